"""The lake's lease: whoever holds it is the one committer."""

from __future__ import annotations

import random
import time
from typing import Self

from schemas.errors import LakeError
from warehouse.sharing.held import LIFE_SECONDS, Holder, Keeper, parsed
from warehouse.storage.files import Storage

PATH = "lease.json"


class LeaseError(LakeError):
    """The lease could not be had in time, or was lost while it was held."""


class Lease(Keeper):
    """``with Lease(storage): ...`` waits for the lease, holds it, and gives it back.

    Raises:
        LeaseError: not free within `timeout` seconds; the text says who holds it.
    """

    def __init__(self, storage: Storage, *, timeout: float = 300.0, life: float = LIFE_SECONDS) -> None:
        super().__init__(storage, life)
        self._timeout = timeout

    def __enter__(self) -> Self:
        super().__enter__()
        deadline = time.monotonic() + self._timeout
        pause = 0.01
        while not self._take(PATH, PATH):
            if time.monotonic() >= deadline:
                holder = holder_of(self._storage)
                who = f"{holder.host} ({holder.token})" if holder else "somebody"
                raise LeaseError(f"{self._storage.address}: {who} holds the lake's lease; waited {self._timeout:g} s; try again later")
            time.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(pause * 1.5, 0.5)
        return self

    def check(self) -> None:
        """Raise LeaseError when the lease is no longer held; called before every step that others would see."""
        hold = self._holds.get(PATH)
        # Overdue: the process was stopped for a while, or the storage was away. Others may have taken the lease over.
        if hold is not None and hold.is_older_than(self._life / 2):
            hold.renew()
        if hold is None or not hold.is_held:
            raise LeaseError(f"{self._storage.address}: the lake's lease was lost to another process; run the command again")


def holder_of(storage: Storage) -> Holder | None:
    """Who holds a lake's lease; None when nobody does."""
    read = storage.read_tagged(PATH)
    return parsed(read[0]) if read else None
