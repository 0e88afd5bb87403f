"""Shoring: thin boards and feet, in colliders only, under what would fall because the scan did not see what carries it.

A scan loses the boards of a shelf behind the things on it, feet, and the flat undersides of small things. What stood there stood on
something: it is put there, no larger than needed, and marked (`supports.is_inferred`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.cutting import solid_hull, without
from tasks.geometry.hulls import Hull
from tasks.geometry.transforms import inverse
from tasks.mounting import HOLDS_NOTHING, mounting
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.supports import Carrier, PlacedAsset

Array = NDArray[np.float64]

BOARD_M = 0.02
"""Thickness of a board [m]."""

PLATE_M = 0.006
"""Thickness of a plate under an object [m]."""

EDGE_M = 0.01
"""A board reaches so far out of what it carries [m]."""

LOWER_SHARE = 0.33
"""Of the height of an object: a plate is as wide as that much of it."""

LEAST_MARGIN_M = 0.01
"""The center of mass lies so far within a plate [m], if the object is wide enough: less, and a nudge throws it over."""

WITHIN_SHARE = 0.6
"""Of the plan of an object that must lie over a piece of furniture which is to have a board for it."""


def board_bearers(placed: Sequence[PlacedAsset], carriers: Mapping[str, Carrier]) -> dict[str, str]:
    """Of each object that nothing carries, and whose name does not say that it hangs, the smallest piece of furniture within which it is:
    that has a board there which was not seen. By instance; of those without any, nothing."""
    by_id = {obj.instance_id: obj for obj in placed}
    bearers: dict[str, str] = {}
    for name, carrier in sorted(carriers.items()):
        obj = by_id[name]
        if carrier.relation != "none" or mounting(obj.category).kind in ("wall", "ceiling", "let_in", "covering"):
            continue
        around = [
            other
            for other in placed
            if other.instance_id != name
            and carriers[other.instance_id].relation != "none"
            and other.category not in HOLDS_NOTHING
            and other.low[2] < obj.low[2] < other.high[2] - EDGE_M
            and _shared(obj, other) >= WITHIN_SHARE * obj.plan_area
            and np.prod(other.high - other.low) > 2.0 * np.prod(obj.high - obj.low)
        ]
        if around:
            bearers[name] = min(around, key=lambda other: (float(np.prod(other.high - other.low)), other.instance_id)).instance_id
    return bearers


def _shared(obj: PlacedAsset, other: PlacedAsset) -> float:
    """Area that the boxes of two objects share in plan [m2]."""
    return float(np.prod(np.maximum(np.minimum(obj.high, other.high) - np.maximum(obj.low, other.low), 0.0)[:2]))


def board(obj: PlacedAsset, bearer: PlacedAsset) -> Hull:
    """A board within the box of a piece of furniture, right below an object, world frame [m]."""
    low, high = np.maximum(obj.low - EDGE_M, bearer.low), np.minimum(obj.high + EDGE_M, bearer.high)
    top = float(obj.low[2])
    return _prism(np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]), top - BOARD_M, top)


def _prism(ring: Array, low: float, high: float) -> Hull:
    """An upright prism over corners in plan, shape (n, 2) [m].

    Raises:
        ValueError: it is thinner than what counts as a solid.
    """
    points = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in (low, high)])
    hull = solid_hull(points)
    if hull is None:
        raise ValueError("a prism of no thickness")
    return hull


@dataclasses.dataclass(frozen=True)
class Shored:
    """Solids in their own frames, and the objects, by number, that stand on a plate of their own."""

    solids: tuple[ConvexParts, ...]
    plated: frozenset[int]


def with_plates(solids: Sequence[ConvexParts], poses: Array, parents: Sequence[int], wanted: Collection[int], clear: float) -> Shored:
    """Solids at rest at `poses`, shape (n, 4, 4) [m], of which those in `wanted` get a flat plate at their lowest point, as wide as their
    lower part, and a board below it in the collider of what carries them; neither reaches into anything.

    parents: who carries each, -1 for the floor. clear: gap that plates keep beside others [m].
    """
    placed = [list(solid.placed(pose)) for solid, pose in zip(solids, poses, strict=True)]
    plated: set[int] = set()
    changed: set[int] = set()
    for i in sorted(wanted):
        vertices = np.concatenate([hull.vertices for hull in placed[i]])
        low, height = float(vertices[:, 2].min()), float(np.ptp(vertices[:, 2]))
        center = poses[i][:3, :3] @ mass_properties_of(solids[i]).center + poses[i][:3, 3]
        ring = _ring(vertices[vertices[:, 2] <= low + max(LOWER_SHARE * height, BOARD_M), :2])
        if ring is None or not _holds(ring, center[:2]):
            continue
        around = [hull for k, hulls in enumerate(placed) if k != i for hull in hulls if _is_near(hull, ring, low)]
        plates = _beside(_prism(ring, low, low + PLATE_M), around, clear)
        if not plates or not _holds(np.concatenate([plate.vertices[:, :2] for plate in plates]), center[:2]):
            continue
        parent = parents[i]
        if parent >= 0 and low > BOARD_M:
            apart = [hull for k, hulls in enumerate(placed) if k not in (i, parent) for hull in hulls if _is_near(hull, ring, low)]
            boards = _beside(_prism(ring, low - BOARD_M, low), apart, clear)
            if not boards:
                continue
            placed[parent] += boards
            changed.add(parent)
        placed[i] += plates
        changed.add(i)
        plated.add(i)
    made = list(solids)
    for i in changed:
        back = inverse(poses[i])
        made[i] = ConvexParts(made[i].name, tuple(hull.transformed(back) for hull in placed[i]), None, made[i].shares)
    return Shored(tuple(made), frozenset(plated))


def _ring(points: Array) -> Array | None:
    """Corners of the convex hull of points in plan, shape (n, 2) [m]; None where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return None


def _holds(ring: Array, center: Array) -> bool:
    """Whether a center of mass, shape (2,), lies well within the convex hull of points in plan, shape (n, 2) [m]."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        plan = ConvexHull(ring)
    except (QhullError, ValueError):
        return False
    margin = -float((plan.equations[:, :2] @ center + plan.equations[:, 2]).max())
    return margin >= min(LEAST_MARGIN_M, 0.25 * plan.volume / max(plan.area, 1e-9))


def _is_near(hull: Hull, ring: Array, low: float) -> bool:
    """Whether a piece may reach into a plate, or the board below it."""
    first, last = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    in_plan = bool((first[:2] <= ring.max(axis=0)).all() and (last[:2] >= ring.min(axis=0)).all())
    return in_plan and bool(first[2] < low + PLATE_M and last[2] > low - BOARD_M)


def _beside(hull: Hull, around: Sequence[Hull], clear: float) -> list[Hull]:
    """What of a hull is in none of some others, as convex parts."""
    parts = [hull]
    for other in around:
        top = float(other.vertices[:, 2].max())
        if top <= float(hull.vertices[:, 2].min()) + 1e-5:
            continue  # it carries the plate
        parts = [part for each in parts for part in without(each, other, clear)]
    return parts
