"""`metascenes deploy --local`: a server and a worker of one's own, which listen here alone and end with the command."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import httpx
import psutil
import pytest

from flows.server.services import guarded
from schemas.runs import StageRun
from tasks.pipeline import SCENE_STAGES
from tests.conftest import REPOSITORY
from tests.flows.server.test_deployments import WAIT_SECONDS, eventually
from tests.scans import write_scan
from tests.services import free_port, have_been_started
from warehouse.lake import Lake

pytestmark = [pytest.mark.whole, pytest.mark.timeout(900)]


PARENT = """
import os, sys, time
from flows.server.services import guarded
code = "import subprocess, time; subprocess.Popen(['sleep', '600'], start_new_session=True); time.sleep(600)"
with guarded([sys.executable, "-c", code], os.environ) as process:
    print(process.pid, flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_what_a_service_started_ends_with_us_however_we_end(how: signal.Signals) -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    guard = psutil.Process(int(parent.stdout.readline()))
    below = eventually(lambda: len(found := guard.children(recursive=True)) == 2 and found, "service and its child")
    parent.send_signal(how)
    parent.wait()
    eventually(
        lambda: not any(process.is_running() and process.status() != psutil.STATUS_ZOMBIE for process in [guard, *below]), "the end of all"
    )


def test_a_service_that_cannot_start_leaves_no_file_open() -> None:
    before = psutil.Process().num_fds()
    with pytest.raises(ValueError, match="null"), guarded(["true"], {"NAME": "a\0b"}):
        pytest.fail("it started")
    assert psutil.Process().num_fds() == before


@pytest.mark.slow
def test_a_server_and_worker_of_ones_own_listen_on_this_machine_alone_and_end_with_the_command(tmp_path: Path) -> None:
    port = free_port()
    write_scan(tmp_path / "scans", "scene0000_00")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")} | {
        "PREFECT_HOME": str(tmp_path / "home")
    }
    command = [sys.executable, "-m", "flows.cli", "deploy", "--local", "--port", str(port), "--json", "--scans", str(tmp_path / "scans")]
    command += ["--lake", str(tmp_path / "lake"), "--out", str(tmp_path / "out"), "--watch", "0 0 1 1 *"]
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(command, cwd=REPOSITORY, env=environment, stdout=subprocess.PIPE, stderr=said, text=True)
    try:
        assert process.stdout is not None
        items = json.loads(process.stdout.readline())["items"]
        assert {item["change"] for item in items} == {"created"}
        below = psutil.Process(process.pid).children(recursive=True)
        listening = [address.laddr for each in below for address in each.net_connections() if address.status == psutil.CONN_LISTEN]
        assert port in {address.port for address in listening}
        assert {address.ip for address in listening} == {"127.0.0.1"}
        assert httpx.get(f"http://127.0.0.1:{port}/", follow_redirects=True, timeout=None).status_code == 200, "the UI"
        assert httpx.get(f"http://127.0.0.1:{port}/api/admin/version", timeout=None).status_code == 401
        token_file = tmp_path / "home" / f"metascenes-{port}.token"
        assert {stat.S_IMODE(path.stat().st_mode) & 0o077 for path in (tmp_path / "home").iterdir()} == {0}
        token = token_file.read_text()
        everyone = [psutil.Process(process.pid), *below]
        assert not [each for each in everyone if token in " ".join(each.cmdline())], "everybody on the machine can read arguments"
        command = [sys.executable, "-m", "prefect", "deployment", "run", "replicate/nightly-lake", "--param", "settle_seconds=0", "--watch"]
        environment |= {"PREFECT_API_URL": f"http://127.0.0.1:{port}/api", "PREFECT_API_AUTH_STRING": token}
        run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=WAIT_SECONDS)
        assert run.returncode == 0, run.stdout + run.stderr
        rows = Lake.open(str(tmp_path / "lake")).snapshot().rows(StageRun)
        assert {(row.stage, row.outcome) for row in rows} == {(stage.name, "done") for stage in SCENE_STAGES}
        below = psutil.Process(process.pid).children(recursive=True)
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(60)
    assert code == 130
    words = (tmp_path / "said").read_text()
    assert str(token_file) in words
    assert token not in words
    eventually(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in below), "the end of all")


@pytest.mark.slow
def test_a_server_of_ones_own_that_dies_ends_the_command_which_says_so(tmp_path: Path) -> None:
    port = free_port()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")} | {
        "PREFECT_HOME": str(have_been_started(tmp_path / "home"))
    }
    command = [sys.executable, "-m", "flows.cli", "deploy", "--local", "--port", str(port), "--json", "--scans", str(tmp_path / "scans")]
    command += ["--lake", str(tmp_path / "lake"), "--out", str(tmp_path / "out")]
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(command, cwd=REPOSITORY, env=environment, stdout=subprocess.PIPE, stderr=said, text=True)
    assert process.stdout is not None
    try:
        assert json.loads(process.stdout.readline())["items"]
        below = psutil.Process(process.pid).children(recursive=True)

        def listens(each: psutil.Process) -> bool:
            return any(one.laddr.port == port for one in each.net_connections() if one.status == psutil.CONN_LISTEN)

        servers = [each for each in below if listens(each)]
        assert servers
        for server in servers:
            server.kill()
        assert process.wait(WAIT_SECONDS) == 1
    finally:
        process.kill()
        process.wait()
    assert "metascenes: the Prefect server ended" in (tmp_path / "said").read_text()
    eventually(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in below), "the end of all")
