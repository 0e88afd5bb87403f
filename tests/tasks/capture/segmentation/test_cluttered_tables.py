"""Tables whose visible part is smaller than the tops of the boxes on them: the table is the level, not the boxes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from bench.capture.frames import write_scan
from tasks.capture import find_scans
from tasks.capture.fusion import FusionConfig, fused_surface
from tasks.capture.leveling import aligned, read_scan
from tasks.capture.rooms.alignment import align
from tasks.capture.rooms.floor_levels import SeenLevel
from tasks.capture.segmentation import gravity
from tasks.capture.segmentation.frame import FrameConfig
from tasks.capture.segmentation.votes import VoteConfig
from tasks.capture.small_objects.lifting import DepthView, depth_noise
from tasks.geometry.meshes import surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at

MAX_LEVEL_ERROR_M = 0.005
TOP_M, SIZE = 0.72, (0.8, 1.4)


def cluttered_frame(seed: int) -> tuple[DepthView, NDArray[np.bool_], NDArray[np.bool_]]:
    """A noisy frame of a table full of boxes that are mostly 2 to 7 cm high, its pixels of the table, and of the boxes."""
    rng = np.random.default_rng([seed, 5])
    boxes, height = [], rng.uniform(0.02, 0.07)
    gap, cells = rng.uniform(0.03, 0.07), (int(rng.integers(2, 4)), int(rng.integers(3, 6)))
    sides = np.array(SIZE) / cells
    for cell in np.ndindex(*cells):
        width, depth = sides - gap - rng.uniform(0, [0.03, 0.05])
        tall = height if rng.random() < 0.8 else rng.uniform(0.03, 0.2)
        x, y = sides * (np.array(cell) + 0.5) - np.array(SIZE) / 2
        boxes.append(trimesh.creation.box((width, depth, tall)).apply_translation([x, y, TOP_M + tall / 2]))
    table = trimesh.creation.box((*SIZE, 0.04)).apply_translation([0, 0, TOP_M - 0.02])
    pitch, away = np.deg2rad(rng.uniform(30, 75)), rng.uniform(0.8, 1.0)
    eye = [away * np.cos(pitch), rng.uniform(-0.2, 0.2), TOP_M + away * np.sin(pitch)]
    camera = Camera.with_fov(look_at(eye, [0, 0, TOP_M]), 320, 240, 1.0)
    hits = RayScene([table, *boxes]).cast(camera.rays())
    is_hit = np.isfinite(hits["t_hit"])
    depth_m = np.where(is_hit, hits["t_hit"], 0.0)
    depth_m = np.where(is_hit, depth_m + rng.normal(size=depth_m.shape) * depth_noise(depth_m) * 0.5, 0).astype(np.float32)
    part = np.where(is_hit, hits["geometry_ids"].astype(np.int64), 99)
    color = rng.integers(0, 255, (100, 3)).astype(np.uint8)[part]
    view = DepthView(f"{seed:06d}", depth_m, color, (camera.fx, camera.fy, camera.cx, camera.cy), camera.pose)
    is_table = (part == 0) & (np.abs(view.points()[..., 2] - TOP_M) < 0.015)
    return view, is_table, is_hit & (part > 0)


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(10))
def test_a_cluttered_table_is_level(seed: int, tmp_path: Path) -> None:
    view, is_table, is_box = cluttered_frame(seed)
    assert is_box.sum() > is_table.sum()
    (scan,), _ = find_scans(write_scan(tmp_path / "table", [view]))
    reading = read_scan(scan)
    surface, _ = fused_surface(reading.frames, FusionConfig(), "table")
    alignment = aligned(reading, surface, [], VoteConfig(), is_authored=False)
    heights = dataclasses.replace(view, pose=alignment.pose).points()[..., 2]
    assert abs(np.median(heights[is_table])) < MAX_LEVEL_ERROR_M


@pytest.mark.parametrize("height", [0.01, 0.024, 0.037, 0.07, 0.14])
def test_the_level_of_frames_comes_before_larger_tops(height: float) -> None:
    rng = np.random.default_rng(1)
    boxes = [trimesh.creation.box((0.3, 0.3, 0.0)).apply_translation([0.35 * i, 0.35 * j, height]) for i in range(3) for j in range(3)]
    table = trimesh.creation.box((0.6, 0.5, 0.0)).apply_translation([1.4, 0.3, 0.0])
    surface = surface_of([table, *boxes])
    points = np.column_stack([rng.uniform(1.1, 1.7, (500, 2)), rng.normal(0, 0.001, 500)])
    pose = align(surface, level=SeenLevel(np.array([0.0, 0.0, 1.0]), points)).pose
    assert abs(pose[2, 3]) < MAX_LEVEL_ERROR_M
    assert pose[2, 2] > np.cos(np.deg2rad(0.5))


def level_of(height: float, side: float, tilt_degrees: float = 0.0) -> SeenLevel:
    """Points on a square [m] that frames show at a height [m], tilted as a small patch may be."""
    rng = np.random.default_rng(1)
    plan = rng.uniform(-side / 2, side / 2, (500, 2))
    slope = np.tan(np.deg2rad(tilt_degrees))
    return SeenLevel(np.array([0.0, 0.0, 1.0]), np.column_stack([plan, height + slope * plan[:, 0] + rng.normal(0, 0.001, 500)]))


def plate_at(height: float, side: float) -> trimesh.Trimesh:
    """A square plate [m] of small faces at a height [m]."""
    return trimesh.creation.box((side, side, 0.0)).subdivide_to_size(0.1).apply_translation([0, 0, height])


@pytest.mark.parametrize("tilt_degrees", [0.0, 3.0])
@pytest.mark.parametrize(("height", "side"), [(0.05, 1.5), (0.08, 1.5), (0.12, 1.5), (0.16, 1.5), (0.4, 0.7), (TOP_M, 1.0), (-0.4, 0.5)])
def test_a_larger_floor_comes_before_the_level_of_frames(height: float, side: float, tilt_degrees: float) -> None:
    """The frames show a platform, a table, or a reflection in the floor."""
    surface = surface_of([plate_at(0.0, 3.0), plate_at(height, side)])
    pose = align(surface, level=level_of(height, side, tilt_degrees)).pose
    assert abs(pose[2, 3]) < MAX_LEVEL_ERROR_M
    assert pose[2, 2] > np.cos(np.deg2rad(0.1))


def test_a_few_low_frames_do_not_pull_the_level_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses drift by 2 cm either way, and one frame shows a little of a shelf below."""
    lens, drift = Camera.with_fov(look_at([0.9, 0.0, 0.9], [0, 0, 0]), 80, 60, 1.0), np.linspace(-0.02, 0.02, 9)
    views: list[Any] = []
    for height, camera, side in [*((height, lens, 4.0) for height in drift), (-0.045, lens, 0.32)]:
        depth = RayScene([plate_at(0.0, side)]).render(camera).depth
        pose = np.array(camera.pose)
        pose[2, 3] += height
        depth_m = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        views.append(DepthView("", depth_m, np.zeros((60, 80, 3), np.uint8), (camera.fx, camera.fy, camera.cx, camera.cy), pose))
    monkeypatch.setattr(gravity, "chosen_frames", lambda frames, most: range(len(frames)))
    monkeypatch.setattr(gravity, "depth_view", lambda frame, pose: frame)
    level = gravity.scan_level(views, 0.01, FrameConfig())
    assert level is not None
    assert level.height_along(np.array([0.0, 0.0, 1.0])) == pytest.approx(0.0, abs=MAX_LEVEL_ERROR_M)
