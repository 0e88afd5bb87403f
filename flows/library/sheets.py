"""Contact sheets of libraries: every model from the front, with what it is, as a picture or as a page."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.errors import InputError
from schemas.files import write_whole
from schemas.text import page_text
from schemas.wording import counted

if TYPE_CHECKING:
    from schemas.indexing import LibraryModel

COLUMNS, CELL_PX, LINE_PX = 10, 96, 12
"""Of a picture; below each model are two lines."""

MOST_DRAWN = 2000
"""Models of a picture, which is 24,000 pixels high then; a page has no bound."""

LETTERS = 16
"""That fit below a model."""


def write_sheet(path: Path, models: Sequence[LibraryModel], blobs: Mapping[str, bytes]) -> None:
    """Write the sheet of some models: a PNG, or a page that needs nothing else, as the file's name ends.

    Raises:
        InputError: the name ends otherwise, there is no model, or there are too many for a picture.
    """
    kinds = {".png": _picture, ".html": _page}
    if path.suffix.lower() not in kinds:
        raise InputError(str(path), "--pictures", f"ends in {path.suffix or 'nothing'}", "name a file that ends in .png or .html")
    if not models:
        raise InputError(str(path), "--pictures", "there is no model to show", "`metascenes library add` adds some")
    write_whole(path, kinds[path.suffix.lower()](models, blobs))


def _picture(models: Sequence[LibraryModel], blobs: Mapping[str, bytes]) -> bytes:
    import PIL.Image
    import PIL.ImageDraw

    if len(models) > MOST_DRAWN:
        problem = f"{counted(len(models), 'model does', 'models do')} not fit into a picture of {MOST_DRAWN}"
        raise InputError("library list", "--pictures", problem, "name a file that ends in .html, or one library")
    columns, high = min(COLUMNS, len(models)), CELL_PX + 2 * LINE_PX
    sheet = PIL.Image.new("RGB", (columns * CELL_PX, -(-len(models) // columns) * high), "white")
    pen = PIL.ImageDraw.Draw(sheet)
    for number, model in enumerate(models):
        x, y = number % columns * CELL_PX, number // columns * high
        with PIL.Image.open(io.BytesIO(blobs[model.thumbnail_blob])) as picture:
            sheet.paste(picture.convert("RGB").resize((CELL_PX, CELL_PX)), (x, y))
        for line, text in enumerate((model.category, model.name)):
            pen.text((x + 2, y + CELL_PX + line * LINE_PX - 1), _drawable(text), "black")
    made = io.BytesIO()
    sheet.save(made, "PNG")
    return made.getvalue()


def _drawable(text: str) -> str:
    """The beginning of a text, in letters that any font has."""
    return text.encode("ascii", "replace").decode()[:LETTERS]


def _page(models: Sequence[LibraryModel], blobs: Mapping[str, bytes]) -> bytes:
    cells = []
    for model in models:
        picture = base64.b64encode(blobs[model.thumbnail_blob]).decode()
        size = " x ".join(f"{side:.2f}" for side in model.extents)
        lines = (model.category, model.name, f"{size} m", model.license, f"{model.library}: {model.file}")
        texts = "".join(f"<span>{html.escape(page_text(line))}</span>" for line in lines)
        cells.append(f'<figure><img alt="" src="data:image/png;base64,{picture}"><figcaption>{texts}</figcaption></figure>')
    return f'<!doctype html><meta charset="utf-8"><title>Models</title><style>{_STYLE}</style><main>{"".join(cells)}</main>'.encode()


_STYLE = (
    "main{display:grid;grid-template-columns:repeat(auto-fill,minmax(9rem,1fr));gap:1rem;font:0.75rem sans-serif}"
    "figure{margin:0}img{width:100%}span{display:block;overflow-wrap:anywhere}"
)
