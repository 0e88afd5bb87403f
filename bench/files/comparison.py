"""Compare what a reader makes of a file with independent judges: agreement, a refusal, a note, or a silent difference."""

from __future__ import annotations

from collections.abc import Mapping

from bench.files.judges import Verdict
from bench.files.measure import ModelMeasure
from bench.files.readers import FileReading

MAX_SHIFT = 1e-4
"""Largest difference between bounds, as a share of the diagonal: single precision and six digits of text stay below it."""

MAX_COLOR_DIFFERENCE = 3.0
"""Largest difference between mean colors, of 255: each border rounds once, and filters of textures differ by one."""

ASPECTS = ("triangles", "extents", "color")

_NOTED = {
    "triangles": ("point", "line", "scene", "instance", "skin", "triangle"),
    "extents": ("scene", "instance", "skin", "animation", "survey"),
    "color": ("color", "texture", "image", "material", "missing", "decoded", "black", "drawn without"),
}
"""Words by which a note names a loss, by aspect."""


def difference_of(reading: ModelMeasure, judged: ModelMeasure) -> tuple[str, ...]:
    """Aspects in which two measures differ; colors count if both state one."""
    different = ["triangles"] if reading.triangles != judged.triangles else []
    limit = MAX_SHIFT * judged.diagonal
    bounds = zip((*reading.low, *reading.high), (*judged.low, *judged.high), strict=True)
    if any(abs(a - b) > limit for a, b in bounds):
        different.append("extents")
    if reading.color is not None and judged.color is not None:
        is_other = any(abs(a - b) > MAX_COLOR_DIFFERENCE for a, b in zip(reading.color, judged.color, strict=True))
        different += ["color"] if is_other else []
    return tuple(different)


def is_named(aspect: str, notes: tuple[str, ...]) -> bool:
    """True if a note names a loss that explains a difference."""
    return any(word in note.lower() for note in notes for word in _NOTED[aspect])


def verdict_of(outcome: FileReading, verdicts: Mapping[str, Verdict]) -> tuple[str, str]:
    """The verdict on a reader, and its reason.

    `agrees` if each aspect is as a judge has it, `refused` and `noted` with the reason, `silent` for every other difference,
    and `unjudged` if no judge reads the file.
    """
    if outcome.measure is None:
        return "refused", outcome.reason
    reading = outcome.measure
    judged = {name: verdict for name, verdict in verdicts.items() if isinstance(verdict, ModelMeasure)}
    if not judged:
        return "unjudged", "; ".join(f"{name} {verdict}" for name, verdict in verdicts.items())
    differences = {name: difference_of(reading, verdict) for name, verdict in judged.items()}
    if not all(differences.values()):
        return "agrees", "with " + ", ".join(name for name, different in differences.items() if not different)
    # Judges that disagree with each other can be right about one aspect each.
    different = [aspect for aspect in ASPECTS if all(aspect in each for each in differences.values())]
    if not different:
        return "agrees", "with a different judge in each aspect"
    unnamed = [aspect for aspect in different if not is_named(aspect, outcome.notes)]
    reason = "; ".join(f"{name}: {_shown(verdict)}" for name, verdict in {"read": reading, **judged}.items())
    if unnamed:
        return "silent", f"{', '.join(unnamed)}: {reason}"
    return "noted", "; ".join(note for note in outcome.notes if any(is_named(aspect, (note,)) for aspect in different))


def judges_differ(verdicts: Mapping[str, Verdict]) -> tuple[str, ...]:
    """Aspects in which judges that read a file disagree."""
    judged = [verdict for verdict in verdicts.values() if isinstance(verdict, ModelMeasure)]
    aspects = {aspect for i, a in enumerate(judged) for b in judged[i + 1 :] for aspect in difference_of(a, b)}
    return tuple(aspect for aspect in ASPECTS if aspect in aspects)


def _shown(measure: ModelMeasure) -> str:
    color = "no color" if measure.color is None else f"color {tuple(round(value) for value in measure.color)}"
    return f"{measure.triangles} triangles, {measure.diagonal:.6g} across, {color}"
