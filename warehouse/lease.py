"""The lake's lease: whoever holds it is the one committer.

A file that is created only if absent and renewed by a thread while its owner lives. It is taken over when the
owner is dead: on the same machine when its process is gone, from elsewhere when it was not renewed in time.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import random
import socket
import threading
import time
from types import TracebackType

from schemas.errors import LakeError
from warehouse.storage import Storage
from warehouse.writer import new_token, writer_of

PATH = "lease.json"

# Renewed three times within its life, so that two renewals may be late before anybody takes it over.
LIFE_SECONDS = 60.0


class LeaseError(LakeError):
    """The lease could not be had in time, or was lost while it was held."""


@dataclasses.dataclass(frozen=True)
class Holder:
    """Who holds the lease, until when if not renewed [s since the epoch]."""

    token: str
    host: str
    expires: float
    life: float

    @property
    def is_gone(self) -> bool:
        """Whether the lease may be taken over."""
        writer = writer_of(self.token)
        if writer is not None and writer.is_here:
            return not writer.is_alive
        return time.time() > self.expires


class Lease:
    """``with Lease(storage): ...`` waits for the lease, holds it, and gives it back.

    Raises:
        LeaseError: not free within `timeout` seconds; the text says who holds it.
    """

    def __init__(self, storage: Storage, *, timeout: float = 300.0, life: float = LIFE_SECONDS) -> None:
        self._storage, self._timeout, self._life = storage, timeout, life
        self._token = ""
        self._tag: str | None = None
        self._renewed = 0.0
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Lease:
        deadline = time.monotonic() + self._timeout
        self._token = new_token()
        pause = 0.01
        while not self._taken():
            if time.monotonic() >= deadline:
                holder = holder_of(self._storage)
                who = f"{holder.host} ({holder.token})" if holder else "somebody"
                raise LeaseError(f"{self._storage.address}: {who} holds the lake's lease; waited {self._timeout:g} s; try again later")
            time.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(pause * 1.5, 0.5)
        self._stopped.clear()
        self._thread = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
        if self._tag is not None:
            self._storage.swap(PATH, None, self._tag)
            self._tag = None

    def check(self) -> None:
        """Raise LeaseError when the lease is no longer held; called before every step that others would see."""
        # Overdue: the process was stopped for a while, or the storage was away. Others may have taken the lease over.
        if time.time() > self._renewed + self._life / 2:
            self._renew_once()
        if self._tag is None:
            raise LeaseError(f"{self._storage.address}: the lake's lease was lost to another process; run the command again")

    def _content(self) -> bytes:
        expires = time.time() + self._life
        return json.dumps({"token": self._token, "host": socket.gethostname(), "expires": expires, "life": self._life}).encode()

    def _taken(self) -> bool:
        content = self._content()
        if not self._storage.create(PATH, content):
            found = self._storage.read_tagged(PATH)
            if found is None:
                return False
            holder = _parse(found[0])
            if (holder is not None and not holder.is_gone) or not self._storage.swap(PATH, content, found[1]):
                return False
        self._tag, self._renewed = self._own_tag(), time.time()
        return self._tag is not None

    def _own_tag(self) -> str | None:
        """Tag of the lease file if it is ours."""
        found = self._storage.read_tagged(PATH)
        holder = _parse(found[0]) if found else None
        return found[1] if found and holder and holder.token == self._token else None

    def _renew(self) -> None:
        while not self._stopped.wait(self._life / 3) and self._tag is not None:
            # The storage may be back at the next renewal. If it is not, `check` tries again, and its error is seen.
            with contextlib.suppress(Exception):
                self._renew_once()

    def _renew_once(self) -> None:
        with self._lock:
            now = time.time()
            if self._tag is not None and self._storage.swap(PATH, self._content(), self._tag):
                self._tag, self._renewed = self._own_tag(), now
            else:
                self._tag = None


def holder_of(storage: Storage) -> Holder | None:
    """Who holds a lake's lease; None when nobody does."""
    found = storage.read_tagged(PATH)
    return _parse(found[0]) if found else None


def _parse(content: bytes) -> Holder | None:
    """The holder; None when the file says nothing readable, which nobody's does that was written whole."""
    try:
        fields = json.loads(content)
        return Holder(str(fields["token"]), str(fields["host"]), float(fields["expires"]), float(fields["life"]))
    except (ValueError, KeyError, TypeError):
        return None
