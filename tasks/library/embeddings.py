"""Vectors of pictures and texts of models, by CLIP or SigLIP out of a folder that transformers wrote."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.selection.methods.encoders import BATCH, Images, Vectors, check_installed, clip_in, weights_digest

MEAN, DEVIATION = 0.5, 0.5
"""Of the pictures that SigLIP was trained on, every channel, as published."""

LONGEST = 64
"""Tokens that SigLIP's texts are filled up to, as in its training."""


class PictureEncoder(Protocol):
    """Vectors of length 1 for pictures and texts, whose products say how well they go together. side: Pixels of a picture."""

    side: int

    def images(self, pictures: Images) -> Vectors:
        """Vectors of pictures, shape (n, side, side, 3) to (n, d)."""

    def texts(self, texts: Sequence[str]) -> Vectors:
        """Vectors of texts, shape (n, d)."""


class SiglipEncoder:
    """SigLIP, and SigLIP 2 of fixed resolution: as CLIP, by a sigmoid loss."""

    def __init__(self, folder: Path) -> None:
        check_installed()
        from transformers import AutoTokenizer, SiglipModel

        options: dict[str, Any] = {"local_files_only": True}
        kind: Any = SiglipModel
        try:
            model, loaded = kind.from_pretrained(str(folder), use_safetensors=True, output_loading_info=True, **options)
            self._tokenizer: Any = AutoTokenizer.from_pretrained(str(folder), **options)
        except Exception as error:  # the readers of weights and tokenizers raise classes of their own
            problem = f"holds no SiglipModel with its tokenizer: {' '.join(str(error).split())[:200]}"
            raise InputError(str(folder), "", problem, "name a folder that both were saved to") from error
        if loaded["missing_keys"]:
            gone = sorted(loaded["missing_keys"])
            raise InputError(str(folder), gone[0], f"is missing, with {len(gone) - 1} more weights", "save the whole model")
        self._model: Any = model.float().eval()
        self.side = int(model.config.vision_config.image_size)

    def images(self, pictures: Images) -> Vectors:
        """Vectors of pictures, shape (n, side, side, 3) to (n, d)."""
        import torch

        vectors = []
        for start in range(0, len(pictures), BATCH):
            values = (pictures[start : start + BATCH].astype(np.float32) / 255.0 - MEAN) / DEVIATION
            pixels = torch.from_numpy(np.ascontiguousarray(values.transpose(0, 3, 1, 2)))
            vectors.append(self._pooled(self._model.vision_model, pixel_values=pixels))
        return np.concatenate(vectors)

    def texts(self, texts: Sequence[str]) -> Vectors:
        """Vectors of texts, shape (n, d); what is longer than the model reads is cut."""
        length = min(LONGEST, int(self._model.config.text_config.max_position_embeddings))
        tokens = self._tokenizer(list(texts), padding="max_length", truncation=True, max_length=length, return_tensors="pt")
        return self._pooled(self._model.text_model, input_ids=tokens["input_ids"])

    def _pooled(self, tower: Any, **inputs: Any) -> Vectors:
        """Vectors of length 1 of one half of the model, computed on one thread: the same on every worker."""
        import torch

        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with torch.no_grad():
                values = tower(**inputs).pooler_output.numpy().astype(np.float32)
        finally:
            torch.set_num_threads(threads)
        return np.asarray(values / np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), 1e-9), dtype=np.float32)


def encoder_in(folder: str) -> PictureEncoder:
    """The encoder of a folder, opened once in a process.

    Raises:
        InputError: none is named, it is not there, of another kind, not as safetensors, or packages are not installed.
    """
    digest = weights_digest(folder)
    name = _architecture(folder)
    openers: dict[str, Callable[[], PictureEncoder]] = {
        "CLIPModel": lambda: clip_in(folder),
        "SiglipModel": lambda: _siglip(folder, digest),
    }
    if name not in openers:
        raise InputError(folder, "architectures", f"is {name or 'not stated'}", f"name a folder of {' or '.join(openers)}")
    return openers[name]()


def _architecture(folder: str) -> str:
    """The class of the model in a folder, as its config names it first."""
    try:
        config = json_value(read_file(Path(folder) / "config.json", "config.json", BUDGET.text_bytes))
    except ValueError as error:
        raise InputError(folder, "config.json", f"is no JSON ({error})", "name a folder that transformers wrote") from error
    names = config.get("architectures") if isinstance(config, dict) else None
    return str(names[0]) if isinstance(names, list) and names else ""


@lru_cache(maxsize=2)
def _siglip(folder: str, digest: str) -> SiglipEncoder:
    return SiglipEncoder(Path(folder))
