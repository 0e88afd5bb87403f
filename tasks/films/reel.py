"""Frames as an animated WebP file."""

from __future__ import annotations

import io
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.films.walks import FilmLook

if TYPE_CHECKING:
    from PIL import Image


def webp(frames: Iterable[NDArray[np.uint8]], count: int, look: FilmLook) -> bytes:
    """So many frames, shape (h, w, 3) each, as a film that runs again and again and rests at both ends. The same frames give the same
    bytes. They are asked for one after the other: those of the longest walks would take 800 MB.
    """
    coming = iter(frames)
    reel = _reel(next(coming), coming, count)
    times = [look.step_ms] * count
    times[0] = times[-1] = look.rest_ms
    file = io.BytesIO()
    # Without key frames all but the first hold what changes: a viewer plays a film from its beginning.
    reel.save(file, "WEBP", save_all=True, duration=times, loop=0, quality=look.quality, method=4, kmin=0, kmax=0)
    return file.getvalue()


def _reel(first: NDArray[np.uint8], others: Iterable[NDArray[np.uint8]], count: int) -> Image.Image:
    """An image of several frames, as Pillow reads them from files."""
    from PIL import Image

    class Reel(Image.Image):
        n_frames = count

        def seek(self, frame: int) -> None:
            if frame > self.shown:
                self.shown = frame
                self.im = Image.fromarray(next(coming)).im
                self.readonly = 0

        def tell(self) -> int:
            return self.shown

    coming: Any = iter(others)
    reel = Reel()
    image = Image.fromarray(first)
    reel.im, reel._mode, reel._size, reel.shown = image.im, image.mode, image.size, 0
    return reel
