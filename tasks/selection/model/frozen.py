"""Frozen encoders of image and text, from folders that transformers wrote: their vectors in the place of own encoders'."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import MutableMapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.selection.methods import encoders
from tasks.selection.methods.encoders import CLIP_MEAN, CLIP_STD, IMAGENET_MEAN, IMAGENET_STD, dino_in, remembered, weights_digest
from tasks.selection.model.clouds import Array
from tasks.selection.model.config import ClipQuery, Dinov2Query, SelectionModel, SiglipQuery
from tasks.selection.model.features import Scanned
from tasks.views.crops import squared

Pair = ClipQuery | SiglipQuery
Frozen = Pair | Dinov2Query

HALVES = (0.5, 0.5, 0.5)
"""Mean and deviation of the pictures that SigLIP was trained on, as published."""

TEMPLATE = "A photo of a {}."
"""Of a category without a caption, as released."""


class PairEncoder:
    """CLIP or SigLIP: vectors of length 1 for pictures and texts, in one space."""

    def __init__(self, kind: str, folder: Path) -> None:
        encoders.check_installed()
        import transformers

        name = "CLIPModel" if kind == "clip" else "SiglipModel"
        with encoders._opening(folder, name):
            self._model: Any = encoders._model_in(getattr(transformers, name), folder)
            self._tokenizer: Any = transformers.AutoTokenizer.from_pretrained(str(folder), local_files_only=True, trust_remote_code=False)
        self.is_clip = kind == "clip"
        self.side = int(self._model.config.vision_config.image_size)
        self.width = int(self._model.config.projection_dim if self.is_clip else self._model.config.text_config.projection_size)

    def image(self, picture: NDArray[np.uint8], imagenet: bool) -> Array:
        """The vector of a picture, shape (h, w, 3) to (e,). imagenet: normalized as for ImageNet, as the release does for CLIP."""
        import torch

        own = (CLIP_MEAN, CLIP_STD) if self.is_clip else (HALVES, HALVES)
        mean, std = (IMAGENET_MEAN, IMAGENET_STD) if imagenet else own
        (pixels,) = encoders._batches(squared(picture, self.side)[None], mean, std)
        with torch.no_grad(), encoders._one_thread():
            pooled = self._model.vision_model(pixel_values=pixels).pooler_output
            return encoders._unit((self._model.visual_projection(pooled) if self.is_clip else pooled).numpy())[0]

    def text(self, text: str) -> Array:
        """The vector of a text, shape (e,); what is longer than the model reads is cut."""
        import torch

        longest = int(self._model.config.text_config.max_position_embeddings)
        fill = True if self.is_clip else "max_length"  # SigLIP was trained on texts of one length
        with torch.no_grad(), encoders._one_thread():
            tokens = self._tokenizer([text], padding=fill, truncation=True, max_length=longest, return_tensors="pt")
            mask = tokens.get("attention_mask") if self.is_clip else None
            pooled = self._model.text_model(input_ids=tokens["input_ids"], attention_mask=mask).pooler_output
            return encoders._unit((self._model.text_projection(pooled) if self.is_clip else pooled).numpy())[0]


def pair_in(query: Pair) -> PairEncoder:
    """The encoder that a query names, opened once in a process.

    Raises:
        InputError: no folder is named, it is not there, or holds no such model as safetensors, or packages are not installed.
    """
    return _pair(query.kind, query.weights, weights_digest(query.weights))


@lru_cache(maxsize=2)
def _pair(kind: str, folder: str, digest: str) -> PairEncoder:
    return PairEncoder(kind, Path(folder))


def image_vector(query: Frozen, image: NDArray[np.uint8], imagenet: bool) -> Array:
    """The vector of a crop, shape (e,), of length 1; of DINOv2 the mean of its patches."""
    if not isinstance(query, Dinov2Query):
        return pair_in(query).image(image, imagenet)
    dino = dino_in(query.weights)
    return encoders._unit(dino.patches(squared(image, dino.side)[None])[0].mean(axis=0))


def is_frozen(query: object) -> bool:
    """Whether an encoder is a frozen one."""
    return isinstance(query, Frozen)


def seen_by_frozen(scanned: Scanned, config: SelectionModel, memory: MutableMapping[str, bytes]) -> Scanned:
    """An instance with the vectors of the frozen encoders that a config names; of a missing image zeros.

    Raises:
        InputError: a folder holds no such encoder.
    """
    image_of, text_of = scanned.image_vector, scanned.text_vector
    if isinstance(config.image, Frozen) and scanned.image is not None:
        query, image, imagenet = config.image, scanned.image, config.image_normalization == "imagenet"
        key = f"image {query.kind} {weights_digest(query.weights)} {imagenet} {hashlib.sha256(image.tobytes()).hexdigest()} {image.shape}"
        image_of = remembered(memory, key, lambda: image_vector(query, image, imagenet))
    elif isinstance(config.image, Frozen):
        image_of = np.zeros(width_of(config.image), dtype=np.float32)
    if isinstance(config.text, Pair):
        text, words = config.text, scanned.caption or TEMPLATE.format(scanned.category)
        key = f"text {text.kind} {weights_digest(text.weights)} {words}"
        text_of = remembered(memory, key, lambda: pair_in(text).text(words))
    return dataclasses.replace(scanned, image_vector=image_of, text_vector=text_of)


def widths_of(config: SelectionModel) -> tuple[int, int]:
    """Lengths of the vectors of frozen encoders of image and text, 0 where there is none."""
    image = width_of(config.image) if isinstance(config.image, Frozen) else 0
    return image, width_of(config.text) if isinstance(config.text, Frozen) else 0


def width_of(query: Frozen) -> int:
    """Length of an encoder's vectors."""
    if isinstance(query, Dinov2Query):
        return len(image_vector(query, np.zeros((8, 8, 3), dtype=np.uint8), False))
    return pair_in(query).width
