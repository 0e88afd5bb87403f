"""Layouts from above: pictures in colors of categories for metrics, and labelled figures for people."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.micro_scenes.categories import read_categories
from tasks.synthesis.layout import Array, Layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Image = NDArray[np.uint8]

BACKGROUND, LARGE = (255, 255, 255), (226, 222, 214)
"""Colors of what is beside the large object, and of it, RGB 0..255."""

MARGIN = 1.15
"""So many times the longer side of the large object is seen: what reaches over its edge is, too."""

GOLDEN = 0.618033988749895
"""Turn of the hue from one category to the next: neighbors by name differ, and no two of sixty are the same."""


@cache
def palette() -> dict[str, tuple[int, int, int]]:
    """Color of every category, RGB 0..255, no two the same, in the order of their names."""
    colors = {}
    for at, name in enumerate(read_categories().names):
        r, g, b = colorsys.hsv_to_rgb(at * GOLDEN % 1.0, (0.9, 0.6, 0.75)[at % 3], (0.85, 0.95, 0.6)[at // 3 % 3])
        colors[name] = (round(255 * r), round(255 * g), round(255 * b))
    return colors


def color_of(category: str) -> tuple[int, int, int]:
    """Color of a category, RGB 0..255; that of `object` for one that is not in the table of categories."""
    colors = palette()
    return colors.get(category, colors["object"])


def seen_m(layout: Layout) -> float:
    """Side of the square round the large object that is seen in its picture [m]."""
    return MARGIN * max(layout.large.size[:2])


def from_above(layout: Layout, pixels: int = 64, extent_m: float | None = None) -> Image:
    """Orthographic picture from above, shape (pixels, pixels, 3), RGB: boxes in the colors of their categories, the higher top above.

    extent_m: Side of the square that is seen [m]; from the large object where it is None. Up in the picture is +X, the front of the
    large object, left is +Y.
    """
    extent = seen_m(layout) if extent_m is None else extent_m
    steps = (0.5 - (np.arange(pixels) + 0.5) / pixels) * extent
    x, y = steps[:, None], steps[None, :]
    image = np.empty((pixels, pixels, 3), dtype=np.uint8)
    image[:] = BACKGROUND
    depth, width, _ = layout.large.size
    image[(np.abs(x) <= 0.5 * depth) & (np.abs(y) <= 0.5 * width)] = LARGE
    tops = layout.centers[:, 2] + 0.5 * layout.sizes[:, 2]
    for at in np.lexsort([np.array(layout.categories), tops]).tolist() if len(layout) else []:
        cos, sin = math.cos(layout.yaws[at]), math.sin(layout.yaws[at])
        dx, dy = x - layout.centers[at, 0], y - layout.centers[at, 1]
        along, across = dx * cos + dy * sin, dy * cos - dx * sin
        inside = (np.abs(along) <= 0.5 * layout.sizes[at, 0]) & (np.abs(across) <= 0.5 * layout.sizes[at, 1])
        image[inside] = color_of(layout.categories[at])
    return image


def figure_of(rows: Sequence[tuple[str, Sequence[Layout]]], title: str) -> Figure:
    """A labelled figure: a row of layouts side by side for every name, all of a row at one scale, as `from_above` sees them."""
    from matplotlib.figure import Figure

    columns = max((len(layouts) for _, layouts in rows), default=0)
    if not columns:
        raise ValueError("a figure needs at least one layout")
    seen = [max((seen_m(layout) for layout in layouts), default=1.0) for _, layouts in rows]
    depths = [MARGIN * max((layout.large.size[0] for layout in layouts), default=1.0) for _, layouts in rows]
    heights = [2.4 * depth / extent + 0.3 for depth, extent in zip(depths, seen, strict=True)]
    figure = Figure(figsize=(2.4 * columns, sum(heights) + 1.2), layout="constrained")
    figure.suptitle(title)
    used: set[str] = set()
    axes = figure.subplots(len(rows), 1, squeeze=False, height_ratios=heights)[:, 0]
    for (name, layouts), ax, extent, depth in zip(rows, axes, seen, depths, strict=True):
        ax.set_title(name, fontsize=9, loc="left")
        ax.axis("off")
        ax.set_xlim(-0.5 * extent, (columns - 0.5) * extent)
        ax.set_ylim(-0.5 * depth, 0.5 * depth)
        ax.set_aspect("equal")
        for at, layout in enumerate(layouts):
            _draw(ax, layout, extent, at * extent)
            used |= set(layout.categories)
    _legend(figure, sorted(used))
    return figure


def _draw(ax: Axes, layout: Layout, extent: float, across: float) -> None:
    """The boxes of a layout, so far across [m], with the names of those that are wide enough."""
    from matplotlib.patches import Polygon, Rectangle

    depth, width, _ = layout.large.size
    ax.add_patch(Rectangle((across - 0.5 * width, -0.5 * depth), width, depth, facecolor=_share(LARGE), edgecolor="0.4"))
    tops = layout.centers[:, 2] + 0.5 * layout.sizes[:, 2]
    for at in np.argsort(tops, kind="stable").tolist():
        ring = footprint(layout, at)
        ax.add_patch(
            Polygon(np.column_stack([across - ring[:, 1], ring[:, 0]]), facecolor=_share(color_of(layout.categories[at])), edgecolor="0.2")
        )
        if max(layout.sizes[at, :2]) > 0.12 * extent:
            label = layout.categories[at].replace("_", " ")
            ax.text(across - layout.centers[at, 1], layout.centers[at, 0], label, fontsize=6, ha="center", va="center")


def _legend(figure: Figure, names: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    if names:
        handles = [Patch(facecolor=_share(color_of(name)), edgecolor="0.2", label=name.replace("_", " ")) for name in names]
        figure.legend(handles=handles, loc="outside lower center", ncols=8, fontsize=7, frameon=False)


def _share(color: tuple[int, int, int]) -> tuple[float, float, float]:
    return color[0] / 255, color[1] / 255, color[2] / 255


def footprint(layout: Layout, at: int) -> Array:
    """Corners of an object's footprint in the frame of the large object [m], shape (4, 2), counter-clockwise."""
    cos, sin = math.cos(layout.yaws[at]), math.sin(layout.yaws[at])
    corners = 0.5 * layout.sizes[at, :2] * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(corners @ np.array([[cos, sin], [-sin, cos]]) + layout.centers[at, :2])
