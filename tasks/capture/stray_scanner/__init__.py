"""Stray Scanner: depth images with their confidence, an odometry, and the frames of its video, as images or unpacked with PyAV.

Written from the public description of the format.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.documents import license_of, name_of, read_text
from tasks.capture.files.frames import frame_sources, one_size
from tasks.capture.files.images import COLOR_SUFFIXES, image_size, read_depth
from tasks.capture.files.lenses import DEPTH_SCALE, Intrinsics, matrix_intrinsics, of_depth
from tasks.capture.files.sens import focal_and_center
from tasks.capture.files.trajectory import Pose
from tasks.capture.files.unpacked import is_installed, missing, step_of, thinned, unpacked
from tasks.capture.files.video import CODE
from tasks.capture.layout import FrameFiles
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, leaving, license_path
from tasks.geometry.transforms import Y_UP_TO_Z_UP, pose_from_quaternion_wxyz

ODOMETRY, CAMERA, DEPTH, CONFIDENCE, VIDEO = "odometry.csv", "camera_matrix.csv", "depth", "confidence", "rgb.mp4"
COLOR = ("rgb", "color", "images")
"""Folders that the video's frames may lie in."""

EXTRACT = f"mkdir rgb && ffmpeg -i {VIDEO} -start_number 0 -fps_mode passthrough -qscale:v 2 rgb/%06d.jpg"
"""What makes images of the video, with the numbers of the depth images."""

MAX_FRAMES_PER_DEPTH = 60
"""Frames of the video per depth image: one a second of a recording at full rate. A higher number is not decoded."""

LEAST_CONFIDENCE = 1
"""Of 0, 1 and 2: what the sensor has no confidence in is no reading."""


def read_stray_scanner(scan: Scan) -> Reading:
    """Frames of color and depth by their numbers, with the poses of the odometry.

    Raises:
        InputError: a file is missing or broken, or the video's frames are not images and PyAV is not installed.
    """
    folder = scan.path
    files = {path.relative_to(folder).as_posix(): path for path in _files(scan, scan.premises)}
    for name in (ODOMETRY, CAMERA):
        if name not in files:
            raise leaving(folder / name) if (folder / name).is_symlink() else InputError(folder.name, name, "is missing", "copy it")
    colors, depths, confidences = (_numbered(files, places) for places in (COLOR, (DEPTH,), (CONFIDENCE,)))
    if not depths:
        raise InputError(folder.name, DEPTH, "has no image with a number", "copy the depth images")
    video_size: tuple[int, int] | None = None
    notes: list[str] = []
    if not colors:
        colors, video_size, notes = _video_frames(files.get(VIDEO), folder, depths)
    numbers = sorted(colors.keys() & depths.keys())
    if not numbers:
        raise InputError(folder.name, "frames", "no color image has the number of a depth image", f"in its folder: {EXTRACT}")
    frames = [FrameFiles(str(number), colors[number], depths[number], None) for number in numbers]
    size = one_size([(frame.color, _color_name(frame.color, folder)) for frame in frames], "color")
    depth_size = one_size([(depths[number], name_of(depths[number], folder)) for number in numbers], "depth")
    lens = matrix_intrinsics(read_text(files[CAMERA], name_of(files[CAMERA], folder)), name_of(files[CAMERA], folder))
    rows = _odometry(files[ODOMETRY], name_of(files[ODOMETRY], folder), lens)
    scale = _scale(lens, size) if video_size is None else size[0] / video_size[0]
    lenses = [_resized(rows[number][1] if number in rows else lens, scale) for number in numbers]
    both = [(own, of_depth(own, size, depth_size, folder.name)) for own in lenses]
    if len(numbers) < len(depths):
        notes.append(f"{len(depths) - len(numbers)} of {len(depths)} depth images have no color image: left out")

    def reader(path: Path) -> Callable[[], NDArray[np.float32]]:
        confidence = confidences.get(int(path.stem)) if path.stem.isdecimal() else None
        return partial(_depth, path, confidence, folder, depth_size)

    poses: list[Pose | None] = [rows[number][0] if number in rows else None for number in numbers]
    sources, more = frame_sources(frames, folder, size, depth_size, both, DEPTH_SCALE, poses, {}, reader)
    if video_size is not None:
        named = zip(sources, numbers, strict=True)
        sources = tuple(dataclasses.replace(source, color_file=f"{VIDEO}#{number}") for source, number in named)
    odometry, camera = (name_of(files[name], folder) for name in (ODOMETRY, CAMERA))
    statements = Statements(odometry, camera, f"{folder.name}/{DEPTH}", has_quaternions=True, from_file=Y_UP_TO_Z_UP)
    sources, findings = settled(sources, statements)
    license = license_of(license_path(folder, scan.premises))
    return Reading(surface=None, frames=sources, license=license, degradations=(*notes, *more, *findings), from_file=Y_UP_TO_Z_UP)


def _video_frames(video: Path | None, folder: Path, depths: dict[int, Path]) -> tuple[dict[int, Path], tuple[int, int], list[str]]:
    """Images of the video by their numbers, its size [px], and notes on frames that are left out or missing.

    Raises:
        InputError: there is no video, PyAV is not installed, or the video cannot be decoded.
    """
    name = f"{folder.name}/{VIDEO}"
    if video is None:
        raise InputError(name, "frames", "is missing, and there are no images", "copy the video, or its frames as images into rgb/")
    if not is_installed("av"):
        raise missing(name, "PyAV", "frames", f"in its folder: {EXTRACT}")
    step, highest = step_of(len(depths)), max(depths)
    last = min(highest, MAX_FRAMES_PER_DEPTH * len(depths))
    recording = unpacked(CODE, video, name, [str(step), str(last)], last + 1)
    count, stated = int(recording.facts.get("count", 0)), int(recording.facts.get("stated", 0))
    colors = {number: path for number in depths if (path := recording.folder / f"{number:06d}.jpg").is_file()}
    notes = thinned(name, step, count)
    total = stated if stated > 0 else count
    if total != highest + 1:
        notes.append(f"{name}: has {total} frames, {DEPTH} has numbers up to {highest}: frames are paired by number")
    return colors, (int(recording.facts.get("width", 0)) or 1, int(recording.facts.get("height", 0)) or 1), notes


def _color_name(path: Path, folder: Path) -> str:
    """A color image as errors name it: its own name, or its number in the video."""
    return name_of(path, folder) if path.is_relative_to(folder) else f"{folder.name}/{VIDEO}#{int(path.stem)}"


def _depth(path: Path, confidence: Path | None, folder: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """Depth [m] that the sensor has confidence in, shape (height, width), 0 elsewhere."""
    depth = read_depth(path, name_of(path, folder), size, DEPTH_SCALE)
    if confidence is None:
        return depth
    name = name_of(confidence, folder)
    if image_size(confidence, name) != size:
        raise InputError(name, "confidence", "has another size than the depth image", "copy the images again")
    return np.where(read_depth(confidence, name, size, 1.0) >= LEAST_CONFIDENCE, depth, np.float32(0))


def _scale(lens: Intrinsics, size: tuple[int, int]) -> float:
    """Factor from the video's own size, whose middle is the lens's center to a tenth, to that of the images."""
    factor = size[0] / (2.0 * lens[2]) if lens[2] > 0 else 1.0
    return 1.0 if abs(np.log(factor)) < 0.1 else factor


def _resized(lens: Intrinsics, factor: float) -> Intrinsics:
    fx, fy, cx, cy = lens
    return fx * factor, fy * factor, cx * factor, cy * factor


def _odometry(path: Path, name: str, lens: Intrinsics) -> dict[int, tuple[Pose, Intrinsics]]:
    """Pose, OpenCV camera to the +Z-up frame, 4x4 [m], and intrinsics by frame; columns go by the header's names."""
    reader = csv.DictReader(io.StringIO(read_text(path, name)), skipinitialspace=True)
    try:
        fields = [field.strip() for field in reader.fieldnames or ()]
        wanted = ("frame", "x", "y", "z", "qx", "qy", "qz", "qw")
        if missing := [field for field in wanted if field not in fields]:
            raise InputError(name, missing[0], "the column is missing", "copy the file again")
        rows = [[(value or "").strip() if isinstance(value, str) else "" for value in row.values()][: len(fields)] for row in reader]
    except csv.Error as error:
        raise InputError(name, "content", f"is no table ({error})", "copy the file again") from error
    column = {field: at for at, field in enumerate(fields)}
    result: dict[int, tuple[Pose, Intrinsics]] = {}
    for line, row in enumerate(rows, start=2):
        try:
            frame = row[column["frame"]]
            x, y, z, qx, qy, qz, qw = (float(row[column[field]]) for field in wanted[1:])
            own = tuple(float(row[column[field]]) for field in ("fx", "fy", "cx", "cy")) if "fx" in fields and "cy" in fields else lens
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(name, f"line {line}", "is not made of numbers", "copy the file again") from error
        if not re.fullmatch(r"\d{1,9}", frame, re.ASCII):
            raise InputError(name, f"line {line}, frame", f"is no number: {frame[:20]!r}", "copy the file again")
        fx, fy, cx, cy = own
        checked = focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), name, f"line {line}")
        norm = float(np.linalg.norm([qx, qy, qz, qw]))
        if 0.9 < norm < 1.1 and np.isfinite([x, y, z]).all():
            pose = pose_from_quaternion_wxyz((qw / norm, qx / norm, qy / norm, qz / norm), [x, y, z])
            result[int(frame)] = (Y_UP_TO_Z_UP @ pose, checked)
    return result


def _numbered(files: dict[str, Path], places: tuple[str, ...]) -> dict[int, Path]:
    """Images of the first of some folders that has any, by their numbers."""
    for place in places:
        own = {int(path.stem): path for key, path in files.items()
               if key.startswith(f"{place}/") and re.fullmatch(r"\d{1,9}", path.stem, re.ASCII)}  # fmt: skip
        if own:
            return own
    return {}


def _recognize(folder: Path) -> str | None:
    is_scan = all((folder / name).is_file() or (folder / name).is_symlink() for name in (ODOMETRY, CAMERA))
    return folder.name if is_scan else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    folder = scan.folder
    files = [folder / ODOMETRY, folder / CAMERA]
    for name in (*COLOR, DEPTH, CONFIDENCE):
        if (folder / name).is_dir() and premises.admits(folder / name):
            files += [path for path in sorted((folder / name).iterdir()) if path.suffix.lower() in COLOR_SUFFIXES]
    if not any(path.parent.name in COLOR for path in files):
        files.append(folder / VIDEO)
    return [path for path in files if path.is_file() and premises.admits(path)]


STRAY_SCANNER = ScanFormat(
    name="stray_scanner",
    dataset="stray_scanner",
    expected=f"{ODOMETRY}, {CAMERA}, {DEPTH}/ and {VIDEO}, or its frames in rgb/",
    recognize=_recognize,
    is_recorded=lambda folder: _recognize(folder) is not None,
    files=_files,
    read=read_stray_scanner,
    signs=(ODOMETRY, CAMERA, f"{DEPTH}/*.png", VIDEO),
)
