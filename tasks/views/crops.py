"""The crop of an instance's best view, with the camera that took it and which of its pixels are the instance's."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import matrix
from tasks.geometry.windows import mask_of, view_window

Image = NDArray[np.uint8]

WHITE = 255


@dataclasses.dataclass(frozen=True)
class Crop:
    """A picture of an instance. image: shape (h, w, 3). camera: whose pixels are those of the image, in the world frame; None where the
    frame has no pose. silhouette: pixels of the instance itself, shape (h, w); None where nobody looked."""

    image: Image
    camera: Camera | None = None
    silhouette: NDArray[np.bool_] | None = None

    def shrunk(self, longest: int) -> Crop:
        """The crop with at most so many pixels along its longer side."""
        height, width = self.image.shape[:2]
        share = longest / max(height, width)
        if share >= 1:
            return self
        wide, high = max(1, round(width * share)), max(1, round(height * share))
        silhouette = None
        if self.silhouette is not None:
            silhouette = resized(np.repeat(self.silhouette[..., None], 3, axis=2).astype(np.uint8) * 255, wide, high)[..., 0] > 127
        camera = None if self.camera is None else scaled(self.camera, wide, high)
        return Crop(resized(self.image, wide, high), camera, silhouette)

    def on_white(self) -> Image:
        """The image with everything else in white, as far as that is known."""
        if self.silhouette is None:
            return self.image
        return np.where(self.silhouette[..., None], self.image, np.uint8(WHITE))


def crop_of(instance: Instance, frame: Frame | None, mask: Mask | None, blobs: Mapping[str, bytes]) -> Crop | None:
    """The crop of an instance's best view; None where it has none.

    frame, mask: Of the view, as far as they are known.

    Raises:
        InputError: the picture cannot be read.
    """
    if instance.view_blob is None:
        return None
    if instance.view_blob not in blobs:
        raise InputError(instance.view_blob, "view_blob", "is not among the blobs", "run the capture stage again")
    image = decoded(blobs[instance.view_blob], instance.view_blob)
    if frame is None or mask is None:
        return Crop(image)
    height, width = image.shape[:2]
    x0, y0, x1, y1 = view_window(mask.pixel_box, frame.width, frame.height)
    inside = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
    left, top, right, bottom = mask.pixel_box
    inside[top - y0 : bottom - y0, left - x0 : right - x0] = mask_of(mask.run_lengths, mask.pixel_box) * np.uint8(255)
    silhouette = resized(np.repeat(inside[..., None], 3, axis=2), width, height)[..., 0] > 127
    if frame.pose is None or frame.intrinsics[0] <= 0:
        return Crop(image, None, silhouette)
    fx, fy, cx, cy = frame.intrinsics
    return Crop(image, scaled(Camera(matrix(frame.pose), fx, fy, cx - x0, cy - y0, x1 - x0, y1 - y0), width, height), silhouette)


def decoded(data: bytes, file: str) -> Image:
    """The pixels of a picture, shape (h, w, 3).

    Raises:
        InputError: it cannot be read.
    """
    import PIL.Image

    try:
        with PIL.Image.open(io.BytesIO(data)) as picture:
            return np.asarray(picture.convert("RGB"))
    except Exception as error:  # whatever the decoder raises, the bytes lead it to
        raise InputError(file, "", "cannot be read as a picture", "run the capture stage again") from error


def resized(image: Image, width: int, height: int) -> Image:
    """An image of another size, shape (height, width, 3); smoothed where it gets smaller."""
    import PIL.Image

    return np.asarray(PIL.Image.fromarray(np.ascontiguousarray(image)).resize((width, height), PIL.Image.Resampling.BICUBIC))


def squared(image: Image, side: int) -> Image:
    """The whole image in the middle of a white square, shape (side, side, 3)."""
    height, width = image.shape[:2]
    share = side / max(height, width)
    part = resized(image, max(1, round(width * share)), max(1, round(height * share)))
    square = np.full((side, side, 3), WHITE, dtype=np.uint8)
    top, left = (side - part.shape[0]) // 2, (side - part.shape[1]) // 2
    square[top : top + part.shape[0], left : left + part.shape[1]] = part
    return square


def filling(image: Image, is_object: NDArray[np.bool_], side: int) -> Image:
    """What is seen of an object, shape (h, w, 3) with its pixels (h, w), cut out and as large as a white square lets it be."""
    rows, columns = np.flatnonzero(is_object.any(axis=1)), np.flatnonzero(is_object.any(axis=0))
    if not len(rows):
        return squared(image, side)
    where = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return squared(np.where(is_object[where][..., None], image[where], np.uint8(WHITE)), side)


def scaled(camera: Camera, width: int, height: int) -> Camera:
    """The camera of the same picture with another number of pixels."""
    across, down = width / camera.width, height / camera.height
    cx, cy = (camera.cx + 0.5) * across - 0.5, (camera.cy + 0.5) * down - 0.5
    return dataclasses.replace(camera, fx=camera.fx * across, fy=camera.fy * down, cx=cx, cy=cy, width=width, height=height)
