"""Instances of single frames without labels against the truth, generated tables and real ones, by this code and by the former one."""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bench.capture.drawn import drawings, read_drawing
from bench.capture.former import FormerScan, former_scans, has_former
from bench.capture.recorded import recorded_view, truth_of_drawing
from bench.capture.tabletops import SUPPORT, TabletopFrame, tabletop_frame
from bench.capture.truth import NOTHING, FrameScore, FrameTruth, frame_score
from bench.goals import goal
from tasks.capture.rooms.alignment import rotation_to_z
from tasks.capture.segmentation.frame import FrameConfig, segmented_frame
from tasks.capture.segmentation.planes import Plane
from tasks.capture.small_objects.lifting import DepthView

Array = NDArray[np.float64]

Code = Literal["before", "now"]

GENERATED = "generated"
"""Name of the frames that were made; real ones have the name of their folder."""

DEPTH_SCALE = 5000.0
"""Units per meter of the depth that is written: tenths of a millimeter and less, 13 m at most."""

NEAR_M = 0.03
"""A pixel is of the vertex of a fused surface that is nearest to it within so much [m]: one and a half of its voxels."""

ROOM = frozenset({"geometry:floor", "geometry:wall", "geometry:ceiling"})
"""Labels of what is part of a room, and of no instance."""

WANTED, WANTED_WELL, WANTED_SECONDS, WANTED_DEGREES, WANTED_M = 0.88, 0.75, 1.0, 1.0, 0.01
"""Of generated frames: F1 at an IoU of 0.5 and of 0.75, seconds a frame, and how far off the plane of the table may be."""


@dataclasses.dataclass(frozen=True)
class FrameFigures:
    """Of some frames, by one code. degrees, off_m: How far the plane of the table is off, at worst; None where it is not known. level:
    Frames in which it is within `WANTED_DEGREES` and `WANTED_M`."""

    material: str
    code: Code
    frames: int
    score: FrameScore
    seconds: float
    level: int | None
    degrees: float | None
    off_m: float | None

    def row(self) -> dict[str, Any]:
        """Figures as plain values."""
        own = {name: getattr(self, name) for name in ("material", "code", "frames", "seconds", "level", "degrees", "off_m")}
        rates = {name: getattr(self.score, name) for name in ("precision", "recall", "f1", "f1_well")}
        return {**own, **dataclasses.asdict(self.score), **rates}


@dataclasses.dataclass(frozen=True)
class KnownFrame:
    """A frame of which is known whose its pixels are. generated: Where it was made; then the plane of its table is known, too."""

    view: DepthView
    truth: FrameTruth
    generated: TabletopFrame | None = None


def frames_report(count: int, seed: int, realdata: Path | None) -> dict[str, Any]:
    """Rows and goals of `count` generated frames, and of real frames over which masks were drawn, where there is a folder of these."""
    made = [tabletop_frame(number, count, seed) for number in range(count)]
    materials = {GENERATED: [KnownFrame(frame.view, truth_of(frame), frame) for frame in made]}
    for drawing in [read_drawing(path) for path in drawings()] if realdata is not None else ():
        assert realdata is not None
        known = KnownFrame(recorded_view(drawing, realdata), truth_of_drawing(drawing))
        materials.setdefault(drawing.frame.split("/")[0], []).append(known)
    figures = []
    for material, frames in materials.items():
        if has_former():
            figures.append(former_figures(material, frames))
        figures.append(own_figures(material, frames))
    return {"rows": [each.row() for each in figures], "goals": frame_goals(figures)}


def truth_of(frame: TabletopFrame) -> FrameTruth:
    """A generated frame's truth: objects, then the table's top."""
    count = len(frame.words)
    return FrameTruth(np.where(frame.owner == SUPPORT, count, np.maximum(frame.owner, NOTHING)), frozenset({count}))


def own_figures(material: str, frames: Sequence[KnownFrame]) -> FrameFigures:
    """What this code finds in each frame by itself, its pose unknown."""
    segmented_frame(frames[0].view, FrameConfig())  # compiles
    segments, seconds = [], []
    for frame in frames:
        clock = time.process_time()
        segments.append(segmented_frame(frame.view, FrameConfig()))
        seconds.append(time.process_time() - clock)
    poses = [np.eye(4) if each.support is None else pose_over(each.support) for each in segments]
    return figures_of(material, "now", frames, [each.region for each in segments], poses, seconds)


def pose_over(plane: Plane) -> Array:
    """The pose in which a plane lies at z = 0, 4x4 [m]."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_to_z(plane.normal)
    pose[2, 3] = plane.offset
    return pose


def former_figures(material: str, frames: Sequence[KnownFrame]) -> FrameFigures:
    """What the former code finds, each frame a scan of its own."""
    with tempfile.TemporaryDirectory() as name:
        workspace = Path(name)
        scans = [write_scan(workspace / "scans" / f"frame_{number:03d}", [frame.view]) for number, frame in enumerate(frames)]
        segments = former_scans(scans, workspace)
    regions = [former_regions(frame.view, scan) for frame, scan in zip(frames, segments, strict=True)]
    return figures_of(material, "before", frames, regions, [scan.pose for scan in segments], [scan.seconds for scan in segments])


def figures_of(
    material: str, code: Code, frames: Sequence[KnownFrame], regions: Sequence[NDArray[np.int64]], poses: Sequence[Array],
    seconds: Sequence[float],
) -> FrameFigures:  # fmt: skip
    """Figures of all frames together; the time is the median of a processor's. poses: Camera to what is taken for the world, 4x4 [m]."""
    scores = [frame_score(frame.truth, segments, frame.view.depth > 0) for frame, segments in zip(frames, regions, strict=True)]
    whole, median = sum(scores, FrameScore()), float(np.median(seconds))
    planes = [plane_error(frame.generated, pose) for frame, pose in zip(frames, poses, strict=True) if frame.generated is not None]
    if not planes:
        return FrameFigures(material, code, len(frames), whole, median, None, None, None)
    degrees, off = np.degrees([angle for angle, _ in planes]), np.array([off for _, off in planes])
    level = int(((degrees <= WANTED_DEGREES) & (off <= WANTED_M)).sum())
    return FrameFigures(material, code, len(frames), whole, median, level, float(degrees.max()), float(off.max()))


def former_regions(view: DepthView, scan: FormerScan) -> NDArray[np.int64]:
    """Region of each pixel, shape (h, w), -1 for none and for what is part of a room."""
    from scipy.spatial import cKDTree

    region = np.full(view.depth.shape, -1, dtype=np.int64)
    if not len(scan.vertices):
        return region
    seen = view.depth > 0
    points = dataclasses.replace(view, pose=np.eye(4)).points()[seen]
    distance, nearest = cKDTree(scan.vertices).query(points, distance_upper_bound=NEAR_M)
    owner = np.where(np.isfinite(distance), scan.owner[np.minimum(nearest, len(scan.owner) - 1)], -1)
    is_room = np.array([label in ROOM for label in scan.labels] + [True])
    region[seen] = np.where(is_room[owner], -1, owner)
    return region


def plane_error(frame: TabletopFrame, pose: Array) -> tuple[float, float]:
    """How far the horizontal of a scan that has the camera at its origin is off [rad], and the level nearest to the table's top [m].

    pose: Scan frame to world frame, 4x4 [m].
    """
    up = frame.view.pose[2, :3]
    angle = math.acos(float(np.clip(pose[2, :3] @ up, -1.0, 1.0)))
    top = dataclasses.replace(frame.view, pose=pose).points()[(frame.owner == SUPPORT) & (frame.view.depth > 0)]
    height = float(np.median(top[:, 2])) if len(top) else math.inf
    return angle, min(abs(height), abs(height - frame.height_m))


def write_scan(folder: Path, views: Sequence[DepthView]) -> Path:
    """Frames as a folder of posed frames; each has its camera at the origin where there is but one."""
    from PIL import Image

    from tasks.geometry.transforms import quaternion_xyzw

    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    lines = []
    for number, view in enumerate(views, start=1):
        pose = view.pose if len(views) > 1 else np.eye(4)
        Image.fromarray(view.color).save(folder / "color" / f"{number}.png")
        units = np.round(view.depth.astype(np.float64) * DEPTH_SCALE)
        Image.fromarray(np.where(units <= 65535, units, 0).astype(np.uint16)).save(folder / "depth" / f"{number}.png")
        lines.append(" ".join(f"{value:.9f}" for value in (*pose[:3, 3], *quaternion_xyzw(pose))))
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    lens = dict(zip(("fx", "fy", "cx", "cy"), views[0].intrinsics, strict=True))
    height, width = views[0].depth.shape
    (folder / "intrinsics.json").write_text(json.dumps({**lens, "width": width, "height": height, "depth_scale": DEPTH_SCALE}))
    return folder


def frame_goals(figures: Sequence[FrameFigures]) -> list[dict[str, Any]]:
    """What this code is held against; the former one only stands beside it."""
    goals = []
    for each in figures:
        if each.code != "now" or each.level is None:
            continue
        goals.append(goal(f"{each.material}: F1 at IoU 0.5", round(each.score.f1, 4), ">=", WANTED))
        goals.append(goal(f"{each.material}: F1 at IoU 0.75", round(each.score.f1_well, 4), ">=", WANTED_WELL))
        goals.append(goal(f"{each.material}: seconds of a processor a frame", round(each.seconds, 3), "<=", WANTED_SECONDS))
        goals.append(goal(f"{each.material}: frames whose table is level to 1 degree and 1 cm", each.level, ">=", each.frames))
    return goals
