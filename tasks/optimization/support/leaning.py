"""Leaning: flat or long things whose scan shows that their top is nearer to a wall than their foot. They stand; what hangs is upright."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.support.walls import WallFace

if TYPE_CHECKING:
    from tasks.optimization.support.supports import PlacedAsset

Array = NDArray[np.float64]

LEAST_LEAN_RADIANS = 0.07
"""4 degrees [rad]: the plane of a picture that hangs is scanned within 2."""

HIGH_LEAN_RADIANS, LOW_M = 0.1, 0.35
"""The same where the lowest part that was seen is higher than this above the floor [rad, m]."""

MOST_LEAN_RADIANS = 0.5
"""29 degrees [rad]: what leans by more slides down, or lies."""

FLAT = 0.5
"""The spread of a flat thing across its plane is at most so much of the smaller one within it."""

LONG = 0.2
"""The larger spread of a long thing across its axis is at most so much of the one along it. A pole that was seen from one side is flat as
well, but its plane turns with the side that was seen; its axis does not."""

TOWARDS = 0.5
"""Cosine of the greatest angle between the way in which something leans and the way to the wall: 60 degrees, more than in a corner."""

LEAST_POINTS = 12
"""Fewer points do not say how something leans."""


@dataclasses.dataclass(frozen=True)
class Lean:
    """Lean of an object: the unit vector up along it, shape (3,), and the angle between that and the vertical [rad]."""

    up: Array
    radians: float


def lean_of(obj: PlacedAsset) -> Lean | None:
    """Lean of the asset of an object, by the area of its surface; None where it is neither flat nor long, or lies."""
    corners = obj.surface.vertices[obj.surface.faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return lean_of_points(corners.mean(axis=1), areas)


def lean_of_points(points: Array, weights: Array) -> Lean | None:
    """Lean of something flat or long, from points, shape (n, 3) [m], with weights, shape (n,); None where it is neither, or
    lies."""
    if len(points) < LEAST_POINTS or not weights.sum() > 0.0:
        return None
    away = points - np.average(points, axis=0, weights=weights)
    values, axes = np.linalg.eigh((away * weights[:, None]).T @ away / weights.sum())
    spread = np.sqrt(np.maximum(values, 0.0))
    if spread[1] <= LONG * spread[2] and spread[2] > 0.0:
        up = axes[:, 2] * np.sign(axes[2, 2])
    elif spread[0] <= FLAT * spread[1]:
        normal = axes[:, 0]
        up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        up /= max(float(np.linalg.norm(up)), 1e-12)
    else:
        return None
    if float(up[2]) < math.cos(MOST_LEAN_RADIANS):
        return None
    return Lean(up, math.acos(min(1.0, float(up[2]))))


def is_leaning(obj: PlacedAsset, face: WallFace) -> bool:
    """True if an object leans towards a wall, as what is put on the floor does and what hangs does not: as it was scanned, or, where it has
    no points, as its asset does. What lies behind the wall does not lean at it: there the room's outline is wrong."""
    if float((0.5 * (obj.low + obj.high)[:2] - face.start) @ face.inward) < 0.0:
        return False
    lean = obj.lean if obj.is_scanned else lean_of(obj)
    least = LEAST_LEAN_RADIANS if obj.low[2] <= LOW_M else HIGH_LEAN_RADIANS
    if lean is None or not least <= lean.radians <= MOST_LEAN_RADIANS:
        return False
    return float(lean.up[:2] @ face.inward) <= -TOWARDS * math.sin(lean.radians)
