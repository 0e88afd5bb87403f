"""Bodies of cloth: closed meshes between two grids of points, with colors by point, and convex pieces that cover them.

Models are in the canonical frame: +Z up, front +X, origin at the bottom center of the box [m].
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.drafting import Extents, FurnitureModel
from tasks.furniture.palette import COVERS, FABRICS, LINENS, Color, pick, shade
from tasks.furniture.solids import Solid, hull
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import transform_points

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

CLOTH_M = 0.012
"""Thickness of a blanket or curtain: thinner cloth has no inside at the scanner's resolution."""


@dataclasses.dataclass(frozen=True)
class SizedModel:
    """A model and the extents of its box [m]."""

    model: FurnitureModel
    extents: Extents


def closed_between(front: Array, back: Array, block: int) -> Solid:
    """Closed body between two grids of points, each of shape (n, m, 3) [m], with outward faces.

    The normal of the front grid, first axis times second, points away from the back grid. block: cells along either side of a convex
    piece; hulls of blocks cover the body, the more closely the smaller they are.
    """
    n, m = front.shape[:2]
    vertices = np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3)])
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    outer = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    inner = outer[:, ::-1] + n * m
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    after = np.roll(rim, -1)
    sides = np.concatenate([np.column_stack([rim, rim + n * m, after]), np.column_stack([after, rim + n * m, after + n * m])])
    pieces = []
    for i in range(0, n - 1, block):
        for j in range(0, m - 1, block):
            ends = slice(i, min(i + block, n - 1) + 1), slice(j, min(j + block, m - 1) + 1)
            pieces.append(hull(np.concatenate([front[ends].reshape(-1, 3), back[ends].reshape(-1, 3)])))
    return Solid(vertices, np.concatenate([outer, inner, sides]), tuple(pieces))


def part_of(name: str, solid: Solid, colors: NDArray[np.uint8]) -> trimesh.Trimesh:
    """A part of a model; colors per vertex, shape (n, 3)."""
    import trimesh

    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    rgba = np.column_stack([colors, np.full(len(colors), 255)]).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=rgba)
    mesh.metadata["name"] = name
    return mesh


def assembled(name: str, category: str, parts: list[trimesh.Trimesh], hulls: list[Hull]) -> SizedModel:
    """A model of parts and convex pieces in one frame, moved so that its origin is the bottom center of its box."""
    points = np.concatenate([np.asarray(part.vertices) for part in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    move = np.eye(4)
    move[:3, 3] = -0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -low[2]
    for part in parts:
        part.vertices = transform_points(np.asarray(part.vertices), move)
    x, y, z = (float(v) for v in high - low)
    return SizedModel(FurnitureModel(name, category, parts, [piece.transformed(move) for piece in hulls]), (x, y, z))


def heap(rng: np.random.Generator, length: float, width: float, tall: float) -> SizedModel:
    """Towels and clothes thrown on a heap: a bumpy surface over the floor, in patches of several cloths; sides in [m]."""
    xs, ys = np.linspace(-0.5 * length, 0.5 * length, 45), np.linspace(-0.5 * width, 0.5 * width, 39)
    x, y = np.meshgrid(xs, ys, indexing="ij")
    heights = np.zeros_like(x)
    centers = rng.uniform(-0.36, 0.36, (14, 2)) * [length, width]
    for (cx, cy), spread, rise in zip(centers, rng.uniform(0.1, 0.24, 14), rng.uniform(0.35, 1.0, 14), strict=True):
        heights = np.maximum(heights, rise * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * spread**2)))
    # Folds run along a few directions; they fade where the heap is low.
    for _ in range(6):
        way, phase, wave = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi), rng.uniform(0.12, 0.3)
        heights += 0.09 * heights * np.sin(2 * np.pi * (x * np.cos(way) + y * np.sin(way)) / wave + phase)
    heights = 0.015 + (tall - 0.015) * heights / heights.max()
    cloths = [pick(LINENS + FABRICS + COVERS, rng) for _ in centers]
    nearest = np.argmin(((np.stack([x, y], axis=-1)[:, :, None] - centers) ** 2).sum(axis=-1), axis=-1)
    stripes = 0.86 + 0.14 * (np.sin(2 * np.pi * (x + 0.4 * y) / 0.09) > 0)
    colors = np.clip(np.array(cloths)[nearest] * stripes[..., None], 0, 255).reshape(-1, 3)
    top = np.stack([x, y, heights], axis=-1)
    solid = closed_between(top, np.stack([x, y, np.zeros_like(x)], axis=-1), 4)
    return assembled(
        "heap of cloth", "clothes", [part_of("cloth", solid, np.concatenate([colors, colors]).astype(np.uint8))], list(solid.pieces)
    )


def curtain(rng: np.random.Generator, width: float, tall: float) -> SizedModel:
    """A pleated curtain with a printed pattern of stripes, checks, dots or waves; sides in [m]."""
    count, rows = max(24, round(width / 0.02)), max(20, round(tall / 0.025))
    y, z = np.meshgrid(np.linspace(-0.5 * width, 0.5 * width, count), np.linspace(0.0, tall, rows), indexing="ij")
    pleat, phase = float(rng.uniform(0.14, 0.2)), float(rng.uniform(0, 2 * np.pi))
    swing = float(rng.uniform(0.035, 0.055)) * (1.0 - 0.25 * z / tall)
    x = swing * np.sin(2 * np.pi * y / pleat + phase + 0.3 * np.sin(2 * np.pi * z / tall))
    colors = printed(rng, y, z)
    front, back = np.stack([x + 0.5 * CLOTH_M, y, z], axis=-1), np.stack([x - 0.5 * CLOTH_M, y, z], axis=-1)
    solid = closed_between(front, back, 3)
    return assembled("patterned curtain", "curtain", [part_of("cloth", solid, np.concatenate([colors, colors]))], list(solid.pieces))


def printed(rng: np.random.Generator, u: Array, v: Array) -> NDArray[np.uint8]:
    """Colors of a print on cloth with two or three colors at coordinates u and v [m]; shape (points, 3)."""
    ground, first, second = (np.array(pick(palette, rng)) for palette in (LINENS, COVERS, FABRICS))
    step = float(rng.uniform(0.14, 0.24))
    kind = int(rng.integers(4))
    a, b = np.floor(u / step).astype(int), np.floor(v / step).astype(int)
    if kind == 0:
        marks = a % 3
    elif kind == 1:
        marks = (a + b) % 2 + (b % 4 == 0)
    elif kind == 2:
        across, up = u / step - a - 0.5, v / step - b - 0.5
        marks = np.where(np.hypot(across, up) < 0.32, 1 + (a + b) % 2, 0)
    else:
        marks = np.floor((v + 0.06 * np.sin(2 * np.pi * u / (2 * step))) / (0.6 * step)).astype(int) % 3
    return np.array([ground, first, second])[marks].reshape(-1, 3).astype(np.uint8)


def throw(rng: np.random.Generator, path: Array, width: float, at: float) -> tuple[trimesh.Trimesh, list[Hull]]:
    """A blanket that lies along a path of points (x, z) [m], shape (n, 2), `width` wide about y = `at` [m]: its part and pieces."""
    line = np.column_stack([path[:, 0], np.full(len(path), at), path[:, 1]])
    solid = _strip(rng, line, width)
    color: Color = pick(COVERS + LINENS, rng)
    bands = (np.floor(solid.vertices[:, 1] / 0.08) % 2).astype(int)
    colors = np.array([color, shade(color, 0.7)])[bands].astype(np.uint8)
    return part_of("throw", solid, colors), list(solid.pieces)


def _strip(rng: np.random.Generator, line: Array, width: float) -> Solid:
    """Cloth along a line of points, shape (n, 3), with waves across it."""
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]
    along = np.linspace(0.0, lengths[-1], max(6, round(lengths[-1] / 0.05)))
    middle = np.column_stack([np.interp(along, lengths, line[:, k]) for k in range(3)])
    ahead = np.gradient(middle, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    across = np.array([0.0, 1.0, 0.0])
    out = np.cross(across, ahead)
    ys = np.linspace(-0.5 * width, 0.5 * width, 14)
    ripple = 0.012 * (1 + np.sin(ys[None] / 0.05 + rng.uniform(0, 6) + 2.0 * along[:, None]))
    back = middle[:, None] + ys[None, :, None] * across
    front = back + (CLOTH_M + ripple)[..., None] * out[:, None]
    return closed_between(front.swapaxes(0, 1), back.swapaxes(0, 1), 2)
