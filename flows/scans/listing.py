"""A folder of scans known only by a listing: what a store of objects says it holds, walked as if it were a folder.

Which scans there are is decided from names alone, so the readers' own rules decide it before anything is fetched.
"""

from __future__ import annotations

import dataclasses
import errno
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, cast

from flows.run.fingerprints import digest
from schemas.errors import InputError
from tasks.capture.formats import format_of, scan_files
from tasks.capture.layout import leads_up
from tasks.capture.premises import Premises
from tasks.capture.scan import Scan

MAX_NAME_BYTES = 255
"""The longest name that file systems take."""

DEPTH = 8
"""Folders in folders that are looked into; the deepest that a reader knows is four below the folder of scans."""


@dataclasses.dataclass(frozen=True, order=True)
class ScanFile:
    """A file: its path below the folder, size [B], time of its last change [ns since the epoch] as it says of itself, and a tag that
    nobody can set: the ETag of an object, the change time of a local file."""

    path: str
    size: int
    modified_ns: int
    tag: str = ""


@dataclasses.dataclass(frozen=True)
class ScanListing:
    """A scan with every file that lies in its folder, read or not, sorted by path; its path says where the scan lies."""

    scan: Scan
    files: tuple[ScanFile, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    @property
    def mark(self) -> str:
        """Hash of paths, sizes, times and tags: another one means that somebody wrote to the scan's folder."""
        return digest(*(f"{file.path}={file.size}:{file.modified_ns}:{file.tag}" for file in self.files))


class ListedPath(PurePosixPath):
    """A path in a listing; of `pathlib.Path` it has what finding scans takes. Made by `listed_folder`."""

    _files: ClassVar[Mapping[str, ScanFile]] = {}
    _folders: ClassVar[Mapping[str, frozenset[str]]] = {}

    def exists(self) -> bool:
        """Whether it is a file or a folder of the listing."""
        return self.is_file() or self.is_dir()

    def is_file(self) -> bool:
        """Whether it is a file of the listing."""
        return str(self) in self._files

    def is_dir(self) -> bool:
        """Whether files lie below it."""
        return str(self) in self._folders

    def is_symlink(self) -> bool:
        """Listings have no links."""
        return False

    def resolve(self) -> ListedPath:
        """Itself."""
        return self

    def iterdir(self) -> Iterator[ListedPath]:
        """What lies directly in the folder. Raises FileNotFoundError."""
        if not self.is_dir():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        return (self / name for name in sorted(self._folders[str(self)]))

    def stat(self) -> os.stat_result:
        """Size and time of last change of a file; nothing else of it is known. Raises FileNotFoundError."""
        if not self.is_file():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        file = self.entry
        times = (file.modified_ns / 1e9,) * 3
        return os.stat_result((0o100400, 0, 0, 1, 0, 0, file.size, *times))

    @property
    def entry(self) -> ScanFile:
        """The file as the listing has it; its path is that below the whole listing."""
        return self._files[str(self)]


def listed_folder(name: str, files: Iterable[ScanFile]) -> Path:
    """The folder of a listing, as `find_scans` takes it. A single file with the path '' is that file itself.

    Scans that are found there have paths in the listing: only names, sizes and times can be asked of them.
    """
    by_path: dict[str, ScanFile] = {}
    folders: dict[str, set[str]] = {}
    for file in files:
        path = f"{name}/{file.path}" if file.path else name
        by_path[path] = file
        while path != name:
            above, _, last = path.rpartition("/")
            folders.setdefault(above, set()).add(last)
            path = above
    known = {path: frozenset(names) for path, names in folders.items()}
    kind: Any = type("ListedPath", (ListedPath,), {"_files": by_path, "_folders": known})
    return cast(Path, kind(name))


def usable_paths(files: Iterable[ScanFile]) -> tuple[list[ScanFile], list[InputError]]:
    """Files that a folder can hold, sorted; and those whose paths leave it, or that are a file and a folder at once."""
    good, errors = [], []
    every = sorted(files)
    folders = {above for file in every for above in _above(file.path)}
    for file in every:
        problem = _problem(file.path)
        if not problem and file.path in folders:
            problem = "is an object and a folder of objects"
        if problem:
            errors.append(InputError(file.path.encode("unicode_escape").decode()[:200], "key", problem, "rename the object"))
        else:
            good.append(file)
    return good, errors


def _problem(path: str) -> str:
    parts = path.split("/")
    if path and any(part in ("", ".", "..") for part in parts):
        return "has an empty, . or .. folder in its path"
    if any(ord(letter) < 32 or letter == "\\" for letter in path):
        return "has a control character or a backslash in its path"
    if any(len(part.encode("utf-8", "surrogatepass")) > MAX_NAME_BYTES for part in parts):
        return f"has a name of more than {MAX_NAME_BYTES} bytes"
    return ""


def _above(path: str) -> Iterator[str]:
    while "/" in path:
        path = path.rpartition("/")[0]
        yield path


def files_of(scan: Scan) -> tuple[ScanFile, ...]:
    """Every file of a scan, in a local folder or a listing, with paths below the scan's folder, sorted.

    Besides what its reader reads there are hidden and temporary files. Of a scan that is one file among others: that file,
    its license, and files whose names begin with its own.

    Raises:
        OSError: the scan's folder cannot be listed.
    """
    whole, root = scan.path.is_dir(), scan.folder
    listed = _listed(root, root) if isinstance(root, ListedPath) else _scanned(root, "", DEPTH if whole else 0, scan.premises)
    by_path = {file.path: file for file in listed}
    if whole:
        return tuple(sorted([*by_path.values(), *_shared(scan, root)]))
    name = scan.path.name
    wanted = {path.name for path in scan_files(scan)}
    return tuple(sorted(file for path, file in by_path.items() if path in wanted or path.startswith((name, f".{name}"))))


def _shared(scan: Scan, root: Path) -> Iterator[ScanFile]:
    """What the scan is read from in the folder above, where scans of its format share files."""
    if not format_of(scan).shared:
        return
    for path in scan_files(scan):
        if not path.is_relative_to(root):
            yield ScanFile(f"../{path.name}", *_state(path))


def _state(path: Path) -> tuple[int, int, str]:
    if isinstance(path, ListedPath):
        return path.entry.size, path.entry.modified_ns, path.entry.tag
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns, str(stat.st_ctime_ns)


def _listed(folder: ListedPath, root: ListedPath) -> Iterator[ScanFile]:
    for path in folder.iterdir():
        if path.is_file():
            yield dataclasses.replace(path.entry, path=path.relative_to(root).as_posix())
        else:
            yield from _listed(path, root)


def _scanned(folder: Path, below: str, depth: int, premises: Premises) -> Iterator[ScanFile]:
    with os.scandir(folder) as entries:
        for entry in entries:
            try:
                if entry.is_symlink() and not premises.admits(Path(entry.path)):
                    continue
                if entry.is_file():
                    stat = entry.stat()
                    yield ScanFile(f"{below}{entry.name}", stat.st_size, stat.st_mtime_ns, str(stat.st_ctime_ns))
                elif depth and entry.is_dir() and not leads_up(Path(entry.path)):
                    yield from _scanned(Path(entry.path), f"{below}{entry.name}/", depth - 1, premises)
            except FileNotFoundError:  # renamed or removed since the folder was listed, as a copy under way does
                continue


def listings(scans: Iterable[Scan], errors: Iterable[InputError]) -> tuple[dict[str, ScanListing], list[InputError]]:
    """Scans with their files by scene id; one whose folder cannot be read is an error beside the others."""
    listed, wrong = {}, list(errors)
    for scan in scans:
        try:
            listed[scan.scene_id] = ScanListing(scan, files_of(scan))
        except InputError as error:
            wrong.append(error)
        except OSError as error:
            wrong.append(InputError(scan.path.name, "files", f"cannot be listed ({error.strerror})", "check their permissions"))
    return listed, wrong
