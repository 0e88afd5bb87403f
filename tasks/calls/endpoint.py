"""Asking a model over an OpenAI-compatible endpoint, in the strictest form that it knows."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from schemas.errors import InputError, check_address
from schemas.parsing import json_value
from tasks.calls.exchange import Exchange, NoAnswer, check_hidden, key_in
from tasks.settings import Config, Count, NonNegative, Positive

NOT_UNDERSTOOD = frozenset({400, 404, 415, 422, 501})
"""States by which servers say that they do not know a form of answer."""

FORMS = ("json_schema", "json_object", "text")
"""How an answer's form is asked for, the strictest first: servers differ in what they understand (specs A.3)."""

_UNDERSTOOD: dict[str, str] = {}
"""The form that an endpoint understood, by address and model: in this process it is asked for first."""


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

    def cost_usd(self, answer: CallAnswer) -> float:
        """What an answer costs [USD]; tokens that the endpoint did not count cost nothing."""
        sent, came = answer.prompt_tokens or 0, answer.reply_tokens or 0
        return (sent * self.prompt_usd_per_million + came * self.reply_usd_per_million) / 1e6


def check_endpoint(settings: EndpointSettings, where: str) -> None:
    """Raises InputError where no endpoint or model is named, the address is none, or a key would go in the clear. Whether the key is there
    is asked when something is sent: what the ledger has needs none."""
    if not settings.model:
        raise InputError(where, "model", "names no model", "give it as the endpoint calls it")
    if not settings.url.startswith(("http://", "https://")):
        raise InputError(where, "url", "is no address", "give that of an OpenAI-compatible endpoint: https://.../v1")
    check_address(settings.url, f"{where}.url")
    if settings.key_variable and os.environ.get(settings.key_variable):
        check_hidden(settings.url, where)


@dataclasses.dataclass(frozen=True)
class CallAnswer:
    """What came back. prompt_tokens, reply_tokens: As the endpoint counts them; None where it does not."""

    data: bytes
    prompt_tokens: int | None = None
    reply_tokens: int | None = None

    @property
    def text(self) -> str:
        """What a chat model says."""
        return self.data.decode()


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

    def ask(self, messages: Sequence[Mapping[str, Any]], schema: Mapping[str, Any], begun: Callable[[], None] = lambda: None) -> CallAnswer:
        """The model's answer to messages, in the form of a JSON schema as far as the server knows how.

        begun: Called before every request, with those that are sent again.

        Raises:
            InputError: the address, the key or the model is refused, or the key would go in the clear.
            EndpointAway: no answer of the protocol came, though it was tried several times.
        """
        exchange = Exchange(
            self.url, self.model, self.key, self.timeout_seconds, self.attempts, self.pause_seconds, where=self.where, sleep=self.sleep,
            clock=self.clock,
        )  # fmt: skip
        known = f"{self.url} {self.model}"
        for form in FORMS[FORMS.index(_UNDERSTOOD.get(known, FORMS[0])) :]:
            body: dict[str, Any] = {"model": self.model, "messages": list(messages), "temperature": 0}
            if form == "json_schema":
                body["response_format"] = {"type": form, "json_schema": {"name": "reply", "strict": True, "schema": dict(schema)}}
            elif form == "json_object":
                body["response_format"] = {"type": form}
            unknown = NOT_UNDERSTOOD if form != FORMS[-1] else ()
            answer = exchange.send("/chat/completions", json.dumps(body).encode(), _read_answer, begun, unknown)
            if answer is not None:
                _UNDERSTOOD[known] = form
                return answer
        raise AssertionError("the last form has an answer or an error")


def _read_answer(data: bytes) -> CallAnswer:
    """The message in an answer, and how many tokens it counts."""
    try:
        table: Any = json_value(data)
        text = table["choices"][0]["message"]["content"]
    except (ValueError, LookupError, TypeError, RecursionError):
        table, text = {}, None
    if not isinstance(text, str):
        raise NoAnswer("no choices[0].message.content, which OpenAI-compatible endpoints have")
    usage = table.get("usage")
    return CallAnswer(text.encode(errors="replace"), _tokens(usage, "prompt_tokens"), _tokens(usage, "completion_tokens"))


def _tokens(usage: Any, name: str) -> int | None:
    """A count of tokens; None where there is none that can be one."""
    value = usage.get(name) if isinstance(usage, Mapping) else None
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 40 else None
