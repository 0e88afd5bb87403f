"""Local folders in which large files are made before they are put in their place."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from warehouse.sharing.writer import new_token, writer_of

# Who makes a file on another machine cannot be asked, and takes hours, not days.
_DAY = 86_400.0


@contextlib.contextmanager
def workplace(root: Path) -> Iterator[Path]:
    """A new folder below `root`, removed at the end with all that is in it; so are those of processes that died."""
    sweep_workplaces(root)
    folder = root / new_token()
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sweep_workplaces(root: Path) -> None:
    """Remove the folders below `root` that dead processes left; those of other machines after a day."""
    with contextlib.suppress(FileNotFoundError):
        for place in root.iterdir():
            writer = writer_of(place.name)
            if writer is None or not place.is_dir():
                continue
            with contextlib.suppress(FileNotFoundError):  # another sweep was faster
                if not writer.is_alive if writer.is_here else time.time() - place.stat().st_mtime > _DAY:
                    shutil.rmtree(place, ignore_errors=True)
