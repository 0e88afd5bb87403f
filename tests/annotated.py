"""A lake with scenes to annotate, and simulated annotators who answer what a batch asks."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from flows.inputs.annotation import BatchPlan, batch_list, create_batch
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene, Shell
from schemas.selection import Selection
from tasks.geometry.meshes import dump_glb, dump_points
from tasks.geometry.transforms import flat, translation
from tests.samples import START, fingerprint, sample, stage_run
from warehouse.lake import Lake

SCENES = ("demo/room_a", "demo/room_b")
SQUARE = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))
ANNOTATORS = ("ada", "bob", "cleo")
SIDES = (0.4, 0.5, 0.6)
"""Edges of the cubes that are candidates, by slot [m]."""


def objects_of(count: int) -> list[str]:
    return [f"{number:04d}" for number in range(1, count + 1)]


def annotatable(folder: Path, objects: int = 4, scenes: Sequence[str] = SCENES) -> Lake:
    """A lake of rooms, each with a wall and with objects in a row: cubes of half a metre, scanned, with three cubes as candidates."""
    lake = Lake.open(folder)
    assets = []
    for side in SIDES:
        part = trimesh.creation.box((side, side, side))
        part.apply_translation([0, 0, side / 2])
        part.visual.vertex_colors = np.full((8, 4), 180, dtype=np.uint8)
        glb = dump_glb([part])
        blob = lake.blobs.put(glb, "glb")
        assets.append(
            sample(
                Asset, asset_id=blob.partition(".")[0], mesh_blob=blob, extents=(side, side, side), category="box", name=f"cube {side}",
                volume_m3=side**3, is_watertight=True, vertex_count=8, face_count=12,
            )
        )  # fmt: skip
    for scene in scenes:
        instances, candidates, selections = [], [], []
        for number, name in enumerate(objects_of(objects)):
            place = translation([-2.0 + 0.8 * (number % 6), -2.0 + 0.8 * (number // 6), 0.25])
            cube = trimesh.creation.box((0.5, 0.5, 0.5)).apply_transform(place)
            points = dump_points(cube.sample(200, seed=number), np.full((200, 3), 90, dtype=np.uint8))
            of = {"scene_id": scene, "instance_id": name}
            instances.append(
                sample(
                    Instance, **of, category="box", is_structure=False, box_pose=flat(place), box_size=(0.5, 0.5, 0.5), box_volume_m3=0.125,
                    points_blob=lake.blobs.put(points, "ply"),
                )
            )  # fmt: skip
            for slot, asset in enumerate(assets, 1):
                named = {"slot": slot, "asset_id": asset.asset_id}
                candidates.append(sample(Candidate, **of, **named, provider="procedural", outcome="filled"))
                pose = flat(place @ translation([0, 0, -0.25]))
                score = (0.6, 0.9, 0.3)[slot - 1]
                selections.append(sample(Selection, **of, **named, rank=(2, 1, 3)[slot - 1], score=score, pose=pose, scale=(1.0, 1.0, 1.0)))
        wall = sample(Instance, scene_id=scene, instance_id="9999", is_structure=True, points_blob=instances[0].points_blob)
        shell = sample(Shell, scene_id=scene, floor_polygon=SQUARE, walls=(), interior_walls=(), height_m=2.5)
        whole = sample(
            Scene, scene_id=scene, scan=scene.partition("/")[2], room_id=scene, alignment=flat(np.eye(4)), mesh_blob=assets[0].mesh_blob
        )
        runs = {
            "capture": {"scenes": [whole], "instances": [*instances, wall], "shells": [shell]},
            "candidates": {"candidates": candidates, "assets": assets},
            "selection": {"selections": selections},
        }
        for stage, rows in runs.items():
            lake.stage_rows(stage_run(scene, stage, fingerprint(scene, stage)), rows)
    lake.commit("rooms")
    return lake


def created(lake: Lake, out: Path, batch: str = "b1", overlap: int = 1, **plan: Any) -> dict[str, Any]:
    """A batch of the annotators, and its folder."""
    return create_batch(lake, BatchPlan(batch, ANNOTATORS, overlap, **plan), out)


def state(lake: Lake, batch: str = "b1") -> str:
    """What a batch is at."""
    (row,) = batch_list(lake, batch)
    return str(row["state"])


def answer(scene: str, instance: str, annotator: str, choice: int | None, at: float = 0.0, **values: Any) -> dict[str, Any]:
    """An answer as its JSON has it, `at` hours after the start."""
    given = {"scene_id": scene, "instance_id": instance, "annotator": annotator, "choice": choice, "simulated": True}
    return given | {"answered_at": (START + timedelta(hours=at)).isoformat()} | values


def fill(
    folder: Path, rng: np.random.Generator, errs: Sequence[str] = (), share: float = 0.3, at: float = 0.0
) -> dict[tuple[str, str, str], bool]:
    """Simulated annotators answer all that the folder of a batch asks: the second candidate, aligned, and a ranking. Those who err give
    the third on a `share` of their objects. Whether each answer is right, by scene, instance and annotator."""
    work = json.loads((folder / "work.json").read_text())
    right = {}
    for one in work["annotators"]:
        answers = []
        name = one["annotator"]
        wrong = set(rng.permutation(len(one["objects"]))[: round(share * len(one["objects"]))]) if name in errs else set()
        for index, asked in enumerate(one["objects"]):
            right[asked["scene_id"], asked["instance_id"], name] = index not in wrong
            ranking = [3, 1] if index in wrong else [2, 1, 3]
            answers.append(
                answer(
                    **{key.partition("_")[0]: value for key, value in asked.items()},
                    annotator=name,
                    choice=ranking[0],
                    at=at,
                    ranking=ranking,
                    seconds=12.5,
                )
            )
        file = folder / one["answers"]
        file.write_text(json.dumps(json.loads(file.read_text()) | {"annotations": answers, "tool": "simulated crowd"}))
    return right


def judged(rows: Sequence[dict[str, Any]], right: dict[tuple[str, str, str], bool], batch: str, reviewer: str = "rita") -> dict[str, Any]:
    """Verdicts of a simulated reviewer who sees what is wrong."""
    given = []
    for row, number in zip(rows, itertools.count()):
        passes = right[row["scene_id"], row["instance_id"], row["annotator"]]
        moment = (START + timedelta(days=30, seconds=number)).isoformat()
        given.append(
            {key: row[key] for key in ("scene_id", "instance_id", "annotator")}
            | {"passes": passes, "reviewed_at": moment}
            | ({} if passes else {"remark": "too large"})
        )
    return {"batch_id": batch, "reviewer": reviewer, "simulated": True, "verdicts": given}


def chance_of_return(wrong: int, sampled: int, answers: int, pass_share: float) -> float:
    """How likely a batch with so many wrong answers is returned: that too few of a sample pass."""
    from scipy.stats import hypergeom

    most = next((failed for failed in range(sampled + 1) if sampled - failed - pass_share * sampled <= 1e-9), sampled + 1)
    return float(hypergeom.sf(most - 1, answers, wrong, sampled))
