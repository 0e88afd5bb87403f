"""Headers of PLY files."""

from __future__ import annotations

import dataclasses

from schemas.budget import BUDGET
from schemas.errors import InputError

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip

_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

AGAIN = "copy or export the mesh again"


@dataclasses.dataclass(frozen=True)
class PlyElement:
    """An element of the header: its fields as (name, dtype), a list field as (name, count dtype, item dtype)."""

    name: str
    count: int
    fields: tuple[tuple[str, ...], ...]


def check_counts(data: bytes, name: str) -> None:
    """Raise InputError when a PLY declares more of anything than the budget has, or its header cannot be read."""
    for element in header(data, name)[1]:
        most = BUDGET.faces if element.name == "face" else BUDGET.vertices
        if element.count > most:
            raise InputError(name, f"element {element.name}", f"declares {element.count}, more than {most}", "decimate the mesh")


def header(data: bytes, name: str) -> tuple[str, list[PlyElement], int]:
    """Byte order ('' for text), elements, and where the content begins."""
    end = data.find(b"end_header", 0, 65536)
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise InputError(name, "header", "is no PLY, or cut inside its header", AGAIN)
    order: str | None = None
    elements: list[PlyElement] = []
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) >= 2 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit() and len(words[2]) < 19:
            elements.append(PlyElement(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and (field := _property(words)) is not None:
            elements[-1] = dataclasses.replace(elements[-1], fields=(*elements[-1].fields, field))
        else:
            raise InputError(name, "header", f"line {line.strip()[:60]!r} is not understood", AGAIN)
    if order is None:
        raise InputError(name, "header", "states no known format", AGAIN)
    return order, elements, newline + 1


def _property(words: list[str]) -> tuple[str, ...] | None:
    if len(words) == 3 and words[1] in _TYPES:
        return (words[2], _TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        return (words[4], _TYPES[words[2]], _TYPES[words[3]])
    return None
