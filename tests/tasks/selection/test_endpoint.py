"""An endpoint that breaks off, repeats a key, or would be sent one in the clear."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from schemas.errors import InputError
from tasks.selection.methods import endpoint as endpoints
from tasks.selection.methods import vision_language
from tasks.selection.methods.endpoint import Endpoint, EndpointAway
from tasks.selection.methods.vision_language import SCHEMA, VisionLanguage
from tests.tasks.selection.test_vision_language import Server, asking, says, server

__all__ = ["server"]


class Broken(Server):
    """A server that writes bytes of its own for the first answers, and closes the connection."""

    def __init__(self, *sent: bytes) -> None:
        super().__init__()
        self.sent = list(sent)
        handler: Any = self._server.RequestHandlerClass
        answer = handler.do_POST

        def do_post(request: Any) -> None:
            if self.sent:
                request.rfile.read(int(request.headers["Content-Length"]))
                request.wfile.write(self.sent.pop(0))
                request.close_connection = True
            else:
                answer(request)

        handler.do_POST = do_post


PASSING = {
    "no status line": b"what is this\r\n\r\n",
    "nothing": b"",
    "half a chunk": b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n50\r\n{",
    "half a body": b'HTTP/1.1 200 OK\r\nContent-Length: 500\r\n\r\n{"choices": [',
    "half an error": b"HTTP/1.1 503 Busy\r\nTransfer-Encoding: chunked\r\n\r\n50\r\nbu",
}


@pytest.mark.parametrize("sent", PASSING.values(), ids=list(PASSING))
def test_answers_that_are_cut_off_pass(sent: bytes) -> None:
    endpoints._UNDERSTOOD.clear()
    server = Broken(sent, sent)
    server.answers = [says("here")]
    try:
        assert asking(server, attempts=3).ask([], SCHEMA) == "here"
        server.sent = [sent, sent]
        with pytest.raises(EndpointAway, match="no answer after 2 tries"):
            asking(server, attempts=2).ask([], SCHEMA)
    finally:
        server.close()


def test_a_refusal_that_is_cut_off_is_a_refusal() -> None:
    server = Broken(b"HTTP/1.1 401 No\r\nTransfer-Encoding: chunked\r\n\r\n50\r\nwho")
    try:
        with pytest.raises(InputError, match="HTTP 401"):
            asking(server).ask([], SCHEMA)
    finally:
        server.close()


KEY = "sk-0123456789abcdefghijklmnopqrstuvwxyz-0123456789-ABCDEFGHIJKLMNOP"


@pytest.mark.parametrize("said", [KEY, f"bad key {KEY}!", KEY[:8], f"key {KEY[:12]}***", " " * 50 + KEY, "x" * 380 + KEY])
@pytest.mark.parametrize("status", [401, 503])
def test_a_key_that_a_server_repeats_is_not_told(server: Server, said: str, status: int) -> None:
    server.answers = [lambda body: (status, said.encode(), {})]
    with pytest.raises((InputError, EndpointAway)) as refused:
        asking(server, key=KEY, attempts=2).ask([], SCHEMA)
    assert f"HTTP {status}" in str(refused.value)
    assert KEY[:8] not in str(refused.value)
    assert "***" in str(refused.value) or "***" not in said, "the rest is told"


def test_a_key_in_a_line_that_is_none_is_not_told() -> None:
    server = Broken(*[f"no {KEY[:20]}\r\n\r\n".encode()] * 2)
    try:
        with pytest.raises(EndpointAway, match=r"no \.\.\.") as away:
            asking(server, key=KEY, attempts=2).ask([], SCHEMA)
        assert KEY[:8] not in str(away.value)
    finally:
        server.close()


@pytest.mark.parametrize("host", ["example.org", "10.0.0.4:80", "localhost.a.org", "127.0.0.1.a.org", "[fe80::1]", "0.0.0.0"])
def test_a_key_goes_nowhere_in_the_clear(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEER_KEY", KEY)
    monkeypatch.setattr(endpoints, "_OPENER", None)
    told = VisionLanguage(url=f"http://{host}/v1", model="seer-1", key_variable="SEER_KEY")
    for refuse in (lambda: vision_language.check(told), lambda: Endpoint(told.url, "seer-1", KEY).ask([], SCHEMA)):
        with pytest.raises(InputError, match=r"^selection\.provider\.url: a key would go to .* in the clear") as refused:
            refuse()
        assert KEY[:8] not in str(refused.value)
    vision_language.check(dataclasses.replace(told, key_variable=""))
    vision_language.check(dataclasses.replace(told, url=f"https://{host}/v1"))


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "127.8.9.1", "[::1]:8000", "localhost", "LOCALHOST:80"])
def test_a_key_may_go_to_this_machine(host: str) -> None:
    endpoints.check_hidden(f"http://{host}/v1")
