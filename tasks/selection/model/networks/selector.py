"""The selection network: candidates and queries in one space, and a head that judges the candidate itself."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from tasks.selection.model.config import NoQuery, OwnImage, OwnText, PointNet2, SelectionModel, Uni3d
from tasks.selection.model.features import EVIDENCE, RESIDUAL, SUMMED
from tasks.selection.model.networks.patches import PatchTransformer, PatchVision
from tasks.selection.model.networks.queries import ImageNet, ResidualNet, WordTable
from tasks.selection.model.networks.sets import PointNet

FIRST_SCALE = 1 / 0.07
LARGEST_SCALE = 100.0


class Selector(nn.Module):
    """Scores of the candidates of objects.

    A batch is a table of tensors, for b objects of k candidates: `clouds` (b, k, n, 6), `scan` (b, n, 6), `is_candidate` (b, k),
    `evidence` (b, k, e), `residuals` (b, k, m, c), `sizes` (b, k, 3) and `scan_size` (b, 3) as logarithms [m], `image`
    (b, 3, side, side) or as the frozen encoder gave it (b, e), `has_image` (b,), `text` (b, t) tokens or (b, e), and in training
    `starts` (b, k + 1), where groups begin. `others` (b, m) are places among all candidates of the batch, object by object, -1 for none.
    What a model does not use may be missing.

    `image_width`, `text_width`: lengths of what frozen encoders give; 0 without one.
    """

    def __init__(self, config: SelectionModel, *, image_width: int = 0, text_width: int = 0) -> None:
        super().__init__()
        architecture = config.architecture
        embedding = architecture.embedding
        self.config = config
        self.point_encoder = encoder_of(architecture)
        width = self.point_encoder.width
        self.pc_projection = None if isinstance(architecture, Uni3d) else nn.Parameter(torch.randn(width, embedding) * width**-0.5)
        self.logit_scale = nn.Parameter(torch.tensor(math.log(FIRST_SCALE)), requires_grad=config.temperature == "learned")
        self.image_encoder = query_of(config.image, image_width, embedding)
        self.text_encoder = query_of(config.text, text_width, embedding)
        if config.extents:
            self.size_embedding = nn.Linear(3, embedding)
            nn.init.zeros_(self.size_embedding.bias)
        if config.quality:
            inside = width + (3 if config.extents else 0) + (2 * len(EVIDENCE) if config.query_evidence else 0)
            if config.residuals:
                self.residual_encoder = ResidualNet(RESIDUAL, config.residual_widths)
                inside += 2 * config.residual_widths[1] + 2 * SUMMED
            if config.query_points:
                inside += embedding
            inside *= 2 if config.relative else 1
            hidden = architecture.head_width
            self.quality = nn.Sequential(
                nn.Linear(inside, hidden), nn.ReLU(), nn.Dropout(architecture.head_dropout), nn.Linear(hidden, 1, bias=False)
            )

    def forward(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """`scores` and `match`, the part of them without the quality, both (b, k), -inf where there is no candidate; `candidates`
        (b, k, e), and the queries `points`, `image`, `text` (b, e) where there are any, of length 1. Of a batch with `choice` and `others`
        also `strangers`, and of one with `words`, `names`: what losses are made of."""
        config, clouds, mask = self.config, batch["clouds"], batch["is_candidate"]
        objects, count = clouds.shape[:2]
        pooled, scan = self._encoded(batch)
        sizes, scan_size = batch.get("sizes"), batch.get("scan_size")
        vectors = {"candidates": self._projected(pooled.view(objects, count, -1), sizes)}
        if scan is not None:
            vectors["points"] = self._projected(scan, scan_size)
        if self.image_encoder is not None:
            vectors["image"] = functional.normalize(self.image_encoder(batch["image"]), dim=-1) * batch["has_image"][:, None]
        if self.text_encoder is not None:
            vectors["text"] = functional.normalize(self.text_encoder(batch["text"]), dim=-1)
        match = self.compared(vectors["candidates"], vectors)
        scores = match
        if config.quality:
            scores = match + self._judged(pooled.view(objects, count, -1), vectors, batch)
        hide = torch.where(mask, 0.0, -torch.inf).to(scores.dtype)
        return {"scores": scores + hide, "match": match + hide, **vectors, **self._trained_beside(vectors, batch)}

    def scale(self) -> Tensor:
        """What cosines are multiplied by."""
        if self.config.temperature == "none":
            return torch.ones_like(self.logit_scale)
        if self.config.temperature == "fixed":
            return torch.full_like(self.logit_scale, self.config.fixed_scale)
        return self.logit_scale.exp().clamp(max=LARGEST_SCALE)

    def compared(self, candidates: Tensor, queries: Mapping[str, Tensor]) -> Tensor:
        """Sum of the scaled cosines of candidates, (b, k, e), with the queries, (b, e) each: (b, k)."""
        named = [queries[name] for name in ("points", "image", "text") if name in queries]
        if not named:
            return candidates.new_zeros(candidates.shape[:2])
        total = torch.stack([torch.einsum("bke,be->bk", candidates, query) for query in named]).sum(0)
        return self.scale() * total

    def _trained_beside(self, vectors: Mapping[str, Tensor], batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """`strangers`: how the chosen candidate and candidates of other scenes match, (b, 1 + m), the chosen first, -inf where there are
        too few; `names`: how categories name the scanned points, (b, c)."""
        made = {}
        if "others" in batch and not vectors.keys().isdisjoint(("points", "image", "text")):
            candidates, choice, rivals = vectors["candidates"], batch["choice"], batch["others"]
            right = candidates[torch.arange(len(choice), device=choice.device), choice][:, None]
            group = torch.cat([right, candidates.flatten(0, 1)[rivals.clamp(min=0)]], dim=1)
            missing = torch.cat([torch.zeros_like(rivals[:, :1]), rivals], dim=1) < 0
            made["strangers"] = self.compared(group, vectors).masked_fill(missing, -torch.inf)
        if "words" in batch and "points" in vectors and self.text_encoder is not None:
            texts = functional.normalize(self.text_encoder(batch["words"]), dim=-1)
            made["names"] = self.scale() * vectors["points"] @ texts.T
        return made

    def _encoded(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor | None]:
        """Vectors of the clouds of candidates, shape (b k, width), and of the scans, (b, width), by one pass of the encoder."""
        clouds, starts = batch["clouds"].flatten(0, 1), batch.get("starts")
        first = None if starts is None else starts[:, :-1].flatten()
        if not self.config.query_points:
            return self.point_encoder(clouds, first), None
        if first is not None and starts is not None:
            first = torch.cat([first, starts[:, -1]])
        pooled = self.point_encoder(torch.cat([clouds, batch["scan"]]), first)
        return pooled[: len(clouds)], pooled[len(clouds) :]

    def _projected(self, pooled: Tensor, sizes: Tensor | None) -> Tensor:
        """Vectors of length 1 in the space of the queries."""
        projected = pooled if self.pc_projection is None else pooled @ self.pc_projection
        if self.config.extents and sizes is not None:
            projected = projected + self.size_embedding(sizes)
        return functional.normalize(projected, dim=-1)

    def _judged(self, pooled: Tensor, vectors: Mapping[str, Tensor], batch: Mapping[str, Tensor]) -> Tensor:
        """What the head says of candidates by themselves, shape (b, k)."""
        config, mask = self.config, batch["is_candidate"]
        parts = [pooled]
        if config.extents:
            parts.append(batch["sizes"] - batch["scan_size"][:, None])
        if config.query_evidence:
            evidence = batch["evidence"]
            best = evidence.masked_fill(~mask[..., None], -torch.inf).amax(1, keepdim=True)
            parts += [evidence, evidence - best]
        if config.residuals:
            points = batch["residuals"]
            parts.append(self.residual_encoder(points.flatten(0, 1)).view(*points.shape[:2], -1))
            summed = torch.cat([side[..., 6:12].abs().mean(2) for side in points.chunk(2, dim=2)], dim=-1)
            parts += [summed, summed - summed.masked_fill(~mask[..., None], torch.inf).amin(1, keepdim=True)]
        if config.query_points:
            parts.append(vectors["candidates"] * vectors["points"][:, None] * vectors["points"].shape[-1] ** 0.5)
        seen = torch.cat(parts, dim=-1)
        if config.relative:
            share = mask.to(seen.dtype)[..., None]
            seen = torch.cat([seen, seen - (seen * share).sum(1, keepdim=True) / share.sum(1, keepdim=True).clamp(min=1)], dim=-1)
        result: Tensor = self.quality(seen)[..., 0]
        return result


def encoder_of(architecture: object) -> PatchTransformer | PatchVision | PointNet:
    """The point encoder of an architecture."""
    if isinstance(architecture, PointNet2):
        return PointNet(architecture)
    return PatchVision(architecture) if isinstance(architecture, Uni3d) else PatchTransformer(architecture)  # type: ignore[arg-type]


def query_of(config: object, width: int, embedding: int) -> nn.Module | None:
    """The encoder of a query; of one that is frozen what brings its vectors, `width` long, to the model's length."""
    if isinstance(config, NoQuery):
        return None
    if isinstance(config, OwnImage):
        return ImageNet(config, embedding)
    if isinstance(config, OwnText):
        return WordTable(config, embedding)
    return nn.Identity() if width == embedding else nn.Linear(width, embedding)
