"""Frames as an animated WebP file."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from functools import cache
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
    times = [look.step_ms] * count
    times[0] = times[-1] = look.rest_ms
    reel: Image.Image = _reel()(iter(frames), count)
    file = io.BytesIO()
    # Without key frames all but the first hold what changes: a viewer plays a film from its beginning.
    reel.save(file, "WEBP", save_all=True, duration=times, loop=0, quality=look.quality, method=4, kmin=0, kmax=0)
    return file.getvalue()


@cache
def _reel() -> Any:
    """An image of several frames, as Pillow has them of files, that takes each frame when it is asked for."""
    from PIL import Image

    def begin(reel: Any, coming: Iterator[NDArray[np.uint8]], count: int) -> None:
        Image.Image.__init__(reel)
        first = Image.fromarray(next(coming))
        reel.im, reel._mode, reel._size = first.im, first.mode, first.size
        reel.coming, reel.n_frames, reel.shown = coming, count, 0

    def seek(reel: Any, frame: int) -> None:
        if frame > reel.shown:  # else the writer goes back to where it began
            reel.im, reel.shown = Image.fromarray(next(reel.coming)).im, frame

    return type("Reel", (Image.Image,), {"__init__": begin, "seek": seek, "tell": lambda reel: reel.shown})
