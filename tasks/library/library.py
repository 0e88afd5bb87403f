"""A library that is opened for retrieval: what is searched, and the assets of what is found."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from tasks.library.search import LibrarySearch

if TYPE_CHECKING:
    from tasks.candidates.assets import MadeAsset


@dataclasses.dataclass(frozen=True, eq=False)
class OpenLibrary:
    """An opened library. Other processes open it for themselves: it is sent to them as the way to it.

    name: Of a library of the lake; None for a folder. weights: Hash of the model that its vectors are of; '' where it has none. notes:
    What is odd about it and what was left out, a line each. asset_of: The asset of a file in the index, with its GLB where the lake does
    not have that; raises InputError where the file is another by now. blobs: What the lake has of its assets. way: A function and its
    arguments that open it.
    """

    name: str | None
    search: LibrarySearch
    weights: str
    notes: tuple[str, ...]
    asset_of: Callable[[str], MadeAsset]
    blobs: Mapping[str, bytes]
    way: tuple[Callable[..., OpenLibrary], tuple[Any, ...]]

    def __reduce__(self) -> tuple[Callable[..., OpenLibrary], tuple[Any, ...]]:
        return self.way
