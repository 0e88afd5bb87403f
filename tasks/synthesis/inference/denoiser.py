"""The denoiser of DiffuScene and PhyScene in NumPy: as `networks.denoiser` has it, in evaluation."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.inference.layers import (
    EPSILON,
    Layers,
    Values,
    attended,
    merged,
    one_thread,
    silu,
    softmax,
    split,
    step_waves,
    text,
    waves,
)
from tasks.synthesis.inference.schedule import NoiseSchedule
from tasks.synthesis.model.config import Diffusion, Transformer
from tasks.synthesis.model.encoding import BOX

_ONE = np.float32(1)


@dataclasses.dataclass(frozen=True)
class PlainDenoiser:
    """A denoiser, as `denoiser_of` makes it.

    schedule: Of its noise. steps: What the network is told of each step of the diffusion, shape (t, w).
    """

    config: Diffusion
    schedule: NoiseSchedule
    layers: Layers
    steps: Values

    def conditions(self, first: Values, places: NDArray[np.int64], *, is_null: bool = False) -> tuple[Values, Values]:
        """What the network is told of layouts in all steps alike, shape (b, 1, w), and the text, shape (b, 1, v).

        first: Vectors of the large objects (b, d). places: Their category and room in the vocabulary (b, 2). is_null: Without the text.
        """
        weights = self.layers.weights
        words = np.tile(weights["null"], (len(first), 1)) if is_null else text(weights, places)
        return self.layers.perceptron("condition", np.concatenate([words, first], axis=-1))[:, None], words[:, None]

    def prediction(self, noised: Values, step: int, condition: tuple[Values, Values]) -> Values:
        """What is told of slots (b, s, d), of the same shape; that of slot 0 means nothing.

        noised: Slot 0 is clean. step: Of the diffusion. condition: As `conditions` gives it.
        """
        layers, (known, words) = self.layers, condition
        box, shape = noised[..., :BOX], self.config.architecture
        if isinstance(shape, Transformer) and shape.waves:
            box = np.concatenate([box, waves(box, shape.waves).reshape(*box.shape[:-1], -1)], axis=-1)
        hidden = layers.perceptron("box_in", box) + layers.perceptron("class_in", noised[..., BOX:])
        if isinstance(shape, Transformer):
            hidden += known + self.steps[step]
            hidden[:, 0] += layers.weights["body.large"]
            hidden = layers.encoder("body.encoder", hidden, shape.heads, norm_first=True)
        else:
            hidden = self._levels(hidden, known + self.steps[step], words)
        category = layers.perceptron("class_out", hidden)
        if self.config.categories == "chances":
            category = self._target(category, noised[..., BOX:], step)
        return np.concatenate([layers.perceptron("box_out", hidden), category], axis=-1)

    def _target(self, logits: Values, noised: Values, step: int) -> Values:
        """The target of one-hots (b, s, k + 1) that are as likely as these logits say before their noised form is looked at."""
        left = self.schedule.left[step]
        signal, noise = np.sqrt(left), np.sqrt(_ONE - left)
        clean = np.float32(2) * softmax(logits + np.float32(2) * signal / (_ONE - left) * noised, axis=-1) - _ONE
        made = noised - signal * clean if self.schedule.target == "eps" else signal * noised - clean
        return np.asarray(made / noise)

    def _levels(self, hidden: Values, context: Values, words: Values) -> Values:
        """`UnetBody`."""
        shape: Any = self.config.architecture
        start, skips = hidden, []
        instances = self.layers.weights.get("body.instances")
        for level in range(shape.levels):
            hidden, left = self._level(f"body.down.{level}", hidden, context, words, instances, ())
            skips += left
        if instances is not None:
            hidden = self._block("body.middle_instance", hidden, instances[None, : hidden.shape[1]])
        hidden = self._block("body.middle_first", hidden, context)
        if shape.crosses:
            hidden = self._attention("body.middle_text", hidden, words, linear=True)
        hidden = self._attention("body.middle_attention", hidden, None, linear=False)
        hidden = self._block("body.middle_second", hidden, context)
        for level in range(shape.levels):
            hidden, _ = self._level(f"body.up.{level}", hidden, context, words, instances, (skips.pop(), skips.pop()))
        return self._block("body.last", np.concatenate([hidden, start], axis=-1), context)

    def _level(
        self, name: str, hidden: Values, context: Values, words: Values, instances: Values | None, skips: tuple[Values, ...]
    ) -> tuple[Values, list[Values]]:
        """`UnetLevel`."""
        if instances is not None:
            hidden = self._block(f"{name}.instance", hidden, instances[None, : hidden.shape[1]])
        hidden = first = self._block(f"{name}.first", np.concatenate([hidden, *skips[:1]], axis=-1), context)
        if self.config.architecture.crosses:
            hidden = self._attention(f"{name}.text", hidden, words, linear=True)
        hidden = self._block(f"{name}.second", np.concatenate([hidden, *skips[1:]], axis=-1), context)
        hidden = self._attention(f"{name}.attention", hidden, None, linear=True)
        return self.layers.linear(f"{name}.out", hidden), [first, hidden]

    def _block(self, name: str, values: Values, condition: Values) -> Values:
        """`ResidualBlock`, whose weights are standardized already."""
        layers = self.layers
        scale, shift = np.split(layers.linear(f"{name}.film", silu(condition)), 2, axis=-1)
        hidden = silu(self._slot_norm(f"{name}.first_norm", layers.linear(f"{name}.first", values)) * (scale + np.float32(1)) + shift)
        hidden = silu(self._slot_norm(f"{name}.second_norm", layers.linear(f"{name}.second", hidden)))
        return hidden + (layers.linear(f"{name}.shortcut", values) if f"{name}.shortcut.weight" in layers.weights else values)

    def _slot_norm(self, name: str, values: Values) -> Values:
        """`SlotNorm`."""
        batch, slots, width = values.shape
        parts = values.reshape(batch, slots, self.config.architecture.groups, -1)
        middle = parts - parts.mean(axis=(1, 3), keepdims=True)
        spread = np.sqrt(np.square(middle).mean(axis=(1, 3), keepdims=True) + np.float32(EPSILON))
        return (middle / spread).reshape(batch, slots, width) * self.layers.weights[f"{name}.weight"] + self.layers.weights[f"{name}.bias"]

    def _attention(self, name: str, values: Values, tokens: Values | None, *, linear: bool) -> Values:
        """`SlotAttention`."""
        layers, heads = self.layers, self.config.architecture.heads
        normed = layers.norm(f"{name}.norm", values)
        query = split(layers.linear(f"{name}.query", normed), heads)
        pair = np.split(layers.linear(f"{name}.key_value", normed if tokens is None else tokens), 2, axis=-1)
        key, value = (split(part, heads) for part in pair)
        if linear:
            context = softmax(key, axis=-2).transpose(0, 1, 3, 2) @ value
            made = (softmax(query, axis=-1) * np.float32(query.shape[-1] ** -0.5)) @ context
        else:
            made = attended(query, key, value)
        made = layers.linear(f"{name}.out", merged(made))
        return values + (layers.norm(f"{name}.out_norm", made) if linear else made)


def denoiser_of(config: Diffusion, weights: Mapping[str, Values]) -> PlainDenoiser:
    """The denoiser of weights: what is the same wherever it is used is made once, standardized weights and what is told of steps."""
    made = dict(weights)
    for name in [name.removesuffix(".film.weight") for name in weights if name.endswith(".film.weight")]:
        for layer in (f"{name}.first.weight", f"{name}.second.weight"):
            middle = weights[layer] - weights[layer].mean(axis=1, keepdims=True)
            made[layer] = middle / np.sqrt(np.square(middle).mean(axis=1, keepdims=True) + np.float32(EPSILON))
    layers = Layers(made)
    with one_thread():
        steps = layers.perceptron("step", step_waves(np.arange(config.noise.steps), config.architecture.width))
    noise = config.noise
    return PlainDenoiser(config, NoiseSchedule(noise.steps, noise.beta_low, noise.beta_high, noise.target, noise.curve), layers, steps)
