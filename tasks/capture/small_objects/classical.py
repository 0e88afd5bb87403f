"""Small objects without a network: what stands out of a board in a posed depth frame, parted where surfaces, colors or hollows part it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.views import border_contact
from tasks.capture.small_objects.consensus import ConsensusConfig, ConsensusInstance, associate, instance_of
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, LiftedFrame, LiftingConfig, depth_noise, lifted
from tasks.capture.small_objects.patches import BoardPixels, PatchConfig, hull_overlap, objects_of, other_color, tints_of
from tasks.capture.small_objects.supports import BELOW_M, SupportSlab
from tasks.capture.small_objects.surfaces import median_heights
from tasks.settings import Config, Count, NonNegative, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

PROVIDER = "classical"
"""Who finds small objects here, as rows name it."""

_ROUNDS = 5
"""Of fitting a plane to what the last one left: objects on the board are out after three."""

_BIN_M = 0.002
"""Width of the bins in which a board's height is looked for [m]."""

_CEILING_SHARE = 0.1
"""Of an object's pixels at the very top of the slab: it goes on above, and is a wall."""

_CEILING_M = 0.03
"""How thick the very top of the slab is [m]."""

_CUT_M = 0.05
"""What comes so near to the top of a slab is cut off by it, as far as several frames agree on [m]; a sheet is cut where they agree less:
it is a wall behind, of which each shows another part."""

_SHEET_M = 0.06
"""Thickness of a sheet with the noise of its depth [m]."""

_WINDOW_PX = 8
"""Pixels around a board that are looked at with it: neighborhoods reach over fewer."""

_TALL_M = 0.45
"""Slabs that are lower end at the next board, up to which things may reach [m]."""


@dataclasses.dataclass(frozen=True)
class Found:
    """What stands on a support: frames with their masks, and instances that name them."""

    frames: tuple[LiftedFrame, ...]
    instances: tuple[ConsensusInstance, ...]


@dataclasses.dataclass(frozen=True)
class ExactLifting(LiftingConfig):
    """Which pixels of a mask are lifted whose outline is exact."""

    erosion_px: NonNegative = 0.0  # such masks end where depth does


@dataclasses.dataclass(frozen=True)
class DividedConsensus(ConsensusConfig):
    """When masks are one instance that a frame may divide."""

    side_by_side: Share = 0.35  # of the frames of two clusters: a hollow or a gap in the depth divides one object in some


@dataclasses.dataclass(frozen=True)
class ClassicalConfig(Config):
    """What stands out, what parts it, and what views have to agree on."""

    kind: ClassVar[str] = PROVIDER
    widest_px: Count = 320  # wider frames are looked at in every second pixel, or fewer: noise of each is specks of wood on real tables
    least_height_m: Positive = 0.005  # a telephone is 8 mm thick; less than this is a board's own unevenness
    height_sigmas: Positive = 2.5  # nor is it a height that noise alone makes one pixel of a hundred
    thin_limits: Positive = 3.0  # so many times the least height is no noise, and a stem of one pixel
    least_board_pixels: Count = 60  # fewer do not say where a board is
    island_share: Share = 0.1  # of the largest part of a board that is seen: smaller ones are bottoms of vessels
    tilt: Positive = 0.03  # of a board in a frame, in radians: three times a tracker's drift
    inside_share: Share = 0.4  # of an object over the board itself: what hangs over the edge by more stands elsewhere
    fills: Share = 0.8  # of both sides of a board: what is as large is the board's own back, or a cloth on it
    edge_m: Positive = 0.015  # of a board along its edges and panels: what lies there alone is board and panel
    least_eye_m: Positive = 0.03  # lower cameras see a board's edge, not what it carries
    unsure_height_m: Positive = 0.015  # over a board that a frame hardly shows: poses drift by a centimeter
    float_m: Positive = 0.04  # over the board: nothing floats, so it is a part of what is below
    part_gap_m: Positive = 0.012  # in plan, between the parts of one object: what poses drift
    part_share: Share = 0.5  # of a part's plan within that of the whole: two that merely touch overlap by a centimeter's drift
    alike_share: Share = 0.15  # likewise, of a part that has the paint of the whole: two that are painted alike may stand side by side
    hold_m: Positive = 0.02  # from what floats to what holds it, where that is not right below: a shade beside a ball is not the ball's
    part_paint: Share = 0.25  # of the difference of two paints: what touches and is as like as this is one object
    least_score: Share = 0.1  # of a mask that the image's border cuts
    patches: PatchConfig = dataclasses.field(default_factory=PatchConfig)  # see there
    lifting: ExactLifting = dataclasses.field(default_factory=ExactLifting)  # see there
    consensus: DividedConsensus = dataclasses.field(default_factory=DividedConsensus)  # see there


def found_objects(views: Sequence[DepthView], slabs: Sequence[SupportSlab], config: ClassicalConfig) -> Found:
    """What stands on the boards of a support, found in posed depth frames."""
    return found_in_masks(views, [found_masks(view, slabs, config) for view in views], slabs, config)


def found_in_masks(
    views: Sequence[DepthView], seen: Sequence[FrameMasks], slabs: Sequence[SupportSlab], config: ClassicalConfig
) -> Found:  # fmt: skip
    """What masks that end where objects do have on the boards of a support: instances that views agree on, but for boards and walls."""
    frames = lifted(views, seen, config.lifting)
    instances = list(associate(frames, config.consensus).instances)
    for slab in slabs:
        instances = [each for each in _settled(frames, instances, slab, config) if not _is_board_or_wall(each, slab, config)]
    return Found(tuple(frames), tuple(instances))


def found_masks(view: DepthView, slabs: Sequence[SupportSlab], config: ClassicalConfig) -> FrameMasks:
    """Masks of what stands on boards in one frame, without names; of a wide one, where it has depth, as every few pixels show them."""
    every = max(1, round(view.depth.shape[1] / config.widest_px))
    seen = _found_masks(view.thinned(every), slabs, config)
    if every == 1:
        return seen
    height, width = view.depth.shape
    large = np.repeat(np.repeat(seen.masks, every, axis=1), every, axis=2)[:, :height, :width] & (view.depth > 0)
    return dataclasses.replace(seen, masks=large)


def _found_masks(view: DepthView, slabs: Sequence[SupportSlab], config: ClassicalConfig) -> FrameMasks:
    depth = filled_depth(view.depth, config.patches.gap_m)
    whole = dataclasses.replace(view, depth=depth)
    world = whole.points()
    valid = (depth > config.lifting.nearest_m) & (depth <= config.lifting.farthest_m)
    masks = [mask for slab in slabs for mask in _on_board(whole, world, valid, slab, config)]
    scores = np.array([max(config.least_score, 1 - border_contact(mask)) for mask in masks])
    return FrameMasks(np.array(masks, dtype=bool).reshape(len(masks), *view.depth.shape), ("",) * len(masks), scores)


def filled_depth(depth: NDArray[np.float32], gap: float = PatchConfig.gap_m) -> NDArray[np.float32]:
    """Depth with single missing pixels filled where two neighbors on opposite sides are of one surface [m]: thin things have many such."""
    padded = np.pad(depth, 1)
    height, width = depth.shape
    filled = depth.copy()
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        before = padded[1 - dy : 1 - dy + height, 1 - dx : 1 - dx + width]
        after = padded[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        single = (filled == 0) & (before > 0) & (after > 0) & (np.abs(before - after) <= gap)
        filled[single] = 0.5 * (before[single] + after[single])
    return filled


def _on_board(view: DepthView, world: Array, valid: Bools, slab: SupportSlab, config: ClassicalConfig) -> list[Bools]:
    """Masks of what stands on one board."""
    eye = slab.local(view.pose[:3, 3])
    inside = valid & slab.holds(world)
    if inside.sum() < config.patches.object_pixels or eye[2] < config.least_eye_m:
        return []
    rows, columns = _window(inside)
    masks = []
    for part in _in_window(_shifted(view, rows, columns), world[rows, columns], inside[rows, columns], eye, slab, config):
        mask = np.zeros(inside.shape, dtype=bool)
        mask[rows, columns] = part
        masks.append(mask)
    return masks


def _window(inside: Bools) -> tuple[slice, slice]:
    """Rows and columns that have all of some pixels, with what their neighborhoods reach to."""
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, int(rows[0]) - _WINDOW_PX), int(rows[-1]) + 1 + _WINDOW_PX),
        slice(max(0, int(columns[0]) - _WINDOW_PX), int(columns[-1]) + 1 + _WINDOW_PX),
    )


def _shifted(view: DepthView, rows: slice, columns: slice) -> DepthView:
    """A part of a frame, as a frame."""
    fx, fy, cx, cy = view.intrinsics
    intrinsics = (fx, fy, cx - columns.start, cy - rows.start)
    return dataclasses.replace(view, depth=view.depth[rows, columns], color=view.color[rows, columns], intrinsics=intrinsics)


def _in_window(view: DepthView, world: Array, inside: Bools, eye: Array, slab: SupportSlab, config: ClassicalConfig) -> list[Bools]:
    """Masks of what stands on a board in the part of a frame that shows it. inside: Pixels in the slab. eye: The camera, in its frame."""
    local = slab.local(world)
    ray = (world - view.pose[:3, 3]) / np.maximum(view.depth, 1e-9)[..., None]
    noise = depth_noise(view.depth) * np.abs(ray @ slab.pose[:3, 2])
    over = inside & (slab.inset(local) >= 0)
    near = over & (np.abs(local[..., 2]) <= BELOW_M)
    plane = board_plane(local[near], noise[near], config)
    least = config.least_height_m if plane is not None else config.unsure_height_m
    plane = np.zeros(3) if plane is None else plane
    height = local[..., 2] - local[..., :2] @ plane[:2] - plane[2]
    limit = np.maximum(least, config.height_sigmas * noise)
    smooth = median_heights(height, inside)
    stands = inside & ((smooth > limit) | (height > config.thin_limits * limit))
    toward = eye - local
    toward /= np.maximum(np.linalg.norm(toward, axis=-1), 1e-9)[..., None]
    pixel = view.depth.astype(np.float64) / view.intrinsics[0]
    is_board = _open_parts(inside & ~stands & (np.maximum(np.abs(smooth), np.abs(height)) <= np.maximum(2 * limit, 0.01)), config)
    points = np.concatenate([local[..., :2], height[..., None]], axis=-1)
    owner = objects_of(BoardPixels(points, toward, stands, is_board, view.color, pixel), config.patches)
    masks = [owner == number for number in range(int(owner.max(initial=-1)) + 1)]
    return [mask for mask in masks if _is_object(local[mask], slab, config)]


def _open_parts(board: Bools, config: ClassicalConfig) -> Bools:
    """Pixels of a board without small islands: the bottom of a mug is as low as a board."""
    from scipy.ndimage import label

    part, count = label(board)
    sizes = np.bincount(part.ravel(), minlength=count + 1)
    sizes[0] = 0
    return np.asarray((sizes >= max(config.least_board_pixels, config.island_share * sizes.max()))[part])


def _is_object(local: Array, slab: SupportSlab, config: ClassicalConfig) -> bool:
    """Whether points in a slab's frame, shape (n, 3), are no wall that goes on above it, and neither panel nor edge of the board."""
    goes_on = float((local[:, 2] > slab.high[2] - _CEILING_M).mean()) > _CEILING_SHARE and slab.high[2] > _TALL_M
    return not goes_on and float((slab.inset(local) >= config.edge_m).mean()) >= config.inside_share


def _is_board_or_wall(instance: ConsensusInstance, slab: SupportSlab, config: ClassicalConfig) -> bool:
    """Whether an instance on a board is as large as the board itself, or goes on above what is looked at."""
    local = slab.local(instance.points)
    if slab.holds(instance.points).mean() <= 0.5:
        return False
    low, high = np.quantile(local, (0.02, 0.98), axis=0)
    is_sheet = oriented_box(instance.points)[1][:2].min() <= _SHEET_M
    goes_on = high[2] > slab.high[2] - (2 if is_sheet else 1) * _CUT_M and slab.high[2] > _TALL_M
    return bool(goes_on or ((high - low)[:2] >= config.fills * 2 * slab.footprint).all())


def _settled(
    frames: list[LiftedFrame], instances: list[ConsensusInstance], slab: SupportSlab, config: ClassicalConfig
) -> list[ConsensusInstance]:
    """Instances after those on a board that float over it, or lie within another one's plan, have become a part of the nearest one that may
    hold them."""
    from scipy.spatial import cKDTree

    local = [slab.local(instance.points) for instance in instances]
    tint = [np.median(tints_of(instance.colors), axis=0) for instance in instances]
    mine = [i for i in range(len(instances)) if slab.holds(instances[i].points).mean() > 0.5]
    owner = {i: i for i in mine}
    for i in sorted(mine, key=lambda i: (len(local[i]), i)):
        floats = float(np.percentile(local[i][:, 2], 2)) > config.float_m
        best: tuple[float, int] | None = None
        for j in mine:
            if owner[j] == owner[i] or (not floats and (len(local[j]), j) < (len(local[i]), i)):
                continue
            gap = float(cKDTree(local[j][:, :2]).query(local[i][:, :2])[0].min())
            if gap > config.part_gap_m:
                continue
            overlap = hull_overlap(local[i][:, :2], local[j][:, :2])
            alike = overlap >= config.alike_share and not other_color(tint[i], tint[j], config.patches, config.part_paint)
            held = floats and float(cKDTree(local[j]).query(local[i])[0].min()) <= config.hold_m
            if held or alike or overlap >= config.part_share:
                best = min(best or (gap, j), (gap, j))
        if best is not None:
            source, target = owner[i], owner[best[1]]
            owner = {k: target if o == source else o for k, o in owner.items()}
    parts: dict[int, list[int]] = {}
    for i in range(len(instances)):
        parts.setdefault(owner.get(i, i), []).append(i)
    return [_one(frames, [instances[i] for i in group]) for group in parts.values()]


def _one(frames: list[LiftedFrame], parts: list[ConsensusInstance]) -> ConsensusInstance:
    """Instances as one."""
    if len(parts) == 1:
        return parts[0]
    masks: dict[int, tuple[int, ...]] = {}
    for part in parts:
        for frame, numbers in part.masks.items():
            masks[frame] = tuple(sorted({*masks.get(frame, ()), *numbers}))
    points, colors = np.concatenate([part.points for part in parts]), np.concatenate([part.colors for part in parts])
    return instance_of(frames, points, colors, dict(sorted(masks.items())))


def board_plane(local: Array, noise: Array, config: ClassicalConfig) -> Array | None:
    """The board's surface in a frame as z = a x + b y + c: (a, b, c), shape (3,); None where too little of it is seen.

    local: Points near the board in its frame [m], shape (n, 3). noise: Of their heights [m], shape (n,).
    """
    level = np.zeros(3)
    if len(local) < config.least_board_pixels:
        return None
    counts = np.bincount(np.floor((local[:, 2] + BELOW_M) / _BIN_M).astype(np.int64), minlength=2)
    level[2] = (float(np.convolve(counts, np.ones(3), "same").argmax()) + 0.5) * _BIN_M - BELOW_M
    plane, design = level.copy(), np.column_stack([local[:, :2], np.ones(len(local))])
    for _ in range(_ROUNDS):
        near = np.abs(local[:, 2] - design @ plane) <= np.maximum(2 * noise, config.least_height_m)
        if near.sum() < config.least_board_pixels:
            return level
        weight = 1 / np.maximum(noise[near], 1e-4)
        plane = np.linalg.lstsq(design[near] * weight[:, None], local[near, 2] * weight, rcond=None)[0]
    return plane if np.abs(plane[:2]).max() <= config.tilt else level
