"""Balance: where the center of an object's mass lies over what it touches, and how objects at an edge are drawn back from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.interior import Interior
from tasks.optimization.shapes import Shapes, Stand
from tasks.optimization.support.resting import bearing, center_of_mass, shift
from tasks.optimization.support.tipping import CONTACT_M, MOST_POINTS, compiled

Array = NDArray[np.float64]

EDGE_M = 0.015
"""What stands on another object keeps its center of mass this far from the edge of what it touches [m], if its base allows:
an elbow's push does not throw it down."""

BASE_SHARE = 0.5
"""Of the distance between the center of mass and the rim of an object's own base: a bottle's is 3 cm."""

MOST_BACK_M = 0.15
"""Farther than this no object is drawn [m]: what carries it in the middle of its carrier is no edge, but a bump of a scanned top."""


def balance(points: Array, center: Array) -> tuple[float, Array]:
    """How far a center of mass, shape (2,), lies inside the convex hull of contacts in plan, shape (n, 2) [m], negative
    outside, and the unit direction into it, shape (2,)."""
    from scipy.spatial import ConvexHull, QhullError

    middle = points.mean(axis=0)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        way = middle - center
        distance = float(np.hypot(*way))
        return -distance, way / distance if distance > 1e-9 else np.zeros(2)
    away = hull.equations[:, :2] @ center + hull.equations[:, 2]
    worst = int(np.argmax(away))
    if away[worst] <= 0.0:
        return -float(away[worst]), -hull.equations[worst, :2]
    ring = points[hull.vertices]
    after = np.roll(ring, -1, axis=0)
    edge = after - ring
    share = np.clip(((center - ring) * edge).sum(axis=1) / np.maximum((edge**2).sum(axis=1), 1e-18), 0.0, 1.0)
    nearest = ring + share[:, None] * edge
    distances = np.hypot(*(nearest - center).T)
    best = int(np.argmin(distances))
    return -float(distances[best]), (nearest[best] - center) / max(float(distances[best]), 1e-12)


def draw_back(interior: Interior, shapes: Shapes, stand: Stand) -> list[tuple[int, tuple[float, float]]]:
    """Draw objects that stand at the edge of what carries them, or over it, back onto it. Returns (object, (dx, dy) [m])."""
    moves = []
    groups = interior.groups()
    points = np.empty((MOST_POINTS, 3))
    for i, carrier in enumerate(interior.carriers):
        parent = int(interior.parent[i])
        if parent < 0 or interior.covering[[parent, i]].any() or interior.fixed[i] or carrier.relation not in ("on", "inside"):
            continue
        among = bearing(interior, shapes, stand, i)
        base = base_of(shapes, stand, i)
        total = np.zeros(2)
        for _ in range(4):
            center = (stand.place[i] + center_of_mass(interior, i))[:2]
            wanted = min(EDGE_M, BASE_SHARE * balance(base + stand.place[i][:2], center)[0])
            count = compiled()["contact_points"](shapes, stand, i, among, CONTACT_M, points)
            if wanted <= 0.0 or count == 0:
                break
            margin, inward = balance(points[:count, :2], center)
            if margin >= wanted - 1e-6:
                break
            way = (wanted - margin + 0.001) * inward
            if np.hypot(*(total + way)) > MOST_BACK_M:
                shift(shapes, stand, groups[i], (-float(total[0]), -float(total[1]), 0.0))
                total[:] = 0.0
                break
            shift(shapes, stand, groups[i], (float(way[0]), float(way[1]), 0.0))
            total += way
        if total.any():
            moves.append((i, (float(total[0]), float(total[1]))))
    return moves


def base_of(shapes: Shapes, stand: Stand, obj: int) -> Array:
    """What an object touches level ground with, from its pivot in plan [m], shape (n, 2)."""
    first, last = shapes.first_piece[obj], shapes.first_piece[obj + 1]
    vertices = shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]]
    return np.asarray(vertices[vertices[:, 2] <= vertices[:, 2].min() + CONTACT_M, :2])
