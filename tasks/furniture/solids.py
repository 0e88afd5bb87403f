"""Closed solids that know their own convex pieces: boxes, cushions, frusta, turned bodies, vessels, sweeps.

Everything is a loft: a stack of rings with equally many points, closed by a fan at either end. Coordinates in metres,
+Z up. A solid's pieces are convex and closed, and cover it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.pieces import Hull
from tasks.geometry.triangles import crosses
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]
Span = tuple[float, float]

_MERGE_M = 1e-9
"""Points of a loft nearer than this are one: rings that collapse to a point or a rectangle."""


@dataclasses.dataclass(frozen=True)
class Solid:
    """A closed mesh and the convex pieces that cover it. vertices: [m], shape (n, 3). faces: shape (m, 3)."""

    vertices: Array
    faces: NDArray[np.int64]
    pieces: tuple[Hull, ...]

    def moved(self, matrix: ArrayLike) -> Solid:
        """The solid through an affine 4x4 matrix without mirroring."""
        m = np.asarray(matrix, dtype=np.float64)
        return Solid(self.vertices @ m[:3, :3].T + m[:3, 3], self.faces, tuple(piece.transformed(m) for piece in self.pieces))

    def at(self, x: float, y: float, z: float) -> Solid:
        """The solid moved by (x, y, z) [m]."""
        matrix = np.eye(4)
        matrix[:3, 3] = x, y, z
        return self.moved(matrix)

    def turned(self, axis: str, angle: float) -> Solid:
        """The solid turned about the `x`, `y` or `z` axis through the origin by `angle` [rad]."""
        return self.moved(rotation(axis, angle))


def rotation(axis: str, angle: float) -> Array:
    """4x4 rotation about a coordinate axis, `x`, `y` or `z`, by `angle` [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def hull(points: ArrayLike) -> Hull:
    """Convex hull of points [m], shape (n, 3), that do not lie in one plane."""
    from scipy.spatial import ConvexHull

    cloud = np.asarray(points, dtype=np.float64)
    convex = ConvexHull(cloud)
    faces = convex.simplices.astype(np.int64)
    a, b, c = (cloud[faces[:, i]] for i in range(3))
    inward = np.einsum("nd,nd->n", crosses(b - a, c - a), convex.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    used = np.zeros(len(cloud), dtype=bool)
    used[faces] = True
    return Hull(cloud[used], (np.cumsum(used) - 1)[faces])


def loft(rings: ArrayLike) -> Hull:
    """Closed mesh through rings, shape (k, m, 3), each counter-clockwise seen from the next one. Convex if they are."""
    return Hull(*_compiled()["_lofted"](np.ascontiguousarray(rings, dtype=np.float64), _MERGE_M))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_is_after, _ascending, _lofted)


def _is_after(keys: NDArray[np.int64], a: int, b: int) -> bool:
    """Whether a row lies after another one in ascending order; of equal ones the later one does."""
    for d in range(keys.shape[1]):
        if keys[a, d] != keys[b, d]:
            return bool(keys[a, d] > keys[b, d])
    return a > b


def _ascending(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows in ascending order, by merging ever longer runs."""
    n, width = len(keys), 1
    order, merged = np.arange(n), np.arange(n)
    while width < n:
        for start in range(0, n, 2 * width):
            left, right, middle, end = start, start + width, min(start + width, n), min(start + 2 * width, n)
            for at in range(start, end):
                if left < middle and (right >= end or not _is_after(keys, order[left], order[right])):
                    merged[at] = order[left]
                    left += 1
                else:
                    merged[at] = order[right]
                    right += 1
        order, merged, width = merged, order, 2 * width
    return order


def _lofted(rings: Array, merge: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and faces of a loft; faces that are lines once near points are one are left out."""
    count, size = rings.shape[:2]
    n, points = count * size, rings.reshape(-1, 3)
    keys = np.empty((n, 3), dtype=np.int64)
    for i in range(n):
        for d in range(3):
            keys[i, d] = np.int64(np.rint(points[i, d] / merge))
    order, place, places = _ascending(keys), np.empty(n, dtype=np.int64), 0
    vertices = np.empty((n, 3))
    for m in range(n):
        i, j = order[m], order[m - 1]
        if m == 0 or keys[i, 0] != keys[j, 0] or keys[i, 1] != keys[j, 1] or keys[i, 2] != keys[j, 2]:
            vertices[places] = points[i]
            places += 1
        place[i] = places - 1
    sides, fan = (count - 1) * size, size - 2
    faces, kept = np.empty((2 * sides + 2 * fan, 3), dtype=np.int64), 0
    for f in range(len(faces)):
        if f < 2 * sides:
            ring, at = f % sides // size * size, f % size
            after = (at + 1) % size
            a, b, c = ring + at, ring + after, ring + size + after
            if f >= sides:
                b, c = c, ring + size + at
        elif f < 2 * sides + fan:
            m = f - 2 * sides
            a, b, c = m + 2, m + 1, 0
        else:
            m = f - 2 * sides - fan
            a, b, c = sides, sides + m + 1, sides + m + 2
        a, b, c = place[a], place[b], place[c]
        if a != b and b != c and c != a:
            faces[kept, 0], faces[kept, 1], faces[kept, 2] = a, b, c
            kept += 1
    return vertices[:places].copy(), faces[:kept].copy()


def convex(rings: ArrayLike) -> Solid:
    """Solid through rings, shape (k, m, 3), whose loft is convex."""
    body = loft(rings)
    return Solid(body.vertices, body.faces, (body,))


def box(x: Span, y: Span, z: Span) -> Solid:
    """Box from its spans along the axes [m]."""
    return wedge((x, y), (x, y), z)


def wedge(bottom: tuple[Span, Span], top: tuple[Span, Span], z: Span) -> Solid:
    """Box whose bottom and top are rectangles (x span, y span) of their own: tapered, slanted, or both."""
    return convex([_rectangle(bottom, z[0]), _rectangle(top, z[1])])


def slab(corners: ArrayLike, z: Span) -> Solid:
    """Upright prism over a convex counter-clockwise polygon, shape (n, 2) [m]."""
    plan = np.asarray(corners, dtype=np.float64)
    return convex([np.column_stack([plan, np.full(len(plan), height)]) for height in z])


def cushion(x: Span, y: Span, z: Span, radius: float, steps: int = 3) -> Solid:
    """Box with edges rounded by `radius` [m], at most half of the shortest side."""
    low, high = (np.array([span[i] for span in (x, y, z)]) for i in (0, 1))
    r = min(radius, 0.499 * float((high - low).min()))
    core, center = 0.5 * (high - low) - r, 0.5 * (high + low)
    angle = np.concatenate([q * np.pi / 2 + np.linspace(0, np.pi / 2, steps + 1) for q in range(4)])
    sign = np.repeat([[1, 1], [-1, 1], [-1, -1], [1, -1]], steps + 1, axis=0)
    rings = []
    for half, lifts in ((-1, np.linspace(-np.pi / 2, 0, steps + 1)), (1, np.linspace(0, np.pi / 2, steps + 1))):
        for lift in lifts:
            around = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.cos(lift) * r
            height = half * core[2] + r * np.sin(lift)
            rings.append(np.column_stack([sign * core[:2] + around, np.full(len(angle), height)]) + center)
    return convex(rings)


def ellipsoid(center: ArrayLike, radii: ArrayLike, around: int = 12, up: int = 6) -> Solid:
    """Ellipsoid about `center`, shape (3,), with `radii`, shape (3,) [m]."""
    lift = np.linspace(-np.pi / 2, np.pi / 2, up + 1)
    section = circle(around)
    rings = [np.column_stack([section * np.cos(t), np.full(around, np.sin(t))]) for t in lift]
    return convex(np.array(rings) * np.asarray(radii, dtype=np.float64) + np.asarray(center, dtype=np.float64))


def circle(count: int = 24) -> Array:
    """Unit circle in plan, shape (count, 2), counter-clockwise; it touches all four sides when count divides by four."""
    angle = np.arange(count) * (2 * np.pi / count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rounded_square(rounding: float = 0.25, steps: int = 3) -> Array:
    """Square from -1 to 1 in plan with corners rounded by `rounding`, shape (4 (steps + 1), 2), counter-clockwise."""
    angle = np.concatenate([q * np.pi / 2 + np.linspace(0, np.pi / 2, steps + 1) for q in range(4)])
    sign = np.repeat([[1, 1], [-1, 1], [-1, -1], [1, -1]], steps + 1, axis=0)
    return (1 - rounding) * sign + rounding * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def square() -> Array:
    """Square from -1 to 1 in plan, shape (4, 2), counter-clockwise."""
    return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64)


def turned_body(profile: Sequence[tuple[float, float]], section: Array | None = None, stretch: float = 1.0) -> Solid:
    """Full body with one section at every height: `profile` of (radius, z) from bottom to top [m].

    `section`: unit outline in plan, shape (m, 2), a circle by default; `stretch`: y radius over x radius. One convex
    piece per convex stretch of the profile.
    """
    outline = circle() if section is None else section
    rings = _rings(profile, outline, stretch)
    body = loft(rings)
    pieces = []
    for first, last in _convex_runs(profile):
        pieces.append(loft(rings[first : last + 1]))
    return Solid(body.vertices, body.faces, tuple(pieces))


def cylinder(radius: float, z: Span, count: int = 16) -> Solid:
    """Upright cylinder about the z axis [m]."""
    return turned_body([(radius, z[0]), (radius, z[1])], circle(count))


def vessel(
    profile: Sequence[tuple[float, float]], wall: float, floor: float, section: Array | None = None, stretch: float = 1.0, sectors: int = 12
) -> Solid:
    """Open hollow body: outer `profile` of (radius, z) from bottom to top, `wall` and `floor` thick [m].

    `section`, `stretch`: as in `turned_body`. Pieces: the floor, and `sectors` parts of the wall per band.
    """
    outline = circle() if section is None else section
    points = list(profile)
    low, top = points[0][1], points[-1][1]
    level = low + min(floor, 0.5 * (top - low))
    radius = float(np.interp(level, [z for _, z in points], [r for r, _ in points]))
    above = [(radius, level)] + [p for p in points if p[1] > level + 1e-9]
    below = [p for p in points if p[1] < level - 1e-9] + [(radius, level)]
    outer = _rings(above, outline, stretch)
    inner = _inner_rings(above, outline, stretch, wall)
    foot = _rings(below, outline, stretch)
    body = loft(np.concatenate([foot[:-1], outer, inner[::-1]]))
    pieces = [loft(foot[first : last + 1]) for first, last in _convex_runs(below)]
    pieces += _wall_pieces(outer, inner, sectors)
    return Solid(body.vertices, body.faces, tuple(pieces))


def band(
    profile: Sequence[tuple[float, float]], wall: float, section: Array | None = None, stretch: float = 1.0, sectors: int = 12
) -> Solid:
    """Hollow body without a floor: outer `profile` of (radius, z) from bottom to top, `wall` thick [m]; else as `vessel`."""
    outline = circle() if section is None else section
    outer, inner = _rings(profile, outline, stretch), _inner_rings(profile, outline, stretch, wall)
    loop = np.concatenate([outer, inner[::-1]])
    count, size = loop.shape[:2]
    here = np.arange(count)[:, None] * size + np.arange(size)
    up = (np.arange(count)[:, None] + 1) % count * size + np.arange(size)
    faces = np.concatenate([np.stack([here, np.roll(here, -1, 1), np.roll(up, -1, 1)], -1), np.stack([here, np.roll(up, -1, 1), up], -1)])
    return Solid(loop.reshape(-1, 3), faces.reshape(-1, 3), tuple(_wall_pieces(outer, inner, sectors)))


def _wall_pieces(outer: Array, inner: Array, sectors: int) -> list[Hull]:
    """Hulls of sectors of a wall between rings, shape (k, m, 3) each, band by band."""
    size, pieces = outer.shape[1], []
    for low in range(len(outer) - 1):
        if outer[low + 1, 0, 2] <= outer[low, 0, 2]:  # a step at one height has no volume of its own
            continue
        for group in np.array_split(np.arange(size), min(sectors, size)):
            columns = np.append(group, (group[-1] + 1) % size)
            pieces.append(hull(np.concatenate([rings[i][columns] for rings in (outer, inner) for i in (low, low + 1)])))
    return pieces


def sweep(path: ArrayLike, width: ArrayLike, height: ArrayLike, count: int = 8, run: int = 1, up: ArrayLike = (0, 0, 1)) -> Solid:
    """Bar along a path, shape (n, 3), with an elliptic (`count` > 4) or rectangular (`count` = 4) section [m].

    `width`, `height`: full section sides, one number or one per point, across and along `up`. One convex piece per
    `run` stretches of the path.
    """
    line = np.asarray(path, dtype=np.float64)
    n = len(line)
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    side = crosses(np.broadcast_to(np.asarray(up, dtype=np.float64), ahead.shape), ahead)
    side /= np.linalg.norm(side, axis=1)[:, None]
    over = crosses(ahead, side)
    section = square() if count == 4 else circle(count)
    w, h = (np.broadcast_to(np.asarray(v, dtype=np.float64), (n,)) for v in (width, height))
    rings = line[:, None] + 0.5 * (
        section[None, :, :1] * (side * w[:, None])[:, None] + section[None, :, 1:] * (over * h[:, None])[:, None]
    )
    body = loft(rings)
    pieces = tuple(hull(rings[i : min(i + run, n - 1) + 1].reshape(-1, 3)) for i in range(0, n - 1, run))
    return Solid(body.vertices, body.faces, pieces)


def bar(start: ArrayLike, end: ArrayLike, width: float, height: float | None = None, count: int = 4) -> Solid:
    """Straight bar between two points, shape (3,) [m], with a rectangular (`count` = 4) or elliptic section."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    upright = abs(b[2] - a[2]) > 0.9 * np.linalg.norm(b - a)
    return sweep([a, b], width, width if height is None else height, count, up=(1.0, 0.0, 0.0) if upright else (0.0, 0.0, 1.0))


def _rectangle(spans: tuple[Span, Span], z: float) -> Array:
    (x0, x1), (y0, y1) = spans
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def _rings(profile: Sequence[tuple[float, float]], outline: Array, stretch: float) -> Array:
    return np.array([np.column_stack([outline * [r, r * stretch], np.full(len(outline), z)]) for r, z in profile])


def _inner_rings(profile: Sequence[tuple[float, float]], outline: Array, stretch: float, wall: float) -> Array:
    rings = []
    for r, z in profile:
        inside = [max(r - wall, 0.3 * r), max(r * stretch - wall, 0.3 * r * stretch)]
        rings.append(np.column_stack([outline * inside, np.full(len(outline), z)]))
    return np.array(rings)


def _convex_runs(profile: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """First and last index of the longest stretches of a profile whose slope only turns inward."""
    runs, first = [], 0
    for i in range(1, len(profile) - 1):
        (r0, z0), (r1, z1), (r2, z2) = profile[i - 1 : i + 2]
        if (r1 - r0) * (z2 - z1) < (r2 - r1) * (z1 - z0) - 1e-12:
            runs.append((first, i))
            first = i
    return [*runs, (first, len(profile) - 1)]
