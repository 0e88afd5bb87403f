"""Floors of rooms with cut corners, bays and openings without doors: the shell follows the scan."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tasks.capture.cloud import Cloud
from tasks.capture.labels import WALL
from tasks.capture.rooms.directions import SlantedWall
from tasks.capture.rooms.outline import _has_no_sides
from tasks.capture.rooms.passages import passages
from tasks.capture.rooms.room import RoomShape, estimate_room, wall_points
from tests.tasks.capture.rooms.cut_rooms import HEIGHT_M, Gap, Ring, cut_cloud

MAX_ERROR_M = 0.04
RECTANGLE: Ring = [(-2.5, -2.0), (2.5, -2.0), (2.5, 2.0), (-2.5, 2.0)]
DOORWAY = Gap(wall=2, start=2.0, width=1.1, height=2.0)
"""In the back wall of `RECTANGLE`, whose line runs from x = 2.5 to x = -2.5: from x = 0.5 to x = -0.6."""


def chamfered(cut: float, slope: float = 1.0) -> Ring:
    """A rectangle without its right front corner."""
    return [(-2.5, -2.0), (2.5 - cut, -2.0), (2.5, slope * cut - 2.0), (2.5, 2.0), (-2.5, 2.0)]


BAY: Ring = [(-2.5, -2.0), (2.5, -2.0), (2.5, 2.0), (1.2, 2.0), (0.6, 2.7), (-0.6, 2.7), (-1.2, 2.0), (-2.5, 2.0)]
OCTAGON: Ring = [(-2.5, -1.0), (-1.5, -2.0), (1.5, -2.0), (2.5, -1.0), (2.5, 1.0), (1.5, 2.0), (-1.5, 2.0), (-2.5, 1.0)]
L_SHAPE: Ring = [(-2.5, -2.0), (1.8, -2.0), (2.5, -1.3), (2.5, 0.5), (0.5, 0.5), (0.5, 2.0), (-2.5, 2.0)]


def shape_of(ring: Ring, **options: object) -> RoomShape:
    return estimate_room(*cut_cloud(ring, **options))  # type: ignore[arg-type]


def free_of(ring: Ring, **options: object) -> list[np.ndarray]:
    cloud, classes = cut_cloud(ring, **options)  # type: ignore[arg-type]
    shape = estimate_room(cloud, classes)
    return passages(cloud, wall_points(cloud, classes), shape.polygon, shape.height)


@pytest.mark.parametrize(
    "ring",
    [
        RECTANGLE,
        chamfered(0.4),
        chamfered(0.8),
        chamfered(1.4),
        chamfered(2.2),
        chamfered(1.0, 0.6),
        chamfered(0.7, 1.8),
        BAY,
        OCTAGON,
        L_SHAPE,
    ],
)
@pytest.mark.parametrize("noise", [0.002, 0.012])
def test_slanted_walls_are_edges_of_the_floor(ring: Ring, noise: float) -> None:
    polygon = shapely.Polygon(shape_of(ring, noise=noise).polygon)
    assert polygon.hausdorff_distance(shapely.Polygon(ring)) < MAX_ERROR_M + noise
    assert len(polygon.exterior.coords) == len(ring) + 1


def test_furniture_across_a_corner_is_no_slanted_wall() -> None:
    shape = shape_of(RECTANGLE, boxes=[((1.9, -1.4, 0.9), (0.4, 1.2, 1.8), np.pi / 4)])
    assert shapely.Polygon(shape.polygon).area == pytest.approx(20.0, abs=0.2)


@pytest.mark.parametrize("ring", [RECTANGLE, chamfered(1.4)])
@pytest.mark.parametrize("behind", [1.2, 4.0])
def test_floor_behind_an_opening_is_not_of_the_room(ring: Ring, behind: float) -> None:
    gap = Gap(len(ring) - 2, 2.0, 1.1, 2.0, behind)
    polygon = shapely.Polygon(shape_of(ring, gaps=[gap]).polygon)
    assert polygon.hausdorff_distance(shapely.Polygon(ring)) < MAX_ERROR_M


@pytest.mark.parametrize(("width", "height"), [(0.8, 2.0), (1.1, 2.0), (1.8, 2.2), (1.1, HEIGHT_M)])
def test_an_opening_without_a_door_is_a_passage(width: float, height: float) -> None:
    (corners,) = free_of(RECTANGLE, gaps=[Gap(2, 2.0, width, height)])
    assert np.allclose([corners[:, 0].max(), corners[:, 0].min()], [0.5, 0.5 - width], atol=0.06)
    assert np.allclose(corners[:, 1], 2.0, atol=0.02)
    assert corners[:, 2].min() == 0.0
    assert corners[:, 2].max() == pytest.approx(height, abs=0.06)


def test_a_slanted_wall_has_passages() -> None:
    (corners,) = free_of(chamfered(1.8), gaps=[Gap(1, 0.7, 1.1, 2.0)])
    middle = corners[:, :2].mean(axis=0)
    assert np.allclose(middle, np.array([0.7, -2.0]) + 1.25 * np.sqrt(0.5), atol=0.06)


def test_two_openings_are_two_passages() -> None:
    assert len(free_of(RECTANGLE, gaps=[Gap(2, 0.5, 1.1, 2.0), Gap(2, 3.0, 0.9, 2.0)])) == 2


@pytest.mark.parametrize(("width", "has_lintel", "is_open"), [(1.1, True, True), (1.1, False, False), (1.9, True, False)])
def test_without_floor_behind_it_only_a_gap_with_its_whole_frame_is_a_passage(width: float, has_lintel: bool, is_open: bool) -> None:
    cloud, classes = cut_cloud(RECTANGLE, gaps=[Gap(2, 2.0, width, 2.0, behind_m=0.01)])
    is_lintel = (cloud.points[:, 1] > 1.9) & (cloud.points[:, 2] > 1.9) & (np.abs(cloud.points[:, 0] + 0.05) < 0.6)
    cloud, classes = masked(cloud, classes, has_lintel | ~is_lintel)
    shape = estimate_room(cloud, classes)
    assert len(passages(cloud, wall_points(cloud, classes), shape.polygon, shape.height)) == is_open


def test_a_closed_room_has_no_passages() -> None:
    assert not free_of(RECTANGLE)


def test_a_gap_behind_furniture_is_no_passage() -> None:
    gap = Gap(2, 2.0, 1.1, 2.0, behind_m=0.01)
    assert not free_of(RECTANGLE, gaps=[gap], boxes=[((-0.05, 1.65, 1.0), (1.0, 0.3, 2.0), 0.0)])


def test_what_stands_in_an_opening_closes_it() -> None:
    assert not free_of(RECTANGLE, gaps=[DOORWAY], boxes=[((-0.05, 2.02, 1.0), (1.1, 0.05, 2.0), 0.0)])


def masked(cloud: Cloud, classes: np.ndarray, is_kept: np.ndarray) -> tuple[Cloud, np.ndarray]:
    """A scan of which a part was not seen."""
    return Cloud(*(values[is_kept] for values in (cloud.points, cloud.normals, cloud.areas, cloud.instance))), classes[is_kept]


def test_floor_that_no_camera_saw_before_a_slanted_wall_is_floor() -> None:
    ring = chamfered(0.8)
    cloud, classes = cut_cloud(ring)
    is_corner = (cloud.points[:, :2] > [1.65, -9.0]).all(axis=1) & (cloud.points[:, 1] < -1.15)
    shape = estimate_room(*masked(cloud, classes, ~(is_corner & (classes != WALL))))
    assert shapely.Polygon(shape.polygon).hausdorff_distance(shapely.Polygon(ring)) < MAX_ERROR_M


@pytest.mark.parametrize("is_across", [True, False])
def test_a_slanted_wall_of_little_surface_cuts_a_corner_that_it_spans(is_across: bool) -> None:
    cloud, classes = cut_cloud(chamfered(0.5))
    is_slanted = (classes == WALL) & (np.abs(cloud.normals[:, :2]).min(axis=1) > 0.5)
    is_seen = (cloud.points[:, 2] > 0.1) & (cloud.points[:, 2] < 1.4) & (np.arange(len(classes)) % 5 < (2 if is_across else 4))
    is_seen &= is_across | (cloud.points[:, 0] > 2.25)
    assert 0.2 < float(cloud.areas[is_slanted & is_seen].sum()) < 0.4
    shape = estimate_room(*masked(cloud, classes, ~is_slanted | is_seen))
    assert (len(shape.polygon) == 5) == is_across


def test_a_hall_behind_an_opening_is_not_of_the_room_though_its_far_wall_was_seen() -> None:
    cloud, classes = cut_cloud(RECTANGLE, gaps=[DOORWAY])
    x, z = (grid.ravel() for grid in np.meshgrid(np.arange(-0.9, 0.9, 0.05), np.arange(0.0, HEIGHT_M, 0.05)))
    far = np.column_stack([x, np.full(len(x), 3.4), z])
    hall = Cloud(
        np.concatenate([cloud.points, far]),
        np.concatenate([cloud.normals, np.tile([0.0, -1.0, 0.0], (len(far), 1))]),
        np.concatenate([cloud.areas, np.full(len(far), 0.0025)]),
        np.concatenate([cloud.instance, np.full(len(far), 0)]),
    )
    shape = estimate_room(hall, np.concatenate([classes, np.full(len(far), WALL)]))
    assert shapely.Polygon(shape.polygon).hausdorff_distance(shapely.Polygon(RECTANGLE)) < MAX_ERROR_M


def test_floor_that_no_camera_saw_along_a_wall_is_floor() -> None:
    cloud, classes = cut_cloud(RECTANGLE)
    is_hole = (classes != WALL) & (cloud.points[:, 0] < -1.6) & (np.abs(cloud.points[:, 1]) < 1.0) & (cloud.points[:, 2] < 1.0)
    shape = estimate_room(*masked(cloud, classes, ~is_hole))
    assert shapely.Polygon(shape.polygon).hausdorff_distance(shapely.Polygon(RECTANGLE)) < MAX_ERROR_M


@pytest.mark.parametrize("is_framed", [True, False])
def test_a_framed_gap_with_a_glimpse_of_floor_behind_it_is_a_passage(is_framed: bool) -> None:
    cloud, classes = cut_cloud(RECTANGLE, gaps=[DOORWAY])
    # Of the floor behind, 20 cm of the opening's width were seen; without a frame, the wall above was not seen either.
    is_kept = (cloud.points[:, 1] < 2.05) | (np.abs(cloud.points[:, 0] - 0.3) < 0.1)
    is_kept &= is_framed | (classes != WALL) | (cloud.points[:, 2] < 1.75) | (cloud.points[:, 1] < 1.9)
    cloud, classes = masked(cloud, classes, is_kept)
    shape = estimate_room(cloud, classes)
    free = passages(cloud, wall_points(cloud, classes), shape.polygon, shape.height)
    assert len(free) == is_framed


@pytest.mark.parametrize(
    "notch",
    [
        shapely.Polygon([(2.001, 1.0), (2.5, 1.2), (2.5, 0.8)]),
        shapely.union_all([shapely.Polygon([(2.001, y), (2.5, y + 0.2), (2.5, y - 0.2)]) for y in (0.5, 1.5)]),
        shapely.union_all([shapely.box(2.0, 0.0, 2.5, 0.5), shapely.Polygon([(2.001, 1.0), (2.5, 1.2), (2.5, 0.8)])]),
    ],
    ids=["point", "points", "lines and a point"],
)
def test_a_notch_that_touches_the_floor_in_a_corner_has_a_border_of_lines_alone(notch: shapely.Geometry) -> None:
    wall = SlantedWall(np.array([4.0, 0.0]), np.array([0.0, 4.0]), np.array([-1.0, -1.0]) / np.sqrt(2.0), 2.0)
    floor = shapely.box(0.0, 0.0, 2.0, 2.0)
    has_line = notch.distance(floor) == 0.0
    walls = np.column_stack([np.full(60, 2.0), np.linspace(0.0, 0.5, 60)])
    assert _has_no_sides(notch, floor, wall, walls) is False
    assert _has_no_sides(notch, floor, wall, walls + 5.0) is has_line
