"""Asset selection where the scanned model is known: rooms and their truth, lineups without a leak, simulated annotations, figures."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial import cKDTree

from bench.selection import catalog, measures, rooms
from bench.selection import data as data_module
from bench.selection.annotations import annotate, answers_of, batch_of, carried_on, give
from bench.selection.data import DataSettings, SelectionData, counts_of, generate
from bench.selection.foreign import made_house, model_of
from bench.selection.lineups import OF_SCANNED
from bench.selection.measures import MeasuredMethod, measured_room, source_digest
from bench.selection.naming import Naming, naming_report
from bench.selection.report import (
    BUNDLED,
    DEFAULT,
    PLAIN,
    TAUGHT,
    SelectionBench,
    margin,
    run_selection_bench,
    table_row,
    top,
    true_surfaces,
)
from bench.selection.rooms import held_out, is_hard, made_room, split_of_room
from flows.cli import cli
from flows.run.fingerprints import code_fingerprint
from schemas.annotation import Annotation, AnswerVerdict, QualityReview
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.navigation import Split
from schemas.record import rows_to_arrow
from schemas.selection import Selection
from tasks.annotation.simulation import AnnotatorRule, order
from tasks.geometry.meshes import read_points, sample_surface, surface_of, surface_of_glb
from tasks.geometry.transforms import inverse, transform_points
from tasks.selection.methods.model import ModelScores
from warehouse.lake import Lake
from warehouse.tables.gate import batch_states
from warehouse.tables.reviews import standing_answers

TRAIN, TEST = 3, 2
"""A kitchen to learn from and a living room that is held out."""

FEW = 5
"""Things in a room that tests scan."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SelectionData:
    """Two little rooms, answered for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rooms, "OBJECTS", FEW)
        patch.setattr(catalog, "ROOMS", 24)
        made = SelectionData(tmp_path_factory.mktemp("data"), DataSettings())
        assert [truth["split"] for truth in generate(made, [TEST, TRAIN]) if isinstance(truth, dict)] == ["test", "train"]
    assert len(list(annotate(made.lake, made.truths(), made.settings.rule, made.settings.seed))) == 1
    return made


def test_a_fifth_of_the_categories_is_in_no_training_room_and_in_test_rooms() -> None:
    rare = held_out(0)
    assert len(rare) == 24
    splits: dict[str, set[str]] = {"train": set(), "test": set()}
    for index in range(12):
        splits[split_of_room(index)] |= {obj.category for obj in made_room(index, 0).furnished.objects} if not is_hard(index) else set()
    assert not splits["train"] & rare
    assert len(splits["test"] & rare) >= 3


@pytest.mark.whole
def test_what_is_exchanged_stands_in_the_same_box_and_what_it_carries_stays_on_it() -> None:
    room = made_room(TRAIN, 0).furnished
    names = {obj.name for obj in room.objects}
    assert all(obj.parent in names or obj.parent in ("floor", "wall", "ceiling") for obj in room.objects)
    for obj in room.objects:
        assert np.ptp(surface_of(obj.parts).vertices, axis=0) == pytest.approx(obj.extents, abs=1e-6)


@pytest.mark.slow
@pytest.mark.whole
def test_the_true_model_lies_on_the_scan_of_its_instance(data: SelectionData) -> None:
    reader = data.lake.snapshot()
    for truth in data.truths():
        surfaces = true_surfaces_of(truth)
        points_of = {row.instance_id: row for row in reader.rows(Instance, truth["scene_id"])}
        assert len(truth["instances"]) >= 3
        for name, true in surfaces.items():
            points, _ = read_points(data.lake.blobs[points_of[name].points_blob])
            samples = transform_points(sample_surface(true.surface, 20_000, np.random.default_rng(0))[0], true.pose)
            assert cKDTree(samples).query(points)[0].mean() < 0.03


def true_surfaces_of(truth: Any) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rooms, "OBJECTS", FEW)
        return true_surfaces(truth, 0)


@pytest.mark.slow
@pytest.mark.whole
def test_rows_are_those_of_any_lake_and_ten_candidates_differ(data: SelectionData) -> None:
    reader = data.lake.snapshot()
    assets = {row.asset_id: row for row in reader.rows(Asset)}
    for truth in data.truths():
        by_instance: dict[str, list[Candidate]] = {}
        for row in reader.rows(Candidate, truth["scene_id"]):
            by_instance.setdefault(row.instance_id, []).append(row)
        selected = Counter(row.instance_id for row in reader.rows(Selection, truth["scene_id"]))
        assert set(by_instance) == set(truth["instances"]) == set(selected)
        for name, rows in by_instance.items():
            slots = truth["instances"][name]["slots"]
            assert [row.asset_id for row in rows] == [slot["asset_id"] for slot in slots]
            assert len({row.asset_id for row in rows}) == len(rows) == selected[name] == 10
            assert sum(slot["kind"] == "scanned" for slot in slots) <= 1
            assert all(row.asset_id in assets for row in rows)
    assert {row.room_id: row.split for row in reader.rows(Split)} == {truth["room_id"]: truth["split"] for truth in data.truths()}
    assert {row.room_id for row in reader.rows(Scene)} == {truth["room_id"] for truth in data.truths()}


@pytest.mark.slow
@pytest.mark.whole
def test_the_scanned_asset_is_the_scanned_model_and_no_field_of_its_rows_says_so(data: SelectionData) -> None:
    reader = data.lake.snapshot()
    assets, found = {row.asset_id: row for row in reader.rows(Asset)}, 0
    for truth in data.truths():
        candidates = {(row.instance_id, row.slot): row for row in reader.rows(Candidate, truth["scene_id"])}
        for name, true in true_surfaces_of(truth).items():
            kinds = {slot: held["kind"] for slot, held in enumerate(truth["instances"][name]["slots"], start=1)}
            for slot, kind in kinds.items():
                row, asset = candidates[name, slot], assets[candidates[name, slot].asset_id or ""]
                if kind == "scanned":
                    found += 1
                    mesh = surface_of_glb(data.lake.blobs[asset.mesh_blob])
                    assert np.sort(mesh.vertices, axis=0) == pytest.approx(np.sort(true.surface.vertices, axis=0), abs=1e-5)
                if kind not in ("crop", "parametric"):
                    said = (row.provider, row.provider_version, row.is_fallback, row.reason, asset.source, asset.license, asset.pieces_blob)
                    assert said == ("procedural", "2", False, None, "furniture generator", "CC0-1.0", None)
                    assert asset.name == asset.category
    assert found >= 3


@pytest.mark.whole
def test_simulated_answers_pass_the_gate_and_every_row_and_view_calls_them_simulated(data: SelectionData) -> None:
    reader = data.lake.snapshot()
    (state,) = batch_states(reader).values()
    assert (state.state, state.counts, state.origin) == ("accepted", True, "created")
    instances = {(truth["scene_id"], name) for truth in data.truths() for name in truth["instances"]}
    answers = reader.rows(Annotation)
    assert {(row.scene_id, row.instance_id) for row in answers} == instances
    assert standing_answers(reader).num_rows == len(answers) == len(instances)
    rows: list[Any] = [*answers, *reader.rows(AnswerVerdict), *reader.rows(QualityReview)]
    assert all(row.is_simulated for row in rows)
    assert len(reader.rows(QualityReview)) == 1
    assert all(len(row.ranking) == 5 and row.ranking[0] == row.choice for row in answers)
    connection = reader.connect()
    for view in ("current_answers", "selection_training"):
        assert connection.execute(f"SELECT DISTINCT is_simulated FROM {view}").fetchall() == [(True,)]
    assert list(annotate(data.lake, data.truths(), data.settings.rule, 0)) == []


@pytest.mark.whole
def test_answers_by_chance_are_returned_with_remarks_and_count_for_nothing(data: SelectionData, tmp_path: Path) -> None:
    shutil.copytree(data.folder, tmp_path / "data")
    lake, kept = Lake.open(tmp_path / "data" / "lake"), data.truths()[:1]
    lake.remove_scene(data.truths()[1]["scene_id"])
    name = batch_of(kept[0]["scene_id"]) + "-again"
    careless = AnnotatorRule(mistakes=1.0)
    given = [row | {"annotator": "simulated-9"} for row in answers_of(kept[0], careless, 5, 0)]
    worst = [max(range(10), key=lambda k: known["slots"][k]["total"]) + 1 for _, known in sorted(kept[0]["instances"].items())]
    give(lake, name, [row | {"choice": slot, "ranking": [slot]} for row, slot in zip(given, worst, strict=True)], 0)
    assert carried_on(lake, name, kept).endswith("returned")
    reader = lake.snapshot()
    assert not batch_states(reader, [name])[name].counts
    assert all(row.remark for row in reader.rows(AnswerVerdict) if row.batch_id == name and not row.passes)
    assert "simulated-9" not in standing_answers(reader).column("annotator").to_pylist()


@pytest.mark.whole
def test_choices_are_those_of_the_rule(data: SelectionData) -> None:
    agree = total = 0
    chosen = {(row.scene_id, row.instance_id): row.choice for row in data.lake.snapshot().rows(Annotation)}
    for truth in data.truths():
        for name, known in truth["instances"].items():
            best = min(known["slots"], key=lambda slot: slot["total"])
            agree, total = agree + (chosen[truth["scene_id"], name] == best["asset_id"]), total + 1
    assert agree / total > 0.6


@pytest.mark.slow
@pytest.mark.whole
def test_the_same_seed_gives_the_same_rows_blobs_and_truth(data: SelectionData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rooms, "OBJECTS", FEW)
    monkeypatch.setattr(catalog, "ROOMS", 24)
    other = SelectionData(tmp_path / "again", DataSettings())
    (truth,) = (row for row in generate(other, [TRAIN]) if isinstance(row, dict))
    known = next(row for row in data.truths() if row["index"] == TRAIN)
    assert json.dumps(truth | {"cpu_seconds": 0}) == json.dumps(known | {"cpu_seconds": 0})
    for record in (Scene, Instance, Candidate, Selection):
        rows = [made.lake.snapshot().rows(record, truth["scene_id"]) for made in (data, other)]
        assert rows_to_arrow(rows[0], record).equals(rows_to_arrow(rows[1], record))


@pytest.mark.whole
def test_what_is_there_is_not_made_again_and_other_settings_are_refused(data: SelectionData) -> None:
    before = data.lake.snapshot().snapshot_id
    assert list(generate(data, [TRAIN, TEST])) == []
    assert data.lake.snapshot().snapshot_id == before
    with pytest.raises(InputError, match="other settings"):
        SelectionData(data.folder, DataSettings(seed=1))
    counts = counts_of(data.truths())
    assert counts["rooms"] == {"train": 1, "test": 1}
    assert counts["held_out"]["train"] == 0


@pytest.mark.whole
def test_methods_are_measured_where_they_hit_and_what_was_measured_is_remembered(data: SelectionData, tmp_path: Path) -> None:
    reader = data.lake.snapshot()
    truth = next(row for row in data.truths() if row["split"] == "test")
    surfaces = true_surfaces_of(truth)
    scorers = [MeasuredMethod(name, config) for name, config in PLAIN.items()]
    rows = measured_room(data.lake, reader, truth, surfaces, scorers[:2], "x", tmp_path, 0)
    assert len(rows) == 2 * len(truth["instances"])
    ranks = {row.instance_id: row.rank for row in reader.rows(Selection, truth["scene_id"]) if _is_best(truth, row)}
    for row in rows:
        if row.method == "geometric":  # the lake's ranks are those of the geometric method, but for what several share
            assert row.truth_rank == ranks[row.instance_id]
        assert row.best_chamfer_m is not None
        assert row.chamfer_m is not None
        assert row.best_chamfer_m <= row.chamfer_m
    more = measured_room(data.lake, reader, truth, {}, scorers, "x", tmp_path, 0)
    assert [row for row in more if row.method in ("geometric", "extents")] == rows
    assert table_row(rows[: len(truth["instances"])], 0)["instances"] == len(truth["instances"])
    own = {slot["asset_id"] for known in truth["instances"].values() for slot in known["slots"] if slot["kind"] in OF_SCANNED}
    assert all(row.is_chosen_own == (row.chosen_asset_id in own) for row in more)


def test_what_is_remembered_hangs_on_the_code_that_measured_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = source_digest("measures")
    assert before != source_digest("foreign")
    (tmp_path / "measures.py").write_text(Path(measures.__file__).read_text() + "# another\n")
    monkeypatch.setattr(measures, "__file__", str(tmp_path / "measures.py"))
    assert source_digest("measures") != before


def _is_best(truth: Any, row: Selection) -> bool:
    slots = truth["instances"][row.instance_id]["slots"]
    return slots[row.slot - 1]["total"] == min(slot["total"] for slot in slots)


def test_rooms_of_other_code_are_known_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = SelectionData(tmp_path)
    assert data.is_of_this_code
    for changed in ("tasks.scanner.dwellings", "tasks.candidates", "tasks.selection.evidence"):
        with monkeypatch.context() as patch:
            patch.setattr(
                data_module, "code_fingerprint", lambda module, changed=changed: code_fingerprint(module) + (module == changed) * "x"
            )
            assert not SelectionData(tmp_path).is_of_this_code
    monkeypatch.setattr(data_module, "source_digest", lambda *modules: "another")
    assert not SelectionData(tmp_path).is_of_this_code
    assert SelectionData(tmp_path / "new").is_of_this_code


def test_the_rule_of_answers_is_the_rule_of_truth() -> None:
    still = dataclasses.replace(AnnotatorRule(), noise=0.0, mistakes=0.0)
    totals = [0.3, 0.0, 1.0]
    assert order(totals, still, np.random.default_rng(0))[0][0] == int(np.argmin(totals))


def asked(lake: Path, question: str) -> list[dict[str, Any]]:
    with Lake.open(lake).snapshot().connect() as connection:
        rows: list[dict[str, Any]] = connection.sql(question).to_arrow_table().to_pylist()
    return rows


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.timeout(900)
def test_the_whole_benchmark_on_two_rooms_trains_measures_and_goes_on(
    data: SelectionData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch")
    monkeypatch.setattr(rooms, "OBJECTS", FEW)
    monkeypatch.setattr(catalog, "ROOMS", 24)
    shutil.copytree(data.folder, tmp_path / "data")
    config = SelectionBench(tmp_path, rooms=4, seeds=1, steps=2, variants=("small", "blind"), methods=(ModelScores("small", within=0.0),))
    told: list[str] = []
    report = run_selection_bench(config, told.append)
    assert len(told) == config.steps_of_progress
    assert set(report["methods"]) == {*PLAIN, DEFAULT, BUNDLED, TAUGHT, "small", "blind"}
    assert set(report["margin"]) == {*PLAIN, DEFAULT, BUNDLED, TAUGHT, "blind"}
    assert top(report["methods"], TAUGHT) == top(report["methods"], "geometric"), "it chooses among the best alone"
    assert [row["name"] for row in report["trainings"]] == ["small", "blind"]
    assert report["counts"]["rooms"]["test"] == len(config.tested)
    assert 0 < report["naming"]["shares"]["all"]["by_model"]["examples"] <= report["counts"]["instances"]["test"]
    shown = asked(tmp_path / "data" / "lake", "FROM selection_methods WHERE training_id = 'bench-selection'")
    assert {row["method"] for row in shown} == set(report["methods"])
    for row in shown:
        figures = report["methods"][row["method"]]["figures"]
        for name in ("top_1", "top_5", "chamfer_m", "ecd_m", "box_iou", "color_kl", "regret_chamfer_m"):
            assert row[name] == figures[name]["value"]
        assert (row["top_1_low"], row["top_1_high"]) == (figures["top_1"]["low"], figures["top_1"]["high"])
    again = run_selection_bench(config, lambda text: None)
    assert again["methods"] == report["methods"]
    assert again["trainings"] == report["trainings"]
    assert asked(tmp_path / "data" / "lake", "FROM selection_methods WHERE training_id = 'bench-selection'") == shown
    (counted,) = asked(tmp_path / "data" / "lake", "SELECT count(*) AS rows, count(DISTINCT method) AS methods FROM selection_outcomes")
    assert counted["methods"] == len(report["methods"])
    assert counted["rows"] == sum(row["instances"] * row["seeds"] for row in report["methods"].values())


def test_names_count_by_whichever_word_and_the_confusion_is_of_what_was_learned() -> None:
    rows = [
        Naming("a", "sofa", True, "couch", "sofa"), Naming("a", "sofa", True, "bed", "sofa"), Naming("b", "plate", True, "object", "plate"),
        Naming("b", "table", True, "kitchen table", "vase"), Naming("b", "keyboard", False, "object", "book"),
    ]  # fmt: skip
    report = naming_report(rows, 0)
    shares = {group: [report["shares"][group][who]["value"] for who in ("by_rules", "by_model")] for group in report["shares"]}
    assert shares == {"all": [0.4, 0.6], "learned": [0.5, 0.75], "ruled": pytest.approx([2 / 3, 2 / 3])}
    assert report["confusion"] == {"sofa": {"sofa": 2}, "plate": {"plate": 1}, "table": {"vase": 1}}


@pytest.mark.parametrize(
    ("methods", "named"),
    [
        (["geometric"], "geometric is none of clip, acdc, vision_language, model"),
        (['{kind="clip", weights="a"}', '{kind="clip", weights="b"}'], "clip is named twice"),
        (['{kind="clip", weight="a"}'], "selection.provider.weight"),
        (["clip"], "names no folder"),
    ],
)
def test_a_method_that_cannot_be_measured_too_is_refused(methods: list[str], named: str, tmp_path: Path) -> None:
    told = [part for method in methods for part in ("--method", method)]
    done = CliRunner().invoke(cli, ["bench", "selection", "--folder", str(tmp_path / "selection"), *told])
    assert done.exit_code
    assert named in " ".join(done.output.split()) or named in str(done.exception)
    assert not (tmp_path / "selection").exists()


def test_margins_are_of_the_same_instances() -> None:
    assert margin([], 0) == {}


def test_a_copy_of_a_model_is_called_by_its_number() -> None:
    assert [model_of(name) for name in ("ChairA_01_003", "PortraitA_01", "FoldingDoor_02_001")] == [
        "ChairA_01",
        "PortraitA_01",
        "FoldingDoor_02",
    ]


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.timeout(3600)
def test_the_house_is_lined_up_against_its_own_models(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    folder = realdata("scene_aws_small_house").parent
    realdata("assets")
    lake, truth = made_house(folder, tmp_path, 0)
    assert len(truth["instances"]) >= 30
    for known in truth["instances"].values():
        assert [slot["kind"] for slot in known["slots"]].count("scanned") == 1
        assert len(known["slots"]) == 10
        assert known["scan_distance_m"] < 0.04
    assert made_house(folder, tmp_path, 0)[1] == truth
    assert {row.instance_id for row in lake.snapshot().rows(Selection, truth["scene_id"])} == set(truth["instances"])
    assert inverse(np.array(truth["moved"])).shape == (4, 4)
