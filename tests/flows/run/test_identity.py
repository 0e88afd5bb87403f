"""Which scene a scan is: the lake's of the same content under any name; its own where it has rows under its own."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.run.configuration import configure
from flows.run.fingerprints import FileHashes
from flows.run.identity import content_of
from flows.run.plan import Plan, make_plan, planned_again
from flows.run.report import report_of
from flows.scans.arrivals import Look, look, remember, watch_report
from schemas.capture import Scene
from tasks.capture.formats import find_scans, room_of, scan_files
from tasks.navigation import split_of
from tests.capture_scans import box_room, write_posed_rgbd
from tests.samples import sample, stage_run
from tests.scans import write_scan
from warehouse.lake import Lake

SETTLE = 120.0


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return Lake.open(tmp_path / "lake")


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Two ScanNet scans of one room and a posed RGB-D scan `hall`."""
    folder = tmp_path / "scans"
    write_scan(folder, "scene0001_00")
    write_scan(folder, "scene0001_01", shift=(0.1, 0.0))
    write_posed_rgbd(folder / "hall", box_room(cameras=2))
    return folder


def planned(lake: Lake, scans: Path, dataset: str | None = None, *, only: str = "", **more: Any) -> Plan:
    found, wrong = find_scans(scans, "auto", dataset)
    assert wrong == []
    hashes = FileHashes(scans.parent / f"hashes_{scans.name}.json")
    return make_plan(lake, [scan for scan in found if only in scan.scene_id], (), configure(), hashes=hashes, **more)


def captured(lake: Lake, plan: Plan, outcome: str = "done", at: float = 0.0) -> None:
    """Have captures of a plan's scenes in the lake, as their workers would leave them."""
    for scene in plan.scenes:
        (step, *_), scan = scene.steps, scene.scan
        if step.action != "run":
            continue
        failure = {} if outcome == "done" else {"error": "mesh: is broken", "error_kind": "input"}
        rows = [sample(Scene, scene_id=scan.scene_id, dataset=scan.dataset, scan=scan.scan, room_id=room_of(scan), mesh_blob=None)]
        run = stage_run(scan.scene_id, "capture", step.fingerprint.value, at=at, reasons=step.fingerprint.parts, outcome=outcome, **failure)
        blob = lake.blobs.put(b"mesh", "glb")
        rows = [dataclasses.replace(row, mesh_blob=blob) for row in rows]
        lake.stage_rows(run, {"scenes": rows} if outcome == "done" else {})
    lake.commit()


def actions(plan: Plan) -> dict[str, tuple[str, str]]:
    """What is done about the capture of each scene, and why."""
    return {scene.scan.scene_id: (scene.steps[0].action, scene.steps[0].why) for scene in plan.scenes}


UP_TO_DATE, NEW = ("reuse", "unchanged"), ("run", "never done")


@pytest.mark.whole
def test_another_dataset_name_makes_no_other_scene(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans, "Demo"))
    plan = planned(lake, scans)
    assert actions(plan) == dict.fromkeys(("demo/scene0001_00", "demo/scene0001_01", "demo/hall"), UP_TO_DATE)
    assert plan.same == {
        "rgbd/hall": "demo/hall", "scannet/scene0001_00": "demo/scene0001_00", "scannet/scene0001_01": "demo/scene0001_01",
    }  # fmt: skip
    assert {(scene.scan.dataset, scene.scan.path.name) for scene in plan.scenes} >= {("Demo", "hall")}, "rows as they were made"
    again = planned(lake, scans, again=True)
    assert actions(again) == dict.fromkeys(("rgbd/hall", "scannet/scene0001_00", "scannet/scene0001_01"), NEW)
    assert again.same == {}


@pytest.mark.whole
def test_what_is_stale_is_computed_under_the_name_that_it_has(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans, "demo"))
    found, _ = find_scans(scans)
    plan = make_plan(lake, found, (), configure(settings=["capture.max_points=5000"]))
    assert actions(plan) == dict.fromkeys(("demo/hall", "demo/scene0001_00", "demo/scene0001_01"), ("run", "config changed"))


@pytest.mark.whole
def test_a_scene_that_is_planned_again_keeps_its_name_and_content(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans))
    (scans / "hall").rename(scans / "entrance")
    moved = (scans / "scene0001_00").rename(scans / "scene0002_00")
    for file in list(moved.iterdir()):
        file.rename(moved / file.name.replace("scene0001_00", "scene0002_00"))
    found, _ = find_scans(scans)
    for settings in ([], ["capture.max_points=5000"]):
        configuration = configure(settings=settings)
        plan = make_plan(lake, found, (), configuration)
        assert plan.same == {"rgbd/entrance": "rgbd/hall", "scannet/scene0002_00": "scannet/scene0001_00"}
        assert [planned_again(lake, scene, configuration) for scene in plan.scenes] == list(plan.scenes)
    captured(lake, plan)  # another run, meanwhile
    after = [planned_again(lake, scene, configuration) for scene in plan.scenes]
    assert [(scene.scan, scene.steps[0].why) for scene in after if scene] == [(scene.scan, "unchanged") for scene in plan.scenes]


def test_a_folder_or_file_that_was_renamed_is_the_same_scan(lake: Lake, scans: Path) -> None:
    glb = scans.parent / "models"
    glb.mkdir()
    for name in ("a.glb", "b.glb"):
        (glb / name).write_bytes(b"glTF" + name.encode())
    captured(lake, planned(lake, scans))
    captured(lake, planned(lake, glb))
    (scans / "hall").rename(scans / "entrance")
    (glb / "a.glb").rename(glb / "c.glb")
    plan = planned(lake, scans)
    assert plan.same == {"rgbd/entrance": "rgbd/hall"}
    assert set(actions(plan).values()) == {UP_TO_DATE}
    plan = planned(lake, glb)
    assert plan.same == {"glb/c": "glb/a"}
    assert actions(plan) == {"glb/a": UP_TO_DATE, "glb/b": UP_TO_DATE}


def test_a_renamed_scan_whose_name_now_holds_another_one_is_a_scene_of_its_own(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans))
    (scans / "hall").rename(scans / "entrance")
    write_posed_rgbd(scans / "hall", box_room(cameras=3))
    plan = planned(lake, scans)
    assert plan.same == {}
    assert actions(plan)["rgbd/entrance"] == NEW
    assert actions(plan)["rgbd/hall"] == ("run", "scan changed")


def test_content_that_changed_is_computed_under_its_own_name_whoever_else_has_it(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans))
    write_posed_rgbd(scans / "kitchen", box_room(cameras=3))
    captured(lake, planned(lake, scans))
    shutil.rmtree(scans / "hall")
    shutil.copytree(scans / "kitchen", scans / "hall")
    plan = planned(lake, scans)
    assert plan.same == {}
    assert actions(plan)["rgbd/hall"] == ("run", "scan changed")
    assert actions(plan)["rgbd/kitchen"] == UP_TO_DATE


def test_copies_in_one_run_are_computed_once(lake: Lake, scans: Path) -> None:
    shutil.copytree(scans / "hall", scans / "a_copy")
    plan = planned(lake, scans)
    assert plan.same == {"rgbd/hall": "rgbd/a_copy"}
    assert actions(plan) == dict.fromkeys(("rgbd/a_copy", "scannet/scene0001_00", "scannet/scene0001_01"), NEW)
    captured(lake, planned(lake, scans, only="hall"))
    plan = planned(lake, scans)
    assert plan.same == {"rgbd/a_copy": "rgbd/hall"}, "the one that the lake has"
    assert actions(plan)["rgbd/hall"] == UP_TO_DATE


def test_a_lake_that_has_a_scan_twice_keeps_both(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans, "demo"))
    captured(lake, planned(lake, scans, again=True))
    for dataset in (None, "demo"):
        plan = planned(lake, scans, dataset)
        assert plan.same == {}
        assert set(actions(plan).values()) == {UP_TO_DATE}
    third = planned(lake, scans, "third")
    assert third.same == {"third/hall": "demo/hall", "third/scene0001_00": "demo/scene0001_00", "third/scene0001_01": "demo/scene0001_01"}
    done = CliRunner().invoke(cli, ["status", "--lake", lake.address, "--json"])
    assert json.loads(done.stdout)["same"][0] == ["demo/hall", "rgbd/hall"]
    done = CliRunner().invoke(cli, ["status", "--lake", lake.address])
    assert "demo/scene0001_00, scannet/scene0001_00: the same scan under 2 names" in done.stdout


def test_a_failure_under_another_name_is_reported_and_one_that_was_removed_is_not(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans, "demo"), outcome="failed")
    plan = planned(lake, scans)
    assert {action for action, _ in actions(plan).values()} == {"report"}
    report = report_of(plan)
    assert report.failures[0] == "demo/hall: capture: mesh: is broken"
    assert report.same["rgbd/hall"] == "demo/hall"
    captured(lake, planned(lake, scans, "demo", retry_failed=True), at=1.0)
    lake.remove_scene("demo/hall")
    assert actions(planned(lake, scans))["rgbd/hall"] == NEW


def test_a_lake_of_the_version_before_is_known_by_the_content_with_its_names(lake: Lake, scans: Path) -> None:
    """It recorded no content without names."""
    plan = planned(lake, scans, "demo")
    old = [dataclasses.replace(one.steps[0], fingerprint=dataclasses.replace(one.steps[0].fingerprint, facts=())) for one in plan.scenes]
    captured(
        lake, dataclasses.replace(plan, scenes=tuple(dataclasses.replace(s, steps=(o,)) for s, o in zip(plan.scenes, old, strict=True)))
    )
    plan = planned(lake, scans)
    assert set(plan.same.values()) == {"demo/hall", "demo/scene0001_00", "demo/scene0001_01"}
    assert set(actions(plan).values()) == {UP_TO_DATE}


def test_files_are_not_read_again_to_know_a_scan(lake: Lake, scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.run.fingerprints.RACY_SECONDS", -1.0)
    captured(lake, planned(lake, scans, "demo"))
    monkeypatch.setattr("flows.run.fingerprints.open_file", lambda *_: pytest.fail("a file was read again"))
    assert len(planned(lake, scans).same) == 3


def test_another_license_is_another_content(scans: Path, tmp_path: Path) -> None:
    (scan,) = (one for one in find_scans(scans)[0] if one.scan == "hall")
    before = content_of(scan, scan_files(scan), FileHashes(tmp_path / "hashes.json"))
    (scan.path / "LICENSE.txt").write_text("CC0-1.0\n")
    after = content_of(scan, scan_files(scan), FileHashes(tmp_path / "hashes.json"))
    assert before.named != after.named
    assert before.nameless != after.nameless


# --- what is said ---


def test_run_and_dry_run_say_it(lake: Lake, scans: Path) -> None:
    plan = planned(lake, scans, "demo")
    for scene in plan.scenes:
        for number, step in enumerate(scene.steps):
            lake.stage_rows(stage_run(scene.scan.scene_id, step.stage, step.fingerprint.value, *step.upstream, at=number,
                                      reasons=step.fingerprint.parts))  # fmt: skip
    lake.commit()
    command = ["run", "--scans", str(scans), "--lake", lake.address]
    done = CliRunner().invoke(cli, command)
    assert done.exit_code == 0, done.output
    assert done.stdout == "nothing to do: 3 scenes are up to date, 3 under another name (rgbd/hall is demo/hall, ...)\n"
    assert "note: scannet/scene0001_00 is demo/scene0001_00: the same scan under another name\n" in done.stderr
    assert "--again" in done.stderr
    assert json.loads(CliRunner().invoke(cli, [*command, "--json"]).stdout)["same"]["rgbd/hall"] == "demo/hall"
    dry = CliRunner().invoke(cli, [*command, "--dry-run"]).stdout
    assert "rgbd/hall is demo/hall: the same scan under another name" in dry
    assert "0 stage runs to do" in dry
    assert json.loads(CliRunner().invoke(cli, [*command, "--dry-run", "--json"]).stdout)["same"]["rgbd/hall"] == "demo/hall"
    again = json.loads(CliRunner().invoke(cli, [*command, "--dry-run", "--json", "--again"]).stdout)
    assert again["counts"] == {"run": len(plan.scenes) * len(plan.scenes[0].steps)}
    assert again["same"] == {}


def settled(scans: Path, lake: Lake, dataset: str | None = None, at: float = 1_800_000_000.0) -> Look:
    for now in (at, at + SETTLE):
        found = look(scans, lake, SETTLE, dataset=dataset, now=now)
        remember(found, scans, lake)
    return found


def test_a_watcher_asks_for_nothing_that_is_known_under_another_name(lake: Lake, scans: Path) -> None:
    assert {one.state for one in settled(scans, lake, "demo").arrivals} == {"new"}
    captured(lake, planned(lake, scans, "demo"))
    found = settled(scans, lake)
    assert {one.state for one in found.arrivals} == {"known"}
    assert found.due(lambda run: True) == []
    report = watch_report(found)
    assert report.same == {
        "rgbd/hall": "demo/hall", "scannet/scene0001_00": "demo/scene0001_00", "scannet/scene0001_01": "demo/scene0001_01",
    }  # fmt: skip
    write_posed_rgbd(scans / "kitchen", box_room(cameras=3))
    shutil.copytree(scans / "kitchen", scans / "zz_kitchen")
    found = settled(scans, lake, at=1_800_100_000.0)
    assert [one.scan for one in found.due(lambda run: True)] == ["rgbd/kitchen"], "of two new copies one"


def test_a_watcher_tells_of_a_failure_under_another_name(lake: Lake, scans: Path) -> None:
    captured(lake, planned(lake, scans, "demo"), outcome="failed")
    found = settled(scans, lake)
    assert {(one.state, one.why.partition(": ")[2]) for one in found.arrivals} == {("failed before", "mesh: is broken")}


# --- train or test ---


def test_a_room_is_on_one_side_whatever_its_dataset_is_called() -> None:
    for number in range(1000):
        room = f"scene{number:04d}"
        sides = {split_of(f"{dataset}/{room}", 0.2) for dataset in ("scannet", "demo", "my.scans-2")}
        sides |= {split_of(f"glb/{room}_{scan:02d}", 0.2) for scan in range(3)}
        assert len(sides) == 1, room


def test_rescans_differ_in_content_and_stay_on_one_side(scans: Path, tmp_path: Path) -> None:
    for dataset in (None, "demo"):
        found = [scan for scan in find_scans(scans, "scannet", dataset)[0] if scan.format == "scannet"]
        assert len({content_of(scan, scan_files(scan), FileHashes(tmp_path / "hashes.json")) for scan in found}) == 2
        assert len({split_of(room_of(scan), 0.2) for scan in found}) == 1


def test_rooms_of_the_dataset_that_most_lakes_hold_stay_where_they_were() -> None:
    """By the hash of the whole name, as it was taken before."""
    import hashlib

    def before(room: str) -> str:
        return "test" if int.from_bytes(hashlib.sha256(room.encode()).digest()[:8], "big") < 0.2 * 2**64 else "train"

    rooms = [f"scene{number:04d}" for number in range(1000)]
    moved = {
        dataset: sum(split_of(f"{dataset}/{room}", 0.2) != before(f"{dataset}/{room}") for room in rooms) for dataset in ("scannet", "demo")
    }
    assert moved == {"scannet": 0, "demo": 312}
