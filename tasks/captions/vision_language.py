"""Captions by a vision-language model: it is shown the crop, and told the label and the size of the box (supplementary A.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from tasks.calls.asking import Conversation, Prompt, picture_part, text_part, told_by
from tasks.calls.endpoint import EndpointSettings, check_endpoint
from tasks.calls.exchange import EndpointAway
from tasks.calls.replies import UnreadableReply
from tasks.captions.classical import ClassicalCaptions, described
from tasks.captions.colors import WORDS
from tasks.captions.physics import MIN_SIDE_M, materials
from tasks.captions.wording import APPEARANCE, PHYSICS, Appearance, PhysicalAttributes, appearance_of, attributes_of
from tasks.geometry.boxes import grown_box
from tasks.settings import Count, Share
from tasks.stage import Context
from tasks.views.crops import crop_of, squared

T = TypeVar("T")

WHERE = "captions.provider"
"""The settings, as errors name them."""

PRINTED_FRICTION = 2.0
"""Most of the printed scale, whose last band is above 1; what rows take."""


@dataclasses.dataclass(frozen=True)
class VisionLanguageCaptions(EndpointSettings):
    """A vision-language model's sentence, words and physical attributes; the classical ones where it says nothing of use."""

    kind: ClassVar[str] = "vision_language"
    pixels: Count = 384  # of the picture's side: more than crops of most objects have
    physics_prompt: Literal["corrected", "printed"] = "corrected"  # the printed one has gaps and two scales of friction (specs F.2)
    replies: Count = 2  # that are asked for when one cannot be read or is not plausible; the model is told why
    away: Literal["fallback", "retry"] = "fallback"  # where no endpoint answers, the scene goes on; `retry` leaves it to the next run
    restitution: Share = 0.05  # of what does not bounce, by its word
    bouncy_restitution: Share = 0.6  # of what does: a rubber ball's is 0.8, a tennis ball's 0.7, a football's 0.5
    classical: ClassicalCaptions = dataclasses.field(default_factory=ClassicalCaptions)  # who stands in
    version: str = "1"  # goes up when the same replies would give another caption


def captioned(
    instance: Instance, frame: Frame | None, mask: Mask | None, context: Context, provider: VisionLanguageCaptions
) -> tuple[Caption, list[str]]:
    """The caption of an instance, and what could not be told well. frame, mask: Of its best view, as far as they are known.

    Raises:
        InputError: the endpoint refuses.
        EndpointAway: it does not answer, or no further call may be made, and that is left to the next run.
    """
    caption, unseen, problems = described(instance, context, provider.classical)
    size = tuple(max(side, MIN_SIDE_M) for side in grown_box(instance.box_pose, instance.box_size, instance.hidden_m)[1].tolist())
    lacking: list[str] = []
    looks, looks_id = _told(_about_looks(instance, frame, mask, size, context, provider), appearance_of, context, provider, lacking)
    sentence = looks.sentence if looks is not None else None
    most = PRINTED_FRICTION if provider.physics_prompt == "printed" else 1.0

    def read(reply: str) -> PhysicalAttributes:
        return attributes_of(reply, size, most_friction=most)

    behavior, behavior_id = _told(_about_physics(instance, size, sentence, provider), read, context, provider, lacking)
    changes: dict[str, Any] = {
        "provider": provider.kind, "provider_version": f"{provider.version}:{provider.model}", "is_fallback": bool(lacking),
        "appearance_call_id": looks_id, "physics_call_id": behavior_id,
    }  # fmt: skip
    if looks is None and behavior is None:
        changes |= {"provider": caption.provider, "provider_version": caption.provider_version}
    if looks is not None:
        changes |= _looks(looks, caption)
    if behavior is not None:
        changes |= _behavior(behavior, changes.get("materials", caption.materials), size, provider)
        problems = []
    return dataclasses.replace(caption, **changes), [*(unseen if looks is None or not looks.colors else []), *problems, *lacking]


def check(config: VisionLanguageCaptions) -> None:
    """Raises InputError where the settings name no endpoint that can be asked."""
    check_endpoint(config, WHERE)


def _told(
    talk: Conversation | str, read: Callable[[str], T], context: Context, provider: VisionLanguageCaptions, lacking: list[str]
) -> tuple[T | None, str | None]:
    """What a model says, read, and the id of the call; None where it says nothing of use, which `lacking` then tells.

    talk: What it is asked, or why it cannot be.
    """
    name = "appearance" if isinstance(talk, str) else talk.prompt.name
    try:
        if isinstance(talk, str):
            raise UnreadableReply(talk)
        return told_by(context, provider, talk, read, WHERE, provider.replies)
    except EndpointAway as away:
        if provider.away == "retry":
            raise
        problem = str(away)
    except UnreadableReply as error:
        problem = str(error)
    lacking.append(f"{name}: {problem}; the classical one stands in")
    return None, None


def _about_looks(
    instance: Instance, frame: Frame | None, mask: Mask | None, size: tuple[float, ...], context: Context, provider: VisionLanguageCaptions
) -> Conversation | str:
    try:
        crop = crop_of(instance, frame, mask, context.blobs)
    except InputError as error:
        return str(error)
    if crop is None:
        return "no picture of it"
    prompt = prompt_of("appearance")
    text = prompt.text.format(
        category=_name(instance), length=size[0], width=size[1], height=size[2], color_words=", ".join(WORDS),
        material_words=", ".join(materials()),
    )  # fmt: skip
    picture = picture_part(squared(crop.on_white(), provider.pixels))
    return Conversation(prompt, [{"role": "user", "content": [text_part(text), picture]}], APPEARANCE, instance.instance_id)


def _about_physics(instance: Instance, size: tuple[float, ...], sentence: str | None, provider: VisionLanguageCaptions) -> Conversation:
    prompt = prompt_of(f"physics_{provider.physics_prompt}")
    about = f' It was described so: "{sentence}"' if sentence else ""
    text = prompt.text.format(category=_name(instance), length=size[0], width=size[1], height=size[2], about=about)
    return Conversation(prompt, [{"role": "user", "content": text}], PHYSICS, instance.instance_id)


@cache
def prompt_of(name: str) -> Prompt:
    """The prompt in the file of a name, beside this module."""
    with open(Path(__file__).parent / f"{name}.txt", encoding="utf-8") as file:
        return Prompt(name, file.read())


def _name(instance: Instance) -> str:
    return (instance.category or instance.nyu40_label).replace('"', "'")


def _looks(looks: Appearance, caption: Caption) -> dict[str, Any]:
    """Fields of a caption's looks. Shares are those of the points, 0 for a color that these do not show."""
    shares = dict(zip(caption.colors, caption.color_shares, strict=True))
    colors = looks.colors or caption.colors
    return {
        "sentence": looks.sentence,
        "colors": colors,
        "color_shares": tuple(shares.get(color, 0.0) for color in colors),
        "materials": looks.materials or caption.materials,
    }


def _behavior(
    behavior: PhysicalAttributes, made_of: tuple[str, ...], size: tuple[float, ...], provider: VisionLanguageCaptions
) -> dict[str, Any]:
    """Fields of how an object behaves. Density is its first material's, and the solid fraction follows from mass and box."""
    density = materials()[made_of[0]].density_kg_m3
    fraction = behavior.mass_kg / (density * size[0] * size[1] * size[2])
    is_solid = 0.001 <= fraction <= 1.0
    return {
        "body_type": behavior.body_type,
        "mass_kg": behavior.mass_kg,
        "density_kg_m3": density if is_solid else None,
        "solid_fraction": fraction if is_solid else None,
        "friction": behavior.friction,
        "restitution": provider.bouncy_restitution if behavior.is_bouncy else provider.restitution,
        "attribute_source": f"model:{provider.model}",
    }
