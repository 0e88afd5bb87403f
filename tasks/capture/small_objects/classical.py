"""Small objects without a network: what stands out of a board in a posed depth frame, parted where surfaces, colors or hollows part it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.consensus import Consensus, ConsensusConfig, associate
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, LiftingConfig, depth_noise, lifted
from tasks.capture.small_objects.patches import BoardPixels, PatchConfig, objects_of
from tasks.capture.small_objects.supports import BELOW_M, SupportSlab
from tasks.capture.instances.views import border_contact
from tasks.settings import Config, Count, Positive, Share

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


@dataclasses.dataclass(frozen=True)
class ClassicalConfig(Config):
    """What stands out, what parts it, and what views have to agree on."""

    least_height_m: Positive = 0.005  # a telephone is 8 mm thick; less than this is a board's own unevenness
    height_sigmas: Positive = 2.5  # nor is it a height that noise alone makes one pixel of a hundred
    least_board_pixels: Count = 60  # fewer do not say where a board is
    tilt: Positive = 0.03  # of a board in a frame, in radians: three times a tracker's drift
    inside_share: Share = 0.5  # of an object over the board itself: what hangs over the edge by more stands elsewhere
    least_score: Share = 0.1  # of a mask that the image's border cuts
    patches: PatchConfig = PatchConfig()  # see there
    lifting: LiftingConfig = LiftingConfig(erosion_px=0.0)  # its masks end where depth does
    consensus: ConsensusConfig = ConsensusConfig()  # see there


def found_objects(views: Sequence[DepthView], slabs: Sequence[SupportSlab], config: ClassicalConfig) -> tuple[Consensus, list[FrameMasks]]:
    """What stands on the boards of a support, found in posed depth frames; and the masks of each frame that it was found with."""
    seen = [found_masks(view, slabs, config) for view in views]
    return associate(lifted(views, seen, config.lifting), config.consensus), seen


def found_masks(view: DepthView, slabs: Sequence[SupportSlab], config: ClassicalConfig) -> FrameMasks:
    """Masks of what stands on boards in one frame, without names."""
    world = view.points()
    valid = (view.depth > config.lifting.nearest_m) & (view.depth <= config.lifting.farthest_m)
    masks = [mask for slab in slabs for mask in _on_board(view, world, valid, slab, config)]
    scores = np.array([max(config.least_score, 1 - border_contact(mask)) for mask in masks])
    return FrameMasks(np.array(masks, dtype=bool).reshape(len(masks), *view.depth.shape), ("",) * len(masks), scores)


def _on_board(view: DepthView, world: Array, valid: Bools, slab: SupportSlab, config: ClassicalConfig) -> list[Bools]:
    """Masks of what stands on one board."""
    local = slab.local(world)
    inside = valid & ((local >= slab.low) & (local <= slab.high)).all(axis=-1)
    if inside.sum() < config.patches.object_pixels:
        return []
    ray = (world - view.pose[:3, 3]) / np.maximum(view.depth, 1e-9)[..., None]
    noise = depth_noise(view.depth) * np.abs(ray @ slab.pose[:3, 2])
    over = inside & (np.abs(local[..., :2]) <= slab.footprint).all(axis=-1)
    plane = _board_plane(local[over & (np.abs(local[..., 2]) <= BELOW_M)], noise[over & (np.abs(local[..., 2]) <= BELOW_M)], config)
    height = local[..., 2] - local[..., :2] @ plane[:2] - plane[2]
    limit = np.maximum(config.least_height_m, config.height_sigmas * noise)
    smooth = _median_height(height, inside)
    stands = inside & (smooth > limit)
    points = np.concatenate([local[..., :2], height[..., None]], axis=-1)
    toward = slab.local(np.broadcast_to(view.pose[:3, 3], world.shape)) - local
    toward /= np.maximum(np.linalg.norm(toward, axis=-1), 1e-9)[..., None]
    pixel = view.depth.astype(np.float64) / view.intrinsics[0]
    is_board = inside & ~stands & (np.abs(smooth) <= np.maximum(2 * limit, 0.01))
    owner = objects_of(BoardPixels(points, toward, stands, is_board, view.color, pixel), config.patches)
    masks = []
    for number in range(int(owner.max(initial=-1)) + 1):
        mask = owner == number
        goes_on = (local[mask][:, 2] > slab.high[2] - _CEILING_M).mean() > _CEILING_SHARE
        if over[mask].mean() >= config.inside_share and not goes_on:
            masks.append(mask)
    return masks


def _board_plane(local: Array, noise: Array, config: ClassicalConfig) -> Array:
    """The board's surface in a frame as z = a x + b y + c: (a, b, c), shape (3,); level at 0 where too little of it is seen.

    local: Points near the board in its frame [m], shape (n, 3). noise: Of their heights [m], shape (n,).
    """
    level = np.zeros(3)
    if len(local) < config.least_board_pixels:
        return level
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


def _median_height(height: Array, inside: Bools) -> Array:
    """Heights over the board, the median of 3 x 3 pixels, those of the slab alone; shape (h, w)."""
    padded = np.pad(np.where(inside, height, np.nan), 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(*height.shape, 9)
    result = np.zeros(height.shape)
    result[inside] = np.nanmedian(windows[inside], axis=-1)
    return result
