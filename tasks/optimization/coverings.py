"""Rugs and mats end at the walls: what a scan shows of one beyond is noise, and nobody moves a rug because of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Shell
from schemas.errors import InputError
from tasks.geometry.transforms import inverse, transform_points, translation
from tasks.mounting import mounting
from tasks.optimization.proposals import Proposal
from tasks.optimization.solids import shell_solids
from tasks.shell import floor_ring

if TYPE_CHECKING:
    from shapely import Geometry

Array = NDArray[np.float64]

FREE_M = 0.002
"""A rug that was cut ends this far before its wall [m]."""

LEAST_M2 = 1e-4
"""Of a rug in walls: less is rounding."""

SILL_M = 0.05
"""What of a wall starts higher is over a doorway [m]."""

LEAST_LEFT = 0.5
"""Of a side of a rug: one of which more would be cut lies in another place than it seems to, and stays as it is."""

CUT_NOTE = "cut at the walls"


def cut_at_walls(proposals: Sequence[Proposal], assets: Mapping[str, Asset], room: Shell | None) -> tuple[list[Proposal], dict[str, str]]:
    """The proposals, floor coverings as large as the walls allow, and what has to be said of each that was cut, by instance. What people
    chose stays as it is."""
    if room is None:
        return list(proposals), {}
    try:
        free = _free(room)
    except InputError:  # said where the room is furnished
        return list(proposals), {}
    made: list[Proposal] = []
    notes: dict[str, str] = {}
    for proposal in proposals:
        if proposal.origin == "selection" and mounting(proposal.instance.category).kind == "covering" and abs(proposal.pose[2, 3]) < 0.1:
            cut = _cut(proposal, np.asarray(assets[proposal.asset_id].extents), free)
            if cut is not None:
                proposal, notes[proposal.instance.instance_id] = cut, CUT_NOTE
        made.append(proposal)
    return made, notes


def _cut(proposal: Proposal, extents: Array, free: Geometry) -> Proposal | None:
    """A proposal that ends at the walls, None where it need not or cannot. free: the floor without its walls, a geometry in plan."""
    import shapely

    half = 0.5 * extents[:2] * proposal.scale[:2]
    low, high = -half, half.copy()
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    plan = transform_points(np.column_stack([corners, np.zeros(4)]), proposal.pose)[:, :2]
    outside = shapely.Polygon(plan).difference(free)
    beyond = [part for part in shapely.get_parts(outside) if part.area > LEAST_M2]
    if not beyond:
        return None
    back = inverse(proposal.pose)
    for part in sorted(beyond, key=lambda part: -part.area):
        ring = np.asarray(part.exterior.coords)
        own = transform_points(np.column_stack([ring, np.full(len(ring), proposal.pose[2, 3])]), back)[:, :2]
        first, last = np.maximum(own.min(axis=0), low), np.minimum(own.max(axis=0), high)
        if (last <= first).any():
            continue  # what was cut before took it along
        cuts = []
        for axis in range(2):
            for side, bound in ((0, last[axis] + FREE_M), (1, first[axis] - FREE_M)):
                ends = [low.copy(), high.copy()]
                ends[side][axis] = bound
                cuts.append((float(np.prod(np.maximum(ends[1] - ends[0], 0.0))), -2 * axis - side, ends))
        low, high = max(cuts, key=lambda cut: cut[:2])[2]
    share = (high - low) / (2.0 * half)
    if (share < LEAST_LEFT).any():
        return None
    middle = translation([*(0.5 * (low + high)), 0.0])
    return dataclasses.replace(proposal, pose=proposal.pose @ middle, scale=proposal.scale * [*share, 1.0])


def _free(room: Shell) -> Geometry:
    """The floor of a room without what stands on it of its inner walls, a geometry in plan [m]: their doorways are free.

    Raises:
        InputError: the floor polygon has no area, or an interior wall no size.
    """
    import shapely

    floor = shapely.Polygon(floor_ring(room))
    hulls = [hull.vertices for solid in shell_solids(room) if solid.name.startswith("inner") for hull in solid.hulls]
    walls = [shapely.MultiPoint(corners[:, :2]).convex_hull for corners in hulls if corners[:, 2].min() <= SILL_M]
    return floor.difference(shapely.union_all(walls)) if walls else floor
