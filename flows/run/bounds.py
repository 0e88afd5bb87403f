"""Checks of foreign files in a process with limits on time and memory; its death is reported in one line.

USD, UsdValidation, MuJoCo's compiler and NVIDIA's validator take what a file asks for, and have no bounds of their own.
Our own exports are checked where they are made, in a worker that has its time limit.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import math
import os
import pickle
import resource
import signal
import stat
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from flows.run.child import start_worker
from schemas.budget import BUDGET
from tasks.exports.findings import Finding

RULE = "budget"
"""The rule that a file breaks whose reader takes too much, or dies of it."""

START: Literal["spawn", "fork"] = "spawn"
"""How the process starts. A fork is quicker, and fit for one that is about to check thousands of files and has no other threads."""

PATIENCE = 4
"""A process may wait for others this many times as long as it may compute; only one that waits for ever takes longer."""


_LONGEST = 86_400.0  # s; the operating system waits for weeks at most


class OutOfBounds(Exception):
    """The process exceeded its limits, or died."""


MAX_FILES = 100_000
"""So many files of a folder are counted: somebody may have put a scene beside everything else."""


def findings_of(check: Callable[[Path], Sequence[Finding]], path: Path, times: float = 1.0, *, names_others: bool = False) -> list[Finding]:
    """Findings of a check on a foreign file or folder, made in a process of its own with `times` the usual budget.

    The budget follows from the bytes of the file or folder; of a file that `names_others` to read, from those of its folder.

    Raises:
        Exception: what the check raises.
    """
    size = _bytes(path.parent if names_others and path.is_file() else path)
    seconds = times * (BUDGET.seconds + BUDGET.child_seconds_per_mb * size / 1e6)
    memory = int(times * (BUDGET.child_bytes + BUDGET.child_bytes_per_byte * size))
    try:
        return list(bounded(check, path, seconds=seconds, memory_bytes=memory))
    except OutOfBounds as error:
        return [Finding(RULE, path.name, f"cannot be checked: {error}; --budget {2 * times:g} gives it twice as much")]


def _bytes(place: Path) -> int:
    """Bytes of a file, or of the regular files in a folder, also those that links in it lead to."""
    files = [place] if place.is_file() else itertools.islice(_files(place), MAX_FILES)
    size = 0
    for file in files:
        with contextlib.suppress(OSError):  # a link that leads nowhere, or a folder that is not ours
            status = file.stat()
            size += min(status.st_size, BUDGET.scene_bytes) if stat.S_ISREG(status.st_mode) else 0  # no reader takes more
    return size


def _files(folder: Path) -> Iterator[Path]:
    for root, _, names in os.walk(folder):
        yield from (Path(root, name) for name in sorted(names))


def bounded(function: Callable[..., Any], *arguments: Any, seconds: float, memory_bytes: int) -> Any:
    """`function(*arguments)` in a new process with so many seconds of computing and bytes of memory.

    Raises:
        OutOfBounds: it took more of either, or died.
        Exception: what the function raises.
    """
    import multiprocessing

    context: Any = multiprocessing.get_context(START)
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(
        target=_compute, args=(sending, os.getpid(), seconds, memory_bytes, function, arguments), daemon=True, name="bounded"
    )
    process.start()
    sending.close()
    answer: bytes | None = None
    try:
        receiving.recv_bytes()  # it is there; now its time runs
        answer = receiving.recv_bytes() if receiving.poll(min(PATIENCE * seconds, _LONGEST)) else None
    except EOFError:
        answer = b""
    finally:
        receiving.close()
        process.join(0.0 if answer is None else 1.0)  # one that has answered ends by itself, and its exit code tells how
        process.kill()
        process.join()
    if answer is None or process.exitcode == -signal.SIGXCPU:
        raise OutOfBounds(f"a reader of it takes more than {seconds:.0f} s")
    if not answer:
        died = signal.Signals(-process.exitcode).name if process.exitcode and process.exitcode < 0 else f"exit code {process.exitcode}"
        raise OutOfBounds(f"a reader of it dies ({died}) with {memory_bytes >> 20} MB of memory")
    result, error = pickle.loads(answer)  # of our own making
    if isinstance(error, MemoryError):
        raise OutOfBounds(f"a reader of it takes more than {memory_bytes >> 20} MB of memory") from error
    if error is not None:
        raise error
    return result


def _compute(
    sending: Connection, parent: int, seconds: float, memory_bytes: int, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    """What the process does: keep to its bounds, compute, answer. What its libraries say on the way is not for people."""
    start_worker(parent)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    most = math.ceil(time.process_time() + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sending.send_bytes(b"")
    try:
        answer = pickle.dumps((function(*arguments), None))
    except Exception as error:
        lacks_memory = getattr(error, "errno", None) == errno.ENOMEM or "failed to map segment" in str(error)  # as imports say it
        answer = _pickled(MemoryError() if lacks_memory else error)
    sending.send_bytes(answer)


def _pickled(error: Exception) -> bytes:
    """An exception that can travel, with where it came from."""
    error.add_note("".join(traceback.format_exception(error))[-4000:])
    try:
        answer = pickle.dumps((None, error))
        pickle.loads(answer)
    except Exception:  # some cannot be made again
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return answer
