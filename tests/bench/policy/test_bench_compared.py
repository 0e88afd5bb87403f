"""The comparison of datasets by the benchmark: the same rooms as drawn and as replicas, a house, and the table as it comes out."""

from __future__ import annotations

import hashlib
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
from bench.rooms import PLAIN
from bench.samples import sample
from flows.cli import cli
from schemas.candidates import Asset
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.navigation import Episode, Split
from schemas.optimization import Placement
from tasks.furniture import generate
from tasks.furniture.rooms import FurnishedRoom
from tasks.geometry.meshes import dump_glb
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader


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
        "house/house", "generated/scene0000_00", "replicas/scene0000_00", "generated/scene0001_00", "replicas/scene0001_00"
    ]  # fmt: skip
    same, other = furnished_room(1, 0), furnished_room(1, 0)
    assert [(obj.name, obj.category) for obj in same.objects] == [(obj.name, obj.category) for obj in other.objects]
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(same.objects, other.objects, strict=True))
    others = [ComparedDatasets(tmp_path, tmp_path, **changed) for changed in ({"rooms": 3}, {"seed": 1}, {"episodes": 9}, {})]
    others.append(ComparedDatasets(tmp_path, folder_with_a_house(tmp_path / "real"), rooms=2))
    assert len({data.mark, *(other.mark for other in others)}) == 6
    assert ComparedDatasets(tmp_path, tmp_path / "nothing", rooms=2).mark == data.mark


def test_scenes_are_made_in_turn_and_those_that_failed_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for part in (HOUSE, MODELS / "one.glb"):
        (tmp_path / part).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / part).write_bytes(b"glTF")
    data = ComparedDatasets(tmp_path / "bench", tmp_path, rooms=1)
    made: list[tuple[str, int]] = []

    def make(data: ComparedDatasets, job: tuple[str, int]) -> str | None:
        made.append(job)
        return "capture: is empty" if job[0] == "replicas" else None

    monkeypatch.setattr(datasets, "make_scene", make)
    advanced: list[str] = []
    assert make_datasets(data, 1, advanced.append) == ["replicas/scene0000_00: capture: is empty"]
    assert made == data.jobs
    assert advanced == [scene_of(*job) for job in data.jobs]
    with pytest.raises(InputError, match=r"--realdata: holds no .*house\.glb"):
        make_datasets(ComparedDatasets(tmp_path / "bench", tmp_path / "nowhere"), 1, advanced.append)


def test_a_stage_that_fails_is_named_each_time_and_its_scan_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = ComparedDatasets(tmp_path, tmp_path, rooms=1)
    scanned: list[FurnishedRoom] = []

    def scan(room: FurnishedRoom, out: Path, name: str, config: Any, rng: Any) -> None:
        (out / name).mkdir(parents=True)  # no leftover is in its way
        scanned.append(room)
        (out / name / f"{name}_vh_clean_2.ply").write_bytes(b"ply\nbroken")
        (out / name / f"{name}.aggregation.json").write_text("{}")

    monkeypatch.setattr(datasets, "scan_scene", scan)
    problems = [datasets.make_scene(data, ("replicas", 4)) for _ in range(3)]
    assert problems[0] is not None
    assert problems[0].startswith("capture: ")
    assert len({*problems}) == 1, "what failed before is no success"
    same = furnished_room(4, 0)
    assert len(scanned) == 3
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(scanned[0].objects, same.objects, strict=True))


def test_a_generated_room_is_in_the_lake_as_it_was_drawn(tmp_path: Path) -> None:
    data = ComparedDatasets(tmp_path, tmp_path, rooms=1, episodes=5)
    datasets.make_scene(data, ("generated", 1))
    data.lake.commit("a room")
    reader = data.lake.snapshot()
    room: FurnishedRoom = furnished_room(1, 0)
    assert reader.rows(Scene)[0].dataset == "generated"
    rows = {row.instance_id: row for row in reader.rows(Placement)}
    categories = {row.instance_id: row.category for row in reader.rows(Instance)}
    assets = {row.asset_id: row for row in reader.rows(Asset)}
    assert any(item.category in PLAIN for item in room.objects), "one of those that benchmarks exchange"
    assert len(rows) == len(room.objects)
    for number, item in enumerate(room.objects):
        assert categories[f"{number:04d}"] == item.category
        assert assets[rows[f"{number:04d}"].asset_id].mesh_blob.startswith(hashlib.sha256(dump_glb(item.parts)).hexdigest())
        assert np.allclose(np.array(rows[f"{number:04d}"].optimized_pose).reshape(4, 4), item.pose)
    assert [row.split for row in reader.rows(Split)] == ["train"]


def report(**changed: Any) -> dict[str, Any]:
    row = {
        "trained_on": "replicas", "tested_on": "house", "seeds": 3, "n": 300, "episodes": 100,
        "sr": 0.32, "sr_low": 0.27, "sr_high": 0.38,
        "success_distance_m": 0.2, "least_sr": 0.3, "greatest_sr": 0.35,
        "found_share": 0.25, "el": 33.71, "curvature_turning_angle_per_m": 0.46, "sel": 0.3156, "spl": 0.2691,
    }  # fmt: skip
    test = {
        "first": "generated", "second": "replicas", "measure": "success", "pairs": 300, "difference": -0.052, "p_value": 0.0123,
        "p_value_by_seed": None,
    }  # fmt: skip
    figures = {
        "comparison_id": "comparison-1", "rooms": {"generated": 24, "replicas": 23, "house": 1}, "seeds": 3,
        "episodes": {"generated": 2400, "replicas": 2300, "house": 100},
        "rows": [row], "tests": [test], "notes": ["house: 1 scene to test in, not 2"], "failed": [],
    }  # fmt: skip
    return {**figures, "goals": [], **changed}


def test_the_table_says_what_came_out() -> None:
    where = {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}
    page = io.StringIO()
    parts = {COMPARED: report(failed=["replicas/scene0003_00: capture: is empty"])}
    print_policy({"machine": where, "seed": 0, "processes": 1, "parts": parts, "goals": []}, Console(file=page, width=180))
    text = page.getvalue()
    for words in ("32.0 (27.0-38.0)", "30.0-35.0", "33.7", "0.46", "31.6", "26.9", "-5.2", "0.0123", "n/a",
                  "23 with 2,300 episodes of replicas", "within 0.2 m",
                  "house: 1 scene to test in", "failed: replicas/scene0003_00: capture: is empty"):  # fmt: skip
        assert words in text


def test_without_the_house_nothing_is_compared_and_that_is_said(tmp_path: Path) -> None:
    done = CliRunner().invoke(
        cli, ["bench", "policy", "--parts", "compared", "--folder", str(tmp_path / "policy")], env={"METASCENES_REALDATA": ""}
    )
    assert done.exit_code == 0
    assert "not compared: METASCENES_REALDATA or --realdata names" in done.output
    assert PolicyBench(tmp_path, rooms=75, realdata=tmp_path).comparison == ComparisonBench(tmp_path, tmp_path, rooms=24)
    stages = ComparisonBench(tmp_path, tmp_path).configuration.stages
    assert stages["training"].system.walks.stop_m < stages["evaluation"].success_m, "who stops as experts do succeeds"
    assert PolicyBench(tmp_path, rooms=5, realdata=tmp_path, parts=(COMPARED,)).advances == 2 * 5 + 1 + 3 * 3 + 1


def test_goals_are_of_how_much_was_compared_not_of_who_won(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Done:
        comparison_id, notes, tests = "comparison-1", (), ()
        rows = ({"episodes": 60}, {"episodes": 60})

    scenes = {"generated": 20, "replicas": 19, "house": 1}

    def rows(_: Any) -> list[Any]:
        return [sample(Episode, scene_id=f"{name}/{k}") for name, count in scenes.items() for k in range(count) for _ in range(2)]

    monkeypatch.setattr(compared, "make_datasets", lambda *_: ["replicas/scene0003_00: capture: is empty"])
    monkeypatch.setattr(compared, "_trained", lambda config, number: number)
    monkeypatch.setattr(compared, "planned", lambda config: None)
    monkeypatch.setattr(compared, "compare", lambda *_: Done)
    monkeypatch.setattr(Reader, "rows", lambda self, record: rows(record))
    advanced: list[str] = []
    config = ComparisonBench(tmp_path, tmp_path, rooms=24, seeds=2)
    Lake.open(config.data.lake.address).commit("nothing")
    found = compared.measure_comparison(config, advanced.append)
    assert [row["met"] for row in found["goals"]] == [False, False, False, True, False]
    assert len(advanced) == len(CHOICES) * 2 + 1
    assert found["episodes"] == {"generated": 40, "replicas": 38, "house": 2}
    scenes["house"] = 0
    with pytest.raises(InputError, match=r"house: has no episodes: replicas/scene0003_00: capture: is empty; give more --rooms"):
        compared.measure_comparison(config, advanced.append)


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
    monkeypatch.setattr(compared, "act", refuse)
    again = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert json.loads(again.stdout)["parts"][COMPARED] == seen
