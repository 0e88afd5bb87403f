"""Selection models by name: the default, the paper's form, the authors' release, what each part is worth, and baselines that learn."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tasks.selection.model.batches import BatchConfig
from tasks.selection.model.config import AugmentationConfig, NoQuery, PaperPatches, PointNet2, SelectionModel, Small, Uni3d


@dataclasses.dataclass(frozen=True)
class Preset:
    """A model and what it learns by. paper: The size that it was published with instead; None where it is the same. trains: As in
    `SelectionTraining`. validates: Whether rooms are held out to choose weights by."""

    model: SelectionModel
    batch: BatchConfig = dataclasses.field(default_factory=BatchConfig)
    paper: Any = None
    trains: str = "all"
    validates: bool = True

    def full(self) -> Preset:
        """The same at the size that was published."""
        return self if self.paper is None else dataclasses.replace(self, model=dataclasses.replace(self.model, architecture=self.paper))


SMALL = SelectionModel()
AS_PUBLISHED_CLOUDS = AugmentationConfig(dropout=0.875, scale_least=0.8, scale_most=1.25, shift=0.1)

DUAL = dataclasses.replace(
    SMALL, query_points=False, query_evidence=False, residuals=False, extents=False, relative=False, frame="canonical",
    architecture=dataclasses.replace(Small(), activation="gelu", head_dropout=0.5, drop_path=0.1),
)  # fmt: skip
"""What the paper has: clouds by themselves, asked with image and text, and a head that sees nothing but the cloud."""

PUBLISHED = Preset(
    DUAL, BatchConfig(rank_weight=0.0, strangers_weight=1.0, names_weight=0.0, augmentation=AS_PUBLISHED_CLOUDS), PaperPatches()
)

POINTS = dataclasses.replace(DUAL, image=NoQuery(), text=NoQuery(), query_points=True, quality=False)
"""Scanned against candidate points, and nothing else."""

SMALL_POINTNET2 = PointNet2(
    points=192, centers=(48, 16), samples=(12, 12), first_widths=(24, 24, 48), second_widths=(48, 48, 96), third_widths=(96, 192, 256),
    last_widths=(128, 96), embedding=96, head_width=96, head_dropout=0.2,
)  # fmt: skip

SMALL_UNI3D = Uni3d(
    points=192, groups=24, group_size=12, dim=96, depth=3, heads=4, mlp_width=384, first_widths=(32, 64), second_widths=(96, 96),
    position_width=64, embedding=96, head_width=96, head_dropout=0.2,
)  # fmt: skip

ASKED = dataclasses.replace(DUAL, quality=False)
"""Asked with image and text, without quality."""

PLAIN_BATCH = BatchConfig(rank_weight=0.0, strangers_weight=1.0, names_weight=0.0, augmentation=AS_PUBLISHED_CLOUDS)


def _without(**changes: Any) -> Preset:
    return Preset(dataclasses.replace(SMALL, **changes))


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "small": Preset(SMALL),
        "as_published": dataclasses.replace(
            PUBLISHED, batch=dataclasses.replace(PUBLISHED.batch, rank_weight=0.5)
        ),  # the paper's form with each defect of the release mended
        "as_released": dataclasses.replace(
            PUBLISHED,
            model=dataclasses.replace(DUAL, temperature="none", decides="match", image_normalization="imagenet"),
            batch=dataclasses.replace(PUBLISHED.batch, augmentation=dataclasses.replace(AS_PUBLISHED_CLOUDS, axis="y")),
            trains="last",
            validates=False,
        ),
        "no_image": _without(image=NoQuery()),
        "no_text": _without(text=NoQuery()),
        "no_points": _without(query_points=False, residuals=False),
        "no_residuals": _without(residuals=False),
        "no_evidence": _without(query_evidence=False),
        "no_quality": _without(quality=False),
        "no_ranks": Preset(SMALL, BatchConfig(rank_weight=0.0)),
        "fixed_temperature": _without(temperature="fixed"),
        "no_temperature": _without(temperature="none"),
        "pointnet2": Preset(dataclasses.replace(POINTS, architecture=SMALL_POINTNET2), PLAIN_BATCH, PointNet2()),
        "pointbert": Preset(POINTS, PLAIN_BATCH, PaperPatches()),
        "ulip2": Preset(ASKED, PLAIN_BATCH, PaperPatches()),
        "uni3d": Preset(dataclasses.replace(ASKED, architecture=SMALL_UNI3D), PLAIN_BATCH, Uni3d()),
    }
)
"""By name. Sizes are those that can be trained here; `full()` has the published ones."""
