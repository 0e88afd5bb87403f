"""Captions: what an object looks like, what it is made of, how it behaves.

The classical provider names colors and materials from the instance's points and takes physical attributes from a sourced category
table. The other one asks a vision-language model (supplementary A.1, Tables A1 and A2), and says where the classical one had to stand in.
"""

from __future__ import annotations

import dataclasses

from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from tasks.captions.classical import ClassicalCaptions, described
from tasks.captions.colors import ColorNames
from tasks.captions.vision_language import VisionLanguageCaptions, captioned, check
from tasks.settings import Config, union_of
from tasks.stage import Context, Outcome, Stage

CaptionProvider = union_of((ClassicalCaptions, VisionLanguageCaptions))
"""Whoever can make captions."""


@dataclasses.dataclass(frozen=True)
class CaptionsConfig(Config):
    """Who words captions."""

    provider: CaptionProvider = dataclasses.field(default_factory=ClassicalCaptions)  # type: ignore[valid-type]  # runs anywhere


def run(*, instances: list[Instance], frames: list[Frame], masks: list[Mask], context: Context, config: CaptionsConfig) -> Outcome:
    """A caption of every instance that is no structure."""
    captions: list[Caption] = []
    doubts: dict[tuple[str, str], list[str]] = {}
    if isinstance(config.provider, VisionLanguageCaptions):
        check(config.provider)
    known_frames = {frame.frame_id: frame for frame in frames}
    known_masks = {(mask.instance_id, mask.frame_id): mask for mask in masks}
    objects = sorted((row for row in instances if not row.is_structure), key=lambda row: row.instance_id)
    for done, instance in enumerate(objects):
        if isinstance(config.provider, VisionLanguageCaptions):
            best = instance.best_frames[0] if instance.best_frames else ""
            frame, mask = known_frames.get(best), known_masks.get((instance.instance_id, best))
            caption, problems = captioned(instance, frame, mask, context, config.provider)
            context.report(done + 1, len(objects), instance.instance_id)
        else:
            caption, *parts = described(instance, context, config.provider)
            problems = [problem for part in parts for problem in part]
        captions.append(caption)
        for problem in problems:
            doubts.setdefault((instance.category, problem), []).append(instance.instance_id)
    return Outcome(captions=captions, degradations=[_doubt(*about, whose) for about, whose in doubts.items()])


def _doubt(category: str, problem: str, whose: list[str]) -> str:
    """What could not be told well of some objects of a category, in a line."""
    more = f" and {len(whose) - 1} more" if len(whose) > 1 else ""
    return f"{whose[0]}{more} {category}: {problem}"


STAGE = Stage(name="captions", reads=("instances", "frames", "masks"), writes=("captions",), config=CaptionsConfig, run=run)

__all__ = ["STAGE", "CaptionProvider", "CaptionsConfig", "ClassicalCaptions", "ColorNames", "VisionLanguageCaptions", "run"]
