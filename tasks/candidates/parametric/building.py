"""Meshes of a fitted form: closed parts in the colors of the points near them, one exact convex piece per block."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.parametric.drawing import Block
from tasks.geometry.meshes import surface_of

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Color = tuple[int, int, int]

EDGE_M = 0.025
"""Radius of the edges of cushions."""

NEAR_M = 0.04
"""Points this near to a part tell its color."""

MIN_POINTS = 30
"""Fewer points tell no color: noise of the camera, and what stood before it."""


def built(
    blocks: Sequence[Block], points: Array, colors: NDArray[np.uint8], color: Color | None
) -> tuple[list[trimesh.Trimesh], list[trimesh.Trimesh]]:
    """Parts with vertex colors, and convex pieces.

    points, colors: of the instance in the frame of the blocks, at least one, shapes (n, 3) [m] and (n, 3). color: where too few are near
    a part; None for that of all points.
    """
    import trimesh

    from tasks.furniture.solids import box, cushion

    parts: list[trimesh.Trimesh] = []
    pieces: list[trimesh.Trimesh] = []
    for part in dict.fromkeys(block.part for block in blocks):
        own = [block for block in blocks if block.part == part]
        shade = np.array([*_part_color(own, points, colors, color), 255], dtype=np.uint8)
        meshes = []
        for block in own:
            sides = [high - low for low, high in (block.x, block.y, block.z)]
            radius = min(EDGE_M, 0.3 * min(sides))
            solid = cushion(block.x, block.y, block.z, radius) if block.is_soft else box(block.x, block.y, block.z)
            mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(shade, (len(solid.vertices), 1)))
            meshes.append(mesh)
            pieces += [trimesh.Trimesh(piece.vertices, piece.faces, process=False) for piece in solid.pieces]
        parts.append(surface_of(meshes).to_trimesh())
    return parts, pieces


def _part_color(blocks: Sequence[Block], points: Array, colors: NDArray[np.uint8], color: Color | None) -> Color:
    """The color in the middle of those of the points near a part."""
    near = np.zeros(len(points), dtype=bool)
    for block in blocks:
        (x0, x1), (y0, y1), (z0, z1) = block.x, block.y, block.z
        near |= ((points >= np.array([x0, y0, z0]) - NEAR_M) & (points <= np.array([x1, y1, z1]) + NEAR_M)).all(axis=1)
    if near.sum() < MIN_POINTS:
        if color is not None:
            return color
        near[:] = True
    r, g, b = np.median(colors[near], axis=0).round().astype(int).tolist()
    return r, g, b
