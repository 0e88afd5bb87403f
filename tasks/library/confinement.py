"""A reader of foreign files in a process of its own, with limits on computing time, memory and what it writes.

USD takes what a file asks for. What comes back is a GLB and a JSON of plain values, read as foreign files are: a reader that a file has
taken over can hand in nothing worse than another foreign file. The process gets no more of the environment than it needs to start.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from schemas.parsing import json_value
from tasks.calls.command import run_apart

FACTS, MODEL = "facts.json", "model.glb"
"""What a child leaves in its folder."""

PATIENCE = 6
"""So many times its computing time a child may take by the clock: it waits where others compute."""

CODE = "from tasks.library.usd.child import main; main()"


@dataclasses.dataclass(frozen=True)
class Confined:
    """What a child found. facts: Plain values. model: A GLB, where it made one."""

    facts: Mapping[str, Any]
    model: bytes | None


def confined(task: str, path: Path, root: Path, name: str) -> Confined:
    """What a child makes of a file below `root`. task: `read` or `list`.

    Raises:
        InputError: the file is refused, or its reader takes too much or dies of it.
    """
    size = path.stat().st_size
    seconds = int(BUDGET.seconds + BUDGET.child_seconds_per_mb * size / 1e6) + 1
    memory = BUDGET.child_bytes + BUDGET.child_bytes_per_byte * size
    with temporary_folder() as folder:
        files = [str(file.absolute()) for file in (path, root)]
        command = [sys.executable, "-c", CODE, task, *files, str(folder), str(seconds), str(memory)]
        places = [place or os.getcwd() for place in sys.path]
        more = {"PYTHONPATH": os.pathsep.join(places), "PXR_WORK_THREAD_LIMIT": "1", "HOME": str(folder)}
        ending = run_apart(command, folder, PATIENCE * seconds, more)
        if ending.code is None:
            raise InputError(name, "content", f"its reader takes more than {seconds} s", "simplify it")
        if ending.code:
            problem = _death(ending.code, ending.errors, seconds, memory)
            raise InputError(name, "content", problem, "export it again, or simplify it")
        facts = json_value(read_file(folder / FACTS, name, BUDGET.text_bytes))
        if not isinstance(facts, dict):
            raise InputError(name, "content", "its reader gave no answer", "export it again")
        if "refused" in facts:
            raise InputError(name, *(str(part) for part in facts["refused"]))
        model = read_file(folder / MODEL, name, BUDGET.model_bytes) if task == "read" else None
    return Confined(facts, model)


def _death(code: int, text: str, seconds: int, memory: int) -> str:
    """What a child died of, in a line."""
    if code == -signal.SIGXCPU:
        return f"its reader takes more than {seconds} s"
    if code == -signal.SIGXFSZ:
        return f"its reader writes more than {BUDGET.model_bytes >> 20} MB"
    if "MemoryError" in text or "bad_alloc" in text or code in (-signal.SIGKILL, -signal.SIGABRT):
        return f"its reader takes more than {memory >> 20} MB of memory"
    last = text.splitlines()[-1:] or [""]
    return f"its reader dies ({signal.Signals(-code).name if code < 0 else last[0][:160]})"


def limit(seconds: int, memory: int) -> None:
    """Hold this process to its limits."""
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_FSIZE, (BUDGET.model_bytes, BUDGET.model_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def answer(folder: Path, facts: Mapping[str, Any]) -> None:
    """Leave the answer of a child."""
    Path(folder, FACTS).write_text(json.dumps(facts))
