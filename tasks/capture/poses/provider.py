"""Whose poses a scan's frames have: its files', or those that were found from its depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.poses.fit import pose_fit
from tasks.capture.poses.open3d import FoundPoses, Open3DPoses
from tasks.capture.reading import FrameSource, Reading
from tasks.settings import Config, Positive, union_of

Array = NDArray[np.float64]

FILE, REFINED, ESTIMATED = "file", "refined", "estimated"
"""Whose a pose is, as rows say it."""


@dataclasses.dataclass(frozen=True)
class GivenPoses(Config):
    """Those of the scan's files, as they are."""

    kind: ClassVar[str] = "given"


PosesProvider = union_of((GivenPoses, Open3DPoses))
"""Whoever can say where a frame was taken."""


@dataclasses.dataclass(frozen=True)
class PosesConfig(Config):
    """Where poses of frames come from, and when they do not fit."""

    provider: PosesProvider = dataclasses.field(default_factory=GivenPoses)  # type: ignore[valid-type]  # needs nothing besides
    largest_misfit_m: Positive = 0.08  # between frames that see the same surface; a tracker that closes its loops leaves 1 to 6 cm


def with_poses(reading: Reading, config: PosesConfig, name: str) -> tuple[Reading, list[str]]:
    """A scan whose frames have poses that were held against its depth, and notes on what was found.

    With a mesh, poses stay as they are: it was made with them. Without one, frames that have depth get poses from the provider where
    those of the files do not fit, or where there are none; `pose_source` says whose they are.

    Raises:
        InputError: no frame has a pose, and nobody may look for one; or the provider failed.
    """
    usable = [i for i, frame in enumerate(reading.frames) if frame.depth is not None and frame.depth_size is not None]
    is_posed = any(frame.pose is not None for frame in reading.frames)
    if reading.surface is None and len(usable) == 1 and not is_posed:
        return _at_origin(reading, usable[0])
    fit = pose_fit(reading.frames)
    fits = fit.misfit_m <= config.largest_misfit_m
    provider = config.provider
    misfit = f"frames that see the same surface have it {100 * fit.misfit_m:.1f} cm apart, the upper quartile of {fit.pairs} pairs"
    if reading.surface is not None or not usable:
        notes = [] if fits else [f"poses: {misfit}; the scan's mesh stays as it is"]
        return reading, notes
    if isinstance(provider, GivenPoses):
        if not is_posed:
            lost = [note for note in reading.degradations if "without a pose" in note and "(missing)" not in note]
            raise InputError(
                name,
                "poses",
                f"none can be used ({'; '.join(lost)})" if lost else "there are none",
                f"{_WRITE}; or have them found: {_FIND}",
            )
        return reading, [] if fits else [f"poses: {misfit}; refine them: {_FIND}"]
    missing = sum(reading.frames[i].pose is None for i in usable)
    if is_posed and fits and not missing and not provider.always:
        return reading, []
    chosen = [usable[i] for i in np.unique(np.linspace(0, len(usable) - 1, min(provider.max_frames, len(usable))).round().astype(int))]
    frames, result = _found(reading.frames, chosen, provider)
    posed = [i for i in chosen if frames[i].pose is not None]
    if len(posed) < 2:
        raise InputError(name, "poses", "none were found from the depth", "record slowly, so that neighboring frames show the same things")
    notes = [f"poses: {len(posed)} of {len(usable)} frames by {result.line}"]
    after = pose_fit(frames)
    if is_posed:
        if after.misfit_m > fit.misfit_m or len(posed) < sum(reading.frames[i].pose is not None for i in chosen):
            return reading, [f"poses: {misfit}; Open3D found none that fit better"]
        notes[0] += f"; {misfit} before, {100 * after.misfit_m:.1f} cm after"
    elif after.misfit_m > config.largest_misfit_m:
        notes.append(f"poses: frames that see the same surface have it {100 * after.misfit_m:.1f} cm apart still")
    notes += _drift_note(result, [pose for i in posed if (pose := frames[i].pose) is not None])
    return dataclasses.replace(reading, frames=frames), notes


def _at_origin(reading: Reading, index: int) -> tuple[Reading, list[str]]:
    """A scan whose only frame with depth gets the pose that its camera defines: the origin."""
    frames = list(reading.frames)
    frames[index] = dataclasses.replace(frames[index], pose=np.eye(4), pose_source=ESTIMATED)
    line = f"poses: frame {frames[index].frame_id} is the only one with depth and has no pose: its camera is the origin"
    return dataclasses.replace(reading, frames=tuple(frames)), [line]


MIN_KEYS, MIN_LOOPS = 10, 3
"""Key frames and closed loops below which nothing bounds the drift of found poses: a walk around a table has more of both."""

MIN_WAY_M, MIN_TURN_RADIANS = 1.0, 0.8
"""Extent of a camera's positions and turns below which its frames share one view: no loop then corrects their drift."""

_DRIFT = "4 degrees and 13 cm over 50 frames of a real kitchen were measured"


def _drift_note(result: FoundPoses, poses: Sequence[Array]) -> list[str]:
    """A line on found poses whose drift nothing bounds: few key frames or closed loops, or little motion."""
    positions = np.array([pose[:3, 3] for pose in poses])
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    traces = np.array([np.trace(poses[0][:3, :3].T @ pose[:3, :3]) for pose in poses])
    turn = float(np.arccos(np.clip((traces.min() - 1) / 2, -1, 1)))
    reasons = [f"{result.keys} key frames"] if result.keys < MIN_KEYS else []
    reasons += [f"{result.loops} closed loops"] if result.loops < MIN_LOOPS else []
    if extent < MIN_WAY_M and turn < MIN_TURN_RADIANS:
        reasons.append(f"little motion ({extent:.2f} m, {np.degrees(turn):.0f} degrees)")
    if not reasons:
        return []
    line = f"poses: found from {', '.join(reasons)}: they may drift unnoticed ({_DRIFT})"
    return [f"{line}; record more of the room, from all sides, or add poses of a tracker"]


_WRITE = "add pose.txt with one camera-to-world pose a line, or a folder pose"
_FIND = "`make open3d`, then --set capture.poses.provider.kind=open3d"


def _found(frames: Sequence[FrameSource], chosen: Sequence[int], provider: Open3DPoses) -> tuple[tuple[FrameSource, ...], FoundPoses]:
    """All frames, those chosen with the poses that the provider finds, in the frame of those they had, if any; the others without."""
    own = [frames[i] for i in chosen]
    given = np.array([np.full((4, 4), np.nan) if frame.pose is None else frame.pose for frame in own])
    answer = provider.poses_of(own, given)
    poses = answer.poses
    both = np.isfinite(given).all(axis=(1, 2)) & np.isfinite(poses).all(axis=(1, 2))
    if both.sum() >= 1:
        poses = moved_onto(given[both], poses[both]) @ poses
    result = [dataclasses.replace(frame, pose=None, pose_source=None) for frame in frames]
    for index, pose in zip(chosen, poses, strict=True):
        if np.isfinite(pose).all():
            source = ESTIMATED if frames[index].pose is None else REFINED
            result[index] = dataclasses.replace(frames[index], pose=pose, pose_source=source)
    return tuple(result), answer


def moved_onto(given: Array, poses: Array) -> Array:
    """The rigid motion, 4x4 [m], after which poses, shape (n, 4, 4), lie nearest to given ones: the mean of their rotations, then of
    their places."""
    turns = np.einsum("nij,nkj->ik", given[:, :3, :3], poses[:, :3, :3])
    u, _, vt = np.linalg.svd(turns)
    motion = np.eye(4)
    motion[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    motion[:3, 3] = (given[:, :3, 3] - poses[:, :3, 3] @ motion[:3, :3].T).mean(axis=0)
    return motion
