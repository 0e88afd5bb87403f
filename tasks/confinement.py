"""Run a reader of foreign files in a process of its own, with limits on computing time, memory and output.

The child leaves a JSON of plain values, and files, in a folder of its own. Both are read as foreign files are: a reader that a file
has taken over can hand in nothing worse than another foreign file. It gets only the environment that it needs to start.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.calls.command import run_apart

FACTS = "facts.json"
"""The answer that a child leaves in its folder."""

MAX_WAIT_FACTOR = 6
"""Wall-clock seconds per second of computing time: a child waits while other processes compute."""


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of a child. seconds: computing time [s]. memory: data [bytes]. written: its largest file [bytes]."""

    seconds: int
    memory: int
    written: int = BUDGET.model_bytes

    @staticmethod
    def of_file(size: int, written: int = BUDGET.model_bytes) -> Limits:
        """Limits for a file of `size` bytes."""
        seconds = int(BUDGET.seconds + BUDGET.child_seconds_per_mb * size / 1e6) + 1
        return Limits(seconds, BUDGET.child_bytes + BUDGET.child_bytes_per_byte * size, written)


def run_child(code: str, arguments: Sequence[str], folder: Path, limits: Limits, name: str) -> Mapping[str, Any]:
    """Run a child and return its facts.

    Args:
        code: Python that the child runs; it calls `limit` with its last two arguments first.
        arguments: words for the child, before its two limits.
        folder: an empty folder, in which the child works and leaves its answer.
        limits: computing time, memory and output.
        name: the file, for messages.

    Raises:
        InputError: the child refuses the file, exceeds a limit or dies.
    """
    command = [sys.executable, "-c", code, *arguments, str(limits.seconds), str(limits.memory)]
    places = [place or os.getcwd() for place in sys.path]
    more = {"PYTHONPATH": os.pathsep.join(places), "PXR_WORK_THREAD_LIMIT": "1", "HOME": str(folder)}
    more |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    ending = run_apart(command, folder, MAX_WAIT_FACTOR * limits.seconds, more)
    if ending.code is None:
        raise InputError(name, "content", f"its reader takes more than {limits.seconds} s", "simplify it")
    if ending.code:
        raise InputError(name, "content", _death(ending.code, ending.errors, limits), "export it again, or simplify it")
    facts = json_value(read_file(folder / FACTS, name, BUDGET.text_bytes))
    if not isinstance(facts, dict):
        raise InputError(name, "content", "its reader gave no answer", "export it again")
    if "refused" in facts:
        raise InputError(name, *(str(part) for part in facts["refused"]))
    return facts


def _death(code: int, text: str, limits: Limits) -> str:
    """Cause of a child's death, in one line."""
    if code == -signal.SIGXCPU:
        return f"its reader takes more than {limits.seconds} s"
    if code == -signal.SIGXFSZ:
        return f"its reader writes more than {limits.written >> 20} MB"
    if "MemoryError" in text or "bad_alloc" in text or code in (-signal.SIGKILL, -signal.SIGABRT):
        return f"its reader takes more than {limits.memory >> 20} MB of memory"
    last = text.splitlines()[-1:] or [""]
    return f"its reader dies ({signal.Signals(-code).name if code < 0 else last[0][:160]})"


def limit(seconds: int, memory: int, written: int = BUDGET.model_bytes) -> None:
    """Limit this process. seconds: computing time [s]. memory: data [bytes]. written: its largest file [bytes]."""
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_FSIZE, (written, written))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def answer(folder: Path, read: Callable[[], Mapping[str, Any]], remedy: str) -> None:
    """Leave the facts that a reader gives in a child's folder, otherwise the reason why it refuses the file.

    remedy: for readers that raise something else than InputError.
    """
    try:
        facts = read()
    except InputError as error:
        facts = {"refused": [error.field, error.problem, error.remedy]}
    except MemoryError:  # the parent says so
        raise
    except BaseException as error:  # foreign readers raise whatever the bytes lead them to, and panics of Rust are no Exception
        facts = {"refused": ["content", f"cannot be read ({type(error).__name__}: {error})"[:300], remedy]}
    leave(folder, facts)


def leave(folder: Path, facts: Mapping[str, Any]) -> None:
    """Leave the facts of a child in its folder."""
    (folder / FACTS).write_text(json.dumps(facts))
