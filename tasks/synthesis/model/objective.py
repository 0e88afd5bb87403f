"""What synthesis models are fitted to: batches of layouts as a function of seed and step alone, their losses, and held-out layouts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.synthesis.layout import UNKNOWN_ROOM, Layout
from tasks.synthesis.model.config import Atiss, Diffusion, Noise
from tasks.synthesis.model.encoding import BOX, Encoding, Vectors

if TYPE_CHECKING:
    from torch import Tensor

LOOKS = 4
"""How often each held-out layout is looked at, each time in another order, up to another beginning or with other noise."""

CHANCES_WEIGHT = 0.25
"""Of the logarithm of chances in the loss: most of it no network can lower, and boxes are learned more slowly."""

LEAST_CHANCE = 1e-6
"""Of a category, as it is told: its logarithm is finite."""

AT_ONCE = 128
"""Layouts of a batch where nothing is learned."""

Batch = dict[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Examples:
    """Layouts as arrays: vectors (n, m, d) with all of their objects, however many slots a model has; how many small objects each has (n,);
    places of the large object's category and of the room in the vocabulary (n,)."""

    vectors: Vectors
    counts: NDArray[np.int64]
    large: NDArray[np.int64]
    room: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.counts)


def examples_of(layouts: Sequence[Layout], encoding: Encoding, slots: int) -> Examples:
    """Layouts by an encoding, with at least so many slots.

    Raises:
        InputError: the vocabulary lacks a category.
    """
    most = max([slots, *(len(layout) + 1 for layout in layouts)])
    vectors = [encoding.vectors(layout, most) for layout in layouts]
    places = np.array([encoding.condition(layout.large) for layout in layouts], dtype=np.int64).reshape(-1, 2)
    shape = (len(layouts), most, encoding.width)
    counts = np.array([len(layout) for layout in layouts], dtype=np.int64)
    return Examples(np.array(vectors, dtype=np.float32).reshape(shape), counts, places[:, 0], places[:, 1])


def shuffled(examples: Examples, chosen: NDArray[np.int64], slots: int, rng: np.random.Generator) -> Vectors:
    """Examples with their objects in another order, those that find no room left out; empty slots last. Shape (b, slots, d)."""
    vectors = examples.vectors[chosen]
    keys = rng.random(vectors.shape[:2])
    keys += 2.0 * (np.arange(vectors.shape[1]) > examples.counts[chosen, None])
    keys[:, 0] = -1.0
    order = np.argsort(keys, axis=1)[:, :slots]
    return np.take_along_axis(vectors, order[..., None], axis=1)


def diffusion_batch(
    examples: Examples, chosen: NDArray[np.int64], model: Diffusion, rooms: Sequence[str], rng: np.random.Generator, *, hides: bool
) -> Batch:
    """Layouts as a denoiser learns from them: clean, with slots but the first in any order, and the noise and the step that they get.

    hides: Whether rooms and texts are hidden from some, as in training.
    """
    count = len(chosen)
    clean = shuffled(examples, chosen, model.slots, rng)
    order = np.argsort(rng.random((count, model.slots)) - 2.0 * (np.arange(model.slots) == 0), axis=1)
    # even over the steps within each batch: the loss then hangs less on which steps were drawn
    steps = (rng.permutation(count) + rng.random(count)) / count * model.noise.steps
    noise = rng.standard_normal(clean.shape, dtype=np.float32)
    return {
        "clean": np.take_along_axis(clean, order[..., None], axis=1), "noise": noise,
        "steps": np.minimum(steps.astype(np.int64), model.noise.steps - 1), "large": examples.large[chosen],
        "room": _rooms(examples, chosen, model.unknown_share if hides else 0.0, rooms, rng),
        "is_null": rng.random(count) < (model.null_share if hides else 0.0),
    }  # fmt: skip


def atiss_batch(
    examples: Examples, chosen: NDArray[np.int64], model: Atiss, rooms: Sequence[str], rng: np.random.Generator, *, hides: bool
) -> Batch:
    """Layouts as ATISS learns from them: the large object and a beginning of the small ones in any order, and what comes next.

    What comes after the last one is the end, whose box means nothing.
    """
    vectors = shuffled(examples, chosen, model.slots, rng)
    counts = np.minimum(examples.counts[chosen], model.slots - 1)
    known = np.minimum((rng.random(len(chosen)) * (counts + 1)).astype(np.int64), counts)
    classes = vectors[..., BOX:].argmax(axis=-1)
    boxes = np.concatenate([vectors[..., :6], np.arctan2(vectors[..., 7:8], vectors[..., 6:7]) / np.float32(math.pi)], axis=-1)
    place = np.minimum(known + 1, model.slots - 1)
    rows = np.arange(len(chosen))
    is_end = known == counts
    end = vectors.shape[-1] - BOX  # one place after `empty`, which is the start here
    seen = int(known.max()) + 1  # what no layout of the batch has costs nothing
    return {
        "classes": classes[:, :seen], "boxes": boxes[:, :seen], "is_there": np.arange(seen) <= known[:, None],
        "large": examples.large[chosen],
        "room": _rooms(examples, chosen, model.unknown_share if hides else 0.0, rooms, rng),
        "next_class": np.where(is_end, end, classes[rows, place]), "next_box": boxes[rows, place], "is_end": is_end,
    }  # fmt: skip


def _rooms(
    examples: Examples, chosen: NDArray[np.int64], share: float, rooms: Sequence[str], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Places of rooms, of a share of them that of the unknown one."""
    return np.where(rng.random(len(chosen)) < share, rooms.index(UNKNOWN_ROOM), examples.room[chosen])


@dataclasses.dataclass(frozen=True)
class SynthesisObjective:
    """What fitting asks for (`tasks.training.fitting.Objective`): batches, the loss, and how good weights are on held-out layouts.

    scenes: Layouts of a batch.
    """

    learning: Examples
    held: Examples
    encoding: Encoding
    model: Diffusion | Atiss
    scenes: int
    seed: int

    def batch(self, step: int) -> dict[str, Tensor]:
        """Tensors of a step."""
        rng = np.random.default_rng([self.seed, 1, step])
        shares = None
        if isinstance(self.model, Atiss) and self.model.prefixes == "even":
            beginnings = np.minimum(self.learning.counts, self.model.slots - 1) + 1.0
            shares = beginnings / beginnings.sum()
        chosen = rng.choice(len(self.learning), size=self.scenes, p=shares)
        return tensors(self._batch(self.learning, chosen, rng, hides=True))

    def loss(self, module: Any, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The loss and its parts."""
        loss, parts = atiss_loss(module, batch) if isinstance(self.model, Atiss) else self._diffusion_loss(module, batch)
        return loss, {name: float(value.detach()) for name, value in parts.items()}

    def validate(self, module: Any) -> float | None:
        """Minus the loss on held-out layouts; None without any."""
        return -self.losses(module, self.held)["loss"] if len(self.held) else None

    def losses(self, module: Any, examples: Examples) -> dict[str, float]:
        """The loss on layouts and its parts, each looked at `LOOKS` times, always in the same way."""
        import torch

        device = next(module.parameters()).device
        sums: dict[str, float] = {}
        with torch.no_grad():
            for chosen, rng in _looks(len(examples), self.seed):
                batch = {name: value.to(device) for name, value in tensors(self._batch(examples, chosen, rng, hides=False)).items()}
                loss, parts = self.loss(module, batch)
                for name, value in {"loss": float(loss), **parts}.items():
                    sums[name] = sums.get(name, 0.0) + value * len(chosen) / (LOOKS * len(examples))
        return sums

    def _batch(self, examples: Examples, chosen: NDArray[np.int64], rng: np.random.Generator, *, hides: bool) -> Batch:
        if isinstance(self.model, Atiss):
            return atiss_batch(examples, chosen, self.model, self.encoding.rooms, rng, hides=hides)
        return diffusion_batch(examples, chosen, self.model, self.encoding.rooms, rng, hides=hides)

    def _diffusion_loss(self, module: Any, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        assert isinstance(self.model, Diffusion)
        return diffusion_loss(module, batch, self.model, self.encoding)


def _looks(count: int, seed: int) -> Iterator[tuple[NDArray[np.int64], np.random.Generator]]:
    """Batches in which each of so many examples is looked at as often."""
    places = np.tile(np.arange(count), LOOKS)
    for number, first in enumerate(range(0, len(places), AT_ONCE)):
        yield places[first : first + AT_ONCE], np.random.default_rng([seed, 2, number])


def tensors(batch: Mapping[str, NDArray[Any]]) -> dict[str, Tensor]:
    """A batch for torch."""
    import torch

    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in batch.items()}


@cache
def schedule(noise: Noise) -> Any:
    """The schedule of a config, which noises and draws."""
    from diffusers import DDPMScheduler

    target = {"v": "v_prediction", "eps": "epsilon"}[noise.target]
    return DDPMScheduler(
        num_train_timesteps=noise.steps, beta_start=noise.beta_low, beta_end=noise.beta_high, beta_schedule=noise.curve,
        variance_type="fixed_small", clip_sample=True, prediction_type=target,
    )  # fmt: skip


def diffusion_loss(module: Any, batch: Mapping[str, Tensor], model: Diffusion, encoding: Encoding) -> tuple[Tensor, dict[str, Tensor]]:
    """Mean squares of what is told of boxes and of categories, of all slots but the first, and overlaps of the denoised layout. Of
    categories that are told as chances: minus the logarithm of the true one's."""
    import torch

    clean, noise, steps, scheduler = batch["clean"], batch["noise"], batch["steps"], schedule(model.noise)
    noised = scheduler.add_noise(clean, noise, steps)
    given = torch.cat([clean[:, :1], noised[:, 1:]], dim=1)
    prediction = module(given, steps, batch["large"], batch["room"], batch["is_null"])
    target = noise if model.noise.target == "eps" else scheduler.get_velocity(clean, noise, steps)
    left = scheduler.alphas_cumprod.to(clean.device)[steps][:, None, None]
    errors = (prediction - target)[:, 1:].square()
    if model.noise.weighting == "snr" and model.noise.target == "v":
        errors = errors * left  # snr / (snr + 1) is what is left of the variance
    parts = {"box": errors[..., :BOX].mean(), "class": errors[..., BOX:].mean()}
    if model.noise.target == "eps":
        denoised = (noised - (1.0 - left).sqrt() * prediction) / left.sqrt()
    else:
        denoised = left.sqrt() * noised - (1.0 - left).sqrt() * prediction
    if model.categories == "chances":
        chances = 0.5 * (denoised + 1.0)[:, 1:, BOX:].gather(-1, clean[:, 1:, BOX:].argmax(dim=-1, keepdim=True))
        parts["class"] = -chances.clamp(min=LEAST_CHANCE).log().mean()
    loss = parts["box"] + (CHANCES_WEIGHT if model.categories == "chances" else 1.0) * parts["class"]
    if model.iou_weight:
        is_object = clean[:, 1:, BOX:].argmax(dim=-1) != encoding.empty
        parts["overlap"] = (left[:, 0, 0] * overlaps(denoised[:, 1:, :6], is_object, encoding)).mean()
        loss = loss + model.iou_weight * parts["overlap"]
    return loss, parts


def overlaps(boxes: Tensor, is_object: Tensor, encoding: Encoding) -> Tensor:
    """Mean IoU of every two objects of a layout, shape (b,), of boxes as if none were turned; 0 of fewer than two objects.

    boxes: Places and half extents as encoded, shape (b, s, 6). is_object: Which slots count, shape (b, s).
    """
    import torch

    low, high = (torch.from_numpy(bound).to(boxes) for bound in (encoding.low, encoding.high))
    metric = 0.5 * (boxes.clamp(-1.0, 1.0) + 1.0) * (high - low) + low
    if encoding.heights == "bottoms":
        metric = torch.cat([metric[..., :2], metric[..., 2:3] + metric[..., 5:], metric[..., 3:]], dim=-1)
    near, far = metric[..., :3] - metric[..., 3:], metric[..., :3] + metric[..., 3:]
    common = (torch.minimum(far[:, :, None], far[:, None]) - torch.maximum(near[:, :, None], near[:, None])).clamp(min=0.0).prod(dim=-1)
    volume = (far - near).prod(dim=-1)
    pairs = is_object[:, :, None] & is_object[:, None] & ~torch.eye(boxes.shape[1], dtype=torch.bool, device=boxes.device)
    share = common / (volume[:, :, None] + volume[:, None] - common).clamp(min=1e-9)
    return (share * pairs).sum(dim=(1, 2)) / pairs.sum(dim=(1, 2)).clamp(min=1)


def atiss_loss(module: Any, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
    """Minus the logarithm of the chance of the next category, and of the seven numbers of the next box where there is one."""
    from torch.nn import functional

    from tasks.synthesis.model.networks.atiss import log_likelihood

    names = ("classes", "boxes", "is_there", "large", "room", "next_class", "next_box")
    made = module(*(batch[name] for name in names))
    truth = {"translation": batch["next_box"][:, :3], "angle": batch["next_box"][:, 6:], "size": batch["next_box"][:, 3:6]}
    is_object = (~batch["is_end"]).to(batch["boxes"].dtype)
    parts = {"class": functional.cross_entropy(made["class"], batch["next_class"])}
    for name, values in truth.items():
        parts[name] = -(log_likelihood(made[name], values).sum(dim=-1) * is_object).mean()
    return parts["class"] + parts["translation"] + parts["angle"] + parts["size"], parts
