"""Images of a plain GLB: PNG and JPEG as they are, every other kind converted to PNG; extended where a sampler does not repeat."""

from __future__ import annotations

import base64
import dataclasses
import io
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.geometry.gltf.arrays import Arrays, natural
from tasks.geometry.gltf.decoding import DecodingJob, decode
from tasks.geometry.gltf.features import BASIS, IMAGE_EXTENSIONS, Document, entries, extension_of, is_elsewhere
from tasks.unpacking import KTX2, image_pixels

CLAMP, MIRROR, REPEAT = 33071, 33648, 10497
"""Wrap modes of samplers (glTF 2.0, 5.26)."""

MAX_PADDING_FACTOR = 16
"""Largest growth of an image that is extended: a clamped texture whose coordinates lie farther outside is noted instead."""

EDGE = 1e-6
"""Distance of a clamped coordinate from the image's edge: at the edge itself, a repeated lookup would take the other side."""


@dataclasses.dataclass(frozen=True)
class Padding:
    """Pixels added on each side of an image. is_mirrored: each axis, continued by its mirror image instead of its edge."""

    before: tuple[int, int] = (0, 0)
    after: tuple[int, int] = (0, 0)
    is_mirrored: tuple[bool, bool] = (False, False)

    @property
    def is_empty(self) -> bool:
        """True if the image stays as it is."""
        return not any((*self.before, *self.after))


class Images:
    """The images of a document, each decoded once.

    notes: lines on images that cannot be decoded, filled as images are asked for.
    """

    def __init__(self, document: Document, arrays: Arrays, file: str) -> None:
        self.notes: dict[str, None] = {}
        self._file, self._arrays = file, arrays
        self._images, self._textures = entries(document, "images"), entries(document, "textures")
        self._files: dict[int, bytes | None] = {}
        self._padded: dict[tuple[int, Padding], bytes] = {}
        self._decode_basis()

    def _decode_basis(self) -> None:
        """Decode all Basis Universal images that textures name, in one child."""
        names = sorted({index for texture in self._textures for _, index in self._sources(texture)})
        packed = {index: data for index in names if (data := self._content(index)) is not None and data[:12] == KTX2}
        most = sum(4 * pixels + 2**16 for data in packed.values() if (pixels := image_pixels(data) or 0) <= BUDGET.pixels)
        results = decode([DecodingJob("basis", data) for data in packed.values()], min(most, BUDGET.all_pixels), self._file)
        for index, result in zip(packed, results, strict=True):
            self._files[index] = None if result.problem else result.arrays["png"].tobytes()
            if result.problem:
                self._note(f"image {index}: {BASIS}: cannot be decoded ({result.problem}): drawn without it")

    def _note(self, text: str) -> None:
        self.notes[f"{self._file}: {text}"] = None

    def _sources(self, texture: Document) -> list[tuple[str, int]]:
        """Extension and number of the images that a texture names, in the order in which they are tried."""
        named = [(name, extension_of(texture, name).get("source")) for name in IMAGE_EXTENSIONS]
        sources = [(name, index) for name, index in (*named, ("", texture.get("source"))) if type(index) is int]
        return [(name, index) for name, index in sources if 0 <= index < len(self._images)]

    def image_of(self, texture: Any) -> int | None:
        """Number of the first image of a texture that can be decoded; None without one."""
        if type(texture) is not int or not 0 <= texture < len(self._textures):
            self._note(f"texture {texture!r:.20} does not exist: drawn without it")
            return None
        sources = self._sources(self._textures[texture])
        if not sources:
            self._note(f"texture {texture} names no image that is read: drawn without it")
        return next((index for _, index in sources if self.file(index) is not None), None)

    def file(self, index: int) -> bytes | None:
        """An image as a PNG or JPEG file; None where it cannot be decoded, which is noted."""
        if index not in self._files:
            self._files[index] = self._converted(index)
        return self._files[index]

    def _content(self, index: int) -> bytes | None:
        """An image as it is in the file; None where it is elsewhere."""
        image = self._images[index]
        if "bufferView" in image:
            return self._arrays.view(natural(image["bufferView"]))
        uri = image.get("uri")
        if isinstance(uri, str) and not is_elsewhere(image):
            return base64.b64decode(uri.partition("base64,")[2])
        return None

    def _converted(self, index: int) -> bytes | None:
        from PIL import Image

        data = self._content(index)
        if data is None:
            self._note(f"image {index}: lies in another file: drawn without it")
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Pillow's own, of images that are refused here
                with Image.open(io.BytesIO(data)) as image:
                    if image.format in ("PNG", "JPEG"):
                        return data  # decoded by the general reader
                    if image.size[0] * image.size[1] > BUDGET.pixels:
                        raise ValueError(f"has {image.size[0] * image.size[1]} pixels, more than {BUDGET.pixels}")
                    mode = "RGBA" if "A" in image.getbands() or "transparency" in image.info else "RGB"
                    return _png(np.asarray(image.convert(mode)))
        except Exception:  # the decoder raises whatever the bytes lead it to
            kind = self._images[index].get("mimeType", "of no stated type")
            self._note(f"image {index} ({kind!s:.40}) cannot be decoded: drawn without it")
            return None

    def size(self, index: int) -> tuple[int, int]:
        """Width and height of an image [px]."""
        from PIL import Image

        with Image.open(io.BytesIO(self.file(index) or b"")) as image:
            return image.size

    def padded(self, index: int, padding: Padding) -> bytes:
        """An image extended on its sides, as a PNG.

        Raises:
            InputError: it cannot be decoded.
        """
        from PIL import Image

        if (index, padding) not in self._padded:
            try:
                pixels = np.asarray(Image.open(io.BytesIO(self.file(index) or b"")).convert("RGBA"))
            except Exception as error:  # the decoder raises whatever the bytes lead it to
                problem = f"{index} cannot be decoded ({type(error).__name__}: {error})"[:200]
                raise InputError(self._file, "images", problem, "export it again") from error
            for axis, side in ((1, 0), (0, 1)):
                widths = [(0, 0)] * 3
                widths[axis] = (padding.before[side], padding.after[side])
                pixels = np.pad(pixels, widths, mode="symmetric" if padding.is_mirrored[side] else "edge")
            self._padded[index, padding] = _png(pixels)
        return self._padded[index, padding]


def _png(pixels: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    packed = io.BytesIO()
    Image.fromarray(pixels).save(packed, "PNG", compress_level=1)
    return packed.getvalue()


@dataclasses.dataclass(frozen=True)
class Lookup:
    """Texture coordinates for a repeated image. padding: extension of the image. is_exact: False where a clamp is approximated."""

    uv: NDArray[np.float64]
    padding: Padding
    is_exact: bool = True


def repeated_lookup(uv: NDArray[np.float64], faces: NDArray[Any], wraps: Sequence[int], size: tuple[int, int]) -> Lookup:
    """Coordinates and padding that show by repeating an image what its own wrap modes show.

    Args:
        uv: coordinates, origin at the upper left, shape (n, 2).
        faces: vertices of the triangles, shape (m, 3).
        wraps: wrap modes along u and v.
        size: width and height of the image [px].
    """
    changed, before, after = np.nan_to_num(uv), [0, 0], [0, 0]
    is_mirrored, is_exact = [False, False], True
    for axis, (wrap, length) in enumerate(zip(wraps, size, strict=True)):
        values = changed[:, axis]
        low, high = float(values.min(initial=0.0)), float(values.max(initial=1.0))
        if wrap == REPEAT or (low >= 0.0 and high <= 1.0 and wrap == MIRROR):
            continue
        if wrap == MIRROR:
            is_mirrored[axis], after[axis] = True, length
        elif _has_crossing(values[faces], 0.5 / length):
            before[axis], after[axis] = (int(np.ceil(length * max(amount, 0.0))) for amount in (-low, high - 1.0))
            if (length + before[axis] + after[axis]) > MAX_PADDING_FACTOR * length:
                before[axis], after[axis], is_exact = 0, 0, False
        total = length + before[axis] + after[axis]
        scaled = (values * length + before[axis]) / total
        changed[:, axis] = scaled if wrap == MIRROR else np.clip(scaled, EDGE, 1.0 - EDGE)
    pixels = np.prod([length + b + a for length, b, a in zip(size, before, after, strict=True)], dtype=np.float64)
    if pixels > min(BUDGET.pixels, MAX_PADDING_FACTOR * size[0] * size[1]):
        return Lookup(np.clip(np.nan_to_num(uv), EDGE, 1.0 - EDGE), Padding(), is_exact=False)
    return Lookup(changed, Padding((before[0], before[1]), (after[0], after[1]), (is_mirrored[0], is_mirrored[1])), is_exact)


def _has_crossing(corners: NDArray[np.float64], margin: float) -> bool:
    """True if a triangle lies on both sides of an edge of the image. corners: coordinates along an axis, shape (m, 3)."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    return bool((((low < -margin) & (high > margin)) | ((low < 1.0 - margin) & (high > 1.0 + margin))).any())
