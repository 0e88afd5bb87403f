"""What a format of models is: how its files are known, read, and what they draw on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import trimesh

Axis = Literal["y", "z"]
"""Which of a file's axes points up."""

MOST_FACES = 2_000_000
"""Faces of a model that is to stand in a room: more is a whole scene, and takes minutes to look at."""


@dataclasses.dataclass(frozen=True)
class ReadModel:
    """What a file holds, in its own units.

    parts: With textures; turned from +Y up to +Z up where `is_turned`, else as the file has them. format: Its name among `FORMATS`.
    unit_m: Metres per unit, where the file says so [m]. up: The axis that points up in the file, where it or its format says so.
    notes: What is missing of it, a line each.
    """

    parts: list[trimesh.Trimesh]
    format: str
    unit_m: float | None
    up: Axis | None
    is_turned: bool = False
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class ModelFormat:
    """A kind of file. endings: Of names, in lower case. read: The model of a file below a folder. beside: Other files that it draws on,
    those that exist inside of the folder."""

    endings: tuple[str, ...]
    read: Callable[[Path, Path], ReadModel]
    beside: Callable[[Path, Path], list[Path]]

    @property
    def name(self) -> str:
        """What it is called: its first ending."""
        return self.endings[0].removeprefix(".")
