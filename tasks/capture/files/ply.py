"""Triangle meshes from PLY, checked before anything is allocated."""

from __future__ import annotations

import dataclasses
import io
import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file, read_file
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.named import Folders
from tasks.capture.files.ply_elements import (
    GRAY,
    Columns,
    Triangles,
    as_bytes,
    color_names,
    has_face_colors,
    index_column,
    read_elements,
    triangles_of,
    vertex_colors_of,
)
from tasks.capture.files.ply_header import AGAIN, PlyElement, check_counts, header
from tasks.capture.files.survey import offset_error
from tasks.geometry.meshes import Surface

MAX_EXTENT_M = 200.0
"""Larger than any building that a hand-held scan covers; beyond it the unit is not the metre, or a vertex is broken."""

MAX_OFFSET_M = 10_000.0
"""Scans may lie away from their origin, but float32 keeps millimetres only up to about ten kilometres."""


@dataclasses.dataclass(frozen=True)
class ReadPly:
    """A mesh and the losses of its reading, a line each."""

    surface: Surface
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class LabelledPly:
    """A mesh and an integer for each of its vertices or triangles. labels: Shape (n,) or (m,). notes: Losses, a line each."""

    surface: Surface
    labels: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def read_ply(path: Path, name: str, is_in_metres: bool = True) -> ReadPly:
    """The triangles of a PLY in the file's frame and unit, with colors of its image, vertices, corners or faces, otherwise gray.

    is_in_metres: True if the unit is the metre; the size is checked then.

    Raises:
        InputError: truncated, no triangles, too many faces, coordinates that are not finite or not in metres,
            a face that names a missing vertex.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes, b"ply")
    order, elements, start = _mesh_header(data, name)
    images = texture_names(data)
    columns = None if images else _binary(data, start, order, elements, name)
    notes: tuple[str, ...] = ()
    if columns is None:
        polygons = _polygons(data, start, order, elements, path, name)
        columns, notes = (polygons.vertices, polygons.triangles.faces, polygons.colors), polygons.notes
    vertices, faces, colors = columns
    if is_in_metres:
        check_vertices(vertices, name)
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        row = int(np.flatnonzero(bad.any(axis=1))[0])
        raise InputError(name, f"face {row}", f"names a vertex that does not exist, of {len(vertices)}", AGAIN)
    return ReadPly(Surface(vertices, faces, colors), notes)


def read_labelled_ply(path: Path, name: str, element: str, field: str) -> LabelledPly:
    """The triangles of a PLY in the file's frame [m], and a property of its vertices or faces as integers.

    element: `vertex` or `face`. Each triangle of a polygon has the value of the polygon.

    Raises:
        InputError: see `read_ply`; or the element has no such property, or its values are not integers.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes, b"ply")
    order, elements, start = _mesh_header(data, name)
    polygons = _polygons(data, start, order, elements, path, name)
    check_vertices(polygons.vertices, name)
    columns = polygons.content[element]
    if field not in columns or columns[field].counts is not None:
        has = ", ".join(sorted(key for key, column in columns.items() if column.counts is None)) or "none"
        raise InputError(name, f"element {element}", f"has no property {field}, only {has}", "use the mesh that the set has for labels")
    labels = _integers(columns[field].values, name, field)
    surface = Surface(polygons.vertices, polygons.triangles.faces, polygons.colors)
    return LabelledPly(surface, labels[polygons.triangles.owner] if element == "face" else labels, polygons.notes)


def _mesh_header(data: bytes, name: str) -> tuple[str, list[PlyElement], int]:
    """Byte order, elements and start of the content of a PLY with vertices and faces."""
    order, elements, start = header(data, name)
    check_counts(data, name)
    counts = {element.name: element.count for element in elements}
    if counts.get("vertex", 0) < 3:
        raise InputError(name, "element vertex", f"has {counts.get('vertex', 0)} vertices, a mesh needs 3", AGAIN)
    if counts.get("face", 0) < 1:
        raise InputError(name, "element face", "the mesh has no faces", "export the scan as a triangle mesh")
    return order, elements, start


def _integers(values: NDArray[np.generic], name: str, field: str) -> NDArray[np.int64]:
    if values.dtype.kind == "f" and not (
        np.isfinite(values).all() and (np.abs(values) < 2**53).all() and (values == np.floor(values)).all()
    ):
        raise InputError(name, field, "has values that are no integers", "is it the right file?")
    return values.astype(np.int64)


def texture_names(data: bytes) -> list[str]:
    """Images that comments of a header name, in their order."""
    head = data[: max(data.find(b"end_header", 0, 65536), 0)].decode("utf-8", "replace")
    return [match[1].strip() for match in re.finditer(r"(?im)^comment[ \t]+TextureFile[ \t]*[:=]?[ \t]*([^\r\n]+)", head)]


def texture_files(path: Path, root: Path) -> list[Path]:
    """Images inside `root` that a PLY names, sorted; empty for files without a header."""
    try:
        with open_file(path, path.name, BUDGET.scene_bytes) as file:
            names = texture_names(file.read(65536))
    except (InputError, OSError):
        return []
    folders = Folders(root)
    found_files = (folders.find((name,), path.parent, path.parent) for name in names)
    return sorted({image for image in found_files if image is not None})


def check_vertices(vertices: NDArray[np.float64], name: str) -> None:
    """Raise InputError unless vertices, shape (n, 3), are finite and span a plausible number of metres."""
    finite = np.isfinite(vertices)
    if not finite.all():
        row, axis = (int(v) for v in np.argwhere(~finite)[0])
        count = int((~finite).any(axis=1).sum())
        raise InputError(name, f"vertex {row}", f"{'xyz'[axis]} is {vertices[row, axis]} ({count} such vertices)", AGAIN)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float((high - low).max())
    offset = float(np.abs(low / 2 + high / 2).max())
    if extent <= MAX_EXTENT_M and offset > MAX_OFFSET_M:
        raise offset_error(name, offset, MAX_OFFSET_M)
    if extent > MAX_EXTENT_M:
        remedy = "scale the mesh to metres, or remove stray vertices"
        raise InputError(name, "vertex", f"spans {extent:.4g} m, more than {MAX_EXTENT_M:g}", remedy)
    if extent < 0.1:
        raise InputError(name, "vertex", f"spans {extent:.4g} m, less than any room", "scale the mesh to metres")


def _binary(
    data: bytes, start: int, order: str, elements: list[PlyElement], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]] | None:
    """Vertices, triangles and colors of a binary PLY whose faces are all triangles; None for any other kind."""
    if not order:
        return None
    vertices = faces = None
    for element in elements:
        is_face = element.name == "face"
        if not is_face and any(len(field) == 3 for field in element.fields):
            if vertices is not None and faces is not None:
                break
            return None
        kinds: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for index, field in enumerate(element.fields):
            if len(field) == 3:
                kinds += [(f"count{index}", order + field[1]), (f"items{index}", order + field[2], (3,))]
            else:
                kinds.append((f"value{index}", order + field[1]))
        dtype = np.dtype(kinds)
        size = element.count * dtype.itemsize
        available = len(data) - start
        lists = [index for index, field in enumerate(element.fields) if len(field) == 3]
        shortest = dtype.itemsize - sum(np.dtype(element.fields[i][2]).itemsize * 3 for i in lists)
        if element.count * shortest > available:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, but the file ends before", AGAIN)
        if size > available:
            if lists and not _all_triangles(data[start : start + available // max(dtype.itemsize, 1) * dtype.itemsize], dtype, lists):
                return None
            held = available // dtype.itemsize
            raise InputError(name, f"element {element.name}", f"declares {element.count}, but the file ends after {held}", AGAIN)
        rows = np.frombuffer(data, dtype=dtype, count=element.count, offset=start)
        if is_face:
            wanted = [i for i in lists if element.fields[i][0] in ("vertex_indices", "vertex_index")]
            if len(lists) != 1 or len(wanted) != 1 or not (rows[f"count{lists[0]}"] == 3).all():
                return None
            if has_face_colors(element.fields):
                return None
            faces = rows[f"items{wanted[0]}"].astype(np.int64)
        elif element.name == "vertex":
            vertices = (rows, element)
        start += size
    if vertices is None or faces is None:
        return None
    rows, element = vertices
    places = {field[0]: f"value{index}" for index, field in enumerate(element.fields)}
    return _coordinates(rows, places, name), faces, _colors(rows, places)


def _all_triangles(data: bytes, dtype: np.dtype[np.void], lists: list[int]) -> bool:
    rows = np.frombuffer(data, dtype=dtype)
    return all((rows[f"count{i}"] == 3).all() for i in lists)


def _coordinates(rows: NDArray[np.void], places: dict[str, str], name: str) -> NDArray[np.float64]:
    missing = [axis for axis in "xyz" if axis not in places]
    if missing:
        raise InputError(name, "element vertex", f"has no property {missing[0]}", AGAIN)
    with np.errstate(invalid="ignore"):  # a signaling NaN is no number, and is told as one
        return np.stack([rows[places[axis]] for axis in "xyz"], axis=1).astype(np.float64)


def _colors(rows: NDArray[np.void], places: dict[str, str]) -> NDArray[np.uint8]:
    names = color_names(places)
    if names is None:
        return np.full((len(rows), 3), GRAY, dtype=np.uint8)
    values = np.stack([rows[places[channel]] for channel in names], axis=1)
    return as_bytes(values, rows[places[names[0]]].dtype.str[1:])


@dataclasses.dataclass(frozen=True)
class _Polygons:
    """Content of a PLY of any kind. vertices: Shape (n, 3). colors: Shape (n, 3). notes: Losses, a line each."""

    content: Mapping[str, Columns]
    vertices: NDArray[np.float64]
    triangles: Triangles
    colors: NDArray[np.uint8]
    notes: tuple[str, ...]


def _polygons(data: bytes, start: int, order: str, elements: list[PlyElement], path: Path, name: str) -> _Polygons:
    """A PLY of any kind: text, polygons, images, colors of faces or corners."""
    try:
        content = read_elements(data, start, order, elements)
    except (ValueError, OverflowError) as error:
        raise InputError(name, "content", f"is cut or broken ({str(error)[:120]})", AGAIN) from error
    vertex = content.get("vertex", {})
    missing = [axis for axis in "xyz" if axis not in vertex or vertex[axis].counts is not None]
    if missing:
        raise InputError(name, "element vertex", f"has no property {missing[0]}", AGAIN)
    indices = index_column(content.get("face", {}))
    if indices is None:
        raise InputError(name, "element face", "has no list of vertices", "export the scan as a triangle mesh")
    with np.errstate(invalid="ignore"):  # a signaling NaN is not a number, and is reported as one
        vertices = np.stack([vertex[axis].values for axis in "xyz"], axis=1).astype(np.float64)
    triangles = triangles_of(indices, vertices)
    if not len(triangles.faces):
        raise InputError(name, "element face", "the mesh has no triangles", "export the scan as a triangle mesh")
    if len(triangles.faces) > BUDGET.faces:
        raise InputError(name, "element face", f"has {len(triangles.faces)} triangles, more than {BUDGET.faces}", "decimate the mesh")
    outside = (triangles.faces < 0) | (triangles.faces >= len(vertices))
    if outside.any():
        row = int(triangles.owner[np.flatnonzero(outside.any(axis=1))[0]])
        raise InputError(name, f"face {row}", f"names a vertex that does not exist, of {len(vertices)}", AGAIN)
    images = PlyImages(path, texture_names(data))
    colors = vertex_colors_of(content, len(vertices), triangles, images.read)
    notes = (*images.notes, *(f"{path.name}: {note}" for note in triangles.notes))
    return _Polygons(content, vertices, triangles, colors, notes)


class PlyImages:
    """Images that a PLY names, read from its folder."""

    def __init__(self, path: Path, names: list[str]) -> None:
        self._path, self._names = path, names
        self._used: set[int] = set()
        self._faults: list[str] = []

    @property
    def notes(self) -> list[str]:
        """Images that are missing, cannot be decoded, or are not used by any triangle, a line each."""
        unused = [name for number, name in enumerate(self._names) if number not in self._used]
        return [*self._faults, *(f"{self._path.name}: {name} is not used: no texture coordinates belong to it" for name in unused)]

    def read(self, number: int) -> NDArray[np.uint8] | None:
        """Pixels of an image by its number, shape (h, w, 3); None for one that is not there."""
        from PIL import Image

        if not 0 <= number < len(self._names):
            return None
        self._used.add(number)
        file = Folders(self._path.parent).find((self._names[number],), self._path.parent, self._path.parent)
        if file is None:
            self._faults.append(f"{self._path.name}: {self._names[number]} is missing, drawn without it")
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the size is checked below
                image = Image.open(io.BytesIO(read_file(file, file.name, BUDGET.image_bytes)))
                if image.size[0] * image.size[1] > BUDGET.pixels:
                    raise ValueError(f"more than {BUDGET.pixels} pixels")
                return np.asarray(image.convert("RGB"))
        except Exception:  # the decoder raises whatever the bytes lead it to
            self._faults.append(f"{self._path.name}: {file.name} cannot be decoded, drawn without it")
            return None
