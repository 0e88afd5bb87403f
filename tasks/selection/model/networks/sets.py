"""PointNet++ with single-scale grouping: points in balls about centers, twice, then the whole cloud."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from tasks.selection.model.config import PointNet2
from tasks.selection.model.networks.blocks import Pointwise, centers_of, normalized_rows, taken


def in_balls(points: Tensor, centers: Tensor, radius: float, count: int) -> Tensor:
    """Indices of the first `count` points within a ball about every center, shape (b, g, count); where there are fewer, the first again.

    Clouds: shape (b, n, 3). Centers, of the cloud's points: shape (b, g, 3).
    """
    total = points.shape[1]
    far = torch.cdist(centers, points, compute_mode="donot_use_mm_for_euclid_dist") > radius
    index = torch.arange(total, device=points.device).expand(far.shape).masked_fill(far, total)
    index = index.topk(min(count, total), dim=-1, largest=False, sorted=True).values
    return torch.where(index == total, index[..., :1], index)


class BallLevel(nn.Module):
    """A PointNet of balls, or of whole clouds."""

    def __init__(self, inside: int, widths: Sequence[int]) -> None:
        super().__init__()
        sizes = [inside, *widths]
        self.layers = nn.ModuleList(Pointwise(a, b) for a, b in itertools.pairwise(sizes))
        self.norms = nn.ModuleList(nn.BatchNorm1d(width) for width in widths)

    def forward(self, values: Tensor) -> Tensor:
        """The maximum over the last axis but one."""
        for layer, norm in zip(self.layers, self.norms, strict=True):
            values = normalized_rows(norm, layer(values)).relu()
        return values.amax(-2)


class PointNet(nn.Module):
    """Clouds of shape (b, n, 6) to vectors (b, last width)."""

    def __init__(self, config: PointNet2) -> None:
        super().__init__()
        self.config, self.width = config, config.last_widths[-1]
        self.first = BallLevel(6, config.first_widths)
        self.second = BallLevel(3 + config.first_widths[-1], config.second_widths)
        self.third = BallLevel(3 + config.second_widths[-1], config.third_widths)
        sizes = [config.third_widths[-1], *config.last_widths]
        self.last = nn.Sequential()
        for inside, outside in itertools.pairwise(sizes):
            self.last.extend([nn.Linear(inside, outside), nn.BatchNorm1d(outside), nn.ReLU(), nn.Dropout(config.head_dropout)])

    def forward(self, clouds: Tensor, starts: Tensor | None = None) -> Tensor:
        """Vectors of clouds."""
        config, points, values = self.config, clouds[..., :3], clouds[..., 3:]
        for level, place in ((self.first, 0), (self.second, 1)):
            centers = centers_of(points, config.centers[place], starts if place == 0 else None)
            index = in_balls(points, centers, config.radii[place], config.samples[place])
            near = taken(torch.cat([points, values], dim=-1), index)
            values = level(torch.cat([near[..., :3] - centers[:, :, None], near[..., 3:]], dim=-1))
            points = centers
        result: Tensor = self.last(self.third(torch.cat([points, values], dim=-1)))
        return result
