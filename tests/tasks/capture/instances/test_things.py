"""Scans of things on a floor: no side of a thing is a wall, parts of one body are one, and what stands on another stays apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.structure import structure_of
from tasks.capture.instances.things import joined_bodies
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.triangles import vertex_normals
from tasks.stage import Context
from tests.capture_scans import plate, ply_bytes
from tests.tasks.capture.rooms.cut_rooms import cut_room

STEP_M = 0.04
RECTANGLE = [(-2.5, -2.0), (2.5, -2.0), (2.5, 2.0), (-2.5, 2.0)]


def box(size: tuple[float, float, float], center: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation(center)


FIGURES = {
    "booth": [box((1.2, 1.2, 1.95), (0, 0, 0.975))],
    "robe": [
        trimesh.creation.cylinder(0.75, 1.9, sections=10).apply_translation([0, 0, 0.95]),
        trimesh.creation.icosphere(radius=0.2).apply_translation([0, 0, 2.0]),
    ],
    "winged": [box((2.4, 0.15, 2.0), (0, 0, 1.0)), box((0.5, 1.4, 1.9), (0, 0, 0.95))],
}


def scanned(parts: list[trimesh.Trimesh]) -> Surface:
    """A body on a floor of 3 m, as a fused scan shows it: one noisy surface without what nobody sees."""
    whole = trimesh.boolean.union(parts) if len(parts) > 1 else parts[0]
    body = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, STEP_M))
    vertices, faces = plate([-1.5, -1.5, 0], [3, 0, 0], [0, 3, 0], STEP_M)
    is_below = whole.contains(vertices + np.array([0, 0, 0.01]))
    floor = trimesh.Trimesh(vertices, faces[~is_below[faces].any(axis=1)], process=False)
    body.update_faces(body.triangles[:, :, 2].min(axis=1) > 0.005)
    surface = surface_of([floor, body])
    return Surface(surface.vertices + np.random.default_rng(1).normal(0, 0.003, surface.vertices.shape), surface.faces, surface.colors)


def categories(surface: Surface) -> set[str]:
    normals = vertex_normals(surface.vertices, surface.faces)
    return {plane.category for plane in structure_of(surface.vertices, normals, vertex_areas(surface))}


@pytest.mark.parametrize("name", FIGURES)
def test_sides_of_a_figure_are_no_walls(name: str) -> None:
    assert categories(scanned(FIGURES[name])) == {"floor"}


@pytest.mark.parametrize("ceiling", [True, False])
def test_walls_around_a_room_are_walls(ceiling: bool) -> None:
    """With a booth in the middle of the room, too."""
    surface, _, _ = cut_room(RECTANGLE, boxes=[((0.3, 0.2, 0.98), (1.2, 1.2, 1.95), 0.0)], ceiling=ceiling)
    assert "wall" in categories(surface)


@pytest.mark.whole
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_one_object_without_walls(name: str, tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "figure.ply").write_bytes(ply_bytes(scanned(FIGURES[name])))
    (scan,), _ = find_scans(tmp_path / "scans")
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig())
    assert [row.is_structure for row in outcome.rows["instances"]] == [True, False]
    assert outcome.rows["shells"][0].walls == ()
    (note,) = (note for note in outcome.degradations if note.startswith("not a room: "))
    assert "sides of what stands there" in note


def parted(parts: list[trimesh.Trimesh], heights: list[float]) -> list[int]:
    """Number of the body of each layer of a solid, whose regions are told apart by heights [m]."""
    whole = trimesh.boolean.union(parts)
    body = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, STEP_M))
    surface = surface_of([body])
    region = np.searchsorted(heights, surface.vertices[:, 2])
    bodies = joined_bodies(surface, vertex_normals(surface.vertices, surface.faces), region)
    return [int(np.bincount(bodies[region == k]).argmax()) for k in range(len(heights) + 1)]


def test_what_stands_on_a_top_stays_apart() -> None:
    table, box_on_it = box((1.2, 0.8, 0.7), (0, 0, 0.35)), box((0.3, 0.3, 0.4), (0.1, 0, 0.9))
    assert parted([table, box_on_it], [0.701]) == [0, 1]


def test_layers_of_one_body_are_one() -> None:
    assert parted([box((0.5, 0.5, 1.8), (0, 0, 0.9))], [0.61, 1.21]) == [0, 0, 0]


def test_regions_that_do_not_touch_stay_apart() -> None:
    region = np.array([0, 0, 0, 1, 1, 1])
    surface = Surface(np.eye(6, 3), np.array([[0, 1, 2], [3, 4, 5]]), np.zeros((6, 3), dtype=np.uint8))
    assert joined_bodies(surface, np.eye(6, 3), region).tolist() == region.tolist()
    assert joined_bodies(surface, np.eye(6, 3), np.full(6, -1)).tolist() == [-1] * 6
