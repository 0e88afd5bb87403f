"""Convex pieces of an asset: the collision shape that every simulator reads the same way.

A decomposition left to the engine is not portable (engines inflate, merge or ignore it), so hulls are always explicit.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections import OrderedDict
from collections.abc import Callable, MutableMapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.mass import MassProperties, mass_properties
from tasks.proximity import closest_points
from tasks.settings import Config, Whole

if TYPE_CHECKING:
    import trimesh

Method = Literal["generator", "hulls", "coacd"]


@dataclasses.dataclass(frozen=True)
class PieceConfig(Config):
    """How a mesh becomes convex pieces."""

    convex_ratio: float = 0.9  # volume of mesh / hull; above it the dents are too small to hold anything
    convex_gap: float = 0.03  # of open meshes, which have no volume: farthest a hull's surface may lie from the mesh, in diagonals
    max_components: Whole = 32  # more hulls than this slow every engine down; then parts are decomposed together
    max_vertices: Whole = 64  # what PhysX accepts for a hull on the GPU
    faces: Whole = 3000  # decimated to this first: a chair in 3 s instead of 13 s, at 2 mm more protrusion
    threshold: float = 0.08  # concavity at which a piece counts as convex: 18 hulls for a chair, 23 mm p99 protrusion
    mcts_iterations: Whole = 60  # with 15 nodes: a third of the default's time, the same overlap within 1 %
    mcts_nodes: Whole = 15  # with 60 iterations, see there
    thickness_m: float = 0.004  # flat parts (a picture, a curtain) get this much body


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
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Convex pieces of one asset in its own frame, how they were made, and the mass properties of their union."""

    hulls: tuple[Hull, ...]
    method: Method
    properties: MassProperties


_memo: OrderedDict[tuple[str, bool, PieceConfig], Pieces] = OrderedDict()
_MEMO_SIZE = 512  # assets; a few hundred kB each at most


def asset_pieces(
    asset_id: str,
    parts: Callable[[], Sequence[trimesh.Trimesh]],
    known: Callable[[], Sequence[trimesh.Trimesh]] | None,
    config: PieceConfig,
    cache: MutableMapping[str, bytes] | None = None,
) -> Pieces:
    """Convex pieces of an unscaled asset, computed once per process for each asset, and once per `cache`.

    parts: gives what is seen. known: gives the pieces from construction; None when there are none. Both in the asset's
    frame [m], and called only when the pieces are not known yet. Pieces never reach outside the box of the parts, so an
    object that rests on what is seen of it rests on its pieces.
    """
    key = (asset_id, known is not None, config)
    if key not in _memo:
        _memo[key] = _cached(asset_id, parts, known, config, {} if cache is None else cache)
        while len(_memo) > _MEMO_SIZE:
            _memo.popitem(last=False)
    _memo.move_to_end(key)
    return _memo[key]


def _cached(
    asset_id: str, parts: Callable[[], Sequence[trimesh.Trimesh]], known: Callable[[], Sequence[trimesh.Trimesh]] | None,
    config: PieceConfig, cache: MutableMapping[str, bytes],
) -> Pieces:  # fmt: skip
    """Pieces out of the cache, put there when they are not; a library's models are decomposed once, not once per run."""
    key = hashlib.sha256(f"pieces {asset_id} {known is not None} {config!r}".encode()).hexdigest()
    if key not in cache:
        cache[key] = _packed(pieces(parts(), known() if known is not None else None, config))
    return _unpacked(cache[key])


def _packed(made: Pieces) -> bytes:
    """Pieces as bytes: the method, mass properties, counts of vertices and faces, then all vertices and all faces."""
    counts = np.array([[len(hull.vertices), len(hull.faces)] for hull in made.hulls], dtype="<i8")
    head = f"{made.method} {len(counts)}\n".encode()
    vertices = np.concatenate([hull.vertices for hull in made.hulls]).astype("<f8")
    faces = np.concatenate([hull.faces for hull in made.hulls]).astype("<i8")
    mass = np.concatenate([[made.properties.volume], made.properties.center, made.properties.inertia.ravel()]).astype("<f8")
    return head + mass.tobytes() + counts.tobytes() + vertices.tobytes() + faces.tobytes()


def _unpacked(data: bytes) -> Pieces:
    """Pieces from bytes of `_packed`."""
    head, body = data.split(b"\n", 1)
    method, count = head.decode().split()
    mass = np.frombuffer(body, dtype="<f8", count=13)
    body = body[mass.nbytes :]
    counts = np.frombuffer(body, dtype="<i8", count=2 * int(count)).reshape(-1, 2)
    stops = np.cumsum(counts, axis=0)
    vertices = np.frombuffer(body, dtype="<f8", offset=counts.nbytes, count=3 * int(stops[-1, 0])).reshape(-1, 3)
    faces = np.frombuffer(body, dtype="<i8", offset=counts.nbytes + vertices.nbytes).reshape(-1, 3)
    hulls = [Hull(v, f) for v, f in zip(np.split(vertices, stops[:-1, 0]), np.split(faces, stops[:-1, 1]), strict=True)]
    properties = MassProperties(float(mass[0]), mass[1:4].copy(), mass[4:].reshape(3, 3).copy())
    return Pieces(tuple(hulls), method, properties)  # type: ignore[arg-type]


def pieces(parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] | None, config: PieceConfig) -> Pieces:
    """`asset_pieces` without its memory."""
    hulls, method = _hulls(parts, known, config)
    return Pieces(hulls, method, mass_properties(hulls))


def _hulls(
    parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] | None, config: PieceConfig
) -> tuple[tuple[Hull, ...], Method]:
    """Convex pieces, and how they were made."""
    points = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    bounds = np.array([points.min(axis=0), points.max(axis=0)])
    if known:
        clouds = [np.asarray(piece.vertices, dtype=np.float64) for piece in known]
        return _boxed(clouds, bounds, config), "generator"
    surface = _merged(parts)
    if not len(surface.faces):  # smaller than what is told apart: a point or a line
        return _boxed([points], bounds, config), "hulls"
    components = _components(surface)
    dented = [c for c in components if not _is_convex(c, config)]
    if len(components) - len(dented) > config.max_components:
        return _boxed(_coacd(surface, config), bounds, config), "coacd"
    whole = {id(c) for c in dented}
    clouds = [np.asarray(c.vertices) for c in components if id(c) not in whole]
    if dented:  # together, so that the threshold is measured against the object, not against each of its parts
        clouds += _coacd(_merged(dented), config)
    return _boxed(clouds, bounds, config), "coacd" if dented else "hulls"


def convex_hull(points: NDArray[np.float64], config: PieceConfig) -> Hull:
    """Convex hull of points, shape (n, 3) [m], with at most `config.max_vertices` vertices; flat points get a body."""
    hull = _hull(_with_body(points, config))
    if len(hull.vertices) > config.max_vertices:
        reach = hull.vertices @ _directions(config.max_vertices).T
        hull = _hull(hull.vertices[np.unique(reach.argmax(axis=0))])
    return hull


def _boxed(clouds: Sequence[NDArray[np.float64]], bounds: NDArray[np.float64], config: PieceConfig) -> tuple[Hull, ...]:
    """Hulls of point clouds, kept inside a box where the box has room for a body; hulls inside others are dropped."""
    low, high = bounds.copy()
    for axis in range(2):
        if high[axis] - low[axis] < config.thickness_m:
            middle = 0.5 * (low[axis] + high[axis])
            low[axis], high[axis] = middle - 0.5 * config.thickness_m, middle + 0.5 * config.thickness_m
    high[2] = max(high[2], low[2] + config.thickness_m)  # upwards only: nothing may reach below what carries it
    hulls = []
    for cloud in clouds:
        hull = convex_hull(cloud, config)
        clipped = np.clip(hull.vertices, low, high)
        if not np.array_equal(clipped, hull.vertices):
            hull = _hull(_inside_body(clipped, low, high, config))
        hulls.append(hull)
    return tuple(_without_contained(hulls))


def _inside_body(
    points: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], config: PieceConfig
) -> NDArray[np.float64]:
    """Points that span a body inside a box: those that clipping pressed flat are drawn inwards from the box's face."""
    flat = np.flatnonzero(np.ptp(points, axis=0) < config.thickness_m * 0.5)
    for axis in flat:
        center = float(np.clip(points[:, axis].mean(), low[axis] + 0.5 * config.thickness_m, high[axis] - 0.5 * config.thickness_m))
        first, second = points.copy(), points.copy()
        first[:, axis], second[:, axis] = center - 0.5 * config.thickness_m, center + 0.5 * config.thickness_m
        points = np.clip(np.concatenate([first, second]), low, high)
    return _with_body(points, config)


def _with_body(points: NDArray[np.float64], config: PieceConfig) -> NDArray[np.float64]:
    """The points, doubled along directions in which they are flatter than a tenth of the thickness."""
    unique = np.unique(points, axis=0)
    for _ in range(3):
        centered = unique - unique.mean(axis=0)
        _, axes = np.linalg.eigh(centered.T @ centered)
        extents = np.ptp(centered @ axes, axis=0)
        thin = int(np.argmin(extents))
        if extents[thin] >= 0.1 * config.thickness_m:
            break
        offset = 0.5 * config.thickness_m * axes[:, thin]
        unique = np.concatenate([unique - offset, unique + offset])
    return unique


def _hull(points: NDArray[np.float64]) -> Hull:
    """Convex hull with outward triangles; the same points give the same hull."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points, qhull_options="QJ Pp" if len(points) < 5 else "Qt Pp")
    used = np.sort(found.vertices)
    index = np.full(len(points), -1, dtype=np.int64)
    index[used] = np.arange(len(used))
    faces = index[found.simplices.astype(np.int64)]
    vertices = np.ascontiguousarray(points[used])
    corners = vertices[faces]
    inward = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), found.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Hull(vertices, faces)


def _without_contained(hulls: list[Hull]) -> list[Hull]:
    """Hulls without those whose every vertex lies inside another one; the order stays."""
    planes = []
    for hull in hulls:
        corners = hull.vertices[hull.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals[lengths > 1e-14] / lengths[lengths > 1e-14][:, None]
        planes.append((normals, np.einsum("ij,ij->i", normals, corners[lengths > 1e-14][:, 0])))
    volumes = [hull.volume for hull in hulls]
    kept = []
    for i, hull in enumerate(hulls):
        inside = any(
            j != i and (volumes[j], -j) > (volumes[i], -i) and bool((hull.vertices @ normals.T <= offsets + 1e-6).all())
            for j, (normals, offsets) in enumerate(planes)
        )
        if not inside:
            kept.append(hull)
    return kept


def _merged(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """All parts as one mesh whose equal positions are one vertex."""
    import trimesh

    vertices = np.concatenate([np.asarray(p.vertices, dtype=np.float64) for p in parts])
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    faces = np.concatenate([np.asarray(p.faces, dtype=np.int64) + o for p, o in zip(parts, offsets, strict=True)])
    _, first, inverse = np.unique(np.round(vertices, 6), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return trimesh.Trimesh(vertices[first], faces[whole], process=False)


def _components(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Connected parts of a mesh, by their lowest face index."""
    import trimesh
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces = np.asarray(mesh.faces)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(mesh.vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    label = label[faces[:, 0]]
    order, first = np.unique(label, return_index=True)
    parts = []
    for which in order[np.argsort(first)]:
        chosen = faces[label == which]
        used, inverse = np.unique(chosen, return_inverse=True)
        parts.append(trimesh.Trimesh(np.asarray(mesh.vertices)[used], inverse.reshape(-1, 3), process=False))
    return parts


def _is_convex(part: trimesh.Trimesh, config: PieceConfig) -> bool:
    """Whether a connected part is as good as its convex hull."""
    hull = _hull(_with_body(np.asarray(part.vertices), config))
    if part.is_watertight and part.is_winding_consistent:
        return abs(float(part.volume)) >= config.convex_ratio * hull.volume
    return _gap(part, hull) <= config.convex_gap


def _gap(part: trimesh.Trimesh, hull: Hull) -> float:
    """Farthest distance of a hull's surface from the mesh that it wraps, in diagonals of the mesh."""
    corners = hull.vertices[hull.faces]
    weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [1, 2, 2], [2, 1, 2], [2, 2, 1]], dtype=np.float64)
    samples = np.einsum("kc,ncd->nkd", weights / weights.sum(axis=1, keepdims=True), corners).reshape(-1, 3)
    distance = closest_points(part.vertices, part.faces, samples).distance
    return float(distance.max() / max(float(np.linalg.norm(np.ptp(part.vertices, axis=0))), 1e-9))


def _coacd(mesh: trimesh.Trimesh, config: PieceConfig) -> list[NDArray[np.float64]]:
    """Vertices of the convex parts of a mesh by CoACD (Wei et al., SIGGRAPH 2022), in the order that it gives them."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)
    if len(faces) > config.faces:
        import fast_simplification

        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=config.faces)
    coacd = _coacd_module()
    found = coacd.run_coacd(
        coacd.Mesh(np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int32)),
        threshold=config.threshold, mcts_iterations=config.mcts_iterations, mcts_nodes=config.mcts_nodes,
        decimate=True, max_ch_vertex=config.max_vertices, seed=0,
    )  # fmt: skip
    return [np.asarray(points, dtype=np.float64) for points, _ in found]


@cache
def _coacd_module() -> Any:
    """CoACD, silent."""
    import coacd

    coacd.set_log_level("error")
    return coacd


@cache
def _directions(count: int) -> NDArray[np.float64]:
    """The six axis directions and others spread over the sphere (Fibonacci lattice), shape (count, 3), unit length."""
    index = np.arange(count - 6) + 0.5
    height = 1.0 - 2.0 * index / (count - 6)
    turn = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - height**2)
    return np.concatenate([np.eye(3), -np.eye(3), np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])])
