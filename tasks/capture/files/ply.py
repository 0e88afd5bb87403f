"""Triangle meshes from PLY, checked before anything is allocated."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.geometry.meshes import Surface

MAX_EXTENT_M = 200.0
"""Larger than any building that a hand-held scan covers; beyond it the unit is not the metre, or a vertex is broken."""

MAX_OFFSET_M = 10_000.0
"""Scans may lie away from their origin, but float32 keeps millimetres only up to about ten kilometres."""

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip

_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

AGAIN = "copy or export the mesh again"


@dataclasses.dataclass(frozen=True)
class PlyElement:
    """An element of the header: its fields as (name, dtype), a list field as (name, count dtype, item dtype)."""

    name: str
    count: int
    fields: tuple[tuple[str, ...], ...]


def read_ply(path: Path, name: str, is_in_metres: bool = True) -> Surface:
    """The triangles of a PLY, with vertex colors (grey where it has none), in the file's frame and unit. is_in_metres: Its unit is the
    metre, and it is held against the size of a scan.

    Raises:
        InputError: truncated, no triangles, too many faces, coordinates that are not finite or not in metres,
            a face that names a missing vertex.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes, b"ply")
    order, elements, start = header(data, name)
    check_counts(data, name)
    counts = {element.name: element.count for element in elements}
    if counts.get("vertex", 0) < 3:
        raise InputError(name, "element vertex", f"has {counts.get('vertex', 0)} vertices, a mesh needs 3", AGAIN)
    if counts.get("face", 0) < 1:
        raise InputError(name, "element face", "the mesh has no faces", "export the scan as a triangle mesh")
    columns = _binary(data, start, order, elements, name)
    if columns is None:
        columns = _by_library(data, name)
    vertices, faces, colors = columns
    if is_in_metres:
        check_vertices(vertices, name)
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        row = int(np.flatnonzero(bad.any(axis=1))[0])
        raise InputError(name, f"face {row}", f"names a vertex that does not exist, of {len(vertices)}", AGAIN)
    return Surface(vertices, faces, colors)


def check_counts(data: bytes, name: str) -> None:
    """Raise InputError when a PLY declares more of anything than the budget has, or its header cannot be read."""
    for element in header(data, name)[1]:
        most = BUDGET.faces if element.name == "face" else BUDGET.vertices
        if element.count > most:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, more than {most}", "decimate the mesh")


def check_vertices(vertices: NDArray[np.float64], name: str) -> None:
    """Raise InputError unless vertices, shape (n, 3), are finite and span a plausible number of metres."""
    finite = np.isfinite(vertices)
    if not finite.all():
        row, axis = (int(v) for v in np.argwhere(~finite)[0])
        count = int((~finite).any(axis=1).sum())
        raise InputError(name, f"vertex {row}", f"{'xyz'[axis]} is {vertices[row, axis]} ({count} such vertices)", AGAIN)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float((high - low).max())
    if extent > MAX_EXTENT_M or max(-low.min(), high.max()) > MAX_OFFSET_M:
        remedy = "scale the mesh to metres, or remove stray vertices"
        raise InputError(name, "vertex", f"spans {extent:.4g} m, more than {MAX_EXTENT_M:g}", remedy)
    if extent < 0.1:
        raise InputError(name, "vertex", f"spans {extent:.4g} m, less than any room", "scale the mesh to metres")


def header(data: bytes, name: str) -> tuple[str, list[PlyElement], int]:
    """Byte order ('' for text), elements, and where the content begins."""
    end = data.find(b"end_header", 0, 65536)
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise InputError(name, "header", "is no PLY, or cut inside its header", AGAIN)
    order: str | None = None
    elements: list[PlyElement] = []
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) >= 2 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit() and len(words[2]) < 19:
            elements.append(PlyElement(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and (field := _property(words)) is not None:
            elements[-1] = dataclasses.replace(elements[-1], fields=(*elements[-1].fields, field))
        else:
            raise InputError(name, "header", f"line {line.strip()[:60]!r} is not understood", AGAIN)
    if order is None:
        raise InputError(name, "header", "states no known format", AGAIN)
    return order, elements, newline + 1


def _property(words: list[str]) -> tuple[str, ...] | None:
    if len(words) == 3 and words[1] in _TYPES:
        return (words[2], _TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        return (words[4], _TYPES[words[2]], _TYPES[words[3]])
    return None


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
    channels = ("red", "green", "blue")
    if not all(channel in places for channel in channels):
        return np.full((len(rows), 3), 180, dtype=np.uint8)
    values = np.stack([rows[places[channel]] for channel in channels], axis=1)
    if values.dtype.kind == "f":
        values = np.clip(np.nan_to_num(values), 0, 1) * 255
    return np.clip(values, 0, 255).astype(np.uint8)


def _by_library(data: bytes, name: str) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
    """Text, polygons and unusual properties: left to trimesh, which triangulates them."""
    import trimesh

    from tasks.geometry.meshes import vertex_colors

    try:
        mesh = trimesh.load(io.BytesIO(data), file_type="ply", process=False)
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise InputError(name, "element face", "the mesh has no triangles", "export the scan as a triangle mesh")
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
        colors = vertex_colors(mesh)
    except InputError:
        raise
    except Exception as error:  # the loader raises whatever the bytes lead it to
        raise InputError(name, "content", f"is cut or broken ({type(error).__name__}: {str(error)[:120]})", AGAIN) from error
    if len(colors) != len(vertices):
        colors = np.full((len(vertices), 3), 180, dtype=np.uint8)
    return vertices, faces, colors
