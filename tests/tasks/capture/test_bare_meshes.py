"""Meshes whose nodes nobody named: instances are found in their geometry, and no scene with one object called geometry comes of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture import CaptureConfig, run
from tasks.capture.bare_mesh import BARE_MESH
from tasks.capture.formats import find_scans, format_of
from tasks.capture.glb import is_label, plain_label
from tasks.capture.instances.segmentation import SegmentationConfig, geometry_instances
from tasks.capture.rooms.alignment import align
from tasks.containers import close_glb, open_glb
from tasks.geometry.meshes import Surface, dump_glb, load_glb
from tasks.geometry.transforms import translation, yaw_pose
from tasks.geometry.triangles import face_areas
from tasks.stage import Context, Outcome
from tests.capture_scans import OBJECTS, box_room, well_formed

Part = tuple[str, tuple[float, float, float], tuple[float, float, float]]
SHELL: tuple[Part, ...] = (
    ("floor", (4.0, 3.0, 0.1), (0, 0, -0.05)),
    ("wall_1", (4.0, 0.1, 2.5), (0, 1.5, 1.25)),
    ("wall_2", (0.1, 3.0, 2.5), (2, 0, 1.25)),
)
TABLE: Part = ("table_1", (1.2, 0.7, 0.7), (0.5, 0.2, 0.35))
CHAIR: Part = ("chair", (0.5, 0.5, 0.9), (-0.8, 0.5, 0.45))


def written(path: Path, parts: Sequence[Part], names: Sequence[str] | None = None) -> Path:
    meshes = []
    for _, extents, center in parts:
        mesh = trimesh.creation.box(extents)
        mesh.apply_translation(center)
        meshes.append(mesh)
    path.write_bytes(dump_glb(meshes, list(names) if names is not None else [name for name, _, _ in parts]))
    return path


def captured(path: Path) -> Outcome:
    (scan,), errors = find_scans(path)
    assert not errors
    return well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig()))


def bare(path: Path) -> str:
    """The line that says why the file was read as a bare mesh, whose instances come from its geometry."""
    outcome = captured(path)
    assert {row.found_by for row in outcome.rows["instances"]} == {"geometry"}
    assert outcome.rows["scenes"][0].segmentation == "geometry"
    (line,) = (line for line in outcome.degradations if ": read as a bare mesh; " in line)
    assert "chair_01, or model|category|part" in line
    return line


DEFAULTS = [
    "Mesh_0", "geometry_0", "geometry", "model", "Object_12", "node3", "polySurface1", "pCube4", "Cube.001", "Icosphere", "mesh_id_17",
    "mesh", "world", "Scene", "0", "", "_", "7f3a", "submesh_0_lod1", "texturedMesh", "Group 2", "StaticMesh_LOD0", "obj-3",
]  # fmt: skip
LABELS = ["chair", "Chair.001", "mesh_chair", "table_2", "HouseWallB_01", "стул_1", "椅子", "كرسي", "TV", "object_sofa", "night stand"]


@pytest.mark.parametrize("name", DEFAULTS)
def test_what_programs_call_a_node_by_themselves_is_no_label(name: str) -> None:
    assert not is_label(name)


@pytest.mark.parametrize("name", LABELS)
def test_what_says_what_an_object_is_is_a_label(name: str) -> None:
    assert is_label(name)


@given(st.sampled_from(DEFAULTS), st.integers(0, 10**6), st.sampled_from([".", "_", "-", " ", ""]))
def test_numbers_make_no_label_of_a_name_that_is_none(name: str, number: int, between: str) -> None:
    assert not is_label(f"{name}{between}{number}")


@pytest.mark.parametrize("name", ["geometry", "my_living_room", "chair"])
def test_a_mesh_in_one_piece_is_a_bare_one_whatever_it_is_called(tmp_path: Path, name: str) -> None:
    room = box_room(cameras=1)
    (tmp_path / "room.glb").write_bytes(dump_glb([room.surface.to_trimesh()], [name]))
    assert bare(tmp_path / "room.glb").startswith(f"{tmp_path.name}/room.glb: node '{name}' holds 100% of the surface: read")


def test_every_thing_in_a_room_in_one_piece_is_found_as_it_is(tmp_path: Path) -> None:
    """Boxes of the instances against the true ones; the box on the table leaves the table a hole."""
    (tmp_path / "room.glb").write_bytes(dump_glb([box_room(cameras=1).surface.to_trimesh()], ["geometry"]))
    outcome = captured(tmp_path / "room.glb")
    rows = [row for row in outcome.rows["instances"] if not row.is_structure]
    assert len(rows) == len(OBJECTS)
    for _, center, size, _ in OBJECTS:
        row = min(rows, key=lambda row: np.linalg.norm(np.array(row.box_pose)[[3, 7, 11]] - center))
        assert np.array(row.box_pose)[[3, 7, 11]] == pytest.approx(center, abs=0.05)
        assert np.sort(row.box_size) == pytest.approx(np.sort(size), abs=0.11)  # what is level and nearer than 5 cm is the floor's
        assert row.category_probability is not None
        assert 0.0 <= row.category_probability <= 1.0
    assert sorted(row.category for row in outcome.rows["instances"] if row.is_structure) == ["ceiling", "floor", *["wall"] * 4]
    assert outcome.rows["shells"][0].floor_area_m2 == pytest.approx(12.0, rel=0.05)


def test_a_drawn_room_of_which_nobody_named_the_nodes_is_one_island_for_each_thing(tmp_path: Path) -> None:
    parts = [("floor", (4.0, 3.0, 0.02), (0, 0, -0.01)), *SHELL[1:], TABLE, CHAIR]
    path = written(tmp_path / "room.glb", parts, [f"Object_{index}" for index in range(len(parts))])
    assert "5 nodes with 100% of the surface have names that are no labels, as 'Object_0'" in bare(path)
    rows = [row for row in captured(path).rows["instances"] if not row.is_structure]
    assert sorted(tuple(np.sort(row.box_size).round(2)) for row in rows) == [(0.5, 0.5, 0.9), (0.7, 0.7, 1.2)]


def test_a_room_with_named_nodes_is_taken_with_some_that_are_not(tmp_path: Path) -> None:
    path = written(tmp_path / "room.glb", [*SHELL, TABLE, CHAIR], [*(name for name, _, _ in SHELL), "table_1", "Mesh_7"])
    rows = captured(path).rows["instances"]
    assert sorted(row.category for row in rows) == ["floor", "mesh", "table", "wall", "wall"]


def in_primitives(path: Path, count: int) -> Path:
    """The same file with the triangles of every mesh in so many primitives."""
    made, binary = open_glb(path.read_bytes())
    for mesh in made["meshes"]:
        (primitive,) = mesh["primitives"]
        whole = made["accessors"][primitive["indices"]]
        each = whole["count"] // count
        assert (each * count, each % 3) == (whole["count"], 0)
        mesh["primitives"] = [primitive | {"indices": len(made["accessors"]) + i} for i in range(count)]
        made["accessors"] += [whole | {"count": each, "byteOffset": 4 * each * i} for i in range(count)]
    path.write_bytes(close_glb(made, binary))
    return path


@pytest.mark.whole
def test_the_primitives_of_a_node_are_one_object_with_its_name_every_time(tmp_path: Path) -> None:
    hall: Part = ("floor", (40.0, 30.0, 0.1), (0, 0, -0.05))
    named: Part = ("chair_1|chair|seat", *CHAIR[1:])
    path = in_primitives(written(tmp_path / "hall.glb", [hall, TABLE, named]), 2)
    loaded = [[str(part.metadata["name"]) for part in load_glb(path.read_bytes())] for _ in range(5)]
    assert loaded == [["chair_1|chair|seat_0", "chair_1|chair|seat_1", "floor||0", "floor||1", "table_1||0", "table_1||1"]] * 5
    outcomes = [captured(path) for _ in range(3)]
    first, *others = [outcome.rows["instances"] for outcome in outcomes]
    assert [(row.source_id, row.raw_label, row.category) for row in first] == [
        ("chair_1", "chair", "chair"), ("floor", "floor", "floor"), ("table_1", "table", "table"),
    ]  # fmt: skip
    assert others == [first, first]
    assert len({outcome.rows["scenes"][0].mesh_blob for outcome in outcomes}) == 1


def test_the_triangles_of_primitives_are_in_the_order_of_the_file(tmp_path: Path) -> None:
    path = in_primitives(written(tmp_path / "table.glb", [TABLE]), 12)
    parts = {str(part.metadata["name"]): part for part in load_glb(path.read_bytes())}
    corners = trimesh.creation.box(TABLE[1]).triangles + TABLE[2]
    for number, triangle in enumerate(corners):
        assert parts[f"table_1||{number}"].triangles[0] == pytest.approx(triangle, abs=1e-6)


def test_a_mesh_that_nobody_named_is_a_bare_one_in_primitives_too(tmp_path: Path) -> None:
    whole = box_room(cameras=1).surface.to_trimesh()
    whole.update_faces(np.arange(len(whole.faces) // 4 * 4))
    path = tmp_path / "room.glb"
    path.write_bytes(dump_glb([whole], ["Mesh_0"]))
    assert "node 'Mesh_0' holds 100% of the surface" in bare(in_primitives(path, 4))


@pytest.mark.parametrize(
    ("name", "label"),
    [("Chair.001", "Chair"), ("table_2", "table"), ("night stand 1-2_3", "night stand"), ("a1b22", "a1b"), ("12", "12"), ("_1", "_1"),
     ("sofa_", "sofa_"), ("desk\u0663", "desk"), ("", "")],
)  # fmt: skip
def test_numbers_at_the_end_of_a_name_are_no_part_of_its_label(name: str, label: str) -> None:
    assert plain_label(name) == label


@pytest.mark.parametrize("name", ["1" * 10_000 + "x", "1_" * 5_000 + "x", "chair" + "_1" * 5_000, "1" * 10_000])
def test_the_label_of_a_name_of_many_numbers_is_found(name: str) -> None:
    assert plain_label(name) == ("chair" if name.startswith("chair") else name)


def test_a_large_floor_is_no_object(tmp_path: Path) -> None:
    hall: Part = ("floor", (40.0, 30.0, 0.1), (0, 0, -0.05))
    assert len(captured(written(tmp_path / "hall.glb", [hall, TABLE])).rows["instances"]) == 2


def test_the_rule_is_at_one_half(tmp_path: Path) -> None:
    cube: Part = ("chair", (1, 1, 1), (0, 0, 0.5))
    other: Part = ("table", (1, 1, 1), (2, 0, 0.5))
    assert len(captured(written(tmp_path / "two.glb", [cube, other])).rows["instances"]) == 2
    larger: Part = ("table", (1.01, 1.01, 1.01), (2, 0, 0.505))
    assert "node 'table' holds 50% of the surface" in bare(written(tmp_path / "more.glb", [cube, larger]))


def test_a_wall_must_say_that_it_is_one(tmp_path: Path) -> None:
    names = ["Object_0", "wall_1", "wall_2", "table", "chair"]
    hall: Part = ("", (40.0, 30.0, 0.1), (0, 0, -0.05))
    assert "'Object_0'" in bare(written(tmp_path / "room.glb", [hall, *SHELL[1:], TABLE, CHAIR], names))


def test_a_bare_mesh_of_another_kind_is_no_scan(tmp_path: Path) -> None:
    box_room(cameras=1).surface.to_trimesh().export(tmp_path / "room.stl")
    found, (error,) = find_scans(tmp_path)
    assert not found
    assert "holds no scan of a known format" in error.problem
    assert error.remedy.startswith("export it as GLB")


@pytest.mark.whole
def test_a_real_house_with_named_parts_is_taken(realdata: Callable[[str], Path]) -> None:
    rows = captured(realdata("scene_aws_small_house") / "house.glb").rows["instances"]
    assert len(rows) > 50
    assert {"wall", "floor", "bed", "sofa"} <= {row.category for row in rows}


@pytest.mark.whole
@pytest.mark.parametrize(
    ("place", "most"),
    [
        ("habitat_sim_test_assets/data/test_assets/scenes/simple_room.glb", 12),
        ("assets/aws_Bed_01.glb", 4),
        ("assets/aws_Wardrobe_01.glb", 4),
    ],
)
def test_real_meshes_without_named_nodes_are_taken_and_not_taken_apart(realdata: Callable[[str], Path], place: str, most: int) -> None:
    folder, _, name = place.rpartition("/")
    rows = captured(realdata(folder) / name).rows["instances"]
    assert 1 <= sum(not row.is_structure for row in rows) <= most


@pytest.mark.slow
@pytest.mark.whole
def test_a_real_house_without_its_names_is_divided_into_what_its_author_drew(realdata: Callable[[str], Path]) -> None:
    """Two thirds of what the author named have an instance that is at least half theirs, by surface."""
    path = realdata("scene_aws_small_house") / "house.glb"
    (scan,), _ = find_scans(path, "bare_mesh")
    reading = format_of(scan).read(scan)
    assert reading.surface is not None
    surface = reading.surface.transformed(align(reading.surface).pose)
    groups = geometry_instances(surface, SegmentationConfig(), reading.materials).groups
    areas = face_areas(surface.vertices, surface.faces)
    true = [str(part.metadata["name"]).split("|")[0] for part in load_glb(path.read_bytes()) for _ in part.faces]
    names, own = np.unique(true, return_inverse=True)
    things = [k for k, name in enumerate(names) if "Wall" not in name and "Floor" not in name]
    found = np.full(len(areas), len(groups))
    for k, group in enumerate(groups):
        found[group.faces] = k
    both = np.bincount(own * (len(groups) + 1) + found, weights=areas, minlength=len(names) * (len(groups) + 1)).reshape(len(names), -1)
    overlap = both / (both.sum(axis=1, keepdims=True) + both.sum(axis=0) - both)
    assert (overlap[things, :-1].max(axis=1) >= 0.5).mean() >= 2 / 3


def test_a_node_without_bars_is_no_part_of_a_model_of_its_name(tmp_path: Path) -> None:
    """Two chairs a meter and a half apart: as one instance they would be 2 m wide."""
    parts = [*SHELL, TABLE, CHAIR, ("chair", CHAIR[1], (0.7, -0.9, 0.45))]
    path = written(tmp_path / "room.glb", parts, [*(name for name, _, _ in SHELL), "table_1", "chair", "chair|chair|seat"])
    chairs = [row for row in captured(path).rows["instances"] if row.category == "chair"]
    assert [np.round(row.box_size, 6).tolist() for row in chairs] == [list(CHAIR[1])] * 2


@pytest.mark.parametrize("angle", [0.0, 20.0, -33.0])
@pytest.mark.parametrize("depth", [0.05, 0.1, 0.3])
def test_a_drawn_room_is_aligned_by_its_walls(angle: float, depth: float) -> None:
    """Corners of thick walls line up at a slant: over 5 m, walls of 10 cm are as long from one face to the other at 2.3 degrees."""
    walls = [((5.0, depth, 2.6), (0.0, side * (2 + depth / 2), 1.3)) for side in (-1, 1)]
    walls += [((depth, 4.0, 2.6), (side * (2.5 + depth / 2), 0.0, 1.3)) for side in (-1, 1)]
    boxes = [trimesh.creation.box(extents, translation(center)) for extents, center in walls]
    mesh: Any = trimesh.util.concatenate(boxes)
    mesh.apply_transform(yaw_pose(np.deg2rad(angle)))
    surface = Surface(np.array(mesh.vertices), np.array(mesh.faces), np.zeros(mesh.vertices.shape, np.uint8))
    made = align(surface, wall_faces=np.ones(len(surface.faces), bool), is_authored=True)
    yaw = np.rad2deg(np.arctan2(made.pose[1, 0], made.pose[0, 0]))
    assert (yaw + angle + 45) % 90 - 45 == pytest.approx(0.0, abs=0.05)


def test_a_closed_body_stands_as_its_file_has_it(tmp_path: Path) -> None:
    """A shelf has boards that face up and down alike, and a back that is seen from the front alone, as the rim hides its other side."""
    seat, back = ((0.45, 0.45, 0.04), (0, 0, 0.45)), ((0.45, 0.04, 0.45), (0, 0.2, 0.695))
    legs = [((0.04, 0.04, 0.43), (x, y, 0.215)) for x in (-0.19, 0.19) for y in (-0.19, 0.19)]
    path = written(tmp_path / "chair.glb", [("chair_1", *box) for box in (seat, back, *legs)], [f"part_{n}" for n in range(6)])
    (scan,), _ = find_scans(path)
    reading = BARE_MESH.read(dataclasses.replace(scan, format="bare_mesh"))
    assert reading.surface is not None
    assert np.ptp(reading.surface.vertices, axis=0) == pytest.approx([0.45, 0.47, 0.92], abs=0.05)
    assert any("y is taken to be up, as glTF has it" in note for note in reading.degradations)
