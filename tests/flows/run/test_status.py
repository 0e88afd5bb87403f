"""How things stand, from the lake alone: what status says is held against a plan made from the scans themselves."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from flows.cli import cli
from flows.commands.status import _span, _what
from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import FileHashes, code_fingerprint
from flows.run.plan import Plan, ScenePlan, Step, annotation_digests, make_plan
from flows.run.status import Expected, Status, expected, recorded_states, status_of
from schemas.annotation import Annotation, QualityReview
from schemas.record import rows_to_arrow
from schemas.runs import StageRun
from tasks.capture.formats import find_scans
from tasks.capture.scan import Scan
from tasks.pipeline import SCENE_STAGES, upstream
from tests.samples import fingerprint, sample, stage_run
from tests.scans import write_scan, write_scans
from tests.test_pipeline import home, run, start  # noqa: F401
from tests.warehouse.sharing.test_claims import said, started
from warehouse.lake import Lake
from warehouse.sharing.claims import Claim
from warehouse.sharing.presence import LiveRun
from warehouse.tables.history import states
from warehouse.tables.outline import COLUMNS, Execution, outline_of

NAMES = [stage.name for stage in SCENE_STAGES]
CHANGES = {"optimization": "optimization.method.max_moves", "navigation": "navigation.max_steps"}


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> list[Scan]:
    """Two small scans: found and hashed as those of a run, computed by nobody here."""
    return found_scans(tmp_path_factory.mktemp("scans"))


def found_scans(folder: Path) -> list[Scan]:
    for number in range(2):
        write_scan(folder, f"scene000{number}_00", shift=(0.01 * number, 0.0))
    found, unusable = find_scans(folder, "auto", None)
    assert (len(found), unusable) == (2, [])
    return found


def plan_of(lake: Lake, scans: list[Scan], configuration: Configuration, hashes: FileHashes | None = None) -> Plan:
    return make_plan(lake, scans, (), configuration, hashes=hashes)


def executed(scene: str, step: Step, at: float, **values: Any) -> StageRun:
    """The row that a worker leaves of a step."""
    made = step.fingerprint
    row = stage_run(scene, step.stage, made.value, *step.upstream, at=at, reasons=made.parts, config=made.config, attempt=step.attempt)
    return dataclasses.replace(row, **values)


def carry_out(lake: Lake, scene: ScenePlan, at: float, until: int = 99, outcome: str = "done") -> None:
    """Stage what a plan says of a scene, up to its n-th step, which comes out so; nothing is left of it where it was killed."""
    for number, step in enumerate(scene.todo[: until + 1]):
        if number == until and outcome != "done":
            if outcome != "killed":
                wrong = {"outcome": outcome, "error": f"{step.stage} is wrong", "error_kind": "input" if outcome == "failed" else "lost"}
                lake.stage_rows(executed(scene.scan.scene_id, step, at + number / 100, **wrong), {})
            return
        lake.stage_rows(executed(scene.scan.scene_id, step, at + number / 100), {})


def annotate(lake: Lake, scene: str, batch: str, at: float) -> None:
    answer = sample(Annotation, batch_id=batch, scene_id=scene, instance_id="0001", annotator="anna", reason=batch)
    accepted = sample(QualityReview, batch_id=batch, verdict="accepted", wrong=0)
    rows = {"annotations": [answer], "quality_reviews": [accepted]}
    lake.stage_rows(stage_run(batch, "annotation", fingerprint(batch), at=at), rows)
    lake.commit(scenes=[batch])


def asked(lake: Lake, configuration: Configuration | None = None, **more: Any) -> Status:
    """What the command asks: as recorded, or with all that the next run will be told."""
    told = configuration is not None
    brought = expected(annotation_digests(lake), configuration, configs=told, seed=told)
    return status_of(lake.outline(), more.get("claims", lake.claimed()), more.get("runs", lake.live_runs()), brought)


class Told(NamedTuple):
    action: str
    why: str


def todo_of(status: Status) -> dict[tuple[str, str], Told]:
    return {(scene.scene_id, one.stage): Told(one.action, one.why) for scene in status.scenes for one in scene.todo}


def todo_of_plan(plan: Plan, lake: Lake) -> dict[tuple[str, str], Told]:
    """What a plan would do with the scenes that the lake knows, in the words of status."""
    known = {scene for scene, _ in lake.history()}
    words = {"failed before on the same input (--retry-failed computes it again)": "failed before on the same input",
             "result changed": "withdrawn"}  # fmt: skip
    return {
        (scene.scan.scene_id, step.stage): Told(step.action, words.get(step.why, step.why))
        for scene in plan.scenes for step in scene.steps
        if step.action != "reuse" and scene.scan.scene_id in known
    }  # fmt: skip


def unforeseen(plan: Plan, lake: Lake) -> tuple[set[tuple[str, str]], set[tuple[str, str]]]:
    """Steps that were tried on what the lake cannot tell will come again, and those that wait for them.

    What a stage will be called is known without its inputs only where the lake has it so: a run that was removed before it
    was committed, or overtaken since, it has not.
    """
    history = lake.history()
    tried, waiting = set(), set()
    for scene in plan.scenes:
        unknown: set[str] = set()
        for step in scene.steps:
            key = (scene.scan.scene_id, step.stage)
            state, above = history.get(key), {part.partition("=")[0] for part in step.upstream}
            if step.action == "wait" and any((key[0], name) in tried | waiting for name in above):
                waiting.add(key)
            elif (step.action == "report" or step.why == "lost before") and above & unknown:
                tried.add(key)
            names = {run.fingerprint for run in (state.done, state.last) if run is not None} if state is not None else set()
            if step.action == "run" and (above & unknown or step.fingerprint.value not in names):
                unknown.add(step.stage)
    return tried, waiting


class History(RuleBasedStateMachine):
    """Runs begin, fail, lose workers, are killed; code, configs, seeds and annotations change in between."""

    scans: list[Scan]

    @initialize()
    def begin(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="status-"))
        self.lake = Lake.open(self.folder / "lake")
        self.hashes = FileHashes(self.folder / "hashes.json")
        self.settings: dict[str, int] = {}
        self.seed, self.clock = 0, 0
        self.versions = dict.fromkeys(NAMES, 0)
        self.patch = pytest.MonkeyPatch()
        for module in ("flows.run.plan", "flows.run.status"):
            self.patch.setattr(f"{module}.code_fingerprint", lambda name: fingerprint(name, self.versions[name.rpartition(".")[2]]))

    def configuration(self) -> Configuration:
        return configure(None, [f"{name}={value}" for name, value in self.settings.items()], seed=self.seed)

    def plan(self) -> Plan:
        self.clock += 1
        return plan_of(self.lake, self.scans, self.configuration(), self.hashes)

    @rule(number=st.integers(0, 1), until=st.integers(0, len(NAMES)), outcome=st.sampled_from(["done", "failed", "lost", "killed"]))
    def run(self, number: int, until: int, outcome: str) -> None:
        carry_out(self.lake, self.plan().scenes[number], self.clock, until, outcome)

    @rule()
    def finish(self) -> None:
        for scene in self.plan().scenes:
            carry_out(self.lake, scene, self.clock)
        self.lake.commit()
        status = asked(self.lake)
        known = {scene.scan.scene_id for scene in self.plan().scenes if scene.failure}
        assert {scene.scene_id for scene in status.scenes if scene.state != "done"} == known, "as recorded, all is done that did not fail"
        assert status.seconds_left == 0

    @rule()
    def commit(self) -> None:
        self.lake.commit()

    @rule(number=st.integers(0, 1))
    def remove(self, number: int) -> None:
        if self.lake.exists:
            self.lake.remove_scene(self.scans[number].scene_id)

    @rule(stage=st.sampled_from(NAMES), version=st.integers(0, 2))
    def edit_code(self, stage: str, version: int) -> None:
        self.versions[stage] = version

    @rule(stage=st.sampled_from(sorted(CHANGES)), value=st.integers(100, 102))
    def tell(self, stage: str, value: int) -> None:
        self.settings[CHANGES[stage]] = value

    @rule(seed=st.integers(0, 1))
    def sow(self, seed: int) -> None:
        self.seed = seed

    @rule(number=st.integers(0, 1))
    def annotate(self, number: int) -> None:
        self.clock += 1
        annotate(self.lake, self.scans[number].scene_id, f"batch-{self.clock}", self.clock)

    @invariant()
    def status_says_what_a_plan_says(self) -> None:
        if not hasattr(self, "lake"):
            return
        plan = self.plan()
        status = asked(self.lake, self.configuration())
        found, planned = todo_of(status), todo_of_plan(plan, self.lake)
        tried, waiting = unforeseen(plan, self.lake)
        assert tried | waiting <= found.keys() & planned.keys()
        assert all(found[key].action == "run" and found[key].why.endswith("will be redone") for key in tried)
        assert all(found[key].action in ("run", "wait") for key in waiting)
        unlike = {key for key in found.keys() | planned.keys() if found.get(key) != planned.get(key)}
        assert unlike <= tried | waiting
        for scene in status.scenes:
            actions = {one.action for one in scene.todo}
            assert (scene.state == "done") == (not actions)
            if "report" in actions:
                assert scene.state == "failed"
        history = self.lake.history()
        assert {(scene, stage) for scene, stages in recorded_states(self.lake.outline().states).items() for stage in stages} == {
            key for key in history if key[1] in NAMES
        }

    def teardown(self) -> None:
        if hasattr(self, "patch"):
            self.patch.undo()
            shutil.rmtree(self.folder)


@pytest.mark.whole
def test_status_says_what_a_plan_would_do(scans: list[Scan]) -> None:
    from hypothesis.stateful import run_state_machine_as_test

    History.scans = scans
    run_state_machine_as_test(History, settings=settings(max_examples=12, stateful_step_count=14, deadline=None))


RUNS = st.lists(
    st.tuples(
        st.sampled_from(["a/b", "a/c", "a/d"]), st.sampled_from(NAMES), st.sampled_from("xyz"), st.integers(1, 3),
        st.sampled_from(["done", "failed", "lost", "withdrawn"]), st.integers(0, 5), st.integers(0, 3),
        st.lists(st.sampled_from(["code=1", "seed=2", "scan=3"]), max_size=3),
    ),
    max_size=40, unique_by=lambda one: one[:4],
)  # fmt: skip


@given(RUNS)
def test_the_outline_is_the_history(drawn: list[tuple[Any, ...]]) -> None:
    rows = [
        stage_run(scene, stage, fingerprint(word), at=at, attempt=attempt, outcome=outcome, snapshot_id=snapshot, reasons=tuple(parts),
                  seconds=float(at), error="wrong" if outcome in ("failed", "lost") else None)
        for scene, stage, word, attempt, outcome, at, snapshot, parts in drawn
    ]  # fmt: skip
    found = outline_of(rows_to_arrow(rows, StageRun).select(list(COLUMNS)), {})

    def outlined(one: StageRun | None) -> Execution | None:
        return Execution(one.fingerprint, one.outcome, one.reasons, one.error, one.started_at.timestamp(), one.seconds) if one else None

    assert found.states == {
        key: (outlined(state.done), outlined(state.last)) for key, state in states(rows_to_arrow(rows, StageRun)).items()
    }
    by_stage: dict[str, list[float]] = {}
    for row in rows:
        if row.outcome == "done":
            by_stage.setdefault(row.stage, []).append(row.seconds)
    assert found.median_seconds == {stage: statistics.median(seconds) for stage, seconds in by_stage.items()}


@pytest.fixture
def lake(scans: list[Scan], tmp_path: Path) -> Lake:
    """A lake in which both scans are done."""
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(plan_of(lake, scans, configure()).scenes):
        carry_out(lake, scene, number)
    lake.commit()
    return lake


def told(lake: Lake, *options: str) -> dict[str, Any]:
    done = CliRunner().invoke(cli, ["status", "--lake", lake.address, "--json", *options])
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.output))


def text(lake: Lake, *options: str) -> list[str]:
    done = CliRunner().invoke(cli, ["status", "--lake", lake.address, *options])
    assert done.exit_code == 0, done.output
    return done.output.splitlines()


def test_a_failed_scene_is_named_with_its_error_and_what_waits(lake: Lake, scans: list[Scan]) -> None:
    configuration = configure(None, ["navigation.max_steps=77"])
    scene = plan_of(lake, scans, configuration).scenes[0]
    carry_out(lake, scene, 10, 0, "failed")
    found = told(lake)
    name = scene.scan.scene_id
    assert found["counts"] == {"done": 1, "running": 0, "failed": 1, "stale": 0, "unfinished": 0}
    assert found["errors"] == [f"{name}: navigation: navigation is wrong"]
    assert found["scenes"][name]["navigation"] == "failed (older rows kept)"
    assert found["todo"] == {
        name: {
            "navigation": {"action": "report", "why": "failed before on the same input"},
            "exports": {"action": "wait", "why": "navigation did not succeed"},
        }
    }
    assert found["seconds_left"] == 0, "what failed on the same input is not computed again"
    lines = text(lake)
    assert lines[0] == "1 done, 1 failed"
    assert lines[1].split(maxsplit=2) == [name, "failed", "navigation failed; 1 stage waits"]
    assert lines[2:] == found["errors"]
    assert text(lake, "--set", "navigation.max_steps=78")[1].endswith("navigation failed; navigation: config changed; 1 stage follows")


def test_changes_make_scenes_stale_and_say_which(lake: Lake, scans: list[Scan], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert text(lake) == ["2 done"]
    names = [scan.scene_id for scan in scans]
    later = ["optimization"]
    for stage in SCENE_STAGES:
        later += [stage.name] if any(before.name in later for before in upstream(stage)) else []
    found = told(lake, "--set", "optimization.method.max_moves=7")
    assert found["counts"]["stale"] == 2
    assert {stage: one["why"] for stage, one in found["todo"][names[0]].items()} == {
        "optimization": "config changed", "micro_scenes": "optimization will be redone", "navigation": "optimization will be redone",
        "fidelity": "optimization will be redone", "exports": "optimization, navigation will be redone",
    }  # fmt: skip
    file = tmp_path / "config.toml"
    file.write_text("[optimization.method]\nmax_moves = 7\n")
    assert told(lake, "--config", str(file))["todo"] == found["todo"]
    assert {stage: one["why"] for stage, one in told(lake, "--seed", "3")["todo"][names[1]].items()}["capture"] == "seed changed"
    assert told(lake, "--seed", "0")["counts"]["done"] == 2
    annotate(lake, names[1], "batch-1", at=20)
    found = told(lake)
    assert list(found["todo"]) == [names[1]]
    assert list(found["todo"][names[1]]) == later
    assert found["todo"][names[1]]["optimization"]["why"] == "annotations changed"
    assert text(lake)[1].split(maxsplit=2) == [names[1], "stale", f"optimization: annotations changed; {len(later) - 1} stages follow"]
    real = code_fingerprint
    monkeypatch.setattr("flows.run.status.code_fingerprint", lambda name: "changed" if name == "tasks.exports" else real(name))
    found = told(lake)
    assert found["counts"]["stale"] == 2
    assert found["todo"][names[0]] == {"exports": {"action": "run", "why": "code changed"}}


def test_an_interrupted_run_leaves_unfinished_scenes_and_the_time_that_they_take(scans: list[Scan], tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    plan = plan_of(lake, scans, configure())
    first, second = plan.scenes
    for number, step in enumerate(first.steps):
        lake.stage_rows(executed(first.scan.scene_id, step, number, seconds=10.0 * (number + 1)), {})
    lake.commit()
    for number, step in enumerate(second.steps[:3]):
        lake.stage_rows(executed(second.scan.scene_id, step, number, seconds=30.0 * (number + 1)), {})
    lost = dataclasses.replace(executed(second.scan.scene_id, second.steps[3], 9), outcome="lost", error="killed", error_kind="lost")
    lake.stage_rows(lost, {})
    found = told(lake)
    assert found["counts"] == {"done": 1, "running": 0, "failed": 0, "stale": 0, "unfinished": 1}
    assert found["todo"][second.scan.scene_id][NAMES[3]] == {"action": "run", "why": "lost before"}
    assert list(found["todo"][second.scan.scene_id]) == NAMES[3:]
    assert found["seconds_left"] == sum(10.0 * (number + 1) for number in range(3, len(NAMES))), "each stage was timed once, on the first"
    assert text(lake)[0] == f"1 done, 1 unfinished; about {_span(found['seconds_left'])} left for one worker"
    lake.commit()
    again = told(lake)
    assert {name: again[name] for name in again if name != "seconds_left"} == {
        name: found[name] for name in found if name != "seconds_left"
    }
    assert again["seconds_left"] == found["seconds_left"], "a lost run is no time of a stage"
    assert {row.outcome for row in lake.snapshot().rows(StageRun)} == {"done", "lost"}


def test_a_run_in_another_process_is_seen_at_its_stage_and_not_any_more_once_it_is_killed(lake: Lake, scans: list[Scan]) -> None:
    name, other = (scan.scene_id for scan in scans)
    configuration = configure(None, ["navigation.max_steps=77"])
    with started("hold", lake.address, 60, "", name, "scannet/scene0009_00") as process:
        assert said(process)["claimed"] == [True, True]
        found = told(lake)
        assert found["counts"] == {"done": 1, "running": 2, "failed": 0, "stale": 0, "unfinished": 0}
        assert {one["scene_id"]: one["stage"] for one in found["running"]} == {name: None, "scannet/scene0009_00": "capture"}
        since = datetime.fromisoformat(found["running"][0]["since"])
        assert abs(since - datetime.now(UTC)) < timedelta(minutes=1)
        (live,) = found["runs"]
        assert (live["scenes"], live["done"], live["seconds_left"]) == (2, 0, 0.0)
        step = next(step for step in plan_of(lake, scans, configuration).scenes[0].steps if step.stage == "navigation")
        row = executed(name, step, 0, started_at=datetime.now(UTC))
        lake.stage_rows(row, {})
        found = told(lake)
        assert {one["scene_id"]: one["stage"] for one in found["running"]}[name] == "exports", "what was done since is behind it"
        lines = text(lake)
        assert lines[0].startswith("1 done, 2 running; about ")
        assert lines[1].startswith("run on ")
        assert [line.split()[:2] for line in lines[2:]] == [[name, "running"], ["scannet/scene0009_00", "running"]]
        process.send_signal(signal.SIGKILL)
        process.wait()
    found = told(lake)
    assert (found["running"], found["runs"]) == ([], [])
    assert found["counts"] == {"done": 1, "running": 0, "failed": 0, "stale": 0, "unfinished": 1}
    assert found["todo"] == {name: {"exports": {"action": "run", "why": "navigation changed"}}}
    assert {one.scene_id: one.state for one in asked(lake, configuration).scenes} == {name: "unfinished", other: "stale"}


def claimed(lake: Lake, *scenes: str, runs: list[LiveRun], since: float) -> Status:
    """How things stand with scenes that were claimed one second after the other."""
    claims = {name: Claim("t", "h", since + 1e6, 1e6, name, since + number) for number, name in enumerate(scenes)}
    outline = lake.outline()
    return status_of(outline, claims, runs, expected(annotation_digests(lake)), since + 1000)


def test_scenes_that_wait_for_a_worker_are_not_running_and_a_stage_is_as_old_as_it_is(lake: Lake, scans: list[Scan]) -> None:
    begun = datetime(2026, 5, 1, tzinfo=UTC)
    since, (name, other), new = begun.timestamp(), (scan.scene_id for scan in scans), "scannet/scene0009_00"
    telling = LiveRun("t", "h", begun, workers=1, runner="pool", at_work={name: ("selection", since + 700)})
    found = {one.scene_id: one for one in claimed(lake, name, other, new, runs=[telling], since=since).scenes}
    assert {scene: one.state for scene, one in found.items()} == {name: "running", other: "done", new: "unfinished"}
    assert (found[name].stage, found[name].since) == ("selection", since + 700)
    assert _what(found[name], since + 1000) == "selection, for 5.0 min, on h"
    assert _what(found[new], since + 1000).startswith("waits for a worker on h; ")
    none = LiveRun("t", "h", begun, workers=2, runner="pool", at_work={})
    assert claimed(lake, name, new, runs=[none], since=since).counts()["running"] == 0


def test_of_a_run_that_does_not_tell_no_more_scenes_run_than_it_has_workers(lake: Lake, scans: list[Scan]) -> None:
    begun = datetime(2026, 5, 1, tzinfo=UTC)
    since, new = begun.timestamp(), [f"scannet/scene000{n}_00" for n in (7, 8, 9)]
    silent = LiveRun("t", "h", begun, workers=2, runner="dask", scenes=4)

    def states(*scenes: str) -> dict[str, str]:
        return {one.scene_id: one.state for one in claimed(lake, *scenes, runs=[silent], since=since).scenes if one.scene_id in scenes}

    assert states(*new) == {new[0]: "running", new[1]: "running", new[2]: "unfinished"}, "those that were claimed first"
    late = scans[0].scene_id
    step = next(
        step for step in plan_of(lake, scans, configure(None, ["navigation.max_steps=78"])).scenes[0].steps if step.stage == "navigation"
    )
    lake.stage_rows(executed(late, step, 0, started_at=begun + timedelta(seconds=500), seconds=60.0), {})
    assert states(*new, late) == {new[0]: "running", new[1]: "unfinished", new[2]: "unfinished", late: "running"}, "and who got on"
    (one,) = [one for one in claimed(lake, *new, late, runs=[silent], since=since).scenes if one.scene_id == late]
    assert (one.stage, one.since) == ("exports", since + 560), "it began when the one before ended, not with the claim"


MEDIANS = {"capture": 10.0, "exports": 30.0}


def live(left: dict[str, int], elapsed: float, done: float, workers: int = 2) -> tuple[LiveRun, float]:
    begun = datetime(2026, 1, 1, tzinfo=UTC)
    return LiveRun("t", "h", begun, workers=workers, left=left, seconds_done=done), begun.timestamp() + elapsed


def left_of(*runs: tuple[LiveRun, float], medians: dict[str, float] | None = None) -> float | None:
    outline = dataclasses.replace(outline_of(rows_to_arrow([], StageRun), {}), median_seconds=MEDIANS if medians is None else medians)
    return status_of(outline, {}, [run for run, _ in runs], Expected({}, {}, {}), runs[0][1]).seconds_left


def test_the_time_left_follows_from_what_is_left_and_how_fast_it_goes() -> None:
    work = {"capture": 3, "exports": 4}
    assert left_of(live(work, 0, 0)) == pytest.approx(150 / 2), "at the start as if all workers were busy"
    assert left_of(live(work, 0, 0, workers=5)) == pytest.approx(150 / 5)
    assert left_of(live(work, 1e6, 0.5e6)) == pytest.approx(150 / 0.5, rel=1e-3), "later as fast as it went"
    assert left_of(live(work, 1e6, 1.7e6)) == pytest.approx(150 / 1.7, rel=1e-3)
    steady = [left_of(live(work, elapsed, 2.0 * max(0.0, elapsed - 10))) for elapsed in (5, 20, 100, 1000)]
    assert all(one == pytest.approx(75, rel=0.35) for one in steady), "what is under way counts, although it is not done"
    assert left_of(live({}, 100, 50)) == left_of(live({"capture": 0}, 100, 50)) == 0
    assert left_of(live({"navigation": 2}, 0, 0, workers=1)) == pytest.approx(40), (
        "a stage that was never timed takes as long as the others"
    )
    assert left_of(live(work, 10, 0), medians={}) is None
    slow, fast = live(work, 0, 0, workers=1), live(work, 0, 0, workers=4)
    assert left_of(slow, fast) == left_of(slow) == pytest.approx(150), "the last one to end counts"


@given(st.floats(0, 1e8), st.floats(0, 1e8))
def test_a_longer_time_never_reads_as_a_shorter_one(one: float, other: float) -> None:
    sizes = {"s": 1, "min": 60, "h": 3600, "d": 86_400}

    def value(seconds: float) -> float:
        number, unit = _span(seconds).split()
        return float(number) * sizes[unit]

    short, long = sorted((one, other))
    assert value(short) <= value(long) * 1.06
    assert value(long) == pytest.approx(long, rel=0.06, abs=0.51)


def test_imported_scenes_are_not_called_stale(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    parts = ("import=metascenes", "scan=1", "config=2", "code=old", "seed=0")
    for stage in ("capture", "optimization"):
        lake.stage_rows(stage_run("meta/a", stage, fingerprint(stage), reasons=parts), {})
    lake.stage_rows(
        stage_run("meta/b", "capture", fingerprint("b"), reasons=parts, outcome="failed", error="no file", error_kind="input"), {}
    )
    lake.commit()
    found = told(lake)
    assert found["counts"] == {"done": 1, "running": 0, "failed": 1, "stale": 0, "unfinished": 0}
    assert found["seconds_left"] == 0
    assert text(lake)[1:] == [f"{'meta/b':<32} failed     capture failed", "meta/b: capture: no file"]
    lake.remove_scene("meta/a")
    assert told(lake)["counts"]["unfinished"] == 1


def test_long_lists_are_cut_and_an_empty_lake_says_so(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    lake.blobs.put(b"x", "glb")
    assert text(lake) == ["the lake is empty"]
    assert told(lake)["counts"] == dict.fromkeys(("done", "running", "failed", "stale", "unfinished"), 0)
    for number in range(30):
        wrong: dict[str, Any] = {"outcome": "failed", "error": f"wrong {number}", "error_kind": "input", "reasons": ("scan=1",)}
        lake.stage_rows(stage_run(f"demo/s{number:02d}", "capture", fingerprint(number), **wrong), {})
    lines = text(lake)
    assert lines[0] == "0 done, 30 failed; time left unknown for one worker"
    assert len(lines) == 1 + 20 + 1 + 20 + 1
    assert [line for line in lines if "--all" in line] == ["and 10 more scenes (--all lists them)", "and 10 more errors (--all lists them)"]
    assert len(text(lake, "--all")) == 1 + 30 + 30
    missing = CliRunner().invoke(cli, ["status", "--lake", str(tmp_path / "none")])
    assert missing.exit_code != 0


@pytest.mark.whole
def test_all_of_ten_thousand_scenes_are_counted() -> None:
    current = expected({}).code
    rows = []
    for number in range(1000):
        prints = {stage: fingerprint(number, stage) for stage in NAMES}
        for stage in SCENE_STAGES:
            above = tuple(f"{name}={prints[name]}" for name in NAMES[: NAMES.index(stage.name)])
            reasons = (*above, "config=1", current[stage.name], "seed=0")
            rows.append(stage_run(f"demo/s{number}", stage.name, prints[stage.name], *above, reasons=reasons))
    part = rows_to_arrow(rows, StageRun)
    import pyarrow as pa
    import pyarrow.compute as pc

    names = part.schema.get_field_index("scene_id")
    parts = [
        part.set_column(names, part.schema.field(names), pc.binary_join_element_wise(part["scene_id"], str(n), "_")) for n in range(10)
    ]
    runs = pa.concat_tables(parts).select(list(COLUMNS))
    status = status_of(outline_of(runs, {}), {}, [], Expected(current, {}, {}))
    assert len(status.scenes) == 10_000
    assert status.counts()["stale"] == 10_000, "annotations= is not among the parts"


@pytest.mark.slow
def test_a_real_run_is_seen_from_beginning_to_end(home: dict[str, str], tmp_path: Path) -> None:  # noqa: F811
    """Two small scans are run, the run is killed in the middle, and run again; status is asked all the while."""
    write_scans(tmp_path / "scans", 2)
    lake = Lake.open(tmp_path / "lake")

    def status() -> dict[str, Any]:
        time.sleep(0.5)  # leave the processors to the run
        command = [sys.executable, "-m", "flows.cli", "status", "--json", "--lake", lake.address]
        done = subprocess.run(command, env=home, capture_output=True, text=True, timeout=600)
        return dict(json.loads(done.stdout)) if done.returncode == 0 else {"running": [], "runs": []}

    process = start(home, tmp_path / "lake", tmp_path / "scans")
    try:
        seen: Iterator[dict[str, Any]] = iter(status, None)
        found = next(
            one for one in seen if process.poll() is not None or any(row["stage"] not in (None, "capture") for row in one["running"])
        )
        assert process.poll() is None, "it was over before anybody looked"
        assert {row["stage"] for row in found["running"]} <= set(NAMES)
        (own,) = found["runs"]
        assert (own["scenes"], own["workers"]) == (2, 2)
        assert sum(own["left"].values()) <= 2 * len(NAMES)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    found = status()
    assert (found["running"], found["runs"]) == ([], [])
    assert found["counts"]["unfinished"] + found["counts"]["done"] >= 1
    assert run(home, tmp_path / "scans", tmp_path / "lake").returncode == 0
    found = status()
    assert found["counts"] == {"done": 2, "running": 0, "failed": 0, "stale": 0, "unfinished": 0}
    assert found["seconds_left"] == 0
    assert lake.storage.names("claims") == lake.storage.names("runs") == []
