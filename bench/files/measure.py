"""Measures of a model that two readers must agree on: triangles, bounds and displayed mean color."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colors import display_of, linear_of

Array = NDArray[np.float64]

REPEAT, CLAMP, MIRROR = 1000, 1001, 1002
"""Wrap modes of textures, as three.js numbers them."""

MAX_SAMPLES = 200_000
"""Most texture samples of a part: the mean of more differs by less than a display value."""

MAX_DIVISIONS = 16
"""Most pieces of a triangle's edge, between which samples of its texture lie."""

MIN_AREA_SHARE = 1e-14
"""Smallest area of a triangle that counts, as a share of the squared diagonal; flat ones are dropped by some readers."""


@dataclasses.dataclass(frozen=True)
class ModelPart:
    """Triangles of one look, in the frame and unit of the file.

    vertices: shape (n, 3). faces: shape (m, 3). factor: linear color, shape (3,); None for a look that the file does not state.
    colors: linear, of vertices, shape (n, 3). uv: shape (n, 2), its origin in the upper left corner. image: sRGB, shape (h, w, 3).
    wraps: wrap modes along u and v.
    """

    vertices: Array
    faces: NDArray[np.int64]
    factor: Array | None = None
    colors: Array | None = None
    uv: Array | None = None
    image: NDArray[np.uint8] | None = None
    wraps: tuple[int, int] = (REPEAT, REPEAT)


@dataclasses.dataclass(frozen=True)
class ModelMeasure:
    """Measures of a model. low, high: bounds in the file's unit. color: mean display value, 0 to 255; None if not all parts state one."""

    triangles: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    color: tuple[float, float, float] | None

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the bounds."""
        return float(np.linalg.norm(np.subtract(self.high, self.low)))


def measure(parts: Sequence[ModelPart]) -> ModelMeasure:
    """Measures of all parts together; triangles without area do not count.

    Raises:
        ValueError: the parts hold no triangles, or coordinates that are not finite.
    """
    corners = [part.vertices[part.faces] for part in parts]
    if not sum(map(len, corners)):
        raise ValueError("holds no triangles")
    points = np.concatenate(corners)
    if not np.isfinite(points).all():
        raise ValueError("has coordinates that are not finite")
    least = MIN_AREA_SHARE * float(np.square(np.ptp(points.reshape(-1, 3), axis=0)).sum())
    total, light, is_colored = 0.0, np.zeros(3), True
    shown = []
    for part, triangles in zip(parts, corners, strict=True):
        areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
        is_shown = areas > least
        if not is_shown.any():
            continue
        shown.append(triangles[is_shown])
        if part.factor is None:
            is_colored = False
            continue
        colors = _face_light(part, part.faces[is_shown])
        light += areas[is_shown] @ colors
        total += float(areas[is_shown].sum())
    if not shown:
        return ModelMeasure(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), None)
    points = np.concatenate(shown).reshape(-1, 3)
    low, high = (tuple(float(value) for value in limit) for limit in (points.min(axis=0), points.max(axis=0)))
    color = tuple(float(value) for value in 255 * display_of(light / total)) if is_colored else None
    return ModelMeasure(len(points) // 3, low, high, color)  # type: ignore[arg-type]


def _face_light(part: ModelPart, faces: NDArray[np.int64]) -> Array:
    """Mean linear color of faces, shape (m, 3)."""
    assert part.factor is not None
    colors = np.tile(part.factor, (len(faces), 1))
    if part.colors is not None:
        colors = colors * part.colors[faces].mean(axis=1)
    if part.uv is not None and part.image is not None:
        colors = colors * _texture_light(part.image, part.uv[faces], part.wraps)
    return colors


def _texture_light(image: NDArray[np.uint8], uv: Array, wraps: tuple[int, int]) -> Array:
    """Mean linear color of a texture over triangles. uv: shape (m, 3, 2)."""
    divisions = int(np.clip((MAX_SAMPLES / max(len(uv), 1)) ** 0.5, 1, MAX_DIVISIONS))
    steps = np.array([(i, j, divisions - 1 - i - j) for i in range(divisions) for j in range(divisions - i)])
    # The pattern is the same from each corner, so the order of corners does not matter.
    weights = (steps + 1 / 3) / divisions
    height, width = image.shape[:2]
    linear = linear_of(image / 255.0)
    light = np.zeros((len(uv), 3))
    for weight in weights:
        place = np.einsum("k,mkd->md", weight, uv)
        column, row = (_pixel(place[:, axis], size, wraps[axis]) for axis, size in ((0, width), (1, height)))
        light += linear[row, column]
    return light / len(weights)


def _pixel(values: Array, size: int, wrap: int) -> NDArray[np.int64]:
    """Pixels at texture coordinates along an axis, shape (m,)."""
    values = np.nan_to_num(values)
    if wrap == REPEAT:
        values = values % 1.0
    elif wrap == MIRROR:
        values = 1.0 - np.abs(values % 2.0 - 1.0)
    return np.clip((values * size).astype(np.int64), 0, size - 1)
