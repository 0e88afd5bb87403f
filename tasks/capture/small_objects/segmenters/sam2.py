"""SAM 2 (Ravi et al., 2024): the whole picture in a square, whatever its sides (specs A.2)."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np

from tasks.capture.small_objects.segmenters.segmenter import DEVIATION, MEAN, WHERE, Array, BoxSegmenter
from tasks.vision.devices import NetworkSettings, opened
from tasks.vision.pixels import Image, Pixels, normalized, shrunk_to


@dataclasses.dataclass(frozen=True)
class Sam2(NetworkSettings):
    """Masks by SAM 2 or 2.1, of any size. Weights are Apache-2.0: facebook/sam2.1-hiera-tiny, -small, -base-plus, -large."""

    kind: ClassVar[str] = "sam2"
    version: str = "1"  # goes up when the same weights would give other masks


class Sam2Segmenter(BoxSegmenter):
    """SAM 2 out of a folder."""

    name = Sam2.kind

    @property
    def side(self) -> int:
        """Of the square that it takes [px]."""
        size = self.network.config.prompt_encoder_config.image_size
        return int(size if isinstance(size, int) else size[0])

    def pixels(self, picture: Image) -> Pixels:
        """A picture as the network takes it, shape (3, side, side)."""
        return normalized(shrunk_to(picture, self.side, self.side), MEAN, DEVIATION)

    def scaled(self, boxes: Array, height: int, width: int) -> Array:
        """Boxes of a picture of that size [px] in the pixels that the network takes, shape (n, 4)."""
        return boxes * (self.side / np.array([width, height, width, height]))

    def looked(self, pixels: Any) -> Any:
        """What the network sees in pictures: features at three scales."""
        return self.network.get_image_embeddings(pixels)

    def of_one(self, seen: Any, place: int) -> Any:
        """What it sees in one of them."""
        return [level[place : place + 1] for level in seen]

    def unfolded(self, logits: Any, height: int, width: int) -> Any:
        """Logits of masks, shape (n, 1, side / 4, side / 4), at the size of the picture [px]."""
        from torch.nn.functional import interpolate

        return interpolate(logits, (height, width), mode="bilinear", align_corners=False)


def sam2_in(settings: Sam2) -> Sam2Segmenter:
    """SAM 2 out of the folder that settings name.

    Raises:
        InputError: it is not there, or holds none.
    """
    network, _, placement = opened(settings, "Sam2Model", WHERE)
    return Sam2Segmenter(network, placement, settings.batch)
