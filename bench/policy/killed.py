"""Policies that are killed: a training and an evaluation as commands, ended by SIGKILL, given again, held against whole ones."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.commands import Commands
from bench.goals import goal
from bench.policy.rooms import PolicyRooms, make_rooms
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
    whole, disturbed = (_Trainings(lake, place / f"cache-{number}") for number, lake in enumerate(lakes))
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


class _Trainings(Commands):
    """Commands that train, and keep checkpoints."""

    def kept(self) -> tuple[int, int]:
        """The last checkpoint of a training under way: fits before its own, and steps; (0, 0) where there is none."""
        names = [path.name for path in self.cache.glob("modules/tasks.training.fitting-*/*.pt")]
        matches = [re.search(r"(?:-round(\d+))?-(\d{9})\.pt$", name) for name in names]
        return max(((int(match[1] or 0), int(match[2])) for match in matches if match), default=(0, 0))
