"""Captions by a vision-language model: it is shown the crop, and told the label and the size of the box (supplementary A.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, TypeVar

from pydantic import model_validator

from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from tasks.calls.asking import Conversation, picture_part, text_part, told_by
from tasks.calls.endpoint import EndpointSettings, check_endpoint
from tasks.calls.exchange import EndpointAway
from tasks.calls.prompts import Prompt, bundled_prompt, chosen_prompt
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

MAX_PARAPHRASED_FRICTION = 2.0
"""Largest friction that the paraphrased prompt may be answered with: its last band is above 1, and rows take 2."""


@dataclasses.dataclass(frozen=True)
class VisionLanguageCaptions(EndpointSettings):
    """A vision-language model's sentence, words and physical attributes; the classical ones where it says nothing of use.

    `physics_prompt_version` is filled in from the prompt, so that its words decide whether captions are made again.
    """

    kind: ClassVar[str] = "vision_language"
    pixels: Count = 384  # of the picture's side: more than crops of most objects have
    physics_prompt: Literal["corrected", "paraphrased"] = "corrected"  # the paraphrase has the paper's gaps and two scales of friction
    physics_prompt_file: str = ""  # text file with a prompt of your own; replies are read in the scale of `physics_prompt`
    physics_prompt_version: str = dataclasses.field(init=False)  # from the prompt's text
    replies: Count = 2  # that are asked for when one cannot be read or is not plausible; the model is told why
    away: Literal["fallback", "retry"] = "fallback"  # where no endpoint answers, the scene goes on; `retry` leaves it to the next run
    restitution: Share = 0.05  # of what does not bounce, by its word
    bouncy_restitution: Share = 0.6  # of what does: a rubber ball's is 0.8, a tennis ball's 0.7, a football's 0.5
    classical: ClassicalCaptions = dataclasses.field(default_factory=ClassicalCaptions)  # who stands in
    version: str = "1"  # goes up when the same replies would give another caption

    @model_validator(mode="after")
    def _with_prompt(self) -> Self:
        object.__setattr__(self, "physics_prompt_version", physics_prompt_of(self).version)
        return self


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
    most = MAX_PARAPHRASED_FRICTION if provider.physics_prompt == "paraphrased" else 1.0

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
    prompt = bundled_prompt(Path(__file__).with_name("appearance.txt"))
    words = {"color_words": ", ".join(WORDS), "material_words": ", ".join(materials())}
    text = prompt.filled({"category": _name(instance), **_lengths(size), **words})
    picture = picture_part(squared(crop.on_white(), provider.pixels))
    return Conversation(prompt, [{"role": "user", "content": [text_part(text), picture]}], APPEARANCE, instance.instance_id)


def _about_physics(instance: Instance, size: tuple[float, ...], sentence: str | None, provider: VisionLanguageCaptions) -> Conversation:
    prompt = physics_prompt_of(provider, provider.physics_prompt_version)
    about = f' It was described so: "{sentence}"' if sentence else ""
    text = prompt.filled({"category": _name(instance), **_lengths(size), "about": about})
    return Conversation(prompt, [{"role": "user", "content": text}], PHYSICS, instance.instance_id)


def physics_prompt_of(provider: VisionLanguageCaptions, version: str = "") -> Prompt:
    """Prompt for physical attributes that the settings choose. version: the version it must have, "" for any.

    Raises:
        InputError: the user's file cannot be used, or has another version.
    """
    bundled = Path(__file__).with_name(f"physics_{provider.physics_prompt}.txt")
    fields = ("category", "length", "width", "height", "about")
    return chosen_prompt(provider.physics_prompt_file, bundled, f"{WHERE}.physics_prompt_file", fields, version)


def _lengths(size: Sequence[float]) -> dict[str, str]:
    """Sides of a box [m], shape (3,), as prompts show them."""
    return {name: f"{side:.2f}" for name, side in zip(("length", "width", "height"), size, strict=True)}


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
