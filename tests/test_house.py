"""A furnished house made by others, scanned by the virtual scanner, through the whole path with a library by others."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.test_pipeline import home, metascenes  # noqa: F401
from warehouse.lake import Lake

pytestmark = [pytest.mark.slow, pytest.mark.realdata, pytest.mark.timeout(3600)]

SCENE = "house/house"


def box_iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two axis-aligned boxes, shape (2, 3) [m]."""
    inside = np.prod(np.clip(np.minimum(a[1], b[1]) - np.maximum(a[0], b[0]), 0, None))
    return float(inside / (np.prod(a[1] - a[0]) + np.prod(b[1] - b[0]) - inside))


def bounds_of(pose: list[float], size: list[float]) -> np.ndarray:
    """Axis-aligned bounds of an oriented box, shape (2, 3) [m]."""
    matrix = np.array(pose).reshape(4, 4)
    half = np.abs(matrix[:3, :3]) @ (np.array(size) / 2)
    return np.array([matrix[:3, 3] - half, matrix[:3, 3] + half])


@pytest.fixture(scope="module")
def house(home: dict[str, str], realdata: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:  # noqa: F811
    folder = tmp_path_factory.mktemp("house")
    source = realdata("scene_aws_small_house")
    scanned = metascenes(home, "scan", source / "house.glb", "--out", folder / "scans", "--voxel", 0.03, timeout=1800)
    assert scanned.returncode == 0, scanned.stderr
    options = ("--dataset", "house", "--library", realdata("assets"), "--lake", folder / "lake")
    done = metascenes(home, "run", "--scans", folder / "scans", *options, timeout=3000)
    assert done.returncode == 0, done.stderr
    return {"lake": folder / "lake", "truth": source / "house.json", "scan": folder / "scans" / "house.truth.json", "folder": folder}


def matched(house: dict[str, Path]) -> list[tuple[dict, dict, float]]:
    """Objects of the house that were seen well, each with the instance whose box overlaps it most."""
    connection = Lake.open(house["lake"]).snapshot().connect()
    rows = connection.execute("SELECT instance_id, category, box_pose, box_size FROM instances WHERE NOT is_structure").fetchall()
    instances = [{"instance_id": i, "category": c, "bounds": bounds_of(p, s)} for i, c, p, s in rows]
    seen = {obj["name"]: obj for obj in json.loads(house["scan"].read_text())["objects"] if obj["observed"] >= 0.8}
    pairs = []
    for obj in json.loads(house["truth"].read_text()):
        if obj["name"] not in seen or seen[obj["name"]]["object_id"] is None:
            continue
        bounds = np.array(obj["bounds"])
        if (bounds[1] - bounds[0]).max() > 6:  # the shell
            continue
        best = max(instances, key=lambda instance: box_iou(instance["bounds"], bounds))
        pairs.append((obj, best, box_iou(best["bounds"], bounds)))
    return pairs


def test_instances_lie_where_the_house_has_its_objects(house: dict[str, Path]) -> None:
    pairs = matched(house)
    assert len(pairs) >= 25
    overlaps = np.array([iou for _, _, iou in pairs])
    # Legs and edges thinner than the voxel are not in the scan, so axis-aligned boxes of chairs and frames come out short.
    assert np.median(overlaps) > 0.6
    assert (overlaps > 0.25).mean() > 0.9
    words = [(obj["category"], best["category"]) for obj, best, iou in pairs if iou > 0.4]
    same = [b in a or bool(set(a.split()) & set(b.split())) for a, b in words]  # the house says `foldingdoor`, `roomwindow`
    assert np.mean(same) > 0.95, words


def test_replicas_stand_where_the_objects_stood(house: dict[str, Path]) -> None:
    connection = Lake.open(house["lake"]).snapshot().connect()
    rows = connection.execute("SELECT instance_id, optimized_pose FROM placements").fetchall()
    placed = {row[0]: row for row in rows}
    off = []
    for obj, best, iou in matched(house):
        if iou < 0.4 or best["instance_id"] not in placed:
            continue
        pose = np.array(placed[best["instance_id"]][1]).reshape(4, 4)
        center = np.array(obj["bounds"]).mean(axis=0)
        off.append(np.linalg.norm(pose[:2, 3] - center[:2]))
    assert len(off) >= 20
    assert np.median(off) < 0.05
    assert np.mean(np.array(off) < 0.3) > 0.9


def test_walls_between_rooms_are_found_in_the_scan(house: dict[str, Path]) -> None:
    """As the model has them: two beside the folding doors, and one between the bedrooms that is no taller than a person."""
    connection = Lake.open(house["lake"]).snapshot().connect()
    ((walls,),) = connection.execute("SELECT interior_walls FROM shells").fetchall()
    truth = [(-2.6, -5.5, -2.6, -3.7, 0.2, 3.0), (-2.6, 1.3, -2.6, 3.1, 0.2, 3.0), (-8.3, -1.496, -3.89, -1.496, 0.105, 1.865)]
    found = [(*min(w[:2], w[2:4], key=sum), *max(w[:2], w[2:4], key=sum), *w[4:]) for w in walls]
    assert len(found) == len(truth)
    for expected in truth:
        assert min(np.abs(np.array(wall) - expected).max() for wall in found) < 0.05


def test_retrieval_finds_the_models_that_furnish_the_house(house: dict[str, Path], realdata: Callable[[str], Path]) -> None:
    """The library holds the very models: a good retrieval has the true one among its four."""
    connection = Lake.open(house["lake"]).snapshot().connect()
    rows = connection.execute("SELECT instance_id, list(name) FROM candidates JOIN assets USING (asset_id) GROUP BY instance_id").fetchall()
    names = {instance: [name.lower() for name in found] for instance, found in rows}
    library = {path.stem.lower() for path in realdata("assets").glob("*.glb")}
    hits = []
    for obj, best, iou in matched(house):
        model = obj["model"].replace("aws_robomaker_residential_", "aws_").lower()
        if iou > 0.4 and model in library and best["instance_id"] in names:
            hits.append(any(model in name for name in names[best["instance_id"]]))
    assert len(hits) >= 15
    assert np.mean(hits) > 0.6


def test_exports_of_the_house_pass_their_gates(house: dict[str, Path], home: dict[str, str]) -> None:  # noqa: F811
    out = house["folder"] / "out"
    done = metascenes(home, "export", "--lake", house["lake"], "--out", out, timeout=600)
    assert done.returncode == 0, done.stderr
    moved = house["folder"] / "moved"
    (out / "usd").rename(moved)
    scene = next(moved.glob("*/scene.usda"))
    check = subprocess.run([sys.executable, "-m", "flows.cli", "doctor", "usd", str(scene)], capture_output=True, text=True, env=home)
    assert check.returncode == 0, check.stdout
