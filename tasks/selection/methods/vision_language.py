"""A vision-language model's pick: it is shown the crop and a picture of each candidate, and ranks them (specs C.6, GPT-4V)."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import io
import json
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError, check_address
from tasks.models import Model
from tasks.selection.crops import squared
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.endpoint import Endpoint, check_hidden, key_in
from tasks.selection.methods.method import Array, Lacking, SelectionMethod
from tasks.selection.methods.pictures import around, parts_of
from tasks.selection.methods.replies import UnreadableReply, ranking_of
from tasks.settings import Config, Count, NonNegative, Positive

PITCH_RADIANS = 0.35
RANKED = 5
"""Places that are asked for, as annotators rank."""

SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {"choice": {"type": "integer"}, "ranking": {"type": "array", "items": {"type": "integer"}}},
    "required": ["choice", "ranking"],
    "additionalProperties": False,
}


@dataclasses.dataclass(frozen=True)
class VisionLanguage(Config):
    """The ranking that a vision-language model gives. Its answers are remembered: the same request is sent once."""

    kind: ClassVar[str] = "vision_language"
    url: str = ""  # of an OpenAI-compatible endpoint, without /chat/completions; none is ours to name
    model: str = ""  # as the endpoint calls it
    key_variable: str = ""  # environment variable that holds the key; servers at home need none
    pixels: Count = 256  # of a picture's side: what crops in the lake have
    views: Count = 2  # pictures of a candidate, side by side: its front and its side
    replies: Count = 3  # that are asked for when one cannot be read; each time the model is told why
    attempts: Count = 4  # to reach the endpoint, before the scene is given up for this run
    pause_seconds: NonNegative = 2.0  # before the second, twice as long before each next one
    timeout_seconds: Positive = 120.0  # large models look at eleven pictures for a while


def score(query: InstanceQuery, candidates: Sequence[Evidence], config: VisionLanguage, model: Model | None) -> Array:
    """Scores that rank candidates as the model does, shape (k,): 1, 0.9, ... for those that it names, below them by geometry.

    Raises:
        Lacking: there is no crop, or no reply could be read.
        InputError: the endpoint refuses.
        EndpointAway: it does not answer.
    """
    if query.crop is None:
        raise Lacking("no crop of it")
    order = _ranking(query, candidates, config)
    scores = np.array([0.5 * each.geometric for each in candidates])
    for place, number in enumerate(order):
        scores[number - 1] = 1.0 - 0.5 * place / max(len(candidates), 1)
    return scores


def messages_of(query: InstanceQuery, candidates: Sequence[Evidence], config: VisionLanguage) -> list[dict[str, Any]]:
    """What the model is asked: the crop and what is known of the object, then a picture of each candidate with its number and size."""
    assert query.crop is not None
    size = " x ".join(f"{value:.2f}" for value in query.target.size)
    about = f" It was described so: {query.text}" if query.text else ""
    parts: list[dict[str, Any]] = [
        _text(
            f"The first picture shows an object in a scanned room: {query.category or 'unnamed'}, {size} m (length, width, height)."
            f"{about} Then come {len(candidates)} models of furniture, numbered from 1, each seen from several sides. Which of them should "
            "stand in its place? Judge shape and parts first, then proportions, material and color."
        ),
        _picture(squared(query.crop.on_white(), config.pixels)),
    ]
    for number, each in enumerate(candidates, start=1):
        views = around(parts_of(each.asset, query.context.blobs), 4, (PITCH_RADIANS,), config.pixels)[: config.views]
        extents = " x ".join(f"{value:.2f}" for value in each.sample.extents)
        parts += [_text(f"Candidate {number}, {extents} m:"), _picture(np.concatenate(list(views), axis=1))]
    parts.append(
        _text(
            f'Answer with JSON alone: {{"choice": NUMBER, "ranking": [NUMBERS]}}. "choice" is the best candidate; "ranking" holds the best '
            f"{min(RANKED, len(candidates))}, best first, beginning with the choice."
        )
    )
    return [{"role": "user", "content": parts}]


def _ranking(query: InstanceQuery, candidates: Sequence[Evidence], config: VisionLanguage) -> tuple[int, ...]:
    """Numbers of candidates, best first, as the model ranks them; a reply that could be read is remembered.

    Raises:
        Lacking: no reply could be read.
    """
    endpoint = Endpoint(
        config.url, config.model, key_in(config.key_variable), config.timeout_seconds, config.attempts, config.pause_seconds
    )  # fmt: skip
    messages = messages_of(query, candidates, config)
    key = hashlib.sha256(json.dumps([config.url, config.model, messages, SCHEMA], sort_keys=True).encode()).hexdigest()
    memory = query.context.caches[__name__]
    if key in memory:
        return ranking_of(memory[key].decode(), len(candidates))
    problem = ""
    for _ in range(config.replies):
        reply = endpoint.ask(messages, SCHEMA)
        try:
            order = ranking_of(reply, len(candidates))
        except UnreadableReply as error:
            problem = str(error)
            again = f"That cannot be used: {problem}. Answer again, with JSON alone."
            messages = [*messages, {"role": "assistant", "content": reply}, {"role": "user", "content": again}]
            continue
        memory[key] = reply.encode()
        return order
    raise Lacking(f"{config.model} gave {config.replies} replies that cannot be used: {problem}")


def _text(text: str) -> dict[str, Any]:
    return {"type": "text", "text": text}


def _picture(image: NDArray[np.uint8]) -> dict[str, Any]:
    """A picture inside of a message, PNG: the same pixels are the same request."""
    import PIL.Image

    file = io.BytesIO()
    PIL.Image.fromarray(np.ascontiguousarray(image)).save(file, "PNG")
    return {"type": "image_url", "image_url": {"url": f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"}}


def check(config: VisionLanguage) -> None:
    """Raises InputError where no endpoint or model is named, the address is none, or the key is not there or
    would go in the clear."""
    if not config.model:
        raise InputError("selection.provider", "model", "names no model", "give it as the endpoint calls it")
    if not config.url.startswith(("http://", "https://")):
        raise InputError("selection.provider", "url", "is no address", "give that of an OpenAI-compatible endpoint: https://.../v1")
    check_address(config.url, "selection.provider.url")
    if key_in(config.key_variable):
        check_hidden(config.url)


def label(config: VisionLanguage, model: Model | None) -> str:
    """Which model picked."""
    return config.model


VISION_LANGUAGE = SelectionMethod(
    name="vision_language", config=VisionLanguage, version="1", score=score, needs=("image", "endpoint"), label=label, check=check
)
