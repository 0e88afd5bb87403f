"""RoomPlan's USDZ: labels and boxes by the names of prims, walls without their openings."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.reading import Reading
from tasks.geometry.transforms import matrix, transform_points
from tasks.geometry.triangles import face_areas
from tasks.stage import Context
from tests.tasks.capture.formats.written import only_scan, read
from tests.tasks.capture.phones.room_packages import Box, furnished_room, write_package

LABELS = ["chair", "door", "floor", "table", "wall", "wall", "wall", "wall", "washerDryer", "window"]


def labels_of(reading: Reading) -> list[str]:
    return sorted(group.raw_label for group in reading.groups or ())


def areas_of(reading: Reading, label: str) -> list[float]:
    """Areas of the instances of a label [m2], sorted."""
    assert reading.surface is not None
    areas = face_areas(reading.surface.vertices, reading.surface.faces)
    return sorted(float(areas[group.faces].sum()) for group in reading.groups or () if group.raw_label == label)


VARIANTS: dict[str, dict[str, Any]] = {
    "as exported": {},
    "centimeters": {"unit": 0.01},
    "z up": {"up": "Z"},
    "nothing stated": {"unit": None, "up": None},
    "turned": {"yaw": 0.6},
    "without groups": {"is_flat": True},
    "meshes": {"group": "Mesh_grp"},
}


@pytest.mark.whole
@pytest.mark.parametrize("case", VARIANTS)
def test_prims_are_instances(case: str, tmp_path: Path) -> None:
    """The door, window and opening are holes of the walls; the floor is one surface; objects keep their boxes."""
    write_package(tmp_path / "Room.usdz", furnished_room(), **VARIANTS[case])
    reading = read(tmp_path)
    assert labels_of(reading) == LABELS
    assert areas_of(reading, "wall") == pytest.approx([7.5 - 2.0, 7.5 - 1.2, 10.0 - 1.8, 10.0], abs=0.01)
    assert areas_of(reading, "floor") == pytest.approx([12.0], abs=0.01)
    assert reading.is_modelled
    assert reading.surface is not None
    (table,) = [group for group in reading.groups or () if group.raw_label == "table"]
    vertices = reading.surface.vertices[table.vertices]
    assert vertices.mean(axis=0) == pytest.approx([0.0, 0.0, 0.37], abs=1e-5)
    assert np.ptp(vertices[:, 2]) == pytest.approx(0.74, abs=1e-5)
    assert set(map(tuple, reading.surface.colors.tolist())) == {(188, 137, 89)}
    assert any("read as a captured room, by the names of its prims" in note for note in reading.degradations)


@pytest.mark.whole
def test_the_room_of_a_package_is_that_of_the_file(tmp_path: Path) -> None:
    write_package(tmp_path / "Room.usdz", furnished_room(), unit=0.01)
    reading = read(tmp_path)
    assert reading.surface is not None
    assert reading.from_file is not None
    own = transform_points(reading.surface.vertices, np.linalg.inv(reading.from_file))
    assert own[:, 1].max() == pytest.approx(250.0, abs=0.01)


@pytest.mark.whole
def test_a_package_becomes_a_scene(tmp_path: Path) -> None:
    write_package(tmp_path / "Room.usdz", furnished_room(), yaw=0.3)
    scan = only_scan(tmp_path)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
    (shell,) = outcome.rows["shells"]
    rows = {row.category: row for row in outcome.rows["instances"] if not row.is_structure}
    assert set(rows) == {"door", "window", "table", "chair", "washing machine"}
    assert sorted(rows["chair"].box_size) == pytest.approx([0.45, 0.45, 0.9], abs=1e-4)
    assert matrix(rows["chair"].box_pose)[2, 3] == pytest.approx(0.45, abs=1e-3)
    assert shell.floor_area_m2 == pytest.approx(12.0, rel=0.02)
    assert outcome.rows["scenes"][0].segmentation == "file"


@pytest.mark.whole
def test_walls_without_a_floor_give_one(tmp_path: Path) -> None:
    write_package(tmp_path / "Room.usdz", [box for box in furnished_room() if box.word != "Floor"])
    reading = read(tmp_path)
    assert areas_of(reading, "floor") == pytest.approx([12.0], abs=0.01)
    assert any("floors: none is usable" in note for note in reading.degradations)


@pytest.mark.whole
def test_two_floors_are_two_storeys(tmp_path: Path) -> None:
    upper = [
        dataclasses.replace(box, name=f"{box.word}{k + 10}", center=(box.center[0], box.center[1] + 2.8, box.center[2]))
        for k, box in enumerate(furnished_room())
    ]
    write_package(tmp_path / "Room.usdz", [*furnished_room(), *upper])
    reading = read(tmp_path)
    assert reading.levels is not None
    assert reading.levels.floors == pytest.approx((0.0, 2.8), abs=1e-3)
    assert labels_of(reading) == sorted(LABELS * 2)


@pytest.mark.whole
def test_a_room_that_is_there_twice_is_read_once(tmp_path: Path) -> None:
    """An export may hold the scanned surfaces next to the boxes."""
    again = '\ndef Xform "Mesh_grp"\n{\ndef Mesh "Wall0"\n{\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]\n'
    again += "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n}\n"
    write_package(tmp_path / "Room.usdz", furnished_room(), more=again)
    reading = read(tmp_path)
    assert labels_of(reading) == LABELS
    assert any("Mesh_grp: shows the room of Parametric_grp again" in note for note in reading.degradations)


def test_custom_data_counts_and_contradictions_are_named(tmp_path: Path) -> None:
    boxes = [dataclasses.replace(box, category="Sofa") if box.name == "Table0" else box for box in furnished_room()]
    write_package(tmp_path / "Room.usdz", boxes)
    reading = read(tmp_path)
    assert "sofa" in labels_of(reading)
    assert any("Table0: customData calls it Sofa, which counts" in note for note in reading.degradations)


@pytest.mark.whole
def test_a_prim_without_a_category_is_named(tmp_path: Path) -> None:
    """A few prims without a name are objects without a label; a file of which most have none is a bare mesh."""
    boxes = [*furnished_room(), Box("Blob0", (0, 2.0, 0), (0.2, 0.2, 0.2), category=" ")]
    write_package(tmp_path / "Room.usdz", boxes)
    reading = read(tmp_path)
    assert labels_of(reading) == sorted([*LABELS, "object"])
    assert any("prims without a category are objects without a label: Blob0" in note for note in reading.degradations)
    others = [dataclasses.replace(box, name=f"Mesh{k}", category=" ") for k, box in enumerate(furnished_room()) if box.word != "Wall"]
    write_package(tmp_path / "other" / "Room.usdz", [furnished_room()[0], *others])
    assert read(tmp_path / "other").groups is None


@pytest.mark.whole
def test_a_wall_with_a_hole_stays_as_it_is(tmp_path: Path) -> None:
    """Walls that are more than a box are not cut again."""
    more = '\ndef Mesh "Wall9"\n{\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (1, 2, 0), (0.5, 1, 0)]\n'
    more += "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]\n}\n"
    write_package(tmp_path / "Room.usdz", furnished_room(), more=more)
    assert areas_of(read(tmp_path), "wall")[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.whole
def test_an_ordinary_model_with_names_of_categories_is_a_mesh(tmp_path: Path) -> None:
    """Other programs number walls and chairs, too: without RoomPlan's groups, nothing that lacks a category is lost."""
    more = [Box(f"{word}_001", (k - 1.0, 0.4, 0.5), (0.3, 0.8, 0.3), category=" ") for k, word in enumerate(("Plant", "Lamp", "Rug"))]
    boxes = [*furnished_room(), *more]
    write_package(tmp_path / "Room.usdz", boxes, is_flat=True)
    reading = read(tmp_path)
    assert reading.groups is None
    assert reading.surface is not None
    assert len(reading.surface.faces) == 12 * len(boxes)


@pytest.mark.whole
def test_a_floor_keeps_its_pieces_and_holes(tmp_path: Path) -> None:
    """Two pieces of 12 and 3 m2, the larger one with a hole of 1 m2."""
    squares = [(-2, -1.5, 2, -0.5), (-2, 0.5, 2, 1.5), (-2, -0.5, -0.5, 0.5), (0.5, -0.5, 2, 0.5), (3, -1.5, 4, 1.5)]
    corners = [(x, 0, z) for x0, z0, x1, z1 in squares for x, z in ((x0, z0), (x1, z0), (x1, z1), (x0, z1))]
    more = f'\ndef Mesh "Floor0"\n{{\npoint3f[] points = {corners}\n'
    more += f"int[] faceVertexCounts = {[4] * len(squares)}\nint[] faceVertexIndices = {list(range(len(corners)))}\n}}\n"
    write_package(tmp_path / "Room.usdz", [box for box in furnished_room() if box.word != "Floor"], more=more)
    reading = read(tmp_path)
    assert areas_of(reading, "floor") == pytest.approx([12.0 - 1.0 + 3.0], abs=0.01)


@pytest.mark.whole
def test_walls_of_no_plausible_height_are_refused(tmp_path: Path) -> None:
    boxes = [dataclasses.replace(box, size=(box.size[0], 0.01 * box.size[1], box.size[2])) for box in furnished_room()]
    write_package(tmp_path / "Room.usdz", boxes)
    with pytest.raises(InputError, match=r"Room.usdz: metersPerUnit: walls are 0.025 m high \(limits 0.5 and 30 m\)"):
        read(tmp_path)
