"""Convex pieces of an asset: the collision shape that every simulator reads the same way.

A decomposition left to the engine is not portable (engines inflate, merge or ignore it), so hulls are always explicit.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.geometry.colliders import ColliderShares, sightlines
from tasks.geometry.decomposition import Halving, parts_of
from tasks.geometry.feet import on_feet
from tasks.geometry.hulls import Hull, hull_of, reduced, with_body
from tasks.geometry.mass import MassProperties, mass_properties
from tasks.geometry.meshes import dump_glb, load_glb
from tasks.geometry.openings import openings
from tasks.geometry.triangles import face_planes, welded
from tasks.settings import Config, Whole
from tasks.stage import Spread

if TYPE_CHECKING:
    import trimesh

__all__ = ["Hull", "Method", "PieceConfig", "Pieces", "asset_pieces", "convex_hull", "pieces"]

Array = NDArray[np.float64]

Method = Literal["generator", "hulls", "cut"]

SMALL_M = 0.5
"""Objects with a shorter diagonal are cut by a measure that is finer in proportion: a mug's opening is not much deeper than what is
early in a cupboard."""

FEW_COMPONENTS = 8
"""Small objects of more separate parts, a set of cups or jars, are cut by the measure that is told: they would become too many pieces."""

LEAST_SCALE = 0.5
"""The measure is never finer than this: 1 cm."""

CONTAINED_BOX_M = 1e-3
"""A hull in another one lies in its box up to this: planes have a slack of a micrometre, which is more at sharp corners."""

SPARE = 0.9
"""Pieces are cut until they keep this much of the shares that are asked for: assets are stretched when they are placed."""


@dataclasses.dataclass(frozen=True)
class PieceConfig(Config):
    """How a mesh becomes convex pieces."""

    early_share: float = 0.02  # of rays that pieces may stop in openings: one in fifty, most of them at edges
    miss_share: float = 0.02  # of rays that may pass by the pieces; round silhouettes lose as much
    max_pieces: Whole = 128  # engines slow down with each; a kitchen cabinet's compartments take 70
    max_components: Whole = 32  # of separate parts a hull each is tried first; more are cut together
    deviation_m: float = 0.01  # of a rounded piece from its hull with fewer corners, above which it is halved: a miss; less if shares ask
    faces: Whole = 50_000  # meshes are decimated to this before they are cut: each cut looks at all of them
    thickness_m: float = 0.004  # flat parts (a picture, a curtain) get this much body


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Convex pieces of one asset in its own frame, how they were made, how well they stand for what is seen of it, unscaled, and the
    mass properties of their union."""

    hulls: tuple[Hull, ...]
    method: Method
    shares: ColliderShares
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


@dataclasses.dataclass(frozen=True)
class Uncut:
    """An asset whose pieces may be wanted. glbs: Gives its GLB and that of its pieces from construction, where it has such; called only
    when its pieces are not known yet. file: Its name in messages."""

    asset_id: str
    glbs: Callable[[], tuple[bytes, bytes | None]]
    has_pieces: bool
    file: str


def cut_ahead(assets: Sequence[Uncut], config: PieceConfig, cache: MutableMapping[str, bytes], spread: Spread) -> None:
    """Put pieces of assets into `cache` that `asset_pieces` would make one after another. An asset that cannot be read is left to it."""
    missing: dict[str, tuple[bytes, bytes | None, PieceConfig, str]] = {}
    for asset in assets:
        key = _key(asset.asset_id, asset.has_pieces, config)
        if (asset.asset_id, asset.has_pieces, config) not in _memo and key not in cache:
            with contextlib.suppress(KeyError, InputError):  # a blob that is missing or damaged
                missing[key] = (*asset.glbs(), config, asset.file)
    longest = sorted(missing, key=lambda key: (missing[key][1] is not None, -len(missing[key][0])))  # first: nobody waits for it at the end
    for key, packed in zip(longest, spread(_packed_pieces, [missing[key] for key in longest]), strict=True):
        if packed is not None:
            cache[key] = packed


def _packed_pieces(work: tuple[bytes, bytes | None, PieceConfig, str]) -> bytes | None:
    """Pieces of a GLB as bytes; None where it cannot be read or has no size."""
    mesh, known, config, file = work
    try:
        return _packed(pieces(load_glb(mesh, file), None if known is None else load_glb(known, f"{file} pieces"), config))
    except (InputError, ValueError):
        return None


def _key(asset_id: str, is_known: bool, config: PieceConfig) -> str:
    """What a cache knows pieces by."""
    return hashlib.sha256(f"pieces {asset_id} {is_known} {config!r}".encode()).hexdigest()


def _cached(
    asset_id: str, parts: Callable[[], Sequence[trimesh.Trimesh]], known: Callable[[], Sequence[trimesh.Trimesh]] | None,
    config: PieceConfig, cache: MutableMapping[str, bytes],
) -> Pieces:  # fmt: skip
    """Pieces out of the cache, put there when they are not; a library's models are decomposed once, not once per run."""
    key = _key(asset_id, known is not None, config)
    if key not in cache:
        cache[key] = _packed(pieces(parts(), known() if known is not None else None, config))
    return _unpacked(cache[key])


def _packed(made: Pieces) -> bytes:
    """Pieces as bytes: the method, shares, mass properties, counts of vertices and faces, then all vertices and all faces."""
    counts = np.array([[len(hull.vertices), len(hull.faces)] for hull in made.hulls], dtype="<i8")
    head = f"{made.method} {len(counts)}\n".encode()
    vertices = np.concatenate([hull.vertices for hull in made.hulls]).astype("<f8")
    faces = np.concatenate([hull.faces for hull in made.hulls]).astype("<i8")
    mass = np.concatenate([made.shares, [made.properties.volume], made.properties.center, made.properties.inertia.ravel()]).astype("<f8")
    return head + mass.tobytes() + counts.tobytes() + vertices.tobytes() + faces.tobytes()


def _unpacked(data: bytes) -> Pieces:
    """Pieces from bytes of `_packed`."""
    head, body = data.split(b"\n", 1)
    method, count = head.decode().split()
    mass = np.frombuffer(body, dtype="<f8", count=15)
    body = body[mass.nbytes :]
    counts = np.frombuffer(body, dtype="<i8", count=2 * int(count)).reshape(-1, 2)
    stops = np.cumsum(counts, axis=0)
    vertices = np.frombuffer(body, dtype="<f8", offset=counts.nbytes, count=3 * int(stops[-1, 0])).reshape(-1, 3)
    faces = np.frombuffer(body, dtype="<i8", offset=counts.nbytes + vertices.nbytes).reshape(-1, 3)
    hulls = [Hull(v, f) for v, f in zip(np.split(vertices, stops[:-1, 0]), np.split(faces, stops[:-1, 1]), strict=True)]
    shares = ColliderShares(float(mass[0]), float(mass[1]))
    properties = MassProperties(float(mass[2]), mass[3:6].copy(), mass[6:].reshape(3, 3).copy())
    return Pieces(tuple(hulls), method, shares, properties)  # type: ignore[arg-type]


def pieces(parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] | None, config: PieceConfig) -> Pieces:
    """`asset_pieces` without its memory."""
    points = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    bounds = np.array([points.min(axis=0), points.max(axis=0)])
    surface = _merged(parts)
    if not len(surface.faces):  # smaller than what is told apart: a point or a line
        hulls = tuple(_boxed(Halving(points, config.thickness_m), bounds, config, config.deviation_m))
        return Pieces(hulls, "hulls", ColliderShares(0.0, 0.0), mass_properties(hulls))
    measure = _Measure(surface, bounds, config)
    tried = []
    for method, hulls in _ways(surface, known, measure):
        shares = measure.sight.shares(hulls)
        tried.append((shares.early > config.early_share or shares.miss > config.miss_share, max(shares), method, hulls, shares))
        if not tried[-1][0]:
            break
    _, _, made, hulls, shares = min(tried, key=lambda way: way[:2])
    properties = mass_properties(hulls)
    footed = on_feet(hulls, properties.center, config.max_pieces)
    if len(footed) == len(hulls):
        return Pieces(hulls, made, shares, properties)
    return Pieces(footed, made, measure.sight.shares(footed), mass_properties(footed))


class _Measure:
    """What the pieces of an asset are held against. sight: the measure that all are told by. fine: a finer one for a small object."""

    def __init__(self, surface: trimesh.Trimesh, bounds: Array, config: PieceConfig) -> None:
        self.config, self.bounds = config, bounds
        self.sight = self.fine = sightlines([surface])
        scale = float(np.linalg.norm(np.ptp(bounds, axis=0))) / SMALL_M
        self.components = [np.asarray(component.vertices) for component in _components(surface)]
        if scale < 1 and len(self.components) <= FEW_COMPONENTS:
            self.fine = sightlines([surface], max(scale, LEAST_SCALE))
        self._halvings: dict[int, tuple[Array, Halving]] = {}
        self._whole: dict[int, tuple[Array, Hull]] = {}
        self._known: dict[tuple[int, float], list[Hull]] = {}

    def boxed(self, clouds: Sequence[Array]) -> tuple[Hull, ...]:
        """Hulls of point clouds, as they are kept: as coarse as keeps the shares, or as fine as hulls are made."""
        hulls: tuple[Hull, ...] = ()
        for finer in (1.0, 0.4):
            deviation_m, before = finer * self.config.deviation_m, len(hulls)
            for cloud in clouds:
                if id(cloud) not in self._halvings:  # the cloud is kept: no other gets its id
                    self._halvings[id(cloud)] = cloud, Halving(cloud, self.config.thickness_m)
                if (id(cloud), deviation_m) not in self._known:
                    halving = self._halvings[id(cloud)][1]
                    self._known[id(cloud), deviation_m] = _boxed(halving, self.bounds, self.config, deviation_m)
            made = tuple(_without_contained([hull for cloud in clouds for hull in self._known[id(cloud), deviation_m]]))
            if hulls and (len(made) == before or len(made) > self.config.max_pieces):
                break
            hulls = made
            if self.keeps(hulls):
                break
        return hulls

    def keeps(self, hulls: Sequence[Hull]) -> bool:
        """Whether hulls keep the shares, with something left for assets that are stretched."""
        shares = self.sight.shares(hulls)
        early = shares.early if self.fine is self.sight else max(shares.early, self.fine.shares(hulls).early)
        return early <= SPARE * self.config.early_share and shares.miss <= SPARE * self.config.miss_share

    def may_keep(self, clouds: Sequence[Array]) -> bool:
        """Whether the hulls of point clouds, before they lose corners, leave openings open."""
        for cloud in clouds:
            if id(cloud) not in self._whole:
                self._whole[id(cloud)] = cloud, hull_of(cloud)
        return self.fine.shares([self._whole[id(cloud)][1] for cloud in clouds]).early <= SPARE * self.config.early_share


def _ways(
    surface: trimesh.Trimesh, known: Sequence[trimesh.Trimesh] | None, measure: _Measure
) -> Iterator[tuple[Method, tuple[Hull, ...]]]:
    """Ways to make pieces, the one that asks for least first."""
    config = measure.config
    if known:
        yield "generator", measure.boxed([np.asarray(piece.vertices, dtype=np.float64) for piece in known])
    else:
        hulls = measure.boxed(measure.components) if len(measure.components) <= config.max_components else ()
        if hulls and measure.keeps(hulls):
            yield "hulls", hulls
    yield "cut", measure.boxed(_cut(surface, measure))
    if measure.fine is not measure.sight:  # what is too intricate for that is cut by the measure that is told
        measure.fine = measure.sight
        yield "cut", measure.boxed(_cut(surface, measure))


def _cut(surface: trimesh.Trimesh, measure: _Measure) -> list[Array]:
    """Corners of the convex parts that a mesh is cut into."""
    vertices, faces, config = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces), measure.config
    if len(faces) > config.faces:
        import fast_simplification

        vertices, faces = fast_simplification.simplify(vertices, faces.astype(np.int32), target_count=config.faces)
    triangles, thickness = np.asarray(vertices, dtype=np.float64)[faces], min(config.thickness_m, 0.25 * measure.fine.early_m)
    return parts_of(
        triangles,
        openings(measure.fine),
        lambda points: with_body(points, thickness),
        measure.may_keep,
        lambda clouds: measure.keeps(measure.boxed(clouds)),
        config.max_pieces,
        config.early_share,
    )


def dump_pieces(hulls: Sequence[Hull]) -> bytes:
    """Convex pieces as a GLB with one node each, in their frame [m], positions in single precision."""
    import trimesh

    meshes = [trimesh.Trimesh(hull.vertices, hull.faces, process=False) for hull in hulls]
    return dump_glb(meshes, [f"piece_{index:05d}" for index in range(len(hulls))])


def read_pieces(data: bytes, file: str) -> tuple[Hull, ...]:
    """Convex pieces of a GLB of `dump_pieces`, as convex as they are in double precision.

    Raises:
        InputError: as `load_glb`; or a piece has no volume.
    """
    from scipy.spatial import QhullError

    try:
        return tuple(hull_of(np.asarray(part.vertices, dtype=np.float64)) for part in load_glb(data, file))
    except QhullError as error:
        raise InputError(file, "content", "holds a convex piece without volume", "run the optimization stage again") from error


def convex_hull(points: NDArray[np.float64], config: PieceConfig) -> Hull:
    """Convex hull of points, shape (n, 3) [m], that engines take as it is (`hulls.LIMITS`); flat points get a body."""
    return reduced(hull_of(with_body(points, config.thickness_m)))


def _boxed(cloud: Halving, bounds: Array, config: PieceConfig, deviation_m: float) -> list[Hull]:
    """Hulls of a point cloud, kept inside a box where the box has room for a body."""
    low, high = bounds.copy()
    for axis in range(2):
        if high[axis] - low[axis] < config.thickness_m:
            middle = 0.5 * (low[axis] + high[axis])
            low[axis], high[axis] = middle - 0.5 * config.thickness_m, middle + 0.5 * config.thickness_m
    high[2] = max(high[2], low[2] + config.thickness_m)  # upwards only: nothing may reach below what carries it
    hulls = []
    for hull in cloud.hulls(deviation_m):
        clipped = np.clip(hull.vertices, low, high)
        if not np.array_equal(clipped, hull.vertices):
            hull = reduced(hull_of(_inside_body(clipped, low, high, config)))
        hulls.append(hull)
    return hulls


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
    return with_body(points, config.thickness_m)


def _without_contained(hulls: list[Hull]) -> list[Hull]:
    """Hulls without those whose every vertex lies inside another one; the order stays."""
    planes = [face_planes(hull.vertices, hull.faces, 1e-14) for hull in hulls]
    volumes = [hull.volume for hull in hulls]
    low = np.array([hull.vertices.min(axis=0) for hull in hulls]).reshape(-1, 3)
    high = np.array([hull.vertices.max(axis=0) for hull in hulls]).reshape(-1, 3)
    kept = []
    for i, hull in enumerate(hulls):
        # Most hulls do not fit into the box of another one: the planes of the rest are looked at.
        around = ((low <= low[i] + CONTAINED_BOX_M) & (high >= high[i] - CONTAINED_BOX_M)).all(axis=1)
        larger = [j for j in np.flatnonzero(around).tolist() if j != i and (volumes[j], -j) > (volumes[i], -i)]
        if not any(bool((hull.vertices @ planes[j][0].T <= planes[j][1] + 1e-6).all()) for j in larger):
            kept.append(hull)
    return kept


def _merged(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """All parts as one mesh whose equal positions are one vertex."""
    import trimesh

    vertices = np.concatenate([np.asarray(p.vertices, dtype=np.float64) for p in parts])
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    faces = np.concatenate([np.asarray(p.faces, dtype=np.int64) + o for p, o in zip(parts, offsets, strict=True)])
    first, place = welded(vertices)
    faces = place[faces]
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
