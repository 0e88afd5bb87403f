"""Connections of a server: how many are open, how long each may take, and how much is written about their errors.

All peers of one machine have the same address, so limits for each address would not help. A connection is trusted once a request
with a valid token came over it. Where too many are open, the oldest one that is not trusted is dropped: strangers who hold
connections without a request cannot keep out the people who have a token.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import logging
import resource
import socket
from collections import OrderedDict
from collections.abc import Callable, Iterator, MutableMapping
from functools import partial
from typing import Any, cast

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from flows.server.access import ADMIT, PLAIN_HEADERS, App, Receive, Send
from schemas.errors import InputError

MAX_CONNECTIONS = 2048
"""Each may hold a head of `MAX_HEAD_BYTES`: 64 MB in all."""

MAX_ACCEPTED_AT_ONCE = 8
"""Dropped connections are closed some turns of the loop later, so that each turn may add this many files to the limit."""

MAX_WAITING = 512
"""Connections that the system keeps for the server until it accepts them."""

MAX_HEAD_BYTES = 32 * 1024
"""A browser sends the cookies of all servers of this machine, some kilobytes each."""

MAX_HEAD_SECONDS = 10.0
"""A head is one packet or a few; from the opening of a connection, or from the end of the answer before."""

MAX_BODY_SECONDS = 60.0
"""Bodies have up to some megabytes."""

MAX_IDLE_SECONDS = 5
"""Time between two requests of a connection, as uvicorn has it."""

MAX_DISCARDED_BYTES = 256 * 1024
"""Rest of a refused body that is still taken, so that the sender reads the refusal instead of a reset."""

MAX_DISCARDING_SECONDS = 2.0
"""The same in time."""

MAX_REMEMBERED_ERRORS = 200
"""Distinct errors whose repetitions are counted; a server has a few kinds."""


def connection_limit() -> int:
    """Connections that may be open at once: half of the files that the process may open; the rest is for files of the server."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MAX_CONNECTIONS if files == resource.RLIM_INFINITY else max(1, min(MAX_CONNECTIONS, files // 2))


class Connections:
    """Open connections of a server, the oldest first."""

    def __init__(self, most: int) -> None:
        """Args: most: connections that may be open at once."""
        self._most = most
        self._strange: dict[asyncio.Transport, None] = {}
        self._trusted: dict[asyncio.Transport, Callable[[], bool]] = {}

    def add(self, transport: asyncio.Transport) -> None:
        """Count a new connection, and drop another one where too many are open."""
        self._strange[transport] = None
        if len(self._strange) + len(self._trusted) <= self._most:
            return
        # The new one is the last of the strangers: an idle connection of a person is opened again unseen, so it goes before.
        idle = (known for known, is_idle in self._trusted.items() if is_idle())
        dropped = next(iter(self._strange)) if len(self._strange) > 1 else next(idle, transport)
        self.remove(dropped)
        dropped.abort()

    def trust(self, transport: asyncio.Transport, is_idle: Callable[[], bool]) -> None:
        """Keep a connection while there are others to drop. `is_idle` says whether it waits for its next request."""
        if transport in self._strange:
            del self._strange[transport]
            self._trusted[transport] = is_idle

    def remove(self, transport: asyncio.Transport) -> None:
        """Forget a connection that is closed."""
        self._strange.pop(transport, None)
        self._trusted.pop(transport, None)


class LimitedProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 with limits of time and of what is read for nothing."""

    def __init__(self, connections: Connections, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._open, self._behind = connections, cast(App, self.app)
        self.app = cast(Any, self._answer)
        self._timer: asyncio.TimerHandle | None = None
        self._watched: object = None
        self._discarded: int | None = None  # bytes; None while requests are read

    async def _answer(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        names = {name for name, _ in scope.get("headers", ())}
        if {b"content-length", b"transfer-encoding"} <= names:
            # Programs in front of the server may disagree with it about where such a request ends.
            await _send_refusal(send, 400, "a request has a length or is chunked, not both")
            return
        trust = partial(self._open.trust, self.transport, self._is_idle)
        await self._behind({**scope, ADMIT: trust}, receive, send)

    def _is_idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See asyncio.Protocol."""
        super().connection_made(transport)
        self._open.add(transport)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """See asyncio.Protocol."""
        self._open.remove(self.transport)
        self._stop_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """See asyncio.Protocol."""
        if self._discarded is None:
            super().data_received(data)
            self._watch()
            return
        self._discarded += len(data)
        if self._discarded > MAX_DISCARDED_BYTES:
            self.transport.abort()

    def on_response_complete(self) -> None:
        """Go on to the next request, unless the body of this one was not read: then end the connection."""
        if self.conn.their_state is not h11.SEND_BODY:
            super().on_response_complete()
            self._watch()
        elif not self.transport.is_closing():
            self._discarded = 0
            self._start_timer(MAX_DISCARDING_SECONDS)
            self.transport.write_eof()
            self.flow.resume_reading()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not HTTP; where an answer has begun, only its end can tell."""
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.abort()
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8"), *PLAIN_HEADERS, (b"connection", b"close")]
        reason = http.HTTPStatus.BAD_REQUEST.phrase.encode()
        for event in (h11.Response(status_code=400, headers=headers, reason=reason), h11.Data(data=msg.encode()), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def _unsupported_upgrade_warning(self) -> None:
        """Such a request is answered as any other."""

    def _watch(self) -> None:
        """Limit the time of what is awaited now: the head of a request or its body."""
        if self.transport.get_protocol() is not self:
            # A WebSocket took over the connection, which may be open for days.
            self._stop_timer()
            return
        state = self.conn.their_state
        if state is self._watched or self._discarded is not None:
            return
        self._stop_timer()
        self._watched = state
        if state in (h11.IDLE, h11.SEND_BODY) and not self.transport.is_closing():
            self._start_timer(MAX_HEAD_SECONDS if state is h11.IDLE else MAX_BODY_SECONDS)

    def _start_timer(self, seconds: float) -> None:
        self._stop_timer()
        self._timer = self.loop.call_later(seconds, self._expire, seconds)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _expire(self, seconds: float) -> None:
        # The application reads large bodies part by part: while it does not read, the sender cannot send.
        if self._watched is h11.SEND_BODY and self.flow.read_paused and self._discarded is None:
            self._start_timer(seconds)
        else:
            self.transport.abort()


class LimitedSocketProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSockets, counted with the other connections; a trusted one is never dropped."""

    def __init__(self, connections: Connections, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._open, self._behind = connections, cast(App, self.app)
        self.app = cast(Any, self._answer)

    async def _answer(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        trust = partial(self._open.trust, self.transport, lambda: False)
        await self._behind({**scope, ADMIT: trust}, receive, send)

    def connection_lost(self, exc: Exception | None) -> None:
        """See asyncio.Protocol."""
        self._open.remove(self.transport)
        super().connection_lost(exc)


class _Server(uvicorn.Server):
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Take a longer queue than the number of connections that are accepted at once; asyncio has one number for both."""
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(MAX_WAITING)


def run_server(app: App, listening: socket.socket, level: str = "warning", patience: int | None = None, has_sockets: bool = False) -> None:
    """Serve an application on a bound socket until interrupted. Parameters are those of `limited_server`."""
    server = limited_server(app, level, patience, has_sockets)
    with counted_errors(), contextlib.suppress(KeyboardInterrupt):
        server.run(sockets=[listening])


def limited_server(app: App, level: str = "warning", patience: int | None = None, has_sockets: bool = False) -> uvicorn.Server:
    """A server of an application within the limits of this module.

    Args:
        app: application that calls `admit` for each request with a valid token.
        level: lowest level of uvicorn's messages that are written.
        patience: time that requests have at the end to be answered [s]; no limit where None.
        has_sockets: whether the application takes WebSockets.
    """
    connections = Connections(connection_limit())
    return _Server(
        uvicorn.Config(
            app, http=cast(Any, partial(LimitedProtocol, connections)),
            ws=cast(Any, partial(LimitedSocketProtocol, connections)) if has_sockets else "none",
            loop="asyncio", log_level=level, access_log=False, backlog=MAX_ACCEPTED_AT_ONCE, timeout_keep_alive=MAX_IDLE_SECONDS,
            timeout_graceful_shutdown=patience, h11_max_incomplete_event_size=MAX_HEAD_BYTES,
        )
    )  # fmt: skip


@contextlib.contextmanager
def bound(host: str, port: int) -> Iterator[socket.socket]:
    """A socket at a host and port of this machine.

    Raises:
        InputError: it is taken, or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{host}:{port}", "--port", f"cannot be had ({reason})", "leave --port away for a free one") from error
        yield made


class CountedErrors(logging.Filter):
    """Writes a message the first time, and then, with its count, the 10th, 100th, 1000th ... time."""

    def __init__(self) -> None:
        super().__init__()
        self._counts = OrderedDict[tuple[object, ...], int]()

    def filter(self, record: logging.LogRecord) -> bool:
        """See logging.Filter. Several handlers are asked about one record; the first decides for all."""
        if "is_written" not in vars(record):
            vars(record)["is_written"] = self._count(record)
        return bool(vars(record)["is_written"])

    def _count(self, record: logging.LogRecord) -> bool:
        kind, error, trace = record.exc_info or (None, None, None)
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        key = (record.name, record.getMessage(), kind, trace and (trace.tb_frame.f_code.co_filename, trace.tb_lineno))
        count = self._counts.pop(key, 0) + 1
        self._counts[key] = count
        if len(self._counts) > MAX_REMEMBERED_ERRORS:
            self._counts.popitem(last=False)
        if count == 1:
            return True
        if str(count).rstrip("0") != "1":
            return False
        text = f"{record.getMessage().strip()}{f': {kind.__name__}: {error}' if kind else ''}"
        record.msg, record.args, record.exc_info, record.exc_text = f"{text} ({count} times so far)", (), None, None
        return True


@contextlib.contextmanager
def counted_errors() -> Iterator[None]:
    """Count repetitions of messages in all logs of this process, for as long as this lasts."""
    counted = CountedErrors()
    loggers = [logging.getLogger(), *logging.Logger.manager.loggerDict.values()]
    handlers = {handler for logger in loggers for handler in getattr(logger, "handlers", ())} | {logging.lastResort}
    for handler in handlers - {None}:
        cast(logging.Handler, handler).addFilter(counted)
    try:
        yield
    finally:
        for handler in handlers - {None}:
            cast(logging.Handler, handler).removeFilter(counted)


async def _send_refusal(send: Send, status: int, reason: str) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *PLAIN_HEADERS, (b"connection", b"close")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{reason}\n".encode()})
