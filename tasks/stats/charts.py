"""The statistics' pictures, one function each: the rows of a view in, a picture out. Nothing to draw gives None."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from tasks.stats.style import GRID, INK, MUTED, PAPER, SERIES, Picture, canvas, in_style, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CATEGORY_LIMIT = 50
"""Categories in the box plot (supplementary, Fig. A7)."""

SCENE_LIMIT = 20
"""Scenes with a bar of their own; of more, a histogram is drawn, or those that matter most."""

SMALLEST_VOLUME_M3 = 1e-6
"""A cubic centimetre. Flatter boxes are drawn there: a logarithmic axis has no zero."""

_CURVE_POINTS = 400
"""Steps that a loss curve of a phone's width can tell apart."""

_BLUE, _ORANGE, _GREEN, _GRAY = (SERIES[i].light for i in (0, 1, 2, 8))


@in_style
def per_scene(rows: pa.Table, column: str, noun: str) -> Picture | None:
    """How many `noun` (objects, categories) scenes hold: one bar a scene, or a histogram of many scenes.

    `rows` has `scene_id` and the integer `column`, one row per scene.
    """
    if not rows.num_rows:
        return None
    counts = np.asarray(rows[column].to_pylist(), dtype=np.int64)
    median = float(np.median(counts))
    title = f"{noun.capitalize()} per scene"
    alt = f"{title}: {len(counts)} scenes, {counts.min()} to {counts.max()} {noun}, median {median:g}."
    name = f"{column}_per_scene"
    if len(counts) <= SCENE_LIMIT:
        figure, axes = canvas(0.9 + 0.24 * len(counts))
        _bars(axes, rows["scene_id"].to_pylist(), counts, _BLUE, "{:.0f}")
        axes.axvline(median, color=_ORANGE, linewidth=1.2, linestyle="--", zorder=0.9)
        axes.set_xlabel(f"{noun}; dashed: median {median:g}")
    else:
        figure, axes = canvas(2.8)
        axes.hist(counts, bins=_integer_bins(counts), color=_BLUE, edgecolor=_BLUE, linewidth=0.4, alpha=0.85)
        axes.axvline(median, color=_ORANGE, linewidth=1.4, linestyle="--")
        axes.grid(visible=False, axis="x")
        axes.grid(visible=True, axis="y", color=GRID.light, linewidth=0.7)
        axes.set_xlabel(f"{noun} in the scene; dashed: median {median:g}")
        axes.set_ylabel("scenes")
    axes.set_title(title)
    return picture(figure, name, title, alt)


@in_style
def volume_boxes(boxes: pa.Table, outliers: pa.Table) -> Picture | None:
    """Volume of the objects' oriented boxes, one box per category, on a logarithmic axis (supplementary, Fig. A7).

    `boxes` and `outliers` are the rows of `volume_by_category` and `volume_outliers`.
    """
    shown = [row for row in boxes.to_pylist() if row["frequency_rank"] <= CATEGORY_LIMIT]
    if not shown:
        return None
    strays: dict[str, list[float]] = {row["category"]: [] for row in shown}
    for row in outliers.select(["category", "box_volume_m3"]).to_pylist():
        if row["category"] in strays:
            strays[row["category"]].append(max(row["box_volume_m3"], SMALLEST_VOLUME_M3))
    stats = [
        {
            "label": f"{row['category']} ({row['objects']})",
            "fliers": strays[row["category"]],
            **{
                key: max(row[column], SMALLEST_VOLUME_M3)
                for key, column in (
                    ("whislo", "whisker_low_m3"),
                    ("q1", "q1_m3"),
                    ("med", "median_m3"),
                    ("q3", "q3_m3"),
                    ("whishi", "whisker_high_m3"),
                )
            },
        }
        for row in shown
    ]
    figure, axes = canvas(1.0 + 0.185 * len(stats))
    axes.bxp(
        stats,
        orientation="horizontal",
        patch_artist=True,
        widths=0.62,
        boxprops={"facecolor": _BLUE, "edgecolor": _BLUE, "alpha": 0.55},
        medianprops={"color": INK.light, "linewidth": 1.4},
        whiskerprops={"color": MUTED.light, "linewidth": 0.9},
        capprops={"color": MUTED.light, "linewidth": 0.9},
        flierprops={"marker": "o", "markersize": 2.2, "markerfacecolor": _ORANGE, "markeredgecolor": _ORANGE},
    )
    _volume_axis(axes, [value for entry in stats for value in (entry["whislo"], entry["whishi"], *entry["fliers"])])
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.set_xlabel("volume of the oriented box [m³], logarithmic")
    title = f"Volume by category, top {CATEGORY_LIMIT}" if len(stats) >= CATEGORY_LIMIT else "Volume by category"
    axes.set_title(title)
    medians = {row["category"]: row["median_m3"] for row in shown}
    small, large = min(medians, key=lambda c: (medians[c], c)), max(medians, key=lambda c: (medians[c], c))
    alt = (
        f"Box plot of object volume for {len(stats)} categories, most frequent first. Smallest median: {small}, "
        f"{medians[small]:.2g} m³; largest: {large}, {medians[large]:.2g} m³. Whiskers end at 1.5 times the interquartile range."
    )
    return picture(figure, "volume_by_category", title, alt)


@in_style
def stage_bars(timing: pa.Table, stages: Sequence[str]) -> Picture | None:
    """Median and 95th percentile of the seconds that each stage takes for a scene. Rows of `stage_timing`."""
    by_stage = {row["stage"]: row for row in timing.to_pylist()}
    order = [stage for stage in stages if stage in by_stage]
    if not order:
        return None
    median = np.array([by_stage[stage]["median_seconds"] for stage in order])
    p95 = np.array([by_stage[stage]["p95_seconds"] for stage in order])
    figure, axes = canvas(1.1 + 0.3 * len(order))
    y = np.arange(len(order))
    axes.barh(y, median, height=0.6, color=_BLUE)
    axes.hlines(y, median, p95, color=_ORANGE, linewidth=1.6)
    axes.plot(p95, y, linestyle="none", marker="|", markersize=9, markeredgewidth=2, color=_ORANGE)
    for at, (low, high) in enumerate(zip(median, p95, strict=True)):
        axes.annotate(f"{low:.2f} s", (max(low, high), at), xytext=(6, 0), textcoords="offset points", va="center", fontsize=8)
    _category_axis(axes, order)
    axes.margins(x=0.14)
    axes.set_xlim(left=0)
    axes.set_xlabel("seconds per scene: median (bar), 95th percentile (mark)")
    title = "Time per stage"
    axes.set_title(title)
    slowest = order[int(np.argmax(median))]
    alt = f"Seconds per scene and stage. Slowest: {slowest}, median {median.max():.2f} s."
    return picture(figure, "stage_timing", title, alt)


@in_style
def scene_bars(runs: pa.Table, stages: Sequence[str]) -> Picture | None:
    """Seconds per scene, split by stage, of the slowest scenes. Rows of `current_runs`: scene_id, stage, seconds."""
    seconds: dict[str, dict[str, float]] = {}
    for row in runs.select(["scene_id", "stage", "seconds"]).to_pylist():
        seconds.setdefault(row["scene_id"], {})[row["stage"]] = row["seconds"]
    totals = {scene: sum(parts.values()) for scene, parts in seconds.items()}
    order = sorted(totals, key=lambda scene: (-totals[scene], scene))[:SCENE_LIMIT]
    if not order:
        return None
    figure, axes = canvas(1.5 + 0.26 * len(order))
    left = np.zeros(len(order))
    for index, stage in enumerate(stages):
        width = np.array([seconds[scene].get(stage, 0.0) for scene in order])
        if width.any():
            axes.barh(np.arange(len(order)), width, left=left, height=0.66, color=SERIES[index % len(SERIES)].light, label=stage)
            left += width
    _category_axis(axes, order)
    axes.set_xlabel("seconds")
    title = "Time per scene" if len(order) == len(totals) else f"Time of the {len(order)} slowest scenes"
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=4, handlelength=1.0, columnspacing=1.2)
    alt = f"{title}, split by stage. Slowest: {order[0]}, {totals[order[0]]:.1f} s."
    return picture(figure, "scene_timing", title, alt)


@in_style
def candidate_bars(wins: pa.Table) -> Picture | None:
    """Candidates that each provider filled, and how many of them won. Rows of `candidate_wins`."""
    rows = wins.to_pylist()
    if not rows:
        return None
    labels = [f"{row['slot']}  {row['provider']}" for row in rows]
    filled, won = (np.array([row[key] for row in rows], dtype=np.float64) for key in ("filled", "wins"))
    figure, axes = canvas(1.5 + 0.27 * len(rows))
    y = np.arange(len(rows))
    axes.barh(y, filled, height=0.7, color=_GRAY, alpha=0.45, label="filled")
    axes.barh(y, won, height=0.42, color=_GREEN, label="ranked first")
    for at, (count, of) in enumerate(zip(won, filled, strict=True)):
        axes.annotate(f"{count:.0f} of {of:.0f}", (of, at), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
    _category_axis(axes, labels)
    axes.margins(x=0.16)
    axes.set_xlabel("candidates, by slot and provider")
    title = "Which candidates win"
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    best = max(rows, key=lambda row: (row["wins"], row["provider"]))
    alt = f"Candidates filled and ranked first, per slot and provider. Most wins: {best['provider']}, {best['wins']} of {best['filled']}."
    return picture(figure, "candidate_wins", title, alt)


@in_style
def deep_pair_counts(losses: pa.Table) -> Picture | None:
    """Pairs deeper than 2 mm before and after the optimization, the worst scenes first. Rows of `collision_loss`.

    Unlike the loss, whose unit is the method's, they compare over all scenes.
    """
    order = sorted(losses.to_pylist(), key=lambda row: (-row["deep_pairs_before"], row["scene_id"]))[:SCENE_LIMIT]
    if not order:
        return None
    before, after = (np.array([row[f"deep_pairs_{when}"] for row in order]) for when in ("before", "after"))
    figure, axes = canvas(1.6 + 0.26 * len(order))
    y = np.arange(len(order))
    axes.hlines(y, after, before, color=MUTED.light, linewidth=1.4, zorder=2)
    axes.plot(before, y, linestyle="none", marker="o", markersize=7, color=_ORANGE, label="proposed", zorder=3)
    axes.plot(after, y, linestyle="none", marker="o", markersize=5, color=_GREEN, label="optimized", zorder=3)
    _category_axis(axes, [row["scene_id"] for row in order])
    axes.margins(x=0.06)
    _whole_numbers(axes)
    axes.set_xlabel("pairs that penetrate deeper than 2 mm")
    title = "Collisions before and after"
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    alt = f"Pairs deeper than 2 mm in {len(order)} scenes: {before.sum()} as proposed, {after.sum()} after the optimization."
    return picture(figure, "collision_loss", title, alt)


@in_style
def stability_bars(rows: pa.Table) -> Picture | None:
    """Share of each scene's free objects that stay within 5 cm and within 1 cm, the least stable first. Rows of `stability`."""
    judged = [row for row in rows.to_pylist() if row["free"]]
    order = sorted(judged, key=lambda row: (row["stable_5cm_share"], row["stable_1cm_share"], row["scene_id"], row["engine"]))[:SCENE_LIMIT]
    if not order:
        return None
    five, one = (100 * np.array([row[f"stable_{limit}_share"] for row in order]) for limit in ("5cm", "1cm"))
    several = len({row["engine"] for row in order}) > 1
    figure, axes = canvas(1.5 + 0.27 * len(order))
    y = np.arange(len(order))
    axes.barh(y, five, height=0.7, color=_GRAY, alpha=0.45, label="5 cm and 5 degrees")
    axes.barh(y, one, height=0.42, color=_GREEN, label="1 cm")
    for at, row in enumerate(order):
        text = f"{row['stable_1cm']}, {row['stable_5cm']} of {row['free']}"
        axes.annotate(text, (max(five[at], one[at]), at), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
    _category_axis(axes, [f"{row['scene_id']} {row['engine']}" if several else row["scene_id"] for row in order])
    axes.set_xlim(0, 128)  # room for the numbers
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("free objects that stay within a limit [%]")
    title = "Stability under gravity"
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    total, fixed = (sum(row[key] for row in order) for key in ("free", "fixed"))
    alt = (
        f"Of {total} free objects in the scenes shown, {sum(row['stable_5cm'] for row in order)} stay within 5 cm and 5 degrees, "
        f"{sum(row['stable_1cm'] for row in order)} within 1 cm. {fixed} more are fixed."
    )
    return picture(figure, "stability", title, alt)


@in_style
def loss_curve(steps: pa.Table, method: str, scene_id: str) -> Picture | None:
    """Loss and smallest loss so far over the steps of a scene's optimization, on an axis that is logarithmic down to the
    smallest loss above zero and linear from there to zero. Rows of `optimization_steps`.

    The smallest loss is drawn at every step at which it falls; of many steps, the loss as the range that it takes.
    """
    rows = sorted(steps.select(["step", "loss", "smallest_loss"]).to_pylist(), key=lambda row: row["step"])
    if not rows:
        return None
    unit, factor, what = ("l", 1000.0, "overlap of the boxes") if method == "paper" else ("mm", 1000.0, "penetration depth")
    step, loss, smallest = (np.array([row[key] for row in rows], dtype=np.float64) for key in ("step", "loss", "smallest_loss"))
    loss, smallest = loss * factor, smallest * factor
    figure, axes = canvas(2.7)
    if len(rows) > _CURVE_POINTS:
        starts = np.linspace(0, len(rows), _CURVE_POINTS // 2 + 1).astype(np.int64)[:-1]
        low, high = np.minimum.reduceat(loss, starts), np.maximum.reduceat(loss, starts)
        axes.fill_between(step[starts], low, high, step="post", color=_ORANGE, alpha=0.45, linewidth=0, label="loss, its range")
    else:
        axes.plot(step, loss, color=_ORANGE, linewidth=1.1, drawstyle="steps-post", label="loss")
    falls = np.flatnonzero(np.diff(smallest, prepend=np.inf) < 0)
    ends = np.append(falls, len(rows) - 1)
    axes.plot(step[ends], smallest[ends], color=_BLUE, linewidth=1.8, drawstyle="steps-post", label="smallest so far")
    _loss_axis(axes, np.concatenate([loss, smallest]))
    axes.grid(visible=False, axis="x")
    axes.grid(visible=True, axis="y", color=GRID.light, linewidth=0.7)
    axes.set_xlim(0, 1.03 * max(step[-1], 1))  # a fall at the last step is to be seen
    _whole_numbers(axes)
    axes.set_xlabel("step" if method == "paper" else "step; moves that were taken back are left out")
    axes.set_ylabel(f"{what} [{unit}]")
    title = f"Loss, method {method}"
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.4)
    alt = (
        f"Collision loss of {scene_id} over {step[-1]:.0f} steps: {loss[0]:.3g} {unit} at the start, {smallest[-1]:.3g} {unit} in the end."
    )
    return picture(figure, f"loss_{scene_id}", title, alt)


@in_style
def navigable_bars(floors: pa.Table) -> Picture | None:
    """Share of each scene's floor that an agent can reach, the least navigable first. Rows of `navigability`."""
    rows = [row for row in floors.to_pylist() if row["navigable_share"] is not None]
    order = sorted(rows, key=lambda row: (row["navigable_share"], row["scene_id"], row["agent"]))[:SCENE_LIMIT]
    if not order:
        return None
    share = np.array([row["navigable_share"] for row in order]) * 100
    agents = {row["agent"] for row in order}
    labels = [row["scene_id"] if len(agents) == 1 else f"{row['scene_id']} {row['agent']}" for row in order]
    figure, axes = canvas(1.0 + 0.26 * len(order))
    _bars(axes, labels, share, SERIES[5].light, "{:.0f}%")
    axes.set_xlabel("navigable share of the floor [%]")
    title = "Navigable floor"
    axes.set_title(title)
    alt = f"Navigable share of the floor in {len(order)} scenes: {share.min():.0f}% to {share.max():.0f}%."
    return picture(figure, "navigability", title, alt)


def _whole_numbers(axes: Axes) -> None:
    """Ticks of the x axis at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


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


def _volume_axis(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis in plain numbers, over all values [m3]; a narrow one has ticks between the powers of ten too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = min(values) / 1.3, max(values) * 1.3
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    decades = np.log10(high / low)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if decades > 2.5 else (1.0, 2.0, 5.0), numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6f}".rstrip("0").rstrip(".")))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _bars(axes: Axes, labels: Sequence[str], values: Any, color: str, number: str) -> None:
    """Horizontal bars from top to bottom, each with its number."""
    axes.barh(np.arange(len(labels)), values, height=0.66, color=color)
    for at, value in enumerate(values):
        label = axes.annotate(number.format(value), (value, at), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
        label.set_bbox({"facecolor": PAPER.light, "edgecolor": "none", "pad": 0.8})
    _category_axis(axes, labels)
    axes.margins(x=0.1)


def _category_axis(axes: Axes, labels: Sequence[str]) -> None:
    """Labels down the left side, the first at the top."""
    axes.set_yticks(np.arange(len(labels)), [_short(label) for label in labels])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(labels) - 0.4, -0.6)


def _short(label: str, length: int = 28) -> str:
    """The label, cut in its middle when it is longer than a phone has place for."""
    keep = (length - 1) // 2
    return label if len(label) <= length else f"{label[:keep]}…{label[-keep:]}"


def _integer_bins(counts: Any) -> Any:
    """Bin edges at half integers, about twenty bins of equal whole width."""
    low, high = int(counts.min()), int(counts.max())
    width = max(1, -(-(high - low + 1) // 20))
    return np.arange(low, high + width + 1, width) - 0.5
