"""Stray Scanner: frames by number, confidence, poses in a frame whose +Y is up, and a video that is no images yet."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import scan_files
from tasks.capture.wholeness import find_gap
from tasks.geometry.transforms import transform_points
from tests.tasks.capture.formats.phones import write_stray_scanner, write_video
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


def write_recording(folder: Path, images: int = 3) -> None:
    """A recording with a video of so many frames, and no images."""
    frames = sample().frames
    write_stray_scanner(folder, frames, is_extracted=False)
    write_video(folder / "rgb.mp4", [frames[k % 3].color() for k in range(images)])


def test_a_video_without_its_decoder_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recording(tmp_path / "a")
    monkeypatch.setattr("tasks.capture.stray_scanner.is_installed", lambda package: False)
    expected = (
        r"^a/rgb.mp4: frames: is decoded by PyAV, which is not installed; pip install \"metascenes\[video\]\", or in its folder: mkdir"
    )
    with pytest.raises(InputError, match=expected):
        read(tmp_path)


@pytest.mark.whole
def test_frames_of_a_video_are_those_of_its_images(tmp_path: Path) -> None:
    """Colors are the video's, lossy; poses, lenses and depth are those of the recording."""
    write_recording(tmp_path / "a")
    reading = read(tmp_path)
    assert [frame.color_file for frame in reading.frames] == ["rgb.mp4#0", "rgb.mp4#1", "rgb.mp4#2"]
    for mine, native in zip(reading.frames, sample().frames, strict=True):
        assert np.abs(mine.color().astype(float) - native.color()).mean() < 8
        np.testing.assert_allclose(np.asarray(mine.pose), np.asarray(native.pose), atol=1e-9)
        np.testing.assert_allclose(mine.intrinsics, native.intrinsics, atol=1e-9)
        assert mine.depth is not None
        assert mine.depth().any()
    assert [path.name for path in scan_files(only_scan(tmp_path))].count("rgb.mp4") == 1
    assert find_gap(only_scan(tmp_path)) is None


@pytest.mark.whole
@pytest.mark.parametrize("images", [pytest.param(2, marks=pytest.mark.slow), 5])
def test_a_video_of_another_length_is_named(images: int, tmp_path: Path) -> None:
    write_recording(tmp_path / "a", images)
    reading = read(tmp_path)
    assert len(reading.frames) == min(images, 3)
    assert any(f"rgb.mp4: has {images} frames, depth has numbers up to 2" in note for note in reading.degradations)


@pytest.mark.slow
@pytest.mark.whole
def test_of_a_long_video_every_so_many_frames_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recording(tmp_path / "a")
    monkeypatch.setattr("tasks.capture.files.unpacked.MAX_FRAMES", 2)
    reading = read(tmp_path)
    assert [frame.color_file for frame in reading.frames] == ["rgb.mp4#0", "rgb.mp4#2"]
    assert any("1 of every 2 frames is used, of 3 in all" in note for note in reading.degradations)


@pytest.mark.whole
@pytest.mark.parametrize(
    "content",
    [
        b"",
        *(pytest.param(content, marks=pytest.mark.slow) for content in (b"ftyp", bytes(4000))),
        b"\0\0\0\x18ftypisom" + bytes(range(256)) * 20,
    ],
)
def test_a_broken_video_is_refused(content: bytes, tmp_path: Path) -> None:
    write_stray_scanner(tmp_path / "a", sample().frames, is_extracted=False)
    (tmp_path / "a" / "rgb.mp4").write_bytes(content)
    with pytest.raises(InputError, match=r"^a/rgb.mp4: (content|streams): "):
        read(tmp_path)


def test_a_high_number_does_not_raise_the_computing_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A depth image is worth a second of video: its number may be wrong."""
    write_recording(tmp_path / "a")
    shutil.copy(tmp_path / "a" / "depth" / "000002.png", tmp_path / "a" / "depth" / "999999999.png")
    asked: list[int] = []

    def refused(code: str, path: Path, name: str, arguments: list[str], frames: int) -> None:
        asked.extend([int(arguments[1]), frames])
        raise InputError(name, "content", "is not decoded here", "none")

    monkeypatch.setattr("tasks.capture.stray_scanner.unpacked", refused)
    with pytest.raises(InputError, match="is not decoded here"):
        read(tmp_path)
    assert max(asked) <= 4 * 60 + 1


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
