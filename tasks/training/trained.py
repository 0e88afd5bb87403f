"""What comes of training: weights, the curve that led to them, and figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from schemas.errors import InputError
from schemas.selection import SelectionOutcome


@dataclasses.dataclass(frozen=True)
class StepLoss:
    """A point of a loss curve: means over the steps since the point before. seconds: Time that these took [s].

    validation: What `Objective.validate` gave at this step; None where it was not asked.
    """

    step: int
    loss: float
    parts: Mapping[str, float]
    learning_rate: float
    seconds: float
    validation: float | None = None


@dataclasses.dataclass(frozen=True)
class Measure:
    """A figure on the examples of a split, with its interval of 95 %. method: What it is of; '' for the model itself.

    dataset: '' for the examples of the training.
    """

    dataset: str
    split: str
    metric: str
    value: float
    low: float | None = None
    high: float | None = None
    examples: int = 0
    method: str = ""


@dataclasses.dataclass(frozen=True)
class Trained:
    """What a learned system gives back. weights: safetensors (`tasks.weights`). examples: How many there were, by split.

    device: What it was trained on, as `Fitted` has it. seconds: Time that training took, over all of its beginnings [s]. outcomes: What was
    chosen for instances of which the truth is known, by this model and by what it is held against.
    """

    architecture: str
    weights: bytes
    parameter_count: int
    steps: tuple[StepLoss, ...]
    measures: tuple[Measure, ...]
    examples: Mapping[str, int]
    license: str
    is_fallback: bool = False
    notes: tuple[str, ...] = ()
    device: str = "cpu"
    seconds: float = 0.0
    outcomes: tuple[SelectionOutcome, ...] = ()


class Diverged(InputError):
    """Training that leads nowhere: a loss that is no finite number."""
