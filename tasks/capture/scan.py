"""A scan, and what a scan format is. Opens nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.errors import InputError
from tasks.capture.premises import REMEDY, Premises
from tasks.words import plain_word

if TYPE_CHECKING:
    from tasks.capture.labels import Label
    from tasks.capture.reading import Reading


@dataclasses.dataclass(frozen=True)
class ScanFormat:
    """A member of the family `schemas.families.scan_formats`: how scans of a format are found and read.

    dataset: Dataset of its scans, where nobody names one. expected: What a scan of it consists of, in the words of an error.
    recognize: Name of the scan that a folder is, by the names in it and wherever links among them lead; None where it is none.
    is_recorded: Whether a folder is or holds a scan of frames or of a sensor's mesh: then what lies beside it is a scan of its own.
    files: All files that `read` would read; links among them that leave the premises are left out, and remembered there.
    read: Everything that a scan states.
    suffixes: Of formats whose scans are single files: how their names end, in lower case.
    is_modelled: Somebody drew it: its axes are the author's, and its labels are names of nodes.
    bare: What was read of a scan as one that names no instances, where those that it names are no objects; None where they are. Takes
    the scan, what was read, and what its labels mean. signs: Patterns of paths that its scans have, by which a folder that is none is
    told what it lacks. is_plain: Anybody can write it: what errors name where any format would do. is_last_resort: Takes any file of
    its suffixes: none of a folder that looks like another format's. unread: Patterns of paths in a scan's folder that its scans have and
    that are not read, such as other versions of the mesh. room: Pattern of scene ids that are scans of one room, which its
    first group names. room_stated: The room's name where files say which scans are of one, None where they do not. shared: Files that
    several scans have in common may lie one folder above them. within: Of formats whose scans lie side by side in one folder: their
    main files and names, by the names in the folder.

    `recognize` and `files` raise InputError for what is no scan and looks like one, `read` and `bare` for files that cannot be used.
    What tells a broken copy from a whole one is only asked by a watch, and lies in `wholeness` of the format's package, where it
    has one: capture does not depend on it.
    """

    name: str
    dataset: str
    expected: str
    recognize: Callable[[Path], str | None]
    is_recorded: Callable[[Path], bool]
    files: Callable[[Scan, Premises], Sequence[Path]]
    read: Callable[[Scan], Reading]
    suffixes: tuple[str, ...] = ()
    is_modelled: bool = False
    bare: Callable[[Scan, Reading, Sequence[Label]], Reading | None] | None = None
    signs: tuple[str, ...] = ()
    is_plain: bool = False
    is_last_resort: bool = False
    unread: tuple[str, ...] = ()
    room: str = ""
    room_stated: Callable[[Scan], str | None] | None = None
    shared: bool = False
    within: Callable[[Path], Sequence[tuple[Path, str]]] | None = None


class PassedOver(InputError):
    """A file or folder that is not a scan and need not be one. A run reports it and does not fail."""


class UnusableScan(InputError):
    """A scan that cannot be used. `path` is its folder or file, `format` the format that it seems to have, '' if unknown."""

    def __init__(self, error: InputError, path: Path, format: str = "") -> None:
        super().__init__(error.file, error.field, error.problem, error.remedy)
        self.path, self.format = path, format


@dataclasses.dataclass(frozen=True)
class Scan:
    """A scan that was found. `path` is its folder, or its file for one that lies beside others.

    places: Folders, links followed, that links of the scan may lead into; without any, the scan's own. word: The scan's part of
    the scene id, where its name alone would give it the id of another scan; '' otherwise.
    """

    format: str
    path: Path
    dataset: str
    scan: str
    places: tuple[Path, ...] = dataclasses.field(default=(), compare=False)
    word: str = ""

    @property
    def folder(self) -> Path:
        """The folder that it lies in, or is."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def premises(self) -> Premises:
        """What decides which of its links are followed."""
        return Premises(self.places or (self.folder,))

    @property
    def scene_id(self) -> str:
        """`<dataset>/<scan>`, both as plain words."""
        return f"{plain_word(self.dataset).lower()}/{self.word or plain_word(self.scan)}"


def license_path(folder: Path, premises: Premises) -> Path | None:
    """A scan's LICENSE.txt, None without one. A link that leads nowhere is none."""
    path = folder / "LICENSE.txt"
    return path if (path.is_file() or path.is_symlink()) and premises.admits(path) and path.is_file() else None


def files_named(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Whatever in a folder has a name that ends so, in any case, and is no folder, sorted; hidden ones are passed over."""
    named = (path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return sorted(path for path in named if not path.is_dir())


def matches(path: str, patterns: Iterable[str]) -> bool:
    """True if a path in a folder matches one of some patterns, in which `*` stands for letters of one name."""
    return any(path.count("/") == pattern.count("/") and fnmatchcase(path, pattern) for pattern in patterns)


def single_file(scan: Scan, suffixes: Sequence[str]) -> Path:
    """The file of a scan that is one, or a folder with one in it.

    Raises:
        InputError: the folder does not hold exactly one, or it is a link that leaves the folder of scans.
    """
    files = [scan.path] if not scan.path.is_dir() else files_named(scan.path, suffixes)
    if len(files) != 1:
        problem = f"holds {len(files)} {' or '.join(suffixes)} files, one is expected"
        raise InputError(scan.path.name, "folder", problem, "name the file itself")
    return own_file(scan, files[0].name)


def own_file(scan: Scan, name: str) -> Path:
    """A file in a scan's folder, by its name.

    Raises:
        InputError: it is a link that leaves the folder of scans.
    """
    path = scan.folder / name
    if not scan.premises.admits(path):
        raise leaving(path)
    return path


def leaving(path: Path) -> InputError:
    """What is said of a link that leaves the folder of scans."""
    return InputError(path.name, "link", "leads out of the folder of scans", REMEDY)
