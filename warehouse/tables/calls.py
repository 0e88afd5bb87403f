"""Calls that were recorded and not committed yet, and calls that are under way.

A reply is kept the moment that it comes: its blob first, then one small file `calls/<call_id>.parquet` with its row, created only if
absent, so that of several that ask the same at once all go on with the first reply. The next commit takes the rows into the table
`model_calls`; files go after the snapshot is there. A call under way is an empty file `calls/<call_id>@<token>`: one whose process is
dead was lost, and who asks the same again counts it.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import pyarrow as pa

from schemas.calls import CALL_PATTERN, ModelCall
from schemas.errors import InputError
from schemas.record import arrow_to_rows, check, rows_to_arrow
from warehouse.sharing.writer import new_token, writer_of

if TYPE_CHECKING:
    from warehouse.storage.files import Storage

FOLDER = "calls"

_FILE = re.compile(rf"({CALL_PATTERN})\.parquet")
_MARK = re.compile(rf"({CALL_PATTERN})@([0-9a-f-]+)")

FORGOTTEN_SECONDS = 30 * 86_400.0
"""A call that was lost and that nobody asks again within a month is no longer counted."""


class PendingCalls:
    """The recorded calls of a lake that no snapshot has yet, and the marks of those under way. prepare: Called before the first write."""

    def __init__(self, storage: Storage, prepare: Callable[[], None]) -> None:
        self._storage, self._prepare = storage, prepare
        self._known: dict[str, ModelCall] = {}  # by id: files never change once they are there

    def all(self) -> dict[str, ModelCall]:
        """The recorded ones, by id.

        Raises:
            InputError: a file is damaged.
        """
        ids = self._ids()
        self._known = {call_id: call for call_id, call in self._known.items() if call_id in ids}
        for call_id in sorted(ids - self._known.keys()):
            self.get(call_id)
        return dict(sorted(self._known.items()))

    def get(self, call_id: str) -> ModelCall | None:
        """A recorded one; None where it is not here.

        Raises:
            InputError: its file is damaged.
        """
        try:
            data = self._storage.read(_path(call_id))
        except FileNotFoundError:
            self._known.pop(call_id, None)
            return None
        self._known[call_id] = _call_in(data, f"{self._storage.address}/{_path(call_id)}")
        return self._known[call_id]

    def create(self, call: ModelCall) -> bool:
        """Record a call; False where another one with its id was recorded first, unless that one has no reply."""
        import pyarrow.parquet as pq

        check([call], ModelCall)
        self._prepare()
        data = io.BytesIO()
        pq.write_table(rows_to_arrow([call], ModelCall), data)
        if self._storage.create(_path(call.call_id), data.getvalue()):
            return True
        before = self.get(call.call_id)
        if before is not None and (before.outcome == "answered" or call.outcome != "answered"):
            return False
        self._storage.write(_path(call.call_id), data.getvalue())  # a reply takes the place of a failure
        return True

    def remove(self, calls: Iterable[ModelCall]) -> None:
        """Remove recorded calls that a snapshot has, unless the file says something else by now."""
        for call in calls:
            if self.get(call.call_id) == call:
                self._storage.remove(_path(call.call_id))
                self._known.pop(call.call_id, None)

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
        marks = [name for name in self._storage.names(FOLDER, f"{call_id}@") if _MARK.fullmatch(name)]
        return [f"{FOLDER}/{name}" for name in marks if _is_dead(name)]

    def blob_names(self, wanted: Callable[[ModelCall], bool] = lambda call: True) -> set[str]:
        """Names of the blobs that recorded calls name; of those that are wanted."""
        calls = [call for call in self.all().values() if wanted(call)]
        return {name for call in calls for name in (call.request_blob, call.reply_blob) if name is not None}

    def strangers(self) -> list[str]:
        """Paths in the folder that are neither a call nor a mark."""
        names = self._storage.names(FOLDER)
        return [f"{FOLDER}/{name}" for name in names if not _FILE.fullmatch(name) and not _MARK.fullmatch(name)]

    def erase(self, scene_id: str) -> None:
        """Remove the recorded calls that a scene asked."""
        self.remove([call for call in self.all().values() if call.scene_id == scene_id])

    def sweep(self) -> None:
        """Remove marks of dead processes that nobody asked for any more for a month."""
        for entry in self._storage.entries(FOLDER):
            name = entry.path.rpartition("/")[2]
            if _MARK.fullmatch(name) and _is_dead(name) and time.time() - entry.modified > FORGOTTEN_SECONDS:
                self._storage.remove(entry.path)

    def _ids(self) -> set[str]:
        return {match[1] for name in self._storage.names(FOLDER) if (match := _FILE.fullmatch(name))}


def _is_dead(name: str) -> bool:
    writer = writer_of(name.partition("@")[2])
    return writer is not None and not writer.is_alive


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
