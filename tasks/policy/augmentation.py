"""How pictures are changed in training: a walk's all alike, so that what changes between two steps is the agent's doing."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tasks.kernels import Kernels, compile_kernels
from tasks.settings import WHOLE, Config, Share

Pictures = NDArray[np.uint8]
Bits = Annotated[int, Field(ge=1, le=8), WHOLE]

LUMINANCE = np.array([0.299, 0.587, 0.114])
"""Shares of red, green and blue in what the eye calls bright (BT.601)."""

SPREAD = 4
"""The mean grey of pictures is that of every fourth pixel in every fourth row."""


@dataclasses.dataclass(frozen=True)
class PictureAugmentation(Config):
    """How far pictures are changed (specs E.1). What is not printed there is ours: how often blur, sharpening and posterizing come."""

    brightness: Share = 0.4  # factor of 1 less to 1 more of this; as published
    contrast: Share = 0.4  # as brightness
    saturation: Share = 0.2  # as brightness
    hue: Annotated[float, Field(ge=0, le=0.5)] = 0.05  # of a full turn, either way; as published
    crop: Annotated[float, Field(gt=0, le=1)] = 0.9  # least share of width and height that stays; as published
    blur_share: Share = 0.1  # of walks that are blurred; 64 pixels have little to lose
    sharpen_share: Share = 0.1  # of walks that are sharpened
    posterize_share: Share = 0.1  # of walks that are posterized
    posterize_bits: Bits = 5  # that stay of a color then; fewer hide what lies in shadow
    versions: Annotated[int, Field(ge=0, le=100), WHOLE] = 0  # of a walk; 0: anew in each look. Frozen eyes encode each once


@dataclasses.dataclass(frozen=True)
class PictureChange:
    """A way to change pictures. matrix, contrast: Colors become matrix @ color, and keep their distance from the mean grey by a factor.
    box: Top, left, height and width of what stays, as shares. sharpness: -1 blurs, 1 sharpens. bits: Of a color that stay."""

    matrix: NDArray[np.float64]
    contrast: float
    box: tuple[float, float, float, float]
    sharpness: float
    bits: int


def drawn(config: PictureAugmentation, rng: np.random.Generator) -> PictureChange:
    """A look, by chance. It draws the same number of times whatever the settings."""
    bright, contrast, saturation, hue, side, top, left, odd, bits = rng.uniform(-1, 1, 9)
    angle, keep = 2.0 * math.pi * config.hue * hue, 1.0 + config.saturation * saturation
    # hue is turned about grey, which stays grey
    axis = np.full((3, 3), 1 / 3)
    cross = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) / math.sqrt(3)
    turned = math.cos(angle) * (np.eye(3) - axis) + math.sin(angle) * cross + axis
    matrix = turned @ (keep * np.eye(3) + (1 - keep) * np.tile(LUMINANCE, (3, 1))) * (1 + config.brightness * bright)
    share = 1 - (1 - config.crop) * (side + 1) / 2
    box = ((1 - share) * (top + 1) / 2, (1 - share) * (left + 1) / 2, share, share)
    odd, bits = (odd + 1) / 2, (bits + 1) / 2
    sharpness = -1.0 if odd < config.blur_share else 1.0 if odd < config.blur_share + config.sharpen_share else 0.0
    return PictureChange(
        matrix, 1 + config.contrast * contrast, box, sharpness, config.posterize_bits if bits < config.posterize_share else 8
    )


def looked(pictures: Pictures, look: PictureChange) -> Pictures:
    """Pictures of a walk (n, h, w, c), all changed alike; what there is beside colors is cut out with them, and else stays."""
    if pictures.shape[-1] > 3:
        _, height, width, _ = pictures.shape
        top, left, tall, wide = look.box
        rows = ((top + (np.arange(height) + 0.5) / height * tall) * height).astype(np.int64)
        columns = ((left + (np.arange(width) + 0.5) / width * wide) * width).astype(np.int64)
        beside = pictures[:, rows[:, None], columns[None], 3:]
        return np.concatenate([looked(np.ascontiguousarray(pictures[..., :3]), look), beside], axis=-1)
    matrix = look.contrast * look.matrix
    grey = float(LUMINANCE @ (look.matrix @ pictures[:, ::SPREAD, ::SPREAD].mean(axis=(0, 1, 2)))) if len(pictures) else 0.0
    made = np.empty_like(pictures)
    mask = np.uint8((0xFF << (8 - look.bits)) & 0xFF)
    sharp = np.float32(look.sharpness)
    _compiled()["change"](
        np.ascontiguousarray(pictures), matrix.astype(np.float32), np.float32((1 - look.contrast) * grey),
        np.array(look.box, dtype=np.float64), mask, made,
    )  # fmt: skip
    if look.sharpness:
        blurred = np.empty_like(made)
        _compiled()["weigh"](made, sharp, blurred)
        return blurred
    return made


def change(pictures: Any, matrix: Any, offset: Any, box: Any, mask: Any, made: Any) -> None:
    """Part of pictures at full size, between pixels as these weigh, in other colors."""
    count, height, width, _ = pictures.shape
    for row in range(height):
        y = min(max((box[0] + (row + 0.5) / height * box[2]) * height - 0.5, 0.0), height - 1.0)
        top = min(int(y), max(height - 2, 0))
        below, v = min(top + 1, height - 1), np.float32(y - top)
        for column in range(width):
            x = min(max((box[1] + (column + 0.5) / width * box[3]) * width - 0.5, 0.0), width - 1.0)
            left = min(int(x), max(width - 2, 0))
            right, u = min(left + 1, width - 1), np.float32(x - left)
            a, b = (np.float32(1) - v) * (np.float32(1) - u), (np.float32(1) - v) * u
            c, d = v * (np.float32(1) - u), v * u
            for n in range(count):
                red = green = blue = np.float32(0)
                red = a * pictures[n, top, left, 0] + b * pictures[n, top, right, 0]
                red += c * pictures[n, below, left, 0] + d * pictures[n, below, right, 0]
                green = a * pictures[n, top, left, 1] + b * pictures[n, top, right, 1]
                green += c * pictures[n, below, left, 1] + d * pictures[n, below, right, 1]
                blue = a * pictures[n, top, left, 2] + b * pictures[n, top, right, 2]
                blue += c * pictures[n, below, left, 2] + d * pictures[n, below, right, 2]
                for channel in range(3):
                    value = matrix[channel, 0] * red + matrix[channel, 1] * green + matrix[channel, 2] * blue + offset
                    made[n, row, column, channel] = np.uint8(min(max(value + np.float32(0.5), np.float32(0)), np.float32(255))) & mask


def weigh(pictures: Any, sharpness: Any, made: Any) -> None:
    """Pictures, and how far each pixel is from the mean of the nine around it, added `sharpness` times."""
    count, height, width, _ = pictures.shape
    for n in range(count):
        for row in range(height):
            for column in range(width):
                for channel in range(3):
                    mean = np.float32(0)
                    for y in range(row - 1, row + 2):
                        for x in range(column - 1, column + 2):
                            mean += pictures[n, min(max(y, 0), height - 1), min(max(x, 0), width - 1), channel]
                    value = np.float32(pictures[n, row, column, channel])
                    value += sharpness * (value - mean / np.float32(9)) + np.float32(0.5)
                    made[n, row, column, channel] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))


@cache
def _compiled() -> Kernels:
    return compile_kernels(change, weigh)
