"""The lake's lease: whoever holds it is the one committer.

A file that is created only if absent and renewed by a thread while its owner lives. It is taken over when the
owner is dead: on the same machine when its process is gone, from elsewhere when it was not renewed in time. What the
same process once held and could not give back counts like something from elsewhere.
"""

from __future__ import annotations

import dataclasses
import json
import random
import socket
import threading
import time
from collections.abc import Mapping
from types import TracebackType

from schemas.errors import LakeError
from warehouse.renewal import Renewal
from warehouse.storage import Storage
from warehouse.writer import new_token, this_writer, writer_of

PATH = "lease.json"

# Renewed three times within its life, so that two renewals may be late before anybody takes it over.
LIFE_SECONDS = 60.0


class LeaseError(LakeError):
    """The lease could not be had in time, or was lost while it was held."""


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
    """A file of the lake that at most one living process holds. `facts` are written into it beside who holds it.

    Nothing here waits or renews by itself: that is for the lease and the claims.
    """

    def __init__(self, storage: Storage, path: str, token: str, life: float, facts: Mapping[str, object] | None = None) -> None:
        self.token, self.life = token, life
        self._storage, self._path, self._facts = storage, path, dict(facts or {})
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
                found = self._storage.read_tagged(self._path)
                if found is None:
                    return False
                holder = parsed(found[0])
                # Our own token: the write went through, and only its answer was lost on the way.
                is_free = holder is None or holder.is_gone or holder.token == self.token
                if not is_free or not self._storage.swap(self._path, content, found[1]):
                    return False
            self._tag, self._renewed = self._own_tag(), now
            return self._tag is not None

    def renew(self) -> bool:
        """Say that we live; whether the file is still ours. Not ours it is for good."""
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
                self._tag, self._renewed = self._own_tag(), now
                return self._tag is not None
            # A write whose answer was lost on the way has changed the tag, and the file is still ours.
            self._tag = self._own_tag()
        self._tag = None
        return False

    def _content(self, now: float) -> bytes:
        holder = {"token": self.token, "host": socket.gethostname(), "expires": now + self.life, "life": self.life}
        return json.dumps({**self._facts, **holder}).encode()

    def _own_tag(self) -> str | None:
        """Tag of the file if it is ours."""
        found = self._storage.read_tagged(self._path)
        holder = parsed(found[0]) if found else None
        return found[1] if found and holder and holder.token == self.token else None


class Lease:
    """``with Lease(storage): ...`` waits for the lease, holds it, and gives it back.

    Raises:
        LeaseError: not free within `timeout` seconds; the text says who holds it.
    """

    def __init__(self, storage: Storage, *, timeout: float = 300.0, life: float = LIFE_SECONDS) -> None:
        self._storage, self._timeout, self._life = storage, timeout, life
        self._hold = Hold(storage, PATH, "", life)
        # A renewal that fails is made up for in `check`, whose error is seen.
        self._renewal = Renewal("lease", lambda: self._hold.renew(), life / 3)

    def __enter__(self) -> Lease:
        deadline = time.monotonic() + self._timeout
        self._hold = Hold(self._storage, PATH, new_token(), self._life)
        pause = 0.01
        while not self._hold.take():
            if time.monotonic() >= deadline:
                holder = holder_of(self._storage)
                who = f"{holder.host} ({holder.token})" if holder else "somebody"
                raise LeaseError(f"{self._storage.address}: {who} holds the lake's lease; waited {self._timeout:g} s; try again later")
            time.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(pause * 1.5, 0.5)
        self._renewal.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._renewal.stop()
        self._hold.give_back()

    def check(self) -> None:
        """Raise LeaseError when the lease is no longer held; called before every step that others would see."""
        # Overdue: the process was stopped for a while, or the storage was away. Others may have taken the lease over.
        if self._hold.is_older_than(self._life / 2):
            self._hold.renew()
        if not self._hold.is_held:
            raise LeaseError(f"{self._storage.address}: the lake's lease was lost to another process; run the command again")


def holder_of(storage: Storage, path: str = PATH) -> Holder | None:
    """Who holds a lake's lease, or another file of that kind; None when nobody does."""
    found = storage.read_tagged(path)
    return parsed(found[0]) if found else None


def parsed(content: bytes) -> Holder | None:
    """The holder; None when the file says nothing readable, which nobody's does that was written whole."""
    try:
        fields = json.loads(content)
        return Holder(str(fields["token"]), str(fields["host"]), float(fields["expires"]), float(fields["life"]))
    except (ValueError, KeyError, TypeError):
        return None
