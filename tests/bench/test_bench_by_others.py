"""Scans by others beside the hard rooms: which are there, what is said of them, and what stays blank."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

import bench.dwellings
from bench.dwellings import DwellingsBench, OthersJob, measure_by_others, run_dwellings_bench
from bench.dwellings.by_others import BY_OTHERS, held_by, judged_by_others, nothing_known
from bench.dwellings.judgement import FIGURES
from bench.dwellings.replicas import BenchReplica
from bench.dwellings.tables import print_dwellings
from bench.realdata import HOUSE, LIVING_ROOM, MODELS
from bench.samples import sample
from flows.commands.bench import rooms
from flows.run.pool import WorkerLost
from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene
from schemas.errors import InputError
from schemas.fidelity import SceneFidelity
from schemas.optimization import Certificate, Optimization, Placement, Support
from tasks.geometry.transforms import flat, translation
from tasks.scanner import ScanTruth, TrueObject
from tests.bench.pools import NoPool

BY_NAME = {scan.name: scan for scan in BY_OTHERS}

ABOUT_TRUTH = {
    "objects", "free", "annotated_share", "stable_1cm", "stable_5cm", "stable_nudged", "unseen_objects", "anchored", "fitted_left_out",
    "off_15cm", "off_30cm", "openings", "silhouette", "openings_seen", "categories_right", "true_rooms", "rooms_right", "unseen",
    "anchored_share", "ways", "ways_open", "regions_per_object", "optimization_cpu_per_25", "rugs",
    "rugs_5cm",
}  # fmt: skip
"""Figures that only a truth gives, or that only generated rooms have."""


def replica() -> BenchReplica:
    """Five objects and a floor: one fixed, one that moved and falls at 1 cm, one that was left out, two that are right."""
    names = [f"{k:04d}" for k in range(6)]
    instances = {
        name: sample(Instance, instance_id=name, source_id=str(k), category="chair", is_structure=k == 5) for k, name in enumerate(names)
    }
    asset = "a" * 64
    placed = [name for name in names if name not in ("0002", "0005")]
    return BenchReplica(
        scene=sample(Scene, alignment=flat(np.eye(4))),
        room=None,
        rooms=[sample(Room, room_index=0)],
        instances=instances,
        placements={
            name: sample(
                Placement, instance_id=name, asset_id=asset, scale=(1.0, 1.0, 1.0), optimized_pose=flat(np.eye(4)),
                displacement_m=0.2 if name == "0001" else 0.0, lift_m=-0.25 if name == "0001" else 0.0,
            )
            for name in placed
        },
        supports={name: sample(Support, instance_id=name, is_fixed=name == "0000") for name in placed},
        certificates={
            name: sample(
                Certificate, instance_id=name, engine="mujoco", is_fixed=name == "0000", is_stable_1cm=name != "0001", is_stable_5cm=True,
                is_stable_nudged=name == "0003",
            )
            for name in placed
        },
        assets={asset: sample(Asset, asset_id=asset, extents=(1.0, 1.0, 1.0))},
        optimization=sample(Optimization, deep_pairs=3),
        fidelity=sample(SceneFidelity, object_f_5cm=0.7, unexplained_share=0.2),
        parts=[],
    )  # fmt: skip


def truth() -> ScanTruth:
    """The five chairs, one of them a stool and 20 cm off, one that the annotation lacks, and a floor."""

    def obj(k: int, category: str, number: int | None, x: float) -> TrueObject:
        return TrueObject(f"o{k}", category, number, flat(translation([x, 0.0, 0.0])), (1.0, 1.0, 1.0), "floor", 1.0)

    objects = [obj(0, "chair", 0, 0.0), obj(1, "stool", 1, 0.2), obj(2, "chair", 2, 0.0), obj(3, "chair", 3, 0.0), obj(4, "chair", 4, 0.0)]
    objects += [obj(6, "vase", None, 0.0), obj(5, "floor", 5, 0.0)]
    return ScanTruth("house", flat(np.eye(4)), "", (), None, 5, tuple(objects))


def test_without_truth_only_the_scan_and_the_replica_are_told() -> None:
    figures = judged_by_others(BY_NAME["living_room"], None, replica(), {"capture": 8.0, "selection": 2.0, "fidelity": 100.0})
    assert {key for key, _, _ in FIGURES if math.isnan(figures[key])} == ABOUT_TRUTH
    assert (figures["annotated_1cm"], figures["annotated_5cm"], figures["annotated_nudged"]) == (2 / 4, 3 / 4, 1 / 4)
    assert (figures["left_out"], figures["deep_pairs"], figures["moved_15cm"], figures["moved_30cm"]) == (1, 3, 1, 1)
    assert (figures["object_f_5cm"], figures["unexplained_share"], figures["rooms_found"]) == (0.7, 0.2, 1)
    assert (figures["seconds"], figures["seconds_per_25"]) == (10.0, 50.0)


def test_a_truth_adds_what_it_knows_and_nothing_else() -> None:
    blank = judged_by_others(BY_NAME["living_room"], None, replica(), {})
    figures = judged_by_others(BY_NAME["house"], truth(), replica(), {})
    assert (figures["objects"], figures["left_out"], figures["off_15cm"], figures["off_30cm"]) == (6, 2, 1, 0)
    assert figures["categories_right"] == 3 / 4
    known = {"objects", "off_15cm", "off_30cm", "categories_right"}
    assert {key for key, _, _ in FIGURES if math.isnan(figures[key])} == ABOUT_TRUTH - known
    same = [key for key, _, _ in FIGURES if key not in ABOUT_TRUTH | {"left_out"}]
    assert [figures[key] for key in same] == [blank[key] for key in same]


def test_a_turned_world_is_no_distance_from_the_truth() -> None:
    turn = np.array([[0.0, -1.0, 0.0, 4.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
    straight = replica()
    placements = {
        name: dataclasses.replace(row, optimized_pose=flat(turn @ np.array(row.optimized_pose).reshape(4, 4)))
        for name, row in straight.placements.items()
    }
    turned = dataclasses.replace(straight, scene=dataclasses.replace(straight.scene, alignment=flat(turn)), placements=placements)
    assert judged_by_others(BY_NAME["house"], truth(), turned, {})["off_15cm"] == 1


def report_of(others: list[dict], absent: list[str]) -> dict:
    return {
        "machine": {"processor": "p", "cores": 1, "system": "s", "python": "3", "versions": {}}, "seed": 0, "processes": 1, "rooms": [],
        "settings": [], "warm_up_seconds": None,
        "groups": {}, "others": others, "not_measured": absent, "errors": [], "goals": [],
    }  # fmt: skip


def test_what_has_no_truth_is_blank_in_the_table() -> None:
    text = StringIO()
    figures = judged_by_others(BY_NAME["living_room"], None, replica(), {})
    print_dwellings(report_of([figures], ["the house: [absent]"]), Console(file=text, width=200))
    lines = text.getvalue().splitlines()
    assert "synthetic living room" in text.getvalue()
    assert "not measured: the house: [absent]" in lines
    for key, words, _ in FIGURES:
        (cells,) = [line[len(words) :] for line in lines if line.startswith(words + "  ")] or [""]
        assert bool(cells.strip()) is (key not in ABOUT_TRUTH), words


# --- which are there ---------------------------------------------------------------------------------------------------


def folder_with(place: Path, *parts: Path) -> Path:
    for part in parts:
        path = place / part
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix:
            path.write_bytes(b"glTF")
        else:
            path.mkdir()
            (path / "frame.txt").write_text("1")
    return place


def test_what_is_absent_is_named(tmp_path: Path) -> None:
    assert [scan.name for scan in held_by(folder_with(tmp_path / "both", HOUSE, MODELS, LIVING_ROOM))[0]] == ["house", "living_room"]
    held, absent = held_by(folder_with(tmp_path / "house", HOUSE, MODELS))
    assert [scan.name for scan in held] == ["house"]
    assert absent == [f"the synthetic living room: {tmp_path / 'house'} does not hold {LIVING_ROOM}"]
    held, absent = held_by(folder_with(tmp_path / "poor", HOUSE, LIVING_ROOM))
    assert [scan.name for scan in held] == ["living_room"]
    assert absent == [f"the AWS small house: {tmp_path / 'poor'} does not hold {MODELS}"]
    assert [line.partition(":")[0] for line in held_by(None)[1]] == ["the AWS small house", "the synthetic living room"]
    for empty in (tmp_path, tmp_path / "no_such"):
        with pytest.raises(InputError, match="--realdata: holds neither"):
            held_by(empty)


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> type[NoPool]:
    class Pool(NoPool):
        def answer(self, function: object, job: OthersJob) -> dict:
            assert function is measure_by_others
            return nothing_known(job.scan, "capture", "a test")

    monkeypatch.setattr(bench.dwellings, "WorkerPool", Pool)
    return Pool


def test_they_are_measured_once_until_their_files_change(tmp_path: Path, pool: type[NoPool]) -> None:
    realdata = folder_with(tmp_path / "real", HOUSE, MODELS, LIVING_ROOM)
    config = DwellingsBench(0, 0, 1, tmp_path / "kept", realdata)
    first = run_dwellings_bench(config, lambda _: None)
    assert pool.calls == config.steps == 2
    assert [row["room"] for row in first["errors"]] == ["house", "living_room"]
    assert [goal["met"] for goal in first["goals"]] == [False]
    again = run_dwellings_bench(config, lambda _: None)
    assert pool.calls == 2
    assert json.dumps(again["others"]) == json.dumps(first["others"])
    (realdata / LIVING_ROOM / "frame.txt").write_text("2")
    run_dwellings_bench(config, lambda _: None)
    assert pool.calls == 3


def test_a_worker_that_dies_is_named_and_not_remembered(tmp_path: Path, pool: type[NoPool]) -> None:
    pool.error = WorkerLost("the worker died")
    realdata = folder_with(tmp_path / "real", LIVING_ROOM)
    report = run_dwellings_bench(DwellingsBench(0, 0, 1, tmp_path, realdata), lambda _: None)
    assert report["errors"] == [{"room": "living_room", "stage": "worker", "error": "the worker died"}]
    assert list(tmp_path.glob("*.json")) == []


def test_the_command_asks_for_something_to_measure(tmp_path: Path, pool: type[NoPool]) -> None:
    nothing = {"METASCENES_REALDATA": ""}
    assert CliRunner().invoke(rooms, ["--rooms", "0"], env=nothing).exit_code == 2
    realdata = folder_with(tmp_path / "real", LIVING_ROOM)
    done = CliRunner().invoke(rooms, ["--rooms", "0", "--processes", "1", "--realdata", str(realdata), "--json"], env=nothing)
    assert done.exit_code == 1
    report = json.loads(done.stdout)
    assert report["others"][0]["stable_1cm"] is None
    assert len(report["not_measured"]) == 1


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.timeout(3600)
def test_the_living_room_goes_through_the_pipeline(tmp_path: Path, realdata: Callable[[str], Path]) -> None:
    figures = measure_by_others(OthersJob(BY_NAME["living_room"], str(realdata(str(LIVING_ROOM)).parent), str(tmp_path)))
    assert figures["error"] is None
    assert 0.0 < figures["object_f_5cm"] <= 1.0
    assert {key for key, _, _ in FIGURES if math.isnan(figures[key])} == ABOUT_TRUTH
