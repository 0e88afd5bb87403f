"""The coordinator's parts where runs meet, stores go away and commits fail: nothing spins, waits for ever or is counted wrongly."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from flows.run.configuration import configure
from flows.run.fanout.backlog import Backlog
from flows.run.fanout.committer import MANY_SCENES, Committer
from flows.run.fanout.coordinator import Coordinator, FanOut
from flows.run.fanout.pools import pool_of, shared_pool
from flows.run.fanout.runners import task_runner
from flows.run.plan import Plan, ScenePlan, make_plan
from flows.run.pool import PoolStopped
from flows.run.report import report_of
from flows.run.scene import job_of
from flows.worker import lost_run
from tasks.capture.formats import find_scans
from tests.flows.run.test_fanout import Futures
from tests.scans import write_scans
from warehouse.lake import Lake


@pytest.fixture
def plan(tmp_path: Path) -> tuple[Plan, Lake]:
    """Six scenes to do, of one scan's files."""
    write_scans(tmp_path / "scans", 1)
    lake = Lake.open(tmp_path / "lake")
    one = make_plan(lake, *find_scans(tmp_path / "scans"), configure()).scenes[0]
    scenes = tuple(dataclasses.replace(one, scan=dataclasses.replace(one.scan, scan=f"scene{n:04}_00")) for n in range(6))
    return Plan(scenes, ()), lake


def fail(lake: Lake, scene: ScenePlan) -> None:
    """Leave a staged run of a scene's first stage, which failed."""
    job = job_of(lake, scene, scene.todo[0], configure())
    lake.stage_rows(dataclasses.replace(lost_run(job, "defect", "bad", 1.0)), {})


def over(scene: ScenePlan) -> ScenePlan:
    return dataclasses.replace(scene, steps=tuple(dataclasses.replace(step, action="reuse") for step in scene.steps))


def test_a_commit_that_keeps_failing_is_tried_again_after_a_pause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.run.fanout.committer.PAUSE_SECONDS", 3600.0)
    folder = tmp_path / "lake"
    lake = Lake.open(folder)
    lake.blobs.put(b"there is a lake", "bin")
    (folder / "staged").mkdir()
    (folder / "staged" / f"s@captions@{'0' * 8}@ffffffff-1-2-3@stage_runs.parquet").write_bytes(b"no Parquet")
    with Committer(lake) as committer:
        for number in range(MANY_SCENES + 1):
            committer.add(f"s/{number}")
        while "commit put off" not in (said := capsys.readouterr().err):
            time.sleep(0.05)
        time.sleep(1.5)  # it looks once a second whether anything is due
        said += capsys.readouterr().err
    assert said.count("commit put off: InputError") == 1


def test_the_pool_of_a_run_that_is_over_is_not_replaced_by_another() -> None:
    with shared_pool("run", 1) as pool:
        assert pool_of("run") is pool
    with pytest.raises(PoolStopped):
        pool_of("run")


@pytest.mark.parametrize(("scenes", "workers"), [(1, 1), (2, 2), (5, 3)])
def test_no_run_starts_more_workers_than_it_has_scenes(scenes: int, workers: int) -> None:
    from flows.pipeline import computing

    with computing("run", FanOut(workers=3), scenes):
        assert pool_of("run").workers == workers


def test_scenes_of_another_run_are_no_longer_counted_as_left(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    names = [scene.scan.scene_id for scene in found.scenes]
    scenes = {scene.scan.scene_id: scene for scene in found.scenes}
    for name in names[:2]:
        fail(lake, scenes[name])

    def replan(scene: ScenePlan, retry: bool) -> ScenePlan:
        if scene.scan.scene_id == names[0]:  # whole
            return over(scene)
        return dataclasses.replace(scene, steps=(*over(scene).steps[:-1], scene.steps[-1]))  # all but the last stage

    told: list[tuple[int, int]] = []
    made = Coordinator(found, lake, configure(), FanOut(workers=2, keep_free_gb=0), replan, retry_failed=False)
    outcome = made.run(Futures(lambda name: False), lambda done, total, text: told.append((done, total)), {})
    steps = sum(len(scene.todo) for scene in found.scenes)
    assert told[-1] == (steps, steps)
    assert outcome.shared == [names[0]]
    assert len(outcome.results) == 5


def test_what_a_lost_worker_had_finished_counts_as_this_runs(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    names = [scene.scan.scene_id for scene in found.scenes]

    class Lost(Futures):
        """The worker goes after its scenes, and before it says so."""

        def results(self, future: Any) -> Any:
            for scene in future.batch.scenes:
                if scene.scan.scene_id in names[:2]:
                    fail(lake, scene)
            return super().results(future)

    def replan(scene: ScenePlan, retry: bool) -> ScenePlan:
        if scene.scan.scene_id == names[0]:
            return over(scene)
        past = lake.history({scene.scan.scene_id})[scene.scan.scene_id, scene.steps[0].stage].last
        waits = (dataclasses.replace(step, action="wait") for step in scene.steps[1:])
        return dataclasses.replace(scene, steps=(dataclasses.replace(scene.steps[0], action="report", before=past), *waits))

    tasks = Lost(lambda name: name in names[:2])
    spread = FanOut(workers=2, runner="dask", batch=1, keep_free_gb=0)
    told = report_of(found, Coordinator(found, lake, configure(), spread, replan, retry_failed=False).run(tasks, lambda *_: None, {}))
    assert set(told.done) == {names[0], *names[2:]}
    assert told.failed == (names[1],)
    assert told.failures == (f"{names[1]}: {found.scenes[1].steps[0].stage}: bad",)
    assert (told.known, told.shared) == ((), ()), "nobody else computed anything"


def test_a_scene_that_is_committed_between_two_looks_is_seen(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan

    class Meanwhile(Lake):
        """Another run commits right after the next look, whichever that is."""

        commits = False

        def last_commit(self) -> str:
            return self._after(super().last_commit())

        def has_staged(self, scene_id: str) -> bool:
            return self._after(super().has_staged(scene_id))

        def _after(self, seen: Any) -> Any:
            if self.commits:
                self.commits = False
                assert lake.commit() is not None
            return seen

    watched = Meanwhile(lake.storage)
    with watched.claims() as claims:
        backlog = Backlog(watched, found, claims, Committer(watched), lambda scan, retry: over(found.scenes[1]), False)
        assert backlog.take(1) == [found.scenes[0]]
        fail(lake, found.scenes[1])
        watched.commits = True
        assert backlog.take(1) == []
    assert backlog.shared[0] == found.scenes[1].scan.scene_id


def test_a_scan_that_cannot_be_read_any_more_is_not_called_up_to_date(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    fail(lake, found.scenes[0])
    made = Coordinator(found, lake, configure(), FanOut(workers=2, keep_free_gb=0), lambda scan, retry: None, retry_failed=False)
    told = report_of(found, made.run(Futures(lambda name: False), lambda *_: None, {}))
    assert len(told.done) == 6
    assert told.unchanged == ()


def test_processes_that_are_at_work_do_not_hold_up_the_end_of_a_run() -> None:
    workers: list[psutil.Process] = []

    def interrupted() -> None:
        with task_runner("processes", 1) as runner:
            runner._executor.submit(time.sleep, 300)
            workers.extend(psutil.Process(pid) for pid in runner._executor._processes)
            raise KeyboardInterrupt

    clock = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - clock < 100
    assert len(workers) == 1
    assert psutil.wait_procs(workers, timeout=300)[1] == []
