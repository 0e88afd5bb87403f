"""An endpoint that breaks off, repeats a key, or would be sent one in the clear."""

from __future__ import annotations

import dataclasses
import itertools
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from schemas.errors import InputError
from tasks.calls import endpoint as endpoints
from tasks.calls import exchange
from tasks.calls.endpoint import FORMS, Endpoint
from tasks.calls.exchange import EndpointAway
from tasks.selection.methods import vision_language
from tasks.selection.methods.vision_language import SCHEMA, VisionLanguage
from tests.tasks.calls.servers import Server, asking, refuses, says, server

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
        assert asking(server, attempts=3).ask([], SCHEMA).text == "here"
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
    monkeypatch.setattr(exchange, "RequestAttempt", None)
    told = VisionLanguage(url=f"http://{host}/v1", model="seer-1", key_variable="SEER_KEY")
    for refuse in (lambda: vision_language.check(told), lambda: Endpoint(told.url, "seer-1", KEY).ask([], SCHEMA)):
        with pytest.raises(InputError, match=r"^selection\.provider\.url: a key would go to .* in the clear") as refused:
            refuse()
        assert KEY[:8] not in str(refused.value)
    vision_language.check(dataclasses.replace(told, key_variable=""))
    vision_language.check(dataclasses.replace(told, url=f"https://{host}/v1"))


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "127.8.9.1", "[::1]:8000", "localhost", "LOCALHOST:80"])
def test_a_key_may_go_to_this_machine(host: str) -> None:
    exchange.check_hidden(f"http://{host}/v1", "captions.provider")


@pytest.mark.parametrize(("refused", "form"), [(0, "json_schema"), (1, "json_object"), (2, "text")])
def test_servers_that_know_no_forms_are_asked_in_plainer_ones(server: Server, refused: int, form: str) -> None:
    server.answers = [*[refuses(400)] * refused, says("{}")]
    assert asking(server).ask([], SCHEMA).text == "{}"
    assert asking(server).ask([], SCHEMA).text == "{}"
    asked = [body.get("response_format", {"type": "text"})["type"] for _, _, body in server.requests]
    assert asked == [*FORMS[: refused + 1], form], "what was understood is asked for first"


@pytest.mark.parametrize("status", [408, 429, 500, 503, 529])
def test_what_passes_is_tried_again(server: Server, status: int) -> None:
    server.answers = [refuses(status), refuses(status), says("here")]
    pauses: list[float] = []
    made = dataclasses.replace(asking(server), pause_seconds=1.5, sleep=pauses.append)
    assert made.ask([], SCHEMA).text == "here"
    assert pauses == [1.5, 3.0]


def test_a_server_says_how_long_to_wait(server: Server) -> None:
    server.answers = [refuses(429, **{"Retry-After": "7"}), refuses(429, **{"Retry-After": "100000"}), says("here")]
    pauses: list[float] = []
    assert dataclasses.replace(asking(server), sleep=pauses.append).ask([], SCHEMA).text == "here"
    assert [pause for pause in pauses if pause] == [7.0, 120.0]


def test_nobody_listening_is_an_endpoint_that_is_away(server: Server) -> None:
    nobody = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    port = nobody.server_address[1]
    nobody.server_close()
    with pytest.raises(EndpointAway, match="no answer after 2 tries"):
        Endpoint(f"http://127.0.0.1:{port}/v1", "seer-1", attempts=2, pause_seconds=0.0).ask([], SCHEMA)


@pytest.mark.parametrize("content", [b"<html>", b"[]", b'{"choices": []}', b'{"choices": [{"message": {"content": null}}]}'])
def test_what_is_no_answer_of_the_protocol_is_none(server: Server, content: bytes) -> None:
    server.answers = [lambda body: (200, content, {}), says("here")]
    assert asking(server).ask([], SCHEMA).text == "here", "a proxy may have said that it restarts"
    server.answers = [lambda body: (200, content, {})]
    with pytest.raises(EndpointAway, match="no choices"):
        asking(server).ask([], SCHEMA)


def test_redirects_are_not_followed(server: Server) -> None:
    server.answers = [lambda body: (302, b"", {"Location": "http://127.0.0.1:1/"})]
    with pytest.raises(InputError, match="HTTP 302"):
        asking(server, key="secret").ask([], SCHEMA)
    assert len(server.requests) == 1


def test_an_answer_that_never_ends_is_given_up(server: Server) -> None:
    """However small its parts are: no single wait is too long, all together are."""
    part = b'{"choices": [' + b" " * 70_000
    endless = Broken(*[b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n" + 10 * part] * 2)
    clock = itertools.count(0.0, 50.0)
    try:
        made = dataclasses.replace(asking(endless, attempts=2), timeout_seconds=120.0, clock=lambda: next(clock))
        with pytest.raises(EndpointAway, match="after 2 tries: still sending after 120 s"):
            made.ask([], SCHEMA)
    finally:
        endless.close()


@pytest.mark.parametrize("usage", [None, [], {}, {"prompt_tokens": -3, "completion_tokens": True}, {"prompt_tokens": "7"}])
def test_tokens_that_nobody_counts_are_none(server: Server, usage: Any) -> None:
    server.answers = [lambda body: (200, {"choices": [{"message": {"content": "x"}}], "usage": usage}, {})]
    assert asking(server).ask([], SCHEMA) == endpoints.CallAnswer(b"x", None, None)


def test_tokens_cost_what_the_settings_say(server: Server) -> None:
    server.answers = [
        lambda body: (200, {"choices": [{"message": {"content": "x"}}], "usage": {"prompt_tokens": 1000, "completion_tokens": 20}}, {})
    ]
    settings = endpoints.EndpointSettings(server.url, "seer-1", prompt_usd_per_million=2.5, reply_usd_per_million=10.0)
    answer = settings.endpoint("captions.provider").ask([], SCHEMA)
    assert (answer.prompt_tokens, answer.reply_tokens) == (1000, 20)
    assert settings.cost_usd(answer) == pytest.approx(0.0025 + 0.0002)
