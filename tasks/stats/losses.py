"""The loss of one scene's optimization over its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from tasks.stats.axes import whole_numbers
from tasks.stats.style import GRID, SERIES, Picture, canvas, chart, in_style
from tasks.stats.tips import columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CURVE_POINTS = 400
"""Steps that a loss curve of a phone's width can tell apart."""

_MOST_TIPS = 40
"""Falls of the smallest loss that can be pointed at, evenly spread."""

_BLUE, _ORANGE = SERIES[0].light, SERIES[1].light


_QUANTITIES = {
    "paper": ("", 1.0, "sum of IoU of the boxes"),
    "released": ("l", 1000.0, "overlap of the boxes"),
    "default": ("mm", 1000.0, "penetration depth"),
}
"""Unit, factor from the table's unit, and name of a method's loss."""


@in_style
def loss_curve(steps: pa.Table, method: str, scene_id: str) -> Picture | None:
    """Loss and smallest loss so far over the steps of a scene's optimization, on an axis that is logarithmic down to the
    smallest loss above zero and linear from there to zero. Rows of `optimization_steps`.

    The smallest loss is drawn at every step at which it falls; of many steps, the loss as the range that it takes.
    """
    rows = sorted(steps.select(["step", "loss", "smallest_loss"]).to_pylist(), key=lambda row: row["step"])
    if not rows:
        return None
    unit, factor, quantity = _QUANTITIES[method]
    step, loss, smallest = (np.array([row[key] for row in rows], dtype=np.float64) for key in ("step", "loss", "smallest_loss"))
    loss, smallest = loss * factor, smallest * factor
    axes = canvas(2.7)
    if len(rows) > _CURVE_POINTS:
        starts = np.linspace(0, len(rows), _CURVE_POINTS // 2 + 1).astype(np.int64)[:-1]
        low, high = np.minimum.reduceat(loss, starts), np.maximum.reduceat(loss, starts)
        axes.fill_between(step[starts], low, high, step="post", color=_ORANGE, alpha=0.45, linewidth=0, label="loss, its range")
    else:
        axes.plot(step, loss, color=_ORANGE, linewidth=1.1, drawstyle="steps-post", label="loss")
    falls = np.flatnonzero(np.diff(smallest, prepend=np.inf) < 0)
    ends = np.append(falls, len(rows) - 1)
    axes.plot(step[ends], smallest[ends], color=_BLUE, linewidth=1.8, drawstyle="steps-post", label="smallest so far")
    marks = falls[np.unique(np.linspace(0, len(falls) - 1, min(len(falls), _MOST_TIPS)).astype(np.int64))]
    after = np.append(step[marks[1:]], max(step[-1], step[marks[-1]] + 1))
    texts = [f"from step {step[at]:.0f}: smallest so far {smallest[at]:.3g} {unit}" for at in marks]
    columns(axes, texts, list(zip(step[marks].tolist(), after.tolist(), strict=True)))
    _loss_axis(axes, np.concatenate([loss, smallest]))
    axes.grid(visible=False, axis="x")
    axes.grid(visible=True, axis="y", color=GRID.light, linewidth=0.7)
    axes.set_xlim(0, 1.03 * max(step[-1], 1))  # a fall at the last step is to be seen
    whole_numbers(axes)
    axes.set_xlabel("step" if method != "default" else "step; moves that were taken back are left out")
    axes.set_ylabel(f"{quantity} [{unit}]" if unit else quantity)
    title = f"Loss, method {method}"
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.4)
    alt = (
        f"Collision loss of {scene_id} over {step[-1]:.0f} steps: {loss[0]:.3g} {unit} at the start, {smallest[-1]:.3g} {unit} in the end."
    )
    return chart(axes, f"loss_{scene_id}", title, alt)


def _loss_axis(axes: Axes, values: Any) -> None:
    """A logarithmic y axis in plain numbers over values that are not negative; below the smallest positive one linear to zero."""
    from matplotlib.ticker import FuncFormatter, NullLocator, SymmetricalLogLocator

    positive = values[values > 0]
    if not len(positive):
        axes.set_ylim(0, 1)
        return
    high = float(positive.max())
    # six decades are shown at most: below them is rounding, drawn at zero
    low = max(10.0 ** np.floor(np.log10(positive.min())), 10.0 ** (np.floor(np.log10(high)) - 6))
    axes.set_yscale("symlog", linthresh=low, linscale=0.4)
    axes.set_ylim(0, high * 1.5)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=low))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
