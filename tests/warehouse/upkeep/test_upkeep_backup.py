"""Backup and restore: a consistent copy of a lake that others write to, made and unmade without losing a byte."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.captions import Caption
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.warehouse.upkeep.test_erasure import found_in, kills
from tests.whole_scenes import stage_batch, stage_whole_scene
from warehouse.lake import Lake
from warehouse.release import make_release, releases
from warehouse.tables.digest import digests
from warehouse.upkeep.backup import backup, restore
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum

pytestmark = pytest.mark.whole

SCENES = [f"demo/scene{number:04d}_00" for number in range(3)]


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    lake = Lake.open(tmp_path_factory.mktemp("filled") / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "old", at=number)
        lake.commit()
    make_release(lake, "v1", snapshot_id=2, notes="for the paper")
    stage_batch(lake, "batch-1", SCENES, at=10)
    lake.commit()
    stage_whole_scene(lake, SCENES[0], "staged only", at=20)
    return Path(lake.address)


@pytest.fixture
def lake(filled: Path, tmp_path: Path) -> Lake:
    shutil.copytree(filled, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


def bytes_of(folder: Path) -> dict[str, bytes]:
    """All files of a lake but those of a backup's own, what is staged, and hints that can be had anew."""
    left_out = ("backup.json", "backup.parquet", "lease.json", "staged", "tmp")
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).parts[0] not in left_out and path.name != "_last_checkpoint"
    }


def everything(lake: Lake) -> Any:
    """What a lake says, in all snapshots and releases."""
    return [(row, digests(lake.snapshot(row.snapshot_id))) for row in lake.snapshot().snapshots], releases(lake)


@pytest.mark.slow
def test_a_restored_lake_is_the_lake(lake: Lake, tmp_path: Path) -> None:
    done = backup(lake, tmp_path / "backup")
    assert done.copied_files == done.files > 100
    restored = restore(tmp_path / "backup", tmp_path / "new")
    assert (restored.files, restored.bytes) == (done.files, done.bytes)
    new = Lake.open(tmp_path / "new")
    assert everything(new) == everything(lake) == everything(Lake.open(tmp_path / "backup"))
    before, after = bytes_of(Path(lake.address)), bytes_of(Path(new.address))
    # Blobs that only staged rows name are not part of it, nor are former lists of the snapshots.
    assert after == {path: data for path, data in before.items() if path in after}
    assert all(path.startswith(("blobs/", "tables/snapshots/part-")) for path in before.keys() - after.keys())
    assert inspect(new).findings == inspect(Lake.open(tmp_path / "backup")).findings == ()
    stage_whole_scene(new, SCENES[1], "goes on", at=50)
    assert new.commit() is not None
    assert len(new.snapshot().rows(Caption)) == 6


def test_only_what_is_new_is_copied_again(lake: Lake, tmp_path: Path) -> None:
    first = backup(lake, tmp_path / "backup")
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "backup").glob("blobs/*/*/*")}
    assert backup(lake, tmp_path / "backup").copied_files <= 1
    stage_whole_scene(lake, SCENES[2], "new", at=30)
    lake.commit(scenes=SCENES[2:])
    again = backup(lake, tmp_path / "backup")
    assert 10 < again.copied_files < first.files / 2
    assert all(path.stat().st_mtime_ns == then for path, then in times.items())
    restore(tmp_path / "backup", tmp_path / "new")
    assert everything(Lake.open(tmp_path / "new")) == everything(lake)


@pytest.mark.slow
def test_what_the_lake_forgot_leaves_the_backup(lake: Lake, tmp_path: Path) -> None:
    backup(lake, tmp_path / "backup")
    assert found_in(tmp_path / "backup", "scene0001_00")
    compact(lake)
    vacuum(lake, days=0)
    assert erase(lake, SCENES[1]).proof.hits == ()  # type: ignore[union-attr]
    done = backup(lake, tmp_path / "backup")
    assert done.removed_files > 10
    assert found_in(tmp_path / "backup", "scene0001_00") == []
    assert everything(Lake.open(tmp_path / "backup")) == everything(lake)
    assert inspect(Lake.open(tmp_path / "backup")).findings == ()


@pytest.mark.slow
def test_others_may_write_meanwhile(lake: Lake, tmp_path: Path) -> None:
    """Snapshots are committed while files are copied: the backup holds those that there were, whole."""
    stop = threading.Event()
    committed: list[int] = []

    def write() -> None:
        other = Lake.open(lake.address)
        at = 100
        while not stop.is_set():
            at += 1
            stage_whole_scene(other, SCENES[at % 3], at, at=at)
            snapshot = other.commit()
            committed.append(snapshot.snapshot_id if snapshot else 0)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for number in range(3):
            done = backup(lake, tmp_path / "backup")
            copy = Lake.open(tmp_path / "backup")
            assert copy.snapshot().snapshot_id == done.snapshot_id
            for row in copy.snapshot().snapshots[-2:]:
                captions = copy.snapshot(row.snapshot_id).rows(Caption)
                assert len(captions) == 2 * len({caption.scene_id for caption in captions})
            restore(tmp_path / "backup", tmp_path / f"new{number}")
            assert digests(Lake.open(tmp_path / f"new{number}").snapshot()) == digests(lake.snapshot(done.snapshot_id))
    finally:
        stop.set()
        thread.join()
    assert committed
    assert inspect(Lake.open(tmp_path / "backup")).errors == ()


def test_addresses_that_hold_other_objects_are_refused(lake: Lake, tmp_path: Path) -> None:
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.tex").write_text("x")
    other = Lake.open(tmp_path / "other")
    stage_whole_scene(other, SCENES[0], "x", at=0)
    other.commit()
    backup(other, tmp_path / "others")
    for target, text in (
        (full, "holds other files"), (tmp_path / "others", "backup of another lake"), (Path(lake.address) / "b", "in the lake itself"),
        (Path(lake.address), "in the lake itself"), (Path(other.address), "holds other files"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            backup(lake, target)
    with pytest.raises(InputError, match="no snapshot yet"):
        backup(Lake.open(tmp_path / "none"), tmp_path / "b")
    with pytest.raises(InputError, match="there is no whole backup"):
        restore(full, tmp_path / "new")
    backup(lake, tmp_path / "backup")
    for target in (full, lake.address):
        with pytest.raises(InputError, match="the address is not empty"):
            restore(tmp_path / "backup", target)
    assert (full / "thesis.tex").read_text() == "x"
    assert sorted(path.name for path in full.iterdir()) == ["thesis.tex"]


def test_another_history_is_no_increment(lake: Lake, tmp_path: Path) -> None:
    """A lake that was restored from an old backup went on by itself: its backup is not that of the first."""
    backup(lake, tmp_path / "old")
    restore(tmp_path / "old", tmp_path / "twin")
    for address, tag in ((lake.address, "a"), (str(tmp_path / "twin"), "b")):
        one = Lake.open(address)
        stage_whole_scene(one, SCENES[1], tag, at=70)
        one.commit(scenes=[SCENES[1]])
    backup(lake, tmp_path / "old")
    with pytest.raises(InputError, match="history is not that of the lake"):
        backup(Lake.open(tmp_path / "twin"), tmp_path / "old")
    assert everything(Lake.open(tmp_path / "old")) == everything(lake)


@pytest.mark.parametrize("damage", ["changed", "cut", "gone", "manifest", "summary"])
def test_damaged_backups_are_refused(lake: Lake, tmp_path: Path, damage: str) -> None:
    backup(lake, tmp_path / "backup")
    file = sorted((tmp_path / "backup").glob("tables/instances/*.parquet"))[0]
    if damage == "changed":
        file.write_bytes(file.read_bytes()[:-1] + b"x")
    elif damage == "cut":
        os.truncate(file, 10)
    elif damage == "gone":
        file.unlink()
    else:
        (tmp_path / "backup" / {"manifest": "backup.parquet", "summary": "backup.json"}[damage]).write_bytes(b"x")
    with pytest.raises(InputError, match=r"is damaged|is missing from the backup|cannot be read"):
        restore(tmp_path / "backup", tmp_path / "new")
    assert not (tmp_path / "new" / "lake.json").exists()
    with pytest.raises(InputError):  # nobody takes it for a lake
        stage_whole_scene(Lake.open(tmp_path / "new"), SCENES[0], "x", at=0) if damage in ("changed", "cut", "gone") else restore("x", "y")


@pytest.mark.parametrize("place", ["../outside", "tables/../../outside", "{folder}/outside"])
def test_a_backup_does_not_choose_where_files_go(lake: Lake, tmp_path: Path, place: str) -> None:
    backup(lake, tmp_path / "backup")
    path = place.format(folder=tmp_path)
    file = tmp_path / "backup" / path
    file.write_bytes(b"x")
    listed = pq.read_table(tmp_path / "backup" / "backup.parquet").to_pylist()
    more = {"path": path, "size": 1, "sha256": hashlib.sha256(b"x").hexdigest()}
    pq.write_table(pa.Table.from_pylist([*listed, more]), tmp_path / "backup" / "backup.parquet")
    before = {name for name in tmp_path.rglob("*") if "restored" not in name.parts}
    with pytest.raises(InputError, match="which is no file of a lake"):
        restore(tmp_path / "backup", tmp_path / "deep" / "restored")
    assert {name for name in tmp_path.rglob("*") if "deep" not in name.parts} == before
    assert not (tmp_path / "deep" / "outside").exists()
    assert not Lake.open(tmp_path / "deep" / "restored").exists


def test_damaged_lakes_are_not_backed_up(lake: Lake, tmp_path: Path) -> None:
    name = lake.snapshot().arrow("scenes").column("mesh_blob")[0].as_py()
    path = lake.blobs.path(name)
    path.write_bytes(b"x")
    with pytest.raises(InputError, match="content differs"):
        backup(lake, tmp_path / "backup")
    path.unlink()
    with pytest.raises(InputError, match="is missing"):
        backup(lake, tmp_path / "backup")
    (Path(lake.address) / "erasure.json").write_text("{}")
    with pytest.raises(InputError, match="an erasure is not finished"):
        backup(lake, tmp_path / "backup")


def test_a_restore_that_was_killed_goes_on(lake: Lake, tmp_path: Path) -> None:
    backup(lake, tmp_path / "backup")
    code = """
import os, sys
from warehouse.upkeep import backup
from warehouse.storage.files import LocalStorage
count, real = 0, LocalStorage.write
def write(self, path, data, lasting=True):
    global count
    count += 1
    if count == int(sys.argv[3]): os._exit(9)
    return real(self, path, data, lasting)
LocalStorage.write = write
backup.restore(sys.argv[1], sys.argv[2])
"""
    for step in (1, 2, 40, 150):
        command = [sys.executable, "-c", code, str(tmp_path / "backup"), str(tmp_path / "new"), str(step)]
        assert subprocess.run(command, cwd=REPOSITORY, check=False).returncode == 9
        assert not (tmp_path / "new" / "lake.json").exists()
    done = restore(tmp_path / "backup", tmp_path / "new")
    assert 0 < done.copied_files < done.files
    assert everything(Lake.open(tmp_path / "new")) == everything(lake)
    assert inspect(Lake.open(tmp_path / "new")).findings == ()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_backup_that_dies_at_any_step_is_finished_by_the_next(filled: Path, tmp_path: Path) -> None:
    results = kills(tmp_path / "work", filled, "backup")
    undisturbed = results[-1]
    assert undisturbed["code"] == 0
    for result in results[:-1]:
        assert result["code"] == 9, result
        assert result["before"] in (None, undisturbed["after"]), f"step {result['step']}: no lake yet, or all of it"
        assert result["after"] == undisturbed["after"]
        assert result["findings"] == []


def test_commands(lake: Lake, tmp_path: Path) -> None:
    def run(*arguments: str) -> Any:
        return CliRunner().invoke(cli, ["lake", *arguments])

    done = json.loads(run("backup", str(tmp_path / "b"), "--lake", lake.address, "--json").output)
    assert done["copied_files"] == done["files"]
    assert "0 removed" in run("backup", str(tmp_path / "b"), "--lake", lake.address).output
    assert run("restore", str(tmp_path / "b"), "--lake", str(tmp_path / "n")).exit_code == 0
    assert digests(Lake.open(tmp_path / "n").snapshot()) == digests(lake.snapshot())
    again = run("restore", str(tmp_path / "b"), "--lake", str(tmp_path / "n"))
    assert again.exit_code != 0
    assert "not empty" in str(again.exception)
