"""Solids out of tetrahedra, for engines that deform them: a grid over convex pieces, its border drawn onto their surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.pieces import Hull
from tasks.geometry.triangles import face_planes

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

CELLS = 250
"""Most cells of the grid over a solid's box: 1,500 tetrahedra, which engines step in milliseconds on a CPU."""

COVERED = 0.8
"""Least share of the solid's volume that the tetrahedra hold, and its inverse the most: measured 0.85 to 1.02 on generated furniture."""

OUTSIDE_M = 0.005
"""Farthest that a corner may lie outside the solid [m]: engines keep objects as far apart; measured 0 to 7 mm,
but for one corner of a stuffed animal at 15 mm, in a cell that keeps the surface from touching itself."""

_SAMPLES = 4  # per axis of a cell, to tell whether most of it is solid
_LEAST = 0.1  # of a tetrahedron's volume that drawing its corners onto the surface leaves: flatter ones make engines stiff
_PASSES = 5  # of drawing the border: a pillow's farthest corner lies 14 mm outside after one, 4 mm after five
_ROUNDS = 24  # of halving what bends a tetrahedron too far


@dataclasses.dataclass(frozen=True)
class Tetrahedra:
    """A conforming mesh. vertices: [m], shape (n, 3). tetrahedra: positive volumes, shape (m, 4). surface: outward, (k, 3).

    Positive is a corner order in which `det(b - a, c - a, d - a) > 0`. The surface is closed and manifold.
    """

    vertices: Array
    tetrahedra: NDArray[np.int64]
    surface: NDArray[np.int64]

    @property
    def volumes(self) -> Array:
        """Volume of every tetrahedron [m3], shape (m,)."""
        return volumes_of(self.vertices, self.tetrahedra)


def volumes_of(vertices: Array, tetrahedra: NDArray[np.int64]) -> Array:
    """Signed volumes of tetrahedra [m3], shape (m,). Shapes (n, 3) and (m, 4)."""
    a, b, c, d = (vertices[tetrahedra[:, i]] for i in range(4))
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0)


def tetrahedralize(hulls: Sequence[Hull], cells: int = CELLS) -> Tetrahedra:
    """The union of convex pieces as at most `6 * cells` tetrahedra, in the pieces' frame [m].

    A grid of nearly cubic cells fills the box of the pieces; the fullest cells stay, with the gaps closed at which their
    surface would touch itself. Each is cut into six along one diagonal (Kuhn 1960), the same in all, so faces fit. Then
    the border's corners are drawn onto the pieces' surface as far as every tetrahedron keeps a tenth of its volume.
    Nothing lies outside the pieces' box; what is apart, like a pair of shoes, stays apart where the grid can tell.
    """
    points = np.concatenate([hull.vertices for hull in hulls])
    low, high = points.min(axis=0), points.max(axis=0)
    counts = cell_counts(high - low, cells)
    step = (high - low) / counts
    solid = manifold(_mostly_solid(hulls, low, step, counts))
    vertices, tetrahedra = _kuhn(solid, low, step)
    surface = surface_of(tetrahedra)
    vertices = _drawn(vertices, tetrahedra, np.unique(surface), hulls, low, high)
    return Tetrahedra(vertices, tetrahedra, surface)


def distance_to(hulls: Sequence[Hull], points: Array) -> tuple[Array, Array]:
    """How far points, shape (n, 3), lie outside the union of convex pieces [m], and the way out, shape (n, 3).

    Exact in sign everywhere and in value next to a face; near an edge the distance to the face's plane, which is less.
    """
    best = np.full(len(points), np.inf)
    way = np.zeros_like(points)
    for hull in hulls:
        normals, offsets = face_planes(hull.vertices, hull.faces)
        beyond = points @ normals.T - offsets
        face = beyond.argmax(axis=1)
        value = beyond[np.arange(len(points)), face]
        nearer = value < best
        best[nearer], way[nearer] = value[nearer], normals[face[nearer]]
    return best, way


def cell_counts(size: Array, cells: int) -> NDArray[np.int64]:
    """Cells along every axis: of nearly equal sides, two at least along each so that thin objects bend, `cells` at most in all."""
    wanted = np.maximum(size, 1e-6)
    side = (float(np.prod(wanted)) / cells) ** (1.0 / len(wanted))
    while True:
        counts = np.maximum(np.round(wanted / side), 2).astype(np.int64)
        if int(np.prod(counts)) <= cells:
            return counts
        side *= 1.02


def _mostly_solid(hulls: Sequence[Hull], low: Array, step: Array, counts: NDArray[np.int64]) -> Cells:
    """The fullest cells, as many as have the volume of the pieces together, shape of `counts`; one at least."""
    axes = [low[i] + step[i] * (np.arange(counts[i] * _SAMPLES) + 0.5) / _SAMPLES for i in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = (distance_to(hulls, grid)[0] <= 0.0).reshape(np.ravel(np.stack([counts, np.full(3, _SAMPLES)], axis=1)))
    share = inside.mean(axis=(1, 3, 5))
    wanted = max(round(float(share.sum())), 1)
    return np.asarray(share >= max(float(np.sort(share, axis=None)[-wanted]), min(1e-9, float(share.max()))))


def manifold(solid: Cells) -> Cells:
    """The cells with more of them filled, until the surface nowhere touches itself along an edge or in a corner.

    Around every edge of the grid, and around every corner, the filled cells must be connected through faces, and the empty
    ones too. Where they are not, all are filled; so it ends.
    """
    grid = np.pad(solid, 1)
    while True:
        before = int(grid.sum())
        for axis in range(3):
            _fill(grid, tuple(1 if i == axis else 2 for i in range(3)))
        _fill(grid, (2, 2, 2))
        grid[[0, -1]] = grid[:, [0, -1]] = grid[:, :, [0, -1]] = False
        if int(grid.sum()) == before:
            return np.asarray(grid[1:-1, 1:-1, 1:-1])


def _fill(grid: Cells, block: tuple[int, ...]) -> None:
    """Fill every block of cells in which filled or empty cells are not connected. The grid's border stays empty."""
    windows = np.lib.stride_tricks.sliding_window_view(grid, block)
    code = (windows.reshape(*windows.shape[:3], -1) @ (1 << np.arange(int(np.prod(block))))).astype(np.int64)
    table = np.array([_is_simple(number, block) for number in range(1 << int(np.prod(block)))])
    for corner in np.argwhere(~table[code]):
        where = tuple(slice(max(c, 1), min(c + b, n - 1)) for c, b, n in zip(corner, block, grid.shape, strict=True))
        grid[where] = True


def _is_simple(number: int, block: tuple[int, ...]) -> bool:
    """Whether the filled cells of a block are connected through faces, and the empty ones too."""
    cells = list(product(*(range(n) for n in block)))
    for wanted in (0, 1):
        left = {cell for i, cell in enumerate(cells) if (number >> i) & 1 == wanted}
        stack = [min(left)] if left else []
        left -= set(stack)
        while stack:
            here = stack.pop()
            near = {cell for cell in left if sum(abs(a - b) for a, b in zip(cell, here, strict=True)) == 1}
            left -= near
            stack += sorted(near)
        if left:
            return False
    return True


def _kuhn(solid: Cells, low: Array, step: Array) -> tuple[Array, NDArray[np.int64]]:
    """Corners of the filled cells [m], and six tetrahedra in each."""
    shape = np.array(solid.shape) + 1
    cells = np.argwhere(solid)
    corners = []
    for order in permutations(range(3)):
        path = [np.zeros(3, dtype=np.int64)]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=np.int64)[axis])
        if np.linalg.det(np.array(path[1:]) - path[0]) < 0:
            path[1], path[2] = path[2], path[1]
        corners.append(np.stack([np.ravel_multi_index((cells + corner).T, shape) for corner in path], axis=1))
    tetrahedra = np.stack(corners, axis=1).reshape(-1, 4)
    used, inverse = np.unique(tetrahedra, return_inverse=True)
    places = np.stack(np.unravel_index(used, shape), axis=1)
    return low + places * step, inverse.reshape(-1, 4).astype(np.int64)


def surface_of(tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    """Outward faces of positive tetrahedra that no other one shares, shape (k, 3)."""
    faces = tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(faces[np.sort(first[count == 1])])


def _drawn(
    vertices: Array, tetrahedra: NDArray[np.int64], border: NDArray[np.int64], hulls: Sequence[Hull], low: Array, high: Array
) -> Array:
    """Vertices with those of the border moved onto the pieces' surface, as far as no tetrahedron gets too flat.

    In passes: what could not move all the way may when its neighbors have. In between, vertices inside move to the middle
    of their neighbors, which makes room.
    """
    least = _LEAST * volumes_of(vertices, tetrahedra)
    pairs = np.concatenate([tetrahedra[:, [i, j]] for i in range(4) for j in range(4) if i != j])
    count = np.bincount(pairs[:, 0], minlength=len(vertices))
    inside = np.ones(len(vertices), dtype=bool)
    inside[border] = False
    for _ in range(_PASSES):
        target = vertices.copy()
        for _ in range(6):
            distance, way = distance_to(hulls, target[border])
            target[border] -= 0.8 * distance[:, None] * way
        vertices = _toward(vertices, np.clip(target, low, high), tetrahedra, least)
        total = np.stack([np.bincount(pairs[:, 0], weights=vertices[pairs[:, 1], k], minlength=len(vertices)) for k in range(3)], axis=1)
        vertices = _toward(vertices, np.where(inside[:, None], total / count[:, None], vertices), tetrahedra, least)
    return vertices


def _toward(vertices: Array, target: Array, tetrahedra: NDArray[np.int64], least: Array) -> Array:
    """Vertices moved as far toward a target as every tetrahedron keeps its least volume [m3]."""
    share = np.ones(len(vertices))
    for attempt in range(_ROUNDS):
        moved = vertices + share[:, None] * (target - vertices)
        flat = volumes_of(moved, tetrahedra) < least
        if not flat.any():
            return moved
        share[np.unique(tetrahedra[flat])] *= 0.5 if attempt < _ROUNDS // 2 else 0.0
    return vertices
