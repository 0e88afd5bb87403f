"""A worker and its helpers: processes of its own that take parts of its work off one list, beside itself.

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
import threading
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

from flows.run.parts import CLAIM, SharedPart, claimed, start_helper
from tasks.stage import Spread, in_turn

_MOST_CLAIMS = 256
"""Of a round: 4 KiB, which any pipe holds."""

_MOST_LOSSES = 3
"""Helpers that may be lost before a worker goes on without."""

_HEARING_SECONDS = 0.02
"""How long a worker waits for helpers to hear of its work: it may be at something next that lets no thread of its own run."""

_ENDING_SECONDS = 5.0
"""How long a helper that says nothing more may take to end, until it counts as lost."""

MIN_WORK_SECONDS = 1.0
"""A worker does so much by itself before it starts helpers: starting one costs seconds of a core, and small scenes need none."""

IDLE_SECONDS = 60.0
"""A helper that nobody asked for so long ends; the next one takes seconds to start."""


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


class Crew:
    """``Crew().spread(function, items, 1)``: what the function makes of each item, by this process and one helper.

    idle_seconds: How long a helper waits for the next work before it ends [s]. work_seconds: Work that this process does by itself
    before it starts helpers [s].
    """

    def __init__(self, idle_seconds: float = IDLE_SECONDS, work_seconds: float = MIN_WORK_SECONDS) -> None:
        self._idle_seconds = idle_seconds
        self._seconds_left = work_seconds
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
            made = self._alone(function, items)
            items = items[len(made) :]
            helpers = min(helpers, len(items) - 1)
            return [*made, *(self._shared(function, items, helpers) if helpers > 0 else map(function, items))]
        finally:
            self._lock.release()

    def _alone(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """Values of the first items, as many as are due before helpers are started."""
        made = []
        for item in items if self._seconds_left > 0 else ():
            began = time.monotonic()
            made.append(function(item))
            self._seconds_left -= time.monotonic() - began
            if self._seconds_left <= 0:
                break
        return made

    def _shared(self, function: Callable[[Any], Any], items: Sequence[Any], count: int) -> list[Any]:
        self._round += 1
        self._drop_claims()
        helpers = self._ready(count)
        message = bytes(ForkingPickler.dumps((self._round, function, list(items))))
        step = -(-len(items) // _MOST_CLAIMS)
        offers = [CLAIM.pack(self._round, first, min(first + step, len(items))) for first in range(0, len(items), step)]
        part = SharedPart(function, items)
        try:
            os.write(self._offers.fileno(), b"".join(offers))  # before the orders: who finds nothing to claim is done
            for helper in helpers:
                helper.order(message)
            del message
            for helper in helpers:
                helper.wait_until_it_heard()
            part.work(claimed(self._claims))
        finally:
            self._drop_claims()  # after an error, or interrupted: nobody is to begin another
        self._gather(part, helpers)
        for index in part.missing():
            part.do(index)
            if part.errors:
                break
        if part.errors:
            raise part.errors[min(part.errors)]
        return [part.made[index] for index in range(len(items))]

    def _ready(self, count: int) -> list[_Helper]:
        """So many helpers, or fewer where the system gives no more."""
        while not self._replies.empty():  # of rounds that are over
            self._count_loss(*self._replies.get())
        self._helpers = [helper for helper in self._helpers if not helper.is_gone]
        while len(self._helpers) < count and self._losses < _MOST_LOSSES:
            try:
                self._helpers.append(_Helper(self._context, self._claims, self._replies, self._idle_seconds))
            except (OSError, RuntimeError):
                self._losses += 1
        return self._helpers[:count]

    def _drop_claims(self) -> None:
        for _ in claimed(self._claims):
            pass

    def _count_loss(self, helper: _Helper, reply: bytes | None) -> None:
        self._losses += reply is None and helper.was_lost

    def _gather(self, part: SharedPart, helpers: Sequence[_Helper]) -> None:
        """What helpers have made of this round, until nothing is missing or none of them is left to say."""
        silent = set(helpers)
        while silent and part.missing():
            helper, reply = self._replies.get()
            if reply is None:
                self._count_loss(helper, reply)
                silent.discard(helper)
                continue
            number, made, errors = pickle.loads(reply)
            if number == self._round:
                silent.discard(helper)
                part.take(made, errors)


class _Helper:
    """A process that helps, and threads that pass on orders to it and its replies: it may be starting yet, or at a round that is over."""

    def __init__(
        self, context: Any, claims: Connection, replies: queue.SimpleQueue[tuple[_Helper, bytes | None]], idle_seconds: float
    ) -> None:
        self._connection, far = context.Pipe()
        self._process = context.Process(target=start_helper, args=(os.getpid(), far, claims, idle_seconds), name="helper", daemon=True)
        self._process.start()
        far.close()
        self.is_gone = self._is_warm = False
        self._heard = threading.Event()
        self._orders: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._replies = replies
        for passing in (self._pass_orders, self._pass_replies):
            threading.Thread(target=passing, name="helper", daemon=True).start()

    @property
    def was_lost(self) -> bool:
        """Whether it ended otherwise than by itself, for want of work."""
        return bool(self._process.exitcode != 0)

    def order(self, message: bytes) -> None:
        """Tell it what there is to do."""
        self._heard.clear()
        self._orders.put(message)

    def wait_until_it_heard(self) -> None:
        """A little, where it has started."""
        if self._is_warm:
            self._heard.wait(_HEARING_SECONDS)

    def _pass_orders(self) -> None:
        while (message := self._orders.get()) is not None:
            while not self._orders.empty():  # a round that is over
                message = self._orders.get()
            if message is None:
                return
            with contextlib.suppress(OSError):
                self._connection.send_bytes(message)
            self._heard.set()
            del message

    def _pass_replies(self) -> None:
        try:
            while True:
                self._replies.put((self, self._connection.recv_bytes()))
                self._is_warm = True
        except (EOFError, OSError):
            pass
        finally:
            self.is_gone = True
            self._orders.put(None)
            self._process.join(_ENDING_SECONDS)
            self._replies.put((self, None))
