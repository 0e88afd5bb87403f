"""A small lake whose rooms are annotated: a table, a box over it, more beside it; ten candidates each, points, a photo, its camera."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from flows.inputs.annotation import BatchPlan, create_batch
from schemas.candidates import Asset, Candidate
from schemas.capture import Frame, Instance, Room, Scene, Shell
from schemas.selection import Selection
from tasks.geometry.meshes import dump_glb, dump_points
from tasks.geometry.transforms import flat, translation, yaw_pose
from tests.flows.view.lakes import EVIL
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake

BATCH, SCENES = "batch-1", ("demo/room_a", "demo/room_b")
RING = ((-2.5, -2.5), (2.5, -2.5), (2.5, 2.5), (-2.5, 2.5))
TABLE_M = 0.5
"""Height of the table's top; the box of object 0002 was scanned 0.2 m above it."""

OBJECTS: tuple[tuple[str, tuple[float, float, float], tuple[float, float, float]], ...] = (
    ("table", (1.0, 1.0, TABLE_M), (0.0, 0.0, 0.0)),
    ("box", (0.3, 0.3, 0.3), (0.0, 0.0, TABLE_M + 0.2)),
    ("box", (0.4, 0.4, 0.4), (1.5, 0.0, 0.0)),
    (EVIL, (0.4, 0.5, 0.6), (-1.5, 0.0, 0.0)),
)
"""Category, size and bottom center of the objects of a room [m]."""

SLOTS = 10
EYE = translation((0.0, -4.0, 1.0))
"""Where the best views were taken; the camera looks along +y."""

SIDE, SIDE_COLOR = translation((4.0, 0.0, 1.0)), (30, 160, 60)
"""Where another photo of all was taken, whose picture is with the scan; the camera looks along -x."""


def asked_lake(folder: Path, annotators: tuple[str, ...] = ("ada", "bob"), overlap: int = 2, scenes: tuple[str, ...] = SCENES) -> Lake:
    """The lake, with the batch `BATCH` of all objects of some scenes."""
    lake = Lake.open(folder / "lake")
    assets = [_asset(lake, slot) for slot in range(1, SLOTS + 1)]
    for scene in scenes:
        _stage(lake, folder / "scans" / scene.partition("/")[2], scene, assets)
    lake.commit("rooms")
    create_batch(lake, BatchPlan(BATCH, annotators, overlap), folder / "work")
    return lake


def _asset(lake: Lake, slot: int) -> Asset:
    """A box whose bottom center is the origin, of another height each."""
    height = 0.5 + 0.1 * slot
    part = trimesh.creation.box((1.0, 1.0, height))
    part.apply_translation([0, 0, height / 2])
    part.visual.vertex_colors = np.tile((60 + 15 * slot, 120, 200 - 12 * slot, 255), (8, 1)).astype(np.uint8)
    blob = lake.blobs.put(dump_glb([part]), "glb")
    return sample(
        Asset, asset_id=blob.partition(".")[0], mesh_blob=blob, pieces_blob=None, extents=(1.0, 1.0, height), category="box",
        name=f"{EVIL} {slot}", volume_m3=height, is_watertight=True, vertex_count=8, face_count=12, license="CC0-1.0",
    )  # fmt: skip


def _stage(lake: Lake, scan: Path, scene: str, assets: list[Asset]) -> None:
    (scan / "color").mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (64, 48), SIDE_COLOR).save(scan / "color" / "1.png")
    rows: dict[type, list[Any]] = {kind: [] for kind in (Instance, Candidate, Selection)}
    solids = []
    photo = io.BytesIO()
    Image.new("RGB", (64, 48), (120, 90, 60)).save(photo, "JPEG")
    for number, (category, size, place) in enumerate(OBJECTS, 1):
        of = {"scene_id": scene, "instance_id": f"{number:04d}"}
        pose = translation(np.add(place, (0.0, 0.0, size[2] / 2)))
        solid = trimesh.creation.box(size).apply_transform(pose)
        solid.visual.vertex_colors = np.full((8, 4), 150, dtype=np.uint8)
        solids.append(solid)
        points = dump_points(solid.sample(300, seed=number), np.full((300, 3), 90, dtype=np.uint8))
        rows[Instance].append(
            sample(
                Instance, **of, category=category, raw_label=category, is_structure=False, box_pose=flat(pose), box_size=size,
                box_volume_m3=float(np.prod(size)), points_blob=lake.blobs.put(points, "ply"), mesh_blob=None, hidden_m=None,
                view_blob=lake.blobs.put(photo.getvalue(), "jpg"), best_frames=("000000", "000001"),
            )
        )  # fmt: skip
        for slot, asset in enumerate(assets, 1):
            chosen = {"slot": slot, "asset_id": asset.asset_id}
            rows[Candidate].append(sample(Candidate, **of, **chosen, provider="procedural", outcome="filled", is_fallback=False))
            scale = tuple(float(length) for length in np.divide(size, asset.extents))
            rows[Selection].append(
                sample(Selection, **of, **chosen, rank=slot, score=1.0 - 0.05 * slot, pose=flat(yaw_pose(0.0, place)), scale=scale)
            )
    eye, side = EYE.copy(), SIDE.copy()
    eye[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    side[:3, :3] = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]])
    whole = lake.blobs.put(dump_glb(solids), "glb")
    walls = tuple((*a, *b) for a, b in zip(RING, RING[1:] + RING[:1], strict=True))
    outputs = {
        "capture": {
            "scenes": [
                sample(
                    Scene, scene_id=scene, scan=scan.name, room_id=scene, alignment=flat(np.eye(4)), mesh_blob=whole, scan_path=str(scan)
                )
            ],
            "instances": rows[Instance], "masks": [], "surfaces": [],
            "shells": [
                sample(
                    Shell, scene_id=scene, floor_polygon=RING, walls=walls, interior_walls=(), height_m=2.5, openings=None, slopes=None,
                        lintels=None
                )
            ],
            "rooms": [sample(Room, scene_id=scene, room_index=0, floor_polygon=RING)],
            "frames": [
                sample(
                    Frame, scene_id=scene, frame_id=f"{number:06d}", color_file=f"color/{number}.{ending}", depth_file=None, width=64,
                    height=48, intrinsics=(60.0, 60.0, 32.0, 24.0), pose=flat(pose),
                )
                for number, (pose, ending) in enumerate(((eye, "jpg"), (side, "png")))
            ],
        },
        "candidates": {"candidates": rows[Candidate], "assets": assets},
        "selection": {"selections": rows[Selection]},
    }  # fmt: skip
    for stage, tables in outputs.items():
        lake.stage_rows(stage_run(scene, stage, fingerprint(scene, stage)), tables)
