"""Parts of the networks: texts, steps and numbers as vectors; layers of single slots, and attention between slots."""

from __future__ import annotations

import itertools
import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from tasks.synthesis.model.config import LearnedText

EPS = 1e-5
"""Of norms and standardized weights, beside variances."""


class Text(nn.Module):
    """What is said of a micro-scene: a vector (w,) for every category of large objects and kind of room."""

    table: Tensor

    def __init__(self, config: Any, large: int, rooms: int) -> None:
        super().__init__()
        self.width = config.width
        self.is_own = isinstance(config, LearnedText)
        if self.is_own:
            self.large = nn.Embedding(large, config.width)
            self.room = nn.Embedding(rooms, config.width)
        else:
            self.register_buffer("table", torch.zeros(large, rooms, config.width))

    def forward(self, large: Tensor, room: Tensor) -> Tensor:
        """Vectors (b, w) of places in the vocabulary (b,)."""
        return self.large(large) + self.room(room) if self.is_own else self.table[large, room]


def waves(values: Tensor, width: int) -> Tensor:
    """Numbers (...) as sines, then cosines, shape (..., width): of 2 pi / 0.1^(2 j / width) times the number (specs D.3)."""
    places = torch.arange(width // 2, dtype=torch.float32, device=values.device)
    phases = values[..., None] * (2.0 * math.pi * 10.0 ** (2.0 * places / width))
    return torch.cat([phases.sin(), phases.cos()], dim=-1)


def step_waves(steps: Tensor, width: int) -> Tensor:
    """Steps of the diffusion (b,) as sines, then cosines, shape (b, width): of 10000^(-j / (width / 2 - 1)) times the step."""
    places = torch.arange(width // 2, dtype=torch.float32, device=steps.device)
    phases = steps[:, None].float() * torch.exp(-math.log(10_000.0) / (width // 2 - 1) * places)
    return torch.cat([phases.sin(), phases.cos()], dim=-1)


class StandardLinear(nn.Linear):
    """A linear layer whose rows of weights have mean 0 and variance 1 wherever it is used."""

    def forward(self, values: Tensor) -> Tensor:
        """Values (..., i) to (..., o)."""
        variance, mean = torch.var_mean(self.weight, dim=1, correction=0, keepdim=True)
        return functional.linear(values, (self.weight - mean) * torch.rsqrt(variance + EPS), self.bias)


class SlotNorm(nn.Module):
    """Group norm over slots (b, s, c): a mean and a variance for each group of channels, of all slots together."""

    def __init__(self, groups: int, width: int) -> None:
        super().__init__()
        self.groups = groups
        self.weight, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))

    def forward(self, values: Tensor) -> Tensor:
        """Values (b, s, c), of the same shape."""
        batch, slots, width = values.shape
        parts = values.reshape(batch, slots, self.groups, width // self.groups)
        variance, mean = torch.var_mean(parts, dim=(1, 3), correction=0, keepdim=True)
        return ((parts - mean) * torch.rsqrt(variance + EPS)).reshape(values.shape) * self.weight + self.bias


class ResidualBlock(nn.Module):
    """Twice a layer, norm and SiLU of single slots, the first scaled and shifted by a condition, beside a shortcut."""

    def __init__(self, inside: int, outside: int, condition: int, groups: int) -> None:
        super().__init__()
        self.film = nn.Linear(condition, 2 * outside)
        self.first, self.first_norm = StandardLinear(inside, outside), SlotNorm(groups, outside)
        self.second, self.second_norm = StandardLinear(outside, outside), SlotNorm(groups, outside)
        self.shortcut = nn.Linear(inside, outside) if inside != outside else nn.Identity()

    def forward(self, values: Tensor, condition: Tensor) -> Tensor:
        """Values (b, s, i) to (b, s, o). condition: Shape (b, 1, c) or (b, s, c)."""
        scale, shift = self.film(functional.silu(condition)).chunk(2, dim=-1)
        hidden = functional.silu(self.first_norm(self.first(values)) * (scale + 1.0) + shift)
        return functional.silu(self.second_norm(self.second(hidden))) + self.shortcut(values)


class SlotAttention(nn.Module):
    """Attention among slots, or of slots to other tokens, of what a norm leaves, beside a shortcut.

    linear: Softmax of queries over channels and of keys over tokens, so that the cost is linear in slots, and one more norm behind it; else
    the usual one.
    """

    def __init__(self, width: int, heads: int, head_width: int, *, linear: bool, tokens: int = 0) -> None:
        super().__init__()
        self.heads, self.head_width, self.linear = heads, head_width, linear
        inner = heads * head_width
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, inner, bias=False)
        self.key_value = nn.Linear(tokens or width, 2 * inner, bias=False)
        self.out = nn.Linear(inner, width)
        self.out_norm = nn.LayerNorm(width) if linear else nn.Identity()

    def forward(self, values: Tensor, tokens: Tensor | None = None) -> Tensor:
        """Values (b, s, c), of the same shape. tokens: Shape (b, t, w); the slots themselves where there are none."""
        normed = self.norm(values)
        key_value = self.key_value(normed if tokens is None else tokens)
        query, (key, value) = self._split(self.query(normed)), (self._split(part) for part in key_value.chunk(2, dim=-1))
        if self.linear:
            context = key.softmax(dim=-2).transpose(-1, -2) @ value
            made = (query.softmax(dim=-1) * self.head_width**-0.5) @ context
        else:
            made = (query @ key.transpose(-1, -2) * self.head_width**-0.5).softmax(dim=-1) @ value
        batch, _, slots, _ = made.shape
        return values + self.out_norm(self.out(made.transpose(1, 2).reshape(batch, slots, -1)))

    def _split(self, values: Tensor) -> Tensor:
        batch, tokens, _ = values.shape
        return values.reshape(batch, tokens, self.heads, self.head_width).transpose(1, 2)


def layers(*widths: int) -> nn.Sequential:
    """Linear layers with GELU between them."""
    made: list[nn.Module] = []
    for inside, outside in itertools.pairwise(widths):
        made += [nn.Linear(inside, outside), nn.GELU()]
    return nn.Sequential(*made[:-1])


def encoder(width: int, heads: int, feedforward: int, count: int, *, dropout: float = 0.0, norm_first: bool) -> nn.TransformerEncoder:
    """Transformer layers over tokens (b, t, width), with GELU."""
    layer = nn.TransformerEncoderLayer(width, heads, feedforward, dropout, "gelu", batch_first=True, norm_first=norm_first)
    return nn.TransformerEncoder(layer, count, nn.LayerNorm(width) if norm_first else None, enable_nested_tensor=False)
