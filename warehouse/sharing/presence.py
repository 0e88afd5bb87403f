"""Presence: which runs are at work on a lake, and how far they are. One held file per run, rewritten while it lives."""

from __future__ import annotations

import dataclasses
import socket
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Self

from warehouse.sharing.held import LIFE_SECONDS, Facts, Holder, Keeper, held_in
from warehouse.storage.files import Storage

FOLDER = "runs"

# A run tells of every stage that is done; nobody looks more often than this.
TELL_SECONDS = 2.0


@dataclasses.dataclass(frozen=True)
class LiveRun:
    """A run that is at work, as it last reported.

    `scenes` are those that it has to compute, `left` the stage runs that are still to do, by stage. `done`, `failed` and
    `postponed` count scenes. `seconds_done` is the sum of its finished stage runs' wall time [s]. `scans` is where its scans lie.
    `at_work` are the scenes that its workers are at: the stage, and since when [s since the epoch]; None where it cannot tell.
    """

    token: str
    host: str
    started_at: datetime
    workers: int = 1
    runner: str = ""
    scans: str = ""
    scenes: int = 0
    left: Mapping[str, int] = dataclasses.field(default_factory=dict)
    done: int = 0
    failed: int = 0
    postponed: int = 0
    seconds_done: float = 0.0
    at_work: Mapping[str, tuple[str, float]] | None = None


class Presence(Keeper):
    """``with Presence(storage, facts) as presence: ...``: this run is at work. `facts` are fields of `LiveRun`.

    Raises:
        TypeError: a fact is no field of `LiveRun`.
    """

    def __init__(self, storage: Storage, facts: Facts | None = None, *, life: float = LIFE_SECONDS, pause: float = TELL_SECONDS) -> None:
        super().__init__(storage, life, min(pause, life / 3))
        self._run = dataclasses.replace(LiveRun("", socket.gethostname(), datetime.now(UTC)), **(facts or {}))
        self._written: LiveRun | None = None

    def __enter__(self) -> Self:
        super().__enter__()
        self._run = dataclasses.replace(self._run, token=self._token, started_at=datetime.now(UTC))
        self._renew()
        return self

    @property
    def run(self) -> LiveRun:
        """The run as it was last reported, written or not."""
        return self._run

    def tell(self, facts: Facts) -> None:
        """Report how far the run is; facts that are not named stay. Costs nothing: a thread writes them, every few seconds at most.

        Raises:
            TypeError: a fact is no field of `LiveRun`.
        """
        with self._lock:
            self._run = dataclasses.replace(self._run, **facts)

    def _renew(self) -> None:
        run, hold = self._run, self._holds.get(self._token)
        if run is self._written and hold is not None and not hold.is_older_than(self._life / 3):
            return
        if hold is not None:
            hold.facts = _facts(run)
            if not hold.renew():  # removed by who took us for dead: we are at work all the same
                self._lose(self._token, hold)
        if self._take(self._token, path_of(self._token), _facts(run)):
            self._written = run


def runs_of(storage: Storage) -> list[LiveRun]:
    """The runs that are at work, of whatever process, the oldest first."""
    living = [run for _, holder, run in _runs(storage) if not holder.is_gone]
    return sorted(living, key=lambda run: (run.started_at, run.token))


def dead_runs(storage: Storage) -> dict[str, LiveRun]:
    """The runs that died at work, by file. A sweep removes them."""
    return {path: run for path, holder, run in _runs(storage) if holder.is_gone}


def sweep_runs(storage: Storage) -> None:
    """Remove the files of runs that died at work."""
    for path in dead_runs(storage):
        storage.remove(path)


def path_of(token: str) -> str:
    """The file of a run."""
    return f"{FOLDER}/{token}.json"


def _facts(run: LiveRun) -> Facts:
    at_work = None if run.at_work is None else dict(run.at_work)
    return vars(run) | {"started_at": run.started_at.isoformat(), "left": dict(run.left), "at_work": at_work}


def _runs(storage: Storage) -> list[tuple[str, Holder, LiveRun]]:
    return held_in(storage, FOLDER, _run, lambda run: path_of(run.token))


def _run(holder: Holder, facts: Facts) -> LiveRun:
    facts = {"at_work": None, **facts}  # an older version says nothing of it
    return LiveRun(**{field.name: _READERS.get(field.name, str)(facts[field.name]) for field in dataclasses.fields(LiveRun)})


def _left(counts: Mapping[str, Any]) -> dict[str, int]:
    return {str(stage): int(count) for stage, count in counts.items()}


def _at_work(places: Mapping[str, Any] | None) -> dict[str, tuple[str, float]] | None:
    return None if places is None else {str(scene): (str(stage), float(since)) for scene, (stage, since) in places.items()}


_READERS: dict[str, Callable[[Any], Any]] = {
    "started_at": datetime.fromisoformat,
    "seconds_done": float,
    "left": _left,
    "at_work": _at_work,
}
_READERS |= dict.fromkeys(("workers", "scenes", "done", "failed", "postponed"), int)
"""How fields of `LiveRun` are read that are no text."""
