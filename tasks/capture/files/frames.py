"""Posed frames of a scan, from exported folders or from a `.sens` container."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import floats, name_of, read_json, read_text
from tasks.capture.files.images import image_size, read_color, read_depth
from tasks.capture.files.sens import focal_and_center, open_sens
from tasks.capture.files.trajectory import as_described, read_trajectory
from tasks.capture.layout import FrameFiles, FrameLayout, frame_ids
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import is_rigid, nearest_rigid

Intrinsics = tuple[float, float, float, float]

DEPTH_SCALE = 1000.0
"""Depth images hold millimetres unless the scan says otherwise: what ScanNet, Kinect and RealSense exporters write."""

_POSE_TOLERANCE = 2e-2
"""Trackers write float32 rotations that have drifted a little from orthogonal; beyond this a pose is broken."""

_MAX_POSITION_M = 10_000.0


def exported_frames(
    layout: FrameLayout, folder: Path, stated: dict[str, str], convention: str = ""
) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames of color, depth and pose files. `stated`: the scan's metadata, for intrinsics that have no file of their own.
    `convention`: What is known about its poses besides what the scan says, see `trajectory`.

    A pose that is missing or unreadable leaves its frame without one, and a note.

    Raises:
        InputError: images of different sizes, no intrinsics, or a trajectory that cannot be read.
    """
    sizes = one_size([(f.color, name_of(f.color, folder)) for f in layout.frames], "color")
    depths = [(f.depth, name_of(f.depth, folder)) for f in layout.frames if f.depth is not None]
    depth_size = one_size(depths, "depth") if depths else None
    color_intrinsics, scale = _color_intrinsics(layout, folder, stated, sizes)
    depth_intrinsics = _depth_intrinsics(layout, folder, stated, color_intrinsics, sizes, depth_size or sizes)
    described = f"{pose_format(layout, folder)} {convention}"
    if layout.trajectory is not None:
        poses, reasons = read_trajectory(layout.trajectory, name_of(layout.trajectory, folder), [f.key for f in layout.frames], described)
    else:
        poses, reasons = _pose_files(layout.frames, folder, described)
    lenses = [(color_intrinsics, depth_intrinsics)] * len(layout.frames)
    return frame_sources(layout.frames, folder, sizes, depth_size, lenses, scale, poses, reasons)


def frame_sources(
    files: Sequence[FrameFiles], folder: Path, size: tuple[int, int], depth_size: tuple[int, int] | None,
    lenses: Sequence[tuple[Intrinsics, Intrinsics]], scale: float, poses: Sequence[NDArray[np.float64] | None], reasons: dict[int, str],
    depth: Callable[[Path], Callable[[], NDArray[np.float32]]] | None = None,
) -> tuple[tuple[FrameSource, ...], list[str]]:  # fmt: skip
    """Frames whose color and depth are files of a scan's folder, and a note on those without a usable pose.

    size, depth_size: Width and height of all images [px]. lenses: Intrinsics of color and depth of each frame [px]. scale: Units of
    the depth images per metre. poses: OpenCV camera to scan frame, 4x4 [m], None where missing. reasons: Why, by frame, where it is
    more than missing. depth: What reads a depth file, where it is no image.
    """
    ids = frame_ids(f.key for f in files)
    checked, notes = checked_poses(ids, poses, reasons)
    frames = []
    for frame, frame_id, pose, (lens, depth_lens) in zip(files, ids, checked, lenses, strict=True):
        read: Callable[[], NDArray[np.float32]] | None = None
        if frame.depth is not None and depth_size is not None:
            name = name_of(frame.depth, folder)
            read = partial(read_depth, frame.depth, name, depth_size, scale) if depth is None else depth(frame.depth)
        frames.append(
            FrameSource(
                frame_id=frame_id,
                color_file=frame.color.relative_to(folder).as_posix(),
                depth_file=frame.depth.relative_to(folder).as_posix() if frame.depth is not None else None,
                width=size[0],
                height=size[1],
                intrinsics=lens,
                depth_size=depth_size,
                depth_intrinsics=depth_lens,
                depth_scale=scale,
                pose=pose,
                color=partial(read_color, frame.color, name_of(frame.color, folder), size),
                depth=read,
            )
        )
    return tuple(frames), notes


def sens_frames(path: Path, folder: Path) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames of a `.sens` container, and a note on those without a usable pose; raises InputError when it is cut."""
    name = name_of(path, folder)
    container = open_sens(path, name)
    if not container.frames:
        return (), [f"{name}: holds no frames"]
    ids = frame_ids(str(index) for index in range(len(container.frames)))
    poses, notes = checked_poses(ids, [frame.pose for frame in container.frames], {})
    width, height = container.color_size
    frames = tuple(
        FrameSource(
            frame_id=frame_id,
            color_file=f"{path.name}#{index}",
            depth_file=f"{path.name}#{index}",
            width=width,
            height=height,
            intrinsics=container.color_intrinsics,
            depth_size=container.depth_size,
            depth_intrinsics=container.depth_intrinsics,
            depth_scale=container.depth_scale,
            pose=pose,
            color=partial(container.color, index),
            depth=partial(container.depth, index),
        )
        for index, (frame_id, pose) in enumerate(zip(ids, poses, strict=True))
    )
    return frames, notes


def checked_poses(
    ids: Sequence[str], poses: Sequence[NDArray[np.float64] | None], reasons: dict[int, str]
) -> tuple[list[NDArray[np.float64] | None], list[str]]:
    """Poses made exactly rigid, None where unusable, and one note per reason with the frames it holds for."""
    checked: list[NDArray[np.float64] | None] = []
    kept: dict[str, list[str]] = {}
    for index, (frame_id, pose) in enumerate(zip(ids, poses, strict=True)):
        reason = reasons.get(index) or _unusable(pose)
        checked.append(None if reason or pose is None else nearest_rigid(pose))
        if reason:
            kept.setdefault(reason, []).append(frame_id)
    notes = [f"{len(frames)} of {len(ids)} frames without a pose ({reason}): {_listed(frames)}" for reason, frames in sorted(kept.items())]
    return checked, notes


def _unusable(pose: NDArray[np.float64] | None) -> str:
    """Why a pose cannot be used, '' when it can."""
    if pose is None:
        return "missing"
    if np.isneginf(pose).any():
        return "-inf"
    if not np.isfinite(pose).all():
        return "not finite"
    if not is_rigid(pose, _POSE_TOLERANCE):
        return "no rotation and translation"
    return "beyond 10 km" if np.abs(pose[:3, 3]).max() > _MAX_POSITION_M else ""


def _pose_files(frames: Sequence[FrameFiles], folder: Path, described: str) -> tuple[list[NDArray[np.float64] | None], dict[int, str]]:
    poses: list[NDArray[np.float64] | None] = []
    reasons: dict[int, str] = {}
    for index, frame in enumerate(frames):
        poses.append(None)
        if frame.pose is None:
            continue
        name = name_of(frame.pose, folder)
        try:
            poses[-1] = as_described(floats(read_text(frame.pose, name), name, "pose", 16).reshape(4, 4), described)
        except InputError as error:
            reasons[index] = error.problem
    return poses, reasons


def one_size(images: Iterable[tuple[Path, str]], field: str) -> tuple[int, int]:
    """The size that all images have; the most frequent one is taken for the right one."""
    sizes = [(image_size(path, name), name) for path, name in images]
    expected = max(sorted(Counter(size for size, _ in sizes).items()), key=lambda item: item[1])[0]
    for size, name in sizes:
        if size != expected:
            problem = f"is {size[0]} x {size[1]} pixels, the other frames have {expected[0]} x {expected[1]}"
            raise InputError(name, field, problem, "export all frames at one size")
    return expected


def _color_intrinsics(layout: FrameLayout, folder: Path, stated: dict[str, str], size: tuple[int, int]) -> tuple[Intrinsics, float]:
    """Color intrinsics at the images' own size [px], and depth units per metre."""
    path = layout.color_intrinsics
    if path is not None:
        return intrinsics_file(path, folder, size, DEPTH_SCALE, _stated_size(stated, "color"))
    values = _stated_intrinsics(stated, "color", folder)
    if values is None:
        remedy = "write intrinsics.json with fx, fy, cx, cy, width, height, depth_scale"
        raise InputError(folder.name, "intrinsics", "the scan states none", remedy)
    return _scaled_to_fit(values, _stated_size(stated, "color"), size), DEPTH_SCALE


def intrinsics_file(
    path: Path, folder: Path, size: tuple[int, int], scale: float, stated: tuple[int, int] | None = None
) -> tuple[Intrinsics, float]:
    """Intrinsics that a file states, at the images' own `size` [px], and depth units per metre, which are `scale` unless it says so.
    stated: Size that the intrinsics are for, where that is known.

    Raises:
        InputError: it states none.
    """
    name = name_of(path, folder)
    if path.suffix == ".json":
        return _json_intrinsics(read_json(path, name), name, size, scale)
    return _scaled_to_fit(matrix_intrinsics(read_text(path, name), name), stated, size), scale


def _depth_intrinsics(
    layout: FrameLayout, folder: Path, stated: dict[str, str], color: Intrinsics, color_size: tuple[int, int], size: tuple[int, int]
) -> Intrinsics:
    if layout.depth_intrinsics is not None:
        name = name_of(layout.depth_intrinsics, folder)
        values = matrix_intrinsics(read_text(layout.depth_intrinsics, name), name)
        return _scaled_to_fit(values, _stated_size(stated, "depth"), size)
    if (intrinsics := _stated_intrinsics(stated, "depth", folder)) is not None:
        return _scaled_to_fit(intrinsics, _stated_size(stated, "depth"), size)
    return scaled_intrinsics(color, color_size, size)


def scaled_intrinsics(values: Intrinsics, size: tuple[int, int], target: tuple[int, int]) -> Intrinsics:
    """Intrinsics of an image of `size` resized to `target`, both (width, height) [px]; pixel centers are integers."""
    kx, ky = target[0] / size[0], target[1] / size[1]
    fx, fy, cx, cy = values
    return fx * kx, fy * ky, (cx + 0.5) * kx - 0.5, (cy + 0.5) * ky - 0.5


def _scaled_to_fit(values: Intrinsics, stated: tuple[int, int] | None, size: tuple[int, int]) -> Intrinsics:
    """Intrinsics of the camera brought to the exported size, where images were shrunk and intrinsics were not."""
    centered = 0.25 * size[0] <= values[2] <= 0.75 * size[0]
    return values if centered or stated is None else scaled_intrinsics(values, stated, size)


def matrix_intrinsics(text: str, name: str) -> Intrinsics:
    """fx, fy, cx, cy [px] from a text: a 3x3 or 4x4 matrix, or the four numbers; raises InputError."""
    count = len(text.replace(",", " ").split())
    if count == 4:
        fx, fy, cx, cy = floats(text, name, "intrinsics", 4)
        return focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), name, "intrinsics")
    side = 3 if count == 9 else 4
    return focal_and_center(floats(text, name, "intrinsics", side * side).reshape(side, side), name, "intrinsics")


def _json_intrinsics(document: dict[str, object], name: str, size: tuple[int, int], usual: float) -> tuple[Intrinsics, float]:
    """Intrinsics as fx, fy, cx, cy, or as Open3D's column-wise `intrinsic_matrix`; and `depth_scale`."""
    listed = document.get("intrinsic_matrix")
    if isinstance(listed, list) and len(listed) == 9 and all(isinstance(v, int | float) for v in listed):
        matrix = np.array(listed, dtype=np.float64).reshape(3, 3).T
    else:
        fx, fy, cx, cy = (_number(document.get(key), name, key) for key in ("fx", "fy", "cx", "cy"))
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    values = focal_and_center(matrix, name, "intrinsics")
    scale = _number(document.get("depth_scale", usual), name, "depth_scale")
    if not 1 <= scale <= 1e6:
        raise InputError(name, "depth_scale", f"is {scale:g}, must be 1 to 1,000,000 units per metre", "1000 for millimetres")
    if "width" in document and "height" in document:
        stated = (round(_number(document["width"], name, "width")), round(_number(document["height"], name, "height")))
        if min(stated) > 0 and stated != size:
            values = scaled_intrinsics(values, stated, size)
    return values, scale


def _number(value: object, name: str, field: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e9:
        raise InputError(name, field, f"must be a number, is {json.dumps(value, default=str)[:40]}", "write it in pixels")
    return float(value)


def _stated_intrinsics(stated: dict[str, str], camera: str, folder: Path) -> Intrinsics | None:
    keys = [f"{key}_{camera}" for key in ("fx", "fy", "mx", "my")]
    if not all(key in stated for key in keys):
        return None
    fx, fy, cx, cy = (float(floats(stated[key], folder.name, key, 1)[0]) for key in keys)
    return focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), folder.name, f"fx_{camera}")


def _stated_size(stated: dict[str, str], camera: str) -> tuple[int, int] | None:
    width, height = stated.get(f"{camera}Width", ""), stated.get(f"{camera}Height", "")
    if not (width.isascii() and height.isascii() and width.isdigit() and height.isdigit() and len(width) < 6 and len(height) < 6):
        return None
    return (int(width), int(height)) if int(width) and int(height) else None


def pose_format(layout: FrameLayout, folder: Path) -> str:
    """What the scan says about its poses (`pose_format` of intrinsics.json), '' when nothing."""
    path = layout.color_intrinsics
    if path is None or path.suffix != ".json":
        return ""
    described = read_json(path, name_of(path, folder)).get("pose_format", "")
    return described if isinstance(described, str) else ""


def _listed(frames: list[str]) -> str:
    return ", ".join(frames[:10]) + (f" and {len(frames) - 10} more" if len(frames) > 10 else "")
