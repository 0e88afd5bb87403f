"""The trainings of the benchmark: which models are made, by which settings, one beside the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

from flows.run.configuration import Configuration, configure
from flows.run.pool import WorkerPool
from flows.training.training import planned_training, train
from schemas.training import LearnedModel
from tasks.selection.model.config import NoQuery
from tasks.training.systems.selection import preset
from warehouse.lake import Lake

MODEL = "small"
"""The model that is held against all others."""

LEARNED = ("pointnet2", "pointbert", "ulip2", "uni3d")
"""Baselines that learn, at sizes that can be trained here, by name of preset."""

ABLATIONS = (
    "no_image", "no_text", "no_points", "no_residuals", "no_evidence", "no_quality", "no_ranks", "fixed_temperature", "no_temperature",
    "as_published", "as_released",
)  # fmt: skip
"""What the model is worth without each of its parts, and as others have it; with the first seed alone."""

BLIND = "blind"
"""The model without the scan: it sees the candidates alone. What it finds above one in ten, the lineups give away."""


def train_all(
    lake: Lake, trainings: Sequence[tuple[str, int]], steps: int, processes: int, advance: Callable[[str], None]
) -> list[tuple[str, int, LearnedModel]]:
    """Models of presets by seed, each trained by one process; so many of them at once."""
    made = []
    with mapped(processes) as spread:
        for (name, seed), model in zip(trainings, spread(partial(_trained, lake.address, steps), trainings), strict=True):
            made.append((name, seed, model))
            advance(f"{name} {seed}")
    return made


def _trained(address: str, steps: int, training: tuple[str, int]) -> LearnedModel:
    """A model trained on the lake's newest snapshot, or the lake's own where it has it."""
    lake = Lake.open(address)
    return train(lake, planned_training(lake, settings_of(*training, steps)))


@contextmanager
def mapped(processes: int) -> Iterator[Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]]:
    """A map whose results come in the order of the items: in this process when there is one, else over so many of their own."""
    if processes == 1:
        yield map
        return
    with ThreadPoolExecutor(processes) as threads, WorkerPool(processes) as pool:  # left first, it lets go of who waits for it
        yield lambda function, items: threads.map(partial(pool.call, function), items)


def settings_of(name: str, seed: int, steps: int) -> Configuration:
    """Settings of a training."""
    system = preset(MODEL if name == BLIND else name)
    if name == BLIND:
        unasked = dataclasses.replace(
            system.model, image=NoQuery(), text=NoQuery(), query_points=False, residuals=False, query_evidence=False, frame="canonical"
        )
        system = dataclasses.replace(system, model=unasked)
    if steps:
        warmup = min(system.fitting.warmup_steps, steps // 4)
        fitting = dataclasses.replace(system.fitting, steps=steps, warmup_steps=warmup, validate_steps=max(1, steps // 10))
        system = dataclasses.replace(system, fitting=fitting)
    plain = configure(seed=seed)
    stages = dict(plain.stages) | {"training": dataclasses.replace(plain.stages["training"], system=system)}
    return dataclasses.replace(plain, stages=stages)


def training_row(name: str, seed: int, model: LearnedModel) -> dict[str, Any]:
    """What a training came to."""
    return {"name": name, "seed": seed, "model_id": model.model_id, "parameters": model.parameter_count, "bytes": model.weights_bytes,
            "seconds": model.seconds, "device": model.device, "examples": list(model.examples)}  # fmt: skip
