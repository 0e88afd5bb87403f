"""Objects that stand as they are put but merely balance: a nudge would throw them over, so they are laid down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.mass import GRAVITY_M_S2
from tasks.geometry.transforms import rotation_of
from tasks.optimization.shapes import Shapes, Stand
from tasks.optimization.support.tipping import (
    CONTACT_M,
    LEAST_GAIN,
    MOST_DROP_M,
    MOST_POINTS,
    SUNK_M,
    Tip,
    compiled,
    free_turn,
    kept_shape,
    lean_of,
    move_by,
    put_back,
    turn_about,
)

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

FLAT = 1.7
"""Farther than from its edge onto its side nothing is laid down [rad]."""

SAME_WAY = 0.7
"""Cosine of directions over edges that are as good as one: 45 degrees."""

OTHER_SIDE = 10.0
"""So many times as far off as a nudge reaches, the other edge may be of what falls: 7 cm for a pillow."""

MOST_WAYS = 4
"""Edges that are tried, one after the other."""

MOST_TURNS = 6
"""An object that has not come to lie after so many turns is round: it rolls."""


def lay_down(shapes: Shapes, stand: Stand, body: int, center: Array, among: Booleans, nudge: float) -> Tip | None:
    """Lay a body that merely balances down onto its side. Changes `shapes` and `stand`.

    It balances when a nudge of `nudge` [m/s] takes its center of mass past an edge of its contacts: nearer to it than
    nudge * sqrt(h / g), h its height above them (Pratt et al. 2006, capture point). It goes over the edge behind which it
    touches something soonest and comes to rest. center, among: as for `tip`. None when it withstands the nudge, or does not
    come to lie: then it stays as it is.
    """
    start = stand.place[body].copy()
    vertices, normals = kept_shape(shapes, body)
    for first in range(MOST_WAYS):
        rotation = _fall(shapes, stand, body, center, among, nudge, first)
        if rotation is not None:
            return Tip(rotation, stand.place[body] - start) if np.abs(rotation - np.eye(3)).max() > 0.0 else None
        put_back(shapes, stand, body, vertices, normals, start)
    return None


def _fall(shapes: Shapes, stand: Stand, body: int, center: Array, among: Booleans, nudge: float, first: int) -> Array | None:
    """Let a body fall over its edges until a nudge leaves it where it is: its rotation (3, 3), or None where it does not come to rest.

    first: over which of its weak edges it goes at first, by the turn until it touches something.
    """
    rotation, came = np.eye(3), np.zeros(3)
    points = np.empty((MOST_POINTS, 3))
    for turn in range(MOST_TURNS):
        count = compiled()["contact_points"](shapes, stand, body, among, CONTACT_M, points)
        c, s = stand.turn[body]
        mass = rotation @ np.array([c * center[0] - s * center[1], s * center[0] + c * center[1], center[2]]) + stand.place[body]
        lean = lean_of(points[:count], mass)
        edges = _weak_edges(points[:count], mass, nudge) if lean is None else [lean]
        if lean is not None and not turn:  # where it cannot fall, it may lie on its other side
            edges += [edge for edge in _weak_edges(points[:count], mass, OTHER_SIDE * nudge) if edge[1] @ lean[1] < -SAME_WAY][:1]
        if not edges:
            return rotation
        ways = [(free_turn(shapes, stand, body, among, *edge, FLAT), *edge) for edge in edges if edge[1] @ came > -0.9]
        ways = sorted((way for way in ways if way[0] >= LEAST_GAIN), key=lambda way: way[0])[0 if turn else first :]
        if not ways:
            return None
        angle, pivot, came = ways[0]
        turned = rotation_of(angle * came)
        rotation = turned @ rotation
        turn_about(shapes, stand, body, turned, pivot)
        gap = min(compiled()["least_gap"](shapes, stand, body, among, SUNK_M)[0], float(stand.low[body, 2]))
        if gap > MOST_DROP_M:
            return None
        move_by(stand, shapes, body, np.array([0.0, 0.0, -gap]))
    return None


def _weak_edges(points: Array, center: Array, nudge: float) -> list[tuple[Array, Array]]:
    """Edges of the hull of contacts in plan, points of shape (n, 3), that a nudge [m/s] takes a center of mass, shape (3,), over, the
    nearest first and no two in nearly one direction: a point on each [m] and the unit axis of the turn over it."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        ring = points[ConvexHull(points[:, :2]).vertices]
    except (QhullError, ValueError):  # none, or all on a line
        return []
    reach = nudge * float(np.sqrt(max(center[2] - float(points[:, 2].min()), 0.0) / GRAVITY_M_S2))
    edge = np.roll(ring, -1, axis=0) - ring
    length = np.hypot(edge[:, 0], edge[:, 1])
    ring, edge, length = ring[length > 1e-9], edge[length > 1e-9], length[length > 1e-9]
    out = np.column_stack([edge[:, 1], -edge[:, 0]]) / length[:, None]
    distance = ((ring[:, :2] - center[:2]) * out).sum(axis=1)
    weak: list[tuple[Array, Array]] = []
    for at in np.argsort(distance, kind="stable"):
        axis = np.array([-out[at, 1], out[at, 0], 0.0])
        if distance[at] < reach and all(axis @ other < SAME_WAY for _, other in weak):
            weak.append((ring[at], axis))
    return weak
