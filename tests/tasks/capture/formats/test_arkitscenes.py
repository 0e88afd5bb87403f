"""ARKitScenes: frames with their lenses and poses, and instances out of labelled boxes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from tasks.capture.formats import find_scans, room_of
from tasks.capture.wholeness import find_gap
from tasks.geometry.transforms import yaw_pose
from tests.capture_scans import OBJECTS, SCAN_FROM_WORLD
from tests.tasks.capture.formats.written import Array, assert_same_frames, only_scan, put, read, sample, write_arkitscenes

NAME = "41069021"


def boxes() -> list[tuple[str, str, Array, Array]]:
    """The true box of the chair in the scan frame."""
    label, center, size, yaw = OBJECTS[1]
    return [("chair-1", label, SCAN_FROM_WORLD @ yaw_pose(yaw, center), np.array(size))]


def write_sample(folder: Path) -> None:
    """A room with a chair and three frames."""
    write_arkitscenes(folder, sample(), boxes())


def test_a_box_holds_the_instance_of_the_native_format(tmp_path: Path) -> None:
    """All of the chair but what touches a wall or the floor, and nothing of the floor that it stands on."""
    write_sample(tmp_path / NAME)
    reading, native = read(tmp_path), sample()
    assert reading.surface is not None
    assert native.surface is not None
    np.testing.assert_array_equal(reading.surface.vertices, native.surface.vertices)
    (chair,) = reading.groups or ()
    true = next(group for group in native.groups or () if group.raw_label == "chair")
    assert (chair.raw_label, chair.source_id) == ("chair", "chair-1")
    np.testing.assert_array_equal(chair.vertices, true.vertices)
    np.testing.assert_array_equal(chair.faces, true.faces)
    assert_same_frames(reading.frames, native.frames)
    assert find_gap(only_scan(tmp_path)) is None


def test_the_smaller_of_two_boxes_has_what_both_hold(tmp_path: Path) -> None:
    label, _, pose, size = boxes()[0]
    write_arkitscenes(tmp_path / NAME, sample(), [("a", "sofa", pose, size * 2.0), (label, "chair", pose, size)])
    reading = read(tmp_path)
    whole = next(group for group in sample().groups or () if group.raw_label == "chair")
    by_label = {group.raw_label: group for group in reading.groups or ()}
    np.testing.assert_array_equal(by_label["chair"].vertices, whole.vertices)
    assert not np.intersect1d(by_label["sofa"].vertices, whole.vertices).size


def test_without_a_mesh_frames_are_to_be_fused(tmp_path: Path) -> None:
    write_sample(tmp_path / NAME)
    (tmp_path / NAME / f"{NAME}_3dod_mesh.ply").unlink()
    reading = read(tmp_path)
    assert reading.surface is None
    assert reading.groups is None
    assert len(reading.frames) == 3


def test_a_pose_that_is_late_is_none(tmp_path: Path) -> None:
    write_sample(tmp_path / NAME)
    path = tmp_path / NAME / f"{NAME}_frames" / "lowres_wide.traj"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "300.15 " + lines[1].partition(" ")[2], lines[2]]) + "\n")
    reading = read(tmp_path)
    assert [frame.pose is None for frame in reading.frames] == [False, True, False]
    assert any("none in the trajectory" in note for note in reading.degradations)


def test_recordings_of_one_visit_are_of_one_room(tmp_path: Path) -> None:
    for name in ("41069021", "41069025", "41069042"):
        write_arkitscenes(tmp_path / name, dataclasses.replace(sample(), frames=()), boxes())
    (tmp_path / "metadata.csv").write_text("video_id,visit_id,fold\n41069021,381668,Training\n41069025,381668.0,Training\n41069042,,x\n")
    scans, errors = find_scans(tmp_path)
    assert errors == []
    assert [room_of(scan) for scan in scans] == ["arkitscenes/visit_381668", "arkitscenes/visit_381668", "arkitscenes/41069042"]


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("axesLengths", [1.0, 0.0, 1.0], "above 0"),
        ("axesLengths", [1.0, 1.0], "must be 3 numbers"),
        ("centroid", [0.0, "x", 0.0], "must be 3 numbers"),
        ("normalizedAxes", [1.0] * 9, "right angles"),
    ],
)
def test_a_wrong_box_is_left_out_alone(key: str, value: object, problem: str, tmp_path: Path) -> None:
    write_sample(tmp_path / NAME)
    path = tmp_path / NAME / f"{NAME}_3dod_annotation.json"
    document = json.loads(path.read_text())
    document["data"][0]["segments"]["obbAligned"][key] = value
    path.write_text(json.dumps(document))
    reading = read(tmp_path)
    assert [group.source_id for group in reading.groups or ()] == [entry["uid"] for entry in document["data"][1:]]
    said = f"{NAME}/{NAME}_3dod_annotation.json: data[0].segments.obbAligned.{key}: "
    assert any(note.startswith(said) and problem in note for note in reading.degradations)


def test_the_raw_layout_is_read_as_well(tmp_path: Path) -> None:
    write_sample(tmp_path / "3dod" / NAME)
    files = {path.relative_to(tmp_path / "3dod" / NAME).as_posix(): path.read_bytes() for path in (tmp_path / "3dod").rglob("*.*")
             if path.is_file()}  # fmt: skip
    put(tmp_path / "raw" / NAME, {name.removeprefix(f"{NAME}_frames/"): data for name, data in files.items()})
    assert_same_frames(read(tmp_path / "raw").frames, read(tmp_path / "3dod").frames)
