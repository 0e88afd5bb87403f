"""Scenes over workers: portions, windows, retries, room on the disk, and how a run ends."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import queue
import statistics
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.commands.run import report_line
from flows.run.configuration import configure
from flows.run.fanout.batch import SceneBatch
from flows.run.fanout.coordinator import LOST_SCENES, Coordinator, FanOut, RunOutcome
from flows.run.fanout.pace import RECENT, SHARE, TASK_SECONDS, Pace
from flows.run.fanout.quota import Quota
from flows.run.plan import Plan, make_plan
from flows.run.report import RunReport, report_of
from flows.run.scene import SceneResult, SceneWork, job_of
from flows.scans.choice import settled
from flows.scans.mirror import FetchError
from flows.worker import _passes, lost_run
from schemas.errors import InputError
from schemas.runs import StageRun
from tasks.capture.formats import find_scans
from tests.scans import write_scans
from warehouse.lake import Lake
from warehouse.storage.refusals import StoreAway


def test_the_quota_measures_what_is_there(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    name = lake.blobs.put(os.urandom(2_000_000), "bin")
    assert name in lake.blobs
    assert Quota(lake, keep_free_gb=0, quota_gb=0.01).reason() is None
    assert "holds 2 MB, --quota is 2 MB" in str(Quota(lake, keep_free_gb=0, quota_gb=0.002).reason())
    assert Quota(lake, keep_free_gb=0).reason() is None
    assert "has" in str(Quota(lake, keep_free_gb=1e9).reason())


class OnePool:
    """A pool whose worker answers with a row of its own making."""

    def __init__(self, error: str) -> None:
        self.calls = 0
        self._error = error

    def call(self, function: Any, job: Any, timeout: float, label: Any) -> Any:
        self.calls += 1
        return lost_run(job, "lost", self._error, 0.0)


def test_a_full_disk_stops_the_run_and_a_store_that_is_away_is_another_try(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    for error, is_full in (("OSError: [Errno 28] No space left on device: 'x'", True), ("StoreAway: does not answer", False)):
        work = SceneWork(found.scenes[0])
        told = work.advance(lake, configure(), OnePool(error))  # type: ignore[arg-type]
        assert (told.is_full, told.is_lost, work.is_finished) == (is_full, not is_full, is_full)
    assert _passes(OSError(errno.ENOSPC, "no room"))
    assert _passes(StoreAway("s3://b/l", "host"))
    assert not _passes(ValueError("wrong"))
    assert not _passes(FileNotFoundError(errno.ENOENT, "gone"))


def result(scene: str, seconds: float = 1.0, failed: bool = False) -> SceneResult:
    return SceneResult(scene, ("capture", "captions"), "candidates" if failed else None, "bad" if failed else None, (), seconds)


@given(
    st.sampled_from(sorted(TASK_SECONDS)),
    st.integers(1, 16),
    st.lists(st.floats(0.01, 500), min_size=1, max_size=20),
    st.integers(1, 10_000),
)
def test_tasks_are_large_enough_to_pay_and_small_enough_to_share(runner: str, workers: int, seconds: list[float], waiting: int) -> None:
    pace = Pace(runner, workers)
    assert pace.batch_size(waiting) == 1, "nothing is known yet"
    for index, one in enumerate(seconds):
        pace.saw(result(f"s/{index}", one))
    size, usual = pace.batch_size(waiting), statistics.median(seconds[-RECENT:])
    assert 1 <= size <= waiting
    if size < waiting // (4 * workers):
        assert TASK_SECONDS[runner] <= SHARE * size * usual * 1.001, "the task's cost is a small part of it"
    assert size == 1 or size <= waiting / (4 * workers), "every worker gets several"
    assert Pace(runner, workers, 7).batch_size(waiting) == 7


def test_the_first_scenes_whose_workers_had_to_start_are_soon_forgotten() -> None:
    pace = Pace("pool", 2)
    for seconds in (40.0, 35.0, 0.6, 0.6, 0.6):
        pace.saw(result("s/1", seconds))
    assert pace.batch_size(1000) == math.ceil(TASK_SECONDS["pool"] / SHARE / 0.6)
    assert not pace.shows_stages


class Futures:
    """Tasks that are done in another thread, in any order, some of whose workers die."""

    def __init__(self, crashes: Callable[[str], bool], tries: int = 2) -> None:
        self.calls: Counter[str] = Counter()
        self.in_flight = self.most = 0
        self._crashes, self._tries, self._lock = crashes, tries, threading.Lock()
        self._work: queue.SimpleQueue[Any] = queue.SimpleQueue()
        threading.Thread(target=self._serve, daemon=True).start()

    def submit(self, batch: SceneBatch) -> Any:
        future = Future(batch)
        with self._lock:
            self.in_flight += 1
            self.most = max(self.most, self.in_flight)
        self._work.put(future)
        return future

    def results(self, future: Any) -> list[SceneResult]:
        with self._lock:
            self.in_flight -= 1
        names = [scene.scan.scene_id for scene in future.batch.scenes]
        for name in names:
            self.calls[name] += 1
        if any(self._crashes(name) and self.calls[name] < self._tries for name in names):
            raise OSError("the worker is gone")
        return [dataclasses.replace(result(s.scan.scene_id), ran=tuple(t.stage for t in s.todo)) for s in future.batch.scenes]

    def _serve(self) -> None:
        while True:
            future = self._work.get()
            time.sleep(0.001)
            future.is_done.set()
            for call in future.taken():
                call(future)


class Future:
    """As Prefect's: a callback that comes late is called at once."""

    def __init__(self, batch: SceneBatch) -> None:
        self.batch, self.task_run_id = batch, uuid.uuid4()
        self.is_done = threading.Event()
        self._calls: list[Callable[[Any], None]] = []
        self._lock = threading.Lock()

    def add_done_callback(self, fn: Callable[[Any], None]) -> None:
        with self._lock:
            self._calls.append(fn)
        if self.is_done.is_set():
            for call in self.taken():
                call(self)

    def taken(self) -> list[Callable[[Any], None]]:
        with self._lock:
            calls, self._calls = self._calls, []
        return calls


@pytest.fixture
def plan(tmp_path: Path) -> tuple[Plan, Lake]:
    """Forty scenes to do, of one scan's files."""
    write_scans(tmp_path / "scans", 1)
    lake = Lake.open(tmp_path / "lake")
    one = make_plan(lake, *find_scans(tmp_path / "scans"), configure()).scenes[0]
    scenes = tuple(dataclasses.replace(one, scan=dataclasses.replace(one.scan, scan=f"scene{n:04}_00")) for n in range(40))
    return Plan(scenes, ()), lake


def coordinator(plan: Plan, lake: Lake, **fan_out: Any) -> Coordinator:
    scenes = {scene.scan.scene_id: scene for scene in plan.scenes}
    spread = FanOut(keep_free_gb=0, **fan_out)
    return Coordinator(plan, lake, configure(), spread, lambda scan, retry: scenes[scan.scene_id], retry_failed=False)


class Sharing(Futures):
    """Tasks that look, when each is done, how many processes its stages could have used last, and how many scenes were left."""

    def __init__(self, scenes: int) -> None:
        super().__init__(lambda name: False)
        self.left, self.seen = scenes, list[tuple[int, int]]()

    def results(self, future: Any) -> list[SceneResult]:
        self.seen.append((self.left, future.batch.processes()))
        self.left -= len(future.batch.scenes)
        return super().results(future)


@pytest.mark.parametrize(("runner", "workers"), [("pool", 1), ("pool", 2), ("pool", 8), ("dask", 8)])
def test_only_the_last_scenes_use_cores_that_no_other_one_needs(plan: tuple[Plan, Lake], runner: str, workers: int) -> None:
    found, lake = plan
    for count in (1, 3, 12):
        tasks = Sharing(count)
        few = dataclasses.replace(found, scenes=found.scenes[:count])
        coordinator(few, lake, workers=workers, runner=runner, batch=1).run(tasks, lambda *_: None, {"scans": "scans"})
        assert [left for left, _ in tasks.seen] == list(range(count, 0, -1))
        for left, processes in tasks.seen:
            assert processes == (1 if runner == "dask" else max(1, workers // left))
            assert processes * left <= max(workers, left), "together no more than there are, or one each"


class Filling(Futures):
    """Tasks each of whose scenes leaves 100 kB in a lake."""

    def __init__(self, lake: Lake) -> None:
        super().__init__(lambda name: False)
        self._lake = lake

    def submit(self, batch: SceneBatch) -> Any:
        for _ in batch.scenes:
            self._lake.blobs.put(os.urandom(100_000), "bin")
        return super().submit(batch)


@pytest.mark.parametrize(("runner", "workers"), [("pool", 1), ("pool", 3), ("dask", 3)])
def test_a_quota_is_kept_from_the_first_scene_on(plan: tuple[Plan, Lake], runner: str, workers: int) -> None:
    from flows.pipeline import state_of

    found, lake = plan
    made = coordinator(found, lake, workers=workers, runner=runner, quota_gb=0.45e-3)
    outcome = made.run(Filling(lake), lambda *_: None, {"scans": "scans"})
    assert len(outcome.results) == 4, "as many as fit; looked at before it was too late"
    assert len(outcome.postponed) == 36
    assert outcome.stopped is not None
    assert outcome.stopped.startswith("the lake holds 0.4 MB, and a scene takes about 0.1 MB, --quota is 0.45 MB"), outcome.stopped
    assert sum(entry.size for entry in lake.storage.walk("")) < 450_000
    told = report_of(found, outcome)
    assert state_of(told).is_failed()
    again = coordinator(found, lake, workers=workers, runner=runner, quota_gb=0.3e-3)
    assert again.run(Filling(lake), lambda *_: None, {"scans": "scans"}).results == [], "looked at before the first scene"


def test_scenes_that_filled_the_lake_together_are_not_passed_over(plan: tuple[Plan, Lake]) -> None:
    from flows.pipeline import state_of

    found, lake = plan
    few = dataclasses.replace(found, scenes=found.scenes[:3])
    outcome = coordinator(few, lake, workers=3, quota_gb=0.15e-3).run(Filling(lake), lambda *_: None, {"scans": "scans"})
    assert (len(outcome.results), outcome.postponed) == (3, [])
    assert "--quota is 0.15 MB" in str(outcome.stopped)
    assert state_of(report_of(few, outcome)).is_failed()
    enough = coordinator(few, lake, workers=3, quota_gb=1.0).run(Filling(lake), lambda *_: None, {"scans": "scans"})
    assert (len(enough.results), enough.stopped) == (3, None)


def test_the_lake_is_measured_after_every_commit_and_else_only_where_it_may_be_full(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    lake.blobs.put(os.urandom(1000), "bin")
    quota, walks = Quota(lake, keep_free_gb=0, quota_gb=1.0), []
    measure = lake.storage.walk
    lake.storage.walk = lambda place: walks.append(place) or measure(place)  # type: ignore[method-assign, func-returns-value]
    assert quota.reason() is None
    assert len(walks) == 1, "before the first scene"
    quota.ended(scenes=1)
    quota.reason()
    assert len(walks) == 2, "nobody knows yet what a scene takes"
    quota._took = 1e6  # so large that a look takes days
    for _ in range(5):
        quota.ended(scenes=1)
        quota.reason()
    assert len(walks) == 2, "by far not full"
    quota._took = 0.0
    quota.ended(commits=1)
    quota.reason()
    assert len(walks) == 3


def test_checks_that_exports_do_not_pass_fail_the_run(plan: tuple[Plan, Lake]) -> None:
    from flows.pipeline import state_of

    found, _ = plan
    (first, second), line = (scene.scan.scene_id for scene in found.scenes[:2]), "exports: urdf breaks the rule complete: 1 of 2 objects"
    broken = {name: (f"{name}: {line}",) for name in (first, second)}
    told = report_of(found, RunOutcome(results=[result(first)]), None, broken)
    assert (told.done, told.failed) == ((first,), ())
    assert told.failures == (f"{second}: {line}", f"{first}: {line}")
    assert set(told.broken) == set(told.failures)
    assert told.known == (f"{second}: {line}",), "of a scene that this run did not compute"
    state = state_of(told)
    assert state.is_failed()
    assert f"{first}: {line}" in str(state.message)
    assert state_of(report_of(found, None, None, {second: broken[second]})).is_completed(), "nothing is new"
    assert "2 checks of exports failed" in report_line(told)
    assert " failed, 2" not in report_line(told)


@pytest.mark.parametrize(("runner", "batch"), [("pool", None), ("dask", 1), ("dask", 3)])
def test_few_tasks_are_in_flight_and_every_scene_is_computed_once(plan: tuple[Plan, Lake], runner: str, batch: int | None) -> None:
    found, lake = plan
    tasks, told = Futures(lambda name: False), []
    made = coordinator(found, lake, workers=3, runner=runner, batch=batch)
    outcome = made.run(tasks, lambda done, total, text: told.append((done, total)), {"scans": "scans"})
    assert sorted(r.scene_id for r in outcome.results) == sorted(s.scan.scene_id for s in found.scenes)
    assert set(tasks.calls.values()) == {1}
    assert 1 < tasks.most <= made.window
    steps = sum(len(scene.todo) for scene in found.scenes)
    assert told[-1] == (steps, steps)
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert lake.claimed() == {}
    assert lake.live_runs() == []
    report = report_of(found, outcome)
    assert (len(report.done), report.failures, report.postponed) == (40, (), ())


def test_scenes_whose_worker_went_wait_again_and_a_scene_that_takes_every_worker_along_is_given_up(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    names = [scene.scan.scene_id for scene in found.scenes]
    tasks = Futures(lambda name: name in names[:5])
    outcome = coordinator(found, lake, workers=2, runner="dask", batch=1).run(tasks, lambda *_: None, {})
    assert all(tasks.calls[name] == (2 if name in names[:5] else 1) for name in names)
    assert len(outcome.retried) == 5
    assert not report_of(found, outcome).failures
    always = Futures(lambda name: name == names[7], tries=LOST_SCENES + 1)
    outcome = coordinator(found, lake, workers=2, runner="dask", batch=1).run(always, lambda *_: None, {})
    told = report_of(found, outcome)
    assert told.failed == (names[7],)
    assert "the worker is gone" in told.failures[0]
    assert len(told.done) == 39
    assert sum(names[7] in line for line in outcome.retried) == LOST_SCENES - 1
    lake.commit()
    (row,) = lake.snapshot().rows(StageRun)
    assert (row.scene_id, row.stage, row.outcome, row.attempt) == (names[7], "capture", "lost", LOST_SCENES)
    assert "the worker is gone" in str(row.error)
    again = make_plan(lake, [found.scenes[7].scan], (), configure()).scenes[0].steps[0]
    assert (again.action, again.why, again.attempt) == ("run", "lost before", LOST_SCENES + 1)


def test_scenes_of_another_run_are_waited_for_and_not_computed(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    names = [scene.scan.scene_id for scene in found.scenes]
    tasks = Futures(lambda name: False)
    with lake.claims() as others:
        assert all(others.claim(name) for name in names[:3])
        made = coordinator(found, lake, workers=2)
        outcomes: list[Any] = []
        thread = threading.Thread(target=lambda: outcomes.append(made.run(tasks, lambda *_: None, {})))
        thread.start()
        deadline = time.monotonic() + 60
        while len(tasks.calls) < 37 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert set(tasks.calls) == set(names[3:])
        assert thread.is_alive(), "it waits for the other run"
        others.release(names[0])
        while names[0] not in tasks.calls and time.monotonic() < deadline:
            time.sleep(0.05)
        assert names[1] not in tasks.calls
    thread.join(60)
    assert set(tasks.calls) == set(names), "given back unfinished, they are computed here"
    assert set(tasks.calls.values()) == {1}


def report(**fields: Any) -> RunReport:
    return dataclasses.replace(RunReport((), (), (), (), 0, ()), **fields)


def test_failures_of_a_run_that_had_to_start_over_are_its_own(plan: tuple[Plan, Lake]) -> None:
    found, lake = plan
    scene = found.scenes[0]
    began = datetime.now(UTC)

    def failed_at(moment: datetime) -> RunReport:
        before = dataclasses.replace(lost_run(job_of(lake, scene, scene.steps[0], configure()), "failed", "bad", 0.0), started_at=moment)
        step = dataclasses.replace(scene.steps[0], action="report", before=before)
        planned = dataclasses.replace(scene, steps=(step, *(dataclasses.replace(s, action="wait") for s in scene.steps[1:])))
        unusable = (InputError("a", "", "no scan"), InputError("c", "", "no scan"), FetchError("b", "", "disk full"))
        return report_of(Plan((planned,), unusable), None, began, refused_before={"a: no scan"})

    old, new = failed_at(began - timedelta(hours=1)), failed_at(began + timedelta(seconds=1))
    line = f"{scene.scan.scene_id}: {scene.steps[0].stage}: bad"
    assert set(old.failures) == set(new.failures) == {"a: no scan", "b: disk full", "c: no scan", line}
    assert set(old.known) == {"a: no scan", line}
    assert set(new.known) == {"a: no scan"}
    assert old.failed == new.failed == (scene.scan.scene_id,)


def test_a_run_fails_in_prefect_for_what_is_new_only() -> None:
    from flows.pipeline import state_of

    old = ("s/1: capture: bad",)
    assert state_of(report(done=("s/2",))).is_completed()
    assert state_of(report(failures=old, known=old)).is_completed()
    assert "1 failed before" in str(state_of(report(failures=old, known=old)).message)
    assert state_of(report(failures=(*old, "s/3: capture: worse"), known=old)).is_failed()
    assert "worse" in str(state_of(report(failures=(*old, "s/3: capture: worse"), known=old)).message)
    assert state_of(report(postponed=("s/4",), stopped="no room")).is_failed()


def test_what_is_worth_waiting_for_is_told_from_what_is_wrong() -> None:
    from botocore.exceptions import EndpointConnectionError, NoCredentialsError, ReadTimeoutError

    from flows.run.patience import is_away
    from warehouse.sharing.lease import LeaseError

    away = StoreAway("s3://b/lake", "http://somebody:something@host:1")
    assert "something" not in str(away)
    waits = [away, LeaseError("held"), TimeoutError(), EndpointConnectionError(endpoint_url="x"), ReadTimeoutError(endpoint_url="x")]
    assert all(is_away(error) for error in waits)
    wrong = [InputError("a", "b", "c"), NoCredentialsError(), ValueError("x"), FileNotFoundError("x"), OSError("Generic error")]
    assert not any(is_away(error) for error in wrong)


def test_scans_on_their_way_are_left_to_a_later_run(tmp_path: Path) -> None:
    write_scans(tmp_path / "scans", 3)
    found, _ = find_scans(tmp_path / "scans")
    assert settled(found, 60) == ([], found), "just written"
    time.sleep(1.1)
    assert settled(found, 1) == (found, [])
    old = time.time() - 3600
    for file in found[0].path.iterdir():
        os.utime(file, (old, old))
    assert settled(found, 60)[1] == found, "a copy may keep times of modification, not of change"
    assert settled(found, 60, by_change=False) == (found[:1], found[1:])
    (found[1].path / ".scene0001_00.txt.Ab3dEf").write_bytes(b"")
    assert settled(found, 0) == ([found[0], found[2]], [found[1]])
