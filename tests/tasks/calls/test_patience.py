"""An endpoint has its time for the whole of an answer, however it spends it."""

from __future__ import annotations

import dataclasses
import socket
import threading
from typing import Any

import pytest

from schemas.errors import InputError
from tasks.calls.attempt import RequestAttempt
from tasks.calls.exchange import EndpointAway, Exchange
from tests.tasks.calls.dripping import CHUNKED, DRIPS, dripping
from tests.tasks.calls.servers import Server, asking, says, server

__all__ = ["server"]

TIMEOUT_S = 0.5
GIVEN_UP = r"no answer after 2 tries: still (connecting|sending|sending or silent) after 0.5 s$"
"""On a busy machine the time may be over before anything was sent."""
PROXIES = ("http_proxy", "https_proxy", "all_proxy", "no_proxy")


@pytest.fixture(autouse=True)
def _no_proxies(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in PROXIES:
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)


def exchange(port: int, attempts: int = 2, scheme: str = "http") -> Exchange:
    return Exchange(f"{scheme}://127.0.0.1:{port}", "seer", timeout_seconds=TIMEOUT_S, attempts=attempts, pause_seconds=0.0)


def sends(exchange: Exchange, body: bytes = b"{}") -> Any:
    return exchange.send("/", body, bytes.decode, lambda: None)


@pytest.mark.parametrize(("start", "piece"), DRIPS.values(), ids=list(DRIPS))
def test_an_answer_that_drips_is_given_up(start: bytes, piece: bytes) -> None:
    """That the server ends says that every connection was closed."""
    with dripping(start, piece) as server:
        with pytest.raises(EndpointAway, match=GIVEN_UP):
            sends(exchange(server.port))
        assert len(server.connections) <= 2


@pytest.mark.whole
@pytest.mark.parametrize("start", [b"HTTP/1.1 401 No\r\nContent-Length: 9000\r\n\r\n", CHUNKED.replace(b"200 OK", b"401 No") + b"5;"])
def test_a_refusal_whose_text_drips_is_a_refusal(start: bytes) -> None:
    """The time is long enough for the first line of an answer on a busy machine."""
    with dripping(start, b"x") as server:
        with pytest.raises(InputError, match="HTTP 401"):
            sends(dataclasses.replace(exchange(server.port), timeout_seconds=10.0))
        assert len(server.connections) <= 2


def test_a_body_that_nobody_reads_is_given_up() -> None:
    with dripping(b"", b"", is_reading=False) as server, pytest.raises(EndpointAway, match=GIVEN_UP):
        sends(exchange(server.port), bytes(64 << 20))


def test_a_handshake_that_never_ends_is_given_up() -> None:
    with dripping(b"", b"") as server:
        with pytest.raises(EndpointAway, match=GIVEN_UP):
            sends(exchange(server.port, scheme="https"))
        assert len(server.connections) <= 2


def test_a_tunnel_that_never_opens_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    with dripping(*DRIPS["header"]) as server:
        monkeypatch.setenv("https_proxy", f"http://127.0.0.1:{server.port}")
        with pytest.raises(EndpointAway, match=GIVEN_UP):
            sends(Exchange("https://seer.invalid", "seer", timeout_seconds=TIMEOUT_S, attempts=2, pause_seconds=0.0))
        assert len(server.connections) <= 2


def test_a_connection_that_nobody_accepts_is_given_up() -> None:
    with socket.socket() as listener, socket.socket() as first, socket.socket() as second:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for line in (first, second):  # the queue is full then
            line.setblocking(False)
            line.connect_ex(listener.getsockname())
        with pytest.raises(EndpointAway, match=GIVEN_UP):
            sends(exchange(listener.getsockname()[1]))


def test_a_name_that_is_looked_up_without_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is sent when the name is found in the end."""
    found, lookups = threading.Event(), []

    def wait(*arguments: Any, **named: Any) -> list[Any]:
        lookups.append(threading.current_thread())
        found.wait()
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", listener.port))]

    with dripping(b"", b"") as listener:
        monkeypatch.setattr(socket, "getaddrinfo", wait)
        asked = Exchange("http://seer.invalid", "seer", timeout_seconds=TIMEOUT_S, attempts=2, pause_seconds=0.0)
        with pytest.raises(EndpointAway, match=r"after 2 tries: still connecting after 0.5 s"):
            sends(asked)
        found.set()
        for thread in lookups:
            thread.join()
    assert len(lookups) == 2


def test_giving_one_up_leaves_the_others(server: Server) -> None:
    """Requests at the same time, and those that take over descriptors that were closed, are answered."""
    server.answers = [says("here")]
    with dripping(*DRIPS["header"]) as slow:
        given_up: list[Exception] = []

        def fail() -> None:
            try:
                sends(exchange(slow.port, attempts=1))
            except EndpointAway as error:
                given_up.append(error)

        threads = [threading.Thread(target=fail) for _ in range(8)]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            assert asking(server, attempts=1).ask([], {}).text == "here"
    assert len(given_up) == 8


def test_an_attempt_that_is_over_opens_no_connection(server: Server) -> None:
    import urllib.request

    attempt = RequestAttempt(urllib.request.Request(server.url), lambda reply: b"", 1.0)
    attempt._end()
    with pytest.raises(TimeoutError):
        attempt.connect(("127.0.0.1", int(server.url.split(":")[2].split("/")[0])))
