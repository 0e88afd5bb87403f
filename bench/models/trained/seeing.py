"""Masks of small objects by the network: the same question, boards and answer as the classical member's."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.models.trained.channels import BoardHeights, board_heights, channels
from bench.models.trained.grouping import objects_of_pairs
from bench.models.trained.things import WORDS
from tasks.capture.instances.views import border_contact
from tasks.capture.small_objects.classical import ClassicalConfig, board_plane, filled_depth
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, depth_noise
from tasks.capture.small_objects.supports import BELOW_M, SupportSlab

if TYPE_CHECKING:
    from bench.models.trained.networks.parting import PartingNet

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

WINDOW_PX = 24
"""Pixels around what may be objects that are looked at with it."""

WIDTH = 320
"""Images are looked at in about this width [px]: that of the frames which were learned from."""

_CLASSICAL = ClassicalConfig()


@dataclasses.dataclass(frozen=True)
class WindowAnswer:
    """Of a frame: objectness 0 to 1, shape (h, w), logits of pairs (p, h, w), and probabilities of categories (n, h, w)."""

    objectness: NDArray[np.float32]
    pairs: NDArray[np.float32]
    categories: NDArray[np.float32]


def seen_masks(network: PartingNet, view: DepthView, slabs: Sequence[SupportSlab]) -> FrameMasks:
    """Masks of what stands on boards in one frame, at the resolution of its depth, each with its likeliest category and how sure it is.

    Larger frames are looked at in every second pixel, or fewer.
    """
    every = max(1, round(view.depth.shape[1] / WIDTH))
    small = thinned(view, every)
    depth = filled_depth(small.depth)
    whole = dataclasses.replace(small, depth=depth)
    heights = board_heights(whole, slabs, [_plane(whole, slab) for slab in slabs])
    rows, columns = (np.flatnonzero(heights.above.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return FrameMasks(np.zeros((0, *view.depth.shape), dtype=bool), (), np.zeros(0))
    window = (
        slice(max(0, int(rows[0]) - WINDOW_PX), int(rows[-1]) + 1 + WINDOW_PX),
        slice(max(0, int(columns[0]) - WINDOW_PX), int(columns[-1]) + 1 + WINDOW_PX),
    )
    answer = answered(network, whole, heights, window)
    is_object = (answer.objectness > 0.5) & heights.above[window] & (depth[window] > 0)
    owner = np.full(depth.shape, -1, dtype=np.int64)
    owner[window] = objects_of_pairs(answer.pairs, is_object)
    words, numbers = [], range(int(owner.max(initial=-1)) + 1)
    for number in numbers:
        words.append(WORDS[int(answer.categories[:, owner[window] == number].mean(axis=1).argmax())])
    large = np.repeat(np.repeat(owner, every, axis=0), every, axis=1)[: view.depth.shape[0], : view.depth.shape[1]]
    masks = np.array([(large == number) & (view.depth > 0) for number in numbers], dtype=bool).reshape(-1, *view.depth.shape)
    scores = np.array([max(_CLASSICAL.least_score, 1 - border_contact(mask)) for mask in masks])
    return FrameMasks(masks, tuple(words), scores)


def answered(network: PartingNet, view: DepthView, heights: BoardHeights, window: tuple[slice, slice]) -> WindowAnswer:
    """What the network says of a window of a frame."""
    import torch

    from bench.models.trained.networks.parting import CATEGORY_STRIDE, STRIDE

    rows, columns = window
    fx, fy, cx, cy = view.intrinsics
    boards = BoardHeights(np.ascontiguousarray(heights.height[window]), np.ascontiguousarray(heights.above[window]))
    seen = channels(
        np.ascontiguousarray(view.depth[window]), view.color[window], (fx, fy, cx - columns.start, cy - rows.start), view.pose, boards
    )
    _, height, width = seen.shape
    padded = np.pad(seen, ((0, 0), (0, -height % STRIDE), (0, -width % STRIDE)))
    with torch.inference_mode():
        kinds, pairs, categories = network(torch.from_numpy(padded)[None])
    objectness = kinds[0].softmax(dim=0)[2].numpy()[:height, :width]
    likely = categories[0].softmax(dim=0).numpy()
    likely = np.repeat(np.repeat(likely, CATEGORY_STRIDE, axis=1), CATEGORY_STRIDE, axis=2)[:, :height, :width]
    return WindowAnswer(objectness, pairs[0].numpy()[:, :height, :width], likely)


def thinned(view: DepthView, every: int) -> DepthView:
    """A frame with every so manieth pixel along each axis; pixel centers stay integers."""
    fx, fy, cx, cy = (value / every for value in view.intrinsics)
    depth, color = view.depth[::every, ::every], view.color[::every, ::every]
    return dataclasses.replace(view, depth=np.ascontiguousarray(depth), color=np.ascontiguousarray(color), intrinsics=(fx, fy, cx, cy))


def _plane(view: DepthView, slab: SupportSlab) -> Array | None:
    """The board as the frame shows it, found as the classical member does."""
    world, measured = view.points(), view.depth > 0
    local = slab.local(world)
    near = measured & slab.holds(world) & (slab.inset(local) >= 0) & (np.abs(local[..., 2]) <= BELOW_M)
    ray = (world - view.pose[:3, 3]) / np.maximum(view.depth, 1e-9)[..., None]
    noise = depth_noise(view.depth) * np.abs(ray @ slab.pose[:3, 2])
    return board_plane(local[near], noise[near], _CLASSICAL)
