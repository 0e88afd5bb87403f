"""Renewal: what a living process says again and again, so that others know that it lives."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable


class Renewal:
    """A thread that calls `renew` every `seconds`, from `start` to `stop`.

    What it raises is let go: the storage may be back at the next call, and who depends on it asks for itself.
    """

    def __init__(self, name: str, renew: Callable[[], object], seconds: float) -> None:
        self._name, self._renew, self._seconds = name, renew, seconds
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin; the first call comes after `seconds`."""
        self._stopped.clear()
        self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End, after a call that is under way; nothing if it never began."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()

    def _work(self) -> None:
        pause = self._seconds
        while not self._stopped.wait(pause):
            begun = time.monotonic()
            with contextlib.suppress(Exception):
                self._renew()
            pause = max(0.0, self._seconds - (time.monotonic() - begun))
