"""A generated room as somebody films it who walks through it slowly: frame after frame, poses known."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.lifting import DepthView, voxel_first
from tasks.furniture.rooms import furnish
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import inverse
from tasks.scanner import ScannerConfig
from tasks.scanner.route import plan_views, targets_of
from tasks.scanner.scenery import Paint, scenery_of
from tasks.scanner.sensor import depth_camera, shoot

Array = NDArray[np.float64]

STEP_M, STEP_RADIANS = 0.06, math.radians(6)
"""Between two frames: a slow walk at 10 frames a second."""

REFERENCE_M = 0.02
"""Distance of the points that a surface is held against [m]."""


@dataclasses.dataclass(frozen=True)
class RoomFilm:
    """views: Frames with their true poses, world frame, depth with a sensor's noise. surface: What they see, without noise [m], shape
    (n, 3)."""

    views: tuple[DepthView, ...]
    surface: Array

    @property
    def poses(self) -> Array:
        """True poses, camera to world, shape (n, 4, 4) [m]."""
        return np.array([view.pose for view in self.views])

    @property
    def length_m(self) -> float:
        """How far the camera went [m]."""
        return float(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1).sum())


def walk(room_type: str, seed: int, frames: int) -> RoomFilm:
    """The first so many frames of a walk through a furnished room. The same seed walks the same way."""
    rng = np.random.default_rng(seed)
    config = ScannerConfig()
    scenery = scenery_of(furnish(room_type, rng))
    scene = RayScene(scenery.parts)
    targets = targets_of(scenery, config.target_spacing_m, config.target_least, rng)
    poses = _filmed(plan_views(scene, scenery, targets, config, rng), frames)
    paint = Paint(scene)
    views, seen = [], np.empty((0, 3))
    for number, pose in enumerate(poses):
        shot = shoot(scene, paint, pose, pose, config, rng)
        camera = depth_camera(pose, config)
        lens = (camera.fx, camera.fy, camera.cx, camera.cy)
        views.append(DepthView(f"{number:06d}", shot.depth.astype(np.float32) / np.float32(1000), shot.color, lens, pose))
        rays = camera.rays()[::4, ::4].reshape(-1, 6)
        depth = scene.cast(rays)["t_hit"].astype(np.float64)
        near = depth < config.max_range_m
        points = rays[near, :3].astype(np.float64) + depth[near, None] * rays[near, 3:]
        seen = np.concatenate([seen, points])
        seen = seen[voxel_first(seen, REFERENCE_M)]
    return RoomFilm(tuple(views), seen)


def _filmed(views: list[Array], frames: int) -> list[Array]:
    """A camera's way through views, each next one the nearest, in steps of a slow walk; the first so many."""
    left, tour = list(range(1, len(views))), [0]
    while left:
        nearest = min(left, key=lambda index: _effort(views[tour[-1]], views[index]))
        left.remove(nearest)
        tour.append(nearest)
    poses: list[Array] = []
    for first, second in itertools.pairwise(tour):
        poses += _between(views[first], views[second])
        if len(poses) >= frames:
            break
    return poses[:frames]


def _motion(first: Array, second: Array) -> tuple[float, float]:
    """Way [m] and turn [rad] between two poses."""
    step = inverse(first) @ second
    return float(np.linalg.norm(step[:3, 3])), math.acos(float(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1)))


def _effort(first: Array, second: Array) -> float:
    way, turn = _motion(first, second)
    return 1.5 * way + turn


def _between(first: Array, second: Array) -> list[Array]:
    """Poses from one to shortly before another."""
    from scipy.spatial.transform import Rotation, Slerp

    way, turn = _motion(first, second)
    count = max(1, math.ceil(max(way / STEP_M, turn / STEP_RADIANS)))
    turns = Slerp([0, 1], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))
    poses = []
    for share in np.arange(count) / count:
        pose = np.eye(4)
        pose[:3, :3] = turns(share).as_matrix()
        pose[:3, 3] = first[:3, 3] + share * (second[:3, 3] - first[:3, 3])
        poses.append(pose)
    return poses


def drifted(poses: Array, share: float, rng: np.random.Generator) -> Array:
    """Poses, shape (n, 4, 4) [m], as a tracker has them that loses its way steadily: at the end of the walk it is off by a share of it."""
    from scipy.spatial.transform import Rotation

    steps = [inverse(first) @ second for first, second in itertools.pairwise(poses)]
    length = sum(float(np.linalg.norm(step[:3, 3])) for step in steps)
    lean, pull = (rng.normal(size=3) for _ in range(2))
    lean, pull = lean / np.linalg.norm(lean), pull / np.linalg.norm(pull)

    def off(size: float) -> Array:
        poses_off = [poses[0]]
        for step in steps:
            error = np.eye(4)
            way = float(np.linalg.norm(step[:3, 3])) + 0.1 * STEP_M
            error[:3, :3] = Rotation.from_rotvec(lean * size * way * 0.15).as_matrix()
            error[:3, 3] = pull * size * way
            poses_off.append(poses_off[-1] @ step @ error)
        return np.array(poses_off)

    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        end = float(np.linalg.norm(off(middle)[-1, :3, 3] - poses[-1, :3, 3]))
        low, high = (middle, high) if end < share * length else (low, middle)
    return off(low)
