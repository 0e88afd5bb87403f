"""Objects of a store for DuckDB and Arrow, which read pieces of them through fsspec's interface.

obstore's own class for it keeps one position for all threads, and DuckDB reads a file in several: its rows came out wrong.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from datetime import datetime
from typing import Any

from fsspec import AbstractFileSystem


class RangeFiles(AbstractFileSystem):
    """The objects of a bucket below a place, `bucket/prefix`, to be read; `ask` puts a question to the store."""

    cachable = False

    def __init__(self, scheme: str, place: str, ask: Callable[[str, Callable[[Any], Any]], Any]) -> None:
        super().__init__()
        self.protocol, self._place, self._ask = scheme, place, ask

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return path.rpartition("://")[2]

    def info(self, path: str, **options: Any) -> dict[str, Any]:
        """Name, size [B] and time of an object. Raises FileNotFoundError."""
        name = self._strip_protocol(path)
        below = name.removeprefix(f"{self._place}/")
        if below == name:
            raise FileNotFoundError(2, "lies outside of the lake", name)
        head = self._ask(below, lambda store: store.head(below))
        return {"name": name, "below": below, "size": int(head["size"]), "type": "file", "mtime": head["last_modified"]}

    def modified(self, path: str) -> datetime:
        """When an object was put."""
        at: datetime = self.info(path)["mtime"]
        return at

    def open(self, path: str, mode: str = "rb", **options: Any) -> io.RawIOBase:
        """An object, to be read. Raises FileNotFoundError."""
        head = self.info(path)
        below = head["below"]
        return _Ranges(head["size"], lambda start, end: self._ask(below, lambda store: bytes(store.get_range(below, start=start, end=end))))


class _Ranges(io.RawIOBase):
    """An object whose pieces are fetched as they are read. Each thread has a position of its own."""

    def __init__(self, size: int, fetch: Callable[[int, int], bytes]) -> None:
        self._size, self._fetch, self._at = size, fetch, threading.local()

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return int(getattr(self._at, "position", 0))

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at.position = offset + (0, self.tell(), self._size)[whence]
        return self.tell()

    def read(self, size: int | None = -1) -> bytes:
        start = self.tell()
        end = self._size if size is None or size < 0 else min(start + size, self._size)
        self._at.position = max(start, end)
        return self._fetch(start, end) if end > start else b""
