"""Scenes that show what another scene showed: who erases that one means these, too."""

from __future__ import annotations

from schemas.synthesis import Synthesis
from warehouse.lake import Lake


def furnished_anew(lake: Lake, scene_id: str) -> tuple[str, ...]:
    """Scenes in which a model furnished an object of a scene anew, and those made of these in turn, the last ones first; in the last
    snapshot and in releases."""
    snapshots = {None, *(release.snapshot_id for release in lake.snapshot().releases)}
    based: dict[str, set[str]] = {}
    for snapshot_id in snapshots:
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
