"""Instances of meshes without labels: refined meshes, the room's planes, merged regions, and what shapes are called."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.capture.meshes import mesh_score
from bench.capture.shapes import held_out, table_of
from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.naming import FEATURES, UNKNOWN, ShapeNamingConfig, _shapes, name_by_shape
from tasks.capture.instances.regions import RegionConfig, merged_regions, region_segments
from tasks.capture.instances.resolution import evened, is_uneven, longest_edges, refined
from tasks.capture.instances.segmentation import SegmentationConfig, geometry_instances
from tasks.capture.instances.structure import outward, structure_of
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import yaw_pose
from tasks.geometry.triangles import enclosed_volume, face_areas, is_closed, vertex_normals
from tasks.segments import edges_of
from tests.capture_scans import OBJECTS, box_room, plate

WHOLE = SegmentationConfig()


def mesh(triangles: np.ndarray) -> Surface:
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return Surface(vertices, faces.reshape(-1, 3), np.full((len(vertices), 3), 128, dtype=np.uint8))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), longest=st.floats(0.15, 1.0))
def test_a_refined_mesh_is_the_same_surface_in_short_edges(seed: int, longest: float) -> None:
    """A closed mesh of any triangles stays closed, and each part lies in the plane of its face."""
    from scipy.spatial import ConvexHull

    points = np.random.default_rng(seed).normal(size=(12, 3))
    hull = ConvexHull(points)
    faces = np.array([face if np.cross(*(points[face[1:]] - points[face[0]])) @ normal[:3] > 0 else face[::-1]
                      for face, normal in zip(hull.simplices, hull.equations, strict=True)])  # fmt: skip
    surface = Surface(points, faces.astype(np.int64), np.zeros((len(points), 3), np.uint8))
    fine, parent = refined(surface, longest)
    assert longest_edges(fine).max() <= longest
    assert is_closed(fine.faces)
    assert enclosed_volume(fine.vertices, fine.faces) == pytest.approx(hull.volume)
    by_face = np.bincount(parent, weights=face_areas(fine.vertices, fine.faces), minlength=len(faces))
    assert by_face == pytest.approx(face_areas(points, faces))
    assert (fine.vertices[: len(points)] == points).all()


def test_a_mesh_of_large_triangles_is_uneven_and_one_of_a_sensor_is_not() -> None:
    assert is_uneven(mesh(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)))
    assert not is_uneven(box_room(cameras=1).surface)


def test_vertices_at_one_place_are_one_to_the_graph() -> None:
    room = box_room(cameras=1).surface
    apart = Surface(room.vertices[room.faces.ravel()], np.arange(room.faces.size).reshape(-1, 3), room.colors[room.faces.ravel()])
    one, other = evened(room, False), evened(apart, False)
    assert (one.surface.vertices == other.surface.vertices).all()
    assert (one.surface.faces == other.surface.faces).all()


def planes_of(surface: Surface) -> list[tuple[str, np.ndarray]]:
    even = evened(surface, False).surface
    areas = vertex_areas(even)
    normals = outward(even.vertices, vertex_normals(even.vertices, even.faces), areas)
    return [(plane.category, even.vertices[plane.members]) for plane in structure_of(even.vertices, normals, areas)]


@pytest.mark.parametrize("is_inside_out", [False, True])
@pytest.mark.parametrize("yaw", [0.0, 0.01, 0.6])
def test_a_room_turned_any_way_has_its_planes_whole_and_nothing_else_in_them(yaw: float, is_inside_out: bool) -> None:
    surface = box_room(cameras=1).surface.transformed(yaw_pose(yaw))
    if is_inside_out:
        surface = dataclasses.replace(surface, faces=surface.faces[:, ::-1])
    planes = planes_of(surface)
    assert sorted(category for category, _ in planes) == ["ceiling", "floor", *["wall"] * 4]
    for category, points in planes:
        local = points @ yaw_pose(-yaw)[:3, :3].T
        thickness = np.ptp(local, axis=0).min()
        assert thickness < (0.05 if category != "wall" else 0.06)
        if category == "wall":
            assert np.ptp(local, axis=0).max() > 2.7


def test_the_two_sides_of_a_thin_wall_between_rooms_are_two_walls() -> None:
    floor = plate([-3, -2, 0], [6, 0, 0], [0, 4, 0])
    sides = [plate([-0.04, -2, 0], [0, 0, 2.5], [0, 4, 0]), plate([0.04, -2, 0], [0, 4, 0], [0, 0, 2.5])]
    ends = [plate([-3, -2, 0], [0, 4, 0], [0, 0, 2.5]), plate([3, -2, 0], [0, 0, 2.5], [0, 4, 0])]
    triangles = np.concatenate([points[faces] for points, faces in (floor, *sides, *ends)])
    walls = [points for category, points in planes_of(mesh(triangles)) if category == "wall"]
    assert sorted(round(float(points[:, 0].mean()), 2) for points in walls) == [-3.0, -0.04, 0.04, 3.0]


def test_a_floor_below_the_floor_is_floor_and_what_a_mirror_shows_is_nothing() -> None:
    pieces = [
        plate([0, 0, 0], [4, 0, 0], [0, 4, 0]),
        plate([4.2, 0, -0.4], [2, 0, 0], [0, 2, 0]),
        plate([1, 1, -1], [0.5, 0, 0], [0, 0.5, 0]),
    ]
    surface = mesh(np.concatenate([points[faces] for points, faces in pieces]))
    (floor,) = geometry_instances(surface, WHOLE).groups
    assert floor.raw_label == "geometry:floor"
    heights = set(surface.vertices[floor.vertices, 2].round(3).tolist())
    assert heights == {0.0, -0.4}


def test_furniture_alone_has_no_floor_and_is_one_thing() -> None:
    """A table, of which the scan shows no floor: neither its top is a floor nor its sides are walls."""
    room = box_room(objects=OBJECTS[:1], cameras=1)
    own = room.instance == room.labels.index("table")
    keep = own[room.surface.faces].all(axis=1)
    used, faces = np.unique(room.surface.faces[keep], return_inverse=True)
    table = Surface(room.surface.vertices[used], faces.reshape(-1, 3), room.surface.colors[used])
    (group,) = geometry_instances(table, WHOLE).groups
    assert len(group.vertices) == len(table.vertices)
    assert len(group.faces) == len(table.faces)


def regions_of(surface: Surface, config: RegionConfig) -> tuple[np.ndarray, np.ndarray]:
    areas = vertex_areas(surface)
    normals = vertex_normals(surface.vertices, surface.faces)
    return merged_regions(surface, normals, areas, region_segments(surface, normals, areas, config), config), areas


def hills(seed: int) -> Surface:
    """A wavy sheet of 1.6 m by 1.6 m with patches of color."""
    points, faces = plate([0, 0, 0], [1.6, 0, 0], [0, 1.6, 0], step=0.04)
    rng = np.random.default_rng(seed)
    points[:, 2] = 0.15 * np.abs(np.sin(rng.uniform(3, 9) * points[:, 0]) * np.sin(rng.uniform(3, 9) * points[:, 1]))
    colors = rng.integers(0, 256, (4, 3))[(points[:, 0] > 0.8) * 2 + (points[:, 1] > 0.8)]
    return Surface(points, faces, colors.astype(np.uint8))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), most=st.floats(0.05, 1.0), limit=st.floats(0.05, 2.0))
def test_regions_hang_together_and_none_is_too_large(seed: int, most: float, limit: float) -> None:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    surface = hills(seed)
    region, areas = regions_of(surface, RegionConfig(most_share=most, most_m2=0.05, limit=limit))
    sizes = np.bincount(region[region >= 0], weights=areas[region >= 0])
    assert (sizes <= max(most * areas.sum(), 0.05) + 1e-9).all()
    assert (sizes >= RegionConfig().least_m2).all()
    edges = edges_of(surface.faces, len(areas))
    within = edges[(region[edges[:, 0]] == region[edges[:, 1]]) & (region[edges[:, 0]] >= 0)]
    graph = coo_array((np.ones(len(within)), tuple(within.T)), shape=(len(areas),) * 2)
    _, label = connected_components(graph, directed=False)
    assert len(np.unique(label[region >= 0])) == len(sizes)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_higher_limit_merges_on_and_takes_nothing_apart(seed: int) -> None:
    low, high = (regions_of(hills(seed), RegionConfig(limit=limit, most_share=1.0))[0] for limit in (0.05, 0.6))
    both = {(int(a), int(b)) for a, b in zip(low, high, strict=True) if a >= 0}
    assert len(both) == len({a for a, _ in both})


def test_instances_hang_on_no_order_of_faces_and_vertices() -> None:
    things = [
        (label, (x, y, z + 0.2), size, yaw) for label, (x, y, z), size, yaw in OBJECTS[:3]
    ]  # where two surfaces meet, normals cancel out
    room, rng = evened(box_room(things, cameras=1).surface, False).surface, np.random.default_rng(0)
    room = dataclasses.replace(room, vertices=room.vertices + rng.normal(0, 0.001, room.vertices.shape))  # no two edges weigh the same
    order, number = rng.permutation(len(room.vertices)), np.empty(len(room.vertices), dtype=np.int64)
    number[order] = np.arange(len(order))
    shuffled = Surface(room.vertices[order], number[room.faces][rng.permutation(len(room.faces))], room.colors[order])
    one, other = geometry_instances(room, WHOLE), geometry_instances(shuffled, WHOLE)
    assert [group.raw_label for group in one.groups] == [group.raw_label for group in other.groups]
    for a, b in zip(one.groups, other.groups, strict=True):
        assert np.unique(number[a.vertices]).tolist() == b.vertices.tolist()
    assert one.probabilities == pytest.approx(other.probabilities)


@given(st.integers(0, 10_000))
def test_probabilities_are_of_all_names_together(number: int) -> None:
    """The most probable name is given where it is probable enough; else `unknown`, with what is left for it."""
    _, _, shapes = _shapes()
    rng = np.random.default_rng(number)
    shape = shapes[number % len(shapes)] + rng.normal(0, 0.05, len(FEATURES))
    sure, any_ = (name_by_shape(shape, ShapeNamingConfig(least=least)) for least in (0.5, 0.0))
    assert 0.0 <= sure.probability <= 1.0
    if any_.probability >= 0.5:
        assert sure == any_
    else:
        assert sure.category == UNKNOWN
        assert sure.probability <= any_.probability


def test_what_is_unlike_anything_is_unknown() -> None:
    assert name_by_shape(np.full(len(FEATURES), 50.0), ShapeNamingConfig()).category == UNKNOWN


def test_the_table_of_shapes_is_read_as_it_is_written() -> None:
    names, whose, shapes = _shapes()
    from tasks.capture.instances.naming import SHAPES_FILE

    rows = [(names[k], shape) for k, shape in zip(whose, shapes, strict=True)]
    assert table_of(rows) == SHAPES_FILE.read_bytes()
    assert UNKNOWN in names
    assert not {"wall", "floor", "ceiling"} & set(names)


def test_names_are_as_often_right_as_they_say_in_what_they_were_not_told_of() -> None:
    """Half of the shapes by the other half: of names that are told with 0.7 on average, 0.6 to 0.8 come true."""
    names, whose, shapes = _shapes()
    rows = [(names[k], shape) for k, shape in zip(whose, shapes, strict=True)]
    answers = held_out([rows[: len(rows) // 2], rows[len(rows) // 2 :]], ShapeNamingConfig())
    named = [(name.probability, name.category == true) for true, name in answers if name.category != UNKNOWN]
    told, right = np.mean(named, axis=0)
    assert len(named) > 40
    assert right == pytest.approx(told, abs=0.12)


def test_scores_of_a_mesh_are_what_they_say() -> None:
    """Two objects and nobody's points: one found with a half of it beside, one in two pieces."""
    owner = np.array([0] * 10 + [1] * 10 + [-1] * 5)
    found = np.array([0] * 10 + [1] * 4 + [2] * 6 + [0] * 5)
    score = mesh_score(owner, found, np.ones(25), np.array([0, 1]))
    assert (score.objects, score.regions, score.half, score.quarter, score.in_pieces) == (2, 3, 2, 2, 0)
    assert score.largest == pytest.approx(15 / 25)
    assert mesh_score(owner, found, np.ones(25), np.array([1])).half == 1
    nothing = mesh_score(owner, np.full(25, -1), np.ones(25), np.array([0, 1]))
    assert (nothing.regions, nothing.half, nothing.largest) == (0, 0, 0.0)
