"""One request over HTTP, whose time counts from its first step to the last byte of its answer.

It runs in a thread of its own, for a name may be looked up, a connection opened and a header read without end. When its time
is over, its own socket is shut, and nobody waits for it any more.
"""

from __future__ import annotations

import contextlib
import functools
import http.client
import socket
import ssl
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from email.message import Message
from typing import Any

from schemas.machine.loopback import host_of, is_this_machine

SHOWN_BYTES = 400
"""Bytes of a refusal's text that are read: more is not shown."""


class RefusedRequest(Exception):
    """A server answered by a state that is an error.

    Args:
        code: state of HTTP.
        headers: of the answer.
        text: beginning of its text, '' if none arrived in time.
    """

    def __init__(self, code: int, headers: Message, text: str) -> None:
        super().__init__(code)
        self.code, self.headers, self.text = code, headers, text


class RequestAttempt:
    """A request that is sent once.

    Args:
        request: address, headers and body.
        read: reads an answer's body from the open reply; raises OSError, ValueError or HTTPException if it cannot be used.
        timeout_s: time for all of it [s].
    """

    def __init__(self, request: urllib.request.Request, read: Callable[[Any], bytes], timeout_s: float) -> None:
        self._request, self._read = request, read
        self._timeout_s = min(timeout_s, threading.TIMEOUT_MAX)
        self._lock = threading.Lock()
        self._line: socket.socket | None = None
        self._is_over = False
        self._step = "connecting"
        self._outcome: bytes | Exception | None = None

    def answer(self) -> bytes:
        """Send the request and read the answer.

        Raises:
            RefusedRequest: the server refuses.
            TimeoutError: the answer is not there in time.
            OSError, ValueError, HTTPException: it cannot be had or used.
        """
        thread = threading.Thread(target=self._work, name="endpoint", daemon=True)
        thread.start()
        try:
            thread.join(self._timeout_s)
        finally:
            self._end()
        if isinstance(self._outcome, bytes):
            return self._outcome
        reason = getattr(self._outcome, "reason", self._outcome)
        if self._outcome is None or isinstance(reason, TimeoutError):
            raise TimeoutError(f"still {self._step}") from self._outcome
        raise self._outcome

    def connect(self, *arguments: Any, **named: Any) -> socket.socket:
        """Open the socket of this attempt, as `socket.create_connection` does."""
        line = socket.create_connection(*arguments, **named)
        with self._lock:
            if self._is_over:
                line.close()
                raise TimeoutError
            # A descriptor of its own: whatever is closed meanwhile, it never means another connection.
            self._line = line.dup()
        self._step = "sending or silent"
        return line

    def _work(self) -> None:
        """Do all that may be waited for."""
        try:
            with self._opener().open(self._request, timeout=self._timeout_s) as reply:
                self._step = "sending"
                self._settle(self._read(reply))
        except urllib.error.HTTPError as error:
            # Its state is enough of an answer, if the text does not arrive.
            self._settle(RefusedRequest(error.code, error.headers, ""))
            self._settle(RefusedRequest(error.code, error.headers, _beginning(error)))
            error.close()
        except Exception as error:
            self._settle(error)

    def _settle(self, outcome: bytes | Exception) -> None:
        """Note an outcome, unless the time is over: what is read of a socket that was shut is cut off."""
        with self._lock:
            if not self._is_over:
                self._outcome = outcome

    def _opener(self) -> urllib.request.OpenerDirector:
        """Opener of this attempt's own connection, past proxies if the address is of this machine."""
        is_near = is_this_machine(host_of(self._request.full_url))
        opener = urllib.request.OpenerDirector()
        for handler in (
            urllib.request.ProxyHandler({} if is_near else None),
            urllib.request.UnknownHandler(),
            _Sender(self),
            _NoRedirects(),
            urllib.request.HTTPDefaultErrorHandler(),
            urllib.request.HTTPErrorProcessor(),
        ):
            opener.add_handler(handler)
        return opener

    def _end(self) -> None:
        """Shut the connection, if it is still open, and let no other one be opened."""
        with self._lock:
            self._is_over = True
            if self._line is not None:
                with contextlib.suppress(OSError):
                    self._line.shutdown(socket.SHUT_RDWR)
                self._line.close()


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """A redirect would take the key along."""

    def redirect_request(self, *arguments: Any, **more: Any) -> None:
        """Follow none: the answer is an error of its own."""
        return None


class _Sender(urllib.request.AbstractHTTPHandler):
    """Requests over http and https on the connection of an attempt."""

    http_request = https_request = urllib.request.AbstractHTTPHandler.do_request_

    def __init__(self, attempt: RequestAttempt) -> None:
        super().__init__()
        self._attempt = attempt

    def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        """Send a request in plain text."""
        return self.do_open(functools.partial(_connection, self._attempt, http.client.HTTPConnection), request)

    def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        """Send a request encrypted."""
        make = functools.partial(http.client.HTTPSConnection, context=_context())
        return self.do_open(functools.partial(_connection, self._attempt, make), request)


@functools.cache
def _context() -> ssl.SSLContext:
    """Certificates that are trusted: reading them takes longer than a request."""
    context = ssl.create_default_context()
    context.set_alpn_protocols(["http/1.1"])
    return context


def _connection(
    attempt: RequestAttempt, make: Callable[..., http.client.HTTPConnection], host: str, **named: Any
) -> http.client.HTTPConnection:
    """A connection whose socket an attempt opens."""
    connection = make(host, **named)
    connection._create_connection = attempt.connect  # type: ignore[attr-defined]
    return connection


def _beginning(error: urllib.error.HTTPError) -> str:
    """Beginning of a refusal's text, as far as it arrives."""
    try:
        part: bytes = error.fp.read1(SHOWN_BYTES)  # type: ignore[attr-defined]
        return part.decode(errors="replace")
    except (OSError, ValueError, AttributeError, http.client.HTTPException):
        return ""
