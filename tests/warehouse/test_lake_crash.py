"""The lake when processes die or meet: nothing committed is lost, nothing is doubled, nothing is left over."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from schemas.captions import Caption
from schemas.runs import StageRun
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from warehouse.lake import Lake
from warehouse.sharing.lease import LIFE_SECONDS, PATH, Lease, LeaseError
from warehouse.sharing.writer import new_token, this_writer, writer_of
from warehouse.storage.files import storage_at
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole


def load(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.warehouse.lake_load", *map(str, arguments)]
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)


@contextmanager
def started(*arguments: object, says: str) -> Iterator[subprocess.Popen[str]]:
    """A process that has said `says`; killed at the end whatever happens."""
    process = load(*arguments)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == says
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def left_over(lake: Lake) -> list[str]:
    folder = Path(lake.address)
    return sorted(str(p.relative_to(folder)) for name in ("staged", "tmp") for p in (folder / name).rglob("*") if p.is_file())


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake with a snapshot, and more staged: replacements, a withdrawal, new scenes, assets that go."""
    lake = Lake.open(tmp_path_factory.mktemp("prepared") / "lake")
    for number in range(3):
        stage_scene(lake, number, "old", at=number)
    lake.commit("prepared")
    stage_scene(lake, 0, "new", at=10)
    stage_scene(lake, 3, "new", at=11)
    lake.stage_rows(stage_run(scene_id(1), "capture", fingerprint("changed"), at=12))  # withdraws what follows
    return Path(lake.address)


@pytest.mark.parametrize("stride", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_commit_that_dies_at_any_step_is_made_good_by_the_next(prepared: Path, tmp_path: Path, stride: int) -> None:
    before = digests(Lake.open(prepared).snapshot())
    process = load("crashes", prepared, tmp_path / "work", stride)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    results = [json.loads(line) for line in output.splitlines()]
    undisturbed = results[-1]
    assert undisturbed["codes"] == [0, 0, 0]
    snapshot_id, expected = undisturbed["before"]
    assert snapshot_id == 2
    assert expected != before
    assert results[-1]["step"] > 20, "every step of the commit was counted"
    for result in results[:-1]:
        assert result["codes"] == [9, 0, 0], result
        assert result["before"] in ([1, before], [2, expected]), f"step {result['step']}: readers see a whole snapshot, the old or the new"
        assert result["after"] == [2, expected], f"step {result['step']}"
        assert result["left"] == [], f"step {result['step']}"
    states = [result["before"][0] for result in results]
    assert states == sorted(states), "once the snapshot is there it stays"
    assert {1, 2} == set(states)


@pytest.mark.slow
def test_processes_that_stage_and_commit_at_once_lose_and_double_nothing(tmp_path: Path) -> None:
    address, count, rounds = tmp_path / "lake", 6, 2
    processes = [load("writer", address, first, count, rounds) for first in (0, 3)]  # scenes 3, 4, 5 by both
    for process in processes:
        assert process.wait(timeout=120) == 0
        assert process.stdout is not None
        process.stdout.close()
    lake = Lake.open(address)
    assert lake.commit() is None
    lake.sweep()
    assert left_over(lake) == []
    alone = Lake.open(tmp_path / "alone")
    for number in range(9):
        stage_scene(alone, number, rounds - 1, at=number)
    alone.commit()
    assert digests(lake.snapshot()) == digests(alone.snapshot())
    runs = [(run.scene_id, run.stage) for run in lake.snapshot().rows(StageRun) if run.outcome == "done"]
    for number in range(9):
        own = runs.count((scene_id(number), "capture"))
        # Both processes staged 3, 4 and 5; the one that overtakes the other may leave it nothing to be adopted.
        assert own == rounds if number not in (3, 4, 5) else rounds <= own <= 2 * rounds
    seen = 0
    for snapshot in lake.snapshot().snapshots:
        captions = lake.snapshot(snapshot.snapshot_id).rows(Caption)
        assert len(captions) == 5 * len({row.scene_id for row in captions})
        assert all(len({row.sentence for row in captions if row.scene_id == scene}) == 1 for scene in {row.scene_id for row in captions})
        seen += 1
    assert seen == len(lake.snapshot().snapshots) > 2


def test_killed_writers_lose_nothing_that_was_committed(tmp_path: Path) -> None:
    address = tmp_path / "lake"
    Lake.open(address).commit()
    last = 0
    for i in range(3):
        process = load("writer", address, 0, 4, 3)
        time.sleep(1.2 + 0.17 * i)
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
        reader = Lake.open(address).snapshot()
        assert reader.snapshot_id >= last
        last = reader.snapshot_id
        for row in reader.rows(Caption):
            assert row.sentence in ("0", "1", "2")
    lake = Lake.open(address)
    for number in range(4):
        stage_scene(lake, number, "final", at=10**6)
    lake.commit()
    lake.sweep()
    alone = Lake.open(tmp_path / "alone")
    for number in range(4):
        stage_scene(alone, number, "final", at=number)
    alone.commit()
    assert digests(lake.snapshot()) == digests(alone.snapshot())
    assert left_over(lake) == []


def test_lease_of_a_killed_process_is_taken_over_at_once(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    lake.blobs.put(b"x", "glb")
    with started("hold", lake.address, says="held") as process:
        with pytest.raises(LeaseError, match=rf"{process.pid}.*holds the lake's lease"), Lease(lake.storage, timeout=0.2):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
        with Lease(lake.storage, timeout=LIFE_SECONDS / 2) as lease:  # long before it would run out
            lease.check()
    assert not (Path(lake.address) / PATH).exists()


def test_lease_has_one_holder_at_a_time(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage = storage_at(tmp_path / "lake")
    dead = f"{this_writer().machine}-999999-1-1"
    storage.create(PATH, json.dumps({"token": dead, "host": "here", "expires": time.time() + 999, "life": 60}).encode())
    inside, most, total = 0, 0, 0
    lock = threading.Lock()

    def work() -> None:
        nonlocal inside, most, total
        for _ in range(5):
            with Lease(storage, timeout=60):
                with lock:
                    inside += 1
                    most, total = max(most, inside), total + 1
                time.sleep(0.002)
                with lock:
                    inside -= 1

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (most, total) == (1, 30)


def test_lease_of_another_host_is_respected_until_it_runs_out(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage = storage_at(tmp_path / "lake")
    elsewhere = {"token": "ffffffff-12-34-1", "host": "elsewhere", "expires": time.time() + 600, "life": 60}
    storage.create(PATH, json.dumps(elsewhere).encode())
    with pytest.raises(LeaseError, match="elsewhere"), Lease(storage, timeout=0.1):
        pass
    storage.write(PATH, json.dumps(elsewhere | {"expires": time.time() - 0.1}).encode())
    with Lease(storage):
        assert json.loads(storage.read(PATH))["host"] != "elsewhere"


def _check_until_it_is_lost(lease: Lease) -> None:
    """The next renewal notices it."""
    while True:
        lease.check()
        time.sleep(0.05)


def test_lease_is_renewed_and_its_loss_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage = storage_at(tmp_path / "lake")
    with Lease(storage, life=6.0) as lease:
        first = json.loads(storage.read(PATH))["expires"]
        while json.loads(storage.read(PATH))["expires"] <= first:
            time.sleep(0.05)
        lease.check()
        stolen = json.dumps({"token": "ffffffff-12-34-1", "host": "elsewhere", "expires": time.time() + 99, "life": 60}).encode()
        while (found := storage.read_tagged(PATH)) is None or not storage.swap(PATH, stolen, found[1]):
            time.sleep(0.001)  # renewed in between
        with pytest.raises(LeaseError, match="was lost to another process"):
            _check_until_it_is_lost(lease)
    assert storage.read(PATH) == stolen, "somebody else's lease is not given back"


def test_committer_that_lost_its_lease_cannot_write_a_snapshot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was stopped for so long that another took the lease over and committed; then it goes on."""
    from warehouse.tables.commit import Commit

    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 0, "a", at=0)
    lake.commit()
    stage_scene(lake, 1, "a", at=1)
    storage = lake.storage
    real = Commit._write_snapshot

    def stopped(self: Commit, *arguments: object) -> None:
        monkeypatch.setattr(Commit, "_write_snapshot", real)
        held = storage.read(PATH)
        storage.remove(PATH)
        other = Lake.open(lake.address)
        stage_scene(other, 2, "b", at=2)
        other.commit("the other's")
        storage.write(PATH, held)
        real(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Commit, "_write_snapshot", stopped)
    with pytest.raises(Exception, match="Failed to commit transaction"):
        lake.commit("late")
    assert [row.note for row in lake.snapshot().snapshots] == ["", "the other's"]
    lake.commit()
    assert {row.scene_id for row in lake.snapshot().rows(Caption)} == {scene_id(0), scene_id(1), scene_id(2)}
    assert len(lake.snapshot().rows(Caption)) == 15
    assert len(lake.snapshot().rows(StageRun)) == 9


def test_sweep_removes_what_the_dead_left_and_nothing_of_the_living(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    folder = Path(lake.address)
    with started("half", lake.address, says="half") as process:
        mine = folder / "tmp" / new_token()
        mine.write_bytes(b"being written")
        foreign = folder / "tmp" / "ffffffff-1-2-3"
        foreign.write_bytes(b"by another host")
        stage_scene(lake, 2, "complete", at=0)
        complete = set(left_over(lake))
        lake.sweep()
        assert set(left_over(lake)) == complete, "the living are left alone, and so is what can be adopted"
        process.kill()
        process.wait()
        lake.sweep()
        remaining = left_over(lake)
        assert not any(f"-{process.pid}-" in path for path in remaining)
        assert str(mine.relative_to(folder)) in remaining
        assert str(foreign.relative_to(folder)) in remaining
    os.utime(foreign, (0, 0))
    mine.unlink()
    lake.commit()
    lake.sweep()
    assert left_over(lake) == []
    assert {row.scene_id for row in lake.snapshot().rows(Caption)} == {scene_id(2)}


def test_sweep_removes_runs_that_can_never_be_adopted_unless_they_are_kept(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    run = stage_run(scene_id(1), "captions", fingerprint("c"), f"capture={fingerprint('never')}")
    lake.stage_rows(run, {"captions": [sample(Caption, scene_id=scene_id(1))]})
    lake.sweep({(run.scene_id, run.stage, run.fingerprint)})
    assert len(left_over(lake)) == 2
    lake.sweep({(run.scene_id, run.stage, fingerprint("other"))})
    assert left_over(lake) == []


def test_sweep_never_removes_files_that_no_writer_named(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 0, "a", at=0)
    lake.commit()
    folder = Path(lake.address)
    half = f"a@captions@{fingerprint(1)}@my-2024-01@captions.parquet"
    theirs = [folder / "tmp" / "my-2024-notes", folder / "staged" / half, folder / "tables" / "captions" / "notes.tmp"]
    ours = folder / "tmp" / f"{this_writer().machine}-999999-1-1"
    for path in (*theirs, ours):
        path.write_bytes(b"mine")
        os.utime(path, (0, 0))
    lake.sweep()
    assert [path.exists() for path in (*theirs, ours)] == [True, True, True, False]


def _as_of(lake: Lake, run: StageRun, token: str) -> None:
    """Rename the files of a staged run as if `token`'s writer had left them."""
    for path in list((Path(lake.address) / "staged").glob(f"*@{run.stage}@{run.fingerprint}@*")):
        parts = path.name.split("@")
        path.rename(path.with_name("@".join([*parts[:3], token, parts[4]])))


def test_sweep_spares_what_living_neighbors_staged(tmp_path: Path) -> None:
    """It cannot be adopted yet, and this run knows nothing of it; its writer may be about to stage what it read."""
    lake = Lake.open(tmp_path / "lake")
    run = stage_run(scene_id(1), "captions", fingerprint("c"), f"capture={fingerprint('later')}")
    lake.stage_rows(run, {"captions": [sample(Caption, scene_id=scene_id(1))]})
    neighbor = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        _as_of(lake, run, _token_of(neighbor.pid))
        lake.sweep()
        assert len(left_over(lake)) == 2
        assert lake.abandoned() == set()
    finally:
        neighbor.communicate(b"\n")
    assert lake.abandoned() == {scene_id(1)}
    lake.sweep({(run.scene_id, run.stage, run.fingerprint)})
    assert len(left_over(lake)) == 2
    lake.sweep()
    assert left_over(lake) == []


def test_abandoned_scenes_are_those_of_which_no_writer_lives(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    assert lake.abandoned() == set()
    dead, elsewhere = f"{this_writer().machine}-999999-1-1", "ffffffff-1-2-3"
    now = datetime.now(UTC)
    for number, writers in enumerate([[dead], [None], [dead, None], [elsewhere], [elsewhere]]):
        for at, (stage, token) in enumerate(zip(("capture", "captions"), writers, strict=False)):
            run = stage_run(scene_id(number), stage, fingerprint(number, stage), at=at)
            started = now - timedelta(days=2 if number == 3 else 0)
            lake.stage_rows(dataclasses.replace(run, started_at=started))
            if token is not None:
                _as_of(lake, run, token)
    assert lake.abandoned() == {scene_id(0), scene_id(3)}
    lake.commit(scenes=lake.abandoned())
    assert {row.scene_id for row in lake.snapshot().rows(StageRun)} == {scene_id(0), scene_id(3)}
    assert lake.abandoned() == set()
    assert {state.scene_id for state in lake.history().values() if state.is_staged} == {scene_id(1), scene_id(2), scene_id(4)}


def test_what_a_killed_run_left_is_abandoned_and_adopted(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    child = "import sys; from warehouse.lake import Lake; from tests.warehouse.lake_load import stage_scene; "
    child += "stage_scene(Lake.open(sys.argv[1]), 1, 'a', at=0)"
    subprocess.run([sys.executable, "-c", child, lake.address], cwd=REPOSITORY, check=True)
    stage_scene(lake, 2, "mine", at=0)
    assert lake.abandoned() == {scene_id(1)}
    lake.commit(scenes=lake.abandoned())
    assert {row.scene_id for row in lake.snapshot().rows(Caption)} == {scene_id(1)}


def _token_of(pid: int) -> str:
    from warehouse.sharing.writer import Writer, _process_start

    return f"{Writer(this_writer().machine, pid, _process_start(pid) or '')}-1"


def test_temporary_files_of_killed_table_writes_are_swept(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 1, "a", at=0)
    lake.commit()
    table = Path(lake.address) / "tables" / "captions"
    wrecks = [table / "part-0-x.snappy.parquet#1", table / "_delta_log" / "_commit_12.json.tmp"]
    for wreck in wrecks:
        wreck.write_bytes(b"half")
    lake.sweep()
    assert not any(wreck.exists() for wreck in wrecks)
    assert len(lake.snapshot().rows(Caption)) == 5


def test_writer_is_told_from_another_with_its_process_id() -> None:
    own = this_writer()
    assert own.is_here
    assert own.is_alive
    assert writer_of(new_token()) == own
    assert not writer_of(f"{own.machine}-{own.pid}-1-1").is_alive  # type: ignore[union-attr]
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    from warehouse.sharing.writer import Writer, _process_start

    other = Writer(own.machine, child.pid, _process_start(child.pid) or "")
    assert other.is_alive
    child.communicate(b"\n")
    assert not other.is_alive
    assert writer_of("thesis.tex") is None
