"""Text and JSON of a scan, read with a limit on size and with errors that name file and field."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value

MAX_TEXT_BYTES, MAX_JSON_BYTES = BUDGET.text_bytes, BUDGET.json_bytes

_AGAIN = "copy the scan again"


def name_of(path: Path, root: Path) -> str:
    """A file as errors and rows name it: the scan's own folder and the path below it, whatever lies above."""
    try:
        return (Path(root.name) / path.relative_to(root)).as_posix()
    except ValueError:
        return path.name


def read_bytes(path: Path, name: str, limit: int, magic: bytes = b"") -> bytes:
    """The content of a file, which begins with `magic`.

    Raises:
        InputError: it is missing, unreadable, no regular file, larger than `limit` bytes, or begins with something else.
    """
    return read_file(path, name, limit, _AGAIN, magic)


def read_text(path: Path, name: str) -> str:
    """The content of a small text file; raises InputError when it is no text."""
    try:
        return read_bytes(path, name, MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(name, "content", f"is no text (byte {error.start})", _AGAIN) from error


def read_json(path: Path, name: str) -> dict[str, Any]:
    """The object that a JSON file holds; raises InputError when it holds no object."""
    data = read_bytes(path, name, MAX_JSON_BYTES)
    try:
        document = json_value(data)
    except ValueError as error:
        raise InputError(name, "content", f"is no JSON ({error})", _AGAIN) from error
    if not isinstance(document, dict):
        raise InputError(name, "content", f"holds {json_kind(document)}, not an object", "is it the right file?")
    return document


def integers(value: Any, name: str, field: str, minimum: int = 0) -> NDArray[np.int64]:
    """A JSON list of integers as an array, shape (n,)."""
    if not isinstance(value, list):
        raise InputError(name, field, f"must be a list of integers, is {json_kind(value)}", "is it the right file?")
    if not value:
        return np.zeros(0, dtype=np.int64)
    if set(map(type, value)) != {int}:  # NumPy would make an array of words of them, each as long as the longest
        value = [_integer(item) for item in value]
    if None in value:
        raise InputError(name, field, "must be a list of integers", "is it the right file?")
    try:
        array = np.array(value, dtype=np.int64)
    except OverflowError as error:
        raise InputError(name, field, "has an integer of more than 64 bits", "is it the right file?") from error
    if array.min() < minimum:
        raise InputError(name, field, f"has {array.min()}, below {minimum}", "is it the right file?")
    return array


def _integer(value: Any) -> int | None:
    """An integer that a file holds as a number, a float or a text; None if it is something else."""
    if isinstance(value, str) and re.fullmatch(r"-?[0-9]{1,19}", value):
        return int(value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if type(value) is int else None


def floats(text: str, name: str, field: str, count: int) -> NDArray[np.float64]:
    """Numbers of a text, separated by blanks or commas, shape (count,); they need not be finite."""
    words = re.split(r"[\s,]+", text.strip())
    if len(words) != count or not words[0]:
        raise InputError(name, field, f"must have {count} numbers, has {len(words) if words[0] else 0}", _AGAIN)
    try:
        return np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(name, field, f"is not a list of numbers: {text.strip()[:40]!r}", _AGAIN) from error


def json_floats(value: Any, name: str, field: str, count: int) -> NDArray[np.float64]:
    """Numbers of a JSON list, or of lists in it, below a million, shape (count,).

    Raises:
        InputError: it holds something else, or another number of them.
    """
    flat = [v for part in value for v in (part if isinstance(part, list) else [part])] if isinstance(value, list) else []
    if len(flat) != count or not all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e6 for v in flat):
        raise InputError(name, field, f"must be {count} numbers", _AGAIN)
    return np.array(flat, dtype=np.float64)


def settings(text: str) -> dict[str, str]:
    """`key = value` lines of a scan's metadata file."""
    pairs = (line.partition("=") for line in text.splitlines())
    return {key.strip(): value.strip() for key, mark, value in pairs if mark and key.strip()}


def plain_text(label: str) -> str:
    """A label of a JSON file in one line of at most 200 letters. A byte that is no UTF-8 cannot come from JSON, a lone surrogate can."""
    return " ".join(label.encode("utf-8", "replace").decode().split())[:200]


def license_of(path: Path | None) -> str | None:
    """First line of a scan's LICENSE.txt, None without one."""
    return None if path is None else first_line(path, path.parent)


def first_line(path: Path, root: Path) -> str | None:
    """First line of a text file, None where it is empty; errors call it by its path below `root`."""
    lines = read_text(path, name_of(path, root)).strip().splitlines()
    return lines[0].strip()[:200] if lines else None


def json_kind(value: Any) -> str:
    """Name of the kind of a JSON value, with its article."""
    if value is None:
        return "null"
    return next(name for kind, name in _KINDS.items() if isinstance(value, kind))


_KINDS = {bool: "a truth value", str: "a text", list: "a list", dict: "an object", object: "a number"}
"""Kinds of JSON values by type; numbers are what is left."""
