"""Long narrow things in a room, seen from the middle of it: curtains, tubes, skirting boards, and what only looks like them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from tasks.capture.segmentation.frame import FrameConfig, FrameSegments, segmented_frame
from tasks.capture.segmentation.organized import OrganizedFrame, organized_frame
from tasks.capture.segmentation.planes import Plane
from tasks.capture.segmentation.strips import StripConfig, with_strips
from tasks.capture.small_objects.lifting import DepthView, depth_noise
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tests.tasks.capture.segmentation.test_frame import best

WALL_X, EYE_M = 2.2, 1.3
"""Where the wall stands, and how high the camera is held [m]."""

AHEAD = np.array([WALL_X, 0.0, 0.4])
"""The foot of the wall is in the middle of the image."""


def block(size: tuple[float, float, float], before_wall: float, y: float, bottom: float = 0.0) -> trimesh.Trimesh:
    """A box whose back is so far before the wall."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([WALL_X - before_wall - size[0] / 2, y, bottom + size[2] / 2])
    return mesh


def room(things: list[list[trimesh.Trimesh]], ahead: np.ndarray = AHEAD) -> tuple[DepthView, np.ndarray]:
    """A frame of a wall and the floor with things, each of some parts, and the thing of each pixel, -1 for none. ahead: What the camera
    looks at."""
    floor, wall = trimesh.creation.box((8, 8, 0.02)), trimesh.creation.box((0.02, 8, 3))
    floor.apply_translation([0, 0, -0.01])
    wall.apply_translation([WALL_X + 0.01, 0, 1.5])
    parts = [part for thing in things for part in thing]
    of = np.repeat(np.arange(len(things)), [len(thing) for thing in things])
    camera = Camera.with_fov(look_at(np.array([0.0, 0.0, EYE_M]), ahead), 320, 240, 1.02)
    hits = RayScene([*parts, floor, wall]).cast(camera.rays())
    depth = np.where(np.isfinite(hits["t_hit"]), hits["t_hit"], 0).astype(np.float64)
    depth += np.where(depth > 0, depth_noise(depth), 0) * np.random.default_rng(3).normal(size=depth.shape)
    part = np.where(np.isfinite(hits["t_hit"]), hits["geometry_ids"].astype(np.int64), len(parts))
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    view = DepthView("0", depth.astype(np.float32), np.full((240, 320, 3), 120, dtype=np.uint8), lens, camera.pose)
    return view, np.append(of, [-1, -1, -1])[np.minimum(part, len(parts) + 2)]


def found(view: DepthView) -> FrameSegments:
    return segmented_frame(view, FrameConfig(), view.pose[2, :3])


FOLDS = [block((0.02, 0.16, 1.9), 0.12 + 0.09 * k, -0.3 + 0.16 * k) for k in range(4)]
"""Four folds of a curtain, each 9 cm before the last."""


Regions = tuple[np.ndarray, Plane, OrganizedFrame]


def regions(things: list[trimesh.Trimesh]) -> Regions:
    """The true regions of a frame, its floor and its points."""
    config = FrameConfig()
    view, owner = room([[thing] for thing in things])
    frame = organized_frame(view, config.farthest_m, config.window_m, config.window_sigmas, config.gate_sigmas)
    return np.where(frame.valid, owner, -1), Plane(view.pose[2, :3], float(view.pose[2, 3])), frame


def joined(of: Regions, **strips: float) -> int:
    """How many regions are left; none of them may have been taken apart."""
    region, floor, frame = of
    found = with_strips(region, floor, frame, 3, dataclasses.replace(StripConfig(), **strips))
    assert ((found >= 0) == (region >= 0)).all()
    assert all(len(np.unique(found[region == number])) == 1 for number in range(region.max() + 1))
    return int(found.max()) + 1


def test_folds_are_one_curtain() -> None:
    of = regions(FOLDS)
    assert joined(of) == 1
    assert joined(of, depth_m=0.05) == len(FOLDS)
    region, floor, frame = of
    painted = dataclasses.replace(frame, color=np.where(region[..., None] % 2, 200, 40 + 0 * frame.color).astype(np.uint8))
    assert joined((region, floor, painted)) == len(FOLDS), "of two colors"
    apart = np.where(region == 3, 1, np.where(region == 0, 0, -1))
    assert joined((apart, floor, frame)) == 2, "what does not touch is two curtains"


def test_doors_and_books_side_by_side_stay_apart() -> None:
    assert joined(regions([block((0.3, 0.7, 1.2), 0.1 + 0.1 * k, -0.35 + 0.7 * k) for k in range(2)])) == 2
    assert joined(regions([block((0.15 + 0.02 * k, 0.05, 0.25), 0.1, -0.1 + 0.05 * k, 0.8) for k in range(4)])) == 4


def test_a_tube_is_a_part_of_what_it_touches_and_a_board_at_the_wall_of_the_wall() -> None:
    chair = [block((0.5, 0.5, 0.35), 0.2, 0.0, 0.3), *(block((0.04, 0.04, 0.65), 0.75, side) for side in (-0.27, 0.27))]
    board = [block((0.03, 3.0, 0.12), 0.0, 0.0)]
    view, owner = room([chair, board])
    segments = found(view)
    assert best(segments, owner, 0) > 0.85
    assert (segments.region[owner == 1] < 0).mean() > 0.95
    assert segments.region.max() == 0


@pytest.mark.parametrize("up", [True, False])
def test_a_wall_alone_carries_nothing(up: bool) -> None:
    """Where up is known, the largest plane of a frame without floor is a wall, and no support."""
    view, _ = room([])
    high = dataclasses.replace(view, depth=np.where(np.arange(240)[:, None] < 90, view.depth, 0).astype(np.float32))
    segments = segmented_frame(high, FrameConfig(), view.pose[2, :3] if up else None)
    assert (segments.support is None) == up
    assert segments.region.max() == -1
    assert segments.room.any() == up


def test_what_is_known_to_be_the_room_is_in_no_region() -> None:
    view, owner = room([[block((0.4, 0.8, 0.9), 0.3, 0.0)]])
    assert best(found(view), owner, 0) > 0.8
    segments = segmented_frame(view, FrameConfig(), view.pose[2, :3], owner == 0)
    assert segments.region.max() == -1
    assert segments.room[(owner == 0) & (view.depth > 0)].mean() > 0.95
