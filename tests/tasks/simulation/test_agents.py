"""Agents in scenes: they move as `replay` does, one or many, and see from where they are."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.navigation import Episode
from tasks.evaluation.measures import path_finder
from tasks.geometry.transforms import look_at
from tasks.navigation.follower import FORWARD, LEFT, RIGHT, replay
from tasks.navigation.planar import PlanarPathFinder
from tasks.simulation.agents import Agents
from tasks.simulation.cameras import cameras_along
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.objectnav import Course, compass, gps, normalize_depth
from tasks.simulation.protocol import ACTIONS, NO_OBJECT
from tasks.simulation.rasterizer import Pictures
from tasks.simulation.simulator import WorldSimulator
from tasks.simulation.world import World, view_points
from tests.samples import sample
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_scene

CONFIG = SimulationConfig(width=8, height=6)
quick = settings(max_examples=40)


class StandInCamera:
    """Pictures whose pixels say where their camera is, and that show part 0 on the left and nothing on the right."""

    def render(self, poses: np.ndarray, width: int, height: int, hfov_radians: float, out: Pictures | None = None) -> Pictures:
        assert out is not None
        assert out.depth.shape == (len(poses), height, width)
        out.rgb[:] = (np.abs(poses[:, :3, 3] * 40) % 256).astype(np.uint8)[:, None, None]
        out.depth[:] = poses[:, 0, 3, None, None]
        out.part[:], out.part[:, :, width // 2 :] = 0, -1
        return out


def room(**different: object) -> tuple[World, Episode]:
    """A room of 4 by 3 m with a pillar, and an episode in it."""
    free = shapely.box(0, 0, 4, 3).difference(shapely.box(1.8, 1.0, 2.2, 2.0))
    values = {
        "scene_id": "demo/a", "episode_id": "0000", "instance_id": "0007", "start_position": (1.0, 1.5, 0.0), "start_yaw_radians": 0.0,
        "view_points": ((3.0, 1.5, 0.0, 0.0), (3.2, 1.4, 0.0, 0.0)),
    }  # fmt: skip
    episode = sample(Episode, **(values | different))
    return World("demo/a", PlanarPathFinder(free), StandInCamera(), ["0007"], [episode], 0.05), episode


@cache
def real(scene_id: str) -> World:
    made = acted_scene(scene_id)
    return World(scene_id, path_finder(made.navmesh, "a.navmesh"), StandInCamera(), ["0001"], made.episodes, CONFIG.reach_m)


def test_actions_have_habitats_numbers() -> None:
    assert ACTIONS == ("stop", "forward", "left", "right")


@quick
@given(
    st.sampled_from([LIVING, STUDY]), st.integers(0, 5), st.floats(-math.pi, math.pi),
    st.lists(st.sampled_from([FORWARD, FORWARD, LEFT, RIGHT]), max_size=60), st.booleans(),
)  # fmt: skip
def test_an_agent_moves_as_the_replay_does(scene_id: str, number: int, yaw: float, actions: list[str], stops: bool) -> None:
    world = real(scene_id)
    episode = dataclasses.replace(world.episodes[f"{number:04d}"], start_yaw_radians=yaw)
    done = replay([*actions, *["stop"] * stops], world.start(episode), yaw, world.finder, CONFIG.motion)
    simulator = WorldSimulator(lambda name: real(name), CONFIG)
    states = [simulator.reset(episode)]
    states += [simulator.step(ACTIONS.index(action)) for action in [*actions, *["stop"] * stops]]
    assert [(s.x, s.y, s.yaw) for s in states] == [tuple(pose) for pose in done.poses.tolist()]
    assert sum(s.collided for s in states) == done.collisions
    assert [s.called_stop for s in states] == [False] * (len(actions) + 1) + [True] * stops


@quick
@given(st.lists(st.lists(st.integers(1, 3), min_size=7, max_size=7), max_size=25), st.integers(0, 2**20))
def test_many_agents_move_as_each_alone(actions: list[list[int]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    agents, alone = Agents(7, CONFIG), [Agents(1, CONFIG) for _ in range(7)]
    for index in range(7):
        world = real((LIVING, STUDY)[int(rng.integers(2))])
        at, yaw = world.finder.random_point(rng, 0), float(rng.uniform(-3, 3))
        agents.place(index, world, at, yaw)
        alone[index].place(0, world, at, yaw)
    for row in actions:
        agents.step(np.array(row))
        for one, action in zip(alone, row, strict=True):
            one.step(np.array([action]))
        assert [agents.state(i) for i in range(7)] == [one.state(0) for one in alone]
    together, apart = agents.render(), [one.render() for one in alone]
    assert np.array_equal(together.rgb, np.concatenate([sight.rgb for sight in apart]))
    some = agents.render(np.array([1, 4, 5]))
    assert np.array_equal(some.depth, together.depth[[1, 4, 5]])


@pytest.mark.parametrize("scene_id", [LIVING, STUDY])
def test_distances_are_those_of_the_episodes(scene_id: str) -> None:
    simulator = WorldSimulator(real, CONFIG)
    for episode in acted_scene(scene_id).episodes:
        simulator.reset(episode)
        assert simulator.geodesic(view_points(episode)) == pytest.approx(episode.geodesic_m, abs=1e-3)
        assert simulator.snap(episode.goal_position[:2]) == pytest.approx(episode.goal_position[:2], abs=1e-3)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"start_position": (9.0, 9.0, 0.0)}, "episode 0000: starts off the navmesh; run the navigation stage again"),
        ({"view_points": ((9.0, 9.0, 0.0, 0.0),)}, "episode 0000: has no view point with a path from its start"),
    ],
)
def test_an_episode_that_cannot_be_begun_says_why(values: dict[str, object], problem: str) -> None:
    world, episode = room(**values)
    with pytest.raises(InputError, match=problem):
        world.start(episode)


def test_a_simulator_wants_an_episode_and_an_action_that_there_is() -> None:
    world, episode = room()
    simulator = WorldSimulator(lambda _: world, CONFIG)
    with pytest.raises(ValueError, match="reset: must come first"):
        simulator.step(1)
    simulator.reset(episode)
    for action in (-1, 4):
        with pytest.raises(ValueError, match=f"action: must be 0 to 3, is {action}"):
            simulator.step(action)


def test_a_simulator_shows_numbers_of_instances() -> None:
    world, episode = room()
    simulator = WorldSimulator(lambda _: world, CONFIG)
    simulator.reset(episode)
    sight = simulator.render()
    assert sight.semantic[:, :4].tolist() == [[7] * 4] * 6
    assert sight.semantic[:, 4:].tolist() == [[NO_OBJECT] * 4] * 6
    assert (sight.depth == 1.0).all()


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-math.pi, math.pi))
def test_a_camera_looks_level_along_the_heading(x: float, y: float, yaw: float) -> None:
    direction = np.array([math.cos(yaw), math.sin(yaw)])
    (pose,) = cameras_along(np.array([[x, y]]), direction[None], 0.88)
    assert pose == pytest.approx(look_at((x, y, 0.88), (*(np.array([x, y]) + direction), 0.88)), abs=1e-9)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-math.pi, math.pi), st.integers(-13, 13))
def test_compass_and_gps_are_the_agents_own(ahead: float, right: float, start_yaw: float, turns: int) -> None:
    direction = np.array([[math.cos(start_yaw), math.sin(start_yaw)]])
    start = np.array([[0.3, -0.2]])
    at = start + ahead * direction + right * direction[:, ::-1] * (1, -1)
    assert gps(at, start, direction)[0] == pytest.approx((ahead, right), abs=1e-6)
    yaw = math.remainder(start_yaw + turns * math.pi / 6, 2 * math.pi)
    (turned,) = compass(np.array([yaw]), np.array([start_yaw]))
    assert math.remainder(float(turned[0]) - turns * math.pi / 6, 2 * math.pi) == pytest.approx(0, abs=1e-6)
    assert -np.float32(np.pi) <= turned[0] <= np.float32(np.pi)


def test_depth_is_normalized_as_habitat_does() -> None:
    depth = np.array([0.0, 0.2, 0.5, 2.75, 5.0, 9.0], dtype=np.float32)
    normalize_depth(depth, CONFIG)
    assert depth.tolist() == [0.0, 0.0, 0.0, 0.5, 1.0, 1.0]


@quick
@given(st.lists(st.integers(1, 3), min_size=1, max_size=60), st.booleans(), st.integers(0, 5))
def test_rewards_sum_up_to_the_way_that_was_made(actions: list[int], stops: bool, number: int) -> None:
    simulator, course = WorldSimulator(real, CONFIG), Course(1, CONFIG)
    episode = acted_scene(LIVING).episodes[number]
    state, goals = simulator.reset(episode), view_points(episode)
    course.begin(0, simulator.geodesic(goals))
    total, travelled, collisions = 0.0, 0.0, 0
    for action in [*actions, *[0] * stops]:
        before, state = state, simulator.step(action)
        moved = math.hypot(state.x - before.x, state.y - before.y)
        reward, ended, cut = course.advance(
            np.array([moved]), np.array([simulator.geodesic(goals)]), np.array([state.collided]), np.array([state.called_stop]),
            np.array([False]), np.array([True]),
        )  # fmt: skip
        total, travelled, collisions = total + float(reward[0]), travelled + moved, collisions + state.collided
        assert (ended[0], cut[0]) == (action == 0, False)
    final, count = simulator.geodesic(goals), len(actions) + stops
    won = stops and final < CONFIG.success_m
    assert total == pytest.approx(course.start_m[0] - final - CONFIG.slack_reward * count + CONFIG.success_reward * won, abs=1e-9)
    measures = {name: values[0] for name, values in course.measures().items()}
    share = course.start_m[0] / max(course.start_m[0], travelled)
    assert measures == {
        "distance_to_goal": final, "success": won, "spl": won * share, "num_steps": count, "collisions": collisions,
        "soft_spl": pytest.approx(max(0.0, 1 - final / course.start_m[0]) * share),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("distance", "stops", "sees", "must_see", "won"),
    [(0.05, True, False, False, True), (0.1, True, True, False, False), (0.05, False, True, False, False),
     (0.05, True, False, True, False), (0.05, True, True, True, True)],
)  # fmt: skip
def test_a_success_is_an_own_stop_near_a_view_point(distance: float, stops: bool, sees: bool, must_see: bool, won: bool) -> None:
    course = Course(1, SimulationConfig(must_see=must_see, max_steps=1))
    course.begin(0, 2.0)
    reward, ended, cut = course.advance(*(np.array([value]) for value in (0.0, distance, False, stops, sees, True)))
    assert (course.succeeded[0], ended[0], cut[0]) == (won, stops, not stops)
    assert reward[0] == pytest.approx(2.0 - distance - 0.01 + 2.5 * won)


def test_who_does_not_act_stays_as_it_was() -> None:
    course = Course(2, CONFIG)
    course.begin(0, 1.0)
    course.begin(1, 2.0)
    both = np.array([True, True])
    reward, ended, cut = course.advance(np.array([0.5, 0.5]), np.array([0.5, 0.5]), both, both, both, np.array([True, False]))
    assert (reward[1], ended.tolist(), cut.tolist()) == (0.0, [True, False], [False, False])
    assert (course.distance_m[1], course.travelled_m[1], course.steps[1], course.collisions[1], course.succeeded[1]) == (
        2.0,
        0,
        0,
        0,
        False,
    )


def test_an_agent_that_starts_at_its_goal_and_stops_is_as_good_as_the_best() -> None:
    course = Course(1, CONFIG)
    course.begin(0, 0.0)
    course.advance(*(np.array([value]) for value in (0.0, 0.0, False, True, True, True)))
    assert {name: values[0] for name, values in course.measures().items() if "sp" in name} == {"spl": 1.0, "soft_spl": 1.0}


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"max_depth_m": 0.5}, "max_depth_m: must be above min_depth_m, 0.5, is 0.5"),
        ({"width": 0}, "width: must be at least 1, is 0"),
        ({"hfov_degrees": 180.0}, "hfov_degrees: must be below 180"),
    ],
)
def test_settings_that_cannot_be_are_refused(values: dict[str, float], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        SimulationConfig(**values)
