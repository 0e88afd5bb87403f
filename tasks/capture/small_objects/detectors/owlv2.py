"""OWLv2 (Minderer et al., 2023): boxes for phrases, each a text of its own (specs A.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tasks.capture.small_objects.detectors.detector import WHERE, Detections, OpenVocabulary, corners, joined_answers
from tasks.selection.methods import encoders
from tasks.settings import Share
from tasks.vision.devices import NetworkPlacement, looking, opened
from tasks.vision.pixels import Image, Pixels, normalized, smoothed_to


@dataclasses.dataclass(frozen=True)
class Owlv2(OpenVocabulary):
    """Boxes by OWLv2. Weights are Apache-2.0: google/owlv2-base-patch16-ensemble, owlv2-large-patch14-ensemble."""

    kind: ClassVar[str] = "owlv2"
    threshold: Share = 0.1  # of a box; the default of transformers and of the model's page
    prompt: str = "a photo of a {name}"  # what a name is asked for as; as on the model's page
    version: str = "1"  # goes up when the same weights would give other boxes


class Owlv2Detector:
    """OWLv2 out of a folder."""

    name = Owlv2.kind
    is_open = True
    draws_masks = False

    def __init__(self, network: Any, tokenizer: Any, placement: NetworkPlacement, settings: Owlv2) -> None:
        self.network, self.tokenizer, self.placement, self.settings = network, tokenizer, placement, settings

    def detect(self, pictures: Sequence[Image], names: Sequence[str]) -> list[Detections]:
        """What is in pictures, shapes (h, w, 3), of those names."""
        return joined_answers(pictures, names, self.settings, self._answers)

    def _answers(self, pictures: Sequence[Image], asked: list[str]) -> list[Detections]:
        """What is in pictures of one size of some phrases."""
        import torch

        longest = int(self.network.config.text_config.max_position_embeddings)
        texts = [self.settings.prompt.replace("{name}", phrase) for phrase in asked]
        tokens = self.tokenizer(texts, padding="max_length", truncation=True, max_length=longest, return_tensors="pt")
        side = int(self.network.config.vision_config.image_size)
        pixels = torch.from_numpy(np.stack([in_square(picture, side) for picture in pictures]))
        device = self.network.device
        with looking():
            out = self.network(
                input_ids=tokens["input_ids"].repeat(len(pictures), 1).to(device),
                attention_mask=tokens["attention_mask"].repeat(len(pictures), 1).to(device),
                pixel_values=pixels.to(device=device, dtype=self.network.dtype),
            )
            sure = out.logits.sigmoid().double().cpu().numpy()
            boxes = [corners(own) * max(pictures[0].shape[:2]) for own in out.pred_boxes]  # of the square, which is as wide as the picture
        return [self._named(own, of_phrases, asked) for own, of_phrases in zip(boxes, sure, strict=True)]

    def _named(self, boxes: Any, sure: Any, asked: list[str]) -> Detections:
        """Boxes of one picture, shape (n, 4), with the phrase that is surest of each. sure: Shape (n, phrases)."""
        scores, best = sure.max(axis=1), sure.argmax(axis=1)
        kept = np.flatnonzero(scores > self.settings.threshold)
        return Detections(boxes[kept], tuple(asked[best[i]] for i in kept), scores[kept])


def in_square(picture: Image, side: int) -> Pixels:
    """A picture in the upper left of a square, black beside it, as the network takes it, shape (3, side, side)."""
    height, width = picture.shape[:2]
    square = np.zeros((max(height, width), max(height, width), 3), dtype=np.float32)
    square[:height, :width] = picture.astype(np.float32) * np.float32(1 / 255)
    return normalized(smoothed_to(square, side), encoders.CLIP_MEAN, encoders.CLIP_STD)


def owlv2_in(settings: Owlv2) -> Owlv2Detector:
    """OWLv2 out of the folder that settings name.

    Raises:
        InputError: it is not there, or holds none, or no tokenizer.
    """

    def tokenizer_in(folder: Path) -> Any:
        from transformers import CLIPTokenizer

        return CLIPTokenizer.from_pretrained(str(folder), local_files_only=True)

    network, tokenizer, placement = opened(settings, "Owlv2ForObjectDetection", WHERE, tokenizer_in)
    return Owlv2Detector(network, tokenizer, placement, settings)
