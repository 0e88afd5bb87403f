"""Triangles of a PLY with an integer for each of its faces or vertices: the object that it is of."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.ply_header import AGAIN, PlyElement, check_counts, header
from tasks.geometry.meshes import Surface

Column = NDArray[np.generic]

CORNERS = ("vertex_indices", "vertex_index")


@dataclasses.dataclass(frozen=True)
class _Rows:
    """An element's rows. columns: Plain properties, shape (n,). lists: List properties, shape (n, k) each."""

    columns: dict[str, Column]
    lists: dict[str, Column]


def read_labelled_ply(path: Path, name: str, element: str, field: str) -> tuple[Surface, NDArray[np.int64]]:
    """The surface of a PLY of triangles or of quads in the file's frame [m], and a property of its faces or vertices as integers.

    element: `face` or `vertex`. A quad becomes two triangles, both with its value: values have shape (m,) or (n,), as the surface.

    Raises:
        InputError: cut or broken, no triangles or quads, no such property, or more than the budget.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes, b"ply")
    order, elements, start = header(data, name)
    check_counts(data, name)
    rows = _binary(data, start, order, elements, name) if order else _text(data, start, elements, name)
    for wanted in ("vertex", "face"):
        if wanted not in rows:
            raise InputError(name, f"element {wanted}", "is missing", "use the mesh that the set has for labels")
    if field not in rows[element].columns:
        has = ", ".join(sorted(rows[element].columns)) or "none"
        raise InputError(name, f"element {element}", f"has no property {field}, only {has}", "use the mesh that the set has for labels")
    vertices = _vertices(rows["vertex"], name)
    faces = _corners(rows["face"], name)
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        row = int(np.flatnonzero(bad.any(axis=1))[0])
        raise InputError(name, f"face {row}", f"names a vertex that does not exist, of {len(vertices)}", AGAIN)
    values = _whole(rows[element].columns[field], name, field)
    if faces.shape[1] == 4:
        faces = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        values = np.repeat(values, 2) if element == "face" else values
    return Surface(vertices, faces, _colors(rows["vertex"])), values


def _binary(data: bytes, start: int, order: str, elements: list[PlyElement], name: str) -> dict[str, _Rows]:
    rows_of: dict[str, _Rows] = {}
    for element in elements:
        lengths = _first_lengths(data, start, order, element, name)
        kinds: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for index, field in enumerate(element.fields):
            if len(field) == 3:
                kinds += [(f"count{index}", order + field[1]), (f"value{index}", order + field[2], (lengths[index],))]
            else:
                kinds.append((f"value{index}", order + field[1]))
        dtype = np.dtype(kinds)
        if element.count * dtype.itemsize > len(data) - start:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, but the file ends before", AGAIN)
        table = np.frombuffer(data, dtype=dtype, count=element.count, offset=start)
        if any((table[f"count{index}"] != length).any() for index, length in lengths.items()):
            raise _mixed(element, name)
        start += element.count * dtype.itemsize
        rows_of[element.name] = _rows(element, {index: table[f"value{index}"] for index in range(len(element.fields))})
    return rows_of


def _first_lengths(data: bytes, start: int, order: str, element: PlyElement, name: str) -> dict[int, int]:
    """How long the lists of an element's first row are, by the number of the field."""
    lengths: dict[int, int] = {}
    for index, field in enumerate(element.fields if element.count else ()):
        kind = np.dtype(order + field[1])
        if len(data) - start < kind.itemsize:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, but the file ends before", AGAIN)
        if len(field) == 3:
            length = int(np.frombuffer(data, kind, 1, start)[0]) if kind.kind in "iu" else -1
            if not 0 <= length <= _LONGEST:
                raise _mixed(element, name)
            lengths[index] = length
            start += length * np.dtype(field[2]).itemsize
        start += kind.itemsize
    return lengths or {index: 3 for index, field in enumerate(element.fields) if len(field) == 3}


_LONGEST = 64
"""Corners of a face; lists of other elements, too, are no longer in files that have labels."""


def _text(data: bytes, start: int, elements: list[PlyElement], name: str) -> dict[str, _Rows]:
    lines = [line for line in data[start:].split(b"\n") if line.strip()]
    rows_of: dict[str, _Rows] = {}
    for element in elements:
        own, lines = lines[: element.count], lines[element.count :]
        if len(own) < element.count:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, but the file ends after {len(own)}", AGAIN)
        try:
            table = np.loadtxt(own, ndmin=2) if own else np.zeros((0, len(element.fields)))
        except ValueError as error:
            raise _mixed(element, name) from error
        values: dict[int, Column] = {}
        at = 0
        for index, field in enumerate(element.fields):
            length = 1
            if len(field) == 3:
                counts = table[:, at] if at < table.shape[1] and len(table) else np.zeros(0)
                length = int(counts[0]) if len(counts) and 0 <= counts[0] <= _LONGEST else 0
                if (counts != length).any():
                    raise _mixed(element, name)
                at += 1
            part = table[:, at : at + length]
            values[index] = part if len(field) == 3 else part.ravel()
            at += length
        if len(own) and at != table.shape[1]:
            problem = f"rows have {table.shape[1]} numbers, {at} are declared"
            raise InputError(name, f"element {element.name}", problem, AGAIN)
        rows_of[element.name] = _rows(element, values)
    return rows_of


def _rows(element: PlyElement, values: dict[int, Column]) -> _Rows:
    named = {field[0]: (field, values[index]) for index, field in enumerate(element.fields)}
    plain = {key: value for key, (field, value) in named.items() if len(field) == 2}
    return _Rows(plain, {key: value for key, (field, value) in named.items() if len(field) == 3})


def _mixed(element: PlyElement, name: str) -> InputError:
    problem = "is broken, or its lists have different lengths"
    return InputError(name, f"element {element.name}", problem, "export the mesh as triangles or as quads")


def _vertices(rows: _Rows, name: str) -> NDArray[np.float64]:
    missing = [axis for axis in "xyz" if axis not in rows.columns]
    if missing:
        raise InputError(name, "element vertex", f"has no property {missing[0]}", AGAIN)
    vertices = np.stack([rows.columns[axis] for axis in "xyz"], axis=1).astype(np.float64)
    if len(vertices) < 3:
        raise InputError(name, "element vertex", f"has {len(vertices)} vertices, a mesh needs 3", AGAIN)
    check_vertices(vertices, name)
    return vertices


def _corners(rows: _Rows, name: str) -> NDArray[np.int64]:
    corners = next((rows.lists[key] for key in CORNERS if key in rows.lists), None)
    if corners is None or not len(corners) or corners.shape[1] not in (3, 4):
        raise InputError(name, "element face", "has no triangles or quads", "export the mesh as triangles or as quads")
    return _whole(corners, name, "vertex_indices")


def _whole(values: Column, name: str, field: str) -> NDArray[np.int64]:
    """Numbers as integers; raises InputError where they are none."""
    if values.dtype.kind == "f" and not (
        np.isfinite(values).all() and (np.abs(values) < 2**53).all() and (values == np.floor(values)).all()
    ):
        raise InputError(name, field, "has values that are no integers", "is it the right file?")
    return values.astype(np.int64)


def _colors(rows: _Rows) -> NDArray[np.uint8]:
    """RGB of each vertex, gray where the file has none; those of text and of bytes are 0 to 255."""
    channels = [rows.columns.get(channel) for channel in ("red", "green", "blue")]
    if any(channel is None for channel in channels):
        return np.full((len(rows.columns["x"]), 3), 180, dtype=np.uint8)
    values = np.nan_to_num(np.stack([np.asarray(channel, dtype=np.float64) for channel in channels], axis=1))
    return np.clip(values, 0, 255).astype(np.uint8)
