"""What a child process does first. It imports nothing: native libraries read their limits of threads as they are loaded."""

from __future__ import annotations

import os
import signal
import threading
import time

ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "RAYON_NUM_THREADS",
        "IGL_NUM_THREADS",
    ),
    "1",
)
"""Native libraries keep to one thread per worker: the workers are the parallelism."""

WATCH_SECONDS = 0.2
"""How often a child looks whether its parent lives. Short against any stage, free against any core."""


def start_worker(parent: int) -> None:
    """Keep a worker to one thread, leave Ctrl-C to the coordinator, and follow it when it goes.

    The worker sets its own variables: those of the coordinator are read by its threads, for which one that comes and goes
    is an error.
    """
    os.environ.update(ONE_THREAD)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    follow_parent(parent)


def follow_parent(parent: int) -> None:
    """Make this process end soon after `parent` does, however that ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, name="follow-parent", daemon=True).start()
