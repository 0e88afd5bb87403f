"""Commits finished scenes in the background: workers never wait for a commit."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from flows.progress import current
from schemas.text import one_line
from warehouse.lake import Lake

COMMIT_SCENES = 25
"""Scenes per commit at least: a commit rewrites a part of every table (1 to 4 s), and what is uncommitted is still staged."""

COMMIT_SHARE = 0.02
"""Part of the time that commits of short scenes may take: after one of two seconds the next one waits for a hundred."""

PAUSE_SECONDS = 5.0
"""From one commit to the next in any case, above all after one that failed."""

MANY_SCENES = 200
"""So many do not wait any longer: every look into the folder of staged files lists all of them."""


class Committer:
    """``with Committer(lake) as committer: committer.add(scene_id)``. What is left at the end is for `flows.run.scene.settle`."""

    def __init__(self, lake: Lake) -> None:
        self._lake = lake
        self._waiting: list[str] = []
        self._change = threading.Condition()
        self._ends = False
        self._last, self._took = -1e9, 0.0
        self.snapshots: list[int] = []
        """Snapshots that were made, in order."""
        self._thread = threading.Thread(target=self._work, name="committer", daemon=True)

    def add(self, scene_id: str) -> None:
        """A scene is finished."""
        with self._change:
            self._waiting.append(scene_id)
            self._change.notify()

    def __enter__(self) -> Committer:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._change:
            self._ends = True
            self._change.notify()
        if kind is None:  # else nobody may wait: what is being committed is whole or not there
            self._thread.join()

    def _is_due(self) -> bool:
        since = time.monotonic() - self._last
        if since < PAUSE_SECONDS:
            return False
        return len(self._waiting) >= MANY_SCENES or (len(self._waiting) >= COMMIT_SCENES and since * COMMIT_SHARE >= self._took)

    def _work(self) -> None:
        while True:
            with self._change:
                while not self._ends and not self._is_due():
                    self._change.wait(timeout=1.0)
                if self._ends:
                    return
                scenes, self._waiting = self._waiting, []
                self._last = time.monotonic()
            snapshot, begun = None, time.monotonic()
            try:
                snapshot = self._lake.commit(scenes=scenes)
                self._took = time.monotonic() - begun
            except BaseException as error:  # a lease held for long, a store that is away, a panic of delta-rs: all is still staged
                current().say(f"commit put off: {type(error).__name__}: {one_line(error)}")
                with self._change:
                    self._waiting = [*scenes, *self._waiting]
                    self._last = time.monotonic()
            if snapshot is not None:
                self.snapshots.append(snapshot.snapshot_id)
