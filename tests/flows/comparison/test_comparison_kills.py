"""A comparison as a command: a Prefect run that is killed while it trains and while it tests, and goes on to the same rows."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from schemas.comparison import ComparedRun, PairedTest
from schemas.evaluation import Trajectory
from schemas.runs import StageRun
from schemas.training import LearnedModel, TrainingStep
from tests.conftest import REPOSITORY
from tests.flows.comparison.lakes import QUICK, compared_lake
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytest.importorskip("torch")
pytestmark = [pytest.mark.whole, pytest.mark.slow]

WAIT_SECONDS = 600.0


def started(folder: Path, lake: Path, *words: str) -> subprocess.Popen[str]:
    """The command, in a group of processes of its own; its cache is beside the lake."""
    (folder / "quick.toml").write_text(QUICK)
    call = [sys.executable, "-m", "flows.cli", "compare", "navigation", "--train", "alpha", "--train", "beta", "--test", "gamma"]
    call += ["--lake", str(lake), "--config", str(folder / "quick.toml"), "--workers", "2", *words]
    around = {**os.environ, "PYTHONPATH": str(REPOSITORY), "METASCENES_CACHE": f"{lake}-cache"}
    return subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=around, cwd=folder, start_new_session=True)


def ended(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, err = process.communicate(timeout=WAIT_SECONDS)
    assert process.returncode == 0, out + err
    told: dict[str, Any] = json.loads(out)
    return told


def killed_when(process: subprocess.Popen[str], is_time: Callable[[], bool]) -> None:
    """Kill the command as soon as something is so, which must come before it ends."""
    give_up = time.monotonic() + WAIT_SECONDS
    while not is_time():
        assert process.poll() is None, "it ended before it could be killed: " + "".join(process.communicate())
        assert time.monotonic() < give_up
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=600)
    assert process.returncode == -signal.SIGKILL


def test_killed_while_it_trains_and_while_it_tests_it_comes_to_the_same_rows(tmp_path: Path) -> None:
    made = compared_lake(tmp_path / "lake")
    other = Path(shutil.copytree(made.address, tmp_path / "other"))
    whole = ended(started(tmp_path, Path(made.address), "--json"))
    assert (whole["trained"], whole["measured"]) == (2, 16)
    first = started(tmp_path, other)
    killed_when(first, lambda: any(Path(f"{other}-cache").glob("modules/tasks.training.fitting-*/*.pt")))
    assert Lake.open(other).snapshot().rows(LearnedModel) == []
    second = started(tmp_path, other)
    killed_when(second, lambda: any("@evaluation@" in path.name for path in (other / "staged").glob("*stage_runs.parquet")))
    assert len(Lake.open(other).snapshot().rows(LearnedModel)) == 2
    assert Lake.open(other).snapshot().rows(ComparedRun) == []
    third = ended(started(tmp_path, other, "--json"))
    assert third["trained"] == 0
    assert 0 < third["measured"] < 16, "what was staged before the kill is not measured again"
    assert {name: third[name] for name in ("comparison_id", "rows", "tests")} == {
        name: whole[name] for name in ("comparison_id", "rows", "tests")
    }
    reader, expected = Lake.open(other).snapshot(), made.snapshot()
    counts = [len(reader.rows(record)) for record in (LearnedModel, TrainingStep, Trajectory, ComparedRun, PairedTest)]
    assert counts == [2, 6, 16, 4, 2]
    mine, theirs = digests(reader), digests(expected)
    tables = ("models", "training_steps", "model_evaluations", "trajectories", "compared_runs", "paired_tests")
    assert {name: mine[name] for name in tables} == {name: theirs[name] for name in tables}
    runs = [run for run in reader.rows(StageRun) if run.stage in ("training", "evaluation", "comparison")]
    assert all(run.outcome == "done" for run in runs)
    assert len({(run.scene_id, run.stage) for run in runs}) == len(runs) == 2 + 4 + 1, "nothing was done twice"
    before = reader.snapshot_id
    again = ended(started(tmp_path, other, "--json"))
    assert (again["trained"], again["measured"], again["rows"]) == (0, 0, whole["rows"])
    assert Lake.open(other).snapshot().snapshot_id == before
