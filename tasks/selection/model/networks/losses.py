"""Losses of the selection model (specs C.3): the chosen candidate, the order of the next ones, strangers, and names."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

from tasks.selection.model.networks.selector import Selector


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


def strangers(selector: Selector, made: Mapping[str, Tensor], choice: Tensor, others: Tensor) -> Tensor:
    """Cross entropy of the chosen candidate among candidates of other scenes, without quality.

    others: (b, m) places among all candidates of the batch, object by object, -1 where no other scene has any.
    """
    candidates = made["candidates"]
    rows = torch.arange(len(choice), device=choice.device)
    group = torch.cat([candidates[rows, choice][:, None], candidates.flatten(0, 1)[others.clamp(min=0)]], dim=1)
    scores = selector.compared(group, made)
    missing = torch.cat([torch.zeros_like(others[:, :1]), others], dim=1) < 0
    return functional.cross_entropy(scores.masked_fill(missing, -torch.inf), torch.zeros_like(choice))


def names(selector: Selector, points: Tensor, words: Tensor, name: Tensor) -> Tensor:
    """Cross entropy of scanned points among the categories of a batch: (b, e), tokens (c, t), index of the right one (b,)."""
    assert selector.text_encoder is not None
    texts = functional.normalize(selector.text_encoder(words), dim=-1)
    return functional.cross_entropy(selector.scale() * points @ texts.T, name)


def total(selector: Selector, batch: Mapping[str, Tensor], weights: Mapping[str, float]) -> tuple[Tensor, dict[str, float]]:
    """The loss of a batch, and its parts. `weights`: of `rank`, `strangers` and `names`; the choice counts 1.

    Beside what the network takes a batch has `choice` (b,), `ranking` (b, m), `others` (b, m), and `words` and `name` for names.
    """
    made = selector(batch)
    parts = {"choice": functional.cross_entropy(made["scores"], batch["choice"])}
    if weights.get("rank"):
        parts["rank"] = plackett_luce(made["scores"], batch["ranking"])
    is_asked = any(name in made for name in ("points", "image", "text"))
    if weights.get("strangers") and is_asked:
        parts["strangers"] = strangers(selector, made, batch["choice"], batch["others"])
    if weights.get("names") and "points" in made and "words" in batch:
        parts["names"] = names(selector, made["points"], batch["words"], batch["name"])
    loss = torch.stack([value * weights.get(name, 1.0) for name, value in parts.items()]).sum()
    return loss, {name: float(value.detach()) for name, value in parts.items()}
