"""Normals of points: directions from their neighbors, signs from sensors, from the file, or from the open space around them."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.point_cloud.points import Points
from tasks.capture.point_cloud.thinning import first_in_voxels
from tasks.kernels import Kernels, compile_kernels

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Neighbors = NDArray[np.int32]

NEIGHBORS = 16
"""Points that a plane is fitted to: at half a voxel they span a disc of two voxels, less than a table leg."""

CHUNK = 200_000
"""Points that are fitted at once: their neighbors take 80 MB."""

ROUNDS = 8
"""Votes of neighbors on a sign: signs travel 20 cm, over the gaps between a chair's parts."""

VOTER_VOXELS = 2.0
"""Side of the voxels that have a point with rays, in voxels of the surface: votes travel farther than that."""

PARALLEL = 0.7
"""Cosine above which neighbors lie on one side of a surface."""

DIRECTIONS = 42
"""Rays that leave a point: with more, the signs of generated rooms stay the same."""

MAX_RAY_M = 6.0
"""Length of rays: across a room; longer ones would let a corridor outweigh all else."""

MIN_AGREEMENT = 0.9
"""Share of neighbors with the same sign from which stated normals are oriented: at edges, a tenth of true ones differ."""

MAX_CELLS = 60_000_000
"""Cells of the space that rays cross, in bytes."""

MIN_FLOOR_SHARE, MAX_OPEN_FACTOR = 0.2, 0.33
"""Covered share of a side of the cloud's box that is a floor, and the factor on it below which the opposite side is open: the ceiling was
not scanned. In a turned room, walls cover none of the sides."""

MIN_STATED_SHARE = 0.5
"""Share of points with a normal in the file from which the others follow them."""


@dataclasses.dataclass(frozen=True)
class Normals:
    """Unit normals toward the side that was seen, shape (n, 3), and a line on where their signs are from."""

    values: Array
    note: str


def oriented_normals(points: Points, tree: cKDTree, side: float, unit_m: float) -> Normals:
    """Normals of thinned points. tree: of their positions. side: side of a voxel, in their unit. unit_m: meters per unit."""
    near, values = _fitted(points.positions, tree)
    if points.sensors is None or points.sensor_of is None or not (points.sensor_of >= 0).any():
        return _without_sensors(points, near, values, side, unit_m)
    is_placed = points.sensor_of >= 0
    toward = points.sensors[points.sensor_of] - points.positions
    sensed = values * _signs(values, toward)[:, None]
    if is_placed.all():
        return Normals(sensed, "normals point to the sensors, which the file states")
    unplaced = _without_sensors(points, near, values, side, unit_m)
    note = f"normals point to the sensors, which the file states for {is_placed.mean():.1%} of points; of the others, {unplaced.note}"
    return Normals(np.where(is_placed[:, None], sensed, unplaced.values), note)


def _without_sensors(points: Points, near: Neighbors, values: Array, side: float, unit_m: float) -> Normals:
    """Normals of points whose sensors are not known. near, values: neighbors and directions of `_fitted`."""
    ignored = ""
    if points.normals is not None:
        stated = points.normals.astype(np.float64)
        is_stated = np.linalg.norm(stated, axis=1) > 0.1  # means of opposite normals are short
        signs = np.where(is_stated, _signs(values, stated), 0.0)
        agreement = _agreement(values * signs[:, None], near)
        if is_stated.mean() > MIN_STATED_SHARE and agreement >= MIN_AGREEMENT:
            return Normals(values * _voted(values, signs, near)[:, None], "normals have the signs that the file states")
        ignored = f"; those of the file are not used, as {1 - agreement:.0%} of neighbors contradict each other"
    # A few points of each surface tell the side, and their neighbors follow: rays are dear.
    chosen = first_in_voxels(points.positions, VOTER_VOXELS * side)
    openness = _openness(points.positions, chosen, values, side, unit_m)
    signs = np.zeros(len(values))
    signs[chosen] = (openness[:, 0] - openness[:, 1]) / np.maximum(openness.sum(axis=1), 1e-9)
    return Normals(values * _voted(values, signs, near)[:, None], f"normals point to the open space around the surface{ignored}")


def _fitted(positions: Array, tree: cKDTree) -> tuple[Neighbors, Array]:
    """Neighbors of each point, shape (n, k), and the directions in which they spread least, shape (n, 3)."""
    count = min(NEIGHBORS, len(positions))
    near, values = np.empty((len(positions), count), np.int32), np.empty((len(positions), 3))
    for start in range(0, len(positions), CHUNK):
        rows = slice(start, start + CHUNK)
        near[rows] = tree.query(positions[rows], count)[1]
        offsets = positions[near[rows]]
        offsets -= offsets.mean(axis=1, keepdims=True)
        values[rows] = np.linalg.eigh(offsets.transpose(0, 2, 1) @ offsets)[1][:, :, 0]
    return near, values


def _signs(values: Array, toward: Array) -> Array:
    """Signs that turn directions toward others, shape (n,)."""
    return np.where(np.einsum("ni,ni->n", values, toward) < 0, -1.0, 1.0)


def _agreement(values: Array, near: Neighbors) -> float:
    """Share of neighbors of a sample with parallel directions that have the same sign."""
    sample = np.linspace(0, len(values) - 1, min(len(values), CHUNK // 10)).astype(np.int64)
    cosines = np.einsum("ni,nki->nk", values[sample], values[near[sample]])
    is_parallel = np.abs(cosines) > PARALLEL
    return float((cosines[is_parallel] > 0).mean()) if is_parallel.any() else 0.0


def _voted(values: Array, signs: Array, near: Neighbors) -> Array:
    """Signs after votes of neighbors, weighted by how parallel they are, shape (n,).

    signs: -1 to 1 by their certainty.
    """
    weights = np.empty(near.shape, np.float32)
    for start in range(0, len(values), CHUNK):
        rows = slice(start, start + CHUNK)
        cosines = (values[near[rows]] @ values[rows, :, None])[:, :, 0]
        weights[rows] = cosines * np.abs(cosines)
    score = signs.astype(np.float32)
    for _ in range(ROUNDS):
        score = np.clip(2.0 * (weights * score[near]).mean(axis=1), -1.0, 1.0)
    return np.where(score < 0, -1.0, 1.0)


def _openness(positions: Array, chosen: NDArray[np.int64], values: Array, side: float, unit_m: float) -> Array:
    """Mean free distance on either side of chosen points, in cells, shape (k, 2): along the direction and against it.

    A ray that leaves the cloud through a closed side of its box counts as blocked at once: nothing was seen from there.
    """
    low, high = positions.min(axis=0), positions.max(axis=0)
    cell = max(side, float(np.prod(np.maximum(high - low, side) / MAX_CELLS ** (1 / 3)) ** (1 / 3)))
    shape = np.maximum(np.ceil((high - low) / cell).astype(np.int64), 1) + 1
    cells = np.minimum(((positions - low) / cell).astype(np.int64), shape - 1)
    is_occupied = np.zeros(shape, np.uint8)
    is_occupied[tuple(cells.T)] = 1
    covered = np.array([_covered(is_occupied, axis, end) for axis in range(3) for end in (0, 1)])
    opposite = covered[[1, 0, 3, 2, 5, 4]]
    is_open = ((opposite > MIN_FLOOR_SHARE) & (covered < MAX_OPEN_FACTOR * opposite)).astype(np.uint8)
    steps = int(np.clip(MAX_RAY_M / unit_m / cell, 8, 4096))
    openness = np.zeros((len(chosen), 2))
    _compiled()["_cast"]((positions[chosen] - low) / cell, values[chosen], _sphere(), is_occupied, is_open, steps, openness)
    return openness


def _covered(is_occupied: NDArray[np.uint8], axis: int, end: int) -> float:
    """Share of a side of the box that has points behind it, within a tenth of the box."""
    depth = max(2, is_occupied.shape[axis] // 10)
    layer = np.take(is_occupied, range(depth) if not end else range(-min(depth, is_occupied.shape[axis]), 0), axis=axis, mode="wrap")
    return float(layer.any(axis=axis).mean())


def _sphere() -> Array:
    """Directions that are spread evenly, on a spiral."""
    rank = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - 2.0 * rank / DIRECTIONS
    angle = np.pi * (1.0 + 5.0**0.5) * rank
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_cast)


def _cast(positions: Any, values: Any, directions: Any, is_occupied: Any, is_open: Any, steps: int, openness: Any) -> None:
    """Follow rays from points through cells until one is occupied."""
    nx, ny, nz = is_occupied.shape
    for p in range(len(positions)):
        rays = np.zeros(2)
        for d in range(len(directions)):
            dx, dy, dz = directions[d, 0], directions[d, 1], directions[d, 2]
            cosine = dx * values[p, 0] + dy * values[p, 1] + dz * values[p, 2]
            if abs(cosine) < 0.25:
                continue  # runs along the surface
            half = 0 if cosine > 0 else 1
            sign = 1.0 if cosine > 0 else -1.0
            rays[half] += 1.0
            # Begin two cells above the surface: noise must not block a ray at its own point.
            x = positions[p, 0] + 2.0 * sign * values[p, 0]
            y = positions[p, 1] + 2.0 * sign * values[p, 1]
            z = positions[p, 2] + 2.0 * sign * values[p, 2]
            free = 0.0
            for step in range(steps):
                i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
                    face = 0 if i < 0 else 1 if i >= nx else 2 if j < 0 else 3 if j >= ny else 4 if k < 0 else 5
                    free = float(step) if is_open[face] else 0.0
                    break
                free = float(step)
                if is_occupied[i, j, k]:
                    break
                x += dx
                y += dy
                z += dz
            openness[p, half] += free
        for half in range(2):
            if rays[half] > 0.0:
                openness[p, half] /= rays[half]
