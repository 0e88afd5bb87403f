"""The path finders over Detour's navmeshes, against files and distances of the real simulator and against exact paths."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.run.configuration import configure
from schemas.errors import InputError
from schemas.navigation import Episode
from tasks.exports.habitat.navmesh_file import DEFAULTS
from tasks.exports.habitat.navmesh_file import read_polygons as independent_reader
from tasks.exports.habitat.rules import check_habitat
from tasks.geometry.meshes import Surface
from tasks.navigation import habitat, placed_surfaces, recast, run
from tasks.navigation.configuration import NavigationConfig, PathFinderConfig
from tasks.navigation.habitat import HabitatConfig
from tasks.navigation.navmesh import Settings, dump_navmesh, polygon_areas, read_navmesh
from tasks.navigation.planar import PlanarConfig, PlanarPathFinder
from tasks.navigation.recast import RecastConfig
from tasks.navigation.regions import CLOSED, walkable_region
from tasks.navigation.triangles import scene_triangles
from tasks.stage import Context
from tests.conftest import REPOSITORY
from tests.replicas import furnished as replica
from tests.replicas import rows_of
from tests.tasks.exports.habitat.habitat_datasets import write_dataset
from tests.tasks.navigation import habitat_stand_in
from tests.tasks.navigation.test_navigation import furnished, living_room, native
from tests.tasks.navigation.test_shortest_paths import solid, surface, table

GOLDEN = REPOSITORY / "tests" / "golden" / "navmesh"
INDEX = json.loads((GOLDEN / "index.json").read_text())
NAMES = [entry["navmesh"] for entry in INDEX]
BUILT = recast.LIBRARY.is_file()


def golden(name: str) -> tuple[bytes, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A golden file, the triangles it was baked from, and the simulator's distances."""
    entry = next(entry for entry in INDEX if entry["navmesh"] == name)
    room = np.load(GOLDEN / entry["room"])
    return (GOLDEN / name).read_bytes(), room["vertices"], room["faces"], dict(np.load(GOLDEN / entry["paths"]))


def polygons_of(data: bytes) -> shapely.Geometry:
    """Union of a file's walkable polygons on the floor in the world frame, by a reader that shares nothing with the path finders."""
    rings = [ring[:, [0, 2]] * (1.0, -1.0) for ring in independent_reader(data).polygons if ring[:, 1].min() < 0.3]
    return shapely.union_all([shapely.Polygon(ring) for ring in rings], grid_size=1e-6)


def baked_room(objects: list[Surface], size: tuple[float, float] = (5.0, 4.0), config: NavigationConfig | None = None) -> bytes:
    tables, _ = furnished({}, size)
    settings = (config or NavigationConfig()).settings
    return recast.bake(*scene_triangles(tables["shells"][0], objects, settings), settings)


# --- as the simulator ---------------------------------------------------------------------------------------------


@native
@pytest.mark.parametrize("name", NAMES)
def test_baked_bytes_and_distances_are_those_of_the_simulator(name: str) -> None:
    data, vertices, faces, paths = golden(name)
    settings = read_navmesh(data).settings
    assert settings is not None
    assert recast.bake(vertices, faces, settings) == data
    mesh = recast.RecastMesh.load(data)
    assert mesh.save() == data
    found = np.array([mesh.path(a, b)[0] for a, b in zip(paths["start"], paths["goal"], strict=True)])
    assert len(found) == 200
    assert np.array_equal(found, paths["geodesic_m"])


@native
@pytest.mark.parametrize("name", NAMES)
def test_islands_are_those_of_the_file_and_of_the_simulator(name: str) -> None:
    data, *_ = golden(name)
    file = read_navmesh(data)
    region, labels = walkable_region(file), recast.RecastMesh.load(data).islands[walkable_region(file).numbers]
    entry = next(entry for entry in INDEX if entry["navmesh"] == name)
    assert len(region.areas) == entry["islands"] == len(set(labels))
    assert len(set(zip(region.islands, labels, strict=True))) == entry["islands"]
    assert sum(region.areas) == pytest.approx(entry["area_m2"], rel=1e-6)
    assert list(region.areas) == sorted(region.areas, reverse=True)


# --- against exact paths ------------------------------------------------------------------------------------------


def compare_with_exact(data: bytes, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Detour's lengths over exact ones on the same polygons, each checked; shape (number of paths,)."""
    finder, exact = recast.RecastPathFinder(data), PlanarPathFinder.from_navmesh(read_navmesh(data), floor_only=True)
    assert exact.islands == pytest.approx(finder.islands, abs=1e-3)
    ratios = []
    for start, goal in zip(starts, goals, strict=True):
        theirs, ours = finder.geodesic(start, goal), exact.geodesic(*exact.snap([start, goal]))
        assert theirs.exists == ours.exists
        if not ours.exists:
            continue
        straight = math.dist(start, goal)
        assert straight - 1e-9 <= theirs.length
        assert straight - 1e-3 <= ours.length <= theirs.length + 1e-3
        ratios.append(theirs.length / max(ours.length, 1e-3))
    return np.array(ratios)


@native
@pytest.mark.parametrize("name", NAMES)
def test_exact_paths_on_golden_polygons_are_never_longer(name: str) -> None:
    data, _, _, paths = golden(name)
    finder = recast.RecastPathFinder(data)
    ends = [finder.snap(paths[end][:, [0, 2]] * (1.0, -1.0)) for end in ("start", "goal")]
    ratios = compare_with_exact(data, *ends)
    assert len(ratios) >= 50
    assert np.median(ratios) < 1.01


side = st.floats(0.15, 1.6)
boxes = st.lists(
    st.tuples(st.floats(0, 5), st.floats(0, 4), side, side, st.floats(0.1, 2.2), st.floats(0, math.pi)), min_size=1, max_size=8
)  # fmt: skip


def furniture(objects: list[tuple[float, ...]]) -> list[Surface]:
    placed = []
    for x, y, w, d, h, yaw in objects:
        c, s = math.cos(yaw), math.sin(yaw)
        placed.append(surface(solid((w, d, h))).transformed(np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])))
    return placed


@native
@given(objects=boxes, seed=st.integers(0, 999))
@settings(max_examples=25, deadline=None)
def test_exact_paths_on_baked_rooms_are_never_longer(objects: list[tuple[float, ...]], seed: int) -> None:
    data = baked_room(furniture(objects))
    finder, rng = recast.RecastPathFinder(data), np.random.default_rng(seed)
    if finder.islands:
        compare_with_exact(data, *np.array([[finder.random_point(rng) for _ in range(8)] for _ in range(2)]))


@native
@given(objects=boxes, seed=st.integers(0, 999))
@settings(max_examples=25, deadline=None)
def test_paths_and_moves_stay_on_the_polygons(objects: list[tuple[float, ...]], seed: int) -> None:
    data = baked_room(furniture(objects))
    finder, rng = recast.RecastPathFinder(data), np.random.default_rng(seed)
    if not finder.islands:
        return
    floor = polygons_of(data)
    grown, shrunk = shapely.buffer(floor, 1e-3), shapely.buffer(floor, -1e-3)
    start, *goals = (finder.random_point(rng) for _ in range(6))
    assert finder.is_navigable([start, *goals]).all()
    field, every = finder.field(goals), [finder.geodesic(start, goal) for goal in goals]
    nearest = field.path(start)
    assert nearest.length == min(path.length for path in every) == field.distances(start)[0]
    assert [finder.field(goal).distances(start)[0] for goal in goals] == [path.length for path in every]
    for path in [nearest, *every]:
        if path.exists:
            assert np.array_equal(path.corners[0], start)
            assert np.array_equal(path.corners[-1], goals[path.goal] if path is nearest else path.corners[-1])
            assert np.hypot(*np.diff(path.corners, axis=0).T).sum() == pytest.approx(path.length, abs=1e-9)
            assert grown.covers(shapely.LineString(path.corners))
    for angle, reach in zip(rng.uniform(-np.pi, np.pi, 20), rng.uniform(0.05, 2, 20), strict=True):
        start = finder.random_point(rng)
        way = reach * np.array([math.cos(angle), math.sin(angle)])
        line = shapely.LineString([start, start + way])
        clear = finder.is_clear(start, start + way)
        assert grown.covers(line) or not clear
        assert clear or not shrunk.covers(line)
        end = finder.try_step(start, way)
        moved = float((end - start) @ way) / reach
        assert np.allclose(end, start + moved / reach * way, atol=1e-9)
        assert finder.is_navigable(end)[0]
        assert grown.covers(shapely.LineString([start, end]))
        assert (moved == pytest.approx(reach)) == clear
        if not clear:
            assert not shrunk.covers(shapely.LineString([start, start + min(1.0, (moved + 0.01) / reach) * way]))


@native
def test_points_are_snapped_to_the_nearest_and_drawn_uniformly() -> None:
    data = baked_room([surface(solid((2, 1.5, 1), (2.5, 2, 0)))])
    finder, floor, rng = recast.RecastPathFinder(data), polygons_of(data), np.random.default_rng(5)
    far = rng.uniform(-6, 11, (200, 2))
    snapped = finder.snap(far)
    moved = np.hypot(*(snapped - far).T)
    assert np.allclose(moved, shapely.distance(floor, shapely.points(far)), atol=2e-3)
    assert finder.is_navigable(snapped).all()
    assert np.array_equal(finder.is_navigable(far), shapely.intersects_xy(floor, *far.T))
    points = np.array([finder.random_point(rng) for _ in range(6000)])
    assert finder.is_navigable(points).all()
    cells = [shapely.box(x, y, x + 1, y + 1) for x in range(5) for y in range(4)]
    expected = np.array([cell.intersection(floor).area for cell in cells]) / floor.area * len(points)
    counted = np.array([shapely.contains_xy(cell, *points.T).sum() for cell in cells])
    assert ((counted - expected) ** 2 / np.maximum(expected, 1)).sum() < 45  # chi-square, 19 degrees of freedom: 1 in 1,400


# --- what is baked ------------------------------------------------------------------------------------------------


@native
def test_only_what_the_agent_would_hit_blocks_the_floor() -> None:
    def is_free(obj: Surface, at: tuple[float, float] = (0.0, 0.0)) -> bool:
        placed = Surface(obj.vertices + np.array([2.5, 2.0, 0.0]), obj.faces, obj.colors)
        return bool(recast.RecastPathFinder(baked_room([placed])).is_navigable(np.add(at, (2.5, 2.0)))[0])

    assert is_free(surface(solid((2, 1.5, 0.02))))  # a rug is driven over
    assert is_free(surface(solid((1, 1, 0.19))))  # so is what is as low as the agent climbs
    assert not is_free(surface(solid((1, 1, 0.25))))
    assert is_free(surface(solid((0.3, 0.3, 0.3), (0, 0, 2.0))))  # a lamp hangs above
    assert not is_free(table(0.75))  # too low to pass under
    assert is_free(table(1.3))  # only its legs
    assert not is_free(table(1.3), (0.5, 0.3))
    assert not is_free(surface(solid((1, 0.5, 2))))


@native
def test_walls_between_rooms_part_the_floor_and_outer_walls_bound_it() -> None:
    tables, _ = furnished({})
    wall = (2.5, -0.1, 2.5, 4.1, 0.1, 2.6)
    room = dataclasses.replace(tables["shells"][0], interior_walls=(wall,))
    settings = NavigationConfig().settings
    data = recast.bake(*scene_triangles(room, [], settings), settings)
    finder = recast.RecastPathFinder(data)
    assert len(finder.islands) == 2
    assert not finder.geodesic((1, 1), (4, 1)).exists
    x0, y0, x1, y1 = polygons_of(data).bounds
    # The radius is rounded up to four cells, and a cell is free or not as a whole.
    assert all(0.18 <= gap <= 0.18 + 0.05 * 2 for gap in (x0, y0, 5 - x1, 4 - y1))


@native
def test_tops_of_furniture_stay_in_the_file_but_nobody_gets_there() -> None:
    data = baked_room([surface(solid((2, 2, 0.6), (2, 2, 0)))])
    everything, finder = walkable_region(read_navmesh(data)), recast.RecastPathFinder(data)
    assert len(everything.areas) == 2
    assert len(finder.islands) == 1
    assert not finder.is_navigable((2, 2))[0]
    assert dump_navmesh(finder.navmesh(NavigationConfig().settings)) == data
    (tile,) = finder.floor.tiles
    assert polygon_areas(tile)[tile.polygons["flags"] == CLOSED].sum() == pytest.approx(min(everything.areas))
    assert PlanarPathFinder.from_navmesh(read_navmesh(data)).island_of([(2, 2)])[0] == 1
    with pytest.raises(ValueError, match="was baked with"):
        finder.navmesh(Settings(agent_radius=0.3))


@native
def test_islands_that_touch_or_lie_above_each_other_stay_apart() -> None:
    high, low = table(1.3), baked_room([])
    data = baked_room([Surface(high.vertices * (2.4, 3.0, 1.0) + (2.5, 2.0, 0.0), high.faces, high.colors)])
    exact = PlanarPathFinder.from_navmesh(read_navmesh(data))
    assert len(exact.islands) == 2
    # The top's edge above does not stop anybody below it.
    assert exact.geodesic((0.5, 2.05), (4.5, 2.05)).length == pytest.approx(4.0, abs=1e-6)
    assert PlanarPathFinder.from_navmesh(read_navmesh(low)).geodesic((0.5, 2.05), (4.5, 2.05)).length == pytest.approx(4.0, abs=1e-6)


@native
def test_a_soup_without_floor_or_with_wrong_indices_is_told_apart() -> None:
    settings = NavigationConfig().settings
    assert recast.bake(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), settings) == b""
    upright = np.array([[0, 0, 0], [5, 0, 0], [0, 5, 0]], dtype=float)
    assert recast.bake(upright, [[0, 1, 2]], settings) == b""
    nothing = recast.RecastPathFinder(b"")
    assert nothing.islands == ()
    assert not nothing.is_navigable((0, 0))[0]
    assert not nothing.geodesic((0, 0), (1, 1)).exists
    with pytest.raises(ValueError, match="is empty"):
        nothing.snap((0, 0))
    with pytest.raises(InputError, match="name vertices that are not there"):
        recast.bake(upright, [[0, 1, 3]], settings)
    with pytest.raises(InputError, match="cell_size: 20000 x 20000 cells are too many"):
        recast.bake([[0, 0, 0], [1000, 0, 0], [0, 0, -1000]], [[0, 1, 2]], settings)
    with pytest.raises(InputError, match=r"broken\.navmesh: "):
        recast.RecastMesh.load((GOLDEN / NAMES[0]).read_bytes()[:-7], "broken.navmesh")


# --- the stage ----------------------------------------------------------------------------------------------------

KINDS = [pytest.param(PlanarConfig(), id="planar"), pytest.param(RecastConfig(), id="recast", marks=native),
         pytest.param(HabitatConfig(), id="habitat", marks=native)]  # fmt: skip


@pytest.fixture
def _habitat_sim(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "habitat_sim", habitat_stand_in)


def replayed(episode: Episode, floor: shapely.Geometry) -> np.ndarray:
    """Positions of an episode's actions, world frame, shape (n, 2), each step checked to lie on the floor."""
    position, heading, places = np.array(episode.start_position[:2]), episode.start_yaw_radians, []
    for action in episode.actions:
        ahead = position + 0.25 * np.array([math.cos(heading), math.sin(heading)]) * (action == "forward")
        assert floor.covers(shapely.LineString([position, ahead]) if action == "forward" else shapely.Point(position))
        places.append(position := ahead)
        heading += {"left": math.pi / 6, "right": -math.pi / 6}.get(action, 0.0)
    return np.array(places)


@pytest.mark.whole
@pytest.mark.usefixtures("_habitat_sim")
@pytest.mark.parametrize("kind", KINDS)
def test_replayed_episodes_end_at_a_view_point_and_never_leave_the_navmesh(kind: PathFinderConfig) -> None:
    tables, context = living_room()
    config = NavigationConfig(train_episodes=60, test_episodes=60, path_finder=kind)
    outcome = run(**tables, context=context, config=config)
    (navmesh,), episodes = outcome.rows["navmeshes"], outcome.rows["episodes"]
    name = type(kind).__name__.removesuffix("Config").lower()
    assert {navmesh.path_finder, *(e.path_finder for e in episodes)} == {name}
    assert len(episodes) == 60
    assert {e.instance_id for e in episodes} == {"0001", "0002", "0003", "0004", "0005", "0006"}
    floor = shapely.buffer(polygons_of(outcome.blobs[navmesh.navmesh_blob]), 1e-3)
    shapely.prepare(floor)
    placed = placed_surfaces(tables["placements"], tables["assets"], context.blobs)
    for e in episodes:
        places = replayed(e, floor)
        views = np.array(e.view_points)[:, :2]
        assert np.hypot(*(views - places[-1]).T).min() <= 0.2
        assert floor.covers(shapely.MultiPoint(views))
        assert places[-1] == pytest.approx(e.final_position[:2], abs=1e-9)
        assert e.geodesic_m >= e.euclidean_m - 1e-9
        assert len(e.actions) <= config.max_steps
        # The agent's disc keeps off what stands at its height, one diagonal of a cell allowed.
        body = placed[e.instance_id].vertices
        inside = body[(body[:, 2] > config.agent.max_climb_m + 0.01) & (body[:, 2] < config.agent.height_m), :2]
        if len(inside):
            hull = shapely.MultiPoint(inside).convex_hull
            assert shapely.distance(hull, shapely.points(places)).min() >= config.agent.radius_m - 0.05 * math.sqrt(2)


@pytest.mark.usefixtures("_habitat_sim")
@pytest.mark.parametrize("kind", KINDS)
def test_the_header_is_what_habitat_lab_asks_for_so_that_nobody_bakes_anew(kind: PathFinderConfig) -> None:
    tables, context = living_room()
    config = NavigationConfig(train_episodes=1, test_episodes=1, path_finder=kind)
    outcome = run(**tables, context=context, config=config)
    (row,) = outcome.rows["navmeshes"]
    header = independent_reader(outcome.blobs[row.navmesh_blob]).settings
    agent = config.agent
    asked = {"agentHeight": agent.height_m, "agentRadius": agent.radius_m, "agentMaxClimb": agent.max_climb_m, "includeStaticObjects": 1.0}
    assert header == pytest.approx(DEFAULTS | asked, abs=1e-6)


def crowd(seed: int) -> tuple[dict, Context]:
    """A room of 8 x 6 m with some twenty turned boxes of all heights in it."""
    rng = np.random.default_rng(seed)
    objects, taken = {}, []
    for _ in range(200):
        (w, d), h, yaw = rng.uniform(0.3, 1.2, 2), float(rng.choice([0.1, 0.45, 0.75, 1.6])), rng.uniform(-np.pi, np.pi)
        x, y = rng.uniform((0.7, 0.7), (7.3, 5.3))
        outline = shapely.affinity.rotate(shapely.box(x - w / 2, y - d / 2, x + w / 2, y + d / 2), yaw, use_radians=True)
        if all(outline.distance(other) > 0.1 for other in taken):
            taken.append(outline)
            objects[f"{len(objects):04d}"] = ("box", [solid((w, d, h))], (x, y, 0.0), yaw)
    return furnished(objects, size=(8.0, 6.0))


@pytest.mark.whole
@pytest.mark.parametrize("kind", KINDS[:2])
@pytest.mark.parametrize("seed", range(3))
def test_crowded_rooms_are_crossed_on_the_navmesh_too(kind: PathFinderConfig, seed: int) -> None:
    tables, context = crowd(seed)
    assert len(tables["instances"]) >= 15
    outcome = run(**tables, context=context, config=NavigationConfig(train_episodes=50, test_episodes=50, path_finder=kind))
    (navmesh,), episodes = outcome.rows["navmeshes"], outcome.rows["episodes"]
    floor = shapely.buffer(polygons_of(outcome.blobs[navmesh.navmesh_blob]), 1e-3)
    shapely.prepare(floor)
    assert len(episodes) == 50
    for e in episodes:
        assert np.hypot(*(np.array(e.view_points)[:, :2] - replayed(e, floor)[-1]).T).min() <= 0.2


@native
def test_a_habitat_dataset_of_its_episodes_passes_the_gate(tmp_path: Path) -> None:
    rows, blobs = rows_of(replica())
    needed = {name: rows[name] for name in ("scenes", "shells", "placements", "instances", "assets")}
    config = NavigationConfig(train_episodes=6, test_episodes=6, path_finder=RecastConfig())
    outcome = run(**needed, context=Context(rows["scenes"][0].scene_id, "navigation", 0, blobs), config=config)
    made = rows | {name: outcome.rows[name] for name in ("navmeshes", "episodes")}
    assert len(made["episodes"]) == 6
    assert check_habitat(write_dataset(tmp_path, [(made, {**blobs, **outcome.blobs})])) == []


@native
def test_the_same_scene_gives_the_same_rows_and_bytes_in_any_order() -> None:
    tables, context = living_room()
    config = NavigationConfig(train_episodes=10, test_episodes=10, path_finder=RecastConfig())
    first = run(**tables, context=context, config=config)
    again = run(**{name: rows[::-1] for name, rows in tables.items()}, context=context, config=config)
    assert again.rows == first.rows
    assert dict(again.blobs) == dict(first.blobs)


@native
def test_a_room_without_floor_for_the_agent_has_no_navmesh_but_reasons() -> None:
    tables, context = furnished({"0001": ("bed", [solid((2.0, 1.6, 0.5))], (1.0, 0.8, 0.0), 0.0)}, size=(2.1, 1.7))
    outcome = run(**tables, context=context, config=NavigationConfig(path_finder=RecastConfig()))
    assert outcome.rows["navmeshes"] == outcome.rows["episodes"] == []
    assert "no floor is free" in outcome.degradations[0]
    assert [u.instance_id for u in outcome.rows["unreachable_targets"]] == ["0001"]


# --- which path finder --------------------------------------------------------------------------------------------


def test_a_word_names_the_path_finder() -> None:
    def named(*words: str) -> object:
        return configure(settings=words).stages["navigation"].path_finder

    assert named() == PlanarConfig()
    assert named("navigation.path_finder=recast") == RecastConfig()
    assert named("navigation.path_finder=recast", "navigation.path_finder.cell_size_m=0.03") == RecastConfig(cell_size_m=0.03)
    assert named("navigation.path_finder=habitat") == HabitatConfig()
    with pytest.raises(InputError, match="it is one of planar, recast, habitat"):
        named("navigation.path_finder=astar")
    with pytest.raises(ValueError, match="cell_size_m: must be above 0"):
        RecastConfig(cell_size_m=0)


def test_a_path_finder_that_cannot_load_is_an_error_that_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tables, context = living_room()
    library = recast.LIBRARY
    monkeypatch.setattr(recast, "LIBRARY", tmp_path / "libmetascenes_recast.so")
    recast._library.cache_clear()
    try:
        with pytest.raises(InputError, match="is not built; install librecast-dev and g\\+\\+ and run make native"):
            run(**tables, context=context, config=NavigationConfig(path_finder=RecastConfig()))
        recast.LIBRARY.write_bytes(b"no library")
        with pytest.raises(InputError, match="does not load"):
            run(**tables, context=context, config=NavigationConfig(path_finder=RecastConfig()))
        if BUILT:
            recast.LIBRARY.write_bytes(library.read_bytes())
            monkeypatch.setattr(recast, "_VERSION", -1)
            with pytest.raises(InputError, match="of another version than this code; run make native again"):
                run(**tables, context=context, config=NavigationConfig(path_finder=RecastConfig()))
    finally:
        recast._library.cache_clear()
    monkeypatch.setitem(sys.modules, "habitat_sim", None)
    with pytest.raises(InputError, match=r"install habitat-sim, or set navigation\.path_finder to recast or planar"):
        run(**tables, context=context, config=NavigationConfig(path_finder=HabitatConfig()))


# --- habitat-sim's own --------------------------------------------------------------------------------------------


@native
@pytest.mark.usefixtures("_habitat_sim")
@pytest.mark.parametrize("name", NAMES)
def test_the_adapter_to_habitat_agrees_with_recast_to_the_last_bit(name: str) -> None:
    data, vertices, faces, _ = golden(name)
    settings = read_navmesh(data).settings
    assert settings is not None
    # The simulator welds nothing, but a GLB holds single precision.
    assert habitat.bake_stage(vertices.astype(np.float32), faces, settings) == data
    compare_with_recast(data)


def compare_with_recast(data: bytes) -> None:
    """habitat-sim's path finder against `recast` on one file."""
    theirs, ours, rng = habitat.HabitatPathFinder(data), recast.RecastPathFinder(data), np.random.default_rng(1)
    points = np.array([ours.random_point(rng) for _ in range(30)])
    assert np.array_equal([theirs.random_point(np.random.default_rng(7))], [ours.random_point(np.random.default_rng(7))])
    assert np.array_equal(theirs.island_of(points), ours.island_of(points))
    far = rng.uniform(-7, 7, (60, 2))
    assert np.array_equal(theirs.is_navigable(far), ours.is_navigable(far))
    assert np.array_equal(theirs.snap(far), ours.snap(far))
    goals = points[:10]
    one, other = theirs.field(goals), ours.field(goals)
    for point in points[10:]:
        a, b = one.path(point), other.path(point)
        assert (a.goal, a.exists) == (b.goal, b.exists)
        assert np.array_equal(a.corners, b.corners)
        assert a.exists is False or a.length == pytest.approx(b.length, abs=1e-12)
    for point, angle in zip(points, rng.uniform(-np.pi, np.pi, 30), strict=True):
        way = 0.25 * np.array([math.cos(angle), math.sin(angle)])
        assert theirs.is_clear(point, point + way) == ours.is_clear(point, point + way)
        assert np.allclose(theirs.try_step(point, way), ours.try_step(point, way), atol=2e-3)


@native
@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("habitat_sim") is None, reason="habitat-sim is not installed")
@pytest.mark.parametrize("name", NAMES)
def test_the_real_habitat_sim_agrees_with_recast(name: str) -> None:
    data, vertices, faces, _ = golden(name)
    settings = read_navmesh(data).settings
    assert settings is not None
    assert habitat.bake_stage(vertices, faces, settings) == data
    compare_with_recast(data)
