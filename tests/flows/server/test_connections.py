"""Connections of the servers: too many of them, slow ones, bodies for nothing, and what is written about it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import connect as open_websocket

from flows.server import connections
from flows.server.access import admit
from flows.server.connections import Connections, CountedErrors, bound, limited_server
from flows.view import bundle
from tests.conftest import REPOSITORY
from tests.flows.view.batches import LAUNCH, asked_lake, serving, stand_in
from tests.flows.view.lakes import shown_lake
from tests.services import PrefectServer

FEW_FILES = "import resource\nresource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))\n"
STRANGERS = 300
KNOWN = b"GET / HTTP/1.1\r\nHost: x\r\nX-Token: yes\r\n\r\n"
HALF_OPEN = {
    "nothing": b"",
    "head": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ",
    "body": b"POST /api/x HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000000\r\n\r\nabc",
}
MAX_LOG_BYTES = 4096

MAX_SILENCE_SECONDS = 60.0
"""Until a test fails whose connection says nothing and does not end; a busy machine answers within seconds."""


class Line:
    """A transport that notes its end."""

    def __init__(self) -> None:
        self.is_dropped = False

    def abort(self) -> None:
        self.is_dropped = True


@given(st.integers(1, 8), st.lists(st.sampled_from(["open", "trust", "busy", "close"]), max_size=60), st.randoms())
def test_the_oldest_strangers_are_dropped_first(most: int, acts: list[str], draw: Any) -> None:
    """Against a plain list of what is open: oldest first, with trust and work."""
    book = Connections(most)
    model: list[tuple[Line, bool, list[bool]]] = []  # connection, is trusted, is idle
    for act in acts:
        if act == "open":
            model.append((Line(), False, [True]))
            book.add(model[-1][0])  # type: ignore[arg-type]
            if len(model) > most:
                strangers = [row for row in model[:-1] if not row[1]]
                idle = [row for row in model[:-1] if row[1] and row[2][0]]
                dropped = (strangers or idle or [model[-1]])[0]
                assert dropped[0].is_dropped
                model.remove(dropped)
        elif model:
            row = draw.choice(model)
            if act == "trust":
                is_idle = row[2]
                book.trust(row[0], lambda is_idle=is_idle: is_idle[0])
                if not row[1]:
                    model = [each for each in model if each[1]] + [(row[0], True, is_idle)] + [
                        each for each in model if not each[1] and each is not row
                    ]  # fmt: skip
            elif act == "busy":
                row[2][0] = not row[2][0]
            else:
                book.remove(row[0])
                model.remove(row)
        assert not any(row[0].is_dropped for row in model)
        assert len(model) <= most


async def application(scope: Any, receive: Any, send: Any) -> None:
    """Lets in who shows a header, and answers 401 to all others without reading."""
    if scope["type"] != "http":
        return
    is_known = any(name == b"x-token" for name, _ in scope["headers"])
    status, said = 401, b"no"
    if is_known:
        admit(scope)
        status, said, is_whole = 200, b"", False
        while not is_whole:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            said, is_whole = said + message.get("body", b""), not message.get("more_body")
    await send({"type": "http.response.start", "status": status, "headers": [(b"content-length", str(len(said)).encode())]})
    await send({"type": "http.response.body", "body": said})


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Callable[[], socket.socket]]]:
    """Starts a server with other limits; opens connections to it, which are silent for `MAX_SILENCE_SECONDS` at most."""
    with contextlib.ExitStack() as stack:

        def start(app: Any = application, most: int = 6, has_sockets: bool = False, **limits: float) -> Callable[[], socket.socket]:
            for name, value in ({"MAX_IDLE_SECONDS": 1000, "MAX_HEAD_SECONDS": 1000} | limits).items():
                monkeypatch.setattr(connections, name, value)
            monkeypatch.setattr(connections, "connection_limit", lambda: most)
            listening = stack.enter_context(bound("127.0.0.1", 0))
            listening.listen()
            address, server = listening.getsockname(), limited_server(app, has_sockets=has_sockets)
            thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
            thread.start()
            stack.callback(thread.join)
            stack.callback(setattr, server, "should_exit", True)
            return lambda: stack.enter_context(socket.create_connection(address, MAX_SILENCE_SECONDS))

        yield start


def answer(connection: socket.socket, request: bytes = b"") -> bytes:
    """Bytes that arrive until the answer is complete or the connection ends."""
    connection.sendall(request)
    said = b""
    with contextlib.suppress(ConnectionError):
        while not (b"\r\n\r\n" in said and said.partition(b"\r\n\r\n")[2]) and (part := connection.recv(65536)):
            said += part
    return said


def has_ended(connection: socket.socket) -> bool:
    """Wait for the end of a connection. False if it stays open without a byte for the socket's timeout."""
    with contextlib.suppress(ConnectionError):
        try:
            while connection.recv(65536):
                pass
        except TimeoutError:
            return False
    return True


def test_a_connection_that_stays_open_is_noticed(started: Callable[..., Callable[[], socket.socket]]) -> None:
    """Otherwise a limit that is broken would stop the tests instead of failing them."""
    connection = started()()
    assert connection.gettimeout() == MAX_SILENCE_SECONDS
    connection.settimeout(0.05)
    assert not has_ended(connection)


@pytest.mark.parametrize("sent", HALF_OPEN.values(), ids=list(HALF_OPEN))
def test_strangers_do_not_keep_people_out(started: Callable[..., Callable[[], socket.socket]], sent: bytes) -> None:
    connect = started()
    first = connect()
    assert answer(first, KNOWN.replace(b"GET", b"POST").replace(b"\r\n\r\n", b"\r\nContent-Length: 2\r\n\r\nhi")).endswith(b"hi")
    strangers = [connect() for _ in range(30)]
    for stranger in strangers:
        with contextlib.suppress(ConnectionError):
            stranger.sendall(sent)
    request = KNOWN.replace(b"\r\n\r\n", b"\r\nContent-Length: 2\r\n\r\nho")
    assert answer(connect(), request).endswith(b"ho")
    assert answer(first, request).endswith(b"ho"), "a trusted connection is kept open"
    assert all(has_ended(stranger) for stranger in strangers[:-6])


def test_a_head_that_drips_is_not_waited_for(started: Callable[..., Callable[[], socket.socket]]) -> None:
    connect = started(MAX_HEAD_SECONDS=0.05, MAX_HEAD_BYTES=1 << 40)
    assert has_ended(connect()), "nothing"
    dripping, drip = connect(), threading.Thread(target=lambda: pour(dripping, b"x", 1 << 40))
    drip.start()  # a byte each time, with no pause that would end it earlier
    assert has_ended(dripping)
    drip.join()


def pour(connection: socket.socket, part: bytes, most: int) -> int:
    """Send a part again and again until the other side takes no more; how many bytes the system took."""
    sent = 0
    with contextlib.suppress(ConnectionError):
        while sent < most:
            sent += connection.send(part)
    return sent


def test_idle_connections_end(started: Callable[..., Callable[[], socket.socket]]) -> None:
    connection = started(MAX_IDLE_SECONDS=0.05)()
    assert b"401" in answer(connection, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    assert has_ended(connection)


def test_a_body_that_stalls_is_not_waited_for(started: Callable[..., Callable[[], socket.socket]]) -> None:
    connection = started(MAX_BODY_SECONDS=0.05)()
    connection.sendall(KNOWN.replace(b"\r\n\r\n", b"\r\nContent-Length: 5\r\n\r\nab"))
    assert has_ended(connection)


@pytest.mark.parametrize("is_first_request", [True, False])
def test_a_websocket_outlasts_the_limits_of_requests(
    started: Callable[..., Callable[[], socket.socket]], monkeypatch: pytest.MonkeyPatch, is_first_request: bool
) -> None:
    """The server's clock goes on by more than any limit while messages are exchanged: every timer that was left expires."""

    async def echo(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "websocket":
            await application(scope, receive, send)
            return
        await receive()
        await send({"type": "websocket.accept"})
        while (message := await receive())["type"] == "websocket.receive":
            if message["text"] == "later":
                monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: time.monotonic() + 1e6)
                await asyncio.sleep(0.001)  # a timer behind those that are due
            await send({"type": "websocket.send", "text": message["text"]})

    connection = started(echo, has_sockets=True)()
    if not is_first_request:
        assert b" 401 " in answer(connection, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    with open_websocket("ws://127.0.0.1/", sock=connection, proxy=None, open_timeout=MAX_SILENCE_SECONDS) as client:
        for text in ("first", "later", "after it", "last"):
            client.send(text)
            assert client.recv(MAX_SILENCE_SECONDS) == text


@pytest.mark.parametrize("length", [b"Content-Length: 100000000000", b"Transfer-Encoding: chunked"])
def test_bodies_of_refused_requests_are_not_read(started: Callable[..., Callable[[], socket.socket]], length: bytes) -> None:
    connection = started(MAX_DISCARDING_SECONDS=1000)()
    assert b" 401 " in answer(connection, b"POST / HTTP/1.1\r\nHost: x\r\n" + length + b"\r\n\r\n")
    assert pour(connection, b"ffff\r\n" + b"x" * 0xFFFF + b"\r\n", 1 << 30) < 32 << 20, "what the system keeps on the way"


def test_a_refused_body_that_stalls_ends(started: Callable[..., Callable[[], socket.socket]]) -> None:
    connection = started(MAX_DISCARDING_SECONDS=0.05)()
    assert b" 401 " in answer(connection, b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n")
    assert has_ended(connection)


WRONG = {
    "length and chunks": b"POST / HTTP/1.1\r\nHost: x\r\nX-Token: a\r\nContent-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "two lengths": b"POST / HTTP/1.1\r\nHost: x\r\nX-Token: a\r\nContent-Length: 4\r\nContent-Length: 5\r\n\r\n0\r\n\r\n",
    "odd coding": b"POST / HTTP/1.1\r\nHost: x\r\nX-Token: a\r\nTransfer-Encoding: chunked, identity\r\n\r\n0\r\n\r\n",
    "negative length": b"POST / HTTP/1.1\r\nHost: x\r\nX-Token: a\r\nContent-Length: -4\r\n\r\n",
    "no host": b"GET / HTTP/1.1\r\nX-Token: a\r\n\r\n",
    "folded": b"GET / HTTP/1.1\r\nHost: x\r\nX-Token : a\r\n\r\n",
    "zero": b"GET /\0 HTTP/1.1\r\nHost: x\r\nX-Token: a\r\n\r\n",
    "no HTTP": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
    "long line": b"GET /" + b"a" * 40_000,
    "long head": b"GET / HTTP/1.1\r\nHost: x\r\n" + b"X-A: b\r\n" * 6000,
}


@pytest.mark.parametrize("request_bytes", WRONG.values(), ids=list(WRONG))
def test_what_is_not_http_is_refused_in_a_line(
    started: Callable[..., Callable[[], socket.socket]], request_bytes: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    said = answer(started()(), request_bytes)
    assert said.startswith(b"HTTP/1.1 400 Bad Request\r\n")
    assert b"x-content-type-options: nosniff" in said.lower()
    assert b"Traceback" not in said
    assert "Traceback" not in capfd.readouterr().err


def test_garbage_in_a_body_ends_the_connection_without_a_trace(
    started: Callable[..., Callable[[], socket.socket]], capfd: pytest.CaptureFixture[str]
) -> None:
    async def slow(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b"first", "more_body": True})
            while (await receive())["type"] != "http.disconnect":
                pass
            await send({"type": "http.response.body", "body": b"last"})

    connection = started(slow)()
    assert b"first" in answer(connection, b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n")
    connection.sendall(b"not a length\r\n")
    assert has_ended(connection)
    assert "Traceback" not in capfd.readouterr().err


def test_an_error_is_written_once_and_then_with_its_count() -> None:
    written: list[str] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            written.append(self.format(record))

    counted, handlers, logger = CountedErrors(), [Kept(), Kept()], logging.Logger("x")
    for handler in handlers:
        handler.addFilter(counted)
        logger.addHandler(handler)
    for _ in range(12345):
        try:
            raise OSError(24, "Too many open files")
        except OSError:
            logger.exception("accept failed for %d", 7)
        logger.error("other")
    assert len(written) == 2 * 2 * 5
    assert written[0].startswith("accept failed for 7\nTraceback")
    assert sum("Traceback" in line for line in written) == 2
    assert written[-4] == "accept failed for 7: OSError: [Errno 24] Too many open files (10000 times so far)"
    assert sum(map(len, written)) < MAX_LOG_BYTES


def crowd(address: httpx.URL, sent: bytes) -> list[socket.socket]:
    """Strangers who hold connections."""
    assert address.port is not None
    strangers = []
    for _ in range(STRANGERS):
        strangers.append(socket.create_connection((address.host, address.port)))
        with contextlib.suppress(ConnectionError):
            strangers[-1].sendall(sent)
    return strangers


@pytest.mark.slow
@pytest.mark.whole
def test_people_are_let_in_among_300_strangers_with_256_files(tmp_path: Path) -> None:
    """The viewer and the annotation page."""
    lake = shown_lake(tmp_path)
    arguments = ["view", "--lake", lake.address, "--json", "--no-browser"]
    command = [sys.executable, "-c", LAUNCH.format(first=FEW_FILES), str(stand_in(tmp_path / "built")), *arguments]
    viewer = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert viewer.stdout is not None
        address = httpx.URL(json.loads(viewer.stdout.readline())["address"])
        for sent in HALF_OPEN.values():
            strangers = crowd(address, sent)
            with httpx.Client(base_url=str(address.copy_with(query=None)), timeout=300) as client:
                assert client.get(address).status_code == 200
                assert client.get("/api/scenes").status_code == 200
            for stranger in strangers:
                stranger.close()
    finally:
        viewer.terminate()
        errors = viewer.communicate()[1]
    assert len(errors) < MAX_LOG_BYTES
    asked_lake(tmp_path / "asked")
    with serving(tmp_path / "asked", first=FEW_FILES) as server:
        address = httpx.URL(server.addresses["ada"]["address"])
        for sent in HALF_OPEN.values():
            strangers = crowd(address, sent)
            server.guest("ada").ask("GET", "/api/me")
            for stranger in strangers:
                stranger.close()
        server.end()
    assert len(server.errors) < MAX_LOG_BYTES


class SmallServer(PrefectServer):
    """A Prefect server that may open few files."""

    def command(self) -> list[str]:
        code = f"{FEW_FILES}import sys\nfrom flows.server.process import main\nsys.exit(main())"
        return [sys.executable, "-c", code, "--port", str(self.port)]


@pytest.mark.whole
def test_clients_of_prefect_are_let_in_among_300_strangers_with_256_files(tmp_path: Path) -> None:
    server = SmallServer(tmp_path, None, {})
    try:
        server.start()
        before = server.log.stat().st_size
        for sent in HALF_OPEN.values():
            strangers = crowd(httpx.URL(server.url), sent)
            with httpx.Client(timeout=300) as client:
                assert client.get(f"{server.url}/health").status_code == 200
                assert client.post(f"{server.url}/flows/filter", json={}).status_code == 401
                assert client.post(f"{server.url}/flows/filter", json={}, headers=server.header).status_code == 200
            for stranger in strangers:
                stranger.close()
        assert server.log.stat().st_size - before < MAX_LOG_BYTES
    finally:
        server.stop()


def test_the_stand_in_is_what_is_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of 300 characters, and names that none can be, are of no file of the client."""
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path))
    for name in ("a" * 300 + ".js", "\0.js", "view.js\0.css", "é" * 200 + ".css", "..", "", "../view.js", "built"):
        with pytest.raises(KeyError):
            bundle.client_file(name)
    assert bundle.client_file("view.js")
