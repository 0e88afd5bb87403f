"""Rows about layouts of textures: of twins, and of models that came with one picture and places in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from schemas.candidates import TextureCharts
from tasks.texturing.charts import ChartFigures, chart_figures

if TYPE_CHECKING:
    import trimesh

MAX_CHARTED_FACES = 50_000
"""Layouts of more faces that came with a model are not measured: it takes longer than all else about it."""

SOURCE = "source"
"""Method of layouts that came with a model."""


def own_charts(asset_id: str, parts: Sequence[trimesh.Trimesh]) -> TextureCharts | None:
    """The layout that a model came with: where it is one part with one picture, as far as it has figures; else None.

    Of several parts each has a texture of its own, so that overlap and coverage say nothing about the whole.
    """
    size = picture_size(parts[0]) if len(parts) == 1 and len(parts[0].faces) <= MAX_CHARTED_FACES else None
    uv: Any = getattr(parts[0].visual, "uv", None)
    if size is None or uv is None or len(uv) != len(parts[0].vertices):
        return None
    try:
        figures = chart_figures(parts[0].vertices, parts[0].faces, uv)
    except ValueError:  # nothing of it has an area in the texture
        return None
    return charts_row(asset_id, None, SOURCE, None, max(size), figures, None)


def picture_size(part: trimesh.Trimesh) -> tuple[int, int] | None:
    """Width and height of a part's picture of base colors [px]; None where it has none. Decodes nothing."""
    picture: Any = getattr(getattr(part.visual, "material", None), "baseColorTexture", None)
    return None if picture is None else (int(picture.size[0]), int(picture.size[1]))


def charts_row(
    asset_id: str, of_asset_id: str | None, method: str, made_by: str | None, side_px: int, figures: ChartFigures, seconds: float | None
) -> TextureCharts:
    """The row of a layout."""
    return TextureCharts(
        asset_id=asset_id, of_asset_id=of_asset_id, method=method, made_by=made_by, side_px=side_px, faces=figures.faces,
        charts=figures.charts, stretch_l2=figures.stretch_l2, stretch_linf=figures.stretch_linf,
        angle_distortion_radians=figures.angle_distortion, coverage=figures.coverage,
        overlap_share=figures.overlap, flipped=figures.flipped,
        outside=figures.outside, collapsed=figures.collapsed, seam_ratio=figures.seam_ratio, seconds=seconds,
    )  # fmt: skip
