"""Camera trajectories: one file with the poses of all frames.

Known layouts, told apart by the shape of their lines:
- 5 lines a frame, three integers and a 4x4 matrix (Redwood, Open3D `trajectory.log`); row k is frame k;
- 7 numbers a line: tx ty tz qx qy qz qw;
- 8 numbers a line: a time stamp or frame number, then tx ty tz qx qy qz qw (TUM);
- 12 or 16 numbers a line: the rows of a 3x4 (KITTI) or 4x4 matrix; 4 numbers a line: 4x4 matrices below one another.
Quaternions have their real part last, unless the scan's description says `qw qx qy qz`. Poses are camera-to-world of an
OpenCV camera (x right, y down, z forward), unless it says `world-to-camera` or `OpenGL`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import read_text
from tasks.geometry.transforms import OPENGL_TO_OPENCV, inverse, is_rigid, pose_from_quaternion_wxyz

STAMP_SECONDS = 0.02
"""Color, depth and tracker of a 30 Hz camera are told to belong together within this, as TUM's own tools do."""

_SHAPE = "write one pose a line: tx ty tz qx qy qz qw, or the 12 or 16 numbers of its matrix"

Pose = NDArray[np.float64]


def read_trajectory(path: Path, name: str, keys: Sequence[str], described: str = "") -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each frame, camera to scan frame, 4x4 [m], None where the file has none; and why, by frame.

    keys: Names of the frames, in order. As many poses as frames are taken in order; otherwise a frame's number, or its
    time stamp, says which pose is its own.

    Raises:
        InputError: the file is no trajectory.
    """
    rows = [line.replace(",", " ").split() for line in read_text(path, name).splitlines()]
    plain = numbers([row for row in rows if row and not row[0].startswith(("#", "%"))], name)
    stamps, poses, kind = _poses(plain, name, "qwqxqyqz" in re.sub(r"[\s,_]", "", described.lower()))
    poses = [as_described(pose, described) if pose is not None else None for pose in poses]
    rows_of = _matched(stamps, len(poses), keys, kind)
    frame_poses: list[Pose | None] = [poses[row] if row is not None else None for row in rows_of]
    return frame_poses, {i: "none in the trajectory" for i, row in enumerate(rows_of) if row is None}


def stamped_poses(
    path: Path, name: str, times: Sequence[float], seconds: float = STAMP_SECONDS
) -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each time [s] in a file of stamped quaternions, as `read_trajectory` gives them: the nearest one in time.

    Raises:
        InputError: the file is no trajectory, or its poses have no time stamps.
    """
    rows = [line.replace(",", " ").split() for line in read_text(path, name).splitlines()]
    stamps, poses, _ = _poses(numbers([row for row in rows if row and not row[0].startswith(("#", "%"))], name), name, real_first=False)
    if not stamps:
        raise InputError(name, "row 0", "has no time stamp", "write one pose a line: timestamp tx ty tz qx qy qz qw")
    return nearest_in_time(stamps, poses, times, seconds)


def nearest_in_time(
    stamps: Sequence[float], poses: Sequence[Pose | None], times: Sequence[float], seconds: float
) -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each time [s]: that of the nearest stamp, None where none is as near as `seconds`; and why, by place."""
    rows_of = [_nearest(np.array(stamps), time, seconds) for time in times]
    return [poses[row] if row is not None else None for row in rows_of], {
        i: "none in the trajectory" for i, row in enumerate(rows_of) if row is None
    }


def as_described(pose: Pose, described: str) -> Pose:
    """A pose as a file has it, 4x4, as OpenCV camera to scan frame, by what is said about it: `world-to-camera`, `OpenGL`."""
    words = re.sub(r"[\s_-]", "", described.lower())
    if ("worldtocamera" in words or "w2c" in words) and is_rigid(pose, 0.02):
        pose = inverse(pose)
    return pose @ OPENGL_TO_OPENCV if "opengl" in words and np.isfinite(pose).all() else pose


def numbers(rows: list[list[str]], name: str) -> list[list[float]]:
    """Rows of words as numbers; raises InputError."""
    try:
        return [[float(word) for word in row] for row in rows]
    except ValueError as error:
        bad = next(i for i, row in enumerate(rows) if not all(_is_number(word) for word in row))
        raise InputError(name, f"row {bad}", f"is not made of numbers: {' '.join(rows[bad])[:40]!r}", _SHAPE) from error


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _poses(rows: list[list[float]], name: str, real_first: bool) -> tuple[list[float], list[Pose | None], str]:
    """Stamps (empty without any), poses and the kind of layout."""
    widths = [len(row) for row in rows]
    if not rows:
        raise InputError(name, "content", "holds no pose", _SHAPE)
    if widths[0] == 3 and len(rows) % 5 == 0 and widths == [3, 4, 4, 4, 4] * (len(rows) // 5):
        return [], [np.array(rows[i + 1 : i + 5]) for i in range(0, len(rows), 5)], "log"
    odd = next((i for i, width in enumerate(widths) if width != widths[0]), None)
    if odd is not None:
        raise InputError(name, f"row {odd}", f"has {widths[odd]} numbers, the first has {widths[0]}", "is the file cut?")
    width = widths[0]
    if width == 4 and len(rows) % 4 == 0:
        return [], [np.array(rows[i : i + 4]) for i in range(0, len(rows), 4)], "matrix"
    if width in (12, 16):
        return [], [np.vstack([np.reshape(row, (-1, 4))[:3], [0, 0, 0, 1]]) for row in rows], "matrix"
    if width not in (7, 8):
        raise InputError(name, "row 0", f"has {width} numbers, none of the known layouts", _SHAPE)
    stamps = [row[0] for row in rows] if width == 8 else []
    return stamps, [_from_quaternion(row[-7:], real_first) for row in rows], "quaternion"


def _from_quaternion(values: list[float], real_first: bool) -> Pose | None:
    """Pose of tx ty tz and a quaternion; None when they are not finite or no quaternion."""
    offset, quaternion = np.array(values[:3]), np.array(values[3:])
    norm = float(np.linalg.norm(quaternion))
    if not np.isfinite(values).all() or not 0.9 < norm < 1.1:
        return None
    w, x, y, z = quaternion if real_first else np.roll(quaternion, 1)
    return pose_from_quaternion_wxyz((w / norm, x / norm, y / norm, z / norm), offset)


def _matched(stamps: list[float], count: int, keys: Sequence[str], kind: str) -> list[int | None]:
    """The row of each frame, None for those without one."""
    if count == len(keys) and kind != "log":
        return list(range(count))
    if stamps:
        times = np.array(stamps)
        return [_nearest(times, float(key)) if re.fullmatch(r"\d+(\.\d+)?", key) else None for key in keys]
    indices = [int(match[1]) if (match := re.search(r"(\d{1,9})$", key)) else None for key in keys]
    if count == len(keys) and any(i is None or i >= count for i in indices):
        return list(range(count))
    return [i if i is not None and i < count else None for i in indices]


def _nearest(times: NDArray[np.float64], time: float, seconds: float = STAMP_SECONDS) -> int | None:
    """Index of the stamp that belongs to `time`, None when none is near enough."""
    gap = np.abs(np.where(np.isfinite(times), times, np.inf) - time)
    best = int(np.argmin(gap))
    return best if gap[best] <= seconds else None
