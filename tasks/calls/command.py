"""Programs of others in processes of their own: bounded in time, and none of what they started stays."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from schemas.errors import InputError
from schemas.machine.environment import child_environment
from schemas.text import cut, one_line
from tasks.calls.guard import NOT_STARTED, NOT_STARTED_LINE

_LAST_BYTES = 4096
"""Of what a program wrote to its standard error, the end is looked at: that is where it says what went wrong."""


GUARD = Path(__file__).with_name("guard.py")
"""Program between this process and the foreign one: a worker may be killed at any moment."""


PLACE = re.compile(r"\{(\w*)\}")
"""Where a value goes into a word."""


def places_in(words: Sequence[str]) -> set[str]:
    """Names in braces that words hold."""
    return {name for word in words for name in PLACE.findall(word)}


def filled(words: Sequence[str], values: Mapping[str, str]) -> list[str]:
    """Fill values into words, in the place of names in braces.

    A value is never read again, so that braces in it mean nothing. A word that begins with a value is not an option:
    it gets a space before a `-`, at which parsers of command lines stop looking.
    """
    return [_as_value(word, PLACE.sub(lambda match: values[match[1]], word)) for word in words]


def _as_value(word: str, text: str) -> str:
    """The text of a filled word, with a space before it if a value made it look like an option."""
    is_option = text.startswith("-") and not word.startswith("-")
    return f" {text}" if is_option else text


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


@dataclasses.dataclass(frozen=True)
class Ending:
    """How a program ended. code: its exit code, None where its time was up. last: the last line of its standard error, '' for none.
    limit_s: How long it might have taken [s]. errors: end of its standard error."""

    code: int | None
    last: str
    seconds: float
    limit_s: float
    errors: str = ""

    @property
    def problem(self) -> str:
        """What went wrong, '' for nothing."""
        if self.code is None:
            return f"took longer than {self.limit_s:g} s"
        if self.code == 0:
            return ""
        how = f"was ended by signal {-self.code}" if self.code < 0 else f"ended with code {self.code}"
        return f"{how}: {self.last or 'it did not say why'}"


def run_apart(command: Sequence[str], folder: Path, timeout_s: float, more: Mapping[str, str] | None = None) -> Ending:
    """Run a program in a folder until it ends, or for so many seconds. It reads nothing, and its output is dropped.

    It and all that it started are gone afterwards, and also if this process is killed meanwhile.

    Args:
        command: program and its words; no shell reads them.
        folder: working folder of the program.
        timeout_s: time after which the program is ended [s].
        more: environment variables in addition to `KEPT_VARIABLES`.

    Raises:
        OSError, ValueError: it cannot be started.
    """
    clock = time.monotonic()
    if shutil.which(command[0]) is None:
        raise FileNotFoundError(errno.ENOENT, "there is no such program", command[0])
    with tempfile.TemporaryFile() as error_file:
        theirs, ours = os.pipe()
        with os.fdopen(ours, "wb", buffering=0) as lifeline:
            guarded = [sys.executable, "-I", "-S", str(GUARD), str(theirs), *command]
            try:
                guard = subprocess.Popen(
                    guarded, cwd=folder, env=child_environment() | dict(more or {}), pass_fds=[theirs],
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=error_file, start_new_session=True,
                )  # fmt: skip
            finally:
                os.close(theirs)
            try:
                code: int | None = guard.wait(timeout_s)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                # Without the other end of its pipe, the guard ends all that is left.
                lifeline.close()
                guard.wait()
        error_file.seek(max(error_file.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
        error_text = error_file.read().decode(errors="replace").strip()
    if code == NOT_STARTED and error_text.startswith(NOT_STARTED_LINE):
        number = int(error_text.removeprefix(NOT_STARTED_LINE))
        raise OSError(number, os.strerror(number), command[0])
    last = cut(one_line(error_text.splitlines()[-1])) if error_text else ""
    return Ending(code, last, time.monotonic() - clock, timeout_s, error_text)


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
