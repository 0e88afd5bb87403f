"""Asking a model: what the ledger has is not asked again, and what is asked is recorded, whatever comes of it."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.calls import ModelCall
from schemas.errors import InputError
from tasks.calls.endpoint import CallAnswer, EndpointSettings
from tasks.calls.exchange import EndpointAway
from tasks.calls.prompts import Prompt
from tasks.calls.replies import UnreadableReply
from tasks.views.pictures import png_of

if TYPE_CHECKING:
    from tasks.stage import Context

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Conversation:
    """What a chat model is asked: messages so far, and the JSON schema of the reply. instance_id: What it is about."""

    prompt: Prompt
    messages: Sequence[Mapping[str, Any]]
    schema: Mapping[str, Any]
    instance_id: str | None = None

    def again(self, reply: str, problem: str) -> Conversation:
        """The same, with a reply that cannot be used and why."""
        more = {"role": "user", "content": f"That cannot be used: {problem}. Answer again, with JSON alone."}
        return dataclasses.replace(self, messages=[*self.messages, {"role": "assistant", "content": reply}, more])


def text_part(text: str) -> dict[str, Any]:
    """A text inside of a message."""
    return {"type": "text", "text": text}


def picture_part(image: NDArray[np.uint8]) -> dict[str, Any]:
    """A picture inside of a message, shape (h, w, 3), as PNG."""
    return {"type": "image_url", "image_url": {"url": f"{PNG_URL}{base64.b64encode(png_of(image)).decode()}"}}


@dataclasses.dataclass(frozen=True)
class Reply:
    """What a call was answered with, now or before."""

    call_id: str
    text: str


def call_key(kind: str, *facts: Any) -> str:
    """The id of a call: of what it is and all that its answer follows from, as JSON. Not of where it is asked: an address may move."""
    return hashlib.sha256(json.dumps([kind, *facts], sort_keys=True).encode()).hexdigest()


def ask(context: Context, settings: EndpointSettings, conversation: Conversation, where: str) -> Reply:
    """A model's reply, as it is in the ledger; else the endpoint is asked. where: The settings, as errors name them.

    Raises:
        InputError: the endpoint refuses.
        EndpointAway: it does not answer, or no further call may be made.
    """
    asked = {"messages": list(conversation.messages), "schema": conversation.schema}
    call_id = call_key("chat", settings.model, settings.model_version, _by_pixels(asked))
    known = context.ledger.reply(call_id)
    if known is not None:
        return Reply(call_id, known.decode())

    def send(begun: Callable[[], None]) -> CallAnswer:
        return settings.endpoint(where).ask(conversation.messages, conversation.schema, begun)

    call = new_call(
        context, call_id, "chat", conversation.instance_id, (settings.model, settings.model_version),
        (conversation.prompt.name, conversation.prompt.version),
    )  # fmt: skip
    reply = recorded(context, call, json.dumps(asked, sort_keys=True).encode(), send, settings.cost_usd)
    return Reply(call_id, reply.decode())


def told_by(
    context: Context, settings: EndpointSettings, talk: Conversation, read: Callable[[str], T], where: str, replies: int
) -> tuple[T, str]:
    """What a model says, read, and the id of the call. A reply that cannot be read is asked for again, with the reason.

    read: Raises UnreadableReply where it is none. replies: How many are asked for at most.

    Raises:
        UnreadableReply: the last one could not be read, either.
        InputError, EndpointAway: as `ask`.
    """
    for left in range(replies - 1, -1, -1):
        reply = ask(context, settings, talk, where)
        try:
            return read(reply.text), reply.call_id
        except UnreadableReply as error:
            if not left:
                raise UnreadableReply(f"{settings.model} gave no reply that can be used: {error}") from error
            talk = talk.again(reply.text, str(error))
    raise AssertionError("at least one reply is asked for")


PNG_URL = "data:image/png;base64,"
"""How a picture inside of a message begins."""


def pixels_digest(png: bytes) -> str:
    """Hash of what a picture shows: its bytes are another's with every version of what packs them."""
    import PIL.Image

    with PIL.Image.open(io.BytesIO(png)) as picture:
        shown = np.asarray(picture.convert("RGB"))
    return hashlib.sha256(repr(shown.shape).encode() + shown.tobytes()).hexdigest()


def _by_pixels(value: Any) -> Any:
    """The same JSON value with the hash of what it shows in the place of each picture."""
    if isinstance(value, Mapping):
        return {name: _by_pixels(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_by_pixels(each) for each in value]
    if isinstance(value, str) and value.startswith(PNG_URL):
        return pixels_digest(base64.b64decode(value.removeprefix(PNG_URL)))
    return value


def new_call(
    context: Context, call_id: str, kind: str, instance_id: str | None, model: tuple[str, str], prompt: tuple[str, str]
) -> ModelCall:
    """The row of a call that nobody has made yet. model, prompt: Name and version."""
    return ModelCall(
        call_id=call_id, kind=kind, stage=context.stage, scene_id=context.scene_id, instance_id=instance_id, model=model[0],
        model_version=model[1], prompt=prompt[0], prompt_version=prompt[1], request_blob="", outcome="answered", problem=None,
        reply_blob=None, prompt_tokens=None, reply_tokens=None, cost_usd=0.0, seconds=0.0, attempts=1, lost=0,
        asked_at=datetime.now(UTC), run="",
    )  # fmt: skip


def recorded(
    context: Context,
    call: ModelCall,
    request: bytes,
    send: Callable[[Callable[[], None]], CallAnswer],
    price: Callable[[CallAnswer], float] = lambda answer: 0.0,
) -> bytes:
    """The reply to a call that nobody has made: it is sent, and recorded whatever comes of it.

    Raises:
        InputError, EndpointAway: as `send` does; that is recorded, too.
    """
    ledger, sent = context.ledger, 0

    def begun() -> None:
        nonlocal sent
        ledger.request()
        sent += 1

    outcome: Literal["answered", "refused", "away"]
    with ledger.asking(call.call_id, call.scene_id):
        known = ledger.reply(call.call_id)  # somebody else may have been quicker
        if known is not None:
            return known
        clock = time.perf_counter()
        answer: CallAnswer | None = None
        failure: InputError | EndpointAway | None = None
        try:
            answer, outcome = send(begun), "answered"
        except InputError as error:
            failure, outcome = error, "refused"
        except EndpointAway as error:
            failure, outcome = error, "away"
        if failure is not None and not sent:
            raise failure  # nothing left this process
        reply = answer.data if answer is not None else None
        done = dataclasses.replace(
            call, outcome=outcome, problem=None if failure is None else str(failure), seconds=time.perf_counter() - clock, attempts=sent,
            prompt_tokens=answer.prompt_tokens if answer is not None else None,
            reply_tokens=answer.reply_tokens if answer is not None else None, cost_usd=price(answer) if answer is not None else 0.0,
        )  # fmt: skip
        kept = ledger.record(done, request, reply)
    if failure is not None:
        raise failure
    assert kept is not None
    return kept
