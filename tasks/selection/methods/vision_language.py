"""A vision-language model's pick: it is shown the crop and a picture of each candidate, and ranks them (specs C.6, GPT-4V)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from tasks.calls.asking import Conversation, ask, picture_part, text_part
from tasks.calls.endpoint import EndpointSettings, check_endpoint
from tasks.calls.prompts import Prompt
from tasks.calls.replies import UnreadableReply
from tasks.models import Model
from tasks.selection.evidence import Evidence, InstanceQuery
from tasks.selection.methods.method import Array, Lacking, SelectionMethod
from tasks.selection.methods.pictures import parts_of
from tasks.selection.methods.ranking import EXAMPLE, ranking_of
from tasks.settings import Count
from tasks.views.crops import squared
from tasks.views.pictures import around

WHERE = "selection.provider"
"""The settings, as errors name them."""

PITCH_RADIANS = 0.35
RANKED = 5
"""Places that are asked for, as annotators rank."""

QUESTION = (
    "The first picture shows an object in a scanned room: {category}, {size} m (length, width, height).{about} Then come {count} models of "
    "furniture, numbered from 1, each seen from several sides. Which of them should stand in its place? Judge shape and parts first, then "
    "proportions, material and color."
)
CANDIDATE = "Candidate {number}, {extents} m:"
FORM = (
    f'Answer with JSON alone, such as {EXAMPLE.replace("{", "{{").replace("}", "}}")}. "choice" is the best candidate; "ranking" holds the '
    "best {ranked}, best first, beginning with the choice."
)
PROMPT = Prompt("ranking", "\n".join((QUESTION, CANDIDATE, FORM)))

SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {"choice": {"type": "integer"}, "ranking": {"type": "array", "items": {"type": "integer"}}},
    "required": ["choice", "ranking"],
    "additionalProperties": False,
}


@dataclasses.dataclass(frozen=True)
class VisionLanguage(EndpointSettings):
    """The ranking that a vision-language model gives. Its answers are recorded: the same request is sent once."""

    kind: ClassVar[str] = "vision_language"
    pixels: Count = 256  # of a picture's side: what crops in the lake have
    views: Count = 2  # pictures of a candidate, side by side: its front and its side
    replies: Count = 3  # that are asked for when one cannot be read; each time the model is told why


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
    named = QUESTION.format(category=query.category or "unnamed", size=size, about=about, count=len(candidates))
    parts = [text_part(named), picture_part(squared(query.crop.on_white(), config.pixels))]
    for number, each in enumerate(candidates, start=1):
        views = around(parts_of(each.asset, query.context.blobs), 4, (PITCH_RADIANS,), config.pixels)[: config.views]
        extents = " x ".join(f"{value:.2f}" for value in each.sample.extents)
        parts += [text_part(CANDIDATE.format(number=number, extents=extents)), picture_part(np.concatenate(list(views), axis=1))]
    parts.append(text_part(FORM.format(ranked=min(RANKED, len(candidates)))))
    return [{"role": "user", "content": parts}]


def _ranking(query: InstanceQuery, candidates: Sequence[Evidence], config: VisionLanguage) -> tuple[int, ...]:
    """Numbers of candidates, best first, as the model ranks them.

    Raises:
        Lacking: no reply could be read.
    """
    talk = Conversation(PROMPT, messages_of(query, candidates, config), SCHEMA, query.instance.instance_id)
    problem = ""
    for _ in range(config.replies):
        reply = ask(query.context, config, talk, WHERE)
        try:
            return ranking_of(reply.text, len(candidates))
        except UnreadableReply as error:
            problem = str(error)
            talk = talk.again(reply.text, problem)
    raise Lacking(f"{config.model} gave {config.replies} replies that cannot be used: {problem}")


def check(config: VisionLanguage) -> None:
    """Raises InputError where no endpoint or model is named, the address is none, or the key is not there or would go in the clear."""
    check_endpoint(config, WHERE)


def label(config: VisionLanguage, model: Model | None) -> str:
    """Which model picked."""
    return config.model


VISION_LANGUAGE = SelectionMethod(
    name="vision_language", config=VisionLanguage, version="1", score=score, needs=("image", "endpoint"), label=label, check=check
)
