"""Level surfaces of values on a grid by marching cubes (Lorensen and Cline, SIGGRAPH 1987), compiled.

The grid comes in bricks of one shape: the blocks of a sparse volume, or one brick for a dense one. The table of cases is
worked out here, not listed: on every side of a cube, the crossings are joined so that corners inside stay apart, which
is the same seen from both of a side's cubes; the segments chain into loops and the loops are cut into triangles. The
surface is therefore closed wherever the grid goes on, and every edge has two faces (Nielson and Hamann, "The
asymptotic decider", Visualization 1991, says what goes wrong otherwise).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Integers = NDArray[np.int64]

LEAST_SHARE = 1e-3
"""A vertex keeps this share of an edge away from the edge's ends, so that no two vertices coincide and no face is a line."""

# Corner c of a cell is at offset (c & 1, c >> 1 & 1, c >> 2 & 1). Edge 4 a + k runs along axis a.


@cache
def _edges() -> NDArray[np.int64]:
    """The lower and upper corner of a cell's twelve edges, shape (12, 2)."""
    return np.array([[c, c | 1 << a] for a in range(3) for c in range(8) if not c >> a & 1], dtype=np.int64)


@cache
def _cases() -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """Triangles of the 256 cases as edges of the cell, shape (256, t, 3), and how many there are, shape (256,).

    Bit c of a case: corner c is inside (below the level). Normals point outside.
    """
    triangles = [[t for loop in _loops(case) for t in _cut(loop)] for case in range(256)]
    count = np.array([len(t) for t in triangles], dtype=np.int64)
    table = np.full((256, count.max(), 3), -1, dtype=np.int8)
    for case, corners in enumerate(triangles):
        table[case, : len(corners)] = np.array(corners, dtype=np.int8).reshape(-1, 3)
    return table, count


def _side_corners(side: int) -> list[int]:
    """The corners of side 2 a + (0 low, 1 high) of a cell, counterclockwise as seen from outside."""
    axis, high = divmod(side, 2)
    u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
    base = (1 << axis) if high else 0
    ring = [base, base | u, base | u | v, base | v]
    return ring if high else ring[::-1]


def _loops(case: int) -> Iterator[list[int]]:
    """Closed chains of crossed edges around the surface's pieces in a cell."""
    number = {frozenset(pair): index for index, pair in enumerate(_edges().tolist())}
    onward: dict[int, int] = {}
    for side in range(6):
        ring = _side_corners(side)
        inside = [bool(case >> c & 1) for c in ring]
        # Around a run of inside corners, from the edge where the walk enters it to the edge where it leaves:
        # two opposite corners inside are two runs, so they are cut off one by one.
        for k in range(4):
            if inside[k] and not inside[k - 1]:
                last = k
                while inside[(last + 1) % 4]:
                    last += 1
                enters, leaves = {ring[k - 1], ring[k]}, {ring[last % 4], ring[(last + 1) % 4]}
                onward[number[frozenset(enters)]] = number[frozenset(leaves)]
    while onward:
        first = min(onward)
        loop = [first]
        while (following := onward.pop(loop[-1])) != first:
            loop.append(following)
        yield loop


def _cut(loop: list[int]) -> list[tuple[int, int, int]]:
    """A loop as triangles whose inner edges run through the cell, not along a side, where another cell's could lie."""
    best = min(_cuts(loop), key=lambda cut: sum(_on_one_side(a, b) for a, b in cut[1]))
    return best[0]


def _cuts(loop: list[int]) -> Iterator[tuple[list[tuple[int, int, int]], list[tuple[int, int]]]]:
    """Every way to cut a loop into triangles, with the inner edges."""
    if len(loop) == 3:
        yield [(loop[0], loop[1], loop[2])], []
        return
    for k in range(1, len(loop) - 1):  # the triangle at the edge from last to first
        sides = [loop[: k + 1], loop[k:]]
        inner = [(part[0], part[-1]) for part in sides if len(part) > 2]
        for left, left_inner in _cuts(sides[0]) if len(sides[0]) > 2 else [([], [])]:
            for right, right_inner in _cuts(sides[1]) if len(sides[1]) > 2 else [([], [])]:
                yield [*left, (loop[0], loop[k], loop[-1]), *right], [*left_inner, *inner, *right_inner]


def _on_one_side(a: int, b: int) -> bool:
    """Whether two edges of a cell lie on a common side."""
    corners = {int(c) for c in _edges()[[a, b]].ravel()}
    return any(corners <= set(_side_corners(side)) for side in range(6))


def level_surface(
    values: NDArray[np.float32], known: NDArray[np.bool_], colors: NDArray[Any], places: Integers, following: Integers
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float32]]:
    """The zero level of values on the nodes of bricks, where all eight nodes of a cell are known.

    values, known: shape (bricks, nx, ny, nz). colors: any k channels of numbers to interpolate, shape (bricks, nx, ny, nz, k).
    places: The first node of each brick on the whole grid, shape (bricks, 3).
    following: The brick at +x (bit 0), +y (bit 1), +z (bit 2) and their sums of each brick, -1 for none, shape (bricks, 8).

    Returns:
        Vertices in steps of the grid, shape (n, 3); faces, shape (m, 3), normals toward positive values; channels at the
        vertices, shape (n, k). Vertices come in the order of bricks and nodes; some may have no face.
    """
    table, count = _cases()
    bricks = len(values)
    rank = np.zeros(values.shape, dtype=np.int32)
    crossed = np.zeros(values.shape, dtype=np.uint8)
    case = np.zeros(values.shape, dtype=np.uint8)
    base = np.zeros(bricks + 1, dtype=np.int64)
    kernels = _compiled()
    triangles = kernels["_survey"](values, known, following, rank, crossed, case, base, count)
    vertices, shades = np.empty((base[-1], 3)), np.empty((base[-1], colors.shape[-1]), dtype=np.float32)
    kernels["_place"](values, colors, places, following, rank, crossed, base, vertices, shades)
    faces = np.empty((triangles, 3), dtype=np.int64)
    kernels["_connect"](following, rank, crossed, case, base, table, count, _edges(), faces)
    return vertices, faces, shades


def dense_surface(values: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The zero level of values on a dense grid, shape (nx, ny, nz): vertices in steps (n, 3), faces (m, 3), normals toward
    positive values. It is closed when the outermost nodes are positive."""
    brick = np.ascontiguousarray(values, dtype=np.float32)[None]
    alone = np.array([[0, -1, -1, -1, -1, -1, -1, -1]], dtype=np.int64)
    no_color = np.zeros((*brick.shape, 0), dtype=np.uint16)  # as the volume's: nothing more to compile
    vertices, faces, _ = level_surface(brick, np.ones(brick.shape, dtype=bool), no_color, np.zeros((1, 3), dtype=np.int64), alone)
    return vertices, faces


@cache
def _compiled() -> Kernels:
    return compile_kernels(_node, _survey, _place, _connect)


def _node(following: Integers, b: int, i: int, j: int, k: int, nx: int, ny: int, nz: int) -> Any:
    """Brick and place in it of a node that may lie one step beyond a brick; brick -1 where there is none."""
    beyond = 0
    if i == nx:
        beyond, i = beyond | 1, 0
    if j == ny:
        beyond, j = beyond | 2, 0
    if k == nz:
        beyond, k = beyond | 4, 0
    return (following[b, beyond] if beyond else b), i, j, k


def _survey(values: Any, known: Any, following: Any, rank: Any, crossed: Any, case: Any, base: Any, count: Any) -> int:
    """Which edges are crossed and how each cell is cut. Fills `rank`, `crossed`, `case` and `base`; counts triangles."""
    bricks, nx, ny, nz = values.shape
    triangles = 0
    for b in range(bricks):
        n = 0
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    rank[b, i, j, k] = n
                    if not known[b, i, j, k]:
                        continue
                    here = values[b, i, j, k] < 0
                    whole, cut = True, 1 if here else 0
                    for c in range(1, 8):
                        o, x, y, z = _node(following, b, i + (c & 1), j + (c >> 1 & 1), k + (c >> 2), nx, ny, nz)
                        if o < 0 or not known[o, x, y, z]:
                            whole = False
                            continue
                        if values[o, x, y, z] < 0:
                            cut |= 1 << c
                        if (c == 1 or c == 2 or c == 4) and (values[o, x, y, z] < 0) != here:
                            crossed[b, i, j, k] |= c
                            n += 1
                    if whole:
                        case[b, i, j, k] = cut
                        triangles += count[cut]
        base[b + 1] = base[b] + n
    return triangles


def _place(values: Any, colors: Any, places: Any, following: Any, rank: Any, crossed: Any, base: Any, vertices: Any, shades: Any) -> None:
    """Vertices and their channels where edges cross the level."""
    bricks, nx, ny, nz = values.shape
    for b in range(bricks):
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    at = base[b] + rank[b, i, j, k]
                    for a in range(3):
                        if not crossed[b, i, j, k] >> a & 1:
                            continue
                        o, x, y, z = _node(following, b, i + (a == 0), j + (a == 1), k + (a == 2), nx, ny, nz)
                        low, high = np.float64(values[b, i, j, k]), np.float64(values[o, x, y, z])
                        share = min(max(low / (low - high), LEAST_SHARE), 1 - LEAST_SHARE)
                        vertices[at, 0], vertices[at, 1], vertices[at, 2] = places[b, 0] + i, places[b, 1] + j, places[b, 2] + k
                        vertices[at, a] += share
                        for s in range(shades.shape[1]):
                            shades[at, s] = (1 - share) * colors[b, i, j, k, s] + share * colors[o, x, y, z, s]
                        at += 1


def _connect(following: Any, rank: Any, crossed: Any, case: Any, base: Any, table: Any, count: Any, edges: Any, faces: Any) -> None:
    """Triangles of all cells, in the order of bricks and nodes."""
    bricks, nx, ny, nz = case.shape
    at = 0
    for b in range(bricks):
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    cut = case[b, i, j, k]
                    for t in range(count[cut]):
                        for v in range(3):
                            edge = table[cut, t, v]
                            c, a = edges[edge, 0], edge // 4
                            o, x, y, z = _node(following, b, i + (c & 1), j + (c >> 1 & 1), k + (c >> 2), nx, ny, nz)
                            # an earlier axis of the same node has its vertex first
                            before = crossed[o, x, y, z] & ((1 << a) - 1)
                            faces[at, v] = base[o] + rank[o, x, y, z] + (before & 1) + (before >> 1)
                        at += 1
