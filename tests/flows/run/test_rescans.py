"""Scans of one room in a lake: held against each other once, again when one of them changed, never kept past what they read."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from bench.stages import run_stages
from flows.commands.run import report_line
from flows.run.configuration import configure
from flows.run.plan import make_plan
from flows.run.report import report_of
from flows.run.rescans import computed, foreseen_rescans, planned_rescans, rescanned, with_rescans
from schemas.capture import Scene
from schemas.rescans import Rescan, RescanObject
from schemas.runs import StageRun
from tasks.capture.formats import find_scans
from tests.samples import fingerprint, sample, stage_run
from tests.scans import write_scan
from warehouse.lake import Lake
from warehouse.upkeep.erasure import erase

A, B, C = "scannet/scene0001_00", "scannet/scene0001_01", "scannet/scene0001_02"
ROOM = "scannet/scene0001"


def stage_capture(lake: Lake, scene: str, print_: str, at: float, room: str = ROOM, scan_format: str = "scannet") -> None:
    """Have a captured scene among what is staged."""
    blob = lake.blobs.put(b"mesh", "glb")
    row = sample(Scene, scene_id=scene, room_id=room, scan_format=scan_format, mesh_blob=blob)
    lake.stage_rows(stage_run(scene, "capture", print_, at=at), {"scenes": [row]})


def stage_rescan(lake: Lake, later: str, earlier: str, prints: dict[str, str], at: float) -> None:
    """Have one scan held against another among what is staged."""
    upstream = [f"capture@{scene}={prints[scene]}" for scene in (later, earlier)]
    pair = {"scene_id": later, "reference_scene_id": earlier}
    rows = {"rescans": [sample(Rescan, **pair, room_id=ROOM)], "rescan_objects": [sample(RescanObject, **pair, number=0)]}
    lake.stage_rows(stage_run(later, "rescans", fingerprint("rescans", *upstream), *upstream, at=at), rows)


def pairs(lake: Lake) -> list[tuple[str, str]]:
    """Which scans are held against which, in both tables alike."""
    found = [(row.scene_id, row.reference_scene_id) for row in lake.snapshot().rows(Rescan)]
    assert found == [(row.scene_id, row.reference_scene_id) for row in lake.snapshot().rows(RescanObject)]
    return found


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    """Three scans of a room, each held against the one before."""
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    lake = Lake.open(tmp_path / "lake")
    prints = {scene: fingerprint(scene) for scene in (A, B, C)}
    for at, scene in enumerate(prints):
        stage_capture(lake, scene, prints[scene], float(at))
    stage_rescan(lake, B, A, prints, 3.0)
    stage_rescan(lake, C, B, prints, 4.0)
    lake.commit()
    assert pairs(lake) == [(B, A), (C, B)]
    return lake


def test_what_was_said_of_a_scan_goes_when_it_is_captured_again(lake: Lake) -> None:
    stage_capture(lake, A, fingerprint(A, "again"), 9.0)
    lake.commit(scenes=[A])
    assert pairs(lake) == [(C, B)]
    assert lake.history([B])[B, "rescans"].done is None
    stage_capture(lake, B, fingerprint(B, "again"), 10.0)
    lake.commit()
    assert pairs(lake) == []


def test_the_same_capture_again_withdraws_nothing(lake: Lake) -> None:
    stage_capture(lake, B, fingerprint(B), 9.0)
    lake.commit()
    assert pairs(lake) == [(B, A), (C, B)]


def test_what_was_made_from_rows_that_were_replaced_is_not_taken_in(lake: Lake) -> None:
    old = {scene: fingerprint(scene) for scene in (A, B)}
    stage_capture(lake, A, fingerprint(A, "again"), 9.0)
    lake.commit()
    stage_rescan(lake, B, A, old, 10.0)
    assert lake.commit() is None
    assert pairs(lake) == [(C, B)]
    stage_rescan(lake, B, A, old | {A: fingerprint(A, "again")}, 11.0)
    lake.commit()
    assert pairs(lake) == [(B, A), (C, B)]


def test_a_scene_that_is_removed_takes_what_was_said_of_it_along(lake: Lake) -> None:
    lake.remove_scene(B)
    assert pairs(lake) == []


@pytest.mark.parametrize(("scene", "left"), [(A, [(C, B)]), (B, []), (C, [(B, A)])])
def test_an_erased_scene_is_named_nowhere(lake: Lake, scene: str, left: list[tuple[str, str]]) -> None:
    told = erase(lake, scene)
    assert told.proof is not None
    assert told.proof.hits == ()
    assert pairs(lake) == left


def test_only_scans_of_rooms_that_others_show_are_held(lake: Lake) -> None:
    stage_capture(lake, "scannet/scene0002_00", fingerprint("alone"), 9.0, "scannet/scene0002")
    stage_capture(lake, "drawn/table", fingerprint("drawn"), 10.0, "scannet/scene0002", "synthesis")
    lake.commit()
    every = {row.scene_id for row in lake.snapshot().rows(Scene)}
    assert rescanned(lake, every) == [[A, B, C]]
    assert rescanned(lake, {B}) == [[A, B, C]]
    assert rescanned(lake, {"scannet/scene0002_00"}) == []


def test_what_is_planned_names_what_it_reads_and_how_many_before(lake: Lake) -> None:
    planned = planned_rescans(lake, {A}, configure(settings=("rescans.earlier=2",)))
    assert [job.outside for job in planned.todo] == [(("rescanned_rooms", (B, A)),), (("rescanned_rooms", (C, B, A)),)]
    assert planned.todo[1].upstream == tuple(f"capture@{scene}={fingerprint(scene)}" for scene in (C, B, A))
    assert planned.known == ()


def test_what_failed_is_said_again_and_not_computed(lake: Lake) -> None:
    job = planned_rescans(lake, {A}, configure()).todo[0]
    failed = stage_run(job.scene_id, "rescans", job.fingerprint, *job.upstream, at=20.0, outcome="failed", error="no", error_kind="input")
    lake.stage_rows(failed, {})
    lake.commit()
    planned = planned_rescans(lake, {A}, configure())
    assert [job.scene_id for job in planned.todo] == [C]
    assert [run.error for run in planned.known] == ["no"]
    again = planned_rescans(lake, {A}, configure(), retry_failed=True)
    assert [(job.scene_id, job.attempt) for job in again.todo] == [(B, 2), (C, 1)]


def test_a_run_tells_what_could_not_be_held_and_the_next_one_that_it_knew(lake: Lake, tmp_path: Path) -> None:
    write_scan(tmp_path / "scans", "scene0001_01")
    configuration = configure()
    plan = make_plan(lake, *find_scans(tmp_path / "scans"), configuration)
    report = with_rescans(report_of(plan), lake, plan, configuration, 1)
    assert [line.split(": ")[:2] for line in report.failures] == [[B, "rescans"], [C, "rescans"]]  # their mesh is none
    assert (report.known, report.rescans, report.steps) == ((), (), 0)
    again = with_rescans(report_of(plan), lake, plan, configuration, 1)
    assert again.known == again.failures == report.failures
    assert pairs(lake) == [(B, A), (C, B)], "what is there stays"
    assert "2 failed" in report_line(again)


def test_what_a_run_would_hold_is_told_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an empty lake, as a run then does; of one whose middle scan changed, what that touches."""
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    for name in ("scene0001_00", "scene0001_01", "scene0001_02", "scene0002_00"):
        write_scan(tmp_path / "scans", name)
    configuration = configure(settings=("rescans.earlier=2",))
    empty = Lake.open(tmp_path / "empty")
    plan = make_plan(empty, *find_scans(tmp_path / "scans"), configuration)
    assert foreseen_rescans(empty, plan, configuration) == {B: (A,), C: (B, A)}


def test_what_would_be_held_again_is_told(lake: Lake, tmp_path: Path) -> None:
    write_scan(tmp_path / "scans", "scene0001_01")
    configuration = configure()
    plan = make_plan(lake, *find_scans(tmp_path / "scans"), configuration)
    assert foreseen_rescans(lake, plan, configuration) == {B: (A,), C: (B,)}, "another scan of the name of the second"
    only = configure(settings=("rescans.earlier=1",))
    write_scan(tmp_path / "fourth", "scene0001_03")
    plan = make_plan(lake, *find_scans(tmp_path / "fourth"), only)
    told = foreseen_rescans(lake, plan, only)
    assert told["scannet/scene0001_03"] == (C,)


CHAIR = ("chair", (0.9, 2.3, 0.45), (0.5, 0.5, 0.9), (90, 60, 40))
TABLE = ("table", (3.4, 0.7, 0.35), (1.2, 0.7, 0.7), (140, 100, 60))
CABINET = ("cabinet", (0.4, 0.7, 0.8), (0.6, 1.1, 1.6), (180, 180, 170))
BED = ("bed", (3.3, 2.4, 0.25), (1.8, 1.3, 0.5), (90, 90, 160))
LAMP = ("lamp", (1.9, 0.3, 0.7), (0.3, 0.3, 1.4), (200, 190, 90))
BIN = ("trash can", (2.0, 2.9, 0.25), (0.4, 0.4, 0.5), (90, 90, 90))


def captured(lake: Lake, scans: Path, name: str, objects: Sequence[object], size: tuple[float, float, float] = (4.4, 3.2, 2.5)) -> None:
    """Scan a room and have the scan captured in a lake."""
    shutil.rmtree(scans / name, ignore_errors=True)
    write_scan(scans, name, size=size, objects=objects)
    done = run_stages(lake, scans / name, ("capture",), 1, ("capture.max_points=4000",))
    assert done.error is None


def changes(lake: Lake) -> list[tuple[object, ...]]:
    """What the view `rescan_changes` says."""
    with lake.snapshot().connect() as connection:
        sql = "SELECT from_scene, to_scene, change, category, round(distance_m, 1) FROM rescan_changes"
        return connection.sql(sql).fetchall()


@pytest.mark.slow
@pytest.mark.whole
def test_three_scans_of_a_room_and_another_room_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    lake, scans, settings = Lake.open(tmp_path / "lake"), tmp_path / "scans", configure()
    kept = (TABLE, CABINET, BED)
    moved = ("chair", (2.4, 1.5, 0.45), *CHAIR[2:])
    captured(lake, scans, "scene0001_00", (*kept, CHAIR, LAMP))
    captured(lake, scans, "scene0001_01", (*kept, moved, BIN))
    captured(lake, scans, "scene0001_02", (*kept, moved, BIN))
    captured(lake, scans, "scene0002_00", (*kept, CHAIR, LAMP))
    sofa = ("sofa", (2.0, 3.9, 0.4), (2.2, 0.9, 0.8), (60, 90, 60))
    captured(lake, scans, "scene0002_01", (sofa,), (6.1, 4.8, 2.5))
    lake.commit()
    scenes = {row.scene_id for row in lake.snapshot().rows(Scene)}
    runs = computed(lake, planned_rescans(lake, scenes, settings).todo, 1)
    assert [(run.scene_id, run.error) for run in runs] == [(B, None), (C, None), ("scannet/scene0002_01", None)]
    assert any("does not fit" in text for text in runs[2].degradations)
    outcomes = {(row.scene_id, row.outcome) for row in lake.snapshot().rows(Rescan)}
    assert outcomes == {(B, "registered"), (C, "registered"), ("scannet/scene0002_01", "refused")}
    assert sorted(changes(lake), key=str) == sorted(
        [(A, B, "moved", "chair", 1.7), (A, B, "removed", "lamp", None), (A, B, "added", "trash can", None)], key=str
    )
    before = lake.snapshot().snapshot_id
    assert planned_rescans(lake, scenes, settings).todo == ()
    assert computed(lake, (), 1) == []
    assert lake.snapshot().snapshot_id == before

    captured(lake, scans, "scene0001_00", (*kept, moved, BIN))
    lake.commit()
    assert changes(lake) == [], "what was said of the scan before is gone with it"
    planned = planned_rescans(lake, scenes, settings)
    assert [job.scene_id for job in planned.todo] == [B]
    computed(lake, planned.todo, 1)
    assert changes(lake) == []
    assert sum(run.stage == "rescans" and run.outcome == "done" for run in lake.snapshot().rows(StageRun)) == 4
