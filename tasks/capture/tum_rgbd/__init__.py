"""TUM RGB-D: lists of color and depth images by time stamp, and the trajectory of a motion-capture system.

Written from the public description of the format.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from schemas.errors import InputError
from tasks.capture.files.documents import license_of, name_of, read_text
from tasks.capture.files.frames import Intrinsics, frame_sources, intrinsics_file, one_size, scaled_intrinsics
from tasks.capture.files.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from tasks.capture.files.trajectory import STAMP_SECONDS, Pose, stamped_poses
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
    (color_times, colors), (depth_times, depths) = (_listed(files, name, folder) for name in (COLOR, DEPTH))
    pairs = associated(color_times, depth_times)
    if not pairs:
        problem = f"has no image within {STAMP_SECONDS:g} s of one in {COLOR}"
        raise InputError(f"{folder.name}/{DEPTH}", "timestamp", problem, "are both lists of one recording?")
    frames = [FrameFiles(str(number), colors[i], depths[j], None) for number, (i, j) in enumerate(pairs)]
    times = [color_times[i] for i, _ in pairs]
    size = one_size([(frame.color, name_of(frame.color, folder)) for frame in frames], "color")
    depth_size = one_size([(depths[j], name_of(depths[j], folder)) for _, j in pairs], "depth")
    notes = []
    if len(pairs) < len(colors):
        notes.append(f"{len(colors) - len(pairs)} of {len(colors)} color images have no depth image within {STAMP_SECONDS:g} s: left out")
    stated = next((files[name] for name in COLOR_INTRINSICS if name in files), None)
    lens, scale = intrinsics_file(stated, folder, size, DEPTH_SCALE) if stated is not None else (_published(folder.name, size), DEPTH_SCALE)
    poses: list[Pose | None] = [None] * len(frames)
    reasons: dict[int, str] = {}
    if POSES in files:
        poses, reasons = stamped_poses(files[POSES], name_of(files[POSES], folder), times)
    else:
        notes.append(f"no {POSES} in the scan: no poses")
    lenses = [(lens, scaled_intrinsics(lens, size, depth_size))] * len(frames)
    sources, more = frame_sources(frames, folder, size, depth_size, lenses, scale, poses, reasons)
    return Reading(
        surface=None,
        frames=sources,
        license=license_of(license_path(folder, scan.premises)),
        degradations=(*notes, *(more if POSES in files else ())),
    )


def associated(color: Sequence[float], depth: Sequence[float]) -> list[tuple[int, int]]:
    """Indices of images that belong together by time [s]: the nearest pair first, each image once, none farther apart than a frame."""
    times = np.array(depth)
    order = np.argsort(times, kind="stable")
    candidates = []
    for i, time in enumerate(color):
        at = int(np.searchsorted(times[order], time))
        for near in range(max(0, at - 2), min(len(order), at + 2)):
            gap = abs(float(times[order[near]]) - time)
            if gap <= STAMP_SECONDS:
                candidates.append((gap, i, int(order[near])))
    pairs: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in sorted(candidates):
        if i not in pairs and j not in taken:
            pairs[i] = j
            taken.add(j)
    return sorted(pairs.items())


def _listed(files: dict[str, Path], name: str, folder: Path) -> tuple[list[float], list[Path]]:
    """Time stamps [s] and images of a list, in its order."""
    called = name_of(files[name], folder)
    times, images = [], []
    for number, line in enumerate(read_text(files[name], called).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 2 or not re.fullmatch(r"\d{1,12}(\.\d{1,12})?", words[0], re.ASCII):
            raise InputError(called, f"line {number}", f"is no time stamp and file: {line.strip()[:60]!r}", "copy the list again")
        if words[1] not in files:
            raise InputError(called, f"line {number}", f"names {words[1][:60]!r}, which the scan does not have", "copy the images again")
        times.append(float(words[0]))
        images.append(files[words[1]])
    if not images:
        raise InputError(called, "content", "lists no image", "copy the list again")
    return times, images


def _published(name: str, size: tuple[int, int]) -> Intrinsics:
    """The benchmark's intrinsics for a folder of a name, at the images' size [px]."""
    lens = next((lens for camera, lens in CAMERAS.items() if camera in name.lower()), USUAL)
    return scaled_intrinsics(lens, SIZE, size)


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
