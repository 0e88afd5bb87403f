"""TUM RGB-D: images and poses that belong together by time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.capture.files.stamps import associated
from tasks.capture.leveling import read_scan
from tasks.capture.wholeness import find_gap
from tests.capture_scans import box_room, write_posed_rgbd
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


LISTS: dict[str, Callable[[str, str], str]] = {
    "blanks and tabs": lambda time, image: f" \t{time}\t {image} \t",
    "comments at the end": lambda time, image: f"{time} {image}   # a note",
    "commas": lambda time, image: f"{time},{image}",
    "17 decimals": lambda time, image: f"{float(time):.17f} {image}",
    "an exponent": lambda time, image: f"{float(time):.17e} {image}",
    "nanoseconds": lambda time, image: f"{round(float(time) * 1e6) * 1000} {image}",
    "backslashes": lambda time, image: f"{time} .\\{image.replace('/', chr(92))}",
    "quotes": lambda time, image: f'{time} "{image}"',
}


@pytest.mark.parametrize("style", LISTS)
def test_lists_of_any_writer(style: str, tmp_path: Path) -> None:
    """Byte order mark, line ends of Windows, lines in another order, a line twice: the frames are the same."""
    write_sample(tmp_path / "a")
    before = read(tmp_path).frames
    for name in ("rgb.txt", "depth.txt"):
        path = tmp_path / "a" / name
        rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
        lines = ["   # indented", "", *(LISTS[style](*row) for row in rows[::-1])]
        path.write_bytes(("\ufeff" + "\r\n".join([*lines, lines[-1]]) + "\r\n").encode())
    reading = read(tmp_path)
    assert_same_frames(reading.frames, before)
    assert reading.degradations[:2] == tuple(f"a/{name}: 1 lines repeat another one: left out" for name in ("rgb.txt", "depth.txt"))
    assert find_gap(only_scan(tmp_path)) is None


def test_an_image_has_one_time(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    with (tmp_path / "a" / "rgb.txt").open("a") as file:
        file.write("1305031102.5 rgb/1305031102.000000.png\n")
    problem = r"^a/rgb.txt: line 7: has 'rgb/1305031102.000000.png' at 1305031102.500000, line 4 at 1305031102.000000; "
    with pytest.raises(InputError, match=problem):
        read(tmp_path)


def test_lists_of_two_recordings_name_both_spans(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "depth.txt"
    path.write_text(path.read_text().replace("\n13050", "\n23050"))
    with pytest.raises(InputError, match=r"it covers 2305031102.010 to .* s, and rgb.txt 1305031101.000 to 1305031102.067 s"):
        read(tmp_path)


def test_millimeters_are_not_the_unit_of_the_format(tmp_path: Path) -> None:
    """The room would have a fifth of its size; with the unit stated, it is read."""
    room = read_scan(only_scan(write_posed_rgbd(tmp_path / "true" / "room", box_room())))
    folder = write_tum_rgbd(tmp_path / "tum" / "a", room.frames)
    for path in (folder / "depth").iterdir():
        Image.fromarray((np.asarray(Image.open(path)) // 5).astype(np.uint16)).save(path)
    problem = r"^a/intrinsics.json: depth_scale: 5000 units per meter and the poses of a/groundtruth.txt contradict each other: with 1000"
    with pytest.raises(InputError, match=problem):
        read(folder.parent)
    stated = json.loads((folder / "intrinsics.json").read_text())
    (folder / "intrinsics.json").write_text(json.dumps(stated | {"depth_scale": 1000}))
    assert_same_frames(read(folder.parent).frames, room.frames)


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
