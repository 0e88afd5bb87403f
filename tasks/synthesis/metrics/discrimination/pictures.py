"""A classifier of pictures from above: a small network of convolutions, in place of the AlexNet whose weights others begin with.

AlexNet's weights are not at hand, so ours learns from nothing, and from few pictures. What is to be seen is put into more channels than
three for that: a code of the category in place of its color, heights, outlines, fronts, and where boxes are in each other or on nothing.
Figures of it stand beside nobody else's.

Of 1,000 layouts a side it tells shuffled ones from true ones in 87 % of cases; boxes in each other and boxes on nothing alone make 85 %.
So it says little of where things stand that collide with nothing: for that, look at the classifier of boxes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.selection.metrics.bootstrap import ConfidenceInterval
from tasks.synthesis.layout import Array, Layout
from tasks.synthesis.metrics.boxes import WITHOUT_LEVEL
from tasks.synthesis.metrics.discrimination.folds import Judge, accuracy, seeded
from tasks.synthesis.pictures import seen_m

if TYPE_CHECKING:
    import torch

DRAWN_PIXELS, PIXELS = 64, 32
"""Sides of pictures as they are drawn, and as they are seen: means of so many pixels, so that edges are known to parts of a pixel."""

NAME = f"own convolutions on {PIXELS} px, no weights to begin with, not comparable"
"""What figures say that they are of."""

CODE = 12
"""Numbers that stand for a category: drawn, and so far from each other that the first layer tells sixty of them apart."""

FREE_M, FULL_M = 0.01, 0.04
"""Heights by which a box may be in the one below it or above all below it and nothing is seen, and from which on it is seen fully: a
pixel is as long as the former."""

SHADES = 7
"""Channels beside the code: height, outlines, both parts of the front's direction, boxes in each other, boxes on nothing, the square."""


@dataclasses.dataclass(frozen=True)
class PictureClassifier:
    """How the classifier of pictures is trained. width: Channels of the first layer. dropout: Share of what is found that is left out.
    shift: Pixels by which pictures are moved by chance. Nothing is mirrored: fronts matter, and so does what is to the right."""

    epochs: int = 12
    batch: int = 128
    learning_rate: float = 3e-3
    weight_decay: float = 0.2
    width: int = 16
    dropout: float = 0.3
    shift: int = 1


@dataclasses.dataclass(frozen=True)
class _Pictures:
    """channels: Shape (n, c, `PIXELS`, `PIXELS`). flags: Whether a pixel shows boxes in each other, and a box on nothing, shape (n, 2)."""

    channels: torch.Tensor
    flags: torch.Tensor


def picture_accuracy(
    truth: Sequence[Layout], drawn: Sequence[Layout], seed: int, classifier: PictureClassifier | None = None
) -> ConfidenceInterval:
    """Share of layouts whose pictures from above a classifier which saw others puts on the right side (SCA), with its interval of 95 %.

    Who judges whom, and what the interval is of, is as `classifier_accuracy` has it. NaN where a side has fewer than `FOLDS` layouts.
    """
    settings = classifier or PictureClassifier()

    def judge(layouts: Sequence[Layout]) -> Judge:
        pictures = _pictures_of(layouts)
        return lambda answers, held, of: _hits(pictures, answers, held, of, settings)

    return accuracy(truth, drawn, seed, judge)


def _pictures_of(layouts: Sequence[Layout]) -> _Pictures:
    """Pictures of layouts, categories by their codes."""
    import torch

    names = sorted({name for layout in layouts for name in layout.categories})
    codes = 0.5 * np.random.default_rng(0).normal(size=(len(names) + 2, CODE)).astype(np.float32)
    codes[0] = 0.0  # beside the large object
    numbers = {name: at + 2 for at, name in enumerate(names)}
    side, steps = DRAWN_PIXELS // PIXELS, torch.linspace(-1.0, 1.0, PIXELS)
    place = torch.stack([steps[:, None].expand(PIXELS, PIXELS), steps[None].expand(PIXELS, PIXELS)])
    channels, flags = [], []
    for layout in layouts:
        kinds, shades = _picture_of(layout, numbers)
        fine = torch.from_numpy(np.concatenate([np.moveaxis(codes[kinds], -1, 0), shades]))
        channels.append(torch.cat([torch.nn.functional.avg_pool2d(fine[None], side)[0], place]))
        flags.append([bool(shades[at].any()) for at in (4, 5)])
    return _Pictures(torch.stack(channels).contiguous(memory_format=torch.channels_last), torch.tensor(flags, dtype=torch.float32))


def _picture_of(layout: Layout, numbers: dict[str, int]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """A layout as `from_above` draws it: numbers of categories, 1 for the large object, shape (p, p), and shades, (`SHADES`, p, p)."""
    extent = seen_m(layout)
    pixel = extent / DRAWN_PIXELS
    steps = (0.5 - (np.arange(DRAWN_PIXELS) + 0.5) / DRAWN_PIXELS) * extent
    x, y = steps[:, None], steps[None, :]
    depth, width, height = layout.large.size
    on_large = (np.abs(x) <= 0.5 * depth) & (np.abs(y) <= 0.5 * width)
    kinds = on_large.astype(np.uint8)
    shades = np.zeros((SHADES, DRAWN_PIXELS, DRAWN_PIXELS), dtype=np.float32)
    shades[6] = extent
    highest = np.full(kinds.shape, -np.inf)  # top of the small objects so far
    tops = layout.centers[:, 2] + 0.5 * layout.sizes[:, 2]
    levels = layout.large.category not in WITHOUT_LEVEL
    for at in np.lexsort([np.array(layout.categories), tops]).tolist() if len(layout) else []:
        cos, sin = math.cos(layout.yaws[at]), math.sin(layout.yaws[at])
        dx, dy = x - layout.centers[at, 0], y - layout.centers[at, 1]
        sides = 0.5 * layout.sizes[at, :2]
        within = np.minimum(sides[0] - np.abs(dx * cos + dy * sin), sides[1] - np.abs(dy * cos - dx * sin))
        inside = within >= 0.0
        bottom = tops[at] - layout.sizes[at, 2]
        below = np.maximum(highest, np.where(on_large, height, 0.0))
        kinds[inside] = numbers[layout.categories[at]]
        shades[0, inside] = tops[at] - height
        shades[1] += np.clip(1.0 - np.abs(within) / pixel, 0.0, 1.0)
        shades[2, inside], shades[3, inside] = cos, sin
        shades[4] = np.where(inside, np.maximum(shades[4], _seen(highest - bottom)), shades[4])
        shades[5] = np.where(inside, _seen(bottom - below) if levels else 0.0, shades[5])
        highest = np.where(inside, np.maximum(highest, tops[at]), highest)
    return kinds, shades


def _seen(heights: Array) -> Array:
    """How clearly heights [m] are seen, 0..1."""
    return np.asarray(np.clip((heights - FREE_M) / (FULL_M - FREE_M), 0.0, 1.0))


def _hits(pictures: _Pictures, answers: NDArray[np.int64], held: NDArray[np.bool_], seed: int, settings: PictureClassifier) -> Array:
    """Of the held-out pictures, 1 for those judged rightly, shape (n,)."""
    import torch

    target = torch.from_numpy(answers).float()
    learned, judged = np.flatnonzero(~held), np.flatnonzero(held)
    rng = np.random.default_rng([seed, 5])
    with seeded(seed):
        network = _network(pictures.channels.shape[1], settings).to(memory_format=torch.channels_last)
        batches = math.ceil(len(learned) / settings.batch)
        optimizer = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, settings.learning_rate, total_steps=settings.epochs * batches)
        for _ in range(settings.epochs):
            for batch in np.array_split(rng.permutation(learned), batches):
                by = tuple(rng.integers(-settings.shift, settings.shift + 1, 2).tolist())
                scores = network(pictures.channels[batch].roll(by, (2, 3)), pictures.flags[batch])
                loss = torch.nn.functional.binary_cross_entropy_with_logits(scores, target[batch])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
        network.eval()
        with torch.inference_mode():
            scores = torch.cat([network(pictures.channels[part], pictures.flags[part]) for part in np.array_split(judged, batches)])
    return np.asarray(((scores > 0) == (target[judged] > 0.5)).double().numpy())


def _network(channels: int, settings: PictureClassifier) -> Any:
    """Four layers of convolutions whose means and maxima are judged, beside the flags."""
    import torch
    from torch import nn

    width = settings.width

    def layers(*widths: int) -> list[nn.Module]:
        return [
            part
            for a, b in pairwise(widths)
            for part in (nn.Conv2d(a, b, 3, padding=1, bias=False), nn.BatchNorm2d(b), nn.ReLU(), nn.MaxPool2d(2))
        ]

    class Pictures(nn.Module):
        """What a picture shows, and whether it shows what cannot be."""

        def __init__(self) -> None:
            super().__init__()
            self.seen = nn.Sequential(*layers(channels, width, 2 * width, 2 * width, 4 * width)[:-1])
            self.head = nn.Sequential(
                nn.Dropout(settings.dropout), nn.Linear(8 * width, 4 * width), nn.ReLU(), nn.Linear(4 * width, 1)
            )  # fmt: skip
            self.flags = nn.Linear(2, 1)

        def forward(self, pictures: torch.Tensor, flags: torch.Tensor) -> torch.Tensor:
            """Logits that layouts are drawn, shape (n,)."""
            seen = self.seen(pictures)
            pooled = torch.cat([seen.amax(dim=(2, 3)), seen.mean(dim=(2, 3))], dim=1)
            return torch.as_tensor((self.head(pooled) + 2.0 * self.flags(flags))[:, 0])

    return Pictures()
