"""Posed frames of a scan, from exported folders or from a `.sens` container."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.consistency.findings import Statements
from tasks.capture.files.documents import name_of, read_json, read_text
from tasks.capture.files.images import DEPTH_SUFFIXES, has_float_depth, image_size, read_color, read_depth
from tasks.capture.files.lenses import DEPTH_SCALE, Intrinsics, color_intrinsics, depth_intrinsics
from tasks.capture.files.sens import open_sens
from tasks.capture.files.trajectory import as_described, numbers, read_trajectory, rigid_reading, rows_of
from tasks.capture.layout import FrameFiles, FrameLayout, frame_ids
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import MIRRORED_Y, is_rigid, nearest_rigid

_POSE_TOLERANCE = 2e-2
"""Trackers write float32 rotations that have drifted a little from orthogonal; beyond this a pose is broken."""

_MAX_POSITION_M = 10_000.0


def exported_frames(layout: FrameLayout, folder: Path, stated: dict[str, str]) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames of color, depth and pose files. `stated`: the scan's metadata, for intrinsics that have no file of their own.

    A pose that is missing or unreadable leaves its frame without one, and a note.

    Raises:
        InputError: images of different sizes, no intrinsics, depth that is not read, or a trajectory that cannot be read.
    """
    sizes = one_size([(f.color, name_of(f.color, folder)) for f in layout.frames], "color")
    depths = [(f.depth, name_of(f.depth, folder)) for f in layout.frames if f.depth is not None]
    if not depths and layout.unpaired:
        first, other = (name_of(path, folder) for path in (layout.frames[0].color, layout.unpaired[0]))
        problem = f"none of {len(layout.unpaired)} files is the depth of one of {len(layout.frames)} color images, as {first}"
        remedy = f"name depth as color, and write it as 16-bit PNG: {', '.join(DEPTH_SUFFIXES)} are read"
        raise InputError(other, "depth", problem, remedy)
    depth_size = one_size(depths, "depth") if depths else None
    usual = 1.0 if depths and has_float_depth(*depths[0]) else DEPTH_SCALE
    lens, scale = color_intrinsics(layout, folder, stated, sizes, usual)
    depth_lens = depth_intrinsics(layout, folder, stated, lens, sizes, depth_size or sizes)
    notes = _unpaired(layout)
    described = pose_format(layout, folder)
    if layout.trajectory is not None:
        keys = [f.key for f in layout.frames]
        poses, reasons = read_trajectory(layout.trajectory, name_of(layout.trajectory, folder), keys, described, notes)
    else:
        poses, reasons = _pose_files(layout.frames, folder, described, notes)
    lenses = [(lens, depth_lens)] * len(layout.frames)
    frames, more = frame_sources(layout.frames, folder, sizes, depth_size, lenses, scale, poses, reasons)
    return frames, notes + more


def _unpaired(layout: FrameLayout) -> list[str]:
    """A line on files of depth that no color image belongs to."""
    names = [path.name for path in layout.unpaired]
    return [f"{len(names)} files of depth have no color image, or are not read: left out: {_listed(names)}"] if names else []


def frame_sources(
    files: Sequence[FrameFiles], folder: Path, size: tuple[int, int], depth_size: tuple[int, int] | None,
    lenses: Sequence[tuple[Intrinsics, Intrinsics]], scale: float, poses: Sequence[NDArray[np.float64] | None], reasons: dict[int, str],
    depth: Callable[[Path], Callable[[], NDArray[np.float32]]] | None = None,
) -> tuple[tuple[FrameSource, ...], list[str]]:  # fmt: skip
    """Frames whose color and depth are files of a scan's folder, and notes on those without a usable pose or depth.

    size, depth_size: Width and height of all images [px]. lenses: Intrinsics of color and depth of each frame [px]. scale: Units of
    the depth images per metre. poses: OpenCV camera to scan frame, 4x4 [m], None where missing. reasons: Why, by frame, where it is
    more than missing. depth: What reads a depth file, where it is no image.
    """
    ids = frame_ids(f.key for f in files)
    checked, notes = checked_poses(ids, poses, reasons)
    blind = [frame_id for frame, frame_id in zip(files, ids, strict=True) if frame.depth is None]
    if 0 < len(blind) < len(ids):
        notes.append(f"{len(blind)} of {len(ids)} color images have no depth image: {_listed(blind)}")
    frames = []
    for frame, frame_id, pose, (lens, depth_lens) in zip(files, ids, checked, lenses, strict=True):
        read: Callable[[], NDArray[np.float32]] | None = None
        if frame.depth is not None and depth_size is not None:
            name = name_of(frame.depth, folder)
            read = partial(read_depth, frame.depth, name, depth_size, scale) if depth is None else depth(frame.depth)
        frames.append(
            FrameSource(
                frame_id=frame_id,
                color_file=_below(frame.color, folder),
                depth_file=_below(frame.depth, folder) if frame.depth is not None else None,
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


def _below(path: Path, folder: Path) -> str:
    """A file's path from its folder, or its name if it was unpacked elsewhere."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


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
        mirrored = pose @ MIRRORED_Y
        return "mirrored: left-handed axes" if is_rigid(mirrored, _POSE_TOLERANCE) else "no rotation and translation"
    return "beyond 10 km" if np.abs(pose[:3, 3]).max() > _MAX_POSITION_M else ""


def _pose_files(
    frames: Sequence[FrameFiles], folder: Path, described: str, notes: list[str]
) -> tuple[list[NDArray[np.float64] | None], dict[int, str]]:
    """Poses of files with the 12 or 16 numbers of a matrix each, and the reasons of frames without one. notes: added to."""
    matrices: dict[int, list[float]] = {}
    reasons: dict[int, str] = {}
    for index, frame in enumerate(frames):
        if frame.pose is None:
            continue
        name = name_of(frame.pose, folder)
        try:
            values = [value for row in numbers(rows_of(read_text(frame.pose, name))[0], name) for value in row]
        except InputError as error:
            reasons[index] = error.problem
            continue
        if len(values) in (12, 16):
            matrices[index] = values
        else:
            reasons[index] = f"must have 12 or 16 numbers, has {len(values)}"
    poses: list[NDArray[np.float64] | None] = [None] * len(frames)
    read, note = rigid_reading(list(matrices.values()), "poses")
    for index, pose in zip(matrices, read, strict=True):
        poses[index] = as_described(pose, described)
    notes += [note] if note else []
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


def frame_statements(layout: FrameLayout, folder: Path, is_open: bool, has_mesh: bool = False) -> Statements:
    """Files that state the facts of exported frames. is_open: depth may choose a convention of poses that no file states."""
    described = pose_format(layout, folder)
    pose = layout.trajectory or next((frame.pose for frame in layout.frames if frame.pose is not None), None)
    lens = layout.color_intrinsics or layout.depth_intrinsics
    scale = folder.name if lens is None or lens.suffix != ".json" else name_of(lens, folder)
    return Statements(
        poses=folder.name if pose is None else name_of(pose if pose == layout.trajectory else pose.parent, folder),
        lens=folder.name if lens is None else name_of(lens, folder),
        scale=scale,
        described=described,
        is_open=is_open and not described,
        has_quaternions=layout.trajectory is not None,
        has_mesh=has_mesh,
    )


def pose_format(layout: FrameLayout, folder: Path) -> str:
    """What the scan says about its poses (`pose_format` of intrinsics.json), '' when nothing."""
    path = layout.color_intrinsics
    if path is None or path.suffix != ".json":
        return ""
    described = read_json(path, name_of(path, folder)).get("pose_format", "")
    return described if isinstance(described, str) else ""


def _listed(frames: list[str]) -> str:
    return ", ".join(frames[:10]) + (f" and {len(frames) - 10} more" if len(frames) > 10 else "")
