"""The dataset as habitat-lab itself reads it, configured by the lines of the dataset's own README."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tasks.exports.config import HabitatConfig
from tasks.exports.habitat.navmesh_file import read_polygons
from tests.conftest import REPOSITORY
from tests.tasks.exports.habitat.habitat_datasets import office, other_room, write_dataset
from tests.tasks.exports.habitat.habitat_episode_damage import EPISODE_DAMAGES

TASKS = {"objectnav": ("ObjectNav-v1", "objectnav/objectnav_hssd-hab"), "pointnav": ("PointNav-v1", "pointnav/pointnav_habitat_test")}
SPLITS = ("train", "test")


def test_the_lock_names_versions_and_no_host() -> None:
    lines = (REPOSITORY / "requirements" / "habitat_lab.lock").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert {"habitat-lab", "numpy", "hydra-core"} <= pins.keys()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where habitat-lab is started: the dataset lies below it as its episodes say."""
    root = tmp_path_factory.mktemp("place")
    made = write_dataset(tmp_path_factory.mktemp("made"), [office(), other_room()])
    target = root / HabitatConfig().dataset_folder
    target.parent.mkdir(parents=True)
    made.rename(target)
    return root


def folder(place: Path) -> Path:
    return place / HabitatConfig().dataset_folder


def snippet(place: Path, task: str, split: str) -> str:
    """The README's Python, changed to another task as the README says, and to another split."""
    text = (folder(place) / "README.md").read_text().split("```python\n")[1].split("```")[0]
    text = text.replace(TASKS["objectnav"][1], TASKS[task][1]).replace("/objectnav/{split}", f"/{task}/{{split}}")
    return text.replace("habitat.dataset.split=train", f"habitat.dataset.split={split}")


def content(place: Path, task: str, split: str) -> list[dict[str, Any]]:
    """The episode files of a split, as written."""
    paths = sorted((folder(place) / task / split / "content").glob("*.json.gz"))
    return [json.loads(gzip.decompress(path.read_bytes())) for path in paths]


@pytest.fixture(scope="module")
def python() -> str:
    path = os.environ.get("METASCENES_HABITAT_LAB_PYTHON", "")
    if not path:
        pytest.skip("METASCENES_HABITAT_LAB_PYTHON names no interpreter with requirements/habitat_lab.lock installed")
    return path


def asked(python: str, questions: list[tuple[Path, str]]) -> list[dict[str, Any]]:
    """What habitat-lab makes of each README's lines, run in a folder."""
    said = json.dumps([{"folder": str(place), "snippet": lines} for place, lines in questions])
    command = [python, str(Path(__file__).with_name("habitat_lab_reader.py")), said]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-4000:]
    return list(json.loads(done.stdout))


@pytest.fixture(scope="module")
def loaded(python: str, place: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """What habitat-lab says of every task and split."""
    keys = [(task, split) for task in TASKS for split in SPLITS]
    found = asked(python, [(place, snippet(place, *key)) for key in keys])
    assert not [one["error"] for one in found if "error" in one]
    return dict(zip(keys, found, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("task", TASKS)
def test_every_episode_is_loaded_as_it_was_written(loaded: dict[Any, Any], place: Path, task: str, split: str) -> None:
    found, files = loaded[task, split], content(place, task, split)
    episodes = [episode for file in files for episode in file["episodes"]]
    goals = {key: value for file in files for key, value in file.get("goals_by_category", {}).items()}
    assert found["kind"].startswith("PointNav" if task == "pointnav" else "ObjectNav")
    assert len(found["episodes"]) == len(episodes) > 0
    for ours, theirs in zip(episodes, found["episodes"], strict=True):
        assert theirs["has_config"], "the episode's scene dataset config is a file, seen from where habitat-lab was started"
        for key in ("scene_id", "scene_dataset_config", "start_position", "start_rotation"):
            assert theirs[key] == ours[key]
        assert {**theirs["info"], **ours["info"]} == theirs["info"]
        steps = [[[s["position"], s["rotation"], s["action"]] for s in path] for path in ours["shortest_paths"]]
        assert steps[0][-1][2] == 0
        if task == "pointnav":
            assert theirs["shortest_paths"] == steps
            expected = ours["goals"]
        else:
            assert theirs["object_category"] == ours["object_category"]
            expected = goals[f"{ours['scene_id']}_{ours['object_category']}"]
        assert [goal["position"] for goal in theirs["goals"]] == [goal["position"] for goal in expected]
        if task == "objectnav":
            states = [[[*v["agent_state"].values(), v["iou"]] for v in goal["view_points"]] for goal in expected]
            assert [goal["views"] for goal in theirs["goals"]] == states
            assert [goal["object_id"] for goal in theirs["goals"]] == [goal["object_id"] for goal in expected]
            assert ours["info"]["target_object_id"] in {goal["object_id"] for goal in theirs["goals"]}


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("task", TASKS)
def test_what_habitat_lab_writes_it_reads_again(loaded: dict[Any, Any], place: Path, task: str, split: str) -> None:
    found = loaded[task, split]
    assert found["document_again"] == found["document"]
    assert len(found["document"]["episodes"]) == len(found["episodes"])
    if task == "objectnav":
        header = json.loads(gzip.decompress((folder(place) / task / split / f"{split}.json.gz").read_bytes()))
        assert found["maps"]["category_to_task_category_id"] == header["category_to_task_category_id"]
        assert found["maps"]["category_to_scene_annotation_category_id"] == header["category_to_scene_annotation_category_id"]


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_the_documented_agent_keeps_every_navmesh(loaded: dict[Any, Any], place: Path, task: str) -> None:
    """habitat-lab asks habitat-sim for these settings; where a navmesh has others, habitat-sim bakes another one."""
    asked = loaded[task, "train"]
    for path in (folder(place) / "navmeshes").glob("*.navmesh"):
        settings = read_polygons(path.read_bytes()).settings
        assert settings is not None
        header = [settings[name] for name in ("agentRadius", "agentHeight", "agentMaxClimb", "agentMaxSlope")]
        assert asked["agent"] == pytest.approx(header, abs=1e-5)
        assert asked["static_objects"] == bool(settings["includeStaticObjects"])
    stated = json.loads((folder(place) / "metadata" / "agent.json").read_text())
    assert asked["motion"] == [stated["forward_step_size"], stated["turn_angle"]]
    assert asked["success_distance"] == stated["success_distance"]


REFUSED = {
    "unknown key in an episode": ("pointnav", "TypeError"),
    "episode without goals": ("pointnav", "ValueError"),
    "bare actions": ("pointnav", "TypeError"),
    "episode without a start": ("objectnav", "ValueError"),
    "unknown key in a goal": ("objectnav", "TypeError"),
    "goal without object": ("objectnav", "ValueError"),
    "no goals of the category": ("objectnav", "KeyError"),
    "no view points": ("objectnav", "TypeError"),
    "view point without iou": ("objectnav", "TypeError"),
    "no category maps": ("objectnav", "AttributeError"),
    "category maps of different keys": ("objectnav", "AssertionError"),
}
"""Kinds of damage that habitat-lab itself stops at, and how. All others it loads without a word."""

SILENT = (
    "start rotation of length 2",
    "start outside",
    "start upstairs",
    "numeric episode id",
    "shorter than straight",
    "no stop",
    "longer steps",
)


@pytest.mark.slow
def test_habitat_lab_stops_where_the_check_says_and_is_silent_elsewhere(python: str, place: Path, tmp_path: Path) -> None:
    """The first scene, which damage is done to, is in the split `train`."""
    questions = []
    for name in (*REFUSED, *SILENT):
        damaged = tmp_path / name.replace(" ", "_")
        shutil.copytree(place, damaged)
        EPISODE_DAMAGES[name].do(folder(damaged))
        task = REFUSED[name][0] if name in REFUSED else "pointnav"
        questions.append((damaged, snippet(damaged, task, "train")))
    found = dict(zip((*REFUSED, *SILENT), (one.get("error") for one in asked(python, questions)), strict=True))
    assert found == {name: error for name, (_, error) in REFUSED.items()} | dict.fromkeys(SILENT)
