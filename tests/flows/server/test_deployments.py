"""What `metascenes deploy` sets up, on a real Prefect server, with a real worker and a real webhook."""

from __future__ import annotations

import contextlib
import http.server
import json
import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from bench.flows.small_scenes import SETTINGS, write_small_scans
from flows.server.deployments import RUNS_AT_ONCE, Schedule, closed
from flows.server.services import SERVER
from schemas.runs import StageRun
from tasks.pipeline import SCENE_STAGES
from tests.conftest import REPOSITORY
from tests.services import PrefectServer, prefect_server_process
from warehouse.lake import Lake

pytestmark = [pytest.mark.whole, pytest.mark.timeout(900)]

WAIT_SECONDS = 600
"""Only what hangs takes as long; nothing here takes a tenth of it on an idle machine."""

FAST = {
    **SERVER,
    "PREFECT_SERVER_SERVICES_SCHEDULER_LOOP_SECONDS": "2",
    "PREFECT_SERVER_SERVICES_SCHEDULER_RECENT_DEPLOYMENTS_LOOP_SECONDS": "2",
}
NAMES = (
    "replicate/nightly-lake",
    "replicate/backfill-lake",
    "watch/watch-lake",
    "statistics/statistics-lake",
    "release/release-lake",
    "train/train-lake",
    "evaluate/evaluate-lake",
    "drive/drive-lake",
    "compare/compare-lake",
    "export/export-lake",
    "upkeep/upkeep-lake",
)
SECRET = "T0AB/B1CD/s3cr3t-webhook-path"


DEPLOYING = """
import json, sys
from click.testing import CliRunner
from flows.cli import cli
for line in sys.stdin:
    done = CliRunner().invoke(cli, json.loads(line))
    print(json.dumps([done.exit_code, done.stdout if done.exit_code == 0 else done.output]), flush=True)
"""


class Prefect:
    """A server with our deployments, a client of its API, and commands that talk to it."""

    def __init__(self, server: PrefectServer, folder: Path) -> None:
        self.server, self.folder = server, folder
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "METASCENES_"))},
            **server.access, "PREFECT_HOME": str(folder / "home"), "OMP_NUM_THREADS": "1",
        }  # fmt: skip
        self.scans, self.lake, self.out = folder / "scans", folder / "lake", folder / "out"
        places = ["--scans", str(self.scans), "--lake", str(self.lake), "--out", str(self.out)]
        self.told = ["deploy", *places, "--timezone", "Europe/Berlin", "--json"]

    def deploy(self, *arguments: str, **environment: str) -> dict[str, str]:
        """What became of each item, by name, as `metascenes deploy` prints it."""
        command = [sys.executable, "-m", "flows.cli", *self.told]
        done = self.run([*command, *arguments], **environment)
        assert done.returncode == 0, done.stderr
        assert SECRET not in done.stdout + done.stderr
        return {item["name"]: item["change"] for item in json.loads(done.stdout)["items"]}

    @contextlib.contextmanager
    def deploying(self) -> Iterator[Callable[..., dict[str, str]]]:
        """`deploy` many times from one process: what it imports takes longer than what it does."""
        command = [sys.executable, "-c", DEPLOYING]
        with subprocess.Popen(
            command, cwd=REPOSITORY, env=self.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None

            def deploy(*arguments: str) -> dict[str, str]:
                print(json.dumps([*self.told, *arguments]), file=process.stdin, flush=True)
                code, said = json.loads(process.stdout.readline() if process.stdout else "")
                assert code == 0, said
                assert SECRET not in said
                return {item["name"]: item["change"] for item in json.loads(said)["items"]}

            yield deploy
            process.stdin.close()

    def run(self, command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=REPOSITORY, env={**self.environment, **environment}, capture_output=True, text=True, check=False, timeout=600
        )

    def ask(self, path: str, body: Mapping[str, Any] | None = None, method: str = "") -> httpx.Response:
        method = method or ("GET" if body is None else "POST")
        for _ in range(20):
            # No limit but the test's own: a server beside a run that has both cores answers when it gets one.
            answer = httpx.request(method, f"{self.server.url}/{path}", json=body, headers=self.server.header, timeout=None)
            if answer.status_code != 503:  # its SQLite is locked for the moment: Prefect's own client asks again, too
                break
            time.sleep(0.5)
        return answer

    def deployment(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = self.ask(f"deployments/name/{name}").raise_for_status().json()
        return found

    def facts(self) -> dict[str, dict[str, Any]]:
        """Everything that is set of each deployment."""
        passing = {
            "id",
            "created",
            "updated",
            "schedules",
            "status",
            "last_polled",
            "concurrency_limit_id",
            "global_concurrency_limit",
            "version_id",
        }
        facts = {}
        for name in NAMES:
            found = self.deployment(name)
            facts[name] = {key: value for key, value in found.items() if key not in passing}
            facts[name]["schedules"] = [(each["slug"], each["active"], each["schedule"]) for each in found["schedules"]]
            facts[name]["limit"] = (found["global_concurrency_limit"] or {}).get("limit")
        return facts


@pytest.fixture(scope="module")
def prefect(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prefect]:
    with prefect_server_process(tmp_path_factory.mktemp("prefect"), None, **FAST) as server:
        yield Prefect(server, tmp_path_factory.mktemp("place"))


class Hook(http.server.BaseHTTPRequestHandler):
    """Takes POSTs as Slack's incoming webhooks do."""

    taken: list[tuple[str, dict[str, Any]]] = []  # noqa: RUF012

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.taken.append((self.path, json.loads(body)))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        """Silent."""


@pytest.fixture(scope="module")
def hook() -> Iterator[str]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hook) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/{SECRET}"
        server.shutdown()


@pytest.fixture(scope="module")
def deployed(prefect: Prefect, hook: str) -> Prefect:
    changes = prefect.deploy(METASCENES_NOTIFY_URL=hook)
    assert {*NAMES, "metascenes-failures", "metascenes-notification"} <= set(changes)
    assert set(changes.values()) == {"created"}
    return prefect


def eventually(found: Callable[[], Any], what: str) -> Any:
    give_up = time.monotonic() + WAIT_SECONDS
    while not (value := found()):
        assert time.monotonic() < give_up, f"{what}: not within {WAIT_SECONDS} s"
        time.sleep(0.5)
    return value


@pytest.mark.slow
def test_schedules_pool_limits_and_parameters_are_what_was_asked_for(deployed: Prefect) -> None:
    nightly = deployed.deployment("replicate/nightly-lake")
    assert [(each["schedule"]["cron"], each["schedule"]["timezone"]) for each in nightly["schedules"]] == [("0 1 * * *", "Europe/Berlin")]
    assert nightly["parameters"]["scans"] == str(deployed.scans)
    assert nightly["parameters"]["lake"] == str(deployed.lake)
    assert nightly["work_pool_name"] == "metascenes"
    pool = deployed.ask("work_pools/metascenes").json()
    assert (pool["type"], pool["concurrency_limit"]) == ("process", RUNS_AT_ONCE)
    assert pool["base_job_template"] == closed(pool["base_job_template"])
    refused = deployed.ask(f"deployments/{nightly['id']}/create_flow_run", {"job_variables": {"command": "touch /tmp/x"}})
    assert refused.status_code == 422, "who starts a run does not say what is executed"
    slots = {}
    for name in NAMES:
        found = deployed.deployment(name)
        if found["global_concurrency_limit"]:
            slots[name] = (found["global_concurrency_limit"]["limit"], found["concurrency_options"]["collision_strategy"])
        assert "metascenes" in found["tags"]
        assert found["description"]
        assert found["enforce_parameter_schema"]
        assert not found["pull_steps"], "nothing is pulled: the package is installed where workers are"
        assert "{{" not in json.dumps([found["parameters"], found["work_pool_name"], found["schedules"]])
    for limit in set(nightly["parameters"]["limits"].values()):
        assert deployed.ask(f"v2/concurrency_limits/{limit}").json()["active"] is False, "stops nobody until it is told how many"
    kinds = {"statistics": "CANCEL_NEW", "export": "ENQUEUE", "upkeep": "CANCEL_NEW"}
    short = {f"{name}/{name}-lake": (1, kind) for name, kind in kinds.items()}
    assert slots == short, "a slot's lease ends a long run whose server is away for minutes"


@pytest.mark.slow
def test_deploying_again_changes_what_is_different_and_prefects_own_command_sets_up_the_same(deployed: Prefect, hook: str) -> None:
    before = deployed.facts()
    backfill = deployed.deployment("replicate/backfill-lake")["id"]
    slot = {"concurrency_limit": 2, "concurrency_options": {"collision_strategy": "ENQUEUE"}}
    deployed.ask(f"deployments/{backfill}", slot, "PATCH").raise_for_status()
    assert deployed.facts()["replicate/backfill-lake"]["limit"] == 2
    limits = ["--gpu-slots", "3", "--vlm-per-second", "0.5", "--runs-at-once", "2"]
    changes = deployed.deploy("--nightly", "30 2 * * 1-5", *limits, "--notify-env", "OTHER_NAME", OTHER_NAME=hook)
    assert {changes.pop(name) for name in ("metascenes-gpu", "metascenes-vlm", "metascenes")} == {"changed"}
    assert deployed.ask("v2/concurrency_limits/metascenes-gpu").json()["limit"] == 3
    assert deployed.ask("work_pools/metascenes").json()["concurrency_limit"] == 2
    nightly = ("replicate/nightly-lake", "train/train-lake")
    assert {changes.pop(name) for name in (*nightly, "replicate/backfill-lake")} == {"changed"}, "an older slot is taken away"
    assert set(changes.values()) == {"unchanged"}
    after = deployed.facts()
    for name in nightly:
        assert [schedule["cron"] for _, _, schedule in after.pop(name)["schedules"]] == ["30 2 * * 1-5"]
    assert after == {name: facts for name, facts in before.items() if name not in nightly}
    assert len(deployed.ask("deployments/filter", {}).json()) == len(NAMES)
    automations = [each["name"] for each in deployed.ask("automations/filter", {}).json()]
    after_runs = ["metascenes-statistics-after-nightly-lake", "metascenes-train-after-release-lake"]
    assert sorted(automations) == ["metascenes-failures", "metascenes-lost-runs", *after_runs]
    schedule = Schedule(str(deployed.scans), str(deployed.lake), str(deployed.out), timezone="Europe/Berlin")
    done = deployed.run([sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all"], **schedule.environment())
    assert done.returncode == 0, done.stdout + done.stderr
    assert deployed.facts() == before


@pytest.mark.slow
def test_limits_are_switched_off_and_stay_what_they_are(deployed: Prefect) -> None:
    told = ["--gpu-slots", "2", "--vlm-per-second", "0.25", "--runs-at-once", "3"]
    off = [each if each.startswith("--") else "0" for each in told]

    def limits() -> list[Any]:
        keys = ("active", "limit", "slot_decay_per_second")
        found = [deployed.ask(f"v2/concurrency_limits/{name}").json() for name in ("metascenes-gpu", "metascenes-vlm")]
        return [*([one[key] for key in keys] for one in found), deployed.ask("work_pools/metascenes").json()["concurrency_limit"]]

    with deployed.deploying() as deploy:
        deploy(*told)
        assert limits() == [[True, 2, 0.0], [True, 1, 0.25], 3]
        deploy()
        assert limits() == [[True, 2, 0.0], [True, 1, 0.25], 3], "who tells nothing changes nothing"
        deploy(*off)
        assert limits() == [[False, 2, 0.0], [False, 1, 0.25], None], "switched off, and still a rate"
        assert set(deploy(*off).values()) == {"unchanged"}


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        ({"stages": {"navigation": {"max_steps": "many"}}}, "max_steps"),
        ({"stages": {"navigations": {}}}, "navigations"),
        ({"stages": {"optimization": {"method": "best"}}}, "method"),
        ({"runner": "abacus"}, "runner"),
        ({"workers": "two"}, "workers"),
    ],
)
def test_a_parameter_that_breaks_the_schema_is_refused_when_the_run_is_created(
    deployed: Prefect, parameters: dict[str, Any], named: str
) -> None:
    backfill = deployed.deployment("replicate/backfill-lake")["id"]
    refused = deployed.ask(f"deployments/{backfill}/create_flow_run", {"parameters": parameters})
    assert refused.status_code == 409
    assert named in refused.text
    told = {"stages": {"navigation": {"max_steps": 3}, "optimization": {"method": {"kind": "paper", "step_m": 0.1}}}}
    taken = deployed.ask(f"deployments/{backfill}/create_flow_run", {"parameters": told, "state": {"type": "CANCELLED"}})
    assert taken.status_code == 201, taken.text


def test_a_scheduled_run_is_picked_up_by_a_worker_in_another_process_and_completed(deployed: Prefect) -> None:
    write_small_scans(deployed.scans, 1)
    nightly = deployed.deployment("replicate/nightly-lake")
    soon = {"interval": 86400.0, "anchor_date": (datetime.now(UTC) + timedelta(seconds=10)).isoformat()}
    schedule = nightly["schedules"][0]
    # The scan is whole; the night would wait for it to settle.
    at_once = {"parameters": nightly["parameters"] | {"settle_seconds": 0, "settings": [*SETTINGS]}}
    deployed.ask(f"deployments/{nightly['id']}", at_once, "PATCH").raise_for_status()
    changed = deployed.ask(f"deployments/{nightly['id']}/schedules/{schedule['id']}", {"schedule": soon}, "PATCH")
    assert changed.status_code < 300, changed.text
    mine = {"deployments": {"id": {"any_": [nightly["id"]]}}}
    worker = subprocess.Popen(
        [sys.executable, "-m", "prefect", "worker", "start", "--pool", "metascenes"], cwd=deployed.folder,
        env=deployed.environment | {"PREFECT_WORKER_QUERY_SECONDS": "1"}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        runs = eventually(
            lambda: [
                run for run in deployed.ask("flow_runs/filter", mine).json() if run["state"]["type"] in ("COMPLETED", "FAILED", "CRASHED")
            ],
            "a run that ended",
        )
    finally:
        tree = [psutil.Process(worker.pid), *psutil.Process(worker.pid).children(recursive=True)]
        for process in tree:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        worker.wait()
        back = {"schedule": schedule["schedule"]}
        deployed.ask(f"deployments/{nightly['id']}", {"parameters": nightly["parameters"]}, "PATCH").raise_for_status()
        deployed.ask(f"deployments/{nightly['id']}/schedules/{schedule['id']}", back, "PATCH").raise_for_status()
    assert [(run["state"]["name"], run["auto_scheduled"]) for run in runs] == [("Completed", True)], runs[0]["state"]["message"]
    assert {"metascenes", "nightly"} <= set(runs[0]["tags"])
    assert not runs[0]["state"]["state_details"]["deployment_concurrency_lease_id"], "no lease that an absent server could end it by"
    rows = Lake.open(str(deployed.lake)).snapshot().rows(StageRun)
    assert {(row.scene_id, row.outcome) for row in rows} == {("scannet/scene0000_00", "done")}
    assert {row.stage for row in rows} == {stage.name for stage in SCENE_STAGES}


@pytest.mark.slow
def test_statistics_are_asked_for_after_our_nightly_run_and_nobody_elses(deployed: Prefect) -> None:
    """Told by the states of runs, without waiting for one: a run that was scheduled less than five minutes before it starts
    has no event of its scheduling, for which Prefect keeps what follows waiting for a quarter of an hour."""
    statistics = {"deployments": {"id": {"any_": [deployed.deployment("statistics/statistics-lake")["id"]]}}}
    before = {one["id"] for one in deployed.ask("flow_runs/filter", statistics).json()}

    def asked() -> list[dict[str, Any]]:
        return [one for one in deployed.ask("flow_runs/filter", statistics).json() if one["id"] not in before]

    flow = deployed.ask("flows/", {"name": "somebodys"}).raise_for_status().json()["id"]
    other = deployed.ask("deployments/", {"name": "nightly-lake", "flow_id": flow}).raise_for_status().json()["id"]
    nightly = deployed.deployment("replicate/nightly-lake")["id"]
    made = []
    for deployment in (other, nightly):
        run = deployed.ask(f"deployments/{deployment}/create_flow_run", {"state": {"type": "RUNNING"}}).raise_for_status().json()["id"]
        ended = deployed.ask(f"flow_runs/{run}/set_state", {"state": {"type": "COMPLETED"}})
        assert ended.raise_for_status().json()["status"] == "ACCEPT"
        made.append(run)
    eventually(asked, "a run of statistics")
    time.sleep(3)
    assert [one["created_by"]["type"] for one in asked()] == ["AUTOMATION"], "once: for ours"
    for run in made:
        deployed.ask(f"flow_runs/{run}", method="DELETE").raise_for_status()
    deployed.ask(f"deployments/{other}", method="DELETE").raise_for_status()


FAILING = """
from prefect import tags
from flows.releases import release
release("/nowhere/else", return_state=True)
with tags("metascenes"):
    release("/nowhere/a \\"lake\\"", return_state=True)
"""


@pytest.mark.slow
def test_a_failed_run_calls_the_webhook_whose_address_stays_a_secret(deployed: Prefect) -> None:
    automations = [each for each in deployed.ask("automations/filter", {}).json() if each["name"] == "metascenes-failures"]
    done = deployed.run([sys.executable, "-c", FAILING])
    assert done.returncode == 0, done.stderr

    def about_it() -> list[tuple[str, dict[str, Any]]]:
        return [call for call in Hook.taken if "/nowhere/" in call[1]["text"]]

    eventually(about_it, "a call of the webhook")
    time.sleep(2)  # what failed first is told of first, so that it is only a second call about the same that could be late
    assert len(about_it()) == 1, "a run without our tag is nobody's business"
    path, said = about_it()[0]
    assert path == f"/{SECRET}"
    assert list(said) == ["text"]
    assert '/nowhere/a "lake"' in said["text"]
    assert "Failed" in said["text"]
    assert "/flow-run/" in said["text"], "a link to the run"
    blocks = deployed.ask("block_documents/filter", {}).json()
    assert [block["name"] for block in blocks] == ["metascenes-notification"]
    assert SECRET not in json.dumps([blocks, automations])
    database = deployed.server.folder / "prefect"
    stored = [file for file in database.rglob("*") if file.is_file() and SECRET.encode() in file.read_bytes()]
    assert not stored, "the server keeps it encrypted"
    code = "from flows.server.notifications import silence; print(*([item.name for item in silence()] for _ in range(2)), sep='\\n')"
    done = deployed.run([sys.executable, "-c", code])
    assert done.stdout.splitlines() == ["['metascenes-failures', 'metascenes-notification']", "[]"], done.stderr
    assert not deployed.ask("block_documents/filter", {}).json()


@pytest.mark.slow
def test_a_run_that_ends_once_is_told_of_once(prefect: Prefect, hook: str) -> None:
    """The server comes upon the same end again: it found its database locked while it handed the event to another automation,
    or a client that had no answer told the state again."""
    prefect.deploy(METASCENES_NOTIFY_URL=hook)
    flow = prefect.ask("flows/", {"name": "ends"}).raise_for_status().json()["id"]

    def failed(name: str) -> str:
        run = {"flow_id": flow, "name": name, "tags": ["metascenes"], "state": {"type": "RUNNING"}}
        made: str = prefect.ask("flow_runs/", run).raise_for_status().json()["id"]
        prefect.ask(f"flow_runs/{made}/set_state", {"state": {"type": "FAILED", "name": "Failed"}}).raise_for_status()
        return made

    def told(run: str) -> int:
        return sum(run in call[1]["text"] for call in Hook.taken)

    first = failed("first")
    occurred = prefect.ask(f"flow_runs/{first}").json()["state"]["timestamp"]
    again = {"prefect.resource.id": f"prefect.flow-run.{first}", "prefect.resource.name": "first"}
    related = [{"prefect.resource.id": "prefect.tag.metascenes", "prefect.resource.role": "tag"}]
    for _ in range(3):
        event = {"occurred": occurred, "event": "prefect.flow-run.Failed", "resource": again, "related": related}
        prefect.ask("events", [event | {"id": str(uuid.uuid4()), "payload": {}}]).raise_for_status()
    eventually(lambda: told(first), "a call of the webhook")
    for name in ("second", "third"):  # what comes later is told of later
        last = failed(name)
        eventually(lambda run=last: told(run), "a call of the webhook")
    assert told(first) == 1


LOST = """
from prefect import flow
from prefect.client.orchestration import get_client
from prefect.events import emit_event
from prefect.states import Completed, Running
from flows.server.notifications import find_lost_runs

find_lost_runs(10)

@flow(name="somebodys")
def somebodys(): ...

with get_client(sync_client=True) as client:
    made = []
    for tags in (["metascenes"], ["metascenes"], ["others"]):
        run = client.create_flow_run(somebodys, tags=tags, state=Running())
        related = [{"prefect.resource.id": f"prefect.tag.{tag}", "prefect.resource.role": "tag"} for tag in tags]
        emit_event("prefect.flow-run.heartbeat", {"prefect.resource.id": f"prefect.flow-run.{run.id}"}, related=related)
        made.append(run.id)
        print(run.id)
    client.set_flow_run_state(made[1], Completed())
"""


@pytest.mark.slow
def test_a_run_that_sends_no_sign_of_life_is_called_crashed(deployed: Prefect) -> None:
    """The machine of a run is gone: nobody is left to say that it ended."""
    done = deployed.run([sys.executable, "-c", LOST])
    assert done.returncode == 0, done.stderr
    lost, ended, others = done.stdout.split()

    def state(run: str) -> str:
        return str(deployed.ask(f"flow_runs/{run}").json()["state"]["name"])

    eventually(lambda: state(lost) == "Crashed", "the end of the lost run")
    assert (state(ended), state(others)) == ("Completed", "Running")
    code = "from flows.server.notifications import find_lost_runs; print(find_lost_runs().change, find_lost_runs().change)"
    assert deployed.run([sys.executable, "-c", code]).stdout.split() == ["changed", "unchanged"]
