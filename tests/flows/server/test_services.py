"""The whole path on real services: Prefect's server on PostgreSQL, the lake on S3 (moto's server)."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import pytest

from bench.flows.small_scenes import SETTINGS, write_small_scans
from tests.conftest import REPOSITORY
from tests.services import (
    ROLE,
    S3,
    START_SECONDS,
    Postgres,
    PrefectServer,
    environment_of,
    free_port,
    have_been_started,
    postgres_server,
    prefect_server_process,
    s3_server,
)
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = [pytest.mark.whole, pytest.mark.postgres, pytest.mark.s3]

QUICK = SETTINGS
"""Settings that make every stage short; each still does its own work."""

LAKE = "s3://lakes/services/lake"
SCENES = ["scannet/scene0000_00", "scannet/scene0001_00"]


class Services(NamedTuple):
    """What runs, and the environment of a command that is to use it."""

    postgres: Postgres
    prefect: PrefectServer
    s3: S3
    environment: dict[str, str]


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    folder = tmp_path_factory.mktemp("services")
    with postgres_server(folder) as postgres, s3_server(folder) as s3, environment_of(s3):
        s3.make_bucket("lakes")
        with prefect_server_process(folder, postgres.url) as prefect:
            yield Services(postgres, prefect, s3, surroundings(folder / "home") | s3.access | prefect.access)


def surroundings(home: Path, started_before: bool = False) -> dict[str, str]:
    """The environment of somebody who has set nothing, with a home of their own, in which Prefect's server may have run before."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "METASCENES_", "AWS_", "DO_NOT_TRACK"))}
    home.mkdir(exist_ok=True)
    if started_before:
        have_been_started(home / ".prefect")
    return kept | {"HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache")}


def run(environment: dict[str, str], scans: Path, lake: str | Path, *more: str) -> dict[str, Any]:
    """The report of `metascenes run`, which ends well."""
    command = [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", str(lake), "--workers", "2", "--json"]
    command += [part for setting in QUICK for part in ("--set", setting)]
    done = subprocess.run([*command, *more], env=environment, cwd=REPOSITORY, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr + done.stdout
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def scan(folder: Path, number: int, version: int = 0) -> None:
    """A small room with an object in it, anew if it is there; another one with every version."""
    shutil.rmtree(folder / f"scene{number:04d}_00", ignore_errors=True)
    write_small_scans(folder, 1, seed=version, first=number)


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scans")
    for number in range(2):
        scan(folder, number)
    return folder


@pytest.fixture(scope="module")
def first(services: Services, scans: Path) -> dict[str, Any]:
    """The report of the first run on the services."""
    return run(services.environment, scans, LAKE)


def attempts(lake: str) -> dict[str, int]:
    """How many stage runs every scene has had."""
    rows = Lake.open(lake).snapshot().connect().execute("SELECT scene_id, count(*) FROM stage_runs GROUP BY ALL").fetchall()
    return dict(rows)


def history(postgres: Postgres) -> tuple[list[str], list[str]]:
    """States of the flow runs of `replicate`, and names of completed task runs, as PostgreSQL has them."""
    states = postgres.query("SELECT r.state_type FROM flow_run r JOIN flow f ON f.id = r.flow_id WHERE f.name = 'replicate' ORDER BY 1")
    names = postgres.query("SELECT name FROM task_run WHERE state_type = 'COMPLETED'")
    return [row[0] for row in states], [row[0] for row in names]


def recorded(postgres: Postgres, scenes: list[str]) -> list[str]:
    """States of the flow runs, once the database knows completed task runs of every scene: the server writes them behind."""
    give_up = time.monotonic() + 120
    while True:
        states, names = history(postgres)
        missing = [scene for scene in scenes if not any(scene.rpartition("/")[2] in name for name in names)]
        if not missing:
            return states
        assert time.monotonic() < give_up, f"no task run of {missing} among {names}"
        time.sleep(0.5)


@pytest.mark.slow
def test_a_run_on_the_services_gives_what_one_without_them_gives(
    services: Services, first: dict[str, Any], scans: Path, tmp_path: Path
) -> None:
    assert sorted(first["done"]) == SCENES
    assert recorded(services.postgres, SCENES) == ["COMPLETED"]
    alone = run(surroundings(tmp_path / "home", started_before=True), scans, tmp_path / "lake")
    assert sorted(alone["done"]) == SCENES
    assert digests(Lake.open(LAKE).snapshot()) == digests(Lake.open(tmp_path / "lake").snapshot())
    assert recorded(services.postgres, SCENES) == ["COMPLETED"], "the other run had a server of its own"


@pytest.mark.slow
def test_what_is_redone_does_not_hang_on_the_database(services: Services, first: dict[str, Any], scans: Path) -> None:
    before, counted = digests(Lake.open(LAKE).snapshot()), attempts(LAKE)
    services.prefect.stop()
    services.postgres.recreate()
    services.prefect.start()
    assert history(services.postgres) == ([], [])
    again = run(services.environment, scans, LAKE)
    assert (again["done"], sorted(again["unchanged"]), again["steps"]) == ([], SCENES, 0)
    assert (digests(Lake.open(LAKE).snapshot()), attempts(LAKE)) == (before, counted)
    scan(scans, 1, version=1)
    changed = run(services.environment, scans, LAKE)
    assert (changed["done"], changed["unchanged"]) == (SCENES[1:], SCENES[:1])
    assert recorded(services.postgres, SCENES[1:]) == ["COMPLETED"], "only this run is known to the new database"
    now = attempts(LAKE)
    assert now[SCENES[0]] == counted[SCENES[0]]
    assert now[SCENES[1]] == counted[SCENES[1]] + changed["steps"]


@pytest.mark.slow
def test_another_server_redoes_nothing_but_what_changed(services: Services, first: dict[str, Any], scans: Path, tmp_path: Path) -> None:
    counted = attempts(LAKE)
    scan(scans, 0, version=1)
    with prefect_server_process(tmp_path) as other:
        changed = run(services.environment | other.access, scans, LAKE)
        assert (changed["done"], changed["unchanged"]) == (SCENES[:1], SCENES[1:])
        again = run(services.environment | other.access, scans, LAKE)
        assert (again["done"], again["steps"]) == ([], 0)
    now = attempts(LAKE)
    assert now[SCENES[1]] == counted[SCENES[1]]
    assert now[SCENES[0]] == counted[SCENES[0]] + changed["steps"]


def test_services_come_back_where_they_were(services: Services) -> None:
    services.postgres.query("CREATE TABLE kept (number int)", "postgres")
    services.postgres.query("INSERT INTO kept SELECT * FROM generate_series(1, 1000)", "postgres")
    for service in (services.postgres, services.prefect):
        processes = service.processes()
        assert processes
        service.kill()
        assert not [process for process in processes if process.is_running() and process.status() != psutil.STATUS_ZOMBIE]
        service.start()
    assert services.postgres.query("SELECT count(*), sum(number) FROM kept", "postgres") == [["1000", "500500"]]
    assert services.prefect.answers()


DIES = """
import os, sys
from pathlib import Path
from tests.services import postgres_server, s3_server
with postgres_server(Path(sys.argv[1])) as postgres, s3_server() as s3:
    print(*(process.pid for service in (postgres, s3) for process in service.processes()), flush=True)
    os.kill(os.getpid(), 9)
"""


def test_services_die_with_the_process_that_started_them(tmp_path: Path) -> None:
    died = subprocess.run([sys.executable, "-c", DIES, str(tmp_path)], cwd=REPOSITORY, capture_output=True, text=True, timeout=600)
    processes = [int(number) for number in died.stdout.split()]
    assert died.returncode == -9
    assert len(processes) > 2, died.stderr
    give_up = time.monotonic() + 30
    while living := [pid for pid in processes if psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE]:
        assert time.monotonic() < give_up, living
        time.sleep(0.1)


WITHOUT_POSTGRES = """
import sys, pytest, tests.services as services
services.postgres_binaries = lambda: None
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "tests/flows/server/test_services.py", "-k", "test_services_come_back"]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("needed", "code"), [("1", 1), ("", 0)])
def test_without_postgresql_these_tests_are_skipped_and_ci_fails(needed: str, code: int) -> None:
    environment = os.environ | {"METASCENES_SKIPS_FAIL": needed}
    done = subprocess.run([sys.executable, "-c", WITHOUT_POSTGRES], env=environment, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == code, done.stdout
    assert "apt-get install postgresql" in done.stdout


BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PAGE = [match.groups() for match in BLOCK.finditer((REPOSITORY / "docs" / "services.md").read_text())]


def block(kind: str, begin: str) -> str:
    """The one block of the page of services that begins so."""
    found = [text for each, text in PAGE if each == kind and begin in text]
    assert len(found) == 1, begin
    return found[0]


class Page:
    """The page's blocks in a folder, with the addresses that the tests have instead of the page's."""

    def __init__(self, folder: Path, environment: dict[str, str], addresses: dict[str, str]) -> None:
        self.folder, self.addresses, self.used = folder, addresses, set[str]()
        self.environment = environment | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
        folder.mkdir()

    def text(self, kind: str, begin: str) -> str:
        text = block(kind, begin)
        self.used.add(text)
        for theirs, ours in self.addresses.items():
            text = text.replace(theirs, ours)
        return text

    def run(self, begin: str, kind: str = "bash", **more: str) -> str:
        """What a block prints; it ends well."""
        command = ["bash", "-euc"] if kind == "bash" else [sys.executable, "-c"]
        done = subprocess.run(
            [*command, self.text(kind, begin)], cwd=self.folder, env=self.environment | more, capture_output=True, text=True, timeout=500
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    @contextlib.contextmanager
    def serving(self, begin: str, ready: Callable[[], bool]) -> Iterator[None]:
        """A block that serves until it is ended, from when it is ready."""
        with (self.folder / f"{begin.strip('# ')}.log").open("w+") as log:
            command = ["bash", "-euc", self.text("bash", begin)]
            process = subprocess.Popen(command, cwd=self.folder, env=self.environment, stdout=log, stderr=log, start_new_session=True)
            try:
                give_up = time.monotonic() + START_SECONDS
                while not ready():
                    log.seek(0)
                    said = log.read()
                    assert process.poll() is None, said
                    assert time.monotonic() < give_up, said
                    time.sleep(0.2)
                yield
            finally:
                below = psutil.Process(process.pid).children(recursive=True)
                process.terminate()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(30)
                for each in [process, *below]:
                    with contextlib.suppress(psutil.NoSuchProcess):
                        each.kill()
                process.wait()


def answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2) as reply:
            return bool(reply.status == 200)
    except OSError:
        return False


def serves(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_command_of_the_page_works(tmp_path: Path) -> None:
    """PostgreSQL's role and database, server, schedules, worker, runs, Dask, backup, upgrade: as the page has them."""
    with postgres_server(tmp_path / "services") as postgres, s3_server(tmp_path / "services") as s3, environment_of(s3):
        s3.make_bucket("lakes")
        server, scheduler, dashboard = free_port(), free_port(), free_port()
        (tmp_path / "scans").mkdir()
        scan(tmp_path / "scans", 0)
        addresses = {
            "127.0.0.1:5432": f"127.0.0.1:{postgres.port}", "127.0.0.1:4200": f"127.0.0.1:{server}", "--port 4200": f"--port {server}",
            "127.0.0.1:8333": f"127.0.0.1:{s3.port}", "127.0.0.1:8786": f"127.0.0.1:{scheduler}", "--port 8786": f"--port {scheduler}",
            "127.0.0.1:8787": f"127.0.0.1:{dashboard}", "/data/scans": str(tmp_path / "scans"), "change-me": "changed",
            "from-openssl": base64.urlsafe_b64encode(secrets.token_bytes(32)).decode(),
        }  # fmt: skip
        page = Page(tmp_path / "page", surroundings(tmp_path / "home") | s3.access, addresses)
        (page.folder / "services.env").write_text(page.text("env", "PREFECT_API_URL"))
        administrator = {
            "PGHOST": "127.0.0.1", "PGPORT": str(postgres.port), "PGUSER": ROLE, "PGPASSWORD": postgres.password,
            "POSTGRES_PASSWORD": "changed",
        }  # fmt: skip
        postgres.query("DROP DATABASE prefect", "postgres")
        page.run("CREATE ROLE prefect", **administrator)
        assert "good" in page.run("ThreadPoolExecutor", "python")
        with page.serving("# server", lambda: answers(f"http://127.0.0.1:{server}/api/health")):
            assert "nightly" in page.run("metascenes deploy")
            pool = "SELECT count(*) FROM worker w JOIN work_pool p ON p.id = w.work_pool_id WHERE p.name = 'metascenes'"
            with page.serving("# worker", lambda: postgres.query(pool) == [["1"]]):
                assert "1 scene done" in page.run('metascenes run --scans "$METASCENES_SCANS" --workers')
            scan(tmp_path / "scans", 1)
            with (
                page.serving("# scheduler", lambda: serves(scheduler)),
                page.serving("# dask worker", lambda: "Registered to" in (page.folder / "dask worker.log").read_text()),
            ):
                assert "1 scene done" in page.run("# dask run")
            (page.folder / "backups").mkdir()
            page.run("# backup")
        assert digests(Lake.open(page.folder / "backups" / "lake").snapshot()) == digests(Lake.open("s3://lakes/metascenes").snapshot())
        assert (page.folder / "backups" / "prefect.dump").read_bytes()[:5] == b"PGDMP"
        page.run("# upgrade")
    assert {text for kind, text in PAGE if kind != "sh"} == page.used
