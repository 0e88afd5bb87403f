"""Asking a vision-language model over an OpenAI-compatible endpoint: what can be tried again is, and nothing is swallowed."""

from __future__ import annotations

import dataclasses
import http.client
import ipaddress
import json
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from typing import Any

from schemas.errors import InputError, check_address
from schemas.text import HIDDEN, cut

MOST_BYTES = 4 << 20
"""Of an answer; a choice needs a kilobyte."""

TRIED_AGAIN = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
"""States of HTTP that pass."""

NOT_UNDERSTOOD = frozenset({400, 404, 415, 422, 501})
"""States by which servers say that they do not know a form of answer."""

LONGEST_PAUSE_SECONDS = 120.0

SHORTEST_PART = 8
"""Characters of a key from its beginning that are hidden where a server repeats them; shorter ones may be part of any word."""

FORMS = ("json_schema", "json_object", "text")
"""How an answer's form is asked for, the strictest first: servers differ in what they understand (specs A.3)."""

_UNDERSTOOD: dict[str, str] = {}
"""The form that an endpoint understood, by address and model: in this process it is asked for first."""


class EndpointAway(ConnectionError):
    """An endpoint does not answer for the time being: nobody's fault, and it passes."""


@dataclasses.dataclass(frozen=True)
class Endpoint:
    """An OpenAI-compatible endpoint. url: up to and without `/chat/completions`. key: sent as a bearer, never written anywhere.
    pause_seconds: before the first further try, twice as long before each next one."""

    url: str
    model: str
    key: str = dataclasses.field(default="", repr=False)
    timeout_seconds: float = 120.0
    attempts: int = 4
    pause_seconds: float = 2.0
    sleep: Callable[[float], None] = time.sleep

    def ask(self, messages: list[dict[str, Any]], schema: Mapping[str, Any]) -> str:
        """The text of the model's answer to messages, in the form of a JSON schema as far as the server knows how.

        Raises:
            InputError: the address, the key or the model is refused, the key would go in the clear, or an answer is not of the protocol.
            EndpointAway: no answer came, though it was tried several times.
        """
        check_address(self.url, "selection.provider.url")
        if self.key:
            check_hidden(self.url)
        known = f"{self.url} {self.model}"
        for form in FORMS[FORMS.index(_UNDERSTOOD.get(known, FORMS[0])) :]:
            body: dict[str, Any] = {"model": self.model, "messages": messages, "temperature": 0}
            if form == "json_schema":
                body["response_format"] = {"type": form, "json_schema": {"name": "choice", "strict": True, "schema": dict(schema)}}
            elif form == "json_object":
                body["response_format"] = {"type": form}
            answer = self._answer(json.dumps(body).encode(), is_last=form == FORMS[-1])
            if answer is not None:
                _UNDERSTOOD[known] = form
                return answer
        raise AssertionError("the last form has an answer or an error")

    def _answer(self, body: bytes, is_last: bool) -> str | None:
        """The text that came back; None where the server does not know the form that was asked for."""
        problem = ""
        for attempt in range(self.attempts):
            if attempt:
                self.sleep(min(self.pause_seconds * 2 ** (attempt - 1), LONGEST_PAUSE_SECONDS))
            headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {self.key}"} if self.key else {})
            request = urllib.request.Request(f"{self.url.rstrip('/')}/chat/completions", data=body, headers=headers, method="POST")
            try:
                with _OPENER.open(request, timeout=self.timeout_seconds) as reply:
                    data = reply.read(MOST_BYTES + 1)
                    if len(data) <= MOST_BYTES and reply.length:  # of a read with a bound, http.client does not say that it was cut off
                        raise http.client.IncompleteRead(data, reply.length)
                    return self._text(data)
            except urllib.error.HTTPError as error:
                message = self._shown(_said(error))
                if error.code in NOT_UNDERSTOOD and not is_last:
                    return None
                problem = f"HTTP {error.code}: {message}"
                if error.code not in TRIED_AGAIN:
                    raise InputError(self.url, self.model, problem, "see url, model and the key of selection.provider") from None
                self._wait_as_told(error.headers.get("Retry-After"), attempt)
            except (OSError, ValueError, http.client.HTTPException) as error:
                problem = self._shown(str(getattr(error, "reason", error)))
        raise EndpointAway(f"{self.url}: no answer after {self.attempts} tries: {problem}")

    def _shown(self, message: str) -> str:
        """The beginning of what a server said, without the key, of which it may repeat a part."""
        for length in range(len(self.key), min(SHORTEST_PART, len(self.key)) - 1, -1):
            message = message.replace(self.key[:length], HIDDEN) if length else message
        return cut(message)

    def _wait_as_told(self, seconds: str | None, attempt: int) -> None:
        if seconds is not None and seconds.strip().isdigit() and attempt + 1 < self.attempts:
            self.sleep(min(float(seconds), LONGEST_PAUSE_SECONDS))

    def _text(self, data: bytes) -> str:
        """The message in an answer."""
        try:
            text = json.loads(data)["choices"][0]["message"]["content"] if len(data) <= MOST_BYTES else None
        except (ValueError, LookupError, TypeError, RecursionError):
            text = None
        if not isinstance(text, str):
            raise InputError(self.url, "choices[0].message.content", "is missing in the answer", "name an OpenAI-compatible endpoint")
        return text


def _said(error: urllib.error.HTTPError) -> str:
    """How the text of a refusal begins, as far as it arrives: its state says all that is needed."""
    try:
        return error.read(400).decode(errors="replace")
    except (OSError, ValueError, http.client.HTTPException):
        return ""


def check_hidden(url: str) -> None:
    """Refuse an address to which a key would go in the clear: http, but for this machine.

    Raises:
        InputError: says so.
    """
    try:
        parts = urllib.parse.urlsplit(url)
        scheme, host = parts.scheme, parts.hostname or ""
    except ValueError:
        raise InputError(
            "selection.provider.url", "", "is no address", "give that of an OpenAI-compatible endpoint: https://.../v1"
        ) from None
    if scheme != "https" and not _is_here(host):
        raise InputError("selection.provider.url", "", f"a key would go to {cut(host)} in the clear", "give an https:// address")


def _is_here(host: str) -> bool:
    """Whether a host is this machine: localhost, 127.0.0.0/8, ::1."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def key_in(variable: str) -> str:
    """A key out of the environment; '' where no variable is named.

    Raises:
        InputError: the variable is not set, or holds what no header can.
    """
    if not variable:
        return ""
    key = os.environ.get(variable, "").strip()
    if not key or not key.isascii() or not key.isprintable():
        raise InputError("selection.provider", "key_variable", f"{variable} holds no key", "set it where the workers run")
    return key


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """A redirect would take the key along."""

    def redirect_request(self, *arguments: Any, **more: Any) -> None:
        """Follow none: the answer is an error of its own."""
        return None


_OPENER = urllib.request.build_opener(_NoRedirects)
