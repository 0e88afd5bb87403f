"""A surface through oriented points: signed distances on a sparse grid, and marching cubes.

Every node near points has the weighted mean of its distances to their planes (Hoppe et al., "Surface reconstruction from
unorganized points", SIGGRAPH 1992; with weights as Kolluri, "Provably good moving least squares", SODA 2005).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.fusion import FAR_BLOCKS, SIDE, following_blocks, without_small_pieces
from tasks.geometry.isosurfaces import level_surface
from tasks.geometry.meshes import Surface
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

REACH_VOXELS = 2.0
"""Distance at which a point loses its weight: nodes of all cells that a surface crosses have points, with a voxel to spare for noise."""

TRIM_VOXELS = 0.9
"""Distance of vertices to their nearest point beyond which there is no surface: it would grow over the edge of what was scanned."""

MIN_PIECE_FACES = 60
"""Smaller pieces are stray points: a pen of 12 cm has more faces at 2 cm."""


BLOCK_BYTES = 16 * 1024
"""Memory for a block: its nodes have a distance, a weight and a color, each of them and their sums as well."""

MAX_BLOCKS = 2**30 // BLOCK_BYTES
"""Blocks that fit into a gigabyte, 65,536. A room of 600,000 voxels has half of them."""


def surface_of_points(
    positions: Array, normals: Array, colors: NDArray[np.uint8], voxel: float, tree: Any, places: NDArray[np.int64]
) -> Surface:
    """The surface that points lie on, with normals to their side.

    Args:
        positions, normals, colors: shape (n, 3) each, positions near the origin.
        voxel: side of a voxel, in the unit of the positions.
        tree: k-d tree of the positions.
        places: blocks that the points reach, by `blocks_of`, shape (k, 3).
    """
    keys = _keys(places)
    size = (len(places), SIDE, SIDE, SIDE)
    sums, weights, shades = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
    _compiled()["_splat"](positions / voxel, normals, colors, keys, FAR_BLOCKS, REACH_VOXELS, sums, weights, shades)
    known = weights > 0
    divisor = np.maximum(weights, np.float32(1e-12))
    sums /= divisor
    shades /= divisor[..., None]
    vertices, faces, painted = level_surface(sums, known, shades, places * SIDE, following_blocks(places))
    vertices *= voxel
    is_near = tree.query(vertices, distance_upper_bound=TRIM_VOXELS * voxel)[0] < np.inf
    faces = faces[is_near[faces].all(axis=1)]
    surface = Surface(vertices, faces, np.clip(np.rint(painted), 0, 255).astype(np.uint8))
    return without_small_pieces(surface, MIN_PIECE_FACES)


def _keys(places: NDArray[np.int64]) -> NDArray[np.int64]:
    return (places + FAR_BLOCKS) @ np.array([(2 * FAR_BLOCKS) ** 2, 2 * FAR_BLOCKS, 1], dtype=np.int64)


def blocks_of(positions: Array, voxel: float) -> NDArray[np.int64]:
    """Blocks of nodes that points reach, sorted by their keys, shape (k, 3)."""
    cells = np.floor(positions / voxel).astype(np.int64)
    low = (cells - int(REACH_VOXELS)) // SIDE
    high = (cells + int(REACH_VOXELS) + 1) // SIDE
    keys = np.zeros(0, dtype=np.int64)
    for corner in range(8):
        is_high = np.array([corner & 1, corner >> 1 & 1, corner >> 2], dtype=bool)
        keys = np.union1d(keys, _keys(np.where(is_high, high, low)))
    width = 2 * FAR_BLOCKS
    return np.stack([keys // width**2, keys // width % width, keys % width], axis=1) - FAR_BLOCKS


@cache
def _compiled() -> Kernels:
    return compile_kernels(_block, _splat)


def _block(keys: Any, key: int) -> int:
    """Position of a key among sorted ones."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


def _splat(positions: Any, normals: Any, colors: Any, keys: Any, far: int, reach: float, sums: Any, weights: Any, shades: Any) -> None:
    """Add each point to the nodes in its reach: distance to its plane, weight and color."""
    side = sums.shape[1]
    last, last_key = -1, -1
    for p in range(len(positions)):
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        for i in range(int(np.ceil(x - reach)), int(np.floor(x + reach)) + 1):
            for j in range(int(np.ceil(y - reach)), int(np.floor(y + reach)) + 1):
                for k in range(int(np.ceil(z - reach)), int(np.floor(z + reach)) + 1):
                    u, v, w = i - x, j - y, k - z
                    distance = (u * u + v * v + w * w) / (reach * reach)
                    if distance >= 1.0:
                        continue
                    bi, bj, bk = i // side, j // side, k // side
                    key = ((bi + far) * 2 * far + bj + far) * 2 * far + bk + far
                    if key != last_key:
                        last, last_key = _block(keys, key), key
                    if last >= len(keys) or keys[last] != key:
                        continue
                    a, b, c = i - bi * side, j - bj * side, k - bk * side
                    share = (1.0 - distance) ** 2
                    sums[last, a, b, c] += share * (u * normals[p, 0] + v * normals[p, 1] + w * normals[p, 2])
                    weights[last, a, b, c] += share
                    for s in range(3):
                        shades[last, a, b, c, s] += share * colors[p, s]
