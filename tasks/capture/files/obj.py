"""Wavefront OBJ text: triangles with their materials, texture coordinates and colors of vertices."""

from __future__ import annotations

import dataclasses
import io
from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.ply_elements import GRAY, as_bytes
from tasks.capture.files.ply_header import AGAIN
from tasks.capture.files.polygons import triangulate
from tasks.geometry.meshes import Surface, sample_texture

MAX_CORNERS = 4096
"""Most corners of a face: clipping the ears of an outline takes a time that grows with their square."""

_FREE_FORM = frozenset({"curv", "curv2", "surf"})
_NAMING = frozenset({b"usemtl", b"mtllib", b"g", b"o"})
"""Statements whose names may hold a `#`, which starts a comment in all others."""

_ELEMENTS = {b"p": "points", b"l": "lines"}


@dataclasses.dataclass(frozen=True)
class ObjText:
    """Content of an OBJ.

    vertices: shape (n, 3). colors: sRGB of vertices, shape (n, 3); None without any. coordinates: of textures, shape (k, 2).
    faces: vertices of triangles, shape (m, 3). corners: texture coordinates of their corners, -1 for none, shape (m, 3).
    materials: number of each triangle's material among `names`, -1 for none, shape (m,). notes: parts that are not read, a line each.
    """

    vertices: NDArray[np.float64]
    colors: NDArray[np.uint8] | None
    coordinates: NDArray[np.float64]
    faces: NDArray[np.int64]
    corners: NDArray[np.int64]
    materials: NDArray[np.int64]
    names: tuple[str, ...]
    notes: tuple[str, ...]


def parse_obj(data: bytes, name: str) -> ObjText:
    """The triangles of an OBJ in the file's frame, in the order of its faces; polygons are triangulated.

    Raises:
        InputError: no triangles, more than the budget, an index that is not there, numbers that are missing, or free-form surfaces.
    """
    # Arrays hold a number in 8 bytes; lists of words would take ten times the file.
    points, coordinates, shades = array("d"), array("d"), array("d")
    shaded, corners, counts, materials = array("q"), array("q"), array("q"), array("q")
    names: dict[str, int] = {}
    current, faces = -1, 0
    elements: dict[str, int] = {}
    # Lines are read one at a time: a list of all would take several times the file.
    for line in io.BytesIO(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n")):
        words = line.split()
        if b"#" in line and not (words and words[0].lower() in _NAMING):
            words = line.partition(b"#")[0].split()
        kind = words[0] if words else b""
        if kind == b"v":
            _add_numbers(words[1:4], 3, points, name, "v")
            if len(words) > 6:
                _add_numbers(words[4:7], 3, shades, name, "v")
                shaded.append(len(points) // 3 - 1)
        elif kind == b"vt":
            _add_numbers([*words[1:3], b"0"][:2], 2, coordinates, name, "vt")
        elif kind in (b"f", b"fo"):
            _add_face(words[1:], len(points) // 3, len(coordinates) // 2, corners, name)
            counts.append(len(words) - 1)
            materials.append(current)
            faces += len(words) - 3
        elif kind.lower() == b"usemtl":
            current = names.setdefault(material_name(words[1:]), len(names))
        elif kind in _ELEMENTS:
            elements[_ELEMENTS[kind]] = elements.get(_ELEMENTS[kind], 0) + 1
        elif kind.decode("latin-1") in _FREE_FORM:
            raise InputError(name, kind.decode(), "uses free-form curves or surfaces, which are not read", "export it as polygons")
        if faces > BUDGET.faces or max(len(points) // 3, len(coordinates) // 2) > BUDGET.vertices:
            problem = f"are more than {BUDGET.faces}, or vertices more than {BUDGET.vertices}"
            raise InputError(name, "faces", problem, "decimate the mesh")
    if not faces:
        only = " and ".join(elements) or ("points" if points else "nothing")
        raise InputError(name, "meshes", f"holds no triangles, only {only}", "export the mesh with its faces")
    vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
    colors, notes = _colors(shaded, shades, len(vertices))
    places = np.array(coordinates, dtype=np.float64).reshape(-1, 2)
    table = np.array(corners, dtype=np.int64).reshape(-1, 2)
    for column, count, what in ((0, len(vertices), "vertex"), (1, len(places), "texture coordinate")):
        if table[:, column].max() >= count:
            highest = int(table[:, column].max()) + 1
            raise InputError(name, "faces", f"one names {what} {highest} of {count}: a {what} that does not exist", AGAIN)
    triangles = triangulate(vertices[table[:, 0]], np.array(counts, dtype=np.int64))
    notes += [*triangles.notes]
    notes += [f"{count} {what}: are not read: they have no surface" for what, count in elements.items()]
    owners = np.array(materials, dtype=np.int64)[triangles.owner]
    vertex_of, place_of = table[triangles.corners, 0], table[triangles.corners, 1]
    return ObjText(vertices, colors, places, vertex_of, place_of, owners, tuple(names), tuple(notes))


def material_name(words: Sequence[bytes]) -> str:
    """Name of a material, blanks in it taken as one."""
    return b" ".join(words).decode("utf-8", "surrogateescape")


def _add_face(words: list[bytes], points: int, coordinates: int, corners: array[int], name: str) -> None:
    """Add vertex and texture coordinate of each corner, both from 0, -1 for no texture coordinate.

    points, coordinates: as many as were stated before: negative indices count backward from them.
    """
    if not 3 <= len(words) <= MAX_CORNERS:
        raise InputError(name, "faces", f"one has {len(words)} corners, fewer than 3 or more than {MAX_CORNERS}", AGAIN)
    for word in words:
        first, _, rest = word.partition(b"/")
        second = rest.partition(b"/")[0]
        try:
            if len(word) > 60:
                raise ValueError
            vertex, place = int(first), int(second) if second else 0
        except ValueError:
            raise InputError(name, "faces", f"one is no face: {b' '.join(words)[:40].decode(errors='replace')!r}", AGAIN) from None
        if vertex == 0 or vertex < -points or abs(vertex) > 2**40:
            problem = f"one names vertex {vertex} after {points} of them: a vertex that does not exist"
            raise InputError(name, "faces", problem, AGAIN)
        if place < -coordinates or abs(place) > 2**40:
            problem = f"one names texture coordinate {place} after {coordinates} of them: a texture coordinate that does not exist"
            raise InputError(name, "faces", problem, AGAIN)
        corners.append(vertex - 1 if vertex > 0 else points + vertex)
        corners.append(place - 1 if place >= 0 else coordinates + place)


def _add_numbers(words: list[bytes], count: int, numbers: array[float], name: str, field: str) -> None:
    try:
        if len(words) < count:
            raise ValueError(f"it has {len(words)}")
        numbers.extend([float(word) for word in words])
    except ValueError as error:
        raise InputError(name, field, f"a line has not {count} numbers ({str(error)[:60]})", AGAIN) from error


def _colors(places: array[int], values: array[float], count: int) -> tuple[NDArray[np.uint8] | None, list[str]]:
    """Colors of vertices, shape (count, 3), and notes; values: of the vertices at `places`, three for each."""
    if not places:
        return None, []
    colors = np.full((count, 3), GRAY, dtype=np.uint8)
    colors[np.array(places)] = as_bytes(np.array(values).reshape(-1, 3), "f8")
    missing = count - len(places)
    return colors, [f"{missing} of {count} vertices state no color: they are gray"] if missing else []


def read_obj(path: Path, name: str, texture: NDArray[np.uint8] | None = None) -> tuple[Surface, tuple[str, ...]]:
    """The triangles of a text OBJ in the file's frame [m], its vertices in their order, and parts that are not read, a line each.

    Args:
        path: file of the mesh.
        name: the file, for messages.
        texture: image of its one material, shape (h, w, 3): a vertex has the color at the texture coordinate of a face
            that it belongs to, otherwise gray.

    Raises:
        InputError: see `parse_obj`; or the coordinates are not those of a room.
    """
    # Text takes many times its bytes, so it has the limit of other text, not that of a scene.
    text = parse_obj(read_bytes(path, name, BUDGET.model_bytes), name)
    check_vertices(text.vertices, name)
    colors = np.full((len(text.vertices), 3), GRAY, dtype=np.uint8)
    if texture is not None and (text.corners >= 0).all():
        uv = np.clip(np.nan_to_num(text.coordinates), -1e6, 1e6)[text.corners.ravel()]
        # The first of a vertex's corners stays.
        colors[text.faces.ravel()[::-1]] = sample_texture(texture, uv, np.ones(3))[::-1]
    return Surface(text.vertices, text.faces, colors), tuple(f"{path.name}: {note}" for note in text.notes)
