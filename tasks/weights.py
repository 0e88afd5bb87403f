"""Weights of networks as safetensors: named arrays behind a JSON header. Nothing in such a file can run.

Written and read with NumPy alone, so that models answer where torch is not installed. The same arrays give the same bytes: names are
sorted, and no time or version is written.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.files import open_file
from schemas.parsing import json_value

MOST_BYTES = 8 << 30
"""Of a file of weights; the largest foreign encoders have a quarter of it."""

MOST_HEADER_BYTES = 100 << 20
"""Of its header, as the format has it."""

MOST_TENSORS = 100_000
"""Of its arrays; large networks have a few thousand."""

_KINDS: dict[str, np.dtype[Any]] = {
    "F64": np.dtype("<f8"), "F32": np.dtype("<f4"), "F16": np.dtype("<f2"), "I64": np.dtype("<i8"), "I32": np.dtype("<i4"),
    "I16": np.dtype("<i2"), "I8": np.dtype("i1"), "U64": np.dtype("<u8"), "U32": np.dtype("<u4"), "U16": np.dtype("<u2"),
    "U8": np.dtype("u1"), "BOOL": np.dtype("?"),
}  # fmt: skip
_BFLOAT = "BF16"
"""Half of a float32, the upper one; NumPy has no type for it, so that it is read as float32."""


def to_safetensors(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Arrays by name as a file's bytes.

    Raises:
        ValueError: an array has a type that the format does not have.
    """
    header: dict[str, Any] = {}
    parts, place = [], 0
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name]).reshape(np.shape(arrays[name]))
        kind = next((kind for kind, dtype in _KINDS.items() if dtype == array.dtype.newbyteorder("<")), None)
        if kind is None:
            raise ValueError(f"{name}: arrays of {array.dtype} cannot be kept")
        raw = array.astype(_KINDS[kind], copy=False).tobytes()
        header[name] = {"dtype": kind, "shape": list(array.shape), "data_offsets": [place, place + len(raw)]}
        parts.append(raw)
        place += len(raw)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # arrays begin where eight bytes begin
    return b"".join([len(text).to_bytes(8, "little"), text, *parts])


def from_safetensors(data: bytes, name: str = "weights") -> dict[str, NDArray[Any]]:
    """Arrays by name of a file's bytes; `name` is what errors call it. Half precision stays, but bfloat16 becomes float32.

    Raises:
        InputError: the bytes are no such file: cut off, with a header that does not fit, or with gaps, overlaps or bytes left over.
    """

    def refuse(field: str, problem: str) -> NoReturn:
        raise InputError(name, field, problem, "give a whole file in the safetensors format")

    if len(data) > MOST_BYTES:
        refuse("", f"is larger than {MOST_BYTES >> 30} GB")
    length = int.from_bytes(data[:8], "little") if len(data) >= 8 else 0
    if not 2 <= length <= min(MOST_HEADER_BYTES, len(data) - 8):
        refuse("header", "is missing or cut off")
    try:
        header = json_value(data[8 : 8 + length].decode(), parse_constant=lambda text: refuse("header", f"holds {text}"))
    except (ValueError, RecursionError):
        refuse("header", "is no JSON")
    if not isinstance(header, dict) or len(header) > MOST_TENSORS:
        refuse("header", f"is no table of up to {MOST_TENSORS} arrays")
    body = memoryview(data)[8 + length :]
    entries = [(key, _entry(value)) for key, value in header.items() if key != "__metadata__"]
    arrays, place = {}, 0
    for key, entry in sorted(entries, key=lambda pair: pair[1][2:] if pair[1] else (-1, -1)):
        if entry is None:
            refuse(key, "must have dtype, shape and data_offsets of this format")
        kind, shape, first, last = entry
        dtype = np.dtype("<u2") if kind == _BFLOAT else _KINDS[kind]
        if first != place or last - first != math.prod(shape) * dtype.itemsize or last > len(body):
            refuse(key, f"has bytes {first} to {last} of {len(body)}, which do not fit its shape or its neighbors")
        array = np.frombuffer(body[first:last], dtype).reshape(shape)
        arrays[key] = (array.astype("<u4") << 16).view("<f4") if kind == _BFLOAT else array
        place = last
    if place != len(body):
        refuse("", f"has {len(body) - place} bytes that belong to no array")
    return arrays


def _entry(value: Any) -> tuple[str, tuple[int, ...], int, int] | None:
    """Type, shape and first and last byte of an array; None where the header's entry says something else."""
    if not isinstance(value, dict) or set(value) != {"dtype", "shape", "data_offsets"}:
        return None
    kind, shape, offsets = value["dtype"], value["shape"], value["data_offsets"]
    if not (isinstance(kind, str) and (kind in _KINDS or kind == _BFLOAT) and isinstance(shape, list) and isinstance(offsets, list)):
        return None
    if len(offsets) != 2 or len(shape) > 32 or not all(type(number) is int and 0 <= number <= MOST_BYTES for number in (*shape, *offsets)):
        return None
    return kind, tuple(shape), offsets[0], offsets[1]


def files_digest(folder: Path, files: Sequence[Path]) -> str:
    """Hash of files below a folder, by name and content, 64 hex digits; of files that have not changed it is remembered.

    Raises:
        InputError: one is no regular file, or has more bytes than weights have.
    """
    return _digest(folder, tuple((path.relative_to(folder).as_posix(), path.stat().st_size, path.stat().st_mtime_ns) for path in files))


@lru_cache(maxsize=16)
def _digest(folder: Path, stamps: tuple[tuple[str, int, int], ...]) -> str:
    hashes = hashlib.sha256()
    for name, _, _ in stamps:
        with open_file(folder / name, name, MOST_BYTES) as file:
            hashes.update(name.encode() + b"\0" + hashlib.file_digest(file, "sha256").digest())
    return hashes.hexdigest()
