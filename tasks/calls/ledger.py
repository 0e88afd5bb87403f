"""The ledger of calls: every reply is recorded as it comes, and nothing that was answered is asked again."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

from schemas.calls import ModelCall


class NoFurtherCall(ConnectionError):
    """A call may not be made in this run. Nothing stands in for its reply: the scene is left to the next run."""


class Ledger(Protocol):
    """What remembers calls. The same object may be asked in another process: it can be pickled."""

    def reply(self, call_id: str) -> bytes | None:
        """What a call was answered with; None where it was not."""

    def asking(self, call_id: str, scene_id: str) -> contextlib.AbstractContextManager[None]:
        """Around a call. Raises NoFurtherCall where none may be made."""

    def request(self) -> None:
        """Before every request of a call: waits where there are too many."""

    def record(self, call: ModelCall, request: bytes, reply: bytes | None) -> bytes | None:
        """Keep a call; its reply, or that of whoever was first to record one."""


class Recollection:
    """A ledger that lasts as long as its object."""

    def __init__(self) -> None:
        self.calls: dict[str, ModelCall] = {}
        self.replies: dict[str, bytes] = {}

    def reply(self, call_id: str) -> bytes | None:
        """What a call was answered with; None where it was not."""
        return self.replies.get(call_id)

    @contextlib.contextmanager
    def asking(self, call_id: str, scene_id: str) -> Iterator[None]:
        """Around a call."""
        yield

    def request(self) -> None:
        """Before every request of a call."""

    def record(self, call: ModelCall, request: bytes, reply: bytes | None) -> bytes | None:
        """Keep a call; its reply."""
        self.calls[call.call_id] = call
        if reply is not None:
            self.replies.setdefault(call.call_id, reply)
        return self.replies.get(call.call_id)
