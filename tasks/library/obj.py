"""Wavefront OBJ files with their materials and textures. They say neither which unit they are in nor which axis points up."""

from __future__ import annotations

from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.capture.files.survey import MAX_SURVEY_OFFSET
from tasks.ingestion import models
from tasks.ingestion.materials import decoded, material_files
from tasks.library.format import MOST_FACES, ModelFormat, ReadModel

MOST_BYTES = 128 * 2**20
"""Of the text: its reader takes ten times as much memory, and two million faces fit."""

MOST_CORNERS = 64
"""Of a face; more are outlines that no fan of triangles fills, or an attempt to make triangles out of nothing."""


def _read(path: Path, root: Path) -> ReadModel:
    """The model in an OBJ.

    Raises:
        InputError: it is broken, has indices that are out of range or too many faces, or its materials lie outside of the folder.
    """
    name = path.relative_to(root).as_posix()
    _weigh(decoded(read_file(path, name, MOST_BYTES)), name)
    parts, notes = models.read_model(path, root, is_z_up=True, limit=MOST_BYTES, max_offset=MAX_SURVEY_OFFSET)
    return ReadModel(parts, OBJ.name, None, None, notes=tuple(notes))


def _weigh(data: bytes, name: str) -> None:
    """Hold the lines of an OBJ against the budget, and the indices of its faces against its vertices.

    Readers wrap indices that are out of range, or die of them; here they are refused.
    """
    vertices = faces = 0
    highest = 0
    for line in data.split(b"\n"):
        kind = line[:2]
        if kind in (b"v ", b"v\t"):
            vertices += 1
        elif kind in (b"f ", b"f\t"):
            corners = line.split()[1:]
            faces += max(len(corners) - 2, 0)
            if len(corners) > MOST_CORNERS or faces > MOST_FACES:
                problem = f"are more than {MOST_FACES}, or one has more than {MOST_CORNERS} corners"
                raise InputError(name, "faces", problem, "decimate it, or split the scene into its objects")
            try:
                indices = [int(corner.partition(b"/")[0]) for corner in corners]
            except ValueError:
                raise InputError(name, "faces", f"one is {line[:40].decode(errors='replace')!r}", "export it again") from None
            if 0 in indices or -vertices > min(indices, default=1):
                raise InputError(name, "faces", f"one names vertex {min(indices)} after {vertices} of them", "export it again")
            highest = max(highest, *indices)
    if highest > vertices:
        raise InputError(name, "faces", f"one names vertex {highest} of {vertices}", "export it again")
    if vertices > BUDGET.vertices:
        raise InputError(name, "vertices", f"are {vertices}, more than {BUDGET.vertices}", "decimate it")


OBJ = ModelFormat((".obj",), _read, material_files)
