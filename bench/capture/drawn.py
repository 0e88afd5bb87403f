"""Masks of objects in real RGB-D frames, drawn by hand: point by point over enlarged pictures, and no segmentation had a part in them.

`drawn/` has a JSON file for each frame. Nothing of the frames themselves is in it:

- frame: Where the color image or cloud lies below the folder of real data. size: [w, h].
- drawn, attribution: How it was drawn; whose frame it is, and its license.
- objects: Of each one its category, a word of `tasks/capture/labels.csv`; whether it is a support of others; the polygons of what is
  seen of it; holes in them.
- structure: Floor and walls, as polygons. ignored: Polygons of what cannot be told apart, of clutter, and of what has no depth.

Polygons have one coordinate for x, to the right, and one for y, down, in pixels from the upper left corner of the image, in steps of a
half: the middle of the first pixel is at (0.5, 0.5). Everything is outlined as far as it goes, or farther where something stands before
it: of objects, a later one lies in front of an earlier one. Structure lies behind all of them, and what is ignored before all.

Outlines keep within some three pixels of what is seen; leaves are drawn one by one, and gaps among them that are narrower are not.
Depth was looked at as a picture, where color does not tell where an object ends. In the two frames of a desk it lies up to ten pixels
beside the color, at the left side most; outlines go by the color.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_json
from tasks.scanner.scenery import STRUCTURE

FOLDER = Path(__file__).with_name("drawn")
"""Of the drawings."""

UNLABELED, IGNORED = 0, -1
"""Labels of pixels that belong to no object, and of those that count for nothing."""

_AGAIN = "draw it again"

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Labels = NDArray[np.int32]


@dataclasses.dataclass(frozen=True)
class DrawnRegion:
    """An object, or a piece of structure. polygons, holes: [px], shapes (n, 2)."""

    category: str
    polygons: tuple[Array, ...]
    holes: tuple[Array, ...] = ()
    is_support: bool = False

    def mask(self, size: tuple[int, int]) -> Bools:
        """Pixels within its polygons and outside of its holes, whatever lies before it, shape (h, w)."""
        return _united(self.polygons, size) & ~_united(self.holes, size)


@dataclasses.dataclass(frozen=True)
class Drawing:
    """What was drawn over one frame. frame: Path below the folder of real data. size: (w, h) [px]. objects: From the back to the front.
    ignored: [px], shapes (n, 2)."""

    frame: str
    size: tuple[int, int]
    attribution: str
    objects: tuple[DrawnRegion, ...]
    structure: tuple[DrawnRegion, ...]
    ignored: tuple[Array, ...]

    @property
    def categories(self) -> tuple[str, ...]:
        """Of the objects: the first one is that of label 1."""
        return tuple(each.category for each in self.objects)

    def labels(self) -> Labels:
        """The object of each pixel, from 1, `UNLABELED` or `IGNORED`, shape (h, w)."""
        return self._layers(self.objects)

    def structure_labels(self) -> Labels:
        """The piece of structure of each pixel, from 1, `UNLABELED` also where an object stands before it, or `IGNORED`, shape (h, w)."""
        labels = self._layers(self.structure)
        labels[self.labels() > 0] = UNLABELED
        return labels

    def _layers(self, regions: Iterable[DrawnRegion]) -> Labels:
        labels = np.full((self.size[1], self.size[0]), UNLABELED, dtype=np.int32)
        for number, region in enumerate(regions, 1):
            labels[region.mask(self.size)] = number
        labels[_united(self.ignored, self.size)] = IGNORED
        return labels


def drawings(folder: Path = FOLDER) -> list[Path]:
    """Files of drawings, by name."""
    return sorted(folder.glob("*.json"))


def read_drawing(path: Path) -> Drawing:
    """A drawing.

    Raises:
        InputError: the file is broken, a polygon crosses itself or leaves the frame, a hole takes nothing away, or an object is hidden
            whole.
    """
    name = path.name
    document = _fields(read_json(path, name), name, "", {"frame", "size", "drawn", "attribution", "objects", "structure", "ignored"})
    frame, size = _text(document, name, "frame"), _size(document.get("size"), name)
    if PurePosixPath(frame).is_absolute() or ".." in PurePosixPath(frame).parts:
        raise InputError(name, "frame", "leaves the folder of real data", "give a path below it")
    _text(document, name, "drawn")
    drawing = Drawing(
        frame=frame,
        size=size,
        attribution=_text(document, name, "attribution"),
        objects=tuple(_region(value, name, field, size, is_object=True) for field, value in _listed(document, name, "objects")),
        structure=tuple(_region(value, name, field, size, is_object=False) for field, value in _listed(document, name, "structure")),
        ignored=tuple(_polygon(value, name, field, size) for field, value in _listed(document, name, "ignored")),
    )
    _check_seen(drawing, name)
    return drawing


def filled(polygon: Array, size: tuple[int, int]) -> Bools:
    """Pixels whose middles lie within a polygon, shape (h, w).

    A middle on an edge belongs to what lies right of the edge, or below it: polygons that share an edge share no pixel and leave none
    out. Exact, since coordinates are whole halves.

    polygon: Corners [px], shape (n, 2). size: (w, h) [px].
    """
    width, height = size
    corners = np.rint(2 * polygon).astype(np.int64)
    x, y = 2 * np.arange(width) + 1, 2 * np.arange(height)[:, None] + 1
    inside = np.zeros((height, width), dtype=bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        (x0, y0), (x1, y1) = (start, end) if start[1] < end[1] else (end, start)
        rows = slice(y0 // 2, y1 // 2)  # whose middles are at y0 or below, and above y1
        inside[rows] ^= (x - x0) * (y1 - y0) >= (y[rows] - y0) * (x1 - x0)
    return inside


def _united(polygons: Iterable[Array], size: tuple[int, int]) -> Bools:
    union = np.zeros((size[1], size[0]), dtype=bool)
    for polygon in polygons:
        union |= filled(polygon, size)
    return union


def _check_seen(drawing: Drawing, name: str) -> None:
    """Raise InputError for an object that nothing is seen of, and for a hole in nothing: a slip of the hand."""
    labels = drawing.labels()
    for index, region in enumerate(drawing.objects):
        if not (labels == index + 1).any():
            raise InputError(name, f"objects[{index}]", f"{region.category} is hidden whole", "list it after what lies behind it")
        whole = _united(region.polygons, drawing.size)
        for number, hole in enumerate(region.holes):
            if not (whole & filled(hole, drawing.size)).any():
                raise InputError(name, f"objects[{index}].holes[{number}]", "lies outside of the object", _AGAIN)


def _region(value: Any, name: str, field: str, size: tuple[int, int], is_object: bool) -> DrawnRegion:
    known = {"category", "polygons", "holes"} | ({"is_support"} if is_object else set())
    region = _fields(value, name, field, known)
    category = _text(region, name, "category", field)
    if not is_object and category not in STRUCTURE:
        raise InputError(name, f"{field}.category", f"is no structure: {category!r}", f"one of {', '.join(STRUCTURE)}")
    is_support = region.get("is_support", None if is_object else False)
    if not isinstance(is_support, bool):
        raise InputError(name, f"{field}.is_support", "must be true or false", "say whether others stand on it")
    polygons = tuple(_polygon(each, name, inner, size) for inner, each in _listed(region, name, "polygons", field))
    if not polygons:
        raise InputError(name, f"{field}.polygons", "is empty", _AGAIN)
    holes = _listed({"holes": [], **region}, name, "holes", field)
    return DrawnRegion(category, polygons, tuple(_polygon(each, name, inner, size) for inner, each in holes), is_support)


def _polygon(value: Any, name: str, field: str, size: tuple[int, int]) -> Array:
    """Corners [px], shape (n, 2)."""
    from shapely.geometry import Polygon

    if not isinstance(value, list) or len(value) < 3 or not all(isinstance(point, list) and len(point) == 2 for point in value):
        raise InputError(name, field, "must be a list of three points [x, y] or more", _AGAIN)
    for coordinate in (each for point in value for each in point):
        if type(coordinate) not in (int, float) or not math.isfinite(coordinate) or 2 * coordinate % 1:
            raise InputError(name, field, f"has {coordinate!r}, which is no whole or half number", "round it to a half")
    corners = np.array(value, dtype=float)
    if corners.min() < 0 or (corners > size).any():
        raise InputError(name, field, f"leaves the frame of {size[0]} x {size[1]} pixels", _AGAIN)
    if not Polygon(corners).is_valid:
        raise InputError(name, field, "crosses or touches itself, or has no area", "draw two polygons")
    return corners


def _size(value: Any, name: str) -> tuple[int, int]:
    if not isinstance(value, list) or [type(each) for each in value] != [int, int] or min(value) < 1:
        raise InputError(name, "size", "must be [w, h], whole numbers from 1", "give those of the frame")
    width, height = value
    if width * height > BUDGET.pixels:
        raise InputError(name, "size", f"is {width * height} pixels, more than {BUDGET.pixels}", "give that of the frame")
    return width, height


def _fields(value: Any, name: str, field: str, known: set[str]) -> dict[str, Any]:
    """An object of JSON without unknown fields: a misspelled one would be lost in silence."""
    if not isinstance(value, dict):
        raise InputError(name, field, f"must be an object, is a {type(value).__name__}", _AGAIN)
    unknown = sorted(set(value) - known)
    if unknown:
        raise InputError(
            name, ".".join(filter(None, [field, unknown[0]])), "is no field of a drawing", f"one of {', '.join(sorted(known))}"
        )
    return value


def _text(document: dict[str, Any], name: str, key: str, within: str = "") -> str:
    value = document.get(key)
    if not isinstance(value, str) or not value.strip():
        raise InputError(name, ".".join(filter(None, [within, key])), "must be a text", "write it down")
    return value


def _listed(document: dict[str, Any], name: str, key: str, within: str = "") -> list[tuple[str, Any]]:
    """The values of a list, each with what errors call it."""
    value, field = document.get(key), ".".join(filter(None, [within, key]))
    if not isinstance(value, list):
        raise InputError(name, field, f"must be a list, is {'missing' if value is None else f'a {type(value).__name__}'}", _AGAIN)
    return [(f"{field}[{number}]", each) for number, each in enumerate(value)]
