"""Rooms to measure optimizations on: furnished by the generator, disturbed, as rows up to the optimization stage."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.perturbation import SHARES, Disturbance, Kind, PerturbedObject, disturb
from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.selection import Selection
from tasks import captions
from tasks.capture.rooms.openings import wall_openings
from tasks.furniture import generate
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.geometry.meshes import dump_glb, dump_points, sample_surface, surface_of
from tasks.geometry.pieces import PieceConfig, pieces
from tasks.geometry.transforms import flat, transform_points, translation
from tasks.mounting import mounting
from tasks.optimization.solids import ConvexParts, shell_solids
from tasks.stage import Blobs, Context

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

COUNTS = (10, 80)
"""Fewest and most objects that a room is asked for."""

PLAIN: tuple[str, ...] = ("armchair", "ottoman", "trash can", "kettle", "backpack")
"""Categories of which a room gets some as meshes without known pieces, which the stage decomposes itself. One asset
each, stretched to size, since a decomposition takes seconds. Two fall into convex parts, three are cut."""

PLAIN_SHARE = 0.5
"""Share of the objects of those categories."""

POINTS = 200
"""Points that a caption's colors are taken from."""

FITTED = ("kitchen counter",)
"""What the generator sets along a wall, to which kitchens have it screwed."""

_WOULD_NOT_MOVE = ("let_in", "covering")


@dataclasses.dataclass(frozen=True)
class Carried:
    """What carried an object before it was disturbed. relation: `floor`, `on`, `wall` or `ceiling`. is_fitted: screwed to its wall."""

    relation: str
    parent_id: str | None
    is_fitted: bool = False


@dataclasses.dataclass(frozen=True)
class BenchScene:
    """A scene to optimize: rows by table and the blobs that they name.

    Of a generated room also what is not told to the optimization: what carried each object, its pose before it was
    disturbed, 4x4 [m], and the disturbances. None and nothing for scans.
    """

    scene_id: str
    rows: Mapping[str, list[Any]]
    blobs: Mapping[str, bytes]
    carried: Mapping[str, Carried] | None = None
    drawn_poses: Mapping[str, Array] | None = None
    disturbances: tuple[Disturbance, ...] = ()

    def digest(self) -> str:
        """SHA-256 of everything in it, 64 hex digits."""
        text = hashlib.sha256()
        for table in sorted(self.rows):
            for row in self.rows[table]:
                text.update(repr(row).encode())
        for name in sorted(self.blobs):
            text.update(name.encode())
        text.update(repr(self.disturbances).encode())
        for name in sorted(self.drawn_poses or {}):
            text.update(self.drawn_poses[name].tobytes() if self.drawn_poses else b"")
        return text.hexdigest()


def plain_asset(category: str) -> list[trimesh.Trimesh]:
    """The parts of the one asset of a category that comes without known pieces, in its own frame [m]."""
    return generate(category, None, np.random.default_rng(20)).parts


def generated_scene(index: int, rooms: int, seed: int, shares: Sequence[tuple[Kind, float]] = SHARES) -> BenchScene:
    """Room `index` of `rooms`: kinds in turn, numbers of objects spread evenly over `COUNTS`, clutter from none to much.

    shares: as of `disturbed_scene`; what is used as it was drawn needs none.
    """
    count = round(COUNTS[0] + (COUNTS[1] - COUNTS[0]) * (index / (rooms - 1) if rooms > 1 else 0.4))
    rng = np.random.default_rng([seed, rooms, index])
    kind = ROOM_TYPES[index % len(ROOM_TYPES)]
    clutter = float(rng.uniform(0.0, 1.0))
    # clutter adds to what a room is asked for
    room = furnish(kind, rng, max(COUNTS[0], count - round(10 * clutter)), clutter)
    return disturbed_scene(f"bench/room_{index:04d}", room, rng, shares=shares)


def scene_of_count(count: int, seed: int) -> BenchScene:
    """A living room of exactly `count` objects, by the first seed from `seed` on that gives one."""
    for number in range(1000):
        rng = np.random.default_rng([seed, count, number])
        room = furnish("living room", rng, count)
        if len(room.objects) == count:
            return disturbed_scene(f"bench/of_{count:04d}", room, rng)
    raise ValueError(f"count: no living room of {count} objects was found")


def disturbed_scene(
    scene_id: str,
    furnished: FurnishedRoom,
    rng: np.random.Generator,
    plain_share: float = PLAIN_SHARE,
    shares: Sequence[tuple[Kind, float]] = SHARES,
) -> BenchScene:
    """The rows of a furnished room whose objects were disturbed, `shares` of them each way.

    plain_share: of the objects of the categories `PLAIN`, which come without known pieces.
    """
    room = _room_row(scene_id, furnished)
    names = {obj.name: f"{i:04d}" for i, obj in enumerate(furnished.objects)}
    blobs = Blobs()
    assets: dict[str, Asset] = {}
    objects: list[PerturbedObject] = []
    used: list[tuple[str, str, tuple[float, float, float]]] = []  # category, asset, scale
    for item in furnished.objects:
        parts, known, scale = item.parts, item.pieces, (1.0, 1.0, 1.0)
        if item.category in PLAIN and rng.random() < plain_share:
            parts, known = plain_asset(item.category), []
            extents = np.ptp(surface_of(parts).vertices, axis=0)
            x, y, z = (float(a / b) for a, b in zip(item.extents, extents, strict=True))
            scale = (x, y, z)
        asset = _asset(item.category, parts, known, blobs)
        assets[asset.asset_id] = asset
        hulls = pieces(item.parts, item.pieces, PieceConfig()).hulls if shares else ()  # by which things are pushed into each other
        parent = names.get(item.parent)
        relation = "on" if parent is not None else item.parent
        let_in = mounting(item.category).kind in _WOULD_NOT_MOVE
        objects.append(PerturbedObject(names[item.name], ConvexParts(names[item.name], hulls), item.pose, relation, parent, let_in))
        used.append((item.category, asset.asset_id, scale))
    poses, done = disturb(objects, shell_solids(room), rng, shares) if shares else ({obj.name: obj.pose for obj in objects}, [])
    instances, selections = [], []
    for obj, item, (category, asset_id, scale) in zip(objects, furnished.objects, used, strict=True):
        pose = poses[obj.name]
        instances.append(_instance(scene_id, obj.name, category, item.parts, pose, item.extents, blobs, rng))
        selections.append(
            Selection(
                scene_id=scene_id, instance_id=obj.name, rank=1, slot=1, asset_id=asset_id, score=1.0, chamfer_m=0.0, coverage=1.0,
                foreign_share=None,
                box_iou=1.0, color_similarity=1.0, pose=flat(pose), scale=scale, look=None, provider="bench", provider_version="1",
            )
        )  # fmt: skip
    context = Context(scene_id, "captions", 0, blobs)
    described = captions.run(instances=instances, frames=[], masks=[], context=context, config=captions.CaptionsConfig())
    rows: dict[str, list[Any]] = {
        "instances": instances, "selections": selections, "shells": [room], "surfaces": [], "captions": described.rows["captions"],
        "assets": [assets[key] for key in sorted(assets)], "annotations": [],
    }  # fmt: skip
    carried = {
        obj.name: Carried(obj.relation, obj.parent, obj.relation == "floor" and item.category in FITTED)
        for obj, item in zip(objects, furnished.objects, strict=True)
    }
    return BenchScene(scene_id, rows, blobs, carried, {obj.name: obj.pose for obj in objects}, tuple(done))


def _room_row(scene_id: str, furnished: FurnishedRoom) -> Shell:
    from shapely.geometry import Polygon

    corners = [(float(x), float(y)) for x, y in furnished.polygon]
    fillings = [
        transform_points(sample_surface(surface_of(item.parts), POINTS, np.random.default_rng(0))[0], item.pose)
        for item in furnished.objects
        if mounting(item.category).kind == "let_in"
    ]
    return Shell(
        scene_id=scene_id, room_type=furnished.room_type, floor_polygon=tuple(corners), floor_area_m2=float(Polygon(corners).area),
        floor_source="surface", walls=tuple((*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)),
        interior_walls=(), openings=wall_openings(np.array(corners), np.zeros((0, 6)), furnished.height, fillings),
        slopes=(), lintels=(), height_m=furnished.height, height_source="ceiling", floor_color=None, wall_color=None,
    )  # fmt: skip


def _asset(category: str, parts: list[trimesh.Trimesh], known: list[trimesh.Trimesh], blobs: Blobs) -> Asset:
    glb, surface = dump_glb(parts), surface_of(parts)
    pieces_blob = blobs.add(dump_glb(known), "glb") if known else None
    return Asset(
        asset_id=hashlib.sha256(glb).hexdigest(), provider="procedural", name=category, category=category, source="generator",
        license="Apache-2.0", author=None, mesh_blob=blobs.add(glb, "glb"), pieces_blob=pieces_blob,
        extents=tuple(map(float, np.ptp(surface.vertices, axis=0))), volume_m3=sum(abs(float(part.volume)) for part in parts),
        is_watertight=all(part.is_watertight for part in parts), vertex_count=len(surface.vertices), face_count=len(surface.faces),
        open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
    )  # fmt: skip


def _instance(
    scene_id: str, name: str, category: str, parts: list[trimesh.Trimesh], pose: Array, extents: tuple[float, float, float],
    blobs: Blobs, rng: np.random.Generator,
) -> Instance:  # fmt: skip
    points, colors, _ = sample_surface(surface_of(parts), POINTS, rng)
    placed = points @ pose[:3, :3].T + pose[:3, 3]
    return Instance(
        scene_id=scene_id, instance_id=name, source_id=name, raw_label=category, category=category, nyu40_id=0, nyu40_label="unlabeled",
        is_structure=False, found_by=None, category_probability=None,
        room_index=None, box_pose=flat(pose @ translation([0.0, 0.0, 0.5 * extents[2]])), box_size=extents,
        box_volume_m3=float(np.prod(extents)), point_count=POINTS, points_blob=blobs.add(dump_points(placed, colors), "ply"),
        hidden_m=None,
        mesh_blob=None, view_blob=None, best_frames=(),
    )  # fmt: skip
