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

MAX_TITLE_LINES = 50
"""Lines before the first row: programs write a header, a count and some comments."""

_AGAIN = "export the points again"
_INNER_COMMA = re.compile(rb"\d,[-+.\d]")
_SEVERAL_COMMAS = re.compile(rb"\d,[-+.\deE]+,[-+.\d]|\d,[-+]")
_COMMA_AND_BLANK = re.compile(rb"\d,[ \t]+[-+.\d]")
_OTHER_SEPARATOR = re.compile(rb"[.\d][ \t;]+[-+.\d]")
_DECIMAL_POINT = re.compile(rb"\d\.\d")
_UNITS = re.compile(r"[\[(][^\])]*[\])]")


@dataclasses.dataclass(frozen=True)
class TextTable:
    """Rows of a text.

    values: shape (n, width). titles: lines of words before the first row. comments: comments before it.
    stated: rows that count lines state, None without any. damaged: rows that were left out. notes: a line each.
    """

    values: Table
    titles: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    stated: int | None = None
    damaged: int = 0
    notes: tuple[str, ...] = ()


def read_point_rows(path: Path, name: str) -> Points:
    """Points of an XYZ or PTS file.

    Raises:
        InputError: it is not a table of numbers, too large, shorter than its count says, or its header lacks x, y or z.
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
    names = _header_names(table, name)
    if names is None:
        names = _guessed_names(table.values, path.suffix.lower() == ".pts")
        notes.append(f"{name}: columns are read as {', '.join(names)}, which it does not say")
    kind = "u2" if _has_whole_colors(table.values, names) else "f8"
    columns = {word: PlyColumn(table.values[:, i], kind) for i, word in enumerate(names)}
    return points_of_columns(columns, name, notes)


def read_rows(file: BinaryIO, name: str, width: int = 0, count: int | None = None) -> TextTable:
    """Rows of numbers in the rest of a file.

    width: numbers in a row; 0 takes those of the first row. count: lines to read, None for all.

    Raises:
        InputError: the text is not a table, it has more rows than the budget, or its commas are ambiguous.
    """
    tables: list[Table] = []
    titles: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    rows = bad = 0
    stated: int | None = None
    has_decimal_commas: bool | None = None
    for block in _blocks(file, name):
        lines = block
        if b"#" in lines or b"//" in lines:
            comments += () if rows else _comments(lines)
            lines = re.sub(rb"(?m)(#|//).*$", b"", lines)
        if not width:
            words, counted, lines = _beginning(lines)
            titles += words
            stated = counted if counted is not None else stated
        if has_decimal_commas is None and b"," in lines:
            has_decimal_commas = _has_decimal_commas(lines, name)
        lines = lines.replace(b",", b"." if has_decimal_commas else b" ").replace(b";", b" ").replace(b"\t", b" ")
        width = width or _width(lines)
        if not width:
            continue
        if count is not None:
            lines = _first_lines(lines, count - rows - bad)
        values, more, wrong = _numbers(lines, width)
        stated = stated if more is None else (stated or 0) + more
        bad += wrong
        rows += len(values)
        check_count(rows, name)
        tables.append(values)
        if count is not None and rows + bad >= count:
            break
    if not rows or bad > max(1, MAX_BAD_SHARE * rows):
        problem = f"has {bad} rows that are not {width or 3} numbers, of {rows + bad}" if rows else "has no rows of numbers"
        raise InputError(name, "content", problem, "is it a file of points? x y z in each line are read")
    notes = (f"{name}: {bad} rows are not {width} numbers: left out",) if bad else ()
    whole = tables[0] if len(tables) == 1 else np.concatenate(tables)
    return TextTable(whole, titles, comments, stated, bad, notes)


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


def _comments(lines: bytes) -> tuple[str, ...]:
    """Comments before the first row, as `//X Y Z R G B`."""
    comments = []
    for line in lines.split(b"\n", MAX_TITLE_LINES)[:MAX_TITLE_LINES]:
        if line.lstrip().startswith((b"#", b"//")):
            comments.append(line.decode("latin-1").strip(" \t#/"))
        elif len(line.split()) > 1 and _is_number(_words(line)[0]):
            break
    return tuple(comments)


def _beginning(lines: bytes) -> tuple[tuple[str, ...], int | None, bytes]:
    """Lines of words before the first row, the count between them, and the lines from the first row on."""
    titles: list[str] = []
    counted: int | None = None
    for _ in range(MAX_TITLE_LINES):
        line, _, rest = lines.lstrip().partition(b"\n")
        words = _words(line)
        if len(words) == 1 and words[0].isdigit() and len(words[0]) < 13:
            counted = int(words[0])
        elif words and not any(map(_is_number, words)):
            titles.append(line.decode("latin-1").strip())
        else:
            break
        lines = rest
    return tuple(titles), counted, lines


def _words(line: bytes) -> list[bytes]:
    return [word for word in re.split(rb"[\s,;]+", line) if word]


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _has_decimal_commas(lines: bytes, name: str) -> bool:
    """True if commas are decimals: they stand inside of numbers that blanks, tabs or semicolons separate.

    Raises:
        InputError: commas and other characters may both separate numbers.
    """
    if not _INNER_COMMA.search(lines):
        return False
    # Without decimal points, `1,5, 2,5` may be two numbers or four.
    if not _OTHER_SEPARATOR.search(lines):
        is_ambiguous = bool(_COMMA_AND_BLANK.search(lines) and not _DECIMAL_POINT.search(lines))
    else:
        is_ambiguous = any(pattern.search(lines) for pattern in (_SEVERAL_COMMAS, _COMMA_AND_BLANK, _DECIMAL_POINT))
    if is_ambiguous:
        problem = "has commas that may separate numbers or be decimals"
        raise InputError(name, "content", problem, "export it again, with blanks between numbers and decimal points")
    return _OTHER_SEPARATOR.search(lines) is not None


def _width(lines: bytes) -> int:
    """Numbers in the first row that has only numbers, otherwise words in the first line; 0 without lines."""
    rows = [line.split() for line in lines.split(b"\n", MAX_TITLE_LINES)[:MAX_TITLE_LINES]]
    filled = [words for words in rows if words]
    row = next((words for words in filled if len(words) > 1 and all(map(_is_number, words))), filled[0] if filled else [])
    return min(len(row), MAX_COLUMNS)


def _first_lines(lines: bytes, count: int) -> bytes:
    """The first lines that are not blank: those after them may be of other elements."""
    if lines.count(b"\n") < count:
        return lines
    return b"\n".join([line for line in lines.split(b"\n") if line.strip()][:count])


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


def _header_names(table: TextTable, name: str) -> tuple[str, ...] | None:
    """Names of the columns by a line before the rows, None without such a line.

    Raises:
        InputError: a header does not name x, y and z, or not as many columns as the rows have.
    """
    width = table.values.shape[1]
    for line in (*table.titles, *table.comments):
        names = _named_columns(line, width)
        if names is not None:
            return names
    # Comments may be prose. Those that name the axes elsewhere than in the first columns contradict a guess.
    lists = [re.findall(r"\w+", comment.lower()) for comment in table.comments]
    contradicting = [
        comment
        for comment, words in zip(table.comments, lists, strict=True)
        if {"x", "y", "z"} <= set(words) and words[:3] != ["x", "y", "z"]
    ]
    for line in (*table.titles, *contradicting):
        problem = f"{line[:60]!r} does not name {width} columns with x, y and z"
        raise InputError(name, "header", problem, "write a name for each column, as x y z red green blue")
    return None


def _named_columns(line: str, width: int) -> tuple[str, ...] | None:
    """Names of columns in a line, which may state units in brackets; None for a line that does not name x, y and z."""
    short = {"r": "red", "g": "green", "b": "blue", "rf": "red", "gf": "green", "bf": "blue"}
    plain = _UNITS.sub("", line).strip("%!* ")
    for text in (plain, plain.rpartition(":")[2]):
        for separator in (r"[,;\t]", r"[\s,;]+"):
            words = [word.strip(" \"'").lower() for word in re.split(separator, text)]
            names = [short.get(word, word) for word in words if word]
            if len(names) == width and all(names.count(axis) == 1 for axis in "xyz"):
                return tuple(word if word not in names[:i] else f"column {i + 1}" for i, word in enumerate(names))
    return None


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


def _has_whole_colors(values: Table, names: tuple[str, ...]) -> bool:
    """True for colors that are whole numbers of more than 1 in all channels together: fractions may be whole in one."""
    channels = [names.index(word) for word in ("red", "green", "blue") if word in names]
    colors = values[:, channels]
    with np.errstate(invalid="ignore"):
        return bool(colors.size and (colors == np.floor(colors)).all() and colors.max() > 1)


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
