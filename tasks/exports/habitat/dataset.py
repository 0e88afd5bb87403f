"""The files of a Habitat dataset that belong to all its scenes: configs, lexicon, split files, agent, README."""

from __future__ import annotations

import csv
import dataclasses
import gzip
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.capture.labels import NYU40
from tasks.exports.config import HabitatConfig
from tasks.exports.habitat.json_files import dump_json, dump_json_gz
from tasks.exports.habitat.navmesh_file import read_polygons

TASKS = ("objectnav", "pointnav")

_ATTRIBUTION = ("provider", "source", "author", "license")


@dataclasses.dataclass(frozen=True)
class HabitatScene:
    """What the dataset's own files need to know of a scene.

    paths: Of all its files. categories: NYU40 class of every category that is a goal. splits: That it has episodes in.
    navmesh: Settings in the navmesh's header, empty without one. assets: Where every asset comes from, by its id.
    config: With the settings of the dataset that the scene was exported with.
    """

    scene_id: str
    handle: str
    license: str
    paths: tuple[str, ...]
    splits: tuple[str, ...]
    categories: Mapping[str, int]
    navmesh: Mapping[str, float]
    assets: Mapping[str, Mapping[str, str]]
    config: HabitatConfig


def describe(roles: Mapping[str, str], read: Callable[[str], bytes]) -> HabitatScene:
    """What the dataset needs to know of a scene, from the roles of its files by path; `read` gives the contents of a path."""
    scene_path = next(path for path, role in roles.items() if role == "scene")
    scene = json_value(read(scene_path))
    classes = {item["user_defined"]["category"]: item["user_defined"]["nyu40_id"] for item in scene["object_instances"]}
    goals: set[str] = set()
    splits: set[str] = set()
    navmesh: dict[str, float] = {}
    for path in roles:
        parts = PurePosixPath(path).parts
        if parts[0] == "objectnav":
            splits.add(parts[1])
            goals |= {episode["object_category"] for episode in json_value(gzip.decompress(read(path)))["episodes"]}
        elif parts[0] == "navmeshes":
            navmesh = read_polygons(read(path)).settings or {}
    return HabitatScene(
        scene_id=scene["user_defined"]["scene_id"],
        handle=PurePosixPath(scene_path).name.removesuffix(".scene_instance.json"),
        license=scene["user_defined"]["license"],
        paths=tuple(sorted(roles)),
        splits=tuple(sorted(splits)),
        categories={category: classes.get(category, 0) for category in sorted(goals)},
        navmesh=navmesh,
        assets={item["user_defined"]["asset_id"]: item["user_defined"] for item in scene["object_instances"]},
        config=dataclasses.replace(HabitatConfig(), **scene["user_defined"].get("dataset", {})),
    )


def dataset_files(scenes: Sequence[HabitatScene]) -> dict[str, bytes]:
    """Files of a dataset beside those of its scenes, by path from its root.

    Semantic ids are NYU40 classes, so they never change when scenes are added. Numbers of ObjectNav's categories are
    positions in the sorted list of the dataset's categories, which is what habitat-lab wants, and do change.

    Raises:
        InputError: the scenes were exported with different settings of the dataset.
    """
    ordered = sorted(scenes, key=lambda scene: scene.handle)
    options = ordered[0].config
    for scene in ordered:
        if scene.config != options:
            problem = f"was exported with other settings of the dataset than {ordered[0].scene_id}"
            raise InputError("export_files", scene.scene_id, problem, "export them apart, or run exports again with the same ones")
    files = {
        f"{options.dataset}.scene_dataset_config.json": dump_json(_dataset_config(ordered, options)),
        f"semantics/{options.dataset}_lexicon.json": dump_json({"classes": [{"id": i, "name": name} for i, name in enumerate(NYU40)]}),
        "README.md": _readme(ordered, options).encode(),
        "metadata/attribution.csv": _attribution(ordered),
    }
    agent = next((scene.navmesh for scene in ordered if scene.navmesh), None)
    if agent is not None:
        files["metadata/agent.json"] = dump_json(agent_settings(agent, options))
    categories: dict[str, int] = {}
    for scene in ordered:
        for category, number in scene.categories.items():
            categories[category] = max(number, categories.get(category, 0))
    tasks = {category: index for index, category in enumerate(sorted(categories))}
    annotations = {category: categories[category] for category in sorted(categories)}
    for split in sorted({split for scene in ordered for split in scene.splits}):
        maps = {"category_to_task_category_id": tasks, "category_to_scene_annotation_category_id": annotations}
        files[f"objectnav/{split}/{split}.json.gz"] = dump_json_gz({"episodes": [], **maps})
        files[f"pointnav/{split}/{split}.json.gz"] = dump_json_gz({"episodes": []})
    return dict(sorted(files.items()))


def _attribution(scenes: Sequence[HabitatScene]) -> bytes:
    """Whom to name for which asset: a line each, sorted, and the scenes that show it."""
    about = {asset_id: values for scene in scenes for asset_id, values in scene.assets.items()}
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["asset_id", *_ATTRIBUTION, "scenes"])
    for asset_id in sorted(about):
        shown = " ".join(scene.handle for scene in scenes if asset_id in scene.assets)
        writer.writerow([asset_id, *(about[asset_id][key] for key in _ATTRIBUTION), shown])
    return table.getvalue().encode()


def agent_settings(navmesh: Mapping[str, float], config: HabitatConfig) -> dict[str, Any]:
    """The agent that a navmesh and its episodes were made for, in the words of habitat-lab's config."""
    return {
        "radius": round(navmesh["agentRadius"], 6),
        "height": round(navmesh["agentHeight"], 6),
        "max_climb": round(navmesh["agentMaxClimb"], 6),
        "max_slope": round(navmesh["agentMaxSlope"], 6),
        "navmesh_include_static_objects": bool(navmesh["includeStaticObjects"]),
        "forward_step_size": config.forward_m,
        "turn_angle": config.turn_degrees,
        "success_distance": config.success_m,
    }


def _dataset_config(scenes: Sequence[HabitatScene], config: HabitatConfig) -> dict[str, Any]:
    """The scene dataset config: every file by its own path, none by a pattern."""

    def listed(folder: str, ending: str) -> dict[str, Any]:
        paths = [path for scene in scenes for path in scene.paths if path.startswith(f"{folder}/") and path.endswith(ending)]
        return {"paths": {".json": sorted(paths)}}

    navmeshes = {f"{scene.handle}_navmesh": f"navmeshes/{scene.handle}.navmesh" for scene in scenes if scene.navmesh}
    return {
        "stages": listed("stages", ".stage_config.json"),
        "light_setups": listed("lights", ".lighting_config.json"),
        "objects": listed("objects", ".object_config.json"),
        "scene_instances": listed("scenes", ".scene_instance.json"),
        "navmesh_instances": navmeshes,
        "semantic_scene_descriptor_instances": {f"{config.dataset}_lexicon": f"semantics/{config.dataset}_lexicon.json"},
    }


def _readme(scenes: Sequence[HabitatScene], config: HabitatConfig) -> str:
    """How to use the dataset."""
    splits = sorted({split for scene in scenes for split in scene.splits})
    settings = {
        "habitat.dataset.data_path": f'"{config.dataset_folder}/objectnav/{{split}}/{{split}}.json.gz"',
        "habitat.dataset.split": "train" if not splits or "train" in splits else splits[0],
        "habitat.dataset.scenes_dir": '""',
        "habitat.simulator.scene_dataset": f'"{config.dataset_folder}/{config.dataset}.scene_dataset_config.json"',
    }
    agent = next((scene.navmesh for scene in scenes if scene.navmesh), None)
    if agent is not None:
        about = agent_settings(agent, config)
        names = ("radius", "height", "max_climb", "max_slope")
        settings |= {f"habitat.simulator.agents.main_agent.{name}": f"{about[name]:g}" for name in names}
        settings["habitat.simulator.navmesh_include_static_objects"] = str(about["navmesh_include_static_objects"])
    settings["habitat.simulator.forward_step_size"] = f"{config.forward_m:g}"
    settings["habitat.simulator.turn_angle"] = f"{config.turn_degrees:g}"
    settings["habitat.task.measurements.success.success_distance"] = f"{config.success_m:g}"
    lines = [
        f"# {config.dataset}: a Habitat dataset",
        "",
        f"{len(scenes)} scenes. Put this folder at `{config.dataset_folder}`, seen from where habitat-lab is started; episodes name it so.",
        "",
        "Scenes are opened by their name in the dataset (the table below), not by a file path, so habitat-lab needs an empty `scenes_dir`.",
        "For PointNav take `pointnav/pointnav_habitat_test` as the base, and `pointnav` for `objectnav` in `data_path`.",
        "",
        "```python",
        "from habitat import get_config",
        "",
        "config = get_config(",
        '    "benchmark/nav/objectnav/objectnav_hssd-hab.yaml",',
        "    overrides=[",
        *(f"        '{name}={value}'," for name, value in settings.items()),
        "    ],",
        ")",
        "```",
        "",
        "The agent's settings matter: habitat-sim compares them with the header of every navmesh and, where one differs, bakes",
        "a navmesh of its own without a word; without `navmesh_include_static_objects` that one runs through the furniture.",
        "They are in `metadata/agent.json` too. Steps of 0.25 m cannot always end within 0.1 m of a point; hence 0.2 m.",
        "",
        "- PointNav episodes go to the view point that the trajectory was made for, ObjectNav episodes to any object of the category.",
        "  `info.geodesic_distance` is the way to that one view point; habitat-lab measures the nearest goal itself.",
        "- `info.scene` and `info.episode` name the episode as `metascenes evaluate` wants it in a file of trajectories.",
        "- `iou` of a view point is the share of a level camera's image that the object's box covers, occlusion aside.",
        "- Semantic ids are NYU40 classes (`semantics/`). Pixels of floor and walls are 0.",
        "- Geometry in `objects/` is named by its content and stored once, however many objects and scenes show it.",
        "- Objects are static, as the navmesh needs. Masses and convex colliders are there for those who set `motion_type` to DYNAMIC;",
        "  `margin` is 0, as habitat-sim's default of 4 cm would throw them apart.",
        "- Scenes are lit by lamps under the ceiling (`lights/`); habitat-sim's `no_lights` shows plain colors instead.",
        "- Where an object or a scene comes from is under `user_defined` in `scenes/`; source, author and license of every asset",
        "  are in `metadata/attribution.csv`, which belongs to any copy of the dataset.",
        "",
        "| scene | name here | splits | license of the scan |",
        "|---|---|---|---|",
    ]
    lines += [f"| {scene.scene_id} | `{scene.handle}` | {', '.join(scene.splits) or 'none'} | {scene.license} |" for scene in scenes]
    return "\n".join([*lines, ""])
