"""Losses of the selection model (specs C.3): the chosen candidate, the order of the next ones, strangers, and names."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional


def plackett_luce(scores: Tensor, ranking: Tensor) -> Tensor:
    """Mean negative logarithm of the chance of ordered prefixes (Plackett, 1975; Luce, 1959), each divided by its length.

    scores: (b, k), -inf where there is no candidate. ranking: (b, m) candidates, best first, filled up with -1. Objects without a ranking
    count for nothing.
    """
    left, total = scores, scores.new_zeros(len(scores))
    rows = torch.arange(len(scores), device=scores.device)
    for place in range(ranking.shape[1]):
        chosen = ranking[:, place]
        given = chosen >= 0
        index = chosen.clamp(min=0)
        # of a row that is through, zeros: the logarithm of nothing has no gradient
        terms = torch.where(given[:, None], left, torch.zeros_like(left))
        total = total - torch.where(given, terms[rows, index] - terms.logsumexp(1), torch.zeros_like(total))
        left = left.masked_fill(functional.one_hot(index, scores.shape[1]).bool() & given[:, None], -torch.inf)
    lengths = (ranking >= 0).sum(1)
    return (total / lengths.clamp(min=1)).sum() / (lengths > 0).sum().clamp(min=1)


def total(made: Mapping[str, Tensor], batch: Mapping[str, Tensor], weights: Mapping[str, float]) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss of what `Selector` made of a batch, and its parts. `weights`: of `rank`, `strangers` and `names`; the choice counts 1.

    batch: With `choice` (b,), and for the parts `ranking` (b, m), and `name` (b,), the place of the right one among `words`.
    """
    parts = {"choice": functional.cross_entropy(made["scores"], batch["choice"])}
    if weights.get("rank"):
        parts["rank"] = plackett_luce(made["scores"], batch["ranking"])
    if weights.get("strangers") and "strangers" in made:
        parts["strangers"] = functional.cross_entropy(made["strangers"], torch.zeros_like(batch["choice"]))
    if weights.get("names") and "names" in made:
        parts["names"] = functional.cross_entropy(made["names"], batch["name"])
    return torch.stack([value * weights.get(name, 1.0) for name, value in parts.items()]).sum(), parts
