"""Calls that were recorded and not committed yet, and calls that are under way.

A reply is kept the moment that it comes: its blob first, then one small file `calls/<call_id>.parquet` with its row, created only if
absent, so that of several that ask the same at once all go on with the first reply. A call that had none leaves a file of its own,
`calls/<call_id>!<token>.parquet`; no file ever changes. The next commit takes the rows into the table `model_calls`; files go after the
snapshot is there. A call under way is an empty file `calls/<call_id>@<token>`: one whose process is dead was lost, and who asks the same
again counts it.
"""

from __future__ import annotations

import dataclasses
import io
import re
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from schemas.calls import CALL_PATTERN, ModelCall
from schemas.errors import InputError
from schemas.record import arrow_to_rows, check, rows_to_arrow
from warehouse.sharing.writer import new_token, writer_of
from warehouse.tables.staging import is_left_over

if TYPE_CHECKING:
    from warehouse.storage.files import Entry, Storage

FOLDER = "calls"

_FILE = re.compile(rf"({CALL_PATTERN})(![0-9a-f-]+)?\.parquet")
_MARK = re.compile(rf"({CALL_PATTERN})@([0-9a-f-]+)")

FORGOTTEN_SECONDS = 30 * 86_400.0
"""A call that was lost and that nobody asks again within a month is no longer counted."""


class PendingCalls:
    """The recorded calls of a lake that no snapshot has yet, and the marks of those under way. prepare: Called before the first write."""

    def __init__(self, storage: Storage, prepare: Callable[[], None]) -> None:
        self._storage, self._prepare = storage, prepare
        self._known: dict[str, ModelCall] = {}  # by path: files never change

    def rows(self) -> dict[str, ModelCall]:
        """Every recorded call, by its file.

        Raises:
            InputError: a file is damaged.
        """
        paths = {f"{FOLDER}/{name}" for name in self._storage.names(FOLDER) if _FILE.fullmatch(name)}
        self._known = {path: call for path, call in self._known.items() if path in paths}
        for path in sorted(paths - self._known.keys()):
            call = self._read(path)
            if call is not None:
                self._known[path] = call
        return dict(sorted(self._known.items()))

    def all(self) -> dict[str, ModelCall]:
        """One row for each call, by its id. Raises as `rows`."""
        by_id: dict[str, list[ModelCall]] = {}
        for call in self.rows().values():
            by_id.setdefault(call.call_id, []).append(call)
        return {call_id: merged(calls) for call_id, calls in by_id.items()}

    def get(self, call_id: str) -> ModelCall | None:
        """A recorded one: with its reply, else a failure; None where it is not here. Raises as `rows`."""
        answered = self._read(_path(call_id))
        if answered is not None:
            return answered
        names = [name for name in self._storage.names(FOLDER, f"{call_id}!") if _FILE.fullmatch(name)]
        failed = [call for name in names if (call := self._read(f"{FOLDER}/{name}")) is not None]
        return merged(failed) if failed else None

    def create(self, call: ModelCall) -> bool:
        """Record a call; False where a reply to it was recorded first."""
        import pyarrow.parquet as pq

        check([call], ModelCall)
        self._prepare()
        data = io.BytesIO()
        pq.write_table(rows_to_arrow([call], ModelCall), data)
        if call.outcome == "answered":
            return self._storage.create(_path(call.call_id), data.getvalue())
        self._storage.write(f"{FOLDER}/{call.call_id}!{new_token()}.parquet", data.getvalue())
        return not self._storage.exists(_path(call.call_id))

    def remove(self, paths: Iterable[str]) -> None:
        """Remove files of calls that a snapshot has."""
        for path in paths:
            self._storage.remove(path)
            self._known.pop(path, None)

    def discard(self, call_id: str) -> None:
        """Remove a reply that a snapshot had before it was recorded again."""
        self.remove([_path(call_id)])

    def _read(self, path: str) -> ModelCall | None:
        try:
            data = self._storage.read(path)
        except FileNotFoundError:
            return None
        return _call_in(data, f"{self._storage.address}/{path}")

    def mark(self, call_id: str) -> str:
        """Say that a call is under way; the mark."""
        self._prepare()
        path = f"{FOLDER}/{call_id}@{new_token()}"
        self._storage.write(path, b"", lasting=False)
        return path

    def unmark(self, mark: str) -> None:
        """Say that it is over."""
        self._storage.remove(mark)

    def lost(self, call_id: str) -> list[str]:
        """Marks of calls with an id whose processes are dead."""
        return [entry.path for entry in self._marks() if _name(entry).startswith(f"{call_id}@") and _is_left(entry)]

    def _marks(self) -> list[Entry]:
        return [entry for entry in self._storage.entries(FOLDER) if _MARK.fullmatch(_name(entry))]

    def blob_names(self, wanted: Callable[[ModelCall], bool] = lambda call: True) -> set[str]:
        """Names of the blobs that recorded calls name; of those that are wanted."""
        calls = [call for call in self.rows().values() if wanted(call)]
        return {name for call in calls for name in (call.request_blob, call.reply_blob) if name is not None}

    def strangers(self) -> list[str]:
        """Paths in the folder that are neither a call nor a mark."""
        names = self._storage.names(FOLDER)
        return [f"{FOLDER}/{name}" for name in names if not _FILE.fullmatch(name) and not _MARK.fullmatch(name)]

    def erase(self, scene_id: str) -> None:
        """Remove the recorded calls that a scene asked."""
        self.remove([path for path, call in self.rows().items() if call.scene_id == scene_id])

    def sweep(self) -> None:
        """Remove marks of dead processes that nobody asked for any more for a month."""
        for entry in self._marks():
            if _is_left(entry) and time.time() - entry.modified > FORGOTTEN_SECONDS:
                self._storage.remove(entry.path)


def merged(calls: Sequence[ModelCall]) -> ModelCall:
    """One row of several about one call: the one with the reply, else the newest; requests and lost calls are those of all."""
    best = max(calls, key=lambda call: (call.outcome == "answered", call.asked_at))
    return dataclasses.replace(best, attempts=sum(call.attempts for call in calls), lost=sum(call.lost for call in calls))


def _name(entry: Entry) -> str:
    return entry.path.rpartition("/")[2]


def _is_left(entry: Entry) -> bool:
    """Whether who left a mark is dead, or cannot be asked and left it a day ago."""
    return is_left_over(writer_of(_name(entry).partition("@")[2]), entry.modified)


def _path(call_id: str) -> str:
    return f"{FOLDER}/{call_id}.parquet"


def _call_in(data: bytes, file: str) -> ModelCall:
    import pyarrow.parquet as pq

    try:
        rows = arrow_to_rows(pq.read_table(io.BytesIO(data)), ModelCall)
        check(rows, ModelCall)
        (call,) = rows
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(file, "", "is no recorded call", "remove it: it is asked again") from error
    assert isinstance(call, ModelCall)
    return call
