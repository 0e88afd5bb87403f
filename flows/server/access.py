"""Who may talk to a Prefect server of ours: whoever has its token, under the server's own names, from its own pages.

Prefect asks for the token by itself (`PREFECT_SERVER_API_AUTH_STRING`). But it answers under any name and to pages of any
origin, and a browser reaches the loopback for whoever wrote the page: by its address, or by a name that was pointed there
(DNS rebinding). `Doorkeeper` stands before all that is served.
"""

from __future__ import annotations

import base64
import contextlib
import os
import secrets
import stat
import urllib.parse
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

from schemas.parsing import json_value

SERVER_TOKEN = "PREFECT_SERVER_API_AUTH_STRING"
"""What a server asks for. A secret: it is handed on by the environment or a file of mode 0600, never by an argument."""

CLIENT_TOKEN = "PREFECT_API_AUTH_STRING"
"""What Prefect's client shows."""

ORIGINS = "PREFECT_SERVER_CORS_ALLOWED_ORIGINS"
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
NAMING = ("PREFECT_API_URL", "PREFECT_SERVER_UI_API_URL", "PREFECT_UI_URL", ORIGINS)
"""Variables of a server's environment that say under which addresses people and workers reach it."""

ADMIT = "metascenes.admit"
"""Key of a scope: a function without arguments that calls the connection trusted (`flows.server.connections`)."""

PLAIN_HEADERS = ((b"x-content-type-options", b"nosniff"), (b"x-frame-options", b"DENY"), (b"cache-control", b"no-store"))
"""Headers of refusals that come from no application."""

Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[MutableMapping[str, Any], Receive, Send], Awaitable[None]]


def own_origins(port: int, environment: Mapping[str, str]) -> list[str]:
    """The origins (`http://host:port`) of a server's own pages: the loopback's, and those that its environment names."""
    origins = {origin_of(f"http://{name}:{port}") for name in LOOPBACK}
    for variable in NAMING:
        origins |= {origin_of(address) for address in environment.get(variable, "").split(",") if "://" in address}
    return sorted(origins)


def origin_of(address: str) -> str:
    """Scheme and host of an address as browsers send them: in small letters, without the scheme's own port."""
    scheme, _, rest = address.strip().lower().partition("://")
    host = rest.partition("/")[0].rpartition("@")[2]
    return f"{scheme}://{host.removesuffix({'http': ':80', 'https': ':443'}.get(scheme, ''))}"


class Doorkeeper:
    """An ASGI application that hands on only requests to a server's own names, from its own origins or from no page at all."""

    def __init__(self, app: App, origins: Iterable[str], remedy: str = "PREFECT_UI_URL in its environment gives it another") -> None:
        """`remedy` says what to do to who asks under another name."""
        self._app, self._remedy = app, remedy
        self._origins = frozenset(origins)
        self._hosts = frozenset(origin.partition("://")[2] for origin in self._origins)

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """See the specification of ASGI."""
        refusal = self._refusal(scope.get("headers", ())) if scope["type"] in ("http", "websocket") else ""
        if not refusal:
            await self._app(scope, receive, _unframed(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
        else:
            headers = [(b"content-type", b"text/plain; charset=utf-8"), *PLAIN_HEADERS]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            await send({"type": "http.response.body", "body": f"{refusal}\n".encode()})

    def _refusal(self, headers: Iterable[tuple[bytes, bytes]]) -> str:
        """Why a request is refused; empty where it is not."""
        values: dict[bytes, list[str]] = {b"host": [], b"origin": []}
        for name, value in headers:
            if name.lower() in values:
                values[name.lower()].append(value.decode("latin-1").strip().lower())
        hosts = [host.removesuffix(":80").removesuffix(":443") for host in values[b"host"]]
        if len(hosts) != 1 or not {*hosts, *values[b"host"]} & self._hosts:
            return f"this server does not go by that name; {self._remedy}"
        if any(origin_of(origin) not in self._origins for origin in values[b"origin"]):
            return "pages of other servers may not ask this one"
        return ""


def admit(scope: Mapping[str, Any]) -> None:
    """Call the connection of a request trusted: whoever sent it showed a valid token."""
    scope.get(ADMIT, lambda: None)()


class TokenWatch:
    """An ASGI application that admits requests with the token of a Prefect server. Prefect itself refuses those without."""

    def __init__(self, app: App, token: str) -> None:
        self._app, self._token = app, token
        self._header = b"Basic " + base64.b64encode(token.encode())

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """See the specification of ASGI."""
        if scope["type"] == "http":
            shown = next((value for name, value in scope["headers"] if name == b"authorization"), b"")
            if secrets.compare_digest(shown, self._header):
                admit(scope)
        await self._app(scope, self._watched(scope, receive) if scope["type"] == "websocket" else receive, send)

    def _watched(self, scope: Mapping[str, Any], receive: Receive) -> Receive:
        """Messages of a WebSocket, whose first one shows the token."""
        is_first = True

        async def received() -> MutableMapping[str, Any]:
            nonlocal is_first
            message = await receive()
            if message["type"] == "websocket.receive" and is_first:
                is_first = False
                if self._shows_token(message.get("text") or ""):
                    admit(scope)
            return message

        return received

    def _shows_token(self, text: str) -> bool:
        try:
            message = json_value(text)
        except ValueError:
            return False
        token = message.get("token") if isinstance(message, dict) else None
        return isinstance(token, str) and secrets.compare_digest(token.encode(errors="replace"), self._token.encode())


def _unframed(send: Send) -> Send:
    """Answers that no other page may show in a frame: who clicks there would click here."""

    async def sent(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), (b"x-frame-options", b"DENY")]}
        await send(message)

    return sent


def prefect_home() -> Path:
    """Where Prefect keeps its files."""
    return Path(os.environ.get("PREFECT_HOME") or Path.home() / ".prefect")


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(32)


def token_file(port: int) -> Path:
    """Where the token of the server on a port of this machine is kept."""
    return prefect_home() / f"metascenes-{port}.token"


def kept_token(port: int) -> str:
    """The token of the server on a port of this machine; a new one where there is none, or where others could have read it."""
    known = _read_token(port)
    if known:
        return known
    token, file = new_token(), token_file(port)
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    new = file.with_name(f"{file.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as text:
        text.write(token)
    new.replace(file)
    return token


def _read_token(port: int) -> str:
    try:
        with os.fdopen(os.open(token_file(port), os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)) as text:
            kept = os.fstat(text.fileno())
            is_ours = stat.S_ISREG(kept.st_mode) and kept.st_uid == os.geteuid() and not stat.S_IMODE(kept.st_mode) & 0o077
            return text.read(200).strip() if is_ours else ""
    except OSError:
        return ""


def take_token(address: str) -> None:
    """Make Prefect's client send the token of a server at an address on this machine, unless the settings name another."""
    place = urllib.parse.urlsplit(address)
    if os.environ.get(CLIENT_TOKEN) or place.hostname not in {"127.0.0.1", "localhost", "::1"}:
        return
    with contextlib.suppress(ValueError):
        token = _read_token(place.port or 80)
        if token:
            os.environ[CLIENT_TOKEN] = token


def close_home(database: str = "") -> None:
    """Take what Prefect keeps in its home, and the SQLite file that a connection URL names, from everybody but their owner.

    Other files that lie in that folder stay as they are.
    """
    files = [path for pattern in ("prefect.db*", "*.toml", "storage", "dlq", "concurrency*") for path in prefect_home().glob(pattern)]
    kind, _, file = database.partition(":///")
    if kind.startswith("sqlite") and file:
        files += [Path(f"{file.partition('?')[0]}{end}") for end in ("", "-wal", "-shm")]
    for path in files:
        with contextlib.suppress(OSError):
            if not path.is_symlink():
                path.chmod(0o700 if path.is_dir() else 0o600)
