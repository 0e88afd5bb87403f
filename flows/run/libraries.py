"""The library that a run takes candidates from: one of the lake by its name, or a folder. Does not import Prefect."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.run.fingerprints import FileHashes, digest
from schemas.errors import InputError, LakeError
from schemas.indexing import LIBRARY_PATTERN, IndexedLibrary
from warehouse.lake import Lake

if TYPE_CHECKING:
    from tasks.candidates.assets import MadeAsset
    from tasks.library.library import OpenLibrary
    from warehouse.tables.snapshot import Reader

NONE = "none"
"""What stands for no library among a stage's inputs."""

SIGN = "@"
"""Between the name of a library of the lake and its content; no hash of a folder has one."""


@dataclasses.dataclass(frozen=True)
class NamedLibrary:
    """A library of the lake, with the content that a run was planned with."""

    name: str
    content: str


def given_library(text: str) -> Path:
    """What a person names as a library. Whatever has a separator is a folder, `./models` and `models/` too, and made absolute so that it
    stays one."""
    path = Path(text)
    return path.absolute() if "/" in text or os.sep in text else path


def may_be_name(given: Path) -> bool:
    """Whether a library that a run was given may be one of the lake: folders are told by more of their path."""
    return len(given.parts) == 1 and re.fullmatch(LIBRARY_PATTERN, given.name) is not None


def library_input(lake: Lake, given: Path | None, hashes: FileHashes) -> str:
    """What a stage's inputs say of a run's library: `<name>@<content>` of one of the lake, the hash of a folder's files, or `none`.

    Raises:
        InputError: there is neither such a library nor such a folder.
    """
    if given is None:
        return NONE
    if may_be_name(given) and lake.exists:
        known = indexed_library(lake.snapshot(), given.name)
        if known is not None:
            return f"{known.library}{SIGN}{known.content}"
    if not given.is_dir():
        problem = f"is neither a library of {lake.address} nor a folder"
        raise InputError(str(given), "library", problem, "`metascenes library list` names those of the lake")
    return folder_hash(given, hashes)


def library_of_input(given: Path | None, value: str) -> Path | NamedLibrary | None:
    """The library that `library_input` spoke of, as a job has it."""
    name, sign, content = value.partition(SIGN)
    return NamedLibrary(name, content) if sign else given


def indexed_library(reader: Reader, name: str) -> IndexedLibrary | None:
    """The row of a library of the lake; None where there is none of that name."""
    return next(iter(reader.rows_by_key(IndexedLibrary, [name])), None)


def folder_hash(folder: Path, hashes: FileHashes) -> str:
    """Hash of the files that decide what a folder holds. Those that cannot be read count as such: they are left out, and it is said so.

    Raises:
        InputError: there is no such folder.
    """
    from tasks.library.catalog import library_files

    parts = []
    for path in library_files(folder):
        try:
            value = hashes.hash(path)
        except (OSError, InputError):
            value = "unreadable"
        name = path.relative_to(folder).as_posix().encode(errors="backslashreplace").decode()
        parts.append(f"{name}={value}")
    return digest(*parts)


_OPEN: dict[tuple[str, str, str], OpenLibrary] = {}
"""Libraries that this process has open, by lake, name and content; a run has one."""


def library_for_worker(address: str, name: str, content: str, snapshot_id: int | None) -> OpenLibrary | None:
    """A library of a lake, opened once for a process: of the newest snapshot or the one that a job was planned from, whichever has that
    content; None where neither has."""
    key = address, name, content
    if key not in _OPEN:
        lake = Lake.open(address)
        known = (
            (reader, row)
            for reader in _readers(lake, snapshot_id)
            if (row := indexed_library(reader, name)) is not None and row.content == content
        )
        reader, row = next(known, (None, None))
        if reader is None or row is None:
            return None
        _OPEN.clear()
        _OPEN[key] = _opened(lake, reader, row, (_reopened, (*key, snapshot_id)))
    return _OPEN[key]


def _readers(lake: Lake, snapshot_id: int | None) -> Iterator[Reader]:
    """The newest snapshot, and the one of a number as far as the lake still has it."""
    yield lake.snapshot()
    if snapshot_id is not None:
        with contextlib.suppress(InputError):
            yield lake.snapshot(snapshot_id)


def _reopened(address: str, name: str, content: str, snapshot_id: int | None) -> OpenLibrary:
    """The same in another process of a worker."""
    library = library_for_worker(address, name, content, snapshot_id)
    if library is None:
        raise LakeError(f"library {name}: it was indexed again or removed meanwhile")
    return library


def _opened(lake: Lake, reader: Reader, row: IndexedLibrary, way: tuple[Callable[..., OpenLibrary], tuple[Any, ...]]) -> OpenLibrary:
    from tasks.library.library import OpenLibrary
    from tasks.library.search import LibrarySearch

    search = LibrarySearch.unpacked(lake.blobs[row.search_blob])
    return OpenLibrary(row.library, search, row.weights or "", row.notes, _Assets(lake, _entry_blobs(reader, row.library)), lake.blobs, way)


def _entry_blobs(reader: Reader, name: str) -> dict[str, str]:
    """Blobs of a library's entries by file."""
    rows = reader.matching("library_models", {"library": [name]}, ["file", "entry_blob"])
    return dict(zip(rows.column("file").to_pylist(), rows.column("entry_blob").to_pylist(), strict=True))


class _Assets:
    """The assets of a library of the lake by file; their GLBs are in the lake already."""

    def __init__(self, lake: Lake, entries: Mapping[str, str]) -> None:
        self._lake, self._entries = lake, entries

    def __call__(self, file: str) -> MadeAsset:
        from tasks.candidates.assets import MadeAsset
        from tasks.library.entry import loaded

        try:
            entry = loaded(self._lake.blobs[self._entries[file]])
        except (KeyError, ValueError) as error:
            # as a store that is away: the scene is lost to this run, and no slot is marked as failed for good
            raise ConnectionError(f"library: {file}: its entry is gone, or of other code; `metascenes library add` it again") from error
        return MadeAsset(entry.asset, {}, charts=entry.charts)
