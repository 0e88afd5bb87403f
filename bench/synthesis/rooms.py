"""Rooms with generated tops as rows of the lake, and their micro-scenes: the truth alone, without scans and meshes."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene, Shell
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.optimization import Placement, Support
from tasks.furniture import tops
from tasks.geometry.transforms import flat, yaw_pose
from tasks.micro_scenes.categories import read_categories

Array = NDArray[np.float64]

ROOM_TYPES: tuple[str, ...] = tuple(sorted({room_type for _, room_type in tops.PAIRS}))
"""Kinds of rooms that have rules, taken in turn."""

LARGE_COUNTS = (3, 6)
"""Fewest and most large objects of a room."""

CELL_M = 3.0
"""Each large object stands somewhere in a square of its own of this side, so that none meets another."""

HEIGHT_M = 2.6
"""From floor to ceiling."""


@dataclasses.dataclass(frozen=True)
class ToppedPiece:
    """A large object of a room. size: Extents [m], shape (3,). pose: Its frame, at the middle of its bottom, to world, 4x4 [m]."""

    word: str
    size: tuple[float, float, float]
    pose: Array
    top: tops.Top


@dataclasses.dataclass(frozen=True)
class ToppedRoom:
    """A room of carriers, in one row along x. Ids of instances count on from carrier to carrier, each before what stands on it."""

    scene_id: str
    room_type: str
    carriers: tuple[ToppedPiece, ...]


def topped_rooms(count: int, seed: int) -> Iterator[ToppedRoom]:
    """A number of rooms, their kinds in turn, each the same whatever the count."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        room_type = ROOM_TYPES[number % len(ROOM_TYPES)]
        words = [word for word, kind in tops.PAIRS if kind == room_type]
        chosen = rng.permutation(len(words))[: int(rng.integers(LARGE_COUNTS[0], LARGE_COUNTS[1] + 1))]
        carriers = []
        for cell, index in enumerate(chosen.tolist()):
            size = tops.typical_size(words[index], rng)
            x, y = CELL_M * (np.array([cell + 0.5, 0.5]) + rng.uniform(-0.04, 0.04, 2))
            pose = yaw_pose(0.5 * math.pi * int(rng.integers(4)) + float(rng.normal(0.0, 0.05)), [float(x), float(y), 0.0])
            carriers.append(ToppedPiece(words[index], size, pose, tops.draw(words[index], size, room_type, rng)))
        yield ToppedRoom(f"tops/s{seed}_r{number:06d}", room_type, tuple(carriers))


def generated_rows(count: int, seed: int) -> Iterator[dict[str, list[Any]]]:
    """The rows of a number of rooms, room by room, by table: what the micro-scenes of a scene are made from."""
    for room in topped_rooms(count, seed):
        yield _rows(room)


def micro_scene_rows(count: int, seed: int) -> tuple[list[MicroScene], list[MicroSceneObject]]:
    """The micro-scenes of the same rooms, made from the tops as they were drawn."""
    scenes: list[MicroScene] = []
    objects: list[MicroSceneObject] = []
    categories = read_categories()
    for room in topped_rooms(count, seed):
        first = 0
        for carrier in room.carriers:
            top, large_id = carrier.top, _id(first)
            scenes.append(
                MicroScene(
                    scene_id=room.scene_id, instance_id=large_id, room_id=room.scene_id, room_index=0, room_type=room.room_type,
                    category=categories.merged(carrier.word), word=carrier.word, asset_id=_asset_id(carrier.word, carrier.size),
                    frame_pose=flat(carrier.pose), box_size=carrier.size, object_count=len(top),
                )
            )  # fmt: skip
            depths: list[int] = []
            for index, word in enumerate(top.words):
                parent = int(top.parents[index])
                depths.append(1 if parent < 0 else depths[parent] + 1)
                x, y, z = map(float, top.centers[index])
                size = _extents(top.sizes[index])
                objects.append(
                    MicroSceneObject(
                        scene_id=room.scene_id, large_id=large_id, instance_id=_id(first + 1 + index), category=categories.merged(word),
                        word=word, asset_id=_asset_id(word, size), parent_id=_id(first + 1 + parent), relation=top.relations[index],
                        depth=depths[-1], box_center=(x, y, z), box_size=size, yaw_radians=float(top.yaws[index]), tilt_radians=0.0,
                    )
                )  # fmt: skip
            first += 1 + len(top)
    return scenes, objects


def _rows(room: ToppedRoom) -> dict[str, list[Any]]:
    instances: list[Instance] = []
    placements: list[Placement] = []
    supports: list[Support] = []
    assets: dict[str, Asset] = {}

    def put(word: str, size: tuple[float, float, float], pose: Array, relation: str, parent: int | None) -> None:
        name, asset = _id(len(instances)), _asset(word, size)
        assets[asset.asset_id] = asset
        box = pose.copy()
        box[2, 3] += 0.5 * size[2]
        instances.append(
            Instance(
                scene_id=room.scene_id, instance_id=name, source_id=name, raw_label=word, category=word, nyu40_id=0,
                nyu40_label="unlabeled", is_structure=False, found_by=None, category_probability=None,
                room_index=0, box_pose=flat(box), box_size=size,
                box_volume_m3=math.prod(size), hidden_m=None, point_count=1, points_blob=_blob(room.scene_id, name, "ply"),
                mesh_blob=None, view_blob=None, best_frames=(),
            )
        )  # fmt: skip
        placements.append(
            Placement(
                scene_id=room.scene_id, instance_id=name, asset_id=asset.asset_id, origin="imported", annotator=None, annotation_match=None,
                scale=(1.0, 1.0, 1.0), proposed_pose=flat(pose), optimized_pose=flat(pose), settled_pose=None, displacement_m=None,
                lift_m=None, method="imported", remains=None, collider_pieces=None, collider_faces=None, collider_early_share=None,
                collider_miss_share=None, collider_blob=None, collider_cut_share=None, collider_distance_m=None, fidelity_loss=None,
            )
        )  # fmt: skip
        supports.append(
            Support(
                scene_id=room.scene_id, instance_id=name, relation=relation, parent_id=None if parent is None else _id(parent),
                against=None, gap_m=0.0, is_fixed=False, is_kept=True, is_inferred=False, bracket_blob=None,
            )
        )  # fmt: skip

    for carrier in room.carriers:
        large, top = len(instances), carrier.top
        put(carrier.word, carrier.size, carrier.pose, "floor", None)
        for index, word in enumerate(top.words):
            size = _extents(top.sizes[index])
            bottom = top.centers[index] - [0.0, 0.0, 0.5 * size[2]]
            put(
                word,
                size,
                carrier.pose @ yaw_pose(float(top.yaws[index]), bottom),
                top.relations[index],
                large + 1 + int(top.parents[index]),
            )
    corners = ((0.0, 0.0), (CELL_M * len(room.carriers), 0.0), (CELL_M * len(room.carriers), CELL_M), (0.0, CELL_M))
    area = CELL_M * CELL_M * len(room.carriers)
    identity = flat(np.eye(4))
    scene = Scene(
        scene_id=room.scene_id, room_id=room.scene_id, dataset="tops", scan=room.scene_id.split("/")[1], scan_format="metascenes",
        scan_path="", alignment=identity, alignment_source="identity", to_original=identity, floor_tilt_radians=None,
        mesh_blob=_blob(room.scene_id, "mesh", "glb"), vertex_count=8, face_count=12, frame_count=0, instance_count=len(instances),
        segmentation="objects", license=None,
    )  # fmt: skip
    shell = Shell(
        scene_id=room.scene_id, room_type=room.room_type, floor_polygon=corners, floor_area_m2=area, floor_source="layout",
        walls=tuple((*a, *b) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)), interior_walls=(), openings=None,
        lintels=None, slopes=None, height_m=HEIGHT_M, height_source="layout", floor_color=None, wall_color=None,
    )  # fmt: skip
    row = Room(scene_id=room.scene_id, room_index=0, room_type=room.room_type, floor_polygon=corners, floor_area_m2=area)
    return {
        "scenes": [scene], "shells": [shell], "rooms": [row], "instances": instances, "supports": supports, "placements": placements,
        "assets": [assets[key] for key in sorted(assets)],
    }  # fmt: skip


def _asset(word: str, size: tuple[float, float, float]) -> Asset:
    asset_id = _asset_id(word, size)
    return Asset(
        asset_id=asset_id, provider="procedural", name=word, category=word, source="generator", license="Apache-2.0", author=None,
        mesh_blob=f"{asset_id}.glb", pieces_blob=None, extents=size, volume_m3=math.prod(size), is_watertight=True, vertex_count=8,
        face_count=12, open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
    )  # fmt: skip


def _asset_id(word: str, size: tuple[float, float, float]) -> str:
    """What would be the hash of its mesh: of its word and extents, which no two objects share."""
    return hashlib.sha256(f"{word} {size}".encode()).hexdigest()


def _blob(scene_id: str, name: str, suffix: str) -> str:
    return f"{hashlib.sha256(f'{scene_id} {name}'.encode()).hexdigest()}.{suffix}"


def _id(number: int) -> str:
    return f"{number:04d}"


def _extents(size: Array) -> tuple[float, float, float]:
    x, y, z = map(float, size)
    return x, y, z
