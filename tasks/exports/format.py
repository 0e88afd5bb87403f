"""What an export format is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, cast

from schemas.files import AnyPath, HeldPath
from schemas.machine.scratch import temporary_folder
from tasks.exports.files import Export, File, write_folder
from tasks.exports.findings import Finding
from tasks.families import part

if TYPE_CHECKING:
    from schemas.navigation import Episode, Navmesh
    from tasks.exports.bodies import Replica, Shape
    from tasks.exports.config import ExportsConfig


@dataclasses.dataclass(frozen=True)
class ExportedScene:
    """What an export is made of. blobs: Of the navmeshes."""

    replica: Replica
    navmeshes: Sequence[Navmesh]
    episodes: Sequence[Episode]
    blobs: Mapping[str, bytes]
    config: ExportsConfig


@dataclasses.dataclass(frozen=True)
class Doctor:
    """How anybody's files come before the gate, as `metascenes doctor <format>`.

    about: What is checked. example: Arguments of an example. names_others: The file names others, which are read, too.
    validators: Options that ask for further checks, with their help. Such a check is `check_<option>` in the module `<option>` of the
    format's package, which the stage does not import.
    """

    about: str
    example: str
    takes: Literal["a file", "a folder", "either"] = "a file"
    names_others: bool = False
    validators: tuple[tuple[str, str], ...] = ()


SharedFiles = Callable[[Sequence[tuple[Mapping[str, str], Callable[[str], bytes]]]], dict[str, bytes]]
"""Files that belong to no scene alone, by path, from the roles of each scene's files by path and a function that reads one."""


@dataclasses.dataclass(frozen=True)
class ExportFormat:
    """A member of the family `schemas.families.export_formats`: how scenes are written and checked in a format.

    title: What it makes, in the words of a list. make: A scene's files and what the gate found in them.
    gate: Imports the module of the format's rules: `RULES`, by name, and `check_<name>`, which finds what is wrong with a file or folder
    that a simulator opens.
    opened: All that a simulator opens of a folder of exports, sorted. doctor: How the gate takes anybody's files.
    shared: Makes the files that belong to no scene alone.
    with_release: A scene's file that says which snapshot, and release if there is a name, it was exported from.
    package: One file of all files of a scene, by path, given which of them is opened; ValueError where that cannot be.
    suffix: Of the name of such a package.
    is_nested: Names of objects are paths: what lies below an object belongs to it.
    prepare: Makes what other formats have of a shape, too, and keeps it with the shape, before the formats are divided among processes.
    is_held: The gate takes files that are held in memory, `schemas.files.HeldPath`, as it takes those of a folder: where a scene has
    many small ones, writing them to be read at once takes longer than to check them.

    What an exported scene says of the objects in it only `metascenes explain` asks: `places` in the format's package.
    """

    name: str
    title: str
    make: Callable[[ExportedScene], Export]
    gate: Callable[[], ModuleType]
    opened: Callable[[Path], list[Path]]
    doctor: Doctor
    shared: SharedFiles | None = None
    with_release: Callable[[bytes, int, str | None], bytes] | None = None
    package: Callable[[Mapping[str, bytes], str], bytes] | None = None
    suffix: str = ""
    is_nested: bool = False
    prepare: Callable[[Shape], object] | None = None
    is_held: bool = False

    @property
    def rules(self) -> tuple[str, ...]:
        """Names of the gate's rules."""
        return tuple(self.gate().RULES)

    @property
    def check(self) -> Callable[[Path], Sequence[Finding]]:
        """What is wrong with a file or folder that a simulator opens. A function of a module, which another process can be given."""
        check: Callable[[Path], Sequence[Finding]] = getattr(self.gate(), f"check_{self.name}")
        return check

    def validator(self, option: str) -> Callable[[Path], Sequence[Finding]]:
        """The check that an option of `doctor.validators` asks for."""
        check: Callable[[Path], Sequence[Finding]] = getattr(part("tasks.exports", self.name, option), f"check_{option}")
        return check


def checked(files: Sequence[File], format_: ExportFormat, opened: str) -> Export:
    """Files, and what the format's gate says of the path that a simulator opens. It looks at them in memory where it can, else in a
    temporary folder.

    Raises:
        OSError: the files cannot be written.
    """
    if format_.is_held:
        check: Callable[[AnyPath], Sequence[Finding]] = cast(Any, format_.check)
        return Export(files, format_.rules, check(HeldPath.folder({file.path: file.data for file in files}) / opened))
    with temporary_folder() as place:
        root = place.resolve()
        write_folder(root, {file.path: file.data for file in files})
        return Export(files, format_.rules, format_.check(root / opened))
