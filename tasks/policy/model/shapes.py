"""Names and shapes of a policy's weights, without torch; the goals that it knows; and whether given weights are those of a config."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from schemas.parsing import json_value
from tasks.policy.actions import UNTOLD
from tasks.policy.model.config import OwnEyes, OwnGoal, PolicyModel

Shape = tuple[int, ...]

VOCABULARY = "goal.vocabulary"
"""Name of an array of a model's weights: JSON text as bytes, a list of categories."""

MOST_GOALS = 10_000


class Vocabulary(tuple[str, ...]):
    """Categories that a policy can be sent to, in the order of their vectors; the first one, '', stands for all that it does not know."""

    def place(self, category: str) -> int:
        """Place of a category's vector."""
        return self.index(category) if category in self else 0

    def array(self) -> NDArray[np.uint8]:
        """As an array of a model's weights."""
        return np.frombuffer(json.dumps(list(self), separators=(",", ":")).encode(), dtype=np.uint8)


def vocabulary_of(categories: Iterable[str]) -> Vocabulary:
    """The vocabulary of some categories."""
    return Vocabulary(("", *sorted({*categories} - {""})))


def vocabulary_in(arrays: Mapping[str, NDArray[Any]], file: str = "weights") -> Vocabulary:
    """The vocabulary among the arrays of a model's weights.

    Raises:
        InputError: it is missing or no such thing.
    """
    remedy = "take weights that `metascenes train` wrote, whole"
    if VOCABULARY not in arrays:
        raise InputError(file, VOCABULARY, "is missing", remedy)
    try:
        words = json_value(np.asarray(arrays[VOCABULARY]).tobytes().decode())
    except (ValueError, RecursionError) as error:
        raise InputError(file, VOCABULARY, "is no vocabulary", remedy) from error
    are_words = isinstance(words, list) and all(isinstance(word, str) for word in words)
    if not are_words or words[:1] != [""] or len({*words}) != len(words) or len(words) > MOST_GOALS:
        raise InputError(file, VOCABULARY, "is no vocabulary", remedy)
    return Vocabulary(words)


def shapes_of(config: PolicyModel, goals: int) -> dict[str, Shape]:
    """Shapes by name, as the network's `state_dict` has them. goals: Places of the vocabulary."""
    width = config.width
    shapes: dict[str, Shape] = {"fusion": (width,), "last.weight": (UNTOLD + 1, width)} | _layer("head", len(ACTIONS), width)
    if not config.blind:
        shapes |= {"camera": (width,)} | _layer("adapter.0", width, width) | _layer("adapter.1", width)
        if isinstance(config.eyes, OwnEyes):
            parts = (config.eyes.patch // config.eyes.part) ** 2
            shapes |= _layer("eyes.0", config.eyes.width, config.channels * config.eyes.part**2) | _layer(
                "eyes.2", width, parts * config.eyes.width
            )
            shapes["places"] = (config.tokens, width)
        else:
            shapes |= _layer("eyes.0", width, config.eyes.width) | _layer("eyes.2", width, width)
    if isinstance(config.goal, OwnGoal):
        shapes["goal.vectors.weight"] = (goals, width)
    else:
        shapes |= {"goal.states": (goals, config.goal.tokens, config.goal.width)}
        shapes |= _layer("goal.adapter.0", width, config.goal.width) | _layer("goal.adapter.1", width)
    for place in range(config.fusion_layers):
        shapes |= _block(f"encoder.layers.{place}", width, config.feedforward, ("self_attn",))
    for place in range(config.decoder_layers):
        shapes |= _block(f"decoder.layers.{place}", width, config.feedforward, ("self_attn", "multihead_attn"))
    return shapes


def check_fit(arrays: Mapping[str, NDArray[Any]], config: PolicyModel, file: str) -> Vocabulary:
    """The vocabulary among a model's arrays, whose other arrays are those of the config.

    Raises:
        InputError: some are missing, too many or of another shape; or the vocabulary is none.
    """
    vocabulary = vocabulary_in(arrays, file)
    wanted = shapes_of(config, len(vocabulary))
    for name in sorted({*wanted, *arrays} - {VOCABULARY}):
        if name not in arrays or name not in wanted or arrays[name].shape != wanted[name]:
            problem = "is missing" if name not in arrays else "is unknown" if name not in wanted else f"has the shape {arrays[name].shape}"
            raise InputError(
                file, name, f"{problem}; the model's config wants {wanted.get(name, 'none')}", "take weights and config of one model"
            )
    return vocabulary


def _layer(name: str, outside: int, inside: int = 0) -> dict[str, Shape]:
    """A linear layer, or without `inside` a norm."""
    return {f"{name}.weight": (outside, inside) if inside else (outside,), f"{name}.bias": (outside,)}


def _block(name: str, width: int, feedforward: int, attentions: tuple[str, ...]) -> dict[str, Shape]:
    shapes = _layer(f"{name}.linear1", feedforward, width) | _layer(f"{name}.linear2", width, feedforward)
    for number in range(len(attentions) + 1):
        shapes |= _layer(f"{name}.norm{number + 1}", width)
    for attention in attentions:
        shapes |= {f"{name}.{attention}.in_proj_weight": (3 * width, width), f"{name}.{attention}.in_proj_bias": (3 * width,)}
        shapes |= _layer(f"{name}.{attention}.out_proj", width, width)
    return shapes
