"""Scenes that show what another scene showed: who erases that one means these, too."""

from __future__ import annotations

import contextlib

from schemas.errors import InputError
from schemas.synthesis import Synthesis
from warehouse.lake import Lake

TABLE = "syntheses"


class FurnishedAnewError(InputError):
    """A scene cannot be erased before those that were made of it. `scenes`: These, the last ones first."""

    def __init__(self, lake: Lake, scene_id: str, scenes: tuple[str, ...]) -> None:
        super().__init__(lake.address, scene_id, f"was furnished anew as {', '.join(scenes)}", "erase these first")
        self.scenes = scenes


def furnished_anew(lake: Lake, scene_id: str) -> tuple[str, ...]:
    """Scenes in which a model furnished an object of a scene anew, and those made of these in turn, the last ones first; in the last
    snapshot, in releases, and among what is staged."""
    based: dict[str, set[str]] = {}
    for staged in lake.staging.runs():  # first: what is committed meanwhile is in the snapshot then
        if TABLE not in staged.files:
            continue
        with contextlib.suppress(FileNotFoundError):
            for entry in lake.staging.read(staged.files[TABLE]).select(["scene_id", "based_on"]).to_pylist():
                based.setdefault(entry["based_on"], set()).add(entry["scene_id"])
    for snapshot_id in {None, *(release.snapshot_id for release in lake.snapshot().releases)}:
        for row in lake.snapshot(snapshot_id).rows(Synthesis):
            if row.based_on is not None:
                based.setdefault(row.based_on, set()).add(row.scene_id)
    matches: dict[str, None] = {}
    waiting = [scene_id]
    while waiting:
        for name in sorted(based.get(waiting.pop(), ())):
            if name not in matches and name != scene_id:
                matches[name] = None
                waiting.append(name)
    return tuple(reversed(matches))
