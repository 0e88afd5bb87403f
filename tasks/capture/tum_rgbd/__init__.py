"""TUM RGB-D: lists of color and depth images by time stamp, and the trajectory of a motion-capture system.

Written from the public description of the format.
"""

from __future__ import annotations

import math
import posixpath
import re
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.documents import license_of, name_of, read_text
from tasks.capture.files.frames import frame_sources, one_size
from tasks.capture.files.images import COLOR_SUFFIXES, DEPTH_SUFFIXES, has_float_depth
from tasks.capture.files.lenses import Intrinsics, intrinsics_file, of_depth, resized_intrinsics
from tasks.capture.files.stamps import STAMP_SECONDS, associated, in_seconds
from tasks.capture.files.trajectory import Pose, stamped_poses
from tasks.capture.layout import COLOR_INTRINSICS, FrameFiles, folders_in
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, leaving, license_path

COLOR, DEPTH, POSES = "rgb.txt", "depth.txt", "groundtruth.txt"

DEPTH_SCALE = 5000.0
"""Units per metre of the format's depth images."""

SIZE = (640, 480)
"""The format's images [px], which the intrinsics below are for."""

CAMERAS: dict[str, Intrinsics] = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""Calibrations that the benchmark publishes, by what is in the names of its folders [px]."""

USUAL: Intrinsics = (525.0, 525.0, 319.5, 239.5)
"""What the benchmark recommends where no calibration is known [px]."""


def read_tum_rgbd(scan: Scan) -> Reading:
    """Color images with the depth images and poses that belong to them by time; without a trajectory, no poses.

    Raises:
        InputError: a file is missing or broken, or no color image has a depth image.
    """
    folder = scan.path
    files = {path.relative_to(folder).as_posix(): path for path in _files(scan, scan.premises)}
    for wanted in (COLOR, DEPTH):
        if wanted not in files:
            raise leaving(folder / wanted) if (folder / wanted).is_symlink() else InputError(folder.name, wanted, "is missing", "copy it")
    notes: list[str] = []
    (color_times, colors), (depth_times, depths) = (_listed(files, name, folder, notes) for name in (COLOR, DEPTH))
    pairs = associated(color_times, depth_times)
    if not pairs:
        spans = f"{depth_times[0]:.3f} to {depth_times[-1]:.3f} s, and {COLOR} {color_times[0]:.3f} to {color_times[-1]:.3f} s"
        problem = f"has no image within {STAMP_SECONDS:g} s of one in {COLOR}: it covers {spans}"
        raise InputError(f"{folder.name}/{DEPTH}", "timestamp", problem, "are both lists of one recording?")
    frames = [FrameFiles(str(number), colors[i], depths[j], None) for number, (i, j) in enumerate(pairs)]
    times = [color_times[i] for i, _ in pairs]
    size = one_size([(frame.color, name_of(frame.color, folder)) for frame in frames], "color")
    depth_size = one_size([(depths[j], name_of(depths[j], folder)) for _, j in pairs], "depth")
    if len(pairs) < len(colors):
        notes.append(f"{len(colors) - len(pairs)} of {len(colors)} color images have no depth image within {STAMP_SECONDS:g} s: left out")
    stated = next((files[name] for name in COLOR_INTRINSICS if name in files), None)
    usual = 1.0 if has_float_depth(depths[pairs[0][1]], name_of(depths[pairs[0][1]], folder)) else DEPTH_SCALE
    lens, scale = intrinsics_file(stated, folder, size, usual) if stated is not None else (_published(folder.name, size), usual)
    poses: list[Pose | None] = [None] * len(frames)
    reasons: dict[int, str] = {}
    if POSES in files:
        poses, reasons = stamped_poses(files[POSES], name_of(files[POSES], folder), times)
    else:
        notes.append(f"no {POSES} in the scan: no poses")
    lenses = [(lens, of_depth(lens, size, depth_size, folder.name))] * len(frames)
    sources, more = frame_sources(frames, folder, size, depth_size, lenses, scale, poses, reasons)
    origin = name_of(stated, folder) if stated is not None else folder.name
    sources, findings = settled(sources, Statements(f"{folder.name}/{POSES}", origin, origin, has_quaternions=True))
    return Reading(
        surface=None,
        frames=sources,
        license=license_of(license_path(folder, scan.premises)),
        degradations=(*notes, *(more if POSES in files else ()), *findings),
    )


def listed_images(text: str) -> list[tuple[int, float | None, str]]:
    """Line number, time and image of each line of a list, None for a time that is not a number; separated by blanks or a comma."""
    images = []
    for number, line in enumerate(text.splitlines(), start=1):
        plain = re.split(r"(?:(?<=\s)|^)#", line, maxsplit=1)[0].strip()
        if not plain:
            continue
        time, _, image = (part.strip() for part in re.sub(r"[\s,]+", " ", plain, count=1).partition(" "))
        is_time = re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d{1,3})?", time, re.ASCII | re.IGNORECASE)
        value = float(time) if is_time and len(time) <= MAX_TIME_LETTERS else math.inf
        image = posixpath.normpath(image.strip("\"'").replace("\\", "/")) if image else ""
        images.append((number, value if math.isfinite(value) else None, image))
    return images


MAX_TIME_LETTERS = 64
"""A time with more letters is not one: Python writes 24, other tools up to 40."""


def _listed(files: dict[str, Path], name: str, folder: Path, notes: list[str]) -> tuple[list[float], list[Path]]:
    """Time stamps [s] and images of a list, in the order of time. notes: lines about repeated rows are added."""
    called = name_of(files[name], folder)
    line_of: dict[str, tuple[int, float]] = {}
    repeated = 0
    for number, time, image in listed_images(read_text(files[name], called)):
        if time is None or not image:
            problem = f"is no time stamp and file: {image[:60]!r}" if time is None else "names no file"
            raise InputError(called, f"line {number}", problem, "write a number of seconds and the path of an image")
        if image not in files:
            raise InputError(called, f"line {number}", f"names {image[:60]!r}, which the scan does not have", "copy the images again")
        before, stated = line_of.setdefault(image, (number, time))
        repeated += before != number
        if stated != time:
            problem = f"has {image[:60]!r} at {time:.6f}, line {before} at {stated:.6f}"
            raise InputError(called, f"line {number}", problem, "an image has one time: remove the wrong line")
    if not line_of:
        raise InputError(called, "content", "lists no image", "copy the list again")
    if repeated:
        notes.append(f"{called}: {repeated} lines repeat another one: left out")
    images = list(line_of)
    times = in_seconds([line_of[image][1] for image in images])
    order = sorted(range(len(images)), key=lambda index: times[index])
    return [times[index] for index in order], [files[images[index]] for index in order]


def _published(name: str, size: tuple[int, int]) -> Intrinsics:
    """The benchmark's intrinsics for a folder of a name, at the images' size [px]."""
    lens = next((lens for camera, lens in CAMERAS.items() if camera in name.lower()), USUAL)
    return resized_intrinsics(lens, SIZE, size, name)


def _recognize(folder: Path) -> str | None:
    is_scan = all((folder / name).is_file() or (folder / name).is_symlink() for name in (COLOR, DEPTH))
    return folder.name if is_scan else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    folder = scan.folder
    files = [folder / name for name in (COLOR, DEPTH, POSES, *COLOR_INTRINSICS) if "/" not in name]
    for place in folders_in(folder):
        if premises.admits(place):
            files += [path for path in sorted(place.iterdir()) if path.suffix.lower() in (*COLOR_SUFFIXES, *DEPTH_SUFFIXES)]
    return [path for path in files if path.is_file() and premises.admits(path)]


TUM_RGBD = ScanFormat(
    name="tum_rgbd",
    dataset="tum_rgbd",
    expected=f"{COLOR}, {DEPTH} and the images that they list, with {POSES}",
    recognize=_recognize,
    is_recorded=lambda folder: _recognize(folder) is not None,
    files=_files,
    read=read_tum_rgbd,
    signs=(COLOR, DEPTH, "rgb/*", "depth/*", POSES),
)
