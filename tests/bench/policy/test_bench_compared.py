"""The comparison of datasets by the benchmark: the same rooms as drawn and as replicas, a house, and the table as it comes out."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from rich.console import Console

from bench.policy import compared, datasets
from bench.policy.compared import CHOICES, ComparisonBench, planned
from bench.policy.datasets import ComparedDatasets, furnished_room, make_datasets, scene_of
from bench.policy.report import COMPARED, PolicyBench
from bench.policy.tables import print_policy
from bench.realdata import HOUSE, MODELS
from flows.cli import cli
from schemas.capture import Instance, Scene
from schemas.errors import InputError, LakeError
from schemas.navigation import Split
from schemas.optimization import Placement
from tasks.furniture import generate
from tasks.furniture.rooms import FurnishedRoom
from tasks.geometry.meshes import dump_glb
from warehouse.lake import Lake


def folder_with_a_house(folder: Path) -> Path:
    """Real data in which the house is a room of the generator."""
    room = furnished_room(9, 5)
    scene = trimesh.Scene()
    for name, part in room.named_parts(ceiling=False):
        scene.add_geometry(part, node_name=name, geom_name=name)
    scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # +Y up, as files have it
    (folder / HOUSE).parent.mkdir(parents=True)
    (folder / HOUSE).write_bytes(scene.export(file_type="glb"))
    (folder / MODELS).mkdir()
    (folder / MODELS / "stool.glb").write_bytes(dump_glb(generate("stool", None, np.random.default_rng(0)).parts))
    return folder


def test_both_datasets_are_of_the_same_rooms_and_the_house_is_made_once(tmp_path: Path) -> None:
    data = ComparedDatasets(tmp_path, tmp_path, rooms=2)
    assert [scene_of(*job) for job in data.jobs] == [
        "generated/scene0000_00", "replicas/scene0000_00", "generated/scene0001_00", "replicas/scene0001_00", "house/house"
    ]  # fmt: skip
    same, other = furnished_room(1, 0), furnished_room(1, 0)
    assert [(obj.name, obj.category) for obj in same.objects] == [(obj.name, obj.category) for obj in other.objects]
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(same.objects, other.objects, strict=True))
    assert ComparedDatasets(tmp_path, tmp_path, rooms=2, seed=1).mark != data.mark != ComparedDatasets(tmp_path, tmp_path, rooms=3).mark


def test_scenes_are_made_in_turn_and_those_without_episodes_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for part in (HOUSE, MODELS / "one.glb"):
        (tmp_path / part).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / part).write_bytes(b"glTF")
    data = ComparedDatasets(tmp_path / "bench", tmp_path, rooms=1)
    made: list[tuple[str, int]] = []
    monkeypatch.setattr(datasets, "make_scene", lambda data, job: made.append(job) or job)
    advanced: list[str] = []
    assert make_datasets(data, 1, advanced.append) == [f"{scene_of(*job)}: has no episodes" for job in data.jobs]
    assert made == data.jobs
    assert advanced == [scene_of(*job) for job in data.jobs]
    with pytest.raises(InputError, match=r"--realdata: holds no .*house\.glb"):
        make_datasets(ComparedDatasets(tmp_path / "bench", tmp_path / "nowhere"), 1, advanced.append)


def test_a_stage_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = ComparedDatasets(tmp_path, tmp_path, rooms=1)

    def unseen(*_: Any, **__: Any) -> None:
        raise InputError("scene", "mesh", "shows nothing", "scan it again")

    monkeypatch.setattr(datasets, "scan_scene", lambda room, out, scan, config, rng: (out / scan).mkdir(parents=True))
    with pytest.raises(LakeError, match=r"replicas/scene0000_00: capture: "):
        datasets.make_scene(data, ("replicas", 0))
    monkeypatch.setattr(datasets, "scan_scene", unseen)
    with pytest.raises(InputError, match="shows nothing"):
        datasets.make_scene(data, ("replicas", 0))


def test_a_generated_room_is_in_the_lake_as_it_was_drawn(tmp_path: Path) -> None:
    data = ComparedDatasets(tmp_path, tmp_path, rooms=1, episodes=5)
    datasets.make_scene(data, ("generated", 1))
    data.lake.commit("a room")
    reader = data.lake.snapshot()
    room: FurnishedRoom = furnished_room(1, 0)
    assert reader.rows(Scene)[0].dataset == "generated"
    rows = {row.instance_id: row for row in reader.rows(Placement)}
    categories = {row.instance_id: row.category for row in reader.rows(Instance)}
    assert len(rows) == len(room.objects)
    for number, item in enumerate(room.objects):
        assert categories[f"{number:04d}"] == item.category
        assert np.allclose(np.array(rows[f"{number:04d}"].optimized_pose).reshape(4, 4), item.pose)
    assert [row.split for row in reader.rows(Split)] == ["train"]


def report(**changed: Any) -> dict[str, Any]:
    row = {
        "trained_on": "replicas", "tested_on": "house", "seeds": 3, "n": 300, "episodes": 100, "sr": 0.32, "sr_low": 0.27, "sr_high": 0.38,
        "least_sr": 0.3, "greatest_sr": 0.35, "found": 0.25, "el": 33.71, "curvature_turning_angle": 0.46, "sel": 0.3156, "spl": 0.2691,
    }  # fmt: skip
    test = {
        "first": "generated", "second": "replicas", "measure": "success", "pairs": 300, "difference": -0.052, "p_value": 0.0123,
        "p_value_by_seed": None,
    }  # fmt: skip
    figures = {
        "comparison_id": "comparison-1", "rooms": 24, "seeds": 3, "episodes": {"generated": 2400, "replicas": 2300, "house": 100},
        "rows": [row], "tests": [test], "notes": ["replicas/scene0003_00: has no episodes"], "failed": [],
    }  # fmt: skip
    return {**figures, "goals": [], **changed}


def test_the_table_says_what_came_out() -> None:
    where = {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}
    page = io.StringIO()
    parts = {COMPARED: report(failed=["house/house: no navmesh"])}
    print_policy({"machine": where, "seed": 0, "processes": 1, "parts": parts, "goals": []}, Console(file=page, width=180))
    text = page.getvalue()
    for words in ("32.0 (27.0-38.0)", "30.0-35.0", "33.7", "0.46", "31.6", "26.9", "-5.2", "0.0123", "n/a", "2,300 of replicas",
                  "replicas/scene0003_00: has no episodes", "failed: house/house: no navmesh"):  # fmt: skip
        assert words in text


def test_without_the_house_nothing_is_compared_and_that_is_said(tmp_path: Path) -> None:
    done = CliRunner().invoke(
        cli, ["bench", "policy", "--parts", "compared", "--folder", str(tmp_path / "policy")], env={"METASCENES_REALDATA": ""}
    )
    assert done.exit_code == 0
    assert "not compared: METASCENES_REALDATA or --realdata names" in done.output
    assert PolicyBench(tmp_path, rooms=75, realdata=tmp_path).comparison == ComparisonBench(tmp_path, tmp_path, rooms=24)
    assert PolicyBench(tmp_path, rooms=5, realdata=tmp_path, parts=(COMPARED,)).advances == 2 * 5 + 1 + 3 * 3 + 1


def test_goals_are_of_how_much_was_compared_not_of_who_won(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Done:
        comparison_id, notes, tests = "comparison-1", (), ()
        rows = ({"episodes": 60}, {"episodes": 60})
        failed = ("house/house: no navmesh",)

    monkeypatch.setattr(compared, "make_datasets", lambda *_: [])
    monkeypatch.setattr(compared, "_trained", lambda config, number: number)
    monkeypatch.setattr(compared, "planned", lambda config: None)
    monkeypatch.setattr(compared, "compare", lambda *_: Done)
    Lake.open(ComparedDatasets(tmp_path, tmp_path, 24).place / "lake").commit("nothing")
    advanced: list[str] = []
    config = ComparisonBench(tmp_path, tmp_path, seeds=2)
    found = compared.measure_comparison(config, advanced.append)
    assert [row["met"] for row in found["goals"]] == [False, False, False]
    assert len(advanced) == len(CHOICES) * 2 + 1
    assert found["episodes"] == {"generated": 0, "replicas": 0, "house": 0}


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.timeout(1800)
def test_datasets_are_compared_and_the_command_goes_on_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    realdata = folder_with_a_house(tmp_path / "real")
    words = ["bench", "policy", "--parts", "compared", "--rooms", "2", "--episodes", "4", "--seeds", "2", "--steps", "3",
             "--processes", "1", "--folder", str(tmp_path / "policy"), "--realdata", str(realdata), "--json"]  # fmt: skip
    first = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert first.exit_code == 1, first.output  # four episodes are too few
    seen = json.loads(first.stdout)["parts"][COMPARED]
    assert {row["trained_on"] for row in seen["rows"]} == {"generated", "replicas", "generated+replicas"}
    assert {(row["tested_on"], row["n"], row["seeds"], row["episodes"]) for row in seen["rows"]} == {("house", 8, 2, 4)}
    assert {test["pairs"] for test in seen["tests"]} == {8}
    assert len(seen["tests"]) == 3 * 2
    config = ComparisonBench(tmp_path / "policy", realdata, 2, 2, 3, episodes=4)
    models = {each.planned.held.model_id for each in planned(config).trainings if each.planned.held is not None}
    assert len(models) == 6, "each choice of datasets gives models of its own"

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("was made before")

    monkeypatch.setattr(datasets, "make_scene", refuse)
    monkeypatch.setattr(compared, "train", lambda lake, planned: planned.held or refuse())
    again = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert json.loads(again.stdout)["parts"][COMPARED] == seen
