"""Deployments as an older version set them up (`golden/deployments.json`): they run on under today's code, and `metascenes deploy`
brings them up without leaving two of anything."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from bench.flows.small_scenes import SETTINGS, write_small_scans
from flows.server.deployments import BASES, closed
from schemas.runs import StageRun
from tests.conftest import REPOSITORY
from tests.flows.server.test_deployments import FAST, NAMES, Prefect, eventually
from tests.services import prefect_server_process
from warehouse.lake import Lake

pytestmark = [pytest.mark.whole, pytest.mark.timeout(1500)]

FORMER = (REPOSITORY / "tests" / "golden" / "deployments.json").read_text()

BLOCK = """
from prefect.blocks.webhook import Webhook
print(Webhook(url="http://127.0.0.1:9/hook", method="POST").save("metascenes-notification"))
"""


@pytest.fixture(scope="module")
def prefect(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prefect]:
    with prefect_server_process(tmp_path_factory.mktemp("prefect"), None, **FAST) as server:
        yield Prefect(server, tmp_path_factory.mktemp("place"))


@pytest.fixture(scope="module")
def former(prefect: Prefect) -> dict[str, str]:
    """Pool, limits, deployments and automations as they were; ids of the deployments by `flow/name`."""
    told = FORMER
    for place in ("scans", "lake", "out"):
        told = told.replace(f'"/data/{place}', f'"{getattr(prefect, place)}')
    was = json.loads(told)
    prefect.ask("work_pools/", was["pool"]).raise_for_status()
    for limit in was["limits"]:
        prefect.ask("v2/concurrency_limits/", limit).raise_for_status()
    flows = {name: prefect.ask("flows/", {"name": name}).raise_for_status().json()["id"] for name in was["schemas"]}
    ids = {}
    for one in was["deployments"]:
        flow = one.pop("flow")
        body = one | {"flow_id": flows[flow], "parameter_openapi_schema": was["schemas"][flow]}
        ids[f"{flow}/{one['name']}"] = prefect.ask("deployments/", body).raise_for_status().json()["id"]
    done = prefect.run([sys.executable, "-c", BLOCK])
    assert done.returncode == 0, done.stderr
    for automation in was["automations"]:
        owner = automation.pop("owner")
        for action in automation["actions"]:
            if "deployment_id" in action:
                action["deployment_id"] = ids[action["deployment_id"]]
            if "block_document_id" in action:
                action["block_document_id"] = done.stdout.split()[-1]
        automation |= {"owner_resource": f"prefect.deployment.{ids[owner]}"} if owner else {}
        prefect.ask("automations/", automation).raise_for_status()
    return ids


def test_their_flows_are_found_and_take_what_they_tell_them() -> None:
    from prefect.flows import load_flow_from_entrypoint

    names = set()
    for one in json.loads(FORMER)["deployments"]:
        flow: Any = load_flow_from_entrypoint(one["entrypoint"])
        assert flow.name == one["flow"]
        flow.validate_parameters(one["parameters"])
        names.add(one["name"])
    assert names == set(BASES) - LATER


LATER = {"train", "evaluate", "drive", "compare"}
"""Deployments that these servers did not have yet."""


def ended(prefect: Prefect, deployment: str) -> list[dict[str, Any]]:
    """The runs of a deployment."""
    found: list[dict[str, Any]] = prefect.ask("flow_runs/filter", {"deployments": {"id": {"any_": [deployment]}}}).json()
    return found


@contextlib.contextmanager
def working(prefect: Prefect) -> Iterator[None]:
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", "metascenes"]
    with (prefect.folder / "worker.log").open("w") as log:
        worker = subprocess.Popen(
            command, cwd=prefect.folder, env=prefect.environment | {"PREFECT_WORKER_QUERY_SECONDS": "1"}, stdout=log, stderr=log,
            start_new_session=True,
        )  # fmt: skip
    try:
        yield
    finally:
        for process in [psutil.Process(worker.pid), *psutil.Process(worker.pid).children(recursive=True)]:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        worker.wait()


def complete(prefect: Prefect, deployment: str) -> None:
    """A run of a deployment that ends well, as the server is told it."""
    run = prefect.ask(f"deployments/{deployment}/create_flow_run", {"state": {"type": "RUNNING"}}).raise_for_status().json()["id"]
    prefect.ask(f"flow_runs/{run}/set_state", {"state": {"type": "COMPLETED"}}).raise_for_status()


@pytest.mark.slow
def test_they_run_on_under_todays_code(prefect: Prefect, former: dict[str, str]) -> None:
    write_small_scans(prefect.scans, 1)
    nightly = former["replicate/nightly"]
    told = {"parameters": {"settle_seconds": 0, "settings": [*SETTINGS]}}
    run = prefect.ask(f"deployments/{nightly}/create_flow_run", told).raise_for_status().json()["id"]

    def state() -> dict[str, Any]:
        found: dict[str, Any] = prefect.ask(f"flow_runs/{run}").json()["state"]
        return found

    with working(prefect):
        eventually(lambda: state()["type"] in ("COMPLETED", "FAILED", "CRASHED"), "the end of the run")
    assert state()["type"] == "COMPLETED", state()["message"]
    rows = Lake.open(str(prefect.lake)).snapshot().rows(StageRun)
    assert {(row.scene_id, row.outcome) for row in rows} == {("scannet/scene0000_00", "done")}


@pytest.mark.slow
def test_deploying_another_lake_leaves_them_and_deploying_theirs_replaces_them(prefect: Prefect, former: dict[str, str]) -> None:
    names = {one["name"] for one in prefect.ask("deployments/filter", {}).json()}
    assert names == set(BASES) - LATER
    other = prefect.deploy("--lake", str(prefect.folder / "other" / "lake"), "--name", "other")
    assert {change for name, change in other.items() if "/" in name} == {"created"}
    assert {one["name"] for one in prefect.ask("deployments/filter", {}).json()} == names | {f"{base}-other" for base in BASES}
    pool = prefect.ask("work_pools/metascenes").json()
    assert pool["base_job_template"] == closed(pool["base_job_template"]), "a pool that was there is closed, too"
    made = prefect.ask(f"deployments/{former['replicate/backfill']}/create_flow_run", {"state": {"type": "CANCELLED"}})
    assert made.status_code == 201, f"what they say of the environment is let through: {made.text}"

    (resting,) = prefect.deployment("watch/watch")["schedules"]
    prefect.ask(f"deployments/{former['watch/watch']}/schedules/{resting['id']}", {"active": False}, "PATCH").raise_for_status()
    changes = prefect.deploy()
    assert {name for name, change in changes.items() if change == "removed"} == set(former)
    assert {changes[name] for name in NAMES} == {"created"}
    lakes = ("lake", "other")
    assert {one["name"] for one in prefect.ask("deployments/filter", {}).json()} == {f"{base}-{lake}" for base in BASES for lake in lakes}
    assert [each["active"] for each in prefect.deployment("watch/watch-lake")["schedules"]] == [False], "what was paused stays so"
    assert [each["active"] for each in prefect.deployment("replicate/nightly-lake")["schedules"]] == [True]
    automations = [each["name"] for each in prefect.ask("automations/filter", {}).json()]
    asking = [f"metascenes-{asked}-{lake}" for asked in ("statistics-after-nightly", "train-after-release") for lake in lakes]
    assert sorted(automations) == sorted(["metascenes-failures", "metascenes-lost-runs", *asking])

    for lake in ("lake", "other"):
        complete(prefect, prefect.deployment(f"replicate/nightly-{lake}")["id"])
        eventually(lambda lake=lake: ended(prefect, prefect.deployment(f"statistics/statistics-{lake}")["id"]), "statistics")
    assert [len(ended(prefect, prefect.deployment(f"statistics/statistics-{lake}")["id"])) for lake in lakes] == [1, 1], "each its own"
    assert {change for name, change in prefect.deploy().items() if "/" in name} == {"unchanged"}


@pytest.mark.slow
def test_a_name_is_one_lakes(prefect: Prefect, former: dict[str, str]) -> None:
    """The last part of their addresses is the same."""
    prefect.deploy()
    before = prefect.facts()
    elsewhere = prefect.folder / "elsewhere" / "lake"
    command = [sys.executable, "-m", "flows.cli", *prefect.told, "--lake", str(elsewhere)]
    done = prefect.run(command)
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1), done.stderr
    assert "--name" in done.stderr
    assert str(prefect.lake) in done.stderr
    prefect.deploy("--lake", str(elsewhere), "--name", "elsewhere")
    assert prefect.facts() == before
    watch = prefect.deployment("watch/watch-elsewhere")["parameters"]
    assert (watch["lake"], watch["deployment"]) == (str(elsewhere), "replicate/backfill-elsewhere")
    assert Path(prefect.deployment("replicate/backfill-elsewhere")["parameters"]["lake"]) == elsewhere
