"""A lineage as a picture: what was exported on the left, the scan on the right, a box per node and a line per link."""

from __future__ import annotations

import io
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from schemas.lineage import Edge, Lineage, Node
from tasks.lineage.words import described, moment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMATS = (".svg", ".png")
"""Endings of the files that pictures are written to."""

_WIDTH, _GAP = 2.5, 0.7
"""Of a box, and between two columns, in inches: a box holds a line, and a link between columns its role."""

_HEIGHT, _SPACE = 0.72, 0.2
"""Of a box, and between two below each other, in inches."""

_LETTERS = 38
"""In a line of a box."""
_DPI = 130

_INK, _MUTED, _LINE, _PAPER, _RED = "#1c2430", "#566170", "#b4bdc8", "#ffffff", "#c53030"

_COLORS = {
    "capture": "#0e7490", "captions": "#6b46c1", "candidates": "#b0500f", "selection": "#8a6d0b", "annotation": "#b83280",
    "optimization": "#2b6cb0", "navigation": "#2f7d55", "exports": "#64707f",
}  # fmt: skip
"""Of the stage that wrote a node; each is legible on white."""

_SETTINGS: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same letters on every machine
    "svg.fonttype": "none",
    "svg.hashsalt": "lineage",
    "path.simplify": False,
}


def draw_lineage(lineage: Lineage, ending: str) -> bytes:
    """A picture of a lineage as SVG (`.svg`) or PNG (`.png`); the same lineage gives the same bytes.

    In the SVG every node is a group with the node's id.
    """
    import matplotlib
    from matplotlib.figure import Figure

    columns = _columns(lineage)
    rows = max(len(column) for column in columns)
    width = len(columns) * (_WIDTH + _GAP) - _GAP + 0.6
    height = rows * (_HEIGHT + _SPACE) + 1.0
    with matplotlib.rc_context(_SETTINGS):
        figure = Figure(figsize=(width, height), facecolor=_PAPER)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, width)
        axes.set_ylim(0, height)
        axes.set_axis_off()
        _title(axes, lineage, height)
        places = _places(columns, height)
        leaving, arriving = Counter(e.source for e in lineage.edges), Counter(e.target for e in lineage.edges)
        for edge in lineage.edges:
            fans_out = leaving[edge.source] > arriving[edge.target]
            _draw_edge(axes, edge, places, lineage.nodes[edge.target].is_missing, fans_out)
        for node in lineage.nodes.values():
            _draw_node(axes, node, places[node.id], _stage(lineage, node), node.id == lineage.target)
        sink = io.BytesIO()
        metadata: dict[str, Any] = {"Date": None, "Creator": None, "Title": _name(lineage)} if ending == ".svg" else {"Software": None}
        figure.savefig(sink, format=ending.removeprefix("."), dpi=_DPI, metadata=metadata)
    return sink.getvalue()


def _name(lineage: Lineage) -> str:
    return described(lineage.nodes[lineage.target])[0]


def _stage(lineage: Lineage, node: Node) -> str | None:
    run = lineage.runs.get(node.run or "")
    return run.stage if run is not None else None


def _columns(lineage: Lineage) -> list[list[str]]:
    """Nodes by column, from what was made last to what it was made from; every link goes from left to right."""
    targets: dict[str, list[str]] = {node: [] for node in lineage.nodes}
    sources: dict[str, list[str]] = {node: [] for node in lineage.nodes}
    for edge in lineage.edges:
        targets[edge.source].append(edge.target)
        sources[edge.target].append(edge.source)
    rank: dict[str, int] = {}
    for node in lineage.nodes:
        _rank(node, targets, rank, set())
    for node in lineage.nodes:
        if not targets[node] and sources[node]:  # what ends a branch stands beside it, not at the far end
            rank[node] = min(rank[source] for source in sources[node]) - 1
    first = max(rank.values())
    columns: list[list[str]] = [[] for _ in range(first - min(rank.values()) + 1)]
    for node in [*dict.fromkeys(node for _, _, node in lineage.outline), *lineage.nodes]:
        column = columns[first - rank[node]]
        if node not in column:
            column.append(node)
    columns = [column for column in columns if column]
    _untangle(columns, targets, sources)
    return columns


def _rank(node: str, targets: Mapping[str, Sequence[str]], rank: dict[str, int], above: set[str]) -> int:
    """Links on the longest way from a node to where nothing follows. A link back to what is `above` does not count."""
    if node not in rank:
        below = [_rank(target, targets, rank, above | {node}) for target in targets[node] if target not in above | {node}]
        rank[node] = 1 + max(below, default=-1)
    return rank[node]


def _untangle(columns: list[list[str]], targets: Mapping[str, Sequence[str]], sources: Mapping[str, Sequence[str]]) -> None:
    """Order each column by where its neighbors are, to and fro."""
    for turn in range(8):
        heights = {node: (index + 0.5) / len(column) for column in columns for index, node in enumerate(column)}
        for column in columns if turn % 2 else columns[::-1]:
            mean = {}
            for index, node in enumerate(column):
                near = [heights[other] for other in (*targets[node], *sources[node])]
                mean[node] = (sum(near) / len(near) if near else heights[node], index)
            column.sort(key=mean.__getitem__)
            heights |= {node: (index + 0.5) / len(column) for index, node in enumerate(column)}


def _places(columns: list[list[str]], height: float) -> dict[str, tuple[float, float]]:
    """Lower left corner of every box, in inches; columns are centered."""
    places = {}
    middle = (height - 0.7) / 2
    for number, column in enumerate(columns):
        top = middle + len(column) * (_HEIGHT + _SPACE) / 2 - _SPACE / 2
        if len(column) == 1 and len(columns) > 1 and height > 3 * _HEIGHT:  # or a link past a lonely box would be hidden by it
            top += (_HEIGHT + _SPACE) / 2 * (-1) ** number
        for index, node in enumerate(column):
            places[node] = (0.3 + number * (_WIDTH + _GAP), top - _HEIGHT - index * (_HEIGHT + _SPACE))
    return places


def _title(axes: Axes, lineage: Lineage, height: float) -> None:
    snapshot = lineage.snapshot
    released = f", release {', '.join(lineage.releases)}" if lineage.releases else ""
    wrong = f"{len(lineage.problems)} problems: see the text" if lineage.problems else "every id leads to a row"
    text = f"snapshot {snapshot.snapshot_id} of {moment(snapshot.created_at.isoformat())}{released}; {wrong}"
    axes.text(0.3, height - 0.32, _plain(_name(lineage), 150), fontsize=11, fontweight="bold", color=_INK, va="center")
    axes.text(0.3, height - 0.56, text, fontsize=8, color=_RED if lineage.problems else _MUTED, va="center")


def _draw_node(axes: Axes, node: Node, place: tuple[float, float], stage: str | None, is_target: bool) -> None:
    from matplotlib.patches import FancyBboxPatch, Rectangle

    x, y = place
    color = _RED if node.is_missing else _COLORS.get(stage or "", _MUTED)
    box = FancyBboxPatch(
        (x, y), _WIDTH, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.06", facecolor="#eef4fb" if is_target else "#f8f9fb",
        edgecolor=color, linewidth=1.8 if is_target else 0.9, linestyle="--" if node.is_missing else "-", zorder=3, gid=node.id,
    )  # fmt: skip
    axes.add_patch(box)
    axes.add_patch(Rectangle((x, y + 0.06), 0.05, _HEIGHT - 0.12, facecolor=color, zorder=4, linewidth=0))
    kind = node.kind.replace("_", " ") + (f" · {stage}" if stage is not None else "")
    axes.text(x + 0.13, y + _HEIGHT - 0.13, kind, fontsize=7, fontweight="bold", color=color, va="center", zorder=5)
    lines = _lines(described(node))
    for number, line in enumerate(lines):
        axes.text(
            x + 0.13, y + _HEIGHT - 0.3 - 0.15 * number, line, fontsize=7, color=_INK if number == 0 else _MUTED, va="center", zorder=5
        )


def _lines(texts: Sequence[str]) -> list[str]:
    """At most three lines of a box."""
    first = textwrap.wrap(texts[0], _LETTERS)[0] if texts[0] else ""
    rest = texts[0][len(first) :].strip()
    if len(rest) > _LETTERS and " " not in rest:
        rest = "…" + rest[1 - _LETTERS :]  # paths differ at their ends
    return [_plain(line, _LETTERS) for line in (first, *([rest] if rest else []), *texts[1:])][:3]


def _plain(text: str, most: int) -> str:
    """Text that matplotlib takes as it is, cut to `most` letters."""
    text = text if len(text) <= most else text[: most - 1] + "…"
    return text.replace("$", r"\$")


def _draw_edge(axes: Axes, edge: Edge, places: Mapping[str, tuple[float, float]], is_missing: bool, fans_out: bool) -> None:
    """A link with its role, which stands where links lie apart: near the target where several leave one source."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    (x0, y0), (x1, y1) = places[edge.source], places[edge.target]
    start, end = (x0 + _WIDTH, y0 + _HEIGHT / 2), (x1, y1 + _HEIGHT / 2)
    bend = _GAP * 0.6
    curve = Path([start, (start[0] + bend, start[1]), (end[0] - bend, end[1]), end], [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4])
    color = _RED if is_missing else _LINE
    axes.add_patch(FancyArrowPatch(path=curve, arrowstyle="-|>", mutation_scale=7, color=color, linewidth=0.9, fill=False, zorder=1))
    if end[0] - start[0] < 1.5 * _GAP:  # a longer link runs below boxes, and its role would, too
        x, y = _on(start, end, bend, 0.72 if fans_out else 0.28)
        axes.text(
            x, y, edge.role, fontsize=6, color=_MUTED, ha="center", va="center", zorder=2,
            bbox={"facecolor": _PAPER, "edgecolor": "none", "pad": 0.4},
        )  # fmt: skip


def _on(start: tuple[float, float], end: tuple[float, float], bend: float, share: float) -> tuple[float, float]:
    """A point on the curve of a link."""
    t, u = share, 1 - share
    x = u**3 * start[0] + 3 * u * u * t * (start[0] + bend) + 3 * u * t * t * (end[0] - bend) + t**3 * end[0]
    return x, (u**3 + 3 * u * u * t) * start[1] + (3 * u * t * t + t**3) * end[1]
