"""Folders of storeys over runs: bad scans stop no other, nothing is half there or there twice, and what is not ours is left alone."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flows.commands.storeys import command
from flows.scans import storeys as writing
from flows.scans.storeys import ScanStoreys, divide_scans
from tasks.capture import CaptureConfig
from tasks.capture.formats import find_scans
from tasks.capture.layout import STOREYS_RECORD as RECORD
from tasks.capture.storeys.levels import StoreyConfig
from tasks.geometry.meshes import Surface, dump_glb, union_of
from tests.capture_scans import BoxRoom, ply_bytes, write_scannet
from tests.flows.scans.test_storeys import HOUSE, divide, tree
from tests.tasks.capture.storeys.houses import house_of


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Three scans: a house, a flat, and one that is cut."""
    folder = tmp_path / "scans"
    folder.mkdir()
    (folder / "house.ply").write_bytes(ply_bytes(HOUSE.surface))
    (folder / "flat.ply").write_bytes(ply_bytes(house_of(1, (6.0, 7.0), 2.5, 0.3).surface))
    (folder / "broken.ply").write_bytes(ply_bytes(HOUSE.surface)[:-100])
    return folder


def test_one_bad_scan_stops_no_other_and_one_of_one_storey_stays_where_it_is(tmp_path: Path, scans: Path) -> None:
    rows = {row.scene_id: row for row in divide(scans, tmp_path / "out")}
    assert {name: row.action for name, row in rows.items()} == {"mesh/broken": "failed", "mesh/flat": "whole", "mesh/house": "divided"}
    assert rows["mesh/broken"].error.startswith("scans/broken.ply: element face: declares")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]


def test_a_storey_with_nothing_of_its_own_is_refused_and_stops_no_other(tmp_path: Path, scans: Path) -> None:
    """All of it is of instances that are mostly below."""
    whole = BoxRoom(HOUSE.surface, np.zeros_like(HOUSE.instance), ("chair",), ())
    write_scannet(tmp_path / "named" / "scene0000_00", whole, frames="none")
    (tmp_path / "drawn").mkdir()
    upper = (HOUSE.storey == 1)[HOUSE.surface.faces].all(axis=1)
    lower = Surface(HOUSE.surface.vertices, HOUSE.surface.faces[~upper], HOUSE.surface.colors)
    nodes = [  # every sixth face of the upper floor, and of the lower all
        union_of([lower, Surface(HOUSE.surface.vertices, HOUSE.surface.faces[upper][k::6], HOUSE.surface.colors)]).to_trimesh()
        for k in range(6)
    ]
    (tmp_path / "drawn" / "one.glb").write_bytes(dump_glb(nodes, [f"thing{k}|chair|0" for k in range(6)]))
    found = [scan for place in ("named", "drawn/one.glb", "scans") for scan in find_scans(tmp_path / place)[0]]
    rows = {row.scene_id: row for row in divide_scans(found, tmp_path / "out", CaptureConfig())}
    assert rows["mesh/house"].action == "divided"
    for scene, name in (("scannet/scene0000_00", "scene0000_00"), ("glb/one", "one.glb")):
        assert (rows[scene].error or "").startswith(f"{name}: instances: storey 1 has none of its own: "), rows[scene]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]


def test_what_nobody_foresaw_stops_no_other(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tasks.capture.storeys import splitting

    layout_of, calls = splitting.layout_of, iter([True])
    (scans / "house2.ply").write_bytes((scans / "house.ply").read_bytes())

    def odd(*given: object) -> object:
        if next(calls, False):
            raise ZeroDivisionError("of a scan")
        return layout_of(*given)

    monkeypatch.setattr(splitting, "layout_of", odd)
    rows = {row.scene_id: row for row in divide(scans, tmp_path / "out")}
    assert "ZeroDivisionError: of a scan" in rows["mesh/house"].error
    assert rows["mesh/house2"].action == "divided"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house2"]


def test_the_same_scan_gives_the_same_bytes_and_is_divided_once(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    divide(scans, tmp_path / "out")
    divide(scans, tmp_path / "other")
    made = tree(tmp_path / "out")
    assert made == tree(tmp_path / "other")
    assert sorted(made) == ["house/house_floor0/house_floor0.ply", "house/house_floor1/house_floor1.ply", f"house/{RECORD}"]
    monkeypatch.setattr(writing, "_write", lambda *_: pytest.fail("it was there already"))
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert (row.action, row.folders) == ("unchanged", ("house/house_floor0", "house/house_floor1"))
    assert tree(tmp_path / "out") == made


def test_a_scan_that_changed_is_divided_anew_and_takes_the_place_of_the_former(tmp_path: Path, scans: Path) -> None:
    divide(scans, tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(3, (7.0, 9.0), 2.5, 0.3).surface))
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert (row.action, len(row.folders)) == ("divided", 3)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["house"]
    assert sorted(path.name for path in (tmp_path / "out" / "house").iterdir()) == [*(f"house_floor{k}" for k in range(3)), RECORD]
    again = divide_scans(find_scans(scans)[0], tmp_path / "out", CaptureConfig(storeys=StoreyConfig(min_cover=0.7)))
    assert [row.action for row in again if row.scene_id == "mesh/house"] == ["divided"]  # by other settings


def test_the_storeys_of_a_scan_that_has_one_now_are_taken_away(tmp_path: Path, scans: Path) -> None:
    divide(scans / "house.ply", tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(1, (7.0, 9.0), 2.5, 0.3).surface))
    assert [row.action for row in divide(scans / "house.ply", tmp_path / "out", dry_run=True)] == ["whole"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]
    assert [row.action for row in divide(scans / "house.ply", tmp_path / "out")] == ["whole"]
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("at", ["the second storey", "the record", "the place"])
def test_a_folder_is_there_whole_or_not_at_all(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch, at: str) -> None:
    """Whatever stops it in between; the same command then does what is missing."""
    from tasks.capture.storeys import splitting

    owner, name, calls = {
        "the second storey": (splitting, "write_storey", 1), "the record": (splitting, "write_divided", 1), "the place": (os, "replace", 0)
    }[at]  # fmt: skip
    whole = getattr(owner, name)
    left = iter(range(calls))

    def stop(*given: object) -> object:
        if next(left, None) is None or at == "the record":
            if at == "the record":
                whole(*given)
            raise KeyboardInterrupt
        return whole(*given)

    with monkeypatch.context() as patched:
        patched.setattr(owner, name, stop)
        with pytest.raises(KeyboardInterrupt):
            divide(scans, tmp_path / "out")
    assert not (tmp_path / "out" / "house").exists()
    assert find_scans(tmp_path / "out")[0] == []
    divide(scans, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["house"]


@pytest.mark.parametrize("is_killed", [False, True])
def test_the_former_storeys_stay_where_new_ones_do_not_take_their_place(
    tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch, is_killed: bool
) -> None:
    """The place is left empty by a rename that fails, or by who is killed before it; the next run finds the former ones there."""
    divide(scans / "house.ply", tmp_path / "out")
    made = tree(tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(3, (7.0, 9.0), 2.5, 0.3).surface))
    replace = os.replace

    def stop(source: Path, target: Path) -> None:
        if Path(source).name == ".house.making":
            raise OSError(28, "No space left on device")
        replace(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", stop)
        if is_killed:
            patched.setattr(writing, "_mend", lambda _: None)
            patched.setattr(writing.shutil, "rmtree", lambda *_, **__: None)
        (row,) = divide(scans / "house.ply", tmp_path / "out")
    assert "No space left on device" in row.error
    if is_killed:
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".house.former", ".house.making"]
        (scans / "house.ply").write_bytes(b"ply")  # nothing can be divided now
        assert [row.action for row in divide(scans / "house.ply", tmp_path / "out")] == ["failed"]
    assert tree(tmp_path / "out") == made


def test_what_is_no_folder_of_storeys_is_not_touched(tmp_path: Path, scans: Path) -> None:
    (tmp_path / "out" / "house").mkdir(parents=True)
    (tmp_path / "out" / "house" / "thesis.txt").write_text("mine")
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert row.error.endswith("house: folder: is there already, and is none of storeys; name another --out, or remove it")
    (tmp_path / "out" / "house" / RECORD).write_text("[]")
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert row.error == f"house/{RECORD}: content: is not a record of storeys; remove the folder"
    assert (tmp_path / "out" / "house" / "thesis.txt").read_text() == "mine"


def test_two_scans_of_one_name_do_not_take_each_others_folder(tmp_path: Path, scans: Path) -> None:
    divide(scans / "house.ply", tmp_path / "out")
    made = tree(tmp_path / "out")
    found, _ = find_scans(scans / "house.ply", dataset="other")
    (row,) = divide_scans(found, tmp_path / "out", CaptureConfig())
    assert row.error.endswith("house: folder: has the storeys of mesh/house; name another --out, or remove it")
    assert tree(tmp_path / "out") == made


def test_the_command_says_what_it_does_and_ends_with_1_where_a_scan_cannot_be_read(tmp_path: Path, scans: Path) -> None:
    words = ["--scans", str(scans), "--out", str(tmp_path / "out")]
    dry = CliRunner().invoke(command, [*words, "--dry-run", "--json"])
    listed = json.loads(dry.stdout)
    assert dry.exit_code == 1
    assert [(row["scene_id"], row["action"], len(row["floors"])) for row in listed["scans"]] == [
        ("mesh/broken", "failed", 0), ("mesh/flat", "whole", 0), ("mesh/house", "divided", 2),
    ]  # fmt: skip
    assert not (tmp_path / "out").exists()
    (scans / "broken.ply").unlink()
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0
    assert [line.split() for line in done.stdout.splitlines()] == [
        ["mesh/flat", "one", "storey"], ["mesh/house", "2", "storeys,", "floors", "at", "0.00,", "2.80", "m:", "divided"],
        ["1", "scan", "divided,", "0", "unchanged,", "1", "of", "one", "storey,", "0", "failed"],
    ]  # fmt: skip


def test_rows_are_plain_values() -> None:
    row = ScanStoreys("mesh/a", "a.ply", "whole")
    assert json.loads(json.dumps(dataclasses.asdict(row)))["error"] is None


REAL: dict[str, Callable[[Path], Path]] = {
    "scene_aws_small_house": lambda folder: folder / "house.glb",
    "rgbd_slambook_dining": lambda folder: folder,
    "habitat_sim_test_assets": lambda folder: folder / "data/test_assets/scenes/simple_room.glb",
}


@pytest.mark.whole
@pytest.mark.parametrize("name", REAL)
def test_real_scans_of_one_storey_stay_one(name: str, realdata: Callable[[str], Path], tmp_path: Path) -> None:
    found, _ = find_scans(REAL[name](realdata(name)))
    rows = divide_scans(found, tmp_path / "out", CaptureConfig())
    assert [row.action for row in rows] == ["whole"]
    assert not (tmp_path / "out").exists()
