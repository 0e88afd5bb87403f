"""What the map does not have is seen, kept while it is hidden, and forgotten when rays pass where it was."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tasks.robot.configuration import Lidar
from tasks.robot.floor_map import Floor
from tasks.robot.lidar import lidar_returns, ray_angles
from tasks.robot.unmapped import BEHIND_M, DOUBTFUL_M, LOOK_M, OFF_MAP_M, TIMES, UnmappedPlaces
from tests.tasks.robot.floors import bare_floor, random_boxes

LIDAR = Lidar()


def scan(floor: Floor, pose: tuple[float, float, float], rng: np.random.Generator | None = None) -> np.ndarray:
    ranges, angles = lidar_returns(floor.segments, pose, LIDAR, rng), ray_angles(LIDAR) + pose[2]
    there = np.isfinite(ranges)
    return (ranges * np.array([np.cos(angles), np.sin(angles)])).T[there] + np.array(pose[:2])


def test_a_room_as_the_map_has_it_shows_nothing() -> None:
    rng = np.random.default_rng(0)
    floor = bare_floor(random_boxes(rng, 8, clear=[(3.0, 3.0)]))
    places = UnmappedPlaces(floor)
    for yaw in np.linspace(0, 6, 30):
        places.see(scan(floor, (3.0, 3.0, yaw), rng), (3.0, 3.0, yaw))
    assert len(places.points) == 0


def test_a_new_thing_is_seen_where_it_is() -> None:
    box = shapely.box(4.0, 2.8, 4.4, 3.2)
    places = UnmappedPlaces(bare_floor())
    places.see(scan(bare_floor([box]), (3.0, 3.0, 0.0), np.random.default_rng(0)), (3.0, 3.0, 0.0))
    assert len(places.points) >= 5
    assert max(shapely.Point(point).distance(box) for point in places.points) < 0.05


def test_it_is_kept_while_it_is_hidden_and_forgotten_when_it_is_gone() -> None:
    box, screen = shapely.box(4.6, 2.8, 5.0, 3.2), shapely.box(4.0, 2.0, 4.1, 4.0)
    places = UnmappedPlaces(bare_floor([screen]))
    there = bare_floor([screen, box])
    places.see(scan(there, (5.5, 3.0, 0.0)), (5.5, 3.0, 0.0))
    known = places.points.copy()
    assert len(known)
    places.see(scan(there, (3.0, 3.0, 0.0)), (3.0, 3.0, 0.0))
    assert np.array_equal(places.points, known)
    gone = bare_floor([screen])
    places.see(scan(gone, (5.5, 3.0, 0.0)), (5.5, 3.0, 0.0))
    assert len(places.points) == 0


def test_what_an_error_of_the_heading_makes_of_a_wall_does_not_last() -> None:
    floor, places = bare_floor(), UnmappedPlaces(bare_floor())
    places.see(scan(floor, (1.0, 3.0, 0.0)), (1.0, 3.0, 0.1))
    for yaw in (0.0, 0.01, 0.02):
        places.see(scan(floor, (1.0, 3.0, yaw)), (1.0, 3.0, yaw))
    inside = [point for point in places.points if shapely.Point(point).within(floor.polygon.buffer(-OFF_MAP_M))]
    assert inside == []


def test_what_is_far_away_is_not_judged() -> None:
    floor = bare_floor([shapely.box(0.2, 2.8, 0.6, 3.2)])
    places = UnmappedPlaces(bare_floor())
    places.see(scan(floor, (0.6 + LOOK_M + 0.1, 3.0, 0.0)), (0.6 + LOOK_M + 0.1, 3.0, 0.0))
    assert len(places.points) == 0
    places.see(np.zeros((0, 2)), (1.0, 1.0, 0.0))


@pytest.mark.parametrize("moved", [0.055, 0.07])
def test_a_thing_that_was_moved_a_little_is_seen_after_some_scans(moved: float) -> None:
    """By less than what one scan tells from noise: its face is nearer to who goes by, by as much as a cart keeps away."""
    assert DOUBTFUL_M < moved < OFF_MAP_M
    places, rng = UnmappedPlaces(bare_floor([shapely.box(4.0, 2.8, 4.4, 3.2)])), np.random.default_rng(0)
    box = shapely.box(4.0 - moved, 2.8, 4.4 - moved, 3.2)
    for number in range(1, 4 * TIMES):
        places.see(scan(bare_floor([box]), (3.0, 3.0, 0.05 * number), rng), (3.0, 3.0, 0.05 * number))
    assert len(places.points) >= 5
    assert max(shapely.Point(point).distance(box.boundary) for point in places.points) < 0.05


@pytest.mark.parametrize("moved", [0.05, 0.055, 0.07])
def test_a_thing_that_was_moved_a_little_and_put_back_is_forgotten(moved: float) -> None:
    """Though nothing is seen behind where it was but its own face, nearer than what proves a place empty."""
    assert moved < BEHIND_M + 0.02
    floor, rng = bare_floor([shapely.box(4.0, 2.8, 4.4, 3.2)]), np.random.default_rng(0)
    places, there = UnmappedPlaces(floor), bare_floor([shapely.box(4.0 - moved, 2.8, 4.4 - moved, 3.2)])
    for number in range(40):
        places.see(scan(there, (3.0, 3.0, 0.05 * number), rng), (3.0, 3.0, 0.05 * number))
    assert len(places.points)
    for number in range(200):
        places.see(scan(floor, (3.0, 3.0, 0.05 * number), rng), (3.0, 3.0, 0.05 * number))
    near = [point for point in places.points if shapely.Point(point).distance(shapely.box(3.9, 2.8, 4.4, 3.2)) < 0.03]
    assert near == []


def test_poses_that_are_off_leave_no_more_the_longer_it_goes() -> None:
    """By 1.5 cm and half a degree in every scan, and nothing was moved: what chance puts somewhere does not add up."""
    rng = np.random.default_rng(0)
    floor = bare_floor(random_boxes(rng, 6, clear=[(3.0, 3.0)]))
    places, counts = UnmappedPlaces(floor), []
    for _ in range(600):
        off = rng.normal(0.0, (0.015, 0.015, np.radians(0.5)))
        places.see(scan(floor, (3.0, 3.0, 0.0), rng) + off[:2], np.array([3.0, 3.0, 0.0]) + off)
        counts.append(len(places.points))
    assert max(counts[300:]) <= max(*counts[:300], 4)
