"""Programs of others in processes of their own: bounded in time, and none of what they started stays."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from schemas.errors import InputError
from schemas.text import cut, one_line

_LAST_BYTES = 4096
"""Of what a program wrote to its standard error, the end is looked at: that is where it says what went wrong."""


SECRETS = ("KEY", "TOKEN", "SECRET", "PASSWORD", "CREDENTIAL")
"""Variables of the environment whose names hold one of these are not given to programs of others."""


GUARD = """
import ctypes, os, signal, sys
try:
    ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG, which stays through exec
except (AttributeError, OSError):
    pass
if os.getppid() != int(sys.argv[1]):
    os._exit(1)
os.execvp(sys.argv[2], sys.argv[2:])
"""
"""What becomes the program, once the system knows to end it with the process that wanted it: a worker may be killed at any moment."""


PLACE = re.compile(r"\{(\w*)\}")
"""Where a value goes into a word."""


def places_in(words: Sequence[str]) -> set[str]:
    """Names in braces that words hold."""
    return {name for word in words for name in PLACE.findall(word)}


def filled(words: Sequence[str], values: Mapping[str, str]) -> list[str]:
    """Words with values in the place of names in braces; a value is never read again, so that braces in it mean nothing."""
    return [PLACE.sub(lambda match: values[match[1]], word) for word in words]


def words_of(command: str, places: Sequence[str], where: str) -> list[str]:
    """The words of a command line, in which names of places stand in braces. where: The settings, as errors name them.

    Raises:
        InputError: there are none, quotes are left open, or braces name something unknown.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(where, "command", f"cannot be read: {error}", "quote it as for a shell") from error
    if not words:
        raise InputError(where, "command", "is empty", f"give one with {{{places[0]}}} and {{out}}")
    unknown = sorted(places_in(words) - set(places))
    if unknown or any(re.search(r"[{}]", PLACE.sub("", word)) for word in words):
        problem = f"has {{{unknown[0]}}}, which is nothing" if unknown else "has a brace that is left open"
        raise InputError(where, "command", problem, f"write one of {', '.join(f'{{{name}}}' for name in places)}")
    return words


class CommandFailed(Exception):
    """A program did not do its work. The text says why, in one line."""


def open_environment() -> dict[str, str]:
    """The variables of the environment that programs of others are given."""
    return {name: value for name, value in os.environ.items() if not any(word in name.upper() for word in SECRETS)}


@dataclasses.dataclass(frozen=True)
class Ending:
    """How a program ended. code: its exit code, None where its time was up. last: the last line of its standard error, '' for none.
    limit_s: How long it might have taken [s]."""

    code: int | None
    last: str
    seconds: float
    limit_s: float

    @property
    def problem(self) -> str:
        """What went wrong, '' for nothing."""
        if self.code is None:
            return f"took longer than {self.limit_s:g} s"
        if self.code == 0:
            return ""
        how = f"was ended by signal {-self.code}" if self.code < 0 else f"ended with code {self.code}"
        return f"{how}: {self.last or 'it did not say why'}"


def run_apart(command: Sequence[str], folder: Path, timeout_s: float) -> Ending:
    """Run a program in a folder until it ends, or for so many seconds. It reads nothing, and what it prints is dropped.

    It and all that it started, as far as they stayed in its process group, are gone afterwards.

    Raises:
        OSError, ValueError: it cannot be started.
    """
    clock = time.monotonic()
    if shutil.which(command[0]) is None:
        raise FileNotFoundError(errno.ENOENT, "there is no such program", command[0])
    guarded = [sys.executable, "-c", GUARD, str(os.getpid()), *command]
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(
            guarded, cwd=folder, env=open_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
            start_new_session=True,
        )  # fmt: skip
        try:
            code: int | None = child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        errors.seek(max(errors.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
        lines = errors.read().decode(errors="replace").strip().splitlines()
    return Ending(code, cut(one_line(lines[-1])) if lines else "", time.monotonic() - clock, timeout_s)


def run_command(command: Sequence[str], folder: Path, timeout_s: float) -> None:
    """Run a program that has to end well; as `run_apart`.

    Raises:
        CommandFailed: there is no such program, it ends with another exit code than 0, or not in time.
    """
    try:
        ending = run_apart(command, folder, timeout_s)
    except (OSError, ValueError) as error:
        raise CommandFailed(f"cannot be started: {getattr(error, 'strerror', None) or error}") from error
    if ending.problem:
        raise CommandFailed(ending.problem)
