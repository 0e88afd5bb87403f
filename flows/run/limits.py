"""Global concurrency limits of the Prefect server around stages: so many at once (a GPU), or so many a second (an endpoint).

A slot is held under a lease that its holder renews: when the holder is gone, the server frees the slot. Servers must keep
leases on disk for that (`flows.server.services.SERVER`): by default they forget them when they are started again, and slots that
were taken then stay so for ever.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from flows.run.patience import is_away, retried
from schemas.errors import InputError
from tasks.pipeline import STAGES

T = TypeVar("T")

LIMITED = "calls"
"""The name under which a run is given a global limit that every request of a call to a model keeps."""

LEASE_SECONDS = 90.0
"""A slot comes back so long after its holder died; Prefect takes no less than 60, and renews at three quarters."""

PATIENCE_SECONDS = 1800.0
"""How long a stage waits for a server that is away: a restart and a move of its database fit in."""

LONGEST_PAUSE_SECONDS = 30.0

KNOWN_SECONDS = 60.0
"""How long a process goes by what it last read of a limit."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """A global concurrency limit. slots: how many at once, or in a burst. per_second: slots that come back each second; 0 for
    those that their holders give back. is_active: whether it is switched on; else everything passes."""

    name: str
    slots: int
    per_second: float = 0.0
    is_active: bool = True

    @property
    def is_rate(self) -> bool:
        """Whether it limits how often something begins, rather than how much goes on at once."""
        return self.per_second > 0


def check_limits(limits: Mapping[str, str]) -> dict[str, Limit]:
    """The limits that stages, and requests of calls to models, are to keep, by stage, as the server has them.

    Raises:
        InputError: there is no such stage, or the server has no such limit or one of no slots, which nothing would pass.
    """
    stages = [*(stage.name for stage in STAGES), LIMITED]
    checked = {}
    for stage, name in limits.items():
        if stage not in stages:
            raise InputError("limits", stage, "is no stage", f"stages are {', '.join(stages)}, the last one being calls to models")
        limit = limit_of(name)
        if limit is None:
            raise InputError("limits", f"{stage}={name}", "the server has no such limit", _remedy(name))
        if limit.is_active and limit.slots < 1:
            raise InputError("limits", f"{stage}={name}", "has no slots: the run would wait for ever", _remedy(name))
        if stage == LIMITED and not limit.is_rate:
            problem = "holds slots, and a request gives none back: only a rate holds requests to it"
            raise InputError("limits", f"{stage}={name}", problem, f"prefect gcl update {name} --slot-decay-per-second 2")
        checked[stage] = limit
    return checked


def limit_of(name: str) -> Limit | None:
    """The server's limit of that name; None if there is none."""
    from prefect.client.orchestration import get_client
    from prefect.exceptions import ObjectNotFound

    with get_client(sync_client=True) as client:
        try:
            read = client.read_global_concurrency_limit_by_name(name)
        except ObjectNotFound:
            return None
    return Limit(name, read.limit, read.slot_decay_per_second, bool(read.active))


@contextlib.contextmanager
def limited(stage: str, limits: Mapping[str, str], patience: float = PATIENCE_SECONDS) -> Iterator[None]:
    """A slot of the stage's limit for as long as this lasts; of a rate, one that began now. Nothing for stages without one.

    A server that goes away meanwhile stops no work: what began goes on, what begins waits for it.

    Raises:
        ConnectionError: no answer from the server for `patience` seconds.
        InputError: the limit has gone since the run began.
    """
    name = limits.get(stage)
    if name is None:
        yield
        return
    slot = _patiently(lambda: _take(name), f"limit {name}", patience)
    try:
        yield
    finally:
        if slot is not None:
            _give_back(slot)


def _take(name: str) -> contextlib.AbstractContextManager[None] | None:
    """A slot, held; None of a rate, which nobody gives back, and of a limit that is switched off."""
    from prefect.concurrency.asyncio import ConcurrencySlotAcquisitionError
    from prefect.concurrency.sync import concurrency, rate_limit

    limit = _known(name)
    if not limit.is_active:
        return None
    try:
        if limit.is_rate:
            rate_limit(name, strict=True)
            return None
        # A lease that could not be renewed in time costs its slot, never the work that goes on under it.
        slot = concurrency(name, lease_duration=LEASE_SECONDS, strict=True, raise_on_lease_renewal_failure=False)
        slot.__enter__()
        return slot
    except ConcurrencySlotAcquisitionError as error:
        if error.__cause__ is not None:
            raise error.__cause__ from error
        _KNOWN.pop(name, None)  # removed or switched off since
        if _known(name).is_active:
            raise
        return None


_KNOWN: dict[str, tuple[float, Limit]] = {}
"""Limits as they were last read in this process, and when."""


def _known(name: str) -> Limit:
    """A limit as it was within the last minute: somebody may switch it on while a run is at work."""
    read_at, limit = _KNOWN.get(name, (-math.inf, None))
    if limit is None or time.monotonic() - read_at > KNOWN_SECONDS:
        limit = limit_of(name)
        if limit is None:
            raise InputError("limits", name, "the server has no such limit", _remedy(name))
        _KNOWN[name] = (time.monotonic(), limit)
    return limit


def _give_back(slot: contextlib.AbstractContextManager[Any]) -> None:
    """Free a slot. Where the server does not answer, its lease ends by itself: the work that was done under it counts."""
    from prefect.logging import get_logger

    try:
        slot.__exit__(None, None, None)
    except Exception as error:
        get_logger("metascenes").warning(f"a slot is given back by its lease, within {LEASE_SECONDS:g} s: {type(error).__name__}: {error}")


def _patiently(ask: Callable[[], T], what: str, patience: float) -> T:
    """What the server answers, as soon as it does."""
    try:
        return retried(ask, _pauses(patience))
    except Exception as error:
        if not is_away(error):
            raise
        raise ConnectionError(f"{what}: no answer from the Prefect server for {patience:g} s: {error}") from error


def _pauses(patience: float) -> Iterator[float]:
    """Longer and longer pauses [s], until `patience` [s] is over."""
    pause, give_up = 1.0, time.monotonic() + patience
    while time.monotonic() + pause <= give_up:
        yield pause
        pause = min(2 * pause, LONGEST_PAUSE_SECONDS)


def _remedy(name: str) -> str:
    return f"make it with `metascenes deploy`, or `prefect gcl create {name} --limit 1`"
