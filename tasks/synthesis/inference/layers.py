"""Layers of networks in evaluation, in single precision, as torch has them: what the networks of synthesis are made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from tasks.kernels import Kernels, compile_kernels

Values = NDArray[np.float32]

EPSILON = 1e-5
"""Of norms and standardized weights, beside variances."""

_LARGEST = np.float32(5.4)
_UP = tuple(map(np.float32, (0.39894217707, 0.0342617387842, 0.00470729633919, 1.73672744424e-4, 6.44843483408e-6, 2.28249401063e-8)))
_DOWN = tuple(map(np.float32, (0.252546629297, 0.0288929974973, 0.00191145946831, 7.5535993009e-5, 1.20683373575e-6)))
"""Share of a normal variable below x, less a half: x U(x^2) / (1 + x^2 D(x^2)) up to `_LARGEST`, fitted to less than 2e-8."""


@cache
def _libraries() -> Any:
    """The libraries of this process that compute matrix products."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[Any]:
    """Within it products of matrices are computed by one thread: the same to the last bit however many this process has."""
    return _libraries().limit(limits=1, user_api="blas")


@dataclasses.dataclass(frozen=True)
class Layers:
    """Layers by the names of their weights. weights: By name, single precision."""

    weights: Mapping[str, Values]

    def linear(self, name: str, values: Values) -> Values:
        """Values (..., i) to (..., o)."""
        return affine(values, self.weights[f"{name}.weight"], self.weights.get(f"{name}.bias"))

    def perceptron(self, name: str, values: Values) -> Values:
        """Linear layers with GELU between them; every other place in the sequence is GELU's."""
        made, place = self.linear(f"{name}.0", values), 2
        while f"{name}.{place}.weight" in self.weights:
            made = self.linear(f"{name}.{place}", gelu(made))
            place += 2
        return made

    def norm(self, name: str, values: Values) -> Values:
        """Layer norm along the last axis."""
        made = np.empty_like(values)
        width = values.shape[-1]
        weight, bias = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        _compiled()["normalize"](values.reshape(-1, width), weight, bias, np.float32(EPSILON), made.reshape(-1, width))
        return made

    def encoder(self, name: str, tokens: Values, heads: int, *, norm_first: bool) -> Values:
        """Transformer layers over tokens (b, t, w) that all see each other; with norms first, one more is last."""
        layer = 0
        while f"{name}.layers.{layer}.linear1.weight" in self.weights:
            own = f"{name}.layers.{layer}"
            if norm_first:
                tokens = tokens + self._attention(own, self.norm(f"{own}.norm1", tokens), heads)
                tokens += self._forward(own, self.norm(f"{own}.norm2", tokens))
            else:
                tokens = self.norm(f"{own}.norm1", tokens + self._attention(own, tokens, heads))
                tokens = self.norm(f"{own}.norm2", tokens + self._forward(own, tokens))
            layer += 1
        return self.norm(f"{name}.norm", tokens) if norm_first else tokens

    def _attention(self, name: str, tokens: Values, heads: int) -> Values:
        weight, bias = self.weights[f"{name}.self_attn.in_proj_weight"], self.weights[f"{name}.self_attn.in_proj_bias"]
        batch, count, width = tokens.shape
        made = np.empty_like(tokens).reshape(batch, count, heads, width // heads)
        _compiled()["attend"](affine(tokens, weight, bias).reshape(batch, count, 3, heads, width // heads), made)
        return self.linear(f"{name}.self_attn.out_proj", made.reshape(tokens.shape))

    def _forward(self, name: str, tokens: Values) -> Values:
        return self.linear(f"{name}.linear2", gelu(self.linear(f"{name}.linear1", tokens)))


def affine(values: Values, weight: Values, bias: Values | None) -> Values:
    """Values (..., i) to (..., o) by a weight (o, i)."""
    made = values.reshape(-1, weight.shape[1]) @ weight.T
    if bias is not None:
        made += bias
    return made.reshape(*values.shape[:-1], len(weight))


def split(values: Values, heads: int) -> Values:
    """Tokens (b, t, h c) by head, shape (b, h, t, c)."""
    return values.reshape(*values.shape[:2], heads, -1).transpose(0, 2, 1, 3)


def merged(values: Values) -> Values:
    """Heads (b, h, t, c) one beside another, shape (b, t, h c)."""
    return values.transpose(0, 2, 1, 3).reshape(values.shape[0], values.shape[2], -1)


def attended(query: Values, key: Values, value: Values) -> Values:
    """Values (b, h, t, c) as queries (b, h, q, c) mix them by keys (b, h, t, c), shape (b, h, q, c)."""
    scores = query @ key.transpose(0, 1, 3, 2)
    scores *= np.float32(query.shape[-1] ** -0.5)
    return softmax(scores, axis=-1) @ value


def softmax(values: Values, axis: int) -> Values:
    """Shares along an axis."""
    shares = values - values.max(axis=axis, keepdims=True)
    np.exp(shares, out=shares)
    shares /= shares.sum(axis=axis, keepdims=True)
    return shares


def silu(values: Values) -> Values:
    """Values times their logistic."""
    return np.asarray(values / (np.float32(1) + np.exp(-values)))


def gelu(values: Values) -> Values:
    """Values times the share of a normal variable below them, in place."""
    _compiled()["activate"](values.reshape(-1))
    return values


def waves(values: Values, width: int) -> Values:
    """Numbers (...) as sines, then cosines, shape (..., width), as `networks.blocks.waves`."""
    places = np.float32(2) * np.arange(width // 2, dtype=np.float32) / np.float32(width)
    phases = values[..., None] * (np.float32(2.0 * np.pi) * _rounded(10.0 ** places.astype(np.float64)))
    return np.concatenate([np.sin(phases), np.cos(phases)], axis=-1)


def step_waves(steps: NDArray[np.int64], width: int) -> Values:
    """Steps (b,) as sines, then cosines, shape (b, width), as `networks.blocks.step_waves`."""
    places = np.float32(-np.log(10_000.0) / (width // 2 - 1)) * np.arange(width // 2, dtype=np.float32)
    phases = steps[:, None].astype(np.float32) * _rounded(np.exp(places.astype(np.float64)))
    return np.concatenate([np.sin(phases), np.cos(phases)], axis=-1)


def _rounded(values: NDArray[np.float64]) -> Values:
    """In single precision: rounded once, as phases multiply the last bit."""
    return values.astype(np.float32)


def text(weights: Mapping[str, Values], places: NDArray[np.int64]) -> Values:
    """Vectors (b, w) of categories of large objects and rooms (b, 2), as places in the vocabulary."""
    large, room = places.T
    if "text.table" in weights:
        return weights["text.table"][large, room]
    return np.asarray(weights["text.large.weight"][large] + weights["text.room.weight"][room])


def activate(values: Any) -> None:
    """GELU of values (n,), in place."""
    u0, u1, u2, u3, u4, u5 = _UP
    d1, d2, d3, d4, d5 = _DOWN
    for at in range(values.size):
        near = min(max(values[at], -_LARGEST), _LARGEST)
        square = near * near
        up = ((((u5 * square + u4) * square + u3) * square + u2) * square + u1) * square + u0
        down = ((((d5 * square + d4) * square + d3) * square + d2) * square + d1) * square + np.float32(1)
        values[at] = values[at] * (np.float32(0.5) + near * up / down)


def normalize(values: Any, weight: Any, bias: Any, epsilon: Any, made: Any) -> None:
    """Rows (n, w) with mean 0 and variance 1, scaled and shifted; sums in eight parts, in which machines add side by side."""
    width = values.shape[1]
    whole = width - width % 8
    parts = np.empty(8, dtype=np.float32)
    for row in range(len(values)):
        parts[:] = np.float32(0)
        for start in range(0, whole, 8):
            for lane in range(8):
                parts[lane] += values[row, start + lane]
        mean = np.float32(0)
        for lane in range(8):
            mean += parts[lane]
        for at in range(whole, width):
            mean += values[row, at]
        mean /= np.float32(width)
        parts[:] = np.float32(0)
        for start in range(0, whole, 8):
            for lane in range(8):
                off = values[row, start + lane] - mean
                parts[lane] += off * off
        variance = np.float32(0)
        for lane in range(8):
            variance += parts[lane]
        for at in range(whole, width):
            variance += (values[row, at] - mean) * (values[row, at] - mean)
        scale = np.float32(1) / np.sqrt(variance / np.float32(width) + epsilon)
        for at in range(width):
            made[row, at] = (values[row, at] - mean) * scale * weight[at] + bias[at]


def attend(parts: Any, made: Any) -> None:
    """Values as queries mix them by keys. parts: Queries, keys and values (b, t, 3, h, c). made: Shape (b, t, h, c)."""
    batch, count, _, heads, width = parts.shape
    room = count + -count % 8  # whole lanes, of which those beyond mean nothing
    keys, scores = np.zeros((width, room), dtype=np.float32), np.zeros(room, dtype=np.float32)
    scale = np.float32(1) / np.sqrt(np.float32(width))
    for item in range(batch):
        for head in range(heads):
            for token in range(count):
                for at in range(width):
                    keys[at, token] = parts[item, token, 1, head, at]
            for token in range(count):
                scores[:] = np.float32(0)
                for at in range(width):
                    query = parts[item, token, 0, head, at] * scale
                    for other in range(room):
                        scores[other] += query * keys[at, other]
                most = scores[0]
                for other in range(1, count):
                    most = max(most, scores[other])
                whole = np.float32(0)
                for other in range(count):
                    scores[other] = np.exp(scores[other] - most)
                    whole += scores[other]
                for at in range(width):
                    made[item, token, head, at] = np.float32(0)
                for other in range(count):
                    share = scores[other] / whole
                    for at in range(width):
                        made[item, token, head, at] += share * parts[item, other, 2, head, at]


@cache
def _compiled() -> Kernels:
    return compile_kernels(activate, normalize, attend)
