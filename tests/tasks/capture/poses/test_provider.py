"""Poses of a scan, whoever they are from: what is kept, what is found, and what rows say of it."""

from __future__ import annotations

import dataclasses
import itertools
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.capture.frames import write_scan
from bench.capture.poses import error_m
from bench.capture.walks import RoomFilm, drifted, walk
from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.formats import find_scans
from tasks.capture.leveling import read_scan
from tasks.capture.poses.open3d import FoundPoses, Open3DPoses
from tasks.capture.poses.provider import GivenPoses, PosesConfig, moved_onto, with_poses
from tasks.capture.reading import Reading
from tasks.capture.small_objects.additions import SmallObjectsConfig, Unsought
from tasks.geometry.transforms import inverse, is_rigid
from tasks.stage import Context
from tests.capture_scans import box_room, write_posed_rgbd


def reading_of(folder: Path) -> Reading:
    (scan,), errors = find_scans(folder)
    assert not errors
    return read_scan(scan)


@pytest.fixture(scope="module")
def filmed() -> RoomFilm:
    return walk("bedroom", 1, 60)


@pytest.fixture(scope="module")
def python() -> str:
    """An interpreter that has open3d: METASCENES_OPEN3D, or this one after `make open3d`."""
    named = os.environ.get("METASCENES_OPEN3D", sys.executable)
    if Open3DPoses(python=named).problem():
        pytest.skip("neither this interpreter has open3d (make open3d), nor one that METASCENES_OPEN3D names")
    return named


@pytest.mark.whole
def test_a_walk_is_slow_and_the_same_twice(filmed: RoomFilm) -> None:
    again = walk("bedroom", 1, 60)
    assert all(np.array_equal(a.depth, b.depth) and np.array_equal(a.pose, b.pose) for a, b in zip(filmed.views, again.views, strict=True))
    steps = [inverse(a) @ b for a, b in itertools.pairwise(filmed.poses)]
    assert max(np.linalg.norm(step[:3, 3]) for step in steps) < 0.061
    assert max(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1)) for step in steps) < np.radians(6.1)


@pytest.mark.whole
def test_drift_is_a_share_of_the_way(filmed: RoomFilm) -> None:
    off = drifted(filmed.poses, 0.03, np.random.default_rng(0))
    assert all(is_rigid(pose) for pose in off)
    end = float(np.linalg.norm(off[-1, :3, 3] - filmed.poses[-1, :3, 3]))
    assert end == pytest.approx(0.03 * filmed.length_m, rel=0.01)
    assert error_m(filmed.poses, filmed.poses) < 1e-9


def test_given_poses_stay_and_are_held_against_the_depth(tmp_path: Path) -> None:
    true = reading_of(write_posed_rgbd(tmp_path / "room", box_room()))
    kept, notes = with_poses(true, PosesConfig(), "room")
    assert kept is true
    assert notes == []
    rng = np.random.default_rng(1)
    odd = []
    for frame in true.frames:
        assert frame.pose is not None
        aside = np.eye(4)
        aside[:3, 3] = rng.normal(0, 0.15, 3)
        odd.append(dataclasses.replace(frame, pose=aside @ frame.pose))
    reading = dataclasses.replace(true, frames=tuple(odd))
    kept, notes = with_poses(reading, PosesConfig(), "odd")
    assert kept is reading
    (note,) = notes
    assert "cm apart" in note
    assert "make open3d" in note
    _, (note,) = with_poses(dataclasses.replace(reading, surface=box_room().surface), PosesConfig(Open3DPoses(python="false")), "odd")
    assert "the scan's mesh stays as it is" in note


def test_no_poses_and_nobody_to_find_them(tmp_path: Path) -> None:
    folder = write_posed_rgbd(tmp_path / "room", box_room(cameras=3))
    (folder / "pose.txt").unlink()
    with pytest.raises(InputError, match=r"room: poses: there are none; .*pose.txt.*make open3d"):
        with_poses(reading_of(folder), PosesConfig(), "room")


@pytest.mark.parametrize("provider", [GivenPoses(), Open3DPoses(python="false")], ids=["given", "open3d"])
def test_one_frame_needs_no_pose(provider: GivenPoses | Open3DPoses, tmp_path: Path) -> None:
    """Its camera is the origin, whoever finds poses; a frame of a scan with a mesh has none."""
    folder = write_posed_rgbd(tmp_path / "room", box_room(cameras=1))
    (folder / "pose.txt").unlink()
    reading, (note,) = with_poses(reading_of(folder), PosesConfig(provider), "room")
    (frame,) = reading.frames
    assert frame.pose is not None
    np.testing.assert_array_equal(frame.pose, np.eye(4))
    assert frame.pose_source == "estimated"
    assert note == "poses: frame 000001 is the only one with depth and has no pose: its camera is the origin"
    meshed = dataclasses.replace(reading_of(folder), surface=box_room(cameras=1).surface)
    assert with_poses(meshed, PosesConfig(provider), "room")[0] is meshed


@pytest.mark.whole
def test_one_frame_becomes_a_scene(tmp_path: Path) -> None:
    folder = write_posed_rgbd(tmp_path / "room", box_room(cameras=1))
    (folder / "pose.txt").unlink()
    (scan,), _ = find_scans(folder)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig())
    assert [row.pose_source for row in outcome.rows["frames"]] == ["estimated"]
    assert len(outcome.rows["instances"]) > 0


@pytest.mark.parametrize(
    ("keys", "loops", "share", "words"),
    [
        (40, 20, 1.0, ""),
        (4, 20, 1.0, "found from 4 key frames: "),
        (40, 0, 1.0, "found from 0 closed loops: "),
        (40, 20, 0.1, "found from little motion (0."),
        (2, 1, 0.1, "found from 2 key frames, 1 closed loops, little motion (0."),
    ],
)
def test_drift_that_nothing_bounds_is_told(
    keys: int, loops: int, share: float, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses from few key frames or loops, or of a camera that hardly moved, come with a warning."""
    true = reading_of(write_posed_rgbd(tmp_path / "room", box_room()))
    count = len(true.frames) if share == 1.0 else 2
    poses = np.array([frame.pose for frame in true.frames[:1] * (len(true.frames) - count) + true.frames[:count]])
    poses[-1, :3, 3] = poses[0, :3, 3] + share * (poses[-1, :3, 3] - poses[0, :3, 3])
    poses[-1, :3, :3] = poses[-1, :3, :3] if share == 1.0 else poses[0, :3, :3]
    monkeypatch.setattr(Open3DPoses, "poses_of", lambda *_: FoundPoses(poses, "a stand-in", keys, loops))
    bare = dataclasses.replace(true, frames=tuple(dataclasses.replace(frame, pose=None) for frame in true.frames))
    _, notes = with_poses(bare, PosesConfig(Open3DPoses()), "room")
    warnings = [note for note in notes if "may drift" in note]
    assert [words in warning for warning in warnings] == [True] * bool(words)


@pytest.mark.parametrize("python", ["no_such_python", "false"])
def test_an_interpreter_that_does_not_work(python: str, tmp_path: Path) -> None:
    folder = write_posed_rgbd(tmp_path / "room", box_room(cameras=3))
    (folder / "pose.txt").unlink()
    with pytest.raises(InputError, match=r"capture.poses.provider.python: .*make open3d"):
        with_poses(reading_of(folder), PosesConfig(Open3DPoses(python=python)), "room")


@pytest.mark.whole
def test_the_motion_onto_given_poses(filmed: RoomFilm) -> None:
    motion = filmed.poses[7]
    np.testing.assert_allclose(moved_onto(motion @ filmed.poses, filmed.poses), motion, atol=1e-9)


@pytest.mark.slow
@pytest.mark.whole
def test_withheld_poses_are_found_and_rows_say_so(filmed: RoomFilm, python: str, tmp_path: Path) -> None:
    folder = write_scan(tmp_path / "video", filmed.views)
    (folder / "pose.txt").unlink()
    config = PosesConfig(Open3DPoses(python=python))
    first, notes = with_poses(reading_of(folder), config, "video")
    found = np.array([frame.pose for frame in first.frames if frame.pose is not None])
    assert len(found) == len(filmed.views)
    assert {frame.pose_source for frame in first.frames} == {"estimated"}
    assert error_m(filmed.poses, found) < 0.02
    assert "60 of 60 frames by Open3D" in notes[0]
    again, _ = with_poses(reading_of(folder), config, "video")
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(first.frames, again.frames, strict=True)), "bit for bit"
    (scan,), _ = find_scans(folder)
    context = Context(scan.scene_id, "capture", 0, {})
    outcome = run(scan=scan, context=context, config=CaptureConfig(poses=config, small_objects=SmallObjectsConfig(provider=Unsought())))
    assert {row.pose_source for row in outcome.rows["frames"]} == {"estimated"}


@pytest.mark.slow
@pytest.mark.whole
def test_poses_that_drift_are_refined_in_their_own_frame(filmed: RoomFilm, python: str, tmp_path: Path) -> None:
    off = drifted(filmed.poses, 0.08, np.random.default_rng(2))
    folder = write_scan(tmp_path / "off", [dataclasses.replace(view, pose=pose) for view, pose in zip(filmed.views, off, strict=True)])
    config = PosesConfig(Open3DPoses(python=python, always=True))
    reading, _ = with_poses(reading_of(folder), config, "off")
    found = np.array([frame.pose for frame in reading.frames])
    assert {frame.pose_source for frame in reading.frames} == {"refined"}
    assert error_m(filmed.poses, found) < 0.5 * error_m(filmed.poses, off)
    assert np.linalg.norm(found[:, :3, 3].mean(axis=0) - off[:, :3, 3].mean(axis=0)) < 1e-6, "where the scan was"
    kept, notes = with_poses(reading_of(folder), PosesConfig(GivenPoses()), "off")
    assert all(frame.pose_source == "file" for frame in kept.frames)
    assert isinstance(notes, list)
