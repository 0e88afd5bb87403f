"""GLB files: metres and +Y up by the standard (glTF 2.0, section 3.4), and nothing that lies elsewhere."""

from __future__ import annotations

from pathlib import Path

from schemas.budget import BUDGET
from tasks.ingestion import models
from tasks.library.format import ModelFormat, ReadModel


def _read(path: Path, root: Path) -> ReadModel:
    """The model in a GLB; weighed before it is unpacked.

    Raises:
        InputError: it is broken, larger than the budget, or names other files.
    """
    parts, notes = models.read_model(path, root, is_z_up=False, limit=BUDGET.asset_bytes)
    return ReadModel(parts, GLB.name, 1.0, "y", is_turned=True, notes=tuple(notes))


def _beside(path: Path, root: Path) -> list[Path]:
    return []


GLB = ModelFormat((".glb",), _read, _beside)
