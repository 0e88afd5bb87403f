"""What CLIP makes of "A desk in the office": a vector for every large object and room of a vocabulary, kept with a model's weights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.synthesis.layout import UNKNOWN_ROOM
from tasks.synthesis.model.config import ClipText
from tasks.synthesis.model.encoding import Encoding


def sentence(large: str, room: str) -> str:
    """What is said of a micro-scene."""
    return f"A {large.replace('_', ' ')} in the {'room' if room == UNKNOWN_ROOM else room}"


def clip_table(config: ClipText, encoding: Encoding) -> NDArray[np.float32]:
    """Vectors by large object and room, shape (l, r, w), whose numbers have variance 1 on average.

    Raises:
        InputError: the folder holds no CLIP, one of another width, or packages are not installed.
    """
    from tasks.selection.methods.encoders import clip_in

    texts = [sentence(large, room) for large in encoding.large for room in encoding.rooms]
    vectors = clip_in(config.weights).texts(texts)
    if vectors.shape[1] != config.width:
        raise InputError("model", "text", f"is {config.width} wide, but its CLIP {vectors.shape[1]}", f"set width={vectors.shape[1]}")
    return (vectors * np.sqrt(config.width)).reshape(len(encoding.large), len(encoding.rooms), -1).astype(np.float32)


def begin_with_clip(module: Any, config: ClipText, encoding: Encoding) -> None:
    """Give a network the vectors of a CLIP. Raises `InputError` as `clip_table`."""
    import torch

    module.text.table.copy_(torch.from_numpy(clip_table(config, encoding)))
