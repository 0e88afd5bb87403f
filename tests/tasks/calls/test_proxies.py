"""What is asked of this machine goes to no proxy: neither keys, nor pictures, nor tokens."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tasks.calls.endpoint import Endpoint
from tasks.calls.exchange import EndpointAway
from tests.conftest import REPOSITORY
from tests.tasks.calls.servers import Server, says, server

__all__ = ["server"]

VARIABLES = ("http_proxy", "HTTP_PROXY", "https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY")


class RecordingProxy:
    """A proxy that answers every request itself, and keeps its bytes."""

    def __init__(self) -> None:
        self.requests: list[bytes] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                line, _ = self._listener.accept()
                with line, contextlib.suppress(OSError):
                    self.requests.append(line.recv(1 << 16))
                    line.sendall(b"HTTP/1.1 502 Recorded\r\nContent-Length: 0\r\n\r\n")

    def close(self) -> None:
        """Listen no more."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()


@pytest.fixture
def recording() -> Iterator[RecordingProxy]:
    """A recording proxy that no variable names yet."""
    proxy = RecordingProxy()
    yield proxy
    proxy.close()


@pytest.fixture
def proxy(recording: RecordingProxy, monkeypatch: pytest.MonkeyPatch) -> RecordingProxy:
    """A recording proxy that the environment names for everything."""
    for name in VARIABLES:
        monkeypatch.setenv(name, recording.url)
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    return recording


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "127.1", "0x7f.1", "2130706433", "%6cocalhost"])
def test_the_key_of_an_endpoint_of_this_machine_meets_no_proxy(server: Server, proxy: RecordingProxy, host: str) -> None:
    server.answers = [says("here")]
    endpoint = Endpoint(server.url.replace("127.0.0.1", host), "seer", "secret-key", attempts=1)
    assert endpoint.ask([], {}).text == "here"
    assert proxy.requests == []


@pytest.mark.parametrize("host", ["localhost.", "0.0.0.0", "a.localhost", "[::1]", "[::]", "[::ffff:127.0.0.1]"])
def test_what_goes_to_this_machine_without_a_key_meets_no_proxy(server: Server, proxy: RecordingProxy, host: str) -> None:
    server.answers = [says("here")]
    with contextlib.suppress(EndpointAway):
        Endpoint(server.url.replace("127.0.0.1", host), "seer", attempts=1).ask([], {})
    assert proxy.requests == []


def test_other_machines_are_asked_through_the_proxy(proxy: RecordingProxy) -> None:
    with pytest.raises(EndpointAway, match="502"):
        Endpoint("http://seer.invalid/v1", "seer", attempts=1).ask([], {})
    (request,) = proxy.requests
    assert request.startswith(b"POST http://seer.invalid/v1/chat/completions ")


RUN = """
from flows.server.process import check_server, is_healthy, prefect_server
with prefect_server() as api:
    assert is_healthy(api)
    check_server(api)
    from prefect import flow
    @flow
    def nothing(): return 1
    assert nothing() == 1
import httpx
assert httpx.get("http://elsewhere.invalid/").status_code == 502
"""


@pytest.mark.whole
def test_the_token_of_a_runs_own_server_meets_no_proxy(recording: RecordingProxy, tmp_path: Path) -> None:
    """Only the run's environment names the proxy: clients of other servers in this process would use it, too."""
    around = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_") and name.lower() != "no_proxy"}
    around |= {"PREFECT_HOME": str(tmp_path / "prefect"), "HOME": str(tmp_path)} | dict.fromkeys(VARIABLES, recording.url)
    done = subprocess.run([sys.executable, "-c", RUN], cwd=REPOSITORY, env=around, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert [request.split(b"\r\n")[0] for request in recording.requests] == [b"GET http://elsewhere.invalid/ HTTP/1.1"]
