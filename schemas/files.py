"""Opening what others wrote: regular files of an agreed size, so that no pipe, device or endless file holds anybody up.

What is written for them, or kept in caches, is written here, whole or not at all.

Whatever people hand in (scans, libraries, settings, batches, datasets, exports to be checked) is opened here and nowhere else.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import os
import posixpath
import secrets
import stat
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from functools import partial
from io import BufferedReader
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError

_KINDS = {
    stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFDIR: "a folder",
}  # fmt: skip


_LONGEST_NAME = 255  # bytes, on about every file system


@dataclasses.dataclass(frozen=True, order=True)
class HeldPath:
    """A path in a folder of files that are held in memory and written nowhere: what `Path` is to those who look into a folder.

    path: From the folder, forward slashes; empty for itself. contents: Of all its files, by path.
    """

    path: str
    contents: Mapping[str, bytes] = dataclasses.field(compare=False, repr=False)

    @classmethod
    def folder(cls, contents: Mapping[str, bytes]) -> HeldPath:
        """The folder of some files.

        Raises:
            OSError: such files could not be written: a name is too long, or a file lies below another.
        """
        for path in contents:
            names = path.split("/")
            if any(len(os.fsencode(name)) > _LONGEST_NAME for name in names):
                raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG), path)
            if any("/".join(names[:count]) in contents for count in range(1, len(names))):
                raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), path)
        return cls("", contents)

    def __truediv__(self, name: str) -> HeldPath:
        joined = posixpath.normpath(posixpath.join(self.path, name))
        return HeldPath("" if joined == "." else joined, self.contents)

    @property
    def name(self) -> str:
        """See Path."""
        return posixpath.basename(self.path)

    @property
    def suffix(self) -> str:
        """See Path."""
        return Path(self.name).suffix

    @property
    def parent(self) -> HeldPath:
        """See Path."""
        return HeldPath(posixpath.dirname(self.path), self.contents)

    def is_file(self) -> bool:
        """See Path."""
        return self.path in self.contents

    def is_dir(self) -> bool:
        """See Path."""
        return any(path.startswith(f"{self.path}/" if self.path else "") for path in self.contents)

    def glob(self, pattern: str) -> Iterator[HeldPath]:
        """Files directly in this folder whose names match, in no order."""
        for path in self.contents:
            if posixpath.dirname(path) == self.path and fnmatchcase(posixpath.basename(path), pattern):
                yield HeldPath(path, self.contents)

    def read_bytes(self) -> bytes:
        """See Path."""
        if self.path not in self.contents:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.path)
        return self.contents[self.path]


AnyPath = Path | HeldPath


def open_file(path: Path, name: str, most_bytes: int) -> BufferedReader:
    """A file, open for reading. What is no regular file is not opened at all: to open a pipe waits, to open a device may act.

    Raises:
        InputError: it is no regular file, or has more than `most_bytes` bytes; names it as `name`.
        OSError: it does not exist or cannot be read.
    """
    _check(path.stat(), name, most_bytes)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        _check(os.fstat(descriptor), name, most_bytes)  # another file may have taken its place
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_file(path: AnyPath, name: str, most_bytes: int, remedy: str = "check the path and its permissions", magic: bytes = b"") -> bytes:
    """The content of a file. magic: What it begins with; of a file that does not, no more is read.

    Raises:
        InputError: it is missing, unreadable, no regular file, longer than `most_bytes`, or begins with something else than
            `magic`; says `remedy` where it cannot be read.
    """
    try:
        if isinstance(path, HeldPath):
            held = path.read_bytes()
            if len(held) > most_bytes:
                raise too_large(name, str(len(held)), most_bytes)
            if not held.startswith(magic):
                raise _other(name, magic)
            return held
        with open_file(path, name, most_bytes) as file:
            if file.read(len(magic)) != magic:
                raise _other(name, magic)
            file.seek(0)
            data = file.read(os.fstat(file.fileno()).st_size)
            while more := file.read(1 << 20):  # it grows, or the kernel makes it while it is read and says that it is empty
                data += more
                if len(data) > most_bytes:
                    raise too_large(name, f"more than {most_bytes}", most_bytes)
            return data
    except OSError as error:
        raise InputError(name, "file", f"cannot be read ({error.strerror or error})", remedy) from error


def is_there(path: AnyPath) -> bool:
    """Whether a path that some file names is that of a regular file. A name that no file can have, too long or with a zero, is of none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_irregular(path: Path) -> bool:
    """Whether something is at a path that is neither a regular file nor a link to one: a folder, a pipe, a device."""
    try:
        return path.exists() and not path.is_file()
    except (OSError, ValueError):
        return False


def sane_bytes(path: Path) -> int:
    """How many bytes a file of its kind may have before anything looks into it; readers have limits of their own."""
    kind = path.suffix.lower()
    if kind in (".txt", ".log"):
        return BUDGET.text_bytes
    if kind in (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff"):
        return BUDGET.image_bytes
    return {".csv": BUDGET.table_bytes, ".json": BUDGET.json_bytes, ".sens": BUDGET.sens_bytes}.get(kind, BUDGET.scene_bytes)


def check_file(path: Path, name: str, most_bytes: int) -> None:
    """Refuse what `open_file` would refuse, without opening it.

    Raises:
        InputError: it is no regular file, or has more than `most_bytes` bytes; names it as `name`.
        OSError: it does not exist.
    """
    _check(path.stat(), name, most_bytes)


def stays_in(path: Path, *folders: Path) -> bool:
    """Whether a path leads into one of some folders, every link on the way followed; a link in a circle leads nowhere.

    What it leads to need not exist.
    """
    try:
        real = path.resolve()
    except (OSError, RuntimeError, ValueError):  # Python's own errors for circles, and for names that none can be
        return False
    return any(real.is_relative_to(folder.resolve()) for folder in folders)


def _check(status: os.stat_result, name: str, most_bytes: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise InputError(name, "file", f"is {kind}, not a regular file", "put the file itself in its place")
    if status.st_size > most_bytes:
        raise too_large(name, str(status.st_size), most_bytes)


def _other(name: str, magic: bytes) -> InputError:
    return InputError(name, "content", f"does not begin with {magic.decode()!r}", "is it the right file?")


def too_large(name: str, size: str, most_bytes: int) -> InputError:
    """The refusal of a file that has more than `most_bytes` bytes."""
    return InputError(name, "size", f"is {size} bytes, at most {most_bytes} are read", "is it the right file?")


@contextlib.contextmanager
def making(path: Path) -> Iterator[Path]:
    """A name beside `path` to make a file under, which is then put in its place; after an error all is as before. Folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name[:80]}.{secrets.token_hex(6)}.making")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes, cache: bool = False) -> None:
    """Replace a file's contents. Of a `cache`, only its user may read it, and a power failure may take it."""
    opened = partial(os.open, mode=0o600 if cache else 0o666)
    with making(path) as unfinished, open(unfinished, "xb", opener=opened) as file:
        file.write(data)
        file.flush()
        if not cache:
            os.fsync(file.fileno())
