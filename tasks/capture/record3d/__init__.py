"""Record3D: an `.r3d` recording, or its folder: metadata with intrinsics and poses, color images, and depth maps of 32-bit floats.

Written from the public description of the format. Depth maps are packed with LZFSE, which the extra `video` decodes.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import check_file
from schemas.wording import counted
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.documents import json_floats, license_of, name_of, read_bytes, read_json
from tasks.capture.files.frames import frame_sources, one_size
from tasks.capture.files.images import MAX_IMAGE_BYTES, MAX_PIXELS
from tasks.capture.files.lenses import Intrinsics, of_depth, resized_intrinsics
from tasks.capture.files.sens import focal_and_center
from tasks.capture.files.trajectory import Pose
from tasks.capture.files.unpacked import MAX_FRAMES, is_installed, missing, thinned, unpacked
from tasks.capture.layout import FrameFiles
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.record3d.archive import CODE, FILES, PACKED
from tasks.capture.scan import Scan, ScanFormat, files_named, leaving, license_path, own_file
from tasks.geometry.transforms import OPENGL_TO_OPENCV, Y_UP_TO_Z_UP, pose_from_quaternion_wxyz

METADATA = ("metadata", "metadata.json")
PLACE = "rgbd"

ARCHIVE = ".r3d"
"""Ending of a recording as the app shares it."""

UNPACK = "in its folder: for f in rgbd/*.depth rgbd/*.conf; do lzfse -decode -i $f -o $f.raw && mv $f.raw $f; done"

LEAST_CONFIDENCE = 1
"""Of 0, 1 and 2: what the sensor has no confidence in is no reading."""


def read_record3d(scan: Scan) -> Reading:
    """Frames of color and depth by their numbers, with the poses of the metadata.

    Raises:
        InputError: a file is missing or broken, or depth maps are packed.
    """
    folder = scan.path
    notes: list[str] = []
    if folder.suffix.lower() == ARCHIVE and folder.is_file():
        folder, notes = _opened(own_file(scan, folder.name))
    unpacked_scan = dataclasses.replace(scan, path=folder, places=(*scan.places, folder) if scan.places else ())
    files = {path.relative_to(folder).as_posix(): path for path in _files(unpacked_scan, unpacked_scan.premises)}
    stated = next((files[name] for name in METADATA if name in files), None)
    if stated is None:
        linked = next((folder / name for name in METADATA if (folder / name).is_symlink()), None)
        raise leaving(linked) if linked is not None else InputError(folder.name, METADATA[0], "is missing", "copy it")
    name = name_of(stated, folder)
    document = read_json(stated, name)
    by_number = {ending: _numbered(files, ending) for ending in (".jpg", ".depth", ".conf")}
    numbers = sorted(by_number[".jpg"].keys() & by_number[".depth"].keys())
    if not numbers:
        raise InputError(f"{folder.name}/{PLACE}", "frames", "no image N.jpg has a depth map N.depth", "unzip the .r3d file again")
    frames = [FrameFiles(str(n), by_number[".jpg"][n], by_number[".depth"][n], None) for n in numbers]
    size = one_size([(frame.color, name_of(frame.color, folder)) for frame in frames], "color")
    depth_size = (_count(document, "dw", name), _count(document, "dh", name))
    if depth_size[0] * depth_size[1] > MAX_PIXELS:
        raise InputError(name, "dw", f"is {depth_size[0]} x {depth_size[1]} pixels", "is it the right file?")
    lenses = _lenses(document, name, numbers, size)
    both = [(lens, of_depth(lens, size, depth_size, folder.name)) for lens in lenses]
    place = _decoded(frames, folder) if _is_packed(frames[0].depth, folder) else folder

    def reader(path: Path) -> Callable[[], NDArray[np.float32]]:
        confidence = by_number[".conf"].get(int(path.stem))
        own = (place / path.relative_to(folder), confidence and place / confidence.relative_to(folder))
        return partial(_depth, *own, place, depth_size)

    poses, wrong = _poses(document.get("poses"), name)
    known = [poses[number] if number < len(poses) else None for number in numbers]
    sources, more = frame_sources(frames, folder, size, depth_size, both, 1.0, known, {}, reader)
    statements = Statements(name, name, f"{folder.name}/{PLACE}", "OpenGL", has_quaternions=True, from_file=Y_UP_TO_Z_UP)
    sources, findings = settled(sources, statements)
    license = license_of(license_path(folder, scan.premises))
    return Reading(surface=None, frames=sources, license=license, degradations=(*notes, *wrong, *more, *findings), from_file=Y_UP_TO_Z_UP)


def _opened(path: Path) -> tuple[Path, list[str]]:
    """The unpacked folder of an archive, and a note on frames that are left out.

    Raises:
        InputError: it is not an archive, is larger than the budget, or its depth is packed and LZFSE is not installed.
    """
    if not is_installed("lzfse"):
        raise missing(path.name, "lzfse", "depth", f"rename it to .zip and unzip it, then {UNPACK}")
    check_file(path, path.name, BUDGET.scene_bytes)
    # Messages name the folder of the files: it gets the name of the recording, unless that leads elsewhere.
    title = path.stem if path.stem.strip(".") else FILES
    recording = unpacked(CODE, path, path.name, [title], MAX_FRAMES)
    step, count = int(recording.facts.get("step", 1)), int(recording.facts.get("frames", 0))
    return recording.folder / FILES / title, thinned(path.name, step, count)


def _decoded(frames: Sequence[FrameFiles], folder: Path) -> Path:
    """A folder with the depth and confidence of a recording whose files are packed.

    Raises:
        InputError: LZFSE is not installed, or a file cannot be decoded.
    """
    name = name_of(frames[0].depth or folder, folder)
    if not is_installed("lzfse"):
        raise missing(name, "lzfse", "content", UNPACK)
    return unpacked(CODE, folder, name, [FILES], len(frames)).folder / FILES / FILES


def _is_packed(path: Path | None, folder: Path) -> bool:
    return path is not None and read_bytes(path, name_of(path, folder), MAX_IMAGE_BYTES)[:3] == PACKED


def _depth(path: Path, confidence: Path | None, folder: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """Depth [m] that the sensor has confidence in, shape (height, width), 0 elsewhere."""
    depth = _map(path, folder, size, np.dtype("<f4")).astype(np.float32)
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    if confidence is None:
        return depth
    return np.where(_map(confidence, folder, size, np.dtype("u1")) >= LEAST_CONFIDENCE, depth, np.float32(0))


def _map(path: Path, folder: Path, size: tuple[int, int], kind: np.dtype[Any]) -> NDArray[Any]:
    name = name_of(path, folder)
    data = read_bytes(path, name, MAX_IMAGE_BYTES)
    if len(data) != size[0] * size[1] * kind.itemsize:
        raise InputError(name, "content", f"has {len(data)} bytes, {size[0]} x {size[1]} values expected", "unzip the .r3d file again")
    return np.frombuffer(data, dtype=kind).reshape(size[1], size[0])


def _lenses(document: dict[str, Any], name: str, numbers: Sequence[int], size: tuple[int, int]) -> list[Intrinsics]:
    """Intrinsics of each frame at the images' size [px]: its own where it has some, else those of the recording."""
    usual = focal_and_center(json_floats(document.get("K"), name, "K", 9).reshape(3, 3).T, name, "K")  # column by column
    own = document.get("perFrameIntrinsicCoeffs")
    stated = (_count(document, "w", name), _count(document, "h", name)) if "w" in document and "h" in document else size
    lenses = []
    for number in numbers:
        lens = usual
        if isinstance(own, list) and number < len(own):
            fx, fy, cx, cy = json_floats(own[number], name, f"perFrameIntrinsicCoeffs[{number}]", 4)
            lens = focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), name, f"perFrameIntrinsicCoeffs[{number}]")
        lenses.append(resized_intrinsics(lens, stated, size, name) if stated != size else lens)
    return lenses


def _poses(value: Any, name: str) -> tuple[list[Pose | None], list[str]]:
    """Poses, OpenCV camera to the +Z-up frame, 4x4 [m], and a note on rows that state none.

    The file has qx qy qz qw tx ty tz of an OpenGL camera, +Y up.
    """
    if value is None:
        return [], []
    if not isinstance(value, list):
        raise InputError(name, "poses", "must be a list", "is it the right file?")
    poses: list[Pose | None] = []
    wrong: list[str] = []
    for index, entry in enumerate(value):
        try:
            poses.append(_pose(entry, name, f"poses[{index}]"))
        except InputError as error:
            poses.append(None)
            wrong.append(str(error))
    if not wrong:
        return poses, []
    return poses, [f"{wrong[0]}: {counted(len(wrong), 'frame')} of {len(value)} without a pose"]


def _pose(row: Any, name: str, field: str) -> Pose:
    """Pose of one row.

    Raises:
        InputError: the row is not seven numbers, or its quaternion has another length than 1.
    """
    values = json_floats(row, name, field, 7)
    norm = float(np.linalg.norm(values[:4]))
    if not 0.9 < norm < 1.1:
        raise InputError(name, field, f"has a quaternion of length {norm:.3g}", "export the recording again")
    qx, qy, qz, qw = (float(v) / norm for v in values[:4])
    return Y_UP_TO_Z_UP @ pose_from_quaternion_wxyz((qw, qx, qy, qz), values[4:]) @ OPENGL_TO_OPENCV


def _count(document: dict[str, Any], key: str, name: str) -> int:
    value = document.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 < value < 100_000:
        raise InputError(name, key, "must be a number of pixels", "is it the right file?")
    return value


def _numbered(files: dict[str, Path], ending: str) -> dict[int, Path]:
    """Files of the recording that end so, by their numbers."""
    own = (path for key, path in files.items() if key.startswith(f"{PLACE}/") and path.suffix.lower() == ending)
    return {int(path.stem): path for path in own if re.fullmatch(r"\d{1,9}", path.stem, re.ASCII)}


def _recognize(folder: Path) -> str | None:
    has_metadata = any((folder / name).is_file() or (folder / name).is_symlink() for name in METADATA)
    return folder.name if has_metadata and (folder / PLACE).is_dir() else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    if scan.path.suffix.lower() == ARCHIVE and not scan.path.is_dir():
        return [scan.path] if scan.path.is_file() and premises.admits(scan.path) else []
    folder = scan.folder
    files = [folder / name for name in METADATA]
    if (folder / PLACE).is_dir() and premises.admits(folder / PLACE):
        files += [path for path in sorted((folder / PLACE).iterdir()) if path.suffix.lower() in (".jpg", ".depth", ".conf")]
    return [path for path in files if path.is_file() and premises.admits(path)]


RECORD3D = ScanFormat(
    name="record3d",
    dataset="record3d",
    expected=f"an {ARCHIVE} file, or {METADATA[0]} and {PLACE}/ with N.jpg and N.depth",
    recognize=_recognize,
    is_recorded=lambda folder: _recognize(folder) is not None or bool(files_named(folder, (ARCHIVE,))),
    files=_files,
    read=read_record3d,
    signs=(METADATA[0], f"{PLACE}/*.jpg", f"{PLACE}/*.depth"),
    within=lambda folder: [(path, path.stem) for path in files_named(folder, (ARCHIVE,))],
)
