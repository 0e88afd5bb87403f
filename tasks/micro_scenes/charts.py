"""What belongs to which large object: pairs of categories (supplementary, Fig. A10), kinds of room (A11), drawn layouts of one (A8)."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

import numpy as np
import pyarrow as pa

from tasks.stats.axes import heat_cells
from tasks.stats.counts import CATEGORY_LIMIT, thousands
from tasks.stats.style import GRID, INK, MUTED, WIDTH_INCHES, Picture, canvas, chart, in_style, panels, picture
from tasks.stats.tips import name_mark
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.pictures import color_of, footprint

LARGE_LIMIT = 10
"""Columns of the map of pairs; rarer large categories are put together."""

PANEL_LIMIT = 3
"""Panels of the map of kinds of room: all large objects, then the most frequent categories of them that stand in two kinds."""

PANEL_LINES = 12
"""Small categories in each of these panels."""

LAYOUT_LIMIT = 6
"""Drawn layouts of one large object that are shown beside each other."""

LEGEND_COLUMNS = 4
"""Names of categories beside each other below them."""


@in_style
def pair_map(pairs: pa.Table) -> Picture | None:
    """Heat map: how many small objects of a category belong to large ones of a category. Rows of `micro_scene_pairs`.

    Colors say which share of a large category's small objects a cell is.
    """
    rows = pairs.to_pylist()
    if not rows:
        return None
    of_small, of_large = Counter[str](), Counter[str]()
    for row in rows:
        of_small[row["category"]] += row["objects"]
        of_large[row["large_category"]] += row["objects"]
    lines, kept = _ranked(of_small)[:CATEGORY_LIMIT], _ranked(of_large)
    neighbors = kept[LARGE_LIMIT - 1 :] if len(kept) > LARGE_LIMIT else []
    kept = kept[: len(kept) - len(neighbors)]
    columns = [*kept, *(["others"] if neighbors else [])]
    objects = np.zeros((len(lines), len(columns)), dtype=np.int64)
    for row in rows:
        if row["category"] in lines:
            column = kept.index(row["large_category"]) if row["large_category"] in kept else -1
            objects[lines.index(row["category"]), column] += row["objects"]
    totals = [of_large[name] for name in kept] + ([sum(of_large[name] for name in neighbors)] if neighbors else [])
    share = objects / np.array(totals)
    axes = canvas(1.9 + 0.185 * len(lines))
    texts = [[thousands(int(count)) if count else "" for count in line] for line in objects]
    heat_cells(axes, [_words(name) for name in lines], [_words(name) for name in columns], share, texts)
    _note(axes, f"Color: share of what is on the large category, at most {share.max():.0%}. Number: objects.")
    title = "Small objects on large ones"
    strongest = max(rows, key=lambda row: (row["objects"], row["large_category"], row["category"]))
    alt = (
        f"Heat map of {len(lines)} of {len(of_small)} small categories on {len(of_large)} large ones. Most objects: "
        f"{_words(strongest['category'])} on {_words(strongest['large_category'])}, {strongest['objects']}."
    )
    return chart(axes, "micro_scene_pairs", title, alt)


@in_style
def room_type_map(cells: pa.Table) -> Picture | None:
    """Heat maps: which small objects belong to large ones in which kinds of room. Rows of `micro_scene_by_room_type`.

    A column adds up to 100 % over all small categories. The first panel is of all large objects, the others are of one category each,
    of those that stand in at least two kinds of room the most frequent ones: how a room changes what is on the same furniture.
    """
    rows = cells.to_pylist()
    if not rows:
        return None
    in_type, of_large = Counter[str](), Counter[str]()
    types_of: dict[str, set[str]] = {}
    for row in rows:
        in_type[row["room_type"]] += row["objects"]
        of_large[row["large_category"]] += row["objects"]
        types_of.setdefault(row["large_category"], set()).add(row["room_type"])
    types = sorted(in_type, key=lambda name: (name == "unknown", -in_type[name], name))
    compared = [name for name in _ranked(of_large) if len(types_of[name] - {"unknown"}) > 1][: PANEL_LIMIT - 1]
    parts = [("all large objects", rows)]
    parts += [(_words(name), [row for row in rows if row["large_category"] == name]) for name in compared]
    counted = [_by_room_type(part, types) for _, part in parts]
    figure, grid = panels(len(parts), 1, 1.1 + sum(0.62 + 0.185 * len(lines) for lines, _ in counted))
    for axes, (name, _), (lines, share) in zip(grid, parts, counted, strict=True):
        texts = [["" if not part else "<1%" if part < 0.005 else f"{part:.0%}" for part in line] for line in share]
        heat_cells(axes, [_words(line) for line in lines], types, share, texts)
        axes.set_title(name, fontsize=8.5, fontweight="normal")
    title = "Small objects by room type"
    figure.suptitle(title, x=0.012, ha="left", fontsize=10, fontweight="bold", color=INK.light)
    _note(grid[0], "Share of the small objects in rooms of the kind.")
    lines, share = counted[0]
    first, at = np.unravel_index(int(np.argmax(share)), share.shape)
    alt = (
        f"Heat maps of small categories in {len(types)} room type{'s' if len(types) > 1 else ''}, for "
        f"{', '.join(name for name, _ in parts)}. Largest share: {_words(lines[first])} in {types[at]}, {share[first, at]:.0%}."
    )
    return picture(figure, "micro_scene_by_room_type", title, alt)


@in_style
def drawn_layouts(objects: pa.Table) -> Picture | None:
    """Layouts that one model drew on one and the same large object, from above. Rows of `synthesis_layouts`, of that object alone.

    Up is +X, the front of the large object, left is +Y. A box is in the color of its category, and higher ones lie above lower ones.
    """
    from matplotlib.patches import Patch

    layouts = _layouts(objects)[:LAYOUT_LIMIT]
    if not layouts:
        return None
    large = layouts[0].large
    low, high = _seen(layouts)
    lines = -(-len(layouts) // 2)
    inches = 0.5 * WIDTH_INCHES * (high[1] - low[1]) / (high[0] - low[0])
    used = sorted({name for layout in layouts for name in layout.categories})
    figure, grid = panels(lines, 2, 0.75 + lines * (0.12 + min(inches, 3.0)) + 0.19 * -(-len(used) // LEGEND_COLUMNS))
    for axes, layout in itertools.zip_longest(grid, layouts):
        axes.axis("off")
        if layout is not None:
            _draw(axes, layout)
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], high[1])
            axes.set_aspect("equal")
    title = "Layouts drawn on one large object"
    size = " x ".join(f"{extent:.2f}" for extent in large.size)
    what = f"{_words(large.category)}, {size} m, {large.room_type}"
    figure.suptitle(f"{title}\n", x=0.012, ha="left", fontsize=10, fontweight="bold", color=INK.light)
    figure.text(0.012, 1 - 0.29 / figure.get_figheight(), what, fontsize=8.5, va="center", color=MUTED.light)
    if used:
        patches = [Patch(facecolor=_tinted(name), edgecolor=_solid(name), label=_words(name)) for name in used]
        figure.legend(handles=patches, loc="outside lower center", ncols=LEGEND_COLUMNS, fontsize=7, handlelength=1.0, columnspacing=1.0)
    counts = ", ".join(str(len(layout)) for layout in layouts)
    alt = f"{title}: {len(layouts)} on a {what}, seen from above, of {counts} objects."
    return picture(figure, "synthesis_layouts", title, alt)


def _layouts(objects: pa.Table) -> list[Layout]:
    """A layout per scene, in the order of the rows."""
    made = []
    for _, group in itertools.groupby(objects.to_pylist(), lambda row: row["scene_id"]):
        rows = list(group)
        drawn = [row for row in rows if row["instance_id"] is not None]
        depth, width, height = rows[0]["large_box_size"]
        centers, sizes = (np.array([row[name] for row in drawn]) for name in ("box_center", "box_size"))
        large = Large(rows[0]["large_category"], (depth, width, height), rows[0]["room_type"])
        made.append(
            Layout(large, tuple(row["category"] for row in drawn), centers, sizes, np.radians([row["yaw_degrees"] for row in drawn]))
        )
    return made


def _seen(layouts: list[Layout]) -> tuple[Any, Any]:
    """Corners of what is shown of every layout [m]: the large object, and what reaches over its edge by no more than half of it."""
    half = 0.5 * np.array([layouts[0].large.size[1], layouts[0].large.size[0]])
    corners = [_turned(footprint(layout, at)) for layout in layouts for at in range(len(layout))]
    reach = np.abs(np.concatenate([half[None, :], *corners])).max(axis=0)
    reach = np.minimum(reach, 2.0 * half) + 0.02 * half.max()
    return -reach, reach


def _draw(axes: Any, layout: Layout) -> None:
    from matplotlib.patches import Polygon, Rectangle

    depth, width, _ = layout.large.size
    axes.add_patch(Rectangle((-0.5 * width, -0.5 * depth), width, depth, facecolor=GRID.light, edgecolor=MUTED.light, alpha=0.6))
    tops = layout.centers[:, 2] + 0.5 * layout.sizes[:, 2]
    for at in np.argsort(tops, kind="stable").tolist():
        name = layout.categories[at]
        box = Polygon(_turned(footprint(layout, at)), facecolor=_tinted(name), edgecolor=_solid(name), linewidth=1.0)
        name_mark(box, f"{_words(name)}, {' x '.join(f'{extent:.2f}' for extent in layout.sizes[at])} m")
        axes.add_patch(box)


def _turned(points: Any) -> Any:
    """Points of the plane of a large object as they are drawn: +X up, +Y left, shape (n, 2)."""
    return np.column_stack([-points[:, 1], points[:, 0]])


def _solid(category: str) -> tuple[float, float, float]:
    red, green, blue = color_of(category)
    return red / 255, green / 255, blue / 255


def _tinted(category: str) -> tuple[float, float, float, float]:
    """A color through which what lies below is seen."""
    return (*_solid(category), 0.55)


def _by_room_type(rows: list[dict[str, Any]], types: list[str]) -> tuple[list[str], Any]:
    """The most frequent small categories, and their shares in kinds of room, shape (categories, types)."""
    counts = Counter[tuple[str, str]]()
    for row in rows:
        counts[row["category"], row["room_type"]] += row["objects"]
    of_small, in_type = Counter[str](), Counter[str]()
    for (category, room_type), objects in counts.items():
        of_small[category] += objects
        in_type[room_type] += objects
    lines = _ranked(of_small)[:PANEL_LINES]
    return lines, np.array([[counts[line, kind] / max(in_type[kind], 1) for kind in types] for line in lines])


def _ranked(counts: Counter[str]) -> list[str]:
    """Names, the most frequent first."""
    return sorted(counts, key=lambda name: (-counts[name], name))


def _words(category: str) -> str:
    return category.replace("_", " ")


def _note(axes: Any, text: str) -> None:
    axes.figure.supxlabel(text, fontsize=8, color=MUTED.light)
