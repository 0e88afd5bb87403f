"""The floor: the lowest large level surface, whatever lies a little above it, and scans without any."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPoint, Point, Polygon, box

from tasks.capture.cloud import dense_cloud
from tasks.capture.instances.segmentation import SegmentationConfig, geometry_instances
from tasks.capture.rooms.floor_levels import facets, floor_height
from tasks.capture.rooms.room import estimate_room
from tasks.geometry.meshes import Surface
from tests.capture_scans import plate
from tests.tasks.capture.test_partitions import CLASSES, DEPTH, WIDTH, assembled, estimated, shell, solid_piece
from tests.tasks.capture.test_slopes import attic


def level(area: float, height: float, cells: int = 12, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Triangles of a level square [m], shape (2 cells^2, 3, 3)."""
    side = np.linspace(0, np.sqrt(area), cells + 1)
    x, y = np.meshgrid(side, side, indexing="ij")
    points = np.stack([x, y, height + noise * np.random.default_rng(seed).standard_normal(x.shape)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=-2).reshape(-1, 3, 3), np.stack([a, c, d], axis=-2).reshape(-1, 3, 3)])


@given(
    height=st.floats(-3, 3), step=st.floats(0.041, 0.3), area=st.floats(0.3, 14), noise=st.sampled_from([0.0, 0.003, 0.008, 0.012]),
    smooth=st.sampled_from([0.0, 0.003]),
)  # fmt: skip
def test_a_platform_just_above_the_floor_does_not_lift_it(height: float, step: float, area: float, noise: float, smooth: float) -> None:
    corners = np.concatenate([level(20.0, height, 40, noise), level(area, height + step, 40, smooth, seed=1)])
    seen = floor_height(facets(corners), None)
    assert seen == pytest.approx(height, abs=0.001 + noise)


@given(height=st.floats(-3, 3), area=st.floats(0.5, 40))
def test_a_floor_alone_is_found_where_it_is(height: float, area: float) -> None:
    assert floor_height(facets(level(area, height)), None) == pytest.approx(height, abs=1e-6)


def test_what_lies_low_in_a_scan_without_a_floor_keeps_its_own_name() -> None:
    """A box low above the ground and a mat beside it, no floor: neither takes the other's name."""
    box = np.concatenate([level(0.3, 0.4, 20), level(0.3, 0.0, 20)[:1]])
    mat = level(0.2, 0.02, 20) + np.array([3.0, 0.0, 0.0])
    mat[:, :, 2] += 0.035 * np.sin(40 * mat[:, :, 0])  # too rough to count as level
    triangles = np.concatenate([box, mat])
    vertices, faces = np.unique(triangles.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    surface = Surface(vertices, faces.reshape(-1, 3), np.full((len(vertices), 3), 128, dtype=np.uint8))
    groups = geometry_instances(surface, SegmentationConfig()).groups
    assert "floor" not in {group.raw_label.split(":")[1] for group in groups}
    assert len(groups) == 2


def hidden_corner(is_walled: bool) -> np.ndarray:
    """The estimated floor of a room of 6 m by 4 m, in a corner of which a desk hides floor and one of the walls [m], shape (n, 2).
    is_walled: the other wall of the corner was seen."""
    top = solid_piece("bed", (4.7, 2.7, 0.7), (5.9, 3.9, 0.74))
    bottom = -0.1 if is_walled else 0.0
    return estimated([*shell(), top], without=(4.4, 2.4, bottom - 0.1, 5.95 if is_walled else 6.1, 4.1, 2.6)).polygon


def test_a_corner_that_furniture_hides_is_floor_where_walls_face_it() -> None:
    import shapely

    assert shapely.Polygon(hidden_corner(True)).area == pytest.approx(24.0, abs=0.3)
    assert shapely.Polygon(hidden_corner(False)).area < 22.5, "neither wall of it was seen: nobody knows"


def test_floor_that_furniture_hides_below_a_slanted_wall_is_floor() -> None:
    """A sofa over the whole width of an attic, below the slope: of the floor there, nothing is seen."""
    import shapely

    sofa = solid_piece("bed", (0.0, 0.0, 0.7), (WIDTH, 1.2, 0.74))
    shape = estimated([*attic(1.0, 1.4), sofa], without=(0.0, 0.0, -0.1, WIDTH, 1.2, 0.6))
    assert shapely.Polygon(shape.polygon).area == pytest.approx(WIDTH * DEPTH, abs=0.3)
    assert len(shape.slopes) == 1


def test_what_lies_outside_of_walls_is_no_floor() -> None:
    """A house around a corner: walls turn their backs to the part that is missing."""
    import shapely

    up, pieces = [0, 0, 2.5], [("floor", plate([0, 0, 0], [6, 0, 0], [0, 2, 0])), ("floor", plate([0, 2, 0], [3, 0, 0], [0, 2, 0]))]
    corners = [(0, 0), (6, 0), (6, 2), (3, 2), (3, 4), (0, 4)]
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        pieces.append(("wall", plate([x0, y0, 0], up, [x1 - x0, y1 - y0, 0])))
    outside = solid_piece("bed", (4.0, 2.8, 0.0), (4.5, 3.3, 0.5))
    assert shapely.Polygon(estimated([*pieces, outside]).polygon).area == pytest.approx(18.0, abs=0.4)


CORNERS = st.floats(0.2, 5.2), st.floats(-0.2, 3.8), st.floats(0.0, 1.4)  # within 1.5 m of the seen floor


@given(st.lists(st.tuples(*CORNERS, st.floats(0.15, 1.6), st.floats(0.15, 1.2), st.floats(0, 3)), min_size=1, max_size=4))
@settings(max_examples=25, deadline=None)
def test_where_no_walls_are_named_all_furniture_stands_in_the_room(objects: list[tuple[float, ...]]) -> None:
    """A patch of floor and boxes beside, over and around it, some in the air: few frames show what carries them."""
    pieces = [solid_piece("bed", (x, y, low), (x + width, y + depth, low + 0.4), yaw) for x, y, low, width, depth, yaw in objects]
    room = Polygon(estimated([("floor", plate((1.5, 1.0, 0.0), (3.0, 0.0, 0.0), (0.0, 2.0, 0.0))), *pieces]).polygon).buffer(1e-6)
    for _, (points, _) in pieces:
        assert room.contains(MultiPoint(points[:, :2]))


def test_whoever_carried_the_camera_stood_in_the_room_and_not_behind_a_wall() -> None:
    """A camera sees the floor from 1.2 m before it; another one looks through a window of a wall that was seen."""
    patch = ("floor", plate((1.5, 1.0, 0.0), (3.0, 0.0, 0.0), (0.0, 2.0, 0.0)))
    wall = ("wall", plate((5.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 2.4)))
    room = assembled([patch, solid_piece("bed", (2.0, 1.5, 0.0), (3.0, 2.5, 0.5)), wall])
    cloud = dense_cloud(room.surface, room.instance)
    classes = np.array([CLASSES[label] for label in room.labels])[cloud.instance]
    before, beyond, far = [0.3, 2.0, 1.5], [5.5, 2.0, 1.5], [-4.0, 2.0, 1.5]
    polygon = Polygon(estimate_room(cloud, classes, eyes=np.array([before, beyond, far])).polygon)
    assert polygon.contains(Point(before[:2]).buffer(0.1))
    assert not polygon.contains(Point(beyond[:2]))
    assert not polygon.contains(Point(far[:2]))
    without = Polygon(estimate_room(cloud, classes).polygon)
    assert polygon.difference(without).area < 3.0
    for height in (-1.4, 4.3):  # on another storey
        assert Polygon(estimate_room(cloud, classes, eyes=np.array([[*before[:2], height]])).polygon).equals(without)


def test_furniture_behind_a_wall_that_nobody_named_stands_in_another_room() -> None:
    low, far = solid_piece("bed", (4.5, 1.5, 0.0), (5.2, 2.5, 0.5)), solid_piece("bed", (6.5, 1.5, 0.0), (7.2, 2.5, 0.5))
    unnamed = solid_piece("wall", (6.0, 0.0, 0.0), (6.05, 4.0, 2.4))
    pieces = [("floor", plate((1.5, 1.0, 0.0), (3.0, 0.0, 0.0), (0.0, 2.0, 0.0))), low, far, unnamed]
    room = assembled(pieces)
    instance = np.where(room.instance == 3, -1, room.instance)
    cloud = dense_cloud(room.surface, instance)
    classes = np.where(cloud.instance == 0, CLASSES["floor"], 0)
    polygon = Polygon(estimate_room(cloud, classes).polygon)
    assert polygon.contains(MultiPoint(low[1][0][:, :2]))
    assert not polygon.intersects(MultiPoint(far[1][0][:, :2]))


def test_walls_that_nobody_named_bound_a_room_however_low_they_were_seen() -> None:
    """A bed at a wall of which 1.1 m were seen takes none of what lies behind it."""
    pieces = [*shell(), solid_piece("bed", (0.01, 1.0, 0.0), (2.0, 2.6, 0.5))]
    room = assembled(pieces)
    walls = [number for number, label in enumerate(room.labels) if label == "wall"]
    instance = np.where(np.isin(room.instance, [0, *walls]), -1, room.instance)
    low = ~(np.isin(room.instance, walls) & (room.surface.vertices[:, 2] > 1.1))
    surface = Surface(room.surface.vertices, room.surface.faces[low[room.surface.faces].all(axis=1)], room.surface.colors)
    cloud = dense_cloud(surface, instance)
    used = np.unique(surface.faces)
    cloud = dataclasses.replace(
        cloud, points=cloud.points[used], normals=cloud.normals[used], areas=cloud.areas[used], instance=cloud.instance[used]
    )
    polygon = Polygon(estimate_room(cloud, np.zeros(len(cloud.points), dtype=np.int64)).polygon)
    assert polygon.symmetric_difference(box(0.0, 0.0, WIDTH, DEPTH)).area < 0.3
