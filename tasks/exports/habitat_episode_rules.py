"""Rules of the episodes in a Habitat dataset, as habitat-lab reads them, and what it does not look at."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from tasks.exports import habitat_shapes
from tasks.exports.findings import Finding
from tasks.exports.habitat_library import Library, read_json
from tasks.exports.navmesh_file import NavmeshFile

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
    "geodesic": "geodesic distances are finite and not shorter than the straight line",
}

_COMMON = {"episode_id", "scene_id", "scene_dataset_config", "additional_obj_config_paths", "start_position", "start_rotation", "info"}
_EPISODE = {*_COMMON, "goals", "start_room", "shortest_paths"}
_OBJECT_EPISODE = {*_EPISODE, "object_category"}
_NEEDED = {"episode_id", "scene_id", "start_position", "start_rotation", "goals"}
_GOAL = {"position", "radius"}
_OBJECT_GOAL = {*_GOAL, "object_id", "object_name", "object_name_id", "object_category", "room_id", "room_name", "view_points"}
_ON_NAVMESH = 0.05  # metres beside the mesh, half a cell of the usual bake each way
_ABOVE_NAVMESH = 0.5  # metres; habitat-lab's own sampler allows as much between start and goal


def check_episodes(library: Library, navmeshes: Mapping[str, NavmeshFile | None]) -> list[Finding]:
    """Everything that is wrong with the episodes of a dataset. `navmeshes`: by scene, None for a scene without one."""
    findings: list[Finding] = []
    for task in ("objectnav", "pointnav"):
        for folder in sorted((library.root / task).glob("*")):
            if folder.is_dir():
                _split(library, folder, task, navmeshes, findings)
    return findings


def _split(library: Library, folder: Path, task: str, navmeshes: Mapping[str, NavmeshFile | None], findings: list[Finding]) -> None:
    """One split of one task."""
    header_path = folder / f"{folder.name}.json.gz"
    header = read_json(header_path, library.root, findings, habitat_shapes.SPLIT) or {}
    where = header_path.relative_to(library.root).as_posix()
    if "episodes" not in header:
        findings.append(Finding("split_file", where, "has no list of episodes"))
    maps = _maps(header)
    if task == "objectnav" and maps is None:
        findings.append(Finding("category_maps", where, "a category map is missing, or the two have different keys"))
    total = len(header.get("episodes") or [])
    for path in sorted((folder / "content").glob("*.json.gz")):
        content = read_json(path, library.root, findings, habitat_shapes.CONTENT)
        if content is None:
            continue
        name = path.relative_to(library.root).as_posix()
        own = _maps(content)
        if any("category_to" in key for key in content) and own != maps:
            findings.append(Finding("category_maps", name, "differ from those of the split"))
        episodes = content.get("episodes")
        if not episodes:
            findings.append(Finding("split_file", name, "has no episodes"))
            continue
        total += len(episodes)
        findings += _content(library, content, task, name, navmeshes, maps)
    if total == 0:
        findings.append(Finding("split_file", where, "there are no episodes in all: habitat-lab stops"))


def _maps(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """The category maps of a document, or None when they are missing or have different keys."""
    tasks = document.get("category_to_task_category_id")
    scenes = document.get("category_to_scene_annotation_category_id", document.get("category_to_mp3d_category_id"))
    if tasks is None or scenes is None or set(tasks) != set(scenes):
        return None
    return {"task": tasks, "scene": scenes}


def _content(
    library: Library, content: Mapping[str, Any], task: str, name: str,
    navmeshes: Mapping[str, NavmeshFile | None], maps: dict[str, Any] | None,
) -> Iterator[Finding]:  # fmt: skip
    """The episodes of one scene."""
    goals = content.get("goals_by_category", {})
    seen: set[Any] = set()
    for index, episode in enumerate(content["episodes"]):
        where = f"{name} episodes[{index}]"
        yield from _keys(episode, _OBJECT_EPISODE if task == "objectnav" else _EPISODE, _NEEDED, "episode_keys", where)
        episode_id = episode.get("episode_id")
        if not isinstance(episode_id, str) or episode_id in seen:
            yield Finding("episode_id", where, f"{episode_id!r} is no text, or is there twice")
        seen.add(str(episode_id))
        yield from _scene(library, episode, where)
        navmesh = navmeshes.get(str(episode.get("scene_id")))
        yield from _start(episode, where, navmesh)
        if task == "objectnav":
            category = episode.get("object_category")
            key = f"{PurePosixPath(str(episode.get('scene_id'))).name}_{category}"
            if not goals.get(key):
                yield Finding("goals", where, f"goals_by_category has no {key!r}")
            states = [state for path in episode.get("shortest_paths") or [] for state in path if isinstance(state, dict)]
            if habitat_shapes.mismatch(states, [habitat_shapes.STATE]):
                yield Finding("shortest_paths", where, "a step has a position, rotation or action of another kind")
            if maps is not None and category not in maps["task"]:
                yield Finding("category_maps", where, f"category {category!r} is in no map")
        else:
            yield from _point_goals(episode, where, navmesh)
    if task == "objectnav":
        for key, items in goals.items():
            yield from _object_goals(library, key, items, name, navmeshes)


def _keys(item: Mapping[str, Any], allowed: set[str], needed: set[str], rule: str, where: str) -> Iterator[Finding]:
    for key in sorted(set(item) - allowed):
        yield Finding(rule, where, f"key {key!r} is refused by habitat-lab")
    for key in sorted(needed - set(item)):
        yield Finding(rule, where, f"key {key!r} is missing")


def _scene(library: Library, episode: Mapping[str, Any], where: str) -> Iterator[Finding]:
    """Scene and dataset of an episode."""
    if episode.get("scene_id") not in library.sections["scene_instances"]:
        yield Finding("episode_scene", where, f"scene_id {episode.get('scene_id')!r} is no scene's name: an empty scene would be opened")
    config = str(episode.get("scene_dataset_config", ""))
    if PurePosixPath(config).name != library.config:
        yield Finding("episode_scene", where, f"scene_dataset_config {config!r} is not this dataset's {library.config}")


def _numbers(value: Any, count: int) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    return np.asarray(value, dtype=np.float64) if value is not None and len(value) == count else None


def _standing(value: Any, navmesh: NavmeshFile | None) -> str | None:
    """What is wrong with a position, or None."""
    place = _numbers(value, 3)
    if place is None:
        return f"{value} is not three finite numbers"
    if navmesh is None:
        return "the scene has no navmesh"
    beside, above = navmesh.distance(place)
    if beside > _ON_NAVMESH or above > _ABOVE_NAVMESH:
        return f"{value} lies {beside:.2f} m beside the navmesh and {above:.2f} m above or below it"
    return None


def _heading(value: Any) -> str | None:
    """What is wrong with a rotation (x, y, z, w) about +Y, or None."""
    rotation = _numbers(value, 4)
    if rotation is None:
        return f"{value} is not four finite numbers"
    if abs(np.linalg.norm(rotation) - 1.0) > 1e-4:
        return f"{value} has length {np.linalg.norm(rotation):.5g}"
    if abs(rotation[0]) > 1e-4 or abs(rotation[2]) > 1e-4:
        return f"{value} tips the agent over; is it (w, x, y, z)?"
    return None


def _start(episode: Mapping[str, Any], where: str, navmesh: NavmeshFile | None) -> Iterator[Finding]:
    """Start and geodesic distance of an episode."""
    wrong = _standing(episode.get("start_position"), navmesh)
    if wrong:
        yield Finding("start", where, f"start_position {wrong}")
    wrong = _heading(episode.get("start_rotation"))
    if wrong:
        yield Finding("start_rotation", where, wrong)
    info = episode.get("info") or {}
    distance, straight = info.get("geodesic_distance"), info.get("euclidean_distance", 0.0)
    if habitat_shapes.number(distance) or habitat_shapes.number(straight) or distance < straight - 1e-3:
        yield Finding("geodesic", where, f"geodesic_distance is {distance}, the straight line {straight}")


def _point_goals(episode: Mapping[str, Any], where: str, navmesh: NavmeshFile | None) -> Iterator[Finding]:
    """Goals and shortest paths of a PointNav episode."""
    goals = episode.get("goals")
    if not goals:
        yield Finding("goals", where, "has no goals")
        return
    for goal in goals:
        yield from _keys(goal, _GOAL, {"position"}, "goal_keys", where)
        wrong = _standing(goal.get("position"), navmesh)
        if wrong:
            yield Finding("goals", where, f"position {wrong}")
    for path in episode.get("shortest_paths") or []:
        states = all(isinstance(state, dict) and set(state) == {"position", "rotation", "action"} for state in path)
        if not states or habitat_shapes.mismatch(path, [habitat_shapes.STATE]):
            yield Finding("shortest_paths", where, "a step is no object with position, rotation and action")


def _object_goals(library: Library, key: str, goals: Any, name: str, navmeshes: Mapping[str, NavmeshFile | None]) -> Iterator[Finding]:
    """Goals of one category in one scene."""
    scene = next((handle for handle in library.sections["scene_instances"] if key.startswith(f"{handle}_")), None)
    if scene is None:
        yield Finding("goals", f"{name} goals_by_category", f"{key!r} does not begin with a scene's name")
        return
    items = library.sections["scene_instances"][scene].values.get("object_instances", [])
    objects = {item.get("template_name") for item in items if isinstance(item, dict)}
    for index, goal in enumerate(goals):
        where = f"{name} goals_by_category[{key!r}][{index}]"
        yield from _keys(goal, _OBJECT_GOAL, {"position", "object_id", "view_points"}, "goal_keys", where)
        if not isinstance(goal.get("object_id"), str) or goal["object_id"] not in objects:
            yield Finding("goal_object", where, f"object_id {goal.get('object_id')!r} is no object of {scene!r}")
        if _numbers(goal.get("position"), 3) is None:
            yield Finding("goals", where, f"position {goal.get('position')} is not three finite numbers")
        views = goal.get("view_points")
        if not views:
            yield Finding("view_points", where, "has none")
            continue
        for view in views:
            yield from _view(view, where, navmeshes.get(scene))


def _view(view: Any, where: str, navmesh: NavmeshFile | None) -> Iterator[Finding]:
    """One view point."""
    if set(view) != {"agent_state", "iou"}:
        yield Finding("view_points", where, "a view point needs agent_state and iou, and nothing else")
        return
    iou = view["iou"]
    if not isinstance(iou, int | float) or isinstance(iou, bool) or not math.isfinite(iou) or iou < 0:
        yield Finding("view_points", where, f"iou is {iou!r}")
    state = view["agent_state"]
    wrong = _standing(state.get("position"), navmesh) or _heading(state.get("rotation"))
    if wrong or set(state) != {"position", "rotation"}:
        yield Finding("view_points", where, wrong or "agent_state needs position and rotation, and nothing else")
