"""Lines that a person types at a terminal, by Python's readline: completion, and a history that outlives the command."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

_MOST_KEPT = 2000
"""Statements that the history keeps."""

_DELIMITERS = " \t\n,()[]{}=<>+-*/%'\"|:;."

Completions = Callable[[str, str], list[str]]
"""What a word may become, by what stands before it in the line and by the word."""


def history_file() -> Path:
    """Where the history is: `metascenes/sql_history` in the user's folder for state."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "metascenes" / "sql_history"


@contextlib.contextmanager
def edited(completions: Completions) -> Iterator[Callable[[str], None]]:
    """Let `input` edit lines for as long as this lasts; gives what keeps a statement in the history.

    Where Python has no readline, lines are read as they are. A history that cannot be kept is said to be, once.
    """
    try:
        import readline
    except ImportError:
        yield lambda statement: None
        return
    readline.set_history_length(_MOST_KEPT)
    file = _history(readline.read_history_file)
    offered: list[str] = []

    def complete(word: str, state: int) -> str | None:
        if state == 0:
            offered[:] = completions(readline.get_line_buffer()[: readline.get_begidx()], word)
        return offered[state] if state < len(offered) else None

    def keep(statement: str) -> None:
        nonlocal file
        readline.add_history(statement)
        if file is None:
            return
        try:
            if hasattr(readline, "append_history_file"):
                readline.append_history_file(1, file)
            else:  # libedit
                readline.write_history_file(file)
        except OSError as error:
            _tell_unkept(file, error)
            file = None

    readline.set_completer(complete)
    readline.set_completer_delims(_DELIMITERS)
    readline.parse_and_bind("bind ^I rl_complete" if "libedit" in (readline.__doc__ or "") else "tab: complete")
    readline.set_auto_history(False)
    try:
        yield keep
    finally:
        readline.set_completer(None)
        readline.set_auto_history(True)


def _history(read: Callable[[Path], None]) -> Path | None:
    """The file of the history, read, and there; None where it cannot be."""
    try:
        file = history_file()
    except RuntimeError as error:  # no home
        _tell_unkept(Path("~"), error)
        return None
    try:
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC, 0o600))
        read(file)
    except OSError as error:
        _tell_unkept(file, error)
        return None
    return file


def _tell_unkept(file: Path, error: Exception) -> None:
    print(f"note: {file}: the history is not kept ({getattr(error, 'strerror', None) or error})", file=sys.stderr)
