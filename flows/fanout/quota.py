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
MEASURE_SECONDS = 60.0
"""How often the lake's own size is measured: every file is looked at."""

MEASURE_SHARE = 0.1
"""Part of a run's time that measuring may take: nothing else goes on meanwhile."""


class Quota:
    """Says whether another scene may begin: free space where lake and temporary files lie, and the size of the lake."""

    def __init__(self, lake: Lake, keep_free_gb: float | None = None, quota_gb: float | None = None) -> None:
        self._lake = lake
        self._keep_free = KEEP_FREE_GB if keep_free_gb is None else keep_free_gb
        self._quota = quota_gb
        self._looked = self._measured = -1e9
        self._took = 0.0
        self._size_gb = 0.0
        self._reason: str | None = None

    def reason(self) -> str | None:
        """Why no further scene may begin, in one line; None when there is room."""
        if self._reason is None and time.monotonic() - self._looked >= LOOK_SECONDS:
            self._looked = time.monotonic()
            self._reason = self._free_reason() or self._size_reason()
        return self._reason

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

    def _size_reason(self) -> str | None:
        if self._quota is None:
            return None
        begun = time.monotonic()
        pause = 0.0 if self._size_gb > 0.9 * self._quota else MEASURE_SECONDS
        if begun - self._measured >= max(pause, self._took / MEASURE_SHARE):
            self._size_gb = sum(entry.size for entry in self._lake.storage.walk("")) / GB
            self._measured = time.monotonic()
            self._took = self._measured - begun
        if self._size_gb < self._quota:
            return None
        return (
            f"the lake holds {self._size_gb:.1f} GB, --quota is {self._quota:g} GB; `metascenes lake vacuum` may free some, then run again"
        )
