"""Copies of scans: a whole one is the same scene, a broken one is left out, and the scan itself runs."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.run.configuration import configure
from flows.run.fingerprints import FileHashes
from flows.run.plan import Plan, make_plan
from schemas.capture import Scene
from tasks.capture.formats import find_scans
from tests.capture_scans import box_room, write_posed_rgbd
from tests.samples import sample, stage_run
from tests.scans import write_scan
from tests.tasks.capture.discovery.test_search import OBJ, PLY, glb, put
from warehouse.lake import Lake


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return Lake.open(tmp_path / "lake")


def planned(lake: Lake, folder: Path) -> Plan:
    return make_plan(lake, *find_scans(folder), configure(), hashes=FileHashes(folder.parent / "hashes.json"))


def arkit(path: Path) -> None:
    put(path / f"{path.name}_3dod_mesh.ply", PLY + b"x" * 100)
    put(path / f"{path.name}_3dod_annotation.json", b"{}")


KINDS: dict[str, Callable[[Path], object]] = {
    "scene0001_00": lambda path: write_scan(path.parent, path.name),
    "hall": lambda path: write_posed_rgbd(path, box_room(cameras=2)),
    "41069021": arkit,
    "attic.ply": lambda path: put(path, PLY + b"x" * 100),
    "cellar.glb": glb,
    "bath": lambda path: put(path / "room.obj", OBJ),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("ending", [" (copy)", " (1)", "_backup"])
def test_a_copy_is_the_same_scene(name: str, ending: str, lake: Lake, tmp_path: Path) -> None:
    """`cp -r scan "scan (copy)"` leaves the scan alone, and says which folder is a copy."""
    place = tmp_path / "scans"
    KINDS[name](place / name)
    put(place / "other.ply", PLY + b"other")
    before = planned(lake, place)
    stem, dot, suffix = name.partition(".")
    copy = place / f"{stem}{ending}{dot}{suffix}"
    (shutil.copytree if (place / name).is_dir() else shutil.copy)(place / name, copy)
    plan = planned(lake, place)
    assert [scene.scan.scene_id for scene in plan.scenes] == [scene.scan.scene_id for scene in before.scenes]
    assert plan.unusable == ()
    assert len(plan.same) == 1
    assert set(plan.same.values()) < {scene.scan.scene_id for scene in plan.scenes}


def cut_file(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def half(path: Path) -> None:
    """Half a copy: of several files the last are missing and one is cut; a single one is cut."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    cut_file(files[0])
    for file in files[1:]:
        if file.suffix in (".jpg", ".png", ".txt") and "0." not in file.name:
            file.unlink()


@pytest.mark.parametrize("name", [name for name in KINDS if name != "scene0001_00"])
def test_half_a_copy_is_left_out_and_named(name: str, lake: Lake, tmp_path: Path) -> None:
    place = tmp_path / "scans"
    KINDS[name](place / name)
    put(place / "other.ply", PLY + b"other")
    before = planned(lake, place)
    stem, dot, suffix = name.partition(".")
    copy = place / f"{stem} (copy){dot}{suffix}"
    (shutil.copytree if (place / name).is_dir() else shutil.copy)(place / name, copy)
    half(copy)
    plan = planned(lake, place)
    assert [scene.scan for scene in plan.scenes] == [scene.scan for scene in before.scenes]
    (error,) = plan.unusable
    whole = next(scene.scan.scene_id for scene in plan.scenes if "other" not in scene.scan.scene_id)
    assert str(error) == f"{copy.name}: files: are an incomplete copy of {whole}; delete them, or copy them again"


def test_half_a_copy_of_a_scan_whose_files_bear_its_name_is_left_out(lake: Lake, tmp_path: Path) -> None:
    place = tmp_path / "scans"
    write_scan(place, "scene0001_00")
    copy = Path(shutil.copytree(place / "scene0001_00", place / "backup"))
    cut_file(copy / "scene0001_00_vh_clean_2.ply")
    (copy / "scene0001_00.aggregation.json").unlink()
    plan = planned(lake, place)
    assert [scene.scan.scene_id for scene in plan.scenes] == ["scannet/scene0001_00"]
    assert [error.problem for error in plan.unusable] == ["are an incomplete copy of scannet/scene0001_00"]


@pytest.mark.parametrize("name", ["hall_short", "hall2"])
def test_a_part_of_a_scan_under_a_name_of_its_own_is_a_scan(name: str, lake: Lake, tmp_path: Path) -> None:
    """Fewer frames may be meant so: only a name that says copy makes a copy."""
    place = tmp_path / "scans"
    write_posed_rgbd(place / "hall", box_room(cameras=2))
    part = Path(shutil.copytree(place / "hall", place / name))
    for file in part.rglob("1.*"):
        file.unlink()
    plan = planned(lake, place)
    assert plan.unusable == ()
    assert [scene.scan.scan for scene in plan.scenes] == ["hall", name]


def test_two_scans_of_one_name_and_other_content_are_two_scenes(lake: Lake, tmp_path: Path) -> None:
    for number, folder in enumerate("ab"):
        put(tmp_path / "scans" / folder / "room.ply", PLY + str(number).encode())
        put(tmp_path / "scans" / folder / "hall.ply", PLY + str(number + 5).encode())
    plan = planned(lake, tmp_path / "scans")
    assert len({scene.scan.scene_id for scene in plan.scenes}) == 4
    assert plan.unusable == ()


def test_the_lake_and_a_new_scan_share_no_folder_on_any_system(lake: Lake, tmp_path: Path) -> None:
    put(tmp_path / "first" / "Living Room.ply", PLY + b"the first")
    put(tmp_path / "first" / "b.ply", PLY + b"b")
    for scene in planned(lake, tmp_path / "first").scenes:
        blob, scan = lake.blobs.put(b"mesh", "glb"), scene.scan
        row = dataclasses.replace(sample(Scene, scene_id=scan.scene_id, dataset=scan.dataset, scan=scan.scan), mesh_blob=blob)
        step = scene.steps[0]
        lake.stage_rows(stage_run(scan.scene_id, "capture", step.fingerprint.value, reasons=step.fingerprint.parts), {"scenes": [row]})
    lake.commit()
    put(tmp_path / "second" / "living room.ply", PLY + b"another")
    put(tmp_path / "second" / "c.ply", PLY + b"c")
    plan = planned(lake, tmp_path / "second")
    names = {scene.scan.scan: scene.scan.scene_id for scene in plan.scenes}
    assert names["living room"].startswith("mesh/living_room-")
    assert names["c"] == "mesh/c"
    shutil.copy(tmp_path / "first" / "Living Room.ply", tmp_path / "second" / "LIVING ROOM.ply")
    again = planned(lake, tmp_path / "second")
    assert "mesh/Living_Room" in {scene.scan.scene_id for scene in again.scenes}, "the same content is the scene of the lake"
    assert len({scene.scan.scene_id.casefold() for scene in again.scenes}) == 3
