"""USD files are read in a process of their own: USD takes whatever memory and time a file asks for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from tasks.confinement import Limits, run_child

MODEL = "model.glb"
"""The mesh that a child leaves in its folder."""

CODE = "from tasks.library.usd.child import main; main()"


@dataclasses.dataclass(frozen=True)
class Confined:
    """What a child found. facts: Plain values. model: A GLB, where it made one."""

    facts: Mapping[str, Any]
    model: bytes | None


def confined(task: str, path: Path, root: Path, name: str) -> Confined:
    """The answer of a child about a file below `root`. task: `read`, `room` (read with the elements of a captured room) or `list`.

    Raises:
        InputError: the file is refused, or its reader takes too much or dies of it.
    """
    with temporary_folder() as folder:
        arguments = [task, str(path.absolute()), str(root.absolute()), str(folder)]
        facts = run_child(CODE, arguments, folder, Limits.of_file(path.stat().st_size), name)
        model = read_file(folder / MODEL, name, BUDGET.model_bytes) if task != "list" else None
    return Confined(facts, model)
