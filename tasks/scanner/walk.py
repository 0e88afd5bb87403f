"""Where the scanner looks from: views chosen one by one for what they add to the coverage, then put in walking order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.meshes import Surface, sample_surface
from tasks.rendering import RayScene, open3d
from tasks.scanner.config import ScannerConfig
from tasks.transforms import look_at

GRID_M = 0.35
"""Distance of the places that are tried. A step."""

CLEARANCE_M = 0.3
"""Nobody stands nearer to a surface than half a person's width."""

YAWS, PITCHES = 12, (-0.65, -0.25, 0.2)
"""Directions tried at each place: every 30 degrees; down at furniture, ahead, and up at the top of the walls [rad]."""

WANTED_VIEWS = 3
"""Each spot is worth being seen this often: fusion averages noise, and small things are hidden from single views."""

TARGETS_PER_M2 = 25.0
"""Spots per square metre of surface whose coverage is counted: one every 20 cm."""


def camera_poses(scene: RayScene, surface: Surface, config: ScannerConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Camera-to-world poses (OpenCV) of a walk through a scene, shape (4, 4) each; world frame, floor at z = 0.

    Raises:
        ValueError: there is no place to stand.
    """
    places = _places(scene, surface, config)
    if not len(places):
        raise ValueError("the scene has no free floor to walk on")
    area = len(places) * GRID_M**2
    count = min(config.max_frames, max(24, int(area * config.frames_per_m2))) if area < 30 else int(area * config.frames_per_m2)
    targets, normals = _targets(surface, rng)
    sight = _sight(scene, places, targets, normals, config)
    directions = _directions()
    chosen = _chosen(places, targets, sight, directions, config, count)
    order = _walk([places[p] for p, _ in chosen])
    poses = []
    for index in order:
        place, direction = chosen[index]
        eye = places[place] + rng.normal(0, [0.04, 0.04, 0.05])
        poses.append(look_at(eye, eye + directions[direction] + rng.normal(0, 0.03, 3)))
    return poses


def _places(scene: RayScene, surface: Surface, config: ScannerConfig) -> NDArray[np.float64]:
    """Eye positions with room around them, a floor below and walls about them [m], shape (p, 3)."""
    low, high = surface.bounds
    x, y = np.meshgrid(np.arange(low[0] + 0.2, high[0], GRID_M), np.arange(low[1] + 0.2, high[1], GRID_M), indexing="ij")
    eyes = np.stack([x.ravel(), y.ravel(), np.full(x.size, config.eye_height_m)], axis=1)
    o3d = open3d()
    free = scene.raycaster.compute_distance(o3d.core.Tensor(eyes.astype(np.float32))).numpy() > CLEARANCE_M
    below = scene.cast(np.concatenate([eyes, np.tile([0.0, 0, -1], (len(eyes), 1))], axis=1).astype(np.float32))["t_hit"]
    stands = (below > config.eye_height_m - 0.1) & (below < config.eye_height_m + 0.1)
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), np.full(16, -0.02)], axis=1)
    rays = np.concatenate([np.repeat(eyes, 16, axis=0), np.tile(around, (len(eyes), 1))], axis=1).astype(np.float32)
    enclosed = np.isfinite(scene.cast(rays)["t_hit"]).reshape(-1, 16).mean(axis=1) > 0.7
    return eyes[free & stands & enclosed]


def _targets(surface: Surface, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spots to be seen [m], shape (t, 3), and their normals. Small faces get their share: things are small."""
    corners = surface.vertices[surface.faces]
    area = float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2)
    points, _, normals = sample_surface(surface, int(np.clip(area * TARGETS_PER_M2, 2000, 20000)), rng)
    return points, normals


def _sight(
    scene: RayScene, places: NDArray[np.float64], targets: NDArray[np.float64], normals: NDArray[np.float64], config: ScannerConfig
) -> NDArray[np.bool_]:
    """Which spots are in plain sight and range of which places, shape (p, t)."""
    sight = np.zeros((len(places), len(targets)), dtype=bool)
    for index, eye in enumerate(places):
        way = targets - eye
        distance = np.linalg.norm(way, axis=1)
        facing = np.abs(np.einsum("td,td->t", way, normals)) > 0.2 * distance
        near = np.flatnonzero((distance < config.max_range_m - 0.5) & (distance > config.min_range_m) & facing)
        rays = np.concatenate([np.tile(eye, (len(near), 1)), way[near]], axis=1).astype(np.float32)
        sight[index, near] = scene.cast(rays)["t_hit"] > 1 - 0.02 / np.maximum(distance[near], 0.1)
    return sight


def _directions() -> NDArray[np.float64]:
    yaw, pitch = np.meshgrid(np.linspace(0, 2 * np.pi, YAWS, endpoint=False), PITCHES, indexing="ij")
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1).reshape(-1, 3)


def _chosen(
    places: NDArray[np.float64],
    targets: NDArray[np.float64],
    sight: NDArray[np.bool_],
    directions: NDArray[np.float64],
    config: ScannerConfig,
    count: int,
) -> list[tuple[int, int]]:
    """Greedy choice of (place, direction): each adds most to spots that were seen less often than wanted."""
    half = config.horizontal_fov_radians / 2
    cone = np.cos(half * 0.85)  # a circle inside the image stands for it
    in_view: list[NDArray[np.int64]] = []
    for index, eye in enumerate(places):
        seen = np.flatnonzero(sight[index])
        way = targets[seen] - eye
        way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
        inside = way @ directions.T > cone
        in_view.extend(seen[inside[:, d]] for d in range(len(directions)))
    worth = np.ones(len(targets))
    gains = np.array([float(len(view)) for view in in_view])
    chosen: list[tuple[int, int]] = []
    while len(chosen) < count and gains.max(initial=0) > 0:
        best = int(np.argmax(gains))
        gain = float(worth[in_view[best]].sum())
        if gain < gains[best] - 1e-9:  # an upper bound from before: gains only shrink
            gains[best] = gain
            continue
        if gain < 3.0:
            break
        chosen.append((best // len(directions), best % len(directions)))
        worth[in_view[best]] = np.maximum(worth[in_view[best]] - 1.0 / WANTED_VIEWS, 0.0)
        gains[best] = float(worth[in_view[best]].sum())
    return chosen


def _walk(places: list[NDArray[np.float64]]) -> list[int]:
    """An order in which each next place is the nearest one left."""
    points = np.array(places)
    left, order = np.ones(len(points), dtype=bool), [0]
    left[0] = False
    while left.any():
        distance = np.where(left, np.linalg.norm(points - points[order[-1]], axis=1), np.inf)
        order.append(int(np.argmin(distance)))
        left[order[-1]] = False
    return order
