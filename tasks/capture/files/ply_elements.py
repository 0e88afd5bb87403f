"""Content of a PLY of any kind: columns of its elements, triangles of its polygons, and colors of its vertices."""

from __future__ import annotations

import dataclasses
import re
import struct
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.ply_header import PlyElement
from tasks.capture.files.polygons import triangulate
from tasks.geometry.meshes import sample_texture

GRAY = 180
"""Gray level of vertices without a color."""

MAX_UNIT_COLOR = 2.0
"""Floats up to this are on a scale of 1: some renderers write highlights above it, and on a scale of 255 all would be black."""

_PREFIXES = ("", "diffuse_", "vertex_", "color_", "ambient_")
_CHANNELS = (("red", "green", "blue"), ("r", "g", "b"))
_COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("tx", "ty"), ("texture_s", "texture_t"))
_INDICES = ("vertex_indices", "vertex_index")


@dataclasses.dataclass(frozen=True)
class PlyColumn:
    """A property of all rows of an element. values: Shape (n,), or all items of a list. kind: Type in the header, as `u1`.
    counts: Items of each row of a list, shape (n,); None for a single value."""

    values: NDArray[np.generic]
    kind: str
    counts: NDArray[np.int64] | None = None


Columns = Mapping[str, PlyColumn]


def read_elements(data: bytes, start: int, order: str, elements: list[PlyElement]) -> dict[str, dict[str, PlyColumn]]:
    """Columns of each element by name. order: Byte order, '' for text. start: Where the content begins.

    Raises:
        ValueError: the content is cut, or is not what the header states.
    """
    content: dict[str, dict[str, PlyColumn]] = {}
    words = data[start:].split() if not order else []
    at = 0 if not order else start
    for element in elements:
        if not element.fields:
            continue
        if order:
            columns, at = _binary_rows(data, at, order, element)
        else:
            columns, at = _text_rows(words, at, order, element)
        content.setdefault(element.name, columns)
    return content


def _text_rows(words: list[bytes], at: int, order: str, element: PlyElement) -> tuple[dict[str, PlyColumn], int]:
    """Columns of an element in a text, and the first word behind it."""
    if not any(len(field) == 3 for field in element.fields):
        width = len(element.fields)
        end = at + element.count * width
        _check_end(end, len(words), element)
        table = _numbers(words[at:end]).reshape(element.count, width)
        return {field[0]: PlyColumn(table[:, i], field[1]) for i, field in enumerate(element.fields)}, end
    items: list[list[bytes]] = [[] for _ in element.fields]
    counts: list[list[int]] = [[] for _ in element.fields]
    for _ in range(element.count):
        for i, field in enumerate(element.fields):
            _check_end(at + 1, len(words), element)
            count = int(words[at]) if len(field) == 3 else 1
            at += len(field) == 3
            if count < 0:
                raise ValueError(f"element {element.name} has a list of {count} items")
            _check_end(at + count, len(words), element)
            items[i] += words[at : at + count]
            counts[i].append(count)
            at += count
    return {
        field[0]: PlyColumn(_numbers(items[i]), field[-1], np.array(counts[i], np.int64) if len(field) == 3 else None)
        for i, field in enumerate(element.fields)
    }, at


def _binary_rows(data: bytes, at: int, order: str, element: PlyElement) -> tuple[dict[str, PlyColumn], int]:
    """Columns of an element in bytes, and the first byte behind it."""
    whole = _equal_rows(data, at, order, element)
    if whole is not None:
        return whole
    readers = [
        (struct.Struct(order + _FORMATS[field[1]]).unpack_from, int(field[1][1]), int(field[2][1]) if len(field) == 3 else 0)
        for field in element.fields
    ]
    starts: list[list[int]] = [[] for _ in readers]
    counts: list[list[int]] = [[] for _ in readers]
    for _ in range(element.count):
        for i, (unpack, size, item) in enumerate(readers):
            _check_end(at + size, len(data), element)
            count = 1
            if item:
                count = int(unpack(data, at)[0])
                if count < 0:
                    raise ValueError(f"element {element.name} has a list of {count} items")
                at += size
            starts[i].append(at)
            counts[i].append(count)
            at += count * (item or size)
    _check_end(at, len(data), element)
    raw = np.frombuffer(data, np.uint8)
    columns = {}
    for i, field in enumerate(element.fields):
        size, number = int(field[-1][1]), np.array(counts[i], np.int64)
        first = np.repeat(np.array(starts[i], np.int64), number)
        inner = np.arange(len(first)) - np.repeat(np.cumsum(number) - number, number)
        places = (first + inner * size)[:, None] + np.arange(size)
        values = np.ascontiguousarray(raw[places]).view(order + field[-1]).ravel()
        columns[field[0]] = PlyColumn(values, field[-1], number if len(field) == 3 else None)
    return columns, at


_FORMATS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}


def _equal_rows(data: bytes, at: int, order: str, element: PlyElement) -> tuple[dict[str, PlyColumn], int] | None:
    """Columns of an element whose rows all have lists as long as those of the first; None for others."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    place = at
    for i, field in enumerate(element.fields):
        if len(field) < 3:
            fields.append((f"v{i}", order + field[1]))
            place += int(field[1][1])
            continue
        size = int(field[1][1])
        if not element.count or place + size > len(data):
            return None
        count = int(np.frombuffer(data, order + field[1], 1, place)[0])
        if not 0 <= count <= len(data):
            return None
        fields += [(f"n{i}", order + field[1]), (f"v{i}", order + field[2], (count,))]
        place += size + count * int(field[2][1])
    width = place - at
    end = at + width * element.count
    if end > len(data):
        return None
    rows = np.frombuffer(data, np.dtype(fields), element.count, at)
    columns = {}
    for i, field in enumerate(element.fields):
        counts = None
        if len(field) == 3:
            counts = rows[f"n{i}"].astype(np.int64)
            if (counts != counts[0]).any():
                return None
        columns[field[0]] = PlyColumn(rows[f"v{i}"].reshape(-1), field[-1], counts)
    return columns, end


def _check_end(end: int, available: int, element: PlyElement) -> None:
    if end > available:
        raise ValueError(f"element {element.name} declares {element.count} rows, but the file ends before")


def _numbers(words: list[bytes]) -> NDArray[np.float64]:
    return np.array([float(word) for word in words], dtype=np.float64)


@dataclasses.dataclass(frozen=True)
class Triangles:
    """Triangles of polygons. faces: Vertices, shape (m, 3). owner: Polygon of each triangle, shape (m,). corners: Positions of its
    corners among those of all polygons, shape (m, 3). notes: Polygons that are not exact, a line each."""

    faces: NDArray[np.int64]
    owner: NDArray[np.int64]
    corners: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def triangles_of(column: PlyColumn, vertices: NDArray[np.float64]) -> Triangles:
    """Triangles of polygons; lists of fewer than three vertices have none.

    vertices: Positions, shape (n, 3); polygons that name others are left to the caller.
    """
    assert column.counts is not None
    with np.errstate(invalid="ignore"):
        indices = column.values.astype(np.int64)
    known = np.clip(indices, 0, max(len(vertices) - 1, 0))
    triangles = triangulate(vertices[known] if len(vertices) else np.zeros((len(known), 3)), column.counts)
    return Triangles(indices[triangles.corners].reshape(-1, 3), triangles.owner, triangles.corners, triangles.notes)


def index_column(columns: Columns) -> PlyColumn | None:
    """The lists of vertices among the properties of faces; None without any."""
    return next((columns[name] for name in _INDICES if name in columns and columns[name].counts is not None), None)


def color_names(names: Mapping[str, object] | set[str]) -> tuple[str, ...] | None:
    """Names of the three color properties among those of an element; None without them."""
    lower = {name.lower(): name for name in names}
    for prefix in _PREFIXES:
        for channels in _CHANNELS:
            if all(prefix + channel in lower for channel in channels):
                return tuple(lower[prefix + channel] for channel in channels)
    return None


def has_face_colors(fields: tuple[tuple[str, ...], ...]) -> bool:
    """True if faces have colors of their own among their properties."""
    return color_names({field[0] for field in fields if len(field) < 3}) is not None


def as_bytes(values: NDArray[np.generic], kind: str) -> NDArray[np.uint8]:
    """Colors on a scale of 255. The type states the scale of whole numbers; wide types often hold bytes, as their maximum tells."""
    numbers = np.nan_to_num(np.asarray(values, dtype=np.float64), posinf=0.0, neginf=0.0)
    top = float(numbers.max(initial=0.0))
    if kind[0] == "f":
        scale = 1.0 if top <= MAX_UNIT_COLOR else 255.0 if top <= 255.0 else 65535.0
    elif kind in ("u1", "i1") or top <= 255.0:
        scale = 255.0
    else:
        scale = {"u2": 65535.0, "i2": 32767.0}.get(kind, 65535.0 if top <= 65535.0 else float(np.iinfo(np.dtype(kind)).max))
    return np.rint(np.clip(numbers / scale, 0.0, 1.0) * 255.0).astype(np.uint8)


def vertex_colors_of(
    content: Mapping[str, Columns], count: int, triangles: Triangles, image: Callable[[int], NDArray[np.uint8] | None]
) -> NDArray[np.uint8]:
    """Color of each vertex, shape (count, 3): of its image, otherwise its own, otherwise that of its first corner or face.

    image: Texture by its number, shape (h, w, 3), None for one that is not there.
    """
    vertex, face = content.get("vertex", {}), content.get("face", {})
    own = _single_colors(vertex)
    colors = np.full((count, 3), GRAY, np.uint8) if own is None else own
    corner = _textured(vertex, face, triangles, image)
    if corner is None and own is None:
        corner = _corner_colors(face, triangles)
    if corner is not None:
        is_known = corner[1]
        order = np.flatnonzero(is_known)[::-1]  # the first of a vertex's corners stays
        colors[triangles.faces.ravel()[order]] = corner[0][order]
    return colors


def _single_colors(columns: Columns) -> NDArray[np.uint8] | None:
    names = color_names({name for name, column in columns.items() if column.counts is None})
    if names is None:
        return None
    return as_bytes(np.stack([columns[name].values for name in names], axis=1), columns[names[0]].kind)


_Corners = tuple[NDArray[np.uint8], NDArray[np.bool_]]
"""Colors of all corners of triangles, shape (3 m, 3), and those that have one, shape (3 m,)."""


def _corner_colors(face: Columns, triangles: Triangles) -> _Corners | None:
    """Colors that faces or their corners have."""
    indices = index_column(face)
    of_face = _single_colors(face)
    if of_face is not None:
        return np.repeat(of_face[triangles.owner], 3, axis=0), np.ones(triangles.faces.size, np.bool_)
    for name, column in face.items():
        if indices is None or indices.counts is None or column.counts is None or not re.fullmatch(r"(?i)(vertex_|wedge_)?colou?rs?", name):
            continue
        for channels in (3, 4):
            if np.array_equal(column.counts, channels * indices.counts):
                corners = as_bytes(column.values.reshape(-1, channels)[:, :3], column.kind)
                return corners[triangles.corners.ravel()], np.ones(triangles.faces.size, np.bool_)
    return None


def _textured(
    vertex: Columns, face: Columns, triangles: Triangles, image: Callable[[int], NDArray[np.uint8] | None]
) -> _Corners | None:  # fmt: skip
    """Colors of images at the texture coordinates of corners or vertices."""
    uv = _coordinates(vertex, face, triangles)
    if uv is None:
        return None
    number = np.zeros(len(triangles.faces), np.int64)
    if "texnumber" in face and face["texnumber"].counts is None:
        number = np.nan_to_num(face["texnumber"].values.astype(np.float64)).astype(np.int64)[triangles.owner]
    colors, is_known = np.zeros((len(uv), 3), np.uint8), np.zeros(len(uv), np.bool_)
    for each in np.unique(number):
        pixels = image(int(each))
        if pixels is not None:
            here = np.repeat(number == each, 3)
            colors[here], is_known[here] = sample_texture(pixels, uv[here], np.ones(3)), True
    return (colors, is_known) if is_known.any() else None


def _coordinates(vertex: Columns, face: Columns, triangles: Triangles) -> NDArray[np.float64] | None:
    """Texture coordinates of all corners of triangles, shape (3 m, 2)."""
    indices, lists = index_column(face), face.get("texcoord")
    counts = None if indices is None else indices.counts
    if lists is not None and lists.counts is not None and counts is not None and np.array_equal(lists.counts, 2 * counts):
        uv = lists.values.astype(np.float64).reshape(-1, 2)[triangles.corners.ravel()]
    else:
        names = next((pair for pair in _COORDINATES if all(name in vertex and vertex[name].counts is None for name in pair)), None)
        if names is None:
            return None
        uv = np.stack([vertex[name].values.astype(np.float64) for name in names], axis=1)[triangles.faces.ravel()]
    return np.clip(np.nan_to_num(uv), -1e6, 1e6)
