"""Grounding DINO (Liu et al., 2023): boxes for phrases, all of them in one text (specs A.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tasks.capture.small_objects.detectors.detector import WHERE, Detections, OpenVocabulary, corners, joined_answers, together, too_long
from tasks.settings import Count, Share
from tasks.vision.devices import NetworkPlacement, looking, opened
from tasks.vision.pixels import IMAGENET_MEAN, IMAGENET_STD, Image, fitted_size, normalized, shrunk_to


@dataclasses.dataclass(frozen=True)
class GroundingDino(OpenVocabulary):
    """Boxes by Grounding DINO. Weights are Apache-2.0: IDEA-Research/grounding-dino-tiny, -base."""

    kind: ClassVar[str] = "grounding_dino"
    threshold: Share = 0.25  # of the surest token of a box; the default of transformers, the authors' demo takes 0.35
    text_threshold: Share = 0.25  # of the surest token of its phrase; as published
    shortest_px: Count = 800  # sides that pictures are brought to; as published
    longest_px: Count = 1333  # of the picture's longer side, as published
    version: str = "1"  # goes up when the same weights would give other boxes


class GroundingDinoDetector:
    """Grounding DINO out of a folder."""

    name = GroundingDino.kind
    is_open = True
    draws_masks = False

    def __init__(self, network: Any, tokenizer: Any, placement: NetworkPlacement, settings: GroundingDino) -> None:
        self.network, self.tokenizer, self.placement, self.settings = network, tokenizer, placement, settings

    def detect(self, pictures: Sequence[Image], names: Sequence[str]) -> list[Detections]:
        """What is in pictures, shapes (h, w, 3), of those names."""
        return joined_answers(pictures, names, self.settings, self._answers)

    def _answers(self, pictures: Sequence[Image], asked: list[str]) -> list[Detections]:
        """What is in pictures of one size of some phrases."""
        import torch

        height, width = pictures[0].shape[:2]
        size = fitted_size(height, width, self.settings.shortest_px, self.settings.longest_px)
        pixels = np.stack([normalized(shrunk_to(picture, *size), IMAGENET_MEAN, IMAGENET_STD) for picture in pictures])
        text, spans = written(asked)
        tokens = self.tokenizer(text, return_offsets_mapping=True, return_token_type_ids=True, return_tensors="pt")
        where = tokens.pop("offset_mapping")[0].numpy()
        places = [np.flatnonzero((where[:, 0] < last) & (first < where[:, 1])) for first, last in spans]
        count = tokens["input_ids"].shape[1]
        if count > self.network.config.max_text_len:
            if len(asked) == 1:
                raise too_long("names_per_call", text, self.network.config.max_text_len)
            half = len(asked) // 2  # long names, which a model may list: fewer at a time
            both = (self._answers(pictures, asked[:half]), self._answers(pictures, asked[half:]))
            return [together(answers) for answers in zip(*both, strict=True)]
        device = self.network.device
        with looking():
            out = self.network(
                pixel_values=torch.from_numpy(pixels).to(device=device, dtype=self.network.dtype),
                **{name: values.expand(len(pictures), -1).to(device) for name, values in tokens.items()},
            )
            sure = out.logits.sigmoid().double().cpu().numpy()[..., :count]
            boxes = [corners(own) * [width, height, width, height] for own in out.pred_boxes]
        return [self._named(own, of_tokens, asked, places) for own, of_tokens in zip(boxes, sure, strict=True)]

    def _named(self, boxes: Any, sure: Any, asked: list[str], places: list[Any]) -> Detections:
        """Boxes of one picture with the phrase that each is of: the one whose tokens are surest on average.

        boxes: x0, y0, x1, y1 [px], shape (n, 4). sure: How sure each token of the text is of each box, shape (n, t). places: Tokens of
        each phrase.
        """
        average = np.stack([sure[:, own].mean(axis=1) if len(own) else np.zeros(len(sure)) for own in places], axis=1)
        best = average.argmax(axis=1)
        surest = np.stack([sure[:, own].max(axis=1) if len(own) else np.zeros(len(sure)) for own in places], axis=1)
        scores = sure.max(axis=1)
        own = surest[np.arange(len(best)), best]
        kept = np.flatnonzero((scores > self.settings.threshold) & (own > self.settings.text_threshold))
        return Detections(boxes[kept], tuple(asked[best[i]] for i in kept), scores[kept])


def written(asked: Sequence[str]) -> tuple[str, list[tuple[int, int]]]:
    """Phrases as the one text that the network reads, with a period after each, and where in it each one is."""
    spans, start = [], 0
    for phrase in asked:
        spans.append((start, start + len(phrase)))
        start += len(phrase) + 2
    return " ".join(f"{phrase}." for phrase in asked), spans


def grounding_dino_in(settings: GroundingDino) -> GroundingDinoDetector:
    """Grounding DINO out of the folder that settings name.

    Raises:
        InputError: it is not there, or holds none, or no tokenizer that says where its tokens are.
    """

    def tokenizer_in(folder: Path) -> Any:
        from transformers import AutoTokenizer

        tokenizer: Any = AutoTokenizer.from_pretrained(str(folder), local_files_only=True, trust_remote_code=False)
        if not tokenizer.is_fast:
            raise ValueError("tokenizer.json is not there")
        return tokenizer

    network, tokenizer, placement = opened(settings, "GroundingDinoForObjectDetection", WHERE, tokenizer_in)
    return GroundingDinoDetector(network, tokenizer, placement, settings)
