"""What a selection model is made of and how it is trained; the paper's form and the authors' release are values of the same fields."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from tasks.settings import LISTED, WHOLE, Config, NonNegative, Positive, Share, union_of

# Most of each: settings come with models of others, and what scores by them is allocated by their word.
Points = Annotated[int, Field(ge=1, le=65_536), WHOLE]
Groups = Annotated[int, Field(ge=1, le=4096), WHOLE]
Width = Annotated[int, Field(ge=1, le=8192), WHOLE]
Hidden = Annotated[int, Field(ge=1, le=32_768), WHOLE]
Depth = Annotated[int, Field(ge=1, le=128), WHOLE]
Heads = Annotated[int, Field(ge=1, le=256), WHOLE]
Buckets = Annotated[int, Field(ge=1, le=524_288), WHOLE]
Widths = Annotated[tuple[Width, ...], Field(strict=False, fail_fast=True, max_length=16)]


@dataclasses.dataclass(frozen=True)
class Patches(Config):
    """Point encoder of patches: groups of near points through a small PointNet, then a transformer (Point-BERT; ULIP-2)."""

    points: Points = 192  # of a candidate's cloud: a cup's handle still has a dozen
    groups: Groups = 24  # half of what would cover the cloud once: one step must stay below half a second on two cores
    group_size: Groups = 12  # 24 x 12 points cover 192 of them one and a half times
    dim: Width = 96  # 2 M parameters are the limit; more did not help where training is short
    depth: Depth = 3  # blocks
    heads: Heads = 4  # 24 channels each
    first_widths: Annotated[tuple[Width, Width], LISTED] = (32, 64)  # the PointNet's layers before points see their group ...
    second_widths: Annotated[tuple[Width, Width], LISTED] = (96, 96)  # ... and after
    position_width: Width = 64  # hidden layer of the embedding of places
    activation: Literal["gelu", "relu"] = "relu"  # half the time of GELU without torch
    drop_path: Share = 0.0  # of the last block, less before: shallow networks lose more than they gain
    embedding: Width = 96  # length of what clouds and queries are compared by
    head_width: Width = 128  # hidden layer of the quality head
    head_dropout: Share = 0.2  # a small head forgets little


@dataclasses.dataclass(frozen=True)
class Small(Patches):
    """Below 2 M parameters; trained here in minutes, and scored without torch."""

    kind: ClassVar[str] = "small"


@dataclasses.dataclass(frozen=True)
class PaperPatches(Patches):
    """As published: Point-BERT of ULIP-2, 33 M parameters."""

    kind: ClassVar[str] = "paper"
    points: Points = 1024  # as the release's command; the backbone was trained on 10,000
    groups: Groups = 512  # as ULIP-2
    group_size: Groups = 32  # as ULIP-2
    dim: Width = 384  # as ULIP-2
    depth: Depth = 18  # as ULIP-2
    heads: Heads = 6  # as ULIP-2
    first_widths: Annotated[tuple[Width, Width], LISTED] = (128, 256)  # as ULIP-2
    second_widths: Annotated[tuple[Width, Width], LISTED] = (512, 256)  # as ULIP-2
    position_width: Width = 128  # as ULIP-2
    activation: Literal["gelu", "relu"] = "gelu"  # as ULIP-2
    drop_path: Share = 0.1  # as ULIP-2
    embedding: Width = 1280  # as ViT-bigG-14
    head_width: Width = 256  # as released
    head_dropout: Share = 0.5  # as released


@dataclasses.dataclass(frozen=True)
class Uni3d(Patches):
    """Shaped as Uni3D: patches into a plain vision transformer whose first token answers (EVA giant by default)."""

    kind: ClassVar[str] = "uni3d"
    points: Points = 8192  # as released
    groups: Groups = 512  # as released
    group_size: Groups = 64  # as released
    dim: Width = 1408  # EVA giant
    depth: Depth = 40  # EVA giant
    heads: Heads = 16  # EVA giant
    mlp_width: Hidden = 6144  # EVA giant
    first_widths: Annotated[tuple[Width, Width], LISTED] = (128, 256)  # as released
    second_widths: Annotated[tuple[Width, Width], LISTED] = (512, 512)  # as released
    position_width: Width = 128  # as released
    activation: Literal["gelu", "relu"] = "gelu"  # as released
    embedding: Width = 1024  # as EVA02-E-14-plus


@dataclasses.dataclass(frozen=True)
class PointNet2(Config):
    """PointNet++ with single-scale grouping (Qi et al., 2017)."""

    kind: ClassVar[str] = "pointnet2"
    points: Points = 1024  # as published
    centers: Annotated[tuple[Groups, Groups], LISTED] = (512, 128)  # as published
    radii: Annotated[tuple[Positive, Positive], LISTED] = (0.2, 0.4)  # as published, of a cloud of radius 1
    samples: Annotated[tuple[Groups, Groups], LISTED] = (32, 64)  # as published
    first_widths: Widths = (64, 64, 128)  # as published
    second_widths: Widths = (128, 128, 256)  # as published
    third_widths: Widths = (256, 512, 1024)  # as published, over the whole cloud
    last_widths: Widths = (512, 256)  # as published
    embedding: Width = 256  # the last layer of the recipe
    head_width: Width = 256  # as PaperPatches
    head_dropout: Share = 0.5  # as published


ARCHITECTURES = (Small, PaperPatches, Uni3d, PointNet2)


@dataclasses.dataclass(frozen=True)
class NoQuery(Config):
    """The model is asked without it."""

    kind: ClassVar[str] = "none"


@dataclasses.dataclass(frozen=True)
class OwnImage(Config):
    """A small convolutional network, trained with the rest: stands in where nobody named weights."""

    kind: ClassVar[str] = "own"
    side: Literal[32, 64] = 64  # pixels; crops of small things have no more
    widths: Annotated[tuple[Width, Width, Width], LISTED] = (16, 32, 64)  # a stride of 2 each


@dataclasses.dataclass(frozen=True)
class OwnText(Config):
    """Learned vectors of hashed words and their letters: unknown words are near those that are written alike."""

    kind: ClassVar[str] = "own"
    buckets: Buckets = 4096  # some 1,000 words and their parts collide little
    width: Width = 32  # half a megabyte at half precision
    tokens: Points = 64  # of a caption; what is longer is cut


@dataclasses.dataclass(frozen=True)
class ClipQuery(Config):
    """CLIP, frozen, from a folder that transformers wrote."""

    kind: ClassVar[str] = "clip"
    weights: str = ""  # folder; nothing is fetched


@dataclasses.dataclass(frozen=True)
class SiglipQuery(Config):
    """SigLIP, frozen, from a folder that transformers wrote."""

    kind: ClassVar[str] = "siglip"
    weights: str = ""  # folder; nothing is fetched


@dataclasses.dataclass(frozen=True)
class Dinov2Query(Config):
    """DINOv2, frozen, from a folder that transformers wrote; images alone."""

    kind: ClassVar[str] = "dinov2"
    weights: str = ""  # folder; nothing is fetched


@dataclasses.dataclass(frozen=True)
class AugmentationConfig(Config):
    """How clouds are changed in training (specs C.4); colors stay."""

    dropout: Share = 0.6  # at most, of the points; the paper's .875 leaves 24 of 192
    scale_least: Positive = 0.9  # the paper's .8 to 1.25 hides how large a thing is, which counts here
    scale_most: Positive = 1.1  # as scale_least
    shift: NonNegative = 0.03  # of the cloud's radius, along each axis
    tilt_radians: NonNegative = 0.06  # standard deviation of a turn about each axis ...
    tilt_limit_radians: NonNegative = 0.18  # ... and its limit
    turn: bool = True  # about up, by any angle, all clouds of an object alike where these stand in one frame
    crop: Share = 0.5  # least share of a view that is looked at; as released
    axis: Literal["z", "y"] = "z"  # of the turn; the release turns about y, which is up in some of its clouds only


@dataclasses.dataclass(frozen=True)
class SelectionModel(Config):
    """A selection model: architecture, queries, and which of the paper's parts and ours it has. Named in the model's id."""

    architecture: union_of(ARCHITECTURES) = dataclasses.field(default_factory=Small)  # type: ignore[valid-type]
    image: union_of((NoQuery, OwnImage, ClipQuery, SiglipQuery, Dinov2Query)) = dataclasses.field(default_factory=OwnImage)  # type: ignore[valid-type]
    text: union_of((NoQuery, OwnText, ClipQuery, SiglipQuery)) = dataclasses.field(default_factory=OwnText)  # type: ignore[valid-type]
    query_points: bool = True  # the scan's own points are the surest query; the paper lacks them
    query_evidence: bool = True  # what alignment measured of the candidate: numbers of its row
    residuals: bool = True  # distances point by point between the scan and the placed candidate
    extents: bool = True  # clouds are scaled to radius 1: sizes are told beside them
    quality: bool = True  # a head that judges the candidate itself
    relative: bool = True  # the head sees how a candidate differs from the others of its object
    frame: Literal["placed", "canonical"] = "placed"  # candidates as aligned to the scan; the paper takes them as they are
    image_normalization: Literal["encoder", "imagenet"] = "encoder"  # the release takes ImageNet's for every encoder
    temperature: Literal["learned", "fixed", "none"] = "learned"  # without, cosines cannot tell ten candidates apart (specs C.8)
    fixed_scale: Positive = 14.3  # 1 / 0.07
    decides: Literal["trained", "match"] = "trained"  # the release scores without the quality it was trained with
    residual_points: Points = 128  # of the scan, and as many of the candidate
    residual_widths: Annotated[tuple[Width, Width], LISTED] = (48, 96)  # layers of the network of single points
