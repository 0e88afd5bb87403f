"""Wavefront OBJ files with their materials and textures. They say neither which unit they are in nor which axis points up."""

from __future__ import annotations

from pathlib import Path

from tasks.capture.files.survey import MAX_SURVEY_OFFSET
from tasks.ingestion import models
from tasks.ingestion.materials import material_files
from tasks.library.format import ModelFormat, ReadModel

MOST_BYTES = 128 * 2**20
"""Largest text of a model: its reader takes ten times as much memory, and two million faces fit."""


def _read(path: Path, root: Path) -> ReadModel:
    """The model in an OBJ.

    Raises:
        InputError: it is broken, has indices that are out of range or too many faces, or its materials lie outside of the folder.
    """
    parts, notes = models.read_model(path, root, is_z_up=True, limit=MOST_BYTES, max_offset=MAX_SURVEY_OFFSET)
    return ReadModel(parts, OBJ.name, None, None, notes=tuple(notes))


OBJ = ModelFormat((".obj",), _read, material_files)
