"""A drive that is killed: the command, ended by SIGKILL when it has driven through a scene, given again, held against a whole one."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.commands import Commands
from bench.goals import goal
from bench.robot.drives import POLICY
from warehouse.lake import Lake
from warehouse.tables.digest import digests

ADVANCES = 3
"""Processes that are started."""

WORDS = ("drive", "--policy", POLICY, "--set=robot.routes=3", "--workers=1")


def measure_kills(replicas: Lake, folder: Path, advance: Callable[[str], None]) -> dict[str, Any]:
    """What came of drives that were killed, beside those that nobody disturbed.

    Raises:
        LakeError: a command failed by itself, or hangs.
    """
    place = folder / "killed"
    shutil.rmtree(place, ignore_errors=True)
    lakes = [Lake.open(shutil.copytree(replicas.address, place / name)) for name in ("whole", "disturbed")]
    whole, disturbed = (Commands(lake, place / f"cache-{number}") for number, lake in enumerate(lakes))
    batches = whole.done(*WORDS)["batches"]
    advance("driven")
    killed = disturbed.killed(WORDS, lambda: sum(map(lakes[1].has_staged, batches)) >= len(batches) // 3)
    advance("killed while it drives")
    again = disturbed.done(*WORDS)
    advance("driven again")
    rows = [digests(lake.snapshot())["robot_runs"] for lake in lakes]
    figures = {
        "killed": killed, "runs": again["runs"], "went_on_with": again["new"], "same_batches": again["batches"] == batches,
        "same_rows": rows[0] == rows[1],
    }  # fmt: skip
    return {**figures, "goals": kill_goals(figures)}


def kill_goals(figures: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What kills must leave as it is. Who was killed too late, or had nothing to do, proves nothing."""
    return [
        goal("drives killed by SIGKILL", figures["killed"], ">=", 1),
        goal("runs that were left to do", figures["went_on_with"], ">=", 1),
        goal("runs that were done already", figures["runs"] - figures["went_on_with"], ">=", 1),
        goal("a killed drive that went on has the rows of a whole one", int(figures["same_batches"] and figures["same_rows"]), "==", 1),
    ]
