"""An input of a parser: the files of a small folder, in memory, on disk, and as one line of JSON to keep."""

from __future__ import annotations

import base64
import dataclasses
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Odd:
    """What lies in the place of a file. kind: `link` to the path in `value`, `fifo`, `folder`, or `sparse` of so many bytes."""

    kind: str
    value: str = ""


Case = Mapping[str, "bytes | Odd"]


def read_case(folder: Path) -> dict[str, bytes | Odd]:
    """All files below a folder, by path."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def write_case(case: Case, folder: Path) -> None:
    """The files of a case, below a new folder. What cannot lie there (a file below a file) is left out."""
    folder.mkdir(parents=True)
    for name, content in case.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, bytes):
                path.write_bytes(content)
            else:
                _write_odd(content, path)
        except (FileExistsError, NotADirectoryError, IsADirectoryError):
            continue


def _write_odd(odd: Odd, path: Path) -> None:
    match odd.kind:
        case "link":
            path.symlink_to(odd.value)
        case "fifo":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "sparse":
            with path.open("wb") as file:
                file.truncate(int(odd.value))


def size_of(case: Case) -> int:
    """Bytes of a case as it is kept, about."""
    return sum(len(zlib.compress(content, 1)) if isinstance(content, bytes) else 32 for content in case.values())


def packed(case: Case) -> dict[str, Any]:
    """A case as JSON: text where it is text, else base64 of what zlib made of it."""
    return {name: _packed(content) for name, content in case.items()}


def _packed(content: bytes | Odd) -> Any:
    if isinstance(content, Odd):
        return {"odd": content.kind, "value": content.value}
    try:
        text = content.decode("ascii")
    except UnicodeDecodeError:
        text = "\r"
    if len(text) < 4096 and "\r" not in text:
        return text
    return {"zlib": base64.b64encode(zlib.compress(content, 9)).decode()}


def unpacked(document: Mapping[str, Any]) -> dict[str, bytes | Odd]:
    """The case that `packed` made JSON of."""
    case: dict[str, bytes | Odd] = {}
    for name, content in document.items():
        if isinstance(content, str):
            case[name] = content.encode("ascii")
        elif "odd" in content:
            case[name] = Odd(content["odd"], content["value"])
        else:
            case[name] = zlib.decompress(base64.b64decode(content["zlib"]))
    return case
