"""SigLIP, frozen, from folders that transformers wrote: tokens of pictures for a policy's eyes, states of instructions for its goals.

Tokens of a picture are kept by its content, so that none is encoded twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import MutableMapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.policy.model.config import PolicyModel, SiglipEyes, SiglipGoal
from tasks.policy.model.shapes import Vocabulary
from tasks.selection.methods import encoders
from tasks.selection.methods.encoders import remembered, weights_digest
from tasks.selection.model.frozen import HALVES

Tokens = NDArray[np.float32]

INSTRUCTION = "Navigate to the {}"
"""Of a category, as episodes say it."""


class VisionTokens:
    """SigLIP's vision tower: a token for every patch of a picture."""

    def __init__(self, folder: Path) -> None:
        encoders.check_installed()
        from transformers import SiglipVisionModel

        with encoders._opening(folder, "SiglipVisionModel"):
            self._model: Any = encoders._model_in(SiglipVisionModel, folder)
        self.side = int(self._model.config.image_size)
        self.width = int(self._model.config.hidden_size)

    def tokens(self, pictures: NDArray[np.uint8], grid: tuple[int, int]) -> Tokens:
        """Tokens of pictures (n, h, w, 3), pooled to rows and columns, shape (n, rows * columns, e)."""
        import torch

        made = []
        with torch.no_grad(), encoders._one_thread():
            for pixels in encoders._batches(resized(pictures, self.side), HALVES, HALVES):
                states = self._model(pixel_values=pixels).last_hidden_state
                patches = round(states.shape[1] ** 0.5)
                plane = states.transpose(1, 2).reshape(len(states), self.width, patches, patches)
                made.append(torch.nn.functional.adaptive_avg_pool2d(plane, grid).flatten(2).transpose(1, 2).numpy())
        return np.concatenate(made)


class TextStates:
    """SigLIP's text tower: a state for every place of a text, and the pooled one."""

    def __init__(self, folder: Path) -> None:
        encoders.check_installed()
        from transformers import AutoTokenizer, SiglipTextModel

        with encoders._opening(folder, "SiglipTextModel"):
            self._model: Any = encoders._model_in(SiglipTextModel, folder)
            self._tokenizer: Any = AutoTokenizer.from_pretrained(str(folder), local_files_only=True, trust_remote_code=False)

    def states(self, text: str) -> Tokens:
        """States of a text and the pooled one, shape (t + 1, e)."""
        import torch

        longest = int(self._model.config.max_position_embeddings)
        with torch.no_grad(), encoders._one_thread():
            read = self._tokenizer([text], padding="max_length", truncation=True, max_length=longest, return_tensors="pt")
            made = self._model(input_ids=read["input_ids"])
            return np.concatenate([made.last_hidden_state[0].numpy(), made.pooler_output.numpy()])


def resized(pictures: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Pictures (n, h, w, 3) as squares (n, side, side, 3), bicubic, whatever their shape was; as published."""
    if pictures.shape[1:3] == (side, side):
        return pictures
    from PIL import Image

    return np.stack([np.asarray(Image.fromarray(picture).resize((side, side), Image.Resampling.BICUBIC)) for picture in pictures])


@lru_cache(maxsize=2)
def _vision(folder: str, digest: str) -> VisionTokens:
    return VisionTokens(Path(folder))


@lru_cache(maxsize=2)
def _text(folder: str, digest: str) -> TextStates:
    return TextStates(Path(folder))


def vision_in(eyes: SiglipEyes) -> VisionTokens:
    """The vision tower that eyes name, opened once in a process.

    Raises:
        InputError: no folder is named, it holds no such model as safetensors, its tokens have another width, or packages are not installed.
    """
    vision = _vision(eyes.weights, weights_digest(eyes.weights))
    if vision.width != eyes.width:
        raise InputError(eyes.weights, "eyes.width", f"tokens have {vision.width} numbers, the config says {eyes.width}", "set it to that")
    return vision


def tokens_of(pictures: NDArray[np.uint8], eyes: SiglipEyes, memory: MutableMapping[str, bytes]) -> NDArray[np.float16]:
    """Tokens of pictures (n, h, w, 3) in half precision, shape (n, p, e): each out of the memory, or made and put there.

    Raises:
        InputError: as `vision_in`.
    """
    digest = weights_digest(eyes.weights)
    grid = (eyes.grid[0], eyes.grid[1])
    made = np.empty((len(pictures), grid[0] * grid[1], eyes.width), dtype=np.float16)
    for place, picture in enumerate(pictures):
        of_picture = hashlib.sha256(np.ascontiguousarray(picture).tobytes()).hexdigest()
        key = hashlib.sha256(f"eyes {digest} {grid} {picture.shape} {of_picture}".encode()).hexdigest()
        made[place] = remembered(memory, key, lambda p=picture: vision_in(eyes).tokens(p[None], grid)[0], half=True)  # type: ignore[misc]
    return made


def states_of(vocabulary: Vocabulary, goal: SiglipGoal) -> Tokens:
    """States of the instructions of all categories, shape (goals, t, e); of the unknown one zeros.

    Raises:
        InputError: no folder is named, it holds no such model, its states have another shape, or packages are not installed.
    """
    text = _text(goal.weights, weights_digest(goal.weights))
    made = np.zeros((len(vocabulary), goal.tokens, goal.width), dtype=np.float32)
    for place, category in enumerate(vocabulary[1:], 1):
        states = text.states(INSTRUCTION.format(category))
        if states.shape != made.shape[1:]:
            problem = f"states have the shape {states.shape}, the config says {made.shape[1:]}"
            raise InputError(goal.weights, "goal", problem, "set goal.tokens and goal.width to that")
        made[place] = states
    return made


def begin_with_states(module: Any, vocabulary: Vocabulary, goal: SiglipGoal, known: Sequence[str] = ()) -> None:
    """Give a network the states of the goals that it can be sent to, but for those `known`, which it has."""
    import torch

    made = torch.from_numpy(states_of(vocabulary, goal))
    for place, category in enumerate(vocabulary):
        if category not in known:
            module.goal.states[place] = made[place]


def is_frozen(model: PolicyModel) -> bool:
    """Whether a policy sees by frozen eyes."""
    return not model.blind and isinstance(model.eyes, SiglipEyes)
