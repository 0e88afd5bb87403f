"""Convex hulls as physics engines take them: closed, and with few enough vertices and faces to be cooked as they are.

PhysX merges triangles that lie in one plane and counts what remains: on the GPU a hull has at most 64 vertices, 64 convex
polygons, 32 corners a polygon and 32 polygons at a vertex, and one with more comes out smaller. Polygons are what is counted
here, too: a cylinder of 24 sides has 92 triangles and 26 polygons, and would lose a third of its sides to a limit of 64 triangles.
Coplanar is judged a hundred times closer than PhysX does, so it never counts more than are counted here.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.triangles import enclosed_volume, face_planes

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
    """Convex hull with outward triangles; the same points give the same hull."""
    from scipy.spatial import ConvexHull

    convex = ConvexHull(points, qhull_options="QJ Pp" if len(points) < 5 else "Qt Pp")
    used = np.sort(convex.vertices)
    index = np.full(len(points), -1, dtype=np.int64)
    index[used] = np.arange(len(used))
    faces = index[convex.simplices.astype(np.int64)]
    vertices = np.ascontiguousarray(points[used])
    corners = vertices[faces]
    inward = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), convex.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    if len(np.unique(edges @ [len(vertices), 1])) < len(edges):
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        faces = _wound_alike(faces, int(areas.argmax()))
    return Hull(vertices, faces)


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
    polygon = _polygon_of(hull, coplanar)
    count = int(polygon.max()) + 1
    corners = np.unique(np.column_stack([np.repeat(polygon, 3), hull.faces.ravel()]), axis=0)
    most = [int(np.bincount(corners[:, column]).max()) for column in (0, 1)]
    return Complexity(len(hull.vertices), count, most[0], most[1])


def is_within(hull: Hull, limits: Complexity = LIMITS) -> bool:
    """Whether engines take a hull as it is."""
    return are_few(len(hull.vertices), limits) or complexity(hull).within(limits)


def stays_within(hull: Hull, limits: Complexity) -> bool:
    """Whether engines take a hull as it is at other scales along its axes, too."""
    return are_few(len(hull.vertices), limits) or all(complexity(hull, measure).within(limits) for measure in _SCALED)


def are_few(count: int, limits: Complexity = LIMITS) -> bool:
    """Whether the hull of so many points, n, keeps all limits however they lie: it has no more than 2 n - 4 faces."""
    return count <= min(limits.vertices, limits.polygons // 2 + 2, limits.corners, limits.meeting)


def _polygon_of(hull: Hull, coplanar: float) -> NDArray[np.int64]:
    """The polygon that each triangle of a hull belongs to, shape (m,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(hull.faces)
    edges = np.sort(np.concatenate([hull.faces[:, [0, 1]], hull.faces[:, [1, 2]], hull.faces[:, [2, 0]]]), axis=1)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    first, second = order[::2] % count, order[1::2] % count  # closed: every edge has two triangles
    corners = hull.vertices[hull.faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(crosses, axis=1)
    normals = crosses / np.maximum(lengths, 1e-300)[:, None]
    tolerance = coplanar * float(np.linalg.norm(np.ptp(hull.vertices, axis=0)))

    def off(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        return np.asarray(np.abs(np.einsum("nd,nkd->nk", normals[a], corners[b] - corners[a][:, :1])).max(axis=1))

    flat = np.minimum(lengths[first], lengths[second]) <= tolerance**2  # a triangle without area is part of either neighbor
    together = flat | (np.maximum(off(first, second), off(second, first)) <= tolerance)
    graph = coo_array((np.ones(together.sum()), (first[together], second[together])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


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
    while left.any() and refused < _REFUSALS and len(chosen) < limits.vertices:
        planes = ConvexHull(cloud[chosen], qhull_options="QJ Pp" if len(chosen) < 5 else "Qt Pp").equations
        beyond = np.where(left, (cloud @ planes[:, :3].T + planes[:, 3]).max(axis=1), -np.inf)
        if beyond.max() <= 1e-9:
            break
        farthest = int(beyond.argmax())
        left[farthest] = False
        if are_few(len(chosen) + 1, limits) or stays_within(_of(cloud, [*chosen, farthest]), limits):
            chosen.append(farthest)
        else:
            refused += 1
    return _of(cloud, chosen)


_REFUSALS = 2
"""Vertices that would make too many faces, one after another, until no other is tried."""


def _of(cloud: Array, chosen: list[int]) -> Hull:
    return hull_of(cloud[sorted(chosen)])


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
