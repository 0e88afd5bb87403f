"""Programs of others: called with a list of words, in a folder of their own, for a limited time, and ended with all that they began."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from schemas.text import cut, one_line

MOST_SHOWN = 200
"""Characters of what a program said before it failed."""

SECRETS = ("KEY", "TOKEN", "SECRET", "PASSWORD", "CREDENTIAL")
"""Variables of the environment whose names hold one of these are not given to programs of others."""


class CommandFailed(Exception):
    """A program did not do its work. The text says why, in one line."""


def run_command(words: Sequence[str], folder: Path, seconds: float, more: Mapping[str, str] | None = None) -> str:
    """What a program says on its standard output, once it has ended well.

    words: The program and its arguments; no shell reads them. folder: Where it runs. more: Variables of its environment.

    Raises:
        CommandFailed: there is no such program, it ends with another exit code than 0, or not in time.
    """
    environment = {name: value for name, value in os.environ.items() if not any(word in name.upper() for word in SECRETS)}
    try:
        process = subprocess.Popen(
            list(words), cwd=folder, env={**environment, **(more or {})}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise CommandFailed(f"cannot be started: {error.strerror or error}") from error
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired as late:
        _end(process)
        raise CommandFailed(f"took longer than {seconds:g} s") from late
    except BaseException:
        _end(process)
        raise
    if process.returncode:
        lines = [line for line in (err or out).decode(errors="replace").splitlines() if line.strip()]
        what = f"was ended by signal {-process.returncode}" if process.returncode < 0 else f"ended with exit code {process.returncode}"
        raise CommandFailed(f"{what}: {cut(one_line(lines[-1]), MOST_SHOWN)}" if lines else what)
    return out.decode(errors="replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a program and what it began; of one that is gone there is nothing to kill."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
