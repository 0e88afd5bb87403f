"""A small lake with meshes for tests: rooms with a few solids in them, their scans, and rows of every table."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Room, Scene, Shell
from schemas.exports import ExportCheck, ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.fidelity import Fidelity, SceneFidelity
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.navigation import Episode, Navmesh, UnreachableTarget
from schemas.optimization import Certificate, Contact, Optimization, OptimizationStep, Placement, Support
from schemas.selection import Selection
from tasks.fidelity.marked_points import MarkedPoints, dump_marked
from tasks.geometry.meshes import dump_glb
from tasks.geometry.transforms import flat, translation, yaw_pose
from tasks.navigation.convex import convex_cover
from tasks.navigation.navmesh import Settings, dump_navmesh, navmesh_from_polygons
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake

STAGES = ("capture", "captions", "candidates", "selection", "optimization", "micro_scenes", "navigation", "fidelity", "exports")
HEIGHT = 2.6
CATEGORIES = ("chair", "table", "lamp", "book", "box", "plant", "mug & <saucer>")


def solid(index: int) -> trimesh.Trimesh:
    """A colored solid, bottom center at the origin: a box, a cylinder or a cone."""
    kinds = (
        lambda: trimesh.creation.box((0.6, 0.5, 0.8)),
        lambda: trimesh.creation.cylinder(0.3, 0.7, sections=24),
        lambda: trimesh.creation.cone(0.35, 0.9, sections=24),
    )
    mesh = kinds[index % 3]()
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    color = np.random.default_rng(index).integers(60, 220, 3)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile([*color, 255], (len(mesh.vertices), 1)).astype(np.uint8))
    return mesh


def floor_navmesh() -> bytes:
    """A .navmesh of a floor of 3 by 2 m."""
    import shapely

    return dump_navmesh(navmesh_from_polygons(convex_cover(shapely.box(-1.5, -1.0, 1.5, 1.0)), Settings()))


def floor_points(seed: int) -> MarkedPoints:
    """Points of objects all over a floor of 4 by 3 m."""
    rng = np.random.default_rng(seed)
    return MarkedPoints(rng.uniform((0, 0, 0), (4, 3, 1), (200, 3)), rng.exponential(0.1, 200), np.zeros(200, np.uint8))


def furnished_lake(folder: Path, scenes: int = 2, objects: int = 6) -> Lake:
    """A lake with `scenes` furnished rooms, committed, one failed scene among its runs."""
    lake = Lake.open(folder)
    for number in range(scenes):
        _stage_scene(lake, f"demo/room_{number}", number, objects)
    lake.stage_rows(
        stage_run(
            "demo/broken", "capture", fingerprint("broken"), outcome="failed", error_kind="input",
            error="/srv/scans/secret folder/broken/broken.txt: axisAlignment: determinant is 0; remove the line to have it estimated",
        ), {},
    )  # fmt: skip
    lake.commit("furnished rooms")
    return lake


def _stage_scene(lake: Lake, scene_id: str, number: int, objects: int) -> None:
    """Stage rows of every stage of one scene."""
    rng = np.random.default_rng(number)
    room = sample(
        Shell, scene_id=scene_id, room_type="office", floor_polygon=((0.0, 0.0), (4.0 + number, 0.0), (4.0 + number, 3.2), (0.0, 3.2)),
        floor_area_m2=12.8 + 3.2 * number, walls=((0.0, 0.0, 4.0, 0.0),), interior_walls=(), height_m=HEIGHT,
    )  # fmt: skip
    tables = ("instances", "captions", "candidates", "assets", "selections", "placements", "supports", "certificates")
    rows: dict[str, list[Any]] = {table: [] for table in tables}
    scan = [mesh for _, mesh in room_shell(room)]
    for index in range(objects):
        scan.extend(_stage_object(lake, rows, scene_id, index, rng))
    ceiling = trimesh.creation.box(bounds=[[0, 0, HEIGHT], [4.0 + number, 3.2, HEIGHT + 0.05]])
    blob = lake.blobs.put(dump_glb([*scan, ceiling]), "glb")
    points = lake.blobs.put(b"points", "ply")
    floor = sample(Instance, scene_id=scene_id, instance_id="0900", category="floor", is_structure=True, points_blob=points)
    outputs: dict[str, dict[str, list[Any]]] = {
        "capture": {
            "scenes": [sample(Scene, scene_id=scene_id, room_id=scene_id, mesh_blob=blob, instance_count=objects + 1)],
            "shells": [room],
            "rooms": [sample(Room, scene_id=scene_id, room_index=0, room_type="office", floor_polygon=room.floor_polygon)],
            "frames": [], "instances": [*rows["instances"], floor], "masks": [],
        },
        "captions": {"captions": rows["captions"]},
        "candidates": {"candidates": rows["candidates"], "assets": rows["assets"]},
        "selection": {"selections": rows["selections"]},
        "optimization": {
            "placements": rows["placements"], "supports": rows["supports"],
            "contacts": [
                sample(
                    Contact, scene_id=scene_id, phase="proposed", instance_a="0000", body_b="0001", penetration_m=0.05, is_allowed=False
                )
            ] if objects > 1 else [],
            "optimization_steps": [
                sample(OptimizationStep, scene_id=scene_id, step=step, loss=loss, smallest_loss=loss, outcome=outcome)
                for step, loss, outcome in ((0, 0.25, "start"), (1, 0.125, "kept"), (2, 0.0, "kept"))
            ],
            "optimizations": [
                sample(
                    Optimization, scene_id=scene_id, method="default", object_count=objects, loss_start=0.25, loss_final=0.0, moves=7,
                    ended="zero_loss", fixed_count=1, deep_pairs=0, remains=("0003: <nothing> carries it",),
                )
            ],
            "certificates": rows["certificates"],
        },
        "micro_scenes": _micro_scene(scene_id, objects),
        "navigation": {
            "navmeshes": [
                sample(
                    Navmesh, scene_id=scene_id, agent="stretch", navmesh_blob=lake.blobs.put(floor_navmesh(), "navmesh"), area_m2=6.0,
                    largest_island_m2=6.0,
                )
            ],
            "episodes": [sample(Episode, scene_id=scene_id, agent="stretch", instance_id="0001")],
            "unreachable_targets": [sample(UnreachableTarget, scene_id=scene_id, instance_id="0002", reason="too high")], "splits": [],
        },
        "fidelity": {
            "fidelity": [
                sample(Fidelity, scene_id=scene_id, instance_id=row.instance_id, f_5cm=0.25 * (1 + index % 4), accuracy_5cm=1.0)
                for index, row in enumerate(rows["placements"])
            ],
            "scene_fidelity": [
                sample(
                    SceneFidelity, scene_id=scene_id, cameras="virtual", object_count=objects, placed_count=objects,
                    object_f_5cm=0.75 + 0.125 * number, distances_blob=lake.blobs.put(dump_marked(floor_points(number)), "ply"),
                )
            ],
        },
        "exports": {
            "export_files": [
                sample(ExportFile, scene_id=scene_id, format=kind, path="a", file_blob=lake.blobs.put(b"f", "usd"), size_bytes=150_000,
                       passed=True)
                for kind in EXPORT_FORMATS
            ],
            "export_checks": [
                *(
                    sample(ExportCheck, scene_id=scene_id, format=kind, rule="units", passed=True)
                    for kind in EXPORT_FORMATS
                    if kind != "habitat"
                ),
                sample(ExportCheck, scene_id=scene_id, format="habitat", rule="up_axis", passed=number > 0, message="up is <missing>"),
            ],
        },
    }  # fmt: skip
    for place, stage in enumerate(STAGES):
        run = stage_run(
            scene_id, stage, fingerprint(scene_id, stage), *(f"{s}={fingerprint(scene_id, s)}" for s in STAGES[:place][-1:]),
            seconds=0.5 + place + number, degradations=("0001: no view; shape by category",) if stage == "captions" else (),
            started_at=datetime(2026, 1, 1, tzinfo=UTC) + timedelta(minutes=place), host="secret-host:1",
        )  # fmt: skip
        lake.stage_rows(run, outputs[stage])


def _micro_scene(scene_id: str, objects: int) -> dict[str, list[Any]]:
    """A table with a lamp, and a book under a plant, as far as there are so many objects."""
    of = {"scene_id": scene_id, "large_id": "0001", "parent_id": "0001", "relation": "on", "depth": 1}
    small = [
        sample(MicroSceneObject, **{**of, "instance_id": f"{index:04d}", "category": CATEGORIES[index]} | carried)
        for index, carried in ((2, {}), (3, {}), (5, {"parent_id": "0003", "depth": 2}))
        if index < objects
    ]
    large = sample(
        MicroScene,
        scene_id=scene_id,
        instance_id="0001",
        room_id=scene_id,
        room_type="office",
        category="table",
        object_count=len(small) or 1,
    )
    return {"micro_scenes": [large] if small else [], "micro_scene_objects": small}


def _stage_object(lake: Lake, rows: dict[str, list[Any]], scene_id: str, index: int, rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Rows of one object; the parts of it that the scan has seen."""
    instance = f"{index:04d}"
    of = {"scene_id": scene_id, "instance_id": instance}
    glb = dump_glb([solid(index)])
    blob = lake.blobs.put(glb, "glb")
    asset = blob.split(".")[0]
    pose = yaw_pose(float(rng.uniform(0, 6)), (0.7 + 1.1 * (index % 3), 0.7 + 1.3 * (index // 3 % 2), 0.0))
    shift = -0.65 if index == 1 else 0.0  # the second object was proposed inside the first
    placement = sample(
        Placement, **of, asset_id=asset, scale=(1.0, 1.0, 1.0), proposed_pose=flat(translation((shift, 0.0, 0.0)) @ pose),
        optimized_pose=flat(pose), displacement_m=abs(shift), lift_m=-0.01 * index, method="default",
    )  # fmt: skip
    category = CATEGORIES[index % len(CATEGORIES)]
    rows["instances"].append(
        sample(
            Instance, **of, category=category, is_structure=False, box_size=(0.6, 0.5, 0.8), box_volume_m3=0.24 * (1 + index % 4),
            points_blob=lake.blobs.put(b"points", "ply"),
        )
    )  # fmt: skip
    rows["captions"].append(sample(Caption, **of, materials=("wood", "metal"), mass_kg=1.5 + index, is_fallback=index == 1))
    if all(row.asset_id != asset for row in rows["assets"]):
        rows["assets"].append(sample(Asset, asset_id=asset, provider="library", mesh_blob=blob, license="CC-BY-4.0", author="A. Maker"))
    rows["candidates"].append(sample(Candidate, **of, slot=1, provider="library", outcome="filled", asset_id=asset, is_fallback=False))
    rows["candidates"].append(sample(Candidate, **of, slot=2, provider="text_to_3d", outcome="empty", asset_id=None, is_fallback=True))
    rows["selections"].append(sample(Selection, **of, rank=1, slot=1, asset_id=asset, score=0.75))
    rows["placements"].append(placement)
    rows["supports"].append(sample(Support, **of, relation="floor", gap_m=0.0, is_fixed=index == 0, is_kept=True))
    moved = 0.5 if index == 3 else 0.001
    problem = "its pieces have no volume" if index == 0 else None
    rows["certificates"].append(
        sample(
            Certificate, **of, engine="mujoco", engine_version="4.0.0", is_fixed=index == 0, problem=problem,
            displacement_m=None if problem else moved, tilt_radians=None if problem else 0.1 * moved,
            start_penetration_m=None if problem else 0.0, is_stable_1cm=problem is None and moved <= 0.01,
            is_stable_5cm=problem is None and moved <= 0.05, nudged_displacement_m=None if problem else 1.5 * moved,
            nudged_tilt_radians=None if problem else 0.2 * moved, is_stable_nudged=problem is None and moved <= 0.005,
            is_density_plausible=True,
        )
    )  # fmt: skip
    return placed_parts(placement, glb)
