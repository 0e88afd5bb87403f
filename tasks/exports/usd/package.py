"""A USD scene as one file: a `.usdz` package, whose bytes are a function of its files."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file, read_file
from tasks.exports.findings import Finding

ALIGNMENT = 64
"""Every file in a package begins at a multiple of this [B], so that it can be mapped into memory (usdz specification)."""

LAYERS = (".usd", ".usda", ".usdc")
CONTENTS = (*LAYERS, ".png", ".jpg", ".jpeg", ".exr", ".avif", ".m4a", ".mp3", ".wav")
"""What a package may hold."""

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time that zip can say: of no machine's clock
_HEADER = 30  # bytes of a local file header before its name


def package(files: Mapping[str, bytes], root: str) -> bytes:
    """A `.usdz` of files by path, with the layer `root` first and the others in the order of their paths.

    The files are kept as they are, and the relative paths between them hold inside the package. USD's own writer states
    when each file was last changed; here equal files make equal bytes.

    Raises:
        ValueError: `root` is not among the files or no layer, or a file may not be in a package.
    """
    if root not in files or PurePosixPath(root).suffix.lower() not in LAYERS:
        raise ValueError(f"{root}: is not among the files, or is no layer")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in [root, *sorted(set(files) - {root})]:
            if PurePosixPath(name).suffix.lower() not in CONTENTS:
                raise ValueError(f"{name}: may not be in a package")
            info = zipfile.ZipInfo(name, _EPOCH)
            info.external_attr = 0o644 << 16
            info.create_system = 3  # the same on every system
            gap = -(buffer.tell() + _HEADER + len(name.encode()) + 4) % ALIGNMENT
            info.extra = (0x1986).to_bytes(2, "little") + gap.to_bytes(2, "little") + bytes(gap)
            archive.writestr(info, files[name])
    return buffer.getvalue()


def names_in(path: Path) -> tuple[str, ...]:
    """Paths of the files in a package, in their order; nothing when it is none."""
    try:
        with open_file(path, path.name, BUDGET.scene_bytes) as file, zipfile.ZipFile(file) as archive:
            return tuple(archive.namelist())
    except (OSError, InputError, zipfile.BadZipFile):
        return ()


def check_package(path: Path) -> Iterator[Finding]:
    """What is wrong with a `.usdz` as a package; nothing for other files."""
    if path.suffix.lower() != ".usdz":
        return
    try:
        data = read_file(path, path.name, BUDGET.scene_bytes)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
    except (InputError, zipfile.BadZipFile, NotImplementedError) as error:
        yield Finding("package", path.name, f"is no zip archive that can be read: {' '.join(str(error).split())[:200]}")
        return
    if not entries or PurePosixPath(entries[0].filename).suffix.lower() not in LAYERS:
        yield Finding("package", path.name, f"its first file is {entries[0].filename if entries else 'missing'}, not a layer")
    for entry in entries:
        name = entry.filename
        if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1:
            yield Finding("package", name, "is compressed or encrypted")
        if name.startswith("/") or ".." in PurePosixPath(name).parts or "\\" in name:
            yield Finding("package", name, "lies outside the package")
        head = data[entry.header_offset : entry.header_offset + _HEADER]
        start = entry.header_offset + _HEADER + int.from_bytes(head[26:28], "little") + int.from_bytes(head[28:30], "little")
        if start % ALIGNMENT:
            yield Finding("package", name, f"begins at byte {start}, not at a multiple of {ALIGNMENT}")
        if not name.endswith("/") and PurePosixPath(name).suffix.lower() not in CONTENTS:
            yield Finding("package", name, "is of a kind that readers need not know", False)
