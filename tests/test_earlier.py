"""What the version before wrote goes on working: its lake opens, answers, is run on, released, exported and kept (tests/earlier)."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import duckdb
import pytest
from click.testing import CliRunner

from bench.flows.small_scenes import SETTINGS
from bench.samples import fingerprint, stage_run
from flows.cli import cli
from schemas.capture import Frame, Instance, Mask, Room, Scene, Shell
from schemas.record import table_of
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.catalog import described, empty_lake
from warehouse.questions.macros import macros
from warehouse.questions.renames import MOVES, RENAMES, move_out_of
from warehouse.questions.sql import query
from warehouse.questions.views import views
from warehouse.upkeep.inspection import inspect

pytestmark = pytest.mark.whole

EARLIER = Path(__file__).parent / "earlier"
CATALOG: dict[str, list[str]] = json.loads((EARLIER / "catalog.json").read_text())
SCENES = {"scannet/scene0001_00", "scannet/scene0003_00", "scannet/scene0004_00", "scannet/scene0004_01"}
COPY = "other/scene0004_00"
IMPORTED = "finished/other_scene0004_00_dc1d7a"
SET = [word for one in SETTINGS if not one.startswith("exports.") for word in ("--set", one)]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("earlier")
    with tarfile.open(EARLIER / "lake.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.fixture
def earlier(written: Path, tmp_path: Path) -> Path:
    """Scans, lake, exported replicas and imported files as the version before left them; a copy for every test."""
    shutil.copytree(written, tmp_path / "earlier")
    return tmp_path / "earlier"


@pytest.fixture
def lake(earlier: Path) -> Lake:
    return Lake.open(earlier / "lake")


def told(*arguments: object, code: int = 0) -> str:
    """What a command prints."""
    done = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert done.exit_code == code, (arguments, done.output, done.exception)
    return done.stdout


def computed(lake: Lake) -> set[str]:
    return {str(row["scene_id"]) for row in query(lake.snapshot(), "SELECT scene_id FROM scenes").to_pylist()}


# --- names ---


def test_every_name_that_a_query_may_hold_is_known_still() -> None:
    """What is missing here was renamed or removed: add a line to warehouse/questions/renames.py."""
    with empty_lake() as connection:
        known = {row[0] for row in connection.execute("SELECT table_name FROM information_schema.tables").fetchall()}
        columns = {name: {row[0] for row in connection.execute(f'DESCRIBE "{name}"').fetchall()} for name in known}
        columns |= {macro.name: set(described(connection, macro).get("columns", {})) for macro in macros()}
    missing = {name: sorted(set(had) - columns.get(name, set())) for name, had in CATALOG.items()}
    assert {name: gone for name, gone in missing.items() if gone or name not in columns} == {}


def test_an_old_name_goes_with_the_version_after_the_next() -> None:
    """A rename whose old name the version before did not know has served its time."""
    assert [one for one in RENAMES if one.before not in (CATALOG.get(one.of or one.before, []) if one.of else CATALOG)] == []
    assert [one for one in MOVES if not set(one.columns) <= set(CATALOG[one.before])] == []


# --- the lake as it is ---


def test_it_opens_and_every_view_answers_as_it_did(lake: Lake) -> None:
    assert computed(lake) == SCENES | {COPY, IMPORTED}
    reader = lake.snapshot()
    empty = {"unreachable_targets", "quality_reviews"}
    assert {name for name in CATALOG if name in TABLES and not query(reader, f'FROM "{name}"').num_rows} <= empty
    answered = {view.name: query(reader, f'FROM "{view.name}"').num_rows for view in views()}
    had = [count for name, count in answered.items() if name in CATALOG]  # others ask of what that version did not compute
    assert sum(count > 0 for count in had) > len(had) * 0.8, answered
    before = query(lake.snapshot(1), "FROM scenes")
    assert before.num_rows == len(SCENES), "an older snapshot"
    assert query(reader, "SELECT sum(wrong) AS n FROM quality_reviews").to_pylist() == [{"n": 0}]


def test_columns_that_were_renamed_since_are_read_and_known_by_both_names(lake: Lake) -> None:
    reader = lake.snapshot()
    renamed = [one for one in RENAMES if one.of in CATALOG]
    assert {"masks", "scene_objects", "unstable_objects", "navigation_metrics"} <= {one.of for one in renamed}
    for one in renamed:
        asked = f'SELECT count(*) AS differ FROM "{one.of}" WHERE "{one.before}" IS DISTINCT FROM ({one.value or one.after})'
        assert query(reader, asked).to_pylist() == [{"differ": 0}], one
    named = query(reader, "SELECT visible_share FROM masks").to_pylist()
    assert named
    assert all(0 < row["visible_share"] <= 1 for row in named)
    assert [row.visible_share for row in reader.rows(Mask)] == [row["visible_share"] for row in named]


def test_it_is_sound(lake: Lake) -> None:
    found = inspect(lake)
    assert [str(one) for one in found.errors] == []


def test_status_tells_what_the_next_run_does(lake: Lake) -> None:
    said = json.loads(told("status", "--lake", lake.address, "--json"))
    assert sum(said["counts"].values()) == len(SCENES) + 3, "copy, imported and failed"
    assert said["counts"]["failed"] == 1
    assert any("scene0007_00" in line and "element face" in line for line in said["errors"])
    assert set(said["scenes"]) == SCENES | {COPY, IMPORTED, "scannet/scene0007_00"}
    assert said["todo"].get(IMPORTED) is None


def test_an_object_is_explained(lake: Lake) -> None:
    said = told("explain", "scannet/scene0004_00/0006", "--lake", lake.address)
    assert "annotation" in said


# --- releases ---


@pytest.mark.slow
def test_its_release_is_listed_shown_asked_and_attached(lake: Lake, tmp_path: Path) -> None:
    assert [one["name"] for one in json.loads(told("release", "list", "--lake", lake.address, "--json"))["releases"]] == ["v1"]
    assert "before the annotations" in told("release", "show", "v1", "--lake", lake.address)
    assert told("sql", "SELECT count(*) AS n FROM scenes", "--release", "v1", "--lake", lake.address, "--output", "csv").split() == [
        "n",
        "6",
    ]
    for name, place in (("of the lake", "v1"), ("a folder", Path(lake.address) / "releases/v1")):
        out = tmp_path / f"{name}.duckdb"
        told("release", "attach", place, "--out", out, "--lake", lake.address)
        with duckdb.connect() as connection:
            connection.execute(f"ATTACH '{out}' AS r (READ_ONLY); USE r")
            assert connection.execute("SELECT scenes FROM headline").fetchall() == [(6,)], name
            for view in views():
                connection.execute(f'FROM "{view.name}"').fetchall()


@pytest.mark.slow
def test_a_new_release_is_compared_with_the_old_one(lake: Lake) -> None:
    told("release", "create", "v2", "--lake", lake.address)
    by = json.loads(told("release", "diff", "v1", "v2", "--lake", lake.address, "--json"))
    assert by["scenes"]["changed"]["count"] >= 2, "those that were annotated"
    assert by["scenes"]["added"]["count"] == by["scenes"]["removed"]["count"] == 0
    changed = {one["table"] for one in by["tables"] if one["added"] or one["changed"] or one["removed"]}
    assert {"annotations", "quality_reviews", "placements", "trajectories"} <= changed
    assert "captions" not in changed
    assert not inspect(lake).errors


@pytest.mark.slow
def test_it_is_exported_over_what_was_exported(lake: Lake, earlier: Path) -> None:
    before = {path.relative_to(earlier) for path in (earlier / "replicas").rglob("*") if path.is_file()}
    told("export", "--lake", lake.address, "--release", "v1", "--scene", "scannet/scene0004_00", "--out", earlier / "replicas")
    after = {path.relative_to(earlier) for path in (earlier / "replicas").rglob("*") if path.is_file()}
    assert before <= after
    told("export", "--lake", lake.address, "--release", "v1", "--out", earlier / "all", "--license-allow", "CC0-1.0")
    assert len(list((earlier / "all/glb").glob("*.glb"))) == len(SCENES) + 1


# --- it is kept ---


@pytest.mark.slow
@pytest.mark.usefixtures("own_machine")
def test_upkeep_leaves_it_as_it_is(lake: Lake, tmp_path: Path) -> None:
    rows = {table: lake.snapshot().arrow(table) for table in TABLES if table not in ("snapshots", "stage_runs", "releases")}
    told("lake", "compact", "--lake", lake.address)
    told("lake", "vacuum", "--days", "0", "--lake", lake.address)
    told("lake", "backup", tmp_path / "backup", "--lake", lake.address)
    told("lake", "restore", tmp_path / "backup", "--lake", tmp_path / "restored")
    for one in (lake, Lake.open(tmp_path / "restored")):
        reader = one.snapshot()
        assert all(reader.arrow(table).equals(before) for table, before in rows.items())
        assert not inspect(one).errors
    done = json.loads(told("lake", "erase", COPY, "--lake", lake.address, "--json", "--yes"))
    assert done["proof"]["hits"] == []
    assert computed(lake) == SCENES | {IMPORTED}


@pytest.mark.slow
def test_people_go_on_annotating_reviewing_and_evaluating(lake: Lake, earlier: Path) -> None:
    assert "already" in told("annotate", "import", earlier / "batch.json", "--lake", lake.address)
    assert "already" in told("annotate", "review", earlier / "review.json", "--lake", lake.address)
    batch = json.loads((earlier / "batch.json").read_text())
    (earlier / "more.json").write_text(json.dumps({**batch, "batch_id": "batch-2"}))
    told("annotate", "import", earlier / "more.json", "--lake", lake.address)
    assert query(lake.snapshot(), "FROM annotations").num_rows == 4
    had = query(lake.snapshot(), "FROM trajectories").num_rows
    told("evaluate", "--policy", "random", "--seed", "7", "--lake", lake.address)
    assert query(lake.snapshot(), "FROM trajectories").num_rows == had * 3 // 2


# --- it is run on ---


def run(earlier: Path, *more: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "METASCENES_LAKE"))}
    command = [sys.executable, "-m", "flows.cli", "run", "--scans", earlier / "scans", "--lake", earlier / "lake", *SET, *more]
    done = subprocess.run([str(word) for word in command], env={**kept, "HOME": str(earlier)}, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done


def steps(earlier: Path, *more: object) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(run(earlier, "--dry-run", "--json", *more).stdout)["steps"]
    return found


@pytest.mark.slow
def test_the_same_scans_are_computed_again_only_where_the_code_changed(lake: Lake, earlier: Path) -> None:
    causes = {(step["action"], step["why"]) for step in steps(earlier)}
    assert {action for action, _ in causes} <= {"reuse", "run", "report", "wait"}
    whys = {why for action, why in causes if action == "run"}
    assert all(why in ("code changed", "config changed", "config, code changed") or why.endswith("will be redone") for why in whys), whys
    assert {step["scene_id"] for step in steps(earlier)} == SCENES | {"scannet/scene0007_00"}
    for dataset in ("third", "other"):
        said = json.loads(run(earlier, "--dry-run", "--json", "--dataset", dataset).stdout)
        assert {step["scene_id"] for step in said["steps"]} == SCENES - {"scannet/scene0004_00"} | {COPY, "scannet/scene0007_00"}
        assert said["same"].get("third/scene0004_00", COPY) == COPY
        assert {step["action"] for step in said["steps"] if step["why"] == "never done"} == set()


@pytest.mark.slow
def test_it_is_run_on_and_then_up_to_date(lake: Lake, earlier: Path) -> None:
    had = lake.snapshot()
    said = run(earlier, "--workers", "2", code=1)
    assert [line for line in said.stderr.splitlines() if line.startswith("failed:")] == [
        line for line in said.stderr.splitlines() if "scene0007_00" in line
    ], said.stderr
    assert computed(lake) == SCENES | {COPY, IMPORTED}
    assert {step["action"] for step in steps(earlier)} <= {"reuse", "report", "wait"}
    other = json.loads(run(earlier, "--json", "--dataset", "third", "--scene", "scene0003_00", "--scene", "scene0007_00", code=1).stdout)
    assert other["same"] == {"third/scene0003_00": "scannet/scene0003_00", "third/scene0007_00": "scannet/scene0007_00"}
    assert (other["done"], other["unchanged"], other["failed"]) == ([], ["scannet/scene0003_00"], ["scannet/scene0007_00"])
    for table in ("annotations", "trajectories", "quality_reviews"):
        assert lake.snapshot().arrow(table).num_rows == had.arrow(table).num_rows, table
    chosen = query(lake.snapshot(), "SELECT scene_id FROM placements WHERE origin = 'annotation'").to_pylist()
    assert {row["scene_id"] for row in chosen} == {"scannet/scene0004_00", "scannet/scene0004_01"}
    assert [str(one) for one in inspect(lake).errors] == []
    told("export", "--lake", lake.address, "--out", earlier / "exported")
    told("release", "create", "v2", "--lake", lake.address)
    told("release", "diff", "v1", "v2", "--lake", lake.address)


# --- rooms ---


@pytest.mark.slow
def test_its_rooms_are_one_for_each_scene_and_its_shells_are_read_out_of_them(lake: Lake, tmp_path: Path) -> None:
    """Then a scene is captured anew, as two rooms, and has its shell in the new table; a release and a compaction keep both."""
    moved = ", ".join(move_out_of("rooms").columns)  # type: ignore[union-attr]

    def check(one: Lake, fresh: set[str]) -> None:
        reader = one.snapshot()
        shells = {row.scene_id: row for row in reader.rows(Shell)}
        assert shells.keys() == SCENES | {COPY, IMPORTED}
        by_sql = query(reader, f"SELECT scene_id, {moved} FROM shells ORDER BY scene_id")
        assert by_sql.column("scene_id").to_pylist() == sorted(shells)
        assert query(reader, f"SELECT DISTINCT scene_id, {moved} FROM rooms ORDER BY scene_id").equals(by_sql)
        for scene, shell in shells.items():
            rooms = reader.rows(Room, scene)
            assert [room.room_index for room in rooms] == list(range(2 if scene in fresh else 1))
            assert reader.rows(Shell, scene) == [shell]
            assert shell.height_m > 2.0
            assert len(shell.walls) >= 4
            if scene not in fresh:
                assert (rooms[0].floor_polygon, rooms[0].room_type) == (shell.floor_polygon, shell.room_type)
        areas = query(reader, "SELECT scene_id, floor_area_m2, rooms FROM objects_per_scene").to_pylist()
        assert {row["scene_id"]: row["floor_area_m2"] for row in areas} == {scene: row.floor_area_m2 for scene, row in shells.items()}
        assert sum(row["rooms"] for row in areas) == len(shells) + len(fresh)
        assert query(reader, "SELECT sum(objects) FROM room_overview").equals(
            query(reader, "SELECT sum(objects) FROM objects_per_scene").rename_columns(["sum(objects)"])
        )
        assert [str(one) for one in inspect(one).errors if one.field in ("room_index", "scene_id, room_index")] == []

    check(lake, set())
    scene = "scannet/scene0001_00"
    shell = lake.snapshot().rows(Shell, scene)[0]
    room = lake.snapshot().rows(Room, scene)[0]
    reader = lake.snapshot()
    kept = {record: reader.rows(record, scene) for record in (Scene, Frame, Instance, Mask)}
    rows = {table_of(record).name: found for record, found in kept.items()}
    rooms = [room, dataclasses.replace(room, room_index=1)]
    rows["instances"] = [dataclasses.replace(row, room_index=None if row.is_structure else 1) for row in rows["instances"]]
    lake.stage_rows(stage_run(scene, "capture", fingerprint("anew"), at=1e9), rows | {"shells": [shell], "rooms": rooms})
    lake.commit("captured anew")
    lake = Lake.open(lake.address)
    check(lake, {scene})
    told("lake", "compact", "--lake", lake.address)
    check(lake, {scene})
    told("release", "create", "v2", "--lake", lake.address)
    for name, count in (("v1", 6), ("v2", 6)):
        out = tmp_path / f"{name}.duckdb"
        told("release", "attach", name, "--out", out, "--lake", lake.address)
        with duckdb.connect() as connection:
            connection.execute(f"ATTACH '{out}' AS r (READ_ONLY); USE r")
            assert connection.execute("SELECT count(*), count(walls), min(height_m) > 2 FROM shells").fetchall() == [(count, count, True)]
            assert connection.execute("SELECT count(*) FROM rooms WHERE room_index = 0 AND walls IS NOT NULL").fetchall() == [(count,)]
