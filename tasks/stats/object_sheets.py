"""An object and its numbered candidates as one picture, for tools that show nothing but images."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import yaw_pose
from tasks.stats.style import INK, MUTED, PAPER
from tasks.stats.thumbnails import OBJECT_PX, fitted, object_thumbnail

PHOTO_PX, COLUMNS = 340, 5
"""Edge of the photo, which is as high as two rows of candidates; candidates beside each other."""

_MARGIN, _GAP, _TITLE, _NUMBER = 16, 12, 40, 26


def seen(view: bytes | None, mesh: bytes | None, yaw_radians: float) -> bytes | None:
    """JPEG of a scanned object: its best view, where no frame shows it its faces, drawn as assets are; None where it has neither.

    mesh: GLB in the world frame, in which the object is turned by its yaw.
    """
    if view is not None or mesh is None:
        return view
    upright = yaw_pose(-yaw_radians, (0.0, 0.0, 0.0))[:3, :3]
    return object_thumbnail(load_glb(mesh, "faces.glb"), turn=upright, px=PHOTO_PX)


def object_sheet(title: str, photo: bytes | None, candidates: Sequence[tuple[int, bytes]]) -> bytes:
    """JPEG: a photo of an object, or that there is none, and beside it pictures of its candidates below their slots.

    Raises:
        OSError: one of them is no image that can be read.
    """
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    font_file = str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")  # the letters of the charts
    large, small = ImageFont.truetype(font_file, 20), ImageFont.truetype(font_file, 16)
    left = _MARGIN + PHOTO_PX + 2 * _GAP
    width = left + COLUMNS * (OBJECT_PX + _GAP) - _GAP + _MARGIN
    rows = max(2, -(-len(candidates) // COLUMNS))
    height = _TITLE + rows * (_NUMBER + OBJECT_PX + _GAP) + _MARGIN
    sheet = Image.new("RGB", (width, height), PAPER.light)
    brush = ImageDraw.Draw(sheet)
    brush.text((_MARGIN, _TITLE - 14), title, fill=INK.light, font=large, anchor="ls")
    if photo is None:
        brush.text((_MARGIN, _TITLE + _NUMBER), "neither frames nor faces of it", fill=MUTED.light, font=small, anchor="ls")
    pictures = [] if photo is None else [(_MARGIN, _TITLE, fitted(photo, (PHOTO_PX, PHOTO_PX)))]
    for place, (slot, picture) in enumerate(candidates):
        x = left + (place % COLUMNS) * (OBJECT_PX + _GAP)
        y = _TITLE + (place // COLUMNS) * (_NUMBER + OBJECT_PX + _GAP)
        brush.text((x, y + _NUMBER - 8), str(slot), fill=INK.light, font=large, anchor="ls")
        pictures.append((x, y + _NUMBER, fitted(picture, (OBJECT_PX, OBJECT_PX))))
    for x, y, picture in pictures:
        with Image.open(io.BytesIO(picture)) as opened:
            sheet.paste(opened.convert("RGB"), (x, y))
    made = io.BytesIO()
    sheet.save(made, "JPEG", quality=85, optimize=True)
    return made.getvalue()
