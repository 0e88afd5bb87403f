"""Our method: every yaw with the scale that its box asks for, the best few refined by nearest points."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.alignment.distances import clamped, nearest_turn
from tasks.alignment.measures import coarse_costs, measure
from tasks.alignment.method import AlignmentMethod
from tasks.alignment.own_size import own_size_starts, refine_height
from tasks.alignment.samples import Fit, Sample, turned
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Refined(Config):
    """Every yaw with the scale that its box asks for, the best few refined by nearest points; its settings stand beside it."""

    kind: ClassVar[str] = "refined"
    camera: bool = False  # true: what looks away from the crop's camera counts as unseen; off, for scans see most things from several sides


def lacks(target: ScannedInstance, own: Refined) -> str | None:
    """Only the camera, if that is to count."""
    return "nobody knows its camera; all sides count alike" if own.camera and target.sight is None else None


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: Refined) -> Fit:
    """The best pose of an asset on an instance.

    Every yaw of a full turn is tried with the scale that its box asks for; the best few are refined by nearest points.
    Of poses that fit alike, the one squared up with the box is taken, then the one with the smaller turn. What is square stays so.
    A model with a size of its own keeps it unless a fitted scale explains the points clearly better.
    """
    if own.camera and target.sight is not None:
        target = dataclasses.replace(target, toward=target.sight.toward)
    yaws = 2 * np.pi * np.arange(config.yaw_count) / config.yaw_count
    if target.is_square:
        yaws = yaws[:: max(config.yaw_count // 4, 1)]
    fits = _boxed(target, sample, yaws.tolist(), config)
    costs = coarse_costs(target, sample, fits, config)
    square = np.ones(len(yaws), dtype=np.bool_) if target.is_square else np.arange(len(yaws)) % max(config.yaw_count // 4, 1) == 0
    order = np.argsort(np.round(costs / target.diagonal, 6), kind="stable")
    near = [i for i in order[: config.starts].tolist() if costs[i] <= config.hopeless * costs[order[0]]]
    starts = sorted({*near, next(i for i in order.tolist() if square[i])})
    rough = target.thinned(config.refine_points)
    few = dataclasses.replace(sample, points=sample.points[: config.refine_samples], normals=sample.normals[: config.refine_samples])
    tried = [fits[i] for i in starts if square[i]]
    for i in starts if not target.is_square else ():
        tried.append(refine(rough, few, fits[i], config))
        if abs(tried[-1].yaw - fits[i].yaw) > config.rebox_yaw_radians:
            tried.append(refine(rough, few, _boxed(target, sample, [tried[-1].yaw], config)[0], config))
    boxed_costs = [measure(rough, few, fit, threshold, config).cost for fit in tried]
    slack = min(boxed_costs) * (1 + config.settle) + 1e-9
    boxed = next(fit for fit, cost in zip(tried, boxed_costs, strict=True) if cost <= slack)
    if not sample.has_own_size:
        return boxed
    # A scale that is fitted has three numbers more: it must explain the points clearly better than the model's own size.
    sized = _own_sized(target, rough, sample, few, yaws, config)
    fitting = [measure(rough, few, fit, threshold, config) for fit in sized]
    sized_costs = [each.cost for each in fitting]
    least = min(sized_costs)
    # Only a model that explains the points is given credit: of poor fits the better one is taken.
    credit = config.own_size if fitting[sized_costs.index(least)].scan <= threshold else 0.0
    if least * (1 - credit) > min(boxed_costs):
        return boxed
    slack = least * (1 + config.settle) + 1e-9
    return next(fit for fit, cost in zip(sized, sized_costs, strict=True) if cost <= slack)


def _own_sized(
    target: ScannedInstance, rough: ScannedInstance, sample: Sample, few: Sample, yaws: Array, config: AlignmentConfig
) -> list[Fit]:
    """Poses of a model in its own size, those that keep their height first. rough, few: a part of the points and of the samples."""
    starts = own_size_starts(target, sample, yaws, config)
    if target.is_square:
        return starts
    level = [refine(rough, few, fit, config) for fit in starts]
    if target.is_grounded:
        return level
    return [*level, *(refine_height(rough, few, fit, config, refine) for fit in level)]


def refine(target: ScannedInstance, sample: Sample, fit: Fit, config: AlignmentConfig) -> Fit:
    """A pose with yaw and shift by least squares over nearest points (Besl and McKay, 1992, in the plane, trimmed).

    Height and scale stay; yaw and shift stay near where they started.
    """
    reach = (config.refine_shift * target.size[:2]).tolist()
    start, (x0, y0, z) = fit.yaw, fit.offset.tolist()
    yaw, x, y, diagonal = start, x0, y0, target.diagonal
    keep, ranks = max(int(config.refine_share * len(target.points)), 3), np.arange(len(target.points))
    scaled = sample.points * fit.scale
    for _ in range(config.refine_steps):
        across, along, source, to = nearest_turn(target.points, scaled @ turned(yaw).T + np.array([x, y, z]), keep, ranks)
        wanted = _within(yaw + float(np.arctan2(across, along)), start, config.refine_yaw_radians)
        moved = (turned(wanted - yaw)[:2, :2] @ (np.array([x, y]) - source) + to).tolist()
        moved = [_within(moved[0], x0, reach[0]), _within(moved[1], y0, reach[1])]
        change = abs(wanted - yaw) * diagonal + max(abs(moved[0] - x), abs(moved[1] - y))
        yaw, (x, y) = wanted, moved
        if change < 5e-4:  # half a millimetre
            break
    return dataclasses.replace(fit, yaw=yaw, offset=np.array([x, y, z]))


def _within(value: float, middle: float, reach: float) -> float:
    """The value that is nearest and no farther than that from a middle."""
    return min(max(value, middle - reach), middle + reach)


def clamp_scale(ratio: ArrayLike, weight: ArrayLike, config: AlignmentConfig) -> Array:
    """Scales nearest to the asked ones, shape (3,), or rows of them, in weighted least squares of their logarithms, that keep the limits
    on each axis and on the largest over the smallest."""
    limits = 0.5 * math.log(config.anisotropy), math.log(config.smallest_scale), math.log(config.largest_scale)
    asked, weights = np.asarray(ratio, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    return clamped(asked.reshape(-1, 3), weights.reshape(-1, 3), *limits).reshape(asked.shape)


def _boxed(target: ScannedInstance, sample: Sample, yaws: Sequence[float], config: AlignmentConfig) -> list[Fit]:
    """The pose for each yaw whose box is the instance's box along the asset's axes, as far as the limits allow."""
    for yaw in yaws:
        if yaw not in target.spans:
            target.spans[yaw] = _span(target, yaw)
    spans = [target.spans[yaw] for yaw in yaws]
    wanted = np.maximum([[*size, target.size[2]] for size, _ in spans], 5e-3)
    scales = clamp_scale(wanted / sample.extents, wanted / (wanted + config.thin_m), config)
    return [Fit(yaw, np.array([*center, 0.0]), scale) for yaw, (_, center), scale in zip(yaws, spans, scales, strict=True)]


def _span(target: ScannedInstance, yaw: float) -> tuple[Array, Array]:
    """How long and wide an instance is along the axes of an asset of a yaw, and its middle, both shape (2,) [m]."""
    turn = turned(yaw)[:2, :2]
    quarter = yaw / (np.pi / 2)
    if abs(quarter - round(quarter)) < 1e-9 or target.is_cut_off:
        square = turned(round(quarter) * np.pi / 2)[:2, :2]
        return np.abs(square.T @ target.size[:2]), np.zeros(2)
    local = target.points[:, :2] @ turn
    low, high = local.min(axis=0), local.max(axis=0)
    return high - low, turn @ (0.5 * (low + high))


REFINED = AlignmentMethod(name="refined", config=Refined, pose=pose, lacks=lacks, reads_sight=True)
