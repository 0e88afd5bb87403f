"""Batches on a disk that is full: a small file system in memory, mounted for the purpose, in which little room is left."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.kills.death import forked, tells_of_full_disk
from bench.kills.operations import perform, story
from bench.kills.stories import KillBatch, seen, verdict
from schemas.errors import InputError
from schemas.machine.environment import child_environment

DISK_BYTES = 64_000_000


def filled(seed: int, events: int, folder: Path) -> KillBatch:
    """One story after another on a disk that is full again and again, until so many pieces of work failed of it.

    Raises:
        InputError: no file system can be mounted here.
    """
    batch, rng, number = KillBatch("disk", seed), random.Random(f"disk {seed}"), 0
    while batch.full.total() < events and not batch.faults:
        number += 1
        place = folder / str(number)
        with mounted(place / "disk", DISK_BYTES) as disk:
            _tell(batch, rng, disk, place, events)
    return batch


def _tell(batch: KillBatch, rng: random.Random, disk: Path, folder: Path, events: int) -> None:
    """A story on the disk, and on a twin elsewhere."""
    twin, log, ballast = folder / "twin", folder / "told", disk / "ballast"
    twin.mkdir(exist_ok=True)
    for number, operation in enumerate(story(rng, rng.randint(10, 16)), 1):
        batch.operations += 1
        name = f"{number} {operation.name} {operation.what}"
        before = _look(disk, log)
        if not operation.is_harmless and batch.full.total() < events and rng.random() < 0.8:
            _fill(disk, ballast, rng.randrange(0, 400_000))
            end = forked(lambda operation=operation: perform(operation, disk), log)  # type: ignore[misc]
            if end.error:
                batch.full[operation.name] += 1
                if not tells_of_full_disk(end.error):
                    batch.faults.append(f"{name}: a full disk is told as {end.error}")
            elif not end.is_done:
                batch.faults.append(f"{name}: {'hung' if end.hung else 'died'}")
            between = _look(disk, log)
            ballast.unlink(missing_ok=True)
        else:
            between = before
        for where in (disk, twin):
            end = forked(lambda operation=operation, where=where: perform(operation, where), log)  # type: ignore[misc]
            if not end.is_done:
                batch.faults.append(f"{name}: with room again: {end.error or 'died'}")
        if between not in (before, _look(disk, log)):
            batch.faults.append(f"{name}: while the disk was full readers saw neither what was nor what will be: {between}")
        if batch.faults:
            return
    batch.faults += verdict(disk / "lake", twin / "lake", log)


def _look(place: Path, log: Path) -> Any:
    end = forked(lambda: seen(place / "lake"), log)
    return end.value if end.is_done else end.error


def _fill(disk: Path, ballast: Path, left: int) -> None:
    """Leave so much room [B]."""
    status = os.statvfs(disk)
    size = max(0, status.f_bavail * status.f_frsize - left)
    with contextlib.suppress(OSError), ballast.open("wb") as file:
        file.write(b"\0" * size)


@contextlib.contextmanager
def mounted(place: Path, size: int) -> Iterator[Path]:
    """A file system of `size` bytes in memory at a folder, for as long as this lasts.

    Raises:
        InputError: it cannot be mounted: not everybody may, and not everywhere.
    """
    place.mkdir(parents=True, exist_ok=True)
    mount = shutil.which("mount")
    command = [mount or "mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    done = subprocess.run(command, env=child_environment(), capture_output=True, text=True, check=False) if mount else None
    if done is None or done.returncode:
        why = " ".join((done.stderr if done else "there is no mount").split())
        raise InputError(str(place), "", f"no small file system can be mounted ({why})", "run it as root, or leave out the kind `disk`")
    try:
        yield place
    finally:
        _unmount(place)


def let_go(folder: Path) -> None:
    """Unmount the disks that a batch left which was killed itself."""
    for place in folder.glob("*/disk"):
        if place.is_mount():
            _unmount(place)


def _unmount(place: Path) -> None:
    subprocess.run(["umount", "-l", str(place)], env=child_environment(), capture_output=True, check=False)
