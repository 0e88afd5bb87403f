"""Frames of a ScanNet `.sens` container, version 4, read one at a time without unpacking the file.

Layout, little-endian: version u32, length of the sensor's name u64 and the name, four 4x4 float32 matrices (intrinsics
and extrinsics of color, of depth), color compression i32, depth compression i32, color width and height u32, depth
width and height u32, depth units per metre f32, frame count u64. A frame: camera-to-world 4x4 f32, time stamps of
color and depth u64, bytes of color and depth u64, the color image, the depth image.
"""

from __future__ import annotations

import dataclasses
import os
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file
from tasks.capture.files.images import MAX_PIXELS, NO_READING, decode_color

MAX_SENS_BYTES = BUDGET.sens_bytes

_FRAME = struct.Struct("<16f4Q")
_COLOR_KINDS = {0: "raw", 1: "png", 2: "jpeg"}
_DEPTH_KINDS = {0: "raw_ushort", 1: "zlib_ushort", 2: "occi_ushort"}
_AGAIN = "download the container again"


@dataclasses.dataclass(frozen=True)
class SensFrame:
    """Where a frame lies in its container. pose: OpenCV camera to scan frame, 4x4 [m], as stored (may be -inf)."""

    pose: NDArray[np.float64]
    color_at: int
    color_bytes: int
    depth_at: int
    depth_bytes: int


@dataclasses.dataclass(frozen=True)
class SensFile:
    """A container's header and where its frames lie. Intrinsics are fx, fy, cx, cy [px]; sizes are width, height [px]."""

    path: Path
    name: str
    color_kind: str
    depth_kind: str
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    color_intrinsics: tuple[float, float, float, float]
    depth_intrinsics: tuple[float, float, float, float]
    depth_scale: float
    frames: tuple[SensFrame, ...]

    def color(self, index: int) -> NDArray[np.uint8]:
        """Color image of a frame, shape (height, width, 3); raises InputError when it cannot be decoded."""
        frame = self.frames[index]
        data, label = self._slice(frame.color_at, frame.color_bytes), f"{self.name}#{index}"
        width, height = self.color_size
        if self.color_kind == "raw":
            if len(data) != width * height * 3:
                raise InputError(label, "color", f"has {len(data)} bytes, {width} x {height} needs {width * height * 3}", _AGAIN)
            return np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3)
        return decode_color(data, label, (width, height))

    def depth(self, index: int) -> NDArray[np.float32]:
        """Depth of a frame [m], shape (height, width), 0 where there is none; raises InputError when it cannot be decoded."""
        frame = self.frames[index]
        data, label = self._slice(frame.depth_at, frame.depth_bytes), f"{self.name}#{index}"
        width, height = self.depth_size
        needed = width * height * 2
        if self.depth_kind == "zlib_ushort":
            try:
                data = zlib.decompressobj().decompress(data, needed + 1)
            except zlib.error as error:
                raise InputError(label, "depth", f"cannot be unpacked ({error})", _AGAIN) from error
        if len(data) != needed:
            raise InputError(label, "depth", f"does not unpack to {width} x {height} pixels", _AGAIN)
        units = np.frombuffer(data, dtype="<u2").reshape(height, width)
        return np.where(units == NO_READING, np.float32(0), units.astype(np.float32) / np.float32(self.depth_scale))

    def _slice(self, start: int, count: int) -> bytes:
        try:
            with open_file(self.path, self.name, MAX_SENS_BYTES) as stream:
                stream.seek(start)
                return stream.read(count)
        except OSError as error:
            raise InputError(self.name, "file", f"cannot be read ({error.strerror})", _AGAIN) from error


def open_sens(path: Path, name: str) -> SensFile:
    """The header of a container, and where each of its frames lies.

    Raises:
        InputError: it is no container of version 4, it is cut, or it states sizes that cannot be.
    """
    try:
        with open_file(path, name, MAX_SENS_BYTES) as stream:
            return _read(stream, os.fstat(stream.fileno()).st_size, path, name)
    except OSError as error:
        raise InputError(name, "file", f"cannot be read ({error.strerror})", _AGAIN) from error


def _read(stream: object, size: int, path: Path, name: str) -> SensFile:
    read = stream.read  # type: ignore[attr-defined]

    def take(fmt: str, field: str) -> tuple[float, ...]:
        data = read(struct.calcsize(fmt))
        if len(data) != struct.calcsize(fmt):
            raise InputError(name, field, "the file ends inside its header", _AGAIN)
        return struct.unpack(fmt, data)

    (version,) = take("<I", "version")
    if version != 4:
        raise InputError(name, "version", f"is {version}, only 4 is known", "is it a ScanNet .sens file?")
    (length,) = take("<Q", "sensor name")
    if length > 4096:
        raise InputError(name, "sensor name", f"is {length} bytes long", _AGAIN)
    read(int(length))
    matrices = np.array(take("<64f", "intrinsics"), dtype=np.float64).reshape(4, 4, 4)
    color_code, depth_code = (int(v) for v in take("<2i", "compression"))
    color_width, color_height, depth_width, depth_height = (int(v) for v in take("<4I", "image sizes"))
    (scale,) = take("<f", "depth shift")
    (count,) = take("<Q", "frame count")
    if color_code not in _COLOR_KINDS or depth_code not in (0, 1):
        kind = _DEPTH_KINDS.get(depth_code, str(depth_code))
        raise InputError(name, "compression", f"color {color_code}, depth {kind} cannot be read", "convert to jpeg and zlib_ushort")
    for field, width, height in (("color size", color_width, color_height), ("depth size", depth_width, depth_height)):
        if not 0 < width * height <= MAX_PIXELS:
            raise InputError(name, field, f"is {width} x {height}", _AGAIN)
    if not (np.isfinite(scale) and 1.0 <= scale <= 1e6):
        raise InputError(name, "depth shift", f"is {scale}, must be 1 to 1,000,000 units per metre", _AGAIN)
    if count > BUDGET.frames:
        raise InputError(name, "frame count", f"declares {int(count)} frames, more than {BUDGET.frames}", _AGAIN)
    if count * _FRAME.size > size:
        raise InputError(name, "frame count", f"declares {int(count)} frames, more than {size} bytes can hold", _AGAIN)
    frames = _frames(stream, size, int(count), name)
    return SensFile(
        path=path,
        name=name,
        color_kind=_COLOR_KINDS[color_code],
        depth_kind=_DEPTH_KINDS[depth_code],
        color_size=(color_width, color_height),
        depth_size=(depth_width, depth_height),
        color_intrinsics=focal_and_center(matrices[0], name, "color intrinsics"),
        depth_intrinsics=focal_and_center(matrices[2], name, "depth intrinsics"),
        depth_scale=float(scale),
        frames=frames,
    )


def _frames(stream: object, size: int, count: int, name: str) -> tuple[SensFrame, ...]:
    frames, at = [], stream.tell()  # type: ignore[attr-defined]
    for index in range(count):
        stream.seek(at)  # type: ignore[attr-defined]
        head = stream.read(_FRAME.size)  # type: ignore[attr-defined]
        if len(head) != _FRAME.size:
            raise InputError(name, f"frame {index}", f"the file ends before it, {count} are declared", _AGAIN)
        values = _FRAME.unpack(head)
        color_bytes, depth_bytes = values[18], values[19]
        at += _FRAME.size
        if max(color_bytes, depth_bytes) > BUDGET.image_bytes:
            raise InputError(name, f"frame {index}", f"has an image of {max(color_bytes, depth_bytes)} bytes", _AGAIN)
        if color_bytes + depth_bytes > size - at:
            raise InputError(name, f"frame {index}", f"the file ends inside it, {count} are declared", _AGAIN)
        frames.append(SensFrame(np.array(values[:16], dtype=np.float64).reshape(4, 4), at, color_bytes, at + color_bytes, depth_bytes))
        at += color_bytes + depth_bytes
    return tuple(frames)


def focal_and_center(matrix: NDArray[np.float64], name: str, field: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy [px] of an intrinsic matrix, 3x3 or 4x4.

    Raises:
        InputError: it is no intrinsic matrix.
    """
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    if not np.isfinite([fx, fy, cx, cy]).all() or not (1 <= fx <= 1e5 and 1 <= fy <= 1e5) or max(abs(cx), abs(cy)) > 1e5:
        problem = f"fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g} are no intrinsics"
        raise InputError(name, field, problem, "write a 3x3 or 4x4 matrix in pixels")
    return fx, fy, cx, cy
