"""Runs that meet, and runs whose workers, servers and databases are killed: the lake is that of a run left in peace."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.flows.chaos import Chaos, disturbed_run
from bench.flows.runs import measured_run
from bench.flows.services import Process, services
from bench.flows.sharing import shared_runs
from bench.flows.small_scenes import write_small_scans
from bench.flows.verdicts import _doubled, verdict_on
from schemas.runs import StageRun
from tests.services import have_been_started, postgres_binaries
from warehouse.lake import Lake

pytestmark = [pytest.mark.whole, pytest.mark.postgres]

SCENES = 6


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Process]]:
    """A Prefect server on PostgreSQL."""
    if postgres_binaries() is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    with services(tmp_path_factory.mktemp("services")) as found:
        yield found


def prepared(folder: Path, count: int) -> tuple[Path, Lake]:
    """Small scans, and the lake of a run that nobody disturbs."""
    scans = write_small_scans(folder / "scans", count)
    have_been_started(folder / "prefect")
    measured_run("pool", scans, folder / "lake", 2, folder)
    return scans, Lake.open(folder / "lake")


@pytest.fixture(scope="module")
def peace(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Lake]:
    return prepared(tmp_path_factory.mktemp("peace"), SCENES)


def assert_sound(found: Chaos) -> None:
    assert found.codes[-1] == 0, found
    assert found.verdict.faults == 0, found.verdict
    assert found.redone == (), "what was finished before a command is not computed again by it"
    assert found.unsaid == (), "a lost worker is told"
    assert found.hung == 0


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_runs_over_overlapping_scenes_compute_each_once(up: dict[str, Process], peace: tuple[Path, Lake], tmp_path: Path) -> None:
    scans, undisturbed = peace
    found = shared_runs(scans, tmp_path, undisturbed, up["server"].access)
    assert found.codes == (0, 0)
    assert found.overlap == 2
    assert (found.both, found.neither) == ((), ())
    assert sum(found.computed) == SCENES
    assert min(found.computed) >= 2, "each computes at least what only it was asked for"
    assert found.verdict.faults == 0, found.verdict


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_workers_runs_servers_and_databases_change_nothing(up: dict[str, Process], peace: tuple[Path, Lake], tmp_path: Path) -> None:
    scans, undisturbed = peace
    hit = 0
    for seed in range(1, 6):  # on a fast machine a run may be over before the second kill
        found = disturbed_run(scans, tmp_path / str(seed), undisturbed, up, kills=4, seed=seed, pauses=(0.2, 2.0))
        assert_sound(found)
        hit += len(found.kills)
        if hit >= 2:
            return
    pytest.fail(f"{hit} kills fell into five runs")


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_chaos_in_a_run_of_fifty_scenes_changes_nothing(up: dict[str, Process], tmp_path: Path) -> None:
    scans, undisturbed = prepared(tmp_path / "peace", 50)
    found = disturbed_run(scans, tmp_path / "chaos", undisturbed, up, kills=12, seed=3)
    assert len(found.kills) >= 10
    assert len(found.kinds) == 4, "workers, runs, the server and the database were killed"
    assert found.lost, "workers were killed while they computed"
    assert_sound(found)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("runner", ["pool", "processes", "dask"])
def test_a_run_outlives_its_workers_and_servers(up: dict[str, Process], peace: tuple[Path, Lake], tmp_path: Path, runner: str) -> None:
    """Unless the run itself is killed, one command is enough."""
    scans, undisturbed = peace
    targets = ("worker", "server", "database")
    found = disturbed_run(scans, tmp_path, undisturbed, up, kills=4, seed=2, runner=runner, pauses=(0.2, 3.0), targets=targets)
    assert found.codes == (0,)
    assert_sound(found)


@pytest.mark.slow
def test_the_verdict_sees_what_is_wrong(peace: tuple[Path, Lake], tmp_path: Path) -> None:
    """Faults made on purpose in a copy of a sound lake."""
    _, undisturbed = peace
    copy = tmp_path / "lake"
    shutil.copytree(undisturbed.address, copy)
    assert verdict_on(Lake.open(copy), undisturbed).faults == 0
    for name in ("claims/left.json", "blobs/00/nobodys.glb"):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes(b"{}")
    lake = Lake.open(copy)
    run = next(run for run in lake.snapshot().rows(StageRun) if run.stage == "exports")
    lake.stage_rows(dataclasses.replace(run, attempt=run.attempt + 1, row_counts=()), {})
    lake.commit("again, and this time it gave no rows")
    found = verdict_on(lake, undisturbed)
    assert found.computed_twice == (f"{run.scene_id} exports: 2 times",)
    assert found.leftovers == ("claims/left.json",)
    assert found.unnamed_blobs == ("blobs/00/nobodys.glb",)
    assert {"export_files", "export_checks"} <= set(found.different)
    assert any("nobodys" in line for line in found.findings)
    assert found.doubled == ()


@pytest.mark.slow
def test_a_row_that_stands_twice_is_seen(peace: tuple[Path, Lake], tmp_path: Path) -> None:
    from deltalake import write_deltalake

    copy = tmp_path / "lake"
    shutil.copytree(peace[1].address, copy)
    lake = Lake.open(copy)
    reader = lake.snapshot()
    assert list(_doubled(reader)) == []
    write_deltalake(copy / "tables" / "episodes", reader.arrow("episodes").slice(0, 1), mode="append")  # no commit does that
    opened = lake.tables.open("episodes")
    assert opened is not None
    beyond = lake.snapshot()
    beyond._files["episodes"] = lake.tables.files("episodes", opened)
    assert list(_doubled(beyond)) == ["episodes"]
