"""Who reaches a Prefect server of ours: whoever has its token, under its own names, from its own pages."""

from __future__ import annotations

import asyncio
import base64
import http.server
import importlib.metadata
import json
import os
import shutil
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from bench.flows.services import plain_server
from bench.flows.small_scenes import write_small_scans
from flows.server.access import (
    ADMIT,
    CLIENT_TOKEN,
    SERVER_TOKEN,
    Doorkeeper,
    TokenWatch,
    close_home,
    kept_token,
    own_origins,
    take_token,
    token_file,
)
from flows.server.deployments import CHOSEN, closed
from tests.conftest import REPOSITORY
from tests.flows.server.test_privacy import SERVES
from tests.flows.server.test_services import surroundings
from tests.flows.stats.test_report_browser import FLAGS
from tests.services import PrefectServer, free_port, have_been_started, prefect_server_process

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ORIGINS = own_origins(4200, {"PREFECT_UI_URL": "https://lake.example", "PREFECT_API_URL": "http://prefect:4200/api"})


def knocked(kind: str, *headers: tuple[str, str]) -> list[MutableMapping[str, Any]]:
    """What is sent to whoever knocks with these headers; an application that says 200 stands behind the door."""
    sent: list[MutableMapping[str, Any]] = []

    async def behind(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    scope = {"type": kind, "headers": [(name.encode(), value.encode()) for name, value in headers]}
    asyncio.run(Doorkeeper(behind, ORIGINS)(scope, None, send))  # type: ignore[arg-type]
    return sent


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("headers", "is_let_in"),
    [
        ([("host", "127.0.0.1:4200")], True),
        ([("Host", "LOCALHOST:4200")], True),
        ([("host", "[::1]:4200"), ("origin", "http://localhost:4200")], True),
        ([("host", "prefect:4200")], True),
        ([("host", "lake.example"), ("origin", "https://lake.example")], True),
        ([("host", "lake.example:443")], True),
        ([("host", "127.0.0.1:4201")], False),
        ([("host", "127.0.0.1")], False),
        ([("host", "evil.example:4200")], False),
        ([("host", "127.0.0.1:4200.evil.example")], False),
        ([("host", "127.0.0.1:4200"), ("host", "evil.example")], False),
        ([], False),
        ([("host", "127.0.0.1:4200"), ("origin", "http://evil.example")], False),
        ([("host", "127.0.0.1:4200"), ("origin", "null")], False),
        ([("host", "127.0.0.1:4200"), ("origin", "http://127.0.0.1:8000")], False),
        ([("host", "127.0.0.1:4200"), ("origin", "https://127.0.0.1:4200")], False),
        ([("host", "127.0.0.1:4200"), ("origin", "http://127.0.0.1:4200"), ("origin", "http://evil.example")], False),
    ],
)
def test_only_own_names_and_own_pages_are_let_in(kind: str, headers: list[tuple[str, str]], is_let_in: bool) -> None:
    first = knocked(kind, *headers)[0]
    refused = {"http": ("http.response.start", 403), "websocket": ("websocket.close", None)}[kind]
    assert (first["type"], first.get("status")) == (("http.response.start", 200) if is_let_in else refused)


@pytest.mark.parametrize(
    ("kind", "shown", "is_trusted"),
    [
        ("http", "right", True),
        ("http", "wrong", False),
        ("http", None, False),
        ("websocket", '{"type": "auth", "token": "right"}', True),
        ("websocket", '{"type": "auth", "token": "wrong"}', False),
        ("websocket", '{"type": "auth", "token": "\\ud800"}', False),
        ("websocket", '["right"]', False),
        ("websocket", "[" * 100_000, False),
    ],
)
def test_a_connection_is_trusted_once_the_token_was_shown(kind: str, shown: str | None, is_trusted: bool) -> None:
    trusted: list[bool] = []

    async def receive() -> dict[str, str | None]:
        return {"type": "websocket.receive", "text": shown}

    async def behind(scope: Any, receive: Any, send: Any) -> None:
        if kind == "websocket":
            assert (await receive())["text"] == shown
            await receive()

    header = [(b"authorization", f"Basic {base64.b64encode(shown.encode()).decode()}".encode())] if shown and kind == "http" else []
    scope = {"type": kind, "headers": header, ADMIT: lambda: trusted.append(True)}
    asyncio.run(TokenWatch(behind, "right")(scope, receive, None))  # type: ignore[arg-type]
    assert bool(trusted) == is_trusted


def test_no_variable_makes_all_origins_own_ones() -> None:
    assert own_origins(4200, {"PREFECT_SERVER_CORS_ALLOWED_ORIGINS": "*"}) == own_origins(4200, {})
    assert "https://a.example" in own_origins(1, {"PREFECT_SERVER_CORS_ALLOWED_ORIGINS": "https://a.example:443/x, http://b.example"})


def test_a_token_is_kept_where_only_its_owner_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path / "home"))
    first = kept_token(4200)
    assert len(first) >= 40
    assert stat.S_IMODE(token_file(4200).stat().st_mode) == 0o600
    assert (kept_token(4200), kept_token(4201) == first) == (first, False)
    token_file(4200).chmod(0o640)
    second = kept_token(4200)
    assert second != first, "somebody may have read it"
    assert stat.S_IMODE(token_file(4200).stat().st_mode) == 0o600
    token_file(4200).rename(tmp_path / "elsewhere")
    token_file(4200).symlink_to(tmp_path / "elsewhere")
    assert kept_token(4200) != second
    assert not token_file(4200).is_symlink()


def test_a_command_shows_the_token_of_a_server_of_this_machine_and_to_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
    monkeypatch.delenv(CLIENT_TOKEN, raising=False)
    token = kept_token(4200)
    for address in (
        "http://prefect.example:4200/api",
        "http://127.0.0.1:4201/api",
        "http://127.0.0.1/api",
        "nonsense",
        "http://127.0.0.1:x/",
    ):
        take_token(address)
        assert CLIENT_TOKEN not in os.environ, address
    take_token("http://localhost:4200/api")
    assert os.environ[CLIENT_TOKEN] == token
    monkeypatch.setenv(CLIENT_TOKEN, "mine")
    take_token("http://127.0.0.1:4200/api")
    assert os.environ[CLIENT_TOKEN] == "mine"


@pytest.mark.whole
@pytest.mark.parametrize("named", ["profile", "environment"])
def test_deploying_shows_the_token_of_a_server_that_the_profile_names(named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that says its version, to whoever has the token, and refuses all else."""
    shown: list[tuple[str, str | None]] = []

    class Server(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length") or 0))
            shown.append((self.path, self.headers["Authorization"]))
            is_version = self.path == "/api/admin/version" and shown[-1][1] is not None
            said = json.dumps(importlib.metadata.version("prefect") if is_version else {"detail": "no"}).encode()
            self.send_response(200 if is_version else 400)
            self.send_header("Content-Length", str(len(said)))
            self.end_headers()
            self.wfile.write(said)

        do_POST = do_GET

        def log_message(self, *told: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
        monkeypatch.delenv(CLIENT_TOKEN, raising=False)
        monkeypatch.delenv("PREFECT_API_URL", raising=False)
        token, api = kept_token(server.server_port), f"http://127.0.0.1:{server.server_port}/api"
        if named == "profile":
            (tmp_path / "profiles.toml").write_text(f'active = "mine"\n[profiles.mine]\nPREFECT_API_URL = "{api}"\n')
        else:
            monkeypatch.setenv("PREFECT_API_URL", api)
        command = [sys.executable, "-m", "flows.cli", "deploy", "--scans", "scans", "--lake", str(tmp_path / "lake")]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
        server.shutdown()
    expected = f"Basic {base64.b64encode(token.encode()).decode()}"
    assert {text for _, text in shown} == {expected}, done.stderr
    assert len({path for path, _ in shown}) > 1, "it went on after the version"
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert api in done.stderr


def test_what_prefect_keeps_is_closed_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
    database = tmp_path / "elsewhere" / "runs.db"
    database.parent.mkdir()
    for file in (tmp_path / "prefect.db", tmp_path / "prefect.db-wal", tmp_path / "profiles.toml", tmp_path / "notes.txt", database):
        file.write_text("")
        file.chmod(0o644)
    (tmp_path / "storage").mkdir(mode=0o755)
    close_home(f"sqlite+aiosqlite:///{database}")
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (*tmp_path.iterdir(), database)}
    closed_now = {"prefect.db": 0o600, "prefect.db-wal": 0o600, "profiles.toml": 0o600, "storage": 0o700, "runs.db": 0o600}
    assert modes == closed_now | {"notes.txt": 0o644, "elsewhere": 0o755}


def test_whoever_starts_a_run_cannot_say_what_is_executed() -> None:
    """Neither by a variable that the server would refuse, nor by one that reaches the worker all the same."""
    from prefect.client.orchestration import PrefectClient
    from prefect.workers.process import ProcessJobConfiguration, ProcessWorker

    usual = ProcessWorker.get_default_base_job_template()
    template = closed(usual)
    assert closed(template) == template
    assert template["variables"]["additionalProperties"] is False
    assert not {"command", "working_dir"} & set(template["variables"]["properties"])
    assert not [text for text in template["job_configuration"].values() if any(f"{{{{ {name} }}}}" in str(text) for name in CHOSEN)]
    told = {"command": "touch /tmp/x", "env": {"LD_PRELOAD": "x"}, "env.PATH": "x", "working_dir": "/", "stream_output": False}

    nobody = PrefectClient("http://127.0.0.1:1/api")  # is asked nothing

    def configured(template: dict[str, Any]) -> ProcessJobConfiguration:
        return asyncio.run(ProcessJobConfiguration.from_template_and_values(template, dict(told), client=nobody))

    picked = configured(usual)
    assert (picked.command, picked.env["LD_PRELOAD"], str(picked.working_dir)) == ("touch /tmp/x", "x", "/"), "Prefect's own lets them"
    held = configured(template)
    assert (held.command, held.env, held.working_dir, held.stream_output) == (None, {}, None, False)
    properties = usual["variables"]["properties"]
    properties |= {"command": properties["command"] | {"default": "nice -n 5 python -m prefect.engine"}}
    assert configured(closed(usual)).command == "nice -n 5 python -m prefect.engine", "the administrator's word holds"


def test_a_server_without_a_token_does_not_start(tmp_path: Path) -> None:
    environment = surroundings(tmp_path / "home")
    done = subprocess.run([sys.executable, "-m", "flows.server"], env=environment, cwd=REPOSITORY, capture_output=True, text=True)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert SERVER_TOKEN in done.stderr


class Address:
    """A server, and a run of it that nobody may start."""

    def __init__(self, url: str, token: str) -> None:
        self.url, self.token = url, token

    def ask(self, path: str, body: dict[str, Any] | None = None, token: str = "", **headers: str) -> httpx.Response:
        auth = httpx.BasicAuth(*token.split(":", 1)) if ":" in token else None
        if token and auth is None:
            import base64

            headers["Authorization"] = f"Basic {base64.b64encode(token.encode()).decode()}"
        told = {name.replace("_", "-"): value for name, value in headers.items()}
        method = "GET" if body is None else "POST"
        return httpx.request(method, f"{self.url}/{path}", json=body, headers=told, timeout=None)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectServer]:
    with prefect_server_process(tmp_path_factory.mktemp("server"), PREFECT_SERVER_UI_V2_ENABLED="false") as started:
        yield started


@pytest.fixture(scope="module")
def deployment(server: PrefectServer, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A deployment in a closed pool, and a file that is there once somebody's command was executed."""
    from prefect.workers.process import ProcessWorker

    here = Address(server.url, server.token)
    pool = {"name": "metascenes", "type": "process", "base_job_template": closed(ProcessWorker.get_default_base_job_template())}
    here.ask("work_pools/", pool, server.token).raise_for_status()
    flow = here.ask("flows/", {"name": "replicate"}, server.token).raise_for_status().json()["id"]
    told = {"name": "nightly-lake", "flow_id": flow, "work_pool_name": "metascenes", "entrypoint": "flows.pipeline.replicate"}
    made = here.ask("deployments/", told, server.token).raise_for_status().json()["id"]
    return made, tmp_path_factory.mktemp("harm") / "done"


def runs(server: PrefectServer) -> int:
    counted: int = Address(server.url, server.token).ask("flow_runs/count", {}, server.token).raise_for_status().json()
    return counted


@pytest.mark.whole
def test_a_stranger_commands_nothing(server: PrefectServer, deployment: tuple[str, Path]) -> None:
    here, (made, harm) = Address(server.url, server.token), deployment
    path, order = f"deployments/{made}/create_flow_run", {"job_variables": {"command": f"touch {harm}"}}
    before = runs(server)
    assert here.ask("health").status_code == 200, "who looks whether it is well needs no token"
    assert here.ask(path, order).status_code == 401
    assert here.ask(path, order, "wrong").status_code == 401
    assert here.ask(path, order, server.token, Origin="http://evil.example").status_code == 403
    assert here.ask(path, order, server.token, Host="evil.example").status_code == 403
    assert here.ask("flow_runs/filter", {}, Origin="http://evil.example").headers.get("access-control-allow-origin") is None
    for variables in ({"command": "x"}, {"env": {"LD_PRELOAD": "x"}}, {"env.LD_PRELOAD": "x"}, {"working_dir": "/"}):
        refused = here.ask(path, {"job_variables": variables}, server.token)
        assert refused.status_code == 422, refused.text
    assert runs(server) == before
    assert here.ask(path, {"state": {"type": "CANCELLED"}}, server.token, Origin=server.url.removesuffix("/api")).status_code == 201
    assert not harm.exists()


@pytest.mark.slow
@pytest.mark.whole
def test_the_servers_of_runs_and_of_measurements_are_closed_as_well(tmp_path: Path) -> None:
    def is_closed(url: str) -> None:
        here = Address(url, "")
        assert here.ask("health").status_code == 200
        assert here.ask("flow_runs/filter", {}).status_code == 401
        assert here.ask("health", Origin="http://evil.example").status_code == 403
        assert here.ask("health", Host="evil.example").status_code == 403

    environment = surroundings(tmp_path / "home", started_before=True)
    process = subprocess.Popen(
        [sys.executable, "-c", SERVES], env=environment, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        is_closed(process.stdout.readline().strip())
        kept = [path for path in (tmp_path / "home" / ".prefect").rglob("*") if path.is_file()]
        assert {"prefect.db"} <= {path.name for path in kept}
        assert {stat.S_IMODE(path.stat().st_mode) for path in kept} == {0o600}
    finally:
        process.communicate()
    have_been_started(tmp_path / "bench" / "prefect")
    with plain_server(tmp_path / "bench") as measured:
        is_closed(measured.url)


PAGE = """<!doctype html><title>foreign</title><script>
async function tried(url, options) {
  try { const said = await fetch(url, options); return [said.type, said.status, (await said.text()).slice(0, 80)]; }
  catch (error) { return ["refused"]; }
}
function socket(url) {
  return new Promise(done => {
    const one = new WebSocket(url, ["prefect"]);
    one.onopen = () => one.send(JSON.stringify({type: "auth", token: null}));
    one.onmessage = message => done(["message", message.data]);
    one.onclose = () => done(["closed"]);
  });
}
function framed(url) {
  return new Promise(done => {
    const frame = document.createElement("iframe");
    frame.onload = () => done(frame.contentDocument === null ? "another's" : "own");
    frame.src = url; document.body.append(frame);
  });
}
</script><body>"""


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """A page of another origin."""

    class Pages(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            says_its_version = self.path == "/half/admin/version"  # and then knows nothing more
            self.send_response(200)
            self.send_header("Content-Type", "application/json" if says_its_version else "text/html")
            self.end_headers()
            self.wfile.write(b'"3.8.8"' if says_its_version else PAGE.encode())

        def log_message(self, *_: Any) -> None:
            """Silent."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Pages) as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{served.server_port}/"
        served.shutdown()


@pytest.fixture
def browser() -> Iterator[Callable[[list[str]], Browser]]:
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = []

        def start(flags: list[str]) -> Browser:
            started.append(playwright.chromium.launch(executable_path=path, args=[*FLAGS, *flags]))
            return started[-1]

        yield start
        for each in started:
            each.close()


@pytest.mark.whole
@pytest.mark.browser
@pytest.mark.timeout(900)
def test_a_page_from_elsewhere_reaches_nothing_and_the_own_pages_ask_for_the_token(
    server: PrefectServer, deployment: tuple[str, Path], elsewhere: str, browser: Callable[[list[str]], Browser]
) -> None:
    made, harm = deployment
    before = runs(server)
    opened = browser(["--host-resolver-rules=MAP evil.example 127.0.0.1"])
    page = opened.new_page()
    page.set_default_timeout(240_000)
    page.goto(elsewhere)
    order = json.dumps({"job_variables": {"command": f"touch {harm}"}})
    path = f"{server.url}/deployments/{made}/create_flow_run"
    headers = {"Content-Type": "application/json", **server.header}
    assert page.evaluate("url => tried(url)", f"{server.url}/health") == ["refused"]
    for options in ({"method": "POST", "body": order, "headers": headers}, {"method": "POST", "body": order}):
        assert page.evaluate("([url, options]) => tried(url, options)", [path, options]) == ["refused"]
    blind = {"method": "POST", "body": order, "mode": "no-cors"}
    assert page.evaluate("([url, options]) => tried(url, options)", [path, blind]) == ["opaque", 0, ""], "sent, and refused by the server"
    assert page.evaluate("url => socket(url)", f"{server.url}/events/out".replace("http:", "ws:")) == ["closed"]
    page.goto(f"http://evil.example:{server.port}/")
    assert "does not go by that name" in page.content(), "a foreign name that was pointed to the loopback"
    assert runs(server) == before
    assert not harm.exists()

    page.goto(server.url.removesuffix("/api"))
    page.get_by_placeholder("admin:pass").or_(page.locator("input[type=password]")).first.fill(server.token)
    page.keyboard.press("Enter")
    page.goto(f"{server.url.removesuffix('/api')}/deployments")
    page.get_by_text("nightly-lake").first.wait_for()


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("kind", ["away", "nonsense", "half", "refuses"])
def test_a_named_server_that_is_none_is_one_line_and_no_defect(kind: str, server: PrefectServer, elsewhere: str, tmp_path: Path) -> None:
    write_small_scans(tmp_path / "scans", 1)
    named = {
        "away": f"http://127.0.0.1:{free_port()}/api",
        "nonsense": f"{elsewhere}api",
        "half": f"{elsewhere}half",
        "refuses": server.url,
    }[kind]
    environment = surroundings(tmp_path / "home") | {"PREFECT_API_URL": named}
    environment |= {CLIENT_TOKEN: "wrong"} if kind == "refuses" else {}
    places = ["--scans", str(tmp_path / "scans"), "--lake", str(tmp_path / "lake")]
    for command in (["run", *places, "--workers", "1"], ["deploy", *places]):
        done = subprocess.run(
            [sys.executable, "-m", "flows.cli", *command], env=environment, cwd=REPOSITORY, capture_output=True, text=True
        )
        assert done.returncode == 2, done.stderr
        said = done.stderr.strip().splitlines()
        assert len(said) == 1, done.stderr
        words = {
            "away": "no Prefect server answers",
            "nonsense": "is no Prefect server",
            "half": "is no Prefect server",
            "refuses": CLIENT_TOKEN,
        }[kind]
        assert words in said[0]
        assert named in said[0]
