"""Refusals of the operating system (a full disk, a file that may not be written, one that is gone) as one kind of error.

Delta-rs, DuckDB and Arrow each have errors of their own for it, and delta-rs panics now and then: whoever waits for room,
and whoever reads the line, must not have to know them all.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from schemas.errors import InputError, LakeError
from schemas.text import one_line

if TYPE_CHECKING:
    from warehouse.storage.files import Storage

REMEDIES = {
    errno.ENOSPC: "free some room and give the command again",
    errno.EDQUOT: "free some room and give the command again",
    errno.EFBIG: "raise the limit on the size of files and give the command again",
    errno.EROFS: "give one that can be written to",
    errno.EACCES: "check who may read and write it",
    errno.EPERM: "check who may read and write it",
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "raise the limit on open files (ulimit -n)",
    errno.EIO: "check the disk",
    errno.ENOTDIR: "check the address: a part of it is a file",
    errno.EISDIR: "check the address: it is a folder",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOENT: "check that it is there",
}
"""What to do about what the system refuses, by its number."""

_IN_WORDS = {os.strerror(number): number for number in REMEDIES}
_FOREIGN = ("_duckdb", "duckdb", "deltalake", "pyarrow", "pyo3_runtime", "builtins", "_internal")


class Refused(LakeError, OSError):
    """A refusal of the operating system: the place, the error number, and what to do."""

    def __init__(self, place: str, number: int) -> None:
        super().__init__(place, number)
        self.errno, self.strerror = number, os.strerror(number)

    def __str__(self) -> str:
        place, number = self.args
        return f"{place}: {os.strerror(number)}; {REMEDIES.get(number, 'give the command again')}"


def number_of(error: BaseException) -> int | None:
    """The error number of the system behind an error of Python or of a library; None where there is none."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    if not type(error).__module__.startswith(_FOREIGN):
        return None
    text = str(error)
    return next((number for words, number in _IN_WORDS.items() if words in text), None)


class StoreAway(LakeError, ConnectionError):
    """A store that does not answer; it may later."""

    def __init__(self, address: str, endpoint: str) -> None:
        super().__init__(address, endpoint)
        self.errno = None  # two arguments of an OSError are taken for its number and words

    def __str__(self) -> str:
        address, endpoint = self.args
        return f"{address}: the store at {endpoint} does not answer; check AWS_ENDPOINT_URL and that it runs"


@contextlib.contextmanager
def in_words(place: str) -> Iterator[None]:
    """Raise errors of the system that libraries report as `Refused` at a place, and panics of delta-rs as exceptions.

    Raises:
        Refused: the system refuses it.
        RuntimeError: delta-rs panicked for another reason.
    """
    try:
        yield
    except LakeError:
        raise
    except BaseException as error:
        is_panic = type(error).__name__ == "PanicException"
        if not (is_panic or isinstance(error, Exception)):
            raise
        number = number_of(error)
        if number is not None and not isinstance(error, FileNotFoundError):
            raise Refused(place, number) from error
        if is_panic:
            raise RuntimeError(f"{place}: delta-rs gave up: {one_line(error)}") from error
        raise


class MissingFile(InputError):
    """A data file of a lake is not there: a vacuum put others in its place, or the lake is damaged."""


@contextlib.contextmanager
def named(storage: Storage) -> Iterator[None]:
    """Name the file of a lake that DuckDB or Arrow finds missing or damaged; for any other as `told`.

    Raises:
        InputError: a data file is missing or damaged.
    """
    with in_words(storage.address):
        try:
            yield
        except Exception as error:
            if isinstance(error, LakeError) or not (isinstance(error, OSError) or type(error).__module__.startswith(_FOREIGN)):
                raise
            match = re.search(r"(?:^|[/'\"\s])(tables/[^\s'\"]+\.parquet)", str(error))
            if match is None:
                raise
            is_gone = isinstance(error, FileNotFoundError) or number_of(error) == errno.ENOENT or "No files found" in str(error)
            problem = "is missing" if is_gone else f"cannot be read ({one_line(error)[:200]})"
            kind = MissingFile if is_gone else InputError
            raise kind(storage.address, match[1], problem, "`metascenes doctor lake` says what is damaged") from error
