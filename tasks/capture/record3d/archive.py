"""Recordings of Record3D as they are shared: a zip archive, whose depth is packed with LZFSE."""

from __future__ import annotations

import re
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.capture.files.images import MAX_IMAGE_BYTES
from tasks.confinement import answer, limit

PACKED = b"bvx"
"""How whatever LZFSE has packed begins."""

CODE = "from tasks.capture.record3d.archive import main; main()"

MAX_ENTRIES = 1_000_000
"""Files of an archive: three for each of the frames of an hour and a half at 60 a second."""

_OWN = re.compile(r"(?:.*/)?(metadata(?:\.json)?|rgbd/(\d{1,9})\.(jpg|depth|conf))", re.ASCII)
"""Files of a recording; an archive that was zipped again has them below a folder."""


def main() -> None:
    """Write the files of an archive, or the packed ones of a folder, unpacked; of frames every so many."""
    path, folder, step = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    limit(int(sys.argv[4]), int(sys.argv[5]))
    try:
        answer(folder, {"files": _unpack(path, folder / "recording", step)})
    except InputError as error:
        answer(folder, {"refused": [error.field, error.problem, error.remedy]})
    except MemoryError:
        raise
    except Exception as error:  # the decoder raises whatever the bytes lead it to
        answer(folder, {"refused": ["content", f"cannot be unpacked ({type(error).__name__}: {error})"[:200], "share it again"]})


def frames_in(path: Path, name: str) -> int:
    """Number of color images in an archive.

    Raises:
        InputError: it is not a zip archive, or has more files than any recording.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
        raise InputError(name, "content", f"is not a zip archive ({error})"[:200], "share the recording again") from error
    if len(names) > MAX_ENTRIES:
        raise InputError(name, "content", f"has {len(names)} files (limit {MAX_ENTRIES})", "share a shorter recording")
    return sum((match := _OWN.fullmatch(name)) is not None and match[3] == "jpg" for name in names)


def _unpack(path: Path, folder: Path, step: int) -> int:
    """Number of files written."""
    (folder / "rgbd").mkdir(parents=True)
    written, count = 0, 0
    for name, data in _from_folder(path, step) if path.is_dir() else _from_archive(path, step):
        if data[:3] == PACKED:
            import lzfse

            data = lzfse.decompress(data)
        written += len(data)
        if written > BUDGET.scene_bytes:
            raise InputError(path.name, "content", f"unpacks to more than {BUDGET.scene_bytes >> 20} MB", "share a shorter recording")
        (folder / name).write_bytes(data)
        count += 1
    return count


def _from_archive(path: Path, step: int) -> Iterator[tuple[str, bytes]]:
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            match = _OWN.fullmatch(entry.filename)
            if match is None or (match[2] is not None and int(match[2]) % step):
                continue
            if entry.flag_bits & 1 or entry.file_size > MAX_IMAGE_BYTES:
                raise InputError(path.name, "content", f"{entry.filename[:80]!r} is encrypted or too large", "share the recording again")
            yield match[1], archive.read(entry)


def _from_folder(path: Path, step: int) -> Iterator[tuple[str, bytes]]:
    for file in sorted((path / "rgbd").iterdir()):
        match = _OWN.fullmatch(f"rgbd/{file.name}")
        if match is not None and match[3] != "jpg" and int(match[2]) % step == 0:
            yield match[1], read_file(file, file.name, MAX_IMAGE_BYTES)
