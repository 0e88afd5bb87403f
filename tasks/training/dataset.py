"""What is learned from: the rows of one snapshot or release, as streams."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Protocol, TypeVar

R = TypeVar("R")


class Dataset(Protocol):
    """The rows of one snapshot or release. `name` is what rows call it: 'snapshot 12', 'release v1'.

    Blobs that the rows name are in `context.blobs`; what is computed from them is cached by content in `context.caches`.
    """

    name: str

    def rows(self, record: type[R]) -> Iterator[R]:
        """Rows of a record type, in the order of its key; of tables with a scene in their key, one scene after another.

        Never are all rows in memory at once. Of annotations these are the answers that count, and those of simulated annotators.
        """
        ...


class RowsInMemory:
    """A dataset of lists of rows, for tests and for what is made up."""

    def __init__(self, name: str, *rows: object) -> None:
        self.name = name
        self._rows = rows

    def rows(self, record: type[R]) -> Iterator[R]:
        """Rows of a record type, in the order that they were given in."""
        return (row for row in self._rows if isinstance(row, record))


@dataclasses.dataclass(frozen=True)
class Provenance:
    """What a training follows from besides config and seed, as rows say it.

    fingerprint: Hash of the runs that wrote the rows of the dataset. code: Hash of the code of the learned system.
    """

    snapshot_id: int | None
    release: str | None
    fingerprint: str
    code: str
