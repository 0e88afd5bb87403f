"""Asking a vision-language model over an OpenAI-compatible endpoint: what can be tried again is, and nothing is swallowed."""

from __future__ import annotations

import dataclasses
import json
import os
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from typing import Any

from schemas.errors import InputError, check_address
from schemas.text import cut

MOST_BYTES = 4 << 20
"""Of an answer; a choice needs a kilobyte."""

TRIED_AGAIN = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
"""States of HTTP that pass."""

NOT_UNDERSTOOD = frozenset({400, 404, 415, 422, 501})
"""States by which servers say that they do not know a form of answer."""

LONGEST_PAUSE_SECONDS = 120.0

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
            InputError: the address, the key or the model is refused, or an answer is not of the protocol.
            EndpointAway: no answer came, though it was tried several times.
        """
        check_address(self.url, "selection.provider.url")
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
                    return self._text(reply.read(MOST_BYTES + 1))
            except urllib.error.HTTPError as error:
                message = cut(error.read(400).decode(errors="replace"))
                if error.code in NOT_UNDERSTOOD and not is_last:
                    return None
                problem = f"HTTP {error.code}: {message}"
                if error.code not in TRIED_AGAIN:
                    raise InputError(self.url, self.model, problem, "see url, model and the key of selection.provider") from None
                self._wait_as_told(error.headers.get("Retry-After"), attempt)
            except (OSError, ValueError) as error:  # http.client's errors are of both
                if isinstance(error, InputError):
                    raise
                problem = cut(str(getattr(error, "reason", error)))
        raise EndpointAway(f"{self.url}: no answer after {self.attempts} tries: {problem}")

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
