"""Posed depth and color into one surface: truncated signed distances on a sparse grid, compiled.

Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH 1996: every voxel near a
reading keeps the running mean of its distance to the surface along the camera's axis, and of its color; the surface is
the zero level. Voxels live in blocks of 8 x 8 x 8 that a hash table finds, made where readings are (Niessner et al.,
"Real-time 3D reconstruction at scale using voxel hashing", SIGGRAPH Asia 2013). Frames count in the order in which they
come and blocks are numbered as they are made: the same frames give the same mesh, to the byte.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.isosurfaces import level_surface
from tasks.geometry.meshes import Surface
from tasks.kernels import Kernels, compile_kernels

Intrinsics = tuple[float, float, float, float]
"""fx, fy, cx, cy [px]; the center of the first pixel is (0, 0)."""

SIDE = 8
"""Voxels along a block: large enough that finding blocks costs little, small enough that few voxels lie idle."""

_FIRST_BLOCKS = 4096
"""Room for a corner of a room, 25 MB; doubled whenever it is full."""

_WIDEST_STRIDE = 4
"""Blocks are sought along every fourth pixel's ray, or more where a block is seen under fewer pixels."""

FAR_BLOCKS = 1 << 20
"""Blocks along an axis on either side of the origin, 160 km at 2 cm: three such numbers fit into one key."""

_COLOR_STEPS = 256
"""Colors are kept in steps of 1/256, so that the rounding of hundreds of means stays under a unit."""


class Volume:
    """A sparse grid of truncated signed distances in the frame of the poses.

    voxel_m: Side of a voxel [m]. truncation_voxels: Distance beyond which a reading says nothing about what is behind it.
    """

    def __init__(self, voxel_m: float, truncation_voxels: float) -> None:
        self.voxel_m = float(voxel_m)
        self.truncation_m = float(truncation_voxels * voxel_m)
        self.blocks = 0
        self._places = np.zeros((0, 3), dtype=np.int64)
        self._seen = np.zeros(0, dtype=np.int64)
        self._values = np.zeros((0, *(SIDE,) * 3), dtype=np.float32)
        self._weights = np.zeros(self._values.shape, dtype=np.uint16)
        self._colors = np.zeros((*self._values.shape, 3), dtype=np.uint16)
        self._table = np.zeros(0, dtype=np.int64)
        self._passes = 0
        self._grow(_FIRST_BLOCKS)

    def integrate(
        self,
        depth: NDArray[np.float32],
        color: NDArray[np.uint8],
        depth_intrinsics: Intrinsics,
        color_intrinsics: Intrinsics,
        pose: NDArray[np.float64],
        max_depth_m: float,
    ) -> None:
        """Take a frame in.

        depth: [m] along the camera's axis, shape (h, w); 0, not finite or above `max_depth_m` is no reading.
        color: shape (h2, w2, 3), seen from the same place. pose: OpenCV camera to volume, 4x4 [m], rigid.
        """
        kernels = _compiled()
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        to_camera = np.linalg.inv(np.asarray(pose, dtype=np.float64))
        lenses = np.array([depth_intrinsics, color_intrinsics], dtype=np.float64)
        block_m, max_depth_m = SIDE * self.voxel_m, float(max_depth_m)
        stride = int(np.clip(0.5 * block_m * min(depth_intrinsics[:2]) / max_depth_m, 1, _WIDEST_STRIDE))
        full = True
        while full:
            self._passes += 1
            self.blocks, touched, full = kernels["_touch"](
                depth, lenses[0], np.ascontiguousarray(pose, dtype=np.float64), block_m, self.truncation_m, max_depth_m, stride,
                self._table, self._places, self._seen, self.blocks, self._passes,
            )  # fmt: skip
            if full:
                self._grow(2 * len(self._places))
        kernels["_blend"](
            depth, np.ascontiguousarray(color, dtype=np.uint8), lenses, to_camera, self.voxel_m, self.truncation_m, max_depth_m,
            touched, self._places, self._values, self._weights, self._colors,
        )  # fmt: skip

    def surface(self, min_weight: float, min_piece_faces: int = 0) -> Surface:
        """The zero level [m] between voxels that more than `min_weight` frames saw, normals toward the cameras, without
        connected pieces of fewer than `min_piece_faces` faces."""
        n = self.blocks
        places = self._places[:n]
        weights = self._weights[:n]
        vertices, faces, colors = level_surface(
            self._values[:n], weights > min_weight, self._colors[:n], places * SIDE, following_blocks(places)
        )
        painted = np.clip(np.round(colors / _COLOR_STEPS), 0, 255).astype(np.uint8)
        return without_small_pieces(Surface(vertices * self.voxel_m, faces, painted), min_piece_faces)

    def _grow(self, blocks: int) -> None:
        """Room for more blocks, and a table twice as long that names them."""

        def longer(old: NDArray[Any]) -> NDArray[Any]:
            new = np.zeros((blocks, *old.shape[1:]), dtype=old.dtype)
            new[: len(old)] = old
            return new

        self._places, self._seen, self._values, self._weights, self._colors = (
            longer(a) for a in (self._places, self._seen, self._values, self._weights, self._colors)
        )
        self._table = np.full(4 * blocks, -1, dtype=np.int64)
        _compiled()["_enter"](self._table, self._places, self.blocks)


def without_small_pieces(surface: Surface, faces: int) -> Surface:
    """A surface without connected pieces of fewer than so many faces, and without vertices that no face uses."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(surface.vertices)
    edges = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, piece = connected_components(graph, directed=False)
    of_face = piece[surface.faces[:, 0]]
    keep = np.bincount(of_face, minlength=piece.max(initial=0) + 1)[of_face] >= faces
    kept = surface.faces[keep]
    used = np.zeros(n, dtype=bool)
    used[kept] = True
    return Surface(surface.vertices[used], (np.cumsum(used) - 1)[kept], surface.colors[used])


def following_blocks(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """The block at +x (bit 0), +y (bit 1), +z (bit 2) and their sums of each block, -1 for none, shape (n, 8)."""
    weights = np.array([(2 * FAR_BLOCKS) ** 2, 2 * FAR_BLOCKS, 1], dtype=np.int64)
    keys = (places + FAR_BLOCKS) @ weights
    order = np.argsort(keys)
    following = np.empty((len(places), 8), dtype=np.int64)
    for c in range(8):
        wanted = keys + np.array([c & 1, c >> 1 & 1, c >> 2]) @ weights
        at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
        following[:, c] = np.where(keys[order[at]] == wanted, order[at], -1)
    return following


@cache
def _compiled() -> Kernels:
    return compile_kernels(_slot, _enter, _touch, _blend)


def _slot(table: Any, places: Any, x: int, y: int, z: int) -> int:
    """Where a block is, or would be, in the table."""
    mixed = (x * 73856093) ^ (y * 19349669) ^ (z * 83492791)
    at = (mixed ^ (mixed >> 15)) & (len(table) - 1)
    while table[at] >= 0:
        b = table[at]
        if places[b, 0] == x and places[b, 1] == y and places[b, 2] == z:
            break
        at = (at + 1) & (len(table) - 1)
    return at


def _enter(table: Any, places: Any, blocks: int) -> None:
    """Enter blocks into an empty table."""
    for b in range(blocks):
        table[_slot(table, places, places[b, 0], places[b, 1], places[b, 2])] = b


def _touch(
    depth: Any, lens: Any, pose: Any, block: float, truncation: float, max_depth: float, stride: int,
    table: Any, places: Any, seen: Any, blocks: int, mark: int,
) -> Any:  # fmt: skip
    """Blocks that lie around readings; makes those that are missing. Stops when there is no room for another.

    mark: A number that no call before had. Returns the count of blocks, those around readings, and whether it stopped.
    """
    height, width = depth.shape
    steps = int(np.ceil(4 * truncation / block))  # half a block or less each
    touched = np.empty(len(places), np.int64)
    count = 0
    for v in range(0, height, stride):
        for u in range(0, width, stride):
            d = np.float64(depth[v, u])
            if not (d > 0.0 and d <= max_depth):
                continue
            x, y = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
            for s in range(steps + 1):
                t = max(d + truncation * (2.0 * s / steps - 1.0), 0.0)
                i = np.floor((t * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]) + pose[0, 3]) / block)
                j = np.floor((t * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]) + pose[1, 3]) / block)
                k = np.floor((t * (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]) + pose[2, 3]) / block)
                if not (abs(i) < 1048575.0 and abs(j) < 1048575.0 and abs(k) < 1048575.0):
                    continue
                at = _slot(table, places, int(i), int(j), int(k))
                b = table[at]
                if b < 0:
                    if blocks == len(places):
                        return blocks, touched[:0], True
                    b = blocks
                    blocks += 1
                    table[at] = b
                    places[b, 0], places[b, 1], places[b, 2] = int(i), int(j), int(k)
                if seen[b] != mark:
                    seen[b] = mark
                    touched[count] = b
                    count += 1
    return blocks, touched[:count], False


def _blend(
    depth: Any, color: Any, lenses: Any, to_camera: Any, voxel: float, truncation: float, max_depth: float,
    touched: Any, places: Any, values: Any, weights: Any, colors: Any,
) -> None:  # fmt: skip
    """Take a frame's readings into the voxels of the blocks that it touches."""
    height, width = depth.shape
    tall, wide = color.shape[:2]
    fx, fy, cx, cy = lenses[0]
    gx, gy, hx, hy = lenses[1]
    for b in touched:
        for i in range(8):
            x = (places[b, 0] * 8 + i) * voxel
            for j in range(8):
                y = (places[b, 1] * 8 + j) * voxel
                p = to_camera[0, 0] * x + to_camera[0, 1] * y + to_camera[0, 3]
                q = to_camera[1, 0] * x + to_camera[1, 1] * y + to_camera[1, 3]
                r = to_camera[2, 0] * x + to_camera[2, 1] * y + to_camera[2, 3]
                for k in range(8):
                    z = (places[b, 2] * 8 + k) * voxel
                    ahead = r + to_camera[2, 2] * z
                    if ahead <= 1e-6:
                        continue
                    a, c = (p + to_camera[0, 2] * z) / ahead, (q + to_camera[1, 2] * z) / ahead
                    u, v = fx * a + cx + 0.5, fy * c + cy + 0.5  # cut to whole numbers, this is the pixel whose center is nearest
                    if not (u >= 0.0 and u < width and v >= 0.0 and v < height):
                        continue
                    d = np.float64(depth[int(v), int(u)])
                    off = d - ahead
                    if not (d > 0.0 and d <= max_depth and off >= -truncation):
                        continue
                    w = np.float64(weights[b, i, j, k])
                    share = 1.0 / (w + 1.0)
                    old = np.float64(values[b, i, j, k])
                    values[b, i, j, k] = old + (min(off / truncation, 1.0) - old) * share
                    if w < 65535.0:
                        weights[b, i, j, k] = int(w) + 1
                    u, v = gx * a + hx + 0.5, gy * c + hy + 0.5
                    if u >= 0.0 and u < wide and v >= 0.0 and v < tall:
                        for s in range(3):
                            before = np.float64(colors[b, i, j, k, s])
                            colors[b, i, j, k, s] = int(before + (256.0 * color[int(v), int(u), s] - before) * share + 0.5)
