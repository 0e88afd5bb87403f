"""What a policy is made of: the small model that one processor trains, and the published size, as values of the same fields."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.settings import LISTED, WHOLE, Config, Positive, Share, adapter, union_of

# Most of each: settings come with models of others, and what is allocated follows from their word.
Width = Annotated[int, Field(ge=2, le=8192), WHOLE]
Depth = Annotated[int, Field(ge=1, le=64), WHOLE]
Heads = Annotated[int, Field(ge=1, le=64), WHOLE]
Window = Annotated[int, Field(ge=1, le=1000), WHOLE]
Pixels = Annotated[int, Field(ge=1, le=4096), WHOLE]
Cells = Annotated[int, Field(ge=1, le=64), WHOLE]
Degrees = Annotated[float, Field(gt=0, lt=180)]
Pitch = Annotated[float, Field(ge=-90, le=90)]


@dataclasses.dataclass(frozen=True)
class AgentCamera(Config):
    """The agent's camera: a pinhole above its center that looks where it is heading."""

    width: Pixels = 64  # a picture costs a tenth of a millisecond, and sixteen patches of it are what one processor learns from (specs E.4)
    height: Pixels = 64  # as wide as high
    hfov_degrees: Degrees = 79.0  # Habitat's object navigation on HSSD
    height_m: Positive = 0.88  # the top of the agent that the navigation stage has
    pitch_degrees: Pitch = 0.0  # up is above 0; level, as Habitat's

    @property
    def hfov_radians(self) -> float:
        """Horizontal field of view."""
        return math.radians(self.hfov_degrees)


@dataclasses.dataclass(frozen=True)
class OwnEyes(Config):
    """Two layers over patches that do not overlap, trained with the rest: stand in for SigLIP where nobody named weights."""

    kind: ClassVar[str] = "own"
    patch: Pixels = 16  # a token is 16 pixels wide: four times as many tokens learn at a quarter of the speed (specs E.4)
    part: Pixels = 4  # pixels of the parts that a patch is read in: what is learned of one serves all
    width: Width = 32  # of what is told of a part
    depth: bool = False  # whether it also senses how far away things are, as the simulator's depth camera does
    goal: bool = False  # whether it senses which pixels show a thing of the goal's category, as the simulator's semantic camera does


@dataclasses.dataclass(frozen=True)
class SiglipEyes(Config):
    """SigLIP's patch tokens, frozen, from a folder that transformers wrote, pooled to a grid and compressed."""

    kind: ClassVar[str] = "siglip"
    weights: str = ""  # folder; nothing is fetched
    width: Width = 768  # of its tokens; as siglip-base-patch16-256
    grid: Annotated[tuple[Cells, Cells], LISTED] = (7, 12)  # rows and columns; as published


@dataclasses.dataclass(frozen=True)
class OwnGoal(Config):
    """A learned vector for each category of targets: stands in for a text encoder where nobody named weights."""

    kind: ClassVar[str] = "own"


@dataclasses.dataclass(frozen=True)
class SiglipGoal(Config):
    """SigLIP's states of "Navigate to the chair", frozen, from a folder that transformers wrote; a model keeps them."""

    kind: ClassVar[str] = "siglip"
    weights: str = ""  # folder; nothing is fetched
    width: Width = 768  # of its states; as siglip-base-patch16-256
    tokens: Window = 65  # 64 states and the pooled one; as published


EYES = (OwnEyes, SiglipEyes)
GOALS = (OwnGoal, SiglipGoal)


@dataclasses.dataclass(frozen=True)
class PolicyModel(Config):
    """A policy: pictures and goal are fused into one vector a step, and a causal decoder over the last steps tells the next action."""

    camera: AgentCamera = dataclasses.field(default_factory=AgentCamera)  # small enough to render and to learn from on one processor
    eyes: union_of(EYES) = dataclasses.field(default_factory=OwnEyes)  # type: ignore[valid-type]  # SigLIP where somebody names weights
    goal: union_of(GOALS) = dataclasses.field(default_factory=OwnGoal)  # type: ignore[valid-type]  # SigLIP where somebody names weights
    blind: bool = False  # without pictures: what the goal and the last actions alone tell
    goalless: bool = False  # without a goal: what the pictures alone tell
    width: Width = 64  # of a token (specs E.4)
    fusion_layers: Depth = 2  # over the tokens of a picture and the goal (specs E.4)
    decoder_layers: Depth = 2  # over steps (specs E.4); these cost a twentieth of the others
    heads: Heads = 4  # 16 channels each
    feedforward: Width = 128  # twice the width: half the usual one
    dropout: Share = 0.1  # as published
    window: Window = 10  # steps that the decoder sees; as printed in the supplementary

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"width: {self.width} channels are not shared by {self.heads} heads, or by sines and cosines")
        if isinstance(self.eyes, OwnEyes):
            patch, part = self.eyes.patch, self.eyes.part
            if patch % part or self.camera.width % patch or self.camera.height % patch:
                size = f"{self.camera.width} x {self.camera.height}"
                raise ValueError(f"eyes: pictures of {size} pixels do not divide into patches of {patch}, or these into parts of {part}")
        return self

    @property
    def senses_depth(self) -> bool:
        """Whether it senses how far away things are."""
        return not self.blind and isinstance(self.eyes, OwnEyes) and bool(self.eyes.depth)

    @property
    def senses_goal(self) -> bool:
        """Whether it senses which pixels show what it is sent to."""
        return not (self.blind or self.goalless) and isinstance(self.eyes, OwnEyes) and bool(self.eyes.goal)

    @property
    def channels(self) -> int:
        """Values of a pixel that the network takes."""
        return 3 + self.senses_depth + self.senses_goal

    @property
    def tokens(self) -> int:
        """Tokens of a picture."""
        if self.blind:
            return 0
        if isinstance(self.eyes, OwnEyes):
            return (self.camera.width // self.eyes.patch) * (self.camera.height // self.eyes.patch)
        return int(self.eyes.grid[0] * self.eyes.grid[1])


@dataclasses.dataclass(frozen=True)
class SmallPolicy(PolicyModel):
    """0.2 M parameters; trained here in minutes, and acts without torch."""

    kind: ClassVar[str] = "small"


@dataclasses.dataclass(frozen=True)
class WideCamera(AgentCamera):
    """The camera in the shape of the grid that SPOC's tokens are pooled to."""

    width: Pixels = 384  # as SPOC
    height: Pixels = 224  # as SPOC


@dataclasses.dataclass(frozen=True)
class PaperPolicy(PolicyModel):
    """As published: SPOC's `siglip_base_3` with one camera (specs E.1)."""

    kind: ClassVar[str] = "paper"
    camera: WideCamera = dataclasses.field(default_factory=WideCamera)  # in the shape of the grid; as SPOC
    eyes: union_of(EYES) = dataclasses.field(default_factory=SiglipEyes)  # type: ignore[valid-type]  # as published
    goal: union_of(GOALS) = dataclasses.field(default_factory=SiglipGoal)  # type: ignore[valid-type]  # as published
    width: Width = 512  # as published
    fusion_layers: Depth = 3  # as printed in the supplementary
    decoder_layers: Depth = 3  # as printed in the supplementary
    heads: Heads = 8  # as published
    feedforward: Width = 2048  # as published


MODELS = (SmallPolicy, PaperPolicy)
AnyPolicy = union_of(MODELS)
"""Type of a field that holds a config of either size."""


def config_from(text: str) -> PolicyModel:
    """The network's config in that of the learned system, as JSON (`tasks.models.Model.config`).

    Raises:
        InputError: there is none in it.
    """
    try:
        made: PolicyModel = adapter(AnyPolicy).validate_python(json_value(text)["model"])
        return made
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("model", "config", "is not that of a policy", "train it again, or import it with its own config") from error
