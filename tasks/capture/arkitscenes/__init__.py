"""ARKitScenes: the mesh that ARKit made, low-resolution frames of color and depth with their poses, and labelled boxes.

Written from the public description of the data set, in the layout of its 3DOD part or of its raw one.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from schemas.errors import InputError
from tasks.capture.arkitscenes.boxes import box_groups
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.documents import floats, license_of, name_of, read_text
from tasks.capture.files.frames import frame_sources, one_size
from tasks.capture.files.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from tasks.capture.files.lenses import DEPTH_SCALE, Intrinsics, of_depth, resized_intrinsics
from tasks.capture.files.ply import read_ply
from tasks.capture.files.sens import focal_and_center
from tasks.capture.files.stamps import time_of
from tasks.capture.files.trajectory import Pose, nearest_in_time, numbers
from tasks.capture.layout import FrameFiles, folders_in
from tasks.capture.premises import Premises
from tasks.capture.reading import FrameSource, Reading
from tasks.capture.scan import Scan, ScanFormat, license_path
from tasks.geometry.transforms import inverse, rotation_of

MESH, BOXES = "_3dod_mesh.ply", "_3dod_annotation.json"
COLOR, DEPTH, LENSES, POSES = "lowres_wide", "lowres_depth", "lowres_wide_intrinsics", "lowres_wide.traj"
VISITS = ("metadata.csv", "3dod_train_val_splits.csv", "raw_train_val_splits.csv")
"""Tables of the data set that say which recordings are of one visit to a room."""

NEAR_SECONDS = 0.005
"""Frames and their poses have the same time stamps but for rounding; the set's own tools take poses that are as near as this."""


def read_arkitscenes(scan: Scan) -> Reading:
    """The mesh, the frames, and an instance for each labelled box; without boxes, instances are found in the geometry.

    Raises:
        InputError: there is neither mesh nor frames, or a file is broken.
    """
    folder = scan.path
    files = _files(scan, scan.premises)
    mesh, boxes = (next((path for path in files if path.name.endswith(ending)), None) for ending in (MESH, BOXES))
    frames, notes = _frames(files, folder)
    surface = None
    if mesh is not None:
        ply = read_ply(mesh, name_of(mesh, folder))
        surface = ply.surface
        notes += ply.notes
    poses, lens, scale = (f"{folder.name}/{name}" for name in (POSES, LENSES, DEPTH))
    frames, findings = settled(frames, Statements(poses, lens, scale, "world-to-camera", has_mesh=surface is not None))
    notes += findings
    if surface is None and not frames:
        raise InputError(folder.name, MESH, "there is no mesh and no frame to make one of", "copy the mesh")
    groups = None
    if surface is None:
        notes.append("no mesh in the scan: fused from its frames, instances found in its geometry")
    elif boxes is None:
        notes.append("no annotation in the scan: instances found in its geometry")
    else:
        groups, more = box_groups(boxes, name_of(boxes, folder), surface)
        notes += more
    if not frames:
        notes.append("no frames in the scan: no views, no masks")
    license = license_of(license_path(folder, scan.premises))
    return Reading(surface=surface, groups=groups, frames=frames, license=license, degradations=tuple(notes))


def _frames(files: Iterable[Path], folder: Path) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Color images with the depth image, the intrinsics and the pose of their time."""
    of_place: dict[str, dict[str, Path]] = {COLOR: {}, DEPTH: {}, LENSES: {}}
    for path in files:
        if path.parent.name in of_place:
            of_place[path.parent.name][path.stem] = path
    trajectory = next((path for path in files if path.name == POSES), None)
    colors = [(time, path) for path in of_place[COLOR].values() if (time := time_of(path.stem)) is not None]
    if not colors:
        return (), []
    colors.sort(key=lambda item: (item[0], item[1].name))
    own = [FrameFiles(str(number), path, of_place[DEPTH].get(path.stem), None) for number, (_, path) in enumerate(colors)]
    size = one_size([(frame.color, name_of(frame.color, folder)) for frame in own], "color")
    depths = [(frame.depth, name_of(frame.depth, folder)) for frame in own if frame.depth is not None]
    depth_size = one_size(depths, "depth") if depths else None
    lenses = _lenses([time for time, _ in colors], of_place[LENSES].values(), folder, size)
    poses: list[Pose | None] = [None] * len(own)
    reasons: dict[int, str] = {}
    if trajectory is not None:
        stamps, known = _trajectory(trajectory, name_of(trajectory, folder))
        poses, reasons = nearest_in_time(stamps, known, [time for time, _ in colors], NEAR_SECONDS)
    both = [(lens, of_depth(lens, size, depth_size or size, folder.name)) for lens in lenses]
    return frame_sources(own, folder, size, depth_size, both, DEPTH_SCALE, poses, reasons)


def _lenses(times: list[float], paths: Iterable[Path], folder: Path, size: tuple[int, int]) -> list[Intrinsics]:
    """Intrinsics of each time at the images' size [px]: those that were written for the nearest one."""
    known = sorted((time, path.name, path) for path in paths if (time := time_of(path.stem)) is not None)
    if not known:
        raise InputError(f"{folder.name}/{LENSES}", "folder", "has no .pincam file", "copy the intrinsics of the frames")
    stamps = np.array([time for time, _, _ in known])
    nearest = [int(np.argmin(np.abs(stamps - time))) for time in times]
    read = {index: _pincam(known[index][2], folder, size) for index in sorted(set(nearest))}
    return [read[index] for index in nearest]


def _pincam(path: Path, folder: Path, size: tuple[int, int]) -> Intrinsics:
    name = name_of(path, folder)
    width, height, fx, fy, cx, cy = floats(read_text(path, name), name, "intrinsics", 6)
    lens = focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), name, "intrinsics")
    if not (1 <= width < 1e5 and 1 <= height < 1e5):
        raise InputError(name, "width", f"{width:g} x {height:g} is no size of an image", "copy the file again")
    return resized_intrinsics(lens, (round(width), round(height)), size, name)


def _trajectory(path: Path, name: str) -> tuple[list[float], list[Pose | None]]:
    """Time stamps [s] and poses, OpenCV camera to scan frame, of lines of a stamp, a rotation vector [rad] and a position [m], which
    are from the scan frame to the camera."""
    rows = numbers([words for line in read_text(path, name).splitlines() if (words := line.split())], name)
    if not rows:
        raise InputError(name, "content", "holds no pose", "copy the file again")
    poses: list[Pose | None] = []
    for number, row in enumerate(rows):
        if len(row) != 7:
            raise InputError(name, f"row {number}", f"has {len(row)} numbers, not 7", "is the file cut?")
        pose = np.eye(4)
        if not np.isfinite(row).all() or np.abs(row[1:4]).max() > 1e3:
            poses.append(None)
            continue
        pose[:3, :3], pose[:3, 3] = rotation_of(row[1:4]), row[4:7]
        poses.append(inverse(pose))
    return [row[0] for row in rows], poses


def _room(scan: Scan) -> str | None:
    """The visit that a recording is of, as a table of the data set beside or above it says."""
    for path in (place / name for place in (scan.path, scan.path.parent) for name in VISITS):
        if path.is_file() and scan.premises.admits(path):
            rows = csv.DictReader(io.StringIO(read_text(path, path.name)))
            try:
                visits = {str(row.get("video_id")): str(row.get("visit_id") or "") for row in rows}
            except csv.Error as error:
                raise InputError(path.name, "content", f"is no table ({error})", "copy it again, or take it away") from error
            visit = visits.get(scan.path.name, "")
            return f"visit_{visit.removesuffix('.0')}" if re.fullmatch(r"\d{1,12}(\.0)?", visit, re.ASCII) else None
    return None


def _places(folder: Path) -> list[Path]:
    """Folders that frames may lie in: the scan's own, or `<id>_frames` in it."""
    return [folder, *(path for path in folders_in(folder) if path.name.endswith("_frames"))]


def _is_scan(folder: Path) -> bool:
    names = [path.name for path in folder.iterdir()]
    if any(name.endswith((MESH, BOXES)) and not name.startswith(".") for name in names):
        return True
    return any((place / COLOR).is_dir() and ((place / POSES).exists() or (place / LENSES).is_dir()) for place in _places(folder))


def _files(scan: Scan, premises: Premises) -> list[Path]:
    folder = scan.folder
    files = [path for path in sorted(folder.iterdir()) if path.name.endswith((MESH, BOXES)) and not path.name.startswith(".")]
    for place in _places(folder):
        if not premises.admits(place):
            continue
        files.append(place / POSES)
        for name, endings in ((COLOR, COLOR_SUFFIXES), (DEPTH, DEPTH_SUFFIXES), (LENSES, (".pincam",))):
            if (place / name).is_dir() and premises.admits(place / name):
                files += [path for path in sorted((place / name).iterdir()) if path.suffix.lower() in endings]
    files += [place / name for place in (folder, folder.parent) for name in VISITS]
    return [path for path in files if path.is_file() and premises.admits(path)]


ARKITSCENES = ScanFormat(
    name="arkitscenes",
    dataset="arkitscenes",
    expected=f"<id>{MESH} with <id>{BOXES}, or {COLOR}, {DEPTH}, {LENSES} and {POSES}",
    recognize=lambda folder: folder.name if _is_scan(folder) else None,
    is_recorded=lambda folder: _is_scan(folder) or any(map(_is_scan, folders_in(folder))),
    files=_files,
    read=read_arkitscenes,
    signs=(f"*{MESH}", f"{COLOR}/*.png", f"{DEPTH}/*.png", f"{LENSES}/*.pincam", POSES),
    room_stated=_room,
    shared=True,
)
