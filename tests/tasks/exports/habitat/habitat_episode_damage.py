"""What can be wrong with episodes: kinds of damage, and the rule that must refuse each."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.tasks.exports.habitat.habitat_damage import Damage, edit, in_agent, in_episodes, in_polygons

cut_links = in_polygons(16, bytes(12))  # nobody's neighbor: every polygon is an island


def in_episode(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change the first PointNav episode."""
    return in_episodes("pointnav", lambda content: change(content["episodes"][0]))


def in_info(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return in_episode(lambda episode: change(episode["info"]))


def in_goal(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change the first goal of ObjectNav."""
    return in_episodes("objectnav", lambda content: change(next(iter(content["goals_by_category"].values()))[0]))


def in_object_episodes(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change every ObjectNav episode of the first scene."""
    return in_episodes("objectnav", lambda content: [change(episode) for episode in content["episodes"]])


def in_split(task: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        for path in sorted((root / task).glob("*/*.json.gz")):
            edit(path, change)

    return damage


def longest_way_straight(root: Path) -> None:
    """Of the episode with the largest detour, the straight line to the goal as its geodesic distance."""

    def change(content: Any) -> None:
        info = max((e["info"] for e in content["episodes"]), key=lambda i: i["geodesic_distance"] - i["euclidean_distance"])
        assert info["geodesic_distance"] > info["euclidean_distance"] + 0.05, "something stands in the way"
        info["geodesic_distance"] = info["euclidean_distance"]

    in_episodes("objectnav", change)(root)


def nudge(episode: Any, by: float) -> None:
    episode["start_position"][0] += by


def turn_around(episode: Any) -> None:
    x, y, z, w = episode["start_rotation"]
    episode["start_rotation"] = [x, w, z, -y]


def swap_turns(episode: Any) -> None:
    for state in episode["shortest_paths"][0]:
        state["action"] = {2: 3, 3: 2}.get(state["action"], state["action"])


def march(episode: Any) -> None:
    """Straight on for ten metres, in a room of six."""
    episode["shortest_paths"] = [[{"position": None, "rotation": None, "action": action} for action in [1] * 40 + [0]]]


def act(episode: Any, index: int, action: int) -> None:
    episode["shortest_paths"][0][index]["action"] = action


def stop_after(episode: Any, steps: int) -> None:
    path = episode["shortest_paths"][0]
    episode["shortest_paths"] = [[*path[:steps], {**path[steps], "action": 0}]]


def other_target(content: Any) -> None:
    """Let every episode's target be the object that stands farthest from where its path ends."""
    goals = [goal for found in content["goals_by_category"].values() for goal in found]
    for episode in content["episodes"]:
        x, _, z = episode["shortest_paths"][0][-1]["position"]
        far = max(goals, key=lambda goal: math.hypot(goal["position"][0] - x, goal["position"][2] - z))
        episode["info"]["target_object_id"] = far["object_id"]
        episode["object_category"] = far["object_category"]


EPISODE_DAMAGES: dict[str, Damage] = {
    "unknown key in an episode": Damage("episode_keys", "pointnav/*/content/*.json.gz", "note", in_episode(lambda e: e.update(note="x"))),
    "episode without a start": Damage(
        "episode_keys",
        "objectnav/*/content/*.json.gz",
        "start_position",
        in_episodes("objectnav", lambda c: c["episodes"][0].pop("start_position")),
    ),
    "unknown key in a goal": Damage("goal_keys", "objectnav/*/content/*.json.gz", "color", in_goal(lambda g: g.update(color="red"))),
    "goal without object": Damage("goal_keys", "objectnav/*/content/*.json.gz", "object_id", in_goal(lambda g: g.pop("object_id"))),
    "numeric episode id": Damage("episode_id", "pointnav/*/content/*.json.gz", "episode_id", in_episode(lambda e: e.update(episode_id=0))),
    "episode id twice": Damage(
        "episode_id",
        "pointnav/*/content/*.json.gz",
        "episode_id",
        in_episodes("pointnav", lambda c: c["episodes"][1].update(episode_id="0")),
    ),
    "episode in no scene": Damage(
        "episode_scene", "pointnav/*/content/*.json.gz", "scene_id", in_episode(lambda e: e.update(scene_id="demo_room"))
    ),
    "episode of another dataset": Damage(
        "episode_scene",
        "pointnav/*/content/*.json.gz",
        "scene_dataset_config",
        in_episode(lambda e: e.update(scene_dataset_config="default")),
    ),
    "start outside": Damage(
        "start", "pointnav/*/content/*.json.gz", "start_position", in_episode(lambda e: e.update(start_position=[50.0, 0.0, 0.0]))
    ),
    "start upstairs": Damage(
        "start", "pointnav/*/content/*.json.gz", "start_position", in_episode(lambda e: e["start_position"].__setitem__(1, 2.0))
    ),
    "start in the scan's frame": Damage(
        "start", "pointnav/*/content/*.json.gz", "start_position", in_episode(lambda e: e.update(start_position=[0.0, 1.5, 0.0]))
    ),
    "start rotation in the other order": Damage(
        "start_rotation",
        "pointnav/*/content/*.json.gz",
        "start_rotation",
        in_episode(lambda e: e.update(start_rotation=[0.8, 0.0, 0.6, 0.0])),
    ),
    "start rotation of length 2": Damage(
        "start_rotation",
        "pointnav/*/content/*.json.gz",
        "start_rotation",
        in_episode(lambda e: e.update(start_rotation=[0.0, 0.0, 0.0, 2.0])),
    ),
    "no goals": Damage("goals", "pointnav/*/content/*.json.gz", "goals", in_episode(lambda e: e.update(goals=[]))),
    "no goals of the category": Damage(
        "goals", "objectnav/*/content/*.json.gz", "goals_by_category", in_episodes("objectnav", lambda c: c["goals_by_category"].popitem())
    ),
    "goal outside": Damage(
        "goals", "pointnav/*/content/*.json.gz", "goals: position", in_episode(lambda e: e["goals"][0].update(position=[0.0, 0.0, 40.0]))
    ),
    "goal of no object": Damage(
        "goal_object", "objectnav/*/content/*.json.gz", "object_id", in_goal(lambda g: g.update(object_id="nothing"))
    ),
    "no view points": Damage("view_points", "objectnav/*/content/*.json.gz", "view_points", in_goal(lambda g: g.update(view_points=None))),
    "view point without iou": Damage(
        "view_points", "objectnav/*/content/*.json.gz", "iou", in_goal(lambda g: g["view_points"][0].pop("iou"))
    ),
    "view point in a wall": Damage(
        "view_points",
        "objectnav/*/content/*.json.gz",
        "view_points",
        in_goal(lambda g: g["view_points"][0]["agent_state"].update(position=[9.0, 0.0, 9.0])),
    ),
    "bare actions": Damage(
        "shortest_paths", "pointnav/*/content/*.json.gz", "shortest_paths", in_episode(lambda e: e.update(shortest_paths=[[1, 1, 0]]))
    ),
    "shorter than straight": Damage(
        "geodesic", "pointnav/*/content/*.json.gz", "geodesic_distance", in_episode(lambda e: e["info"].update(geodesic_distance=0.01))
    ),
    "infinite distance": Damage(
        "geodesic", "pointnav/*/content/*.json.gz", "geodesic_distance", in_episode(lambda e: e["info"].update(geodesic_distance=None))
    ),
    "category maps of different keys": Damage(
        "category_maps",
        "objectnav/*/*.json.gz",
        "category_to_task_category_id",
        in_split("objectnav", lambda s: s["category_to_task_category_id"].popitem()),
    ),
    "no category maps": Damage(
        "category_maps",
        "objectnav/*/*.json.gz",
        "category_to_task_category_id",
        in_split("objectnav", lambda s: s.pop("category_to_task_category_id")),
    ),
    "category in no map": Damage(
        "category_maps",
        "objectnav/*/content/*.json.gz",
        "object_category",
        in_episodes("objectnav", lambda c: c["episodes"][0].update(object_category="yacht")),
    ),
    "no episodes": Damage(
        "split_file", "pointnav/*/content/*.json.gz", "episodes", in_episodes("pointnav", lambda c: c.update(episodes=[]))
    ),
    "split without episodes": Damage("split_file", "pointnav/*/*.json.gz", "episodes", in_split("pointnav", lambda s: s.pop("episodes"))),
    "agent without steps": Damage("replay", "pointnav/*/content/*.json.gz", "metadata/agent.json", in_agent(lambda a: a.pop("turn_angle"))),
    "longer steps": Damage(
        "replay", "pointnav/*/content/*.json.gz", "shortest_paths[0]", in_agent(lambda a: a.update(forward_step_size=0.3))
    ),
    "narrower turns": Damage("replay", "pointnav/*/content/*.json.gz", "shortest_paths[0]", in_agent(lambda a: a.update(turn_angle=10))),
    "episode without goals": Damage("episode_keys", "pointnav/*/content/*.json.gz", "goals", in_episode(lambda e: e.pop("goals"))),
    "episode without info": Damage(
        "geodesic", "pointnav/*/content/*.json.gz", "geodesic_distance", in_episode(lambda e: e.update(info=None))
    ),
    "distance of a detour": Damage(
        "geodesic",
        "pointnav/*/content/*.json.gz",
        "geodesic_distance",
        in_info(lambda i: i.update(geodesic_distance=i["geodesic_distance"] + 0.02)),
    ),
    "distance through the furniture": Damage("geodesic", "objectnav/*/content/*.json.gz", "geodesic_distance", longest_way_straight),
    "start away from its path": Damage(
        "replay", "pointnav/*/content/*.json.gz", "shortest_paths[0][0].position", in_episode(lambda e: nudge(e, 0.002))
    ),
    "start turned away from its path": Damage(
        "replay", "pointnav/*/content/*.json.gz", "shortest_paths[0][0].rotation", in_episode(turn_around)
    ),
    "left for right": Damage("replay", "objectnav/*/content/*.json.gz", "shortest_paths[0]", in_object_episodes(swap_turns)),
    "through the wall": Damage("replay", "pointnav/*/content/*.json.gz", "leaves the navmesh", in_episode(march)),
    "an action of other agents": Damage(
        "replay", "objectnav/*/content/*.json.gz", "shortest_paths[0][0]: action", in_object_episodes(lambda e: act(e, 0, 9))
    ),
    "no stop": Damage(
        "replay_end", "pointnav/*/content/*.json.gz", "shortest_paths[0]", in_episode(lambda e: e["shortest_paths"][0].pop())
    ),
    "stop on the way": Damage(
        "replay_end", "objectnav/*/content/*.json.gz", "shortest_paths[0]", in_object_episodes(lambda e: act(e, 1, 0))
    ),
    "stop far from the goal": Damage(
        "replay_end",
        "pointnav/*/content/*.json.gz",
        "not within 0.2 m",
        in_episode(lambda e: stop_after(e, len(e["shortest_paths"][0]) // 3)),
    ),
    "actions to another object": Damage(
        "replay_end", "objectnav/*/content/*.json.gz", "not within 0.2 m", in_episodes("objectnav", other_target)
    ),
    "goal behind a wall": Damage("reachable", "pointnav/*/content/*.json.gz", "goals", cut_links),
}
