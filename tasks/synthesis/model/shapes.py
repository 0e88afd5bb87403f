"""Names and shapes of the weights of a synthesis model, without torch, and whether given ones are those of a config."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.synthesis.model.config import Atiss, ClipText, Diffusion, Transformer, Unet
from tasks.synthesis.model.encoding import BOUNDS, BOX, VOCABULARY, Encoding, encoding_in

Shape = tuple[int, ...]


def shapes_of(config: Diffusion | Atiss, encoding: Encoding) -> dict[str, Shape]:
    """Shapes by name, as the network's `state_dict` has them."""
    text, large, rooms = config.text.width, len(encoding.large), len(encoding.rooms)
    if isinstance(config.text, ClipText):
        shapes: dict[str, Shape] = {"text.table": (large, rooms, text)}
    else:
        shapes = {"text.large.weight": (large, text), "text.room.weight": (rooms, text)}
    classes = len(encoding.classes)
    return shapes | (_atiss(config, classes) if isinstance(config, Atiss) else _denoiser(config, classes))


def check_fit(arrays: Mapping[str, NDArray[Any]], config: Diffusion | Atiss, file: str) -> Encoding:
    """The encoding among a model's arrays, whose other arrays are those of the config.

    Raises:
        InputError: some are missing, too many or of another shape; or the encoding is none.
    """
    encoding = encoding_in(arrays, file)
    wanted = shapes_of(config, encoding)
    for name in sorted({*wanted, *arrays} - {VOCABULARY, BOUNDS}):
        if name not in arrays or name not in wanted or arrays[name].shape != wanted[name]:
            problem = "is missing" if name not in arrays else "is unknown" if name not in wanted else f"has the shape {arrays[name].shape}"
            raise InputError(
                file, name, f"{problem}; the model's config wants {wanted.get(name, 'none')}", "take weights and config of one model"
            )
    return encoding


def _atiss(config: Atiss, classes: int) -> dict[str, Shape]:
    width, part, numbers = config.width, config.embedding, 3 * config.mixtures
    shapes: dict[str, Shape] = {"query": (width,), "large_token": (width,)}
    shapes |= {"class_in.weight": (part, classes + 2), "class_told.weight": (part, classes + 2)}
    shapes |= _layer("start", width, config.text.width) | _layer("object_in", width, 8 * part) | _layer("class_out", classes + 2, width)
    shapes |= _transformer("encoder", width, config.feedforward, config.layers)
    for name, parts, count in (("translation", 1, 3), ("angle", 4, 1), ("size", 5, 3)):
        inside = width + parts * part
        for axis in range(count):
            shapes |= _layers(f"heads.{name}.{axis}", inside, 2 * inside, inside, numbers)
    return shapes


def _denoiser(config: Diffusion, classes: int) -> dict[str, Shape]:
    shape, text = config.architecture, config.text.width
    width = shape.width
    is_plain = isinstance(shape, Transformer)
    wide, inner = (width, (width,)) if is_plain else (4 * width, (width, 2 * width))
    shapes: dict[str, Shape] = {"null": (text,)}
    shapes |= _layers("step", width, wide, wide) | _layers("condition", text + BOX + classes + 1, wide, wide)
    box_width = BOX * (1 + shape.waves) if isinstance(shape, Transformer) else BOX
    for name, inside, outside in (("box", box_width, BOX), ("class", classes + 1, classes + 1)):
        shapes |= _layers(f"{name}_in", inside, *inner, width) | _layers(f"{name}_out", width, *inner[::-1], outside)
    if isinstance(shape, Transformer):
        norm = _layer("body.encoder.norm", width)
        return shapes | {"body.large": (width,)} | norm | _transformer("body.encoder", width, shape.feedforward, shape.layers)
    return shapes | {f"body.{name}": value for name, value in _unet(shape, config.slots, text).items()}


def _unet(shape: Unet, slots: int, text: int) -> dict[str, Shape]:
    width, wide, inner = shape.width, 4 * shape.width, shape.heads * shape.head_width
    shapes = (
        _block("middle_first", width, width, wide) | _block("middle_second", width, width, wide) | _block("last", 2 * width, width, wide)
    )
    shapes |= _attention("middle_attention", width, inner, width)
    if shape.instance_width:
        shapes |= {"instances": (slots, shape.instance_width)} | _block("middle_instance", width, width, shape.instance_width)
    if shape.crosses:
        shapes |= _attention("middle_text", width, inner, text) | _layer("middle_text.out_norm", width)
    for side, inside in (("down", width), ("up", 2 * width)):
        for level in range(shape.levels):
            name = f"{side}.{level}"
            shapes |= _block(f"{name}.first", inside, width, wide) | _block(f"{name}.second", inside, width, wide)
            shapes |= _attention(f"{name}.attention", width, inner, width) | _layer(f"{name}.attention.out_norm", width)
            shapes |= _layer(f"{name}.out", width, width)
            if shape.instance_width:
                shapes |= _block(f"{name}.instance", width, width, shape.instance_width)
            if shape.crosses:
                shapes |= _attention(f"{name}.text", width, inner, text) | _layer(f"{name}.text.out_norm", width)
    return shapes


def _block(name: str, inside: int, outside: int, condition: int) -> dict[str, Shape]:
    shapes = _layer(f"{name}.film", 2 * outside, condition) | _layer(f"{name}.first", outside, inside)
    shapes |= _layer(f"{name}.second", outside, outside) | _layer(f"{name}.first_norm", outside) | _layer(f"{name}.second_norm", outside)
    return shapes if inside == outside else shapes | _layer(f"{name}.shortcut", outside, inside)


def _attention(name: str, width: int, inner: int, tokens: int) -> dict[str, Shape]:
    own: dict[str, Shape] = {f"{name}.query.weight": (inner, width), f"{name}.key_value.weight": (2 * inner, tokens)}
    return own | _layer(f"{name}.norm", width) | _layer(f"{name}.out", width, inner)


def _transformer(name: str, width: int, feedforward: int, count: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    for layer in range(count):
        at = f"{name}.layers.{layer}"
        shapes |= {f"{at}.self_attn.in_proj_weight": (3 * width, width), f"{at}.self_attn.in_proj_bias": (3 * width,)}
        shapes |= _layer(f"{at}.self_attn.out_proj", width, width) | _layer(f"{at}.norm1", width) | _layer(f"{at}.norm2", width)
        shapes |= _layer(f"{at}.linear1", feedforward, width) | _layer(f"{at}.linear2", width, feedforward)
    return shapes


def _layers(name: str, *widths: int) -> dict[str, Shape]:
    """Linear layers with an activation after each but the last, which has a number, too."""
    shapes: dict[str, Shape] = {}
    for place, (inside, outside) in enumerate(itertools.pairwise(widths)):
        shapes |= _layer(f"{name}.{2 * place}", outside, inside)
    return shapes


def _layer(name: str, *shape: int) -> dict[str, Shape]:
    """Shapes of a layer's weight and bias."""
    return {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
