"""Frames that a network is learned from, and what it sees of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.models.trained.channels import BoardHeights, board_heights, channels, level_heights, mirrored, upright
from bench.models.trained.noise import measured_depth, seen_color
from bench.models.trained.scenes import FIRST_SEED, SUPPORT, TrainingFrame, training_frames
from bench.models.trained.things import NAMELESS, WORDS, drawn_thing
from tasks.capture.small_objects.lifting import DepthView
from tasks.capture.small_objects.supports import SupportSlab
from tasks.geometry.transforms import yaw_pose

SEED = FIRST_SEED + 1


@pytest.fixture(scope="module")
def frame() -> TrainingFrame:
    return training_frames(SEED, 1)[0]


def view_of(frame: TrainingFrame) -> DepthView:
    return DepthView("", frame.depth, frame.color, frame.intrinsics, frame.pose)


def test_the_same_seed_gives_the_same_frames_and_another_others(frame: TrainingFrame) -> None:
    (again,) = training_frames(SEED, 1)
    for field in dataclasses.fields(TrainingFrame):
        assert np.array_equal(getattr(frame, field.name), getattr(again, field.name))
    assert not np.array_equal(training_frames(SEED + 1, 1)[0].depth, frame.depth)


def test_things_stand_over_boards_and_supports_below_them() -> None:
    for seed in range(SEED, SEED + 4):
        for frame in training_frames(seed, 2):
            points = view_of(frame).points()
            assert frame.owner.max() < len(frame.categories)
            assert ((frame.categories >= NAMELESS) & (frame.categories < len(WORDS))).all()
            boards = frame.boards[:, 0]
            of_things = points[frame.owner >= 0][:, 2]
            assert (of_things >= boards.min() - 1e-3).all()
            assert (points[frame.owner == SUPPORT][:, 2] <= boards.max() + 1.5).all()
            assert (frame.depth[frame.owner >= 0] > 0).all()


def test_a_thing_stands_on_the_middle_of_its_bottom_and_has_its_size() -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        made = drawn_thing(rng)
        bounds = np.array([part.bounds for part in made.parts])
        low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
        assert np.allclose(high - low, made.size, atol=1e-6)
        assert np.allclose([low[0] + high[0], low[1] + high[1], low[2]], 0, atol=1e-6)


def test_a_sensor_by_chance_errs_by_millimeters_and_loses_some(frame: TrainingFrame) -> None:
    lost = []
    for seed in range(12):
        depth = measured_depth(frame.depth, frame.facing, np.random.default_rng(seed))
        assert np.array_equal(depth, measured_depth(frame.depth, frame.facing, np.random.default_rng(seed)))
        both = (depth > 0) & (frame.depth > 0)
        lost.append(1 - both.sum() / (frame.depth > 0).sum())
        assert np.median(np.abs(depth - frame.depth)[both]) < 0.03
    assert min(lost) > 0
    assert max(lost) < 0.6
    assert seen_color(frame.color, np.random.default_rng(0)).shape == frame.color.shape


def test_a_mirrored_frame_has_the_mirrored_channels(frame: TrainingFrame) -> None:
    above = frame.depth > 1
    heights = BoardHeights((0.1 * frame.depth).astype(np.float32), above)
    seen = channels(frame.depth, frame.color, frame.intrinsics, frame.pose, heights)

    def flipped(image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image[:, ::-1])

    fx, fy, cx, cy = frame.intrinsics
    other = channels(
        flipped(frame.depth), flipped(frame.color), (fx, fy, frame.depth.shape[1] - 1 - cx, cy), mirrored(frame.pose),
        BoardHeights(flipped(heights.height), flipped(above)),
    )  # fmt: skip
    expected = seen[:, :, ::-1].copy()
    expected[4] *= -1  # what leans to the right leans to the left
    assert (np.abs(expected - other) > 1e-3).mean() < 1e-3  # of surfaces seen edge-on the side is by chance


def test_whence_in_the_world_something_is_seen_changes_no_channel(frame: TrainingFrame) -> None:
    view = view_of(frame)
    moved = yaw_pose(2.1, [3.0, -1.0, 0.4])
    other = dataclasses.replace(view, pose=moved @ view.pose)
    half = frame.half
    slab = SupportSlab(np.eye(4), np.array([*(-half - 0.05), -0.03]), np.array([*(half + 0.05), 0.6]), half)
    raised = yaw_pose(0.0, [0.0, 0.0, float(frame.boards[0, 0])])
    own = board_heights(view, [dataclasses.replace(slab, pose=raised)], [None])
    elsewhere = board_heights(other, [dataclasses.replace(slab, pose=moved @ raised)], [None])
    assert (own.above != elsewhere.above).mean() < 1e-4
    first = channels(view.depth, view.color, view.intrinsics, view.pose, own)
    second = channels(other.depth, other.color, other.intrinsics, other.pose, elsewhere)
    assert (np.abs(first - second) > 2e-3).mean() < 1e-3
    assert np.allclose(upright(view.pose).T @ upright(view.pose), np.eye(3))


def test_levels_are_boards(frame: TrainingFrame) -> None:
    view, half = view_of(frame), frame.half
    slabs = [
        SupportSlab(
            yaw_pose(0.0, [0.0, 0.0, float(level)]), np.array([*(-half - 0.05), -0.03]), np.array([*(half + 0.05), float(clear)]), half
        )
        for level, clear in frame.boards
    ]
    by_slabs = board_heights(view, slabs, [None] * len(slabs))
    by_levels = level_heights(view.points(), frame.boards, half, view.depth > 0)
    is_below = [float(view.pose[2, 3]) - float(level) < 0.03 for level, _ in frame.boards]
    if not any(is_below):
        assert (by_slabs.above != by_levels.above).mean() < 1e-4
        assert np.allclose(by_slabs.height, by_levels.height, atol=1e-3)
    assert by_levels.above[(frame.owner >= 0)].mean() > 0.5
