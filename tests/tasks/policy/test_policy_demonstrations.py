"""Walks along episodes, what an expert does anywhere, and corrections of a policy's own walks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from schemas.navigation import Episode, Navmesh, Split
from tasks.policy.actions import FORWARD, LEFT, RIGHT, START, STOP
from tasks.policy.collection import held_out, spread
from tasks.policy.corrections import CorrectionsConfig, agreement, corrected
from tasks.policy.demonstrations import Expert, Guide, WalkConfig, majority, seen_by_all, views_of
from tasks.policy.inference.actor import load
from tasks.simulation.cameras import camera_poses
from tasks.training.dataset import RowsInMemory
from tests.tasks.policy.policies import TINY, drawn_weights
from tests.tasks.policy.rooms import Compass, context, dataset, navigated, walks

CONFIG = WalkConfig()


def offset(yaw: float) -> np.ndarray:
    return CONFIG.forward_m * np.array([math.cos(yaw), math.sin(yaw)])


def test_walks_are_the_episodes_actions_from_their_starts_to_their_ends() -> None:
    data = walks()
    episodes = navigated()[0]["episodes"]
    assert [walk.name for walk in data.train[: len(episodes)]] == [episode.episode_id for episode in episodes]
    for walk, episode in zip(data.train, episodes * 3, strict=True):
        assert tuple(ACTIONS[action] for action in walk.targets) == episode.actions
        assert (walk.done == walk.targets).all()
        assert walk.last.tolist() == [START, *walk.targets[:-1]]
        assert np.allclose(walk.poses[0], [*episode.start_position[:2], episode.start_yaw_radians], atol=1e-5)
        assert np.allclose(walk.poses[-1, :2], episode.final_position[:2], atol=1e-5)  # the last action stops
        moved = np.hypot(*np.diff(walk.poses[:, :2], axis=0).T)
        assert np.allclose(moved, np.where(walk.targets[:-1] == FORWARD, 0.25, 0.0), atol=1e-9)
        turned = np.array([math.remainder(turn, 2 * math.pi) for turn in np.diff(walk.poses[:, 2])])
        due = {LEFT: math.pi / 6, RIGHT: -math.pi / 6}
        assert np.allclose(turned, [due.get(action, 0.0) for action in walk.targets[:-1]])
    assert majority(data.train) == np.bincount(np.concatenate([walk.targets for walk in data.train])).argmax()
    assert (data.license, dict(data.left_out)) == ("CC0-1.0, MIT", {})
    assert {*data.looks} == {f"demo/room_{number:02d}" for number in range(4)}
    assert {*data.courses} == {f"demo/room_{number:02d}" for number in range(3)}


def test_rooms_are_on_one_side_and_have_so_many_walks() -> None:
    data = walks(rooms=5, config=WalkConfig(train_episodes=3, test_episodes=2))
    assert (len(data.train), len(data.test)) == (12, 2)
    learning, held = held_out(data.train, 0.3)
    assert {walk.room_id for walk in learning}.isdisjoint({walk.room_id for walk in held})
    assert len({walk.room_id for walk in held}) == 1
    assert held_out(data.train, 0.0) == (data.train, [])
    replicas = [dataclasses.replace(walk, room_id=f"replicas/{walk.room_id.rpartition('/')[2]}") for walk in data.train]
    both, neither = held_out([*data.train, *replicas], 0.3)
    assert ([walk.poses is one.poses for walk, one in zip(both, [*learning, *learning], strict=True)], len(neither)) == (
        [True] * (2 * len(learning)),
        2 * len(held),
    ), "a room and the replica of its scan are on one side"
    assert held_out(data.train[:3], 0.5)[1] == []
    assert spread(data.train, 4) == data.train[::3]
    assert spread(data.train, 100) == data.train
    rows, blobs = dataset()
    from tasks.policy.collection import collected

    without = RowsInMemory("x", *(row for row in rows._rows if not isinstance(row, Split)))
    assert not collected(without, context(blobs), CONFIG, 0.0).test
    with pytest.raises(InputError, match="has none in a training room"):
        collected(without, context(blobs), CONFIG, 1.0)


def test_episodes_that_cannot_be_walked_are_left_out_and_counted() -> None:
    from tasks.policy.collection import collected

    rows, blobs = dataset(rooms=3)
    odd = [
        dataclasses.replace(row, actions=("forward",) * 40 + ("stop",)) if isinstance(row, Episode) and row.episode_id == "0001" else row
        for row in rows._rows
        if not (isinstance(row, Navmesh) and row.scene_id == "demo/room_01")
    ]
    data = collected(RowsInMemory("x", *odd), context(blobs), CONFIG, 0.2)
    assert dict(data.left_out) == {"their actions lead elsewhere on the navmesh": 2, "their navmesh is not in the lake": 6}
    assert {walk.scene_id for walk in data.train} == {"demo/room_00"}
    none = RowsInMemory("x", *(row for row in odd if not isinstance(row, Navmesh)))
    with pytest.raises(InputError, match=r"has none that can be used: .* left out: their navmesh"):
        collected(none, context(blobs), CONFIG, 0.2)


def guided(guide: Guide, finder, position, yaw: float, most: int = 200) -> int:
    """How many actions a guide takes from a pose to its stop."""
    for count in range(1, most):
        action = guide.right(position, yaw)
        assert action >= 0
        if action == STOP:
            return count
        if action == FORWARD:
            position = finder.try_step(position, offset(yaw))
        else:
            yaw += math.pi / 6 * (1 if action == LEFT else -1)
        guide.did(action)
    raise AssertionError("never stopped")


def test_on_the_path_the_expert_takes_what_is_left_of_the_episode_and_beside_it_finds_the_way_back() -> None:
    data, episodes = walks(rooms=2), navigated()[0]["episodes"]
    finder, rng = next(iter(data.courses.values())).finder, np.random.default_rng(0)
    for walk, episode in zip(data.train, episodes, strict=True):
        expert = Expert(finder, views_of(episode, finder), CONFIG)
        for step in range(len(walk)):
            position, yaw = walk.poses[step, :2], float(walk.poses[step, 2])
            assert guided(Guide(expert, walk.targets[step:]), finder, position, yaw) == len(walk) - step
            found = expert.actions(position, yaw)
            assert guided(Guide(expert), finder, position, yaw) == len(found)
            if step % 3 == 0:  # an agent that does something else is led from where that leads to
                guide = Guide(expert, walk.targets[step:])
                wrong = int(rng.choice([action for action in (FORWARD, LEFT, RIGHT) if action != guide.right(position, yaw)]))
                guide.did(wrong)
                if wrong == FORWARD:
                    position = finder.try_step(position, offset(yaw))
                else:
                    yaw += math.pi / 6 * (1 if wrong == LEFT else -1)
                assert guided(guide, finder, position, yaw) == len(expert.actions(position, yaw))


def test_an_expert_that_faces_its_target_turns_before_it_stops() -> None:
    plain, facing = walks(rooms=2), walks(rooms=2, config=WalkConfig(facing=True, facing_degrees=30.0))
    finder = next(iter(plain.courses.values())).finder
    turns = 0
    for before, after, episode in zip(plain.train, facing.train, navigated()[0]["episodes"], strict=True):
        assert after.targets[: len(before) - 1].tolist() == before.targets[:-1].tolist()
        assert after.targets[-1] == STOP
        turns += len(after) - len(before)
        views = views_of(episode, finder)
        expert = Expert(finder, views, WalkConfig(facing=True, facing_degrees=30.0))
        goal = expert.field.path(after.poses[-1, :2]).goal
        assert abs(math.remainder(views[goal, 2] - after.poses[-1, 2], 2 * math.pi)) <= math.radians(30) + 1e-9
        assert expert.actions(after.poses[-1, :2], float(after.poses[-1, 2])) == [STOP]
    assert turns > 0


def test_an_expert_that_stops_early_does_so_where_it_comes_near_and_turns_to_the_target() -> None:
    near, degrees = 0.8, 30.0
    config = WalkConfig(facing=True, facing_degrees=degrees, stop_m=near)
    plain, early = walks(rooms=2), walks(rooms=2, config=config)
    finder = next(iter(plain.courses.values())).finder
    shorter = 0
    for before, after, episode in zip(plain.train, early.train, navigated()[0]["episodes"], strict=True):
        views = views_of(episode, finder)
        expert = Expert(finder, views, config)
        distances = expert.field.distances(after.poses[:, :2])
        assert distances[-1] < near
        moved = np.flatnonzero(after.targets == FORWARD)
        if len(moved):
            assert (distances[: moved[-1] + 1] >= near).all(), "it stops where it first is near"
        ahead = seen_by_all(views) - after.poses[-1, :2]
        off = math.remainder(math.atan2(ahead[1], ahead[0]) - after.poses[-1, 2], 2 * math.pi)
        assert abs(off) <= math.radians(degrees) + 1e-9
        assert expert.actions(after.poses[-1, :2], float(after.poses[-1, 2])) == [STOP]
        common = min(len(before), int(moved[-1]) + 1 if len(moved) else 0)
        assert after.targets[:common].tolist() == before.targets[:common].tolist()
        shorter += len(after) < len(before)
    assert shorter > 0


@given(st.floats(-5, 5), st.floats(-5, 5), st.lists(st.floats(-3.1, 3.1), min_size=2, max_size=6), st.floats(0.3, 2.0))
def test_what_all_view_points_look_at_is_where_their_looks_cross(x: float, y: float, angles: list[float], away: float) -> None:
    yaws = np.array(angles)
    views = np.column_stack([x - away * np.cos(yaws), y - away * np.sin(yaws), yaws])
    spread = np.abs(np.sin(yaws[:, None] - yaws[None])).max()
    if spread > 0.35:
        assert np.allclose(seen_by_all(views), [x, y], atol=1e-6)
    else:
        assert np.isfinite(seen_by_all(views)).all()


def test_where_looks_do_not_cross_it_is_a_little_ahead() -> None:
    assert np.allclose(seen_by_all(np.array([[1.0, 2.0, math.pi / 2]])), [1.0, 2.5])
    assert np.allclose(seen_by_all(np.array([[1.0, 2.0, 0.0], [3.0, 2.0, math.pi]])), [1.5, 2.0])


def test_cameras_look_where_agents_head() -> None:
    poses = camera_poses([[1.0, 2.0, 0.0], [0.0, 0.0, math.pi / 2]], 0.88, 0.0)
    assert np.allclose(poses[0], [[0, 0, 1, 1], [-1, 0, 0, 2], [0, -1, 0, 0.88], [0, 0, 0, 1]])
    assert np.allclose(poses[1, :3, 2], [0, 1, 0])
    up = camera_poses([[0.0, 0.0, 0.7]], 1.0, 0.3)[0, :3, :3]
    assert np.allclose(up @ up.T, np.eye(3))
    assert np.linalg.det(up) == pytest.approx(1.0)
    assert up[2, 2] == pytest.approx(math.sin(0.3))


def test_a_policy_is_corrected_wherever_it_gets_and_twice_alike() -> None:
    data, actor = walks(rooms=3), load(drawn_weights(TINY), TINY)
    config = CorrectionsConfig(rounds=1, episodes=4, max_steps=12)
    made = corrected(actor, data.courses, Compass(), CONFIG, config, 1, 0)
    again = corrected(load(drawn_weights(TINY), TINY), data.courses, Compass(), CONFIG, config, 1, 0)
    assert len(made) == 8
    for walk, other in zip(made, again, strict=True):
        assert np.array_equal(walk.poses, other.poses)
        assert np.array_equal(walk.targets, other.targets)
        assert np.array_equal(walk.done, other.done)
        assert len(walk) <= 12
        assert STOP not in walk.done[:-1]
        assert (walk.targets >= 0).all()
        course = data.courses[walk.scene_id]
        assert course.finder.is_navigable(walk.poses[:, :2]).all()
        for before, action, after in zip(walk.poses, walk.done, walk.poses[1:], strict=False):
            if action == FORWARD:
                assert np.allclose(course.finder.try_step(before[:2], offset(before[2])), after[:2])
            else:
                assert math.remainder(after[2] - before[2], 2 * math.pi) == pytest.approx(math.pi / 6 * (1 if action == LEFT else -1))
    assert 0.0 < agreement(made) < 1.0
    other = corrected(actor, data.courses, Compass(), CONFIG, config, 2, 0)
    assert [walk.name for walk in other] != [walk.name for walk in made]
    # who is always guided walks as the episodes do
    led = corrected(actor, data.courses, Compass(), CONFIG, dataclasses.replace(config, expert_share=1.0, max_steps=100), 1, 0)
    shown = {walk.name: walk for walk in data.train if walk.scene_id == "demo/room_00"}
    assert agreement(led) == 1.0
    for walk in led:
        assert walk.done.tolist() == shown[walk.name.partition("-")[0]].done.tolist()
        assert np.allclose(walk.poses, shown[walk.name.partition("-")[0]].poses)
