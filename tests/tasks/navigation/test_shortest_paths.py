"""Free floor, exact shortest paths and the actions that follow them."""

from __future__ import annotations

import dataclasses
import itertools
import math

import networkx as nx
import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.transforms import yaw_pose
from tasks.navigation.convex import ConvexCover
from tasks.navigation.follower import FORWARD, LEFT, RIGHT, STOP, Motion, follow, replay
from tasks.navigation.navmesh import Settings, dump_navmesh, navmesh_from_polygons, read_navmesh
from tasks.navigation.obstacles import GRID_M, OUTLINE_M, SEAM_M, footprint, free_space
from tasks.navigation.planar import PlanarPathFinder

ROOM_SIZE = (5.0, 4.0)

# --- shortest paths -----------------------------------------------------------------------------------------------


def box(x: float, y: float, w: float, d: float, degrees: float = 0.0) -> shapely.Polygon:
    return shapely.affinity.rotate(shapely.box(x - w / 2, y - d / 2, x + w / 2, y + d / 2), degrees)


side = st.floats(0.15, 1.8)
loose_boxes = st.builds(box, st.floats(0, 5), st.floats(0, 4), side, side, st.sampled_from([0.0, 15.0, 37.0, 45.0, 90.0]))
quarter = st.integers(0, 20).map(lambda n: n / 4)
# On a grid boxes touch, line up and share corners: everything that a general position hides.
grid_boxes = st.builds(lambda x, y, w, d: shapely.box(x, y, x + w, y + d), quarter, quarter, *[st.integers(1, 6).map(lambda n: n / 4)] * 2)
obstacles = st.one_of(st.lists(loose_boxes, max_size=8), st.lists(grid_boxes, max_size=9))


def room_less(boxes: list[shapely.Polygon]) -> shapely.Geometry:
    floor = shapely.box(0, 0, *ROOM_SIZE)
    return shapely.difference(floor, shapely.union_all(boxes)) if boxes else floor


def brute_force(free: shapely.Geometry, points: np.ndarray) -> np.ndarray:
    """Geodesic distances between all points: every pair of corners, tested by GEOS, searched by networkx."""
    at = np.unique(np.concatenate([shapely.get_coordinates(free), points]), axis=0)
    grown = shapely.buffer(free, 1e-9)
    shapely.prepare(grown)
    a, b = np.triu_indices(len(at), 1)
    seen = shapely.covers(grown, shapely.linestrings(np.stack([at[a], at[b]], axis=1)))
    graph = nx.Graph()
    graph.add_nodes_from(range(len(at)))
    graph.add_weighted_edges_from(zip(a[seen], b[seen], np.hypot(*(at[a[seen]] - at[b[seen]]).T), strict=True))
    place = [int(np.flatnonzero((at == p).all(axis=1))[0]) for p in points]
    result = np.full((len(points), len(points)), np.inf)
    for i, source in enumerate(place):
        lengths = nx.single_source_dijkstra_path_length(graph, source)
        result[i] = [lengths.get(target, np.inf) for target in place]
    return result


@given(boxes=obstacles, seed=st.integers(0, 999))
@settings(max_examples=120, deadline=None)
def test_distances_are_those_of_brute_force(boxes: list[shapely.Polygon], seed: int) -> None:
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    rng = np.random.default_rng(seed)
    points = np.array([finder.random_point(rng) for _ in range(6)])
    expected = brute_force(finder.free, points)
    found = np.array([finder.field(p).distances(points) for p in points])
    # Parts that touch at one corner are separate islands here; brute force squeezes a point through.
    island = finder.island_of(points)
    together = island[:, None] == island[None, :]
    assert (island >= 0).all()
    assert np.allclose(found[together], expected[together], rtol=0, atol=1e-6)
    assert np.isinf(found[~together]).all()


@given(boxes=obstacles, more=loose_boxes, seed=st.integers(0, 999))
@settings(max_examples=60, deadline=None)
def test_distances_are_a_metric_and_grow_with_obstacles(boxes: list[shapely.Polygon], more: shapely.Polygon, seed: int) -> None:
    wide, narrow = PlanarPathFinder(room_less(boxes)), PlanarPathFinder(room_less([*boxes, more]))
    if not narrow.islands:
        return
    rng = np.random.default_rng(seed)
    points = np.array([narrow.random_point(rng) for _ in range(5)])
    before, after = (np.array([finder.field(p).distances(points) for p in points]) for finder in (wide, narrow))
    straight = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    for distance in (before, after):
        assert (distance >= straight - 1e-9).all()
        assert np.allclose(np.where(np.isfinite(distance), distance, -1), np.where(np.isfinite(distance.T), distance.T, -1), atol=1e-9)
        for i, j, k in itertools.permutations(range(5), 3):
            assert distance[i, j] <= distance[i, k] + distance[k, j] + 1e-9
    assert (after >= before - 1e-9).all()


@given(boxes=obstacles, seed=st.integers(0, 999))
@settings(max_examples=60, deadline=None)
def test_distances_are_the_same_on_the_navmesh_that_is_written(boxes: list[shapely.Polygon], seed: int) -> None:
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    read = PlanarPathFinder.from_navmesh(read_navmesh(dump_navmesh(finder.navmesh(Settings()))))
    assert read.islands == pytest.approx(finder.islands, abs=1e-4)
    rng = np.random.default_rng(seed)
    # A hair off the edge, which single precision moves.
    inner = PlanarPathFinder(shapely.buffer(finder.free, -1e-5))
    if not inner.islands:
        return
    points = np.array([inner.random_point(rng) for _ in range(6)])
    before, after = (np.array([f.field(p).distances(points) for p in points]) for f in (finder, read))
    assert np.array_equal(np.isfinite(before), np.isfinite(after))
    assert np.allclose(after[np.isfinite(after)], before[np.isfinite(before)], rtol=0, atol=1e-4)


@given(boxes=obstacles, seed=st.integers(0, 999))
@settings(max_examples=60, deadline=None)
def test_paths_lead_through_free_floor_and_are_as_long_as_they_say(boxes: list[shapely.Polygon], seed: int) -> None:
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    rng = np.random.default_rng(seed)
    start, *goals = (finder.random_point(rng) for _ in range(5))
    one = finder.field(goals).path(start)
    every = [finder.geodesic(start, goal) for goal in goals]
    assert one.length == pytest.approx(min(path.length for path in every))
    grown = shapely.buffer(finder.free, 1e-6)
    for path in [one, *every]:
        if not path.exists:
            assert np.isinf(path.length)
            continue
        assert np.array_equal(path.corners[0], start)
        assert np.hypot(*np.diff(path.corners, axis=0).T).sum() == pytest.approx(path.length, abs=1e-9)
        assert grown.covers(shapely.LineString(path.corners))


@given(boxes=obstacles, seed=st.integers(0, 999), reach=st.floats(0.01, 3))
@settings(max_examples=60, deadline=None)
def test_steps_stop_short_of_obstacles_and_never_slide(boxes: list[shapely.Polygon], seed: int, reach: float) -> None:
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    rng = np.random.default_rng(seed)
    grown = shapely.buffer(finder.free, 1e-7)
    for angle in rng.uniform(-np.pi, np.pi, 6):
        start, along = finder.random_point(rng), np.array([math.cos(angle), math.sin(angle)])
        end = finder.try_step(start, reach * along)
        moved = float((end - start) @ along)
        assert np.allclose(end, start + moved * along, atol=1e-9)
        assert -1e-12 <= moved <= reach + 1e-12
        assert finder.is_navigable(end)[0]
        assert grown.covers(shapely.LineString([start, end]))
        if moved < reach - 1e-9:
            # It stopped because the very next centimetre is blocked.
            ahead = shapely.LineString([start, start + min(moved + 0.01, reach) * along])
            assert not shapely.buffer(finder.free, -1e-9).covers(ahead)


@pytest.mark.whole
@given(boxes=obstacles, seed=st.integers(0, 999), yaw=st.sampled_from([0.0, math.pi / 4]) | st.floats(-math.pi, math.pi))
@settings(max_examples=60, deadline=None)
def test_random_walks_never_leave_the_floor(boxes: list[shapely.Polygon], seed: int, yaw: float) -> None:
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    file = read_navmesh(dump_navmesh(finder.navmesh(Settings())))
    polygons = [tile.vertices[p["vertices"][: p["count"]]][:, [0, 2]] * (1.0, -1.0) for tile in file.tiles for p in tile.polygons]
    floors = shapely.buffer([room_less(boxes), shapely.union_all(shapely.polygons([shapely.linearrings(p) for p in polygons]))], 1e-6)
    shapely.prepare(floors)
    rng = np.random.default_rng(seed)
    for walked, floor in zip((finder, PlanarPathFinder.from_navmesh(file)), floors, strict=True):
        corners = walked.boundary.starts
        # At a corner and on an edge too: there every tolerance counts.
        on_edge = walked.snap(corners[:1] + rng.random() * (walked.boundary.ends[:1] - corners[:1]))[0]
        for start in (walked.random_point(rng), corners[rng.integers(len(corners))], on_edge):
            actions = rng.choice([FORWARD, FORWARD, LEFT, RIGHT], 100).tolist()
            done = replay(actions, start, yaw, walked, Motion())
            assert walked.is_navigable(done.poses[:, :2]).all()
            assert floor.covers(shapely.points(done.poses[:, :2])).all()
            moves = np.stack([done.poses[:-1, :2], done.poses[1:, :2]], axis=1)
            assert floor.covers(shapely.linestrings(moves)).all()


@pytest.mark.whole
@given(boxes=obstacles, seed=st.integers(0, 999), near=st.sampled_from([0.0, 1e-12, 5e-10, 1e-8, 5e-8, 1e-6, 1e-3]))
@settings(max_examples=100, deadline=None)
def test_moves_between_points_on_or_near_walls_are_those_of_the_closed_polygon(
    boxes: list[shapely.Polygon], seed: int, near: float
) -> None:  # fmt: skip
    finder = PlanarPathFinder(room_less(boxes))
    if not finder.islands:
        return
    rng = np.random.default_rng(seed)
    edges = rng.integers(0, len(finder.boundary.starts), 80)
    starts, ends = finder.boundary.starts[edges], finder.boundary.ends[edges]
    along = starts + rng.choice([0.0, 1e-8, 1e-3, 0.5, 1.0], 80)[:, None] * (ends - starts)
    points = along + near * rng.choice([-1, 0, 1], (80, 2))
    points = points[finder.is_navigable(points)]
    grown = shapely.buffer(finder.free, 1e-8)
    shapely.prepare(grown)
    island = finder.island_of(points)
    for a, b in zip(*rng.integers(0, len(points), (2, 200)), strict=True) if len(points) else ():
        if island[a] != island[b]:
            continue
        line, is_clear = shapely.LineString([points[a], points[b]]), finder.is_clear(points[a], points[b])
        assert is_clear == finder.is_clear(points[b], points[a])
        # Lines along slanted edges cross them by rounding: neither is then wrong within a hair.
        assert is_clear or not finder.free.covers(line)
        assert not is_clear or grown.covers(line)


def test_a_step_that_was_stopped_at_a_wall_leads_no_next_one_through_it() -> None:
    finder = PlanarPathFinder(room_less([]))
    for angle in (1e-6, 1e-4, 0.01, 0.05, 0.1, 1.0):
        # So far off that the wall x = 5 stops the step just before its end.
        stopped = finder.try_step((5 - 0.2 * math.sin(angle), 2.0), 0.25 * np.array([math.sin(angle), math.cos(angle)]))
        assert 4.9 < stopped[0] <= 5 + 1e-9
        for turned in np.linspace(-math.pi, math.pi, 25):
            moved = finder.try_step(stopped, 0.25 * np.array([math.cos(turned), math.sin(turned)]))
            assert moved[0] <= 5 + 1e-9
            if math.cos(turned) < -1e-6:
                assert np.allclose(moved, stopped + 0.25 * np.array([math.cos(turned), math.sin(turned)]))


def test_a_sight_along_an_edge_that_bends_by_a_hair_ends_at_what_stands_on_it() -> None:
    # Single precision moves corners on one line by some 5e-8 m; a spike rises between the two that are moved.
    up = 2 + 5e-8
    spike = shapely.Polygon([(1, 1), (4, 1), (4, 2), (3, up), (2.5, 3), (2, up), (1, 2)])
    finder = PlanarPathFinder(room_less([spike]))
    assert not finder.is_clear((1, 2), (4, 2))
    assert not finder.is_clear((4, 2), (1, 2))
    assert finder.geodesic((1, 2), (4, 2)).length == pytest.approx(2 * (1.5**2 + 1) ** 0.5, abs=1e-6)
    # Without the spike the way leads over both corners.
    low = PlanarPathFinder(room_less([shapely.Polygon([(1, 1), (4, 1), (4, 2), (3, up), (2, up), (1, 2)])]))
    assert low.geodesic((1, 2), (4, 2)).length == pytest.approx(3, abs=1e-12)


def test_paths_bend_around_corners_they_touch_and_pass_gaps_of_no_width() -> None:
    # Two squares in a line: the way along their common edge line is straight and touches four corners.
    finder = PlanarPathFinder(room_less([shapely.box(1, 1, 2, 2), shapely.box(3, 1, 4, 2)]))
    assert finder.geodesic((0.5, 2), (4.5, 2)).length == pytest.approx(4.0, abs=1e-12)
    assert finder.geodesic((1.5, 2), (1.5, 1)).length == pytest.approx(2.0, abs=1e-12)
    assert finder.geodesic((1.5, 2), (2, 1.5)).length == pytest.approx(1.0, abs=1e-12)
    assert finder.geodesic((1, 2), (2, 1)).length == pytest.approx(2.0, abs=1e-12)
    assert not finder.is_clear((1.2, 2), (1.8, 1))
    assert finder.geodesic((1.5, 1.5), (0.5, 0.5)).length == np.inf
    assert np.array_equal(finder.snap([(1.5, 1.9), (0.5, 0.5), (-1, 2)]), [(1.5, 2), (0.5, 0.5), (0, 2)])


def test_polygons_that_are_linked_at_a_point_are_one_island() -> None:
    # Bakes hold such links: two corners of an edge at one place.
    at = np.array([(0, 0), (1, 0), (1, 1), (1, 1), (0, 1), (2, 1), (2, 2), (1, 2)], dtype=float)
    linked = ConvexCover(at, ((0, 1, 2, 3, 4), (3, 2, 5, 6, 7)), ((-1, -1, 1, -1, -1), (0, -1, -1, -1, -1)))
    finder = PlanarPathFinder.from_navmesh(read_navmesh(dump_navmesh(navmesh_from_polygons(linked, Settings()))))
    assert finder.islands == pytest.approx([2.0], abs=1e-3)
    assert finder.geodesic((0.2, 0.8), (1.2, 1.8)).length == pytest.approx(2 * math.hypot(0.8, 0.2), abs=1e-3)
    apart = ConvexCover(at, linked.polygons, ((-1,) * 5, (-1,) * 5))
    finder = PlanarPathFinder.from_navmesh(read_navmesh(dump_navmesh(navmesh_from_polygons(apart, Settings()))))
    assert finder.islands == pytest.approx([1.0, 1.0])
    assert not finder.geodesic((0.2, 0.8), (1.2, 1.8)).exists


def test_navmeshes_that_no_agent_can_walk_on_are_refused_and_connections_are_no_floor() -> None:
    file = PlanarPathFinder(room_less([])).navmesh(Settings())
    (tile,) = file.tiles
    extra = np.repeat(tile.polygons[:1], 2)
    extra["count"], extra["neighbors"] = 2, 0
    for kind in (0, 1):
        extra["area_and_type"] = kind << 6
        changed = dataclasses.replace(tile, polygons=np.concatenate([tile.polygons, extra]))
        data = dump_navmesh(dataclasses.replace(file, tiles=(changed,)))
        if kind == 0:
            with pytest.raises(InputError, match="a polygon has 2 corners"):
                read_navmesh(data)
        else:
            assert PlanarPathFinder.from_navmesh(read_navmesh(data)).islands == pytest.approx([20.0])
    with pytest.raises(InputError, match=r"^mine\.navmesh: tiles: are 2"):
        PlanarPathFinder.from_navmesh(dataclasses.replace(file, tiles=(tile, tile)), file="mine.navmesh")
    for height in (0.0, -0.2, math.nan, math.inf):
        with pytest.raises(InputError, match=r"^mine\.navmesh: heights"):
            PlanarPathFinder.from_navmesh(dataclasses.replace(file, settings=Settings(cell_height=height)), True, "mine.navmesh")


def test_islands_are_numbered_by_area_and_not_connected() -> None:
    finder = PlanarPathFinder(room_less([shapely.box(1.5, -1, 2, 5)]))
    assert finder.islands == pytest.approx((12.0, 6.0))
    assert list(finder.island_of([(3, 1), (1, 1), (1.7, 1), (9, 9)])) == [0, 1, -1, -1]
    assert finder.geodesic((3, 1), (1, 1)).exists is False


def test_random_points_are_uniform_over_the_free_area() -> None:
    finder = PlanarPathFinder(room_less([box(2.5, 2, 2, 1.5, 20), shapely.box(4, -1, 4.2, 5)]))
    rng = np.random.default_rng(5)
    points = np.array([finder.random_point(rng) for _ in range(6000)])
    assert finder.is_navigable(points).all()
    cells = [shapely.box(x, y, x + 1, y + 1) for x in range(5) for y in range(4)]
    expected = np.array([cell.intersection(finder.free).area for cell in cells]) / finder.free.area * len(points)
    counted = np.array([shapely.contains_xy(cell, *points.T).sum() for cell in cells])
    assert ((counted - expected) ** 2 / np.maximum(expected, 1)).sum() < 45  # chi-square, 19 degrees of freedom: 1 in 1,400
    small = np.array([finder.random_point(rng, island=1) for _ in range(50)])
    assert (finder.island_of(small) == 1).all()


# --- obstacles ----------------------------------------------------------------------------------------------------


def surface(*parts: trimesh.Trimesh) -> Surface:
    return surface_of(parts)


def solid(extents: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents)
    made.apply_translation((at[0], at[1], at[2] + extents[2] / 2))
    return made


def table(height: float) -> Surface:
    legs = [solid((0.05, 0.05, height - 0.05), (x, y, 0)) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
    return surface(solid((1.2, 0.8, 0.05), (0, 0, height - 0.05)), *legs)


def test_only_what_the_agent_would_hit_blocks_the_floor() -> None:
    low, high = 0.2, 0.88
    assert footprint(surface(solid((2, 1, 0.02))), low, high).is_empty  # a rug is driven over
    assert footprint(surface(solid((0.3, 0.3, 0.3), (0, 0, 2.0))), low, high).is_empty  # a lamp hangs above
    assert footprint(table(0.75), low, high).area == pytest.approx(1.2 * 0.8, rel=0.01)  # too low to pass under
    assert footprint(table(1.2), low, high).area == pytest.approx(4 * 0.05**2, rel=0.3)  # only its legs
    assert footprint(surface(solid((1, 0.5, 2))), low, high).area == pytest.approx(0.5, rel=0.02)  # a wardrobe is no ring


def test_an_open_shell_of_upright_faces_is_closed_off() -> None:
    shell = solid((1, 0.6, 2))
    upright = np.abs(shell.face_normals[:, 2]) < 0.5
    shell.update_faces(upright)
    blocked = footprint(surface(shell), 0.2, 0.88)
    assert blocked.covers(shapely.box(-0.5, -0.3, 0.5, 0.3))
    assert blocked.area == pytest.approx(0.6, rel=0.02)


@given(
    yaw=st.floats(-3.2, 3.2), x=st.floats(-5, 5), y=st.floats(-5, 5), inset=st.sampled_from([0.0, 0.0, 0.03]),
    cuts=st.tuples(st.floats(0.05, 0.4), st.floats(0.5, 1.5)),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_solids_that_share_corners_are_filled_at_any_turn(yaw: float, x: float, y: float, inset: float, cuts: tuple[float, float]) -> None:
    """Base, body and top of a cabinet: welded where they touch, with nothing but upright faces at the agent's height."""
    base, body = cuts
    parts = [solid((0.4 - inset, 0.9 - inset, base)), solid((0.4, 0.9, body), (0, 0, base)), solid((0.4, 0.9, 0.1), (0, 0, base + body))]
    turned = surface(*parts).transformed(yaw_pose(yaw, (x, y, 0)))
    outline = shapely.affinity.translate(shapely.affinity.rotate(box(0, 0, 0.4, 0.9), yaw, origin=(0, 0), use_radians=True), x, y)
    found = footprint(turned, 0.2, 0.88)
    assert found.covers(outline)
    assert found.difference(outline.buffer(2 * SEAM_M)).is_empty


@pytest.mark.parametrize("name", ["torus", "dented", "dense", "two balls", "slanted"])
def test_footprint_is_the_union_of_all_cross_sections(name: str) -> None:
    if name == "torus":
        mesh = trimesh.creation.torus(0.5, 0.2, major_sections=24, minor_sections=12)
    elif name in ("dented", "dense"):
        mesh = trimesh.creation.icosphere(subdivisions=6 if name == "dense" else 3)
        mesh.vertices *= 0.35 + 0.15 * np.sin(4 * mesh.vertices[:, :1])
    elif name == "two balls":
        balls = [trimesh.creation.icosphere(radius=r).apply_translation((x, 0, 0)) for r, x in ((0.4, 0), (0.3, 0.9))]
        mesh = trimesh.util.concatenate(balls)
    else:
        mesh = solid((0.2, 0.3, 1.5))
        mesh.apply_transform(trimesh.transformations.rotation_matrix(0.8, (0.3, 1, 0)))
    mesh.apply_translation((0, 0, 0.45 - mesh.bounds[0, 2] - np.ptp(mesh.bounds[:, 2]) / 2))
    found, slices = footprint(surface(mesh), 0.25, 0.6), []
    for z in np.linspace(0.2501, 0.5999, 25):
        section = mesh.section((0, 0, 1), (0, 0, z))
        if section is not None:
            flat_section, _ = section.to_2D(to_2D=trimesh.transformations.translation_matrix((0, 0, -z)))
            slices.extend(flat_section.polygons_closed)
    filled = shapely.union_all([shapely.Polygon(p.exterior) for p in shapely.get_parts(shapely.union_all(slices))])
    assert found.covers(shapely.buffer(filled, -1e-6))
    # Between two sections 15 mm apart a slope may reach out a little farther than either.
    excess = 0.015 if name == "slanted" else 0.004
    assert found.difference(shapely.buffer(filled, 3 * SEAM_M + (2 * GRID_M if name == "dense" else 0) + excess)).area < 1e-6


@given(boxes=st.lists(loose_boxes, max_size=7), radius=st.floats(0.05, 0.4))
@settings(max_examples=60, deadline=None)
def test_free_floor_keeps_the_radius_and_little_more(boxes: list[shapely.Polygon], radius: float) -> None:
    floor = np.array([(0, 0), (5, 0), (5, 2.5), (3.5, 2.5), (3.5, 4), (0, 4)], dtype=float)
    room, blocked = shapely.Polygon(floor), shapely.union_all(boxes)
    free = free_space(floor, boxes, radius)
    assert room.covers(free)
    if not free.is_empty:
        edge = shapely.points(shapely.get_coordinates(shapely.segmentize(free, 0.02)))
        assert shapely.distance(room.exterior, edge).min() >= radius - 1e-9
        assert blocked.is_empty or shapely.distance(blocked, edge).min() >= radius - 1e-9
    generous = radius * 1.011 + 2 * OUTLINE_M + 1e-6
    surely = room.buffer(-generous, quad_segs=64).difference(blocked.buffer(generous, quad_segs=64))
    assert surely.difference(free).area < 1e-6


# --- actions ------------------------------------------------------------------------------------------------------


def test_replay_turns_left_counter_clockwise_and_returns_after_twelve_turns() -> None:
    finder, motion = PlanarPathFinder(room_less([])), Motion()
    around = replay([LEFT] * 12 + [FORWARD, STOP], (2, 2), 0.3, finder, motion)
    assert around.poses[1, 2] == pytest.approx(0.3 + math.pi / 6)
    assert around.poses[-1] == pytest.approx((2 + 0.25 * math.cos(0.3), 2 + 0.25 * math.sin(0.3), 0.3))
    assert around.length == pytest.approx(0.25)
    square = replay(([FORWARD] * 2 + [RIGHT] * 3) * 4, (2, 2), 0.1, finder, motion)
    assert square.poses[-1] == pytest.approx((2, 2, 0.1), abs=1e-12)
    blocked = replay([FORWARD] * 30, (2, 2), 0.0, finder, motion)
    assert blocked.collisions == 18
    assert blocked.poses[-1, 0] == pytest.approx(5.0, abs=1e-5)
    with pytest.raises(ValueError, match="'jump' at 1"):
        replay([FORWARD, "jump"], (2, 2), 0, finder, motion)
    with pytest.raises(ValueError, match="follows a stop"):
        replay([STOP, FORWARD], (2, 2), 0, finder, motion)


def test_actions_squeeze_through_a_gap_that_greedy_steps_run_into() -> None:
    # A slot 6 cm wide and half a metre long, off every straight line from the start.
    finder = PlanarPathFinder(room_less([shapely.box(2.0, -1, 2.5, 2.0), shapely.box(2.0, 2.06, 2.5, 5)]))
    field, motion = finder.field((4.5, 0.5)), Motion()
    for yaw in (0.0, math.pi / 12, math.pi / 2):
        actions = follow((0.4, 3.3), yaw, field, finder, motion, 0.1875, 500, 4000)
        if yaw == math.pi / 12:  # all twelve headings are 15 degrees or more off the slot: 13 cm to the side on its length
            assert actions is None
            continue
        assert actions is not None
        done = replay(actions, (0.4, 3.3), yaw, finder, motion)
        assert done.collisions == 0
        assert float(field.distances(done.poses[-1, :2])[0]) <= 0.1875
        assert done.length <= 1.5 * field.path((0.4, 3.3)).length


@pytest.mark.parametrize("seed", range(4))
def test_sights_by_a_grid_of_edges_are_those_of_looking_at_every_edge(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between corners, along edges, out of the room: a hall with a hundred obstacles, some of them in line with each other."""
    from tasks.navigation import visibility

    rng = np.random.default_rng(seed)
    places = [(1.2 * i + 0.3 + j * 0.01 * (seed % 2), 1.2 * j + 0.3) for i in range(10) for j in range(10)]
    objects = [
        shapely.box(x, y, x + 0.6, y + 0.5) if rng.random() < 0.7 else shapely.Point(x, y).buffer(0.3, quad_segs=3) for x, y in places
    ]
    hall = max(shapely.get_parts(shapely.box(0, 0, 12.5, 12.5).difference(shapely.union_all(objects))), key=lambda part: part.area)
    grid = visibility.boundary_of([hall])
    assert len(grid.starts) > visibility._FEW
    assert len(grid.corners[-2]) > 100, "there are many cells"
    monkeypatch.setattr(visibility, "_FEW", len(grid.starts))
    plain = visibility.boundary_of([hall])
    assert len(plain.corners[-2]) == 2, "there is one cell"
    points = np.concatenate([grid.starts, rng.uniform(-1, 13.5, (200, 2))])
    starts, ends = points[rng.integers(len(points), size=(2, 4000))]
    seen = visibility.clear(plain, starts, ends)
    assert 50 < seen.sum() < 3950
    assert np.array_equal(visibility.clear(grid, starts, ends), seen)
    for start, end in zip(starts[:300], ends[:300], strict=True):
        assert visibility.clear_lengths(grid, start[None], end[None]) == visibility.clear_lengths(plain, start[None], end[None])
        assert visibility.first_clear(grid, start, ends[:40]) == visibility.first_clear(plain, start, ends[:40])
