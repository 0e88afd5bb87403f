"""Stray Scanner: frames by number, confidence, poses in a frame whose +Y is up, and a video that is no images yet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.wholeness import find_gap
from tasks.geometry.transforms import transform_points
from tests.tasks.capture.formats.phones import write_stray_scanner
from tests.tasks.capture.formats.written import only_scan, read, sample


def write_sample(folder: Path) -> None:
    """Three frames of a room with a chair."""
    write_stray_scanner(folder, sample().frames)


def test_frames_are_those_of_the_native_format(tmp_path: Path) -> None:
    """Colors, lenses, poses, and depth where the sensor has confidence in it."""
    write_sample(tmp_path / "71de12f9")
    reading = read(tmp_path)
    assert len(reading.frames) == 3
    for mine, native in zip(reading.frames, sample().frames, strict=True):
        np.testing.assert_array_equal(mine.color(), native.color())
        assert mine.depth is not None
        assert native.depth is not None
        np.testing.assert_array_equal(mine.depth()[:, 10:], native.depth()[:, 10:])
        assert not mine.depth()[:, :10].any()
        np.testing.assert_allclose(mine.pose, native.pose, atol=1e-9)
        np.testing.assert_allclose([*mine.intrinsics, *mine.depth_intrinsics], [*native.intrinsics, *native.depth_intrinsics], atol=1e-9)
    assert find_gap(only_scan(tmp_path)) is None


def test_a_video_is_told_how_to_become_images(tmp_path: Path) -> None:
    write_stray_scanner(tmp_path / "a", sample().frames, is_extracted=False)
    with pytest.raises(InputError, match=r"^a/rgb.mp4: frames: a video is not read, .* in its folder: mkdir rgb && ffmpeg -i rgb.mp4 "):
        read(tmp_path)


def test_intrinsics_of_each_frame_and_smaller_images_are_known(tmp_path: Path) -> None:
    """Later versions state a lens for each frame; frames that were extracted at half the size have half of it."""
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "odometry.csv"
    head, *rows = path.read_text().splitlines()
    (tmp_path / "a" / "camera_matrix.csv").write_text("100, 0, 39\n0, 100, 29\n0, 0, 1\n")
    path.write_text("\n".join([f"{head}, fx, fy, cx, cy", *(f"{row}, {100 + k}, 100, 39, 29" for k, row in enumerate(rows))]) + "\n")
    frames = read(tmp_path).frames
    assert [frame.intrinsics[0] * 2 for frame in frames] == pytest.approx([100 * 40 / 39, 101 * 40 / 39, 102 * 40 / 39])


def test_a_frame_that_the_odometry_lacks_has_no_pose(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "odometry.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:3]) + "\n")
    reading = read(tmp_path)
    assert [frame.pose is None for frame in reading.frames] == [False, False, True]
    pose = reading.frames[0].pose
    assert pose is not None
    assert transform_points([[0.0, -1.0, 0.0]], pose)[0, 2] > pose[2, 3], "up in the picture is up"
