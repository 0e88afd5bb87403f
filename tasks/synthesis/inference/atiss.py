"""ATISS in NumPy: as `networks.atiss` has it, in evaluation, and objects drawn from what it tells."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.inference.layers import Layers, Values, softmax, text, waves
from tasks.synthesis.model.config import Atiss

LEAST_LOG_SCALE = np.float32(-7.0)
"""As in training."""

LEAST_SHARE = 1e-5
"""Logistics reach to infinity: they are drawn between this share and all but this."""

CHANCES = 15
"""Even numbers that an object is drawn by: one for its category, and for each of seven numbers two, for the logistic and its value."""


@dataclasses.dataclass(frozen=True)
class Told:
    """What comes next, of b sets of objects. hidden: What is known of it, shape (b, w). logits: Of its category, shape (b, k + 2)."""

    hidden: Values
    logits: Values


@dataclasses.dataclass(frozen=True)
class Next:
    """ATISS: what comes next. layers: Of its weights."""

    config: Atiss
    layers: Layers

    def start(self, places: NDArray[np.int64]) -> Values:
        """The tokens before those of objects, shape (b, 2, w). places: Category and room of large objects in the vocabulary (b, 2)."""
        weights = self.layers.weights
        first = self.layers.linear("start", text(weights, places))
        return np.stack([first, np.broadcast_to(weights["query"], first.shape)], axis=1)

    def token(self, classes: NDArray[np.int64], boxes: Values, *, is_large: bool = False) -> Values:
        """Tokens of objects, shape (b, 1, w). classes: Shape (b,). boxes: Middle, half extents and yaw / pi, scaled to -1..1, (b, 7)."""
        weights, part = self.layers.weights, self.config.embedding
        named = weights["class_in.weight"].T[classes]
        token = self.layers.linear("object_in", np.concatenate([named, waves(boxes, part).reshape(len(boxes), -1)], axis=-1))
        return (token + weights["large_token"] if is_large else token)[:, None]

    def next(self, tokens: Values) -> Told:
        """What comes after tokens (b, t, w)."""
        hidden = self.layers.encoder("encoder", tokens, self.config.heads, norm_first=False)[:, 1]
        return Told(hidden, self.layers.linear("class_out", hidden))

    def mixtures(self, hidden: Values, category: NDArray[np.int64], known: Values, part: str) -> Values:
        """Mixtures of a part of the next object, shape (b, 1 or 3, 3 m), as `AtissNet.numbers`. known: Numbers before the part."""
        named = self.layers.weights["class_told.weight"].T[category]
        values = np.concatenate([hidden, named, waves(known, self.config.embedding).reshape(len(hidden), -1)], axis=-1)
        heads = [self.layers.perceptron(f"heads.{part}.{place}", values) for place in range(1 if part == "angle" else 3)]
        return np.stack(heads, axis=1)

    def drawn(self, context: Told, can_be: NDArray[np.bool_], chances: Values) -> tuple[NDArray[np.int64], Values]:
        """Categories (b,) and boxes (b, 7) of next objects; a box beside the end symbol means nothing.

        can_be: Which categories and symbols may be drawn, shape (k + 2,). chances: Even numbers, shape (b, `CHANCES`).
        """
        category = chosen(softmax(np.where(can_be, context.logits, np.float32(-np.inf)), axis=-1), chances[:, 0])
        known = np.zeros((len(category), 0), dtype=np.float32)
        for part, first, last in (("translation", 1, 7), ("angle", 7, 9), ("size", 9, 15)):
            drawn = logistic(self.mixtures(context.hidden, category, known, part), chances[:, first:last].reshape(len(category), -1, 2))
            known = np.concatenate([known, drawn], axis=-1)
        return category, known[:, [0, 1, 2, 4, 5, 6, 3]]


def chosen(shares: Values, chances: Values) -> NDArray[np.int64]:
    """Places (...) of shares (..., n), by even numbers (...)."""
    sums = np.cumsum(shares, axis=-1, dtype=np.float64)
    places = (sums <= chances[..., None] * sums[..., -1:]).sum(axis=-1)
    last = shares.shape[-1] - 1 - (shares[..., ::-1] > 0).argmax(axis=-1)
    return np.minimum(places, last)


def logistic(values: Values, chances: Values) -> Values:
    """Numbers (...) within -1..1 of mixtures of logistics (..., 3 m), by even numbers (..., 2)."""
    weights, middles, scales = np.split(values, 3, axis=-1)
    place = chosen(softmax(weights, axis=-1), chances[..., 0])[..., None]
    middle, scale = (np.take_along_axis(part, place, axis=-1)[..., 0] for part in (middles, scales))
    even = np.clip(chances[..., 1], LEAST_SHARE, 1.0 - LEAST_SHARE).astype(np.float64)
    drawn = middle + np.exp(np.maximum(scale, LEAST_LOG_SCALE)) * np.log(even / (1.0 - even))
    return np.clip(drawn, -1.0, 1.0).astype(np.float32)
