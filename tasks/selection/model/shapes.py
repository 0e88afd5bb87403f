"""Names and shapes of the weights of a model that is scored without torch, and whether given ones are those of a config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.selection.model.config import OwnImage, OwnText, Patches, SelectionModel
from tasks.selection.model.features import EVIDENCE, RESIDUAL, SUMMED

Shape = tuple[int, ...]


def shapes_of(config: SelectionModel) -> dict[str, Shape]:
    """Shapes by name, as `Selector.state_dict` has them."""
    architecture: Patches = config.architecture
    embedding, dim = architecture.embedding, architecture.dim
    shapes: dict[str, Shape] = {"logit_scale": (), "pc_projection": (2 * dim, embedding)} | _encoder(architecture)
    if isinstance(config.image, OwnImage):
        for layer, (inside, outside) in enumerate(zip((3, *config.image.widths), config.image.widths, strict=False)):
            shapes |= _layer(f"image_encoder.convolutions.{layer}", outside, inside, 3, 3)
        shapes |= _layer("image_encoder.projection", embedding, 2 * config.image.widths[-1])
    if isinstance(config.text, OwnText):
        shapes["text_encoder.table.weight"] = (config.text.buckets + 1, config.text.width)
        shapes |= _layer("text_encoder.projection", embedding, config.text.width)
    if config.extents:
        shapes |= _layer("size_embedding", embedding, 3)
    if config.quality:
        shapes |= _quality(config)
    return shapes


def check_shapes(arrays: Mapping[str, NDArray[Any]], wanted: Mapping[str, Shape], file: str) -> None:
    """Hold names and shapes of weights against those of a config.

    Raises:
        InputError: some are missing, too many or of another shape.
    """
    for name in sorted({*wanted, *arrays}):
        if name not in arrays or name not in wanted or arrays[name].shape != wanted[name]:
            problem = "is missing" if name not in arrays else "is unknown" if name not in wanted else f"has the shape {arrays[name].shape}"
            raise InputError(
                file, name, f"{problem}; the model's config wants {wanted.get(name, 'none')}", "take weights and config of one model"
            )


def _quality(config: SelectionModel) -> dict[str, Shape]:
    """Shapes of the head that judges candidates."""
    architecture: Patches = config.architecture
    shapes: dict[str, Shape] = {}
    inside = 2 * architecture.dim + 3 * config.extents + 2 * len(EVIDENCE) * config.query_evidence
    if config.residuals:
        first, second = config.residual_widths
        shapes |= _layer("residual_encoder.layers.0", first, RESIDUAL) | _layer("residual_encoder.layers.1", second, first)
        inside += 2 * second + 2 * SUMMED
    inside = (inside + architecture.embedding * config.query_points) * (2 if config.relative else 1)
    shapes["quality.3.weight"] = (1, architecture.head_width)
    return shapes | _layer("quality.0", architecture.head_width, inside)


def _encoder(architecture: Patches) -> dict[str, Shape]:
    """Shapes of the encoder of points."""
    dim, first, second, width = architecture.dim, architecture.first_widths, architecture.second_widths, architecture.position_width
    shapes = _layer("encoder.first_conv.0", first[0], 6, 1) | _layer("encoder.first_conv.3", first[1], first[0], 1)
    shapes |= _layer("encoder.second_conv.0", second[0], 2 * first[1], 1) | _layer("encoder.second_conv.3", second[1], second[0], 1)
    for name, size in (("encoder.first_conv.1", first[0]), ("encoder.second_conv.1", second[0])):
        shapes |= _layer(name, size) | {f"{name}.running_mean": (size,), f"{name}.running_var": (size,), f"{name}.num_batches_tracked": ()}
    shapes |= _layer("reduce_dim", dim, second[1]) | _layer("pos_embed.0", width, 3) | _layer("pos_embed.2", dim, width)
    shapes |= {"cls_token": (1, 1, dim), "cls_pos": (1, 1, dim)} | _layer("norm", dim)
    for block in range(architecture.depth):
        name = f"blocks.blocks.{block}"
        shapes |= {f"{name}.attn.qkv.weight": (3 * dim, dim)} | _layer(f"{name}.attn.proj", dim, dim)
        shapes |= _layer(f"{name}.norm1", dim) | _layer(f"{name}.norm2", dim)
        shapes |= _layer(f"{name}.mlp.fc1", 4 * dim, dim) | _layer(f"{name}.mlp.fc2", dim, 4 * dim)
    return {f"point_encoder.{name}": shape for name, shape in shapes.items()}


def _layer(name: str, *shape: int) -> dict[str, Shape]:
    """Shapes of a layer's weight and bias."""
    return {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
