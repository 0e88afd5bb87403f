"""Whether a scan's files are all there and whole, as far as a glance tells: a copy that is under way, or that broke off.

Damage of other kinds is none of this: the reader says what is wrong and what to do.
"""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from schemas.errors import InputError
from schemas.files import open_file
from schemas.parsing import json_value
from tasks.capture.files.documents import MAX_JSON_BYTES, MAX_TEXT_BYTES, name_of
from tasks.capture.files.sens import MAX_SENS_BYTES, open_sens
from tasks.capture.formats import format_of, left_out
from tasks.capture.layout import FrameLayout
from tasks.capture.scan import Scan
from tasks.families import part

_TEMPORARY = re.compile(
    r"\..+\.[A-Za-z0-9]{6}"  # rsync's `.name.XXXXXX`
    r"|.+\.(?=[0-9]*[A-Fa-f])[0-9A-Fa-f]{8}"  # the AWS tools' `name.XXXXXXXX`; eight digits alone are a date
    r"|.+\.(?:part|partial|filepart|tmp|temp|crdownload|download|aria2|gstmp|swp)"
    r"|\.rsync-partial|\.~tmp~"
)

HEADER_BYTES = 65536
"""A header that is longer is none."""

_SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8,
          "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8}  # fmt: skip
_CUT_JSON_LETTERS = 16
"""An error this close to the end of a text is its end: the longest word of JSON, `-Infinity`, and some blanks."""


@dataclasses.dataclass(frozen=True)
class Gap:
    """What a scan lacks: file and reason. `is_readable`: its reader would make do with what is there, so it may be meant so."""

    what: str
    is_readable: bool = False


def is_temporary(path: str) -> bool:
    """Whether a file's name, or that of a folder above it, is one that copying programs use until a file is whole."""
    return any(_TEMPORARY.fullmatch(name) for name in path.split("/"))


def find_gap(scan: Scan) -> Gap | None:
    """What is missing of a scan on this machine, or cut; what its reader cannot do without comes first. None: it looks whole.

    Opens every file, and reads JSON and small texts whole. A file that vanishes meanwhile is a gap.
    """
    try:
        gaps = list(_gaps(scan))
    except FileNotFoundError as error:
        return Gap(f"{Path(str(error.filename)).name}: vanished while it was looked at")
    except (InputError, OSError):  # the reader says so, too, and says it better
        return None
    gap = next((gap for gap in gaps if not gap.is_readable), gaps[0] if gaps else None)
    note = left_out(scan) if gap is not None else ""
    return dataclasses.replace(gap, what=f"{gap.what} ({note})") if gap is not None and note else gap


def _gaps(scan: Scan) -> Iterator[Gap]:
    """Gaps by the module `wholeness` of the scan's format; without one, by what each of its files says of its length."""
    format = format_of(scan)
    own = part("tasks.capture", format.name, "wholeness")
    if own is not None:
        yield from own.gaps(scan)
        return
    for path in format.files(scan, scan.premises):
        yield from file_gaps(path, scan.folder)


def frame_gaps(layout: FrameLayout, folder: Path, stated: bool) -> Iterator[Gap]:
    """Gaps of exported frames. `stated`: the scan's metadata may state the intrinsics."""
    for path in layout.files:
        yield from file_gaps(path, folder)
    for what, files in (("depth", [f.depth for f in layout.frames]), ("pose", [f.pose for f in layout.frames])):
        there = sum(path is not None for path in files)
        if there < len(files) and (there or what == "depth" or layout.trajectory is None):
            yield Gap(f"{folder.name}: {len(files)} color images and {there} of {what}", is_readable=there > 0 or what == "pose")
        for beside in {path.parent for path in files if path is not None} - {layout.folder}:
            ours = {path.suffix for path in files if path is not None}
            count = sum(path.suffix in ours and not path.name.startswith(".") for path in beside.iterdir())
            if count > len(layout.frames):
                yield Gap(f"{folder.name}: {len(layout.frames)} color images and {count} of {what}", is_readable=True)
    if layout.trajectory is not None:
        lines = [line for line in content(layout.trajectory, MAX_TEXT_BYTES).splitlines() if line.strip() and not line.startswith(b"#")]
        if len(lines) < len(layout.frames):
            yield Gap(f"{name_of(layout.trajectory, folder)}: has {len(lines)} lines for {len(layout.frames)} frames", is_readable=True)
    if layout.color_intrinsics is None:
        yield Gap(f"{folder.name}: intrinsics are missing", is_readable=stated)


def file_gaps(path: Path, folder: Path) -> Iterator[Gap]:
    """What a file's own words about its length say."""
    name, size = name_of(path, folder), path.stat().st_size
    if not size:
        yield Gap(f"{name}: is empty")
        return
    check = _CHECKS.get(path.suffix.lower())
    gap = check(path, size) if check is not None else None
    if gap is not None:
        yield dataclasses.replace(gap, what=f"{name}: {gap.what}")


def _ply(path: Path, size: int) -> Gap | None:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        head = file.read(HEADER_BYTES)
        end = head.find(b"end_header")
        start = head.find(b"\n", end) + 1
        if not head.startswith(b"ply"[: len(head)]):
            return None
        if end < 0 or not start:
            return Gap("ends inside its header") if size < HEADER_BYTES else None
        elements = _elements(head[:end].decode("latin-1"))
        if b"format ascii" in head[:end]:
            rows = sum(count for count, _ in elements)
            file.seek(start)
            lines = sum(chunk.count(b"\n") for chunk in iter(lambda: file.read(2**20), b""))
            file.seek(-1, 2)
            whole = file.read(1) == b"\n"
            return Gap(f"declares {rows} rows and has {lines}") if lines + (not whole) < rows else None if whole else _no_line_end()
    needed = start + sum(count * row for count, row in elements)
    return Gap(f"needs {needed} bytes at least and has {size}") if size < needed else None


def _elements(header: str) -> list[tuple[int, int]]:
    """Count and least bytes of a row of every element; a list has three items at least, as faces do."""
    elements: list[tuple[int, int]] = []
    for line in header.splitlines():
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3 and words[2].isascii() and words[2].isdigit() and len(words[2]) < 19:
            elements.append((int(words[2]), 0))
        elif words[:1] == ["property"] and len(words) > (4 if words[1:2] == ["list"] else 2) and elements:
            size = _SIZES.get(words[1], 0) if words[1] != "list" else _SIZES.get(words[2], 0) + 3 * _SIZES.get(words[-2], 0)
            elements[-1] = (elements[-1][0], elements[-1][1] + size)
    return elements


def _json(path: Path, size: int) -> Gap | None:
    try:
        text = content(path, MAX_JSON_BYTES).decode("utf-8-sig")
        json_value(text)
    except UnicodeDecodeError as error:
        return Gap("ends inside a letter") if error.end >= size - 1 and error.reason == "unexpected end of data" else None
    except json.JSONDecodeError as error:
        is_cut = error.pos >= len(text.rstrip()) - _CUT_JSON_LETTERS or error.msg.startswith("Unterminated")
        return Gap("ends before its JSON does") if is_cut else None
    except ValueError:  # deeper or larger than any scan's, a number of thousands of digits: the reader says so
        return None
    return None


def _text(path: Path, size: int) -> Gap | None:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        file.seek(-1, 2)
        return None if file.read(1) in b"\r\n" else _no_line_end()


def _no_line_end() -> Gap:
    return Gap("does not end with a line", is_readable=True)


def _sens(path: Path, size: int) -> Gap | None:
    try:
        open_sens(path, "")
    except InputError as error:
        is_cut = "the file ends" in error.problem or error.field == "frame count"
        return Gap(f"{error.field}: {error.problem}") if is_cut else None
    return None


def _png(path: Path, size: int) -> Gap | None:
    return None if _tail(path, size, 12).endswith(b"IEND\xaeB`\x82") else Gap("is cut")


def _jpeg(path: Path, size: int) -> Gap | None:
    # Some cameras write more behind the end of the image, so that its absence there proves little.
    return None if _tail(path, size, 4096).rstrip(b"\0").endswith(b"\xff\xd9") else Gap("does not end as a JPEG", is_readable=True)


def _netpbm(path: Path, size: int) -> Gap | None:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        head = file.read(4096)
    match = re.match(rb"P([56])(?:\s|#[^\n]*\n)+(\d{1,6})(?:\s|#[^\n]*\n)+(\d{1,6})(?:\s|#[^\n]*\n)+(\d{1,5})\s", head)
    if match is None:
        return Gap("ends inside its header") if size < 32 else None
    kind, width, height, top = (int(value) for value in match.groups())
    needed = match.end() + width * height * (3 if kind == 6 else 1) * (2 if top > 255 else 1)
    return Gap(f"needs {needed} bytes and has {size}") if size < needed else None


def _bmp(path: Path, size: int) -> Gap | None:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        head = file.read(6)
    needed = struct.unpack("<I", head[2:6])[0] if len(head) == 6 else 54
    return Gap(f"needs {needed} bytes and has {size}") if size < needed else None


def _glb_length(path: Path, size: int) -> Gap | None:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        head = file.read(12)
    if not head.startswith(b"glTF"[: len(head)]):
        return None
    needed = struct.unpack("<I", head[8:12])[0] if len(head) == 12 else 12
    return Gap(f"needs {needed} bytes and has {size}") if size < needed else None


def content(path: Path, most_bytes: int) -> bytes:
    """All that a file holds."""
    with open_file(path, path.name, most_bytes) as file:
        return file.read()


def _tail(path: Path, size: int, count: int) -> bytes:
    with open_file(path, path.name, MAX_SENS_BYTES) as file:
        file.seek(max(0, size - count))
        return file.read()


_CHECKS: dict[str, Callable[[Path, int], Gap | None]] = {
    ".ply": _ply, ".json": _json, ".txt": _text, ".log": _text, ".freiburg": _text, ".sens": _sens, ".glb": _glb_length,
    ".png": _png, ".jpg": _jpeg, ".jpeg": _jpeg, ".pgm": _netpbm, ".ppm": _netpbm, ".bmp": _bmp,
}  # fmt: skip
