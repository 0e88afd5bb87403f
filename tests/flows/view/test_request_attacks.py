"""Hostile requests to every route of the viewer and of the annotation page: each is refused, shows nothing and changes nothing.

Routes come from the applications themselves, so that a new one is attacked as well.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import re
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from flows.server import connections
from flows.server.connections import bound, limited_server
from flows.view import bundle
from flows.view.annotating import requests
from flows.view.application import application, scene_routes
from flows.view.gate import guarded
from flows.view.scene import Scenes
from tests.flows.view.batches import PORT, Desk, digests, stand_in
from tests.flows.view.lakes import shown_lake

HOST = f"127.0.0.1:{PORT}"
ORIGIN = f"http://{HOST}"
SECRET = "the sentence in a file that no page shows"
LEAKS = (SECRET.encode(), b"root:x:", b"Traceback", b'File "', b'"tokens"')
MIN_ATTACKS = 3500
"""As SECURITY.md says; a loop that lost its routes would pass otherwise."""

JSON_TYPE = (b"content-type", b"application/json")


@dataclasses.dataclass(frozen=True)
class Attack:
    """A request, and the statuses that refuse it. headers: those besides Host, Origin and the session of `person`."""

    name: str
    method: str
    path: str
    refused: frozenset[int]
    person: str = ""
    headers: tuple[tuple[bytes, bytes], ...] = ()
    hosts: tuple[str, ...] = (HOST,)
    origin: str | None = ORIGIN
    query: str = ""
    body: bytes = b""
    kind: str = "http"


@dataclasses.dataclass(frozen=True)
class Page:
    """An application as it is served. key: an object that the person is asked about; other: one that is asked of others only."""

    app: Any
    guard: Any
    tokens: Mapping[str, str]
    person: str
    key: str
    other: str = ""
    roles: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict)

    def routes(self) -> dict[str, set[str]]:
        """Methods by path, of included routers as well."""
        methods: dict[str, set[str]] = {}
        left: list[Any] = list(self.app.routes)
        for route in left:
            inner = getattr(route, "original_router", None)
            if inner is not None:
                left += inner.routes
            else:
                methods.setdefault(route.path, set()).update(route.methods)
        return methods

    def filled(self, path: str, key: str = "", **words: str) -> str:
        """A path with an object in it, or with other words in some places."""
        dataset, scan, instance = (key or self.key).split("/")
        sound = {"dataset": dataset, "scan": scan, "instance": instance, "annotator:path": "ada", "frame": "000000", "name": "view.js"}
        return re.sub(r"\{([^}]+)\}", lambda match: (sound | words)[match[1]], path)

    def places(self, path: str) -> list[str]:
        """Parameters in a path."""
        return re.findall(r"\{([^}]+)\}", path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    made = tmp_path_factory.mktemp("attacked")
    (made / "secret.txt").write_text(SECRET)
    with pytest.MonkeyPatch.context() as patch:
        built = stand_in(made / "built")
        (built / "secret.txt").write_text(SECRET)
        (made / "secret.js").write_text(SECRET)
        patch.setattr(bundle, "BUILT", built)
        yield made


@pytest.fixture(scope="module")
def viewer(folder: Path) -> Page:
    app = application([scene_routes(Scenes(shown_lake(folder / "view")))])
    tokens = {"viewer": "v" * 43}
    return Page(app, guarded(app, PORT, lambda: {token: name for name, token in tokens.items()}), tokens, "viewer", "demo/room_0/0000")


@pytest.fixture(scope="module")
def annotation(folder: Path) -> Page:
    desk = Desk(folder)
    return Page(desk.app, desk.guard, desk.tokens, "ada", desk.own("ada"), desk.own("bob"), desk.work.roles)


@pytest.fixture(params=["viewer", "annotation"])
def page(request: pytest.FixtureRequest) -> Page:
    return request.getfixturevalue(request.param)  # type: ignore[no-any-return]


def scope_of(attack: Attack, cookie: str) -> dict[str, Any]:
    """Messages of a request that uvicorn passes on."""
    headers = [(b"host", host.encode("latin-1")) for host in attack.hosts]
    headers += [(b"origin", attack.origin.encode())] if attack.origin is not None else []
    headers += [(b"cookie", cookie.encode())] if cookie else []
    scope = {"type": attack.kind, "path": unquote(attack.path), "raw_path": attack.path.encode(), "query_string": attack.query.encode()}
    scope |= {"method": attack.method} if attack.kind == "http" else {"subprotocols": []}
    return scope | {"headers": [*headers, *attack.headers], "root_path": "", "http_version": "1.1", "scheme": "http", "server": ("x", PORT)}


async def sent_for(app: Any, scope: dict[str, Any], body: bytes) -> list[dict[str, Any]]:
    """Messages that an application sends."""
    parts = [body[at : at + 60_000] for at in range(0, len(body), 60_000)] or [b""]
    messages = [{"type": "http.request", "body": part, "more_body": part is not parts[-1]} for part in parts]
    messages = [{"type": "websocket.connect"}] if scope["type"] == "websocket" else messages
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        if not messages:
            await asyncio.Event().wait()  # who sent it is still there
        return messages.pop(0)

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    with contextlib.suppress(Exception):  # after the answer, which is looked at; the log has the error
        await app(scope, receive, send)
    return sent


def session(page: Page, name: str) -> str:
    """The cookie that a person gets."""
    entrance = Attack("entrance", "GET", "/", frozenset({200}), query=f"token={page.tokens[name]}")
    start = asyncio.run(sent_for(page.guard, scope_of(entrance, ""), b""))[0]
    return dict(start["headers"])[b"set-cookie"].decode().partition(";")[0]


def carry_out(page: Page, attacks: Iterable[Attack]) -> int:
    """Carry out attacks one after the other, and check every answer; how many there were."""
    cookies = {name: session(page, name) for name in page.tokens}

    async def all_of_them() -> int:
        count = 0
        for attack in attacks:
            count += 1
            sent = await sent_for(page.guard, scope_of(attack, cookies.get(attack.person, "")), attack.body)
            check(attack, sent)
        return count

    return asyncio.run(all_of_them())


def check(attack: Attack, sent: Sequence[Mapping[str, Any]]) -> None:
    """Refused, without a trace or a byte of a file, with the headers that forbid what no page needs."""
    assert sent, attack
    if attack.kind == "websocket":
        assert [message["type"] for message in sent] in (["websocket.close"], ["websocket.http.response.start"]), attack
        return
    start, body = sent[0], b"".join(message.get("body", b"") for message in sent[1:])
    headers = dict(start["headers"])
    assert start["status"] in attack.refused, (attack, start["status"], body[:300])
    assert not any(leak in body for leak in LEAKS), (attack, body[:300])
    assert len(body) < 12_000, attack  # an error names what was asked for
    assert b"set-cookie" not in headers, attack
    assert (headers[b"x-content-type-options"], headers[b"x-frame-options"]) == (b"nosniff", b"DENY"), attack
    assert headers[b"content-type"].startswith((b"text/plain", b"application/json")), attack


UNKNOWN, FOREIGN, ABSENT = frozenset({401}), frozenset({403}), frozenset({404, 405})
NAMES = ("evil.example", f"evil.example:{PORT}", "127.0.0.1:1", f"127.0.0.1:{PORT}.evil.example", f"127.0.0.1@evil.example:{PORT}", "", "é")
ORIGINS = ("https://evil.example", "null", "http://127.0.0.1:1", f"https://{HOST}", f"{ORIGIN}.evil.example", "", "file://")
SITES: tuple[Mapping[str, str], ...] = (
    {"sec-fetch-site": "cross-site"}, {"sec-fetch-site": "same-site"}, {"sec-fetch-site": "odd"},
    {"sec-fetch-site": "same-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors", "sec-fetch-dest": "script"},
)  # fmt: skip


def at_the_door(page: Page) -> Iterator[Attack]:
    """By people without a session, under other names, from other pages."""
    token = page.tokens[page.person]
    cookies = ("guess", token, "", "x" * 5000, '"; DROP', "ü")
    shown = [(b"cookie", f"metascenes_{PORT}={cookie}".encode()) for cookie in cookies]
    shown += [(b"cookie", f"metascenes_{PORT + 1}={token}".encode()), (b"authorization", f"Bearer {token}".encode())]
    for path, methods in page.routes().items():
        place = page.filled(path)
        for method in sorted(methods):
            yield Attack("no session", method, place, UNKNOWN)
            yield from (Attack("other cookie", method, place, UNKNOWN, headers=(header,)) for header in shown)
            if (method, place) != ("GET", "/"):
                yield Attack("token in the address", method, place, UNKNOWN, query=f"token={token}")
            yield Attack("wrong token", method, place, UNKNOWN, query="token=guess&token=" + token)
            yield from (Attack("other name", method, place, FOREIGN, page.person, hosts=(name,)) for name in NAMES)
            yield Attack("no name", method, place, FOREIGN, page.person, hosts=())
            yield Attack("two names", method, place, FOREIGN, page.person, hosts=(HOST, "evil.example"))
            yield from (Attack("other origin", method, place, FOREIGN, page.person, origin=origin) for origin in ORIGINS)
            two = ((b"origin", b"https://evil.example"),)
            yield Attack("two origins", method, place, FOREIGN, page.person, two)
            for site in SITES:
                headers = tuple((name.encode(), value.encode()) for name, value in site.items())
                yield Attack("other site", method, place, FOREIGN, page.person, headers)
            if method != "GET":
                yield Attack("change without an origin", method, place, FOREIGN, page.person, origin=None)
        for person, origin in (("", ORIGIN), (page.person, "https://evil.example"), (page.person, None), (page.person, ORIGIN)):
            yield Attack("socket", "GET", place, FOREIGN, person, origin=origin, kind="websocket")


WORDS = (
    "..", "%2e%2e", "..%2f..%2f..%2fetc%2fpasswd", "%2e%2e%2f%2e%2e%2fsecret.txt", "..%252f..%252fetc%252fpasswd", "..%5c..%5csecret.txt",
    "%2fetc%2fpasswd", "..%2fsecret.js", "secret.txt", "%00", "view.js%00.css", "x" * 300, "x" * 300 + ".js", "x" * 5000, "%c3%a9" * 300,
    "%f0%9f%92%a3" * 100 + ".css", "%ff%fe", "%ed%a0%80", "%E2%80%AE", "b1.sqlite.tokens", "lake.json", "~root", "-1", "9" * 400,
    "%0d%0aX:%20y",
    "%3Cscript%3E1%3C%2Fscript%3E", "%27%3B%20DROP%20TABLE%20drafts--", "%7B%7B7*7%7D%7D", ".", "%20", "*", "nul",
    "file:%2f%2f%2fetc%2fpasswd",
)  # fmt: skip
"""Words in place of a name: paths that climb, encoded once and twice, bytes that no name has, lengths that no file system takes."""

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PROPFIND", "get", "X" * 300)


def in_paths(page: Page) -> Iterator[Attack]:
    """By a person, in each parameter of each route; and with methods that a route does not have."""
    refused = frozenset({400, 403, 404, 405, 422})
    for path, methods in page.routes().items():
        for method in sorted(methods):
            person = (
                next((name for name, held in page.roles.items() if "reviewer" in held), page.person) if "verdicts" in path else page.person
            )
            body = json.dumps({"passes": True} if "verdicts" in path else {"choice": 1, "edit": 1}).encode()
            for place in page.places(path):
                for word in WORDS:
                    attacked = page.filled(path, **{place: word})
                    yield Attack("path", method, attacked, refused, person, (JSON_TYPE,), body=b"" if method in ("GET", "DELETE") else body)
        for method in sorted(set(METHODS) - methods):
            yield Attack("method", method, page.filled(path), ABSENT, page.person, (JSON_TYPE,), body=b"{}")
    for path in (
        "//",
        "/..",
        "/%2e%2e/secret.txt",
        "/docs",
        "/openapi.json",
        "/redoc",
        "/api",
        "/api/",
        "/built/view.js",
        "/client",
        "/.git/config",
    ):
        yield Attack("other path", "GET", path, ABSENT | {307}, page.person)


def bodies() -> Iterator[tuple[str, bytes, tuple[tuple[bytes, bytes], ...]]]:
    """Bodies that no route reads, with their headers."""
    sound = json.dumps({"choice": 1, "edit": 1}).encode()
    for name, body in {
        "nothing": b"", "array": b"[]", "null": b"null", "text": b'"x"', "open": b"{", "deep array": b"[" * 60_000,
        "deep object": b'{"a":' * 10_000 + b"1" + b"}" * 10_000, "no UTF-8": b'{"choice": "\xff"}', 
        "UTF-16": sound.decode().encode("utf-16"),
        "long number": b'{"edit": ' + b"9" * 60_000 + b"}", "not a number": b'{"edit": NaN}', "infinite": b'{"edit": 1e999}',
        "twice": b'{"edit": 1, "edit": 2}', "too large": b'{"page": "' + b"x" * requests.MOST_BYTES + b'"}', 
        "huge": b" " * (1 << 20) + b"{}",
        "unknown field": b'{"__proto__": {"roles": ["reviewer"]}}', "path": b'{"file": "../../secret.txt"}',
        "half a letter as a field": b'{"\\ud800": 1}', "half a letter as a choice": b'{"choice": "\\ud800", "edit": 1}',
        "half a letter as a page": b'{"choice": 1, "edit": 1, "page": "\\ud800"}',
        "half a letter as a remark": b'{"passes": false, "remark": "\\udfff"}', "zero": b'{"choice": "\\u0000", "edit": 1}',
        "zero as a remark": b'{"passes": false, "remark": "\\u0000"}',"long choice": b'{"choice": "' + b"x" * 60_000 + b'", "edit": 1}',
        
    }.items():  # fmt: skip
        yield name, body, (JSON_TYPE,)
    for kind in (b"text/plain", b"application/x-www-form-urlencoded", b"multipart/form-data; boundary=x", b"", b"application/jsonx"):
        yield f"kind {kind!r}", sound, ((b"content-type", kind),)


def in_bodies(page: Page) -> Iterator[Attack]:
    """Odd bodies by people who may use a route; sound ones by people who may not, and for objects of others."""
    refused = frozenset({400, 404, 413, 415, 422})
    for path, methods in page.routes().items():
        for method in sorted(methods & {"POST", "PUT", "PATCH"}):
            people = [name for name, held in page.roles.items() if ("annotator" in held) == (name == page.person)]
            for name, body, headers in bodies():
                for person in people:
                    # Nobody but the person is asked about the object: 403 for all others, whatever they send.
                    yield Attack(f"body {name}", method, page.filled(path), refused | FOREIGN, person, headers, body=body)
            if page.other and "{instance}" in path and "verdicts" not in path:
                body = json.dumps({"choice": 1, "edit": 1}).encode()
                yield Attack("object of others", method, page.filled(path, page.other), FOREIGN, page.person, (JSON_TYPE,), body=body)


def test_nobody_passes_the_door(page: Page, folder: Path) -> None:
    before = digests(folder)
    assert carry_out(page, at_the_door(page)) > 250
    assert digests(folder) == before


@pytest.mark.whole
def test_no_path_leads_to_a_file(page: Page, folder: Path) -> None:
    before = digests(folder)
    assert carry_out(page, in_paths(page)) > len(WORDS) * 5
    assert digests(folder) == before


def test_no_body_changes_anything(annotation: Page, folder: Path) -> None:
    before = digests(folder)
    assert carry_out(annotation, in_bodies(annotation)) > 100
    assert digests(folder) == before


def test_there_are_as_many_attacks_as_is_said(viewer: Page, annotation: Page) -> None:
    kinds = (at_the_door, in_paths, in_bodies)
    assert sum(1 for page in (viewer, annotation) for kind in kinds for _ in kind(page)) >= MIN_ATTACKS


LINE = f"Host: {HOST}\r\n"
PROTOCOL = {
    "absolute address": f"GET http://evil.example/api/scenes HTTP/1.1\r\n{LINE}\r\n",
    "two names": f"GET / HTTP/1.1\r\n{LINE}Host: evil.example\r\n\r\n",
    "path that climbs": f"GET /client/../../../../../../etc/passwd HTTP/1.1\r\n{LINE}\r\n",
    "path without a root": f"GET ../secret.txt HTTP/1.1\r\n{LINE}\r\n",
    "all of the server": f"OPTIONS * HTTP/1.1\r\n{LINE}\r\n",
    "tunnel": f"CONNECT evil.example:443 HTTP/1.1\r\n{LINE}\r\n",
    "trace": f"TRACE / HTTP/1.1\r\n{LINE}\r\n",
    "socket": f"GET / HTTP/1.1\r\n{LINE}Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
    "HTTP/2": f"GET / HTTP/1.1\r\n{LINE}Upgrade: h2c\r\nConnection: Upgrade, HTTP2-Settings\r\nHTTP2-Settings: AAMAAABk\r\n\r\n",
    "HTTP/2 at once": "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "earlier HTTP": "GET /api/scenes\r\n\r\n",
    "HTTP/1.0": "GET /api/scenes HTTP/1.0\r\n\r\n",
    "length and chunks": f"POST / HTTP/1.1\r\n{LINE}Content-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n"
    "0\r\n\r\nGET /api/scenes HTTP/1.1\r\n\r\n",
    "two lengths": f"POST / HTTP/1.1\r\n{LINE}Content-Length: 4\r\nContent-Length: 44\r\n\r\n0123",
    "length with a sign": f"POST / HTTP/1.1\r\n{LINE}Content-Length: +4\r\n\r\n0123",
    "odd coding": f"POST / HTTP/1.1\r\n{LINE}Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
    "coding with a space": f"POST / HTTP/1.1\r\n{LINE}Transfer-Encoding : chunked\r\n\r\n0\r\n\r\n",
    "length of no chunk": f"POST / HTTP/1.1\r\n{LINE}Transfer-Encoding: chunked\r\n\r\nxyz\r\n",
    "body to come": f"POST / HTTP/1.1\r\n{LINE}Expect: 100-continue\r\nContent-Length: 1000000000\r\n\r\n",
    "folded line": f"GET / HTTP/1.1\r\n{LINE}X-A: b\r\n  Host: evil.example\r\n\r\n",
    "zero in a line": f"GET / HTTP/1.1\r\n{LINE}X-A: \0\r\n\r\n",
    "long name": f"GET /client/{'x' * 300}.js HTTP/1.1\r\n{LINE}\r\n",
    "long line": f"GET /{'x' * 100_000} HTTP/1.1\r\n{LINE}\r\n",
    "many headers": f"GET / HTTP/1.1\r\n{LINE}{'X-A: b' * 1000 + chr(13) + chr(10)}\r\n",
    "long cookie": f"GET / HTTP/1.1\r\n{LINE}Cookie: {'a=b; ' * 2000}\r\n\r\n",
}


@pytest.fixture(scope="module")
def address(viewer: Page) -> Iterator[tuple[str, int]]:
    """The viewer at a socket. It goes by the name of another port, which no protocol looks at."""
    with bound("127.0.0.1", 0) as listening, pytest.MonkeyPatch.context() as patch:
        patch.setattr(connections, "MAX_IDLE_SECONDS", 0.2)  # answers are read to the end of the connection
        patch.setattr(connections, "MAX_DISCARDING_SECONDS", 0.2)
        listening.listen()
        server = limited_server(viewer.guard)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        yield listening.getsockname()
        server.should_exit = True
        thread.join()


@pytest.mark.parametrize("name", PROTOCOL)
@pytest.mark.parametrize("is_known", [False, True], ids=["stranger", "person"])
def test_what_no_browser_sends_is_refused(
    viewer: Page, address: tuple[str, int], name: str, is_known: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    text = PROTOCOL[name]
    if is_known:
        text = text.replace(LINE, f"{LINE}Cookie: {session(viewer, 'viewer')}\r\nOrigin: {ORIGIN}\r\n", 1)
    said = b""
    with socket.create_connection(address) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(text.encode("latin-1"))
        while part := connection.recv(65536):
            said += part
    statuses = [int(status) for status in re.findall(rb"HTTP/1\.1 (\d{3}) ", said)]
    if is_known and name in ("socket", "HTTP/2", "many headers", "long cookie", "folded line"):
        assert statuses == [200], "a person's request whose oddities are not looked at"
    else:
        assert statuses, said[:500]
        assert all(400 <= status < 500 for status in statuses), said[:500]
        assert b"nosniff" in said
    assert not any(leak in said for leak in LEAKS)
    assert "Traceback" not in capfd.readouterr().err


def test_a_person_with_one_role_does_nothing_of_another(annotation: Page, folder: Path) -> None:
    before = digests(folder)
    attacks = []
    for path, methods in annotation.routes().items():
        role = "reviewer" if re.match(r"/api/(sample|reviews|verdicts|conclude)", path) else ""
        role = "annotator" if re.match(r"/api/(work|drafts|answers|figures|settle|submit)", path) else role
        people = [name for name, held in annotation.roles.items() if role and role not in held]
        for method, name in ((method, name) for method in sorted(methods) for name in people):
            attacks.append(Attack("other role", method, annotation.filled(path), FOREIGN, name, (JSON_TYPE,), body=b"{}"))
    assert carry_out(annotation, attacks) >= 8
    assert digests(folder) == before
