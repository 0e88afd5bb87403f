"""Color and depth images of a scan."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file
from tasks.capture.files.documents import read_bytes

MAX_PIXELS, MAX_IMAGE_BYTES = BUDGET.pixels, BUDGET.image_bytes

COLOR_SUFFIXES = (".jpg", ".jpeg", ".png", ".ppm", ".bmp")
DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff")

_AGAIN = "copy the image again"


def image_size(path: Path, name: str) -> tuple[int, int]:
    """Width and height [px] from an image's header.

    Raises:
        InputError: it is no image, no regular file, or larger than MAX_PIXELS.
    """
    from PIL import Image

    with _decoding(name, "image", "read"), open_file(path, name, MAX_IMAGE_BYTES) as file, Image.open(file) as image:
        width, height = image.size
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(name, "image", f"is {width} x {height} pixels", _AGAIN)
    return width, height


def read_color(path: Path, name: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A color image of the stated width and height, shape (height, width, 3); raises InputError."""
    return decode_color(read_bytes(path, name, MAX_IMAGE_BYTES), name, size)


def decode_color(data: bytes, name: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Color image from the bytes of a JPEG, PNG, ..., shape (height, width, 3); raises InputError."""
    from PIL import Image

    with _decoding(name, "color", "decoded"), Image.open(io.BytesIO(data)) as image:
        _same_size(image.size, size, name, "color")
        pixels = np.asarray(image.convert("RGB"))
    return pixels


def has_float_depth(path: Path, name: str) -> bool:
    """True if a depth image holds floating-point numbers, by its header.

    Raises:
        InputError: the file is not an image.
    """
    from PIL import Image

    with _decoding(name, "image", "read"), open_file(path, name, MAX_IMAGE_BYTES) as file, Image.open(file) as image:
        return image.mode == "F"


def read_depth(path: Path, name: str, size: tuple[int, int], scale: float) -> NDArray[np.float32]:
    """Depth [m], shape (height, width), 0 where there is none, of an image in 1/scale meters; raises InputError.

    The largest value of 16 bits marks pixels without a reading. 8 bits are refused above `MAX_SCALE_8_BITS`.
    """
    from PIL import Image

    data = read_bytes(path, name, MAX_IMAGE_BYTES)
    with _decoding(name, "depth", "decoded"), Image.open(io.BytesIO(data)) as image:
        _same_size(image.size, size, name, "depth")
        values = np.asarray(image)
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise InputError(name, "depth", "is no single-channel image", "export depth as 16-bit grey")
    if values.dtype == np.uint8 and scale > MAX_SCALE_8_BITS:
        problem = f"has 8 bits: at {scale:g} units per meter they reach {255 / scale:.2g} m"
        raise InputError(name, "depth", problem, "export depth as 16-bit grey")
    depth = values.astype(np.float32) / np.float32(scale)
    is_reading = np.isfinite(depth) & (depth > 0) & ((values != NO_READING) | (values.dtype.kind == "f"))
    return np.where(is_reading, depth, np.float32(0))


NO_READING = 65535
"""The largest value of 16 bits: an invalid pixel or one out of range, never a distance."""

MAX_SCALE_8_BITS = 100.0
"""Units per meter at which 8 bits still reach 2.5 m; confidence images have 1."""


def encode_jpeg(image: NDArray[np.uint8], longest: int) -> bytes:
    """JPEG of an image, shape (h, w, 3), shrunk so that its longer side is at most `longest` pixels."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(image))
    if max(picture.size) > longest:
        picture.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, format="JPEG", quality=88)
    return out.getvalue()


@contextlib.contextmanager
def _decoding(name: str, field: str, done: str) -> Iterator[None]:
    """Name the file of whatever the decoder raises, which is whatever the bytes lead it to."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(name, field, f"cannot be {done} ({_reason(error)})", _AGAIN) from error


def _same_size(actual: tuple[int, int], size: tuple[int, int], name: str, field: str) -> None:
    if actual != size:
        raise InputError(
            name, field, f"is {actual[0]} x {actual[1]} pixels, {size[0]} x {size[1]} expected", "export all frames at one size"
        )


def _reason(error: Exception) -> str:
    text = str(error).split("<")[0].strip()
    return f"{type(error).__name__}: {text[:80]}" if text else type(error).__name__
