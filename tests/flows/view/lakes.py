"""A small lake with all that the viewer shows: two rooms, two candidates an object, masks with their frame, colliders, an episode."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask, Room, Scene, Shell
from schemas.exports import ExportFile
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Certificate, Contact, Optimization, Placement, Support
from schemas.robot import RobotRun
from schemas.selection import Selection
from tasks.geometry.meshes import dump_glb
from tasks.geometry.transforms import flat, translation, yaw_pose
from tasks.shell import room_shell
from tests.furnished import floor_navmesh, solid
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake

EVIL = '</script><img src=x onerror="window.hacked=1"><b>&amp;\'`${window.hacked=1}'
"""A label as somebody writes it who wants the page to run it."""

OBJECTS = 4
SCENES = ("demo/room_0", "demo/room_1")
FRAME_PX = (64, 48)
STAGES = ("capture", "captions", "candidates", "selection", "optimization", "navigation", "exports")
UNSTABLE, PROPOSED_SHIFT_M, SETTLED_SHIFT_M = "0002", 0.4, 0.1
ACTIONS = ("forward", "forward", "left", "forward", "stop")
TRACK = ((1.5, 2.0, 0.0), (2.0, 2.0, 0.2), (2.2, 2.1, 0.4))


def shown_lake(folder: Path, note: str = "two rooms") -> Lake:
    """The lake, committed; scans lie beside it in `scans`. Labels of the second scene are `EVIL`."""
    lake = Lake.open(folder / "lake")
    for number, scene_id in enumerate(SCENES):
        _stage(lake, folder / "scans" / f"room_{number}", scene_id, number)
    lake.commit(note)
    return lake


def place(index: int) -> np.ndarray:
    """Where an object of a scene was optimized to, 4x4."""
    return yaw_pose(0.3 * index, (0.8 + 1.0 * index, 0.9 + 0.4 * (index % 2), 0.0))


def _stage(lake: Lake, scan: Path, scene_id: str, number: int) -> None:
    label = EVIL if number else ""
    (scan / "color").mkdir(parents=True)
    Image.fromarray(np.full((FRAME_PX[1], FRAME_PX[0], 3), (40, 90, 160), dtype=np.uint8)).save(scan / "color" / "0.jpg")
    ring = ((0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0))
    room = sample(
        Shell, scene_id=scene_id, room_type="office", floor_polygon=ring, floor_area_m2=15.0, height_m=2.5, interior_walls=(),
        openings=None,        walls=tuple((*a, *b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)), slopes=None, lintels=None,
        floor_color=(150, 120, 90), wall_color=(210, 205, 195),
    )  # fmt: skip
    kinds = (Instance, Caption, Candidate, Asset, Selection, Placement, Support, Certificate, Mask)
    rows: dict[type, list[Any]] = {kind: [] for kind in kinds}
    solids = [_stage_object(lake, rows, scene_id, index, label) for index in range(OBJECTS)]
    scanned = lake.blobs.put(dump_glb([*(mesh for _, mesh in room_shell(room)), *solids]), "glb")
    frame = sample(
        Frame, scene_id=scene_id, frame_id="000000", color_file="color/0.jpg", depth_file=None, width=FRAME_PX[0], height=FRAME_PX[1]
    )
    contact = {"scene_id": scene_id, "is_allowed": False}
    final = (1.5 + 2 * 0.25 + 0.25 * math.cos(math.pi / 6), 2.0 + 0.25 * math.sin(math.pi / 6), 0.0)
    outputs: dict[str, dict[str, list[Any]]] = {
        "capture": {
            "scenes": [
                sample(
                    Scene, scene_id=scene_id, room_id=scene_id, mesh_blob=scanned, instance_count=OBJECTS, scan_path=str(scan), license=None
                )
            ],
            "shells": [room], "rooms": [sample(Room, scene_id=scene_id, room_index=0, floor_polygon=ring)], "frames": [frame],
            "instances": rows[Instance], "masks": rows[Mask], "surfaces": [],
        },
        "captions": {"captions": rows[Caption]},
        "candidates": {"candidates": rows[Candidate], "assets": rows[Asset]},
        "selection": {"selections": rows[Selection]},
        "optimization": {
            "placements": rows[Placement], "supports": rows[Support], "certificates": rows[Certificate], "optimization_steps": [],
            "contacts": [
                sample(Contact, **contact, phase="proposed", instance_a="0000", body_b="0001", penetration_m=0.05),
                sample(Contact, **contact, phase="proposed", instance_a="0002", body_b="wall_00", penetration_m=0.001),
                sample(Contact, **contact, phase="optimized", instance_a="0001", body_b="0003", penetration_m=0.0),
            ],
            "optimizations": [
                sample(Optimization, scene_id=scene_id, object_count=OBJECTS, loss_start=0.05, loss_final=0.0, deep_pairs=0, remains=())
            ],
        },
        "navigation": {
            "navmeshes": [
                sample(
                    Navmesh, scene_id=scene_id, agent="stretch", agent_radius_m=0.18, agent_height_m=0.9,
                    navmesh_blob=lake.blobs.put(floor_navmesh(), "navmesh"), area_m2=6.0, largest_island_m2=6.0,
                )
            ],
            "episodes": [
                sample(
                    Episode, scene_id=scene_id, episode_id="0000", agent="stretch", instance_id="0001",
                    instruction=label or "Find the table",
                    start_position=(1.5, 2.0, 0.0), start_yaw_radians=0.0, goal_position=final,
                    actions=ACTIONS, final_position=final,
                    path=((1.5, 2.0), final[:2]), geodesic_m=0.72,
                )
            ],
            "unreachable_targets": [], "splits": [],
        },
        "exports": {"export_files": _exported(lake, scene_id), "export_checks": []},
    }  # fmt: skip
    for index, stage in enumerate(STAGES):
        above = [f"{s}={fingerprint(scene_id, s)}" for s in STAGES[:index]]
        lake.stage_rows(stage_run(scene_id, stage, fingerprint(scene_id, stage), *above), outputs[stage])
    batch = f"drive-{scene_id.replace('/', '-')}"
    driven = sample(
        RobotRun, batch_id=batch, scene_id=scene_id, episode_id="0000", instance_id="0001", policy=label or "expert", run_name="built-in",
        setup="", body="planar", outcome="arrived", problem=None, radius_m=0.17, category="table", seconds=8.0, error_m=0.004,
        subgoals=((2.0, 2.0), final[:2]), times=(0.0, 4.0, 8.0), track=TRACK, clearances=(0.3, 0.2, 0.3),
        estimate=((1.52, 2.0, 0.0), *TRACK[1:]),
    )  # fmt: skip
    lake.stage_rows(stage_run(batch, "robot", fingerprint(scene_id, "robot")), {"robot_runs": [driven]})


def _stage_object(lake: Lake, rows: dict[type, list[Any]], scene_id: str, index: int, label: str) -> Any:
    """Rows of one object; what the scan has of it."""
    key = f"{index:04d}"
    of = {"scene_id": scene_id, "instance_id": key}
    pose, category = place(index), label or ("chair", "table", "lamp", "box")[index]
    blobs = [lake.blobs.put(dump_glb([solid(index + shape)]), "glb") for shape in (0, 10)]
    photo = io.BytesIO()
    Image.new("RGB", (32, 24), (120 + 20 * index, 80, 60)).save(photo, "JPEG")
    rows[Instance].append(
        sample(
            Instance, **of, raw_label=category, category=category, is_structure=False, hidden_m=(0.0,) * 6, box_size=(0.6, 0.5, 0.8),
            box_pose=flat(pose @ translation((0.0, 0.0, 0.4))), points_blob=lake.blobs.put(b"points", "ply"), mesh_blob=None,
            view_blob=lake.blobs.put(photo.getvalue(), "jpg"), best_frames=("000000",),
        )
    )  # fmt: skip
    x = 4 + 14 * index
    rows[Mask].append(sample(Mask, **of, frame_id="000000", pixel_box=(x, 8, x + 10, 28), pixel_count=100, run_lengths=tuple([5, 5] * 20)))
    rows[Caption].append(sample(Caption, **of, sentence=f"A {category}.", mass_kg=1.5 + index))
    for slot, blob in enumerate(blobs, 1):
        asset = blob.split(".")[0]
        if all(row.asset_id != asset for row in rows[Asset]):
            rows[Asset].append(
                sample(
                    Asset, asset_id=asset, name=label or f"model {slot}", category=category, mesh_blob=blob, pieces_blob=None,
                    license="CC0-1.0", source="library", author=label or "A. Maker",
                )
            )  # fmt: skip
        rows[Candidate].append(
            sample(Candidate, **of, slot=slot, provider="library", outcome="filled", asset_id=asset, is_fallback=False, reason=None)
        )
        rows[Selection].append(
            sample(
                Selection, **of, rank=slot, slot=slot, asset_id=asset, score=0.9 / slot, scale=(1.0, 1.0, 1.0),
                pose=flat(translation((0.0, 0.1 * slot, 0.0)) @ pose),
            )
        )  # fmt: skip
    rows[Candidate].append(
        sample(
            Candidate, **of, slot=3, provider="text_to_3d", outcome="empty", asset_id=None, is_fallback=False, reason=label or "no endpoint"
        )
    )
    moved, settled = (translation((shift, 0.0, 0.0)) @ pose for shift in (-PROPOSED_SHIFT_M, SETTLED_SHIFT_M if key == UNSTABLE else 0.0))
    rows[Placement].append(
        sample(
            Placement, **of, asset_id=blobs[0].split(".")[0], origin="selection", annotator=None, scale=(1.0, 1.0, 1.0),
            proposed_pose=flat(moved), optimized_pose=flat(pose), settled_pose=flat(settled), method="default",
            remains=(label or "left alone it moves") if key == UNSTABLE else None,
        )
    )  # fmt: skip
    carried = {"relation": "on", "parent_id": "0001"} if index == 3 else {"relation": "floor", "parent_id": None}
    rows[Support].append(sample(Support, **of, **carried, against=None, is_fixed=False, is_kept=True))
    rows[Certificate].append(
        sample(
            Certificate, **of, engine="mujoco", problem=None, is_fixed=False, displacement_m=0.1 if key == UNSTABLE else 0.0,
            tilt_radians=0.0, is_stable_1cm=key != UNSTABLE, is_stable_5cm=key != UNSTABLE, is_stable_nudged=key != UNSTABLE,
            simulated_seconds=2.0,
        )
    )  # fmt: skip
    scanned = solid(index)
    scanned.apply_transform(pose)
    return scanned


def _exported(lake: Lake, scene_id: str) -> list[Any]:
    """A Habitat export as far as the viewer reads it: the last object has no template."""
    name = scene_id.replace("/", "_")
    collider = lake.blobs.put(dump_glb([solid(0), solid(1)]), "glb")
    placed = [
        {"template_name": f"{name}_{index:04d}", "user_defined": {"instance_id": f"{index:04d}"}} for index in range(OBJECTS)
    ]  # fmt: skip
    files = {f"scenes/{name}.scene_instance.json": ("scene", json.dumps({"object_instances": placed}).encode(), "json")}
    for index in range(OBJECTS - 1):
        config = json.dumps({"collision_asset": "pieces.collider.glb"}).encode()
        files[f"objects/{name}_{index:04d}.object_config.json"] = ("object", config, "json")
    rows = [
        sample(ExportFile, scene_id=scene_id, format="habitat", path=path, role=role, file_blob=lake.blobs.put(data, kind), passed=True)
        for path, (role, data, kind) in files.items()
    ]
    of = {"scene_id": scene_id, "format": "habitat", "role": "collision", "passed": True}
    return [*rows, sample(ExportFile, **of, path="objects/pieces.collider.glb", file_blob=collider)]
