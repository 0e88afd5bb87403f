"""`metascenes library add` killed: what was indexed is remembered, and the end is the same."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from schemas.indexing import IndexedLibrary
from schemas.runs import StageRun
from tasks.indexing import STAGE
from tests.conftest import REPOSITORY
from tests.tasks.library.models import as_glb, chair
from warehouse.lake import Lake
from warehouse.tables.digest import digests
from warehouse.upkeep.inspection import inspect

pytestmark = pytest.mark.whole

MODELS = 24
WAIT_SECONDS = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("models")
    for number in range(MODELS):
        (place / f"chair_{number:02d}.glb").write_bytes(as_glb(chair(number), 1.0 + 0.01 * number))
    return place


def started(folder: Path, lake: Path, cache: Path, processes: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "flows.cli", "library", "add", folder, "--name", "chairs", "--lake", lake, "--processes", processes]
    around = {**os.environ, "PYTHONPATH": str(REPOSITORY), "METASCENES_CACHE": str(cache)}
    return subprocess.Popen(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=around, cwd=folder, start_new_session=True
    )


def ended(process: subprocess.Popen[str]) -> str:
    out, err = process.communicate(timeout=WAIT_SECONDS)
    assert process.returncode == 0, out + err
    return out


def remembered(cache: Path) -> set[str]:
    """Entries that lie whole in a cache."""
    return {path.name for path in cache.glob("modules/tasks.library.indexing-*/entry-*")}


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_an_indexing_that_is_killed_goes_on_with_what_is_missing(tmp_path: Path, folder: Path, processes: int) -> None:
    lake, cache = tmp_path / "lake", tmp_path / "cache"
    killed = started(folder, lake, cache, processes)
    give_up = time.monotonic() + WAIT_SECONDS
    while len(remembered(cache)) < 3:
        assert killed.poll() is None, "it ended before it could be killed: " + "".join(killed.communicate())
        assert time.monotonic() < give_up
        time.sleep(0.01)
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate(timeout=600)
    assert Lake.open(lake).snapshot().rows(IndexedLibrary) == []
    made = {path: path.stat().st_mtime_ns for path in cache.glob("modules/tasks.library.indexing-*/entry-*")}
    assert len(made) >= 3
    assert f"{MODELS} models" in ended(started(folder, lake, cache, processes))
    assert len(remembered(cache)) == MODELS
    assert {path: path.stat().st_mtime_ns for path in made} == made, "what was remembered is not made again"
    again = ended(started(folder, lake, cache, processes))
    assert again.rstrip().endswith("unchanged")
    one = Lake.open(lake)
    assert inspect(one).errors == ()
    assert [run.outcome for run in one.snapshot().rows(StageRun)] == ["done"]
    ended(started(folder, tmp_path / "whole", tmp_path / "other", 3 - processes))
    mine, theirs = digests(one.snapshot()), digests(Lake.open(tmp_path / "whole").snapshot())
    assert {name: mine[name] for name in STAGE.writes} == {name: theirs[name] for name in STAGE.writes}
