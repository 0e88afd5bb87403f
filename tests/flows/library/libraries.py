"""Small libraries and lakes for tests of the command."""

from __future__ import annotations

import json
from pathlib import Path

from flows.library.adding import LibraryContents, add_library, planned_library
from tasks.library.indexing import IndexConfig
from tests.tasks.library.models import as_glb, as_obj, chair
from warehouse.lake import Lake


def write_models(folder: Path) -> Path:
    """Chairs, one twice and one in centimetres, a list of them, and a file that is broken."""
    folder.mkdir(parents=True)
    (folder / "a_chair.glb").write_bytes(as_glb(chair()))
    (folder / "b_chair.glb").write_bytes(as_glb(chair()))
    (folder / "c_chair.obj").write_bytes(as_obj(chair(5), 0.01))
    (folder / "broken.glb").write_bytes(b"glTF")
    listed = [{"file": "a_chair.glb", "category": "chair", "license": "CC-BY-4.0", "author": "A. Maker", "source": "https://example.org/a"}]
    (folder / "index.json").write_text(json.dumps(listed))
    return folder


def added(lake: Lake, folder: Path, name: str = "chairs", config: IndexConfig | None = None, processes: int = 1) -> LibraryContents:
    """A folder as a library of a lake."""
    return add_library(lake, planned_library(lake, folder, name, (), config or IndexConfig(), processes))
