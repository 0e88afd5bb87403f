"""Coordinates of surveys: meshes far from their origin are moved near to it while they are still doubles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError

Array = NDArray[np.float64]

MAX_PLAIN_OFFSET_M = 1_000.0
"""Meshes within this distance stay where they are: float32 keeps a tenth of a millimetre there."""

MAX_SURVEY_OFFSET = 1e8
"""Larger than all coordinates of map projections [m]; doubles keep a micrometre up to here."""

MAX_STEP_M = 0.002
"""Largest step between stored coordinates that leaves furniture its shape."""


def survey_shift(vertices: Array, name: str) -> Array | None:
    """Translation (3,) in whole metres that brings vertices (n, 3) [m] near to the origin; None for vertices that are near.

    Raises:
        InputError: coordinates were stored as 32-bit floats, too coarse at this distance.
    """
    center = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
    distance = float(np.abs(center).max())
    if not MAX_PLAIN_OFFSET_M < distance <= MAX_SURVEY_OFFSET:
        return None
    axis = int(np.abs(center).argmax())
    column = vertices[:, axis]
    step = float(np.spacing(np.float32(distance)))
    if step > MAX_STEP_M and (column.astype(np.float32) == column).all():
        problem = f"are {far(distance)} from the origin and stored as 32-bit floats, in steps of {step:.3g} m"
        raise InputError(name, "vertices", problem, "export doubles, or subtract the survey offset before the export")
    return -np.round(center)


def shift_note(shift: Array, name: str) -> str:
    """Line that tells of a shift (3,) [m]."""
    x, y, z = (f"{value:,.0f}" for value in shift)
    return f"{name}: coordinates of a survey were moved by ({x}, {y}, {z}) m to the origin"


def far(distance_m: float) -> str:
    """A large distance in words."""
    return f"{distance_m / 1000:,.4g} km" if distance_m < 1e7 else f"{distance_m / 1000:,.0f} km"


def offset_error(name: str, distance_m: float, limit_m: float) -> InputError:
    """Error of a mesh that lies too far from its origin."""
    problem = f"are {far(distance_m)} from the origin (limit {far(limit_m)})"
    return InputError(name, "vertices", problem, "subtract the survey offset")
