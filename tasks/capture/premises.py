"""Which links of a scan are followed: those that stay in the folder of scans, or lead into a store that somebody named."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

from schemas.errors import InputError
from schemas.files import stays_in

REMEDY = "copy the files in, or allow their folder with --links-into"


@dataclasses.dataclass
class Premises:
    """Folders, links followed, that the files of a scan may lie in; and the links to elsewhere that were met on the way.

    A listing of a store of objects has no links: there every file is admitted.
    """

    folders: tuple[Path, ...]
    left_out: set[Path] = dataclasses.field(default_factory=set)

    def admits(self, path: Path) -> bool:
        """Whether a file or folder is no link, or one that stays; one that leaves is remembered."""
        if not path.is_symlink() or stays_in(path, *self.folders):
            return True
        self.left_out.add(path)
        return False

    def note(self, folder: Path) -> str:
        """What was left out, in a line; '' when nothing was. `folder`: the scan's."""
        names = sorted(place_of(path, folder) for path in self.left_out)
        if not names:
            return ""
        listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        return f"{listed}: {'links that lead' if len(names) > 1 else 'a link that leads'} out of the folder of scans, left out"


def place_of(path: Path, folder: Path) -> str:
    """A scan's file by its path below the scan's folder; one that scans share, in the folder above, by its name."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


def stores(folders: Iterable[str | Path]) -> tuple[Path, ...]:
    """Folders that links may lead into, as people name them, links followed.

    Raises:
        InputError: one is no folder.
    """
    roots = []
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise InputError("--links-into", str(folder), "is no folder", "name the folder that links of scans may lead into")
        roots.append(folder.resolve())
    return tuple(roots)
