"""The policy's network in evaluation, in single precision, as torch has it.

Every agent is computed by products of matrices of its own, whose shapes are always the same: what it does hangs on no other agent, to the
last bit. Weights of eyes and goal of others are read as frozen vectors; what tells these of pictures needs torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tasks.policy.model.config import OwnEyes, OwnGoal, PolicyModel
from tasks.policy.model.steps import sinusoids
from tasks.synthesis.inference.layers import Values, attended, merged, softmax, split

EPSILON = np.float32(1e-5)
"""Of norms, beside variances."""

Indices = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class PlainPolicy:
    """The network by its weights (`tasks.policy.model.networks.policy`)."""

    config: PolicyModel
    weights: Mapping[str, Values]

    def goal_tokens(self, goals: Indices) -> Values:
        """Tokens (n, g, w) of goals (n,), places in the vocabulary."""
        goals = np.zeros_like(goals) if self.config.goalless else goals
        if isinstance(self.config.goal, OwnGoal):
            return self.weights["goal.vectors.weight"][goals][:, None]
        return self._adapted("goal.adapter", self.weights["goal.states"][goals])

    def seen(self, pictures: NDArray[np.uint8], goal_tokens: Values) -> Values:
        """Vectors (n, w) of pictures (n, h, w, c) with the tokens (n, g, w) of what each is seen for."""
        parts = [np.broadcast_to(self.weights["fusion"], (len(goal_tokens), 1, self.config.width))]
        if not self.config.blind:
            parts.append(self._tokens(pictures))
        tokens = np.concatenate([*parts, goal_tokens], axis=1)
        for layer in range(self.config.fusion_layers):
            name = f"encoder.layers.{layer}"
            is_last = layer == self.config.fusion_layers - 1
            known, tokens = tokens, tokens[:, :1] if is_last else tokens  # of the last only the first token is asked for
            tokens = self._norm(f"{name}.norm1", tokens + self._attention(f"{name}.self_attn", tokens, known))
            tokens = self._norm(f"{name}.norm2", tokens + self._forward(name, tokens))
        return tokens[:, 0]

    def decided(self, seen: Values, last: Indices, times: Indices, goal_tokens: Values) -> Values:
        """Logits (n, t, a) of the actions of steps, each of which sees those before it; see `PolicyNet.decided`."""
        steps = seen + self.weights["last.weight"][last] + sinusoids(times, self.config.width)
        ahead = np.triu(np.full((seen.shape[1],) * 2, -np.inf, dtype=np.float32), 1)
        for layer in range(self.config.decoder_layers):
            name = f"decoder.layers.{layer}"
            steps = self._norm(f"{name}.norm1", steps + self._attention(f"{name}.self_attn", steps, steps, ahead))
            steps = self._norm(f"{name}.norm2", steps + self._attention(f"{name}.multihead_attn", steps, goal_tokens))
            steps = self._norm(f"{name}.norm3", steps + self._forward(name, steps))
        return self._linear("head", steps)

    def _tokens(self, pictures: NDArray[np.uint8]) -> Values:
        eyes = self.config.eyes
        assert isinstance(eyes, OwnEyes)
        count, height, width, channels = pictures.shape
        inner, part = eyes.patch // eyes.part, eyes.part
        cut = pictures.reshape(count, height // eyes.patch, inner, part, width // eyes.patch, inner, part, channels)
        cut = cut.transpose(0, 1, 4, 2, 5, 3, 6, 7).reshape(count, -1, channels * part * part)
        values = cut.astype(np.float32) / np.float32(127.5) - np.float32(1.0)
        read = np.maximum(self._linear("eyes.0", values), 0).reshape(count, self.config.tokens, -1)
        read = np.maximum(self._linear("eyes.2", read), 0)
        return self._adapted("adapter", read) + self.weights["camera"] + self.weights["places"]

    def _adapted(self, name: str, values: Values) -> Values:
        return np.maximum(self._norm(f"{name}.1", self._linear(f"{name}.0", values)), 0)

    def _linear(self, name: str, values: Values) -> Values:
        """Values (n, t, i) to (n, t, o)."""
        made: Values = values @ self.weights[f"{name}.weight"].T
        made += self.weights[f"{name}.bias"]
        return made

    def _norm(self, name: str, values: Values) -> Values:
        """Layer norm along the last axis."""
        off = values - values.mean(axis=-1, keepdims=True)
        off /= np.sqrt((off * off).mean(axis=-1, keepdims=True) + EPSILON)
        off *= self.weights[f"{name}.weight"]
        off += self.weights[f"{name}.bias"]
        return off

    def _attention(self, name: str, values: Values, known: Values, mask: Values | None = None) -> Values:
        """Values (n, t, w) as they mix what is known (n, s, w). mask: Added to scores (t, s)."""
        weight, bias = self.weights[f"{name}.in_proj_weight"], self.weights[f"{name}.in_proj_bias"]
        width, heads = self.config.width, self.config.heads
        query, key, value = (
            split(given @ weight[first : first + width].T + bias[first : first + width], heads)
            for first, given in ((0, values), (width, known), (2 * width, known))
        )
        if mask is None:
            mixed = attended(query, key, value)
        else:
            scores = query @ key.transpose(0, 1, 3, 2)
            scores *= np.float32(query.shape[-1] ** -0.5)
            mixed = softmax(scores + mask, axis=-1) @ value
        return self._linear(f"{name}.out_proj", np.ascontiguousarray(merged(mixed)))

    def _forward(self, name: str, values: Values) -> Values:
        return self._linear(f"{name}.linear2", np.maximum(self._linear(f"{name}.linear1", values), 0))
