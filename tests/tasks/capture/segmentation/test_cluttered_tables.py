"""Tables whose visible part is smaller than the tops of the boxes on them: the table is the level, not the boxes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from bench.capture.frames import write_scan
from tasks.capture import find_scans
from tasks.capture.fusion import FusionConfig, fused_surface
from tasks.capture.leveling import aligned, read_scan
from tasks.capture.rooms.alignment import SeenLevel, align
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


def test_a_floor_far_below_the_level_of_frames_is_the_floor() -> None:
    floor = trimesh.creation.box((3.0, 3.0, 0.0)).subdivide().subdivide()
    table = trimesh.creation.box((1.0, 1.0, 0.0)).subdivide().subdivide().apply_translation([0, 0, TOP_M])
    surface = surface_of([floor, table])
    points = np.column_stack([np.random.default_rng(1).uniform(-0.5, 0.5, (500, 2)), np.full(500, TOP_M)])
    assert abs(align(surface, level=SeenLevel(np.array([0.0, 0.0, 1.0]), points)).pose[2, 3]) < MAX_LEVEL_ERROR_M
