"""Frames of a scan as pictures. The lake has their rows; their pixels stay where the scan is."""

from __future__ import annotations

import io
from pathlib import Path

from schemas.capture import Frame
from schemas.errors import InputError
from schemas.files import stays_in

QUALITY = 85
AWAY = "the pictures of a scan stay in its folder, which is not at hand here"


def picture(scan_path: str, frame: Frame, window: tuple[int, int, int, int] | None = None) -> bytes:
    """JPEG of a frame, or of a part x0, y0, x1, y1 of it [px], drawn anew from its pixels: what else the file holds goes nowhere.

    Raises:
        InputError: the scan's folder is not on this machine, or the picture in it is missing, damaged or a link out of it.
    """
    from PIL import Image

    from tasks.capture.files.images import read_color
    from tasks.capture.files.sens import open_sens

    folder = Path(scan_path)
    file, _, index = frame.color_file.partition("#")
    path = folder / file
    if "://" in scan_path or not folder.is_dir() or not path.is_file():
        raise InputError(scan_path, frame.frame_id, AWAY, "put the scan where it was when it was captured")
    if not stays_in(path, folder):
        raise InputError(scan_path, frame.frame_id, "leads out of the scan's folder")
    if index:
        container = open_sens(path, file)
        if not 0 <= int(index) < len(container.frames):
            raise InputError(file, index, "the container has no such frame")
        pixels = container.color(int(index))
    else:
        pixels = read_color(path, file, (frame.width, frame.height))
    if window is not None:
        x0, y0, x1, y1 = window
        pixels = pixels[y0:y1, x0:x1]
    made = io.BytesIO()
    Image.fromarray(pixels).save(made, "JPEG", quality=QUALITY)
    return made.getvalue()


def are_at_hand(scan_path: str, frame: Frame) -> bool:
    """Whether the scan's folder is on this machine, with the picture of a frame in it."""
    return "://" not in scan_path and (Path(scan_path) / frame.color_file.partition("#")[0]).is_file()
