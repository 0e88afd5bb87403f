"""A folder of models that is used as it is: indexed on first use, each file once for a machine and each folder once for a process."""

from __future__ import annotations

from collections.abc import MutableMapping
from functools import lru_cache
from pathlib import Path

from tasks.candidates.assets import MadeAsset
from tasks.library.catalog import catalog_of, library_files
from tasks.library.indexing import IndexConfig, ModelIndex, Spread, entry_asset, index_folder, refused_first
from tasks.library.library import OpenLibrary
from tasks.library.search import LibrarySearch

CACHED_ASSETS = 64
"""How many finished assets (megabytes each) a process keeps."""

Mark = tuple[tuple[str, int, int], ...]
"""Files of a folder with their sizes and times of change."""

_OPEN: dict[tuple[Path, IndexConfig], tuple[Mark, OpenLibrary]] = {}


def library_in(folder: Path, config: IndexConfig, store: MutableMapping[str, bytes], spread: Spread = map) -> OpenLibrary:
    """The library of a folder; the one that this process has open, unless a file changed since. store: Remembers entries by content.

    Raises:
        InputError: there is no such folder, or the weights of the config cannot be used.
    """
    mark = tuple((str(path), stat.st_size, stat.st_mtime_ns) for path in library_files(folder) for stat in (path.stat(),))
    known = _OPEN.get((folder, config))
    if known is None or known[0] != mark:
        known = mark, _indexed(folder, config, store, spread)
        _OPEN.clear()  # a run has one library
        _OPEN[folder, config] = known
    return known[1]


def _indexed(folder: Path, config: IndexConfig, store: MutableMapping[str, bytes], spread: Spread) -> OpenLibrary:
    catalog = catalog_of(folder)
    index = index_folder(folder, catalog, config, store, spread)
    by_file = {entry.file: entry for entry in index.entries}

    @lru_cache(maxsize=CACHED_ASSETS)
    def asset_of(file: str) -> MadeAsset:
        return entry_asset(by_file[file], folder, catalog.of(file))

    search, weights = LibrarySearch.of(index.entries), weights_of(index)
    return OpenLibrary(None, search, weights, (*catalog.notes, *refused_first(index)), asset_of, {}, (library_in, (folder, config, store)))


def weights_of(index: ModelIndex) -> str:
    """Hash of the model whose vectors the search compares; '' where it compares none."""
    return index.entries[0].weights if index.entries else ""
