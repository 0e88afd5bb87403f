"""Camera trajectories: one file with the poses of all frames.

Known layouts, told apart by the shape of their lines:
- 5 lines a frame, three integers and a 4x4 matrix (Redwood, Open3D `trajectory.log`); the first integer is the frame's number;
- 7 numbers a line: tx ty tz qx qy qz qw;
- 8 numbers a line: a time stamp or frame number, then tx ty tz qx qy qz qw (TUM);
- 12 or 16 numbers a line: a 3x4 (KITTI) or 4x4 matrix; 4 numbers a line: 4x4 matrices below one another.
Quaternions have their real part last, unless the scan's description or a comment of the file says `qw qx qy qz`. Matrices are
written by rows, or by columns where only that reading is a rotation. Poses are camera-to-world of an OpenCV camera (x right,
y down, z forward), unless the description says `world-to-camera`, `OpenGL` or `left-handed`.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import read_text
from tasks.capture.files.stamps import STAMP_SECONDS, in_seconds, number_of, time_of
from tasks.geometry.transforms import MIRRORED_Y, OPENGL_TO_OPENCV, inverse, is_rigid, pose_from_quaternion_wxyz

_SHAPE = "write one pose a line: tx ty tz qx qy qz qw, or the 12 or 16 numbers of its matrix"

_RIGID = 0.02
"""Largest error of an entry of R R^T: trackers write rotations of float32 that have drifted from orthogonal."""

_SAME_POSE = 0.01
"""Two poses of one time are the same within this, in every entry [m or 1]."""

Pose = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class _PoseRows:
    """Poses of a file in its order.

    stamps: times [s] of the rows, or frame numbers with `has_numbers`; empty without any. reasons: of rows without a pose.
    """

    poses: list[Pose | None]
    stamps: list[float] = dataclasses.field(default_factory=list)
    reasons: dict[int, str] = dataclasses.field(default_factory=dict)
    has_numbers: bool = False
    note: str = ""


def read_trajectory(
    path: Path, name: str, keys: Sequence[str], described: str = "", notes: list[str] | None = None
) -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each frame, camera to scan frame, 4x4 [m], None where the file has none; and the reason, by frame.

    Time stamps and frame numbers of the file decide which pose belongs to a frame; without them the number of the row does.
    Frame numbers count images that are named by time in the order of their times.

    Args:
        path: the trajectory.
        name: the file as errors call it.
        keys: names of the frames, in order.
        described: words of the scan about its poses.
        notes: lines about the pairing are added here, such as two counts that differ.

    Raises:
        InputError: the file is not a trajectory, or contradicts itself.
    """
    rows = _without_conflicts(_read(read_text(path, name), name, described))
    rows = dataclasses.replace(rows, poses=[as_described(pose, described) if pose is not None else None for pose in rows.poses])
    pairing: list[str] = [rows.note] if rows.note else []
    row_of = _matched(rows, keys, name, pairing)
    if notes is not None:
        notes += pairing
    times = [time for key in keys if (time := time_of(key)) is not None]
    return _of_frames(rows, row_of, times)


def stamped_poses(
    path: Path, name: str, times: Sequence[float], seconds: float = STAMP_SECONDS
) -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each time [s] in a file of stamped quaternions, as `read_trajectory` gives them: the nearest one in time.

    Raises:
        InputError: the file is not a trajectory, or its poses have no time stamps.
    """
    rows = _read(read_text(path, name), name, "")
    if not rows.stamps:
        raise InputError(name, "row 0", "has no time stamp", "write one pose a line: timestamp tx ty tz qx qy qz qw")
    rows = _without_conflicts(rows)
    return _of_frames(rows, [_nearest(np.array(rows.stamps), time, seconds) for time in times], times)


def nearest_in_time(
    stamps: Sequence[float], poses: Sequence[Pose | None], times: Sequence[float], seconds: float
) -> tuple[list[Pose | None], dict[int, str]]:
    """The pose of each time [s]: that of the nearest stamp, None where none is as near as `seconds`; and the reason, by place."""
    rows = _without_conflicts(_PoseRows(list(poses), list(stamps)))
    return _of_frames(rows, [_nearest(np.array(stamps), time, seconds) for time in times], times)


@dataclasses.dataclass(frozen=True)
class PoseConvention:
    """Meaning of a file's poses. is_left_handed counts before is_opengl: its axes of the camera are its own."""

    is_inverse: bool
    is_opengl: bool
    is_left_handed: bool


def convention_of(described: str) -> PoseConvention:
    """Meaning of poses by their description: `world-to-camera`, `OpenGL`, `left-handed`."""
    words = re.sub(r"[\s_-]", "", described.lower())
    is_left_handed = "lefthanded" in words
    return PoseConvention("worldtocamera" in words or "w2c" in words, "opengl" in words and not is_left_handed, is_left_handed)


def as_described(pose: Pose, described: str) -> Pose:
    """A pose as a file has it, 4x4, as OpenCV camera to scan frame, by its description."""
    meaning = convention_of(described)
    if not np.isfinite(pose).all():
        return pose
    if meaning.is_inverse and is_rigid(pose, _RIGID):
        pose = inverse(pose)
    return _in_other_axes(pose, meaning)


def as_written(pose: Pose, described: str) -> Pose:
    """A rigid pose, OpenCV camera to scan frame, as a file of that description has it; inverse of `as_described`."""
    meaning = convention_of(described)
    pose = _in_other_axes(pose, meaning)
    return inverse(pose) if meaning.is_inverse else pose


def _in_other_axes(pose: Pose, meaning: PoseConvention) -> Pose:
    if meaning.is_left_handed:
        return MIRRORED_Y @ pose @ MIRRORED_Y
    return pose @ OPENGL_TO_OPENCV if meaning.is_opengl else pose


def rigid_reading(matrices: Sequence[Sequence[float]], name: str) -> tuple[list[Pose], str]:
    """Poses, 4x4, of the 12 or 16 numbers of their matrices, and a line if these are written by columns.

    They are, if some matrix is rigid by columns only and none is by rows only.
    """
    last = [0.0, 0.0, 0.0, 1.0]
    rows, columns = [], []
    for values in matrices:
        square = np.reshape(values, (-1, 4)) if len(values) == 16 else np.vstack([np.reshape(values, (3, 4)), last])
        rows.append(np.array(square, dtype=np.float64))
        columns.append(rows[-1].T if len(values) == 16 else np.vstack([np.reshape(values, (4, 3)).T, last]))
    rigid = [(is_rigid(row, _RIGID), is_rigid(column, _RIGID)) for row, column in zip(rows, columns, strict=True)]
    if (False, True) in rigid and (True, False) not in rigid:
        return columns, f"{name}: matrices are rigid by columns only (translation last), and read so"
    return rows, ""


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


def rows_of(text: str) -> tuple[list[list[str]], str]:
    """Rows of words of a table, and its comments as one text. `#`, `%` and `//` begin a comment; commas and semicolons separate words.

    A first row without a number is a header, and as such a comment.
    """
    rows: list[list[str]] = []
    comments: list[str] = []
    is_first = True
    for line in text.splitlines():
        parts = _COMMENT.split(line, maxsplit=1)
        comments += parts[1:]
        words = re.sub(r"[,;]", " ", parts[0]).split()
        if words and is_first and not any(map(_is_number, words)):
            comments += words
        elif words:
            rows.append(words)
        is_first = is_first and not words
    return rows, " ".join(comments)


_COMMENT = re.compile(r"(?:(?<=\s)|^)(?:#|%|//)")


def _read(text: str, name: str, described: str) -> _PoseRows:
    """Poses of a file as it has them; raises InputError."""
    words, comments = rows_of(text)
    order, stated = quaternion_order(described), quaternion_order(comments)
    if order and stated and order != stated:
        problem = f"says quaternions are {stated}, the scan's description {order}"
        raise InputError(name, "comment", problem, "correct the comment, or pose_format in intrinsics.json")
    return _poses(numbers(words, name), name, (order or stated) == REAL_FIRST)


REAL_FIRST, REAL_LAST = "qw qx qy qz", "qx qy qz qw"


def quaternion_order(text: str) -> str:
    """Order of a quaternion that a text names, empty if it names none."""
    letters = re.sub(r"[\s,;_.()]", "", text.lower())
    return next((order for order in (REAL_FIRST, REAL_LAST) if order.replace(" ", "") in letters), "")


def _poses(rows: list[list[float]], name: str, real_first: bool) -> _PoseRows:
    """Poses of rows of numbers by the shape of the rows; raises InputError."""
    widths = [len(row) for row in rows]
    if not rows:
        raise InputError(name, "content", "holds no pose", _SHAPE)
    if widths[0] == 3 and len(rows) % 5 == 0 and widths == [3, 4, 4, 4, 4] * (len(rows) // 5):
        heads = [rows[i][0] for i in range(0, len(rows), 5)]
        # Some writers leave the same number in every head, which numbers nothing.
        has_numbers = len(set(heads)) == len(heads) and all(head.is_integer() for head in heads)
        blocks, note = rigid_reading([[*itertools.chain(*rows[i + 1 : i + 5])] for i in range(0, len(rows), 5)], name)
        return _PoseRows([*blocks], heads if has_numbers else [*map(float, range(len(blocks)))], has_numbers=True, note=note)
    odd = next((i for i, width in enumerate(widths) if width != widths[0]), None)
    if odd is not None:
        raise InputError(name, f"row {odd}", f"has {widths[odd]} numbers, the first has {widths[0]}", "is the file cut?")
    width = widths[0]
    if width == 4 and len(rows) % 4 == 0:
        rows, width = [[*itertools.chain(*rows[i : i + 4])] for i in range(0, len(rows), 4)], 16
    if width in (12, 16):
        matrices, note = rigid_reading(rows, name)
        return _PoseRows([*matrices], note=note)
    if width not in (7, 8):
        raise InputError(name, "row 0", f"has {width} numbers, none of the known layouts", _SHAPE)
    return _quaternion_rows(rows, name, real_first)


def _quaternion_rows(rows: list[list[float]], name: str, real_first: bool) -> _PoseRows:
    """Poses of rows with a translation and a quaternion, after a stamp if they have 8 numbers; raises InputError."""
    values = np.array(rows)[:, -7:]
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(values[:, 3:], axis=1)
        first = np.linalg.norm(values[:, :4], axis=1)
    is_unit = np.abs(lengths - 1.0) < _UNIT
    is_first = np.abs(first - 1.0) < _UNIT
    if is_first.all() and not is_unit.any():
        problem = f"its first four numbers have length {first[0]:.3g} as a quaternion, its last four {lengths[0]:.3g}"
        raise InputError(name, "row 0", problem, "write the quaternion last: tx ty tz qx qy qz qw")
    poses: list[Pose | None] = []
    reasons: dict[int, str] = {}
    for index, (row, length) in enumerate(zip(values, lengths, strict=True)):
        poses.append(None)
        if not np.isfinite(row).all():
            reasons[index] = "-inf" if np.isneginf(row).any() else "not finite"
        elif not is_unit[index]:
            reasons[index] = f"its quaternion has length {length:.3g}, not 1"
        else:
            w, x, y, z = row[3:] if real_first else np.roll(row[3:], 1)
            poses[-1] = pose_from_quaternion_wxyz((w / length, x / length, y / length, z / length), row[:3])
    stamps = in_seconds([row[0] for row in rows]) if len(rows[0]) == 8 else []
    has_numbers = bool(stamps) and all(stamp.is_integer() and abs(stamp) < _EPOCH for stamp in stamps)
    return _PoseRows(poses, stamps, reasons, has_numbers)


_UNIT = 0.1
"""Quaternions that are written with two digits are off from unit length by a few hundredths."""

_EPOCH = 1e9
"""Whole numbers below are numbers of frames, not times: as seconds since 1970 they would be before September 2001."""


def _matched(rows: _PoseRows, keys: Sequence[str], name: str, notes: list[str]) -> list[int | None]:
    """The row of each frame, None for those without one; raises InputError for orders that contradict each other."""
    count, is_as_many = len(rows.poses), len(rows.poses) == len(keys)
    indices, times = [number_of(key) for key in keys], [time_of(key) for key in keys]
    stamps = np.array(rows.stamps)
    if not rows.stamps and is_as_many:
        return list(range(count))
    if not rows.stamps:
        notes.append(f"{name}: has {count} poses for {len(keys)} images: an image gets the row of its number, counted from 0")
        return [i if i is not None and i < count else None for i in indices]
    if None not in times:
        known_times = [time for time in times if time is not None]
        nearest = [_nearest(stamps, time) for time in known_times]
        if not rows.has_numbers or _are_seconds(nearest, known_times, count):
            return nearest
        return _by_order(stamps, known_times, name, notes)
    if rows.has_numbers:
        return _by_number(rows.stamps, indices, is_as_many, name, notes)
    if not is_as_many:
        problem = f"has {count} poses with times, and the {len(keys)} images have no times in their names"
        raise InputError(name, "rows", problem, "name images by time, or write one pose an image")
    # Nothing but the order pairs images without times with poses that have some: then it has to be that of time.
    late = next((i for i in range(1, count) if not stamps[i] >= stamps[i - 1]), None)
    if late is not None:
        problem = f"its time {stamps[late]:.6f} is before that of the row above, and the images have no times"
        raise InputError(name, f"row {late}", f"{problem}: rows and times state two orders", "sort the rows, or name images by time")
    return list(range(count))


def _are_seconds(nearest: Sequence[int | None], times: Sequence[float], count: int) -> bool:
    """True if whole numbers of poses are times [s]: all poses or all images find a partner, or some do at images of whole seconds.

    nearest: the row of each image by time. times: of the images [s]. count: number of rows.
    """
    paired_rows = {row for row in nearest if row is not None}
    is_whole = all(abs(time - round(time)) <= STAMP_SECONDS for time in times)
    return bool(paired_rows) and (is_whole or len(paired_rows) == min(count, len(times)))


def _by_order(stamps: NDArray[np.float64], times: Sequence[float], name: str, notes: list[str]) -> list[int | None]:
    """Rows of images in the order of time by their frame numbers, None for all if numbers and images may be of different frames."""
    counts = f"numbers {len(stamps)} poses from {stamps.min():g} to {stamps.max():g}, and {len(times)} images are named by time"
    steps = np.diff(np.sort(stamps))
    # A number that is missing may be that of a pose or of an image: only even steps leave no doubt.
    if len(stamps) != len(times) or (len(steps) and not (steps[0] > 0 and (steps == steps[0]).all())):
        notes.append(f"{name}: {counts}: not paired; write a pose for each image, or name images by number")
        return [None] * len(times)
    notes.append(f"{name}: {counts}: paired in the order of numbers and times")
    row_of: list[int | None] = [None] * len(times)
    for image, row in zip(np.argsort(times, kind="stable"), np.argsort(stamps), strict=True):
        row_of[int(image)] = int(row)
    return row_of


def _by_number(stamps: Sequence[float], indices: Sequence[int | None], is_as_many: bool, name: str, notes: list[str]) -> list[int | None]:
    """Rows of frames by their numbers; in order where all numbers are off by the same, or frames have none."""
    row_of = {stamp: row for row, stamp in reversed(list(enumerate(stamps)))}
    offsets = {index - stamp for index, stamp in zip(indices, stamps, strict=False) if index is not None}
    if is_as_many and (None in indices or (len(offsets) == 1 and offsets != {0})):
        if None not in indices:
            problem = f"numbers poses from {stamps[0]:g} and the images are numbered from {indices[0]}"
            notes.append(f"{name}: {problem}: as many of both, paired in order")
        return list(range(len(stamps)))
    return [None if index is None else row_of.get(index) for index in indices]


def _without_conflicts(rows: _PoseRows) -> _PoseRows:
    """Rows without the poses of a time for which another row states another pose; the reason names both rows."""
    poses, reasons = list(rows.poses), dict(rows.reasons)
    order = sorted((stamp, row) for row, stamp in enumerate(rows.stamps) if np.isfinite(stamp))
    for (stamp, row), (next_stamp, other) in itertools.pairwise(order):
        first, second = rows.poses[row], rows.poses[other]
        if stamp == next_stamp and first is not None and second is not None and np.abs(first - second).max() > _SAME_POSE:
            for index in (row, other):
                poses[index], reasons[index] = None, f"rows {row} and {other} state two poses for one time"
    return dataclasses.replace(rows, poses=poses, reasons=reasons)


def _of_frames(rows: _PoseRows, row_of: Sequence[int | None], times: Sequence[float] = ()) -> tuple[list[Pose | None], dict[int, str]]:
    """Poses of frames by their rows, and the reasons of those without one. times: of the frames [s], for what is said if none fits."""
    reason = "none in the trajectory"
    finite = [stamp for stamp in rows.stamps if np.isfinite(stamp)]
    if len(times) and finite and all(row is None for row in row_of):
        reason += f": images are from {min(times):.6f} to {max(times):.6f} s, poses from {min(finite):.6f} to {max(finite):.6f} s"
    reasons = {i: reason if row is None else rows.reasons[row] for i, row in enumerate(row_of) if row is None or row in rows.reasons}
    return [None if row is None else rows.poses[row] for row in row_of], reasons


def _nearest(times: NDArray[np.float64], time: float, seconds: float = STAMP_SECONDS) -> int | None:
    """Index of the stamp that belongs to `time`, None when none is near enough."""
    gap = np.abs(np.where(np.isfinite(times), times, np.inf) - time)
    best = int(np.argmin(gap))
    return best if gap[best] <= seconds else None
