"""Commits: what they may not depend on, and what damage does not stop them."""

from __future__ import annotations

import errno
import itertools
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from schemas.candidates import Candidate
from schemas.captions import Caption
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from warehouse.lake import Lake
from warehouse.storage.files import LocalStorage
from warehouse.storage.objects import ObjectStorage
from warehouse.tables import commit, staging
from warehouse.tables.datafiles import log_version
from warehouse.tables.delta import FOLDER
from warehouse.tables.digest import digests


class _Backwards:
    """Threads that happen to take the last task first, and each only when the one before is done."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        pass

    def __enter__(self) -> _Backwards:
        return self

    def __exit__(self, *problem: object) -> None:
        pass

    def map(self, work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        return [work(item) for item in reversed(items)][::-1]


def committed(folder: Path) -> list[dict[str, str]]:
    """Digests of the snapshots of a lake with new scenes, replaced ones, assets that others keep or nobody, and a withdrawal."""
    lake = Lake.open(folder)
    for number in range(4):
        stage_scene(lake, number, "old", at=number)
    lake.commit()
    for number in (0, 1, 4):
        stage_scene(lake, number, "new", at=10 + number)
    lake.stage_rows(stage_run(scene_id(2), "capture", fingerprint("changed"), at=20))
    lake.commit()
    return [digests(lake.snapshot(number)) for number in (1, 2)]


def test_tables_may_be_written_in_any_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = committed(tmp_path / "threads")
    monkeypatch.setattr(commit, "ThreadPoolExecutor", _Backwards)
    assert committed(tmp_path / "backwards") == expected


def test_rows_that_are_not_held_are_read_in_their_turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = committed(tmp_path / "held")
    monkeypatch.setattr(staging, "HELD_BYTES", 0)
    assert committed(tmp_path / "read again") == expected


def test_a_disk_that_cannot_be_read_for_a_moment_costs_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number in range(2):
        stage_scene(lake, number, "old", at=number)
    read = LocalStorage.read

    def refused(storage: LocalStorage, path: str) -> bytes:
        if path.endswith("@captions.parquet"):
            raise OSError(errno.EIO, "Input/output error", path)
        return read(storage, path)

    with monkeypatch.context() as patched:
        patched.setattr(LocalStorage, "read", refused)
        with pytest.raises(OSError, match="Input/output error"):
            lake.commit()
    lake = Lake.open(tmp_path / "lake")
    assert lake.snapshot().snapshot_id == 0
    lake.commit()
    assert set(lake.snapshot().arrow("stage_runs").column("outcome").to_pylist()) == {"done"}
    undisturbed = Lake.open(tmp_path / "undisturbed")
    for number in range(2):
        stage_scene(undisturbed, number, "old", at=number)
    undisturbed.commit()
    assert digests(lake.snapshot()) == digests(undisturbed.snapshot())


def test_damage_behind_a_sound_footer_loses_its_own_run_alone(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number in range(2):
        stage_scene(lake, number, "old", at=number)
    (file,) = Path(lake.address).glob(f"staged/{staging.quoted_scene(scene_id(0))}@captions@*@captions.parquet")
    content = bytearray(file.read_bytes())
    content[4:200] = bytes(196)
    file.write_bytes(content)
    lake.commit()
    last = lake.history()[scene_id(0), "captions"].last
    assert (last.outcome, last.error_kind) == ("lost", "lost")
    assert "cannot be read" in str(last.error)
    assert {row.scene_id for row in lake.snapshot().rows(Caption)} == {scene_id(1)}


def test_whoever_opens_a_table_reads_few_entries_of_its_log(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number in range(23):
        lake.stage_rows(stage_run(scene_id(number), "captions", fingerprint(number)))
        lake.commit()
    for name in ("stage_runs", "snapshots"):
        files = lake.storage.names(f"{FOLDER}/{name}/_delta_log")
        versions = {ending: [log_version(file) or 0 for file in files if file.endswith(ending)] for ending in (".json", ".parquet")}
        assert max(versions[".json"]) >= 22
        assert max(versions[".json"]) - max(versions[".parquet"]) < 10


def test_files_that_are_written_together_are_there_in_order_and_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    storage = LocalStorage(tmp_path / "lake")
    files = {f"staged/{number}": bytes([number]) * number for number in range(9)}
    seen: list[list[str]] = []
    real = os.replace

    def replace(source: Path, target: Path) -> None:
        seen.append(storage.names("staged"))
        real(source, target)

    synced: list[str] = []
    sync = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        sync(descriptor)

    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr(os, "fsync", fsync)
    storage.write_together(files)
    assert synced[-1] == str(tmp_path / "lake" / "staged"), "the names last, once all are there"
    assert len([path for path in synced if "/tmp/" in path.removeprefix(str(tmp_path))]) == len(files)
    assert seen[-1] == [str(number) for number in range(8)], "the last one comes when all others are there"
    assert {path: storage.read(path) for path in files} == files
    assert storage.names("tmp") == []
    monkeypatch.setattr(os, "fsync", fails_at(sync, 3))
    with pytest.raises(OSError, match="No space left"):
        storage.write_together({f"later/{number}": b"0" for number in range(5)})
    assert storage.names("later") == storage.names("tmp") == []


@pytest.mark.parametrize("number", [0, 1, 2, 40])
def test_files_are_removed_whether_they_are_there_or_not(tmp_path: Path, number: int) -> None:
    storage = LocalStorage(tmp_path / "lake")
    paths = [f"staged/{i}" for i in range(number)]
    for path in [*paths, "staged/stays"]:
        storage.write(path, b"0")
    storage.remove_all(["staged/nosuch", *paths])
    storage.remove_all(paths)
    assert storage.names("staged") == ["stays"]


def test_a_file_that_cannot_be_removed_is_said(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path / "lake")
    storage.write("staged/folder/file", b"0")
    with pytest.raises(OSError, match="folder"):
        storage.remove_all(["staged/nosuch", "staged/folder", "staged/none"])


def test_a_store_is_sent_the_last_of_files_when_it_has_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    store = ObjectStorage("s3://bucket/lake")
    begun, there = [], []

    def write(path: str, data: bytes) -> None:
        begun.append((path, len(there)))
        time.sleep(0.002 * (9 - data[0]))  # the first ones take longest
        there.append(path)

    monkeypatch.setattr(store, "write", write)
    store.write_together({str(number): bytes([number]) for number in range(9)})
    assert begun[-1] == ("8", 8)
    assert sorted(there) == [str(number) for number in range(9)]


def fails_at(real: Callable[[int], None], number: int) -> Callable[[int], None]:
    """A function that finds the disk full when it is called for the n-th time."""
    calls = itertools.count(1)

    def call(descriptor: int) -> None:
        if next(calls) == number:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    return call


def test_rows_that_were_found_are_looked_for_again_once_they_are_gone(tmp_path: Path) -> None:
    lake, scene, printed = Lake.open(tmp_path / "lake"), scene_id(0), fingerprint("candidates")

    def found() -> list[int | None]:
        seen = [lake.staged_rows(table, scene, printed) for table in ("candidates", "assets", "texture_charts")]
        return [None if rows is None else len(rows) for rows in seen]

    assert found() == [None, None, None]
    for at in (0, 10):
        slots = [sample(Candidate, scene_id=scene, slot=slot, asset_id=None) for slot in (1, 2)]
        lake.stage_rows(stage_run(scene, "candidates", printed, at=at), {"candidates": slots})
        assert found() == found() == [2, 0, 0], "staged, with tables that have no rows"
        lake.commit()
        assert found() == [None, None, None]
