"""Axes that several charts share: bars with their numbers, cells of heat maps, labels down the side, plain numbers on logarithmic axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tasks.stats.style import INK, PAPER, SERIES
from tasks.stats.tips import area, lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def whole_numbers(axes: Axes) -> None:
    """Ticks of the x axis at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def bars(axes: Axes, labels: Sequence[str], values: Any, color: str, number: str, noun: str = "") -> None:
    """Horizontal bars from top to bottom, each with its number, and of what it is so many in its tip."""
    axes.barh(np.arange(len(labels)), values, height=0.66, color=color)
    for at, value in enumerate(values):
        label = axes.annotate(number.format(value), (value, at), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
        label.set_bbox({"facecolor": PAPER.light, "edgecolor": "none", "pad": 0.8})
    category_axis(axes, labels)
    lines(axes, [f"{label}: {number.format(value)} {noun}".rstrip() for label, value in zip(labels, values, strict=True)])
    axes.margins(x=0.1)


def category_axis(axes: Axes, labels: Sequence[str]) -> None:
    """Labels down the left side, the first at the top."""
    axes.set_yticks(np.arange(len(labels)), [short(label) for label in labels])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(labels) - 0.4, -0.6)


def heat_cells(axes: Axes, names: Sequence[str], columns: Sequence[str], share: Any, texts: Sequence[Sequence[str]]) -> None:
    """Cells of a heat map: `names` from top to bottom, `columns` from left to right.

    share: How strong each cell's color is beside the strongest, shape (names, columns). texts: What stands in each cell; one without a
    text has no color either.
    """
    for line, row in enumerate(texts):
        for column, text in enumerate(row):
            if text:
                strength = 0.06 + 0.42 * share[line, column] / share.max()  # the text on it stays legible on light and on dark ground
                axes.barh(line, 1.0, left=column - 0.5, height=1.0, color=SERIES[0].light, alpha=strength, linewidth=0)
                axes.text(column, line, text, ha="center", va="center", fontsize=6.5, color=INK.light)
                what = f"{names[line]}, {columns[column]}: {text}" + ("" if text.endswith("%") else f", {share[line, column]:.0%}")
                area(axes, (column - 0.5, column + 0.5), (line - 0.5, line + 0.5), what)
    category_axis(axes, [short(name, 22) for name in names])
    axes.tick_params(axis="y", labelsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(-0.5, len(columns) - 0.5)
    few = len(columns) <= 3
    axes.set_xticks(
        np.arange(len(columns)),
        [short(name, 16) for name in columns],
        rotation=0 if few else 35,
        ha="center" if few else "right",
        rotation_mode="anchor",
    )
    axes.tick_params(axis="x", labelsize=8)
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def short(label: str, length: int = 28) -> str:
    """The label, cut in its middle when it is longer than a phone has place for."""
    keep = (length - 1) // 2
    return label if len(label) <= length else f"{label[:keep]}…{label[-keep:]}"


def integer_bins(counts: Any) -> Any:
    """Bin edges at half integers, about twenty bins of equal whole width."""
    low, high = int(counts.min()), int(counts.max())
    width = max(1, -(-(high - low + 1) // 20))
    return np.arange(low, high + width + 1, width) - 0.5


def volume_axis(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis in plain numbers, over all values [m3]; a narrow one has ticks between the powers of ten too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = min(values) / 1.3, max(values) * 1.3
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    decades = np.log10(high / low)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if decades > 2.5 else (1.0, 2.0, 5.0), numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6f}".rstrip("0").rstrip(".")))
    axes.xaxis.set_minor_formatter(NullFormatter())
