"""Scans that are too low, too small or too large for a room, or that show no room: each gets one line, and keeps its geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.rooms.heights import ASSUMED_M, with_plausible_height
from tasks.capture.rooms.plausibility import size_notes
from tasks.capture.rooms.room import RoomShape
from tasks.geometry.meshes import Surface, surface_of
from tasks.optimization.support.walls import wall_faces
from tasks.shell import room_shell
from tasks.stage import Context, Outcome
from tests.capture_scans import BoxRoom, box_room, ply_bytes, well_formed, write_scannet

UNIT_QUESTION = "are its coordinates in meters?"


def captured(folder: Path) -> Outcome:
    (scan,), _ = find_scans(folder)
    return well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig()))


def cut_room(height: float, last_label: str | None = None) -> BoxRoom:
    """The room as a scan shows it that ends at a height [m]. last_label: name of its last object, another than its own."""
    room = box_room(ceiling=False)
    faces = room.surface.faces[(room.surface.vertices[room.surface.faces, 2] <= height + 1e-6).all(axis=1)]
    used = np.unique(faces)
    number = np.full(len(room.surface.vertices), -1)
    number[used] = np.arange(len(used))
    surface = Surface(room.surface.vertices[used], number[faces], room.surface.colors[used])
    labels = room.labels if last_label is None else (*room.labels[:-1], last_label)
    return BoxRoom(surface, room.instance[used], labels, room.cameras)


@pytest.mark.parametrize(
    ("height", "label", "expected", "source"),
    [
        (1.55, None, ASSUMED_M, "assumed"),
        (1.3, "ceiling", ASSUMED_M, "assumed"),  # a lamp's shade, named by mistake
        (2.5, None, 2.5, "walls"),
    ],
)
def test_a_room_that_ends_below_any_ceiling_gets_a_stated_height(
    height: float, label: str | None, expected: float, source: str, tmp_path: Path
) -> None:
    outcome = captured(write_scannet(tmp_path / "scans" / "scene0000_00", cut_room(height, label), frames="none").parent)
    (shell,) = outcome.rows["shells"]
    assert shell.height_m == pytest.approx(expected, abs=0.02)
    assert shell.height_source == source
    assert sum("no ceiling seen" in note for note in outcome.degradations) == 1
    assert any("is assumed" in note for note in outcome.degradations) == (source == "assumed")


def shape_of(height: float, source: str, top: float, area: float = 12.0, is_room: bool = True) -> RoomShape:
    """A room whose walls end at a height, and in which anything reaches a top [m]."""
    polygon = np.array([[0.0, 0.0], [area / 3, 0.0], [area / 3, 3.0], [0.0, 3.0]])
    inner = np.array([[1.0, 0.0, 1.0, 2.0, 0.1, height], [2.0, 0.0, 2.0, 2.0, 0.1, 0.5]])
    return RoomShape(polygon, area, "surface", np.zeros((0, 4)), inner, height, source, (), top=top, is_room=is_room)


@pytest.mark.parametrize(
    ("height", "source", "top", "expected"),
    [
        (1.56, "walls", 1.6, ASSUMED_M),  # frames that look down
        (1.56, "walls", 2.9, 2.9),  # a lamp or a cabinet shows more
        (2.2, "walls", 2.2, None),
        (2.2, "walls", 2.45, ASSUMED_M),
        (0.8, "walls", 0.8, ASSUMED_M),
        (1.2, "extent", 1.2, ASSUMED_M),
        (2.7, "walls", 2.72, None),
        (2.6, "ceiling", 3.5, None),
    ],
)
def test_an_assumed_height_is_never_below_the_scan(height: float, source: str, top: float, expected: float | None) -> None:
    shape, notes = with_plausible_height(shape_of(height, source, top), is_stated=False)
    assert shape.height == pytest.approx(height if expected is None else expected)
    assert (shape.height_source == "assumed") == (expected is not None)
    assert sum("is assumed" in note for note in notes) == (expected is not None)
    assert np.allclose(shape.interior_walls[:, 5], [shape.height, 0.5]), "half-height walls stay"


def test_what_is_no_room_or_is_stated_keeps_its_height() -> None:
    assert with_plausible_height(shape_of(0.8, "extent", 0.8, area=1.5), is_stated=False)[0].height == 0.8
    assert with_plausible_height(shape_of(1.5, "extent", 1.5, is_room=False), is_stated=False)[0].height == 1.5
    shape, notes = with_plausible_height(shape_of(1.9, "walls", 1.9), is_stated=True)
    assert (shape.height, shape.height_source, notes) == (1.9, "walls", [])


@pytest.mark.parametrize(("factor", "is_asked"), [(0.1, True), (1.0, False), pytest.param(10.0, True, marks=pytest.mark.slow)])
def test_an_implausible_size_is_a_question_about_units(factor: float, is_asked: bool, tmp_path: Path) -> None:
    room = box_room()
    surface = Surface(factor * room.surface.vertices, room.surface.faces, room.surface.colors)
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "room.ply").write_bytes(ply_bytes(surface))
    outcome = captured(tmp_path / "scans")
    assert sum(UNIT_QUESTION in note for note in outcome.degradations) == is_asked
    (scene,) = outcome.rows["scenes"]
    assert np.allclose(np.linalg.det(np.reshape(scene.alignment, (4, 4))[:3, :3]), 1.0), "nothing is scaled"


@pytest.mark.parametrize(("span", "is_asked"), [(0.4, True), (0.7, False), (25.0, False), (40.0, True)])
def test_stray_vertices_ask_nothing(span: float, is_asked: bool) -> None:
    vertices = np.random.default_rng(2).uniform(0, span, (5000, 3))
    vertices[:10] *= 100
    assert bool(size_notes(vertices, "room.ply")) == is_asked
    assert size_notes(np.zeros((0, 3)), "room.ply") == []


def test_a_figure_on_a_plate_is_reported_as_not_a_room(tmp_path: Path) -> None:
    plate = trimesh.creation.cylinder(0.9, 0.02, sections=24).apply_translation([0, 0, -0.01])
    body = trimesh.creation.capsule(0.9, 0.2).apply_translation([0, 0, 0.25])
    head = trimesh.creation.icosphere(radius=0.14).apply_translation([0, 0, 1.6])
    surface = surface_of([part.subdivide_to_size(0.05) for part in (plate, body, head)])
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "figure.ply").write_bytes(ply_bytes(surface))
    outcome = captured(tmp_path / "scans")
    assert sum(note.startswith("not a room: ") for note in outcome.degradations) == 1
    (shell,) = outcome.rows["shells"]
    assert shell.height_m < 2.0, "nothing is assumed of a room that is none"
    assert shell.walls == ()
    assert [name for name, _ in room_shell(shell)] == ["floor"]
    assert not wall_faces(shell)


def test_a_room_is_a_room(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "room.ply").write_bytes(ply_bytes(box_room().surface))
    assert not any(note.startswith("not a room: ") for note in captured(tmp_path / "scans").degradations)
