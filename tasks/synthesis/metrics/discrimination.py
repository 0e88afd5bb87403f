"""How well a classifier tells drawn layouts from true ones (SCA): 50 % when they are alike, 100 % when each gives itself away.

The classifier sees boxes, not pictures: a network of relations, the same for any order of the objects, that looks at every object and
every two of them. So it sees what a picture from above does not, such as heights, and knows what is beside what.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.selection.metrics.bootstrap import ConfidenceInterval, interval
from tasks.synthesis.layout import Array, Layout
from tasks.synthesis.metrics.boxes import TOLERANCE_M, depths, overhangs

if TYPE_CHECKING:
    import torch

FOLDS = 5
"""Classifiers that are trained; each judges the fifth of the layouts that it did not see."""

MOST_OBJECTS = 23
"""Of a layout that are looked at."""

SMALLEST_M = TOLERANCE_M
"""Lengths are seen in steps of so much: what is less is no collision either."""

WIDTH = 48
FARTHEST = 4.0
"""Standard deviations beyond which inputs are not told apart."""


@dataclasses.dataclass(frozen=True)
class Classifier:
    """How the classifier is trained."""

    epochs: int = 40
    batch: int = 128
    learning_rate: float = 3e-3
    weight_decay: float = 0.02


@dataclasses.dataclass(frozen=True)
class _Inputs:
    """Layouts as arrays, their objects one after another. objects: shape (n, f). names: Numbers of their categories, shape (n,). pairs: Of
    every two different objects of a layout, shape (p, g). ends: The two, counted within their layout, shape (p, 2). larges: Of the
    layouts, shape (l, h). kinds: Numbers of the large object's category and of its room, shape (l, 2). counts: Objects, shape (l,)."""

    objects: NDArray[np.float32]
    names: NDArray[np.int64]
    pairs: NDArray[np.float32]
    ends: NDArray[np.int64]
    larges: NDArray[np.float32]
    kinds: NDArray[np.int64]
    counts: NDArray[np.int64]

    def __getitem__(self, rows: NDArray[np.int64]) -> _Inputs:
        """Some of the layouts, in this order."""
        counts, pairs = self.counts[rows], self.counts * (self.counts - 1)
        objects, of_pairs = _ranges(self.counts, rows), _ranges(pairs, rows)
        return _Inputs(self.objects[objects], self.names[objects], self.pairs[of_pairs], self.ends[of_pairs], self.larges[rows],
                       self.kinds[rows], counts)  # fmt: skip


def classifier_accuracy(
    truth: Sequence[Layout], drawn: Sequence[Layout], seed: int, classifier: Classifier | None = None
) -> ConfidenceInterval:
    """Share of layouts that a classifier which saw others puts on the right side (SCA), with its interval of 95 %.

    Equally many of both sides are judged, each once. Layouts on the same large object are judged by the same classifier, so that it
    cannot know from the one what the other is. NaN where a side has fewer than `FOLDS` layouts.
    """
    count = min(len(truth), len(drawn))
    if count < FOLDS:
        return ConfidenceInterval(math.nan, math.nan, math.nan, 0)
    rng = np.random.default_rng([seed, 2])
    chosen = [[side[at] for at in sorted(rng.permutation(len(side))[:count].tolist())] for side in (truth, drawn)]
    layouts = [*chosen[0], *chosen[1]]
    answers = np.repeat([0, 1], count)
    inputs, keys = _inputs_of(layouts), [repr(layout.large) for layout in layouts]
    folds = _folds(keys, seed)
    hits = np.full(len(layouts), math.nan)
    for fold in range(FOLDS):
        held = folds == fold
        if held.any() and not held.all():
            hits[held] = _hits(inputs, answers, held, seed * FOLDS + fold, classifier or Classifier())
    return interval(hits, keys, seed)


def shuffled(layouts: Sequence[Layout], seed: int) -> list[Layout]:
    """Layouts whose objects stand anywhere: footprints inside of the large object's box as far as they fit, at their own heights and
    turns. What tells true ones from drawn ones has to tell these from true ones, or it tells nothing."""
    rng = np.random.default_rng([seed, 3])
    made = []
    for layout in layouts:
        centers = layout.centers.copy()
        room = np.maximum(-(overhangs(layout) - np.abs(layout.centers[:, :2])), 0.0)
        centers[:, :2] = rng.uniform(-1.0, 1.0, size=(len(layout), 2)) * room
        made.append(dataclasses.replace(layout, centers=centers))
    return made


def _folds(keys: Sequence[str], seed: int) -> NDArray[np.int64]:
    """Which classifier judges each layout, shape (n,): equally many large objects each, by chance."""
    names = sorted(set(keys), key=lambda key: hashlib.sha256(f"{seed}|{key}".encode()).digest())
    place = {name: at % FOLDS for at, name in enumerate(names)}
    return np.array([place[key] for key in keys], dtype=np.int64)


def _ranges(counts: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Places of what some rows hold, where row after row holds so many, shape (sum of these counts,)."""
    chosen, starts = counts[rows], np.cumsum(counts) - counts
    return np.asarray(np.arange(chosen.sum()) + np.repeat(starts[rows] - (np.cumsum(chosen) - chosen), chosen))


def _inputs_of(layouts: Sequence[Layout]) -> _Inputs:
    names = {name: at for at, name in enumerate(sorted({name for layout in layouts for name in layout.categories}))}
    counts = np.array([min(len(layout), MOST_OBJECTS) for layout in layouts])
    ends = [np.argwhere(~np.eye(count, dtype=bool)) for count in counts.tolist()]
    kinds = [
        {value: number for number, value in enumerate(sorted({getattr(layout.large, field) for layout in layouts}))}
        for field in ("category", "room_type")
    ]
    return _Inputs(
        objects=_scaled(np.concatenate([_objects(layout)[:count] for layout, count in zip(layouts, counts.tolist(), strict=True)])),
        names=np.array([names[name] for layout in layouts for name in layout.categories[:MOST_OBJECTS]], dtype=np.int64),
        pairs=_scaled(np.concatenate([_pairs(layout)[two[:, 0], two[:, 1]] for layout, two in zip(layouts, ends, strict=True)])),
        ends=np.concatenate(ends),
        larges=_scaled(np.array([[*np.log(layout.large.size), len(layout)] for layout in layouts])),
        kinds=np.array([[kinds[0][layout.large.category], kinds[1][layout.large.room_type]] for layout in layouts]),
        counts=counts,
    )


def _objects(layout: Layout) -> Array:
    """What is seen of each object, shape (n, 13): place over the sides and in metres, how far over the edges, bottom above the top and, of
    what is near it, exactly, size, turn."""
    gap = layout.centers[:, 2] - 0.5 * layout.sizes[:, 2] - layout.large.size[2]
    lengths = _rounded(np.column_stack([layout.centers[:, :2], np.maximum(overhangs(layout), -0.1), gap, np.clip(gap, -0.05, 0.05)]))
    place = 2.0 * layout.centers[:, :2] / np.asarray(layout.large.size[:2])
    turn = np.column_stack([np.cos(layout.yaws), np.sin(layout.yaws)])
    return np.column_stack([place, lengths, np.log(np.maximum(_rounded(layout.sizes), SMALLEST_M)), turn])


def _pairs(layout: Layout) -> Array:
    """What is seen of every two objects, shape (n, n, 6): the second in the frame of the first, its turn there, how deep they are in
    each other."""
    cos, sin = np.cos(layout.yaws)[:, None], np.sin(layout.yaws)[:, None]
    between = layout.centers[None] - layout.centers[:, None]
    turns = layout.yaws[None] - layout.yaws[:, None]
    along, across = between[..., 0] * cos + between[..., 1] * sin, between[..., 1] * cos - between[..., 0] * sin
    lengths = _rounded(np.stack([along, across, between[..., 2], np.clip(depths(layout), -0.1, 0.1)], axis=-1))
    return np.concatenate([lengths, np.cos(turns)[..., None], np.sin(turns)[..., None]], axis=-1)


def _rounded(lengths: Array) -> Array:
    """Lengths as the classifier sees them [m]."""
    return np.asarray(np.round(lengths / SMALLEST_M) * SMALLEST_M)


def _scaled(values: Array) -> NDArray[np.float32]:
    """Values less their means over the rows, by their spreads."""
    if not len(values):
        return np.zeros(values.shape, dtype=np.float32)
    scaled = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-6)
    return np.asarray(np.clip(scaled, -FARTHEST, FARTHEST), dtype=np.float32)


def _hits(inputs: _Inputs, answers: NDArray[np.int64], held: NDArray[np.bool_], seed: int, settings: Classifier) -> Array:
    """Of the held-out layouts, 1 for those judged rightly, shape (n,)."""
    import torch

    target = torch.from_numpy(answers).float()
    learned, judged = np.flatnonzero(~held), np.flatnonzero(held)
    rng = np.random.default_rng([seed, 4])
    with _seeded(seed):
        network = _network(inputs)
        batches = math.ceil(len(learned) / settings.batch)
        optimizer = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, settings.learning_rate, total_steps=settings.epochs * batches)
        for _ in range(settings.epochs):
            for batch in np.array_split(rng.permutation(learned), batches):
                loss = torch.nn.functional.binary_cross_entropy_with_logits(network(inputs[batch]), target[torch.from_numpy(batch)])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
        network.eval()
        with torch.inference_mode():
            scores = network(inputs[judged])
    return np.asarray(((scores > 0) == (target[torch.from_numpy(judged)] > 0.5)).double().numpy())


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Torch with draws by a seed and one thread, so that sums are in the same order however many there are; as it was afterwards."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(threads)


def _network(inputs: _Inputs) -> Any:
    """A network of relations for such inputs."""
    import torch
    from torch import nn

    def layers(*widths: int) -> nn.Sequential:
        return nn.Sequential(*(part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU())))

    def gathered(values: torch.Tensor, into: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Sums and maxima of rows by where they belong; 0 where nothing does."""
        zeros = values.new_zeros(count, values.shape[1])
        most = zeros.scatter_reduce(0, into[:, None].expand_as(values), values, "amax", include_self=False)
        return zeros.index_add(0, into, values), most

    class Relations(nn.Module):
        """Objects, what others are to each, and the whole."""

        def __init__(self) -> None:
            super().__init__()
            self.name = nn.Embedding(int(inputs.names.max(initial=0)) + 1, WIDTH)
            self.kinds = nn.ModuleList(nn.Embedding(int(inputs.kinds[:, at].max()) + 1, WIDTH // 4) for at in range(2))
            self.large = layers(inputs.larges.shape[1] + 2 * (WIDTH // 4), WIDTH)
            self.own = layers(2 * WIDTH + inputs.objects.shape[1], WIDTH, WIDTH)
            self.first, self.second = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)
            self.between = nn.Linear(inputs.pairs.shape[1], WIDTH)
            self.relation = nn.Sequential(nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU())
            self.joined = layers(3 * WIDTH, WIDTH)
            self.dropout = nn.Dropout(0.2)
            self.head = nn.Sequential(*layers(4 * WIDTH, WIDTH), nn.Linear(WIDTH, 1))

        def forward(self, some: _Inputs) -> torch.Tensor:
            """Logits that layouts are drawn, shape (n,)."""
            counts = torch.from_numpy(some.counts)
            layout = torch.repeat_interleave(torch.arange(len(counts)), counts)
            starts = torch.repeat_interleave(counts.cumsum(0) - counts, counts * (counts - 1))
            first, second = (torch.from_numpy(some.ends[:, at].copy()) + starts for at in range(2))
            kinds = torch.from_numpy(some.kinds)
            known = [table(kinds[:, at]) for at, table in enumerate(self.kinds)]
            large = self.large(torch.cat([torch.from_numpy(some.larges), *known], dim=1))
            own = self.own(torch.cat([self.name(torch.from_numpy(some.names)), large[layout], torch.from_numpy(some.objects)], dim=1))
            related = self.relation(self.first(own)[first] + self.second(own)[second] + self.between(torch.from_numpy(some.pairs)))
            sums, most = gathered(related, first, len(own))
            joined = self.joined(torch.cat([own, most, sums / 4], dim=1))
            sums, most = gathered(joined, layout, len(counts))
            pooled = torch.cat([large, sums / counts.clamp(min=1)[:, None], sums / 4, most], dim=1)
            return torch.as_tensor(self.head(self.dropout(pooled))[:, 0])

    return Relations()
