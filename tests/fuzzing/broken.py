"""Readers that are wrong in every way that is looked for, so that a test can tell that each is found."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path

from schemas.errors import InputError, LakeError
from tests.fuzzing.doors import Target

SOUND = b'{"a": 1}'


def targets() -> dict[str, Target]:
    """A reader for each fault, and one without any. All read sound inputs, and fail on every other."""
    readers = [_raises, _spins, _waits, _fills, _hides, _dies, _leaves, _says_lines, _says_what_cannot_be_printed, _refuses]
    return {name: _target(name, read) for read in readers for name in [read.__name__.strip("_")]}


def _target(name: str, read: Callable[[Path], object]) -> Target:
    def only_changed(folder: Path) -> None:
        file = folder / "a.json"
        if not file.is_file() or file.read_bytes() != SOUND:
            read(folder)

    return Target(name, 10, lambda: [{"a.json": SOUND}], only_changed)


def _raises(folder: Path) -> None:
    raise KeyError("a")


def _spins(folder: Path) -> None:
    while True:
        pass


def _waits(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    (folder / "pipe").read_bytes()


def _fills(folder: Path) -> None:
    held = bytearray(150 << 20)
    held[:: 1 << 12] = b"\1" * (len(held) >> 12)


def _hides(folder: Path) -> None:
    try:
        bytearray(1 << 40)
    except MemoryError as error:
        raise InputError("a.json", "content", "cannot be read") from error


def _dies(folder: Path) -> None:
    ctypes.string_at(0)


def _leaves(folder: Path) -> None:
    raise SystemExit(0)


class _Unread(LakeError):
    """A refusal that does not look at what it says."""

    def __str__(self) -> str:
        return self.text

    def __init__(self, text: str) -> None:
        self.text = text
        super().__init__()


def _says_lines(folder: Path) -> None:
    raise _Unread("a.json: is\nwrong")


def _says_what_cannot_be_printed(folder: Path) -> None:
    raise _Unread("a.json: is \udc80")


def _refuses(folder: Path) -> None:
    raise InputError("a.json", "content", "is wrong")
