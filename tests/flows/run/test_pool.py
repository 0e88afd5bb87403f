"""The worker pool: crashes, time limits, a killed parent, and one thread per worker."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from flows.run.child import ONE_THREAD
from flows.run.pool import WorkerLost, WorkerPool, WorkerTimeout, spread_over
from tests.conftest import REPOSITORY

LIMIT = 60.0
"""Seconds that a healthy task may take here: starting a worker imports this module, on a busy machine."""


def thread_variables() -> dict[str, str | None]:
    return {name: os.environ.get(name) for name in ONE_THREAD}


@pytest.fixture
def pool() -> Iterator[WorkerPool]:
    with WorkerPool(1) as opened:
        yield opened


def test_a_result_comes_back_from_another_process(pool: WorkerPool) -> None:
    assert pool.call(divmod, 17, 5, timeout=LIMIT) == (3, 2)
    first = pool.call(os.getpid, timeout=LIMIT)
    assert first != os.getpid()
    assert pool.call(os.getpid, timeout=LIMIT) == first, "the worker stays warm between tasks"


def test_an_error_of_the_task_is_raised_as_itself(pool: WorkerPool) -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        pool.call(int, "seven", timeout=LIMIT)
    assert pool.call(int, "7", timeout=LIMIT) == 7


def end_with(code: int) -> None:
    os._exit(code)


def kill_yourself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def squared(number: int) -> tuple[int, int]:
    return number**2, os.getpid()


def die_once(path: str) -> str:
    """Dies at the first call, wherever that is but in the worker itself."""
    if multiprocessing.parent_process() is not None and not Path(path).exists():
        Path(path).touch()
        kill_yourself()
    return path


def spread_twice(path: str) -> tuple[int, list[tuple[int, int]], list[str], list[tuple[int, int]]]:
    """What a worker gets from processes of its own: before one of them dies, when it does, and after."""
    spread = spread_over(2)
    return os.getpid(), spread(squared, range(6)), spread(die_once, [path, path]), spread(squared, range(4))


@pytest.mark.whole
def test_a_worker_spreads_work_over_its_own_processes_and_survives_the_loss_of_one(pool: WorkerPool, tmp_path: Path) -> None:
    path = str(tmp_path / "died")
    own, first, lost, again = pool.call(spread_twice, path, timeout=2 * LIMIT)
    assert [value for value, _ in first] == [n**2 for n in range(6)]
    assert own not in {process for _, process in first}
    assert lost == [path, path], "done in turn by the worker"
    assert [value for value, _ in again] == [n**2 for n in range(4)]
    assert own not in {process for _, process in again}, "new processes"
    assert spread_over(1)(squared, [3]) == [(9, os.getpid())]


def test_a_worker_that_dies_is_reported_and_the_pool_goes_on(pool: WorkerPool) -> None:
    for task, arguments in ((end_with, (3,)), (kill_yourself, ())):
        with pytest.raises(WorkerLost) as lost:
            pool.call(task, *arguments, timeout=LIMIT)
        assert len(str(lost.value).splitlines()) == 1
        assert pool.call(divmod, 9, 2, timeout=LIMIT) == (4, 1)


def test_a_crash_costs_a_neighbor_nothing() -> None:
    from concurrent.futures import ThreadPoolExecutor

    with WorkerPool(2) as pool, ThreadPoolExecutor(2) as threads:
        assert pool.call(int, "1", timeout=LIMIT) == 1
        slow = threads.submit(pool.call, time.sleep, 1.0, timeout=LIMIT)
        with pytest.raises(WorkerLost):
            pool.call(end_with, 5, timeout=LIMIT)
        assert slow.result(timeout=LIMIT) is None


@pytest.mark.whole
def test_the_pool_goes_on_after_all_workers_died_at_once() -> None:
    """Killed while they compute, between tasks, and again: what was under way is lost, and nothing else."""
    from concurrent.futures import ThreadPoolExecutor

    with WorkerPool(2) as pool, ThreadPoolExecutor(2) as threads:
        for pause in (0.0, 0.3, 0.0):
            found = {process.pid for process in threads.map(lambda _: psutil.Process(pool.call(slow_pid, timeout=LIMIT)), range(2))}
            under_way = [threads.submit(pool.call, time.sleep, 30, timeout=LIMIT) for _ in range(2)] if pause else []
            time.sleep(pause)
            for pid in found:
                os.kill(pid, signal.SIGKILL)
            for one in under_way:
                with pytest.raises(WorkerLost):
                    one.result(timeout=LIMIT)
            for _ in range(3):  # a task that was handed to a dying worker is lost with it
                try:
                    assert pool.call(divmod, 9, 2, timeout=LIMIT) == (4, 1)
                    break
                except WorkerLost:
                    continue
            else:
                pytest.fail("the pool does not come back")


def slow_pid() -> int:
    time.sleep(0.2)
    return os.getpid()


def test_a_task_over_its_time_is_stopped_and_the_pool_goes_on(pool: WorkerPool) -> None:
    worker = pool.call(os.getpid, timeout=LIMIT)
    with pytest.raises(WorkerTimeout, match=r"0\.5 s"):
        pool.call(time.sleep, 3000, timeout=0.5)  # the test's own limit is below that
    assert pool.call(divmod, 9, 2, timeout=LIMIT) == (4, 1)
    assert pool.call(os.getpid, timeout=LIMIT) != worker, "the worker that slept was stopped"
    assert not psutil.pid_exists(worker) or psutil.Process(worker).status() == psutil.STATUS_ZOMBIE


def blas_threads() -> int:
    """Threads that NumPy's BLAS would use in this process, as the library itself says."""
    (library,) = (Path(np.__file__).parent.parent / "numpy.libs").glob("libscipy_openblas*")
    return int(ctypes.CDLL(str(library)).scipy_openblas_get_num_threads64_())


def test_workers_keep_to_one_thread_and_the_callers_variables_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before = thread_variables()
    with WorkerPool(1) as pool:
        assert thread_variables() == before, "a thread may read them at any time"
        assert pool.call(thread_variables, timeout=LIMIT) == ONE_THREAD
        assert pool.call(blas_threads, timeout=LIMIT) == 1
    assert thread_variables() == before


PARENT = """
import sys, time, threading
from tests.flows.run.test_pool import sleep_and_tell
from flows.run.pool import WorkerPool

if __name__ == "__main__":
    with WorkerPool(2) as pool:
        print(pool.call(__import__("os").getpid, timeout=600), flush=True)
        threading.Thread(target=pool.call, args=(sleep_and_tell, sys.argv[1], 60), daemon=True).start()
        time.sleep(60)
"""


def sleep_and_tell(file: str, seconds: float) -> None:
    """Leave the worker's process id in `file`, then be in the middle of a task."""
    with open(file, "w") as out:
        out.write(f"{os.getpid()}\n")
    time.sleep(seconds)


def alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return condition()


def test_workers_die_soon_after_their_parent_was_killed(tmp_path: Path) -> None:
    script, busy = tmp_path / "parent.py", tmp_path / "busy"
    script.write_text(PARENT)
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    parent = subprocess.Popen([sys.executable, str(script), str(busy)], env=environment, stdout=subprocess.PIPE, text=True)
    family: list[psutil.Process] = []
    try:
        assert parent.stdout is not None
        idle = int(parent.stdout.readline())
        assert wait_until(lambda: busy.exists() and busy.read_text().endswith("\n"), LIMIT)
        family = psutil.Process(parent.pid).children(recursive=True)
        assert {idle, int(busy.read_text())} <= {process.pid for process in family}
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait(timeout=300)
        wait_until(lambda: not any(alive(process) for process in family), 2.0)
        assert [" ".join(process.cmdline()) for process in family if alive(process)] == []
    finally:
        parent.kill()
        for process in family:
            if alive(process):
                process.kill()
        parent.wait(timeout=300)
