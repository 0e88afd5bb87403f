"""Files that other files name as another machine has them: with its separators, drives, folders and letter case."""

from __future__ import annotations

import ntpath
from collections.abc import Iterator, Sequence
from pathlib import Path

from schemas.files import is_there, stays_in


class Folders:
    """Files below the folder `root`, looked up by names that other machines wrote."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._listings: dict[Path, dict[str, list[Path]]] = {}

    def leads_out(self, name: str, folder: Path) -> bool:
        """True if a name, read on this machine, leads out of the root."""
        return "\0" in name or not stays_in(folder / name, self._root)

    def find(self, names: Sequence[str], folder: Path, home: Path) -> Path | None:
        """The file that one of several readings of a name means; None without one.

        folder: Of the file that names it. home: Folder of the mesh, in and right below which its last part is looked for.
        """
        for name in names:
            if not name or "\0" in name:
                continue
            plain = name.strip("\"' ").replace("\\", "/")
            parts = [part for part in ntpath.splitdrive(plain)[1].split("/") if part not in ("", ".")]
            if not parts:
                continue
            for candidate in (folder / name, folder / plain):
                if is_there(candidate) and self._is_file(candidate):
                    return candidate
            for candidates in self._guesses(parts, folder, home):
                files = [path for path in candidates if self._is_file(path)]
                if len(files) == 1:
                    return files[0]
        return None

    def _guesses(self, parts: list[str], folder: Path, home: Path) -> Iterator[list[Path]]:
        """Places of a file, the most likely first: its path in other letter case, next to who names it, one folder below."""
        paths = [folder]
        for part in parts:
            paths = [path for above in paths for path in self._named(above, part)][:8]
        yield paths
        for place in dict.fromkeys((folder, home)):
            yield self._named(place, parts[-1])
        yield [path for below in self._below(home) for path in self._named(below, parts[-1])]

    def _named(self, folder: Path, name: str) -> list[Path]:
        if name == "..":
            return [folder / name] if stays_in(folder / name, self._root) else []
        listing = self._listing(folder)
        exact = [path for path in listing.get(name.lower(), ()) if path.name == name]
        return exact or listing.get(name.lower(), [])

    def _below(self, folder: Path) -> list[Path]:
        return sorted(path for paths in self._listing(folder).values() for path in paths if path.is_dir() and not path.is_symlink())

    def _listing(self, folder: Path) -> dict[str, list[Path]]:
        if folder not in self._listings:
            listing: dict[str, list[Path]] = {}
            try:
                for path in sorted(folder.iterdir()) if stays_in(folder, self._root) else ():
                    listing.setdefault(path.name.lower(), []).append(path)
            except OSError:
                pass
            self._listings[folder] = listing
        return self._listings[folder]

    def _is_file(self, path: Path) -> bool:
        try:
            return path.is_file() and stays_in(path, self._root)
        except OSError:
            return False
