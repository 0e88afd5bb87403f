"""Parts of a worker's work: whoever takes part claims items of one list and does them; who helps says what came of them.

It imports nothing but the standard library, as `flows.run.child`: native libraries read their limits of threads as they are loaded.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import struct
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

from flows.run.child import start_worker

CLAIM = struct.Struct("<QII")
"""Number of a round, and the items from one up to another."""

Claim = tuple[int, int, int]


def start_helper(parent: int, connection: Connection, claims: Connection, idle_seconds: float) -> None:
    """Help a worker, `parent`, until it is gone or has asked for nothing for so long [s]."""
    import multiprocessing

    start_worker(parent)
    multiprocessing.current_process().daemon = False  # else it may have no processes of its own; the worker ends it all the same
    early: list[Claim] = []  # of a round whose order is still on its way
    with contextlib.suppress(EOFError, OSError):
        while connection.poll(idle_seconds):
            message = connection.recv_bytes()
            connection.send_bytes(_done(message, claims, early))
            del message


def _done(message: bytes, claims: Connection, early: list[Claim]) -> bytes:
    """The reply to an order: what came of the items that were claimed."""
    number, function, items = pickle.loads(message)
    part = SharedPart(function, items)
    part.work(_claims_of(number, claims, early))
    return bytes(ForkingPickler.dumps((number, *part.packed())))


def _claims_of(number: int, claims: Connection, early: list[Claim]) -> Iterator[Claim]:
    """Claims of a round. One of a later round, which began while this process was still at this one, is kept."""
    while early and early[0][0] <= number:
        if (claim := early.pop())[0] == number:
            yield claim
    if not early:
        for claim in claimed(claims):
            if claim[0] != number:
                early.append(claim)
                return
            yield claim


def claimed(claims: Connection) -> Iterator[Claim]:
    """The next claims, each for nobody else, until there are none."""
    while True:
        try:
            read = os.read(claims.fileno(), CLAIM.size)
        except BlockingIOError:
            return
        if not read:  # nobody is left to offer any
            return
        number, first, end = CLAIM.unpack(read)
        yield number, first, end


class SharedPart:
    """What one process makes of a round's items."""

    def __init__(self, function: Callable[[Any], Any], items: Sequence[Any]) -> None:
        self._function, self._items = function, items
        self.made: dict[int, Any] = {}
        self.errors: dict[int, Exception] = {}

    def work(self, claims: Iterator[Claim]) -> None:
        """Do what is claimed, up to an error: items before it were claimed before, and those behind it do not matter any more."""
        for _, first, end in claims:
            for index in range(first, end):
                self.do(index)
                if self.errors:
                    return

    def do(self, index: int) -> None:
        """One item."""
        try:
            self.made[index] = self._function(self._items[index])
        except Exception as error:
            self.errors[index] = error

    def missing(self) -> list[int]:
        """Items of which nothing is known; after an error those before it."""
        return [index for index in range(min(self.errors, default=len(self._items))) if index not in self.made]

    def packed(self) -> tuple[dict[int, bytes], dict[int, bytes]]:
        """Results and errors for the worker. What cannot be sent as it is, is left to it: it does the item itself."""
        made, errors = {}, {}
        for index, value in self.made.items():
            with contextlib.suppress(Exception):
                made[index] = bytes(ForkingPickler.dumps(value))
        for index, error in self.errors.items():
            place, trace = place_of(error), "".join(traceback.format_exception(error))
            with contextlib.suppress(Exception):
                error.place = place  # type: ignore[attr-defined]
                error.add_note(f"in a helper:\n{trace}")
                packed = bytes(ForkingPickler.dumps(error))
                if _is_as_it_was(pickle.loads(packed), error):
                    errors[index] = packed
        return made, errors

    def take(self, made: dict[int, bytes], errors: dict[int, bytes]) -> None:
        """Take in what a helper packed; what cannot be read is left to do."""
        for packed, known in ((made, self.made), (errors, self.errors)):
            for index, value in packed.items():
                with contextlib.suppress(Exception):
                    known[index] = pickle.loads(value)


def _is_as_it_was(read: Any, error: Exception) -> bool:
    """Whether nothing of an error is lost on its way; its cause would be."""
    return type(read) is type(error) and str(read) == str(error) and error.__cause__ is None and error.__context__ is None


def place_of(error: BaseException) -> str:
    """Where in our code an error came from, in whatever process, as ``file:line``; nothing where it came from elsewhere."""
    known = getattr(error, "place", None)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).parent.name]
    ours = [frame for frame in frames if any(f"/{room}/" in frame.filename for room in ("tasks", "warehouse", "flows"))]
    return known if isinstance(known, str) else f"{_below_root(Path(ours[-1].filename))}:{ours[-1].lineno}" if ours else ""


def _below_root(path: Path) -> str:
    """A file of ours from its room on; many are called `__init__.py`."""
    root = Path(__file__).parents[2]
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name
