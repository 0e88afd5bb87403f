"""Layers that several networks share, named as in the checkpoints of Point-BERT and ULIP-2."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class Pointwise(nn.Module):
    """A convolution of kernel 1 as a product of matrices over the last axis; its weight has the shape (out, in, 1) of checkpoints."""

    def __init__(self, inside: int, outside: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outside, inside, 1))
        self.bias = nn.Parameter(torch.zeros(outside))
        nn.init.kaiming_uniform_(self.weight, a=5**0.5)

    def forward(self, values: Tensor) -> Tensor:
        """Shape (..., in) to (..., out)."""
        return functional.linear(values, self.weight[:, :, 0], self.bias)


class DropPath(nn.Module):
    """Leaves a residual branch out for whole samples (Huang et al., 2016)."""

    def __init__(self, share: float) -> None:
        super().__init__()
        self.share = share

    def forward(self, values: Tensor) -> Tensor:
        """The same shape; in training some samples zero and the others larger."""
        if not self.training or self.share == 0.0:
            return values
        keep = torch.rand(len(values), *[1] * (values.dim() - 1), device=values.device) >= self.share
        return values * keep.to(values.dtype) / (1.0 - self.share)


class Mlp(nn.Module):
    """Two layers; the first `hidden` wide."""

    def __init__(self, dim: int, hidden: int, activation: nn.Module) -> None:
        super().__init__()
        self.fc1, self.act, self.fc2 = nn.Linear(dim, hidden), activation, nn.Linear(hidden, dim)

    def forward(self, values: Tensor) -> Tensor:
        """The same shape."""
        result: Tensor = self.fc2(self.act(self.fc1(values)))
        return result


class Attention(nn.Module):
    """Attention of tokens to each other. `split_bias`: queries and values have biases of their own, as in EVA."""

    def __init__(self, dim: int, heads: int, *, split_bias: bool = False) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim, bias=False)
        self.proj = nn.Linear(dim, dim)
        self.q_bias = nn.Parameter(torch.zeros(dim)) if split_bias else None
        self.v_bias = nn.Parameter(torch.zeros(dim)) if split_bias else None

    def forward(self, tokens: Tensor) -> Tensor:
        """Shape (b, t, dim), the same."""
        batch, count, dim = tokens.shape
        bias = None
        if self.q_bias is not None and self.v_bias is not None:
            bias = torch.cat([self.q_bias, torch.zeros_like(self.q_bias), self.v_bias])
        parts = functional.linear(tokens, self.qkv.weight, bias).view(batch, count, 3, self.heads, dim // self.heads)
        query, key, value = parts.permute(2, 0, 3, 1, 4).unbind(0)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        result: Tensor = self.proj(mixed.transpose(1, 2).reshape(batch, count, dim))
        return result


class TransformerBlock(nn.Module):
    """A block of a transformer that normalizes first."""

    def __init__(self, dim: int, heads: int, hidden: int, activation: nn.Module, drop: float, *, split_bias: bool = False) -> None:
        super().__init__()
        self.norm1, self.attn = nn.LayerNorm(dim), Attention(dim, heads, split_bias=split_bias)
        self.norm2, self.mlp = nn.LayerNorm(dim), Mlp(dim, hidden, activation)
        self.drop_path = DropPath(drop)

    def forward(self, tokens: Tensor) -> Tensor:
        """Shape (b, t, dim), the same."""
        tokens = tokens + self.drop_path(self.attn(self.norm1(tokens)))
        result: Tensor = tokens + self.drop_path(self.mlp(self.norm2(tokens)))
        return result


def activation_of(name: str) -> nn.Module:
    """The layer of a name."""
    return nn.GELU() if name == "gelu" else nn.ReLU()


def normalized_rows(layer: nn.Module, values: Tensor) -> Tensor:
    """Batch normalization over all but the last axis."""
    result: Tensor = layer(values.reshape(-1, values.shape[-1])).view(values.shape)
    return result


def taken(values: Tensor, index: Tensor) -> Tensor:
    """Rows of clouds: shapes (b, n, c) and (b, ...) of indices to (b, ..., c)."""
    flat = index.reshape(len(index), -1, 1).expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).view(*index.shape, values.shape[-1])


def farthest(points: Tensor, count: int, start: Tensor) -> Tensor:
    """Indices of points each farthest from those before it, shape (b, count), from clouds (b, n, 3) and first indices (b,)."""
    chosen = torch.empty(len(points), count, dtype=torch.long, device=points.device)
    nearest = torch.full(points.shape[:2], float("inf"), device=points.device)
    rows, last = torch.arange(len(points), device=points.device), start.to(points.device)
    for place in range(count):
        chosen[:, place] = last
        nearest = torch.minimum(nearest, (points - points[rows, last][:, None]).square().sum(-1))
        last = nearest.argmax(1)
    return chosen


def centers_of(points: Tensor, count: int, starts: Tensor | None) -> Tensor:
    """Centers, shape (b, count, 3), of clouds (b, n, 3): their first points, or points that lie apart from given first ones, (b,), on."""
    return points[:, :count] if starts is None else taken(points, farthest(points, count, starts))


def seeded_starts(clouds: int, points: int, seed: int) -> Tensor:
    """First indices for `farthest`, shape (clouds,), that follow from a seed."""
    return torch.randint(points, (clouds,), generator=torch.Generator().manual_seed(seed))


def nearest(points: Tensor, centers: Tensor, count: int) -> Tensor:
    """Indices of the nearest points of every center, shape (b, g, count); clouds (b, n, 3), centers (b, g, 3)."""
    squares = points.square().sum(-1)[:, None] - 2.0 * centers @ points.transpose(1, 2)  # less the same number for all points of a center
    return squares.topk(min(count, points.shape[1]), dim=-1, largest=False, sorted=False).indices
