"""How well poses are found and mended: of walks whose poses are withheld, or drift."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bench.capture.frames import write_scan
from bench.capture.walks import RoomFilm, drifted, walk
from bench.goals import goal
from schemas.errors import InputError
from tasks.capture.formats import find_scans
from tasks.capture.fusion import FusionConfig, fused_surface
from tasks.capture.leveling import read_scan
from tasks.capture.poses.fit import pose_fit
from tasks.capture.poses.open3d import Open3DPoses
from tasks.capture.poses.provider import PosesConfig, moved_onto, with_poses
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import transform_points

Array = NDArray[np.float64]

Given = Literal["true", "drifted", "withheld"]

DRIFT = 0.03
"""Of the way, at its end."""

WANTED = 0.9
"""Of the F-score that true poses give."""

NEAR_M = 0.05
"""Points that are so near are the same surface [m]."""


@dataclasses.dataclass(frozen=True)
class PoseFigures:
    """Of one walk. given: Which poses the scan has. posed: Frames with a pose afterwards. before_m, after_m: Error of the camera's places
    after the best rigid motion, root of the mean square [m]; n/a (None) where there are no poses. misfit_m: As `pose_fit` says it
    afterwards. f_score: Of the fused surface at `NEAR_M`; true_f_score: with true poses."""

    room: str
    seed: int
    given: Given
    frames: int
    way_m: float
    posed: int
    before_m: float | None
    after_m: float
    misfit_m: float
    f_before: float | None
    f_score: float
    true_f_score: float
    seconds: float


def measured(room: str, seed: int, frames: int, provider: Open3DPoses) -> list[PoseFigures]:
    """Figures of a walk, its poses withheld, and drifted.

    Raises:
        InputError: Open3D cannot be run.
    """
    filmed = walk(room, seed, frames)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        sources = _sources(filmed, filmed.poses, Path(name) / "true")
        best = _f_score(filmed, sources, filmed.poses)
        given: Given
        for given in ("withheld", "drifted"):
            poses = None if given == "withheld" else drifted(filmed.poses, DRIFT, np.random.default_rng([seed, 3]))
            sources = _sources(filmed, poses, Path(name) / given)
            started = time.perf_counter()
            reading, _ = with_poses(_reading(Path(name) / given), PosesConfig(provider), given)
            seconds = time.perf_counter() - started
            estimate = np.array([np.full((4, 4), np.nan) if frame.pose is None else frame.pose for frame in reading.frames])
            is_posed = np.isfinite(estimate).all(axis=(1, 2))
            rows.append(
                PoseFigures(
                    room, seed, given, len(estimate), filmed.length_m, int(is_posed.sum()),
                    None if poses is None else error_m(filmed.poses, poses), error_m(filmed.poses[is_posed], estimate[is_posed]),
                    pose_fit(reading.frames).misfit_m, None if poses is None else _f_score(filmed, sources, poses),
                    _f_score(filmed, reading.frames, estimate), best, seconds,
                )
            )  # fmt: skip
    return rows


def _reading(folder: Path) -> Any:
    (scan,), errors = find_scans(folder)
    assert not errors
    return read_scan(scan)


def _sources(filmed: RoomFilm, poses: Array | None, folder: Path) -> tuple[FrameSource, ...]:
    """Frames of a walk as a folder has them, with these poses or none."""
    own = filmed.poses if poses is None else poses
    write_scan(folder, [dataclasses.replace(view, pose=pose) for view, pose in zip(filmed.views, own, strict=True)])
    if poses is None:
        (folder / "pose.txt").unlink()
    frames: tuple[FrameSource, ...] = _reading(folder).frames
    return frames


def error_m(true: Array, estimate: Array) -> float:
    """Root of the mean square distance of camera places, shapes (n, 4, 4), after the rigid motion that makes it least [m]."""
    a, b = true[:, :3, 3], estimate[:, :3, 3]
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.sqrt((((b - b.mean(0)) @ turn.T - (a - a.mean(0))) ** 2).sum(axis=1).mean()))


def _f_score(filmed: RoomFilm, frames: Sequence[FrameSource], poses: Array) -> float:
    """F-score of the surface that frames fuse to, moved to where its cameras should be, against what they saw."""
    from scipy.spatial import cKDTree

    surface, _ = fused_surface(frames, FusionConfig(), "walk")
    posed = np.isfinite(poses).all(axis=(1, 2))
    points = transform_points(surface.vertices, moved_onto(filmed.poses[posed], poses[posed]))
    accuracy = float((cKDTree(filmed.surface).query(points)[0] < NEAR_M).mean())
    completeness = float((cKDTree(points).query(filmed.surface)[0] < NEAR_M).mean())
    return 2 * accuracy * completeness / max(accuracy + completeness, 1e-9)


def poses_report(walks: int, frames: int, seed: int, python: str) -> dict[str, Any]:
    """Figures and goals of some walks; a line in their place where Open3D is not there."""
    provider, rooms = Open3DPoses(python=python, always=True), ("bedroom", "living room", "office")
    figures: list[PoseFigures] = []
    try:
        for number in range(walks):
            figures += measured(rooms[number % len(rooms)], seed + number, frames, provider)
    except InputError as error:
        return {"rows": [], "note": str(error), "goals": [goal("poses: measured with Open3D", 0, ">=", 1)]}
    goals = []
    for given in ("withheld", "drifted"):
        own = [each for each in figures if each.given == given]
        ratio = float(np.mean([each.f_score / each.true_f_score for each in own]))
        goals.append(goal(f"poses {given}: F-score of the fused surface by that with true poses", round(ratio, 4), ">=", WANTED))
    return {"rows": [dataclasses.asdict(each) for each in figures], "note": "", "goals": goals}
