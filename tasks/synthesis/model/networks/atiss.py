"""ATISS without floor plan: the next object of a set, or that there is none, by a transformer without order (specs D.3)."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from tasks.synthesis.model.config import Atiss
from tasks.synthesis.model.networks.blocks import Text, encoder, layers, waves

PARTS = ("translation", "angle", "size")
"""Of an object after its category, in the order in which they are told: three numbers, one, three."""

BINS = 256
"""Of -1..1, in which a logistic is cut."""

LEAST_LOG_SCALE = -7.0


class AtissNet(nn.Module):
    """What comes after a set of objects: a category, then numbers that each see those before.

    classes, large, rooms: Sizes of the vocabulary. Categories that are told have two places more: the start, which nothing has, and the
    end. Weights: `text`, its layer `start`, the token `query`, `large_token`, which is added to that of the large object, `class_in` and
    `object_in` of objects, `encoder`, and heads: `class_out`, `class_told`, and layers by coordinate.
    """

    def __init__(self, config: Atiss, classes: int, large: int, rooms: int) -> None:
        super().__init__()
        self.config, self.classes = config, classes
        width, part, numbers = config.width, config.embedding, 3 * config.mixtures
        self.text = Text(config.text, large, rooms)
        self.start = nn.Linear(config.text.width, width)
        self.query, self.large_token = nn.Parameter(0.02 * torch.randn(width)), nn.Parameter(torch.zeros(width))
        self.class_in = nn.Linear(classes + 2, part, bias=False)
        self.object_in = nn.Linear(8 * part, width)
        self.encoder = encoder(width, config.heads, config.feedforward, config.layers, dropout=config.dropout, norm_first=False)
        self.class_out, self.class_told = nn.Linear(width, classes + 2), nn.Linear(classes + 2, part, bias=False)
        widths = {"translation": width + part, "angle": width + 4 * part, "size": width + 5 * part}
        self.heads = nn.ModuleDict(
            {name: nn.ModuleList(layers(inside, 2 * inside, inside, numbers) for _ in range(1 if name == "angle" else 3))
             for name, inside in widths.items()}
        )  # fmt: skip

    @property
    def end(self) -> int:
        """Place of the end symbol among the categories."""
        return self.classes + 1

    def hidden(self, classes: Tensor, boxes: Tensor, is_there: Tensor, large: Tensor, room: Tensor) -> Tensor:
        """What is known of the next object, shape (b, w).

        classes: Of objects (b, s), the large one first; those that are not there mean nothing. boxes: Middle, half extents and yaw / pi,
        scaled to -1..1, shape (b, s, 7). is_there: Shape (b, s). large, room: Places in the vocabulary (b,).
        """
        named = self.class_in(functional.one_hot(classes, self.classes + 2).to(boxes.dtype))
        tokens = self.object_in(torch.cat([named, waves(boxes, self.config.embedding).flatten(-2)], dim=-1))
        tokens = torch.cat([tokens[:, :1] + self.large_token, tokens[:, 1:]], dim=1)
        start = self.start(self.text(large, room))[:, None]
        every = torch.cat([start, self.query.expand_as(start), tokens], dim=1)
        absent = torch.cat([torch.zeros_like(is_there[:, :1]).expand(-1, 2), ~is_there], dim=1)
        return self.encoder(every, src_key_padding_mask=absent)[:, 1]

    def numbers(self, hidden: Tensor, category: Tensor, context: Tensor, part: str) -> Tensor:
        """Mixtures of a part of the next object, shape (b, 1 or 3, 3 m): weights, middles and scales, weights and scales as logarithms.

        category: Of the object (b,). told: Numbers that come before the part, in order: none, middle, middle and yaw / pi; (b, 0, 3 or 4).
        """
        named = self.class_told(functional.one_hot(category, self.classes + 2).to(hidden.dtype))
        known = torch.cat([hidden, named, waves(context, self.config.embedding).flatten(-2)], dim=-1)
        heads: Any = self.heads[part]
        return torch.stack([head(known) for head in heads], dim=1)

    def forward(
        self, classes: Tensor, boxes: Tensor, is_there: Tensor, large: Tensor, room: Tensor, next_class: Tensor, next_box: Tensor
    ) -> dict[str, Tensor]:
        """Logits of the next object's category (b, k + 2), and mixtures of its parts, each told the truth of those before.

        next_class: Of the next object (b,). next_box: As a row of boxes (b, 7). Others: As `hidden`.
        """
        hidden = self.hidden(classes, boxes, is_there, large, room)
        made = {"class": self.class_out(hidden)}
        context = next_box[:, [0, 1, 2, 6]]
        for part, count in zip(PARTS, (0, 3, 4), strict=True):
            made[part] = self.numbers(hidden, next_class, context[:, :count], part)
        return made


def mixture(values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Log weights, middles and log scales (..., m) of a head's numbers (..., 3 m)."""
    weights, middles, scales = values.chunk(3, dim=-1)
    return weights.log_softmax(dim=-1), middles, scales.clamp(min=LEAST_LOG_SCALE)


def log_likelihood(values: Tensor, truth: Tensor) -> Tensor:
    """Log of the share of the bin around the truth (...) by mixtures of logistics (..., 3 m); the outer bins reach to infinity."""
    weights, middles, scales = mixture(values)
    centered, inverse = truth[..., None] - middles, torch.exp(-scales)
    upper, lower = inverse * (centered + 1.0 / (BINS - 1)), inverse * (centered - 1.0 / (BINS - 1))
    # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - e^(l - u)), whose logarithm is exact however far out
    inside = functional.logsigmoid(upper) + functional.logsigmoid(-lower) + torch.log(-torch.expm1(lower - upper))
    edge = 1.0 - 1.0 / (BINS - 1)
    log = torch.where(truth[..., None] < -edge, functional.logsigmoid(upper), inside)
    log = torch.where(truth[..., None] > edge, functional.logsigmoid(-lower), log)
    return torch.logsumexp(weights + log, dim=-1)


def drawn_number(values: Tensor, generator: torch.Generator) -> Tensor:
    """Numbers (...) within -1..1 drawn from mixtures of logistics (..., 3 m); the scale is what it is in training."""
    weights, middles, scales = mixture(values)
    chosen = torch.multinomial(weights.exp().flatten(0, -2), 1, generator=generator).reshape(*weights.shape[:-1], 1)
    even = torch.rand(chosen.shape, generator=generator).clamp(1e-5, 1.0 - 1e-5)
    drawn = middles.gather(-1, chosen) + scales.gather(-1, chosen).exp() * (even.log() - torch.log1p(-even))
    return drawn[..., 0].clamp(-1.0, 1.0)


def angle_of(cosine: Tensor, sine: Tensor) -> Tensor:
    """Yaws as shares of pi, -1..1."""
    return torch.atan2(sine, cosine) / math.pi
