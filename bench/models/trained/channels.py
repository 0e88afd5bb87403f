"""What the network sees of a frame: heights over boards, surfaces and colors, pixel by pixel, the same from wherever a support is seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.lifting import DepthView, depth_noise
from tasks.capture.small_objects.supports import BELOW_M, SupportSlab
from tasks.kernels import compile_kernels

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Images = NDArray[np.float32]

CHANNELS = 17
"""Height at four scales, normal (3), depth's second differences (2), bends (2), measured, above a board, color (3), size of a pixel."""

GAP_M, GAP_PIXELS = 0.012, 4.0
"""Neighbors that are no farther from each other are of one surface [m], or so many sizes of a pixel."""

_BEND_PX = 2
_LEAST_EYE_M = 0.03
_COLOR_SHIFT = 12.0
_FAR_M = 0.6


@dataclasses.dataclass(frozen=True)
class BoardHeights:
    """Of the pixels of a frame over the board that is theirs, shape (h, w) [m]; of others over the nearest one. above: Pixels in a slab."""

    height: Images
    above: Bools


def board_heights(view: DepthView, slabs: Sequence[SupportSlab], planes: Sequence[Array | None]) -> BoardHeights:
    """Heights over boards. planes: Of the boards in their slabs' frames as the frame shows them, z = a x + b y + c, shapes (3,)."""
    world, measured = view.points(), view.depth > 0
    height, above = np.zeros(view.depth.shape, dtype=np.float32), np.zeros(view.depth.shape, dtype=bool)
    nearest = np.full(view.depth.shape, np.inf)
    for slab, fitted in zip(slabs, planes, strict=True):
        plane, local = np.zeros(3) if fitted is None else fitted, slab.local(world)
        own = local[..., 2] - local[..., :2] @ plane[:2] - plane[2]
        if slab.local(view.pose[:3, 3])[2] >= _LEAST_EYE_M:
            held = measured & ~above & ((local >= slab.low) & (local <= slab.high)).all(axis=-1)
            height[held] = own[held]
            above |= held
        nearer = ~above & (np.abs(own) < nearest)
        height[nearer], nearest[nearer] = np.clip(own[nearer], -_FAR_M, _FAR_M), np.abs(own[nearer])
    return BoardHeights(height, above)


def level_heights(points: Array, boards: Array, half: Array, measured: Bools) -> BoardHeights:
    """The same where boards are levels: points in the support's frame [m], shape (h, w, 3); boards, half: As `TrainingFrame`."""
    reach = half + 0.05
    over = measured & (np.abs(points[..., :2]) <= reach).all(axis=-1)
    height, above = np.zeros(measured.shape, dtype=np.float32), np.zeros(measured.shape, dtype=bool)
    nearest = np.full(measured.shape, np.inf)
    for level, clear in boards:
        own = points[..., 2] - level
        held = over & ~above & (own >= -BELOW_M) & (own <= clear)
        height[held] = own[held]
        above |= held
        nearer = ~above & (np.abs(own) < nearest)
        height[nearer], nearest[nearer] = np.clip(own[nearer], -_FAR_M, _FAR_M), np.abs(own[nearer])
    return BoardHeights(height, above)


def channels(
    depth: NDArray[np.float32], color: NDArray[np.uint8], intrinsics: tuple[float, float, float, float], pose: Array, boards: BoardHeights
) -> Images:
    """What the network sees, shape (`CHANNELS`, h, w). depth: [m], shape (h, w). color: RGB, shape (h, w, 3). pose: See `DepthView`."""
    made = np.zeros((CHANNELS, *depth.shape), dtype=np.float32)
    noise = depth_noise(depth).astype(np.float32)
    turn = (upright(pose).T @ pose[:3, :3]).astype(np.float32)
    surfaces = compile_kernels(_surfaces)[_surfaces.__name__]
    surfaces(np.ascontiguousarray(depth, dtype=np.float32), turn, *intrinsics, boards.height, boards.above, noise, made)
    logs = np.log(color.astype(np.float32) + np.float32(_COLOR_SHIFT))
    tints = (logs.mean(axis=-1), 2 * (logs[..., 0] - logs[..., 1]), 2 * (logs[..., 2] - logs[..., 1]))
    where = boards.above & (depth > 0)
    for place, tint in enumerate(tints):  # light and exposure differ from frame to frame
        made[CHANNELS - 4 + place] = tint - np.median(tint[where] if where.any() else tint)
    return made


def upright(pose: Array) -> Array:
    """Axes of a camera that looks level, in the world: to its right, ahead, up; as columns, 3x4 less the origin."""
    ahead = pose[:3, 2] if np.hypot(*pose[:2, 2]) > 1e-3 else -pose[:3, 1]
    ahead = np.array([ahead[0], ahead[1], 0.0]) / np.hypot(ahead[0], ahead[1])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([np.cross(ahead, up), ahead, up], axis=1)


def mirrored(pose: Array) -> Array:
    """The pose from which a mirrored frame would have been seen, the mirror being upright and holding the viewing direction."""
    axes, across = upright(pose), np.diag([-1.0, 1.0, 1.0])
    made = pose.copy()
    made[:3, :3] = axes @ across @ axes.T @ pose[:3, :3] @ across
    return made


def _surfaces(
    depth: Images, turn: Images, fx: float, fy: float, cx: float, cy: float, height: Images, above: Bools, noise: Images, made: Images
) -> None:  # fmt: skip
    """Channels of geometry, in place."""
    rows, columns = depth.shape
    points, other = np.empty((rows, columns, 3), np.float32), np.empty((rows, columns, 3), np.float32)
    for r in range(rows):
        for c in range(columns):
            d = depth[r, c]
            x, y = np.float32((c - cx) / fx) * d, np.float32((r - cy) / fy) * d
            for k in range(3):
                points[r, c, k] = turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * d
    toward = points.copy()
    step = np.zeros((2, rows, columns), np.bool_)  # to the next row, to the next column: of one surface
    for r in range(rows):
        for c in range(columns):
            limit = max(np.float32(GAP_M), np.float32(GAP_PIXELS * depth[r, c] / fx))
            for axis in range(2):
                row, column = r + 1 - axis, c + axis
                if depth[r, c] > 0 and row < rows and column < columns and depth[row, column] > 0:
                    square = np.float32(0)
                    for k in range(3):
                        square += (points[r, c, k] - points[row, column, k]) ** 2
                    step[axis, r, c] = square <= limit * limit
    for _ in range(2):  # noise is smaller in the mean of neighbors
        for r in range(rows):
            for c in range(columns):
                count = np.float32(1)
                x, y, z = points[r, c, 0], points[r, c, 1], points[r, c, 2]
                for row, column, same in (
                    (r + 1, c, step[0, r, c]), (r - 1, c, r > 0 and step[0, r - 1, c]),
                    (r, c + 1, step[1, r, c]), (r, c - 1, c > 0 and step[1, r, c - 1]),
                ):  # fmt: skip
                    if same:
                        count += 1
                        x, y, z = x + points[row, column, 0], y + points[row, column, 1], z + points[row, column, 2]
                other[r, c, 0], other[r, c, 1], other[r, c, 2] = x / count, y / count, z / count
        points, other = other, points
    for r in range(rows):
        for c in range(columns):
            d = depth[r, c]
            if d <= 0:
                continue
            pixel, over = d / fx, height[r, c]
            made[0, r, c], made[1, r, c] = np.tanh(over / 0.015), np.tanh(over / 0.06)
            made[2, r, c], made[3, r, c] = 2 * min(max(over, -0.6), 0.8), np.tanh(over / (4 * noise[r, c]))
            inside_rows, inside_columns = 0 < r < rows - 1, 0 < c < columns - 1
            if inside_rows and inside_columns and step[0, r, c] and step[0, r - 1, c] and step[1, r, c] and step[1, r, c - 1]:
                ax, ay, az = (
                    points[r + 1, c, 0] - points[r - 1, c, 0], points[r + 1, c, 1] - points[r - 1, c, 1],
                    points[r + 1, c, 2] - points[r - 1, c, 2],
                )  # fmt: skip
                bx, by, bz = (
                    points[r, c + 1, 0] - points[r, c - 1, 0], points[r, c + 1, 1] - points[r, c - 1, 1],
                    points[r, c + 1, 2] - points[r, c - 1, 2],
                )  # fmt: skip
                nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                length = max(np.sqrt(nx * nx + ny * ny + nz * nz), np.float32(1e-12))
                if nx * toward[r, c, 0] + ny * toward[r, c, 1] + nz * toward[r, c, 2] > 0:
                    length = -length
                made[4, r, c], made[5, r, c], made[6, r, c] = nx / length, ny / length, nz / length
            if inside_rows and depth[r - 1, c] > 0 and depth[r + 1, c] > 0:
                made[7, r, c] = np.tanh((depth[r + 1, c] + depth[r - 1, c] - 2 * d) / (6 * pixel))
            if inside_columns and depth[r, c - 1] > 0 and depth[r, c + 1] > 0:
                made[8, r, c] = np.tanh((depth[r, c + 1] + depth[r, c - 1] - 2 * d) / (6 * pixel))
            made[11, r, c], made[12, r, c] = 1, above[r, c]
            made[16, r, c] = np.log(max(pixel, 1e-4) / 0.003)
    for axis in range(2):
        for r in range(rows):
            for c in range(columns):
                down, right = _BEND_PX * (1 - axis), _BEND_PX * axis
                if r < down or c < right or r + down >= rows or c + right >= columns:
                    continue
                bend, square, sure = np.float32(0), np.float32(0), np.float32(0)
                for k in range(3):
                    along = points[r + down, c + right, k] - points[r - down, c - right, k]
                    first, second = made[4 + k, r - down, c - right], made[4 + k, r + down, c + right]
                    bend, square, sure = bend + (second - first) * along, square + along * along, sure + abs(first) * abs(second)
                if sure > 0 and square > 0 and square < (3 * GAP_M) ** 2 + (GAP_PIXELS * _BEND_PX * 2 * depth[r, c] / fx) ** 2:
                    made[9 + axis, r, c] = np.tanh(bend / np.sqrt(square) / 0.4)
