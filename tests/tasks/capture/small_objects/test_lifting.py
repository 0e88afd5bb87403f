"""Masks of depth frames as points: against rays, against brute force, and pixels that no surface has."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.lifting import (
    DepthView,
    FrameMasks,
    LiftingConfig,
    at_color,
    at_depth,
    density_clusters,
    depth_noise,
    depth_view,
    distinct,
    lift,
    sound_pixels,
    visible_points,
    voxel_first,
)  # fmt: skip
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at

SIZE = (48, 64)
LENS = (70.0, 68.0, 31.5, 23.5)


def view(depth: np.ndarray, pose: np.ndarray | None = None) -> DepthView:
    return DepthView("000000", depth.astype(np.float32), np.zeros((*depth.shape, 3), np.uint8), LENS, np.eye(4) if pose is None else pose)


def masks(*areas: np.ndarray) -> FrameMasks:
    return FrameMasks(np.array(areas), ("",) * len(areas), np.ones(len(areas)))


@given(x=st.floats(-2, 2), y=st.floats(-2, 2), z=st.floats(0.5, 2))
def test_pixels_are_where_rays_hit(x: float, y: float, z: float) -> None:
    """The renderer of the project is the other implementation: points of its hits, and their pixels."""
    import trimesh

    camera = Camera(look_at([x + 3.0, y, z], [x, y, 0.4]), *LENS, SIZE[1], SIZE[0])
    rays = camera.rays()
    hit = RayScene([trimesh.creation.box((9, 9, 0.1))]).cast(rays)["t_hit"]
    seen = np.isfinite(hit)
    frame = view(np.where(seen, hit, 0), camera.pose)
    points = frame.points()
    assert np.allclose(points[seen], rays[seen][:, :3] + hit[seen][:, None] * rays[seen][:, 3:], atol=1e-4)
    row, column, depth, inside = frame.pixels(points[seen])
    assert inside.all()
    assert (np.stack([row, column], 1) == np.argwhere(seen)).all()
    assert np.allclose(depth, hit[seen], atol=1e-4)
    assert visible_points(frame, points[seen], np.full(seen.sum(), 1e-3))[0].all()
    assert not visible_points(frame, camera.pose[:3, 3] + 0.9 * (points[seen] - camera.pose[:3, 3]), np.full(seen.sum(), 0.02))[0].any()


def test_points_behind_the_camera_are_in_no_image() -> None:
    assert not view(np.ones(SIZE)).pixels(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))[3].any()


def test_flying_pixels_and_what_is_out_of_range_are_left_out() -> None:
    depth = np.full(SIZE, 2.0)
    depth[:, 20:40] = 1.0
    depth[:, 40] = 1.5  # what a sensor mixes of both
    depth[0], depth[1], depth[2] = 0.0, 0.05, 9.0
    sound = sound_pixels(depth.astype(np.float32), LiftingConfig())
    assert not sound[:3].any()
    assert not sound[3:, 40].any()
    assert sound[3:, 21:39].all()


@given(st.integers(0, 50), st.floats(0.5, 4.0))
def test_noise_makes_no_edges(seed: int, away: float) -> None:
    depth = np.full(SIZE, away) + np.random.default_rng(seed).normal(size=SIZE) * depth_noise(np.array(away)) * 0.7
    assert sound_pixels(depth.astype(np.float32), LiftingConfig()).mean() > 0.97


def test_a_mask_keeps_its_largest_part_and_a_small_one_is_dropped() -> None:
    depth = np.full(SIZE, 1.0)
    mask, speck = np.zeros(SIZE, bool), np.zeros(SIZE, bool)
    mask[5:40, 5:25] = mask[5:12, 55:60] = True
    speck[44:47, 40:43] = True
    lifted = lift(view(depth), masks(mask, speck), LiftingConfig())
    assert len(lifted.masks) == 1
    assert (lifted.points[0][:, 0] < 0).all()
    assert set(np.unique(lifted.owner)) == {-1, 0}


def test_what_lies_in_two_masks_is_nobodys() -> None:
    first, second = np.zeros(SIZE, bool), np.zeros(SIZE, bool)
    first[:, :40], second[:, 30:] = True, True
    owner = lift(view(np.full(SIZE, 1.0)), masks(first, second), LiftingConfig()).owner
    assert (owner[:, 30:40] == -1).all()
    assert (owner[:, :30] == 0).all()
    assert (owner[:, 40:] == 1).all()


def test_of_two_names_for_one_mask_the_surer_stays() -> None:
    area = np.zeros(SIZE, bool)
    area[5:30, 5:30] = True
    smaller = area.copy()
    smaller[5:7] = False
    kept = distinct(FrameMasks(np.array([area, smaller]), ("mug", "cup"), np.array([0.4, 0.9])), 0.7)
    assert kept.labels == ("cup",)


def test_masks_without_names_for_each_are_refused() -> None:
    with pytest.raises(ValueError, match="must be as many"):
        FrameMasks(np.zeros((2, 4, 4), bool), ("mug",), np.ones(2))


@given(st.integers(0, 10**6))
def test_clusters_are_those_of_brute_force(seed: int) -> None:
    """Far less than a reach within, far more than one between: any right DBSCAN has these clusters."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    centers = np.arange(count)[:, None] * [0.5, 0.0, 0.0]
    truth = np.repeat(np.arange(count), 40)
    points = centers[truth] + rng.uniform(-0.014, 0.014, (len(truth), 3))
    stray = np.array([[0.0, 3.0, 0.0], [0.0, -3.0, 0.0]])
    label = density_clusters(np.concatenate([points, stray]), 0.05, 5)
    assert (label[-2:] == -1).all()
    assert len(set(zip(truth.tolist(), label[:-2].tolist(), strict=True))) == count
    assert sorted(set(label[:-2].tolist())) == list(range(count))


def test_of_nothing_there_are_no_clusters() -> None:
    assert density_clusters(np.zeros((0, 3)), 0.05, 5).shape == (0,)
    assert (density_clusters(np.array([[0.0, 0, 0], [1, 1, 1]]), 0.05, 2) == -1).all()


@given(st.integers(0, 100))
def test_every_voxel_keeps_one_point(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.1, 0.1, (200, 3))
    kept = points[voxel_first(points, 0.02)]
    cells = {tuple(row) for row in np.floor(points / 0.02).astype(int).tolist()}
    assert len(kept) == len(cells) == len({tuple(row) for row in np.floor(kept / 0.02).astype(int).tolist()})


def test_what_the_color_image_does_not_show_is_in_no_mask() -> None:
    """Depth sees twice as wide as color: pixels beside it have no color, and no part in a mask at its border."""
    color = np.full((48, 32, 3), 90, np.uint8)
    depth = np.full(SIZE, 1.5, np.float32)
    fx, fy, cx, cy = LENS
    frame = FrameSource("000007", "c", "d", 32, 48, (fx, fy, cx, cy), (64, 48), LENS, 1000.0, np.eye(4), lambda: color, lambda: depth)
    seen = depth_view(frame, np.eye(4))
    assert seen is not None
    assert (seen.depth[:, :32] == 1.5).all()
    assert not seen.depth[:, 32:].any()
    small = at_depth(np.ones((48, 32), bool), frame)
    assert small[:, :32].all()
    assert not small[:, 32:].any()


def test_frames_of_two_cameras_show_one_thing() -> None:
    """Color at twice the resolution of depth: a mask there and back covers what it did, and colors are those of the pixels."""
    color = np.zeros((96, 128, 3), np.uint8)
    color[20:60, 40:90] = 200
    depth = np.full(SIZE, 1.5, np.float32)
    frame = FrameSource(
        "000007", "c", "d", 128, 96, (140.0, 136.0, 63.5, 47.5), (64, 48), LENS, 1000.0, np.eye(4), lambda: color, lambda: depth
    )  # fmt: skip
    seen = depth_view(frame, np.eye(4))
    assert seen is not None
    mask = color[..., 0] > 0
    small = at_depth(mask, frame)
    assert (small == (seen.color[..., 0] > 0)).all()
    assert (at_color(small, frame) == mask).mean() > 0.97
    assert depth_view(dataclasses.replace(frame, depth=None), np.eye(4)) is None
