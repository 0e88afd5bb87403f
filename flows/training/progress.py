"""How far a training is, for people: a bar on a terminal, a line now and then where there is none."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from flows.progress import Progress


class StepBar:
    """``with StepBar("selection") as bar: train(..., bar.report)``. A fit that begins anew, or is another's, has a bar of its own."""

    def __init__(self, title: str, what: str = "steps") -> None:
        self._title, self._what = title, what
        self._bar: Progress | None = None
        self._done, self._of = 0, 0

    def report(self, done: int, of: int, text: str) -> None:
        """So many of so many steps are done."""
        if self._bar is None or of != self._of or done <= self._done:
            self._end()
            self._bar = Progress(f"{self._title}: {self._what}", of, lines=True).__enter__()
            self._done, self._of = 0, of
        for _ in range(done - self._done):
            self._bar.advance(text)
        self._done = done

    def __enter__(self) -> StepBar:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._end()

    def _end(self) -> None:
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
            self._bar = None


Watch = Callable[[str, int, int, str], None]
"""Told of trainings: which, and as a report so many of so many steps."""


class TrainingBars:
    """``with TrainingBars(): ...``: bars for the trainings that a flow carries out meanwhile in this process, one at a time."""

    def __init__(self) -> None:
        self._bar: StepBar | None = None
        self._name = ""

    def watch(self, name: str, done: int, of: int, text: str) -> None:
        """See `Watch`."""
        if self._bar is None or name != self._name:
            self._end()
            self._bar, self._name = StepBar(name).__enter__(), name
        self._bar.report(done, of, text)
        if done == of:
            self._end()

    def __enter__(self) -> TrainingBars:
        _watches.append(self.watch)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        _watches.remove(self.watch)
        self._end()

    def _end(self) -> None:
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
            self._bar = None


_watches: list[Watch] = []


def watched() -> Watch:
    """Who watches trainings in this process; nobody where no bar is shown."""
    return _watches[-1] if _watches else _unseen


def _unseen(name: str, done: int, of: int, text: str) -> None:
    """Nobody watches."""
