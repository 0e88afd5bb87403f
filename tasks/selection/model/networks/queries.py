"""Own encoders of what a model is asked with: a crop of the scan's best view, words, and distances point by point."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from tasks.selection.model.config import OwnImage, OwnText


class ImageNet(nn.Module):
    """Three convolutions of stride 2, then means and maxima over the picture: crops (b, 3, side, side) in 0..1 to (b, embedding)."""

    def __init__(self, config: OwnImage, embedding: int) -> None:
        super().__init__()
        sizes = [3, *config.widths]
        self.convolutions = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in itertools.pairwise(sizes))
        self.projection = nn.Linear(2 * config.widths[-1], embedding)

    def forward(self, images: Tensor) -> Tensor:
        """Vectors of crops, of any length."""
        values = 2.0 * images - 1.0
        for layer in self.convolutions:
            values = layer(values).relu()
        result: Tensor = self.projection(torch.cat([values.mean((2, 3)), values.amax((2, 3))], dim=-1))
        return result


class WordTable(nn.Module):
    """Mean of the learned vectors of tokens, shape (b, t), of which 0 is none, then one layer: (b, embedding)."""

    def __init__(self, config: OwnText, embedding: int) -> None:
        super().__init__()
        self.table = nn.Embedding(config.buckets + 1, config.width, padding_idx=0)
        nn.init.normal_(self.table.weight[1:], std=0.3)
        self.projection = nn.Linear(config.width, embedding)

    def forward(self, tokens: Tensor) -> Tensor:
        """Vectors of texts, of any length."""
        is_word = (tokens > 0)[..., None]
        result: Tensor = self.projection((self.table(tokens) * is_word).sum(1) / is_word.sum(1).clamp(min=1))
        return result


class ResidualNet(nn.Module):
    """A PointNet of points with their distances: shape (b, m, c) to the mean beside the maximum, (b, 2 width)."""

    def __init__(self, inside: int, widths: tuple[int, int]) -> None:
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(inside, widths[0]), nn.Linear(widths[0], widths[1])])

    def forward(self, points: Tensor) -> Tensor:
        """Vectors of clouds of distances."""
        for layer in self.layers:
            points = layer(points).relu()
        return torch.cat([points.mean(1), points.amax(1)], dim=-1)
