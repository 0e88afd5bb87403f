"""Who sees the page: whoever has its token, under its own names, from its own pages; and what requests cannot do."""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import random
import re
import string
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from flows.server.access import new_token
from flows.view import bundle, gate
from flows.view.application import application, scene_routes
from flows.view.gate import POLICY, guarded
from flows.view.scene import Scenes
from tests.flows.view.lakes import EVIL, SCENES, shown_lake
from warehouse.lake import Lake

PORT = 8799
ORIGIN = f"http://127.0.0.1:{PORT}"
TOKENS = {new_token(): "anna", new_token(): "bert"}
TOKEN = next(iter(TOKENS))
SCENE = f"/api/scenes/{SCENES[0]}"
PATHS = ("/", "/client/view.js", "/api/scenes", SCENE, f"{SCENE}/frames/000000/picture", "/blobs/x.glb")


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("gate"))


@pytest.fixture(scope="module")
def stranger(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """Somebody without the token. The client is a stand-in, so that nothing has to be built."""
    built = tmp_path_factory.mktemp("built")
    for name in ("view.html", "view.js", "view.css"):
        (built / name).write_text(f"/* {name} */")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle, "BUILT", built)
        app = guarded(application([scene_routes(Scenes(lake))]), PORT, lambda: TOKENS, ["scenes.example"])
        yield TestClient(app, base_url=ORIGIN, follow_redirects=False, raise_server_exceptions=False)  # type: ignore[arg-type]


@pytest.fixture
def guest(stranger: TestClient) -> Iterator[TestClient]:
    """Somebody who opened the address with the token."""
    answer = stranger.get("/", params={"token": TOKEN})
    assert answer.status_code == 200
    yield stranger
    stranger.cookies.clear()


def test_without_a_token_nobody_sees_anything(stranger: TestClient) -> None:
    for path in PATHS:
        for answer in (stranger.get(path), stranger.get(path, params={"token": "guess"}), stranger.post(path), stranger.head(path)):
            assert answer.status_code == 401
            assert "view.js" not in answer.text
            assert "set-cookie" not in answer.headers
        assert stranger.get(path, headers={"cookie": f"metascenes_{PORT}=guess; other={TOKEN}"}).status_code == 401
    assert stranger.get("/api/scenes", params={"token": TOKEN}).status_code == 401, "only the page takes a token"


@given(st.text(st.characters(codec="latin-1"), max_size=60).filter(lambda text: text.strip() not in TOKENS))
def test_no_other_text_is_a_token(stranger: TestClient, text: str) -> None:
    assert stranger.get("/", params={"token": text}).status_code == 401
    scope = {"type": "http", "method": "GET", "path": "/api/scenes", "query_string": b""}
    assert _status(stranger, scope, [(b"cookie", f"metascenes_{PORT}={text}".encode("latin-1"))]) == 401


@pytest.mark.parametrize("beside", ['theme={"dark":1}', "a b=c", "=", "x", f"y=metascenes_{PORT}", f"metascenes_{PORT}0=guess", "ü=\xff"])
def test_cookies_of_others_do_not_hide_ours(stranger: TestClient, beside: str) -> None:
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b""}
    own = f"metascenes_{PORT}={_session(stranger.app)}"
    for header in (f"{beside}; {own}", f"{own}; {beside}", f"{beside};{own};{beside}"):
        assert _status(stranger, scope, [(b"cookie", header.encode("latin-1"))]) == 200


@given(st.text(st.characters(codec="latin-1"), max_size=30).filter(lambda text: f"metascenes_{PORT}=" not in text))
def test_whatever_comes_along_our_cookie_is_seen_alone(stranger: TestClient, text: str) -> None:
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b""}
    session = _session(stranger.app)
    for header, status in ((f"{text}; metascenes_{PORT}={session}", 200), (f"{text}; other={session}", 401)):
        assert _status(stranger, scope, [(b"cookie", header.encode("latin-1"))]) == status


@pytest.mark.parametrize("port", [80, 443, PORT])
@pytest.mark.parametrize("name", ["Scenes.Example", "10.0.0.7", "[fd00::7]"])
def test_a_server_answers_under_its_own_name_at_any_port(name: str, port: int) -> None:
    """Browsers leave the port of the scheme away, in the name as in the origin."""

    async def behind(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    app = guarded(behind, port, lambda: TOKENS, [name])
    host = name.lower() if port == 80 else f"{name.lower()}:{port}"
    session = _session(app, port)
    for asked, origin, status in ((host, f"http://{host}", 200), (host, "http://evil.example", 403), (f"evil.example:{port}", None, 403)):
        sent = [(b"host", asked.encode()), (b"cookie", f"metascenes_{port}={session}".encode())]
        sent += [(b"origin", origin.encode())] if origin else []
        scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": sent}
        assert _sent(app, scope)[0]["status"] == status


def test_the_token_becomes_a_session_that_no_script_and_no_other_site_has(stranger: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN, "at": SCENES[1]})
    cookie = re.fullmatch(rf"metascenes_{PORT}=([A-Za-z0-9_-]{{43}}); Path=/; HttpOnly; SameSite=Strict", answer.headers["set-cookie"])
    assert cookie is not None
    assert answer.headers["cache-control"] == "no-store"
    assert f'content="0;url=/#{SCENES[1]}"' in answer.text
    assert TOKEN not in f"{answer.headers}{answer.text}"
    assert stranger.get("/").status_code == 200
    stranger.cookies.clear()
    assert stranger.get("/", params={"token": cookie[1]}).status_code == 401, "a session is not a token"
    assert stranger.get("/", headers={"cookie": f"metascenes_{PORT}={TOKEN}"}).status_code == 401, "a token is not a session"


def test_a_session_is_of_one_server_and_ends_with_its_token() -> None:
    people = {TOKEN: "anna"}
    names: list[str] = []

    async def behind(scope: Any, receive: Any, send: Any) -> None:
        names.append(scope["person"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    apps = [guarded(behind, PORT, lambda: people) for _ in range(2)]  # the same port and tokens: a server that is started again
    session = _session(apps[0])
    headers = [(b"host", f"127.0.0.1:{PORT}".encode()), (b"cookie", f"metascenes_{PORT}={session}".encode())]
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": headers}
    assert [_sent(app, scope)[0]["status"] for app in apps] == [200, 401]
    people[new_token()] = people.pop(TOKEN)
    assert _sent(apps[0], scope)[0]["status"] == 401, "renewed"
    people.clear()
    assert _sent(apps[0], scope)[0]["status"] == 401, "withdrawn"
    people[TOKEN] = "bert"
    assert _sent(apps[0], scope)[0]["status"] == 200
    assert names == ["anna", "bert"], "whose token it is now"


def test_the_newest_sessions_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "MAX_SESSIONS", 3)
    sessions = gate.Sessions(lambda: TOKENS)
    other = sessions.begin(next(token for token, name in TOKENS.items() if name == "bert"))
    begun = [sessions.begin(TOKEN) for _ in range(5)]
    assert [sessions.person(session) for session in begun] == [None, None, "anna", "anna", "anna"]
    assert sessions.person(other) == "bert", "those of others stay"


@pytest.mark.parametrize("at", [EVIL, '"><script>1</script>', "//evil.example", "a b", "x" * 201])
def test_an_address_leads_to_a_place_of_the_page_and_nowhere_else(stranger: TestClient, at: str) -> None:
    text = stranger.get("/", params={"token": TOKEN, "at": at}).text
    stranger.cookies.clear()
    assert 'content="0;url=/"' in text or f'content="0;url=/#{at}"' in text
    assert "<script" not in text
    assert "onerror" not in text


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"host": f"localhost:{PORT}"}, 200),
        ({"host": f"scenes.example:{PORT}"}, 200),
        ({"origin": ORIGIN}, 200),
        ({"sec-fetch-site": "same-origin"}, 200),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}, 200),
        ({"host": f"evil.example:{PORT}"}, 403),
        ({"host": "127.0.0.1:1"}, 403),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "http://127.0.0.1:1"}, 403),
        ({"origin": "null"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"}, 403),
    ],
)
def test_only_own_names_and_own_pages_are_answered(guest: TestClient, headers: dict[str, str], status: int) -> None:
    assert guest.get("/api/scenes", headers=headers).status_code == status
    if status == 403:
        assert guest.get("/", params={"token": TOKEN}, headers=headers).status_code == (403 if "sec-fetch-site" not in headers else 200)


def test_what_would_change_something_must_name_its_origin(guest: TestClient) -> None:
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        assert guest.request(method, "/api/scenes").status_code == 403
        assert guest.request(method, "/api/scenes", headers={"origin": "http://evil.example"}).status_code == 403
        assert guest.request(method, "/api/scenes", headers={"origin": ORIGIN}).status_code == 405, "and here nothing does"


@pytest.mark.parametrize("cookie", [None, "guess", "session"])
def test_sockets_want_the_token_and_the_origin(stranger: TestClient, cookie: str | None) -> None:
    """As the annotation page will open them."""
    people: list[Any] = []

    async def behind(scope: Any, receive: Any, send: Any) -> None:
        people.append(scope["person"])
        await send({"type": "websocket.accept"})

    app = guarded(behind, PORT, lambda: TOKENS)
    shown = _session(app) if cookie == "session" else cookie
    kept = [(b"cookie", f"metascenes_{PORT}={shown}".encode())] if cookie else []
    for origin, is_own in ((ORIGIN, True), ("http://evil.example", False), (None, False)):
        headers = [(b"host", f"127.0.0.1:{PORT}".encode()), *kept, *([(b"origin", origin.encode())] if origin else [])]
        sent = _sent(app, {"type": "websocket", "path": "/", "query_string": f"token={TOKEN}".encode(), "headers": headers})
        is_let_in = is_own and cookie == "session"
        assert [message["type"] for message in sent] == ["websocket.accept" if is_let_in else "websocket.close"]
    assert people == (["anna"] if cookie == "session" else [])


def test_every_answer_forbids_what_the_page_does_not_need(guest: TestClient) -> None:
    guest.get(f"/api/scenes/{SCENES[0]}")
    for path in (*PATHS, "/nothing"):
        headers = guest.get(path).headers
        assert headers["content-security-policy"] == POLICY
        assert headers["x-frame-options"] == "DENY"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-resource-policy"] == "same-origin"
    allowed = dict(part.split(" ", 1) for part in POLICY.split("; "))
    assert allowed["script-src"] == allowed["style-src"] == "'self'"
    assert allowed["default-src"] == "'none'"
    assert "http" not in POLICY


def test_blobs_are_kept_for_good_and_the_rest_is_asked_for_again(guest: TestClient) -> None:
    document = guest.get(f"/api/scenes/{SCENES[0]}").json()
    for name in (document["scan"], document["shell"], document["navmeshes"][0]["blob"]):
        answer = guest.get(f"/blobs/{name}")
        assert hashlib.sha256(answer.content).hexdigest() == name.split(".")[0]
        assert "immutable" in answer.headers["cache-control"]
        again = guest.get(f"/blobs/{name}", headers={"if-none-match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
    page = guest.get("/")
    assert page.headers["cache-control"] == "private, no-cache"
    assert guest.get("/", headers={"if-none-match": page.headers["etag"]}).status_code == 304


def test_labels_are_data(guest: TestClient) -> None:
    answer = guest.get(f"/api/scenes/{SCENES[1]}")
    assert answer.headers["content-type"] == "application/json"
    assert answer.json()["objects"][0]["category"] == EVIL


def test_a_thousand_forged_requests_change_nothing_and_get_nothing(guest: TestClient, lake: Lake, tmp_path: Path) -> None:
    """From somebody inside: paths that climb, ids of nothing, scripts, long texts, odd bytes."""
    before = _digest(Path(lake.address))
    secret = lake.blobs.path(lake.snapshot().arrow("instances")["points_blob"][0].as_py())
    for path, method in itertools.islice(_forged(random.Random(0), secret), 1000):
        answer = guest.request(method, path, headers={"origin": ORIGIN})
        assert answer.status_code in (404, 405, 422), (method, path, answer.status_code)
        assert answer.content != b"points"
        assert answer.headers["content-type"].startswith(("application/json", "text/plain"))
        assert b"Traceback" not in answer.content
    assert _digest(Path(lake.address)) == before


def _forged(draw: random.Random, secret: Path) -> Iterator[tuple[str, str]]:
    """Paths below the addresses of the API, and methods."""
    climbs = ["..%2f" * 6 + "etc%2fpasswd", "%2e%2e%2flake.json", "..%5c..", "%00", "%2Fetc%2Fpasswd", "lake.json", "view.js%00.css"]
    climbs.append(secret.name)
    scripts = ["%3Cscript%3E1%3C%2Fscript%3E", "%27%3B%20DROP%20TABLE%20scenes--", "%24%7B1%7D", "%7B%7B7*7%7D%7D"]
    while True:
        noise = "".join(draw.choices(string.ascii_letters + string.digits + "._-~", k=draw.choice([1, 8, 64, 2000])))
        word = draw.choice([*climbs, *scripts, noise, "%F0%9F%92%A3" * 3, "9" * 300, "-1", "0000"])
        base = draw.choice(["/blobs/", "/client/", "/api/scenes/", "/api/scenes/demo/", f"/api/scenes/{SCENES[0]}/objects/", "/"])
        base = base if word != "0000" else f"/api/scenes/{SCENES[0]}/frames/"
        yield base + word, draw.choice(["GET", "GET", "GET", "POST", "DELETE", "PUT"])


def _digest(folder: Path) -> str:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return hashlib.sha256("".join(f"{path}{hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files).encode()).hexdigest()


def _status(client: TestClient, scope: dict[str, Any], headers: list[tuple[bytes, bytes]]) -> int:
    sent = _sent(client.app, {**scope, "headers": [(b"host", f"127.0.0.1:{PORT}".encode()), *headers]})
    return int(sent[0]["status"])


def _session(app: Any, port: int = PORT) -> str:
    """The session that an application gives to the first person for the token in the address."""
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": f"token={TOKEN}".encode()}
    start = _sent(app, scope | {"headers": [(b"host", f"127.0.0.1:{port}".encode())]})[0]
    return str(dict(start["headers"])[b"set-cookie"].partition(b";")[0].partition(b"=")[2].decode())


def _sent(app: Any, scope: dict[str, Any]) -> list[MutableMapping[str, Any]]:
    sent: list[MutableMapping[str, Any]] = []

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app(scope, None, send))
    return sent
