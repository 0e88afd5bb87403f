"""Order of images, and which depth, pose and time belong to each."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.capture.files.frames import exported_frames
from tasks.capture.files.images import read_depth
from tasks.capture.files.lenses import matrix_intrinsics
from tasks.capture.files.stamps import associated, in_seconds, natural_order, number_of, partners, time_of
from tasks.capture.files.trajectory import read_trajectory
from tasks.capture.layout import frame_ids, frame_layout

EYE = "0 0 0 1"


def stamp(index: int) -> str:
    return f"{1305031102.0 + index / 15:.6f}"


def paired(text: str, keys: list[str], place: Path, notes: list[str] | None = None) -> tuple[list[int | None], dict[int, str]]:
    """Pose of each image, by its x, and the reasons of the others."""
    path = place / "groundtruth.txt"
    path.write_bytes(text.encode())
    poses, reasons = read_trajectory(path, path.name, keys, notes=notes)
    return [None if pose is None else round(pose[0, 3]) for pose in poses], reasons


@pytest.mark.parametrize(
    "names",
    [
        [stamp(index) for index in range(40)],
        [str(index) for index in range(12)],
        ["2.5", "9.99", "10.01", "11"],
        [f"frame-{index:06d}" for index in range(12)],
        ["1305031101_999999999", "1305031102_5", "1305031102_000100000"],
        [str(1403636579763555584 + 50_000_000 * index) for index in range(5)],
        ["walk_1.9", "walk_1.10"][::-1],
    ],
)
def test_names_are_in_the_order_of_their_numbers(names: list[str]) -> None:
    assert sorted(sorted(names), key=natural_order) == names
    ids = frame_ids(names)
    assert ids == sorted(set(ids)), "ids have the same order"


@given(st.lists(st.integers(0, 2**31), min_size=1, unique=True), st.integers(1, 9))
def test_times_are_in_their_own_order(ticks: list[int], digits: int) -> None:
    names = [f"{tick / 10**digits:.{digits}f}" for tick in sorted(ticks)]
    assert sorted(names, key=natural_order) == names
    assert [time_of(name) for name in names] == [float(name) for name in names]


def test_images_named_by_time_are_taken_in_its_order(tmp_path: Path) -> None:
    names = [stamp(index) for index in range(25)]
    for kind in ("rgb", "depth"):
        (tmp_path / kind).mkdir()
        for name in names:
            (tmp_path / kind / f"{name}.png").write_bytes(b"")
    layout = frame_layout(tmp_path)
    assert layout is not None
    assert [frame.key for frame in layout.frames] == names
    assert all(frame.depth is not None and frame.depth.name == frame.color.name for frame in layout.frames)


ROWS = {
    "in order": (range(10), range(10)),
    "a pose lost, one more at the end": ([0, 1, 2, 3, 4, 6, 7, 8, 9, 10], [0, 1, 2, 3, 4, None, 6, 7, 8, 9]),
    "reversed": (range(9, -1, -1), range(10)),
    "one more pose": (range(11), range(10)),
}


@pytest.mark.parametrize("unit", [1, 10**3, 10**6, 10**9])
@pytest.mark.parametrize("case", ROWS)
def test_a_pose_belongs_to_the_image_of_its_time(case: str, unit: int, tmp_path: Path) -> None:
    """As many poses as images or not, in any order, and in seconds, milli-, micro- or nanoseconds."""
    rows, expected = ROWS[case]
    time = (lambda index: stamp(index)) if unit == 1 else (lambda index: str(round(float(stamp(index)) * unit)))
    text = "".join(f"{time(index)} {index}.0 0 0 {EYE}\n" for index in rows)
    poses, reasons = paired(text, [stamp(index) for index in range(10)], tmp_path)
    assert poses == list(expected)
    assert reasons == {index: "none in the trajectory" for index in range(10) if poses[index] is None}


@pytest.mark.parametrize("case", ROWS)
def test_a_pose_belongs_to_the_image_of_its_number(case: str, tmp_path: Path) -> None:
    rows, expected = ROWS[case]
    text = "".join(f"{index} {index}.0 0 0 {EYE}\n" for index in rows)
    log = "".join(f"{index} {index} {index + 1}\n1 0 0 {index}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for index in rows)
    for content in (text, log):
        assert paired(content, [f"frame-{index:06d}" for index in range(10)], tmp_path)[0] == list(expected)


def test_two_ways_of_counting_are_a_note(tmp_path: Path) -> None:
    notes: list[str] = []
    text = "".join(f"{index} {index}.0 0 0 {EYE}\n" for index in range(5))
    assert paired(text, [str(index + 1) for index in range(5)], tmp_path, notes)[0] == [0, 1, 2, 3, 4]
    assert notes == ["groundtruth.txt: numbers poses from 0 and the images are numbered from 1: as many of both, paired in order"]
    notes.clear()
    assert paired(f"0 0 0 {EYE}\n" * 5, ["0", "1", "2"], tmp_path, notes)[0] == [0, 0, 0]
    assert "has 5 poses for 3 images" in notes[0]


@given(st.integers(0, 999_999_999), st.integers(1, 24))
def test_a_number_with_leading_zeros_is_no_time(number: int, digits: int) -> None:
    for name in (f"{number:0{digits}d}", f"frame_{number:0{digits}d}"):
        assert number_of(name) == number
        assert time_of(name) is None
    assert number_of(f"0{number:09d}_000001") == 1


@pytest.mark.parametrize("digits", [6, 9, 10, 13, 16, 19])
def test_poses_of_numbered_images_of_any_width(digits: int, tmp_path: Path) -> None:
    """With stamps of their own, with numbers, as many unstamped rows or more."""
    keys = [f"{index:0{digits}d}" for index in range(3)]
    for heads, count in (([stamp(index) for index in range(3)], 3), (["0", "1", "2"], 3), ([""] * 3, 3), ([""] * 4, 4)):
        text = "".join(f"{heads[index % 3]} {index}.0 0 0 {EYE}\n" for index in range(count))
        assert paired(text, keys, tmp_path) == ([0, 1, 2], {})


def written_numbers(numbers: Sequence[float], is_log: bool) -> str:
    """A trajectory whose poses have their number as x."""
    if is_log:
        return "".join(f"{k} {k} {k + 1}\n1 0 0 {k}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for k in numbers)
    return "".join(f"{k} {k}.0 0 0 {EYE}\n" for k in numbers)


@pytest.mark.parametrize("is_log", [False, True])
@pytest.mark.parametrize("start", [0.0, 1305031102.1])
@pytest.mark.parametrize("numbers", [range(40), range(39, -1, -1), range(1, 41), range(0, 200, 5)])
def test_numbers_of_poses_count_images_in_the_order_of_time(numbers: Sequence[int], start: float, is_log: bool, tmp_path: Path) -> None:
    keys, notes = [f"{start + index / 30:.6f}" for index in range(40)], list[str]()
    assert paired(written_numbers(numbers, is_log), keys[::-1], tmp_path, notes) == (sorted(numbers)[::-1], {})
    counts = f"numbers 40 poses from {min(numbers)} to {max(numbers)}, and 40 images are named by time"
    assert notes == [f"groundtruth.txt: {counts}: paired in the order of numbers and times"]


@pytest.mark.parametrize("numbers", [range(39), range(50), [*range(20), *range(21, 41)]])
def test_numbers_that_may_be_of_other_frames_than_the_images_pair_none(numbers: Sequence[int], tmp_path: Path) -> None:
    """Also where single numbers are near the times of images."""
    keys, notes = [f"{index / 30:.6f}" for index in range(40)], list[str]()
    poses, reasons = paired(written_numbers(numbers, is_log=False), keys, tmp_path, notes)
    assert poses == [None] * 40
    assert set(reasons) == set(range(40))
    assert notes[0].endswith("40 images are named by time: not paired; write a pose for each image, or name images by number")


def test_whole_numbers_are_times_of_images_at_whole_seconds(tmp_path: Path) -> None:
    assert paired(written_numbers(range(2, 9), is_log=False), ["1.0", "2.01", "3.0"], tmp_path)[0] == [None, 2, 3]
    assert paired(written_numbers(range(3), is_log=False), ["0.0", "0.5", "1.0", "1.5", "2.0"], tmp_path)[0] == [0, None, 1, None, 2]


def test_times_of_poses_alone_need_rows_in_order(tmp_path: Path) -> None:
    """Images without times get the poses in order, if the order of rows is that of time; otherwise the two contradict each other."""
    keys = [str(index) for index in range(10)]
    rows = [f"{stamp(index)} {index}.0 0 0 {EYE}\n" for index in range(10)]
    assert paired("".join(rows), keys, tmp_path)[0] == list(range(10))
    with pytest.raises(InputError, match=r"groundtruth.txt: row 1: .* rows and times state two orders"):
        paired("".join(rows[::-1]), keys, tmp_path)
    with pytest.raises(InputError, match=r"has 9 poses with times, and the 10 images have no times in their names"):
        paired("".join(rows[1:]), keys, tmp_path)


def test_no_common_time_names_both_spans(tmp_path: Path) -> None:
    _, reasons = paired(f"5.0 0 0 0 {EYE}\n6.5 0 0 0 {EYE}\n", ["1305031102.5", "1305031103.5"], tmp_path)
    assert reasons[0].endswith("images are from 1305031102.500000 to 1305031103.500000 s, poses from 5.000000 to 6.500000 s")


def test_two_poses_of_one_time_are_neither(tmp_path: Path) -> None:
    poses, reasons = paired(f"1.5 0 0 0 {EYE}\n1.5 1 0 0 {EYE}\n2.5 2 0 0 {EYE}\n2.5 2 0 0 {EYE}\n", ["1.5", "2.5"], tmp_path)
    assert poses == [None, 2]
    assert reasons == {0: "rows 0 and 1 state two poses for one time"}


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff# a\r\n\t 1.5  1 0 0 0 0 0 1 # at the end\r\n   # indented\r\n\t2.5, 2, 0, 0, 0, 0, 0, 1\r\n",
        "1.50000000000000000 1 0 0 0 0 0 1\n2.4999999999999999 2 0 0 0 0 0 1\n",
        "1.5e0 1 0 0 0 0 0 1\n25E-1 2 0 0 0 0 0 1\n",
        "timestamp tx ty tz qx qy qz qw\n1.5;1;0;0;0;0;0;1\n2.5;2;0;0;0;0;0;1\n",
        "% matlab\n// or C\n1.5 1 0 0 0 0 0 0.98\n2.5 2 0 0 0 0 0 1.04\n",
    ],
)
def test_rows_of_any_writer(text: str, tmp_path: Path) -> None:
    assert paired(text, ["1.5", "2.5"], tmp_path) == ([1, 2], {})


def test_an_order_of_quaternions_in_a_comment_counts(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("# timestamp tx ty tz qw qx qy qz\n0 0 0 0 1 0 0 0\n")
    (pose,), _ = read_trajectory(path, path.name, ["0"])
    assert pose is not None
    assert np.allclose(pose, np.eye(4))
    with pytest.raises(InputError, match=r"says quaternions are qw qx qy qz, the scan's description qx qy qz qw"):
        read_trajectory(path, path.name, ["0"], "tx ty tz qx qy qz qw")


def test_rows_without_a_pose_say_why(tmp_path: Path) -> None:
    text = f"0 0 0 0 0 0 0 0\n1 nan 0 0 {EYE}\n2 -inf 0 0 {EYE}\n3 0 0 0 0 0 0 2.3\n4 4 0 0 {EYE}\n"
    poses, reasons = paired(text, list("01234"), tmp_path)
    assert poses == [None, None, None, None, 4]
    assert list(reasons.values()) == ["its quaternion has length 0, not 1", "not finite", "-inf", "its quaternion has length 2.3, not 1"]
    with pytest.raises(InputError, match=r"its first four numbers have length 1 as a quaternion, its last four 7.* tx ty tz qx qy qz qw"):
        paired("0 0 0 1 5 5 -0.1\n0 0 1 0 7 -1 0.2\n", ["0", "1"], tmp_path)


@pytest.mark.parametrize("shape", ["16", "12", "square", "log"])
def test_matrices_by_columns_are_read_so(shape: str, tmp_path: Path) -> None:
    """Also the first, at the origin, which both readings allow."""
    turned = np.array([[0.0, -1, 0, 3], [1, 0, 0, 0.5], [0, 0, 1, 2], [0, 0, 0, 1]])
    near = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    texts, path, notes = [], tmp_path / "poses.txt", list[str]()
    for index, pose in enumerate((near, turned)):
        values = pose.T[:, :3] if shape == "12" else pose.T
        lines = [" ".join(map(str, row)) for row in values]
        head = [f"{index} {index} {index + 1}"] if shape == "log" else []
        texts.append("\n".join(head + lines) if shape in ("square", "log") else " ".join(lines))
    path.write_text("\n".join(texts) + "\n")
    poses, reasons = read_trajectory(path, path.name, ["0", "1"], notes=notes)
    np.testing.assert_allclose(np.array(poses), np.array([near, turned]))
    assert reasons == {}
    assert notes == ["poses.txt: matrices are rigid by columns only (translation last), and read so"]


@given(st.lists(st.integers(0, 400).map(lambda t: t / 1000), max_size=12, unique=True))
def test_partners_are_the_same_names_or_near_times(times: list[float]) -> None:
    names = [f"{time:.3f}" for time in times]
    assert partners(names, names) == {name: name for name in names}
    late = [f"{time + 0.004:.4f}" for time in times]
    pairs = partners(names, late)
    assert all(abs(float(name) - float(other)) <= 0.02 for name, other in pairs.items())
    assert len(set(pairs.values())) == len(pairs) == len(associated(times, [float(name) for name in late]))


def test_partners_by_number() -> None:
    assert partners(["rgb_01", "rgb_2"], ["depth_2", "depth_0001"]) == {"rgb_01": "depth_0001", "rgb_2": "depth_2"}
    assert partners(["a_1", "b_1"], ["depth_1"]) == {}
    assert in_seconds([1.5, 2.5]) == [1.5, 2.5]


def write_images(folder: Path, color: list[str], depth: dict[str, np.ndarray], **stated: object) -> Path:
    """A folder of frames with intrinsics."""
    for kind in ("color", "depth"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for name in color:
        Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(folder / "color" / name)
    for name, values in depth.items():
        Image.fromarray(values).save(folder / "depth" / name)
    numbers = {"fx": 40, "fy": 40, "cx": 19.5, "cy": 14.5, "width": 40, "height": 30}
    (folder / "intrinsics.json").write_text(json.dumps(numbers | stated))
    return folder


def read_images(folder: Path) -> tuple[list[float], list[str]]:
    """Median depth [m] of each frame, 0 without any, and the notes."""
    layout = frame_layout(folder)
    assert layout is not None
    frames, notes = exported_frames(layout, folder, {})
    return [0.0 if frame.depth is None else float(np.median(frame.depth())) for frame in frames], notes


def millimeters(value: int) -> np.ndarray:
    return np.full((30, 40), value, np.uint16)


def test_another_count_of_depth_is_noted(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png", "1.png", "2.png"], {"1.png": millimeters(1500), "7.png": millimeters(1)})
    depths, notes = read_images(folder)
    assert depths == [0.0, 1.5, 0.0]
    assert notes[0] == "1 files of depth have no color image, or are not read: left out: 7.png"
    assert notes[-1] == "2 of 3 color images have no depth image: 000000, 000002"


def test_depth_that_belongs_to_no_image_is_refused(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png", "1.png"], {})
    (folder / "depth" / "0.exr").write_bytes(b"v/1\x01")
    with pytest.raises(InputError, match=r"^a/depth/0.exr: depth: none of 1 files is the depth of one of 2 color images, as a/color/0.png"):
        read_images(folder)


def test_depth_of_near_times_and_of_equal_numbers_is_paired(tmp_path: Path) -> None:
    write_images(tmp_path / "times", ["9.99.png", "10.01.png"], {"10.015.png": millimeters(2000), "9.985.png": millimeters(1000)})
    assert read_images(tmp_path / "times")[0] == [1.0, 2.0]
    write_images(tmp_path / "numbers", ["rgb_1.png", "rgb_10.png"], {"d_0010.png": millimeters(2000), "d_0001.png": millimeters(1000)})
    assert read_images(tmp_path / "numbers")[0] == [1.0, 2.0]


def test_floats_are_meters_unless_a_file_says_otherwise(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png"], {"0.tiff": np.full((30, 40), 1.75, np.float32)})
    assert read_images(folder)[0] == [1.75]
    folder = write_images(tmp_path / "b", ["0.png"], {"0.tiff": np.full((30, 40), 1750, np.float32)}, depth_scale=1000)
    assert read_images(folder)[0] == [1.75]


def test_the_largest_value_is_no_reading_and_8_bits_are_no_depth(tmp_path: Path) -> None:
    values = millimeters(40_000)
    values[0, :7] = 65535
    Image.fromarray(values).save(tmp_path / "0.png")
    depth = read_depth(tmp_path / "0.png", "0.png", (40, 30), 1000.0)
    assert (depth == 0).sum() == 7
    assert np.unique(depth).tolist() == [0.0, 40.0]
    Image.fromarray(values.astype(np.uint8)).save(tmp_path / "1.png")
    with pytest.raises(InputError, match=r"has 8 bits: at 1000 units per meter they reach 0.26 m; export depth as 16-bit"):
        read_depth(tmp_path / "1.png", "1.png", (40, 30), 1000.0)


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({"width": 30, "height": 40}, "are for images of 30 x 40 pixels, and the images have 40 x 30 pixels: turned by 90 degrees"),
        ({"width": 160, "height": 90}, "are for images of 160 x 90 pixels, .* another shape"),
    ],
)
def test_intrinsics_of_images_of_another_shape(stated: dict[str, int], words: str, tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png"], {"0.png": millimeters(1500)}, **stated)
    with pytest.raises(InputError, match=rf"^a/intrinsics.json: intrinsics: {words}"):
        read_images(folder)


@pytest.mark.parametrize(("shape", "words"), [((40, 30), "turned by 90 degrees"), ((42, 51), "another shape")])
def test_depth_of_another_shape_needs_its_own_intrinsics(shape: tuple[int, int], words: str, tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png"], {"0.png": np.full(shape, 1500, np.uint16)})
    with pytest.raises(InputError, match=rf"the depth images have .*, the color images 40 x 30 pixels: {words}"):
        read_images(folder)
    (folder / "intrinsic_depth.txt").write_text("30 0 15\n0 30 20\n0 0 1\n")
    assert read_images(folder)[0] == [1.5]


MATRICES: dict[str, str] = {
    "four": "525, 526, 319.5, 239.5",
    "3x3": "# K\n525 0 319.5\n0 526 239.5\n0 0 1\n",
    "3x4": "525 0 319.5 0 0 526 239.5 0 0 0 1 0",
    "4x4": "525 0 319.5 0\n0 526 239.5 0\n0 0 1 0 # real camera\n0 0 0 1\n",
    "by columns": "525 0 0\n0 526 0\n319.5 239.5 1\n",
}


@pytest.mark.parametrize("kind", MATRICES)
def test_intrinsics_of_any_writer(kind: str) -> None:
    assert matrix_intrinsics(MATRICES[kind], "camera.txt") == (525.0, 526.0, 319.5, 239.5)


def test_pose_files_of_three_rows_and_by_columns(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["0.png", "1.png"], {"0.png": millimeters(900), "1.png": millimeters(900)})
    (folder / "pose").mkdir()
    pose = np.array([[0.0, -1, 0, 3], [1, 0, 0, 0.5], [0, 0, 1, 2], [0, 0, 0, 1]])

    def write(change: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, list[str]]:
        for index in range(2):
            np.savetxt(folder / "pose" / f"{index}.txt", change(pose))
        layout = frame_layout(folder)
        assert layout is not None
        frames, notes = exported_frames(layout, folder, {})
        return np.array([frame.pose for frame in frames]), notes

    for change, lines in ((lambda m: m, 0), (lambda m: m[:3], 0), (lambda m: m.T, 1)):
        poses, notes = write(change)
        np.testing.assert_allclose(poses, [pose, pose], atol=1e-12)
        assert len(notes) == lines
    mirrored = write(lambda m: m @ np.diag([1.0, -1, 1, 1]))[1]
    assert mirrored == ["2 of 2 frames without a pose (mirrored: left-handed axes): 000000, 000001"]
