"""Rules of the episodes in a Habitat dataset, as habitat-lab reads them, and what it does not look at."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.exports.habitat.ground import Ground
from tasks.exports.habitat.library import Library, read_json
from tasks.exports.habitat.navmesh_file import NEAR, NavmeshPolygons
from tasks.exports.habitat.replay import AgentSteps, Trip, check_trips, heading_of, steps_of

EPISODE_RULES: dict[str, str] = {
    "split_file": "every split has a split file with a list of episodes, and some episodes in all",
    "category_maps": "ObjectNav's two category maps are there and have the same keys, which cover every episode's category",
    "episode_keys": "episodes have the keys that habitat-lab needs and none that it refuses",
    "goal_keys": "goals and view points have the keys that habitat-lab needs and none that it refuses",
    "episode_id": "episode ids are text and unique in their file",
    "episode_scene": "episodes name a scene of this dataset exactly, and this dataset's config",
    "start": "starts are three finite numbers on the scene's navmesh",
    "start_rotation": "start rotations are (x, y, z, w), of length 1, about +Y alone",
    "goals": "every episode has goals: its own, or those of its category under the key that habitat-lab builds",
    "view_points": "goals of ObjectNav have view points with position, rotation and iou, on the navmesh",
    "goal_object": "goals of ObjectNav name an object of their scene",
    "shortest_paths": "shortest paths of PointNav are lists of states, not of bare actions",
    "geodesic": "geodesic distances are finite and those of the shortest path over the navmesh's polygons, exactly or as Detour finds it",
    "reachable": "a goal of every episode is connected to its start on the navmesh",
    "replay": "actions of shortest paths, replayed with the documented steps, follow their own states and never leave the navmesh",
    "replay_end": "and end, with stop, within the documented distance (0.2 m) of a goal's position or a target's view point",
}

_COMMON = {"episode_id", "scene_id", "scene_dataset_config", "additional_obj_config_paths", "start_position", "start_rotation", "info"}
_EPISODE = {*_COMMON, "goals", "start_room", "shortest_paths"}
_OBJECT_EPISODE = {*_EPISODE, "object_category"}
_NEEDED = {"episode_id", "scene_id", "start_position", "start_rotation", "goals"}
_GOAL = {"position", "radius"}
_OBJECT_GOAL = {*_GOAL, "object_id", "object_name", "object_name_id", "object_category", "room_id", "room_name", "view_points"}
_ABOVE_NAVMESH = 0.5  # metres; habitat-lab's own sampler allows as much between start and goal


@dataclasses.dataclass(frozen=True)
class _World:
    """What episodes are held against: templates by name, navmeshes by scene (None without one), the agent's steps if stated."""

    library: Library
    navmeshes: Mapping[str, NavmeshPolygons | None]
    grounds: Mapping[str, Ground]
    steps: AgentSteps | None


def check_episodes(library: Library, navmeshes: Mapping[str, NavmeshPolygons | None], agent: Mapping[str, Any] | None) -> list[Finding]:
    """Everything that is wrong with the episodes of a dataset.

    Args:
        library: The dataset.
        navmeshes: By scene, None for a scene without one.
        agent: What `metadata/agent.json` says, None without one.
    """
    findings: list[Finding] = []
    grounds = {scene: Ground(navmesh) for scene, navmesh in navmeshes.items() if navmesh is not None}
    world = _World(library, navmeshes, grounds, steps_of(agent))
    for task in ("objectnav", "pointnav"):
        for folder in sorted((library.root / task).glob("*")):
            if folder.is_dir():
                _split(world, folder, task, findings)
    return findings


def _split(world: _World, folder: Path, task: str, findings: list[Finding]) -> None:
    """One split of one task."""
    library = world.library
    header_path = folder / f"{folder.name}.json.gz"
    header = read_json(header_path, library.root, findings, shapes.SPLIT) or {}
    where = header_path.relative_to(library.root).as_posix()
    if "episodes" not in header:
        findings.append(Finding("split_file", where, "episodes are missing"))
    maps = _maps(header)
    if task == "objectnav" and maps is None:
        findings.append(
            Finding(
                "category_maps",
                where,
                "category_to_task_category_id or category_to_scene_annotation_category_id is missing, or their keys differ",
            )
        )
    total = len(header.get("episodes") or [])
    for path in sorted((folder / "content").glob("*.json.gz")):
        content = read_json(path, library.root, findings, shapes.CONTENT)
        if content is None:
            continue
        name = path.relative_to(library.root).as_posix()
        own = _maps(content)
        if any("category_to" in key for key in content) and own != maps:
            findings.append(Finding("category_maps", name, "category_to_..._category_id differ from those of the split"))
        episodes = content.get("episodes")
        if not episodes:
            findings.append(Finding("split_file", name, "episodes are none"))
            continue
        total += len(episodes)
        findings += _content(world, content, task, name, maps)
        findings += _replayed(world, content, task, name)
    if total == 0:
        findings.append(Finding("split_file", where, "episodes are none in all scenes: habitat-lab stops"))


def _maps(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """The category maps of a document, or None when they are missing or have different keys."""
    tasks = document.get("category_to_task_category_id")
    scenes = document.get("category_to_scene_annotation_category_id", document.get("category_to_mp3d_category_id"))
    if tasks is None or scenes is None or set(tasks) != set(scenes):
        return None
    return {"task": tasks, "scene": scenes}


def _content(world: _World, content: Mapping[str, Any], task: str, name: str, maps: dict[str, Any] | None) -> Iterator[Finding]:
    """The episodes of one scene."""
    library, navmeshes = world.library, world.navmeshes
    goals = content.get("goals_by_category", {})
    seen: set[Any] = set()
    for index, episode in enumerate(content["episodes"]):
        where = f"{name} episodes[{index}]"
        yield from _keys(episode, _OBJECT_EPISODE if task == "objectnav" else _EPISODE, _NEEDED, "episode_keys", where)
        episode_id = episode.get("episode_id")
        if not isinstance(episode_id, str) or episode_id in seen:
            yield Finding("episode_id", where, f"episode_id {episode_id!r} is no text, or is there twice")
        seen.add(str(episode_id))
        yield from _scene(library, episode, where)
        scene = library.scene_of(episode.get("scene_id"))
        floor = _Floor(scene in navmeshes, navmeshes.get(str(scene)))
        yield from _start(episode, where, floor)
        if task == "objectnav":
            category = episode.get("object_category")
            key = f"{PurePosixPath(str(episode.get('scene_id'))).name}_{category}"
            if not goals.get(key):
                yield Finding("goals", where, f"goals_by_category has no {key!r}")
            states = [state for path in episode.get("shortest_paths") or [] for state in path if isinstance(state, dict)]
            if shapes.mismatch(states, [shapes.STATE]):
                yield Finding("shortest_paths", where, "shortest_paths: a step has a position, rotation or action of another kind")
            if maps is not None and category not in maps["task"]:
                yield Finding("category_maps", where, f"object_category {category!r} is in no map")
        else:
            yield from _point_goals(episode, where, floor)
    if task == "objectnav":
        for key, items in goals.items():
            yield from _object_goals(library, key, items, name, navmeshes)


def _replayed(world: _World, content: Mapping[str, Any], task: str, name: str) -> Iterator[Finding]:
    """The episodes of one scene, carried out on its navmesh."""
    trips: dict[str, list[Trip]] = {}
    walked = 0
    for index, episode in enumerate(content["episodes"]):
        scene, paths = str(world.library.scene_of(episode.get("scene_id"))), episode.get("shortest_paths") or []
        walked += bool(paths)
        start = numbers(episode.get("start_position"), 3)
        goals = _object_places(content, episode) if task == "objectnav" else _places(episode.get("goals") or [])
        if scene in world.grounds and start is not None and len(goals) and _heading(episode.get("start_rotation")) is None:
            heading = heading_of(episode["start_rotation"])
            trip = Trip(f"{name} episodes[{index}]", start, heading, goals, paths, episode.get("info") or {})
            trips.setdefault(scene, []).append(trip)
    for scene, scene_trips in trips.items():
        yield from check_trips(scene_trips, world.grounds[scene], world.steps)
    if walked and world.steps is None:
        message = "metadata/agent.json states no forward_step_size and turn_angle: shortest_paths cannot be replayed"
        yield Finding("replay", name, message, world.library.is_ours)
    if walked < len(content["episodes"]):
        yield Finding("replay", name, f"{len(content['episodes']) - walked} episodes have no shortest_paths to replay", is_error=False)


def _object_places(content: Mapping[str, Any], episode: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """View points of the object that an ObjectNav episode was made for, or of all of its category, shape (n, 3)."""
    key = f"{PurePosixPath(str(episode.get('scene_id'))).name}_{episode.get('object_category')}"
    goals = content.get("goals_by_category", {}).get(key) or []
    target = (episode.get("info") or {}).get("target_object_id")
    chosen = [goal for goal in goals if goal.get("object_id") == target] or goals
    return _places([view.get("agent_state") or {} for goal in chosen for view in goal.get("view_points") or []])


def _places(goals: Iterable[Mapping[str, Any]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Positions of goals or agent states that have one, shape (n, 3)."""
    positions = [position for goal in goals if (position := numbers(goal.get("position"), 3)) is not None]
    return np.array(positions, dtype=np.float64).reshape(-1, 3)


def _keys(item: Mapping[str, Any], allowed: set[str], needed: set[str], rule: str, where: str) -> Iterator[Finding]:
    for key in sorted(set(item) - allowed):
        yield Finding(rule, where, f"key {key!r} is refused by habitat-lab")
    for key in sorted(needed - set(item)):
        yield Finding(rule, where, f"key {key!r} is missing")


def _scene(library: Library, episode: Mapping[str, Any], where: str) -> Iterator[Finding]:
    """Scene and dataset of an episode."""
    if library.scene_of(episode.get("scene_id")) is None:
        yield Finding("episode_scene", where, f"scene_id {episode.get('scene_id')!r} is no scene's name: an empty scene would be opened")
    config = str(episode.get("scene_dataset_config", ""))
    if PurePosixPath(config).name != library.config:
        yield Finding("episode_scene", where, f"scene_dataset_config {config!r} is not this dataset's {library.config}")


def numbers(value: Any, count: int) -> NDArray[np.float64] | None:
    """A list of `count` numbers as an array, else None."""
    return np.asarray(value, dtype=np.float64) if value is not None and len(value) == count else None


@dataclasses.dataclass(frozen=True)
class _Floor:
    """What a scene's agents stand on. An unknown scene is another rule's."""

    is_known: bool
    navmesh: NavmeshPolygons | None


def _standing(value: Any, floor: _Floor) -> str | None:
    """What is wrong with a position, or None."""
    place = numbers(value, 3)
    if place is None:
        return f"{value} is not three finite numbers"
    if floor.navmesh is None:
        return "lies in a scene that has no navmesh" if floor.is_known else None
    beside, above = floor.navmesh.distance(place)
    if beside > NEAR or above > _ABOVE_NAVMESH:
        return f"{value} lies {beside:.2f} m beside the navmesh and {above:.2f} m above or below it"
    return None


def _heading(value: Any) -> str | None:
    """What is wrong with a rotation (x, y, z, w) about +Y, or None."""
    rotation = numbers(value, 4)
    if rotation is None:
        return f"{value} is not four finite numbers"
    if abs(np.linalg.norm(rotation) - 1.0) > 1e-4:
        return f"{value} has length {np.linalg.norm(rotation):.5g}"
    if abs(rotation[0]) > 1e-4 or abs(rotation[2]) > 1e-4:
        return f"{value} tips the agent over; is it (w, x, y, z)?"
    return None


def _start(episode: Mapping[str, Any], where: str, floor: _Floor) -> Iterator[Finding]:
    """Start and geodesic distance of an episode."""
    wrong = _standing(episode.get("start_position"), floor)
    if wrong:
        yield Finding("start", where, f"start_position {wrong}")
    wrong = _heading(episode.get("start_rotation"))
    if wrong:
        yield Finding("start_rotation", where, f"start_rotation {wrong}")
    info = episode.get("info") or {}
    distance, straight = info.get("geodesic_distance"), info.get("euclidean_distance", 0.0)
    if shapes.number(distance) or shapes.number(straight) or distance < straight - 1e-3:
        yield Finding("geodesic", where, f"geodesic_distance is {distance}, the straight line {straight}")


def _point_goals(episode: Mapping[str, Any], where: str, floor: _Floor) -> Iterator[Finding]:
    """Goals and shortest paths of a PointNav episode."""
    goals = episode.get("goals")
    if not goals:
        yield Finding("goals", where, "goals are none")
        return
    for goal in goals:
        yield from _keys(goal, _GOAL, {"position"}, "goal_keys", where)
        wrong = _standing(goal.get("position"), floor)
        if wrong:
            yield Finding("goals", where, f"goals: position {wrong}")
    for path in episode.get("shortest_paths") or []:
        states = all(isinstance(state, dict) and set(state) == {"position", "rotation", "action"} for state in path)
        if not states or shapes.mismatch(path, [shapes.STATE]):
            yield Finding("shortest_paths", where, "shortest_paths: a step is no object with position, rotation and action")


def _object_goals(library: Library, key: str, goals: Any, name: str, navmeshes: Mapping[str, NavmeshPolygons | None]) -> Iterator[Finding]:
    """Goals of one category in one scene."""
    scene = next(
        (handle for handle in library.sections["scene_instances"] if key.startswith((f"{handle}_", f"{handle}.scene_instance.json_"))), None
    )
    if scene is None and library.is_ours:
        yield Finding("goals", f"{name} goals_by_category", f"{key!r} does not begin with a scene's name")
        return
    floor = _Floor(scene in navmeshes, navmeshes.get(str(scene)))
    items = library.sections["scene_instances"][scene].values.get("object_instances", []) if scene is not None else []
    objects = {item.get("template_name") for item in items if isinstance(item, dict)}
    for index, goal in enumerate(goals):
        where = f"{name} goals_by_category[{key!r}][{index}]"
        yield from _keys(goal, _OBJECT_GOAL, {"position", "object_id", "view_points"}, "goal_keys", where)
        if not isinstance(goal.get("object_id"), str) or goal["object_id"] not in objects:
            yield Finding("goal_object", where, f"object_id {goal.get('object_id')!r} is no object of {scene!r}", library.is_ours)
        if numbers(goal.get("position"), 3) is None:
            yield Finding("goals", where, f"position {goal.get('position')} is not three finite numbers")
        views = goal.get("view_points")
        if not views:
            yield Finding("view_points", where, "view_points are none")
            continue
        for view in views:
            yield from _view(view, where, floor)


def _view(view: Any, where: str, floor: _Floor) -> Iterator[Finding]:
    """One view point."""
    if set(view) != {"agent_state", "iou"}:
        yield Finding("view_points", where, "view_points: one needs agent_state and iou, and nothing else")
        return
    iou = view["iou"]
    if shapes.number(iou) or iou < 0:
        yield Finding("view_points", where, f"view_points: iou is {iou!r}")
    state = view["agent_state"]
    wrong = _standing(state.get("position"), floor) or _heading(state.get("rotation"))
    if wrong or set(state) != {"position", "rotation"}:
        yield Finding("view_points", where, f"view_points: {wrong or 'agent_state needs position and rotation, and nothing else'}")
