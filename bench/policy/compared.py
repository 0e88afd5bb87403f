"""Datasets held against each other by who learns from them: replicas of scans, the rooms themselves, and both, tested in a house that
others furnished (supplementary, Table A4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.policy.datasets import GENERATED, HOME, REPLICAS, ComparedDatasets, make_datasets
from bench.policy.trainings import SMALL, PolicyTraining
from bench.selection.trainings import mapped
from flows.comparison.comparing import compare
from flows.comparison.planning import ComparedTraining, PlannedComparison, asked_comparison, planned_comparison
from flows.evaluation.acting import in_this_process
from flows.run.configuration import Configuration
from flows.training.training import train
from schemas.errors import LakeError
from schemas.navigation import Episode
from schemas.training import LearnedModel
from tasks.comparison import ComparisonConfig

CHOICES = (REPLICAS, GENERATED, f"{GENERATED}+{REPLICAS}")
"""What policies learn from."""

LEAST_EPISODES = 100
"""That are tested in, as in Table A4: there 10 scenes with 10 each, here one house."""


@dataclasses.dataclass(frozen=True)
class ComparisonBench:
    """What is compared. rooms: Of each dataset that is learned from. steps: Of each training; 0 for the system's own. episodes: At most, of
    each room, and in the house."""

    folder: Path
    realdata: Path
    rooms: int = 24
    seeds: int = 3
    steps: int = 0
    seed: int = 0
    processes: int = 1
    episodes: int = 100

    @property
    def data(self) -> ComparedDatasets:
        """The datasets."""
        return ComparedDatasets(self.folder, self.realdata, self.rooms, self.seed, self.episodes)

    @property
    def configuration(self) -> Configuration:
        """Settings of the comparison: policies as those that act in generated rooms, but for what they learn from."""
        plain = PolicyTraining(SMALL, self.seed, self.steps, self.episodes).configuration
        stages = {**plain.stages, "comparison": ComparisonConfig(seeds=self.seeds, scenes=1, trajectories=self.episodes)}
        return dataclasses.replace(plain, stages=stages)

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return len(self.data.jobs) + len(CHOICES) * self.seeds + 1


def measure_comparison(config: ComparisonBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The table, as it comes out; and how much was compared.

    Raises:
        InputError: the house is not there, or a dataset has no episodes.
        LakeError: a stage or a training failed.
    """
    data = config.data
    notes = make_datasets(data, config.processes, advance)
    with mapped(config.processes) as spread:
        for number, _ in enumerate(spread(partial(_trained, config), range(len(CHOICES) * config.seeds)), start=1):
            advance(f"{number} policies trained")
    done = compare(data.lake, planned(config), _refused, in_this_process)
    advance("compared")
    rows = [row.scene_id.partition("/")[0] for row in data.lake.snapshot().rows(Episode)]
    figures = {
        "comparison_id": done.comparison_id, "rooms": config.rooms, "seeds": config.seeds,
        "episodes": {name: rows.count(name) for name in (GENERATED, REPLICAS, HOME)}, "rows": list(done.rows), "tests": list(done.tests),
        "notes": [*notes, *done.notes], "failed": list(done.failed),
    }  # fmt: skip
    tested = min((row["episodes"] for row in done.rows), default=0)
    return {
        **figures,
        "goals": [
            goal("episodes in which datasets are compared", tested, ">=", LEAST_EPISODES),
            goal("seeds of each compared training", config.seeds, ">=", 3),
            goal("scenes that were left out of the comparison", len(done.failed), "<=", 0),
        ],
    }


def planned(config: ComparisonBench) -> PlannedComparison:
    """The comparison, held against the lake as it is."""
    return planned_comparison(config.data.lake, asked_comparison(CHOICES, (HOME,)), config.configuration)


def _trained(config: ComparisonBench, number: int) -> LearnedModel:
    return train(config.data.lake, planned(config).trainings[number].planned)


def _refused(training: ComparedTraining) -> LearnedModel:
    """Nothing is trained any more when policies act."""
    raise LakeError(f"{training.planned.training_id}: its model is not in the lake; give the command again")
