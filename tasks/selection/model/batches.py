"""Batches of the selection model: which objects a step sees, and how it sees them, as a function of seed and step alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.augmentation import augmented, cropped
from tasks.selection.model.config import AugmentationConfig, OwnText, SelectionModel
from tasks.selection.model.examples import Example
from tasks.selection.model.features import features_of
from tasks.selection.model.words import tokens_of
from tasks.settings import Config, Count, NonNegative

if TYPE_CHECKING:
    from torch import Tensor

MOST_CANDIDATES = 10
RANKED = 5
"""Places of a ranking that count (specs C.3)."""
NAME_TOKENS = 24
"""Of a category's name."""


@dataclasses.dataclass(frozen=True)
class BatchConfig(Config):
    """What a training step sees, and what counts."""

    objects: Count = 12  # of ten candidates each: a step takes 0.3 s on two cores
    rank_weight: NonNegative = 0.5  # of the order of the next candidates (specs C.3, C.8); 0 leaves ranks out
    strangers_weight: NonNegative = 0.5  # of the group of other scenes' candidates; better than 1 in the toy runs of specs C.8
    names_weight: NonNegative = 0.1  # of telling what a scan shows: little, since few objects are chosen by it
    regroup: bool = False  # groups begin at random points: the paper's way; leaving out points has the same effect for less
    augmentation: AugmentationConfig = dataclasses.field(default_factory=AugmentationConfig)


def chosen_objects(count: int, objects: int, step: int, seed: int) -> NDArray[np.int64]:
    """Examples of a step: every example once in an epoch, in an order that seed and epoch give; the last batch runs into the next epoch."""
    places = np.arange(step * objects, (step + 1) * objects)
    orders = {int(e): np.random.default_rng([seed, 1, int(e)]).permutation(count) for e in np.unique(places // count)}
    return np.array([orders[int(p // count)][p % count] for p in places])


def training_batch(
    examples: Sequence[Example], clouds: Mapping[str, bytes], model: SelectionModel, config: BatchConfig, seed: int, step: int
) -> dict[str, NDArray]:
    """What step `step` learns from, by the names that the network and its losses have for it."""
    chosen = [examples[i] for i in chosen_objects(len(examples), config.objects, step, seed)]
    rows, choices, rankings = [], [], []
    for place, example in enumerate(chosen):
        rng = np.random.default_rng([seed, 2, step, place])
        contenders = example.contenders(clouds)
        order = rng.permutation(len(contenders))
        given = example.rankings[int(rng.integers(len(example.rankings)))]  # annotators disagree: each is heard as often
        mixed = [contenders[i] for i in order]
        view = augmented(example.scanned, mixed, model, config.augmentation, rng)
        scanned = example.scanned
        if scanned.image is not None:
            scanned = dataclasses.replace(scanned, image=cropped(scanned.image, config.augmentation.crop, rng))
        rows.append(features_of(scanned, mixed, model, view))
        at = np.argsort(order)
        choices.append(int(at[given[0]]))
        rankings.append([int(at[i]) for i in given[:RANKED]] + [-1] * (RANKED - len(given)))
    batch = joined(rows)
    batch["choice"], batch["ranking"] = np.array(choices), np.array(rankings)
    rng = np.random.default_rng([seed, 3, step])
    batch["others"] = others_of(batch["is_candidate"], [example.scene_id for example in chosen], rng)
    if config.regroup:
        starts = rng.integers(model.architecture.points, size=(len(chosen), batch["is_candidate"].shape[1] + 1))
        batch["starts"] = starts
    if isinstance(model.text, OwnText):
        named = sorted({example.scanned.category for example in chosen})
        batch["words"] = np.stack([tokens_of(name, model.text.buckets, NAME_TOKENS) for name in named])
        batch["name"] = np.array([named.index(example.scanned.category) for example in chosen])
    return batch


def others_of(is_candidate: NDArray[np.bool_], scenes: Sequence[str], rng: np.random.Generator) -> NDArray[np.int64]:
    """For every object places of candidates of other scenes, shape (b, 9), drawn without repetition; -1 where there are too few."""
    count = is_candidate.shape[1]
    owner = np.repeat(np.arange(len(scenes)), count)
    names = np.array(scenes)[owner]
    made = np.full((len(scenes), MOST_CANDIDATES - 1), -1)
    for row, scene in enumerate(scenes):
        free = np.flatnonzero(is_candidate.ravel() & (names != scene))
        drawn = rng.permutation(free)[: MOST_CANDIDATES - 1]
        made[row, : len(drawn)] = drawn
    return made


def joined(rows: Sequence[Mapping[str, NDArray]]) -> dict[str, NDArray]:
    """Features of objects as one batch; what some have more candidates of is filled up with zeros."""
    batch = {}
    for name in rows[0]:
        values = [np.asarray(row[name]) for row in rows]
        most = max((len(value) for value in values if value.ndim), default=0)
        if name in ("clouds", "sizes", "evidence", "residuals", "is_candidate"):
            values = [np.concatenate([v, np.zeros((most - len(v), *v.shape[1:]), dtype=v.dtype)]) if len(v) < most else v for v in values]
        batch[name] = np.stack(values)
    return batch


def tensors(batch: Mapping[str, NDArray]) -> dict[str, Tensor]:
    """A batch for torch."""
    import torch

    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in batch.items()}


@dataclasses.dataclass(frozen=True)
class SelectionObjective:
    """What fitting asks for (`tasks.training.fitting.Objective`): batches, the loss, and how good weights are on held-out rooms."""

    learning: Sequence[Example]
    held: Sequence[Example]
    clouds: Mapping[str, bytes]
    model: SelectionModel
    config: BatchConfig
    seed: int

    def batch(self, step: int) -> dict[str, Tensor]:
        """Tensors of a step."""
        return tensors(training_batch(self.learning, self.clouds, self.model, self.config, self.seed, step))

    def loss(self, module: Any, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The loss and its parts."""
        from tasks.selection.model.networks.losses import total

        weights = {"rank": self.config.rank_weight, "strangers": self.config.strangers_weight, "names": self.config.names_weight}
        loss, parts = total(module(batch), batch, weights)
        return loss, {name: float(value.detach()) for name, value in parts.items()}

    def validate(self, module: Any) -> float | None:
        """Mean of the share of right choices and of the chance given to them; None without rooms held out. The chance tells models apart
        that a few hundred choices do not."""
        if not self.held:
            return None
        scores = predicted(module, self.held, self.clouds)
        right = [float(np.argmax(s) == e.choice) for s, e in zip(scores, self.held, strict=True)]
        chances = [float(np.exp(s[e.choice] - s.max()) / np.exp(s - s.max()).sum()) for s, e in zip(scores, self.held, strict=True)]
        return 0.5 * float(np.mean(right) + np.mean(chances))


def predicted(module: Any, examples: Sequence[Example], clouds: Mapping[str, bytes], at_once: int = 16) -> list[NDArray[np.float32]]:
    """Scores of the candidates of examples, shape (k,) each, by what the model's config says decides; the module's mode stays."""
    import torch

    config = module.config
    device = next(module.parameters()).device
    was_training = module.training
    module.eval()
    made: list[NDArray[np.float32]] = []
    with torch.no_grad():
        for first in range(0, len(examples), at_once):
            part = examples[first : first + at_once]
            batch = joined([features_of(e.scanned, e.contenders(clouds), config) for e in part])
            out = module({name: values.to(device) for name, values in tensors(batch).items()})
            scores = out["match" if config.decides == "match" else "scores"].float().cpu().numpy()
            made += [row[: len(e.candidates)] for row, e in zip(scores, part, strict=True)]
    module.train(was_training)
    return made
