"""Content-addressed files of the lake: `blobs/ab/cd/<sha256>.<extension>`, written once for the whole lake."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from schemas.errors import InputError, LakeError
from schemas.record import BLOB_PATTERN
from warehouse.storage.files import Storage

FOLDER = "blobs"

_FRESH_SECONDS = 3600.0

_WRITERS = 8
"""Threads that wait for the store at a time: a disk syncs many files at once, and a store over the network answers each by itself."""


class BlobStore(Mapping[str, bytes]):
    """Blobs by name, `<sha256>.<extension>`. Reading checks the contents against the name."""

    def __init__(self, storage: Storage, prepare: Callable[[], None]) -> None:
        self._storage, self._prepare = storage, prepare
        self._known: set[str] = set()

    def put(self, data: bytes, extension: str) -> str:
        """Keep `data` and return its name. Written once, whole or not at all."""
        name = f"{hashlib.sha256(data).hexdigest()}.{extension}"
        self._keep(name, data)
        return name

    def put_all(self, blobs: Mapping[str, bytes]) -> None:
        """Keep many blobs under the names that they have, several at a time.

        Raises:
            LakeError: one has another content than its name says; the others may have been kept.
        """
        for name, data in blobs.items():
            if not _hash_matches(data, name):
                raise LakeError(f"blob {name[:12]} does not have the content that its name says")
        if blobs:
            self._prepare()
        with ThreadPoolExecutor(_WRITERS, thread_name_prefix="blobs") as writers:
            writes = [writers.submit(self._keep, name, data) for name, data in blobs.items()]
        for write in writes:
            write.result()

    def _keep(self, name: str, data: bytes) -> None:
        path = _path(name)
        # Refreshed even when it is there, so that a vacuum does not take it for garbage before a row names it.
        if not self._storage.refresh(path, _FRESH_SECONDS):
            self._prepare()
            self._storage.write(path, data)
        self._known.add(name)

    def refresh(self, name: str) -> bool:
        """Whether a blob is there; if so, it counts as put now, so that a vacuum does not take it before a row names it."""
        return self._storage.refresh(_path(name), _FRESH_SECONDS)

    def remove(self, path: str) -> None:
        """Remove the blob at a path. Only what no row names, and only while the lake's lease is held."""
        self._storage.remove(path)
        self._known.discard(path.rpartition("/")[2])

    def path(self, name: str) -> Path:
        """Where a blob lies in the local file system.

        Raises:
            InputError: there is no such blob, or the lake is not in a local folder.
        """
        path = self._storage.local_path(_path(name))
        if path is None:
            raise InputError(self._storage.address, name, "the lake is not in a local folder", "read the blob's bytes instead")
        if not path.is_file():
            raise InputError(self._storage.address, name, "there is no such blob in the lake")
        return path

    def __getitem__(self, name: str) -> bytes:
        try:
            data = self._storage.read(_path(name))
        except FileNotFoundError:
            raise KeyError(name) from None
        if not _hash_matches(data, name):
            raise InputError(self._storage.address, name, "the blob's contents do not hash to its name", "restore the file")
        return data

    def __contains__(self, name: object) -> bool:
        if not isinstance(name, str) or not re.fullmatch(BLOB_PATTERN, name):
            return False
        # A vacuum leaves blobs alone that were put a day ago or later, so what was seen once is there.
        if name not in self._known and self._storage.exists(_path(name)):
            self._known.add(name)
        return name in self._known

    def __iter__(self) -> Iterator[str]:
        for first in self._storage.folders(FOLDER):
            for second in self._storage.folders(f"{FOLDER}/{first}"):
                for entry in self._storage.entries(f"{FOLDER}/{first}/{second}"):
                    yield entry.path.rpartition("/")[2]

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _path(name: str) -> str:
    if not re.fullmatch(BLOB_PATTERN, name):
        raise InputError(name, "", "this is no blob name", "blobs are named <sha256>.<extension>")
    return f"{FOLDER}/{name[:2]}/{name[2:4]}/{name}"


def _hash_matches(data: bytes, name: str) -> bool:
    return hashlib.sha256(data).hexdigest() == name.partition(".")[0]
