"""A warm pool of spawned worker processes: survives a native crash, times out one task, dies with its parent."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from types import TracebackType
from typing import Any, TypeVar

from flows.run.child import start_worker
from tasks.stage import Spread, in_turn

T = TypeVar("T")


class WorkerLost(Exception):
    """The worker died while it computed: a crash in native code, the out-of-memory killer, a kill."""


class WorkerTimeout(Exception):
    """The task took longer than its time limit; its worker was stopped."""


class PoolStopped(Exception):
    """The pool was stopped while, or before, the task was computed."""


class WorkerPool:
    """Worker processes that stay warm between tasks. Threads of the caller share it.

    ``with WorkerPool(2) as pool: result = pool.call(function, argument, timeout=600)``
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._lock = threading.Lock()
        self._open: dict[Any, tuple[str, ...] | None] = {}
        self._begun: dict[Any, float] = {}
        self._stopped = False
        self._pool = self._started()

    def _started(self) -> Any:
        import multiprocessing

        from pebble import ProcessPool

        return ProcessPool(
            max_workers=self.workers, context=multiprocessing.get_context("spawn"), initializer=start_worker, initargs=(os.getpid(),)
        )

    def _replace(self, broken: Any) -> None:
        """Start anew after all workers died at once, which pebble does not survive. The lock is held."""
        if self._pool is broken and not self._stopped:
            self._pool = self._started()
            threading.Thread(target=_end, args=(broken,), name="broken-pool", daemon=True).start()

    def under_way(self) -> dict[tuple[str, ...], float]:
        """Labels of the calls that a worker is at, and since when [s since the epoch]: when this was first asked of each."""
        with self._lock:
            for future, label in self._open.items():
                if label is not None and future.running():
                    self._begun.setdefault(future, time.time())
            return {label: self._begun[future] for future, label in self._open.items() if label is not None and future in self._begun}

    def call(self, function: Callable[..., T], *arguments: Any, timeout: float | None = None, label: tuple[str, ...] | None = None) -> T:
        """`function(*arguments)` in a worker; waits for the result. `label` names it among those that are under way.

        Raises:
            WorkerLost: the worker died.
            WorkerTimeout: it took longer than `timeout` seconds.
            PoolStopped: the pool was stopped meanwhile.
        """
        from concurrent.futures import CancelledError
        from concurrent.futures import TimeoutError as FutureTimeout
        from concurrent.futures.process import BrokenProcessPool

        from pebble import ProcessExpired

        with self._lock:
            if self._stopped:
                raise PoolStopped("the run is ending")
            try:
                future = self._pool.schedule(function, args=arguments, timeout=timeout)
            except RuntimeError:  # broken, and nobody has noticed yet
                self._replace(self._pool)
                future = self._pool.schedule(function, args=arguments, timeout=timeout)
            pool = self._pool
            self._open[future] = label
        try:
            result: T = future.result()
            return result
        except ProcessExpired as error:
            raise WorkerLost(f"the worker died (exit code {error.exitcode})") from error
        except BrokenProcessPool as error:
            with self._lock:
                self._replace(pool)
            raise WorkerLost("all workers died at once") from error
        except FutureTimeout as error:
            raise WorkerTimeout(f"took longer than {timeout:g} s") from error
        except CancelledError as error:
            raise PoolStopped("the run is ending") from error
        finally:
            with self._lock:
                self._open.pop(future, None)
                self._begun.pop(future, None)

    def __enter__(self) -> WorkerPool:
        return self

    def stop(self) -> None:
        """End the workers at once. Threads that wait for a result get an answer, or nobody could ever end."""
        with self._lock:
            self._stopped = True
            waiting = list(self._open)
        for future in waiting:
            future.cancel()
        self._pool.stop()
        self._pool.join()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self._pool.close()
            self._pool.join()
        else:
            self.stop()


def _end(pool: Any) -> None:
    """Let go of a broken pool: of its threads, and of workers that it started last."""
    pool.stop()
    pool.join()


def spread_over(processes: int, advance: Callable[[int, int], None] | None = None) -> Spread:
    """A map for work inside a worker: over so many processes of its own, kept warm; in turn when there is only one.

    The results are in the order of the items either way. `advance` is told how many of them are there, and of how many.
    """
    if processes < 2 and advance is None:
        return in_turn

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        from concurrent.futures.process import BrokenProcessPool

        if len(items) < 2 or processes < 2:
            return _gathered(map(function, items), len(items), advance)
        try:
            return _gathered(_own_processes(processes).map(function, items), len(items), advance)
        except BrokenProcessPool:  # one of them was killed; the next scene gets new ones, this one does without
            _own_processes.cache_clear()
            return _gathered(map(function, items), len(items), advance)

    return spread


def _gathered(values: Iterable[Any], of: int, advance: Callable[[int, int], None] | None) -> list[Any]:
    gathered = []
    for value in values:
        gathered.append(value)
        if advance is not None:
            advance(len(gathered), of)
    return gathered


@cache
def _own_processes(processes: int) -> Any:
    """Processes of a worker's own; they end soon after it, however it ends."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    multiprocessing.current_process().daemon = False  # else it may have no processes of its own
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=start_worker, initargs=(os.getpid(),))
