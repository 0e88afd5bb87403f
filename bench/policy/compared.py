"""Datasets held against each other by who learns from them: replicas of scans, the rooms themselves, and both, tested in a house that
others furnished (supplementary, Table A4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.policy.acting import SUCCESS_M
from bench.policy.datasets import GENERATED, HOME, REPLICAS, ComparedDatasets, make_datasets
from bench.policy.trainings import SENSING, PolicyTraining
from bench.selection.trainings import mapped
from flows.comparison.comparing import compare
from flows.comparison.planning import ComparedTraining, PlannedComparison, asked_comparison, planned_comparison
from flows.evaluation.acting import PlannedScene, act
from flows.run.configuration import Configuration
from flows.training.training import train
from schemas.errors import InputError, LakeError
from schemas.navigation import Episode
from schemas.runs import StageRun
from schemas.training import LearnedModel
from tasks.comparison import ComparisonConfig

CHOICES = (REPLICAS, GENERATED, f"{GENERATED}+{REPLICAS}")
"""What policies learn from."""

LEAST_EPISODES = 100
"""That are tested in, as in Table A4: there 10 scenes with 10 each, here one house."""


WALKED_SHARE = 0.8
"""Of the rooms of a dataset, that must have episodes: a tenth of furnished rooms leave the agent no floor."""


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

    @cached_property
    def data(self) -> ComparedDatasets:
        """The datasets."""
        return ComparedDatasets(self.folder, self.realdata, self.rooms, self.seed, self.episodes)

    @property
    def configuration(self) -> Configuration:
        """Settings of the comparison: policies as those that act in generated rooms, but for what they learn from."""
        plain = PolicyTraining(SENSING, self.seed, self.steps, self.episodes).configuration
        own = {
            "comparison": ComparisonConfig(seeds=self.seeds, scenes=1, trajectories=self.episodes),
            "evaluation": dataclasses.replace(plain.stages["evaluation"], success_m=SUCCESS_M),  # farther than experts stop
        }
        return dataclasses.replace(plain, stages={**plain.stages, **own})

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return len(self.data.jobs) + len(CHOICES) * self.seeds + 1


def measure_comparison(config: ComparisonBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The table, as it comes out; and how much was compared.

    Raises:
        InputError: the house is not there, or a dataset has no episodes.
        LakeError: a training failed.
    """
    data = config.data
    failed = make_datasets(data, config.processes, advance)
    walked: dict[str, set[str]] = {name: set() for name in (GENERATED, REPLICAS, HOME)}
    episodes = dict.fromkeys(walked, 0)
    for row in data.lake.snapshot().rows(Episode):
        dataset = row.scene_id.partition("/")[0]
        walked[dataset].add(row.scene_id)
        episodes[dataset] += 1
    for name, scenes in walked.items():
        if not scenes:
            problem = "has no episodes: " + (failed[0] if failed else "its rooms leave the agent no floor")
            raise InputError("bench policy", name, problem, "give more --rooms, or another --seed")
    with mapped(config.processes) as spread:
        for number, _ in enumerate(spread(partial(_trained, config), range(len(CHOICES) * config.seeds)), start=1):
            advance(f"{number} policies trained")

        def act_in(scenes: Sequence[PlannedScene]) -> Iterable[StageRun]:
            return spread(act, [scene.task for scene in scenes])

        done = compare(data.lake, planned(config), _refused, act_in)
    advance("compared")
    rooms = {name: len(scenes) for name, scenes in walked.items()}
    tested = min((row["episodes"] for row in done.rows), default=0)
    return {
        "comparison_id": done.comparison_id, "wanted_rooms": config.rooms, "seeds": config.seeds, "rooms": rooms, "episodes": episodes,
        "rows": list(done.rows), "tests": list(done.tests), "notes": list(done.notes), "failed": failed,
        "goals": [
            goal("episodes in which datasets are compared", tested, ">=", LEAST_EPISODES),
            goal("seeds of each compared training", config.seeds, ">=", 3),
            goal("scans that a stage failed on", len(failed), "==", 0),
            *(
                goal(f"share of the rooms of {name} that have episodes", rooms[name] / config.rooms, ">=", WALKED_SHARE)
                for name in (GENERATED, REPLICAS)
            ),
        ],
    }  # fmt: skip


def planned(config: ComparisonBench) -> PlannedComparison:
    """The comparison, held against the lake as it is."""
    return planned_comparison(config.data.lake, asked_comparison(CHOICES, (HOME,)), config.configuration)


def _trained(config: ComparisonBench, number: int) -> LearnedModel:
    return train(config.data.lake, planned(config).trainings[number].planned)


def _refused(training: ComparedTraining) -> LearnedModel:
    """Nothing is trained any more when policies act."""
    raise LakeError(f"{training.planned.training_id}: its model is not in the lake; give the command again")
