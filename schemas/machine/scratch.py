"""Temporary folders that carry their owner's name, so that folders of killed processes are found and removed.

A name is `metascenes-<host>-<boot>-<pid>-<start>-<letters>`. Of another start of the same host every owner is dead;
of another host or process namespace none is known to be.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from schemas.machine.processes import boot_name, host_name, short_hash, start_of

UNKNOWN_START = "0"
"""Start of a process that the system does not tell."""

_NAME = re.compile(r"metascenes-([0-9a-f]{8})-([0-9a-f]{8})-([0-9]{1,10})-([0-9a-f]{1,20})-\w+")


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder for this user alone, removed at the end with all its contents.

    The first one of a process removes those that killed processes left.
    """
    _sweep_once(os.getpid())
    with tempfile.TemporaryDirectory(prefix=f"{_owner()}-", ignore_cleanup_errors=True) as name:
        yield Path(name)


def temporary_folders() -> list[Path]:
    """All temporary folders of the project that belong to this user, sorted, their owners alive or dead."""
    try:
        root = Path(tempfile.gettempdir())
        names = os.listdir(root)
    except OSError:  # commands that need no temporary folder go without one
        return []
    return sorted(root / name for name in names if _NAME.fullmatch(name) and _is_own_folder(root / name))


def abandoned_folders() -> list[Path]:
    """Temporary folders whose owner is dead, sorted."""
    return [path for path in temporary_folders() if _is_abandoned(path.name)]


def sweep_temporary_folders() -> list[Path]:
    """Remove the temporary folders whose owner is dead; returns those that are gone."""
    folders = abandoned_folders()
    for folder in folders:
        _open_for_removal(folder)
        shutil.rmtree(folder, ignore_errors=True)
    return [folder for folder in folders if not folder.exists()]


def _open_for_removal(folder: Path) -> None:
    """Permit the removal of folders that a program left without permissions; links are not followed."""
    with contextlib.suppress(OSError):
        folder.chmod(0o700)
    for place, names, _ in os.walk(folder):
        for path in (Path(place, name) for name in names):
            if not path.is_symlink():
                with contextlib.suppress(OSError):
                    path.chmod(0o700)


@functools.cache
def _sweep_once(pid: int) -> None:
    """Sweep at the first call in process `pid`."""
    sweep_temporary_folders()


def _owner() -> str:
    """Beginning of the names of this process's folders."""
    pid = os.getpid()
    return f"metascenes-{host_name()}-{short_hash(boot_name())}-{pid}-{start_of(pid) or UNKNOWN_START}"


def _is_abandoned(name: str) -> bool:
    """True if the owner in a folder's name is known to be dead."""
    parts = _NAME.fullmatch(name)
    if parts is None or parts[1] != host_name():
        return False
    if parts[2] != short_hash(boot_name()):
        return True
    return parts[4] != UNKNOWN_START and start_of(int(parts[3])) != parts[4]


def _is_own_folder(path: Path) -> bool:
    """True if a path is a folder of this user, and not a link."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid()
