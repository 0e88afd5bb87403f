"""TUM RGB-D: images and poses that belong together by time."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.tum_rgbd import associated
from tasks.capture.wholeness import find_gap
from tests.tasks.capture.formats.written import assert_same_frames, only_scan, read, sample, write_tum_rgbd


def write_sample(folder: Path) -> None:
    """Three frames of a room with a chair."""
    write_tum_rgbd(folder, sample().frames)


def test_frames_are_those_of_the_native_format(tmp_path: Path) -> None:
    write_sample(tmp_path / "rgbd_dataset_freiburg2_desk")
    reading = read(tmp_path)
    assert_same_frames(reading.frames, sample().frames)
    assert (reading.surface, reading.groups) == (None, None)
    assert reading.degradations == ("1 of 4 color images have no depth image within 0.02 s: left out",)
    assert find_gap(only_scan(tmp_path)) is None


def test_without_a_trajectory_there_are_no_poses(tmp_path: Path) -> None:
    write_tum_rgbd(tmp_path / "a", sample().frames, is_tracked=False)
    reading = read(tmp_path)
    assert [frame.pose for frame in reading.frames] == [None] * 3
    assert reading.degradations[-1] == "no groundtruth.txt in the scan: no poses"


@pytest.mark.parametrize(("name", "focal"), [("rgbd_dataset_freiburg1_xyz", 517.3), ("Freiburg3_office", 535.4), ("desk", 525.0)])
def test_the_benchmarks_own_cameras_are_known_by_name(name: str, focal: float, tmp_path: Path) -> None:
    write_sample(tmp_path / name)
    (tmp_path / name / "intrinsics.json").unlink()
    frame = read(tmp_path).frames[0]
    assert frame.intrinsics[0] == pytest.approx(focal * frame.width / 640)


@pytest.mark.parametrize("line", ["1305031102.0 ../../etc/passwd", "1305031102.0 rgb/none.png", "later rgb/first.png", "1305031102.0"])
def test_a_list_names_images_of_the_scan(line: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    (tmp_path / "a" / "rgb.txt").write_text(line + "\n")
    with pytest.raises(InputError, match=r"^a/rgb.txt: line 1: "):
        read(tmp_path)


def test_images_that_a_list_names_and_that_are_not_there_are_a_gap(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    (tmp_path / "a" / "rgb" / "first.png").unlink()
    gap = find_gap(only_scan(tmp_path))
    assert gap is not None
    assert not gap.is_readable
    assert gap.what == "rgb.txt: lists 1 images that are not there, as rgb/first.png"


TIMES = st.lists(st.integers(0, 400).map(lambda t: t / 1000), max_size=12, unique=True)


@given(TIMES, TIMES)
def test_every_image_belongs_to_one_at_most_and_near_ones_to_somebody(color: list[float], depth: list[float]) -> None:
    pairs = associated(color, depth)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    assert all(abs(color[i] - depth[j]) <= 0.02 for i, j in pairs)
    free_depth = set(range(len(depth))) - {j for _, j in pairs}
    for i in set(range(len(color))) - {i for i, _ in pairs}:
        order = sorted(range(len(depth)), key=lambda j: abs(depth[j] - color[i]))[:1]
        assert not any(j in free_depth and abs(color[i] - depth[j]) < 0.02 for j in order), "nobody has its nearest"
