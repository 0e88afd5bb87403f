"""What a learned system is: a declaration, a frozen config and a pure `train`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from tasks.models import Model, ModelFolder
from tasks.settings import Config
from tasks.training.trained import Trained

__all__ = ["LearnedSystem", "Model", "ShippedModel"]

ShippedModel = ModelFolder
"""A model inside the package: a folder as `metascenes models export` writes it."""


def no_fit(weights: bytes, config: Any, file: str) -> None:
    """Of a learned system that holds weights against their config when it opens them."""


def no_difference(start: str, config: Any, file: str) -> None:
    """Of a learned system that goes on from whatever fits its config."""


def no_paths(config: Any) -> Mapping[str, str]:
    """Of a learned system that reads nothing but the dataset."""
    return {}


def none_shipped() -> Mapping[str, ShippedModel]:
    """Of a learned system whose models are all trained by who uses them."""
    return {}


@dataclasses.dataclass(frozen=True)
class LearnedSystem:
    """A member of the family `schemas.families.learned_systems`.

    config: Its settings, a class whose `kind` is the name. reads: Tables that it learns from. train: `train(*, dataset, start, context,
    config)` gives what came of training on a `Dataset`, from the weights `start` or, where these are None, anew. It is pure: the same
    rows, config and seed give the same weights on the same device. shipped: Models inside the package, by name. fits: `fits(weights,
    config, file)` raises `InputError` where the weights of a model by others are not those of its config; it opens nothing else. paths:
    Files and folders that a config names, by field: what lies there is a part of a training's name. continues: `continues(start, config,
    file)` raises `InputError` where a model, whose own config is the JSON `start`, means something else by what its network takes, though
    its weights fit.
    """

    name: str
    config: type[Config]
    reads: tuple[str, ...]
    train: Callable[..., Trained]
    shipped: Callable[[], Mapping[str, ShippedModel]] = none_shipped
    fits: Callable[[bytes, Any, str], None] = no_fit
    paths: Callable[[Any], Mapping[str, str]] = no_paths
    continues: Callable[[str, Any, str], None] = no_difference
