"""S3DIS: rooms of points with a file for each object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.reading import Reading
from tasks.capture.s3dis import S3DIS
from tests.capture_scans import OBJECTS, box_room
from tests.tasks.capture.formats.clouds import sampled, small_cloud, write_s3dis

LABELS = ("floor", "wall", "wall", "wall", "wall", "ceiling")


def write_sample(folder: Path) -> None:
    """A corner of a room."""
    write_s3dis(folder, small_cloud(), LABELS)


def read(folder: Path) -> Reading:
    (scan,), errors = find_scans(folder)
    assert errors == []
    return S3DIS.read(scan)


def test_objects_of_a_room_are_its_instances(tmp_path: Path) -> None:
    room = box_room(OBJECTS[:2])
    cloud = sampled(room, 120_000)
    labels = (*LABELS, "table", "chair")
    folder = tmp_path / "Area_1" / "office_1"
    write_s3dis(folder, cloud, labels)
    with (folder / "office_1.txt").open("a") as file:
        file.write("0.5 0.5 1.5 9 9 9\n")
    (scan,), _ = find_scans(tmp_path)
    assert (scan.scene_id, len(scan_files(scan))) == ("s3dis/Area_1_office_1", 9)
    reading = S3DIS.read(scan)
    assert reading.surface is not None
    assert {group.source_id: group.raw_label for group in reading.groups or ()} == {
        f"{label}_{labels[: i + 1].count(label)}": label for i, label in enumerate(labels)
    }
    assert "office_1/office_1.txt: 1 points are of no object" in reading.degradations
    for group in reading.groups or ():
        (index,) = (i for i, label in enumerate(labels) if f"{label}_{labels[: i + 1].count(label)}" == group.source_id)
        own = cloud.points[cloud.owner == index]
        found = reading.surface.vertices[group.vertices]
        assert np.abs(found.min(axis=0) - own.min(axis=0)).max() < 0.04
        assert np.abs(found.max(axis=0) - own.max(axis=0)).max() < 0.04


def test_a_damaged_row_costs_the_row(tmp_path: Path) -> None:
    write_sample(tmp_path / "office_2")
    path = tmp_path / "office_2" / "Annotations" / "floor_1.txt"
    lines = path.read_text().splitlines()
    lines[3] = lines[3][:-1] + "\x10" + lines[3][-1]
    path.write_text("\n".join(lines))
    notes = read(tmp_path / "office_2").degradations
    assert "office_2/Annotations/floor_1.txt: 1 rows are not 6 numbers: left out" in notes


def test_points_of_two_objects_are_of_the_smaller_one(tmp_path: Path) -> None:
    write_sample(tmp_path / "office_2")
    objects = tmp_path / "office_2" / "Annotations"
    rows = (objects / "floor_1.txt").read_text().splitlines()
    (objects / "clutter_1.txt").write_text("\n".join(rows[: len(rows) // 3]))
    (objects / "pen_1.txt").write_text("\n".join(f"-1.5 -1.0 {0.5 + 0.001 * i:.3f} 9 9 9" for i in range(40)))
    reading = read(tmp_path / "office_2")
    assert f"office_2: {len(rows) // 3} points are in several objects: the smallest object has them" in reading.degradations
    groups = {group.source_id: group for group in reading.groups or ()}
    assert len(groups["clutter_1"].vertices) > 0
    assert "pen_1" not in groups
    assert any(line.startswith("office_2: ") and "have no surface: " in line and "pen_1" in line for line in reading.degradations)


def test_a_broken_object_costs_itself(tmp_path: Path) -> None:
    write_sample(tmp_path / "office_2")
    (tmp_path / "office_2" / "Annotations" / "floor_1.txt").write_text("no points\n")
    reading = read(tmp_path / "office_2")
    assert "floor" not in {group.raw_label for group in reading.groups or ()}
    assert any(line.startswith("office_2/Annotations/floor_1.txt: content: has no rows of numbers; ") for line in reading.degradations)


def test_a_room_without_readable_objects_is_refused(tmp_path: Path) -> None:
    write_sample(tmp_path / "office_2")
    for path in (tmp_path / "office_2" / "Annotations").iterdir():
        path.write_text("no points\n")
    with pytest.raises(InputError, match=r"^office_2: Annotations: has no object that can be read \(office_2/Annotations/ceiling_1.txt: "):
        read(tmp_path / "office_2")
