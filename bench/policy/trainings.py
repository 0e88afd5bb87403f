"""The trainings of the benchmark: which policies are learned, by which settings, through the training that `metascenes train` starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from bench.selection.trainings import mapped
from flows.run.configuration import Configuration, configure
from flows.training.models import evaluations_of_model
from flows.training.training import planned_training, train
from schemas.training import LearnedModel
from tasks.policy.corrections import CorrectionsConfig
from tasks.policy.figures import MAJORITY
from tasks.training.systems.navigation import NavigationTraining, preset
from warehouse.lake import Lake

SMALL, SENSING, DAGGER, BLIND, GOALLESS = "small", "sensing", "dagger", "blind", "goalless"

ROUNDS = 3
"""Rounds of corrections of a policy that is corrected."""

STOP_M = 0.8
"""From a view point, where experts stop and turn to the target: from there it is in view in eight of ten episodes; from the view point
itself, right before low things, in seven."""

VARIANTS: Mapping[str, tuple[str, int]] = MappingProxyType(
    {SMALL: (SMALL, 0), SENSING: (SENSING, 0), DAGGER: (SENSING, ROUNDS), BLIND: (BLIND, 0), GOALLESS: (GOALLESS, 0),
     "blind-dagger": (BLIND, ROUNDS), "goalless-dagger": (GOALLESS, ROUNDS), "small-dagger": (SMALL, ROUNDS)}
)  # fmt: skip
"""What can be trained, by name: preset, and rounds of corrections."""

USUAL = (SMALL, SENSING, DAGGER, BLIND, GOALLESS)
"""What is trained where nobody says which."""


@dataclasses.dataclass(frozen=True)
class PolicyTraining:
    """A training of a variant, of `VARIANTS`. steps: Before corrections; 0 for the system's own. episodes: Of a room to learn from."""

    name: str
    seed: int
    steps: int = 0
    episodes: int = 100

    @property
    def system(self) -> NavigationTraining:
        """Its settings. Experts face their target in the end: in a third of the episodes they would stop with their back to it."""
        name, rounds = VARIANTS[self.name]
        system = preset(name)
        walks = dataclasses.replace(
            system.walks, facing=True, stop_m=STOP_M, train_episodes=self.episodes, test_episodes=max(1, self.episodes // 2)
        )  # fmt: skip
        corrections = CorrectionsConfig(rounds=rounds)
        fitting = system.fitting
        if self.steps:
            few = max(1, self.steps // 4)
            corrections = dataclasses.replace(corrections, steps=max(1, self.steps // 2))
            fitting = dataclasses.replace(
                fitting, steps=self.steps, warmup_steps=min(fitting.warmup_steps, self.steps // 4),
                validate_steps=min(fitting.validate_steps, few), record_steps=min(fitting.record_steps, few),
            )  # fmt: skip
        return dataclasses.replace(system, walks=walks, corrections=corrections, fitting=fitting)

    @property
    def configuration(self) -> Configuration:
        """Settings of the run that trains it."""
        plain = configure(seed=self.seed)
        stage = dataclasses.replace(plain.stages["training"], system=self.system)
        return dataclasses.replace(plain, stages={**plain.stages, "training": stage})


@dataclasses.dataclass(frozen=True)
class TrainedVariant:
    """What a training came to: the row of its model in the lake of rooms."""

    training: PolicyTraining
    model: LearnedModel


def trained_variants(lake: Lake, trainings: Sequence[PolicyTraining], processes: int) -> Iterator[TrainedVariant]:
    """The model of each training, made by one process of so many; those that the lake has are not made again, and a killed one goes on."""
    with mapped(processes) as spread:
        for training, model in zip(trainings, spread(partial(_trained, lake.address), trainings), strict=True):
            yield TrainedVariant(training, model)


def _trained(address: str, training: PolicyTraining) -> LearnedModel:
    lake = Lake.open(address)
    return train(lake, planned_training(lake, training.configuration))


def accuracies(lake: Lake, model: LearnedModel) -> dict[str, float | None]:
    """Shares of experts' steps in held-out rooms where an action is the right one: the model's, and the one that is most frequent in
    training; None where there are no such steps."""
    shares = {
        figure.method: figure.value
        for figure in evaluations_of_model(lake.snapshot(), model)
        if (figure.split, figure.metric) == ("test", "action_accuracy")
    }
    return {"accuracy": shares.get(model.kind), "majority": shares.get(MAJORITY)}


def variant_row(lake: Lake, variant: TrainedVariant) -> dict[str, Any]:
    """What a training came to, as plain values."""
    model = variant.model
    return {
        "name": variant.training.name, "seed": variant.training.seed, "model_id": model.model_id, "parameters": model.parameter_count,
        "seconds": model.seconds, "device": model.device, "notes": list(model.notes), **accuracies(lake, model),
    }  # fmt: skip
