"""Policies that are killed: a training and an evaluation as commands, ended by SIGKILL, given again, held against whole ones."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.policy.rooms import PolicyRooms, make_rooms
from schemas.errors import LakeError
from schemas.training import TrainingStep
from warehouse.lake import Lake
from warehouse.tables.digest import digests

FITTING = {
    "fitting.steps": 24, "fitting.warmup_steps": 6, "fitting.checkpoint_steps": 4, "fitting.validate_steps": 12, "fitting.record_steps": 2,
    "corrections.rounds": 1, "corrections.steps": 12, "corrections.episodes": 3, "walks.facing": "true",
}  # fmt: skip
"""Settings of the training that is killed: short, with a checkpoint every fourth step and a round of corrections."""

MAX_STEPS = 40
"""Of an episode: who has learned for so short hardly ever stops."""

KILLS: tuple[tuple[int, int], ...] = ((0, 8), (1, 4))
"""The training is killed as soon as it has kept a checkpoint of so many steps or more, in the fit before corrections, and in that after."""

ADVANCES = 4 + len(KILLS)
"""Processes that are started, and rooms that are made."""

PATIENCE_SECONDS = 900.0
"""A process that gives no sign for so long hangs."""


@dataclasses.dataclass(frozen=True)
class KillsBench:
    """What is killed. folder: Of rooms and lakes; what is in it is made anew, but for the rooms."""

    folder: Path
    rooms: int = 4
    episodes: int = 12
    seed: int = 0


def measure_kills(config: KillsBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """What came of a training and of an evaluation that were killed, beside those that nobody disturbed: weights, losses, trajectories.

    Raises:
        LakeError: a command failed by itself, or hangs.
    """
    rooms = PolicyRooms(config.folder, config.rooms, config.seed, config.episodes)
    make_rooms(rooms, 1, lambda _: None)
    place = config.folder / "killed"
    shutil.rmtree(place, ignore_errors=True)
    lakes = [Lake.open(shutil.copytree(rooms.lake.address, place / name)) for name in ("whole", "disturbed")]
    whole, disturbed = (_Commands(lake, place / f"cache-{number}") for number, lake in enumerate(lakes))
    advance("rooms")
    model = whole.done(*_training())["model_id"]
    advance("trained")
    killed = 0
    for point in KILLS:
        killed += disturbed.killed(_training(), lambda point=point: disturbed.kept() >= point)  # type: ignore[misc]
        advance("killed while it trains")
    again = disturbed.done(*_training())["model_id"]
    advance("trained again")
    losses = [[(row.step, row.loss) for row in lake.snapshot().rows(TrainingStep)] for lake in lakes]
    batches = whole.done(*_acting(model))["policies"][0]["batches"]
    acted_at = disturbed.killed(_acting(again), lambda: lakes[1].has_staged(batches[0]) and not lakes[1].has_staged(batches[-1]))
    disturbed.done(*_acting(again))
    advance("evaluated")
    trajectories = [digests(lake.snapshot())["trajectories"] for lake in lakes]
    figures = {
        "rooms": config.rooms, "trainings_killed": killed, "evaluations_killed": acted_at, "same_weights": model == again,
        "same_losses": bool(losses[0]) and losses[0] == losses[1], "trajectories": len(lakes[0].snapshot().arrow("trajectories")),
        "same_trajectories": trajectories[0] == trajectories[1],
    }  # fmt: skip
    return {**figures, "goals": kill_goals(figures)}


def kill_goals(figures: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What kills must leave as it is. Who was killed too late, or had nothing to do, proves nothing."""
    return [
        goal("trainings killed by SIGKILL", figures["trainings_killed"], ">=", len(KILLS)),
        goal("a killed training that went on has the weights of a whole one", int(figures["same_weights"]), "==", 1),
        goal("and its losses", int(figures["same_losses"]), "==", 1),
        goal("evaluations killed by SIGKILL", figures["evaluations_killed"], ">=", 1),
        goal("trajectories that were measured", figures["trajectories"], ">=", 1),
        goal("a killed evaluation that went on has the rows of a whole one", int(figures["same_trajectories"]), "==", 1),
    ]


def _training() -> list[str]:
    return ["train", "navigation", *(f"--set=training.system.{name}={value}" for name, value in FITTING.items())]


def _acting(model_id: str) -> list[str]:
    return ["evaluate", "--policy", model_id, f"--set=evaluation.max_steps={MAX_STEPS}"]


class _Commands:
    """Commands on a lake, each in an interpreter of its own, with a cache of their own."""

    def __init__(self, lake: Lake, cache: Path) -> None:
        self._lake, self._cache = lake, cache

    def kept(self) -> tuple[int, int]:
        """The last checkpoint of a training under way: fits before its own, and steps; (0, 0) where there is none."""
        names = [path.name for path in self._cache.glob("modules/tasks.training.fitting-*/*.pt")]
        matches = [re.search(r"(?:-round(\d+))?-(\d{9})\.pt$", name) for name in names]
        return max(((int(match[1] or 0), int(match[2])) for match in matches if match), default=(0, 0))

    def done(self, *words: str) -> dict[str, Any]:
        """What a command answers.

        Raises:
            LakeError: it fails, or hangs.
        """
        process = self._started(words)
        try:
            out, err = process.communicate(timeout=PATIENCE_SECONDS)
        except subprocess.TimeoutExpired as error:
            process.kill()
            raise LakeError(f"{words[0]}: gave no answer in {PATIENCE_SECONDS:g} s") from error
        if process.returncode:
            raise LakeError(f"{words[0]}: exit code {process.returncode}: {(err.strip() or out.strip()).splitlines()[-1:]}")
        answer: dict[str, Any] = json.loads(out)
        return answer

    def killed(self, words: Sequence[str], is_time: Callable[[], bool]) -> int:
        """Kill a command as soon as it is time; 1 where it was killed, 0 where it was done before.

        Raises:
            LakeError: it fails by itself, or its time never comes.
        """
        process, end = self._started(words), time.monotonic() + PATIENCE_SECONDS
        while process.poll() is None and time.monotonic() < end and not is_time():
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        _, err = process.communicate()
        if process.returncode not in (0, -signal.SIGKILL) or time.monotonic() >= end:
            raise LakeError(f"{words[0]}: exit code {process.returncode} before it was killed: {err.strip().splitlines()[-1:]}")
        return int(process.returncode == -signal.SIGKILL)

    def _started(self, words: Sequence[str]) -> subprocess.Popen[str]:
        root = str(Path(__file__).parents[2])
        around = {**os.environ, "PYTHONPATH": root, "METASCENES_CACHE": str(self._cache)}
        command = [sys.executable, "-m", "flows.cli", *words, "--lake", self._lake.address, "--json"]
        return subprocess.Popen(command, env=around, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
