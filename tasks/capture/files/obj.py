"""Triangles of an OBJ with colors at its vertices, from a texture where it has one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.ply_header import AGAIN
from tasks.geometry.meshes import Surface, sample_texture

GRAY = 180
"""Of what has no color."""


def read_obj(path: Path, name: str, texture: NDArray[np.uint8] | None = None) -> Surface:
    """The triangles of a text OBJ in the file's frame [m], its vertices in their order. texture: Image of its one material, shape
    (h, w, 3): a vertex has the color at the texture coordinate of a face that it is of; gray without.

    Raises:
        InputError: no triangles, more than the budget, an index that is none, or coordinates that are none.
    """
    lines = read_bytes(path, name, BUDGET.scene_bytes).split(b"\n")
    kinds: dict[bytes, list[bytes]] = {b"v": [], b"vt": [], b"f": []}
    for line in lines:
        kind, _, rest = line.strip().partition(b" ")
        if kind in kinds:
            kinds[kind].append(rest)
    for kind, most in ((b"v", BUDGET.vertices), (b"vt", BUDGET.vertices), (b"f", BUDGET.faces)):
        if len(kinds[kind]) > most:
            raise InputError(name, kind.decode(), f"has {len(kinds[kind])} lines, more than {most}", "decimate the mesh")
    if len(kinds[b"v"]) < 3 or not kinds[b"f"]:
        raise InputError(name, "f", "the mesh has no triangles", "export the scan as a triangle mesh")
    vertices = _columns(kinds[b"v"], 3, name, "v")
    check_vertices(vertices, name)
    corners = [_corners(line, name) for line in kinds[b"f"]]
    triangles = [(face[0], face[i], face[i + 1]) for face in corners for i in range(1, len(face) - 1)]
    if len(triangles) > BUDGET.faces:
        raise InputError(name, "f", f"has {len(triangles)} triangles, more than {BUDGET.faces}", "decimate the mesh")
    table = np.array(triangles, dtype=np.int64)  # (m, 3, 2): vertex and texture coordinate
    faces = _resolved(table[:, :, 0], len(vertices), name, "vertex")
    colors = np.full((len(vertices), 3), GRAY, dtype=np.uint8)
    if texture is not None and kinds[b"vt"] and (table[:, :, 1] != 0).all():
        coordinates = np.clip(np.nan_to_num(_columns(kinds[b"vt"], 2, name, "vt")), -1e6, 1e6)
        uv = coordinates[_resolved(table[:, :, 1], len(coordinates), name, "texture coordinate").ravel()]
        colors[faces.ravel()[::-1]] = sample_texture(texture, uv, np.ones(3))[::-1]  # the first of a vertex's corners stays
    return Surface(vertices, faces, colors)


def _columns(lines: list[bytes], count: int, name: str, field: str) -> NDArray[np.float64]:
    try:
        return np.array([[float(word) for word in line.split()[:count]] for line in lines], dtype=np.float64).reshape(len(lines), count)
    except ValueError as error:
        raise InputError(name, field, f"a line has not {count} numbers", AGAIN) from error


def _corners(line: bytes, name: str) -> list[tuple[int, int]]:
    """Vertex and texture coordinate of each corner as the file counts, 0 for no texture coordinate."""
    corners = []
    for word in line.split():
        first, _, rest = word.partition(b"/")
        second = rest.partition(b"/")[0]
        digits = (first, second or b"0")
        if not all(len(part) < 12 and part.removeprefix(b"-").isdigit() for part in digits):
            raise InputError(name, "f", f"is no face: {line[:40].decode('latin-1')!r}", AGAIN)
        corners.append((int(first), int(second or b"0")))
    if not 3 <= len(corners) <= _MOST_CORNERS:
        raise InputError(name, "f", f"has {len(corners)} corners", "export the scan as a triangle mesh")
    return corners


_MOST_CORNERS = 64


def _resolved(indices: NDArray[np.int64], count: int, name: str, what: str) -> NDArray[np.int64]:
    """Indices from 0: the file counts from 1, or backward from its end."""
    resolved = np.where(indices < 0, indices + count, indices - 1)
    if ((resolved < 0) | (resolved >= count)).any():
        raise InputError(name, "f", f"names a {what} that does not exist, of {count}", AGAIN)
    return resolved
