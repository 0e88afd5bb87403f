"""How many there are of what: histograms per scene (supplementary, Fig. A6), categories, categories by room type, growth."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pyarrow as pa

from tasks.stats.axes import bars, category_axis, heat_cells, integer_bins, short
from tasks.stats.style import GRID, INK, MUTED, SERIES, Picture, canvas, chart, in_style, panels, picture
from tasks.stats.tips import columns as tell_columns
from tasks.stats.tips import lines

SCENE_LIMIT = 20
"""Scenes with a bar of their own; of more, a histogram is drawn, or those that matter most."""

CATEGORY_LIMIT = 40
"""Categories with a bar of their own, and rows of the heat map."""

ROOM_TYPE_LIMIT = 8
"""Columns of the heat map; a phone has place for no more. Rarer room types are put together."""

RELEASE_LIMIT = 24
"""Releases in the picture of growth, the newest."""

GROWING = ("scenes", "rooms", "objects", "categories", "assets", "episodes")
"""Columns of `dataset_growth` that are drawn."""

_BLUE, _ORANGE = SERIES[0].light, SERIES[1].light


@in_style
def per_scene(histogram: pa.Table, scenes: pa.Table, column: str, noun: str) -> Picture | None:
    """How many `noun` (objects, categories) scenes hold: one bar a scene, or a histogram of many scenes.

    Args:
        histogram: The integer `column`, and `scenes`: how many scenes hold that many.
        scenes: `scene_id` and `column` of the first scenes, all of them where they are few.
        column: Column that is counted.
        noun: What it counts.
    """
    if not histogram.num_rows:
        return None
    values, times = (np.asarray(histogram[name].to_pylist(), dtype=np.int64) for name in (column, "scenes"))
    count, median = int(times.sum()), weighted_median(values, times)
    title = f"{noun.capitalize()} per scene"
    alt = f"{title}: {count} scene{'s' if count > 1 else ''}, {values.min()} to {values.max()} {noun}, median {median:g}."
    name = f"{column}_per_scene"
    if count <= SCENE_LIMIT:
        axes = canvas(0.9 + 0.24 * count)
        bars(axes, scenes["scene_id"].to_pylist(), np.asarray(scenes[column].to_pylist(), dtype=np.int64), _BLUE, "{:.0f}", noun)
        axes.axvline(median, color=_ORANGE, linewidth=1.2, linestyle="--", zorder=0.9)
        axes.set_xlabel(f"{noun}; dashed: median {median:g}")
    else:
        axes = canvas(2.8)
        edges = integer_bins(values)
        heights, _ = np.histogram(values, bins=edges, weights=times)
        spans = list(itertools.pairwise(edges.tolist()))
        tell_columns(axes, [_bin(span, height, noun) for span, height in zip(spans, heights, strict=True)], spans)
        axes.hist(values, bins=edges, weights=times, color=_BLUE, edgecolor=_BLUE, linewidth=0.4, alpha=0.85)
        axes.axvline(median, color=_ORANGE, linewidth=1.4, linestyle="--")
        axes.grid(visible=False, axis="x")
        axes.grid(visible=True, axis="y", color=GRID.light, linewidth=0.7)
        axes.set_xlabel(f"{noun} in the scene; dashed: median {median:g}")
        axes.set_ylabel("scenes")
    return chart(axes, name, title, alt)


def _bin(span: tuple[float, float], scenes: float, noun: str) -> str:
    """A bar of a histogram in words; its edges are half integers."""
    low, high = round(span[0] + 0.5), round(span[1] - 0.5)
    return f"{low if low == high else f'{low} to {high}'} {noun}: {scenes:.0f} scene{'' if scenes == 1 else 's'}"


def weighted_median(values: Any, times: Any) -> float:
    """The median of whole numbers of which each occurs so many times; the mean of the middle two of an even count."""
    order = np.argsort(values)
    ends = np.cumsum(np.asarray(times)[order])
    middle = [(ends[-1] - 1) // 2, ends[-1] // 2]
    return float(np.mean(np.asarray(values)[order][np.searchsorted(ends, middle, side="right")]))


@in_style
def category_bars(counts: pa.Table, total: int) -> Picture | None:
    """Objects of the most frequent categories and the scenes that hold one. Rows of `category_counts`, the most frequent first.

    `total` counts all categories.
    """
    rows = counts.slice(0, CATEGORY_LIMIT).to_pylist()
    if not rows:
        return None
    axes = canvas(1.4 + 0.185 * len(rows))
    y = np.arange(len(rows))
    objects, scenes = (np.array([row[key] for row in rows]) for key in ("objects", "scenes"))
    axes.barh(y, objects, height=0.7, color=_BLUE, alpha=0.85, label="objects")
    axes.plot(scenes, y, linestyle="none", marker="|", markersize=7, markeredgewidth=1.8, color=_ORANGE, label="scenes with one")
    category_axis(axes, [f"{row['category']} ({thousands(row['objects'])})" for row in rows])
    lines(axes, [f"{row['category']}: {row['objects']} objects in {row['scenes']} scenes" for row in rows])
    axes.tick_params(axis="y", labelsize=8)
    axes.set_xlim(0, 1.04 * objects.max())
    _short_numbers(axes, "x", integer=True)
    axes.set_xlabel("objects" if len(rows) == total else f"objects, the {len(rows)} most frequent of {thousands(total)} categories")
    title = "Objects per category"
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    few = ", ".join(f"{row['category']} ({row['objects']} in {row['scenes']} scenes)" for row in rows[:3])
    return chart(axes, "category_counts", title, f"{title}, {len(rows)} of {total} categories. Most frequent: {few}.")


@in_style
def room_map(cells: pa.Table) -> Picture | None:
    """Heat map: in which kinds of room the objects of a category stand.

    A row is a category, and its colors say which share of its objects stands in each kind of room; the numbers count them.
    `cells`: category, room_type, objects, the most frequent categories only.
    """
    rows = cells.to_pylist()
    if not rows:
        return None
    total: dict[str, int] = {}
    in_type: dict[str, int] = {}
    for row in rows:
        total[row["category"]] = total.get(row["category"], 0) + row["objects"]
        in_type[row["room_type"]] = in_type.get(row["room_type"], 0) + row["objects"]
    categories = sorted(total, key=lambda name: (-total[name], name))[:CATEGORY_LIMIT]
    types = sorted(in_type, key=lambda name: (-in_type[name], name))
    kept = types if len(types) <= ROOM_TYPE_LIMIT else types[: ROOM_TYPE_LIMIT - 1]
    columns = [*kept, *(["other types"] if len(kept) < len(types) else [])]
    objects = np.zeros((len(categories), len(columns)), dtype=np.int64)
    place = {name: at for at, name in enumerate(categories)}
    for row in rows:
        if row["category"] in place:
            objects[place[row["category"]], kept.index(row["room_type"]) if row["room_type"] in kept else -1] += row["objects"]
    axes = canvas(1.5 + 0.185 * len(categories))
    share = objects / objects.sum(axis=1, keepdims=True)
    heat_cells(axes, categories, columns, share, [[thousands(int(count)) if count else "" for count in row] for row in objects])
    title = "Categories by room type"
    axes.figure.supxlabel(
        f"Color: share of the category's objects, at most {share.max():.0%}. Number: objects.", fontsize=8, color=MUTED.light
    )
    strongest = max(np.ndindex(*objects.shape), key=lambda at: (objects[at], -at[0], -at[1]))
    alt = (
        f"Heat map of {len(categories)} categories in {len(types)} room types. Most objects: "
        f"{categories[strongest[0]]} in {columns[strongest[1]]}, {objects[strongest]}."
    )
    return chart(axes, "category_by_room_type", title, alt)


@in_style
def growth(rows: pa.Table) -> Picture | None:
    """What each release holds, one panel a quantity. Rows of `dataset_growth`, the oldest first; the newest are drawn."""
    releases = rows.to_pylist()[-RELEASE_LIMIT:]
    if not releases:
        return None
    figure, grid = panels(2, 3, 3.1 + (0.35 if len(releases) > 4 else 0.0))
    x = np.arange(len(releases))
    for axes, column in zip(grid, GROWING, strict=True):
        values = np.array([row[column] for row in releases])
        axes.bar(x, values, width=0.72, color=_BLUE, alpha=0.85)
        texts = [f"{row['name']}: {row[column]} {column}" for row in releases]
        tell_columns(axes, texts, [(at - 0.5, at + 0.5) for at in range(len(releases))])
        axes.annotate(
            thousands(int(values[-1])),
            (x[-1], values[-1]),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=7.5,
        )
        axes.set_title(column, fontsize=8.5, fontweight="normal")
        axes.set_ylim(0, 1.18 * max(1, values.max()))
        axes.set_xlim(-0.6, max(len(releases) - 0.4, 1.6))
        axes.grid(visible=False, axis="x")
        axes.grid(visible=True, axis="y", color=GRID.light, linewidth=0.7)
        _short_numbers(axes, "y", integer=True)
        axes.tick_params(axis="both", labelsize=7, length=0)
        shown = sorted({0, len(releases) - 1}) if len(releases) > 4 else range(len(releases))
        names = [short(releases[at]["name"], 9) for at in shown]
        wide = sum(map(len, names)) > 14
        axes.set_xticks(list(shown), names, rotation=35 if wide else 0, ha="right" if wide else "center")
    title = "Growth over releases"
    figure.suptitle(title, x=0.012, ha="left", fontsize=10, fontweight="bold", color=INK.light)
    first, last = releases[0], releases[-1]
    if len(releases) == 1:
        alt = f"{title}: {last['name']} holds " + ", ".join(f"{last[c]} {c}" for c in GROWING) + "."
    else:
        steps = ", ".join(f"{first[c]} to {last[c]} {c}" for c in GROWING)
        alt = f"{title}, from {first['name']} to {last['name']}: {steps}."
    return picture(figure, "dataset_growth", title, alt)


def thousands(value: int) -> str:
    """A count in at most four characters or so: 950, 1.2k, 38k, 4.0M."""
    for limit, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= limit:
            scaled = value / limit
            return f"{scaled:.1f}{unit}" if scaled < 9.95 else f"{scaled:.0f}{unit}"
    return str(value)


def _short_numbers(axes: Any, which: str, integer: bool = False) -> None:
    """Ticks as short counts, few of them."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_locator(MaxNLocator(5 if which == "x" else 4, integer=integer))
    axis.set_major_formatter(FuncFormatter(lambda value, _: thousands(round(value)) if value >= 0 else ""))
