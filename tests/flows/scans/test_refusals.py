"""Refused scans: a row, a line and a failed run for as long as they are refused; one message, until something changes."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.pipeline import replicate, state_of
from flows.run.configuration import configure
from flows.run.fingerprints import FileHashes
from flows.run.plan import Plan, make_plan
from flows.run.report import RunReport, report_of
from flows.scans.choice import found_scans
from flows.scans.mirror import FetchError
from flows.scans.refusals import keep_refusals, refused_scans
from flows.server.notifications import AS_BEFORE
from schemas.runs import RefusedScan
from tasks.capture.formats import find_scans
from tasks.capture.scan import PassedOver
from tests.samples import sample, stage_run
from tests.tasks.capture.discovery.test_search import PLY, glb, put
from warehouse.lake import Lake
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect

NIGHT = datetime(2026, 1, 1, 1, tzinfo=UTC)


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return Lake.open(tmp_path / "lake")


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Two scans and a folder that lacks something."""
    for name in ("attic", "bath"):
        put(tmp_path / "scans" / f"{name}.ply", PLY + name.encode())
    put(tmp_path / "scans" / "group" / "half" / "habitat" / "info_semantic.json", b"{}")
    return tmp_path / "scans"


def planned(lake: Lake, scans: Path, **choice: Any) -> Plan:
    return make_plan(lake, *found_scans(scans, **choice), configure(), hashes=FileHashes(scans.parent / "hashes.json"))


def night(lake: Lake, scans: Path, number: int, **choice: Any) -> tuple[RunReport, Any]:
    """What a run reports of the scans of a night, and how it ends, without computing a scene."""
    began = NIGHT + timedelta(days=number)
    plan = planned(lake, scans, **choice)
    before = keep_refusals(lake, str(scans), plan, began, is_whole=not choice)
    report = report_of(plan, began=began, refused_before=before)
    return report, state_of(report)


def test_a_night_fails_once_and_again_without_a_second_message_until_the_scan_is_repaired(lake: Lake, scans: Path) -> None:
    line = "half: folder: holds no scan of a known format"
    report, state = night(lake, scans, 0)
    assert (state.type.value, len(report.refused), report.known) == ("FAILED", 1, ())
    assert report.failures == report.refused
    assert report.refused[0].startswith(line)
    assert state.message.startswith(f"0 scenes done, 2 up to date, 1 scan refused: {line}")
    (row,) = refused_scans(lake)
    assert (row.scans, row.path, row.format) == (str(scans), "group", "replica_v1") or row.path == "group/half"
    assert (row.first_seen_at, row.last_seen_at) == (NIGHT, NIGHT)
    assert "looks like replica_v1" in row.reason

    report, state = night(lake, scans, 1)
    assert (state.type.value, state.name, report.failures, report.known) == ("FAILED", "Failed", report.refused, report.refused)
    assert state.message.startswith(f"{AS_BEFORE}0 scenes done, 2 up to date, 1 scan refused: {line}")
    assert "failed before" not in state.message
    (again,) = refused_scans(lake)
    assert (again.first_seen_at, again.last_seen_at) == (NIGHT, NIGHT + timedelta(days=1))

    put(scans / "group" / "half" / "habitat" / "mesh_semantic.ply", PLY)
    report, state = night(lake, scans, 2)
    assert (state.type.value, report.refused) == ("COMPLETED", ())
    assert refused_scans(lake) == []
    snapshot = lake.snapshot().snapshot_id
    night(lake, scans, 3)
    assert lake.snapshot().snapshot_id == snapshot, "nothing to write down"


def test_another_reason_and_another_scan_are_news(lake: Lake, scans: Path) -> None:
    night(lake, scans, 0)
    put(scans / "more" / "habitat" / "info_semantic.json", b"{}")
    report, state = night(lake, scans, 1)
    assert not state.message.startswith(AS_BEFORE)
    assert "2 scans refused: more: folder: holds no scan" in state.message
    assert len(set(report.refused) - set(report.known)) == 1
    assert night(lake, scans, 2)[1].message.startswith(AS_BEFORE)
    put(scans / "more" / "walk" / "rgb.txt")
    (scans / "more" / "habitat" / "info_semantic.json").unlink()
    put(scans / "more" / "walk" / "rgb" / "1.png")
    assert not night(lake, scans, 3)[1].message.startswith(AS_BEFORE)
    first = {row.path: row.first_seen_at for row in refused_scans(lake)}
    assert max(first.values()) == NIGHT + timedelta(days=3)
    assert NIGHT in first.values()


def test_a_run_over_some_scenes_leaves_rows_of_the_others(lake: Lake, scans: Path) -> None:
    night(lake, scans, 0)
    before = refused_scans(lake)
    report, _ = night(lake, scans, 1, scenes=("mesh/attic",))
    assert report.refused == ()
    assert refused_scans(lake) == before


def test_folders_of_scans_keep_their_own_rows_and_a_run_that_starts_over_has_its_news(lake: Lake, scans: Path, tmp_path: Path) -> None:
    put(tmp_path / "more" / "half" / "habitat" / "info_semantic.json", b"{}")
    put(tmp_path / "more" / "den.ply", PLY)
    put(tmp_path / "more" / "hut.ply", PLY + b"1")
    night(lake, scans, 0)
    report, state = night(lake, tmp_path / "more", 1)
    assert len(refused_scans(lake)) == 2
    again, state_again = night(lake, tmp_path / "more", 1)
    assert (again, state_again.message) == (report, state.message)


def test_folders_of_other_things_are_notes_and_fail_no_run(lake: Lake, tmp_path: Path) -> None:
    for name in ("docs/readme.pdf", "src/deep/tool.py", "videos/walk.mp4", "zips/a.zip", "empty/.keep", "lost+found/x"):
        put(tmp_path / "scans" / name)
    for name in ("attic", "bath"):
        put(tmp_path / "scans" / f"{name}.ply", PLY + name.encode())
    report, state = night(lake, tmp_path / "scans", 0)
    assert (state.type.value, report.refused) == ("COMPLETED", ())
    assert refused_scans(lake) == []
    notes = [str(line) for line in find_scans(tmp_path / "scans")[1] if isinstance(line, PassedOver)]
    assert sorted(note.partition(":")[0] for note in notes) == ["docs", "empty", "src", "videos", "zips"]
    assert any(note.endswith("unpack it") for note in notes)
    for name in ("attic", "bath"):
        (tmp_path / "scans" / f"{name}.ply").unlink()
    assert night(lake, tmp_path / "scans", 1)[1].type.value == "FAILED", "no scan at all"


@pytest.mark.parametrize("format", ["glb", "tum_rgbd", "posed_rgbd", "scannet", "roomplan", "bare_mesh", "replica_v1"])
def test_a_run_for_one_format_refuses_no_sound_scan_of_another(format: str, lake: Lake, tmp_path: Path) -> None:
    from tests.tasks.capture.discovery.test_enclosed import INNER

    for name, (make, _) in INNER.items():
        make(tmp_path / "scans" / name)
    put(tmp_path / "scans" / "meshes" / "attic.ply", PLY)
    glb(tmp_path / "scans" / "models" / "cellar.glb")
    put(tmp_path / "scans" / "habitat_home" / "habitat" / "mesh_semantic.ply", PLY)
    put(tmp_path / "scans" / "habitat_home" / "habitat" / "info_semantic.json", b"{}")
    report, _ = night(lake, tmp_path / "scans", 0, format=format)
    assert report.refused == ()


def test_runs_for_different_formats_keep_each_others_rows(lake: Lake, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the flow itself, which says of a run whether it looked at all scans."""
    seen: list[bool] = []

    def keep(*_: Any, is_whole: bool, **__: Any) -> frozenset[str]:
        seen.append(is_whole)
        return frozenset()

    monkeypatch.setattr("flows.pipeline.keep_refusals", keep)
    monkeypatch.setattr("flows.pipeline.with_rescans", lambda report, *_: report)
    monkeypatch.setattr("flows.pipeline._carry_out", lambda plan, *_: report_of(plan, began=NIGHT))
    monkeypatch.setattr("flows.pipeline.patiently", lambda once: once())
    monkeypatch.setattr("flows.pipeline.keep", lambda report: None)
    for format in ("auto", "glb"):
        replicate.fn(str(scans), lake.address, format=format)
    assert seen == [True, False]
    for name in ("cellar", "loft"):
        glb(scans / f"{name}.glb", name)
    night(lake, scans, 0)
    before = refused_scans(lake)
    assert before
    night(lake, scans, 1, format="glb")
    assert refused_scans(lake) == before


def test_a_scan_that_could_not_be_fetched_is_tried_again_and_not_refused(lake: Lake, scans: Path) -> None:
    plan = planned(lake, scans)
    plan = Plan(plan.scenes, (FetchError("mesh/den", "objects", "cannot be fetched", "run the same command again"),), plan.snapshot_id)
    assert keep_refusals(lake, str(scans), plan, NIGHT) == frozenset()
    report = report_of(plan, began=NIGHT)
    assert (report.refused, len(report.failures), report.known) == ((), 1, ())
    assert state_of(report).type.value == "FAILED"
    assert not lake.exists, "nothing to write down"


def ask(lake: Lake, *words: str) -> str:
    result = CliRunner().invoke(cli, [*words, "--lake", lake.address])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_status_and_failures_list_them(lake: Lake, scans: Path) -> None:
    night(lake, scans, 0)
    (row,) = refused_scans(lake)
    told = ask(lake, "status")
    assert "1 scan refused" in told.splitlines()[0]
    assert f"refused since 2026-01-01: {row.path}: folder: holds no scan" in told
    (listed,) = json.loads(ask(lake, "status", "--json"))["refused"]
    assert (listed["scans"], listed["path"], listed["format"]) == (str(scans), row.path, "replica_v1")
    (failure,) = json.loads(ask(lake, "sql", "SELECT * FROM failures", "--output", "json"))
    assert (failure["scene_id"], failure["outcome"], failure["error_kind"]) == (row.path, "refused", "input")
    assert failure["error"] == f"folder: {row.reason}"
    assert not inspect(lake).findings, "the lake is sound"


def test_an_erasure_takes_rows_of_the_scene_and_leaves_the_others(lake: Lake) -> None:
    lake.stage_rows(stage_run("scannet/scene0001_00", "capture", "ab" * 32, outcome="failed", error="x", error_kind="input"))
    lake.commit()
    rows = [sample(RefusedScan, scans="/scans", path=path, reason="no") for path in ("scene0001_00", "a/scene0001_00", "scene0002_00")]
    lake.refuse_scans("/scans", rows)
    erase(lake, "scannet/scene0001_00")
    assert [row.path for row in refused_scans(lake)] == ["scene0002_00"]


def test_a_dry_run_writes_nothing_and_names_them(lake: Lake, scans: Path) -> None:
    told = ask(lake, "run", "--scans", str(scans), "--dry-run")
    assert "unusable: half: folder: holds no scan" in told or "unusable: group: folder: holds no scan" in told
    assert not lake.exists
