"""The processes that compute: one pool for a run on this machine, or one process of its own for every remote worker."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from flows.run.child import follow_parent
from flows.run.pool import PoolStopped, WorkerPool

_shared: dict[str, WorkerPool | None] = {}
"""By run; None of a run that is over."""

_own: list[WorkerPool] = []
_lock = threading.Lock()


@contextlib.contextmanager
def shared_pool(run: str, workers: int) -> Iterator[WorkerPool]:
    """The pool of a run whose tasks are threads of this process."""
    with WorkerPool(workers) as pool:
        _shared[run] = pool
        try:
            yield pool
        finally:
            _shared[run] = None


def at_work(run: str) -> dict[str, tuple[str, float]] | None:
    """Scenes of a run that workers are at: stage, and since when [s since the epoch]; None where this process cannot tell."""
    pool = _shared.get(run)
    if pool is None:
        return None
    return {label[0]: (label[1], since) for label, since in pool.under_way().items()}


def pool_of(run: str) -> WorkerPool:
    """The pool that computes a task of a run: the shared one, else this process's own.

    A worker of Prefect's, Dask's or Ray's hands the computing on to a process of its own, which may crash in native code
    or hang without taking the worker along. It stays warm from task to task, and ends with the worker.

    Raises:
        PoolStopped: the run had its pool in this process, and is ending.
    """
    pool = _shared[run] if run in _shared else _own_pool()
    if pool is None:  # a task that slept before another try meanwhile
        raise PoolStopped("the run is ending")
    return pool


def _own_pool() -> WorkerPool:
    with _lock:
        if not _own:
            import multiprocessing
            from multiprocessing.util import Finalize

            parent = multiprocessing.parent_process()
            if parent is not None and parent.pid is not None:
                follow_parent(parent.pid)  # Prefect's own would wait for work for ever once the run was killed
            multiprocessing.current_process().daemon = False  # Dask's workers are, and could have no process of their own
            pool = WorkerPool(1)
            Finalize(None, pool.stop, exitpriority=100)  # before a worker that ends waits for its processes to end
            _own.append(pool)
        return _own[0]
