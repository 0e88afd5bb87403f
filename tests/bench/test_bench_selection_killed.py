"""The selection model is killed again and again while it learns, and ends with the weights that it has undisturbed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bench.selection import catalog, rooms
from bench.selection.annotations import annotate
from bench.selection.data import DataSettings, SelectionData, generate
from schemas.training import LearnedModel, TrainingStep
from tests.conftest import REPOSITORY
from warehouse.lake import Lake

pytest.importorskip("torch")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

ROOMS = (2, 3)
FEW = 5
KILLS = 10
FITTING = {"steps": 48, "warmup_steps": 12, "checkpoint_steps": 4, "validate_steps": 24}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SelectionData:
    """Two little rooms, answered for."""
    monkeypatch.setattr(rooms, "OBJECTS", FEW)
    monkeypatch.setattr(catalog, "ROOMS", 24)
    made = SelectionData(tmp_path / "data", DataSettings())
    assert all(isinstance(truth, dict) for truth in generate(made, ROOMS))
    for _ in annotate(made.lake, made.truths(), made.settings.rule, made.settings.seed):
        pass
    return made


def training(lake: str, cache: Path) -> subprocess.Popen[str]:
    settings = [f"--set=training.system.fitting.{name}={value}" for name, value in FITTING.items()]
    return subprocess.Popen(
        [sys.executable, "-m", "flows.cli", "train", "selection", "--lake", lake, "--json", *settings],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "METASCENES_CACHE": str(cache)},
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def kept_step(cache: Path) -> int:
    """The step of the last checkpoint in a cache, 0 where there is none."""
    found = [re.search(r"(\d{9})\.pt$", path.name) for path in cache.glob("modules/tasks.training.fitting-*/*.pt")]
    return max((int(match[1]) for match in found if match), default=0)


def killed_after(lake: str, cache: Path, step: int) -> None:
    """A training that is killed as soon as it has kept a checkpoint after `step`."""
    process = training(lake, cache)
    while kept_step(cache) <= step:
        assert process.poll() is None, "it was done before"
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def trained(lake: str, cache: Path) -> dict[str, Any]:
    out, _ = training(lake, cache).communicate()
    row: dict[str, Any] = json.loads(out)
    return row


def test_killed_ten_times_it_has_the_same_weights(data: SelectionData, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(data.lake.address, other)
    row = trained(data.lake.address, tmp_path / "undisturbed")
    for _ in range(KILLS):
        killed_after(str(other), tmp_path / "disturbed", kept_step(tmp_path / "disturbed"))
        assert not Lake.open(other).snapshot().rows(LearnedModel)
    assert trained(str(other), tmp_path / "disturbed")["model_id"] == row["model_id"]
    losses = [[point.loss for point in Lake.open(place).snapshot().rows(TrainingStep)] for place in (data.lake.address, other)]
    assert losses[0] == losses[1]
    assert losses[0]
