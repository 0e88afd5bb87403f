"""Shoring: thin plates, in colliders only, under what would tip because the scan did not see what it stands on.

A scan loses the flat undersides of small things, and bends the tops below them. What stood there stood flat: it gets a plate below it, and
what carries it a board, no larger than needed, and is marked (`supports.is_inferred`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull
from tasks.geometry.transforms import inverse
from tasks.optimization.colliders.cutting import beyond, prism, without
from tasks.optimization.interior import Interior
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.boards import BOARD_M

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])

PLATE_M = 0.006
"""Thickness of a plate under an object [m]."""

LOWER_SHARE = 0.33
"""Of the height of an object: a plate is as wide as that much of it."""

LEAST_MARGIN_M = 0.01
"""The center of mass lies so far within a plate [m], if the object is wide enough: less, and a nudge throws it over."""


def with_plates(interior: Interior, poses: Array, wanted: Collection[int], clear: float) -> tuple[Interior, frozenset[int]]:
    """The interior, and the objects by number, of which those in `wanted` that are at rest at `poses`, shape (n, 4, 4) [m], got a flat
    plate at their lowest point, as wide as their lower part, and a board below it in the collider of what carries them; neither reaches
    into anything.

    clear: gap that plates keep beside others [m].
    """
    solids, parents = interior.solids, interior.parent.tolist()
    placed = [list(solid.placed(pose)) for solid, pose in zip(solids, poses, strict=True)]
    plated: set[int] = set()
    changed: set[int] = set()
    for i in sorted(wanted):
        vertices = np.concatenate([hull.vertices for hull in placed[i]])
        low, height = float(vertices[:, 2].min()), float(np.ptp(vertices[:, 2]))
        center = poses[i][:3, :3] @ mass_properties_of(solids[i]).center + poses[i][:3, 3]
        level = low + max(LOWER_SHARE * height, BOARD_M)
        lower = [part.vertices[:, :2] for hull in placed[i] if (part := beyond(hull, DOWN, -level)) is not None]
        ring = _ring(np.concatenate([*lower, np.zeros((0, 2))]))
        if ring is None or not _holds(ring, center[:2]):
            continue
        around = [hull for k, hulls in enumerate(placed) if k != i for hull in hulls if _is_near(hull, ring, low)]
        plates = _beside(prism(ring, low, low + PLATE_M), around, clear)
        if not plates or not _holds(np.concatenate([plate.vertices[:, :2] for plate in plates]), center[:2]):
            continue
        parent = parents[i]
        if parent >= 0 and low > BOARD_M:
            apart = [hull for k, hulls in enumerate(placed) if k not in (i, parent) for hull in hulls if _is_near(hull, ring, low)]
            boards = _beside(prism(ring, low - BOARD_M, low), apart, clear)
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
        made[i] = ConvexParts(made[i].name, tuple(hull.transformed(back) for hull in placed[i]))
    carriers = tuple(dataclasses.replace(c, is_inferred=c.is_inferred or i in plated) for i, c in enumerate(interior.carriers))
    return dataclasses.replace(interior, solids=tuple(made), carriers=carriers), frozenset(plated)


def _ring(points: Array) -> Array | None:
    """Corners of the convex hull of points in plan, shape (n, 2) [m]; None where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return None


def _holds(ring: Array, center: Array) -> bool:
    """True if a center of mass, shape (2,), lies well within the convex hull of points in plan, shape (n, 2) [m]."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        plan = ConvexHull(ring)
    except (QhullError, ValueError):
        return False
    margin = -float((plan.equations[:, :2] @ center + plan.equations[:, 2]).max())
    return margin >= min(LEAST_MARGIN_M, 0.25 * plan.volume / max(plan.area, 1e-9))


def _is_near(hull: Hull, ring: Array, low: float) -> bool:
    """True if a piece may reach into a plate, or the board below it."""
    first, last = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    in_plan = bool((first[:2] <= ring.max(axis=0)).all() and (last[:2] >= ring.min(axis=0)).all())
    return in_plan and bool(first[2] < low + PLATE_M and last[2] > low - BOARD_M)


def _beside(hull: Hull | None, around: Sequence[Hull], clear: float) -> list[Hull]:
    """Convex parts of a hull that lie in none of several other hulls; none if there is no hull."""
    if hull is None:
        return []
    parts = [hull]
    for other in around:
        top = float(other.vertices[:, 2].max())
        if top <= float(hull.vertices[:, 2].min()) + 1e-5:
            continue  # it carries the plate
        parts = [part for each in parts for part in without(each, other, clear)]
    return parts
