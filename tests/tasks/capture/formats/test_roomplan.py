"""RoomPlan: boxes with categories are instances, walls without their openings are the shell."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.wholeness import find_gap
from tasks.geometry.transforms import inverse, matrix, transform_points, yaw_of, yaw_pose
from tasks.geometry.triangles import face_areas
from tasks.stage import Context
from tests.capture_scans import OBJECTS, ROOM
from tests.tasks.capture.formats.phones import write_roomplan
from tests.tasks.capture.formats.written import Array, only_scan, read
from tests.tasks.capture.phones import captured_rooms

DOOR = (1, 0.3, 0.9, 2.0)
"""In which wall, how far from its middle, width and height [m]."""


def boxes() -> list[tuple[str, Array, Array]]:
    return [(label, yaw_pose(yaw, center), np.array(size)) for label, center, size, yaw in OBJECTS[:3]]


def write_sample(folder: Path) -> None:
    """A living room with a door, a table, a chair and a cabinet."""
    write_roomplan(folder, boxes(), ROOM, [DOOR])


def write_structure(folder: Path) -> None:
    """A structure of two storeys: a bay, floors in both planes, one that is missing, and a door that names no wall."""
    listed = captured_rooms.walls()
    listed[1] = listed[1] | {"curve": captured_rooms.arc(2.5, 1.85, 1.5, is_measured=True, sign=-1.0)}
    rooms = [
        captured_rooms.captured(walls=listed, floors=[captured_rooms.floor_upright()], objects=[captured_rooms.table()]),
        captured_rooms.captured(walls=captured_rooms.walls(2.8, 1), floors=[captured_rooms.floor_lying(2.8, story=1)]),
        captured_rooms.captured(walls=captured_rooms.walls(2.8, 1, x=4.0), sections=[{"label": "kitchen"}]),
    ]
    door = captured_rooms.surface("door", captured_rooms.placed(0, 1.0, -1.5), [0.9, 2.0, 0])
    captured_rooms.write(folder, {"rooms": rooms, "doors": [door], "version": 2}, "CapturedStructure.json")


FURTHER_SAMPLES = (write_structure,)


def test_boxes_are_instances_and_walls_the_shell(tmp_path: Path) -> None:
    """Every box comes back with its category, place, turn and size; the room has its area, height and door."""
    write_sample(tmp_path / "home")
    scan = only_scan(tmp_path)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
    (scene,), (shell,) = outcome.rows["scenes"], outcome.rows["shells"]
    assert (scene.scene_id, scene.segmentation) == ("roomplan/home", "file")
    world = matrix(scene.alignment)
    rows = [row for row in outcome.rows["instances"] if not row.is_structure and row.category != "door"]
    for (label, pose, size), row in zip(boxes(), rows, strict=True):
        box = matrix(row.box_pose)
        assert row.category == label
        np.testing.assert_allclose(box[:3, 3], transform_points([pose[:3, 3]], world)[0], atol=1e-5)
        turn = (yaw_of(world) + yaw_of(pose) - yaw_of(box)) % np.pi
        quarters = round(turn / (np.pi / 2))
        assert turn == pytest.approx(quarters * np.pi / 2, abs=1e-5)
        np.testing.assert_allclose(row.box_size, size if quarters % 2 == 0 else size[[1, 0, 2]], atol=1e-5)
        assert row.mesh_blob is not None
    assert shell.floor_area_m2 == pytest.approx(ROOM[0] * ROOM[1], rel=0.02)
    assert shell.height_m == pytest.approx(ROOM[2], abs=0.02)
    assert shell.room_type == "living room"
    assert [row.category for row in outcome.rows["instances"]].count("wall") == 4
    assert len(shell.openings) == 1
    assert find_gap(scan) is None


def test_a_wall_lacks_the_door_in_it(tmp_path: Path) -> None:
    write_sample(tmp_path / "home")
    reading = read(tmp_path)
    assert reading.surface is not None
    areas = face_areas(reading.surface.vertices, reading.surface.faces)
    walls = [float(areas[group.faces].sum()) for group in reading.groups or () if group.raw_label == "wall"]
    x, y, z = ROOM
    assert walls == pytest.approx([x * z, y * z - DOOR[2] * DOOR[3], x * z, y * z])


def test_what_was_turned_is_turned_back_to_the_axes_of_the_file(tmp_path: Path) -> None:
    write_sample(tmp_path / "home")
    reading = read(tmp_path)
    listed = json.loads((tmp_path / "home" / "CapturedRoom.json").read_text())["objects"]
    assert reading.surface is not None
    assert reading.from_file is not None
    vertices = transform_points(reading.surface.vertices, inverse(reading.from_file))
    named = [group for group in reading.groups or () if group.raw_label in {label for label, _, _ in boxes()}]
    for group, stated in zip(named, listed, strict=True):
        own = vertices[group.vertices]
        np.testing.assert_allclose((own.min(axis=0) + own.max(axis=0)) / 2, np.ravel(stated["transform"])[12:15], atol=1e-5)


@pytest.mark.parametrize("change", ["no parent", "nested", "no floors"])
def test_other_ways_to_say_the_same(change: str, tmp_path: Path) -> None:
    """Matrices by columns, doors that do not name their wall, and rooms without a floor, as the first version had them."""
    write_sample(tmp_path / "home")
    before = read(tmp_path)
    path = tmp_path / "home" / "CapturedRoom.json"
    document = json.loads(path.read_text())
    for entry in [entry for value in document.values() if isinstance(value, list) for entry in value if "transform" in entry]:
        if change == "nested":
            entry["transform"] = [entry["transform"][k : k + 4] for k in range(0, 16, 4)]
        if change == "no parent":
            entry.pop("parentIdentifier", None)
    if change == "no floors":
        del document["floors"]
    path.write_text(json.dumps(document))
    after = read(tmp_path)
    assert before.surface is not None
    assert after.surface is not None
    areas = [float(face_areas(r.surface.vertices, r.surface.faces).sum()) for r in (before, after)]  # type: ignore[union-attr]
    assert areas[0] == pytest.approx(areas[1])
    assert [group.raw_label for group in after.groups or ()] == [group.raw_label for group in before.groups or ()]


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("transform", [0.0] * 16, r"objects\[0\].transform: is no rotation"),
        ("transform", [1.0] * 15, r"objects\[0\].transform: must be 16 numbers"),
        ("dimensions", [1.0, -1.0, 1.0], r"objects\[0\].dimensions: must be 0 to 200 m"),
        ("polygonCorners", [[0.0]], r"objects\[0\].polygonCorners\[0\]: must be 3 numbers"),
    ],
)
def test_a_wrong_element_is_left_out_alone(key: str, value: object, field: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "home")
    count = len(read(tmp_path).groups or ())
    path = tmp_path / "home" / "CapturedRoom.json"
    document = json.loads(path.read_text())
    document["objects"][0][key] = value
    path.write_text(json.dumps(document))
    reading = read(tmp_path)
    assert len(reading.groups or ()) == count - 1
    assert any(re.match(rf"home/CapturedRoom.json: {field}", note) for note in reading.degradations)


def test_a_json_without_walls_is_no_room(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "Room.json").write_text("{}")
    (tmp_path / "home" / "Room.usdz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"^home/Room.json: walls: there are none"):
        read(tmp_path)
