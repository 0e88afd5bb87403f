"""Scores of small models without torch: the network of `networks.selector` in evaluation, in NumPy."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from schemas.errors import InputError
from tasks.selection.model.clouds import Array, ColoredCloud
from tasks.selection.model.config import NoQuery, OwnImage, OwnText, PaperPatches, Patches, SelectionModel, Small
from tasks.selection.model.features import EVIDENCE, Contender, Scanned, colored, features_of, log_sizes, radius_of
from tasks.selection.model.shapes import check_shapes, shapes_of
from tasks.selection.model.sight import scan_cloud
from tasks.selection.model.words import tokens_of
from tasks.weights import from_safetensors

LARGEST_SCALE = 100.0
EPSILON = 1e-5
"""Of batch and layer norms, as in torch."""


class CandidateScorer(Protocol):
    """What scores the candidates of an object."""

    @property
    def config(self) -> SelectionModel:
        """What model it is."""
        ...

    def score(self, scanned: Scanned, contenders: Sequence[Contender]) -> NDArray[np.float64]:
        """Scores, shape (k,), higher is better; only differences mean something."""
        ...


def is_plain(config: SelectionModel) -> bool:
    """Whether a model is scored without torch: patches and own encoders are, other architectures and frozen encoders are not."""
    own = isinstance(config.image, NoQuery | OwnImage) and isinstance(config.text, NoQuery | OwnText)
    return own and isinstance(config.architecture, Small | PaperPatches)


def load(weights: bytes, config: SelectionModel, file: str = "weights") -> CandidateScorer:
    """What scores by these weights: without torch where that is possible.

    Raises:
        InputError: they are no weights of such a model.
    """
    if is_plain(config):
        return Scorer(config, folded(_fitting(from_safetensors(weights, file), config, file)))
    from tasks.selection.model.scoring import torch_scorer

    return torch_scorer(weights, config, file)


def check_fit(weights: bytes, config: SelectionModel, file: str = "weights") -> None:
    """Hold the weights of a model by others against its config; nothing is allocated, and nothing but the weights is opened.

    Raises:
        InputError: names or shapes are others, the config cannot be scored, or wants an encoder that lies outside of the model.
    """
    for field, query in (("image", config.image), ("text", config.text)):
        if not isinstance(query, NoQuery | OwnImage | OwnText):
            problem = f"is a frozen encoder ({query.kind}) in a folder of some machine, which is not opened for models of others"
            raise InputError(file, f"config.model.{field}", problem, "train the model in this lake, on a machine that has the folder")
    heads, dim = getattr(config.architecture, "heads", 1), getattr(config.architecture, "dim", 1)
    if dim % heads:
        raise InputError(file, "config.model.architecture.heads", f"{heads} heads do not share {dim} channels", "export the model again")
    arrays = from_safetensors(weights, file)
    if is_plain(config):
        wanted = shapes_of(config)
    else:
        from tasks.selection.model.scoring import check_torch, torch_shapes

        check_torch(config, file)
        wanted = torch_shapes(config)
    check_shapes(arrays, wanted, file)


@cache
def _libraries() -> Any:
    """The libraries of this process that compute matrix products."""
    return ThreadpoolController()


@dataclasses.dataclass(frozen=True)
class Scorer:
    """A model in NumPy. `weights`: by name, single precision, as `folded` has them."""

    config: SelectionModel
    weights: Mapping[str, Array]

    def score(self, scanned: Scanned, contenders: Sequence[Contender]) -> NDArray[np.float64]:
        """Scores, shape (k,): the same to the last bit however many threads this process has for matrix products."""
        with _libraries().limit(limits=1, user_api="blas"):
            made = self.forward(features_of(scanned, contenders, self.config))
        return made["match" if self.config.decides == "match" else "scores"].astype(np.float64)

    def scores(
        self, points: NDArray, colors: NDArray, image: NDArray[np.uint8] | None, text: str | None, extents: NDArray,
        scan: tuple[NDArray, NDArray] | None = None,
    ) -> NDArray[np.float64]:  # fmt: skip
        """Scores of clouds alone, without what alignment says of them; for models with `query_evidence` and `residuals` off.

        points, colors: Of the candidates, (k, n, 3) [m] and 0..255, as placed on the instance where the model's frame is that. image: Of
        the instance. text: Its category. extents: Of the candidates' boxes and, last, the instance's, (k + 1, 3) [m]. scan: Points and
        colors of the instance.
        """
        own = ColoredCloud(points[0].astype(np.float32), colors[0]) if scan is None else scan_cloud(*scan, self.config)
        scanned = Scanned(own, np.asarray(extents[-1], dtype=np.float32), text or "", None, image)
        nothing = np.zeros(len(EVIDENCE), dtype=np.float32)
        clouds = [scan_cloud(p, c, self.config) for p, c in zip(points, colors, strict=True)]
        contenders = [
            Contender(cloud, np.asarray(size, dtype=np.float32), np.eye(4), np.ones(3), nothing)
            for cloud, size in zip(clouds, extents, strict=False)
        ]
        return self.score(scanned, contenders)

    def forward(self, features: Mapping[str, NDArray]) -> dict[str, Array]:
        """What `Selector.forward` gives for a batch of this object, without its first axis."""
        config, clouds = self.config, features["clouds"]
        pooled = self._encoded(np.concatenate([clouds, features["scan"][None]]) if config.query_points else clouds)
        made = {"candidates": self._projected(pooled[: len(clouds)], features.get("sizes"))}
        if config.query_points:
            made["points"] = self._projected(pooled[-1:], _row(features.get("scan_size")))[0]
        if isinstance(config.image, OwnImage):
            made["image"] = _unit(self._image(features["image"])) * features["has_image"]
        if isinstance(config.text, OwnText):
            made["text"] = _unit(self._text(features["text"]))
        queries = [made[name] for name in ("points", "image", "text") if name in made]
        match = self.scale() * sum((made["candidates"] @ query for query in queries), np.zeros(len(clouds), dtype=np.float32))
        made["match"] = match.astype(np.float32)
        made["scores"] = made["match"] + (self._judged(pooled[: len(clouds)], made, features) if config.quality else np.float32(0))
        return made

    def scale(self) -> float:
        """What cosines are multiplied by."""
        if self.config.temperature == "none":
            return 1.0
        if self.config.temperature == "fixed":
            return self.config.fixed_scale
        return min(float(np.exp(self.weights["logit_scale"])), LARGEST_SCALE)

    def named(self, cloud: ColoredCloud, extents: NDArray, categories: Sequence[str], tokens: int) -> NDArray[np.float64]:
        """How well each of some categories names a scanned object, shape (c,): cosines times the scale. `cloud` as in `Scanned`."""
        config = self.config
        if not isinstance(config.text, OwnText) or not config.query_points:
            raise ValueError("the model was not trained to name scans")
        middle, radius = (np.array([0, 0, 0.5 * extents[2]]), radius_of(extents)) if config.frame == "placed" else (None, None)
        pooled = self._encoded(colored(cloud, config.architecture.points, middle, radius)[None])
        point = self._projected(pooled, log_sizes(np.asarray(extents))[None] if config.extents else None)[0]
        texts = np.stack([_unit(self._text(tokens_of(name, config.text.buckets, tokens))) for name in categories])
        return self.scale() * (texts @ point).astype(np.float64)

    def _linear(self, name: str, values: Array) -> Array:
        bias = self.weights.get(f"{name}.bias")
        product = values @ self.weights[f"{name}.weight"].reshape(len(self.weights[f"{name}.weight"]), -1).T
        return product if bias is None else product + bias

    def _layer_norm(self, name: str, values: Array) -> Array:
        middle = values - values.mean(axis=-1, keepdims=True)
        spread = np.sqrt(np.square(middle).mean(axis=-1, keepdims=True) + np.float32(EPSILON))
        return middle / spread * self.weights[f"{name}.weight"] + self.weights[f"{name}.bias"]

    def _activated(self, values: Array) -> Array:
        if self.config.architecture.activation == "relu":
            return np.maximum(values, 0)
        from scipy.special import erf

        return 0.5 * values * (1.0 + erf(values * np.float32(0.5**0.5)))

    def _encoded(self, clouds: Array) -> Array:
        """`PatchTransformer`: clouds (b, n, 6) to vectors (b, 2 dim)."""
        architecture: Patches = self.config.architecture
        points, groups = clouds[..., :3], architecture.groups
        centers = points[:, :groups]
        squares = np.square(points).sum(axis=-1)[:, None] - 2.0 * centers @ points.transpose(0, 2, 1)
        size = min(architecture.group_size, points.shape[1])
        index = np.argpartition(squares, size - 1, axis=-1)[..., :size] if size < points.shape[1] else np.argsort(squares, axis=-1)
        patches = clouds[np.arange(len(clouds))[:, None, None], index]
        patches[..., :3] -= centers[:, :, None]
        tokens = self._linear("point_encoder.reduce_dim", self._patches(patches))
        first = np.broadcast_to(self.weights["point_encoder.cls_token"], (len(clouds), 1, tokens.shape[-1]))
        tokens = np.concatenate([first, tokens], axis=1)
        hidden = self._activated(self._linear("point_encoder.pos_embed.0", centers))
        places = np.broadcast_to(self.weights["point_encoder.cls_pos"], first.shape)
        places = np.concatenate([places, self._linear("point_encoder.pos_embed.2", hidden)], axis=1)
        for block in range(architecture.depth):
            tokens = self._block(f"point_encoder.blocks.blocks.{block}", tokens + places, architecture.heads)
        tokens = self._layer_norm("point_encoder.norm", tokens)
        return np.concatenate([tokens[:, 0], tokens[:, 1:].max(axis=1)], axis=-1)

    def _patches(self, patches: Array) -> Array:
        """`PatchNet`."""
        name = "point_encoder.encoder"
        points = np.maximum(self._linear(f"{name}.first_conv.0", patches), 0)
        points = self._linear(f"{name}.first_conv.3", points)
        weight, width = self.weights[f"{name}.second_conv.0.weight"][..., 0], points.shape[-1]
        whole = points.max(axis=2, keepdims=True) @ weight[:, :width].T + self.weights[f"{name}.second_conv.0.bias"]
        mixed = np.maximum(points @ weight[:, width:].T + whole, 0)
        return self._linear(f"{name}.second_conv.3", mixed).max(axis=2)

    def _block(self, name: str, tokens: Array, heads: int) -> Array:
        """`TransformerBlock`."""
        batch, count, dim = tokens.shape
        parts = self._linear(f"{name}.attn.qkv", self._layer_norm(f"{name}.norm1", tokens))
        query, key, value = parts.reshape(batch, count, 3, heads, dim // heads).transpose(2, 0, 3, 1, 4)
        logits = query @ key.transpose(0, 1, 3, 2) * np.float32((dim // heads) ** -0.5)
        chances = np.exp(logits - logits.max(axis=-1, keepdims=True))
        chances /= chances.sum(axis=-1, keepdims=True)
        mixed = (chances @ value).transpose(0, 2, 1, 3).reshape(batch, count, dim)
        tokens = tokens + self._linear(f"{name}.attn.proj", mixed)
        hidden = self._activated(self._linear(f"{name}.mlp.fc1", self._layer_norm(f"{name}.norm2", tokens)))
        return tokens + self._linear(f"{name}.mlp.fc2", hidden)

    def _projected(self, pooled: Array, sizes: Array | None) -> Array:
        projected = pooled @ self.weights["pc_projection"]
        if self.config.extents and sizes is not None:
            projected = projected + self._linear("size_embedding", sizes)
        return _unit(projected)

    def _image(self, image: Array) -> Array:
        """`ImageNet`: (3, side, side) to (e,)."""
        values = 2.0 * image - np.float32(1.0)
        for layer in range(3):
            weight = self.weights[f"image_encoder.convolutions.{layer}.weight"]
            padded = np.pad(values, ((0, 0), (1, 1), (1, 1)))
            windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))[:, ::2, ::2]
            values = np.einsum("cyxhw,ochw->oyx", windows, weight, optimize=True)
            values = np.maximum(values + self.weights[f"image_encoder.convolutions.{layer}.bias"][:, None, None], 0)
        seen = np.concatenate([values.mean(axis=(1, 2)), values.max(axis=(1, 2))])
        return self._linear("image_encoder.projection", seen)

    def _text(self, tokens: NDArray[np.int64]) -> Array:
        """`WordTable`: (t,) to (e,)."""
        real = tokens[tokens > 0]
        return self._linear("text_encoder.projection", self.weights["text_encoder.table.weight"][real].sum(axis=0) / max(len(real), 1))

    def _judged(self, pooled: Array, made: Mapping[str, Array], features: Mapping[str, NDArray]) -> Array:
        config = self.config
        parts = [pooled]
        if config.extents:
            parts.append(features["sizes"] - features["scan_size"])
        if config.query_evidence:
            evidence = features["evidence"]
            parts += [evidence, evidence - evidence.max(axis=0)]
        if config.residuals:
            hidden = features["residuals"]
            for layer in range(2):
                hidden = np.maximum(self._linear(f"residual_encoder.layers.{layer}", hidden), 0)
            parts.append(np.concatenate([hidden.mean(axis=1), hidden.max(axis=1)], axis=-1))
            sides = np.split(np.abs(features["residuals"][..., 6:12]), 2, axis=1)
            summed = np.concatenate([side.mean(axis=1) for side in sides], axis=-1)
            parts += [summed, summed - summed.min(axis=0)]
        if config.query_points:
            parts.append(made["candidates"] * made["points"] * np.float32(made["points"].shape[-1] ** 0.5))
        seen = np.concatenate(parts, axis=-1)
        if config.relative:
            seen = np.concatenate([seen, seen - seen.mean(axis=0)], axis=-1)
        return self._linear("quality.3", np.maximum(self._linear("quality.0", seen), 0))[:, 0]


def folded(weights: Mapping[str, NDArray]) -> dict[str, Array]:
    """Weights with the batch norms of patches inside of the layers before them, where they cost nothing."""
    made = dict(weights)
    for name in ("point_encoder.encoder.first_conv", "point_encoder.encoder.second_conv"):
        mean, spread = made.pop(f"{name}.1.running_mean"), np.sqrt(made.pop(f"{name}.1.running_var").astype(np.float64) + EPSILON)
        factor, shift = made.pop(f"{name}.1.weight") / spread, made.pop(f"{name}.1.bias")
        made[f"{name}.0.weight"] = (made[f"{name}.0.weight"] * factor[:, None, None]).astype(np.float32)
        made[f"{name}.0.bias"] = ((made[f"{name}.0.bias"] - mean) * factor + shift).astype(np.float32)
    return made


def _unit(values: Array) -> Array:
    """Of length 1 along the last axis, as torch normalizes."""
    return values / np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), np.float32(1e-12))


def _row(values: NDArray | None) -> NDArray | None:
    return None if values is None else values[None]


def _fitting(arrays: Mapping[str, NDArray], config: SelectionModel, file: str) -> dict[str, Array]:
    """Weights in single precision, whose names and shapes are those of the config.

    Raises:
        InputError: some are missing, too many or of another shape.
    """
    check_shapes(arrays, shapes_of(config), file)
    return {name: np.asarray(values, dtype=np.float32) for name, values in arrays.items()}
