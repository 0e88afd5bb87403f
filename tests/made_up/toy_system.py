"""A learned system: two layers that tell from an instance's numbers whether its name is even. There is nothing to it but the mechanism."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import signal
from typing import Any, ClassVar

import numpy as np

from schemas.capture import Instance
from tasks.settings import Config, Count
from tasks.stage import Context
from tasks.training.dataset import Dataset
from tasks.training.fitting import Fitted, FittingConfig, fit, seeded, weights_of
from tasks.training.system import LearnedSystem
from tasks.training.trained import Measure, Trained
from tasks.weights import from_safetensors

KILL_AT = "TOY_SYSTEM_KILL_AT"
"""Step in which the process kills itself, for tests of what comes after: nothing is told, flushed or closed."""


@dataclasses.dataclass(frozen=True)
class ToySystemConfig(Config):
    """Two layers."""

    kind: ClassVar[str] = "toy_system"

    width: Count = 16  # of the layer between
    fitting: FittingConfig = dataclasses.field(default_factory=lambda: FittingConfig(steps=60, checkpoint_steps=7, validate_steps=20))


def example(instance: Instance) -> tuple[np.ndarray, float]:
    """Eight numbers that follow from an instance's name, and whether the first two are of one sign."""
    draws = np.random.default_rng(list(hashlib.sha256(f"{instance.scene_id}/{instance.instance_id}".encode()).digest()))
    numbers = draws.normal(size=8).astype(np.float32)
    return numbers, float(numbers[0] * numbers[1] > 0)


class Parity:
    """An `Objective`."""

    def __init__(self, examples: list[tuple[np.ndarray, float]], seed: int) -> None:
        self._inputs = np.stack([numbers for numbers, _ in examples])
        self._truth = np.asarray([truth for _, truth in examples], np.float32)
        self._seed = seed

    def batch(self, step: int) -> Any:
        import torch

        chosen = np.random.default_rng([self._seed, step]).integers(0, len(self._truth), 8)
        return torch.from_numpy(self._inputs[chosen]), torch.from_numpy(self._truth[chosen])

    def loss(self, module: Any, batch: Any) -> tuple[Any, dict[str, float]]:
        from torch.nn.functional import binary_cross_entropy_with_logits

        inputs, truth = batch
        loss = binary_cross_entropy_with_logits(module(inputs)[:, 0], truth)
        return loss, {"entropy": float(loss.detach())}

    def validate(self, module: Any) -> float:
        import torch

        device = next(module.parameters()).device
        return float(((module(torch.from_numpy(self._inputs).to(device))[:, 0] > 0).cpu().numpy() == (self._truth > 0)).mean())


def train(*, dataset: Dataset, start: bytes | None, context: Context, config: ToySystemConfig) -> Trained:
    import torch

    examples = [example(row) for row in dataset.rows(Instance)]
    with seeded(context.seed, "initial weights"):
        layers = [torch.nn.Linear(8, config.width), torch.nn.ReLU(), torch.nn.Dropout(0.1), torch.nn.Linear(config.width, 1)]
        module = torch.nn.Sequential(*layers)
    if start is not None:
        module.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in from_safetensors(start).items()})
    fitted = fit(
        module, Parity(examples, context.seed), config.fitting, seed=context.seed,
        checkpoints=context.caches["tasks.training.fitting"], key=context.scene_id, report=reporting(context),
    )  # fmt: skip
    return trained(fitted, len(examples))


def reporting(context: Context) -> Any:
    """The context's report; it kills this process in the step that the environment names."""

    def report(done: int, of: int, text: str) -> None:
        if os.environ.get(KILL_AT) == str(done):
            os.kill(os.getpid(), signal.SIGKILL)
        context.report(done, of, text)

    return report


def trained(fitted: Fitted, count: int) -> Trained:
    measures = (
        Measure("", "validation", "accuracy", fitted.validation or 0.0, 0.0, 1.0, count),
        Measure("", "validation", "accuracy", 0.5, examples=count, method="coin"),
    )
    size = sum(tensor.numel() for tensor in fitted.state_dict.values())
    return Trained(
        architecture="two layers", weights=weights_of(fitted.state_dict), parameter_count=size,
        steps=fitted.steps, measures=measures, examples={"train": count}, license="CC0-1.0", is_fallback=True,
        notes=("made up",), device=fitted.device, seconds=fitted.seconds,
    )  # fmt: skip


TOY_SYSTEM = LearnedSystem(name="toy_system", config=ToySystemConfig, reads=("instances",), train=train)
