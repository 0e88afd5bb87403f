"""What the scanner's camera records: depth with noise, holes and a limit; color under a fixed light; poses that drift.

Noise grows with the square of the distance, as measured for structured-light sensors (Khoshelham and Elberink,
"Accuracy and Resolution of Kinect Depth Data", Sensors 2012, equation 8).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.rendering import Camera, RayScene
from tasks.scanner.scenery import Paint

if TYPE_CHECKING:
    from tasks.scanner import ScannerConfig
    from tasks.scanner.defects import Blindness

Array = NDArray[np.float64]

LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])
"""Where the room's light comes from: fixed, so that a surface has one color in all frames."""


@dataclasses.dataclass(frozen=True)
class Shot:
    """One frame. depth: [mm], shape (height, width) uint16, 0 where there is none. color: shape (h, w, 3) uint8.
    pose: Camera (OpenCV axes) to scan frame as the tracker believes it, 4x4 [m]."""

    depth: NDArray[np.uint16]
    color: NDArray[np.uint8]
    pose: Array


def depth_camera(pose: Array, config: ScannerConfig) -> Camera:
    """The depth camera at a pose."""
    return Camera.with_fov(pose, config.depth_width, config.depth_height, config.fov_radians)


def color_camera(pose: Array, config: ScannerConfig) -> Camera:
    """The color camera at a pose: the same center and field of view, pixels of its own."""
    return Camera.with_fov(pose, config.color_width, config.color_height, config.fov_radians)


def shoot(
    scene: RayScene,
    paint: Paint,
    pose: Array,
    believed: Array,
    config: ScannerConfig,
    rng: np.random.Generator,
    blind: Blindness | None = None,
) -> Shot:
    """A frame from a true pose (camera to world); `believed` is the pose in the scan frame that goes with it.

    `blind`: what gives no depth, though it has a color.
    """
    hits = scene.cast(depth_camera(pose, config).rays())
    depth = hits["t_hit"].astype(np.float64)
    seen = np.isfinite(depth)
    facing = np.abs(hits["primitive_normals"].astype(np.float64) @ pose[:3, 2])
    measured = _measured(np.where(seen, depth, 0.0), facing, config, rng)
    if blind is not None:
        rays = depth_camera(pose, config).rays()[seen].astype(np.float64)
        at = rays[:, :3] + depth[seen][:, None] * rays[:, 3:]
        hidden = blind.hides(hits["geometry_ids"][seen].astype(np.int64), hits["primitive_ids"][seen].astype(np.int64), at)
        measured[seen] = np.where(hidden, 0, measured[seen])
    if (config.color_width, config.color_height) != (config.depth_width, config.depth_height):
        hits = scene.cast(color_camera(pose, config).rays())
        seen = np.isfinite(hits["t_hit"])
    color = np.full((*seen.shape, 3), 236.0)
    normals = hits["primitive_normals"][seen].astype(np.float64)
    # a face seen from behind shows its other side
    rays_toward = np.where(normals @ pose[:3, 2] > 0, -1.0, 1.0)
    normals *= rays_toward[:, None]
    light = 0.62 + 0.26 * np.maximum(normals @ LIGHT, 0) + 0.12 * (0.5 + 0.5 * normals[:, 0])
    part, face = hits["geometry_ids"][seen].astype(np.int64), hits["primitive_ids"][seen].astype(np.int64)
    color[seen] = paint.at(part, face, hits["primitive_uvs"][seen]) * light[:, None]
    exposure = 1.0 + config.exposure_spread * float(np.clip(rng.normal(), -2, 2))
    grain = rng.normal(0, config.color_noise, seen.shape)[..., None]
    return Shot(measured, np.clip(np.round(color * exposure + grain), 0, 255).astype(np.uint8), believed)


def _measured(depth: Array, facing: Array, config: ScannerConfig, rng: np.random.Generator) -> NDArray[np.uint16]:
    """True depth [m], 0 for none, as the sensor reports it [mm]."""
    from scipy.ndimage import maximum_filter, minimum_filter

    far = np.where(depth > 0, depth, 1e3)
    jump = maximum_filter(far, 3) - minimum_filter(far, 3) > config.edge_jump * np.maximum(depth, 0.5)
    lost = jump & (rng.random(depth.shape) < config.edge_dropout)
    lost |= rng.random(depth.shape) < config.speckle_dropout
    lost |= facing < config.grazing_cosine
    # disparity is found over patches: neighboring pixels share part of their error
    white = rng.normal(size=depth.shape)
    shared = 0.25 * (white + np.roll(white, 1, 0) + np.roll(white, 1, 1) + np.roll(white, (1, 1), (0, 1))) * 2
    sigma = config.depth_noise_m + config.depth_noise_per_m * np.maximum(depth - 0.4, 0) ** 2
    noisy = depth + sigma * shared
    lost |= (depth < config.min_range_m) | (depth > config.max_range_m)
    return np.where(lost, 0, np.round(noisy * 1000)).astype(np.uint16)


def drift(count: int, config: ScannerConfig, rng: np.random.Generator) -> list[Array]:
    """How far the tracker is off at each of `count` frames: a smooth walk that is pulled back, 4x4 each, in the camera's frame."""
    from scipy.spatial.transform import Rotation

    keep = 0.9  # a tracker closes loops within some ten frames
    state, speed = np.zeros(6), np.zeros(6)
    offsets = []
    for _ in range(count):
        speed = 0.6 * speed + 0.4 * rng.normal(size=6)
        state = keep * state + (1 - keep) * 4.0 * speed
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(state[:3] * config.drift_radians).as_matrix()
        pose[:3, 3] = state[3:] * config.drift_m
        offsets.append(pose)
    return offsets


def scan_frame(config: ScannerConfig, rng: np.random.Generator, center: Array) -> Array:
    """World to scan frame, 4x4: any yaw, a small tilt, an offset; the scene's center comes to lie some metres off the origin."""
    from scipy.spatial.transform import Rotation

    yaw = float(rng.uniform(-np.pi, np.pi))
    lean = rng.normal(0, 1, 2)
    lean *= config.tilt_radians / max(float(np.linalg.norm(lean)), 1e-9) * float(rng.uniform(0.3, 1.0))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([lean[0], lean[1], 0.0]).as_matrix() @ Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    pose[:3, 3] = rng.uniform([1.0, 1.0, -0.2], [4.0, 4.0, 0.2]) - pose[:3, :3] @ center
    return pose
