"""Facts of a recording that contradict each other: each fault is found by its depth, and correct recordings have none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.consistency.hypotheses import CONVENTIONS, USUAL
from tasks.capture.files.trajectory import as_described, as_written
from tasks.capture.leveling import height_notes, read_scan
from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import inverse, look_at, pose_from_quaternion_wxyz, quaternion_wxyz, translation
from tests.capture_scans import box_room, write_posed_rgbd
from tests.tasks.capture.formats.written import only_scan

Frames = tuple[FrameSource, ...]
Pose = NDArray[np.float64]

STATED = Statements("pose.txt", "intrinsics.json", "depth", has_quaternions=True)
OPEN = dataclasses.replace(STATED, is_open=True)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    """Twelve frames of a room whose facts agree, in memory."""
    folder = write_posed_rgbd(tmp_path_factory.mktemp("agreeing") / "room", box_room())
    return tuple(with_depth(frame, 1.0) for frame in read_scan(only_scan(folder)).frames)


def with_depth(frame: FrameSource, factor: float) -> FrameSource:
    """A frame whose depth is read in another unit."""
    assert frame.depth is not None
    depth = frame.depth() * np.float32(factor)
    return dataclasses.replace(frame, depth=lambda: depth, depth_scale=frame.depth_scale / factor)


def with_lens(frame: FrameSource, factor: float) -> FrameSource:
    """A frame with another focal length, in color and depth."""
    zoom = np.array([factor, factor, 1.0, 1.0])
    color, depth = (tuple((np.array(lens) * zoom).tolist()) for lens in (frame.intrinsics, frame.depth_intrinsics))
    return dataclasses.replace(frame, intrinsics=color, depth_intrinsics=depth)


def with_poses(frames: Frames, change: Callable[[Pose], Pose]) -> Frames:
    return tuple(dataclasses.replace(frame, pose=change(frame.pose)) for frame in frames if frame.pose is not None)


def written_real_first(pose: Pose) -> Pose:
    """A pose whose quaternion was written w x y z, and is read x y z w."""
    w, x, y, z = quaternion_wxyz(pose)
    return pose_from_quaternion_wxyz((z, w, x, y), pose[:3, 3])


def enlarged(pose: Pose, factor: float) -> Pose:
    result = pose.copy()
    result[:3, 3] *= factor
    return result


def assert_same_poses(mine: Frames, true: Frames) -> None:
    for one, other in zip(mine, true, strict=True):
        assert one.pose is not None
        assert other.pose is not None
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-9)


def test_facts_that_agree_are_left_alone(frames: Frames) -> None:
    for statements in (STATED, OPEN):
        result, notes = settled(frames, statements)
        assert notes == []
        assert all(one is other for one, other in zip(result, frames, strict=True))


@pytest.mark.parametrize("meaning", CONVENTIONS)
def test_a_description_is_undone(meaning: str) -> None:
    pose = look_at([1.0, 2.0, 1.5], [0.0, 0.3, 0.2])
    np.testing.assert_allclose(as_described(as_written(pose, meaning), meaning), pose, atol=1e-12)


FAULTS: dict[str, Callable[[Pose], Pose]] = {
    **{meaning: partial(as_written, described=meaning) for meaning in CONVENTIONS if meaning != USUAL},
    "qw qx qy qz": written_real_first,
    "qw qx qy qz world-to-camera": lambda pose: written_real_first(inverse(pose)),
}


@pytest.mark.parametrize("meaning", FAULTS)
def test_poses_of_another_convention(meaning: str, frames: Frames) -> None:
    """Read as meant where nothing states a convention, and refused with both sides where something does."""
    wrong = with_poses(frames, FAULTS[meaning])
    result, (note,) = settled(wrong, OPEN)
    assert_same_poses(result, frames)
    assert note.startswith(f"poses read as {meaning}:")
    with pytest.raises(InputError, match=rf"^pose.txt: poses: .*'camera-to-world' contradict each other: as {meaning} depth agrees"):
        settled(wrong, STATED)


def test_a_stated_convention_that_depth_contradicts(frames: Frames) -> None:
    wrong = with_poses(frames, inverse)  # as a reader has camera-to-world poses that a file calls world-to-camera
    statements = dataclasses.replace(STATED, described="world-to-camera, real part last")
    with pytest.raises(InputError, match=r"'world-to-camera, real part last' contradict each other: as camera-to-world depth agrees"):
        settled(wrong, statements)
    assert settled(frames, statements) == (frames, [])


@pytest.mark.parametrize(("factor", "words"), [(5.0, "200 units"), (0.2, "5000 units"), (0.25, "4000 units"), (0.1, "10000 units")])
def test_depth_of_another_unit(factor: float, words: str, frames: Frames) -> None:
    wrong = tuple(with_depth(frame, factor) for frame in frames)
    for statements in (STATED, OPEN):
        with pytest.raises(InputError, match=rf"^depth: depth_scale: {words} per meter .* with 1000 units per meter \(millimeters\)"):
            settled(wrong, statements)


@pytest.mark.parametrize(("factor", "words"), [(100.0, "positions of poses in centimeters"), (1000.0, "positions of poses in millimeters")])
def test_positions_of_another_unit(factor: float, words: str, frames: Frames) -> None:
    with pytest.raises(InputError, match=words):
        settled(with_poses(frames, lambda pose: enlarged(pose, factor)), STATED)


@pytest.mark.parametrize(("factor", "metres"), [(1000.0, r"e\+03 m"), (0.001, "0.00")])
def test_depth_that_no_room_has(factor: float, metres: str, frames: Frames) -> None:
    wrong = tuple(with_depth(frame, factor) for frame in frames)
    for few in (wrong, wrong[:1], tuple(dataclasses.replace(frame, pose=None) for frame in wrong)):
        with pytest.raises(InputError, match=rf"^depth: depth_scale: .* put half of the readings .*{metres}.*1000 for millimeters"):
            settled(few, STATED)


@pytest.mark.parametrize(("factor", "is_doubtful"), [(1.0, False), (0.2, True), (5.0, True)])
def test_a_unit_without_poses_is_doubted_at_most(factor: float, is_doubtful: bool, frames: Frames) -> None:
    unposed = tuple(dataclasses.replace(with_depth(frame, factor), pose=None) for frame in frames)
    result, notes = settled(unposed, STATED)
    assert len(result) == len(frames)
    assert [note.startswith("depth: depth_scale:") for note in notes] == [True] * is_doubtful


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_focal_length_of_another_image_size(factor: float, frames: Frames) -> None:
    right = frames[0].depth_intrinsics[0]
    with pytest.raises(InputError, match=rf"^intrinsics.json: intrinsics: fx {right * factor:.1f} for .* with fx {right:.1f} depth"):
        settled(tuple(with_lens(frame, factor) for frame in frames), OPEN)


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ((246.0, 246.0, 159.5, 119.5), "about 320 x 240 pixels, and the color images have 160 x 120"),
        ((62.0, 62.0, 39.5, 29.5), "about 80 x 60 pixels, and the color images have 160 x 120"),
        ((123.0, 123.0, 59.5, 79.5), "about 120 x 160 pixels, and the color images have 160 x 120: turned by 90 degrees"),
    ],
)
def test_a_principal_point_of_another_image_size(lens: tuple[float, float, float, float], words: str, frames: Frames) -> None:
    wrong = tuple(dataclasses.replace(frame, intrinsics=lens, depth_intrinsics=lens) for frame in frames)
    for few in (wrong, wrong[:1], tuple(dataclasses.replace(frame, pose=None) for frame in wrong)):
        with pytest.raises(InputError, match=words):
            settled(few, OPEN)


def test_a_crop_whose_depth_agrees_is_noted(frames: Frames) -> None:
    """The right two thirds of each image: its principal point is far to the left, and right."""

    def cropped(frame: FrameSource) -> FrameSource:
        assert frame.depth is not None
        depth = frame.depth()[:, 60:]
        fx, fy, cx, cy = frame.depth_intrinsics
        lens = (fx, fy, cx - 60, cy)
        return dataclasses.replace(
            frame, width=100, depth_size=(100, 120), intrinsics=lens, depth_intrinsics=lens, depth=lambda: depth, color=frame.color
        )

    crops = tuple(cropped(frame) for frame in frames)
    result, (note,) = settled(crops, STATED)
    assert_same_poses(result, frames)
    assert "principal point (19.5, 59.5)" in note
    assert "depth of its frames agrees" in note


def test_poses_of_other_frames_are_noted(frames: Frames) -> None:
    order = np.random.default_rng(3).permutation(len(frames))
    mixed = tuple(dataclasses.replace(frame, pose=frames[k].pose) for frame, k in zip(frames, order, strict=True))
    result, (note,) = settled(mixed, STATED)
    assert_same_poses(result, mixed)
    assert note.startswith("pose.txt: poses: frames that look at the same place agree on ")


def test_with_a_mesh_a_contradiction_is_a_note(frames: Frames) -> None:
    wrong = tuple(with_depth(frame, 0.2) for frame in frames)
    result, (note,) = settled(wrong, dataclasses.replace(STATED, has_mesh=True))
    assert_same_poses(result, wrong)
    assert "depth_scale: 5000 units per meter" in note
    assert note.endswith("the scan's mesh stays as it is")


def test_one_frame_and_frames_without_depth_contradict_nothing(frames: Frames) -> None:
    blind = tuple(dataclasses.replace(frame, depth=None, depth_size=None) for frame in frames)
    for few in ((), frames[:1], blind):
        assert settled(few, STATED) == (few, [])


@pytest.mark.parametrize(("lift", "words"), [(0.0, ""), (5.5, "m above the floor"), (-2.5, "m below the floor")])
def test_cameras_that_no_person_holds_are_noted(lift: float, words: str, frames: Frames) -> None:
    heights = [float(frame.pose[2, 3]) for frame in frames if frame.pose is not None]
    notes = height_notes(frames, translation([0.0, 0.0, lift + 1.5 - min(heights)]))
    assert [words in note for note in notes] == [True] * bool(words)


@pytest.mark.parametrize("name", ["rgbd_slambook_dining", "rgbd_open3d_livingroom_synth", "rgbd_tum_desk_pair"])
def test_real_recordings_have_no_findings(name: str, realdata: Callable[[str], Path]) -> None:
    reading = read_scan(only_scan(realdata(name)))
    assert [note for note in reading.degradations if "without a pose" not in note] == []
