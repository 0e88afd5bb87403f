"""Contact points of what is round below: four corners that enclose the center of mass.

A ball stands on a patch as wide as a nudge needs to roll it off, as real ones do that are soft or have seams: on a point, it
would roll at the first touch, and on one of the facets of its collider it would lie askew.

Engines keep four points of the many in which two convex shapes touch, as a rule those that span most area: a square in a disc,
turned at random. A lamp that leans out over its foot then falls over the rim between two of them. Corners that do not
touch are no candidates, so the four that hold the lamp, a hull of their own, are the four that every engine finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import REDUCED, Hull, hull_of, stays_within
from tasks.geometry.mass import GRAVITY_M_S2
from tasks.geometry.triangles import face_planes

Array = NDArray[np.float64]

KEPT = 4
"""Contact points that engines keep of a pair of convex shapes."""

UNDERSIDE_M = 1e-4
"""Corners this near in height to the lowest touch level ground [m]."""

LIFT_M = 4e-4
"""How far the rest of a base is lifted [m]: more than what counts as touching, less than anybody sees."""

NEAR_RIM = 0.5
"""A center of mass is near the rim when it is nearer to it than this share of the base's radius, twice its area by its
circumference: an inscribed square encloses all that is farther than 0.3 of a disc's radius from its rim."""

NUDGE_M_S = 0.05
"""A nudge that certificates give [m/s]."""

PATCH = 1.4
"""So many times the distance by which a nudge moves the point to stand on (Pratt et al. 2006, capture point), a patch reaches out."""

ROUND_M = 0.003
"""A patch's corners lie so far below what is round [m], at most, or `ROUND_SHARE` of its center's height: facets of a ball's collider."""

ROUND_SHARE = 0.02
"""See `ROUND_M`: the facets of a sphere of 62 corners are off by as much at the edge of a patch."""

LEAST_MARGIN = 0.8
"""Of the distance to the rim that four corners must leave to the sides between them; else the base stays as it is."""


def on_feet(hulls: Sequence[Hull], center: Array, most: int) -> tuple[Hull, ...]:
    """Hulls of an unscaled asset [m], +Z up: bases with the center of mass near the rim, shape (3,), stand on four of their corners.

    Such a base is lifted by `LIFT_M` and a hull of its own is put at its feet, inside of what it was. What touches the ground in
    a point gets a patch below its center of mass. most: hulls that there may be.
    """
    low = min(float(hull.vertices[:, 2].min()) for hull in hulls)
    patch = _patch(hulls, low, center)
    if patch is not None and len(hulls) < most:
        return (*hulls, patch)
    made: list[Hull] = []
    for hull in hulls:
        feet = _feet_of(hull, low, center[:2])
        lifted = hull if feet is None else _lifted(hull, low)
        made += [lifted, feet] if feet is not None and stays_within(lifted, REDUCED) else [hull]
    return tuple(made) if len(made) <= most else tuple(hulls)


def _feet_of(hull: Hull, low: float, center: Array) -> Hull | None:
    """Four corners of a base and a block above them, inside of it; None for a base that needs none."""
    from scipy.spatial import ConvexHull, QhullError

    base = np.flatnonzero(hull.vertices[:, 2] <= low + UNDERSIDE_M)
    if len(base) <= KEPT:
        return None
    try:
        plan = ConvexHull(hull.vertices[base, :2])
    except QhullError:  # on a line
        return None
    rim = -float((plan.equations[:, :2] @ center + plan.equations[:, 2]).max())
    ring = hull.vertices[base[plan.vertices]]
    if not 0.0 < rim < NEAR_RIM * 2.0 * plan.volume / plan.area or len(ring) <= KEPT:  # in the plane: area and circumference
        return None
    feet, margin = _enclosing(ring[:, :2], center)
    if margin < LEAST_MARGIN * rim:
        return None
    return hull_of(np.concatenate([ring[feet], 0.5 * (ring[feet] + hull.vertices.mean(axis=0))]))


def _patch(hulls: Sequence[Hull], low: float, center: Array) -> Hull | None:
    """A block whose underside is a square below a center of mass, for what touches the ground there and nowhere else."""
    height = max(float(center[2]) - low, 0.0)
    half, gap = PATCH * NUDGE_M_S * float(np.sqrt(height / GRAVITY_M_S2)), max(ROUND_M, ROUND_SHARE * height)
    vertices = np.concatenate([hull.vertices for hull in hulls])
    away = np.abs(vertices[:, :2] - center[:2]).max(axis=1)
    if half <= 0.0 or away[vertices[:, 2] <= low + UNDERSIDE_M].max() >= half or away[vertices[:, 2] <= low + LIFT_M].max() >= 2 * half:
        return None
    corners = center[:2] + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    if max(_above(hulls, corner) for corner in corners) - low > gap:
        return None
    return hull_of(np.concatenate([np.column_stack([corners, np.full(4, z)]) for z in (low, low + 2 * gap)]))


def _above(hulls: Sequence[Hull], place: Array) -> float:
    """Height of the lowest surface over a place in plan, shape (2,); endless where there is none."""
    lowest = np.inf
    for hull in hulls:
        normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
        beside = normals[:, :2] @ place
        down, up = normals[:, 2] < -1e-9, normals[:, 2] > 1e-9
        bottom = float(((beside - offsets)[down] / -normals[down, 2]).max())
        top = float(((offsets - beside)[up] / normals[up, 2]).min())
        upright = ~down & ~up
        if bottom <= top and (beside[upright] <= offsets[upright]).all():
            lowest = min(lowest, bottom)
    return lowest


def _lifted(hull: Hull, low: float) -> Hull:
    """A base without its lowest layer."""
    vertices = hull.vertices.copy()
    vertices[:, 2] = np.maximum(vertices[:, 2], low + LIFT_M)
    return hull_of(vertices)


def _enclosing(ring: Array, center: Array) -> tuple[list[int], float]:
    """Those four corners of a convex polygon, counterclockwise, shape (n, 2), whose sides are farthest from a point, and how far."""
    chosen = np.array(list(combinations(range(len(ring)), KEPT)))
    corners = ring[chosen]
    sides = np.roll(corners, -1, axis=1) - corners
    inward = np.stack([-sides[..., 1], sides[..., 0]], axis=-1) / np.linalg.norm(sides, axis=-1, keepdims=True)
    margins = ((center - corners) * inward).sum(axis=-1).min(axis=1)
    best = int(np.argmax(np.round(margins, 9)))
    return chosen[best].tolist(), float(margins[best])
