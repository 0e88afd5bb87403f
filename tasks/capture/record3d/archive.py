"""Recordings of Record3D as they are shared: a zip archive, whose depth is packed with LZFSE."""

from __future__ import annotations

import re
import sys
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.capture.files.images import MAX_IMAGE_BYTES
from tasks.capture.files.unpacked import step_of
from tasks.confinement import answer, limit

PACKED = b"bvx"
"""First bytes of files that LZFSE has packed."""

FILES = "files"
"""Folder for the unpacked recording, separate from the answer of the child."""

CODE = "from tasks.capture.record3d.archive import main; main()"

MAX_ENTRIES = 1_000_000
"""Files of an archive: three for each of the frames of an hour and a half at 60 a second."""

_OWN = re.compile(r"(?:.*/)?(metadata(?:\.json)?|rgbd/(\d{1,9})\.(jpg|depth|conf))", re.ASCII)
"""Files of a recording; an archive that was zipped again has them below a folder."""


def main() -> None:
    """Write the files of an archive, or the packed ones of a folder, unpacked, below the name that the third argument gives."""
    path, folder, title = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    limit(int(sys.argv[4]), int(sys.argv[5]))
    answer(folder, lambda: unpack(path, folder / FILES / title), "share it again")


def unpack(path: Path, folder: Path) -> dict[str, int]:
    """Write the files of a recording, of a long one only some frames.

    Args:
        path: an archive, or a folder with packed files.
        folder: a new folder for the files.

    Returns:
        Number of color images in an archive as `frames`; every `step`-th is written.

    Raises:
        InputError: it is not a zip archive, has more files than any recording, or unpacks to more than the budget.
    """
    (folder / "rgbd").mkdir(parents=True)
    if path.is_dir():
        _write(_from_folder(path), path.name, folder)
        return {}
    try:
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
        raise InputError(path.name, "content", f"is not a zip archive ({error})"[:200], "share the recording again") from error
    with archive:
        entries = archive.infolist()
        if len(entries) > MAX_ENTRIES:
            raise InputError(path.name, "content", f"has {len(entries)} files (limit {MAX_ENTRIES})", "share a shorter recording")
        matches = (_OWN.fullmatch(entry.filename) for entry in entries)
        numbers = sorted({int(match[2]) for match in matches if match is not None and match[3] == "jpg"})
        step = step_of(len(numbers))
        _write(_from_archive(archive, path.name, frozenset(numbers[::step])), path.name, folder)
    return {"frames": len(numbers), "step": step}


def _write(files: Iterable[tuple[str, bytes]], name: str, folder: Path) -> None:
    """Write files by their names, unpacked. name: the recording, for messages."""
    written = 0
    for target, data in files:
        if data[:3] == PACKED:
            import lzfse

            data = lzfse.decompress(data)
        written += len(data)
        if written > BUDGET.scene_bytes:
            raise InputError(name, "content", f"unpacks to more than {BUDGET.scene_bytes >> 20} MB", "share a shorter recording")
        (folder / target).write_bytes(data)


def _from_archive(archive: zipfile.ZipFile, name: str, numbers: frozenset[int]) -> Iterator[tuple[str, bytes]]:
    """Metadata and the files of frames with some numbers. name: the archive, for messages."""
    for entry in archive.infolist():
        match = _OWN.fullmatch(entry.filename)
        if match is None or (match[2] is not None and int(match[2]) not in numbers):
            continue
        if entry.flag_bits & 1 or entry.file_size > MAX_IMAGE_BYTES:
            raise InputError(name, "content", f"{entry.filename[:80]!r} is encrypted or too large", "share the recording again")
        yield match[1], archive.read(entry)


def _from_folder(path: Path) -> Iterator[tuple[str, bytes]]:
    for file in sorted((path / "rgbd").iterdir()):
        match = _OWN.fullmatch(f"rgbd/{file.name}")
        if match is not None and match[3] != "jpg":
            yield match[1], read_file(file, file.name, MAX_IMAGE_BYTES)
