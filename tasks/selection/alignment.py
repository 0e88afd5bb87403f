"""Where an asset stands on an instance: yaw, place and scale that bring its surface onto the scanned points.

Everything here is in the instance's frame: its oriented box turned straight, x and y zero at the box center, z zero
at the height on which the asset is to stand.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.geometry.meshes import sample_surface, surface_of_glb
from tasks.geometry.triangles import surface_area
from tasks.selection.distances import clamped, coarse_distances, disc_distances, nearest_indices, nearest_turn, spacing
from tasks.settings import Config, Whole

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class AlignmentConfig(Config):
    """How the pose of an asset on an instance is searched."""

    yaw_count: Whole = 24  # every 15 degrees: half a step is within reach of the refinement; a multiple of 4 holds the box's own yaws
    hopeless: float = 1.5  # a yaw that costs this many times the best one's stays behind after refinement too
    starts: Whole = 3  # a chair fits nearly as well turned by 90 or 180 degrees: the best three are refined, then compared
    refine_steps: Whole = 12  # nearest-point refinement of one yaw and two shifts settles within ten
    refine_share: float = 0.8  # the farthest fifth of the points is noise or bleeding from neighbors
    refine_yaw_radians: float = 0.2  # a little more than half a yaw step
    rebox_yaw_radians: float = 0.03  # turned by more, the box was askew and its sides were not the object's: a 2 m desk gains 6 cm
    refine_shift: float = 0.1  # of the box's side: the box is known to a tenth even where the scan is thin
    smallest_scale: float = 0.5  # beyond half or twice its size an asset depicts another object (a coffee table is no desk)
    largest_scale: float = 2.0  # twice its size, as smallest_scale
    anisotropy: float = 1.6  # the largest over the smallest scale: beyond it round objects turn visibly oval
    thin_m: float = 0.03  # scan noise across a thin side: such a side says little about scale
    points: Whole = 512  # scanned points: 3 cm apart on a chair, 8 cm on a bed
    samples: Whole = 1024  # of the asset's whole surface, of which the scan saw half or less
    coarse: Whole = 224  # of both, for the yaw search: the cost separates yaws long before it is exact
    refine_points: Whole = 256  # for refining and comparing poses of one asset: errors of single nearest points average out
    refine_samples: Whole = 512  # of the surface, twice refine_points: the scan saw half of it or less
    settle: float = 0.01  # a refined pose must be better by this share than the pose squared up with the box
    hidden_weight: float = 0.1  # undersides are never seen; a little weight keeps a solid block from posing as a table
    hidden_normal: float = -0.5  # z of a normal that counts as an underside: steeper than 30 degrees below the horizon
    seen_share: float = 0.75  # one side against a wall is up to a quarter of the surface: the worst quarter does not count
    truncation: float = 0.2  # of the diagonal: farther is wrong, however far


HIDDEN_M = 0.05
"""Farther than this beyond what a scan could see, nobody expects points [m]."""


@dataclasses.dataclass(frozen=True)
class ScannedInstance:
    """A scanned instance in its own frame. `points`: shape (k, 3) [m]; `colors`: shape (n, 3); `size`: box extents [m];
    `spacing`: distance between neighboring points [m]; `resolution`: the same of all points that the scan has of it; `seen`: lowest
    and highest corner of the part of the box that the scan could see, shape (2, 3) [m]; `is_square`: whether the box says how it is
    turned and where it is, as a wall does of what is let into it. Known once they were asked for: `spans`, its
    size and middle along the axes of an asset, by the asset's yaw; `parts`, the instance with fewer points, by how many."""

    points: Array
    colors: NDArray[np.uint8]
    size: Array
    spacing: float
    resolution: float
    seen: Array = dataclasses.field(default_factory=lambda: np.array([[-np.inf] * 3, [np.inf] * 3]))
    is_square: bool = False
    spans: dict[float, tuple[Array, Array]] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)
    parts: dict[int, ScannedInstance] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def is_cut_off(self) -> bool:
        """Whether a part beside what was seen is hidden, so that only the box tells how wide it is."""
        low, high = self.seen[:, :2]
        return bool((low > HIDDEN_M - 0.5 * self.size[:2]).any() or (high < 0.5 * self.size[:2] - HIDDEN_M).any())

    def thinned(self, count: int) -> ScannedInstance:
        """The instance with its first points alone."""
        if count not in self.parts:
            points = self.points[:count]
            self.parts[count] = dataclasses.replace(self, points=points, spacing=spacing(points))
        return self.parts[count]

    def weights(self, placed: Array, normals: Array, config: AlignmentConfig) -> Array:
        """What samples of a surface, with unit normals, shapes (..., m, 3), count where no point is near: little where none could be."""
        low, high = self.seen
        hidden = normals[..., 2] < config.hidden_normal
        if np.isfinite(self.seen).any():
            hidden |= (placed < low - HIDDEN_M).any(axis=-1) | (placed > high + HIDDEN_M).any(axis=-1)
        return np.where(hidden, config.hidden_weight, 1.0)

    @property
    def diagonal(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.size))


@dataclasses.dataclass(frozen=True)
class Sample:
    """Evenly spread samples of a canonical asset's surface, in random order. `points`, `normals`, `colors`: shape
    (m, 3); `extents`: of the asset's box [m]; `area`: of its surface [m2]."""

    points: Array
    normals: Array
    colors: NDArray[np.uint8]
    extents: Array
    area: float

    def placed(self, fit: Fit) -> tuple[Array, Array, float]:
        """Points, unit normals and disc radius of the samples in the instance's frame [m]."""
        points, normals, radii = self.placed_all([fit])
        return points[0], normals[0], float(radii[0])

    def placed_all(self, fits: Sequence[Fit]) -> tuple[Array, Array, Array]:
        """The same for several fits at a time, shapes (p, m, 3), (p, m, 3) and (p,)."""
        turns = np.stack([_turn(fit.yaw).T for fit in fits])
        scales = np.stack([fit.scale for fit in fits])
        points = (self.points * scales[:, None]) @ turns + np.stack([fit.offset for fit in fits])[:, None]
        normals = (self.normals / scales[:, None]) @ turns
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        stretch = [float(np.prod(scale)) ** (2 / 3) for scale in scales]  # area grows with the square of the mean scale
        return points, normals, np.sqrt(self.area * np.array(stretch) / (np.pi * len(self.points)))


@dataclasses.dataclass(frozen=True)
class Fit:
    """A pose of an asset in the instance's frame: turn about +Z [rad], shift [m], shape (3,), scale, shape (3,)."""

    yaw: float
    offset: Array
    scale: Array


@dataclasses.dataclass(frozen=True)
class Distances:
    """How a placed asset fits [m]. `scan`: mean distance of the points to the surface. `asset`: mean distance of the
    surface that could have been seen to the points. `chamfer`: mean of both plain means. `coverage`: share of the
    points within the threshold."""

    scan: float
    asset: float
    chamfer: float
    coverage: float

    @property
    def cost(self) -> float:
        """What alignment minimizes. Surface without points counts half: the scan is partial, the asset is not."""
        return self.scan + 0.5 * self.asset


def sample_asset(asset: Asset, glb: bytes, config: AlignmentConfig, rng: np.random.Generator) -> Sample:
    """Samples of a canonical asset.

    Raises:
        InputError: the GLB cannot be read.
        ValueError: its surface has no area.
    """
    surface = surface_of_glb(glb, asset.mesh_blob)
    area = surface_area(surface.vertices, surface.faces)
    points, colors, normals = sample_surface(surface, config.samples, rng)
    order = rng.permutation(config.samples)
    extents = np.maximum(surface.bounds[1] - surface.bounds[0], 1e-4)
    return Sample(points[order], normals[order], colors[order], extents, area)


def make_target(
    points: Array, colors: NDArray[np.uint8], size: Array, config: AlignmentConfig, rng: np.random.Generator,
    hidden: Sequence[float] | None = None, is_let_in: bool = False,
) -> ScannedInstance:  # fmt: skip
    """An instance from its points in its own frame, shape (n, 3) [m]: thinned evenly, in random order.

    hidden: how much of the box the scan could not see on its sides -x, +x, -y, +y, -z, +z [m]. is_let_in: into a wall; where a part of
    it is hidden, its box was turned as the wall runs, and a strip of it fits other turns as well.
    """
    order = rng.permutation(len(points))
    cell = max(float(np.linalg.norm(size)) / 40, 1e-3)
    cells = np.floor(points[order] / cell).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    thinned = points[order[np.sort(first)]][: config.points]
    size, lost = np.maximum(size, 5e-3), np.zeros(6) if hidden is None else np.asarray(hidden, dtype=np.float64)
    low, high = np.array([-0.5 * size[0], -0.5 * size[1], 0.0]), np.array([0.5 * size[0], 0.5 * size[1], size[2]])
    seen = np.array([np.where(lost[0::2] > 0, low + lost[0::2], -np.inf), np.where(lost[1::2] > 0, high - lost[1::2], np.inf)])
    return ScannedInstance(thinned, colors, size, spacing(thinned), spacing(points), seen, is_let_in and bool(lost[:4].any()))


def measure(target: ScannedInstance, sample: Sample, fit: Fit, threshold: float, config: AlignmentConfig) -> Distances:
    """How a placed asset fits. `threshold`: distance within which a point counts as covered [m]."""
    placed, normals, radius = sample.placed(fit)
    scan = disc_distances(target.points, placed, normals, radius)
    _, back = nearest_indices(placed, target.points)
    back = np.maximum(back - target.spacing, 0.0)
    limit = config.truncation * target.diagonal
    weights = target.weights(placed, normals, config)
    return Distances(
        scan=float(np.minimum(scan, limit).mean()),
        asset=float(_seen_means(np.minimum(back, limit)[None], weights[None], config.seen_share)[0]),
        chamfer=0.5 * float(scan.mean() + back.mean()),
        coverage=float((scan <= threshold).mean()),
    )


def align(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig) -> tuple[Fit, Distances]:
    """The best pose of an asset on an instance, and how it fits.

    Every yaw of a full turn is tried with the scale that its box asks for; the best few are refined by nearest points.
    Of poses that fit alike, the one squared up with the box is taken, then the one with the smaller turn. What is square stays so.
    """
    yaws = 2 * np.pi * np.arange(config.yaw_count) / config.yaw_count
    if target.is_square:
        yaws = yaws[:: max(config.yaw_count // 4, 1)]
    fits = [_boxed(target, sample, float(yaw), config) for yaw in yaws]
    costs = _coarse_costs(target, sample, fits, config)
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
            tried.append(refine(rough, few, _boxed(target, sample, tried[-1].yaw, config), config))
    measured = [measure(rough, few, fit, threshold, config).cost for fit in tried]
    slack = min(measured) * (1 + config.settle) + 1e-9
    fit = next(fit for fit, cost in zip(tried, measured, strict=True) if cost <= slack)
    return fit, measure(target, sample, fit, threshold, config)


def refine(target: ScannedInstance, sample: Sample, fit: Fit, config: AlignmentConfig) -> Fit:
    """A pose with yaw and shift by least squares over nearest points (Besl and McKay, 1992, in the plane, trimmed).

    Height and scale stay; yaw and shift stay near where they started.
    """
    start, reach = fit, config.refine_shift * target.size[:2]
    points = target.points
    keep = max(int(config.refine_share * len(points)), 3)
    scaled = sample.points * fit.scale
    for _ in range(config.refine_steps):
        across, along, source, to = nearest_turn(points, scaled @ _turn(fit.yaw).T + fit.offset, keep)
        turn = float(np.arctan2(across, along))
        yaw = float(np.clip(fit.yaw + turn, start.yaw - config.refine_yaw_radians, start.yaw + config.refine_yaw_radians))
        around = _turn(yaw - fit.yaw)[:2, :2]
        moved = around @ (fit.offset[:2] - source) + to
        moved = np.clip(moved, start.offset[:2] - reach, start.offset[:2] + reach)
        change = abs(yaw - fit.yaw) * target.diagonal + float(np.abs(moved - fit.offset[:2]).max())
        fit = dataclasses.replace(fit, yaw=yaw, offset=np.array([*moved, fit.offset[2]]))
        if change < 5e-4:  # half a millimetre
            break
    return fit


def clamp_scale(ratio: Sequence[float] | Array, weight: Sequence[float] | Array, config: AlignmentConfig) -> Array:
    """Scales nearest to the asked ones, shape (3,), in weighted least squares of their logarithms, that keep the limits
    on each axis and on the largest over the smallest."""
    limits = 0.5 * math.log(config.anisotropy), math.log(config.smallest_scale), math.log(config.largest_scale)
    return clamped(np.asarray(ratio, dtype=np.float64), np.asarray(weight, dtype=np.float64), *limits)


def _boxed(target: ScannedInstance, sample: Sample, yaw: float, config: AlignmentConfig) -> Fit:
    """The pose for a yaw whose box is the instance's box along the asset's axes, as far as the limits allow."""
    if yaw not in target.spans:
        target.spans[yaw] = _span(target, yaw)
    size, center = target.spans[yaw]
    wanted = np.maximum(np.array([*size, target.size[2]]), 5e-3)
    scale = clamp_scale(wanted / sample.extents, wanted / (wanted + config.thin_m), config)
    return Fit(yaw, np.array([*center, 0.0]), scale)


def _span(target: ScannedInstance, yaw: float) -> tuple[Array, Array]:
    """How long and wide an instance is along the axes of an asset of a yaw, and its middle, both shape (2,) [m]."""
    turn = _turn(yaw)[:2, :2]
    quarter = yaw / (np.pi / 2)
    if abs(quarter - round(quarter)) < 1e-9 or target.is_cut_off:
        square = _turn(round(quarter) * np.pi / 2)[:2, :2]
        return np.abs(square.T @ target.size[:2]), np.zeros(2)
    local = target.points[:, :2] @ turn
    low, high = local.min(axis=0), local.max(axis=0)
    return high - low, turn @ (0.5 * (low + high))


def _coarse_costs(target: ScannedInstance, sample: Sample, fits: Sequence[Fit], config: AlignmentConfig) -> Array:
    """Cost of every pose by a part of the points and samples [m], shape (p,)."""
    part = dataclasses.replace(sample, points=sample.points[: config.coarse], normals=sample.normals[: config.coarse])
    placed, normals, radii = part.placed_all(fits)
    out, back = coarse_distances(target.points[: config.coarse], placed)
    limit = config.truncation * target.diagonal
    weights = target.weights(placed, normals, config)
    near = np.minimum(np.maximum(out - 0.5 * radii[:, None], 0.0), limit).mean(axis=1)
    return near + 0.5 * _seen_means(np.minimum(back, limit), weights, config.seen_share)


def _seen_means(distances: Array, weights: Array, share: float) -> Array:
    """Weighted means of the smallest distances that hold `share` of the weight, of each row: shapes (p, m) to (p,)."""
    order = np.argsort(distances, axis=1, kind="stable")
    nearest, first = np.take_along_axis(distances, order, axis=1), np.take_along_axis(weights, order, axis=1)
    reached = np.cumsum(first, axis=1)
    counts = (reached < share * reached[:, -1:]).sum(axis=1) + 1
    sums = [(float((d[:n] * w[:n]).sum()), float(w[:n].sum())) for d, w, n in zip(nearest, first, counts.tolist(), strict=True)]
    return np.array([distance / weight for distance, weight in sums])


def _turn(yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
