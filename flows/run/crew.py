"""Helpers of a worker: processes of its own that take parts of its work off one list, beside itself.

Claims lie in a pipe, from which worker and helpers read them: each takes the next as soon as it is free, no interpreter has to answer
for it, and who is killed takes along what it had claimed and no lock. A helper that is still starting is not waited for, unless another
one was lost meanwhile.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import struct
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

from flows.run.child import start_helper
from tasks.stage import Spread, in_turn

IDLE_SECONDS = 60.0
"""A helper that nobody asked for so long ends; the next one takes seconds to start."""

_CLAIM = struct.Struct("<QII")
"""Number of a round, and the items from one up to another."""

_MOST_CLAIMS = 256
"""Of a round: 4 KiB, which any pipe holds."""

_MOST_LOSSES = 3
"""Helpers that may be lost at their work before a worker goes on without."""

_Claim = tuple[int, int, int]


def crew_of(processes: int) -> Spread:
    """A map for work inside a worker, over so many processes, itself among them; in turn when there is only one.

    The results are in the order of the items, and the error is that of the first item that has one. What a helper was at when it was
    lost is done by the worker. Of several threads of a worker one has the helpers at a time; the others go on without.
    """
    return in_turn if processes < 2 else lambda function, items: _own_crew().spread(function, items, processes - 1)


_own: list[Crew] = []
_making = threading.Lock()


def _own_crew() -> Crew:
    """The one of this process."""
    with _making:
        if not _own:
            multiprocessing.current_process().daemon = False  # else it may have no processes of its own
            _own.append(Crew())
        return _own[0]


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


class Crew:
    """``Crew().spread(function, items, 1)``: what the function makes of each item, by this process and one helper."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._claims, self._offers = self._context.Pipe(duplex=False)
        os.set_blocking(self._claims.fileno(), False)
        self._round = self._losses = 0
        self._helpers: list[_Helper] = []
        self._replies: queue.SimpleQueue[tuple[_Helper, bytes | None]] = queue.SimpleQueue()
        self._lock = threading.Lock()

    def spread(self, function: Callable[[Any], Any], items: Sequence[Any], helpers: int) -> list[Any]:
        """The function's values, in the order of the items, by so many helpers at most.

        Raises:
            Exception: that of the first item that the function fails on.
        """
        helpers = min(helpers, len(items) - 1)
        if helpers < 1 or self._losses >= _MOST_LOSSES or not self._lock.acquire(blocking=False):
            return [function(item) for item in items]
        try:
            return self._shared(function, items, helpers)
        finally:
            self._lock.release()

    def _shared(self, function: Callable[[Any], Any], items: Sequence[Any], count: int) -> list[Any]:
        self._round += 1
        self._drop_claims()
        while not self._replies.empty():  # of rounds that are over
            self._replies.get()
        self._helpers = [helper for helper in self._helpers if not helper.is_gone]
        while len(self._helpers) < count:
            self._helpers.append(_Helper(self._context, self._claims, self._replies))
        helpers = self._helpers[:count]
        message = bytes(ForkingPickler.dumps((self._round, function, list(items))))
        for helper in helpers:
            helper.order(message)
        del message
        step = -(-len(items) // _MOST_CLAIMS)
        offers = [_CLAIM.pack(self._round, first, min(first + step, len(items))) for first in range(0, len(items), step)]
        part = _Part(function, items)
        try:
            os.write(self._offers.fileno(), b"".join(offers))
            part.work(_claimed(self._claims))
        finally:
            self._drop_claims()  # after an error, or interrupted: nobody is to begin another
        self._gather(part, helpers)
        for index in part.missing():
            part.do(index)
        if part.errors:
            raise part.errors[min(part.errors)]
        return [part.made[index] for index in range(len(items))]

    def _drop_claims(self) -> None:
        for _ in _claimed(self._claims):
            pass

    def _gather(self, part: _Part, helpers: Sequence[_Helper]) -> None:
        """What helpers have made of this round, until nothing is missing or none of them is left to say."""
        silent = set(helpers)
        while silent and part.missing():
            helper, reply = self._replies.get()
            if reply is None:
                self._losses += helper in silent
                silent.discard(helper)
                continue
            number, made, errors = pickle.loads(reply)
            if number == self._round:
                silent.discard(helper)
                part.take(made, errors)


class _Part:
    """What one process makes of a round's items."""

    def __init__(self, function: Callable[[Any], Any], items: Sequence[Any]) -> None:
        self._function, self._items = function, items
        self.made: dict[int, Any] = {}
        self.errors: dict[int, Exception] = {}

    def work(self, claims: Iterator[_Claim]) -> None:
        """Do what is claimed, up to an error: items before it were claimed before, and those behind it do not matter any more."""
        for _, first, end in claims:
            for index in range(first, end):
                self.do(index)
                if self.errors:
                    return

    def do(self, index: int) -> None:
        try:
            self.made[index] = self._function(self._items[index])
        except Exception as error:
            self.errors[index] = error

    def missing(self) -> list[int]:
        """Items of which nothing is known; after an error those before it."""
        return [index for index in range(min(self.errors, default=len(self._items))) if index not in self.made]

    def take(self, made: dict[int, bytes], errors: dict[int, Exception]) -> None:
        """Take in what a helper packed."""
        self.errors.update(errors)
        for index, value in made.items():
            try:
                self.made[index] = pickle.loads(value)
            except Exception as error:
                self.errors[index] = error

    def packed(self) -> tuple[dict[int, bytes], dict[int, Exception]]:
        """For the worker. A result that cannot be sent is an error of its item, and an error that cannot is told in words."""
        made = {}
        for index, value in self.made.items():
            try:
                made[index] = bytes(ForkingPickler.dumps(value))
            except Exception as error:
                self.errors[index] = error
        return made, {index: _sendable(error) for index, error in self.errors.items()}


def _sendable(error: Exception) -> Exception:
    """An error with the place and the trace that do not go along by themselves, in words where it cannot be sent as it is."""
    place, trace = place_of(error), "".join(traceback.format_exception(error))
    try:
        pickle.loads(ForkingPickler.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.place = place  # type: ignore[attr-defined]
    error.add_note(f"in a helper:\n{trace}")
    return error


class _Helper:
    """A process that helps, and threads that pass on orders to it and its replies: it may be starting yet, or at a round that is over."""

    def __init__(self, context: Any, claims: Connection, replies: queue.SimpleQueue[tuple[_Helper, bytes | None]]) -> None:
        self._connection, far = context.Pipe()
        process = context.Process(target=start_helper, args=(os.getpid(), far, claims), name="helper", daemon=True)
        process.start()
        far.close()
        self.is_gone = False
        self._orders: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._replies = replies
        for passing in (self._pass_orders, self._pass_replies):
            threading.Thread(target=passing, name="helper", daemon=True).start()

    def order(self, message: bytes) -> None:
        """Tell it what there is to do."""
        self._orders.put(message)

    def _pass_orders(self) -> None:
        while (message := self._orders.get()) is not None:
            while not self._orders.empty():  # a round that is over
                message = self._orders.get()
            if message is None:
                return
            with contextlib.suppress(OSError):
                self._connection.send_bytes(message)
            del message

    def _pass_replies(self) -> None:
        try:
            while True:
                self._replies.put((self, self._connection.recv_bytes()))
        except (EOFError, OSError):
            pass
        finally:
            self.is_gone = True
            self._orders.put(None)
            self._replies.put((self, None))


def help_worker(connection: Connection, claims: Connection) -> None:
    """Take part in whatever the worker orders, until it is gone or asks for nothing."""
    early: list[_Claim] = []  # of a round whose order is still on its way
    with contextlib.suppress(EOFError, OSError):
        while early or connection.poll(IDLE_SECONDS):
            number, function, items = pickle.loads(connection.recv_bytes())
            part = _Part(function, items)
            part.work(_claims_of(number, claims, early))
            reply = ForkingPickler.dumps((number, *part.packed()))
            del part, items, function
            connection.send_bytes(reply)
            del reply


def _claims_of(number: int, claims: Connection, early: list[_Claim]) -> Iterator[_Claim]:
    """Claims of a round. One of a later round, which began while this process was still at this one, is kept."""
    while early and early[0][0] <= number:
        if (claim := early.pop())[0] == number:
            yield claim
    if not early:
        for claim in _claimed(claims):
            if claim[0] != number:
                early.append(claim)
                return
            yield claim


def _claimed(claims: Connection) -> Iterator[_Claim]:
    """The next claims, each for nobody else, until there are none."""
    while True:
        try:
            read = os.read(claims.fileno(), _CLAIM.size)
        except BlockingIOError:
            return
        if not read:  # nobody is left to offer any
            return
        number, first, end = _CLAIM.unpack(read)
        yield number, first, end
