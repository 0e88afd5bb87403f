"""What a run leaves in Prefect, read back from a real server; what is written when none answers; names and keys."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.run import outcome
from flows.run.fingerprints import Fingerprint
from flows.run.plan import Plan, ScenePlan, Step
from flows.run.report import RunReport
from flows.server.artifacts import artifact_key, flow_run_name, link_of, public_address, task_run_name
from schemas.errors import InputError
from tasks.capture.scan import Scan
from tests.scans import write_scan, write_scans
from tests.services import PrefectServer, prefect_server_process
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

STATES = ("done", "failed", "unchanged", "shared", "postponed")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectServer]:
    with prefect_server_process(tmp_path_factory.mktemp("server")) as started:
        yield started


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("home")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    return kept | {"PREFECT_HOME": str(folder / "prefect"), "DO_NOT_TRACK": "1", "OMP_NUM_THREADS": "1"}


def asked(server: PrefectServer, path: str, **body: Any) -> Any:
    """What the server's API answers."""
    headers = {"Content-Type": "application/json", **server.header}
    request = urllib.request.Request(f"{server.url}/{path}", json.dumps(body).encode(), headers)
    with urllib.request.urlopen(request, timeout=600) as reply:
        return json.load(reply)


def waited(server: PrefectServer, path: str, count: int, **body: Any) -> list[dict[str, Any]]:
    """Rows of an answer, once there are enough of them: events and logs arrive a moment after what they tell of."""
    give_up = time.monotonic() + 60
    while True:
        found = asked(server, path, **body)
        rows: list[dict[str, Any]] = found["events"] if isinstance(found, dict) else found
        if len(rows) >= count or time.monotonic() > give_up:
            return rows
        time.sleep(0.5)


class Ran:
    """A run of the command line against the server: what it printed, and what the server then has of it."""

    def __init__(self, server: PrefectServer, home: dict[str, str], scans: Path, lake: Lake) -> None:
        command = [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", lake.address, "--json"]
        done = subprocess.run(command, env=home | server.access, capture_output=True, text=True, timeout=500)
        assert done.returncode == 1, done.stderr
        self.report = RunReport(**{name: tuple(v) if isinstance(v, list) else v for name, v in json.loads(done.stdout).items()})
        self.said = done.stderr
        self.flow_run = max(asked(server, "flow_runs/filter"), key=lambda run: run["start_time"])
        only = {"flow_runs": {"id": {"any_": [self.flow_run["id"]]}}}
        artifacts = asked(server, "artifacts/filter", **only)
        self.artifacts = {artifact["key"]: artifact for artifact in artifacts}
        assert len(self.artifacts) == len(artifacts)
        self.tasks = {run["name"] for run in asked(server, "task_runs/filter", **only)}
        self.logs = waited(server, "logs/filter", 3, logs={"flow_run_id": {"any_": [self.flow_run["id"]]}})
        self.rows = json.loads(self.artifacts[artifact_key("scenes", lake.address)]["data"])


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return Lake.open(tmp_path_factory.mktemp("artifacts") / "rooms")


@pytest.fixture(scope="module")
def runs(server: PrefectServer, home: dict[str, str], lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> tuple[Ran, Ran]:
    """A run over a whole scan and a cut one, and another one after a second cut scan has come."""
    scans = write_scans(tmp_path_factory.mktemp("runs") / "office", 1)
    cut(write_scan(scans, "scene0001_00"))
    first = Ran(server, home, scans, lake)
    cut(write_scan(scans, "scene0002_00"))
    return first, Ran(server, home, scans, lake)


def cut(scan: Path) -> None:
    """Half of a file did not arrive."""
    file = next(scan.glob("*.aggregation.json"))
    file.write_text(file.read_text()[:100])


def asked_in_sql(lake: Lake, question: str) -> list[tuple[Any, ...]]:
    with lake.snapshot().connect() as connection:
        return connection.sql(question).fetchall()


@pytest.mark.slow
def test_the_run_is_named_after_what_it_does(runs: tuple[Ran, Ran]) -> None:
    first, second = runs
    assert first.flow_run["name"] == "office -> rooms, 2 scenes"
    assert second.flow_run["name"] == "office -> rooms, 1 scene"
    scenes = {"scannet/scene0000_00", "scannet/scene0001_00"}
    assert {name for name in scenes if any(name in task for task in first.tasks)} == scenes


@pytest.mark.slow
def test_the_table_says_of_every_scene_what_the_lake_says(runs: tuple[Ran, Ran], lake: Lake) -> None:
    first, second = runs
    assert [(row["Scene"], row["State"]) for row in first.rows] == [("scannet/scene0001_00", "failed"), ("scannet/scene0000_00", "done")]
    assert [(row["Scene"], row["State"]) for row in second.rows] == [
        ("scannet/scene0001_00", "failed"), ("scannet/scene0002_00", "failed"), ("scannet/scene0000_00", "skipped"),
    ]  # fmt: skip
    seconds = dict(asked_in_sql(lake, "SELECT scene_id, sum(seconds) FROM stage_runs GROUP BY scene_id"))
    formats = dict(asked_in_sql(lake, "SELECT scene_id, list_sort(list(DISTINCT format)) FROM export_files GROUP BY scene_id"))
    errors = dict(asked_in_sql(lake, "SELECT scene_id, stage || ': ' || error FROM failures"))
    for row in first.rows:
        assert row["Seconds"] == pytest.approx(seconds[row["Scene"]], abs=0.01)
    done = first.rows[1]
    assert done["Exports"].split(", ") == formats[done["Scene"]]
    assert done["Stage"] == "capture to exports"
    assert {row["Scene"]: f"{row['Stage']}: {row['Why']}" for row in second.rows[:2]} == errors


@pytest.mark.slow
def test_the_summary_adds_up(runs: tuple[Ran, Ran], lake: Lake) -> None:
    first, _ = runs
    text = first.artifacts[artifact_key("summary", lake.address)]["data"]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
    told = {row[0]: row[1:] for row in cells}
    assert told["done"] == ["1"]
    assert told["failed"] == ["1"]
    assert told["stage runs"] == [str(first.report.steps)]
    assert told["degradations"] == [str(len(first.report.degradations))]
    question = "SELECT stage, count(*), sum(seconds) FROM stage_runs WHERE scene_id <> 'scannet/scene0002_00' GROUP BY stage"
    timed = asked_in_sql(lake, question)
    assert {stage for stage, *_ in timed} <= set(told)
    for stage, count, total in timed:
        assert int(told[stage][0]) == count
        assert float(told[stage][1]) == pytest.approx(total, abs=0.051)
    assert all(f"`{line}`" in text for line in (*first.report.failures, *first.report.degradations))
    assert f"--lake {lake.address}" in text


@pytest.mark.slow
def test_progress_is_complete_and_links_lead_to_the_lake(runs: tuple[Ran, Ran], lake: Lake) -> None:
    for ran in runs:
        assert ran.artifacts[artifact_key("progress", lake.address)]["data"] == 100
        assert Path(lake.address).as_uri() in ran.artifacts[artifact_key("lake", lake.address)]["data"]
        assert all(artifact["description"] for artifact in ran.artifacts.values())
    assert "1 of 3 scenes to do" in runs[1].artifacts[artifact_key("progress", lake.address)]["description"]


@pytest.mark.slow
def test_both_runs_are_the_history_of_the_same_keys(runs: tuple[Ran, Ran], server: PrefectServer, lake: Lake) -> None:
    assert set(runs[0].artifacts) == set(runs[1].artifacts)
    for key in runs[0].artifacts:
        found = asked(server, "artifacts/filter", artifacts={"key": {"any_": [key]}})
        assert {artifact["flow_run_id"] for artifact in found} == {ran.flow_run["id"] for ran in runs}
        latest = asked(server, "artifacts/latest/filter", artifacts={"key": {"any_": [key]}})
        assert [artifact["flow_run_id"] for artifact in latest] == [runs[1].flow_run["id"]]


@pytest.mark.slow
def test_failures_are_in_the_runs_log_and_once_on_the_command_line(runs: tuple[Ran, Ran]) -> None:
    for ran in runs:
        warnings = [log["message"] for log in ran.logs if log["level"] == 30]
        for line in ran.report.failures:
            assert warnings.count(line) == 1
            assert [said for said in ran.said.splitlines() if line in said] == [f"failed: {line}"]


@pytest.mark.slow
def test_the_lake_is_an_asset_made_from_the_scans(runs: tuple[Ran, Ran], server: PrefectServer, lake: Lake) -> None:
    first, _ = runs
    chosen = {"event": {"name": ["prefect.asset.materialization.succeeded"]}, "resource": {"id": [Path(lake.address).as_uri()]}}
    (event,) = waited(server, "events/filter", 1, filter=chosen)
    related = {one["prefect.resource.id"] for one in event["related"] if one["prefect.resource.role"] == "asset"}
    assert related == {Path(first.flow_run["parameters"]["scans"]).absolute().as_uri()}
    assert f"prefect.flow-run.{first.flow_run['id']}" in {one["prefect.resource.id"] for one in event["related"]}
    assert event["payload"]["scenes"] == len(first.report.done)
    assert 0 < event["payload"]["snapshot_id"] <= lake.snapshot().snapshot_id


BOARD = """
import sys, time
from pathlib import Path
from prefect import flow
from flows.server import artifacts
from flows.server.artifacts import Board, committed, run_log
from flows.run.configuration import configure
from flows.run.plan import make_plan
from flows.run.report import RunReport
from flows.run.scene import job_of
from flows.worker import execute
from tasks.capture.formats import find_scans
from warehouse.lake import Lake

scans, lake, patience = Path(sys.argv[1]), Lake.open(sys.argv[2]), float(sys.argv[3])
artifacts.PATIENCE_SECONDS, artifacts.UPDATE_SECONDS = patience, 0.2

def heard():
    print("ready", flush=True)
    sys.stdin.readline()

@flow(name="boarded", persist_result=False)
def run():
    configuration = configure()
    plan = make_plan(lake, *find_scans(scans, "auto", None), configuration)
    with Board() as board:
        board.begin(plan, lake.address, str(scans))
        heard()
        failed = {}
        for count, scene in enumerate(plan.todo, 1):
            for step in scene.todo:
                row = execute(job_of(lake, scene, step, configuration))
                if row.outcome != "done":
                    failed[scene.scan.scene_id] = f"{scene.scan.scene_id}: {step.stage}: {row.error}"
                    break
            clock = time.monotonic()
            board.advance(count, len(plan.todo), scene.scan.scene_id)
            run_log(f"{scene.scan.scene_id} is over")
            assert time.monotonic() - clock < 1, "advance waits for the server"
        lake.commit()
        committed(lake.address, lake.snapshot().snapshot_id, str(scans))
        heard()
        done = tuple(scene.scan.scene_id for scene in plan.todo if scene.scan.scene_id not in failed)
        report = RunReport(done=done, failed=tuple(failed), unchanged=(), failures=tuple(failed.values()), steps=0, degradations=())
        board.end(report, plan, lake)
        print("over", *done, flush=True)

try:
    run()
except Exception as error:  # Prefect could not tell its server how the run ended
    print(f"prefect: {type(error).__name__}", flush=True)
"""


def boarded(server: PrefectServer, home: dict[str, str], scans: Path, lake: Path, patience: float) -> subprocess.Popen[str]:
    """A process whose run waits for a line before it computes, and for another before it ends."""
    more = {**server.access, "PREFECT_CLIENT_MAX_RETRIES": "0"}
    return subprocess.Popen(
        [sys.executable, "-c", BOARD, str(scans), str(lake), str(patience)],
        env=home | more, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def goes_on(process: subprocess.Popen[str]) -> None:
    """Let it go on once it is ready."""
    assert process.stdout is not None
    assert process.stdin is not None
    line = process.stdout.readline()
    assert line == "ready\n", line + (process.stderr.read() if process.stderr else "")
    process.stdin.write("\n")
    process.stdin.flush()


@pytest.mark.slow
def test_a_server_that_dies_costs_the_lake_nothing(home: dict[str, str], tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    cut(write_scan(scans, "scene0001_00"))
    with prefect_server_process(tmp_path / "server") as server:
        process = boarded(server, home, scans, tmp_path / "lake", 2.0)
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line == "ready\n"
        server.kill()
        clock = time.monotonic()
        said, wrong = process.communicate("\n\n", timeout=500)
    assert said.split()[:3] == ["ready", "over", "scannet/scene0000_00"]
    assert wrong.count("does not answer") == 1
    assert "what it shows of this run is not complete" in wrong
    lake = Lake.open(tmp_path / "lake")
    outcomes = {key: state.last.outcome for key, state in lake.history().items()}
    assert {outcomes[key] for key in outcomes if key[0] == "scannet/scene0000_00"} == {"done"}
    assert lake.snapshot().snapshot_id == 1
    assert time.monotonic() - clock < 200, "the end of the process waits for a server that is gone"


@pytest.mark.parametrize("forgets", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["restarted", "with another database"])
def test_a_server_that_comes_back_is_told_everything(home: dict[str, str], tmp_path: Path, forgets: bool) -> None:
    cut(write_scan(tmp_path / "scans", "scene0001_00"))
    with prefect_server_process(tmp_path / "server") as server:
        process = boarded(server, home, tmp_path / "scans", tmp_path / "lake", 100.0)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        server.kill()
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "ready\n"
        if forgets:
            for file in (tmp_path / "server" / "prefect").glob("prefect.db*"):
                file.unlink()
        server.start()
        said, wrong = process.communicate("\n", timeout=300)
        found = {artifact["key"]: artifact for artifact in asked(server, "artifacts/filter")}
    assert said.startswith("over"), wrong
    assert wrong.count("does not answer") == 1
    assert wrong.count("answers again") == 1
    lake = Lake.open(tmp_path / "lake")
    assert set(found) == {artifact_key(kind, lake.address) for kind in ("progress", "scenes", "summary", "lake")}
    assert found[artifact_key("progress", lake.address)]["data"] == 100
    assert [row["State"] for row in json.loads(found[artifact_key("scenes", lake.address)]["data"])] == ["failed"]


NAMES = st.text(st.characters(blacklist_categories=("Cs", "Cc")), min_size=1, max_size=40).filter(lambda text: text.strip(". /\\") == text)


@settings(deadline=None)  # the first one imports Prefect
@given(st.lists(NAMES, min_size=1, max_size=4), st.sampled_from(["/", "s3://bucket/"]))
def test_keys_are_what_prefect_takes_and_one_per_lake(parts: list[str], root: str) -> None:
    from prefect.types.names import ArtifactKey, ValidAssetKey
    from pydantic import TypeAdapter

    from flows.server.artifacts import _asset_key

    lake = root + "/".join(part.replace("@", "a").replace("?", "q") for part in parts)  # what may carry credentials is refused
    key = artifact_key("scenes", lake)
    assert TypeAdapter(ArtifactKey).validate_python(key) == key
    assert re.fullmatch(r"run-scenes-[a-z0-9-]*[0-9a-f]{6}", key)
    assert artifact_key("scenes", lake + "x") != key
    assert artifact_key("scenes", lake + "/") == key
    assert TypeAdapter(ValidAssetKey).validate_python(_asset_key(lake)) == _asset_key(lake)
    assert _asset_key(lake + "%") != _asset_key(lake)


@given(st.sampled_from(["s3", "http", "https", "gs"]), NAMES, NAMES)
def test_an_address_with_a_secret_is_refused_and_not_repeated(scheme: str, user: str, secret: str) -> None:
    user, secret = (re.sub(r"[/@]", "x", text) for text in (user, secret + "-secret"))
    with pytest.raises(InputError, match="the address carries credentials") as caught:
        public_address(f"{scheme}://{user}:{secret}@host/bucket/lake")
    assert secret not in str(caught.value)
    assert link_of("s3://bucket/lake@home") == "s3://bucket/lake@home"


def test_names_say_what_is_done() -> None:
    assert flow_run_name("/data/scannet/", "s3://bucket/lake") == "scannet -> lake"
    assert flow_run_name("/data/scannet", "/data/lake", 12) == "scannet -> lake, 12 scenes"
    assert flow_run_name("/data/scans", "/data/lake", 1, "scannet") == "scannet -> lake, 1 scene"
    assert task_run_name("scannet/scene0001_00", "optimization") == "scannet/scene0001_00 optimization"
    assert task_run_name(["a/1", "a/2", "a/3"]) == "a/1 and 2 more"


def scene_plan(number: int) -> ScenePlan:
    step = Step("capture", "run", "never done", Fingerprint((), "{}", "code", 0), (), 1, None)
    return ScenePlan(Scan("scannet", Path("scans"), "a", f"scene{number:04d}_00"), (step,))


@given(st.lists(st.sampled_from(STATES), max_size=30), st.integers(0, 3))
def test_every_scene_is_in_the_table_once_and_those_that_failed_are_first(states: list[str], unusable: int) -> None:
    plans = [scene_plan(number) for number in range(len(states))]
    scenes = {plan.scan.scene_id: state for plan, state in zip(plans, states, strict=True)}
    named = {state: tuple(scene for scene, found in scenes.items() if found == state) for state in STATES}
    failures = tuple(f"{scene}: capture: file: field: why; mend it" for scene in named["failed"])
    report = RunReport(**named, failures=failures, steps=0, degradations=(), stopped="the disk is full")
    plan = Plan(tuple(plans), tuple(InputError(f"b{n}", "files", "none") for n in range(unusable)))
    rows = outcome.scene_rows(report, plan, {})
    assert sorted(row["Scene"] for row in rows) == sorted([*scenes, *(f"b{n}" for n in range(unusable))])
    assert [state for state, _ in itertools.groupby(rows, lambda row: row["State"])] == [
        state for state in outcome.ORDER if any(row["State"] == state for row in rows)
    ]
    for row in rows:
        if row["State"] == "failed" and row["Scene"] in scenes:
            assert (row["Stage"], row["Why"]) == ("capture", "file: field: why; mend it")
        if row["State"] == "postponed":
            assert row["Why"] == "the disk is full"
