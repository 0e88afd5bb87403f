"""PCD files of the Point Cloud Library: text, binary and compressed; rows of points, or the grid of a depth camera."""

from __future__ import annotations

import dataclasses
import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.documents import read_bytes
from tasks.capture.files.ply_elements import PlyColumn
from tasks.capture.point_cloud.points import Points, check_count, points_of_columns
from tasks.capture.point_cloud.rows import MAX_COLUMNS, read_rows
from tasks.geometry.transforms import pose_from_quaternion_wxyz
from tasks.kernels import Kernels, compile_kernels

AGAIN = "copy or export the cloud again"

MAX_HEADER_BYTES = 65536
"""Headers have eleven lines."""

_KINDS = {
    "F": {"4": "<f4", "8": "<f8"},
    "I": {"1": "i1", "2": "<i2", "4": "<i4", "8": "<i8"},
    "U": {"1": "u1", "2": "<u2", "4": "<u4", "8": "<u8"},
}
_PACKED = ("rgb", "rgba")


@dataclasses.dataclass(frozen=True)
class PcdHeader:
    """Header of a PCD. fields: name, dtype and count of each. start: where the content begins. viewpoint: sensor to file, 4x4."""

    fields: tuple[tuple[str, str, int], ...]
    width: int
    height: int
    points: int
    data: str
    start: int
    viewpoint: NDArray[np.float64]

    @property
    def states_viewpoint(self) -> bool:
        """False for the viewpoint that programs write which know none: the origin, without a turn."""
        return not np.allclose(self.viewpoint, np.eye(4), rtol=0.0, atol=1e-12)


@dataclasses.dataclass(frozen=True)
class Pcd:
    """Points of a PCD with its header."""

    points: Points
    header: PcdHeader


def read_pcd(path: Path, name: str) -> Pcd:
    """All points of a PCD, also those without coordinates, in the order of the file.

    Raises:
        InputError: cut, broken, too large, or of a kind that is not known.
    """
    data = read_bytes(path, name, BUDGET.scene_bytes)
    header = read_header(data, name)
    columns = _text_columns(data, header, name) if header.data == "ascii" else _binary_columns(data, header, name)
    for word in _PACKED:
        if word in columns:
            columns |= _unpacked_colors(columns.pop(word))
    wide = [f"{field} ({count} values)" for field, _, count in header.fields if count != 1 and field != "_"]
    notes = [f"{name}: {', '.join(wide)}: not used"] if wide else []
    points = points_of_columns(columns, name, notes)
    if header.states_viewpoint:
        sensor_of = np.zeros(len(points.positions), np.int32)
        points = dataclasses.replace(points, sensors=header.viewpoint[None, :3, 3], sensor_of=sensor_of)
    return Pcd(points, header)


def read_header(data: bytes, name: str) -> PcdHeader:
    """The header of a PCD."""
    lines: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in lines:
        end = data.find(b"\n", start, MAX_HEADER_BYTES)
        if end < 0:
            raise InputError(name, "header", "is not that of a PCD, or cut", AGAIN)
        words = data[start:end].decode("latin-1").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            lines[words[0].upper()] = words[1:]
    names = lines.get("FIELDS", lines.get("COLUMNS", []))
    sizes, types = lines.get("SIZE", []), lines.get("TYPE", [])
    counts = lines.get("COUNT", ["1"] * len(names))
    if not names or len(names) > MAX_COLUMNS or not len(names) == len(sizes) == len(types) == len(counts):
        raise InputError(name, "header", f"lists {len(names)} fields, {len(sizes)} sizes and {len(types)} types", AGAIN)
    fields = []
    for field, size, kind, count in zip(names, sizes, types, counts, strict=True):
        dtype = _KINDS.get(kind, {}).get(size)
        if dtype is None:
            raise InputError(name, f"field {field}", f"has type {kind} of {size} bytes, which is not known", AGAIN)
        fields.append((field.lower(), dtype, _natural(count, name, "COUNT", 4096)))
    repeated = {field for field, _, _ in fields if field != "_" and [other for other, _, _ in fields].count(field) > 1}
    if repeated:
        raise InputError(name, "FIELDS", f"list {min(repeated)[:40]!r} twice", AGAIN)
    width = _natural(lines.get("WIDTH", ["0"])[:1], name, "WIDTH")
    height = _natural(lines.get("HEIGHT", ["1"])[:1], name, "HEIGHT")
    points = _natural(lines.get("POINTS", [str(width * height)])[:1], name, "POINTS")
    check_count(max(points, width * height), name)
    if "WIDTH" in lines and points != width * height:
        raise InputError(name, "POINTS", f"is {points}, but WIDTH x HEIGHT is {width} x {height}", AGAIN)
    form = (lines["DATA"] or [""])[0].lower()
    if form not in ("ascii", "binary", "binary_compressed"):
        raise InputError(name, "DATA", f"is {form!r:.40}, not ascii, binary or binary_compressed", AGAIN)
    return PcdHeader(tuple(fields), width, height, points, form, start, _viewpoint(lines.get("VIEWPOINT"), name))


def _natural(words: list[str] | str, name: str, field: str, most: int = 2**62) -> int:
    word = words if isinstance(words, str) else (words or [""])[0]
    if not (word.isascii() and word.isdigit()) or len(word) > 18 or int(word) > most:
        raise InputError(name, field, f"is not a whole number: {word[:40]!r}", AGAIN)
    return int(word)


def _viewpoint(words: list[str] | None, name: str) -> NDArray[np.float64]:
    """Pose of the sensor, 4x4."""
    try:
        numbers = np.array([float(word) for word in words]) if words else np.array([0.0, 0, 0, 1, 0, 0, 0])
    except ValueError:
        numbers = np.zeros(0)
    length = float(np.linalg.norm(numbers[3:])) if len(numbers) == 7 and np.abs(numbers).max() < 1e9 else 0.0
    if not length > 0.0:
        raise InputError(name, "VIEWPOINT", "is not a position and a quaternion", AGAIN)
    return pose_from_quaternion_wxyz((numbers[3:] / length).tolist(), numbers[:3])


def _text_columns(data: bytes, header: PcdHeader, name: str) -> dict[str, PlyColumn]:
    width = sum(count for _, _, count in header.fields)
    if not header.points:
        return {}
    file = io.BytesIO(data)
    file.seek(header.start)
    table = read_rows(file, name, width, header.points)
    _check_rows(len(table.values), header, name)
    columns, at = {}, 0
    for field, dtype, count in header.fields:
        if count == 1:
            columns[field] = PlyColumn(_typed(table.values[:, at], field, dtype), np.dtype(dtype).str[1:])
        at += count
    return columns


def _typed(values: NDArray[np.float64], field: str, dtype: str) -> NDArray[np.generic]:
    """Packed colors in their own type, whose bits count; other values stay as they are."""
    if field not in _PACKED:
        return values
    with np.errstate(invalid="ignore", over="ignore"):
        return values.astype(dtype) if dtype[1] == "f" else np.nan_to_num(values).astype(np.int64).astype(dtype)


def _binary_columns(data: bytes, header: PcdHeader, name: str) -> dict[str, PlyColumn]:
    size = header.points * sum(np.dtype(dtype).itemsize * count for _, dtype, count in header.fields)
    if size > BUDGET.scene_bytes:
        raise InputError(name, "size", f"is {size} bytes when unpacked, more than {BUDGET.scene_bytes}", "thin the cloud")
    columns: dict[str, PlyColumn] = {}
    if header.data == "binary":
        row = np.dtype([(f"f{i}", dtype, (count,)) for i, (_, dtype, count) in enumerate(header.fields)])
        _check_rows((len(data) - header.start) // max(row.itemsize, 1), header, name)
        table = np.frombuffer(data, row, header.points, header.start)
        for i, (field, _, count) in enumerate(header.fields):
            if count == 1:
                columns[field] = PlyColumn(table[f"f{i}"][:, 0], row[f"f{i}"].base.str[1:])
        return columns
    body = data[header.start :]
    packed, whole = (int(v) for v in np.frombuffer(body[:8], "<u4")) if len(body) >= 8 else (0, 0)
    if len(body) < 8 or packed > len(body) - 8 or whole < size:
        raise InputError(name, "content", f"ends after {max(len(body) - 8, 0)} of {packed} packed bytes, or holds too few points", AGAIN)
    if whole > size + 4096:
        raise InputError(name, "content", f"states {whole} bytes, its points have {size}", AGAIN)
    plain = np.zeros(whole, np.uint8)
    if _compiled()["_unpack"](np.frombuffer(body, np.uint8, packed, 8), plain) != whole:
        raise InputError(name, "content", "cannot be unpacked", AGAIN)
    at = 0
    for field, dtype, count in header.fields:
        if count == 1:
            columns[field] = PlyColumn(np.frombuffer(plain, dtype, header.points, at), np.dtype(dtype).str[1:])
        at += header.points * count * np.dtype(dtype).itemsize
    return columns


def _check_rows(rows: int, header: PcdHeader, name: str) -> None:
    if rows < header.points:
        raise InputError(name, "content", f"ends after {rows} of {header.points} points", AGAIN)


def _unpacked_colors(column: PlyColumn) -> dict[str, PlyColumn]:
    """Red, green and blue in the bits of one number."""
    values = np.ascontiguousarray(column.values)
    if values.dtype.itemsize == 4:
        bits = values.view(np.uint32)
    elif values.dtype.kind == "f":
        bits = values.astype(np.float32).view(np.uint32)
    else:
        bits = values.astype(np.uint32)
    return {word: PlyColumn(((bits >> shift) & 255).astype(np.uint8), "u1") for word, shift in (("red", 16), ("green", 8), ("blue", 0))}


@cache
def _compiled() -> Kernels:
    return compile_kernels(_unpack)


def _unpack(packed: Any, plain: Any) -> int:
    """Undo LZF compression: runs of literals, and references to bytes before them. Returns the number of bytes, -1 for broken ones."""
    at, out = 0, 0
    while at < len(packed):
        control = int(packed[at])
        at += 1
        if control < 32:
            count = control + 1
            if at + count > len(packed) or out + count > len(plain):
                return -1
            for _ in range(count):
                plain[out] = packed[at]
                at += 1
                out += 1
            continue
        count = control >> 5
        if count == 7:
            if at >= len(packed):
                return -1
            count += int(packed[at])
            at += 1
        if at >= len(packed):
            return -1
        before = out - ((control & 31) << 8) - int(packed[at]) - 1
        at += 1
        count += 2
        if before < 0 or out + count > len(plain):
            return -1
        for _ in range(count):
            plain[out] = plain[before]
            before += 1
            out += 1
    return out
