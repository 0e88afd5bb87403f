"""Held files: who is at work on a lake, in small files with facts that one living process holds at a time.

A held file is created only if absent, renewed by a thread while its holder lives, and given back at the end. It may be
taken over when its holder is dead: on the same machine when the process is gone, from elsewhere when the file was not
renewed in time. What the same process once held and could not give back counts like something from elsewhere.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import socket
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Self, TypeVar

from schemas.parsing import json_value
from warehouse.sharing.writer import new_token, this_writer, writer_of
from warehouse.storage.files import Storage

# Renewed three times within its life, so that two renewals may be late before anybody takes it over.
LIFE_SECONDS = 60.0

RENEWERS = 16
"""Files renewed at a time. A distant store takes 0.1 s for one: thousands are then renewed well within their life."""

Facts = Mapping[str, Any]
_Record = TypeVar("_Record")


@dataclasses.dataclass(frozen=True)
class Holder:
    """Who holds a file, until when if not renewed [s since the epoch]."""

    token: str
    host: str
    expires: float
    life: float

    @property
    def is_gone(self) -> bool:
        """Whether the file may be taken over."""
        writer = writer_of(self.token)
        # Our own process lives, of course: what it no longer renews it could not give back, because the storage was away.
        if writer is not None and writer.is_here and writer != this_writer():
            return not writer.is_alive
        return time.time() > self.expires


class Hold:
    """One file that at most one living process holds. `facts` are written into it beside who holds it.

    Nothing here waits or renews by itself.
    """

    def __init__(self, storage: Storage, path: str, token: str, life: float, facts: Facts | None = None) -> None:
        self.token, self.life, self.facts = token, life, facts or {}
        self._storage, self._path = storage, path
        self._tag: str | None = None
        self._renewed = 0.0
        self._lock = threading.Lock()

    @property
    def is_held(self) -> bool:
        """Whether the file was ours when it was last taken, renewed or given back."""
        return self._tag is not None

    def is_older_than(self, seconds: float) -> bool:
        """Whether it was taken or renewed more than `seconds` ago."""
        return time.time() > self._renewed + seconds

    def take(self) -> bool:
        """Take the file if it is not there or its holder is gone; whether it is ours now."""
        with self._lock:
            now = time.time()
            content = self._content(now)
            if not self._storage.create(self._path, content):
                read = self._storage.read_tagged(self._path)
                if read is None:
                    return False
                holder = parsed(read[0])
                # Our own token: the write went through, and only its answer was lost on the way.
                is_free = holder is None or holder.is_gone or holder.token == self.token
                if not is_free or not self._storage.swap(self._path, content, read[1]):
                    return False
            return self._is_ours(now)

    def renew(self) -> bool:
        """Say that we live, with the facts of now; whether the file is still ours. One that is not is lost for good."""
        with self._lock:
            return self._renew()

    def give_back(self) -> None:
        """Remove the file if it is ours."""
        with self._lock:
            # Overdue: it may be taken over in this moment, which only a write with the tag rules out on every store.
            if self.is_older_than(self.life / 2) and not self._renew():
                return
            if self._tag is not None:
                self._storage.swap(self._path, None, self._tag)
                self._tag = None

    def _renew(self) -> bool:
        for _ in range(2):
            if self._tag is None:
                return False
            now = time.time()
            if self._storage.swap(self._path, self._content(now), self._tag):
                return self._is_ours(now)
            # A write whose answer was lost on the way has changed the tag, and the file is still ours.
            self._tag = self._own_tag()
        self._tag = None
        return False

    def _content(self, now: float) -> bytes:
        holder = Holder(self.token, socket.gethostname(), now + self.life, self.life)
        return json.dumps({**self.facts, **dataclasses.asdict(holder)}).encode()

    def _is_ours(self, now: float) -> bool:
        """Whether the file that was written at a time is ours, as far as the storage tells."""
        self._tag, self._renewed = self._own_tag(), now
        return self._tag is not None

    def _own_tag(self) -> str | None:
        """Tag of the file if it is ours."""
        read = self._storage.read_tagged(self._path)
        holder = parsed(read[0]) if read else None
        return read[1] if read and holder and holder.token == self.token else None


class Keeper:
    """``with Keeper(storage) as keeper: ...``: the files that a process holds under one token, renewed by one thread.

    Leaving gives all of them back. What a renewal raises is let go: the storage may be back at the next one, and who
    depends on a file asks for itself. If it is not back, others take the file over when its life is over.
    """

    def __init__(self, storage: Storage, life: float = LIFE_SECONDS, pause: float | None = None) -> None:
        self._storage, self._life, self._pause = storage, life, life / 3 if pause is None else pause
        self._token = ""
        self._holds: dict[str, Hold] = {}
        self._lost: set[str] = set()
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._token = new_token()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()  # after a renewal that is under way
        with contextlib.ExitStack() as rest:  # every file is tried, and the last error is raised
            for key in list(self._holds):
                rest.callback(self.release, key)

    def release(self, key: str) -> None:
        """Give a file back. One that is not ours is no error."""
        with self._lock:
            hold = self._holds.pop(key, None)
        if hold is not None:
            hold.give_back()

    def _take(self, key: str, path: str, facts: Facts | None = None) -> bool:
        """Whether a file is ours now: nobody had it, its holder is dead, or it was ours before. Never waits."""
        with self._lock:
            if self._is_fresh(key):
                return True
            hold = Hold(self._storage, path, self._token, self._life, facts)
            if not hold.take():
                return False
            self._holds[key] = hold
            self._lost.discard(key)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name=type(self).__name__, daemon=True)
                self._thread.start()
            return True

    def _is_fresh(self, key: str) -> bool:
        """Whether a file was taken or renewed within its life."""
        hold = self._holds.get(key)
        return hold is not None and hold.is_held and not hold.is_older_than(self._life)

    def _work(self) -> None:
        pause = self._pause
        while not self._stopped.wait(pause):
            begun = time.monotonic()
            with contextlib.suppress(Exception):
                self._renew()
            pause = max(0.0, self._pause - (time.monotonic() - begun))

    def _renew(self) -> None:
        with self._lock:
            holds = dict(self._holds)
        if len(holds) < 2:  # by this thread alone: no further one can be had while the interpreter ends
            list(map(self._renew_one, holds, holds.values()))
            return
        with ThreadPoolExecutor(min(RENEWERS, len(holds)), thread_name_prefix="renewers") as renewers:
            list(renewers.map(self._renew_one, holds, holds.values()))

    def _renew_one(self, key: str, hold: Hold) -> None:
        with contextlib.suppress(Exception):
            if not hold.renew():
                self._lose(key, hold)

    def _lose(self, key: str, hold: Hold) -> None:
        with self._lock:
            if self._holds.get(key) is hold:  # not released meanwhile
                del self._holds[key]
                self._lost.add(key)


def parsed(content: bytes) -> Holder | None:
    """The holder; None when the file says nothing readable, which nobody's does that was written whole."""
    with contextlib.suppress(ValueError, KeyError, TypeError):
        return holder_from(json_value(content))
    return None


def holder_from(fields: Facts) -> Holder:
    """The holder that a file's fields name.

    Raises:
        ValueError, KeyError, TypeError: the fields are not those of a holder.
    """
    try:
        return Holder(str(fields["token"]), str(fields["host"]), float(fields["expires"]), float(fields["life"]))
    except OverflowError as error:
        raise ValueError(str(error)) from error


def held_in(
    storage: Storage, folder: str, record: Callable[[Holder, Facts], _Record], path_of: Callable[[_Record], str]
) -> list[tuple[str, Holder, _Record]]:
    """The held files of a folder, whoever holds them: path, holder and what `record` makes of the facts.

    What cannot be read, or lies elsewhere than `path_of` says, is none of the lake's. Reading takes part in nothing.
    """
    files = []
    for name in storage.names(folder):
        path = f"{folder}/{name}"
        read = storage.read_tagged(path)
        if read is None:  # given back meanwhile
            continue
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
            fields = json_value(read[0])
            holder = holder_from(fields)
            made = record(holder, fields)
            if path == path_of(made):
                files.append((path, holder, made))
    return files
