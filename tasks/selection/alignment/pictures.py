"""Pictures compared by the patches of DINOv2 (Oquab et al., 2023), whose weights lie in a folder that somebody names."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.geometry.meshes import Surface
from tasks.selection.alignment.snapshots import surface_snapshot

if TYPE_CHECKING:
    from tasks.selection.alignment.acdc import Acdc

MEAN = np.array([0.485, 0.456, 0.406], dtype=np.float32)
"""Of the red, green and blue that DINOv2 was trained with, in 0..1."""

SPREAD = np.array([0.229, 0.224, 0.225], dtype=np.float32)
"""Their standard deviations."""

BATCH = 20
"""Pictures at once: 100 of them would take a gigabyte in a large model."""


def picture_distances(picture: NDArray[np.uint8], surface: Surface, elevation: float, config: Acdc) -> NDArray[np.float64]:
    """How far the snapshots of a surface are from a square picture on white, shape (h, h, 3), by the cosines of their patches in
    the same place: shape (snapshots,).

    Raises:
        InputError: the folder holds no weights of DINOv2.
    """
    model = loaded(config.dinov2)
    patch = int(model.config.patch_size)
    side = max(config.picture_pixels // patch, 1) * patch
    wanted = patches(model, [resized(picture, side)])[0]
    azimuths = [2 * np.pi * i / config.snapshots for i in range(config.snapshots)]
    drawn = [surface_snapshot(surface, azimuth, elevation, side).color for azimuth in azimuths]
    shown = np.concatenate([patches(model, drawn[i : i + BATCH]) for i in range(0, len(drawn), BATCH)])
    return np.asarray(1.0 - np.einsum("npd,pd->np", shown, wanted).mean(axis=1), dtype=np.float64)


def patches(model: Any, pictures: list[NDArray[np.uint8]]) -> NDArray[np.float32]:
    """Unit features of the patches of pictures of one size, without the token of the whole: shape (n, patches, channels)."""
    import torch

    values = (np.stack(pictures).astype(np.float32) / 255.0 - MEAN) / SPREAD
    with torch.inference_mode():
        tokens = model(pixel_values=torch.from_numpy(np.ascontiguousarray(values.transpose(0, 3, 1, 2)))).last_hidden_state
    features = tokens[:, 1:].numpy()
    return features / np.maximum(np.linalg.norm(features, axis=2, keepdims=True), 1e-12)


def resized(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """A picture as a square of so many pixels, shape (side, side, 3), its longer side filling it, white beside it."""
    import PIL.Image

    height, width = picture.shape[:2]
    wide, high = (max(1, round(side * length / max(height, width))) for length in (width, height))
    part = np.asarray(PIL.Image.fromarray(np.ascontiguousarray(picture)).resize((wide, high), PIL.Image.Resampling.BICUBIC))
    square = np.full((side, side, 3), 255, dtype=np.uint8)
    top, left = (side - high) // 2, (side - wide) // 2
    square[top : top + high, left : left + wide] = part
    return square


@lru_cache(maxsize=1)
def loaded(folder: str) -> Any:
    """The model in a folder, from safetensors alone: nothing in it can run.

    Raises:
        InputError: there is none.
    """
    for file in ("config.json", "model.safetensors"):
        if not Path(folder, file).is_file():
            raise InputError(folder, file, "is not there", "name a folder of DINOv2 in transformers' format, with safetensors")
    try:
        from transformers import Dinov2Model

        model = Dinov2Model.from_pretrained(folder, local_files_only=True, use_safetensors=True)
    except ImportError as error:
        raise InputError(folder, "", "wants the packages torch and transformers", "install them, or leave dinov2 empty") from error
    except Exception as error:  # whatever the files lead the loader to
        raise InputError(folder, "model.safetensors", f"is no DINOv2: {error}"[:300], "name a folder of DINOv2") from error
    return model.eval()
