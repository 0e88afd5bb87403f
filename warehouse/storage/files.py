"""Files of a lake: a local folder or a prefix in a store of objects behind one small protocol.

Paths are relative to the lake, with forward slashes. Every write is whole or not at all.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from schemas.errors import InputError, check_address
from warehouse.sharing.writer import new_token
from warehouse.storage.locks import locked
from warehouse.storage.refusals import in_words
from warehouse.storage.workplace import workplace

if TYPE_CHECKING:
    import pyarrow.fs

T = TypeVar("T")
U = TypeVar("U")

TEMPORARY = "tmp"

STORES = ("s3://", "gs://", "az://")
"""What addresses in stores of objects begin with: S3 and what speaks it, Google Cloud Storage, Azure."""

SYNCS = 4
"""Files that are synced, or removed, at a time: forty small ones took a disk 266 ms one after another, four at a time 19 ms, eight 15."""


@dataclasses.dataclass(frozen=True, slots=True)
class Entry:
    """A file: its path, size [B] and time of last change [s since the epoch]."""

    path: str
    size: int
    modified: float


class Storage(Protocol):
    """What a lake needs of the place that it lies in."""

    address: str

    def read(self, path: str) -> bytes:
        """Contents of a file. Raises FileNotFoundError."""

    def write(self, path: str, data: bytes, lasting: bool = True) -> None:
        """Write a file, replacing what was there; readers see the old contents or the new, never a part.

        Unless `lasting`, a power failure may take the file's name away again until another file of its folder is written.
        """

    def write_together(self, files: Mapping[str, bytes]) -> None:
        """Write files as `write` does, in less time than one after another: the last one when all others are there."""

    def move_in(self, file: Path, path: str) -> None:
        """Put a finished local file, however large, in the place of a file; it is gone from where it was."""

    def workplace(self) -> contextlib.AbstractContextManager[Path]:
        """``with storage.workplace() as folder``: a new local folder to make files in, from which `move_in` is cheap."""

    def create(self, path: str, data: bytes) -> bool:
        """Write a file unless it exists. Of several at once, exactly one gets True."""

    def exists(self, path: str) -> bool:
        """Whether there is such a file."""

    def refresh(self, path: str, seconds: float) -> bool:
        """Whether there is such a file that counts as changed within `seconds`; where it can, an older one is made to."""

    def remove(self, path: str) -> None:
        """Remove a file; one that is not there is no error."""

    def remove_all(self, paths: Sequence[str]) -> None:
        """Remove files, in no order; those that are not there are no error."""

    def each(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """What `work`, most of which is asking the storage, makes of every item, in their order; several at a time where that is faster."""

    def entries(self, folder: str) -> list[Entry]:
        """Files directly inside a folder, sorted by path; empty when there is no such folder."""

    def names(self, folder: str, head: str = "") -> list[str]:
        """Names of the files directly inside a folder that begin with `head`, sorted; cheaper than `entries`."""

    def folders(self, folder: str) -> list[str]:
        """Names of the folders directly inside a folder, sorted."""

    def walk(self, folder: str) -> Iterator[Entry]:
        """Files anywhere below a folder ("" is all of it), in no order; none when there is no such folder."""

    def read_tagged(self, path: str) -> tuple[bytes, str] | None:
        """Contents of a file and a tag for `swap`; None when there is no such file."""

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        """Replace (None: remove) a file if it still is what `tag` was given for. Returns whether it was."""

    def delta_address(self, path: str) -> str:
        """Address of a folder for delta-rs."""

    def delta_options(self) -> dict[str, str] | None:
        """Storage options for delta-rs."""

    def arrow_filesystem(self) -> pyarrow.fs.FileSystem:
        """File system in which Arrow finds `arrow_path`."""

    def arrow_path(self, path: str) -> str:
        """A file's path in `arrow_filesystem`."""

    def duckdb_path(self, path: str) -> str:
        """A file's path for DuckDB."""

    def register(self, connection: Any) -> None:
        """Teach a DuckDB connection to read `duckdb_path`."""

    def local_path(self, path: str) -> Path | None:
        """A file's path in the local file system; None when it is not there."""


def storage_at(address: str | Path) -> Storage:
    """The storage at an address: a folder, or `s3://bucket/prefix` (`gs://`, `az://`).

    Raises:
        InputError: the address is of another kind, or carries credentials.
    """
    check_address(address)
    if isinstance(address, str) and address.startswith(STORES):
        from warehouse.storage.objects import ObjectStorage

        return ObjectStorage(address)
    if isinstance(address, str) and re.match(r"[a-z][a-z0-9+]*://", address):
        raise InputError(address, "", "this kind of address is not supported", "give a folder or s3://bucket/prefix")
    return LocalStorage(Path(address))


class LocalStorage:
    """A lake in a local folder. Nothing is created before the first write."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(os.path.abspath(folder.expanduser()))
        self.address = str(self.folder)
        # delta-rs decodes such addresses a second time and DuckDB reads them as patterns: both would look elsewhere.
        if re.search(r"[\[\]*?#\\\x00-\x1f]|%[0-9A-Fa-f]{2}", self.address):
            raise InputError(self.address, "", "the lake's address holds one of [ ] * ? # \\ or %xx", "choose a folder without them")
        for place in (self.folder, *self.folder.parents):
            if os.path.isdir(place):
                break
            if os.path.lexists(place) and not os.path.isdir(place):  # which another process may have made since the first look
                problem = "this is a file, not a folder" if place == self.folder else f"lies below {place}, which is no folder"
                raise InputError(self.address, "", problem, "give a new or empty folder")

    def read(self, path: str) -> bytes:
        """See Storage."""
        with open(f"{self.address}/{path}", "rb") as file:  # a path object would take as long again
            return file.read()

    def write(self, path: str, data: bytes, lasting: bool = True) -> None:
        """See Storage. Temporary file, fsync, rename, fsync of the folder."""
        with in_words(f"{self.address}/{path}"), self._temporary(data) as temporary:
            self._placed(path, lambda target: os.replace(temporary, target), lasting)

    def write_together(self, files: Mapping[str, bytes]) -> None:
        """See Storage. A disk syncs several files in the time of one."""
        temporaries = [self.folder / TEMPORARY / new_token() for _ in files]
        try:
            with in_words(self.address), ThreadPoolExecutor(SYNCS, thread_name_prefix="syncs") as threads:
                for _ in threads.map(self._filled, temporaries, files.values()):
                    pass
            for temporary, path in zip(temporaries, files, strict=True):
                with in_words(f"{self.address}/{path}"):
                    self._placed(path, partial(os.replace, temporary), lasting=False)
            for folder in {(self.folder / path).parent for path in files}:
                _sync_folder(folder)
        finally:
            for temporary in temporaries:
                temporary.unlink(missing_ok=True)

    def move_in(self, file: Path, path: str) -> None:
        """See Storage. fsync and rename, or a copy first where the file lies on another file system."""
        import shutil

        with in_words(f"{self.address}/{path}"):
            with open(file, "rb") as handle:
                os.fsync(handle.fileno())
            try:
                self._placed(path, lambda target: os.replace(file, target))
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                with self.workplace() as folder:
                    copy = folder / "file"
                    shutil.copyfile(file, copy)
                    self.move_in(copy, path)
                file.unlink()

    def workplace(self) -> contextlib.AbstractContextManager[Path]:
        """See Storage. Below the lake's folder of temporary files."""
        return workplace(self.folder / TEMPORARY)

    def create(self, path: str, data: bytes) -> bool:
        """See Storage. A hard link to the finished temporary file, which fails when the name is taken."""
        if self.exists(path):
            return False
        # Told from outside: which error it is decides here first.
        with in_words(f"{self.address}/{path}"), self._temporary(data) as temporary:
            try:
                self._placed(path, lambda target: os.link(temporary, target))
            except FileExistsError:
                return False
            except OSError as error:
                if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EMLINK):
                    raise
                with locked(self.folder):  # no hard links on this file system: take turns instead
                    if self.exists(path):
                        return False
                    self._placed(path, lambda target: os.replace(temporary, target))
        return True

    def exists(self, path: str) -> bool:
        """See Storage."""
        return (self.folder / path).is_file()

    def refresh(self, path: str, seconds: float) -> bool:
        """See Storage."""
        target = self.folder / path
        try:
            if time.time() - target.stat().st_mtime > seconds:
                os.utime(target)
        except FileNotFoundError:
            return False
        return True

    def remove(self, path: str) -> None:
        """See Storage."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(f"{self.address}/{path}")

    def remove_all(self, paths: Sequence[str]) -> None:
        """See Storage. A disk that is told of every block that is freed takes several files in the time of one."""
        if len(paths) < 2:
            for path in paths:
                self.remove(path)
            return
        with ThreadPoolExecutor(SYNCS, thread_name_prefix="removals") as threads:
            for _ in threads.map(self.remove, paths):
                pass

    def each(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """See Storage. One after another: threads cost more than a disk lets them wait."""
        return map(work, items)

    def entries(self, folder: str) -> list[Entry]:
        """See Storage."""
        entries = []
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(self.folder / folder) as scanned:
            for entry in scanned:
                with contextlib.suppress(FileNotFoundError):  # removed by another process meanwhile
                    if entry.is_file():
                        status = entry.stat()
                        entries.append(Entry(f"{folder}/{entry.name}" if folder else entry.name, status.st_size, status.st_mtime))
        return sorted(entries, key=lambda entry: entry.path)

    def names(self, folder: str, head: str = "") -> list[str]:
        """See Storage."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(self.folder / folder) as entries:
            return sorted(entry.name for entry in entries if entry.name.startswith(head) and entry.is_file())
        return []

    def folders(self, folder: str) -> list[str]:
        """See Storage."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(self.folder / folder) as entries:
            return sorted(entry.name for entry in entries if entry.is_dir())
        return []

    def walk(self, folder: str) -> Iterator[Entry]:
        """See Storage. Links to folders are not followed."""
        for parent, _, names in os.walk(self.folder / folder):
            place = os.path.relpath(parent, self.folder)
            for name in names:
                with contextlib.suppress(FileNotFoundError):  # removed by another process meanwhile
                    status = os.stat(os.path.join(parent, name))
                    path = name if place == "." else f"{place}/{name}"
                    yield Entry(path.replace(os.sep, "/"), status.st_size, status.st_mtime)

    def read_tagged(self, path: str) -> tuple[bytes, str] | None:
        """See Storage. The tag is a hash of the contents, which must therefore differ from writer to writer."""
        try:
            data = self.read(path)
        except FileNotFoundError:
            return None
        return data, hashlib.sha256(data).hexdigest()

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        """See Storage. Compared and replaced under a lock of the kernel, which dies with its holder."""
        with locked(self.folder):
            current = self.read_tagged(path)
            if current is None or current[1] != tag:
                return False
            if data is None:
                self.remove(path)
            else:
                self.write(path, data)
            return True

    def delta_address(self, path: str) -> str:
        """See Storage."""
        return str(self.folder / path)

    def delta_options(self) -> dict[str, str] | None:
        """See Storage."""
        return None

    def arrow_filesystem(self) -> pyarrow.fs.FileSystem:
        """See Storage."""
        import pyarrow.fs

        return pyarrow.fs.LocalFileSystem()

    def arrow_path(self, path: str) -> str:
        """See Storage."""
        return str(self.folder / path)

    def duckdb_path(self, path: str) -> str:
        """See Storage."""
        return str(self.folder / path)

    def register(self, connection: Any) -> None:
        """See Storage. DuckDB reads local files by itself."""

    def local_path(self, path: str) -> Path | None:
        """See Storage."""
        return self.folder / path

    @contextlib.contextmanager
    def _temporary(self, data: bytes) -> Iterator[Path]:
        """A finished temporary file with `data`, removed at the end unless it was renamed."""
        path = self.folder / TEMPORARY / new_token()
        try:
            with in_words(self.address):
                self._filled(path, data)
            yield path
        finally:
            path.unlink(missing_ok=True)

    def _filled(self, path: Path, data: bytes) -> None:
        """Write a new temporary file that lasts."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = open(path, "xb")  # noqa: SIM115  # closed below: only what goes wrong here is the folder's fault
        except OSError as error:
            problem = f"the lake's folder cannot be made or written to ({error.strerror or error})"
            raise InputError(self.address, "", problem, "give a folder that you can write to") from error
        with handle:
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())

    def _placed(self, path: str, place: Callable[[Path], None], lasting: bool = True) -> None:
        """Call `place` with the target of `path`, and make the new name last."""
        target = self.folder / path
        try:
            place(target)
        except FileNotFoundError:
            target.parent.mkdir(parents=True, exist_ok=True)
            place(target)
        if lasting:
            _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
