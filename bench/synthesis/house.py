"""Real ones: the micro-scenes of the AWS small house, by the stage, of its objects as its authors placed them."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.realdata import HOUSE
from bench.synthesis.measures import Draws
from schemas.budget import BUDGET
from schemas.candidates import Asset
from schemas.capture import Instance, Scene, Shell
from schemas.files import read_file
from schemas.optimization import Placement
from tasks.containers import GLB_MAGIC
from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import flat, translation
from tasks.micro_scenes import STAGE, MicroScenesConfig
from tasks.scanner.scenery import STRUCTURE, SceneryObject, scenery_of
from tasks.stage import Blobs, Context
from tasks.synthesis.layout import Layout, layouts_of
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.metrics.distributions import category_kl

SCENE = "house/truth"

REPEATS = 50
"""Layouts that are drawn on each large object of the house: its shares are of a handful of objects, the drawn ones should not be."""


def lacking(realdata: Path | None) -> str | None:
    """Why the house cannot be measured; None where it can."""
    if realdata is None:
        return "METASCENES_REALDATA or --realdata names the folder that holds it"
    return None if (realdata / HOUSE).exists() else f"{realdata} does not hold {HOUSE}"


def house_layouts(realdata: Path) -> list[Layout]:
    """What stands on the large objects of the house. Its room types nobody states."""
    parts = load_glb(read_file(realdata / HOUSE, HOUSE.name, BUDGET.scene_bytes, magic=GLB_MAGIC), HOUSE.name)
    return layouts_of_objects(scenery_of(parts).objects)


def layouts_of_objects(objects: Sequence[SceneryObject]) -> list[Layout]:
    """The micro-scenes of objects that stand where they do, by the stage, and nobody says on what."""
    named = [(f"{at:04d}", obj) for at, obj in enumerate(objects)]
    rows = [(_instance(name, obj), _placement(name, obj), _asset(name, obj)) for name, obj in named]
    outcome = STAGE.run(
        scenes=[_scene(len(rows))], shells=[_shell()], rooms=[], instances=[row[0] for row in rows], supports=[],
        placements=[row[1] for row in rows], assets=[row[2] for row in rows], context=Context(SCENE, STAGE.name, 0, Blobs()),
        config=MicroScenesConfig(),
    )  # fmt: skip
    return layouts_of(outcome.rows["micro_scenes"], outcome.rows["micro_scene_objects"])


def house_figures(house: Sequence[Layout], generated: Sequence[Layout], draws: Draws | None, known: Sequence[str]) -> dict[str, Any]:
    """What the house has, and how far categories on generated tops, and on drawn ones of the same large objects, are from it.

    draws: The model; None without one. known: Categories of large objects that it knows.
    """
    larges = [layout.large for layout in house if layout.large.category in known for _ in range(REPEATS)]
    drawn = draws.draw(larges, 0) if draws is not None and larges else []
    alike = [layout for layout in house if layout.large.category in known]
    return {
        "micro_scenes": len(house),
        "objects": sum(len(layout) for layout in house),
        "larges": dict(sorted(Counter(layout.large.category for layout in house).items())),
        "smalls": dict(sorted(Counter(name for layout in house for name in layout.categories).items())),
        "collides": box_figures(house).collides,
        "ckl_generated": category_kl(house, generated),
        "ckl_drawn": category_kl(alike, drawn),
        "drawn_on": len(alike),
    }


def _asset_id(name: str) -> str:
    return hashlib.sha256(f"{SCENE} {name}".encode()).hexdigest()


def _instance(name: str, obj: SceneryObject) -> Instance:
    size = _numbers(obj.extents)
    box = obj.pose @ translation([0.0, 0.0, 0.5 * size[2]])
    return Instance(
        scene_id=SCENE, instance_id=name, source_id=obj.name, raw_label=obj.category, category=obj.category, nyu40_id=0,
        nyu40_label="unlabeled", is_structure=obj.category in STRUCTURE, found_by=None, category_probability=None,
        room_index=None, box_pose=flat(box), box_size=size,
        box_volume_m3=math.prod(size), hidden_m=None, point_count=1, points_blob=f"{_asset_id(name)}.ply", mesh_blob=None, view_blob=None,
        best_frames=(),
    )  # fmt: skip


def _placement(name: str, obj: SceneryObject) -> Placement:
    pose = flat(obj.pose)
    return Placement(
        scene_id=SCENE, instance_id=name, asset_id=_asset_id(name), origin="imported", annotator=None, annotation_match=None,
        scale=(1.0, 1.0, 1.0), proposed_pose=pose, optimized_pose=pose, settled_pose=None, displacement_m=None, lift_m=None,
        method="imported", remains=None, collider_pieces=None, collider_faces=None, collider_early_share=None, collider_miss_share=None,
        collider_blob=None, collider_cut_share=None, collider_distance_m=None, fidelity_loss=None,
    )  # fmt: skip


def _asset(name: str, obj: SceneryObject) -> Asset:
    size = _numbers(obj.extents)
    return Asset(
        asset_id=_asset_id(name), provider="library", name=obj.name, category=obj.category, source="AWS small house", license="unknown",
        author=None, mesh_blob=f"{_asset_id(name)}.glb", pieces_blob=None, extents=size, volume_m3=math.prod(size), is_watertight=False,
        vertex_count=8, face_count=12, open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
    )  # fmt: skip


def _scene(count: int) -> Scene:
    identity = flat(np.eye(4))
    return Scene(
        scene_id=SCENE, room_id=SCENE, dataset="house", scan="truth", scan_format="metascenes", scan_path="", alignment=identity,
        alignment_source="identity", to_original=flat(np.eye(4)),
        floor_tilt_radians=None, mesh_blob=f"{_asset_id('mesh')}.glb", vertex_count=8, face_count=12,
        frame_count=0, instance_count=count, segmentation="objects", license=None,
    )  # fmt: skip


def _shell() -> Shell:
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    return Shell(
        scene_id=SCENE, room_type="dwelling", floor_polygon=corners, floor_area_m2=1.0, floor_source="layout", walls=(), interior_walls=(),
        openings=None, lintels=None, slopes=None, height_m=2.5, height_source="layout", floor_color=None, wall_color=None,
    )  # fmt: skip


def _numbers(values: Any) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z
