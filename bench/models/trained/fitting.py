"""Fitting the network to training frames: crops under noise that is drawn in each step, and what pixels, pairs and objects in them are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, MutableMapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.models.trained.channels import channels, level_heights, mirrored
from bench.models.trained.grouping import PAIRS, halves
from bench.models.trained.noise import measured_depth, seen_color
from bench.models.trained.scenes import FIRST_SEED, SUPPORT, TALL_M, TrainingFrame, training_frames
from bench.models.trained.things import NAMELESS
from tasks.capture.small_objects.classical import filled_depth
from tasks.capture.small_objects.lifting import DepthView
from tasks.settings import Config, Count
from tasks.training.fitting import FittingConfig, fit, seed_of, seeded

if TYPE_CHECKING:
    from torch import Tensor, nn

    from bench.models.trained.networks.parting import PartingNet

CROP = (128, 176)
"""Rows and columns that are learned from at once: half of a frame, with a few objects whole."""

NO_DEPTH = -3
"""Owner of pixels without depth, of which nothing is learned."""

_TILT, _LEVEL_M, _HALF_M = 0.004, 0.0025, 0.02
_IGNORED = -100


@dataclasses.dataclass(frozen=True)
class TrainedConfig(Config):
    """What the network is learned from, and how."""

    scenes: Count = 220  # each another support with other things: more scenes are worth more than more views of them
    views: Count = 4  # of a scene
    crops: Count = 4  # of a step: norms of batches need some
    steps: Count = 5000  # 45 minutes beside other jobs; each crop has noise of its own
    seed: Count = FIRST_SEED  # of the first scene; what is measured has lower ones


@dataclasses.dataclass(frozen=True)
class TrainingCrop:
    """A crop. seen: Channels (c, h, w). owner: Thing of each pixel, `SUPPORT`, `REST` or `NO_DEPTH`, shape (h, w). above: Pixels in a slab,
    shape (h, w). category: Of each fourth pixel, -100 for none, shape (h / 4, w / 4)."""

    seen: NDArray[np.float32]
    owner: NDArray[np.int64]
    above: NDArray[np.bool_]
    category: NDArray[np.int64]


def training_crop(frame: TrainingFrame, rng: np.random.Generator) -> TrainingCrop:
    """A crop of a frame around some pixel of a thing, as a sensor by chance sees it; half of them mirrored."""
    rows, columns = np.nonzero(frame.owner >= 0)
    pixel, shape = int(rng.integers(len(rows))), frame.owner.shape
    top = int(np.clip(rows[pixel] - rng.integers(CROP[0]), 0, shape[0] - CROP[0]))
    left = int(np.clip(columns[pixel] - rng.integers(CROP[1]), 0, shape[1] - CROP[1]))
    crop = (slice(top, top + CROP[0]), slice(left, left + CROP[1]))
    owner = frame.owner[crop].astype(np.int64)
    depth = filled_depth(measured_depth(frame.depth[crop], frame.facing[crop], rng))
    color = seen_color(frame.color[crop], rng)
    fx, fy, cx, cy = frame.intrinsics
    view = DepthView("", depth, color, (fx, fy, cx - left, cy - top), frame.pose)
    points, measured = view.points(), depth > 0
    # a board is found in a frame to some millimeters
    middle = points[measured][:, :2].mean(axis=0) if measured.any() else np.zeros(2)
    points[..., 2] += rng.normal(0, _LEVEL_M) + (points[..., :2] - middle) @ rng.normal(0, _TILT, 2)
    boards = frame.boards.copy()
    if len(boards) == 1:
        boards[:, 1] = TALL_M * rng.uniform(0.75, 1.1)
    heights = level_heights(points, boards, frame.half + rng.normal(0, _HALF_M, 2), measured)
    pose = frame.pose
    owner[~measured] = NO_DEPTH
    if rng.random() < 0.5:
        pose, owner = mirrored(pose), owner[:, ::-1]
        depth, color = np.ascontiguousarray(depth[:, ::-1]), np.ascontiguousarray(color[:, ::-1])
        view = dataclasses.replace(view, intrinsics=(fx, fy, CROP[1] - 1 - view.intrinsics[2], view.intrinsics[3]))
        heights = dataclasses.replace(
            heights, height=np.ascontiguousarray(heights.height[:, ::-1]), above=np.ascontiguousarray(heights.above[:, ::-1])
        )
    category = np.where((owner >= 0) & heights.above, frame.categories[np.maximum(owner, 0)], _IGNORED)[::4, ::4]
    category = np.where(category == NAMELESS, _IGNORED, category)
    return TrainingCrop(channels(depth, color, view.intrinsics, pose, heights), owner.copy(), heights.above, category)


@dataclasses.dataclass(frozen=True)
class PartingObjective:
    """What the network is asked for. frames: That are learned from."""

    frames: Sequence[TrainingFrame]
    crops: int
    seed: int

    def batch(self, step: int) -> tuple[Tensor, ...]:
        """Channels (b, c, h, w), owners (b, h, w), pixels in slabs (b, h, w) and categories (b, h / 4, w / 4) of crops of a step."""
        import torch

        rng = np.random.default_rng([self.seed, step, 5])
        made = [training_crop(self.frames[int(rng.integers(len(self.frames)))], rng) for _ in range(self.crops)]
        return tuple(
            torch.from_numpy(np.stack([getattr(each, field.name) for each in made])) for field in dataclasses.fields(TrainingCrop)
        )  # fmt: skip

    def loss(self, module: nn.Module, batch: tuple[Tensor, ...]) -> tuple[Tensor, dict[str, float]]:
        """Cross entropy of kinds, of pairs of which one is an object's, and of categories."""
        from torch.nn.functional import cross_entropy

        seen, owner, above, category = batch
        kinds, pairs, categories = (each.float() for each in module(seen))
        of_kinds, of_pairs = kind_loss(kinds, owner, above), pair_loss(pairs, owner)
        of_categories = cross_entropy(categories, category, ignore_index=_IGNORED) if (category >= 0).any() else 0 * categories.sum()
        parts = {"kinds": float(of_kinds.detach()), "pairs": float(of_pairs.detach()), "categories": float(of_categories.detach())}
        return of_kinds + 1.5 * of_pairs + 0.15 * of_categories, parts

    def validate(self, module: nn.Module) -> float | None:
        """Nobody looks: the schedule ends, and no frame comes twice under the same noise."""
        return None


def kind_loss(kinds: Tensor, owner: Tensor, above: Tensor) -> Tensor:
    """Mean cross entropy over pixels with depth; those above no board count a tenth."""
    import torch
    from torch.nn.functional import cross_entropy

    target = torch.where(owner >= 0, 2, torch.where(owner == SUPPORT, 1, 0))
    weight = torch.where(above, 1.0, 0.1) * (owner > NO_DEPTH)
    each = cross_entropy(kinds, target, reduction="none", weight=torch.tensor([1.0, 1.0, 1.5], device=kinds.device))
    return (each * weight).sum() / weight.sum().clamp(min=1)


def pair_loss(pairs: Tensor, owner: Tensor) -> Tensor:
    """Mean over steps of the mean cross entropy of pairs with depth: of two objects they count thrice, of an object and what is none
    half, since those are parted by their kinds already."""
    import torch
    from torch.nn.functional import binary_cross_entropy_with_logits

    losses = []
    for place, step in enumerate(PAIRS):
        (here_rows, here_columns), (there_rows, there_columns) = halves(step)
        a, b = owner[:, here_rows, here_columns], owner[:, there_rows, there_columns]
        is_one, both = (a == b) & (a >= 0), (a >= 0) & (b >= 0)
        counted = ((a >= 0) | (b >= 0)) & (a > NO_DEPTH) & (b > NO_DEPTH)
        weight = counted * torch.where(both & ~is_one, 3.0, torch.where(both, 1.0, 0.5))
        each = binary_cross_entropy_with_logits(pairs[:, place, here_rows, here_columns], is_one.float(), reduction="none")
        losses.append((each * weight).sum() / weight.sum().clamp(min=1))
    return torch.stack(losses).mean()


def fitted_network(
    config: TrainedConfig, checkpoints: MutableMapping[str, bytes], report: Callable[[int, int, str], None]
) -> tuple[PartingNet, dict[str, Any]]:
    """The network after its training, for inference, and figures of it. The same settings give the same weights bit for bit.

    Raises:
        InputError: torch is not installed.
    """
    from bench.models.trained.networks.parting import PartingNet

    frames: list[TrainingFrame] = []
    for number in range(config.scenes):
        frames += training_frames(config.seed + number, config.views)
        report(number + 1, config.scenes, "scenes")
    fitting = FittingConfig(
        steps=config.steps, learning_rate=2.5e-3, warmup_steps=100, weight_decay=1e-4, clip_norm=5.0, precision="bf16-mixed", device="cpu",
        checkpoint_steps=100, validate_steps=config.steps, record_steps=100,
    )  # fmt: skip
    objective = PartingObjective(frames, config.crops, config.seed)
    with seeded(config.seed, "weights"):
        network = PartingNet()
    fitted = fit(network, objective, fitting, seed=seed_of(config.seed, "fit"), checkpoints=checkpoints, key="parting", report=report)
    network.load_state_dict(dict(fitted.state_dict))
    last = fitted.steps[-1]
    figures = {
        "parameters": sum(each.numel() for each in network.parameters()), "frames": len(frames), "steps": config.steps,
        "seconds": fitted.seconds, "loss": last.loss, **last.parts,
    }  # fmt: skip
    return network.eval(), figures
