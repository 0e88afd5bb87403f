"""Files of an export, and what a gate found in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from tasks.exports.findings import Finding


@dataclasses.dataclass(frozen=True)
class File:
    """A file of an export: its path from the format's root, forward slashes; its contents; its role."""

    path: str
    data: bytes
    role: str


@dataclasses.dataclass(frozen=True)
class Export:
    """A scene in one format: its files, the rules that were held against them, what they found, and what was left out."""

    files: Sequence[File]
    rules: Iterable[str]
    findings: Sequence[Finding]
    missed: Sequence[str] = ()


def write_folder(root: Path, files: Mapping[str, bytes]) -> None:
    """Write files by path, below `root`."""
    for path, data in files.items():
        target = root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)


def files_below(root: Path, role_of: Callable[[str], str]) -> list[File]:
    """Every file below a folder, by path; `role_of` says the role of a path."""
    paths = {path.relative_to(root).as_posix(): path for path in root.rglob("*") if path.is_file()}
    return [File(name, paths[name].read_bytes(), role_of(name)) for name in sorted(paths)]
