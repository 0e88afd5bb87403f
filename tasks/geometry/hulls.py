"""Convex hulls as physics engines take them: closed, and with few enough vertices and faces to be cooked as they are.

PhysX merges triangles that lie in one plane and counts what remains: on the GPU a hull has at most 64 vertices, 64 convex
polygons, 32 corners a polygon and 32 polygons at a vertex, and one with more comes out smaller. Polygons are what is counted
here, too: a cylinder of 24 sides has 92 triangles and 26 polygons, and would lose a third of its sides to a limit of 64 triangles.
Coplanar is judged a hundred times closer than PhysX does, so it never counts more than are counted here.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.triangles import enclosed_volume, face_planes
from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

COPLANAR = 8e-6
"""Neighboring triangles are one polygon when each lies in the plane of the other up to this share of the hull's diagonal."""


@dataclasses.dataclass(frozen=True)
class Hull:
    """A convex piece. vertices: [m], shape (n, 3). faces: outward triangles, shape (m, 3). The holder states the frame."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    def transformed(self, pose: ArrayLike, scale: ArrayLike = (1.0, 1.0, 1.0)) -> Hull:
        """The hull scaled along its own axes by positive factors, shape (3,), then moved by a rigid 4x4 pose."""
        m = np.asarray(pose, dtype=np.float64)
        return Hull((self.vertices * np.asarray(scale)) @ m[:3, :3].T + m[:3, 3], self.faces)

    @property
    def volume(self) -> float:
        """Volume [m3]."""
        return enclosed_volume(self.vertices, self.faces)


class Complexity(NamedTuple):
    """What engines count of a hull. corners: of the polygon with most; meeting: polygons at the vertex with most."""

    vertices: int
    polygons: int
    corners: int
    meeting: int

    def within(self, limits: Complexity) -> bool:
        """Whether no figure is above its limit."""
        return all(count <= most for count, most in zip(self, limits, strict=True))


LIMITS = Complexity(64, 64, 31, 31)
"""What PhysX takes on the GPU; older versions take 31 corners a polygon, newer ones 32."""


_SCALED = (COPLANAR / 8.0, 8.0 * COPLANAR)
"""Reduced hulls keep the limits by both measures: at another scale, what nearly lies in one plane does so, or no longer. Below the
first, coordinates of six decimals and of single precision make triangles of flat sides."""


REDUCED = Complexity(62, 58, 29, 29)
"""What hulls are reduced to: scaled, rounded to single precision and built again, they have some polygons more or less."""


def hull_of(points: Array) -> Hull:
    """Convex hull of points, shape (n, 3) [m], with outward triangles; the same points give the same hull.

    Raises:
        scipy.spatial.QhullError: they are fewer than four, or lie in a plane.
    """
    return _hull_and_planes(points)[0]


def _hull_and_planes(points: Array) -> tuple[Hull, Array]:
    """The hull of points, and the planes of its triangles: normals outwards and offsets [m], shape (m, 4)."""
    from scipy.spatial import ConvexHull

    convex = ConvexHull(points, qhull_options="QJ Pp" if len(points) < 5 else "Qt Pp")
    used = np.sort(convex.vertices)
    vertices = np.ascontiguousarray(points[used], dtype=np.float64)
    planes = np.ascontiguousarray(convex.equations)
    index = np.full(len(points), -1, dtype=np.int64)
    index[used] = np.arange(len(used))
    faces = index[convex.simplices]
    if _compiled()["_face_outwards"](vertices, faces, planes):
        corners = vertices[faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        faces = _wound_alike(faces, int(areas.argmax()))
    return Hull(vertices, faces), planes


def _wound_alike(faces: NDArray[np.int64], first: int) -> NDArray[np.int64]:
    """Faces of a closed surface turned as one of them is: a triangle without area does not tell its outside by itself."""
    beside: dict[frozenset[int], list[int]] = {}
    turned = [tuple(face) for face in faces.tolist()]
    for index, (a, b, c) in enumerate(turned):
        for edge in ((a, b), (b, c), (c, a)):
            beside.setdefault(frozenset(edge), []).append(index)
    done, waiting = {first}, [first]
    while waiting:
        a, b, c = turned[waiting.pop()]
        for start, end in ((a, b), (b, c), (c, a)):
            for index in beside[frozenset((start, end))]:
                if index in done:
                    continue
                d, e, f = turned[index]
                if (start, end) in ((d, e), (e, f), (f, d)):
                    turned[index] = (f, e, d)
                done.add(index)
                waiting.append(index)
    return np.array(turned, dtype=np.int64)


def with_body(points: Array, thickness: float) -> Array:
    """The points, doubled along directions in which they are flatter than a tenth of the thickness [m]."""
    for _ in range(3):
        centered = points - points.mean(axis=0)
        _, axes = np.linalg.eigh(centered.T @ centered)
        extents = np.ptp(centered @ axes, axis=0)
        thin = int(np.argmin(extents))
        if extents[thin] >= 0.1 * thickness:
            break
        offset = 0.5 * thickness * axes[:, thin]
        points = np.unique(np.concatenate([points - offset, points + offset]), axis=0)
    return points


def complexity(hull: Hull, coplanar: float = COPLANAR) -> Complexity:
    """Vertices, convex polygons once coplanar triangles are one, most corners of a polygon, most polygons at a vertex.

    coplanar: Share of the hull's diagonal, up to which triangles lie in one plane; see `COPLANAR`.
    """
    tolerance = coplanar * float(np.linalg.norm(np.ptp(hull.vertices, axis=0)))
    vertices, faces = np.ascontiguousarray(hull.vertices, dtype=np.float64), np.ascontiguousarray(hull.faces, dtype=np.int64)
    return Complexity(len(hull.vertices), *map(int, _compiled()["_counted"](vertices, faces, tolerance)))


def is_within(hull: Hull, limits: Complexity = LIMITS) -> bool:
    """Whether engines take a hull as it is."""
    return are_few(len(hull.vertices), limits) or complexity(hull).within(limits)


def stays_within(hull: Hull, limits: Complexity) -> bool:
    """Whether engines take a hull as it is at other scales along its axes, too."""
    return are_few(len(hull.vertices), limits) or all(complexity(hull, measure).within(limits) for measure in _SCALED)


def are_few(count: int, limits: Complexity = LIMITS) -> bool:
    """Whether the hull of so many points, n, keeps all limits however they lie: it has no more than 2 n - 4 faces."""
    return count <= min(limits.vertices, limits.polygons // 2 + 2, limits.corners, limits.meeting)


@cache
def _compiled() -> Kernels:
    return compile_kernels(_cross, _face_outwards, _reach, _root, _counted)


def _cross(vertices: Any, face: Any) -> tuple[float, float, float]:
    """Normal of a triangle, as long as twice its area."""
    a, b, c = face[0], face[1], face[2]
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _face_outwards(vertices: Any, faces: Any, planes: Any) -> bool:
    """Turn the triangles of a hull by the outward normals of their planes; whether some still disagree with a neighbor."""
    edges = np.empty(3 * len(faces), dtype=np.int64)
    for f in range(len(faces)):
        x, y, z = _cross(vertices, faces[f])
        if x * planes[f, 0] + y * planes[f, 1] + z * planes[f, 2] < 0:
            faces[f, 0], faces[f, 2] = faces[f, 2], faces[f, 0]
        for k in range(3):
            edges[3 * f + k] = faces[f, k] * len(vertices) + faces[f, (k + 1) % 3]
    edges.sort()
    return bool((edges[1:] == edges[:-1]).any())


def _reach(normal: Any, vertices: Any, foot: int, face: Any) -> float:
    """How far the corners of a triangle lie off the plane through a vertex [m]."""
    most = 0.0
    for k in range(3):
        away = 0.0
        for d in range(3):
            away += normal[d] * (vertices[face[k], d] - vertices[foot, d])
        most = max(most, abs(away))
    return most


def _root(parent: Any, item: int) -> int:
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


def _counted(vertices: Any, faces: Any, tolerance: float) -> tuple[int, int, int]:
    """Polygons of a closed hull, most corners of one, most that meet at a vertex. Triangles are one polygon when each lies in the plane of
    the other up to `tolerance` [m]; one without area is part of either neighbor."""
    count, size = len(faces), len(vertices)
    normals, lengths = np.empty((count, 3)), np.empty(count)
    edges = np.empty(3 * count, dtype=np.int64)
    for f in range(count):
        x, y, z = _cross(vertices, faces[f])
        lengths[f] = np.sqrt(x * x + y * y + z * z)
        least = max(lengths[f], 1e-300)
        normals[f, 0], normals[f, 1], normals[f, 2] = x / least, y / least, z / least
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            edges[k * count + f] = min(a, b) * size + max(a, b)
    parent = np.arange(count)
    order = np.argsort(edges, kind="mergesort")
    for k in range(0, len(order) - 1, 2):  # closed: every edge has two triangles
        f, g = order[k] % count, order[k + 1] % count
        if (
            min(lengths[f], lengths[g]) <= tolerance * tolerance
            or max(_reach(normals[f], vertices, faces[f, 0], faces[g]), _reach(normals[g], vertices, faces[g, 0], faces[f])) <= tolerance
        ):
            parent[_root(parent, f)] = _root(parent, g)
    polygons, corners = 0, np.empty(3 * count, dtype=np.int64)
    for f in range(count):
        polygon = _root(parent, f)
        polygons += polygon == f
        for k in range(3):
            corners[3 * f + k] = polygon * size + faces[f, k]
    corners.sort()
    of_polygon, at_vertex = np.zeros(count, dtype=np.int64), np.zeros(size, dtype=np.int64)
    for k in range(len(corners)):
        if k == 0 or corners[k] != corners[k - 1]:
            of_polygon[corners[k] // size] += 1
            at_vertex[corners[k] % size] += 1
    return polygons, of_polygon.max(), at_vertex.max()


def reduced(hull: Hull, limits: Complexity = REDUCED) -> Hull:
    """A hull inside another one, of vertices of it, within limits; itself where it is within them already.

    Vertices are added where the rest reaches out farthest. The outermost ones along every axis come first, so that the box stays
    the same and what rests on a side of it still does.
    """
    if stays_within(hull, limits):
        return hull
    from scipy.spatial import ConvexHull

    cloud = hull.vertices
    chosen, left, refused = _solid(cloud, _outermost(cloud)), np.ones(len(cloud), dtype=bool), 0
    left[chosen] = False
    made: Hull | None = None
    planes = np.zeros((0, 4))
    while left.any() and refused < _REFUSALS and len(chosen) < limits.vertices:
        if not len(planes):
            planes = ConvexHull(cloud[chosen], qhull_options="QJ Pp" if len(chosen) < 5 else "Qt Pp").equations
        beyond = np.where(left, (cloud @ planes[:, :3].T + planes[:, 3]).max(axis=1), -np.inf)
        if beyond.max() <= 1e-9:
            break
        farthest = int(beyond.argmax())
        left[farthest] = False
        grown, its_planes = _hull_and_planes(cloud[sorted([*chosen, farthest])])
        if are_few(len(chosen) + 1, limits) or stays_within(grown, limits):
            chosen.append(farthest)
            made, planes = grown, its_planes
        else:
            refused += 1
    return made if made is not None else hull_of(cloud[sorted(chosen)])


_REFUSALS = 2
"""Vertices that would make too many faces, one after another, until no other is tried."""


def _solid(cloud: Array, chosen: list[int]) -> list[int]:
    """The chosen vertices, and those farthest from their plane on either side where they lie in one."""
    centered = cloud[chosen] - cloud[chosen].mean(axis=0)
    _, spread, axes = np.linalg.svd(centered)
    if spread[-1] > 1e-9 * spread[0]:
        return chosen
    heights = (cloud - cloud[chosen].mean(axis=0)) @ axes[-1]
    return list(dict.fromkeys([*chosen, int(heights.argmax()), int(heights.argmin())]))


def _outermost(cloud: Array) -> list[int]:
    """Indices of vertices on the six sides of the box: on each side those that reach farthest along the two other axes."""
    chosen: dict[int, None] = {}
    slack = 1e-9 + 1e-7 * np.ptp(cloud, axis=0)
    for axis in (2, 0, 1):
        for sign in (-1, 1):
            heights = sign * cloud[:, axis]
            side = np.flatnonzero(heights >= heights.max() - slack[axis])
            across = [i for i in range(3) if i != axis]
            for along in across:
                for end in (-1, 1):
                    chosen[int(side[np.lexsort((cloud[side, across[0]], cloud[side, across[1]], -end * cloud[side, along]))[0]])] = None
    return list(chosen)


def balanced(hull: Hull, whole: Hull) -> Hull:
    """A reduced hull grown until it reaches out of the whole one a little farther than that reaches out of it, inside the same box.

    A collider that is too small shows at every silhouette, one that is too large by as much hardly does. Itself where that gains nothing:
    a grown hull that breaks limits loses vertices.
    """
    low, high = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    grow = 1 + 1.25 * deviation(hull, whole.vertices) / np.maximum(high - low, 1e-9)
    middle = 0.5 * (low + high)
    # The sides of the box stay in it: whatever rests on one, or stands on it, does so as before.
    grown = reduced(hull_of(np.clip(middle + (hull.vertices - middle) * grow, low, high)))
    return grown if deviation(grown, whole.vertices) < deviation(hull, whole.vertices) else hull


def deviation(hull: Hull, points: Array) -> float:
    """How far points reach out of a hull at most [m]: distance to the plane of a face, at least 0."""
    normals, offsets = face_planes(hull.vertices, hull.faces, 1e-18)
    return max(0.0, float((points @ normals.T - offsets).max()))
