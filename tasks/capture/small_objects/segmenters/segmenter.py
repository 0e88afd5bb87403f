"""What a segmenter is: it has a mask for each box that somebody drew into a picture."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tasks.vision.devices import NetworkPlacement, looking
from tasks.vision.pixels import IMAGENET_MEAN, IMAGENET_STD, Image, Pixels

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

WHERE = "capture.small_objects.provider.segmenter"
"""The settings, as errors name them."""

BOXES_AT_ONCE = 16
"""Boxes of a picture whose masks are drawn at its own size at a time: 80 MB at 1296 x 968 px."""

MEAN, DEVIATION = IMAGENET_MEAN, IMAGENET_STD
"""Of the pictures that SAM and SAM 2 were trained on, as published."""


@dataclasses.dataclass(frozen=True)
class Segments:
    """Masks of a picture, shape (n, h, w), in the order of the boxes, and how well each fits as the segmenter sees it, shape (n,)."""

    masks: Bools
    scores: Array


class Segmenter(Protocol):
    """Masks for boxes. name: As rows have it. placement: Where its network is; None for who has none."""

    name: str

    @property
    def placement(self) -> NetworkPlacement | None:
        """Where its network is."""

    def segment(self, pictures: Sequence[Image], boxes: Sequence[Array]) -> list[Segments]:
        """Masks in pictures, shapes (h, w, 3), of whatever fills boxes x0, y0, x1, y1 [px], shapes (n, 4)."""


class BoxSegmenter(abc.ABC):
    """A network of the SAM family: it looks at a picture once, and then at each box."""

    name: str

    def __init__(self, network: Any, placement: NetworkPlacement, batch: int) -> None:
        self.network, self.placement, self.batch = network, placement, batch

    def segment(self, pictures: Sequence[Image], boxes: Sequence[Array]) -> list[Segments]:
        """Masks in pictures, shapes (h, w, 3), of whatever fills boxes x0, y0, x1, y1 [px], shapes (n, 4)."""
        import torch

        asked = [i for i, own in enumerate(boxes) if len(own)]
        drawn: dict[int, Segments] = {}
        with looking():
            for start in range(0, len(asked), self.batch):
                part = asked[start : start + self.batch]
                pixels = torch.from_numpy(np.stack([self.pixels(pictures[i]) for i in part]))
                seen = self.looked(pixels.to(device=self.network.device, dtype=self.network.dtype))
                for place, i in enumerate(part):
                    drawn[i] = self._segmented(seen, place, pictures[i].shape[:2], np.asarray(boxes[i], dtype=np.float64))
        return [drawn.get(i) or Segments(np.zeros((0, *picture.shape[:2]), dtype=bool), np.zeros(0)) for i, picture in enumerate(pictures)]

    def _segmented(self, seen: Any, place: int, size: tuple[int, ...], boxes: Array) -> Segments:
        """Masks of one picture of those that were looked at. size: Its height and width [px]."""
        import torch

        height, width = size[0], size[1]
        masks = np.zeros((len(boxes), height, width), dtype=bool)
        scores = np.zeros(len(boxes))
        drawn = torch.from_numpy(self.scaled(boxes, height, width)).to(device=self.network.device, dtype=self.network.dtype)
        for start in range(0, len(boxes), BOXES_AT_ONCE):
            # one mask a box: three are for points, which may mean a thing or its part
            out = self.network(
                image_embeddings=self.of_one(seen, place), input_boxes=drawn[None, start : start + BOXES_AT_ONCE], multimask_output=False
            )
            logits = self.unfolded(out.pred_masks[0], height, width)
            masks[start : start + BOXES_AT_ONCE] = (logits[:, 0] > 0).cpu().numpy()
            scores[start : start + BOXES_AT_ONCE] = out.iou_scores[0, :, 0].double().cpu().numpy()
        return Segments(masks, np.clip(scores, 0.0, 1.0))

    @abc.abstractmethod
    def pixels(self, picture: Image) -> Pixels:
        """A picture as the network takes it, shape (3, side, side)."""

    @abc.abstractmethod
    def scaled(self, boxes: Array, height: int, width: int) -> Array:
        """Boxes of a picture of that size [px] in the pixels that the network takes, shape (n, 4)."""

    @abc.abstractmethod
    def looked(self, pixels: Any) -> Any:
        """What the network sees in pictures, shape (n, 3, side, side), whatever boxes it is asked for: its features, for `of_one`."""

    @abc.abstractmethod
    def of_one(self, seen: Any, place: int) -> Any:
        """What it sees in one of them, the features of a single picture as the network takes them. place: From 0 on."""

    @abc.abstractmethod
    def unfolded(self, logits: Any, height: int, width: int) -> Any:
        """Logits of masks, shape (n, 1, side / 4, side / 4), at the size of the picture [px]."""
