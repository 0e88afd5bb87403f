"""Networks that know the truth of a generated desk or shelf, and blur it: what is left to measure is the chain behind them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.models.tabletops import Tabletop
from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.detectors import Detections
from tasks.capture.small_objects.detectors.detector import box_overlap
from tasks.capture.small_objects.items import ListedItems
from tasks.capture.small_objects.items.pictures import box_of
from tasks.capture.small_objects.learned import LearnedConfig, LearnedFound, SeeingNetworks, objects_on
from tasks.capture.small_objects.lifting import DepthView
from tasks.capture.small_objects.segmenters import Segments
from tasks.capture.small_objects.support_views import CarryingInstance
from tasks.capture.small_objects.supports import support_slabs
from tasks.stage import Context
from tasks.vision.devices import NetworkPlacement
from tasks.vision.pixels import Image

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

BOX_NOISE = 0.06
"""Deviation of a box's corners, in sides of the box, beside one pixel."""

MISSED, INVENTED, MISNAMED = 0.1, 0.1, 0.1
"""Shares of what a frame shows that a detector does not find, of boxes that it finds where nothing is, and of names that are another's."""

OUTLINE_PX = 1
"""How far a mask reaches over its object, or falls short of it [px]; networks do so by one or two at 320 px of width."""

LEAST_PIXELS = 30
"""Of an object in a frame: detectors do not see less."""


class TrueBoxes:
    """A detector that finds most of what a frame shows, in boxes that are somewhat off."""

    name = "true_boxes"
    is_open = True
    draws_masks = False
    placement: NetworkPlacement | None = None

    def __init__(self, scene: Tabletop, rng: np.random.Generator) -> None:
        self.scene, self.rng = scene, rng
        self.frames = {view.color.tobytes(): index for index, view in enumerate(scene.views)}

    def detect(self, pictures: Sequence[Image], names: Sequence[str]) -> list[Detections]:
        """What is in pictures of the scene's frames, shapes (h, w, 3), of those names."""
        return [self._found(self.frames[np.ascontiguousarray(picture).tobytes()], names) for picture in pictures]

    def _found(self, frame: int, names: Sequence[str]) -> Detections:
        owner, rng = self.scene.owner[frame], self.rng
        height, width = owner.shape
        boxes, labels, scores = [], [], []
        for place, word in enumerate(self.scene.words):
            mask = owner == place
            if mask.sum() < LEAST_PIXELS or rng.random() < MISSED or word not in names:
                continue
            true = np.array(box_of(mask), dtype=np.float64)
            sides = np.tile(true[2:] - true[:2], 2)
            boxes.append(true + rng.normal(size=4) * (1.0 + BOX_NOISE * sides))
            labels.append(str(rng.choice(names)) if rng.random() < MISNAMED else word)
            scores.append(float(rng.uniform(0.4, 0.9)))
        for _ in range(rng.binomial(len(self.scene.words), INVENTED)):
            corner, side = rng.uniform(0, [0.9 * width, 0.9 * height]), rng.uniform(0.04, 0.2) * width
            boxes.append(np.array([*corner, *np.minimum(corner + side, [width, height])]))
            labels.append(str(rng.choice(names)))
            scores.append(float(rng.uniform(0.25, 0.5)))
        return Detections(np.array(boxes).reshape(-1, 4), tuple(labels), np.array(scores))


class TrueMasks:
    """A segmenter that has the mask of whatever fills a box best, its outline off by a pixel; of an empty box a part of what is behind."""

    name = "true_masks"
    placement: NetworkPlacement | None = None

    def __init__(self, scene: Tabletop, rng: np.random.Generator) -> None:
        self.scene, self.rng = scene, rng
        self.frames = {view.color.tobytes(): index for index, view in enumerate(scene.views)}

    def segment(self, pictures: Sequence[Image], boxes: Sequence[Array]) -> list[Segments]:
        """Masks in pictures of the scene's frames, shapes (h, w, 3), of whatever fills boxes x0, y0, x1, y1 [px], shapes (n, 4)."""
        made = []
        for picture, own in zip(pictures, boxes, strict=True):
            owner = self.scene.owner[self.frames[np.ascontiguousarray(picture).tobytes()]]
            masks = np.array([self._mask(owner, box) for box in own], dtype=bool).reshape(len(own), *owner.shape)
            made.append(Segments(masks, np.full(len(own), 0.9)))
        return made

    def _mask(self, owner: NDArray[np.int64], box: Array) -> Bools:
        from scipy.ndimage import binary_dilation, binary_erosion

        drawn = np.zeros(owner.shape, dtype=bool)
        x0, y0, x1, y1 = np.rint(np.clip(box, 0, [owner.shape[1], owner.shape[0]] * 2)).astype(int)
        drawn[y0:y1, x0:x1] = True
        best, most = drawn, 0.3
        for place in np.unique(owner[owner > -2]):
            mask = owner == place
            overlap = box_overlap(np.array(box_of(mask), dtype=np.float64), box)
            if overlap > most:
                best, most = mask, overlap
        steps = int(self.rng.integers(-OUTLINE_PX, OUTLINE_PX + 1))
        if not steps:
            return best
        return np.asarray((binary_dilation if steps > 0 else binary_erosion)(best, iterations=abs(steps)))


def frame_of(view: DepthView) -> FrameSource:
    """A posed frame of the world as a scan would have it, color and depth of one camera."""
    height, width = view.depth.shape
    return FrameSource(
        view.frame_id, "", "", width, height, view.intrinsics, (width, height), view.intrinsics, 1000.0, view.pose, lambda: view.color,
        lambda: view.depth,
    )  # fmt: skip


def found_by_standins(scene: Tabletop, rng: np.random.Generator, config: LearnedConfig | None = None) -> LearnedFound:
    """What the chain finds on a desk or shelf when networks stand in that know the truth, and blur it."""
    slabs = support_slabs(scene.word, scene.box_pose, scene.box_size, scene.support_points)
    support = CarryingInstance("0000", scene.word, slabs, scene.support_points)
    items = ListedItems(names=tuple(dict.fromkeys(scene.words)))
    config = dataclasses.replace(config or LearnedConfig(), items=items, look="frame")
    networks = SeeingNetworks(TrueBoxes(scene, rng), TrueMasks(scene, rng))
    context = Context("bench/tabletop", "capture", 0, {})
    return objects_on(support, [frame_of(view) for view in scene.views], np.eye(4), networks, context, config)
