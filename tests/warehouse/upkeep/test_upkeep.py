"""Compaction and vacuum: the lake stays small, and every row that is kept stays what it was."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
from datetime import timedelta
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from deltalake import DeltaTable
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.cli import cli
from schemas.captions import Caption
from schemas.errors import InputError
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from tests.warehouse.upkeep.test_erasure import kills
from tests.whole_scenes import stage_batch, stage_whole_scene
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.sharing.writer import new_token, this_writer
from warehouse.storage.files import Storage
from warehouse.tables import adoption
from warehouse.tables.delta import DeltaTables, LogError
from warehouse.tables.digest import digests
from warehouse.upkeep.compaction import NOTE, compact
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six commits of three scenes, the newest snapshot beside a release."""
    lake = Lake.open(tmp_path_factory.mktemp("filled") / "lake")
    for i in range(6):
        stage_whole_scene(lake, scene_id((i * 2) % 3), i, at=i)
        lake.commit(f"run {i}")
    stage_batch(lake, "batch-1", [scene_id(0)], at=20)
    lake.commit("batch")
    make_release(lake, "v1", snapshot_id=2)
    return Path(lake.address)


@pytest.fixture
def lake(filled: Path, tmp_path: Path) -> Lake:
    shutil.copytree(filled, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


def size_of(lake: Lake) -> int:
    return sum(path.stat().st_size for path in Path(lake.address).rglob("*") if path.is_file())


def age(lake: Lake) -> None:
    for path in Path(lake.address, "blobs").rglob("*.*"):
        os.utime(path, (0, 0))


@pytest.mark.slow
@pytest.mark.whole
def test_compaction_puts_files_together_in_order_and_changes_no_row(lake: Lake) -> None:
    before = {row.snapshot_id: digests(lake.snapshot(row.snapshot_id)) for row in lake.snapshot().snapshots}
    files = {table: len(lake.snapshot().files(table)) for table in lake.snapshot().versions}
    assert max(files.values()) > 2
    planned = compact(lake, dry_run=True)
    assert planned.snapshot_id is None
    assert lake.snapshot().snapshot_id == max(before)
    done = compact(lake)
    assert [one.table for one in done.tables] == [one.table for one in planned.tables]
    reader = lake.snapshot()
    assert (reader.snapshot_id, reader.snapshot.note) == (done.snapshot_id, NOTE)  # type: ignore[union-attr]
    for one in done.tables:
        assert one.files_before == files[one.table]
        assert len(reader.files(one.table)) == one.files_after == 1
        rows = pq.read_table(Path(lake.address) / reader.files(one.table)[0])
        assert rows.equals(rows.sort_by([(name, "ascending") for name in TABLES[one.table].key]))
    assert digests(reader) == before[max(before)]
    assert {number: digests(lake.snapshot(number)) for number in before} == before
    assert compact(lake).tables == ()
    stage_whole_scene(lake, scene_id(1), "later", at=50)
    assert lake.commit() is not None
    assert inspect(lake).errors == ()


@pytest.mark.whole
def test_files_of_a_large_table_hold_neighbors(tmp_path: Path) -> None:
    """Scenes come in any order; afterwards each lies in one or two files, and good files are left alone."""
    lake = Lake.open(tmp_path / "lake")
    order = [(7 * i) % 40 for i in range(40)]
    for part in range(8):
        for number in order[part::8]:
            rows = [sample(Caption, scene_id=scene_id(number), instance_id=f"{i:04d}", sentence=fingerprint(number, i)) for i in range(400)]
            lake.stage_rows(stage_run(scene_id(number), "captions", fingerprint(number)), {"captions": rows})
        lake.commit()
    before = digests(lake.snapshot())
    (done,) = compact(lake, ["captions"], target_bytes=60_000).tables
    assert done.files_after > 4
    assert digests(lake.snapshot()) == before
    places: dict[str, set[str]] = {}
    for file in lake.snapshot().files("captions"):
        for scene in pq.read_table(Path(lake.address) / file, columns=["scene_id"]).column(0).unique().to_pylist():
            places.setdefault(scene, set()).add(file)
    assert len(places) == 40
    assert sum(len(found) for found in places.values()) <= 40 + done.files_after
    assert compact(lake, ["captions"], target_bytes=60_000).tables == ()
    lake.stage_rows(stage_run(scene_id(39), "captions", fingerprint("new")), {"captions": [sample(Caption, scene_id=scene_id(39))]})
    lake.commit()
    again = compact(lake, ["captions"], target_bytes=60_000).tables
    assert all(one.files_rewritten < one.files_before / 2 for one in again)
    found = lake.snapshot().rows(Caption, scene_id(39))
    assert len(found) == 1
    assert len(lake.snapshot().rows(Caption)) == 39 * 400 + 1


def test_compaction_of_no_table_and_of_an_empty_lake(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such table"):
        compact(lake, ["nothing"])
    assert compact(Lake.open(tmp_path / "none")).tables == ()
    assert not (tmp_path / "none").exists()
    assert [one.table for one in compact(lake, ["captions"]).tables] == ["captions"]


STEPS = st.lists(st.sampled_from(["scene 0", "scene 1", "remove 0", "compact", "vacuum", "release"]), min_size=3, max_size=8)


@pytest.mark.whole
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(steps=STEPS)
def test_upkeep_between_commits_changes_nothing_that_is_kept(tmp_path_factory: pytest.TempPathFactory, steps: list[str]) -> None:
    """A lake with upkeep and one without hold the same rows after any commits; released snapshots stay readable."""
    kept, plain = (Lake.open(tmp_path_factory.mktemp("upkeep") / "lake") for _ in range(2))
    released: dict[int, dict[str, str]] = {}
    for at, step in enumerate(steps):
        if step == "compact":
            compact(kept)
        elif step == "vacuum":
            planned = vacuum(kept, days=0, dry_run=True)
            assert dataclasses.replace(vacuum(kept, days=0), log_bytes=0) == dataclasses.replace(planned, log_bytes=0)
        elif step == "release":
            last = kept.snapshot().snapshot_id
            if last and last not in released:
                kept.storage.write(f"releases/r{last}/release.json", _record(f"r{last}", last))
                released[last] = digests(kept.snapshot())
        else:
            for lake in (kept, plain):
                if step.startswith("scene"):
                    stage_scene(lake, int(step[-1]), at, at=at)
                    lake.commit()
                else:
                    lake.remove_scene(scene_id(0))
    assert digests(kept.snapshot()) == digests(plain.snapshot())
    for number, expected in released.items():
        assert digests(kept.snapshot(number)) == expected


def _record(name: str, snapshot_id: int) -> bytes:
    from schemas.runs import Release
    from warehouse.tables.released import record_fields

    return json.dumps(record_fields(sample(Release, name=name, snapshot_id=snapshot_id))).encode()


@pytest.mark.whole
def test_vacuum_makes_the_room_that_it_says(lake: Lake) -> None:
    compact(lake)
    age(lake)
    last, released = digests(lake.snapshot()), digests(lake.snapshot(2))
    before = size_of(lake)
    planned = vacuum(lake, days=0, dry_run=True)
    assert size_of(lake) == before
    done = vacuum(lake, days=0)
    assert (done.snapshots, done.files, done.blobs, done.blob_bytes) == (
        planned.snapshots, planned.files, planned.blobs, planned.blob_bytes,
    )  # fmt: skip
    assert done.snapshots == (1, 3, 4, 5, 6, 7)
    # A checkpoint per table and the list of snapshots were written meanwhile.
    assert 0 < before - size_of(lake) <= done.bytes
    assert digests(lake.snapshot()) == last
    assert digests(lake.snapshot(2)) == released
    assert inspect(lake).findings == ()
    assert vacuum(lake, days=0).bytes == 0
    for table in lake.storage.folders("tables"):
        versions = {lake.snapshot(row.snapshot_id).versions.get(table) for row in lake.snapshot().snapshots}
        logs = [int(name[:20]) for name in lake.storage.names(f"tables/{table}/_delta_log") if name[:20].isdigit()]
        if table != "snapshots":
            assert min(logs) >= min(version for version in versions if version is not None)


def test_vacuum_spares_strangers_and_young_blobs(lake: Lake) -> None:
    folder = Path(lake.address)
    strangers = [folder / "tables/captions/mine.parquet", folder / "blobs/ab/cd/notes.txt", folder / "thesis.tex"]
    for path in strangers:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"mine")
        os.utime(path, (0, 0))
    young = lake.blobs.put(b"young", "glb")
    done = vacuum(lake, days=0)
    assert all(path.exists() for path in strangers)
    assert young in lake.blobs
    assert done.young_blobs >= 1


@pytest.mark.whole
def test_vacuum_removes_what_the_dead_were_writing(lake: Lake) -> None:
    """Whoever vacuums last leaves nothing, also of a vacuum that was killed with half a lease written."""
    folder = Path(lake.address) / "tmp"
    folder.mkdir(exist_ok=True)
    dead, living = folder / f"{this_writer().machine}-999999-1-2", folder / new_token()
    for path in (dead, living):
        path.write_bytes(b"{")
    vacuum(lake, dry_run=True)
    assert dead.exists()
    vacuum(lake)
    assert not dead.exists()
    assert living.exists()


def test_reader_of_a_kept_snapshot_goes_on_while_a_vacuum_runs(lake: Lake) -> None:
    reader = lake.snapshot()
    files = {table: reader.files(table) for table in reader.versions}
    vacuum(lake, days=0)
    assert all(lake.storage.exists(file) for paths in files.values() for file in paths)
    assert len(reader.rows(Caption)) == 6


def test_snapshot_that_was_the_last_one_until_now_stays_however_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake")
    now = adoption.now_utc()
    for number, days_ago in enumerate((40, 30, 0)):
        monkeypatch.setattr("warehouse.tables.commit.now_utc", lambda days_ago=days_ago: now - timedelta(days=days_ago))
        stage_scene(lake, number, "x", at=number)
        lake.commit()
    reader = lake.snapshot(2)  # somebody reads it since yesterday, when it was the newest
    assert vacuum(lake, days=7).snapshots == (1,)
    assert len(reader.rows(Caption)) == 10
    assert vacuum(lake, days=0).snapshots == (2,)


def test_reader_that_opens_while_a_vacuum_runs_finds_its_snapshot(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    before = lake.snapshot()
    real = DeltaTables.files

    def overtaken(self: DeltaTables, table: str, opened: DeltaTable) -> list[str]:
        """The files of a table, after which a vacuum puts others in their place, once."""
        found = real(self, table, opened)
        monkeypatch.setattr(DeltaTables, "files", real)
        assert vacuum(Lake.open(lake.address), days=0).snapshots
        assert not lake.storage.exists(found[0])
        return found

    monkeypatch.setattr(DeltaTables, "files", overtaken)
    reader = lake.snapshot()
    assert reader.snapshot == before.snapshot
    assert reader.arrow("captions").equals(before.arrow("captions"))


def test_log_that_is_shortened_while_it_is_read_is_read_again(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    log = Path(lake.address) / "tables" / "snapshots" / "_delta_log"
    moved = log.with_name("moved")
    log.rename(moved)
    shutil.copytree(moved, log)
    (log / f"{0:020}.json").unlink()  # a log without its beginning and without a checkpoint, as a reader may meet it
    looks: list[float] = []

    def put_back(seconds: float) -> None:
        looks.append(seconds)
        if len(looks) == 2:
            shutil.rmtree(log)
            moved.rename(log)

    monkeypatch.setattr("warehouse.tables.delta.time.sleep", put_back)
    assert len(lake.snapshot().rows(Caption)) == 6
    assert len(looks) == 2
    next(log.glob("*.json")).write_text("nonsense")  # what stays broken is told in a line
    with pytest.raises(LogError, match=r"tables/snapshots/_delta_log: cannot be read \(.*Json error.*\); `metascenes doctor lake`") as told:
        lake.snapshot()
    assert "\n" not in str(told.value)
    assert "unknown" not in str(told.value)


@pytest.mark.parametrize(("damage", "said"), [("missing", "is missing, which snapshot"), ("cut off", "cannot be read")])
def test_data_file_that_is_damaged_is_named(lake: Lake, damage: str, said: str) -> None:
    name = lake.snapshot().files("instances")[0]
    file = Path(lake.address) / name
    data = file.read_bytes()
    file.unlink()
    if damage == "cut off":
        file.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=f"{re.escape(name)}: {said}") as told:
        lake.snapshot().connect()
    assert "\n" not in str(told.value)
    file.write_bytes(data)
    lake.snapshot().connect().close()


@pytest.mark.whole
def test_commands_say_what_they_do(lake: Lake) -> None:
    def run(*arguments: str) -> Any:
        return CliRunner().invoke(cli, ["lake", *arguments, "--lake", lake.address])

    before = digests(lake.snapshot())
    told = json.loads(run("compact", "--dry-run", "--json").output)
    assert told["snapshot_id"] is None
    assert len(told["tables"]) > 10
    assert "would be done" in run("compact", "--dry-run").output
    done = json.loads(run("compact", "--json", "--table", "captions", "--table", "scenes").output)
    assert [one["table"] for one in done["tables"]] == ["captions", "scenes"]
    assert run("compact", "--table", "captions").output == "nothing to put together\n"
    told = json.loads(run("vacuum", "--days", "0", "--dry-run", "--json").output)
    done = json.loads(run("vacuum", "--days", "0", "--json").output)
    assert {**told, "log_bytes": 0, "bytes": 0} == {**done, "log_bytes": 0, "bytes": 0}
    assert done["snapshots"] == [1, 3, 4, 5, 6, 7]
    assert "0 snapshots" in run("vacuum").output
    assert digests(lake.snapshot()) == before
    assert run("compact", "--table", "nothing").exit_code != 0
    for name in ("compact", "vacuum", "backup", "restore", "erase"):
        assert "Example: metascenes lake" in run(name, "--help").output


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("command", ["compact", "vacuum"])
def test_upkeep_that_dies_at_any_step_is_finished_by_the_next(filled: Path, tmp_path: Path, command: str) -> None:
    results = kills(tmp_path / "work", filled, command)
    undisturbed = results[-1]
    assert undisturbed["code"] == 0
    assert len(results) > 8
    for result in results[:-1]:
        assert result["code"] == 9, result
        assert result["before"] == result["after"] == undisturbed["first"], f"step {result['step']}: the same rows, always"
        assert all("is named by no version" in finding for finding in result["findings"]), result  # a vacuum removes it


def test_storage_walks_what_lies_below(lake: Lake) -> None:
    storage: Storage = lake.storage
    folder = Path(lake.address)
    for below in ("", "tables", "blobs", "tables/captions/_delta_log"):
        expected = {str(path.relative_to(folder)): path.stat().st_size for path in (folder / below).rglob("*") if path.is_file()}
        assert {entry.path: entry.size for entry in storage.walk(below)} == expected
    assert list(storage.walk("nothing")) == []
