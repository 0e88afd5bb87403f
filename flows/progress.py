"""What a run tells while it works: one listener at a time, a bar for people or nothing."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import Any

from schemas.text import shown

LINE_SECONDS = 10.0
"""Between two lines where there is no bar."""


class Progress:
    """A bar over (scene, stage) steps on standard error when that is a terminal; silent otherwise.

    `lines`: where it is none, a line at the start, at the end and now and then between.
    """

    def __init__(self, title: str, total: int, shown: bool | None = None, lines: bool = False) -> None:
        self._lock = threading.Lock()
        self._bar: Any = None
        self._title, self._total = title, total
        self._shown = sys.stderr.isatty() if shown is None else shown
        self._lines = lines and not self._shown
        self._told, self._done, self._said_at = self._lines and total > 0, 0, 0.0

    def begin(self, total: int) -> None:
        """Begin here, with so many steps: for work that is preceded by other work, and whose size is not known before."""
        self.__exit__(None, None, None)
        self._total, self._told, self._done = total, self._lines and total > 0, 0
        self.__enter__()

    def advance(self, text: str = "") -> None:
        """One step is over; `text` says which."""
        with self._lock:
            self._done += 1
            if self._told and (self._done == self._total or time.monotonic() - self._said_at >= LINE_SECONDS):
                self._tell(text)
        if self._bar is not None:
            with self._lock:
                self._bar.update(self._task, advance=1, what=shown(text))

    def _tell(self, text: str = "") -> None:
        self._said_at = time.monotonic()
        print(f"{self._title}: {self._done} of {self._total}{', ' if text else ''}{text}", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """A line above the bar; plain on standard error when there is none."""
        if self._bar is not None:
            self._bar.console.print(shown(text), highlight=False, markup=False)
        else:
            print(text, file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        if self._told:
            self._tell()
        if self._shown and self._total:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            from flows.terminal import drawn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.fields[what]}", markup=False),
            )
            self._bar = Bar(*columns, console=Console(file=drawn(sys.stderr)), transient=True, redirect_stdout=False, redirect_stderr=False)
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total, what="")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


_current = Progress("", 0, shown=False)


def listen(progress: Progress | None) -> None:
    """Make `progress` the one that `current` gives; None for silence."""
    global _current
    _current = progress or Progress("", 0, shown=False)


def current() -> Progress:
    """The listener of the run in this process."""
    return _current
