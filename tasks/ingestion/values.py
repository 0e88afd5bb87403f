"""JSON of finished datasets, read with a limit on size and without NaN, and the names of their licences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.capture.files.documents import MAX_TEXT_BYTES, name_of, read_bytes

LICENSES = ("LICENSE", "LICENSE.txt", "LICENSE.md")
"""Files whose first line is a dataset's licence."""


def json_document(path: Path | str, root: Path | None, data: bytes | None = None) -> Any:
    """The value that a JSON file holds; of `data` where it was read before.

    Raises:
        InputError: the file is missing, too large, or no JSON; numbers that are not finite are no JSON.
    """
    name = name_of(Path(path), root) if root is not None else str(path)
    if data is None:
        data = read_bytes(Path(path), name, MAX_TEXT_BYTES)
    try:
        return json_value(data, parse_constant=_refuse)
    except ValueError as error:
        raise InputError(name, "content", f"is no JSON ({error})", "copy the dataset again") from error


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is no number")
