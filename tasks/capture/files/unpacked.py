"""Packed files of recordings: videos, archives and LZFSE, unpacked once for a process by a child with limits."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import check_file
from schemas.machine.scratch import temporary_folder
from tasks.confinement import Limits, run_child

MAX_FRAMES = 1_000
"""Frames that are unpacked: capture looks at 60, and a walk through a room at 60 frames a second repeats itself."""

MAX_HELD = 2
"""Recordings that a process holds unpacked: its own, and the one before."""

FRAMES_PER_SECOND = 15
"""Frames that a child decodes and writes in a second of computing time, at least."""

EXTRA = 'pip install "metascenes[video]"'


@dataclasses.dataclass(frozen=True)
class Unpacked:
    """Files of a recording. folder: for this process alone, removed at its end. facts: of the child."""

    folder: Path
    facts: Mapping[str, Any]


_held: OrderedDict[tuple[object, ...], tuple[contextlib.ExitStack, Unpacked]] = OrderedDict()


def is_installed(package: str) -> bool:
    """True if a package of the extra `video` can be imported."""
    return importlib.util.find_spec(package) is not None


def unpacked(code: str, path: Path, name: str, arguments: Sequence[str], frames: int) -> Unpacked:
    """Files that a child unpacks from a recording; the same files again for the same arguments.

    Args:
        code: Python that the child runs, as for `run_child`; its arguments are the path, its folder and `arguments`.
        path: a file, or a folder of files that are packed one by one.
        name: the file, for messages.
        arguments: further words for the child.
        frames: frames that the child decodes.

    Raises:
        InputError: the file is larger than the budget, refused, or takes more than a child may.
    """
    if path.is_file():
        check_file(path, name, BUDGET.scene_bytes)
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    states = tuple((str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files)
    key = (code, str(path.resolve()), states, *arguments)
    if key in _held:
        _held.move_to_end(key)
        return _held[key][1]
    size = max((state[1] for state in states), default=0)
    limits = Limits.of_file(min(size, BUDGET.asset_bytes))
    limits = dataclasses.replace(limits, seconds=limits.seconds + frames // FRAMES_PER_SECOND)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        facts = run_child(code, [str(path.absolute()), str(folder), *arguments], folder, limits, name)
        recording = Unpacked(folder, facts)
        while len(_held) >= MAX_HELD:
            _held.popitem(last=False)[1][0].close()
        _held[key] = (stack.pop_all(), recording)
    return recording


def step_of(count: int) -> int:
    """Distance of the frames that are unpacked of so many: 1 for all."""
    return max(1, -(-count // MAX_FRAMES))


def thinned(name: str, step: int, count: int) -> list[str]:
    """A note on frames that are left out, none if all are used."""
    return [f"{name}: 1 of every {step} frames is used, of {count} in all"] if step > 1 else []


def missing(name: str, package: str, field: str, other: str) -> InputError:
    """The error of a packed file whose decoder is not installed. other: a way without it."""
    return InputError(name, field, f"is decoded by {package}, which is not installed", f"{EXTRA}, or {other}")
