"""SAM (Kirillov et al., 2023), which the paper takes: the picture in the upper left of a square, black beside it (specs A.2)."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np

from tasks.capture.small_objects.segmenters.segmenter import DEVIATION, MEAN, WHERE, Array, BoxSegmenter
from tasks.vision.devices import NetworkSettings, opened
from tasks.vision.pixels import Image, Pixels, normalized, shrunk_to


@dataclasses.dataclass(frozen=True)
class Sam(NetworkSettings):
    """Masks by SAM, of any size. Weights are Apache-2.0: facebook/sam-vit-base, -large, -huge."""

    kind: ClassVar[str] = "sam"
    version: str = "1"  # goes up when the same weights would give other masks


class SamSegmenter(BoxSegmenter):
    """SAM out of a folder."""

    name = Sam.kind

    @property
    def side(self) -> int:
        """Of the square that it takes [px]."""
        return int(self.network.config.vision_config.image_size)

    def _size(self, height: int, width: int) -> tuple[int, int]:
        """Of a picture within the square."""
        share = self.side / max(height, width)
        return int(height * share + 0.5), int(width * share + 0.5)

    def pixels(self, picture: Image) -> Pixels:
        """A picture as the network takes it, shape (3, side, side)."""
        height, width = self._size(*picture.shape[:2])
        square = np.zeros((3, self.side, self.side), dtype=np.float32)
        square[:, :height, :width] = normalized(shrunk_to(picture, height, width), MEAN, DEVIATION)
        return square

    def scaled(self, boxes: Array, height: int, width: int) -> Array:
        """Boxes of a picture of that size [px] in the pixels that the network takes, shape (n, 4)."""
        high, wide = self._size(height, width)
        return boxes * (np.array([wide, high, wide, high]) / np.array([width, height, width, height]))

    def looked(self, pixels: Any) -> Any:
        """What the network sees in pictures."""
        return self.network.get_image_embeddings(pixels)

    def of_one(self, seen: Any, place: int) -> Any:
        """What it sees in one of them."""
        return seen[place : place + 1]

    def unfolded(self, logits: Any, height: int, width: int) -> Any:
        """Logits of masks, shape (n, 1, side / 4, side / 4), at the size of the picture [px]."""
        from torch.nn.functional import interpolate

        high, wide = self._size(height, width)
        whole = interpolate(logits, (self.side, self.side), mode="bilinear", align_corners=False)[..., :high, :wide]
        return interpolate(whole, (height, width), mode="bilinear", align_corners=False)


def sam_in(settings: Sam) -> SamSegmenter:
    """SAM out of the folder that settings name.

    Raises:
        InputError: it is not there, or holds none.
    """
    network, _, placement = opened(settings, "SamModel", WHERE)
    return SamSegmenter(network, placement, settings.batch)
