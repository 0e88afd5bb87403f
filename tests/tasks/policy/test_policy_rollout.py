"""Policies that act in the episodes of a scene: what they do alone they do among others, and what they see is what is there."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from schemas.evaluation import ACTIONS
from schemas.navigation import Episode
from tasks.evaluation import EvaluationConfig, TrajectoryBatch, run
from tasks.evaluation.measures import path_finder
from tasks.evaluation.sights import SceneSights
from tasks.geometry.rendering import Camera, RayScene
from tasks.navigation.follower import replay
from tasks.policy.actions import STOP
from tasks.policy.collection import VisibleScene
from tasks.policy.inference.actor import load
from tasks.policy.model.config import PolicyModel
from tasks.policy.rollout import rolled_out
from tasks.policy.sight import SceneRenderer
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.simulation.cameras import camera_poses
from tasks.simulation.world import World, world_of
from tasks.stage import Context
from tests.tasks.policy.policies import MODELS, TINY, drawn_weights
from tests.tasks.policy.rooms import navigated

CONFIG = EvaluationConfig(max_steps=25)


class Reciting:
    """Says what the expert of each episode does, by the order of the episodes; keeps the pictures that it was shown."""

    def __init__(self, episodes: list[Episode]) -> None:
        self.config: PolicyModel = TINY
        self.plans = [[ACTIONS.index(action) for action in episode.actions] for episode in episodes]
        self.pictures: list[list[np.ndarray]] = [[] for _ in episodes]
        self.goals: list[str] = []

    def reset(self, n: int, goals: list[str]) -> None:
        self.goals, self.step, self.going = goals, 0, list(range(n))
        assert n == len(self.plans)

    def keep(self, agents: np.ndarray) -> None:
        self.going = [self.going[place] for place in agents]

    def logits(self, pictures: np.ndarray) -> np.ndarray:
        assert len(pictures) == len(self.going)
        for agent, picture in zip(self.going, pictures, strict=True):
            self.pictures[agent].append(picture.copy())
        self.step += 1
        return np.eye(4, dtype=np.float32)[self.wanted()]

    def wanted(self) -> np.ndarray:
        return np.array([self.plans[agent][self.step - 1] for agent in self.going])

    def did(self, actions: np.ndarray) -> None:
        assert actions.tolist() == self.wanted().tolist(), "experts run against nothing"


@pytest.fixture(scope="module")
def room() -> tuple[dict[str, Any], dict[str, bytes]]:
    return navigated()


def world_in(room: tuple[dict[str, Any], dict[str, bytes]]) -> World:
    rows, blobs = room
    shell = rows["shells"][0]
    return world_of(
        shell.scene_id,
        shell,
        (),
        rows["placements"],
        rows["assets"],
        rows["instances"],
        rows["navmeshes"][0],
        rows["episodes"],
        blobs,
        0.05,
    )


def test_an_agent_does_what_it_says_until_it_stops_and_sees_where_it_is(room: Any) -> None:
    world, episodes = world_in(room), room[0]["episodes"]
    actor = Reciting(episodes)
    done = rolled_out(world, actor, episodes, EvaluationConfig())  # type: ignore[arg-type]
    assert [attempt.actions for attempt in done] == [episode.actions for episode in episodes]
    assert actor.goals == [episode.category for episode in episodes]
    camera = TINY.camera
    for index, episode in enumerate(episodes):
        poses = replay(episode.actions, world.start(episode), episode.start_yaw_radians, world.finder, CONFIG.motion).poses[:-1]
        seen = world.camera.render(camera_poses(poses, camera.height_m), camera.width, camera.height, camera.hfov_radians).rgb
        assert np.array(actor.pictures[index]).tobytes() == seen.tobytes(), "and nobody looks who has stopped"


@pytest.mark.parametrize("name", ["tiny", "sensing"])
def test_an_agent_that_acts_senses_to_the_byte_what_it_learned_from(room: Any, name: str) -> None:
    """Training draws scenes by their rows, acting by the world that agents walk in."""
    rows, blobs = room
    world, episodes = world_in(room), rows["episodes"]
    actor = Reciting(episodes)
    actor.config = MODELS[name]
    rolled_out(world, actor, episodes, EvaluationConfig())  # type: ignore[arg-type]
    (scene_id,) = {episode.scene_id for episode in episodes}
    look = VisibleScene(rows["shells"][0], (), tuple(rows["placements"]), tuple(rows["instances"]))
    renderer = SceneRenderer({scene_id: look}, {asset.asset_id: asset for asset in rows["assets"]}, blobs, MODELS[name])
    for index, episode in enumerate(episodes):
        poses = replay(episode.actions, world.start(episode), episode.start_yaw_radians, world.finder, CONFIG.motion).poses[:-1]
        assert np.array(actor.pictures[index]).tobytes() == renderer(scene_id, poses).tobytes()


def test_each_acts_as_if_it_were_alone_and_is_cut_in_the_end(room: Any) -> None:
    world, episodes, actor = world_in(room), room[0]["episodes"], load(drawn_weights(TINY), TINY)
    together = rolled_out(world, actor, episodes, CONFIG)
    alone = [rolled_out(world, actor, [episode], CONFIG)[0] for episode in reversed(episodes)][::-1]
    assert list(together) == alone
    assert all(len(attempt.actions) <= CONFIG.max_steps for attempt in together)
    assert all(attempt.actions[-1] == "stop" for attempt in together if len(attempt.actions) < CONFIG.max_steps)
    assert rolled_out(world, actor, [], CONFIG) == ()


class Stopping(Reciting):
    """Stops at once."""

    def wanted(self) -> np.ndarray:
        return np.full(len(self.going), STOP)


def test_a_target_is_seen_where_rays_meet_it(room: Any) -> None:
    rows, blobs = room
    parts: list[Any] = [mesh for _, mesh in room_shell(rows["shells"][0])]
    owners: list[str | None] = [None] * len(parts)
    by_id = {asset.asset_id: asset for asset in rows["assets"]}
    for placement in rows["placements"]:
        placed = placed_parts(placement, blobs[by_id[placement.asset_id].mesh_blob])
        parts += placed
        owners += [placement.instance_id] * len(placed)
    rays, names = RayScene(parts), np.array([*owners, None], dtype=object)
    sights = SceneSights(rows["shells"][0], tuple(rows["placements"]), tuple(rows["instances"]), tuple(rows["assets"]), blobs)
    episodes = [episode for episode in rows["episodes"] for _ in range(12)]
    ends = [
        (episode.instance_id, (*episode.start_position[:2], episode.start_yaw_radians + k * math.pi / 6))
        for k, episode in enumerate(episodes)
    ]
    seen = sights.seen(ends, CONFIG)
    poses = camera_poses([end for _, end in ends], CONFIG.camera_height_m)
    shares = []
    for pose, (target, _) in zip(poses, ends, strict=True):
        camera = Camera.with_fov(pose, CONFIG.camera_px, CONFIG.camera_px, CONFIG.camera_hfov)
        hits = rays.cast(camera.rays())
        shares.append((names[np.where(np.isfinite(hits["t_hit"]), hits["geometry_ids"].astype(np.int64), -1)] == target).mean())
    clear = [abs(share - CONFIG.seen_share) > 3e-4 for share in shares]  # not by the edge of a pixel
    assert [bool(s) for s, c in zip(seen, clear, strict=True) if c] == [
        bool(share >= CONFIG.seen_share) for share, c in zip(shares, clear, strict=True) if c
    ]
    assert 0.05 < np.mean([bool(one) for one in seen]) < 0.95
    assert sights.seen([("9999", (0.0, 0.0, 0.0))], CONFIG) == [None]


def test_rows_say_what_was_in_view_in_the_end_and_nothing_where_it_cannot_be_drawn(room: Any) -> None:
    rows, blobs = room
    episodes = rows["episodes"]
    done = rolled_out(world_in(room), Stopping(episodes), episodes, CONFIG)  # type: ignore[arg-type]
    batch = TrajectoryBatch("b", "navigation", "r", done)
    tables = {name: rows[name] for name in ("episodes", "navmeshes", "shells", "instances", "assets", "placements")}
    context = Context("b", "evaluation", 0, blobs)
    made = run(trajectory_batch=batch, **tables, context=context, config=CONFIG).rows["trajectories"]
    sights = SceneSights(rows["shells"][0], tuple(rows["placements"]), tuple(rows["instances"]), tuple(rows["assets"]), blobs)
    starts = [(e.instance_id, (*e.start_position[:2], e.start_yaw_radians)) for e in episodes]
    assert [row.is_target_seen for row in made] == sights.seen(starts, CONFIG)
    for without in ({"placements": []}, {"assets": []}, {"instances": []}):
        outcome = run(trajectory_batch=batch, **{**tables, **without}, context=context, config=CONFIG)
        blind = outcome.rows["trajectories"]
        assert bool(outcome.degradations) == ("placements" not in without)
        assert [row.is_target_seen for row in blind] == [None] * len(episodes)
        assert [dataclasses.replace(row, is_target_seen=None) for row in made] == blind


def test_the_finder_of_a_world_is_the_one_that_measures(room: Any) -> None:
    rows, blobs = room
    finder = path_finder(blobs[rows["navmeshes"][0].navmesh_blob], "x.navmesh")
    points = np.array([episode.start_position[:2] for episode in rows["episodes"]])
    views = np.array(rows["episodes"][0].view_points)[:, :2]
    world = world_in(room)
    assert world.field(views).distances(points).tobytes() == finder.field(finder.snap(views)).distances(points).tobytes()
