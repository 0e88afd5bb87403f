"""Single frames without labels: planted things on a table, in any roll and pitch of the camera, and frames that show nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from bench.capture.frames import plane_error, pose_over, truth_of
from bench.capture.tabletops import tabletop_frame
from bench.capture.truth import frame_score
from tasks.capture.segmentation.frame import FrameConfig, FrameSegments, segmented_frame, under_plane
from tasks.capture.segmentation.planes import Plane
from tasks.capture.small_objects.lifting import DepthView, depth_noise
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at

TOP, FLOOR = 0.74, 0.01
"""Heights of a table and of the floor [m]."""


def thing(size: tuple[float, float, float], x: float, y: float, bottom: float = TOP) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([x, y, bottom + size[2] / 2])
    return mesh


def shown(things: list[trimesh.Trimesh], pitch: float, noise: float = 1.0, table: bool = True) -> tuple[DepthView, np.ndarray]:
    """A frame of a table in a room with things on it, and the thing of each pixel, -1 for none."""
    around = [trimesh.creation.box((6, 6, 2 * FLOOR)), trimesh.creation.box((0.02, 6, 3))]
    around[1].apply_translation([-1.6, 0, 1.5])
    top = trimesh.creation.box((1.0, 1.4, 0.04))
    top.apply_translation([0, 0, TOP - 0.02])
    parts = [*things, *around, *([top] if table else [])]
    eye = np.array([np.cos(pitch), 0.0, np.sin(pitch)]) * 0.9 + [0, 0, TOP]
    camera = Camera.with_fov(look_at(eye, [0, 0, TOP]), 320, 240, 1.02)
    hits = RayScene(parts).cast(camera.rays())
    depth = np.where(np.isfinite(hits["t_hit"]), hits["t_hit"], 0).astype(np.float64)
    rng = np.random.default_rng(3)
    depth += noise * np.where(depth > 0, depth_noise(depth), 0) * rng.normal(size=depth.shape)
    part = np.where(np.isfinite(hits["t_hit"]), hits["geometry_ids"].astype(np.int64), len(parts))
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    color = np.full((240, 320, 3), 120, dtype=np.uint8)
    return DepthView("0", depth.astype(np.float32), color, lens, camera.pose), np.where(part < len(things), part, -1)


def best(found: FrameSegments, owner: np.ndarray, number: int) -> float:
    """The largest IoU of a thing with a region."""
    own = owner == number
    return max((own & (found.region == j)).sum() / (own | (found.region == j)).sum() for j in range(found.region.max() + 1))


SHOWN = [thing((0.12, 0.18, 0.1), 0.1, 0.25), thing((0.15, 0.1, 0.16), -0.1, -0.2), thing((0.08, 0.08, 0.08), 0.1, 0.25, TOP + 0.1)]


@pytest.mark.parametrize("pitch", [0.45, 0.8, 1.15])
def test_boxes_come_out_one_by_one_also_stacked_ones(pitch: float) -> None:
    view, owner = shown(SHOWN, pitch)
    found = segmented_frame(view, FrameConfig())
    assert found.region.max() + 1 == len(SHOWN)
    assert min(best(found, owner, number) for number in range(len(SHOWN))) > 0.75
    assert found.support is not None
    up = view.pose[2, :3]
    assert np.degrees(np.arccos(min(1.0, found.support.normal @ up))) < 0.2
    assert abs(found.support.heights(np.zeros(3)) - (view.pose[2, 3] - TOP)) < 0.002
    assert not (found.on_support & found.room).any()
    assert not ((found.region >= 0) & (found.on_support | found.room)).any()


def test_a_mirrored_frame_has_mirrored_regions() -> None:
    """Nothing hangs on which side is which, but for the drawing of hypotheses: what is found is the same things."""
    view, owner = shown(SHOWN, 0.8)
    flipped = dataclasses.replace(
        view, depth=view.depth[:, ::-1].copy(), color=view.color[:, ::-1].copy(),
        intrinsics=(*view.intrinsics[:2], view.depth.shape[1] - 1 - view.intrinsics[2], view.intrinsics[3]),
    )  # fmt: skip
    found = segmented_frame(flipped, FrameConfig())
    assert min(best(found, owner[:, ::-1], number) for number in range(len(SHOWN))) > 0.75


def test_the_same_frame_gives_the_same_regions() -> None:
    view, _ = shown(SHOWN, 0.8)
    first, second = (segmented_frame(view, FrameConfig()) for _ in range(2))
    assert (first.region == second.region).all()
    assert first.support is not None
    assert second.support is not None
    assert first.support.normal.tobytes() == second.support.normal.tobytes()


@pytest.mark.parametrize("depth", [0.0, np.nan, 50.0])
def test_a_frame_that_shows_nothing_has_no_regions_and_no_support(depth: float) -> None:
    view = DepthView("0", np.full((48, 64), depth, np.float32), np.zeros((48, 64, 3), np.uint8), (60, 60, 31.5, 23.5), np.eye(4))
    found = segmented_frame(view, FrameConfig())
    assert found.support is None
    assert found.region.max() == -1
    assert not found.on_support.any()


def test_specks_of_depth_are_no_crash() -> None:
    rng = np.random.default_rng(0)
    depth = np.where(rng.random((120, 160)) < 0.02, rng.uniform(0.3, 5.0, (120, 160)), 0).astype(np.float32)
    view = DepthView("0", depth, np.zeros((120, 160, 3), np.uint8), (140, 140, 79.5, 59.5), np.eye(4))
    assert segmented_frame(view, FrameConfig()).region.max() == -1


def test_a_generated_frame_is_found_and_level() -> None:
    """Of seed 1000, by which constants were chosen."""
    frame = tabletop_frame(17, 30, 1000)
    found = segmented_frame(frame.view, FrameConfig())
    assert frame_score(truth_of(frame), found.region, frame.view.depth > 0).f1 > 0.75
    assert found.support is not None
    angle, off = plane_error(frame, pose_over(found.support))
    assert np.degrees(angle) < 0.2
    assert off < 0.002


def test_what_is_under_a_table_is_within_its_outline() -> None:
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    top = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    points = np.array([[0.5, 0.5, -0.7], [1.5, 0.5, -0.7], [0.1, 0.9, 3.0], [-0.1, 0.5, 0.0]])
    assert under_plane(points, top, plane).tolist() == [True, False, True, False]
    assert not under_plane(points, top[:2], plane).any(), "a line is over nothing"
