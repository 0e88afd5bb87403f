"""Who may see a page of ours: whoever has the token of its address, under the server's own names, from its own pages.

The token comes with the address once and is kept as a cookie that no script sees and no other site sends. Behind this stands
`flows.server.access.Doorkeeper`, which looks at names and origins.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable, Mapping, MutableMapping
from typing import Any
from urllib.parse import parse_qs

from flows.server.access import App, Doorkeeper, Receive, Send, origin_of, own_origins

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

_READING = {"GET", "HEAD"}
_WELCOME = """<!doctype html>
<meta charset="utf-8"><meta http-equiv="refresh" content="0;url={}"><link rel="icon" href="data:,"><title>Scene lake</title>
"""
_PLACE = re.compile(r"[A-Za-z0-9_./-]{1,200}")
"""What an address may name besides its token: a scene, or an object of one."""


def guarded(app: App, port: int, people: Mapping[str, str], names: Iterable[str] = (), home: str = "/") -> App:
    """An application that answers only to people with a token, by its own names (loopback, and `names`), to its own pages.

    `people`: who has which token, name by token; the name is in the scope as `person` for what stands behind. `home`: the page
    that an address with a token leads to.
    """
    origins = [*own_origins(port, {}), *(origin_of(f"http://{name}:{port}") for name in names)]
    return Doorkeeper(Gate(app, port, people, home), origins, remedy="open the address that the command printed")


class Gate:
    """An ASGI application that hands on requests with a token's cookie, and exchanges a token in the address for one."""

    def __init__(self, app: App, port: int, people: Mapping[str, str], home: str = "/") -> None:
        self._app, self._people, self._home = app, dict(people), home
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
        person = self._person(shown[0]) if is_entrance else self._person(self._kept(headers.get(b"cookie", "")))
        if person is None:
            await _refuse(scope, send, 401, "the address that the command printed has the token that is missing here")
        elif is_entrance:
            await self._let_in(send, shown[0], query.get("at", [""])[0])
        elif not _is_own_request(scope, headers):
            await _refuse(scope, send, 403, "pages of other servers may not ask this one")
        else:
            await self._app({**scope, "person": person}, receive, _with_headers(send))

    def _person(self, token: str) -> str | None:
        """Whose token it is. All are compared, each in the same time."""
        people = [name for known, name in self._people.items() if secrets.compare_digest(known.encode(), token.encode())]
        return people[0] if people else None

    def _kept(self, header: str) -> str:
        """Our cookie. Those of other servers of this machine come along, and `SimpleCookie` gives up all for one that it dislikes."""
        pairs = (pair.strip().partition("=") for pair in header.split(";"))
        return next((value for name, _, value in pairs if name == self.cookie), "")

    async def _let_in(self, send: Send, token: str, at: str) -> None:
        """Keep the token as a cookie and go on without it in the address, to a place of the page.

        By a page, not by a redirect: after a link on another site a browser does not send such a cookie along a redirect.
        """
        cookie = f"{self.cookie}={token}; Path=/; HttpOnly; SameSite=Strict"
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
