"""The check's own replay and geodesic distances, against the real simulator's, another library's, and shapes made by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.exports.habitat import ACTIONS, rotation
from tasks.exports.habitat.ground import Ground
from tasks.exports.habitat.navmesh_file import NavmeshPolygons, read_polygons
from tasks.exports.habitat.replay import AgentSteps, Trip, check_trips, heading_of, walk
from tasks.navigation.convex import convex_cover
from tasks.navigation.navmesh import NavmeshFile as Written
from tasks.navigation.navmesh import Settings, dump_navmesh, navmesh_from_polygons, polygon_islands
from tasks.navigation.navmesh import read_navmesh as read_written
from tests.conftest import REPOSITORY

GOLDEN = REPOSITORY / "tests" / "golden" / "navmesh"
ENTRIES = json.loads((GOLDEN / "index.json").read_text())
STEPS = AgentSteps(0.25, math.radians(30), 0.2)


def flat(points: np.ndarray) -> np.ndarray:
    return np.asarray(points, dtype=np.float64)[:, [0, 2]]


def made(floor: shapely.Geometry) -> Written:
    """A navmesh of a floor in plan (x, y of the world, so x, -z of Habitat)."""
    return navmesh_from_polygons(convex_cover(floor), Settings())


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["navmesh"])
def test_the_simulators_own_distances_are_reachable_and_never_shorter(entry: dict[str, Any]) -> None:
    navmesh = read_polygons((GOLDEN / entry["navmesh"]).read_bytes())
    assert len(set(navmesh.islands)) == entry["islands"]
    ground, paths = Ground(navmesh), np.load(GOLDEN / entry["paths"])
    starts, goals, stated = flat(paths["start"]), flat(paths["goal"]), paths["geodesic_m"]
    at, to = ground.island_of(paths["start"]), ground.island_of(paths["goal"])
    assert ((at == to) & (at >= 0)).tolist() == np.isfinite(stated).tolist(), "what it reaches is what hangs together"
    found = [ground.island(int(at[i])).geodesic(starts[i], goals[i : i + 1]) for i in np.flatnonzero(np.isfinite(stated))]
    shortest = np.array(found)[:, 0]
    assert (shortest == np.array(found)[:, 1]).all(), "known exactly"
    known = stated[np.isfinite(stated)]
    assert (shortest <= known + 1e-3).all(), "no path over its polygons is shorter than the shortest"
    assert (known <= 1.5 * shortest + 1e-3).all(), "and it misses the shortest by less than the check allows"
    assert (shortest >= np.hypot(*(starts - goals)[np.isfinite(stated)].T) - 1e-3).all()


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["navmesh"])
def test_connected_parts_are_those_of_the_other_reader(entry: dict[str, Any]) -> None:
    data = (GOLDEN / entry["navmesh"]).read_bytes()
    (tile,) = read_written(data).tiles
    walkable = (tile.polygons["flags"] & 1).astype(bool)
    other = polygon_islands(tile)[walkable]
    pairs = set(zip(read_polygons(data).islands.tolist(), other.tolist(), strict=True))
    assert len(pairs) == len(set(other.tolist())) == len({ours for ours, _ in pairs})


@given(st.floats(-7, 7), st.lists(st.sampled_from([1, 2, 3, 4, 5]), max_size=30))
def test_walking_is_turning_about_y_and_going_to_minus_z(yaw: float, actions: list[int]) -> None:
    quaternion = rotation(yaw)
    places, headings = walk(np.array([1.0, -2.0]), heading_of(quaternion), np.array(actions, dtype=np.int64), STEPS)
    place, turn = np.array([1.0, 0.0, -2.0]), Rotation.from_quat(quaternion)
    for index, action in enumerate([*actions, 0]):
        np.testing.assert_allclose(places[index], place[[0, 2]], atol=1e-7)
        ahead = turn.apply([0.0, 0.0, -1.0])
        np.testing.assert_allclose([-math.sin(headings[index]), -math.cos(headings[index])], ahead[[0, 2]], atol=1e-7)
        if action == ACTIONS["forward"]:
            place = place + 0.25 * ahead
        elif action in (ACTIONS["left"], ACTIONS["right"]):
            turn = turn * Rotation.from_rotvec([0.0, math.radians(30) * (1 if action == ACTIONS["left"] else -1), 0.0])


@pytest.mark.whole
@given(st.integers(0, 2**32 - 1))
def test_moves_stay_on_the_floor_when_every_point_of_them_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    holes = shapely.union_all([shapely.box(*low, *(low + rng.uniform(0.3, 1.0, 2))) for low in rng.uniform(-2, 1.5, (4, 2))])
    floor = shapely.difference(shapely.box(-2.5, -2.5, 2.5, 2.5), holes)
    ground = Ground(read_polygons(dump_navmesh(made(floor))))
    starts = rng.uniform(-2.5, 2.5, (60, 2))
    angles = rng.uniform(0, 2 * np.pi, 60)
    ends = starts + 0.25 * np.column_stack([np.cos(angles), np.sin(angles)])
    parts = ground.island_of(np.insert(starts, 1, 0.0, axis=1))
    dense = starts[:, None] + np.linspace(0, 1, 200)[None, :, None] * (ends - starts)[:, None]
    away = shapely.distance(floor, shapely.points(dense * [1, -1])).max(axis=1)
    for part in set(parts[parts >= 0].tolist()):
        chosen = np.flatnonzero(parts == part)
        stays = ground.island(part).contains_moves(starts[chosen], ends[chosen])
        assert not stays[away[chosen] > 2e-3].any()
        if floor.geom_type == "Polygon":
            assert stays[away[chosen] < 1e-6].all()


def trip(**changes: Any) -> Trip:
    """A metre straight on along -z, from the middle of a floor of four metres."""
    start = Trip(
        "episode", np.zeros(3), 0.0, np.array([[0.0, 0.0, -1.0]]), [[1, 1, 1, 1, 0]], {"geodesic_distance": 1.0, "path_finder": "planar"}
    )
    return dataclasses.replace(start, **changes)


def rules(one: Trip, navmesh: NavmeshPolygons, steps: AgentSteps | None = STEPS) -> list[str]:
    return [finding.rule for finding in check_trips([one], Ground(navmesh), steps)]


def test_a_straight_walk_and_what_can_be_wrong_with_it() -> None:
    square = read_polygons(dump_navmesh(made(shapely.box(-2, -2, 2, 2))))
    assert rules(trip(), square) == []
    assert rules(trip(paths=[["MOVE_FORWARD"] * 4 + ["stop"]]), square) == [], "names of actions do as well"
    assert rules(trip(paths=[[1, 4, 1, 5, 1, 1, 0]]), square) == [], "looking up and down moves nobody"
    assert rules(trip(heading=math.pi), square) == ["replay_end"]
    assert rules(trip(paths=[[1] * 12 + [0]]), square) == ["replay_end", "replay"], "out of the floor, and past the goal"
    assert rules(trip(info={"geodesic_distance": 1.02, "path_finder": "planar"}), square) == ["geodesic"]
    assert rules(trip(info={"geodesic_distance": 1.02, "path_finder": "recast"}), square) == [], "Detour's paths are no shortest ones"
    assert rules(trip(info={"geodesic_distance": 0.98, "path_finder": "recast"}), square) == ["geodesic"], "but never shorter"
    assert rules(trip(info={"geodesic_distance": 2.3, "path_finder": "recast"}), square) == ["geodesic"], "nor more than twice as long"
    turned = [{"position": None, "rotation": rotation(0.5 * math.pi + angle), "action": 1} for angle in (0.0, 0.0, 0.01, 0.0)]
    assert rules(trip(paths=[[*turned[:2], *turned[3:], 1, 0]]), square) == []
    assert rules(trip(paths=[[*turned, 0]]), square) == ["replay"], "a state half a degree off"
    assert rules(trip(paths=[[1, 1]]), square, None) == [], "without the agent's steps there is nothing to replay"
    wall = read_polygons(dump_navmesh(made(shapely.difference(shapely.box(-2, -2, 2, 2), shapely.box(-3, 0.4, 3, 0.5)))))
    assert rules(trip(), wall) == ["reachable"]
    bar = read_polygons(dump_navmesh(made(shapely.difference(shapely.box(-2, -2, 2, 2), shapely.box(-1, 0.4, 1, 0.5)))))
    around = math.hypot(1.0, 0.4) + 0.1 + math.hypot(1.0, 0.5)
    said = {"geodesic_distance": around, "path_finder": "planar"}
    assert rules(trip(info=said), bar) == ["replay"], "the way around is as long as it says, but the actions go through"


def test_floors_above_one_another_are_held_against_the_straight_line_only() -> None:
    """Two floors of one connected part: in plan nobody can tell how long the stairs are."""
    low = np.array([[-2.0, 0, -2], [-2, 0, 2], [2, 0, 2], [2, 0, -2]])
    both = NavmeshPolygons(2, None, [low, low + np.array([0, 3, 0])], np.zeros(2, dtype=np.int64))
    assert rules(trip(info={"geodesic_distance": 9.0}), both) == []
    assert rules(trip(info={"geodesic_distance": 0.9}), both) == ["geodesic"]


@pytest.mark.parametrize("order", [1, -1])
def test_an_agent_stands_on_the_floor_of_its_own_height(order: int) -> None:
    """As in bakes of whole houses: a roof, or another storey, above the floor, in either order in the file."""
    low = np.array([[-2.0, 0, -2], [-2, 0, 2], [2, 0, 2], [2, 0, -2]])
    small = low * [0.5, 1, 0.5]  # its border, beside which the agent may stand, lies below the middle of the roof
    house = NavmeshPolygons(2, None, [small, low + np.array([0, 2.6, 0])][::order], np.arange(2))
    below, above = (0, 1)[::order]
    for x in (0.0, 0.99, 1.03):
        for height, part in ((0.0, below), (2.6, above)):
            assert house.distance(np.array([x, height, 0.0]))[1] == 0.0
            assert Ground(house).island_of(np.array([[x, height, 0.0]])).tolist() == [part]
    assert house.distance(np.array([1.5, 0.0, 0.0])) == (0.0, 2.6)
    assert rules(trip(goals=np.array([[0.0, 0.0, -0.9]]), info={"geodesic_distance": 0.9}), house) == []
    assert rules(trip(goals=np.array([[0.0, 2.6, -0.9]]), info={"geodesic_distance": 0.9}), house) == ["reachable"]
    upstairs = trip(start=np.array([0.0, 2.6, 0.5]), goals=np.array([[0.0, 2.6, -0.5]]))
    assert rules(upstairs, house) == []
    step = NavmeshPolygons(2, None, [low, low + np.array([4.02, 0.2, 0])][::order], np.arange(2))
    assert Ground(step).island_of(np.array([[1.99, 0.2, 0.0], [2.03, 0.0, 0.0]])).tolist() == [below, above], "one floor, a step high"


def test_tiles_of_one_navmesh_hang_together_where_they_touch() -> None:
    left, right, far = (made(shapely.box(x, -1, x + 2, 1)) for x in (-2, 0, 5))
    tiles = tuple(part.tiles[0] for part in (left, right, far))
    data = dump_navmesh(dataclasses.replace(left, tiles=tiles, most_tiles=3))
    islands = read_polygons(data).islands
    assert islands[0] == islands[1] != islands[2]
