"""Room on the disk: a run stops politely before there is none."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from warehouse.lake import Lake

GB = 1e9

KEEP_FREE_GB = 2.0
"""A scene leaves a few hundred MB at most; those in flight, and the commit, must still find room after the last look."""

LOOK_SECONDS = 1.0
"""How often the disk is looked at while nothing ends."""

MEASURE_SECONDS = 60.0
"""How often the lake's own size is measured in any case: every file is looked at."""

MEASURE_SHARE = 0.1
"""Part of a run's time that measuring may take, as long as scenes so far say that there is room: nothing else goes on meanwhile."""


class Quota:
    """Says whether another scene may begin: free space where lake and temporary files lie, and the size of the lake.

    The lake is measured before the first scene, after every commit, and whenever the scenes that ended since, each taken to
    be as large as those before, may have filled it.
    """

    def __init__(self, lake: Lake, keep_free_gb: float | None = None, quota_gb: float | None = None) -> None:
        self._lake = lake
        self._keep_free = KEEP_FREE_GB if keep_free_gb is None else keep_free_gb
        self._quota = quota_gb
        self._looked = self._measured = -1e9
        self._took = 0.0
        self._size_gb = self._first_gb = 0.0
        self._ended = self._ended_before = self._commits = 0
        self._is_news = False
        self._reason: str | None = None

    def ended(self, scenes: int = 0, commits: int = 0) -> None:
        """Note how many more scenes lie in the lake, and how many commits were made in all: news are a reason to look again."""
        self._ended += scenes
        if scenes or commits != self._commits:
            self._is_news = True
        self._commits = commits

    def reason(self, under_way: int = 0) -> str | None:
        """Why no further scene may begin, in one line; None when there is room, or nobody knows before others have ended."""
        if self._reason is None and (self._is_news or time.monotonic() - self._looked >= LOOK_SECONDS):
            self._reason = self._free_reason() or self._size_reason(under_way)
            self._looked, self._is_news = time.monotonic(), False
        return self._reason

    def fits(self, under_way: int) -> bool:
        """Whether one scene more beside those under way stays below the quota, as far as scenes so far say."""
        scene = self._scene_gb
        return self._quota is None or not under_way or scene is None or self._expected_gb + (under_way + 1) * scene <= self._quota

    def excess(self) -> str | None:
        """The warning at the end of a run that was not stopped but left the lake larger than its quota; None within it."""
        if self._quota is None or (self._scene_gb is not None and self._expected_gb < 0.9 * self._quota):
            return None
        self._measure()
        return self._sentence() if self._size_gb > self._quota else None

    @property
    def _scene_gb(self) -> float | None:
        """What a scene of this run took so far; None before one was measured."""
        return max(0.0, self._size_gb - self._first_gb) / self._ended_before if self._ended_before else None

    @property
    def _expected_gb(self) -> float:
        return self._size_gb + (self._ended - self._ended_before) * (self._scene_gb or 0.0)

    def _free_reason(self) -> str | None:
        local = self._lake.storage.local_path("")
        for place, what in ((local, "the lake's disk"), (Path(tempfile.gettempdir()), "the disk of temporary files")):
            if place is None:
                continue
            existing = next(folder for folder in (place, *place.parents) if folder.is_dir())
            free = shutil.disk_usage(existing).free / GB
            if free < self._keep_free:
                return f"{what} ({existing}) has {free:.1f} GB left, --keep-free is {self._keep_free:g} GB; free some and run again"
        return None

    def _size_reason(self, under_way: int) -> str | None:
        if self._quota is None:
            return None
        is_first = self._measured < 0
        is_unknown = self._scene_gb is None and self._ended > 0
        is_due = self._is_news or time.monotonic() - self._measured >= MEASURE_SECONDS
        is_cheap = time.monotonic() - self._measured >= self._took / MEASURE_SHARE
        if is_first or is_unknown or (self._ended > self._ended_before and self._next_gb > self._quota) or (is_due and is_cheap):
            self._measure()
        is_full = self._size_gb >= self._quota or (not under_way and self._next_gb > self._quota)
        return self._sentence() if is_full else None

    @property
    def _next_gb(self) -> float:
        return self._expected_gb + (self._scene_gb or 0.0)

    def _measure(self) -> None:
        begun = time.monotonic()
        self._size_gb = sum(entry.size for entry in self._lake.storage.walk("")) / GB
        if self._measured < 0:
            self._first_gb = self._size_gb
        self._measured = time.monotonic()
        self._took, self._ended_before = self._measured - begun, self._ended

    def _sentence(self) -> str:
        scene = f", and a scene takes about {_shown(self._scene_gb)}" if self._scene_gb else ""
        quota = _shown(self._quota or 0.0)
        return f"the lake holds {_shown(self._size_gb)}{scene}, --quota is {quota}; `metascenes lake vacuum` may free some, then run again"


def _shown(size_gb: float) -> str:
    """A size in the unit that fits."""
    return f"{size_gb:.1f} GB" if size_gb >= 0.1 else f"{1000 * size_gb:.2g} MB"
