"""Whole runs on every runner: the same rows and blobs, and what becomes of lost workers, full disks, stores and servers that are away."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from bench.flows.small_scenes import SETTINGS, write_small_scans
from flows.run.fanout.runners import task_runner
from tests.services import have_been_started, prefect_server_process, s3_server
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("home")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    have_been_started(folder / ".prefect")
    return {**kept, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / ".cache")}


@pytest.fixture(scope="module")
def served(home: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment of runs that share a server, which is there sooner than one of their own."""
    with prefect_server_process(tmp_path_factory.mktemp("server")) as server:
        yield {**home, **server.access}


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_scans(tmp_path_factory.mktemp("scans"), 2)


@pytest.fixture(scope="module")
def lake(home: dict[str, str], scans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pool computes, which is the measure for all others."""
    folder = tmp_path_factory.mktemp("lake") / "lake"
    done = run(home, scans, folder)
    assert done.returncode == 0, done.stderr
    return folder


def command(scans: Path, lake: Path, *more: object) -> list[str]:
    given = [part for setting in SETTINGS for part in ("--set", setting)]
    return [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", str(lake), "--workers", "2", *given, *map(str, more)]


def run(home: dict[str, str], scans: Path, lake: Path, *more: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(scans, lake, *more), env=home, capture_output=True, text=True, timeout=400)


def leftovers(lake: Path) -> list[Path]:
    return [
        path
        for name in ("staged", "tmp", "claims", "runs")
        if (lake / name).exists()
        for path in (lake / name).rglob("*")
        if path.is_file()
    ]


@pytest.mark.slow
@pytest.mark.parametrize("runner", ["processes", "dask"])
def test_every_runner_gives_the_same_rows_and_blobs(served: dict[str, str], scans: Path, lake: Path, tmp_path: Path, runner: str) -> None:
    done = run(served, scans, tmp_path / "lake", "--runner", runner, "--batch", 2)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert digests(Lake.open(tmp_path / "lake").snapshot()) == digests(Lake.open(lake).snapshot())
    assert leftovers(tmp_path / "lake") == []


def test_a_cluster_on_this_machine_takes_orders_from_its_run_alone() -> None:
    """Whoever reaches the port of a Dask scheduler has it do what they say."""
    import distributed
    import httpx

    with task_runner("dask", 1) as started:
        scheduler = started.client.cluster.scheduler_address
        assert scheduler.startswith("tls://127.0.0.1:")
        with pytest.raises((OSError, TypeError)):
            distributed.Client(scheduler.replace("tls:", "tcp:"), timeout=30)
        below = [psutil.Process(), *psutil.Process().children(recursive=True)]
        ports = {each.laddr for process in below for each in process.net_connections("inet") if each.status == psutil.CONN_LISTEN}
        assert {each.ip for each in ports} == {"127.0.0.1"}
        for each in ports:
            with contextlib.suppress(httpx.TransportError):  # of TLS
                assert httpx.get(f"http://127.0.0.1:{each.port}/info/main/workers.html", timeout=None).status_code == 404


def workers_of(process: psutil.Process) -> list[psutil.Process]:
    """Processes of a run that compute: spawned ones that have taken up work."""
    found = []
    for child in process.children(recursive=True):
        try:
            if "spawn_main" in " ".join(child.cmdline()) and child.cpu_times().user > 1.0:
                found.append(child)
        except psutil.Error:
            continue
    return found


def staged_runs(lake: Path, outcome: str | None = None) -> set[tuple[str, str]]:
    """Scene and stage of the stage runs that wait for a commit: all, or those that ended so."""
    found = set()
    for path in (lake / "staged").glob("*@stage_runs.parquet"):
        with contextlib.suppress(FileNotFoundError):  # committed meanwhile
            rows = pq.read_table(path, columns=["scene_id", "stage", "outcome"]).to_pylist()
            found |= {(row["scene_id"], row["stage"]) for row in rows if outcome in (None, row["outcome"])}
    return found


def test_a_lost_worker_is_retried_and_bad_input_is_not(home: dict[str, str], lake: Path, tmp_path: Path) -> None:
    scans, target = tmp_path / "scans", tmp_path / "lake"
    write_small_scans(scans, 4)  # for seconds there is always a worker that computes
    write_small_scans(scans, 1, first=9)
    ply = next((scans / "scene0009_00").glob("*.ply"))
    ply.write_bytes(ply.read_bytes()[:-1000])
    process = subprocess.Popen(command(scans, target), env=home, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not (lost := staged_runs(target, "lost")) and process.poll() is None and time.monotonic() < deadline:
        done = staged_runs(target)
        if ("scannet/scene0009_00", "capture") in done and ("scannet/scene0000_00", "captions") in done:
            for worker in workers_of(psutil.Process(process.pid)):
                os.kill(worker.pid, signal.SIGKILL)
            time.sleep(0.5)  # one that was between two stages is not missed: then the next one is killed
        time.sleep(0.02)
    _, err = process.communicate(timeout=300)
    assert lost, err
    assert process.returncode == 1, err
    failed = [line for line in err.splitlines() if line.startswith("failed: ")]
    assert len(failed) == 1, err
    assert "scene0009_00" in failed[0]
    assert "worker lost" in err
    runs = Lake.open(target).snapshot().connect().execute("SELECT scene_id, stage, attempt, outcome FROM stage_runs").fetchall()
    of_broken = [row for row in runs if row[0] == "scannet/scene0009_00"]
    assert of_broken == [("scannet/scene0009_00", "capture", 1, "failed")], "bad input is computed once"
    lost = [row for row in runs if row[3] == "lost"]
    assert lost
    for scene, stage, attempt, _ in lost:
        assert (scene, stage, attempt + 1, "done") in runs
    done = Counter((scene, stage) for scene, stage, _, outcome in runs if outcome == "done")
    assert set(done.values()) == {1}, "what was finished is not done again"
    reader, whole = Lake.open(target).snapshot(), Lake.open(lake).snapshot()
    for table in ("placements", "episodes", "export_files"):
        assert reader.arrow(table, "scannet/scene0000_00") == whole.arrow(table, "scannet/scene0000_00")
    assert leftovers(target) == []


@pytest.mark.slow
def test_a_run_stops_politely_before_the_disk_is_full_and_goes_on_later(served: dict[str, str], scans: Path, tmp_path: Path) -> None:
    target = tmp_path / "lake"
    full = run(served, scans, target, "--keep-free", 1e9)
    assert full.returncode == 1
    assert "--keep-free is 1e+09 GB" in full.stderr
    assert "2 scenes were not begun" in full.stderr
    assert Lake.open(target).history() == {}
    assert leftovers(target) == []
    first = run(served, scans, target, "--scene", "*0000_00")
    assert first.returncode == 0, first.stderr
    small = run(served, scans, tmp_path / "small", "--quota", 1e-4, "--workers", 1)
    assert small.returncode == 1
    assert "--quota is 0.1 MB" in small.stderr
    assert "1 scene was not begun" in small.stderr
    assert len({scene for scene, _ in Lake.open(tmp_path / "small").history()}) == 1, "the first filled it"
    over = run(served, scans, target, "--quota", 1e-6)
    assert over.returncode == 1
    assert "metascenes lake vacuum" in over.stderr
    assert {scene for scene, _ in Lake.open(target).history()} == {"scannet/scene0000_00"}


REPLICATE = """
import sys
from flows.run import patience
from flows.server.process import prefect_server
patience.PAUSES = (1.0,) * 100
with prefect_server():
    from flows.pipeline import replicate
    state = replicate(scans=sys.argv[1], lake=sys.argv[2], workers=1, settings=sys.argv[3:], return_state=True)
    print(state.name, state.message)
"""


@pytest.mark.slow
@pytest.mark.s3
def test_a_flow_waits_for_a_store_that_is_away(home: dict[str, str], tmp_path: Path) -> None:
    write_small_scans(tmp_path / "scans", 1)
    with s3_server() as store:
        store.kill()
        arguments = [sys.executable, "-c", REPLICATE, str(tmp_path / "scans"), "s3://bucket/lake", *SETTINGS]
        process = subprocess.Popen(arguments, env={**home, **store.access}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        said = next(line for line in process.stderr if "trying again" in line)
        assert "the store at http://127.0.0.1" in said
        store.start()
        store.make_bucket("bucket")
        out, _ = process.communicate(timeout=400)
        assert process.returncode == 0
        assert "Completed 1 scene done" in out
        assert any("/tables/placements/" in name for name in store.objects("bucket/lake"))


@pytest.mark.slow
def test_a_server_that_is_gone_at_the_end_takes_nothing_from_the_run(home: dict[str, str], tmp_path: Path) -> None:
    write_small_scans(tmp_path / "scans", 1)
    with prefect_server_process(tmp_path / "server") as server:
        told = {**server.access, "PREFECT_CLIENT_MAX_RETRIES": "1", "PREFECT_FLOWS_HEARTBEAT_FREQUENCY": "30"}
        process = subprocess.Popen(
            command(tmp_path / "scans", tmp_path / "lake"), env={**home, **told}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        deadline = time.monotonic() + 200
        while not list((tmp_path / "lake" / "staged").glob("*@captions@*")) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert process.poll() is None
        server.kill()
        out, err = process.communicate(timeout=400)
    assert process.returncode == 0, err
    assert out.startswith("1 scene done"), err
    assert "does not know how the run ended" in err
    assert "Traceback" not in err
    assert len(Lake.open(tmp_path / "lake").history()) == 7
    assert leftovers(tmp_path / "lake") == []
