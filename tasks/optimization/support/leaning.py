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

MOST_LEAN_RADIANS = 0.5
"""29 degrees [rad]: what leans by more slides down, or lies."""

FLAT = 0.5
"""The spread of a flat thing across its plane is at most so much of the smaller one within it, and that of a long thing across its axis
of the one along it."""

TOWARDS = 0.7
"""Cosine of the greatest angle between the way in which something leans and the way to the wall: 45 degrees."""


@dataclasses.dataclass(frozen=True)
class Lean:
    """How an object leans: the unit vector up along it, shape (3,), and the angle between that and the vertical [rad]."""

    up: Array
    radians: float


def lean_of(obj: PlacedAsset) -> Lean | None:
    """How a flat or long object leans, by the area of its surface; None where it is neither, or lies."""
    corners = obj.surface.vertices[obj.surface.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.sum() > 0.0:
        return None
    points = corners.mean(axis=1)
    away = points - np.average(points, axis=0, weights=area)
    values, axes = np.linalg.eigh((away * area[:, None]).T @ away / area.sum())
    spread = np.sqrt(np.maximum(values, 0.0))
    if spread[0] <= FLAT * spread[1]:
        normal = axes[:, 0]
        up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    elif spread[1] <= FLAT * spread[2]:
        up = axes[:, 2] * np.sign(axes[2, 2])
    else:
        return None
    length = float(np.linalg.norm(up))
    if length < math.cos(MOST_LEAN_RADIANS):
        return None
    up = up / length
    return Lean(up, math.acos(min(1.0, float(up[2]))))


def is_leaning(obj: PlacedAsset, face: WallFace) -> bool:
    """True if an object leans towards a wall, as what is put on the floor does and what hangs does not."""
    lean = lean_of(obj)
    if lean is None or not LEAST_LEAN_RADIANS <= lean.radians <= MOST_LEAN_RADIANS:
        return False
    return float(lean.up[:2] @ face.inward) <= -TOWARDS * math.sin(lean.radians)
