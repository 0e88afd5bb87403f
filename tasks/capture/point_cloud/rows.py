"""Points in text, a line each: XYZ, PTS, and the rows of PLY and PCD files in text. Read in blocks, so that a large file fits."""

from __future__ import annotations

import dataclasses
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file
from tasks.capture.files.ply_elements import PlyColumn
from tasks.capture.point_cloud.points import Points, check_count, points_of_columns

Table = NDArray[np.float64]

BLOCK_BYTES = 16 * 2**20
"""Text that is parsed at once."""

MAX_BAD_SHARE = 0.01
"""Rows of a sound file that a slip of a program may have damaged; with more, the file is of another kind."""

MAX_COLUMNS = 64
"""Programs write no more values for a point."""

MAX_LINE_BYTES = 65536
"""Rows are shorter."""

_AGAIN = "export the points again"
_DECIMAL_COMMA = re.compile(rb"\s*(-?\d+,\d+[\s;]+){2,}-?\d+,\d+")
_WORDS = re.compile(r"[A-Za-z_][\w.]*")


@dataclasses.dataclass(frozen=True)
class TextTable:
    """Rows of a text. values: shape (n, width). header: names of the columns, empty without a header. stated: rows that count lines
    state, None without any. damaged: rows that were left out. notes: a line each."""

    values: Table
    header: tuple[str, ...] = ()
    stated: int | None = None
    damaged: int = 0
    notes: tuple[str, ...] = ()


def read_point_rows(path: Path, name: str) -> Points:
    """Points of an XYZ or PTS file.

    Raises:
        InputError: it is not a table of numbers, too large, or shorter than its count says.
    """
    try:
        with open_file(path, name, BUDGET.scene_bytes) as file:
            table = read_rows(file, name)
    except OSError as error:
        raise InputError(name, "file", f"cannot be read ({error.strerror or error})", "check its permissions") from error
    rows, width = table.values.shape
    if table.stated is not None and table.stated > rows + table.damaged:
        raise InputError(name, "points", f"are {rows}, the file states {table.stated}", "copy or export the file again")
    if width < 3:
        raise InputError(name, "columns", f"are {width}, a point needs 3", _AGAIN)
    notes = list(table.notes)
    names = _header_names(table.header, width)
    if names is None:
        names = _guessed_names(table.values, path.suffix.lower() == ".pts")
        notes.append(f"{name}: columns are read as {', '.join(names)}, which it does not say")
    kinds = ["u2" if _is_whole_bytes(table.values[:, i]) else "f8" for i in range(width)]
    columns = {word: PlyColumn(table.values[:, i], kinds[i]) for i, word in enumerate(names)}
    return points_of_columns(columns, name, notes)


def read_rows(file: BinaryIO, name: str, width: int = 0, count: int | None = None) -> TextTable:
    """Rows of numbers in the rest of a file.

    width: numbers in a row; 0 takes those of the first row. count: rows to read, None for all.

    Raises:
        InputError: the text is not a table, or it has more rows than the budget.
    """
    tables: list[Table] = []
    header: tuple[str, ...] = ()
    rows = bad = 0
    stated: int | None = None
    has_commas: bool | None = None
    for block in _blocks(file, name):
        lines = block
        if b"#" in lines or b"//" in lines:
            if not rows and not header:
                header = _commented_header(lines)
            lines = re.sub(rb"(?m)(#|//).*$", b"", lines)
        if has_commas is None and lines.strip():
            has_commas = _DECIMAL_COMMA.match(lines.lstrip().split(b"\n", 2)[-1 if b"\n" in lines.lstrip() else 0]) is not None
        lines = lines.replace(b",", b".") if has_commas else lines.replace(b",", b" ")
        lines = lines.replace(b";", b" ").replace(b"\t", b" ")
        if not width:
            width, counted, words, lines = _beginning(lines)
            header = header or words
            stated = counted if counted is not None else stated
            if not width:
                continue
        values, more, wrong = _numbers(lines, width)
        stated = stated if more is None else (stated or 0) + more
        bad += wrong
        rows += len(values)
        check_count(rows, name)
        tables.append(values)
        if count is not None and rows >= count:
            break
    if not rows or bad > max(1, MAX_BAD_SHARE * rows):
        problem = f"has {bad} rows that are not {width or 3} numbers, of {rows + bad}" if rows else "has no rows of numbers"
        raise InputError(name, "content", problem, "is it a file of points? x y z in each line are read")
    notes = (f"{name}: {bad} rows are not {width} numbers: left out",) if bad else ()
    whole = tables[0] if len(tables) == 1 else np.concatenate(tables)
    return TextTable(whole[:count], header, stated, bad, notes)


def _blocks(file: BinaryIO, name: str) -> Iterator[bytes]:
    """Whole lines of a file, some megabytes at a time."""
    rest = b""
    while data := file.read(BLOCK_BYTES):
        if b"\0" in data:
            raise InputError(name, "content", "is not text", "is it the right file?")
        whole, _, more = (rest + data.replace(b"\r", b"\n")).rpartition(b"\n")
        rest = more
        if len(rest) > MAX_LINE_BYTES:
            raise InputError(name, "content", f"has a line of more than {MAX_LINE_BYTES} bytes", "is it the right file?")
        if whole:
            yield whole
    if rest.strip():
        yield rest


def _commented_header(lines: bytes) -> tuple[str, ...]:
    """Names of columns in the comment before the first row, as `//X Y Z R G B`."""
    first = lines.lstrip().split(b"\n", 1)[0]
    if not first.startswith((b"#", b"//")):
        return ()
    words = _WORDS.findall(first.decode("latin-1"))
    return tuple(words) if [word.lower() for word in words[:3]] == ["x", "y", "z"] else ()


def _beginning(lines: bytes) -> tuple[int, int | None, tuple[str, ...], bytes]:
    """Width of the first row, the count and the names of columns before it, and the lines from it on."""
    counted: int | None = None
    names: tuple[str, ...] = ()
    for _ in range(3):
        line, _, rest = lines.lstrip().partition(b"\n")
        words = line.split()
        if not words:
            return 0, counted, names, b""
        if len(words) == 1 and words[0].isdigit() and len(words[0]) < 13:
            counted, lines = int(words[0]), rest
        elif not names and [word.strip(b"\"'").lower() for word in words[:3]] == [b"x", b"y", b"z"]:
            names, lines = tuple(word.strip(b"\"'").decode("latin-1") for word in words), rest
        else:
            return min(len(words), MAX_COLUMNS), counted, names, lines
    return 0, counted, names, lines


def _numbers(lines: bytes, width: int) -> tuple[Table, int | None, int]:
    """Rows of `width` numbers, the sum of counts between them, and how many other rows there are."""
    if not lines.strip():
        return np.zeros((0, width)), None, 0
    try:
        table = np.loadtxt(io.BytesIO(lines), dtype=np.float64, comments=None, ndmin=2)
        if table.shape[1] == width:
            return table, None, 0
    except (ValueError, OverflowError):  # some row differs: each is looked at
        pass
    rows: list[list[float]] = []
    bad, stated = 0, None
    for line in lines.split(b"\n"):
        words = line.split()
        if not words:
            continue
        try:
            if len(words) == width:
                rows.append([float(word) for word in words])
                continue
            if len(words) == 1 and words[0].isdigit() and len(words[0]) < 13:
                stated = (stated or 0) + int(words[0])  # a further part of a PTS file
                continue
        except ValueError:
            pass
        bad += 1
    return np.array(rows, dtype=np.float64).reshape(-1, width), stated, bad


def _header_names(header: tuple[str, ...], width: int) -> tuple[str, ...] | None:
    """Names of the columns by a header, None without one that fits."""
    if len(header) != width or len({word.lower() for word in header}) != width:
        return None
    short = {"r": "red", "g": "green", "b": "blue"}
    return tuple(short.get(word.lower(), word.lower()) for word in header)


def _guessed_names(values: Table, is_pts: bool) -> tuple[str, ...]:
    """Names of columns by their number and values. Programs write positions first, then color or normal or, in PTS, intensity."""
    width = values.shape[1]
    names = ["x", "y", "z", *(f"column {i + 1}" for i in range(3, width))]
    sample = values[np.linspace(0, len(values) - 1, min(len(values), 20_000)).astype(np.int64)]
    starts = [4, 3] if is_pts and width >= 7 else [3, 4] if width == 7 else list(range(3, width - 2, 3))
    for start in starts:
        part = sample[:, start : start + 3]
        if part.shape[1] < 3 or names[start] == "red":
            continue
        if "red" not in names and _is_color(part):
            names[start : start + 3] = ["red", "green", "blue"]
        elif "nx" not in names and _is_normal(part):
            names[start : start + 3] = ["nx", "ny", "nz"]
    if width in (4, 7) and names[3] == "column 4":
        names[3] = "intensity"
    return tuple(names)


def _is_whole_bytes(values: Table) -> bool:
    """True for whole numbers of 0 to 65,535, as colors and classes are."""
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= 65535) & (values == np.floor(values))).all())


def _is_color(part: Table) -> bool:
    """True for whole numbers of a byte, or fractions that are not unit vectors."""
    if not np.isfinite(part).all() or part.min() < 0:
        return False
    if (part == np.floor(part)).all():
        return bool(part.max() <= 255 and part.max() > 1)
    return bool(part.max() <= 1.0) and not _is_normal(part)


def _is_normal(part: Table) -> bool:
    """True if nearly all rows are vectors of length one."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool((np.abs(np.linalg.norm(part, axis=1) - 1.0) < 0.02).mean() > 0.95)
