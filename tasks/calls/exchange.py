"""Requests over HTTP: what can be tried again is, and nothing is swallowed."""

from __future__ import annotations

import dataclasses
import http.client
import os
import re
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, TypeVar

from schemas.errors import InputError, check_address
from schemas.machine.loopback import is_loopback
from schemas.text import HIDDEN, cut
from tasks.calls.attempt import RefusedRequest, RequestAttempt

T = TypeVar("T")

PART_BYTES = 1 << 16
"""Of an answer that are read at once: between two parts the time is looked at."""

TRIED_AGAIN = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
"""States of HTTP that pass."""

LONGEST_PAUSE_SECONDS = 120.0

SHORTEST_PART = 8
"""Characters of a key from its beginning that are hidden where a server repeats them; shorter ones may be part of any word."""


class EndpointAway(ConnectionError):
    """An endpoint does not answer for the time being: nobody's fault, and it passes."""


class NoAnswer(ValueError):
    """What came back is no answer; it may be one the next time."""


@dataclasses.dataclass(frozen=True)
class Exchange:
    """Requests to one address. url: Without a slash at its end. key: Sent as a bearer, never written anywhere. pause_seconds: Before the
    first further try, twice as long before each next one. most_bytes: Of an answer. where: The settings, as errors name them; what: is
    asked there."""

    url: str
    what: str
    key: str = dataclasses.field(default="", repr=False)
    timeout_seconds: float = 120.0
    attempts: int = 4
    pause_seconds: float = 2.0
    most_bytes: int = 4 << 20
    where: str = ""
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    def check(self) -> None:
        """Raises InputError where the address is none, or the key would go in the clear."""
        check_address(self.url, f"{self.where}.url")
        if self.key:
            check_hidden(self.url, self.where)

    def send(
        self, path: str, body: bytes | None, read: Callable[[bytes], T], begun: Callable[[], None], unknown: Collection[int] = ()
    ) -> T | None:
        """What is read of the answer to a body that is posted, or to a plain request without one; None where the server answers by a
        state in `unknown`.

        read: Raises NoAnswer where that is none. begun: Called before every request.

        Raises:
            InputError: the server refuses.
            EndpointAway: no answer came, though it was tried several times.
        """
        self.check()
        problem = ""
        for attempt in range(self.attempts):
            if attempt:
                self.sleep(min(self.pause_seconds * 2 ** (attempt - 1), LONGEST_PAUSE_SECONDS))
            headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {self.key}"} if self.key else {})
            method = "GET" if body is None else "POST"
            request = urllib.request.Request(f"{self.url.rstrip('/')}{path}", data=body, headers=headers, method=method)
            begun()
            try:
                give_up = self.clock() + self.timeout_seconds
                return read(RequestAttempt(request, partial(self._whole, give_up=give_up), self.timeout_seconds).answer())
            except RefusedRequest as refusal:
                if refusal.code in unknown:
                    return None
                problem = f"HTTP {refusal.code}: {self._shown(refusal.text)}"
                if refusal.code not in TRIED_AGAIN:
                    raise InputError(self.url, self.what, problem, f"see url, key and what else {self.where} says") from None
                self._wait_as_told(refusal.headers.get("Retry-After"), attempt)
            except TimeoutError as error:
                problem = f"{error} after {self.timeout_seconds:g} s"
            except (OSError, ValueError, http.client.HTTPException) as error:
                problem = self._shown(str(getattr(error, "reason", error)))
        raise EndpointAway(f"{self.url}: no answer after {self.attempts} tries: {problem}")

    def _whole(self, reply: Any, give_up: float) -> bytes:
        """The bytes of an answer.

        Raises:
            IncompleteRead: it was cut off.
            TimeoutError: it is still coming after all of the time that it has.
            NoAnswer: it has more bytes than are looked at.
        """
        data = bytearray()
        while len(data) <= self.most_bytes and (part := reply.read1(PART_BYTES)):
            data += part
            if self.clock() > give_up:
                raise TimeoutError
        if len(data) > self.most_bytes:
            raise NoAnswer(f"more than {self.most_bytes} bytes came back")
        if reply.length:  # of a read with a bound, http.client does not say that it was cut off
            raise http.client.IncompleteRead(bytes(data), reply.length)
        return bytes(data)

    def _shown(self, message: str) -> str:
        """The beginning of what a server said, without the key, of which it may repeat a part."""
        for length in range(len(self.key), min(SHORTEST_PART, len(self.key)) - 1, -1):
            message = message.replace(self.key[:length], HIDDEN) if length else message
        return cut(message)

    def _wait_as_told(self, seconds: str | None, attempt: int) -> None:
        if seconds is not None and re.fullmatch(r"[0-9]{1,9}", seconds.strip()) and attempt + 1 < self.attempts:
            self.sleep(min(float(seconds), LONGEST_PAUSE_SECONDS))


def check_hidden(url: str, where: str) -> None:
    """Refuse an address to which a key would go in the clear: http, but for this machine.

    Raises:
        InputError: says so.
    """
    try:
        parts = urllib.parse.urlsplit(url)
        scheme, host = parts.scheme, parts.hostname or ""
    except ValueError:
        raise InputError(f"{where}.url", "", "is no address", "give that of an OpenAI-compatible endpoint: https://.../v1") from None
    if scheme != "https" and not is_loopback(host):
        raise InputError(f"{where}.url", "", f"a key would go to {cut(host)} in the clear", "give an https:// address")


def key_in(variable: str, where: str) -> str:
    """A key out of the environment; '' where no variable is named.

    Raises:
        InputError: the variable is not set, or holds what no header can.
    """
    if not variable:
        return ""
    key = os.environ.get(variable, "").strip()
    if not key or not key.isascii() or not key.isprintable():
        raise InputError(where, "key_variable", f"{variable} holds no key", "set it where the workers run")
    return key
