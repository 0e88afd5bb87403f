"""What a synthesis model is made of; defaults are the small models that one processor trains, `presets` has the published sizes."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.settings import WHOLE, Config, NonNegative, Share, adapter, union_of

# Most of each: settings come with models of others, and what is allocated follows from their word.
Slots = Annotated[int, Field(ge=2, le=256), WHOLE]
Width = Annotated[int, Field(ge=4, le=8192), WHOLE]
Part = Annotated[int, Field(ge=0, le=8192), WHOLE]
Depth = Annotated[int, Field(ge=1, le=64), WHOLE]
Heads = Annotated[int, Field(ge=1, le=64), WHOLE]
Steps = Annotated[int, Field(ge=2, le=10_000), WHOLE]
Beta = Annotated[float, Field(gt=0, lt=0.5)]


@dataclasses.dataclass(frozen=True)
class LearnedText(Config):
    """Learned vectors of the large object's category and of the room, added: stand in for a text encoder where nobody named weights."""

    kind: ClassVar[str] = "own"
    width: Width = 64  # some ten categories and seven rooms are to be told apart; CLIP's vectors have 512


@dataclasses.dataclass(frozen=True)
class ClipText(Config):
    """CLIP's vectors of "A desk in the office", frozen, from a folder that transformers wrote; a model keeps them."""

    kind: ClassVar[str] = "clip"
    weights: str = ""  # folder; nothing is fetched
    width: Width = 512  # of the projection; as clip-vit-base-patch32


@dataclasses.dataclass(frozen=True)
class Unet(Config):
    """The denoiser as published: a network of single slots ("Unet1D" without neighbors) with attention between slots on every level."""

    kind: ClassVar[str] = "unet"
    width: Width = 64  # an eighth of the published one: a step must stay near a thirtieth of a second on one processor
    levels: Depth = 2  # down, and as many up
    groups: Heads = 8  # of the norms; as published
    heads: Heads = 4  # of the attentions; as published
    head_width: Width = 16  # half of the published one, for an eighth of the width
    instance_width: Part = 0  # of a learned vector of each slot; 0: none, as slots are shuffled and alike
    crosses: bool = False  # attention to the text on every level; without, text reaches all slots with the step


@dataclasses.dataclass(frozen=True)
class Transformer(Config):
    """A plain transformer over slots in the place of the published denoiser: learns faster where it is small (specs D.7)."""

    kind: ClassVar[str] = "transformer"
    width: Width = 96  # as specs D.7, where it is enough for tables of six categories
    layers: Depth = 3  # as specs D.7
    heads: Heads = 4  # 24 channels each
    feedforward: Width = 192  # twice the width: half the usual one loses nothing here and saves a third of the time
    waves: Part = 8  # of each number of a box, beside the number: attention tells from products of them how far apart things are


@dataclasses.dataclass(frozen=True)
class Noise(Config):
    """How layouts are noised, and what the denoiser tells."""

    steps: Steps = 200  # as specs D.7; the published 1000 cost five times as much to sample
    beta_low: Beta = 1e-5  # variance added in the first step: it blurs places by 3 mm to a meter, published are 10 mm
    beta_high: Beta = 0.1  # in the last step: with 0.02 a seventh of the layout's variance would be left in the noisiest state
    target: Literal["v", "eps"] = "v"  # with the noise itself as target small networks get numbers of objects wrong
    weighting: Literal["none", "snr"] = "none"  # snr / (snr + 1) of v, as published, hardly looks at the steps that decide on categories
    curve: Literal["scaled_linear", "linear"] = "scaled_linear"  # roots of variances are even: more steps of little noise; published linear


ARCHITECTURES = (Transformer, Unet)
TEXTS = (LearnedText, ClipText)


@dataclasses.dataclass(frozen=True)
class SlotModel(Config):
    """What all three models have: slots, vocabulary and text."""

    slots: Slots = 13  # the large object and 12: more are rare on one table, and attention costs the square
    classes: Literal["seen", "all"] = "seen"  # categories of the training data alone, or all of the table of categories
    text: union_of(TEXTS) = dataclasses.field(default_factory=LearnedText)  # type: ignore[valid-type]  # CLIP where somebody names weights
    heights: Literal["bottoms", "middles"] = "bottoms"  # over the large object's top: one number for all on it; published are middles
    unknown_share: Share = 0.1  # of training examples whose room is hidden, so that a room that nobody knows is something learned


@dataclasses.dataclass(frozen=True)
class Atiss(SlotModel):
    """ATISS without floor plan: one object after another, each of a mixture of logistics, until the end symbol (specs D.3)."""

    kind: ClassVar[str] = "atiss"
    embedding: Width = 16  # of each of the eight parts of an object; a quarter of the published one
    layers: Depth = 3  # one less than published
    heads: Heads = 4  # half of the published ones; with it the width of a token is 128
    feedforward: Width = 256  # twice the width of a token; as published
    mixtures: Heads = 10  # logistics of each number; as published
    dropout: Share = 0.0  # short trainings do not overfit
    prefixes: Literal["even", "published"] = "even"  # beginnings learned from: as published, large scenes count less and all end early

    @property
    def width(self) -> int:
        """Of a token: eight parts."""
        return 8 * self.embedding


@dataclasses.dataclass(frozen=True)
class Diffusion(SlotModel):
    """What DiffuScene and PhyScene have: a denoiser of all slots at once."""

    architecture: union_of(ARCHITECTURES) = dataclasses.field(default_factory=Transformer)  # type: ignore[valid-type]
    noise: Noise = dataclasses.field(default_factory=Noise)
    categories: Literal["chances", "numbers"] = "chances"  # numbers, as published, leave shares of categories far off in the time there is
    null_share: Share = 0.1  # of training examples without text, for guidance; as usual
    guidance: NonNegative = 1.0  # weight of the text in sampling; 1: none of it is exaggerated
    iou_weight: NonNegative = 0.0  # of overlaps of the denoised layout in the loss


@dataclasses.dataclass(frozen=True)
class DiffuScene(Diffusion):
    """DiffuScene without floor plan (specs D.4).

    The small model deviates: it tells v, each step weighted alike, chances of categories, and heights over the large object's top, as a
    transformer that is told boxes as waves, too, in 200 steps of noise whose roots are even.
    """

    kind: ClassVar[str] = "diffuscene"
    iou_weight: NonNegative = 0.1  # as published


@dataclasses.dataclass(frozen=True)
class PhyScene(Diffusion):
    """PhyScene without floor plan (specs D.5): the network of DiffuScene, without a loss of overlaps, guided by physics in sampling.

    The small model deviates as that of DiffuScene does; the published one predicts the noise.
    """

    kind: ClassVar[str] = "physcene"


MODELS = (DiffuScene, PhyScene, Atiss)
SynthesisModel = union_of(MODELS)
"""Type of a field that holds a config of any of the models."""


def config_from(text: str) -> Diffusion | Atiss:
    """The network's config in that of the learned system, as JSON (`tasks.models.Model.config`).

    Raises:
        InputError: there is none in it.
    """
    try:
        return adapter(SynthesisModel).validate_python(json_value(text)["model"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "model", "config", "is not that of a synthesis model", "train it again, or import it with its own config"
        ) from error
