"""What a chart says of a mark when it is pointed at, tapped or reached by keys: titles inside the SVG.

A mark is the artist itself, or an area over the place that it stands for: a thin bar is hard to hit, a line of a table is not.
Areas are neither drawn nor laid out, so that a picture looks the same with and without them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.transforms import Transform

_INSIDE, _ALONG = "tip:", "tip along:"
"""Beginnings of an artist's id in the SVG; the rest is what is said of it."""


def name_mark(artist: Artist, text: str, along: bool = False) -> None:
    """Say `text` of a mark: of all that is inside its outline, or `along` its line alone."""
    artist.set_gid((_ALONG if along else _INSIDE) + text)


def area(axes: Axes, x: tuple[float, float], y: tuple[float, float], text: str, transform: Transform | None = None) -> None:
    """Say `text` of an area, from and to on each axis in data coordinates, or in those of `transform`."""
    from matplotlib.patches import Rectangle

    patch = Rectangle((x[0], y[0]), x[1] - x[0], y[1] - y[0], facecolor="none", edgecolor="none", zorder=10)
    patch.set_transform(transform or axes.transData)
    patch.set_in_layout(False)
    name_mark(patch, text)
    axes.add_artist(patch)


def lines(axes: Axes, texts: Sequence[str]) -> None:
    """Say a text of each line of a chart with categories down its side, over its whole width."""
    for at, text in enumerate(texts):
        area(axes, (0.0, 1.0), (at - 0.5, at + 0.5), text, axes.get_yaxis_transform())


def columns(axes: Axes, texts: Sequence[str], edges: Sequence[tuple[float, float]]) -> None:
    """Say a text of each column between two places on the x axis, over its whole height."""
    for (left, right), text in zip(edges, texts, strict=True):
        area(axes, (left, right), (0.0, 1.0), text, axes.get_xaxis_transform())


def titled(svg: str) -> str:
    """The SVG of a figure with what is said of its marks as titles."""
    svg = re.sub(rf'<g id="{_INSIDE}([^"]*)">', r'<g class="tip" pointer-events="all"><title>\1</title>', svg)
    return re.sub(rf'<g id="{_ALONG}([^"]*)">', r'<g class="tip" pointer-events="stroke"><title>\1</title>', svg)
