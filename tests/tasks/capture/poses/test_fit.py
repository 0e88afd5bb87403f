"""Poses against depth: what fits, what does not, and by how much."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.capture.formats import find_scans
from tasks.capture.leveling import read_scan
from tasks.capture.poses.fit import pose_fit
from tasks.capture.reading import FrameSource
from tests.capture_scans import box_room, write_posed_rgbd


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> tuple[FrameSource, ...]:
    """Twelve frames with true poses, whose images are read once."""
    folder = write_posed_rgbd(tmp_path_factory.mktemp("fit") / "room", box_room())
    (scan,), errors = find_scans(folder)
    assert not errors
    result = []
    for frame in read_scan(scan).frames:
        assert frame.depth is not None
        image = frame.depth()
        result.append(dataclasses.replace(frame, depth=lambda image=image: image))
    return tuple(result)


def moved(frames: tuple[FrameSource, ...], motions: list[np.ndarray]) -> list[FrameSource]:
    return [dataclasses.replace(frame, pose=motion @ frame.pose) for frame, motion in zip(frames, motions, strict=True)]


def test_true_poses_fit(frames: tuple[FrameSource, ...]) -> None:
    fit = pose_fit(frames)
    assert fit.pairs >= 2 * len(frames), "each sees what several others see"
    assert fit.misfit_m < 0.01, "pixels of 160 columns are up to 2 cm apart, on the same planes"


@settings(max_examples=5)
@given(st.integers(0, 10_000))
def test_where_the_world_lies_is_nothing_to_them(frames: tuple[FrameSource, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.random(rng=rng).as_matrix()
    motion[:3, 3] = rng.uniform(-50, 50, 3)
    before, after = pose_fit(frames), pose_fit(moved(frames, [motion] * len(frames)))
    assert after.pairs == before.pairs
    assert after.misfit_m == pytest.approx(before.misfit_m, abs=2e-4)


@settings(max_examples=5)
@given(st.floats(0.05, 0.12))
def test_what_lies_aside_does_not_fit(frames: tuple[FrameSource, ...], aside: float) -> None:
    """Every second camera off by the same vector, along each axis in turn: surfaces that face it show it, and a room has some of all."""
    before, after = pose_fit(frames), []
    for axis in np.eye(3):
        motion = np.eye(4)
        motion[:3, 3] = aside * axis
        after.append(pose_fit(moved(frames, [motion if number % 2 else np.eye(4) for number in range(len(frames))])))
    assert all(fit.pairs > 0.9 * before.pairs for fit in after)
    assert all(fit.misfit_m > before.misfit_m for fit in after)
    assert max(fit.misfit_m for fit in after) > 0.3 * aside


def test_nothing_to_compare(frames: tuple[FrameSource, ...]) -> None:
    for few in ([], list(frames[:1]), [dataclasses.replace(frame, pose=None) for frame in frames]):
        assert pose_fit(few).pairs == 0
        assert pose_fit(few).misfit_m == 0.0
    blind = [dataclasses.replace(frame, depth=lambda: np.zeros((120, 160), np.float32)) for frame in frames]
    assert pose_fit(blind).pairs == 0


def test_a_folder_without_poses_says_what_to_do(tmp_path: Path) -> None:
    folder = write_posed_rgbd(tmp_path / "room", box_room(cameras=3))
    (folder / "pose.txt").unlink()
    (scan,), errors = find_scans(folder)
    assert not errors
    reading = read_scan(scan)
    assert [frame.pose for frame in reading.frames] == [None] * 3
    assert "without a pose (missing)" in " ".join(reading.degradations)
