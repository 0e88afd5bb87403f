"""The benchmark of learned synthesis: what is kept and what is made again, the truth it holds models against, goals, and a whole run."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench.synthesis import draws, measures, trainings
from bench.synthesis.draws import KeptDraws
from bench.synthesis.house import house_figures, lacking, layouts_of_objects
from bench.synthesis.measures import NEAREST, SHUFFLED, TRUTH, UNGUIDED, Measurement, conditioning, measured, table_in
from bench.synthesis.report import MODEL, SynthesisBench, goals, scene_goals, summed
from bench.synthesis.rooms import ROOM_TYPES
from bench.synthesis.scenes import made_scenes, requests
from bench.synthesis.trainings import PRESETS, Training, TrainingRooms, held_layouts, learned_layouts, trained
from flows.cli import cli
from flows.inputs.synthesis import DrawingModel
from tasks.furniture import tops
from tasks.geometry.transforms import translation, yaw_pose
from tasks.micro_scenes.categories import read_categories
from tasks.scanner.scenery import SceneryObject
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.metrics.distributions import category_kl, category_shares, total_variation
from tasks.training.systems.synthesis import SYNTHESIS
from tasks.training.trained import Trained

ROOMS = TrainingRooms(60, 0)


def places(layouts: list[Layout]) -> set[Any]:
    return {(layout.large, layout.categories) for layout in layouts}


def test_models_are_held_against_rooms_that_none_learned_from_of_the_same_rules() -> None:
    learned, held = learned_layouts(ROOMS), held_layouts(100, ROOMS)
    assert len(held) == 100
    assert not places(learned) & places(held)
    assert {layout.large.category for layout in held} <= {layout.large.category for layout in learned}
    assert category_kl(learned, held_layouts(300, ROOMS)) < 0.1
    assert len(learned) > 150


def test_the_truth_drawn_again_follows_what_is_stated_and_the_baseline_of_another_room_does_not() -> None:
    truth = Measurement(TRUTH, 0, None, ROOMS, 100, 100).draws(Path())
    held = held_layouts(100, ROOMS)
    drawn = truth.draw([layout.large for layout in held], 0)
    assert [layout.large for layout in drawn] == [layout.large for layout in held]
    assert places(drawn) != places(held)
    assert (box_figures(drawn).collides, box_figures(drawn).off_support) == (0.0, 0.0)
    found = conditioning(truth, 60, 0)
    assert set(found) == set(ROOM_TYPES)
    assert all(row["own"] < 0.15 < 0.25 < row["others"] for row in found.values())

    class InKitchens:
        def draw(self, larges: Any, seed: int) -> list[Layout]:
            kitchens = [dataclasses.replace(large, room_type="kitchen") for large in larges]
            return [dataclasses.replace(one, large=large) for one, large in zip(truth.draw(kitchens, seed), larges, strict=True)]

    wrong = conditioning(InKitchens(), 30, 0)
    shares = category_shares(truth.draw([table_in("kitchen")] * 30, measures.HELD))
    assert wrong["kitchen"]["own"] < 0.2 < 0.3 < wrong["office"]["own"]
    assert wrong["office"]["own"] == pytest.approx(total_variation(shares, tops.stated_distribution("table", "office")), abs=0.12)


def test_a_training_is_made_once_and_again_where_anything_it_follows_from_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []

    def train(*, dataset: Any, start: Any, context: Any, config: Any) -> Trained:
        asked.append((context.seed, config.fitting.steps))
        weights = f"{len(asked)}".encode()
        return Trained("physcene", weights, 7, (), (), {"train": 1}, "CC0-1.0", seconds=12.0)

    monkeypatch.setattr(trainings, "train", train)
    first = Training("physcene", 0, TrainingRooms(20, 0), 40)
    model = trained(tmp_path, first)
    assert trained(tmp_path, first) == model
    assert (model.parameters, model.seconds, model.file.read_bytes()) == (7, 12.0, b"1")
    others = [
        dataclasses.replace(first, **change) for change in ({"seed": 1}, {"steps": 41}, {"rooms": TrainingRooms(21, 0)}, {"name": "atiss"})
    ]
    for other in [*others, dataclasses.replace(first, rooms=TrainingRooms(20, 1))]:
        assert trained(tmp_path, other).weights != model.weights
    assert asked == [(0, 40), (1, 40), (0, 41), (0, 40), (0, 40), (0, 40)]
    assert Training("atiss", 0, ROOMS).config.fitting.steps >= 1000
    model.file.unlink()  # killed between the two files, or before
    assert trained(tmp_path, first).file.read_bytes() == b"7"


def test_figures_are_kept_until_what_they_follow_from_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def figures_of(folder: Path, what: Measurement) -> dict[str, float]:
        calls.append(what.name)
        return {"ckl": 0.25}

    monkeypatch.setattr(measures, "figures_of", figures_of)
    what = Measurement(NEAREST, 0, None, ROOMS, 20, 4)
    assert measured(tmp_path, what) == measured(tmp_path, what) == {"name": NEAREST, "seed": 0, "ckl": 0.25}
    for other in (dataclasses.replace(what, scenes=21), dataclasses.replace(what, per_room=5), dataclasses.replace(what, name=TRUTH)):
        measured(tmp_path, other)
    assert calls == [NEAREST, NEAREST, NEAREST, TRUTH]


def test_requests_are_as_even_over_pairs_as_can_be_and_of_what_the_model_knows() -> None:
    known = ("desk", "table", "bed")
    asked = requests(40, known, 0)
    merged = read_categories().merged
    pairs = [pair for pair in tops.PAIRS if merged(pair[0]) in known]
    assert {(request.large, request.room_type) for request, _ in asked} == set(pairs)
    counts = [count for _, count in asked]
    assert (sum(counts), max(counts) - min(counts)) == (40, 1)
    assert len(requests(3, known, 0)) == 3


def perfect(**changes: float) -> dict[str, Any]:
    row = {
        "ckl": 0.01, "collides": 0.0, "off_support": 0.0, "sca": {"value": 0.5}, "nearest": {"ratio": 1.0},
        "rooms": {room_type: {"own": 0.05} for room_type in ROOM_TYPES},
    }  # fmt: skip
    flat_row = {key: value for key, value in changes.items() if "." not in key}
    for key, value in changes.items():
        if key.startswith("rooms."):
            row["rooms"][key.partition(".")[2]]["own"] = value  # type: ignore[index]
        elif "." in key:
            row[key.partition(".")[0]][key.partition(".")[2]] = value  # type: ignore[index]
    return row | flat_row


@pytest.mark.parametrize(
    ("key", "value"),
    [("ckl", 0.05), ("collides", 0.011), ("off_support", 0.011), ("sca.value", 0.61), ("nearest.ratio", 0.7), ("rooms.kitchen", 0.13)],
)
def test_every_goal_is_met_by_the_mean_of_seeds_and_missed_by_one_figure_alone(key: str, value: float) -> None:
    shuffled, quick = summed([{"sca": {"value": 0.95}}]), [{"seconds": 600.0}, {"seconds": 900.0}]
    good = {MODEL: summed([perfect(), perfect()]), "diffuscene": summed([perfect()]), SHUFFLED: shuffled}
    assert all(row["met"] for row in goals(good, quick))
    bad = good | {MODEL: summed([perfect(**{key: value})] * 2), UNGUIDED: summed([perfect(**{key: value})])}
    assert [row["met"] for row in goals(bad, quick)].count(False) == 1
    assert [row["met"] for row in goals(good | {SHUFFLED: summed([{"sca": {"value": 0.8}}])}, quick)].count(False) == 1
    assert [row["met"] for row in goals(good, [{"seconds": 901.0}])].count(False) == 1
    nothing_drawn = goals({MODEL: summed([perfect(ckl=math.nan)])}, [])
    assert [row["goal"] for row in nothing_drawn if row["met"] is False] == [f"CKL of {MODEL}"]


def test_scenes_have_goals_of_their_own() -> None:
    scenes = {"scenes_stable_1cm": 0.99, "moved_median_m": 0.004, "passed": 1.0}
    assert [row["met"] for row in scene_goals(scenes)] == [True] * 3
    for key, value in (("scenes_stable_1cm", 0.98), ("moved_median_m", 0.01), ("passed", 0.99)):
        assert [row["met"] for row in scene_goals(scenes | {key: value})].count(False) == 1
    assert scene_goals({}) == []


def test_the_house_is_what_stands_on_its_large_objects() -> None:
    turn = np.asarray(yaw_pose(0.7, [3.0, 2.0, 0.0]))
    put = [
        ("desk", (0.0, 0.0, 0.0), (0.7, 1.4, 0.75)), ("vase", (0.1, 0.3, 0.75), (0.1, 0.1, 0.3)),
        ("chair", (1.0, 0.0, 0.0), (0.5, 0.5, 0.9)), ("book", (-0.1, -0.3, 0.75), (0.2, 0.15, 0.04)),
        ("floor", (0.0, 0.0, -0.1), (8.0, 8.0, 0.1)),
    ]  # fmt: skip
    objects = [SceneryObject(f"{name}_001", name, turn @ translation(place), np.array(size)) for name, place, size in put]
    (layout,) = layouts_of_objects(objects)
    assert layout.large == Large("desk", (0.7, 1.4, 0.75), "unknown")
    merged = read_categories().merged
    assert layout.categories == (merged("vase"), merged("book"))
    assert layout.centers == pytest.approx(np.array([[0.1, 0.3, 0.9], [-0.1, -0.3, 0.77]]))
    figures = house_figures([layout], [layout], None, [])
    assert (figures["micro_scenes"], figures["objects"], figures["ckl_generated"], figures["drawn_on"]) == (1, 2, 0.0, 0)
    assert math.isnan(figures["ckl_drawn"])
    assert "METASCENES_REALDATA" in str(lacking(None))


def test_the_bar_has_as_many_steps_as_are_advanced(tmp_path: Path) -> None:
    config = SynthesisBench(tmp_path, seeds=2)
    assert len(config.trainings) == len(PRESETS) * 2
    assert config.advances == 6 + 8 * (1 + 4) + 6 * 24 + 4 + 100  # trainings, figures and parts that are drawn, tables, plain ones, scenes
    alone = dataclasses.replace(config, parts=("scenes",))
    assert [training.name for training in alone.trainings] == [MODEL]
    assert alone.advances == 1 + 100
    assert dataclasses.replace(config, models=()).advances == 4


@pytest.mark.slow
@pytest.mark.whole
def test_scenes_of_true_layouts_are_stable_stay_where_they_are_and_pass_the_gates(tmp_path: Path) -> None:
    truth = Measurement(TRUTH, 0, None, ROOMS, 10, 2).draws(Path())

    class Drawer:
        def check(self, large: Large) -> None:
            assert large.category == "nightstand"

        def draw(self, larges: Any, seed: int, numbers: Any) -> list[Layout]:
            return truth.draw(larges, seed)

    made: list[str] = []
    model = DrawingModel("a" * 64, "physcene", "CC0-1.0", "b" * 64, Drawer())
    found = made_scenes(tmp_path, model, ["nightstand"], 1, 0, 1, made.append)
    assert made == ["nightstand, bedroom"]
    assert (found["scenes"], found["failed"], found["broken"]) == (1, [], {})
    assert found["objects"] > 0
    assert all(row["met"] for row in scene_goals(found))
    assert found["stable_5cm"] >= found["stable_1cm"] == found["scenes_stable_1cm"] == 1.0
    assert found["seconds_per_scene"] == pytest.approx(sum(found["seconds"].values()))
    assert {"optimization", "exports"} <= set(found["seconds"])


@pytest.mark.slow
@pytest.mark.whole
def test_a_whole_benchmark_goes_on_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    caches: defaultdict[str, dict[str, bytes]] = defaultdict(dict)
    monkeypatch.setattr(trainings, "ModuleCaches", lambda: caches)
    monkeypatch.delenv("METASCENES_REALDATA", raising=False)
    words = ["bench", "synthesis", "--rooms", "30", "--seeds", "1", "--steps", "20", "--models", "physcene", "--scenes", "12",
             "--per-room", "2", "--parts", "layouts", "--processes", "1", "--folder", str(tmp_path / "synthesis")]  # fmt: skip
    first = CliRunner().invoke(cli, [*words, "--json"], catch_exceptions=False)
    assert first.exit_code == 1, first.output  # twenty steps teach nothing
    report = json.loads(first.stdout)
    assert set(report["figures"]) == {MODEL, UNGUIDED, *(one.name for one in SynthesisBench(tmp_path).plain)}
    assert report["figures"][TRUTH]["collides"]["mean"] == 0.0
    assert report["figures"][NEAREST]["nearest.copies"]["mean"] > 0.5
    assert report["scenes_made"] == {}
    assert [Path(path).name for path in report["pictures"]] == ["rooms.png", "larges.png"]
    assert all(Path(path).stat().st_size > 10_000 for path in report["pictures"])
    assert {row["goal"]: row["met"] for row in report["goals"]}[f"CKL of {MODEL}"] is False

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("was made before")

    assert set(caches) == {"tasks.training.fitting"}
    assert not caches["tasks.training.fitting"]
    for module, name in ((trainings, "train"), (measures, "figures_of"), (measures, "shuffled_figures")):
        monkeypatch.setattr(module, name, refuse)
    again = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert again.exit_code == 1, again.output
    assert "AWS small house" in again.stdout
    assert "MISSED" in again.stdout


def test_what_was_drawn_in_parts_is_what_is_drawn_at_once_and_is_drawn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = Training("atiss", 0, ROOMS)
    shipped = SYNTHESIS.shipped()["atiss"].model
    file = tmp_path / "atiss.safetensors"
    file.write_bytes(shipped.weights)
    model = trainings.TrainedModel(training, file, "f" * 64, 1, 1.0, "cpu")
    monkeypatch.setattr(draws, "PART", 5)
    larges = [layout.large for layout in held_layouts(13, ROOMS)]
    kept = KeptDraws(tmp_path / "drawn", model)
    at_once = model.drawer().draw(larges, 3)
    for _ in range(2):
        drawn = kept.draw(larges, 3)
        assert [layout.categories for layout in drawn] == [layout.categories for layout in at_once]
        for one, other in zip(drawn, at_once, strict=True):
            for name in ("centers", "sizes", "yaws"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert len(list((tmp_path / "drawn").iterdir())) == 3
        assert 0 < kept.seconds(larges, 3) < 1000
        monkeypatch.setattr(draws, "write_whole", None)  # the second time nothing is drawn
    assert kept.parts(larges, 3)[0].mark != kept.parts(larges, 4)[0].mark
    assert kept.parts(larges, 3)[0].mark != KeptDraws(tmp_path, model, measures.NO_GUIDANCE).parts(larges, 3)[0].mark
