"""Notes of runs as users read them: equal ones of several objects in one line, the most important first, a few for each scan."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence

MAX_NOTES_PER_SCENE = 10
"""More are not read; all of them are in `stage_runs.degradations`."""

MAX_NAMES = 3
"""Objects that a line names, of those that it is about."""

EXPECTED: tuple[str, ...] = (
    r"no frames in the scan: no views, no masks",  # formats that are a mesh alone
    r"no mesh and no frames in the scan: objects are boxes",  # captured rooms
    r"read as a captured room, by the names of its prims; no frames",
    r"no frame has a pose: what could be seen was decided by virtual cameras",  # follows from the two above
    r"scan mesh thinned from \d+ to \d+ faces",  # of the mesh to look at; nothing is computed from it
    r"[^:]+: not used: [\w.]+(, [\w.]+)*",  # fields of a captured room that no stage needs
    r"instances found in the (geometry|depth of \d+ frames): ",  # what a scan without labels is always segmented by
)
"""Conditions that hold for every scan of a kind. They are kept in the lake, and are no degradations of a run."""

_IS_EXPECTED = re.compile("|".join(f"(?:{pattern})" for pattern in EXPECTED))

_URGENT = re.compile(
    r"\?|\bnot a room\b|\bcheck\b|\bcorrect\b|\brun again\b|\bcannot\b|\bfailed\b|\brefused\b|\bmissing\b|\bwrong\b|\bwithout a pose\b"
)
"""Words of notes that ask for something or name a loss; they come first."""

_OBJECT = re.compile(r"^(?P<name>\d{4,}(?: [\w' -]+?)?): (?P<text>.+)$", re.DOTALL)
_VARYING = re.compile(r"'[^']*'|\b\d{4,}\b|[-+]?\d+(?:[.,]\d+)*")


@dataclasses.dataclass(frozen=True)
class _Note:
    """A note in its parts: the scene and stage that it begins with, the object that it is about, if any, and the rest."""

    place: str
    name: str
    text: str

    @property
    def kind(self) -> tuple[str, str]:
        """What notes of several objects have in common: the place, and the text without names and numbers."""
        return self.place, _VARYING.sub("#", self.text)


def is_expected(line: str) -> bool:
    """True if a line, `scene: stage: text`, states an expected condition."""
    return _IS_EXPECTED.match(_parsed(line).text) is not None


def condensed(lines: Iterable[str], max_lines: int = MAX_NOTES_PER_SCENE) -> list[str]:
    """Notes for a terminal: for each scene at most `max_lines`, equal ones of several objects as one, urgent ones first.

    Args:
        lines: notes as `scene: stage: text`, or `stage: object: text` without a scene.
        max_lines: most lines of a scene; the last one counts those that are left out.
    """
    scenes: dict[str, dict[tuple[str, str], list[_Note]]] = {}
    for line in lines:
        note = _parsed(line)
        scenes.setdefault(note.place.partition(": ")[0], {}).setdefault(note.kind, []).append(note)
    shown: list[str] = []
    for scene, kinds in scenes.items():
        texts = sorted((_together(notes) for notes in kinds.values()), key=lambda text: _URGENT.search(text) is None)
        if len(texts) > max_lines:
            more = len(texts) - max_lines + 1
            texts = [*texts[: max_lines - 1], f"{scene}: and {more} more kinds of notes in stage_runs.degradations"]
        shown += texts
    return shown


def _parsed(line: str) -> _Note:
    """The parts of a line. Scenes have a slash in their name; other lines have no place."""
    scene, _, rest = line.partition(": ")
    stage, separator, text = rest.partition(": ")
    if "/" not in scene or " " in scene or not separator or not re.fullmatch(r"[a-z_]+", stage):
        scene, text, place = "", line, ""
    else:
        place = f"{scene}: {stage}"
    match = _OBJECT.match(text)
    return _Note(place, match["name"], match["text"]) if match else _Note(place, "", text)


def _together(notes: Sequence[_Note]) -> str:
    """Notes of one kind as one line."""
    first = notes[0]
    names = list(dict.fromkeys(note.name for note in notes if note.name))
    if len(notes) == 1:
        parts = [first.place, first.name, first.text]
    elif names:
        rest = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        counted = f"{len(names)} objects ({', '.join(names[:MAX_NAMES])}{rest})" if len(names) > 1 else names[0]
        differ = len({note.text for note in notes}) > 1  # in numbers: those of the first are told
        parts = [first.place, f"{counted}, the first" if differ else counted, first.text]
    else:
        parts = [first.place, f"{first.text} (and {len(notes) - 1} more of this kind)"]
    return ": ".join(part for part in parts if part)
