"""Who may see a page of ours: whoever has the token of its address, under the server's own names, from its own pages.

The token comes with the address once. It is exchanged for a session: a random cookie that no script sees and no other site sends,
and that ends with the server or with the token. Before this stands `flows.server.access.Doorkeeper`, which looks at names and origins.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import Callable, Iterable, Mapping, MutableMapping
from typing import Any
from urllib.parse import parse_qs

from flows.server.access import App, Doorkeeper, Receive, Send, admit, new_token, origin_of, own_origins

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self' blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What a page may load: its own files, and pictures that it makes of what it loaded. No inline script, no other host."""

HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)

People = Callable[[], Mapping[str, str]]
"""Names by token, as they are now: tokens are withdrawn and renewed while a server runs."""

MAX_SESSIONS = 100
"""Sessions of one token. Each opening of its address begins one; then the oldest one ends, and others' stay as they are."""

_READING = {"GET", "HEAD"}
_WELCOME = """<!doctype html>
<meta charset="utf-8"><meta http-equiv="refresh" content="0;url={}"><link rel="icon" href="data:,"><title>Scene lake</title>
"""
_PLACE = re.compile(r"[A-Za-z0-9_./-]{1,200}")
"""What an address may name besides its token: a scene, or an object of one."""


def guarded(app: App, port: int, people: People, names: Iterable[str] = (), home: str = "/") -> App:
    """An application that answers only to people with a token, by its own names (loopback, and `names`), to its own pages.

    `people`: asked with each request; the name is in the scope as `person` for what stands behind. `home`: the page that an address
    with a token leads to.
    """
    origins = [*own_origins(port, {}), *(origin_of(f"http://{name}:{port}") for name in names)]
    return Doorkeeper(Gate(app, port, people, home), origins, remedy="open the address that the command printed")


class Sessions:
    """Sessions of one server, in its memory alone: the next start knows none of them."""

    def __init__(self, people: People) -> None:
        self._people = people
        self._tokens: dict[bytes, str] = {}  # by hash of the session: finding one takes no time that tells about another

    def begin(self, token: str) -> str:
        """Begin a session of the person who has a token."""
        session, people = new_token(), self._people()
        self._tokens = {each: held for each, held in self._tokens.items() if held in people}
        own = [each for each, held in self._tokens.items() if held == token]
        for each in own[: max(0, len(own) + 1 - MAX_SESSIONS)]:
            del self._tokens[each]
        self._tokens[_hash(session)] = token
        return session

    def person(self, session: str) -> str | None:
        """The person of a session; None where there is none, or where the token that began it holds no more."""
        token = self._tokens.get(_hash(session))
        return None if token is None else self.person_of_token(token)

    def person_of_token(self, token: str) -> str | None:
        """The person who has a token. It is compared with all, each in the same time."""
        people = [name for known, name in self._people().items() if secrets.compare_digest(known.encode(), token.encode())]
        return people[0] if people else None


def _hash(session: str) -> bytes:
    return hashlib.sha256(session.encode()).digest()


class Gate:
    """An ASGI application that hands on requests of a session, and exchanges a token in the address for one."""

    def __init__(self, app: App, port: int, people: People, home: str = "/") -> None:
        self._app, self._sessions, self._home = app, Sessions(people), home
        self.cookie = f"metascenes_{port}"  # cookies know no ports: two servers of one machine must not overwrite each other's

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """See the specification of ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope.get("headers", ())}
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        shown = query.get("token", [])
        is_entrance = scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == self._home and bool(shown)
        cookies = "; ".join(value.decode("latin-1") for name, value in scope.get("headers", ()) if name.lower() == b"cookie")
        session = self._kept(cookies)
        person = self._sessions.person_of_token(shown[0]) if is_entrance else self._sessions.person(session)
        if person is None:
            await _refuse(scope, send, 401, "open the address that the command printed: its token is missing here, or has ended")
        elif is_entrance:
            admit(scope)
            await self._let_in(send, self._sessions.begin(shown[0]), query.get("at", [""])[0])
        elif not _is_own_request(scope, headers):
            await _refuse(scope, send, 403, "pages of other servers may not ask this one")
        else:
            admit(scope)
            await self._app({**scope, "person": person}, receive, _with_headers(send))

    def _kept(self, header: str) -> str:
        """Our cookie. Those of other servers of this machine come along, and `SimpleCookie` gives up all for one that it dislikes."""
        pairs = (pair.strip().partition("=") for pair in header.split(";"))
        return next((value for name, _, value in pairs if name == self.cookie), "")

    async def _let_in(self, send: Send, session: str, at: str) -> None:
        """Keep a session as a cookie and go on without the token in the address, to a place of the page.

        By a page, not by a redirect: after a link on another site a browser does not send such a cookie along a redirect.
        """
        cookie = f"{self.cookie}={session}; Path=/; HttpOnly; SameSite=Strict"
        page = _WELCOME.format(self._home + (f"#{at}" if _PLACE.fullmatch(at) else "")).encode()
        headers = [(b"content-type", b"text/html; charset=utf-8"), (b"set-cookie", cookie.encode()), (b"cache-control", b"no-store")]
        await _with_headers(send)({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": page})


def _is_own_request(scope: Mapping[str, Any], headers: Mapping[bytes, str]) -> bool:
    """Whether a request comes from a page of ours or from a person, as far as the browser says.

    Another port of this machine is the same site, to which cookies are sent; browsers tell it apart. What changes something
    must name its origin; that it is ours the doorkeeper has seen.
    """
    if headers.get(b"sec-fetch-site", "none") not in ("same-origin", "none"):
        return (
            headers.get(b"sec-fetch-mode") == "navigate" and scope.get("method") == "GET" and headers.get(b"sec-fetch-dest") == "document"
        )
    return (scope["type"] == "http" and scope["method"] in _READING) or b"origin" in headers


async def _refuse(scope: Mapping[str, Any], send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
    await _with_headers(send)({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{reason}\n".encode()})


def _with_headers(send: Send) -> Send:
    """Answers with the headers that every page of ours has."""

    async def sent(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return sent
