"""Asking a model over an OpenAI-compatible endpoint: what can be tried again is, and nothing is swallowed."""

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
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from schemas.errors import InputError, check_address
from schemas.text import HIDDEN, cut
from tasks.settings import Config, Count, NonNegative, Positive

MOST_BYTES = 4 << 20
"""Of an answer; a choice needs a kilobyte."""

PART_BYTES = 1 << 16
"""Of an answer that are read at once: between two parts the time is looked at."""

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
class EndpointSettings(Config):
    """Where a model answers, and what is done where it does not."""

    url: str = ""  # of an OpenAI-compatible endpoint, without /chat/completions; none is ours to name
    model: str = ""  # as the endpoint calls it
    model_version: str = ""  # where the same name means another model today than it did: replies to the other one are not taken for its own
    key_variable: str = ""  # environment variable that holds the key; servers at home need none
    attempts: Count = 4  # to reach the endpoint, before it counts as away
    pause_seconds: NonNegative = 2.0  # before the second, twice as long before each next one
    timeout_seconds: Positive = 120.0  # large models look at eleven pictures for a while; one that sends on for longer is given up
    prompt_usd_per_million: NonNegative = 0.0  # tokens that are sent; servers at home cost nothing
    reply_usd_per_million: NonNegative = 0.0  # tokens that come back

    def endpoint(self, where: str) -> Endpoint:
        """What asks. where: The settings, as errors name them.

        Raises:
            InputError: the key is not there.
        """
        key = key_in(self.key_variable, where)
        return Endpoint(self.url, self.model, key, self.timeout_seconds, self.attempts, self.pause_seconds, where=where)

    def cost_usd(self, answer: Answer) -> float:
        """What an answer costs [USD]; tokens that the endpoint did not count cost nothing."""
        sent, told = answer.prompt_tokens or 0, answer.reply_tokens or 0
        return (sent * self.prompt_usd_per_million + told * self.reply_usd_per_million) / 1e6


def check_endpoint(settings: EndpointSettings, where: str) -> None:
    """Raises InputError where no endpoint or model is named, the address is none, or the key is not there or would go in the clear."""
    if not settings.model:
        raise InputError(where, "model", "names no model", "give it as the endpoint calls it")
    if not settings.url.startswith(("http://", "https://")):
        raise InputError(where, "url", "is no address", "give that of an OpenAI-compatible endpoint: https://.../v1")
    check_address(settings.url, f"{where}.url")
    if key_in(settings.key_variable, where):
        check_hidden(settings.url, where)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What came back. prompt_tokens, reply_tokens: As the endpoint counts them; None where it does not."""

    text: str
    prompt_tokens: int | None = None
    reply_tokens: int | None = None


@dataclasses.dataclass(frozen=True)
class Endpoint:
    """An OpenAI-compatible endpoint. url: up to and without `/chat/completions`. key: sent as a bearer, never written anywhere.
    pause_seconds: before the first further try, twice as long before each next one. where: the settings, as errors name them."""

    url: str
    model: str
    key: str = dataclasses.field(default="", repr=False)
    timeout_seconds: float = 120.0
    attempts: int = 4
    pause_seconds: float = 2.0
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    where: str = "selection.provider"

    def ask(self, messages: Sequence[Mapping[str, Any]], schema: Mapping[str, Any], begun: Callable[[], None] = lambda: None) -> Answer:
        """The model's answer to messages, in the form of a JSON schema as far as the server knows how.

        begun: Called before every request, with those that are sent again.

        Raises:
            InputError: the address, the key or the model is refused, the key would go in the clear, or an answer is not of the protocol.
            EndpointAway: no answer came, though it was tried several times.
        """
        check_address(self.url, f"{self.where}.url")
        if self.key:
            check_hidden(self.url, self.where)
        known = f"{self.url} {self.model}"
        for form in FORMS[FORMS.index(_UNDERSTOOD.get(known, FORMS[0])) :]:
            body: dict[str, Any] = {"model": self.model, "messages": list(messages), "temperature": 0}
            if form == "json_schema":
                body["response_format"] = {"type": form, "json_schema": {"name": "reply", "strict": True, "schema": dict(schema)}}
            elif form == "json_object":
                body["response_format"] = {"type": form}
            answer = self._answer(json.dumps(body).encode(), form == FORMS[-1], begun)
            if answer is not None:
                _UNDERSTOOD[known] = form
                return answer
        raise AssertionError("the last form has an answer or an error")

    def _answer(self, body: bytes, is_last: bool, begun: Callable[[], None]) -> Answer | None:
        """What came back; None where the server does not know the form that was asked for."""
        problem = ""
        for attempt in range(self.attempts):
            if attempt:
                self.sleep(min(self.pause_seconds * 2 ** (attempt - 1), LONGEST_PAUSE_SECONDS))
            headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {self.key}"} if self.key else {})
            request = urllib.request.Request(f"{self.url.rstrip('/')}/chat/completions", data=body, headers=headers, method="POST")
            begun()
            try:
                give_up = self.clock() + self.timeout_seconds
                with _OPENER.open(request, timeout=self.timeout_seconds) as reply:
                    return self._read_answer(self._whole(reply, give_up))
            except urllib.error.HTTPError as error:
                message = self._shown(_said(error))
                if error.code in NOT_UNDERSTOOD and not is_last:
                    return None
                problem = f"HTTP {error.code}: {message}"
                if error.code not in TRIED_AGAIN:
                    raise InputError(self.url, self.model, problem, f"see url, model and the key of {self.where}") from None
                self._wait_as_told(error.headers.get("Retry-After"), attempt)
            except (OSError, ValueError, http.client.HTTPException) as error:
                problem = self._shown(str(getattr(error, "reason", error)))
        raise EndpointAway(f"{self.url}: no answer after {self.attempts} tries: {problem}")

    def _whole(self, reply: Any, give_up: float) -> bytes:
        """The bytes of an answer, up to one more than are looked at.

        Raises:
            IncompleteRead: it was cut off.
            TimeoutError: it is still coming after all of the time that it has.
        """
        data = b""
        while len(data) <= MOST_BYTES and (part := reply.read1(PART_BYTES)):
            data += part
            if self.clock() > give_up:
                raise TimeoutError(f"still sending after {self.timeout_seconds:g} s")
        if len(data) <= MOST_BYTES and reply.length:  # of a read with a bound, http.client does not say that it was cut off
            raise http.client.IncompleteRead(data, reply.length)
        return data

    def _shown(self, message: str) -> str:
        """The beginning of what a server said, without the key, of which it may repeat a part."""
        for length in range(len(self.key), min(SHORTEST_PART, len(self.key)) - 1, -1):
            message = message.replace(self.key[:length], HIDDEN) if length else message
        return cut(message)

    def _wait_as_told(self, seconds: str | None, attempt: int) -> None:
        if seconds is not None and seconds.strip().isdigit() and attempt + 1 < self.attempts:
            self.sleep(min(float(seconds), LONGEST_PAUSE_SECONDS))

    def _read_answer(self, data: bytes) -> Answer:
        """The message in an answer, and how many tokens it counts."""
        try:
            table: Any = json.loads(data) if len(data) <= MOST_BYTES else {}
            text = table["choices"][0]["message"]["content"]
        except (ValueError, LookupError, TypeError, RecursionError):
            table, text = {}, None
        if not isinstance(text, str):
            raise InputError(self.url, "choices[0].message.content", "is missing in the answer", "name an OpenAI-compatible endpoint")
        usage = table.get("usage")
        return Answer(text, _tokens(usage, "prompt_tokens"), _tokens(usage, "completion_tokens"))


def _tokens(usage: Any, name: str) -> int | None:
    """A count of tokens; None where there is none that can be one."""
    value = usage.get(name) if isinstance(usage, Mapping) else None
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 40 else None


def _said(error: urllib.error.HTTPError) -> str:
    """How the text of a refusal begins, as far as it arrives: its state says all that is needed."""
    try:
        return error.read(400).decode(errors="replace")
    except (OSError, ValueError, http.client.HTTPException):
        return ""


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
    if scheme != "https" and not _is_here(host):
        raise InputError(f"{where}.url", "", f"a key would go to {cut(host)} in the clear", "give an https:// address")


def _is_here(host: str) -> bool:
    """Whether a host is this machine: localhost, 127.0.0.0/8, ::1."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


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


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """A redirect would take the key along."""

    def redirect_request(self, *arguments: Any, **more: Any) -> None:
        """Follow none: the answer is an error of its own."""
        return None


_OPENER = urllib.request.build_opener(_NoRedirects)
