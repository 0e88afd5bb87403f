"""Policies in scenes: what fails in one of them is that scene's, is written down, and is tried again."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flows.evaluation import flow
from flows.evaluation.acting import PlannedPolicy, act, evaluated, in_this_process, planned_policy
from flows.evaluation.flow import ACTING, ACTION_SECONDS, seconds_for
from flows.evaluation.measuring import Evaluated
from flows.run.configuration import configure
from flows.run.pool import WorkerLost, WorkerTimeout
from flows.run.scene import STAGE_SECONDS
from flows.server.scene_tasks import LOST_RETRIES, PooledScene, in_scene
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.runs import StageRun
from tests.flows.evaluation.stand_ins import let_experts_act
from tests.samples import fingerprint
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_lake
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

MODEL = fingerprint("a model")


@pytest.fixture(scope="module")
def made_lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(acted_lake(tmp_path_factory.mktemp("acted") / "lake").address)


@pytest.fixture
def lake(made_lake: Path, tmp_path: Path) -> Lake:
    return Lake.open(shutil.copytree(made_lake, tmp_path / "lake"))


def planned(lake: Lake) -> PlannedPolicy:
    return planned_policy(lake, MODEL, configure())


def measured(lake: Lake) -> Evaluated:
    """What the flow does, in this process."""
    work = planned(lake)
    runs = {run.scene_id: run for run in in_this_process(work.todo)}
    lake.commit(scenes=work.batches)
    return evaluated(work, runs)


def runs_of(lake: Lake) -> list[StageRun]:
    return [run for run in lake.snapshot().rows(StageRun) if run.stage == "evaluation"]


@pytest.mark.parametrize(
    ("problem", "kind", "text"),
    [
        (ValueError("no\nsuch shape"), "defect", "ValueError: no such shape"),
        (InputError("gamma", "navmesh", "is empty", "make it again"), "input", "gamma: navmesh: is empty; make it again"),
        (ConnectionError("the store is away"), "lost", "ConnectionError: the store is away"),
    ],
)
def test_what_fails_in_one_scene_is_written_down_and_the_others_are_measured(
    lake: Lake, monkeypatch: pytest.MonkeyPatch, problem: Exception, kind: str, text: str
) -> None:
    let_experts_act(monkeypatch, {MODEL: {STUDY: problem}})
    first = measured(lake)
    (line,) = first.failed
    assert line.startswith(f"{STUDY}: {text}")
    assert "\n" not in line
    assert first.scenes == 1
    assert {row.scene_id for row in lake.snapshot().rows(Trajectory)} == {LIVING}
    assert first.new == first.trajectories == len(lake.snapshot().rows(Trajectory)) > 0
    (failed,) = [run for run in runs_of(lake) if run.error]
    assert (failed.error_kind, failed.outcome) == (kind, "lost" if kind == "lost" else "failed")
    assert str(failed.error).startswith(text)
    again = measured(lake)
    assert (again.new, again.failed) == (0, first.failed), "it is tried again, and fails again"
    assert sorted(run.attempt for run in runs_of(lake) if run.error) == [1, 2]
    let_experts_act(monkeypatch, {})
    assert [scene.task.scene_id for scene in planned(lake).todo] == [STUDY]
    mended = measured(lake)
    assert (mended.failed, mended.scenes, mended.new) == ((), 2, mended.trajectories - first.trajectories)
    assert planned(lake).todo == []


def test_a_scene_may_take_longer_the_more_is_to_be_done_in_it(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    let_experts_act(monkeypatch, {})
    scene = planned(lake).scenes[0]
    assert seconds_for(scene) == STAGE_SECONDS + ACTION_SECONDS * scene.episodes * 500
    shorter = planned_policy(lake, MODEL, configure(settings=["evaluation.max_steps=20"])).scenes[0]
    assert seconds_for(shorter) == STAGE_SECONDS + ACTION_SECONDS * shorter.episodes * 20


class PoolStandIn:
    """A pool whose calls end with an error. calls: What was asked for, and for how long."""

    def __init__(self, error: Exception) -> None:
        self.error, self.calls = error, list[tuple[Any, float]]()

    def call(self, function: Callable[..., Any], argument: Any, *, timeout: float) -> Any:
        assert function is act
        self.calls.append((argument, timeout))
        raise self.error


@pytest.mark.parametrize(
    ("problem", "count", "kind"),
    [(WorkerLost("killed by signal 9"), LOST_RETRIES + 1, "lost"), (WorkerTimeout("took more than 7 s"), 1, "timeout")],
)
def test_a_worker_that_does_not_come_back_leaves_a_row(
    lake: Lake, monkeypatch: pytest.MonkeyPatch, problem: Exception, count: int, kind: str
) -> None:
    let_experts_act(monkeypatch, {})
    whole = planned(lake)
    scene = whole.todo[0]
    monkeypatch.setenv("PREFECT__RUNTIME__TASK_RUN__RUN_COUNT", str(count))
    pool = PoolStandIn(problem)
    work = PooledScene(scene, ACTING, pool)  # type: ignore[arg-type]
    state = in_scene.fn("a scene", work)
    assert state.is_failed()
    assert state.message == str(problem)
    assert pool.calls == [(scene.task, seconds_for(scene))]
    assert work.run is not None
    assert (work.run.scene_id, work.run.error_kind, work.run.error) == (scene.batch_id, kind, str(problem))
    lake.commit()
    (row,) = runs_of(lake)
    assert (row.scene_id, row.error_kind, row.outcome) == (scene.batch_id, kind, "lost" if kind == "lost" else "failed")
    done = evaluated(whole, {scene.batch_id: work.run})
    assert done.failed == (f"{scene.task.scene_id}: {problem}",)
    assert scene.batch_id in {each.batch_id for each in planned(lake).todo}, "the next run tries it again"


def test_a_lost_worker_is_tried_again_before_it_counts(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    let_experts_act(monkeypatch, {})
    work = PooledScene(planned(lake).todo[0], ACTING, PoolStandIn(WorkerLost("killed")))  # type: ignore[arg-type]
    for count in range(1, LOST_RETRIES + 1):
        monkeypatch.setenv("PREFECT__RUNTIME__TASK_RUN__RUN_COUNT", str(count))
        with pytest.raises(WorkerLost):
            in_scene.fn("a scene", work)
    assert work.run is None
    lake.commit()
    assert runs_of(lake) == []


def test_the_run_ends_as_failed_where_a_scene_did(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(flow, "run_log", lambda line, **_: lines.append(line))
    whole = Evaluated("navigation", "abc", ("navigation-1",), 6, 1, 6)
    assert flow._state([whole]).is_completed()
    broken = Evaluated("expert", "built-in", ("expert-1",), 6, 1, 6, (), (f"{STUDY}: ValueError: no",))
    state = flow._state([whole, broken])
    assert state.is_failed()
    assert f"expert: {STUDY}: ValueError: no" in str(state.message)
    assert f"expert: {STUDY}: ValueError: no" in lines
