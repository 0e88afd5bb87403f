"""A small lake with scenes to act in for tests: two rooms with furniture, their navmeshes and episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from schemas.candidates import Candidate
from schemas.capture import Scene, Shell
from schemas.navigation import Episode, Navmesh
from tasks.navigation import NavigationConfig, run, split_of
from tasks.stage import Context
from tests.samples import fingerprint, sample, stage_run
from tests.tasks.navigation.test_navigation import furnished, living_room
from tests.tasks.navigation.test_shortest_paths import solid
from warehouse.lake import Lake

CONFIG = NavigationConfig(train_episodes=6, test_episodes=6)
LIVING, STUDY = "demo/living_00", "demo/study_00"
TRAIN, TEST = "demo/room_a", "demo/room_c"
assert (split_of(TRAIN, CONFIG.test_share), split_of(TEST, CONFIG.test_share)) == ("train", "test")


@dataclasses.dataclass(frozen=True)
class ActedScene:
    """Rows of a scene by table, and the blobs that they name."""

    rows: dict[str, list[Any]]
    blobs: dict[str, bytes]

    @property
    def navmesh(self) -> bytes:
        (row,) = self.rows["navmeshes"]
        assert isinstance(row, Navmesh)
        return self.blobs[row.navmesh_blob]

    @property
    def episodes(self) -> list[Episode]:
        return self.rows["episodes"]


def study() -> tuple[dict, Context]:
    return furnished({
        "0001": ("desk", [solid((1.2, 0.6, 0.75))], (1.0, 0.4, 0.0), 0.0),
        "0002": ("chair", [solid((0.45, 0.45, 0.45)), solid((0.05, 0.45, 0.5), (-0.2, 0, 0.45))], (1.1, 1.1, 0.0), 1.5),
        "0003": ("shelf", [solid((0.4, 1.2, 1.8))], (3.2, 1.5, 0.0), 0.0),
    }, size=(3.5, 3.0))  # fmt: skip


@cache
def acted_scene(scene_id: str) -> ActedScene:
    """One of the two scenes: made once."""
    tables, context = living_room() if scene_id == LIVING else study()
    room_id = TRAIN if scene_id == LIVING else TEST
    renamed: dict[str, list[Any]] = {
        name: [dataclasses.replace(row, scene_id=scene_id) if hasattr(row, "scene_id") else row for row in rows]
        for name, rows in tables.items()
    }
    renamed["scenes"] = [dataclasses.replace(row, room_id=room_id) for row in renamed["scenes"] if isinstance(row, Scene)]
    renamed["shells"] = [dataclasses.replace(row, floor_color=(180, 150, 110), wall_color=(220, 220, 210)) for row in renamed["shells"]
                         if isinstance(row, Shell)]  # fmt: skip
    outcome = run(**renamed, context=Context(scene_id, "navigation", 3, context.blobs), config=CONFIG)
    return ActedScene(renamed | dict(outcome.rows), dict(context.blobs) | dict(outcome.blobs))


def as_scene(made: ActedScene, scene_id: str, room_id: str) -> ActedScene:
    """The same scene by another name, in a room of another name."""
    split = split_of(room_id, CONFIG.test_share)

    def changed(row: Any) -> Any:
        values = {"scene_id": scene_id, "room_id": room_id, "split": split}
        return dataclasses.replace(row, **{name: value for name, value in values.items() if hasattr(row, name)})

    return ActedScene({table: [changed(row) for row in rows] for table, rows in made.rows.items()}, made.blobs)


def acted_lake(folder: Path, scenes: tuple[str, ...] = (LIVING, STUDY)) -> Lake:
    """A lake of some of the scenes, committed."""
    return lake_of_scenes(folder, {scene_id: acted_scene(scene_id) for scene_id in scenes})


def lake_of_scenes(folder: Path, scenes: Mapping[str, ActedScene]) -> Lake:
    """A lake of scenes by their names, committed."""
    lake = Lake.open(folder)
    of = {
        "capture": ("scenes", "shells", "instances"), "candidates": ("candidates", "assets"), "optimization": ("placements",),
        "navigation": ("navmeshes", "episodes", "unreachable_targets", "splits"),
    }  # fmt: skip
    for scene_id, made in scenes.items():
        for name, data in made.blobs.items():
            assert lake.blobs.put(data, name.split(".")[1]) == name
        points = lake.blobs.put(b"points", "ply")
        mesh = lake.blobs.put(b"mesh", "glb")
        rows = made.rows | {
            "instances": [dataclasses.replace(row, points_blob=points) for row in made.rows["instances"]],
            # Assets stay while a candidate names them.
            "candidates": [
                sample(Candidate, scene_id=scene_id, instance_id=row.instance_id, slot=1, outcome="filled", asset_id=row.asset_id)
                for row in made.rows["placements"]
            ],
            "scenes": [dataclasses.replace(row, mesh_blob=mesh) for row in made.rows["scenes"]],
        }
        above: list[str] = []
        for stage, tables in of.items():
            lake.stage_rows(
                stage_run(scene_id, stage, fingerprint(scene_id, stage), *above), {table: rows.get(table, []) for table in tables}
            )
            above = [f"{stage}={fingerprint(scene_id, stage)}"]
    lake.commit("scenes to act in")
    return lake
