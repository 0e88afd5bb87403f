"""Compare readings of a file with independent judges: agreement, a refusal, a note, or a silent difference."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from bench.files.judges import Verdict
from bench.files.measure import ModelMeasure
from bench.files.readers import FileReading

MAX_SHIFT = 1e-4
"""Largest difference between bounds, as a share of the diagonal: single precision and six digits of text stay below it."""

MAX_COLOR_DIFFERENCE = 3.0
"""Largest difference between mean colors, of 255: each border rounds once, and filters of textures differ by one."""

ASPECTS = ("triangles", "extents", "color")

_ESTIMATED = "its surface is estimated"
"""Note on a point cloud, whose file states no triangles."""

NOTED: dict[str, tuple[str, ...]] = {
    "triangles": (
        "several scenes", "meshes outside the scene", "outlines that cross themselves", "is not read: the finest level is", _ESTIMATED,
    ),
    "extents": ("several scenes", "meshes outside the scene", "the pose at rest is", _ESTIMATED),
    "color": (
        "is missing, drawn without it", "cannot be decoded, drawn without it", "cannot be decoded: drawn without it",
        "is in no library, drawn without it", "for their image: drawn without it", "does not exist: drawn without it",
        "names no image that is read: drawn without it", "lies in another file: drawn without it",
        "numbers for each vertex: drawn without it", "are not as many as its positions: drawn without them",
        "of its base color: drawn without its texture", "colors of vertices under an image are not read",
        "vertices state no color: they are gray", "is taken for its image, by its name",
        "is black under its image: the image is taken as it is", "its clamped texture is read at the vertices alone",
        "vertex colors over a texture are read as their mean", "colors are those of the base color", "the default materials are",
        "specular colors are not read", "colors without their alpha", "that let light through are read as solid", _ESTIMATED,
    ),
}  # fmt: skip
"""Phrases of the notes that explain a difference, by aspect."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A reading compared with judges. verdict, reason: see `verdict_of`. unchecked: aspects that no judge states."""

    verdict: str
    reason: str
    unchecked: tuple[str, ...] = ()


def states(measure: ModelMeasure, aspect: str) -> bool:
    """True if a measure has a value for an aspect: a color may be missing."""
    return aspect != "color" or measure.color is not None


def is_different(aspect: str, reading: ModelMeasure, judged: ModelMeasure) -> bool:
    """True if a reading differs from a judge that states the aspect; a reading without a color differs from any color."""
    if aspect == "triangles":
        return reading.triangles != judged.triangles
    if aspect == "extents":
        limit = MAX_SHIFT * judged.diagonal
        bounds = zip((*reading.low, *reading.high), (*judged.low, *judged.high), strict=True)
        return any(abs(a - b) > limit for a, b in bounds)
    if reading.color is None or judged.color is None:
        return reading.color is not judged.color
    return any(abs(a - b) > MAX_COLOR_DIFFERENCE for a, b in zip(reading.color, judged.color, strict=True))


def is_named(aspect: str, notes: tuple[str, ...]) -> bool:
    """True if a note names a loss that explains a difference."""
    return any(phrase in note for note in notes for phrase in NOTED[aspect])


def verdict_of(outcome: FileReading, verdicts: Mapping[str, Verdict]) -> Comparison:
    """The verdict on a reader, and its reason.

    Only the judges that state an aspect decide it, and one that agrees is enough: judges can be right about one aspect each.
    `agrees` if no aspect differs, `refused` and `noted` with the reason, `silent` for every other difference, and `unjudged` if no
    judge reads the file.
    """
    if outcome.measure is None:
        return Comparison("refused", outcome.reason)
    reading = outcome.measure
    judged = {name: verdict for name, verdict in verdicts.items() if isinstance(verdict, ModelMeasure)}
    if not judged:
        return Comparison("unjudged", "; ".join(f"{name} {verdict}" for name, verdict in verdicts.items()), ASPECTS)
    stating = {aspect: [name for name in judged if states(judged[name], aspect)] for aspect in ASPECTS}
    agreeing = {aspect: [name for name in names if not is_different(aspect, reading, judged[name])] for aspect, names in stating.items()}
    unchecked = tuple(aspect for aspect in ASPECTS if not stating[aspect])
    different = [aspect for aspect in ASPECTS if stating[aspect] and not agreeing[aspect]]
    if not different:
        checks = [f"{aspect} with {', '.join(names)}" for aspect, names in agreeing.items() if names]
        return Comparison("agrees", "; ".join([*checks, *(f"{aspect} unchecked" for aspect in unchecked)]), unchecked)
    unnamed = [aspect for aspect in different if not is_named(aspect, outcome.notes)]
    if unnamed:
        reason = "; ".join(f"{name}: {_shown(verdict)}" for name, verdict in {"read": reading, **judged}.items())
        return Comparison("silent", f"{', '.join(unnamed)}: {reason}", unchecked)
    reasons = [note for note in outcome.notes if any(is_named(aspect, (note,)) for aspect in different)]
    return Comparison("noted", "; ".join(reasons), unchecked)


def judges_differ(verdicts: Mapping[str, Verdict]) -> tuple[str, ...]:
    """Aspects in which judges that state them disagree."""
    judged = [verdict for verdict in verdicts.values() if isinstance(verdict, ModelMeasure)]
    pairs = [(a, b) for i, a in enumerate(judged) for b in judged[i + 1 :]]
    return tuple(
        aspect for aspect in ASPECTS if any(states(a, aspect) and states(b, aspect) and is_different(aspect, a, b) for a, b in pairs)
    )


def _shown(measure: ModelMeasure) -> str:
    color = "no color" if measure.color is None else f"color {tuple(round(value) for value in measure.color)}"
    return f"{measure.triangles} triangles, {measure.diagonal:.6g} across, {color}"
