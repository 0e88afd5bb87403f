"""The one place through which the command line speaks: nothing that it prints commands the terminal or holds a credential.

A reader that goes away (`| head`) ends the command quietly; a standard output that cannot be written is named.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO, NoReturn, TextIO, cast

from schemas.errors import LakeError
from schemas.text import escaped, shown

READER_GONE = 141
"""Exit code of a command whose reader went away: what a shell says of any that SIGPIPE ends."""


class Terminal(io.TextIOBase):
    """A text stream on which everything is `schemas.text.shown`. It hides the stream's own bytes; `output` gives them."""

    def __init__(self, stream: TextIO, is_answer: bool) -> None:
        self.stream, self._is_answer = stream, is_answer
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not fit the terminal's encoding

    def write(self, text: str) -> int:
        """Write text as it may be shown."""
        if not isinstance(text, str):  # click asks whether a stream takes bytes by writing none
            raise TypeError("text is written here")
        if text:
            with _unwritable(self._is_answer):
                self.stream.write(shown(text))
        return len(text)

    def flush(self) -> None:
        """Pass on what is held back."""
        with _unwritable(self._is_answer):
            self.stream.flush()

    def isatty(self) -> bool:
        """Whether a person looks at it."""
        return self.stream.isatty()

    def fileno(self) -> int:
        """Its descriptor."""
        return self.stream.fileno()

    def writable(self) -> bool:
        """Yes."""
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """That of the stream."""
        return self.stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """That of the stream."""
        return self.stream.errors


class _Bytes:
    """Standard output for bytes, with the same words when it cannot be written. A terminal gets text `escaped`."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._is_looked_at = stream, stream.isatty()

    def write(self, data: Any) -> int:
        if self._is_looked_at:
            data = escaped(bytes(data).decode()).encode()
        with _unwritable(True):
            return self._stream.write(data)

    def flush(self) -> None:
        with _unwritable(True):
            self._stream.flush()


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Standard output and standard error as a `Terminal` each, for as long as this lasts."""
    _fill_descriptors()
    before = sys.stdin, sys.stdout, sys.stderr
    sys.stdin = before[0] or open(0, closefd=False)  # noqa: SIM115
    sys.stdout = cast(TextIO, Terminal(before[1] or open(1, "w", closefd=False), is_answer=True))  # noqa: SIM115
    sys.stderr = cast(TextIO, Terminal(before[2] or open(2, "w", closefd=False), is_answer=False))  # noqa: SIM115
    try:
        yield
    finally:
        sys.stdin, sys.stdout, sys.stderr = before


def output() -> BinaryIO:
    """Standard output for bytes: whole lines of text, which a terminal gets `escaped` and files and pipes as they are, or
    what no terminal is given."""
    stream = sys.stdout
    return cast(BinaryIO, _Bytes(stream.stream.buffer)) if isinstance(stream, Terminal) else stream.buffer


def drawn(stream: TextIO) -> TextIO:
    """The stream itself, for what draws (bars, colored tables). Who writes there has made the text fit to be shown."""
    return stream.stream if isinstance(stream, Terminal) else stream


def _fill_descriptors() -> None:
    """Where the caller closed 0, 1 or 2, the next file that is opened would take its number, and get what others print."""
    for number, how in ((0, os.O_RDWR), (1, os.O_RDONLY), (2, os.O_RDWR)):  # writing to 1 fails as it should: answers are lost
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, how)


@contextlib.contextmanager
def _unwritable(is_answer: bool) -> Iterator[None]:
    """What cannot be written: nobody is left to be told of messages; of answers the caller is."""
    try:
        yield
    except OSError as error:
        if is_answer:
            _end(error)


def _end(error: OSError) -> NoReturn:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # what is held back is flushed once more when the process ends
    os.close(nowhere)
    if isinstance(error, BrokenPipeError):
        sys.exit(READER_GONE)
    raise LakeError(f"standard output: cannot be written ({error.strerror}); what was to be printed is lost") from error
