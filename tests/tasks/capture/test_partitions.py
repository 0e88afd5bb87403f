"""Walls inside a room: found in scans, standing in replicas, in the way of agents and of moves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from schemas.capture import Shell
from schemas.errors import InputError
from tasks import navigation
from tasks.capture.cloud import dense_cloud
from tasks.capture.labels import CEILING, FLOOR, WALL
from tasks.capture.rooms.room import RoomShape, estimate_room
from tasks.capture.rooms.slabs import Slab, joined
from tasks.geometry.meshes import Surface, vertex_colors
from tasks.geometry.transforms import yaw_pose
from tasks.navigation.obstacles import free_space
from tasks.navigation.planar import PlanarPathFinder
from tasks.navigation.targets import view_points
from tasks.optimization import Default, Released
from tasks.optimization.search.collisions import room_triangles
from tasks.shell import interior_footprints, room_shell
from tests.capture_scans import BoxRoom, box_plates, box_room, plate, write_scannet
from tests.replicas import furnished, room_of, rows_of, with_navigation
from tests.tasks.capture.test_capture import captured
from tests.tasks.exports.test_exports import export
from tests.tasks.navigation.test_navigation import furnished as objects_in_a_room
from tests.tasks.navigation.test_navigation import solid
from tests.tasks.optimization.scenes import Scene, block, bounds

WIDTH, DEPTH, HEIGHT = 6.0, 4.0, 2.5
CLASSES = {"floor": FLOOR, "wall": WALL, "ceiling": CEILING, "wardrobe": 3, "bed": 4, "door": 8, "counter": 12}

Piece = tuple[str, tuple[np.ndarray, np.ndarray]]


def shell(width: float = WIDTH, depth: float = DEPTH) -> list[Piece]:
    """Floor and the four walls around it, as seen from inside."""
    up = [0, 0, HEIGHT]
    return [
        ("floor", plate([0, 0, 0], [width, 0, 0], [0, depth, 0])),
        ("wall", plate([0, 0, 0], up, [width, 0, 0])), ("wall", plate([0, depth, 0], [width, 0, 0], up)),
        ("wall", plate([0, 0, 0], [0, depth, 0], up)), ("wall", plate([width, 0, 0], up, [0, depth, 0])),
    ]  # fmt: skip


def solid_piece(label: str, low: tuple[float, float, float], high: tuple[float, float, float], yaw: float = 0.0) -> Piece:
    """A box between two corners, turned about its middle."""
    a, b = np.array(low), np.array(high)
    return label, box_plates(b - a, yaw_pose(yaw, (a + b) / 2))


def wall_with_door(x: float = 3.0, thickness: float = 0.12, door: tuple[float, float] = (2.4, 3.3)) -> list[Piece]:
    """A wall across the room with a doorway 2.05 m high, and the wall over it."""
    a, b = x - thickness / 2, x + thickness / 2
    return [
        solid_piece("wall", (a, 0, 0), (b, door[0], HEIGHT)),
        solid_piece("wall", (a, door[1], 0), (b, DEPTH, HEIGHT)),
        solid_piece("wall", (a, door[0], 2.05), (b, door[1], HEIGHT)),
    ]


def assembled(pieces: list[Piece], noise: float = 0.0) -> BoxRoom:
    """The pieces as one mesh, instance by instance; vertices moved by `noise` [m]."""
    offsets = np.cumsum([0, *(len(points) for _, (points, _) in pieces)])
    vertices = np.concatenate([points for _, (points, _) in pieces])
    faces = np.concatenate([triangles + offset for (_, (_, triangles)), offset in zip(pieces, offsets, strict=False)])
    instance = np.concatenate([np.full(len(points), i) for i, (_, (points, _)) in enumerate(pieces)])
    shades = {"floor": (150, 110, 70), "wall": (200, 210, 220)}
    colors = np.concatenate([np.tile(shades.get(label, (10, 10, 10)), (len(points), 1)) for label, (points, _) in pieces]).astype(np.uint8)
    vertices = vertices + np.random.default_rng(0).normal(0, noise, vertices.shape)
    return BoxRoom(Surface(vertices, faces, colors), instance, tuple(label for label, _ in pieces), ())


def estimated(pieces: list[Piece], noise: float = 0.0, without: tuple[float, ...] = ()) -> RoomShape:
    """The room of the pieces. `without`: x0, y0, z0, x1, y1, z1 of a part of space that nobody has seen [m]."""
    room = assembled(pieces, noise)
    surface, instance = room.surface, room.instance
    if without:
        unseen = np.all((surface.vertices > without[:3]) & (surface.vertices < without[3:]), axis=1)
        surface = Surface(surface.vertices, surface.faces[~unseen[surface.faces].any(axis=1)], surface.colors)
    cloud = dense_cloud(surface, instance)
    used = np.unique(surface.faces)
    cloud = dataclasses.replace(
        cloud, points=cloud.points[used], normals=cloud.normals[used], areas=cloud.areas[used], instance=cloud.instance[used]
    )
    return estimate_room(cloud, np.array([CLASSES[label] for label in room.labels])[cloud.instance])


def ordered(shape: RoomShape) -> np.ndarray:
    """Interior walls across the room, from low to high y."""
    rows = [w if w[1] <= w[3] else [*w[2:4], *w[:2], *w[4:]] for w in shape.interior_walls.tolist()]
    return np.array(sorted(rows, key=lambda w: w[1])).reshape(-1, 6)


def with_walls(room: Shell, walls: list[tuple[float, ...]], **values: Any) -> Shell:
    return dataclasses.replace(room, interior_walls=tuple(walls), **values)


# capture


@pytest.mark.whole
@given(st.floats(1.2, 4.8), st.floats(0.06, 0.3), st.floats(0.6, 2.4), st.floats(0.75, 1.2), st.booleans())
@example(3.0, 0.25, 1.375, 1.0, False)  # both sides end at whole cells, 30 cm apart: one plan, and no line between
@settings(max_examples=25, deadline=None)
def test_a_wall_between_two_rooms_is_found_and_its_doorway_stays_open(
    x: float, thickness: float, start: float, width: float, is_noisy: bool
) -> None:
    door = (start, start + width)
    shape = estimated([*shell(), *wall_with_door(x, thickness, door)], noise=0.004 if is_noisy else 0.0)
    walls = ordered(shape)
    assert shape.area == pytest.approx(WIDTH * DEPTH, rel=0.02)
    assert len(walls) == 2
    assert np.abs(walls[:, [0, 2]] - x).max() < 0.03
    assert np.abs(walls[:, 4] - thickness).max() < 0.03
    assert np.abs(walls[:, [1, 3]] - [[0, door[0]], [door[1], DEPTH]]).max() < 0.03
    assert np.allclose(walls[:, 5], shape.height)
    assert not shape.notes
    # each wall's two faces are among the walls, and the room lies to their left
    faces = shape.walls[len(shape.polygon) :]
    assert len(faces) == 4
    for x0, y0, x1, y1 in faces:
        left = np.array([-(y1 - y0), x1 - x0]) / np.hypot(x1 - x0, y1 - y0)
        assert np.sign(left[0]) == np.sign((x0 + x1) / 2 - x)


@pytest.mark.parametrize("quarter", [0, 1])
def test_two_rooms_through_the_whole_stage(quarter: int, tmp_path: Path) -> None:
    """A tilted and turned scan folder: rows carry the walls, their colors and the floor's."""
    room = assembled([*shell(), *wall_with_door(), solid_piece("bed", (0.3, 0.4, 0), (1.3, 2.3, 0.5))])
    turned = room.surface.transformed(yaw_pose(quarter * math.pi / 2, [0, 0, 0]))
    outcome = captured(write_scannet(tmp_path / "scene0001_00", dataclasses.replace(room, surface=turned), frames="none"))
    (row,) = outcome.rows["shells"]
    assert len(row.interior_walls) == 2
    for wall in row.interior_walls:
        assert abs((wall[1] if quarter else wall[0]) - 3.0) < 0.03
        assert wall[4] == pytest.approx(0.12, abs=0.03)
    assert sum(math.dist(wall[:2], wall[2:4]) for wall in row.interior_walls) == pytest.approx(DEPTH - 0.9, abs=0.06)
    assert row.floor_color == (150, 110, 70)
    assert row.wall_color == (200, 210, 220)


@pytest.mark.parametrize("yaw", [0.15, 0.4, -0.5, 0.79, 1.3])
def test_walls_in_other_directions_are_found(yaw: float) -> None:
    wall = solid_piece("wall", (1.8, 1.94, 0), (4.2, 2.06, HEIGHT), yaw)
    (found,) = estimated([*shell(), wall], noise=0.003).interior_walls
    expected = shapely.LineString(
        [np.array([3, 2]) - 1.2 * np.array([np.cos(yaw), np.sin(yaw)]), np.array([3, 2]) + 1.2 * np.array([np.cos(yaw), np.sin(yaw)])]
    )
    assert shapely.hausdorff_distance(shapely.LineString(found[:4].reshape(2, 2)), expected) < 0.05
    assert found[4] == pytest.approx(0.12, abs=0.03)


def test_a_wall_seen_from_one_side_has_the_thickness_of_a_partition_behind_its_face() -> None:
    face = ("wall", plate([3, 0.0, 0], [0, 0, HEIGHT], [0, 2.4, 0]))  # looks to -x
    (found,) = ordered(estimated([*shell(), face]))
    assert found == pytest.approx([3.05, 0, 3.05, 2.4, 0.1, HEIGHT], abs=0.03)


def test_furniture_before_a_wall_does_not_open_it() -> None:
    """A wardrobe hides one face, a door that stands open along the wall the other: only the wall above them is seen."""
    pieces = [*shell(), solid_piece("wall", (2.9, 0, 0), (3.1, DEPTH, HEIGHT))]
    pieces += [solid_piece("wardrobe", (2.3, 1.8, 0), (2.85, 3.95, 2.1)), solid_piece("door", (3.13, 1.7, 0), (3.17, 3.95, 2.1))]
    (found,) = ordered(estimated(pieces, without=(2.85, 1.75, -0.1, 3.12, 4.1, 2.1)))
    assert found == pytest.approx([3.0, 0, 3.0, DEPTH, 0.2, HEIGHT], abs=0.03)
    # the same wall with floor under it where nothing was seen of it is a wall with a doorway
    threshold = ("floor", plate([2.9, 1.75, 0], [0.2, 0, 0], [0, 2.25, 0]))
    opened = ordered(estimated([*pieces[:6], threshold], without=(2.85, 1.75, 0.01, 3.15, 4.1, 2.1)))
    assert [wall[3] for wall in opened] == pytest.approx([1.75], abs=0.06)


def test_a_window_between_rooms_is_no_passage() -> None:
    pieces = [
        solid_piece("wall", (2.94, 0, 0), (3.06, 1.5, HEIGHT)), solid_piece("wall", (2.94, 2.5, 0), (3.06, DEPTH, HEIGHT)),
        solid_piece("wall", (2.94, 1.5, 0), (3.06, 2.5, 0.9)), solid_piece("wall", (2.94, 1.5, 2.1), (3.06, 2.5, HEIGHT)),
    ]  # fmt: skip
    (found,) = ordered(estimated([*shell(), *pieces]))
    assert found == pytest.approx([3, 0, 3, DEPTH, 0.12, HEIGHT], abs=0.03)


SINGLE: dict[str, list[Piece]] = {
    "wardrobe": [solid_piece("wardrobe", (1.0, 1.0, 0), (2.0, 1.3, 2.2))],
    "wardrobe whose front is called wall": [("wall", plate([1.0, 0.6, 0], [1.5, 0, 0], [0, 0, 2.2]))],
    "pillar": [solid_piece("wall", (2.0, 2.0, 0), (2.3, 2.3, HEIGHT))],
    "chimney": [solid_piece("wall", (2.0, 0.0, 0), (3.2, 0.5, HEIGHT))],
    "wall scanned twice": [("wall", plate([0.15, 0, 0], [0, DEPTH, 0], [0, 0, HEIGHT]))],
    "beam": [solid_piece("wall", (2.9, 0, 2.1), (3.1, DEPTH, HEIGHT))],
    "counter": [solid_piece("counter", (2.0, 2.0, 0), (4.0, 2.2, 1.5))],
}


@pytest.mark.parametrize("name", SINGLE)
def test_nothing_else_becomes_a_wall(name: str) -> None:
    pieces = [*shell(), *SINGLE[name]]
    if "front" in name:  # nobody has seen the floor behind it
        pieces[0] = ("floor", plate([0, 0.6, 0], [WIDTH, 0, 0], [0, DEPTH - 0.6, 0]))
    # nobody sees the floor below a chimney
    shape = estimated(pieces, without=(1.9, -0.1, -0.1, 3.3, 0.6, 0.01) if name == "chimney" else ())
    assert len(shape.interior_walls) == 0
    assert len(shape.walls) == len(shape.polygon)


@pytest.mark.parametrize("door", [(1.8, 2.7), (2.4, 3.3), (2.75, 3.6)])
def test_a_wall_goes_on_beyond_a_doorway_though_its_far_side_and_the_floor_there_are_hidden(door: tuple[float, float]) -> None:
    near, _, lintel = wall_with_door(door=door)
    side = ("wall", plate([2.94, door[1], 0], [0, 0, HEIGHT], [0, DEPTH - door[1], 0]))
    counter = solid_piece("counter", (3.06, door[1], 0.05), (3.9, DEPTH, 0.9))
    walls = ordered(estimated([*shell(), near, side, lintel, counter], without=(3.02, door[1] - 0.02, -0.1, 3.95, DEPTH + 0.1, 0.03)))
    assert len(walls) == 2
    assert np.abs(walls[:, [0, 2]] - 3.0).max() < 0.03
    assert np.abs(walls[:, 4] - 0.12).max() < 0.03
    assert np.abs(walls[:, [1, 3]] - [[0, door[0]], [door[1], DEPTH]]).max() < 0.06
    assert walls[:, 5] == pytest.approx(HEIGHT, abs=0.03)


def test_what_is_too_thick_for_a_low_wall_is_left_out_and_reported() -> None:
    shape = estimated([*shell(), solid_piece("wall", (1.5, 1.5, 0), (4.5, 2.0, 1.0))])
    assert len(shape.interior_walls) == 0
    assert any("left out of interior_walls" in note for note in shape.notes)
    (taller,) = estimated([*shell(), solid_piece("wall", (1.5, 1.9, 0), (4.5, 2.0, 1.6))]).interior_walls
    assert taller[5] == pytest.approx(1.6, abs=0.03)


def test_single_rooms_have_none(tmp_path: Path) -> None:
    (row,) = captured(write_scannet(tmp_path / "scene0001_00", box_room(), frames="none")).rows["shells"]
    assert row.interior_walls == ()
    assert row.floor_color == (40, 60, 80)  # the first of the box room's colors


def test_ends_near_another_wall_reach_it_and_no_slab_leaves_the_floor() -> None:
    floor = shapely.box(0, 0, WIDTH, DEPTH)
    across = Slab(np.array([3.0, -0.2]), np.array([3.0, 3.8]), 0.1, HEIGHT)
    branch = Slab(np.array([3.2, 2.0]), np.array([5.2, 2.0]), 0.1, HEIGHT)
    first, second = joined([across, branch], floor)
    assert np.allclose([*first.start, *first.end], [3, 0, 3, DEPTH])
    assert np.allclose([*second.start, *second.end], [3, 2, 5.2, 2])


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.realdata
def test_walls_of_a_modelled_house(realdata: Callable[[str], Path]) -> None:
    """Its own faces say where: 20 cm thick beside the folding doors, 10 cm and 1.87 m tall between the bedrooms."""
    (row,) = captured(realdata("scene_aws_small_house") / "house.glb").rows["shells"]
    divider, north, south = ([*sorted([wall[:2], wall[2:4]], key=sum), wall[4:]] for wall in row.interior_walls)
    for found, expected in (
        (divider, [(-8.3, -1.496), (-3.89, -1.496), (0.105, 1.865)]),
        (north, [(-2.6, 1.3), (-2.6, 3.1), (0.2, 3.0)]),
        (south, [(-2.6, -5.5), (-2.6, -3.7), (0.2, 3.0)]),
    ):
        assert np.allclose(found, expected, atol=0.03)


# replica and exports


slabs = st.tuples(st.floats(-2, 2), st.floats(-1.5, 1.5), st.floats(-4, 4), st.floats(0.4, 3), st.floats(0.04, 0.36), st.floats(1.2, 2.6))


def slab_row(x: float, y: float, yaw: float, length: float, thickness: float, height: float) -> tuple[float, ...]:
    dx, dy = length / 2 * math.cos(yaw), length / 2 * math.sin(yaw)
    return (x - dx, y - dy, x + dx, y + dy, thickness, height)


@given(st.lists(slabs, max_size=3))
@settings(max_examples=50, deadline=None)
def test_interior_walls_are_closed_boxes_of_the_replica(values: list[tuple[float, ...]]) -> None:
    rows = [slab_row(*v) for v in values]
    room = with_walls(room_of(), rows, floor_color=(10, 20, 30), wall_color=(90, 80, 70))
    named = room_shell(room)
    inner = [(name, mesh) for name, mesh in named if name.startswith("inner_")]
    assert [name for name, _ in inner] == [f"inner_{i:02d}" for i in range(len(rows))]
    for (_, mesh), (_, _, _, length, thickness, height), corners in zip(inner, values, interior_footprints(room), strict=True):
        assert mesh.is_volume
        assert mesh.volume == pytest.approx(length * thickness * height)
        assert mesh.bounds[:, 2] == pytest.approx([0, height])
        assert shapely.Polygon(corners).exterior.is_ccw
    for name, mesh in named:
        expected = [10, 20, 30] if name == "floor" else [90, 80, 70]
        assert (vertex_colors(mesh) == expected).all()


@pytest.mark.parametrize("wall", [(0.0, 0.0, 0.0, 0.0, 0.1, 2.0), (0.0, 0.0, 1.0, 0.0, 0.0, 2.0), (0.0, 0.0, 1.0, 0.0)])
def test_interior_walls_without_a_size_are_refused(wall: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="interior_walls 0"):
        room_shell(with_walls(room_of(), [wall]))


def test_exports_have_interior_walls_as_colliders_and_pass_their_gates(tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdPhysics

    rows, blobs = rows_of(furnished())
    wall = (0.6, -2.0, 0.6, -0.6, 0.12, 2.6)
    rows["shells"] = [with_walls(rows["shells"][0], [wall], floor_color=(120, 90, 60))]
    outcome = export(*with_navigation(rows, blobs))
    assert [f"{row.format} {row.rule}: {row.message}" for row in outcome.rows["export_checks"] if not row.passed] == []
    for row in outcome.rows["export_files"]:
        if row.format == "usd":
            path = tmp_path / row.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(outcome.blobs[row.file_blob])
    (scene,) = tmp_path.rglob("scene.usda")
    stage = Usd.Stage.Open(str(scene))
    (collider,) = [p for p in stage.Traverse() if "Inner_00" in str(p.GetPath()) and p.HasAPI(UsdPhysics.CollisionAPI)]
    points = np.array(UsdGeom.PointBased(collider).GetPointsAttr().Get())
    assert np.allclose([points.min(axis=0), points.max(axis=0)], [[0.54, -2.0, 0.0], [0.66, -0.6, 2.6]], atol=1e-5)
    part = collider.GetParent()
    labels = [part.GetAttribute(name).Get() for name in part.GetPropertyNames() if "labels" in name]
    assert labels
    assert all(list(value) == ["wall"] for value in labels)


# navigation


@pytest.mark.whole
@given(st.floats(0.6, 2.4), st.floats(0.9, 1.3))
@settings(max_examples=15, deadline=None)
def test_paths_go_through_the_doorway_and_not_through_the_wall(start: float, width: float) -> None:
    shape = estimated([*shell(), *wall_with_door(door=(start, start + width))])
    room = with_walls(room_of(polygon=shape.polygon.tolist()), [tuple(wall) for wall in shape.interior_walls.tolist()])
    walls = [shapely.Polygon(corners) for corners in interior_footprints(room)]
    finder = PlanarPathFinder(free_space(room.floor_polygon, walls, 0.2, 0.1))
    assert len(finder.islands) == 1
    path = finder.geodesic([1.0, 1.0], [5.0, 3.0])
    line = shapely.LineString(path.corners)
    assert min(shapely.distance(line, wall) for wall in walls) >= 0.2 - 1e-6
    crossing = shapely.get_coordinates(line.intersection(shapely.LineString([(3.0, 0.0), (3.0, DEPTH)])))
    assert ((crossing[:, 1] > start) & (crossing[:, 1] < start + width)).all()
    closed = shapely.box(2.94, 0, 3.06, DEPTH)
    assert len(PlanarPathFinder(free_space(room.floor_polygon, [closed], 0.2, 0.1)).islands) == 2


def test_episodes_of_a_room_with_a_wall_never_cross_it_and_goals_are_on_the_objects_side() -> None:
    tables, context = objects_in_a_room({
        "0001": ("bed", [solid((0.8, 1.9, 0.5))], (2.35, 1.0, 0.0), 0.0),  # its side at the wall
        "0002": ("chair", [solid((0.5, 0.5, 0.9))], (4.6, 3.2, 0.0), 0.0),
    })  # fmt: skip
    depth = max(y for _, y in tables["shells"][0].floor_polygon)
    tables["shells"] = [with_walls(tables["shells"][0], [(2.83, 0.0, 2.83, depth - 1.2, 0.1, 2.5)])]
    config = navigation.NavigationConfig(train_episodes=10, test_episodes=10)
    outcome = navigation.run(**tables, context=context, config=config)
    wall = shapely.Polygon(interior_footprints(tables["shells"][0])[0])
    assert len(outcome.rows["episodes"]) == 10
    sides = set()
    for episode in outcome.rows["episodes"]:
        path = [*episode.path] if len(episode.path) > 1 else [*episode.path, *episode.path]
        assert shapely.distance(shapely.LineString(path), wall) >= config.agent.radius_m - 1e-6
        if episode.category == "bed":
            assert all(view[0] < 2.83 for view in episode.view_points)
            sides.add(episode.start_position[0] < 2.83)
    assert False in sides, "some start on the other side of the wall"


def test_a_door_is_seen_from_both_sides_of_the_wall_that_it_stands_in() -> None:
    walls = [shapely.box(2.95, 0, 3.05, 1.5), shapely.box(2.95, 2.4, 3.05, 4)]
    door = shapely.box(2.97, 1.5, 3.03, 2.4)
    finder = PlanarPathFinder(free_space([(0, 0), (6, 0), (6, 4), (0, 4)], [*walls, door], 0.2, 0.1))
    points = view_points(door, finder, navigation.NavigationConfig(), walls)
    assert (points[:, 0] < 2.9).any()
    assert (points[:, 0] > 3.1).any()


# optimization


@given(st.lists(slabs, min_size=1, max_size=3))
@settings(max_examples=50, deadline=None)
def test_walls_are_cut_out_of_the_floor_that_assets_may_stand_on(values: list[tuple[float, ...]]) -> None:
    room = with_walls(room_of(), [slab_row(*v) for v in values])
    floor = shapely.Polygon(room.floor_polygon)
    walls = [shapely.Polygon(corners) for corners in interior_footprints(room)]
    triangles = room_triangles(np.array(room.floor_polygon), interior_footprints(room))
    made = shapely.union_all([shapely.Polygon(t) for t in triangles])
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    assert (first[:, 0] * second[:, 1] >= first[:, 1] * second[:, 0]).all(), "counter-clockwise"
    assert made.area == pytest.approx(floor.difference(shapely.union_all(walls)).area, abs=1e-6)
    assert all(made.intersection(wall).area < 1e-6 for wall in walls)


@pytest.mark.parametrize("seed", range(4))
def test_no_move_pushes_an_asset_into_a_wall(seed: int) -> None:
    scene = Scene()
    wall = (0.5, -2.0, 0.5, 2.0, 0.1, 2.5)
    scene.add(block(0.5, 0.5, 0.5), yaw_pose(0, [0.19, 0.0, 0.0]))  # up to 1 cm before the wall
    scene.add(block(0.5, 0.5, 0.5), yaw_pose(0, [0.05, 0.0, 0.0]))
    free = bounds(scene.run(Released(), seed), scene, "optimized")
    assert any(box[1, 0] > 0.46 for box in free.values()), "without the wall it would be pushed there"
    scene.shells = [with_walls(scene.shells[0], [wall])]
    for method in (Released(), Default()):
        kept = scene.run(method, seed)
        for box in bounds(kept, scene, "optimized").values():
            assert box[1, 0] <= 0.45 + (1e-9 if isinstance(method, Released) else method.slop_m)
        (summary,) = kept.rows["optimizations"]
        assert summary.loss_final < summary.loss_start if isinstance(method, Released) else summary.loss_final == 0.0
        assert summary.deep_pairs == 0 or isinstance(method, Released)


def test_furniture_across_floor_that_was_seen_in_patches_belongs_to_the_room() -> None:
    """Two patches of floor, a bed between them that reaches over both, and nothing else."""
    patches = [("floor", plate([0, 0, 0], [1.5, 0, 0], [0, 3.0, 0])), ("floor", plate([3.0, 0, 0], [1.0, 0, 0], [0, 3.0, 0]))]
    shape = estimated([*patches, solid_piece("bed", (1.6, 0.5, 0.0), (2.9, 2.5, 0.6))])
    room = shapely.Polygon(shape.polygon)
    assert room.covers(shapely.box(1.7, 0.6, 2.8, 2.4))
    assert room.covers(shapely.box(0.1, 0.1, 1.4, 2.9))


def test_furniture_behind_a_wall_belongs_to_another_room() -> None:
    """A wardrobe of the next room, seen through the door, 70 cm behind a wall."""
    behind = solid_piece("wardrobe", (WIDTH + 0.7, 1.0, 0.0), (WIDTH + 2.2, 3.4, 2.0))
    alone, both = estimated(shell()), estimated([*shell(), behind])
    assert both.area == pytest.approx(alone.area, rel=0.01)
    assert not any("furniture" in note for note in both.notes)
