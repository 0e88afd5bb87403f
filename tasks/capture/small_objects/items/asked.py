"""Items that a vision-language model sees on a support (supplementary; specs A.3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import model_validator

from tasks.calls.asking import Conversation, picture_part, text_part, told_by
from tasks.calls.endpoint import EndpointSettings, check_endpoint
from tasks.calls.exchange import EndpointAway
from tasks.calls.prompts import Prompt, chosen_prompt
from tasks.calls.replies import UnreadableReply
from tasks.capture.small_objects.items.item import ITEMS, SupportItem, items_of, united
from tasks.capture.small_objects.items.pictures import Bools, MaskStyle, support_picture
from tasks.settings import Count, Share
from tasks.stage import Context
from tasks.vision.pixels import Image

WHERE = "capture.small_objects.provider.items"
"""The settings, as errors name them."""

_OUTSIDE = {
    "hard": "What does not belong to the {category} is black.", "dim": "What does not belong to the {category} is darkened.", "box": ""
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class AskedItems(EndpointSettings):
    """Items by a vision-language model, which is shown the support.

    `prompt_version` is filled in from the prompt, so that its words decide whether a scene is captured again.
    """

    kind: ClassVar[str] = "asked"
    prompt: Literal["corrected", "paraphrased"] = "corrected"  # `paraphrased` asks as the supplementary does, for a bare list (Table A1)
    prompt_file: str = ""  # text file with your own words, such as the paper's; {category} and {outside} are filled in
    prompt_version: str = dataclasses.field(init=False)  # from the prompt's text
    mask_style: MaskStyle = "dim"  # `hard`, as in the paper, removes what stands taller than the support's mask
    dilation: Share = 0.05  # of the mask, in longer sides of its box (specs A.3)
    margin: Share = 0.1  # above the mask, in heights of its box: tall things stick out (specs A.3)
    pixels: Count = 768  # of the picture's longer side: a pen on a desk is still 20 px long
    replies: Count = 2  # that are asked for when one cannot be read; the model is told why
    away: Literal["fallback", "retry"] = "fallback"  # where no endpoint answers, the scene goes on; `retry` leaves it to the next run
    version: str = "1"  # goes up when the same replies would give other items

    @model_validator(mode="after")
    def _with_prompt(self) -> Self:
        object.__setattr__(self, "prompt_version", prompt_of(self).version)
        return self


@dataclasses.dataclass(frozen=True)
class ToldItems:
    """Items on a support. call_ids: Of the replies that they are from. problems: Why there are no more, one line each."""

    items: tuple[SupportItem, ...]
    call_ids: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def asked_items(category: str, instance_id: str, shown: Sequence[tuple[Image, Bools]], context: Context, settings: AskedItems) -> ToldItems:
    """Items that a model sees on a support, in one picture or several.

    category, instance_id: Of the support. shown: Pictures, shapes (h, w, 3), with the support's masks, shapes (h, w).

    Raises:
        InputError: the endpoint refuses.
        EndpointAway: it does not answer, and that is left to the next run.
    """
    lists, calls, problems = [], [], []
    for picture, mask in shown:
        try:
            items, call_id = told_by(
                context, settings, conversation(category, instance_id, picture, mask, settings), items_of, WHERE, settings.replies
            )
        except EndpointAway as away:
            if settings.away == "retry":
                raise
            problems.append(f"items: {away}")
            break
        except UnreadableReply as error:
            problems.append(f"items: {error}")
            continue
        lists.append(items)
        calls.append(call_id)
    return ToldItems(united(lists), tuple(dict.fromkeys(calls)), tuple(problems))


def conversation(category: str, instance_id: str, picture: Image, mask: Bools, settings: AskedItems) -> Conversation:
    """What a model is asked about a support that one picture shows."""
    prompt = prompt_of(settings, settings.prompt_version)
    word = category.replace('"', "'")
    text = prompt.filled({"category": word, "outside": _OUTSIDE[settings.mask_style].format(category=word)})
    shown = support_picture(picture, mask, settings.mask_style, settings.dilation, settings.margin, settings.pixels)
    return Conversation(prompt, [{"role": "user", "content": [text_part(text), picture_part(shown)]}], ITEMS, instance_id)


def prompt_of(settings: AskedItems, version: str = "") -> Prompt:
    """Prompt that the settings choose. version: the version it must have, "" for any.

    Raises:
        InputError: the user's file cannot be used, or has another version.
    """
    bundled = Path(__file__).with_name(f"items_{settings.prompt}.txt")
    return chosen_prompt(settings.prompt_file, bundled, f"{WHERE}.prompt_file", ("category", "outside"), version)


def check(settings: AskedItems) -> None:
    """Raises InputError where the settings name no endpoint that can be asked."""
    check_endpoint(settings, WHERE)
