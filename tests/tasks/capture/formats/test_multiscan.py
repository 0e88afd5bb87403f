"""MultiScan: faces that name their object, lists of faces, and boxes alone; which way is up; and a real annotation."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.formats import find_scans, room_of, scan_files
from tasks.capture.wholeness import find_gap
from tasks.geometry.transforms import matrix, transform_points, yaw_pose
from tasks.geometry.triangles import face_areas
from tasks.stage import Context
from tests.capture_scans import OBJECTS, ROOM, well_formed
from tests.tasks.capture.formats.written import (
    Array,
    assert_same_instances,
    only_scan,
    owner_of_faces,
    read,
    sample,
    write_multiscan,
    write_multiscan_boxes,
)

SCAN = "scene_00007_01"

DOOR_M, WALL_M = (0.9, 2.0), 0.1
"""Width and height of the door in the first wall, and how thick walls, floor and ceiling were scanned."""


def boxes() -> list[tuple[str, Array, Array]]:
    """A room about the origin, its floor at height 0, with a door and three objects: names, poses and sizes."""
    x, y, z = ROOM
    found = [("floor.1", at(0, 0, 0), (x, y, WALL_M)), ("ceiling.1", at(0, 0, z), (x, y, WALL_M))]
    found += [(f"wall.{k + 1}", at(0, side * y / 2, z / 2), (x, WALL_M, z)) for k, side in enumerate((-1, 1))]
    found += [(f"wall.{k + 3}", at(side * x / 2, 0, z / 2), (WALL_M, y, z)) for k, side in enumerate((-1, 1))]
    found.append(("sliding_door.1", at(0.3, -y / 2, DOOR_M[1] / 2), (DOOR_M[0], 0.2, DOOR_M[1])))
    found += [(f"{label}.1", yaw_pose(yaw, center), size) for label, center, size, yaw in OBJECTS[:3]]
    return [(name, pose, np.array(size)) for name, pose, size in found]


def at(*center: float) -> Array:
    return yaw_pose(0.0, center)


def write_sample(folder: Path) -> None:
    """A room with a chair, as downloads have it."""
    write_multiscan(folder / SCAN, sample())


FURTHER_SAMPLES = (
    lambda folder: write_multiscan(folder / SCAN, sample(), is_labelled=False),
    lambda folder: write_multiscan_boxes(folder / SCAN, boxes(), np.eye(4)),
)
"""With lists of faces, and with nothing but boxes."""


@pytest.mark.parametrize("is_labelled", [True, False])
def test_instances_are_those_of_the_native_format(is_labelled: bool, tmp_path: Path) -> None:
    """Faces that name their object, and lists of faces of parts, give the same."""
    write_multiscan(tmp_path / SCAN, sample(), is_labelled)
    reading = read(tmp_path)
    assert_same_instances(reading, sample())
    assert not reading.is_modelled
    assert (reading.groups or ())[0].origin == f"{SCAN}.annotations.json: objects[0].label"
    scan = only_scan(tmp_path)
    assert (scan.scene_id, room_of(scan)) == (f"multiscan/{SCAN}", "multiscan/scene_00007")
    assert only_scan(tmp_path / SCAN).scan == SCAN
    assert find_gap(scan) is None


def test_numbers_of_faces_come_before_lists_of_them(tmp_path: Path) -> None:
    """A scan may have both; lists are of the earlier state of the set."""
    folder = write_multiscan(tmp_path / SCAN, sample())
    (folder / f"{SCAN}.semseg.json").write_text(json.dumps({"triIndices": {"floor.1": [0]}}))
    assert_same_instances(read(tmp_path), sample())
    assert len(scan_files(only_scan(tmp_path))) == 3


@pytest.mark.parametrize("is_labelled", [True, False])
def test_what_is_marked_to_be_removed_goes_with_its_faces(is_labelled: bool, tmp_path: Path) -> None:
    """The chair's faces and vertices are gone, everything else is as it was."""
    native = sample()
    groups, surface = native.groups or (), native.surface
    assert surface is not None
    chair = [group.raw_label for group in groups].index("chair")
    changed(write_multiscan(tmp_path / SCAN, native, is_labelled), lambda document: document["objects"][chair].update(label="remove"))
    if not is_labelled:
        path = tmp_path / SCAN / f"{SCAN}.semseg.json"
        path.write_text(path.read_text().replace("chair.1:handle.1", "remove").replace("chair.1:chair.1", "remove:rest"))
    reading = read(tmp_path)
    assert reading.surface is not None
    kept = owner_of_faces(native) != chair
    np.testing.assert_array_equal(reading.surface.vertices[reading.surface.faces], surface.vertices[surface.faces[kept]])
    assert len(reading.surface.vertices) == len(surface.vertices) - len(groups[chair].vertices)
    assert [group.raw_label for group in reading.groups or ()] == [group.raw_label for group in groups if group.raw_label != "chair"]
    assert any(note.startswith(f"1 of {len(groups)} objects are marked to be removed") for note in reading.degradations)


def test_an_object_without_a_number_costs_no_other_one(tmp_path: Path) -> None:
    """The mesh names faces by numbers: what has none is left out, and what is marked to be removed needs none."""
    native = sample()
    names = [group.raw_label for group in native.groups or ()]

    def forget(document: dict[str, Any]) -> None:
        document["objects"][names.index("chair")].pop("objectId")
        document["objects"].append({"label": "remove"})

    changed(write_multiscan(tmp_path / SCAN, native), forget)
    reading = read(tmp_path)
    assert [group.raw_label for group in reading.groups or ()] == [name for name in names if name != "chair"]
    place = names.index("chair")
    assert f"objects[{place}] (chair.1): has no objectId, by which the mesh names its faces" in reading.degradations


def test_numbers_of_another_annotation_are_refused(tmp_path: Path) -> None:
    def renumber(document: dict[str, Any]) -> None:
        for entry in document["objects"]:
            entry["objectId"] += 1000

    changed(write_multiscan(tmp_path / SCAN, sample()), renumber)
    with pytest.raises(
        InputError, match=r"objects: no face of the mesh is of any of them; use mesh and annotation of one and the same scan"
    ):
        read(tmp_path)


def test_a_remover_is_an_object(tmp_path: Path) -> None:
    changed(write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4)), lambda d: d["objects"][-1].update(label="remover.1"))
    assert [group.raw_label for group in read(tmp_path).groups or ()][-1] == "remover"


def test_a_mesh_that_is_a_link_to_nothing_is_told(tmp_path: Path) -> None:
    """As data that was not fetched yet lies there: no room of boxes is made of it."""
    folder = write_multiscan(tmp_path / SCAN, sample())
    (folder / f"{SCAN}.ply").unlink()
    (folder / f"{SCAN}.ply").symlink_to(folder / "annex" / "content")
    with pytest.raises(InputError, match=rf"{SCAN}.ply"):
        read(tmp_path)
    gap = find_gap(only_scan(tmp_path))
    assert gap is not None
    assert not gap.is_readable


def test_annotations_of_others_take_no_folder_from_its_format(tmp_path: Path) -> None:
    write_multiscan(tmp_path / "kitchen", sample())
    folder = tmp_path / "kitchen"
    assert only_scan(folder).scan == "kitchen", "named as the folder is"
    for path in [*folder.iterdir()]:
        path.rename(folder / path.name.replace("kitchen", "home"))
    assert only_scan(folder).scan == "home", "beside its mesh"
    (folder / "home.ply").unlink()
    scans, _ = find_scans(folder)
    assert scans == []


def test_without_numbers_and_lists_instances_are_to_be_found(tmp_path: Path) -> None:
    folder = write_multiscan(tmp_path / SCAN, sample(), is_labelled=False)
    (folder / f"{SCAN}.semseg.json").unlink()
    reading = read(tmp_path)
    assert reading.groups is None
    assert any(f"no {SCAN}.semseg.json beside the mesh" in note for note in reading.degradations)


def test_what_two_objects_claim_is_the_smaller_ones(tmp_path: Path) -> None:
    folder = write_multiscan(tmp_path / SCAN, sample(), is_labelled=False)
    path = folder / f"{SCAN}.semseg.json"
    lists = json.loads(path.read_text())["triIndices"]
    ordered = sorted(sample().groups or (), key=lambda group: len(group.faces))
    assert len(ordered[0].faces) > 5
    parts = [set(map(int, group.faces[1:])) for group in (ordered[0], ordered[-1])]
    small, large = (next(key for key in lists if part & set(lists[key])) for part in parts)
    path.write_text(json.dumps({"triIndices": lists | {large: lists[large] + lists[small][:5], "ghost.1": [0]}}))
    reading = read(tmp_path)
    assert_same_instances(reading, sample())
    assert "5 faces are claimed by two objects: they stay with the smaller" in reading.degradations
    assert f"{SCAN}.semseg.json: 1 of its names are not in the annotation: their faces are nobody's" in reading.degradations


def test_boxes_are_instances_and_walls_the_shell(tmp_path: Path) -> None:
    """Every box comes back with its category and corners; floor, walls and ceiling lie in the middle of theirs."""
    write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4))
    scan = only_scan(tmp_path)
    outcome = well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))
    (scene,), (shell,) = outcome.rows["scenes"], outcome.rows["shells"]
    assert (scene.scene_id, scene.segmentation) == (f"multiscan/{SCAN}", "file")
    assert [row.category for row in outcome.rows["instances"]] == ["floor", "ceiling", *["wall"] * 4, "door", "table", "chair", "cabinet"]
    assert [row.source_id for row in outcome.rows["instances"]] == [name for name, _, _ in boxes()]
    for (name, pose, size), row in zip(boxes(), outcome.rows["instances"], strict=True):
        assert row.is_structure == name.startswith(("floor", "ceiling", "wall"))
        expected = np.where(size == WALL_M, 0.0, size) if row.is_structure else size
        assert_same_corners(corners(matrix(row.box_pose), np.array(row.box_size)), corners(matrix(scene.alignment) @ pose, expected), 1e-5)
    assert shell.floor_area_m2 == pytest.approx(ROOM[0] * ROOM[1], rel=0.02)
    assert shell.height_m == pytest.approx(ROOM[2], abs=0.02)
    assert len(shell.openings) == 1
    gap = find_gap(scan)
    assert gap is not None
    assert gap.is_readable, "there may be no mesh"


def test_a_wall_lacks_the_door_in_it(tmp_path: Path) -> None:
    write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4))
    reading = read(tmp_path)
    assert reading.surface is not None
    areas = face_areas(reading.surface.vertices, reading.surface.faces)
    walls = [float(areas[group.faces].sum()) for group in reading.groups or () if group.raw_label == "wall"]
    x, y, z = ROOM
    assert walls == pytest.approx([x * z - DOOR_M[0] * DOOR_M[1], x * z, y * z, y * z])


def test_without_a_floor_it_lies_within_the_walls(tmp_path: Path) -> None:
    write_multiscan_boxes(tmp_path / SCAN, boxes()[1:], np.eye(4))
    reading = read(tmp_path)
    assert reading.surface is not None
    (floor,) = (group for group in reading.groups or () if group.raw_label == "floor")
    own = reading.surface.vertices[floor.vertices]
    np.testing.assert_allclose([own.min(axis=0), own.max(axis=0)], [[-ROOM[0] / 2, -ROOM[1] / 2, 0], [ROOM[0] / 2, ROOM[1] / 2, 0]])


directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda up: np.linalg.norm(up) > 0.1)


@given(up=directions.map(lambda up: up / np.linalg.norm(up)).filter(lambda up: up[2] > -0.999))
@example(up=np.array([0.0, 0.0, -1.0]))
@settings(max_examples=25)
def test_up_is_where_most_objects_say(up: Array) -> None:
    """However a scan is turned, and though one object lies on its side, everything comes back as it stands."""
    turn, lying = np.eye(4), np.eye(4)
    turn[:3, :3] = shortest_turn(up).T
    lying[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    named = [*boxes(), ("mop.1", at(0.2, 0.1, 0.1) @ lying, np.array([0.1, 0.1, 1.2]))]
    with TemporaryDirectory() as place:
        write_multiscan_boxes(Path(place) / SCAN, named, turn)
        surface = read(Path(place)).surface
        groups = read(Path(place)).groups or ()
    assert surface is not None
    areas = face_areas(surface.vertices, surface.faces)
    for (name, pose, size), group in zip(named, groups, strict=True):
        is_structure = name.startswith(("floor", "ceiling", "wall"))
        own, expected = surface.vertices[group.vertices], corners(pose, np.where(size == WALL_M, 0.0, size) if is_structure else size)
        np.testing.assert_allclose([own.min(axis=0), own.max(axis=0)], [expected.min(axis=0), expected.max(axis=0)], atol=1e-6)
        if not is_structure:
            assert_same_corners(own, expected, 1e-6)
            x, y, z = size
            assert areas[group.faces].sum() == pytest.approx(2 * (x * y + y * z + z * x))


def shortest_turn(up: Array) -> Array:
    """The rotation about the axis at right angles to both that turns `up` to +z, 3x3, by SciPy."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    axis = axis / length if length > 1e-12 else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * np.arctan2(length, up[2])).as_matrix()


def test_a_mesh_is_turned_with_its_boxes(tmp_path: Path) -> None:
    def lay(document: dict[str, Any]) -> None:
        for entry in document["objects"]:
            entry["obb"]["up"] = [0.0, 1.0, 0.0]

    changed(write_multiscan(tmp_path / SCAN, sample()), lay)
    surface, native = read(tmp_path).surface, sample().surface
    assert surface is not None
    assert native is not None
    np.testing.assert_allclose(surface.vertices, native.vertices[:, [0, 2, 1]] * [1, -1, 1], atol=1e-12)
    from_file = read(tmp_path).from_file
    assert from_file is not None
    np.testing.assert_allclose(transform_points(native.vertices, from_file), surface.vertices, atol=1e-12)


def corners(pose: Array, size: Array) -> Array:
    """Corners of a box, shape (8, 3)."""
    return transform_points(np.array(list(product((-0.5, 0.5), repeat=3))) * size, pose)


def assert_same_corners(mine: Array, others: Array, tolerance: float) -> None:
    """Each is where one of the others is, and the other way round."""
    apart = np.linalg.norm(mine[:, None] - others[None], axis=2)
    assert apart.min(axis=0).max() < tolerance
    assert apart.min(axis=1).max() < tolerance


@pytest.mark.whole
def test_boxes_of_a_real_annotation_come_back(realdata: Callable[[str], Path]) -> None:
    """Of 28 objects, one is marked to be removed; 23 have the corners that the file says, and floor, walls and ceiling their extents."""
    folder = realdata("multiscan_sample")
    (path,) = folder.glob("*.annotations.json")
    listed = json.loads(path.read_text())["objects"]
    assert len(listed) == 28
    scan = only_scan(folder)
    assert (scan.scene_id, room_of(scan)) == ("multiscan/scene_00000_00", "multiscan/scene_00000")
    outcome = well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))
    world = matrix(outcome.rows["scenes"][0].alignment)
    rows = {row.source_id: row for row in outcome.rows["instances"]}
    assert [*rows] == [entry["label"] for entry in listed if entry["label"] != "remove"]
    np.testing.assert_allclose(world[2, :3], [0, 0, 1], atol=1e-9)
    free = 0
    for entry in listed:
        if entry["label"] not in rows:
            continue
        row, box = rows[entry["label"]], entry["obb"]
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(box["normalizedAxes"], (3, 3)).T
        pose[:3, 3] = box["centroid"]
        size = np.array(box["axesLengths"])
        if row.is_structure:
            assert row.category == entry["label"].partition(".")[0]
            size[np.argmin(size)] = 0.0
        free += not row.is_structure
        assert_same_corners(corners(matrix(row.box_pose), np.array(row.box_size)), corners(world @ pose, size), 1e-3)
    assert free == 23
    expected = {"ceiling_light.1": "light", "stiker.2": "picture", "gate.1": "door", "wall_cabinet.1": "cabinet", "chair.1": "chair"}
    assert {name: rows[name].category for name in expected} == expected


def changed(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the annotation of a scan."""
    path = folder / f"{SCAN}.annotations.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda d: d.pop("objects"), r"objects: must be a list of objects"),
        (lambda d: [entry.pop("obb") for entry in d["objects"]], r"objects: no element has an area; give the scan its mesh"),
        (lambda d: [entry.update(label="remove") for entry in d["objects"]], r"objects: every object is marked to be removed"),
        (
            lambda d: d["objects"].extend([d["objects"][2] | {"label": f"wall.{k}"} for k in range(9, 40)]),
            r"objects\[6\].obb: lies in more than 16 walls",
        ),
    ],
)
def test_a_broken_annotation_is_refused(change: Callable[[dict[str, Any]], object], line: str, tmp_path: Path) -> None:
    changed(write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4)), change)
    with pytest.raises(InputError, match=rf"^{SCAN}/{SCAN}.annotations.json: {line}"):
        read(tmp_path)


def test_an_object_without_a_box_is_left_out(tmp_path: Path) -> None:
    changed(write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4)), lambda d: d["objects"][-1].pop("obb"))
    reading = read(tmp_path)
    assert [group.source_id for group in reading.groups or ()] == [name for name, _, _ in boxes()][:-1]
    assert f"{SCAN}.annotations.json: objects[9] (cabinet.1): has no box, left out" in reading.degradations


@pytest.mark.parametrize(
    ("change", "line", "is_left_out"),
    [
        (lambda rows: rows.append(7), "objects[10]: is not an object", False),
        (lambda rows: rows[9].update(label=None), "objects[9].label: is missing", False),
        (lambda rows: rows[9].update(label="floor.1"), "objects[9]: 'floor.1' names two objects", True),
        (lambda rows: rows[9].update(objectId="x"), "objects[9].objectId: must be a number from 0", False),
        (lambda rows: rows[9].update(obb=[]), "objects[9].obb: must be a box", True),
        (lambda rows: rows[9]["obb"].update(up=[0, 0, 2]), "objects[9].obb.up: is not a unit vector", False),
        (lambda rows: rows[9]["obb"].update(centroid=[0, 0]), "objects[9].obb.centroid: must be 3 numbers", True),
        (lambda rows: rows[9]["obb"].update(axesLengths=[1, -1, 1]), "objects[9].obb.axesLengths: must be 0 to 200 m", True),
        (lambda rows: rows[9]["obb"].update(normalizedAxes=[0.5] * 9), "objects[9].obb.normalizedAxes: are no three unit vectors", True),
    ],
)
def test_a_wrong_object_is_left_out_alone(
    change: Callable[[list[Any]], object], line: str, is_left_out: bool, tmp_path: Path
) -> None:  # fmt: skip
    changed(write_multiscan_boxes(tmp_path / SCAN, boxes(), np.eye(4)), lambda document: change(document["objects"]))
    reading = read(tmp_path)
    assert [group.source_id for group in reading.groups or ()][:9] == [name for name, _, _ in boxes()][:9]
    assert len(reading.groups or ()) == 10 - is_left_out
    assert any(note.startswith(f"{SCAN}/{SCAN}.annotations.json: {line}") for note in reading.degradations)


def test_segments_of_another_mesh_are_refused(tmp_path: Path) -> None:
    folder = write_multiscan(tmp_path / SCAN, sample(), is_labelled=False)
    path = folder / f"{SCAN}.semseg.json"
    for value in ([10**6], [-1], {"run": 3}):
        path.write_text(json.dumps({"triIndices": {"floor.1": value}}))
        with pytest.raises(InputError, match="no face of the mesh is of any of them"):
            read(tmp_path)


def test_two_annotations_in_a_folder_are_refused(tmp_path: Path) -> None:
    folder = write_multiscan(tmp_path / SCAN, sample())
    (folder / "scene_00007_02.annotations.json").write_text("{}")
    scans, errors = find_scans(tmp_path)
    assert scans == []
    assert [str(error) for error in errors] == [f"{SCAN}: folder: holds 2 annotations, one is expected; give every scan its own folder"]
