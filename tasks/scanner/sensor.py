"""What a depth sensor makes of the truth: noise, lost pixels, millimetres; and what tracking makes of the pose."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.rendering import Camera, RayScene
from tasks.scanner.config import ScannerConfig


@dataclasses.dataclass(frozen=True)
class Shot:
    """One frame: color (h, w, 3) uint8, depth (h/2, w/2) uint16 [mm], true and tracked camera-to-world pose (OpenCV)."""

    color: NDArray[np.uint8]
    depth: NDArray[np.uint16]
    true_pose: NDArray[np.float64]
    pose: NDArray[np.float64]


def camera_at(pose: NDArray[np.float64], config: ScannerConfig) -> Camera:
    """The color camera at a pose."""
    return Camera.with_fov(pose, *config.color_size, config.horizontal_fov_radians)


def drifted(poses: list[NDArray[np.float64]], config: ScannerConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Poses as tracking gives them: an error that wanders slowly and is pulled back (a loop closes again)."""
    from scipy.spatial.transform import Rotation

    error, stay, tracked = np.zeros(6), 0.9, []
    spread = np.array([config.drift_m] * 3 + [config.drift_radians] * 3)
    for pose in poses:
        error = stay * error + np.sqrt(1 - stay**2) * spread * rng.standard_normal(6)
        moved = pose.copy()
        moved[:3, 3] += error[:3]
        moved[:3, :3] = Rotation.from_rotvec(error[3:]).as_matrix() @ pose[:3, :3]
        tracked.append(moved)
    return tracked


def shoot(
    scene: RayScene, pose: NDArray[np.float64], tracked: NDArray[np.float64], config: ScannerConfig, rng: np.random.Generator
) -> Shot:
    """Color and noisy depth from a pose. Depth is that of every second color pixel."""
    view = scene.render(camera_at(pose, config), background=(235, 235, 235))
    true = view.depth[::2, ::2].astype(np.float64)
    facing = np.abs(view.normal[::2, ::2].astype(np.float64) @ pose[:3, 2])
    depth = np.where(np.isfinite(true), true, 0.0)
    sigma = config.depth_noise * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
    depth = depth + sigma * rng.standard_normal(depth.shape)
    jump = _jumps(true)
    lost = (jump > 0.05 * np.maximum(depth, 0.1)) & (rng.random(depth.shape) < 0.7)
    lost |= (facing < 0.12) | (depth < config.min_range_m) | (depth > config.max_range_m) | ~np.isfinite(true)
    millimetres = np.where(lost, 0, np.round(depth * 1000)).astype(np.uint16)
    color = np.clip(view.color + rng.normal(0, 1.5, view.color.shape), 0, 255).astype(np.uint8)
    return Shot(color, millimetres, pose, tracked)


def _jumps(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Steps of depth between neighbors [m], shape (h, w); where nothing is seen counts as far away."""
    filled = np.where(np.isfinite(depth), depth, 100.0)
    return np.maximum(np.abs(np.diff(filled, axis=0, prepend=filled[:1])), np.abs(np.diff(filled, axis=1, prepend=filled[:, :1])))
