"""A batch of a lake served to its people: in this process, or in one of its own, and what they ask by HTTP."""

from __future__ import annotations

import contextlib
import hashlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
from fastapi.testclient import TestClient

from flows.inputs.annotation import BatchPlan, create_batch
from flows.server.access import new_token
from flows.view.annotating.drafts import Drafts
from flows.view.annotating.routes import annotation_application
from flows.view.annotating.settling import Rooms
from flows.view.annotating.work import ServedBatch
from flows.view.gate import guarded
from schemas.annotation import Assignment
from tests.annotated import annotatable
from tests.conftest import REPOSITORY
from warehouse.lake import Lake

BATCH = "b1"
PORT = 8797
ORIGIN = f"http://127.0.0.1:{PORT}"
LAUNCH = """
import sys
from pathlib import Path
from flows.view import bundle
bundle.BUILT = Path(sys.argv.pop(1))
{first}
from flows.cli import main
main()
"""
"""The command with a stand-in of the client, so that nothing has to be built."""


def asked_lake(folder: Path, people: tuple[str, ...] = ("ada", "bob"), overlap: int = 1, objects: int = 4, **plan: Any) -> Lake:
    """A lake with a batch, `lake` in a folder."""
    lake = annotatable(folder / "lake", objects)
    create_batch(lake, BatchPlan(BATCH, people, overlap, **plan), folder / "work")
    return lake


def stand_in(folder: Path) -> Path:
    """A client of empty pages."""
    folder.mkdir(exist_ok=True)
    for name in ("view.js", "view.html", "annotate.html"):
        (folder / name).write_text(f"<!-- {name} -->")
    return folder


class Guest:
    """Somebody who opened the address with their token."""

    def __init__(self, address: str) -> None:
        self.base = address.partition("/?")[0]
        self.client = httpx.Client(base_url=self.base, headers={"origin": self.base}, timeout=300)
        assert self.client.get(address).status_code == 200

    def ask(self, method: str, path: str, body: Any = None, status: int = 200) -> Any:
        """What the server answers, as JSON, by a status."""
        answer = self.client.request(method, path, json=body)
        assert answer.status_code == status, (method, path, answer.status_code, answer.text)
        return answer.json()

    def objects(self) -> list[dict[str, Any]]:
        """What is asked of them."""
        return list(self.ask("GET", "/api/work")["objects"])


class Server:
    """`metascenes annotate serve` in a process of its own. Ended by `end`; what it wrote to standard error is `errors` then."""

    def __init__(self, folder: Path, *options: str, first: str = "") -> None:
        """`first`: code that the process runs before the command."""
        arguments = ["annotate", "serve", BATCH, "--lake", str(folder / "lake"), "--json", *options]
        command = [sys.executable, "-c", LAUNCH.format(first=first), str(stand_in(folder / "built")), *arguments]
        self.process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise AssertionError(self.process.communicate()[1])
        self.addresses: dict[str, dict[str, Any]] = json.loads(line)["addresses"]
        self.errors = ""

    def guest(self, name: str) -> Guest:
        """Somebody of the batch, by their own address."""
        return Guest(self.addresses[name]["address"])

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Ends it; its exit code."""
        self.process.send_signal(how)
        self.errors = self.process.communicate()[1]
        return self.process.returncode


@contextlib.contextmanager
def serving(folder: Path, *options: str, first: str = "") -> Iterator[Server]:
    """A server that is ended in any case."""
    server = Server(folder, *options, first=first)
    try:
        yield server
    finally:
        if server.process.poll() is None:
            server.end(signal.SIGKILL)


def digests(folder: Path) -> dict[str, str]:
    """Hash of every file below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


class Desk:
    """The application as it is served, with a client for everybody; ada and bob answer, rita and bob review."""

    def __init__(self, folder: Path) -> None:
        self.lake, self.folder = asked_lake(folder), folder
        self.drafts = Drafts(folder / "lake" / "drafts" / "b1.sqlite", BATCH)
        self.work = ServedBatch(self.lake, BATCH, self.drafts, ["rita", "Bob"])
        self.app = annotation_application(self.work, Rooms(self.work))
        self.tokens = {name: new_token() for name in self.work.roles}
        self.guard = guarded(self.app, PORT, lambda: {token: name for name, token in self.tokens.items()})

    def stranger(self) -> TestClient:
        return TestClient(self.guard, base_url=ORIGIN, follow_redirects=False, raise_server_exceptions=False)  # type: ignore[arg-type]

    def client(self, name: str) -> TestClient:
        client = self.stranger()
        assert client.get("/", params={"token": self.tokens[name]}).status_code == 200
        client.headers["origin"] = ORIGIN
        return client

    def own(self, name: str) -> str:
        row = next(row for row in self.lake.snapshot().rows(Assignment) if row.annotator == name)
        return f"{row.scene_id}/{row.instance_id}"

    def routes(self) -> Iterator[tuple[str, str]]:
        """Every method of every route, those of included routers among them."""
        left: list[Any] = list(self.app.routes)
        for route in left:
            inner = getattr(route, "original_router", None)
            left += inner.routes if inner is not None else ()
            yield from ((method, route.path) for method in (sorted(route.methods) if inner is None else ()))
