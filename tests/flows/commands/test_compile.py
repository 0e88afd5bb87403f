"""`metascenes compile`: all that a run computes with is machine code before its first scene."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

ROOM = """
import sys
from pathlib import Path
from bench.stages import run_stages
from flows.inputs.evaluation import run_policy
from flows.run.configuration import configure
from schemas.families.policies import POLICIES
from tasks.pipeline import SCENE_STAGES
from tasks.scanner.demo import demo_scan
from warehouse.lake import Lake

place = Path(sys.argv[1])
demo_scan(place / "scans", 0, 5)
lake = Lake.open(str(place / "lake"))
staged = run_stages(lake, place / "scans", [stage.name for stage in SCENE_STAGES], 1)
assert staged.error is None, staged
assert len(staged.seconds) == len(SCENE_STAGES)
lake.commit()
for policy in POLICIES:
    assert not run_policy(lake, policy, configure()).failed
"""


def machine_code(folder: Path) -> set[str]:
    """Files with machine code, and what tells which of them are used."""
    return {f"{path.name} {path.stat().st_mtime_ns}" for path in folder.rglob("*.nb?")}


@pytest.mark.whole
@pytest.mark.slow
def test_a_room_that_nobody_saw_compiles_nothing_more(tmp_path: Path) -> None:
    code = tmp_path / "code"
    around = {**os.environ, "NUMBA_CACHE_DIR": str(code), "METASCENES_CACHE": str(tmp_path / "cache")}

    def told(*words: str) -> dict[str, float]:
        command = [sys.executable, "-m", "flows.cli", "compile", *words, "--json"]
        done = subprocess.run(command, cwd=REPOSITORY, env=around, capture_output=True, text=True, check=True)
        answer: dict[str, float] = json.loads(done.stdout)
        return answer

    first = told("--workers", "2")
    assert 0 < first["compiled"] <= first["kernels"]
    made = machine_code(code)
    assert len(made) > first["compiled"]
    assert told("--workers", "1")["compiled"] == 0
    subprocess.run([sys.executable, "-c", ROOM, str(tmp_path / "room")], cwd=REPOSITORY, env=around, check=True)
    assert machine_code(code) == made, "python -m tests.contributing.kernels writes the list of kernels anew"
