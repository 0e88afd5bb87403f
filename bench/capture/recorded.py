"""Real frames over which masks were drawn, read from the folder of real data; they are in no repository of ours."""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import numpy as np

from bench.capture.drawn import Drawing
from bench.capture.truth import NOTHING, UNKNOWN, FrameTruth
from schemas.errors import InputError
from tasks.capture.files.frames import exported_frames
from tasks.capture.layout import frame_layout
from tasks.capture.small_objects.lifting import DepthView, depth_view

CLOUD_LENS = (525.0, 525.0, 319.5, 239.5)
"""fx, fy, cx, cy [px] of clouds of first-generation structured light at 640 x 480: their files name no lens."""


def recorded_view(drawing: Drawing, root: Path) -> DepthView:
    """The frame that a drawing is of, its camera at the origin.

    Raises:
        InputError: it is not in the folder, or cannot be read.
    """
    path = root / drawing.frame
    if path.suffix == ".pcd":
        return cloud_view(path)
    layout = frame_layout(path.parents[1])
    if layout is None:
        raise InputError(drawing.frame, "folder", "holds no frames", "name the folder of real data with --realdata")
    frames, _ = exported_frames(layout, path.parents[1], {})
    for frame in frames:
        if Path(frame.color_file).stem == path.stem:
            view = depth_view(dataclasses.replace(frame, pose=np.eye(4)), np.eye(4))
            if view is not None:
                return view
    raise InputError(drawing.frame, "frame", "is not there, or has no depth", "name the folder of real data with --realdata")


def truth_of_drawing(drawing: Drawing) -> FrameTruth:
    """What a drawing says of pixels: objects, structure that is no object, and of the rest nothing."""
    labels = drawing.labels().astype(np.int64)
    owner = np.where(drawing.structure_labels() > 0, NOTHING, UNKNOWN)
    supports = frozenset(number for number, each in enumerate(drawing.objects) if each.is_support)
    return FrameTruth(np.where(labels > 0, labels - 1, owner), supports)


def cloud_view(path: Path) -> DepthView:
    """An organized cloud of the Point Cloud Library (`x y z rgb` or `rgba`, binary or compressed) as a frame.

    Raises:
        InputError: it is no such cloud.
    """
    try:
        data = path.read_bytes()
        start = data.index(b"DATA ")
        end = data.index(b"\n", start) + 1
        header = dict(line.split(" ", 1) for line in data[:end].decode("ascii").splitlines() if not line.startswith("#"))
        width, height, kind = int(header["WIDTH"]), int(header["HEIGHT"]), header["DATA"].strip()
        if header["FIELDS"].split()[:3] != ["x", "y", "z"] or header["SIZE"].split() != ["4"] * 4 or width * height > 1 << 24:
            raise ValueError(header["FIELDS"])
        if kind == "binary_compressed":
            packed, size = struct.unpack_from("<II", data, end)
            columns = np.frombuffer(unpacked(data[end + 8 : end + 8 + packed], size), dtype="<f4").reshape(4, height, width)
        else:
            columns = np.moveaxis(np.frombuffer(data, "<f4", 4 * width * height, end).reshape(height, width, 4), -1, 0)
    except (OSError, ValueError, KeyError, IndexError, struct.error) as error:
        raise InputError(path.name, "DATA", "is no organized cloud of x, y, z and color", "take the file as it was published") from error
    depth = np.where(np.isfinite(columns[2]), np.abs(columns[2]), 0).astype(np.float32)
    code = np.ascontiguousarray(columns[3]).view("<u4")
    color = np.stack([code >> 16 & 255, code >> 8 & 255, code & 255], axis=-1).astype(np.uint8)
    return DepthView(path.stem, depth, color, CLOUD_LENS, np.eye(4))


def unpacked(data: bytes, size: int) -> bytes:
    """What LZF packed (Lehmann, liblzf: literal runs, and references of up to 264 bytes), `size` bytes.

    Raises:
        ValueError: it is no such stream, or of another size.
    """
    out, at = bytearray(), 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        back = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        if back < 0:
            raise ValueError("refers to what is before its start")
        for _ in range(length + 2):
            out.append(out[back])
            back += 1
        if len(out) > size:
            raise ValueError("is longer than it says")
    if len(out) != size:
        raise ValueError("is shorter than it says")
    return bytes(out)
