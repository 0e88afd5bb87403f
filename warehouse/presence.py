"""Presence: which runs are at work on a lake, and how far they are. One file per run, rewritten while it lives."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import socket
import threading
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from types import TracebackType
from typing import Any

from warehouse.lease import LIFE_SECONDS, Holder, parsed
from warehouse.renewal import Renewal
from warehouse.storage import Storage
from warehouse.writer import new_token

FOLDER = "runs"

# A run tells of every stage that is done; nobody looks more often than this.
TELL_SECONDS = 2.0


@dataclasses.dataclass(frozen=True)
class LiveRun:
    """A run that is at work, as it told it last.

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


class Presence:
    """``with Presence(storage, facts) as presence: ...``: this run is at work. `facts` are fields of `LiveRun`.

    Raises:
        TypeError: a fact is no field of `LiveRun`.
    """

    def __init__(
        self, storage: Storage, facts: Mapping[str, Any] | None = None, *, life: float = LIFE_SECONDS, pause: float = TELL_SECONDS
    ) -> None:
        self._storage, self._life = storage, life
        self._run = dataclasses.replace(LiveRun("", socket.gethostname(), datetime.now(UTC)), **dict(facts or {}))
        self._written: LiveRun | None = None
        self._renewed = 0.0
        self._lock = threading.Lock()
        # A storage that is away takes nothing from the run itself; it is tried again.
        self._renewal = Renewal("presence", self._keep, min(pause, life / 3))

    def __enter__(self) -> Presence:
        self._run = dataclasses.replace(self._run, token=new_token(), started_at=datetime.now(UTC))
        self._write()
        self._renewal.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._renewal.stop()
        self._storage.remove(path_of(self._run.token))

    @property
    def run(self) -> LiveRun:
        """The run as it was told last, written or not."""
        return self._run

    def tell(self, facts: Mapping[str, Any]) -> None:
        """Say how far the run is; facts that are not named stay. Costs nothing: a thread writes them, every few seconds at most.

        Raises:
            TypeError: a fact is no field of `LiveRun`.
        """
        with self._lock:
            self._run = dataclasses.replace(self._run, **dict(facts))

    def _keep(self) -> None:
        if self._run is not self._written or time.time() > self._renewed + self._life / 3:
            self._write()

    def _write(self) -> None:
        run, now = self._run, time.time()
        fields = dataclasses.asdict(
            dataclasses.replace(run, left=dict(run.left), at_work=None if run.at_work is None else dict(run.at_work))
        )
        fields |= {"started_at": run.started_at.isoformat(), "expires": now + self._life, "life": self._life}
        self._storage.write(path_of(run.token), json.dumps(fields).encode(), lasting=False)
        self._written, self._renewed = run, now


def runs_of(storage: Storage) -> list[LiveRun]:
    """The runs that are at work, of whatever process, the oldest first."""
    found = [run for _, holder, run in _runs(storage) if not holder.is_gone]
    return sorted(found, key=lambda run: (run.started_at, run.token))


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


def _runs(storage: Storage) -> list[tuple[str, Holder, LiveRun]]:
    """All runs that can be read, with file and holder. Other files are none of the lake's."""
    found = []
    for name in storage.names(FOLDER):
        path = f"{FOLDER}/{name}"
        read = storage.read_tagged(path)  # None: gone meanwhile
        holder = parsed(read[0]) if read is not None else None
        if read is None or holder is None or path != path_of(holder.token):
            continue
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
            found.append((path, holder, _run(json.loads(read[0]))))
    return found


def _run(fields: Mapping[str, Any]) -> LiveRun:
    return LiveRun(
        token=str(fields["token"]),
        host=str(fields["host"]),
        started_at=datetime.fromisoformat(fields["started_at"]),
        workers=int(fields["workers"]),
        runner=str(fields["runner"]),
        scans=str(fields["scans"]),
        scenes=int(fields["scenes"]),
        left={str(stage): int(count) for stage, count in fields["left"].items()},
        done=int(fields["done"]),
        failed=int(fields["failed"]),
        postponed=int(fields["postponed"]),
        seconds_done=float(fields["seconds_done"]),
        at_work=_at_work(fields.get("at_work")),  # an older version says nothing of it
    )


def _at_work(told: Mapping[str, Any] | None) -> dict[str, tuple[str, float]] | None:
    return None if told is None else {str(scene): (str(stage), float(since)) for scene, (stage, since) in told.items()}
