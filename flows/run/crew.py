"""Helpers of a worker: processes of its own that take parts of its work off one list, beside itself.

Claims lie in a pipe, from which worker and helpers read them: each takes the next as soon as it is free, no interpreter has to answer
for it, and who is killed takes along what it had claimed and no lock. A helper that is still starting is not waited for.
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
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any

from flows.run.child import start_worker
from tasks.stage import Spread, in_turn

_CLAIM = struct.Struct("<QII")
"""Number of a round, and the items from one up to another."""

_MOST_CLAIMS = 1024
"""Of a round: 16 KiB, which any pipe holds."""

_Claim = tuple[int, int, int]


def crew_of(processes: int) -> Spread:
    """A map for work inside a worker, over so many processes, itself among them; in turn when there is only one.

    The results are in the order of the items, and the error is that of the first item that has one. What a helper was at when it was
    lost is done by the worker.
    """
    return in_turn if processes < 2 else lambda function, items: _crew(processes - 1).spread(function, items)


@cache
def _crew(helpers: int) -> Crew:
    """Kept warm, as the worker is."""
    multiprocessing.current_process().daemon = False  # else it may have no processes of its own
    return Crew(helpers)


class Crew:
    """``Crew(1).spread(function, items)``: what the function makes of each item, by this process and one other."""

    def __init__(self, helpers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._claims, self._offers = context.Pipe(duplex=False)
        os.set_blocking(self._claims.fileno(), False)
        self._round = 0
        self._helpers = [_Helper(context, self._claims) for _ in range(helpers)]

    def spread(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """The function's values, in the order of the items.

        Raises:
            Exception: that of the first item that the function fails on.
        """
        if len(items) < 2:
            return [function(item) for item in items]
        self._round += 1
        self._helpers = [helper.living() for helper in self._helpers]
        message = bytes(ForkingPickler.dumps((self._round, function, list(items))))
        for helper in self._helpers:
            helper.order(message)
        step = -(-len(items) // _MOST_CLAIMS)
        offers = [_CLAIM.pack(self._round, first, min(first + step, len(items))) for first in range(0, len(items), step)]
        os.write(self._offers.fileno(), b"".join(offers))
        part = _Part(function, items)
        try:
            part.work(_claimed(self._claims))
        finally:
            for _ in _claimed(self._claims):  # after an error, or interrupted: nobody is to begin another
                pass
        self._gather(part)
        for index in part.missing():
            part.do(index)
        if part.errors:
            raise part.errors[min(part.errors)]
        return [part.made[index] for index in range(len(items))]

    def _gather(self, part: _Part) -> None:
        """What helpers have made of this round, until nothing is missing or none of them is left to say."""
        silent = [helper.connection for helper in self._helpers]
        while silent and part.missing():
            for ready in wait(silent):
                assert isinstance(ready, Connection)
                try:
                    number, made, errors = pickle.loads(ready.recv_bytes())
                except (EOFError, OSError):
                    silent.remove(ready)
                    continue
                if number == self._round:
                    silent.remove(ready)
                    part.made.update((index, pickle.loads(value)) for index, value in made.items())
                    part.errors.update(errors)


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
            error.add_note(traceback.format_exc())
            self.errors[index] = error

    def missing(self) -> list[int]:
        """Items of which nothing is known; after an error those before it."""
        return [index for index in range(min(self.errors, default=len(self._items))) if index not in self.made]

    def packed(self) -> tuple[dict[int, bytes], dict[int, Exception]]:
        """For the worker. A result that cannot be sent is an error of its item, and an error that cannot is told in words."""
        made = {}
        for index, value in self.made.items():
            try:
                made[index] = bytes(ForkingPickler.dumps(value))
            except Exception as error:
                self.errors[index] = error
        for index, failure in self.errors.items():
            try:
                pickle.loads(ForkingPickler.dumps(failure))
            except Exception:
                self.errors[index] = RuntimeError(f"{type(failure).__name__}: {failure}")
        return made, self.errors


class _Helper:
    """A process that helps, and a thread that passes orders on to it: it may be starting yet, and take none."""

    def __init__(self, context: Any, claims: Connection) -> None:
        self._context, self._claims = context, claims
        self.connection, far = context.Pipe()
        self._process = context.Process(target=_help, args=(far, claims, os.getpid()), name="helper", daemon=True)
        self._process.start()
        far.close()
        self._orders: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._pass_on, name="orders", daemon=True).start()

    def living(self) -> _Helper:
        """This one, or another in its place when it has died."""
        if self._process.is_alive():
            return self
        self._orders.put(b"")  # which fails, and ends the thread
        return _Helper(self._context, self._claims)

    def order(self, message: bytes) -> None:
        """Tell it what there is to do."""
        self._orders.put(message)

    def _pass_on(self) -> None:
        while True:
            message = self._orders.get()
            while not self._orders.empty():  # a round that is over
                message = self._orders.get()
            try:
                self.connection.send_bytes(message)
            except OSError:
                return


def _help(connection: Connection, claims: Connection, parent: int) -> None:
    """Take part in whatever the worker orders, until it is gone."""
    start_worker(parent)
    early: list[_Claim] = []  # of a round whose order is still on its way
    while True:
        try:
            message = connection.recv_bytes()
        except (EOFError, OSError):
            return
        number, function, items = pickle.loads(message)
        part = _Part(function, items)
        part.work(_claims_of(number, claims, early))
        with contextlib.suppress(OSError):
            connection.send_bytes(ForkingPickler.dumps((number, *part.packed())))


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
        number, first, end = _CLAIM.unpack(read)
        yield number, first, end
