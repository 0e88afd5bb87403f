"""What habitat-lab itself makes of a dataset's episodes. Run by an interpreter that has requirements/habitat_lab.lock.

Its simulator cannot be installed with pip; whatever of magnum, corrade and habitat_sim it imports is an empty stand-in,
since datasets are read without it.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import json
import os
import sys
import types
from pathlib import Path
from typing import Any

_ABSENT = ("magnum", "corrade", "habitat_sim")


class _Known(type):
    """The type of stand-in classes: every attribute of one is another."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _stand_in(name)


def _stand_in(name: str) -> Any:
    """A class that can be made with any arguments, derived from, and asked for anything."""
    return _Known(name, (), {"__init__": lambda self, *args, **kwargs: None, "__getattr__": lambda self, name: _stand_in(name)})


class _Module(types.ModuleType):
    """A module that has whatever is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _stand_in(name)


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the absent packages and everything below them."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True) if fullname.split(".")[0] in _ABSENT else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return _Module(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def read(snippet: str) -> dict[str, Any]:
    """Run the README's lines, which configure habitat-lab, and load the dataset that they name."""
    from habitat.datasets import make_dataset

    names: dict[str, Any] = {}
    exec(snippet, names)
    config = names["config"].habitat
    dataset = make_dataset(config.dataset.type, config=config.dataset)
    text = dataset.to_json()
    again = type(dataset)()
    again.from_json(text, scenes_dir="")
    agent = config.simulator.agents.main_agent
    return {
        "kind": type(dataset).__name__,
        "episodes": [episode_of(episode) for episode in dataset.episodes],
        "maps": {name: getattr(dataset, name) for name in vars(dataset) if name.startswith("category_to_")},
        "document": json.loads(text),
        "document_again": json.loads(again.to_json()),
        "agent": [float(agent.radius), float(agent.height), float(agent.max_climb), float(agent.max_slope)],
        "static_objects": bool(config.simulator.navmesh_include_static_objects),
        "motion": [float(config.simulator.forward_step_size), float(config.simulator.turn_angle)],
        "success_distance": float(config.task.measurements.success.success_distance),
    }


def episode_of(episode: Any) -> dict[str, Any]:
    """What an episode object holds; goals are those that the task would go to, which ObjectNav looks up by category."""
    goals = [
        {"position": goal.position, "radius": goal.radius, "object_id": getattr(goal, "object_id", None),
         "views": [[view.agent_state.position, view.agent_state.rotation, view.iou] for view in getattr(goal, "view_points", None) or []]}
        for goal in episode.goals
    ]  # fmt: skip
    return {
        "scene_id": episode.scene_id, "scene_dataset_config": episode.scene_dataset_config,
        "has_config": Path(episode.scene_dataset_config).is_file(),
        "start_position": episode.start_position, "start_rotation": episode.start_rotation, "info": episode.info, "goals": goals,
        "object_category": getattr(episode, "object_category", None),
        "shortest_paths": [[[point.position, point.rotation, point.action] for point in path] for path in episode.shortest_paths or []],
    }  # fmt: skip


def tried(folder: str, snippet: str) -> dict[str, Any]:
    """The same from where habitat-lab is started, or the name of the error that it stops with."""
    os.chdir(folder)
    try:
        return read(snippet)
    except Exception as error:
        return {"error": type(error).__name__}


if __name__ == "__main__":
    sys.meta_path.insert(0, _Finder())
    json.dump([tried(**one) for one in json.loads(sys.argv[1])], sys.stdout, default=list)
