"""Tables of text: rows of a view in, cells for the report or for a terminal out."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import pyarrow as pa

ROW_LIMIT = 50
"""Rows that a table of the report shows; the SQL beside it gives all of them."""

OBJECT_LIMIT = 200
"""Objects that a table of one scene shows."""


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell as text; numbers are set to the right.

    raw: What it is sorted by and what a CSV file says, where that is not the text: a number in full, a column's name in the view.
    """

    text: str
    is_number: bool
    raw: str | None = None


@dataclasses.dataclass(frozen=True)
class Grid:
    """A table as text. `total` counts its rows and those that are not shown; `view` names the SQL behind it."""

    caption: str
    view: str
    headers: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]
    total: int


def portable(text: str) -> str:
    """Text without the folders of absolute paths: a report travels, and other machines have no such folders."""
    # folders after the first may have spaces in their names
    text = re.sub(r"(?:file://|(?<![\w.:/]))/[^\s/:;,'\"()<>]+/(?:[^/:;,'\"()<>\n]+/)*", "", text)
    return re.sub(r"\b[A-Za-z]:\\(?:[^\s\\:;,'\"]+\\)+", "", text)


def stage_table(timing: pa.Table, stages: Sequence[str]) -> str:
    """Times per stage as plain text: total, median and 95th percentile per run, and per object. Rows of `stage_timing`."""
    rows = sorted(timing.to_pylist(), key=lambda row: place(row["stage"], stages))
    if not rows:
        return "no stage has run"
    lines = [("stage", "scenes", "runs", "total s", "median s", "p95 s", "s per object")]
    for row in rows:
        each = row["seconds_per_object"]
        lines.append(
            (
                row["stage"],
                str(row["scenes"]),
                str(row["runs"]),
                f"{row['total_seconds']:.2f}",
                f"{row['median_seconds']:.2f}",
                f"{row['p95_seconds']:.2f}",
                "-" if each is None else f"{each:.3f}",
            )
        )
    lines.append(("all", "", "", f"{sum(row['total_seconds'] for row in rows):.2f}", "", "", ""))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    aligned = (
        [text.ljust(width) if at == 0 else text.rjust(width) for at, (text, width) in enumerate(zip(line, widths, strict=True))]
        for line in lines
    )
    return "\n".join("  ".join(line).rstrip() for line in aligned)


Format = Callable[[Any], str]


def as_count(value: Any) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{value:,}".replace(",", "\u202f")


def as_number(value: Any) -> str:
    """Three significant digits, without an exponent where people would not use one."""
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return as_count(round(value))
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 6)}f}"


def as_percent(value: Any) -> str:
    """A share as a whole percentage."""
    return f"{100 * value:.0f}%"


def as_share(value: Any) -> str:
    """A share as a percentage with one decimal: 100% means all, 0% means none."""
    rounded = round(100 * value, 1)
    return f"{min(max(rounded, 0.1), 99.9) if 0 < value < 1 else rounded:g}%"


def as_size(value: Any) -> str:
    """Bytes as kB or MB."""
    return f"{value / 1e6:.1f} MB" if value >= 1e5 else f"{value / 1e3:.1f} kB"


def as_text(value: Any) -> str:
    """Any value as text that names no folder of this machine."""
    return portable(str(value))


def as_start(value: Any) -> str:
    """The first digits of a hash, enough to tell one from another."""
    return str(value)[:12]


def as_yes(value: Any) -> str:
    """A verdict."""
    return "yes" if value else "no"


def as_box(value: Any) -> str:
    """Edges of a box [m]."""
    return " \u00d7 ".join(f"{edge:.2f}" for edge in value)


def grid(
    caption: str, view: str, rows: pa.Table, columns: Sequence[tuple[str, str, Format]], total: int | None = None, limit: int = ROW_LIMIT
) -> Grid:
    """Columns of an Arrow table as text: (column, header, format) each. A missing value is a dash.

    `rows` may be the first of `total`; no more than `limit` of them are shown.
    """
    numeric = [form in (as_count, as_number, as_percent, as_share, as_size, as_box) for _, _, form in columns]
    shown = rows.slice(0, limit).select([name for name, _, _ in columns]).to_pylist()
    cells = tuple(
        tuple(
            Cell("\u2013" if row[name] is None else form(row[name]), is_number, raw(row[name], is_number))
            for (name, _, form), is_number in zip(columns, numeric, strict=True)
        )
        for row in shown
    )
    headers = tuple(Cell(header, is_number, name) for (name, header, _), is_number in zip(columns, numeric, strict=True))
    return Grid(caption, view, headers, cells, max(total or 0, rows.num_rows))


def raw(value: Any, is_number: bool) -> str | None:
    """A value as a CSV file says it, where its text says less: numbers in full, several with spaces between, nothing for a missing one."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return " ".join(map(str, value))
    return str(value) if is_number else None


def place(stage: str, stages: Sequence[str]) -> tuple[int, str]:
    """Place of a stage in the order of the data path; unknown ones come last."""
    return (list(stages).index(stage) if stage in stages else len(stages), stage)
