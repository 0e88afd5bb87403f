"""Weights as safetensors, read and written without torch: a table of names, types, shapes and places as JSON, then the numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError

MOST_HEADER_BYTES = 16 * 2**20
"""Of the table; the largest networks need less than a tenth."""

TYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "|i1", "U8": "|u1", "BOOL": "|b1"}
REMEDY = "export the weights again, or take a file that safetensors wrote"


def written(arrays: Mapping[str, NDArray], *, half: bool = False) -> bytes:
    """A safetensors file, whose bytes follow from names and numbers alone. `half`: floating numbers at half precision."""
    table: dict[str, object] = {}
    parts, place = [], 0
    for name in sorted(arrays):
        values = np.asarray(arrays[name])
        if half and values.dtype.kind == "f":
            values = np.clip(values, -65504.0, 65504.0).astype("<f2")
        kind = next((kind for kind, code in TYPES.items() if np.dtype(code) == values.dtype), None)
        if kind is None:
            raise InputError("weights", name, f"has numbers of type {values.dtype}", f"use one of {', '.join(TYPES)}")
        data = values.astype(TYPES[kind]).tobytes()
        table[name] = {"dtype": kind, "shape": list(values.shape), "data_offsets": [place, place + len(data)]}
        parts.append(data)
        place += len(data)
    header = json.dumps(table, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + b"".join(parts)


def read(data: bytes, file: str = "weights") -> dict[str, NDArray]:
    """Arrays of a safetensors file, by name.

    Raises:
        InputError: it is none, a place lies outside of it, or a shape does not fit its bytes.
    """
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or not 2 <= length <= min(MOST_HEADER_BYTES, len(data) - 8):
        raise InputError(file, "header", "is not that of a safetensors file", REMEDY)
    try:
        table = json.loads(data[8 : 8 + length])
    except (ValueError, RecursionError) as error:
        raise InputError(file, "header", "is no JSON", REMEDY) from error
    if not isinstance(table, dict):
        raise InputError(file, "header", "is no table", REMEDY)
    body = memoryview(data)[8 + length :]
    return {str(name): _array(file, str(name), entry, body) for name, entry in table.items() if name != "__metadata__"}


def _array(file: str, name: str, entry: object, body: memoryview) -> NDArray:
    """The array that an entry of the table describes."""
    fields = entry if isinstance(entry, dict) else {}
    code, shape, offsets = fields.get("dtype"), fields.get("shape"), fields.get("data_offsets")
    if code not in TYPES:
        raise InputError(file, name, f"has numbers of type {str(code)[:20]}", f"convert them to one of {', '.join(TYPES)}")
    if not _are_sizes(shape) or not _are_sizes(offsets) or len(offsets) != 2 or not offsets[0] <= offsets[1] <= len(body):  # type: ignore[arg-type, index]
        raise InputError(file, name, "lies outside of the file", REMEDY)
    count = 1
    for side in shape:  # type: ignore[union-attr]
        count *= side
    if count * np.dtype(TYPES[code]).itemsize != offsets[1] - offsets[0]:  # type: ignore[index]
        raise InputError(file, name, "has another shape than its bytes", REMEDY)
    return np.frombuffer(body[offsets[0] : offsets[1]], dtype=TYPES[code]).reshape(shape)  # type: ignore[index, arg-type]


def _are_sizes(values: object) -> bool:
    """Whether a value is a list of whole numbers from 0 on."""
    return isinstance(values, list) and all(type(value) is int and value >= 0 for value in values)
