"""3RScan: labelled vertices with the colors of the textured mesh, frames with their camera, and which scans are of one room."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.files.obj import read_obj
from tasks.capture.formats import find_scans, room_of, scan_files
from tasks.capture.wholeness import find_gap
from tests.tasks.capture.formats.written import (
    assert_same_frames,
    assert_same_instances,
    labelled_ply,
    only_scan,
    owner_of,
    read,
    sample,
    write_threerscan,
)


def write_sample(folder: Path) -> None:
    """A room with a chair and three frames."""
    write_threerscan(folder, sample())


def write_segments_sample(folder: Path) -> None:
    """The same room by the segments of its textured mesh, with what says which scans are of one room."""
    write_threerscan(folder, dataclasses.replace(sample(), frames=()), is_labelled=False)
    (folder / "3RScan.json").write_text(json.dumps([{"reference": "first", "scans": [{"reference": folder.name}]}]))


def write_text_sample(folder: Path) -> None:
    """The same room with its labelled mesh as text, and nothing else but the labels."""
    write_sample(folder)
    for path in (*folder.glob("*.obj"), *folder.glob("*.png"), *folder.glob("*.segs.v2.json")):
        path.unlink()
    surface = sample().surface
    assert surface is not None
    (folder / "labels.instances.annotated.v2.ply").write_bytes(labelled_ply(surface, owner_of(sample()) + 1, is_text=True))


FURTHER_SAMPLES = (write_segments_sample, write_text_sample)


def test_a_mesh_of_labels_alone_has_no_colors(tmp_path: Path) -> None:
    write_text_sample(tmp_path / "a")
    reading = read(tmp_path)
    assert reading.surface is not None
    assert (reading.surface.colors == 180).all()
    assert [group.raw_label for group in reading.groups or ()] == [group.raw_label for group in sample().groups or ()]
    assert reading.degradations == ("no mesh.refined.v2.obj in the scan: its mesh has no colors",)


@pytest.mark.parametrize("is_labelled", [True, False])
def test_instances_and_frames_are_those_of_the_native_format(is_labelled: bool, tmp_path: Path) -> None:
    write_threerscan(tmp_path / "a", sample(), is_labelled)
    reading = read(tmp_path)
    assert_same_instances(reading, sample())
    assert_same_frames(reading.frames, sample().frames)
    assert reading.degradations == ()
    assert find_gap(only_scan(tmp_path)) is None


def test_a_packed_sequence_says_how_to_unpack_it(tmp_path: Path) -> None:
    write_threerscan(tmp_path / "a", dataclasses.replace(sample(), frames=()))
    (tmp_path / "a" / "sequence.zip").write_bytes(b"PK")
    reading = read(tmp_path)
    assert reading.frames == ()
    assert any("unzip sequence.zip -d sequence" in note for note in reading.degradations)
    gap = find_gap(only_scan(tmp_path))
    assert gap is not None
    assert gap.is_readable


@pytest.mark.parametrize("place", ["above", "beside"])
def test_rescans_are_of_one_room(place: str, tmp_path: Path) -> None:
    names = ("first", "again", "other")
    for name in names:
        write_threerscan(tmp_path / name, dataclasses.replace(sample(), frames=()))
    rooms = [{"reference": "first", "type": "train", "scans": [{"reference": "again", "transform": []}]}, {"reference": "third"}]
    for folder in [tmp_path] if place == "above" else [tmp_path / name for name in names]:
        (folder / "3RScan.json").write_text(json.dumps(rooms))
    scans, errors = find_scans(tmp_path)
    assert errors == []
    assert {scan.scan: room_of(scan) for scan in scans} == {"first": "3rscan/first", "again": "3rscan/first", "other": "3rscan/other"}
    assert all("3RScan.json" in {path.name for path in scan_files(scan)} for scan in scans)
    rooms_file = next(path for path in scan_files(scans[0]) if path.name == "3RScan.json")
    rooms_file.write_text(json.dumps([{}, 7, {"reference": None}, *rooms]))
    assert {scan.scan: room_of(scan) for scan in scans}["first"] == "3rscan/first"


def test_numbers_that_the_annotation_lacks_are_nobodys(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "semseg.v2.json"
    document = json.loads(path.read_text())
    document["segGroups"] = [*document["segGroups"][2:], {"objectId": 900, "label": "ghost", "segments": []}]
    path.write_text(json.dumps(document))
    native = dataclasses.replace(sample(), groups=(sample().groups or ())[2:])
    assert_same_instances(read(tmp_path), native)


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0.25 0.5\nvt 0.75 0.5\nf 1/1 2/1 3/1\nf 2/2 4/2 -2/2\n"


def test_a_textured_mesh_has_the_colors_of_its_texture(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(OBJ)
    texture = np.array([[[10, 20, 30], [40, 50, 60]]], dtype=np.uint8)
    surface, _ = read_obj(path, "a.obj", texture)
    assert surface.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert surface.colors.tolist() == [[10, 20, 30], [10, 20, 30], [10, 20, 30], [40, 50, 60]]
    assert (read_obj(path, "a.obj")[0].colors == 180).all()


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ("f 1/1 2/1 3/1", "f 1/1 2/1 9/1", "vertex that does not exist"),
        ("f 1/1 2/1 3/1", "f 1/1 2/1 3/7", "texture coordinate that does not exist"),
        ("f 1/1 2/1 3/1", "f 1/1 2/1", "corners"),
        ("f 1/1 2/1 3/1", "f a b c", "is no face"),
        ("f 1/1 2/1 3/1", "f 0 2 3", "vertex that does not exist"),
        ("v 1 0 0", "v 1 0", "3 numbers"),
        ("v 1 0 0", "v 1 0 nan", "is nan"),
    ],
)
def test_a_mesh_that_is_broken_is_refused(before: str, after: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(OBJ.replace(before, after))
    with pytest.raises(InputError, match=problem):
        read_obj(path, "a.obj", np.zeros((1, 2, 3), np.uint8))
