"""Galleries as one picture each: the scenes (supplementary, Fig. A3), and objects with their candidates (Fig. A5)."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
from collections.abc import Sequence

from schemas.text import page_text
from tasks.stats.axes import short
from tasks.stats.style import INK, MUTED, PAPER, SERIES, Picture, Tone, themed
from tasks.stats.thumbnails import OBJECT_PX, SCENE_PX, CandidateStrip, SceneTile

SCENE_COLUMNS = 3
"""Pairs of thumbnails beside each other: 2000 pixels, as wide as a slide."""

_GREEN, _ORANGE = SERIES[2], SERIES[1]
_MARGIN, _GAP, _TITLE, _LINE = 24, 14, 52, 20


@dataclasses.dataclass(frozen=True)
class _Image:
    x: float
    y: float
    width: float
    height: float
    file: bytes


@dataclasses.dataclass(frozen=True)
class _Text:
    """`y` is the base line."""

    x: float
    y: float
    text: str
    size: int = 15
    tone: Tone = INK
    bold: bool = False


@dataclasses.dataclass(frozen=True)
class _Frame:
    x: float
    y: float
    width: float
    height: float
    tone: Tone = MUTED
    line: int = 1


_Mark = _Image | _Text | _Frame


def scene_sheet(tiles: Sequence[SceneTile], total: int) -> Picture | None:
    """Scenes as thumbnails, each scan beside its replica; `total` counts all scenes."""
    if not tiles:
        return None
    width, height = SCENE_PX
    cell_width, cell_height = 2 * width + 4 + 2 * _GAP, height + _LINE + 2 * _GAP
    columns = min(SCENE_COLUMNS, len(tiles))
    marks: list[_Mark] = [_Text(_MARGIN, 38, "Scans and their replicas" + _sampled(len(tiles), total), 20, INK, True)]
    for at, tile in enumerate(tiles):
        x, y = _MARGIN + at % columns * cell_width, _TITLE + at // columns * cell_height
        marks.append(_Text(x, y + 14, short(tile.scene_id, 60), 14, MUTED))
        if tile.scan is None or tile.replica is None:
            marks.append(_Frame(x, y + _LINE, 2 * width + 4, height))
            marks.append(_Text(x + 12, y + _LINE + 28, short(f"no pictures: {tile.excuse}", 70), 14, MUTED))
            continue
        marks.append(_Image(x, y + _LINE, width, height, tile.scan))
        marks.append(_Image(x + width + 4, y + _LINE, width, height, tile.replica))
    rows = -(-len(tiles) // columns)
    alt = f"Gallery of {len(tiles)} of {total} scenes, each scan beside its replica: {', '.join(tile.scene_id for tile in tiles[:6])}."
    size = (2 * _MARGIN + columns * cell_width - 2 * _GAP, _TITLE + rows * cell_height)
    return _drawn("scene_gallery", "Scans and their replicas", alt, "scene_objects", size, marks)


def candidate_sheet(strips: Sequence[CandidateStrip]) -> Picture | None:
    """Objects, one a row: how the scan shows them, and their candidates by slot; the chosen one framed, fallbacks named."""
    if not strips:
        return None
    cell_width, cell_height = OBJECT_PX + _GAP, OBJECT_PX + 4 * _LINE + _GAP
    marks: list[_Mark] = [_Text(_MARGIN, 38, "Objects and their candidates", 20, INK, True)]
    for row, strip in enumerate(strips):
        y = _TITLE + row * cell_height + _LINE
        marks.append(_Text(_MARGIN, y - 6, f"{strip.category}  {strip.scene_id} {strip.instance_id}", 14, INK, True))
        marks.extend(_picture_or_frame(_MARGIN, y, strip.crop))
        marks.append(_Text(_MARGIN, y + OBJECT_PX + 17, "scan", 13, MUTED))
        for column, tile in enumerate(strip.tiles, start=1):
            x = _MARGIN + column * cell_width + 8
            marks.extend(_picture_or_frame(x, y, tile.picture))
            if tile.is_chosen:
                marks.append(_Frame(x - 3, y - 3, OBJECT_PX + 6, OBJECT_PX + 6, _GREEN, 4))
            marks.append(_Text(x, y + OBJECT_PX + 17, short(f"{tile.slot} {tile.provider}", 17), 13, MUTED))
            score = f"{tile.score:.3f}" if tile.score is not None else ("not scored" if tile.is_filled else "empty")
            marks.append(
                _Text(x, y + OBJECT_PX + 34, f"{score} chosen" if tile.is_chosen else score, 13, _GREEN if tile.is_chosen else INK)
            )
            if tile.is_fallback:
                marks.append(_Text(x, y + OBJECT_PX + 51, "fallback", 13, _ORANGE))
    most = max(len(strip.tiles) for strip in strips)
    count = sum(len(strip.tiles) for strip in strips)
    alt = (
        f"Gallery of {len(strips)} objects, each as the scan shows it beside its candidates, {count} in all; "
        f"the chosen ones are framed, fallbacks named: {', '.join(strip.category for strip in strips[:6])}."
    )
    size = (2 * _MARGIN + (most + 1) * cell_width + 8 - _GAP, _TITLE + len(strips) * cell_height)
    return _drawn("candidate_gallery", "Objects and their candidates", alt, "candidate_wins", size, marks)


def _sampled(shown: int, total: int) -> str:
    return f", {shown} of {total} drawn by chance" if shown < total else ""


def _picture_or_frame(x: float, y: float, file: bytes | None) -> list[_Mark]:
    return [_Image(x, y, OBJECT_PX, OBJECT_PX, file) if file is not None else _Frame(x, y, OBJECT_PX, OBJECT_PX)]


def _drawn(name: str, title: str, alt: str, view: str, size: tuple[float, float], marks: Sequence[_Mark]) -> Picture:
    """The marks as SVG and as PNG."""
    width, height = (round(value) for value in size)
    body = "".join(_as_svg(mark) for mark in marks)
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="DejaVu Sans, sans-serif"><title>{html.escape(page_text(title))}</title>{body}</svg>'
    )
    return Picture(name, title, alt, themed(svg), _as_png(width, height, marks), view=view)


def _as_svg(mark: _Mark) -> str:
    match mark:
        case _Image():
            data = base64.b64encode(mark.file).decode("ascii")
            place = f'x="{mark.x:g}" y="{mark.y:g}" width="{mark.width:g}" height="{mark.height:g}"'
            return f'<image {place} href="data:image/jpeg;base64,{data}"/>'
        case _Frame():
            place = f'x="{mark.x:g}" y="{mark.y:g}" width="{mark.width:g}" height="{mark.height:g}"'
            return f'<rect {place} fill="none" stroke="{mark.tone.light}" stroke-width="{mark.line}"/>'
        case _Text():
            weight = ' font-weight="bold"' if mark.bold else ""
            face = f'font-size="{mark.size}" fill="{mark.tone.light}"{weight}'
            return f'<text x="{mark.x:g}" y="{mark.y:g}" {face}>{html.escape(page_text(mark.text))}</text>'


def _as_png(width: int, height: int, marks: Sequence[_Mark]) -> bytes:
    from pathlib import Path

    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"  # the letters of the charts
    sheet = Image.new("RGB", (width, height), PAPER.light)
    brush = ImageDraw.Draw(sheet)
    for mark in marks:
        match mark:
            case _Image():
                with Image.open(io.BytesIO(mark.file)) as image:
                    sheet.paste(image.convert("RGB").resize((round(mark.width), round(mark.height))), (round(mark.x), round(mark.y)))
            case _Frame():
                box = (mark.x, mark.y, mark.x + mark.width - 1, mark.y + mark.height - 1)
                brush.rectangle(box, outline=mark.tone.light, width=mark.line)
            case _Text():
                font = ImageFont.truetype(str(fonts / ("DejaVuSans-Bold.ttf" if mark.bold else "DejaVuSans.ttf")), mark.size)
                brush.text((mark.x, mark.y), mark.text, fill=mark.tone.light, font=font, anchor="ls")
    made = io.BytesIO()
    sheet.save(made, "PNG", optimize=True)
    return made.getvalue()
