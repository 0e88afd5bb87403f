"""USD files and packages: read in a process of their own, once it is known that all they draw on lies inside of the folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import check_file, stays_in
from tasks.geometry.meshes import load_glb
from tasks.library.confinement import confined
from tasks.library.format import Axis, ModelFormat, ReadModel
from tasks.library.usd.rooms import RoomPrim


@dataclasses.dataclass(frozen=True)
class RoomModel:
    """A USD file, and the elements if it is a captured room. part_elements: of each part; empty for other files."""

    model: ReadModel
    elements: tuple[RoomPrim, ...] = ()
    part_elements: tuple[int, ...] = ()


def read_room(path: Path, root: Path) -> RoomModel:
    """The model in a USD file, with the elements of a captured room.

    Raises:
        InputError: it is broken, larger than the budget, or draws on files outside of the folder.
    """
    model, facts = _confined("room", path, root)
    listed, numbers = facts.get("elements"), facts.get("part_elements")
    if not listed:
        return RoomModel(model)
    if not isinstance(listed, list) or not isinstance(numbers, list) or len(numbers) != len(model.parts):
        raise InputError(path.name, "content", "its reader gave no answer", "export it again")
    # The loader orders parts by their names, which are their numbers.
    order = [int(str(part.metadata["name"]).removeprefix("part_")) for part in model.parts]
    return RoomModel(model, tuple(RoomPrim(*map(str, entry)) for entry in listed), tuple(int(numbers[number]) for number in order))


def _read(path: Path, root: Path) -> ReadModel:
    """The model in a USD file, instances as meshes of their own; raises as `read_room` does."""
    return _confined("read", path, root)[0]


def _confined(task: str, path: Path, root: Path) -> tuple[ReadModel, Mapping[str, Any]]:
    """The model that a child reads from a USD file, and the child's facts."""
    name = path.relative_to(root).as_posix()
    check_file(path, name, BUDGET.asset_bytes)
    made = confined(task, path, root, name)
    assert made.model is not None
    unit, axis, notes = made.facts.get("unit_m"), made.facts.get("up"), made.facts.get("notes")
    if not isinstance(unit, float | int | None) or axis not in ("y", "z", None) or not isinstance(notes, list):
        raise InputError(name, "content", "its reader gave no answer", "export it again")
    up: Axis | None = axis
    parts = load_glb(made.model, name)
    return ReadModel(parts, USD.name, None if unit is None else float(unit), up, notes=tuple(str(note) for note in notes)), made.facts


def _beside(path: Path, root: Path) -> list[Path]:
    """Layers and textures that a layer names, at any depth; a package holds its own."""
    if path.suffix.lower() == ".usdz":
        return []
    name = path.relative_to(root).as_posix()
    check_file(path, name, BUDGET.asset_bytes)
    files = confined("list", path, root, name).facts.get("files")
    paths = [Path(file) for file in files if isinstance(file, str)] if isinstance(files, list) else []
    return sorted(file for file in paths if file.is_file() and stays_in(file, root))


USD = ModelFormat((".usd", ".usda", ".usdc", ".usdz"), _read, _beside)
