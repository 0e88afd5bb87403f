"""Files and folders that settings name, told by what lies there."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from schemas.errors import InputError
from schemas.files import open_file
from tasks.weights import MOST_BYTES


def content_of(path: Path, field: str) -> str:
    """Hash of a file, or of names and content of the files of a folder (not of folders in it): 64 hex digits.

    `field` is the setting that names it.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    try:
        if not path.is_dir():
            return _hash(path)
        hashes = hashlib.sha256()
        for file in sorted(each for each in path.iterdir() if each.is_file()):
            hashes.update(f"{file.name}\0{_hash(file)}\n".encode())
        return hashes.hexdigest()
    except OSError as error:
        raise InputError("training.system", field, f"{path} cannot be read ({error.strerror})", "name what is there") from error


def contents_of(paths: Mapping[str, str]) -> list[str]:
    """What lies at each of some paths, by field: `<field>=<hash>` each, sorted."""
    return [f"{field}={content_of(Path(path), field)}" for field, path in sorted(paths.items()) if path]


def _hash(file: Path) -> str:
    with open_file(file, file.name, MOST_BYTES) as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()
