"""A lock on a local folder, for what a file system cannot do in one step."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

LOCK_SECONDS = 60.0
"""The lock is held while one small file is compared and replaced."""

_thread_lock = threading.Lock()


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder; the kernel frees it when the process ends, however it ends.

    Raises:
        TimeoutError: another process holds it for too long.
    """
    import fcntl

    with _thread_lock:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            _wait_for(partial(fcntl.flock, descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB), folder)
            yield
        finally:
            os.close(descriptor)


def _wait_for(lock: Callable[[], None], folder: Path) -> None:
    """Take a lock that others hold for milliseconds. A holder that was stopped in these must not stop everybody."""
    deadline, pause = time.monotonic() + LOCK_SECONDS, 0.0005
    while True:
        try:
            return lock()
        except BlockingIOError:
            if time.monotonic() > deadline:
                text = f"{folder}: another process has held the lock on this folder for {LOCK_SECONDS:g} s; is it stopped?"
                raise TimeoutError(text) from None
            time.sleep(pause)
            pause = min(2 * pause, 0.02)
