"""Comparisons carried out with stand-ins for trainings: what fails, what is erased, and what is withdrawn."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from flows.commands.training.compare import _tell
from flows.comparison.comparing import Compared, answers_of_comparison, compare, left_to_do
from flows.comparison.planning import ComparedTraining, PlannedComparison, asked_comparison, planned_comparison
from flows.evaluation.acting import in_this_process
from flows.training.folders import withdraw_model
from flows.training.training import system_configuration
from schemas.comparison import ComparedRun, PairedTest
from schemas.errors import InputError
from schemas.runs import StageRun
from schemas.training import LearnedModel
from tests.flows.comparison.lakes import compared_lake
from tests.flows.evaluation.stand_ins import let_experts_act
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.upkeep.erasure import erase

pytestmark = pytest.mark.whole

FEW = ("comparison.seeds=2", "comparison.trajectories=3", "evaluation.max_steps=20")


@pytest.fixture(scope="module")
def made_lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(compared_lake(tmp_path_factory.mktemp("compared") / "lake").address)


@pytest.fixture
def lake(made_lake: Path, tmp_path: Path) -> Lake:
    return Lake.open(shutil.copytree(made_lake, tmp_path / "lake"))


def planned(lake: Lake, *settings: str) -> PlannedComparison:
    configuration = system_configuration("navigation", settings=[*FEW, *settings])
    return planned_comparison(lake, asked_comparison(["alpha", "beta"], ["gamma"]), configuration)


def model_of(training: ComparedTraining) -> str:
    return fingerprint(training.trained_on, training.seed)


def carried_out(lake: Lake, *settings: str) -> Compared:
    """Compare, with trainings that leave a model's row and nothing else."""

    def train(training: ComparedTraining) -> LearnedModel:
        values: dict[str, Any] = {"kind": "navigation", "origin": "trained", "architecture": "small", "parent_id": None,
                                  "is_withdrawn": False, "weights_blob": lake.blobs.put(b"weights", "weights")}  # fmt: skip
        name = training.planned.training_id
        row: LearnedModel = sample(LearnedModel, model_id=model_of(training), training_id=name, **values)
        lake.stage_rows(stage_run(name, "training", training.planned.job.fingerprint), {"models": [row]})
        lake.commit()
        return row

    return compare(lake, planned(lake, *settings), train, in_this_process)


def scenes_of(lake: Lake) -> set[str]:
    return {row.scene_id for row in lake.snapshot().rows(ComparedRun)}


def test_a_scene_in_which_one_policy_cannot_act_is_left_out_for_all(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = planned(lake)
    broken = model_of(whole.trainings[-1])
    let_experts_act(monkeypatch, {broken: {"gamma/one": ValueError("no such shape")}})
    first = carried_out(lake)
    (line,) = first.failed
    assert line.startswith("gamma/one: trained on beta: ValueError: no such shape")
    assert (first.trained, first.measured) == (4, 4 * 2 * 3 - 3)
    assert scenes_of(lake) == {"gamma/two"}
    assert [(row["trained_on"], row["scenes"], row["n"], row["sr"]) for row in first.rows] == [("alpha", 1, 6, 1.0), ("beta", 1, 6, 1.0)]
    assert {(test["scenes"], test["seeds"], test["pairs"], test["p_value_by_scene"], test["p_value_by_seed"]) for test in first.tests} == {
        (1, 2, 6, None, 1.0)
    }
    assert [run.error_kind for run in lake.snapshot().rows(StageRun) if run.error] == ["defect"]
    assert left_to_do(lake, planned(lake)) == (0, 3, True), "the next run tries it again"
    let_experts_act(monkeypatch, {})
    mended = carried_out(lake)
    assert (mended.comparison_id, mended.failed, mended.trained, mended.measured) == (first.comparison_id, (), 0, 3)
    assert scenes_of(lake) == {"gamma/one", "gamma/two"}
    assert {(test["scenes"], test["pairs"], test["p_value_by_scene"]) for test in mended.tests} == {(2, 12, 1.0)}
    assert left_to_do(lake, planned(lake)) == (0, 0, False)


def test_where_no_scene_is_left_nothing_is_compared(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    problems: Mapping[str, Exception] = {scene: ValueError("no such shape") for scene in ("gamma/one", "gamma/two")}
    let_experts_act(monkeypatch, {model_of(planned(lake).trainings[0]): problems})
    with pytest.raises(InputError, match=r"^comparison-[0-9a-f]{16}: scenes: none is left: gamma/\w+: trained on alpha: ValueError: no"):
        carried_out(lake)
    assert lake.snapshot().rows(PairedTest) == lake.snapshot().rows(ComparedRun) == []


def test_a_withdrawn_model_is_not_compared(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    let_experts_act(monkeypatch, {})
    done = carried_out(lake)
    assert (len(done.rows), len(done.tests)) == (2, 2)
    row = withdraw_model(lake, model_of(planned(lake).trainings[0]), "it was trained on the wrong rooms")
    with pytest.raises(InputError) as refused:
        planned(lake)
    assert str(refused.value) == (
        f"models: model_id: {row.model_id[:12]}, trained on alpha, was withdrawn; compare with another seed or other settings"
    )
    assert answers_of_comparison(lake, done.comparison_id) == ((), ())


def test_tests_that_counted_an_erased_scene_are_not_shown(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    let_experts_act(monkeypatch, {})
    done = carried_out(lake)
    assert {test["scenes"] for test in done.tests} == {2}
    erased = erase(lake, "gamma/one")
    assert erased.proof is not None
    assert scenes_of(lake) == {"gamma/two"}
    rows, tests = answers_of_comparison(lake, done.comparison_id)
    assert [row["scenes"] for row in rows] == [1, 1], "means are those of what is left"
    assert tests == ()
    assert len(lake.snapshot().rows(PairedTest)) == len(done.tests) > 0


def test_the_command_says_what_each_p_is_about(lake: Lake, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    let_experts_act(monkeypatch, {})
    _tell(carried_out(lake, "comparison.seeds=1", "comparison.scenes=1"))
    lines = capsys.readouterr().out.splitlines()
    (head,) = [line for line in lines if line.endswith("p by seed")]
    assert re.split(" {2,}", head)[-3:] == ["p", "p by scene", "p by seed"]
    assert [line.split()[-3:] for line in lines if " success " in line or " spl " in line] == [["1.0000", "n/a", "n/a"]] * 2
    assert "by one seed there is no p: give --seeds" in lines
    _tell(carried_out(lake, "comparison.seeds=3"))
    assert "by 3 seeds p is 0.25 at least" in capsys.readouterr().out.splitlines()
