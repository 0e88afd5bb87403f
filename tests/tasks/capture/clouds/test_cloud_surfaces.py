"""Surfaces of point clouds against the rooms that the points were taken from."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import igl
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.bare_mesh.upright import Stated
from tasks.capture.formats import find_scans, format_of
from tasks.capture.point_cloud.normals import oriented_normals
from tasks.capture.point_cloud.points import Points, labelled
from tasks.capture.point_cloud.scene import cloud_reading
from tasks.capture.point_cloud.thinning import thinned
from tasks.capture.reading import Reading
from tasks.geometry.transforms import matrix, transform_points
from tasks.geometry.triangles import face_normals
from tasks.stage import Context
from tests.capture_scans import OBJECTS, box_room, ply_bytes
from tests.tasks.capture.formats.clouds import Cloud, sampled
from tests.tasks.capture.formats.clouds import ply_bytes as cloud_bytes

ROOM = box_room(OBJECTS[:2])
CLOUD = sampled(ROOM, 100_000, noise_m=0.003)
Z_UP = Stated(None, "z", "most of its kind")


def reading_of(points: Points, stated: Stated = Z_UP) -> Reading:
    return cloud_reading(points, stated, "room.xyz", None, ())


def in_file(reading: Reading) -> NDArray[np.float64]:
    """Vertices of a reading in the frame of the file."""
    assert reading.surface is not None
    assert reading.from_file is not None
    return transform_points(reading.surface.vertices, np.linalg.inv(reading.from_file))


def test_the_surface_lies_on_the_points_and_faces_the_room() -> None:
    reading = reading_of(Points(CLOUD.points, CLOUD.colors))
    vertices, surface = in_file(reading), reading.surface
    assert surface is not None
    clean = sampled(ROOM, 20_000, seed=1)
    squared, face, _ = igl.point_mesh_squared_distance(clean.points, vertices, surface.faces)
    assert (np.sqrt(squared) < 0.02).mean() > 0.95
    back = np.sqrt(igl.point_mesh_squared_distance(vertices, ROOM.surface.vertices, ROOM.surface.faces)[0])
    assert (back < 0.02).mean() > 0.95
    middle = vertices[surface.faces].mean(axis=1)
    is_wall = (np.abs(middle[:, 0]) > 1.9) & (np.abs(middle[:, 1]) < 1.3) & (np.abs(middle[:, 2] - 1.25) < 1.0)
    inward = (face_normals(vertices, surface.faces)[is_wall, 0] * middle[is_wall, 0]) < 0
    assert inward.mean() > 0.97
    nearest = cKDTree(CLOUD.points).query(vertices)[1]
    off = np.abs(surface.colors.astype(int) - CLOUD.colors[nearest]).max(axis=1)
    assert np.median(off) <= 2
    assert face.max() < len(surface.faces)


@pytest.mark.parametrize("factor", [1.0, 1000.0, 100.0])
def test_units_and_survey_coordinates_are_found(factor: float) -> None:
    shift = np.array([441547.5, 5121946.5, 345.0]) * factor
    reading = reading_of(Points(CLOUD.points * factor + shift, CLOUD.colors))
    assert reading.surface is not None
    assert np.abs(np.ptp(reading.surface.vertices, axis=0) - np.ptp(CLOUD.points, axis=0)).max() < 0.03
    assert np.abs(reading.surface.vertices).max() < 10
    assert np.abs((in_file(reading) - shift) / factor).max() < 2.6
    assert any("coordinates of a survey were moved" in line for line in reading.degradations)


def test_columns_of_objects_are_instances(tmp_path: Path) -> None:
    (tmp_path / "room.ply").write_bytes(cloud_bytes(CLOUD, objects=True))
    (scan,), _ = find_scans(tmp_path)
    assert scan.format == "bare_mesh"
    reading = format_of(scan).read(scan)
    assert reading.surface is not None
    assert [(group.source_id, group.raw_label) for group in reading.groups or ()] == [(str(i), f"class {i + 10}") for i in range(8)]
    nearest = cKDTree(CLOUD.points).query(in_file(reading))[1]
    for number, group in enumerate(reading.groups or ()):
        assert (CLOUD.owner[nearest[group.vertices]] == number).mean() > 0.95


def test_normals_of_the_file_are_used_unless_they_contradict_each_other() -> None:
    normals = np.where(np.abs(CLOUD.points / [2.0, 1.5, 1.25] - [0, 0, 1]) > 0.985, -np.sign(CLOUD.points - [0, 0, 1.25]), 0.0)
    normals = (normals + 1e-3).astype(np.float32)
    rng = np.random.default_rng(0)
    outward = reading_of(Points(CLOUD.points, normals=-normals))
    mixed = reading_of(Points(CLOUD.points, normals=normals * rng.choice([-1, 1], (len(normals), 1)).astype(np.float32)))
    assert any(line.endswith("normals have the signs that the file states") for line in outward.degradations)
    assert any("those of the file are not used" in line for line in mixed.degradations)
    assert inward_share(outward) < 0.03
    assert inward_share(mixed) > 0.97


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("source", ["stated", "sensors"])
def test_normals_have_the_side_that_the_file_states(source: str, side: float) -> None:
    """side: 1 for normals into the room, -1 for normals out of the room."""
    walls, inward = wall_points()
    cloud = Points(walls)
    if source == "stated":
        cloud = Points(walls, normals=(side * inward).astype(np.float32))
    else:
        sensors = -side * 5.0 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]) if side < 0 else np.array([[0, 0, 1.25]])
        facing = (sensors[None] - walls[:, None]) * inward[:, None]
        cloud = Points(walls, sensors=sensors, sensor_of=(side * facing.sum(axis=2)).argmax(axis=1).astype(np.int32))
    cosines = np.einsum("ni,ni->n", normals_of(cloud), inward)
    assert (side * cosines > 0.5).mean() > 0.97


def test_normals_point_to_the_open_space() -> None:
    walls, inward = wall_points()
    cosines = np.einsum("ni,ni->n", normals_of(Points(walls)), inward)
    assert (cosines > 0.5).mean() > 0.97


def wall_points() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points on the middle of the walls, on a grid of 4 cm, and the directions into the room, shape (n, 3) each."""
    points, inward = [], []
    across, up = (part.ravel() for part in np.meshgrid(np.arange(-1.3, 1.3, 0.04), np.arange(0.2, 2.3, 0.04)))
    for axis, distance in ((0, 2.0), (1, 1.5)):
        for sign in (-1.0, 1.0):
            part, direction = np.empty((len(up), 3)), np.zeros(3)
            part[:, axis], part[:, 1 - axis], part[:, 2] = sign * distance, across, up
            direction[axis] = -sign
            points.append(part)
            inward.append(np.broadcast_to(direction, part.shape))
    return np.concatenate(points), np.concatenate(inward)


def normals_of(points: Points) -> NDArray[np.float64]:
    return oriented_normals(points, cKDTree(points.positions), 0.06, 1.0).values


def inward_share(reading: Reading) -> float:
    """Share of the faces of two walls that face the room."""
    vertices, surface = in_file(reading), reading.surface
    assert surface is not None
    middle = vertices[surface.faces].mean(axis=1)
    is_wall = (np.abs(middle[:, 0]) > 1.9) & (np.abs(middle[:, 1]) < 1.3) & (np.abs(middle[:, 2] - 1.25) < 1.0)
    return float(((face_normals(vertices, surface.faces)[is_wall, 0] * middle[is_wall, 0]) < 0).mean())


@pytest.mark.parametrize("factor", [1.0, 1000.0])
def test_a_stray_point_does_not_change_the_unit(factor: float) -> None:
    points = np.concatenate([CLOUD.points, [[0.0, 0.0, 40.0]]]) * factor
    reading, clean = reading_of(Points(points)), reading_of(Points(points[:-1]))
    assert reading.surface is not None
    assert clean.surface is not None
    assert np.abs(np.ptp(reading.surface.vertices, axis=0) - np.ptp(CLOUD.points, axis=0)).max() < 0.03
    assert len(reading.surface.faces) == pytest.approx(len(clean.surface.faces), rel=0.05)
    words = ("is read as", "is taken to be in")
    assert [line for line in reading.degradations if any(word in line for word in words)] == [
        line for line in clean.degradations if any(word in line for word in words)
    ]
    assert any("1 points lie more than" in line for line in reading.degradations)


def test_objects_without_a_surface_are_noted() -> None:
    pen = np.array([1.0, 0.0, 1.8]) + np.random.default_rng(0).random((40, 3)) * [0.12, 0.01, 0.01]
    objects = labelled(np.append(CLOUD.owner, np.full(40, 70)), None)
    reading = reading_of(Points(np.concatenate([CLOUD.points, pen]), objects=objects))
    assert [group.source_id for group in reading.groups or ()] == [str(i) for i in range(8)]
    assert "room.xyz: 1 objects have no surface: 70: left out" in reading.degradations


def test_sparse_points_are_refused_before_the_grid_is_built() -> None:
    sparse = np.stack(np.meshgrid(*[np.arange(20.0)] * 3), axis=-1).reshape(-1, 3)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"^room.xyz: points: lie 1 m apart, too far for a surface; "):
            reading_of(Points(sparse))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 50 * 2**20


def test_sparse_points_around_a_room_cost_no_memory() -> None:
    rng = np.random.default_rng(0)
    sparse = rng.random((20_000, 3)) * [80.0, 80.0, 25.0] - [40.0, 40.0, 0.0]
    tracemalloc.start()
    try:
        reading = reading_of(Points(np.concatenate([CLOUD.points, sparse])))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 400 * 2**20
    assert reading.surface is not None
    assert np.ptp(reading.surface.vertices, axis=0).max() < 4.1


@pytest.mark.parametrize("limit", ["MAX_VOXELS", "MAX_BLOCKS"])
def test_the_grid_has_a_budget(limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"tasks.capture.point_cloud.scene.{limit}", 100)
    with pytest.raises(InputError, match=r"^room.xyz: points: are spread over \d+ voxels of .* or .*; export each room"):
        reading_of(Points(CLOUD.points))


def test_means_of_voxels_keep_objects_apart() -> None:
    objects = labelled(CLOUD.owner, None)
    order = np.random.default_rng(0).permutation(len(CLOUD.points))
    points = Points(CLOUD.points, CLOUD.colors, objects=objects)
    one, other = thinned(points, 0.05), thinned(points.at(order), 0.05)
    assert np.allclose(one.positions, other.positions, atol=1e-9)
    assert one.objects is not None
    assert set(one.objects.owner.tolist()) == set(range(8))
    assert thinned(one, 1e-4).positions.shape == one.positions.shape


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((50, 3)), "a surface needs 100"),
        (np.full((500, 3), np.nan), "a surface needs 100"),
        (np.zeros((500, 3)), "less than any room"),
        (np.random.default_rng(0).random((500, 3)) * 1e6, "more than 200"),
        (np.random.default_rng(0).random((200, 3)) * [20, 20, 3], "too far for a surface"),
    ],
)
def test_points_without_a_surface_are_refused(points: NDArray[np.float64], message: str) -> None:
    with pytest.raises(InputError, match=rf"^room.xyz: .*{message}"):
        reading_of(Points(points))


@pytest.mark.whole
def test_a_room_of_points_is_captured_as_its_mesh_is(tmp_path: Path) -> None:
    room = box_room(OBJECTS)
    cloud = sampled(room, 250_000, noise_m=0.003)
    hole = np.linalg.norm(cloud.points - [0.8, -1.5, 1.2], axis=1) < 0.15
    cloud = Cloud(cloud.points[~hole], cloud.colors[~hole], cloud.owner[~hole])
    for name, data in (("mesh", ply_bytes(room.surface)), ("points", cloud_bytes(cloud))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "room.ply").write_bytes(data)
    outcomes = {}
    for scan in find_scans(tmp_path)[0]:
        outcomes[scan.scan] = run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig())
    mesh, points = outcomes["mesh"].rows, outcomes["points"].rows
    assert abs(mesh["shells"][0].floor_area_m2 - points["shells"][0].floor_area_m2) < 0.2
    assert abs(mesh["shells"][0].height_m - points["shells"][0].height_m) < 0.03
    free = [[matrix(row.box_pose)[:3, 3] for row in rows["instances"] if not row.is_structure] for rows in (mesh, points)]
    for center in free[0]:
        assert min(float(np.linalg.norm(center - other)) for other in free[1]) < 0.05
