"""Lamps and cameras of exported scenes: in the room, whatever its shape, and out of the furniture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tasks.exports.bodies import Replica
from tasks.exports.lighting import lamps, viewpoint
from tasks.geometry.transforms import transform_points
from tests.replicas import cube, furnished, replica_of, room_of, rows_of

CORRIDOR = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (7.0, 6.0), (7.0, 1.0), (0.0, 1.0))
"""An L whose middle lies outside of it."""


@pytest.fixture(scope="module")
def office() -> Replica:
    return replica_of(*rows_of(furnished()))


@st.composite
def floors(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Rectangles with a notch: L-shaped rooms and plain ones."""
    width, depth = draw(st.floats(1.0, 12.0)), draw(st.floats(1.0, 12.0))
    x, y = draw(st.floats(0.1, 1.0)) * width, draw(st.floats(0.1, 1.0)) * depth
    at = draw(st.floats(-50.0, 50.0))
    ring = [(0.0, 0.0), (width, 0.0), (width, y), (x, y), (x, depth), (0.0, depth)]
    return [(a + at, b - at) for a, b in ring]


@given(polygon=floors(), height=st.floats(0.2, 6.0))
def test_lamps_hang_and_the_camera_stands_in_the_room(polygon: list[tuple[float, float]], height: float, office: Replica) -> None:
    room = dataclasses.replace(room_of("demo/room_01", polygon), height_m=height)
    floor = shapely.Polygon(polygon).buffer(1e-6)
    camera = viewpoint(dataclasses.replace(office, room=room, bodies=()))
    for places in (lamps(room), camera[None, :3, 3]):
        assert shapely.contains_xy(floor, places[:, 0], places[:, 1]).all()
        assert ((places[:, 2] > 0.0) & (places[:, 2] < height)).all()
    np.testing.assert_allclose(camera[:3, :3].T @ camera[:3, :3], np.eye(3), atol=1e-9)
    assert np.linalg.det(camera[:3, :3]) > 0.0


def test_rooms_get_lamps_by_their_size_and_none_in_the_wall() -> None:
    room = room_of("demo/room_01", CORRIDOR)
    places = lamps(room)
    assert len(places) >= 4
    assert shapely.contains_xy(shapely.Polygon(CORRIDOR), places[:, 0], places[:, 1]).all()
    small = room_of("demo/room_01", ((0.0, 0.0), (1.5, 0.0), (1.5, 1.5), (0.0, 1.5)))
    np.testing.assert_allclose(lamps(small)[:, :2], [[0.75, 0.75]])


def test_the_camera_looks_into_the_room_from_outside_of_everything(office: Replica) -> None:
    camera = viewpoint(office)
    for body in office.bodies:
        local = transform_points(camera[None, :3, 3], np.linalg.inv(body.pose))[0]
        low, high = body.shape.bounds
        assert ((local < low) | (local > high)).any()
    ahead = transform_points(np.array([[0.0, 0.0, -1.0]]), camera)[0] - camera[:3, 3]
    middle = np.array(shapely.Polygon(office.room.floor_polygon).centroid.coords[0])
    assert ahead[2] < 0.0
    assert ahead[:2] @ (middle - camera[:2, 3]) > 0.0
    assert abs(camera[2, 0]) < 1e-12
    assert camera[2, 1] > 0.0


def test_a_room_full_to_the_walls_still_has_a_camera() -> None:
    full = replica_of(*rows_of([cube((20.0, 20.0, 2.4), np.eye(4))]))
    assert np.isfinite(viewpoint(full)).all()


def test_lamps_and_the_camera_keep_out_of_walls_inside_the_room(office: Replica) -> None:
    wall = (1.5, 0.0, 1.5, 2.5, 0.2, 2.6)
    room = dataclasses.replace(room_of("demo/room_01", ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0))), interior_walls=(wall,))
    places = np.concatenate([lamps(room), viewpoint(dataclasses.replace(office, room=room, bodies=()))[None, :3, 3]])
    inside = shapely.box(1.4, 0.0, 1.6, 2.5)
    assert not shapely.contains_xy(inside, places[:, 0], places[:, 1]).any()
