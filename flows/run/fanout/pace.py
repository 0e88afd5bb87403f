"""How much of the work goes into one Prefect task, so that orchestration stays a small part of it."""

from __future__ import annotations

import math
import statistics
from collections import deque

from flows.run.scene import SceneResult

SHARE = 0.02
"""Part of the work that tasks may cost. A run is to lose less than 5 % to orchestration in all, commits included."""

TASK_SECONDS = {"pool": 0.05, "processes": 0.13, "dask": 0.13, "ray": 0.13}
"""What one task costs [s]: threads 3 to 13 ms, processes, Dask and Ray 55 to 90 ms, and the server's processor about 40 ms more."""

STAGE_TASK_SECONDS = 0.015
"""What a task within a task costs [s]."""


RECENT = 15
"""Scenes that say how long the next one takes. Their median: the first ones of every worker wait for imports and compilers."""


class Pace:
    """Learns from results how long a scene takes, and says how many go into a task.

    Nothing is known at first: scenes of real scans take minutes, so the first tasks hold one scene each.
    """

    def __init__(self, runner: str, workers: int, batch: int | None = None) -> None:
        self._task_seconds, self._workers, self._fixed = TASK_SECONDS[runner], workers, batch
        self._scenes: deque[float] = deque(maxlen=RECENT)
        self._stages: deque[float] = deque(maxlen=RECENT)

    def saw(self, result: SceneResult) -> None:
        """Take in how long a scene took."""
        if result.ran:
            self._scenes.append(result.seconds)
            self._stages.append(result.seconds / len(result.ran))

    def batch_size(self, waiting: int) -> int:
        """Scenes for the next task, when so many wait for one. Every worker still gets several tasks."""
        if self._fixed is not None:
            return self._fixed
        if not self._scenes:
            return 1
        wanted = math.ceil(self._task_seconds / SHARE / max(statistics.median(self._scenes), 1e-3))
        return max(1, min(wanted, waiting // (4 * self._workers)))

    @property
    def shows_stages(self) -> bool:
        """Whether stages are long enough to be tasks of their own, which a person can follow."""
        return not self._stages or statistics.median(self._stages) * SHARE >= STAGE_TASK_SECONDS
