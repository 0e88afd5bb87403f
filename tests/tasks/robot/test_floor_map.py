"""The floor of a replica: what stands in the way, and what the lidar's plane cuts."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
import shapely
import trimesh

from tasks.exports.bodies import Replica
from tasks.geometry.meshes import surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import translation, yaw_pose
from tasks.robot.configuration import Cart, Lidar
from tasks.robot.floor_map import EDGE, Floor, cut, floor_of, outline
from tasks.robot.lidar import lidar_returns, ray_angles
from tests.replicas import ROOM, Object, cube, furnished, replica_of, rows_of

CART, LIDAR = Cart(), Lidar()


def made(objects: list, carriers: dict[str, str | None] | None = None) -> tuple[Replica, Floor]:
    rows, blobs = rows_of(objects)
    replica = replica_of(rows, blobs)
    named = {row.instance_id: row.parent_id for row in rows["supports"]} if carriers is None else carriers
    return replica, floor_of(replica, CART, LIDAR, named)


@pytest.fixture(scope="module")
def study() -> tuple[Replica, Floor]:
    return made(furnished())


def test_what_is_climbed_or_passed_under_is_no_obstacle() -> None:
    flat = cube((0.6, 0.4, CART.climb_m - 0.005), translation((0.0, 0.0, 0.0)))
    shelf = cube((0.6, 0.4, 0.3), translation((-1.0, 0.0, CART.height_m + 0.01)))
    crate = cube((0.6, 0.4, 0.3), yaw_pose(0.5, (1.0, -1.0, 0.0)))
    _, floor = made([flat, shelf, crate])
    names = [name for name in floor.obstacles if name.isdigit()]
    assert len(names) == 1
    turned = shapely.affinity.rotate(shapely.box(0.7, -1.2, 1.3, -0.8), 0.5, use_radians=True)
    assert shapely.symmetric_difference(floor.obstacles[names[0]], turned).area < 0.01
    assert floor.standing >= {names[0]}
    assert [name for name in floor.plane if name.isdigit()] == names
    lines = shapely.union_all([shapely.LineString(line.reshape(2, 2)) for line in floor.plane[names[0]]])
    assert shapely.hausdorff_distance(lines, turned.exterior, densify=0.01) < 0.003


def test_a_rug_may_be_thicker_than_a_sill_and_not_than_a_mattress() -> None:
    boxes = [
        cube((0.6, 0.4, height), translation((x, 0.0, 0.0))) for x, height in ((-1.0, 0.05), (0.0, 0.05), (1.0, CART.covering_m + 0.02))
    ]
    rug, sill, thick = (dataclasses.replace(box, category=name) for box, name in zip(boxes, ("rug", "box", "rug"), strict=True))
    _, floor = made([rug, sill, thick])
    assert sorted(name for name in floor.obstacles if name.isdigit()) == ["0002", "0003"]
    assert "0001" not in floor.standing


def test_what_stands_on_the_floor_is_what_could_be_moved() -> None:
    rug = cube((2.0, 2.0, 0.01), translation((0.0, 0.0, 0.0)))
    chair = cube((0.4, 0.4, 0.5), translation((0.0, 0.5, 0.01)), relation="on", parent_id="0001")
    box = cube((0.3, 0.3, 0.3), translation((0.0, 0.5, 0.51)), relation="on", parent_id="0002")
    _, floor = made([rug, chair, box, cube((0.4, 0.1, 0.4), translation((0.0, 1.9, 0.1)), relation="wall")])
    assert floor.standing == {"0002"}, "a rug is driven over, and what hangs on a wall stays there"
    assert floor.carriers == {"0002": "0001", "0003": "0002"}
    assert {"0001", "0002", "0003", "0004", "wall_00"} <= set(floor.envelopes)
    assert floor.envelopes["0003"][1:] == pytest.approx((0.51, 0.81))
    assert floor.envelopes["0003"].plan.area == pytest.approx(0.09)


def test_doors_are_open() -> None:
    door = Object("door", *[cube((0.9, 0.05, 2.0), np.eye(4)).parts] * 2, pose=translation((0.0, 0.0, 0.0)))
    _, floor = made([door, cube((0.3, 0.3, 0.3), translation((1.0, 0.0, 0.0)))])
    assert "0001" not in {*floor.obstacles, *floor.plane, *floor.standing, *floor.envelopes}
    assert "0002" in floor.obstacles


def test_the_room_is_bounded_by_its_edge_and_its_walls(study: tuple[Replica, Floor]) -> None:
    _, floor = study
    assert shapely.symmetric_difference(floor.polygon, shapely.Polygon(ROOM)).area < 1e-6
    assert floor.edge_names[: len(ROOM)] == [EDGE] * len(ROOM)
    assert len(floor.edges) == len(floor.edge_names)
    around = shapely.union_all([shapely.LineString(line.reshape(2, 2)) for line in floor.segments]).envelope
    assert around.buffer(1e-6).contains(floor.polygon)


def test_a_disc_in_the_free_space_touches_nothing(study: tuple[Replica, Floor]) -> None:
    _, floor = study
    free = floor.free(0.2)
    assert free.area > 2
    blocked = shapely.union_all(list(floor.obstacles.values()))
    assert free.distance(blocked) >= 0.2
    assert free.distance(floor.polygon.exterior) >= 0.2
    points = np.random.default_rng(0).uniform(-3.5, 3.5, (500, 2))
    expected = [floor.polygon.contains(shapely.Point(p)) and not blocked.intersects(shapely.Point(p)) for p in points]
    np.testing.assert_array_equal(floor.covers(points), expected)


def test_the_lidar_sees_what_rays_meet_in_the_replica(study: tuple[Replica, Floor]) -> None:
    """Against Embree on the surfaces themselves."""
    replica, floor = study
    surfaces = [surface_of(body.shape.parts).transformed(body.pose).to_trimesh() for body in replica.bodies]
    scene = RayScene([*surfaces, *(part for name, part in replica.shell if name != "floor")])
    lidar = Lidar(noise_m=0.0, dropped=0.0)
    for x, y, yaw in ((-2.0, -1.5, 0.3), (2.0, 0.4, 2.0), (0.0, 1.6, -1.0)):
        angles = ray_angles(lidar) + yaw
        rays = np.zeros((len(angles), 6), dtype=np.float32)
        rays[:, :3] = [x, y, lidar.height_m]
        rays[:, 3], rays[:, 4] = np.cos(angles), np.sin(angles)
        true = scene.cast(rays)["t_hit"]
        seen = lidar_returns(floor.segments, [x, y, yaw], lidar)
        both = np.isfinite(true) & np.isfinite(seen)
        assert both.sum() > 300
        assert np.median(np.abs(true - seen)[both]) < 0.002
        assert (np.abs(true - seen)[both] < 0.02).mean() > 0.97, "the rest passes corners"


def test_what_a_plane_cuts_of_a_sphere_is_a_circle() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    lines = cut(ball, 0.3)
    radii = np.hypot(*lines.reshape(-1, 2).T)
    assert 0.395 < radii.min() <= radii.max() < 0.4001
    assert len(cut(ball, 0.6)) == 0


def test_outlines_close_and_have_holes() -> None:
    ring = shapely.box(0, 0, 4, 4).difference(shapely.box(1, 1, 2, 2))
    edges = outline(ring)
    assert np.hypot(*(edges[:, 2:] - edges[:, :2]).T).sum() == pytest.approx(20.0)


def test_a_floor_travels(study: tuple[Replica, Floor]) -> None:
    _, floor = study
    twin = pickle.loads(pickle.dumps(floor))
    np.testing.assert_array_equal(twin.segments, floor.segments)
    assert twin.carriers == floor.carriers
    assert twin.carriers, "something stands on something"


def test_a_bracket_is_in_the_way_where_it_is_low_and_the_lidar_passes_it() -> None:
    replica, _ = made([])
    low, high = (
        trimesh.creation.box((0.3, 0.3, 0.02), translation((x, 0.0, z))) for x, z in ((-1.0, LIDAR.height_m), (1.0, CART.height_m + 0.1))
    )
    floor = floor_of(dataclasses.replace(replica, brackets=(("bracket_0001", low), ("bracket_0002", high))), CART, LIDAR, {})
    assert [name for name in floor.obstacles if name.startswith("bracket")] == ["bracket_0001"]
    assert not [name for name in floor.plane if name.startswith("bracket")]
