"""Assets that cannot stand by themselves: another candidate of the same object that can, before anything is put to rest.

The crop of a chair of which the scan lost two legs, or of a pot that it saw from one side, falls over wherever it is put. Whoever knows
what the object is knows that it stood.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.selection import Selection
from tasks.geometry.transforms import matrix
from tasks.mounting import LEANS, mounting
from tasks.optimization.interior import Interior
from tasks.optimization.misfits import AS_WELL
from tasks.optimization.proposals import Proposal
from tasks.optimization.shapes import shapes_of, stand_of
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.resting import shift
from tasks.optimization.support.tipping import tip

LEAST_SCORE = 0.9
"""Of the score of what was selected: what fits worse is another object, however well it stands."""

MOST_LEAN_RADIANS = 0.15
"""An asset that stands only when it leans by more, 9 degrees, was not meant to stand so."""

ON_FLOOR_M = 0.1
"""What is proposed lower than this stands on the floor [m]."""

NOTE = "another asset, which stands by itself"


def on_their_feet(
    proposals: Sequence[Proposal], selections: Sequence[Selection], assets: Collection[str],
    furnish: Callable[[Sequence[Proposal]], tuple[Interior, list[str]]], most_tilt: float,
) -> tuple[list[Proposal], dict[str, frozenset[str]]]:  # fmt: skip
    """The proposals, those on the floor that cannot stand as they are replaced by the best candidate that can, and the assets that cannot
    stand, by instance. What people chose stays as it is, and so does what may lean or hang, what stands on other furniture, in whatever
    way, and what no candidate can replace.

    most_tilt: how far what stands on nothing but its feet may tip until it rests [rad]; a selected asset may lean by
    `MOST_LEAN_RADIANS`.
    """
    ranked: dict[str, list[Selection]] = defaultdict(list)
    for row in sorted(selections, key=lambda s: (s.instance_id, s.rank)):
        if row.asset_id in assets:
            ranked[row.instance_id].append(row)
    chosen: list[Proposal] = []
    fallen: dict[str, frozenset[str]] = {}
    for proposal in proposals:
        instance = proposal.instance
        kind = mounting(instance.category)
        is_standing = (kind.kind == "stands" or kind.base is not None) and proposal.pose[2, 3] <= ON_FLOOR_M
        if proposal.origin == "selection" and is_standing and instance.category not in LEANS:
            interior, _ = furnish((proposal,))
            if interior.objects and not _stands(interior, most_tilt):
                better, worse = _better(proposal, ranked[instance.instance_id], furnish, most_tilt)
                if better is not None:
                    proposal, fallen[instance.instance_id] = better, worse
        chosen.append(proposal)
    return chosen, fallen


def _better(
    proposal: Proposal, rows: Sequence[Selection], furnish: Callable[[Sequence[Proposal]], tuple[Interior, list[str]]], most_tilt: float
) -> tuple[Proposal | None, frozenset[str]]:
    """The best candidate that stands, None where there is none of a like score, and the assets of better ones, which do not."""
    worse = {proposal.asset_id}
    now = next(row for row in rows if row.asset_id == proposal.asset_id)
    for row in rows:
        if row.asset_id == proposal.asset_id or row.score < LEAST_SCORE * now.score or row.coverage < now.coverage - AS_WELL:
            continue
        other = dataclasses.replace(proposal, asset_id=row.asset_id, pose=matrix(row.pose), scale=np.array(row.scale))
        interior, _ = furnish((other,))
        if interior.objects and _stands(interior, most_tilt):
            return other, frozenset(worse)
        worse.add(row.asset_id)
    return None, frozenset(worse)


def _stands(interior: Interior, most_tilt: float) -> bool:
    """Whether the only object of an interior stands on level ground, nearly as it is."""
    return stands_alone(interior.solids[0], interior.poses[0], most_tilt)


def stands_alone(solid: ConvexParts, pose: NDArray[np.float64], most_tilt: float = MOST_LEAN_RADIANS) -> bool:
    """True if a solid at a rigid pose, 4x4 [m], stands on level ground, or tips by `MOST_LEAN_RADIANS` and `most_tilt` [rad] at most until
    it does."""
    shapes = shapes_of([solid], pose[None])
    stand = stand_of(shapes, pose[None, :3, 3])
    shift(shapes, stand, [0], (0.0, 0.0, -float(stand.low[0, 2])))
    center = pose[:3, :3] @ mass_properties_of(solid).center
    tipped = tip(shapes, stand, 0, center, np.zeros(1, dtype=np.bool_), most_tilt)
    return tipped is not None and float(tipped.rotation[2, 2]) >= np.cos(min(MOST_LEAN_RADIANS, most_tilt))
