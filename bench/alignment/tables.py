"""The report of the alignment as tables: a table for each set of objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, as_text, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

COLUMNS = (
    ("method", False), ("yaw", True), ("<= 5", True), ("<= 15", True), ("place mm", True), ("sides %", True), ("surface mm", True),
    ("% diag", True), ("ms", True),
)  # fmt: skip


def print_alignment(report: Mapping[str, Any], console: Console) -> None:
    """Print medians of errors of yaw [degrees], place of the box's middle, sides and surface, shares of right yaws, milliseconds."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    for of in dict.fromkeys(row["set"] for row in report["figures"]):
        rows = [row for row in report["figures"] if row["set"] == of]
        table = table_of(f"{of}: {rows[0]['objects']} objects, {rows[0]['round']} of them round", *COLUMNS)
        for row in rows:
            add_row(
                table, row["method"], _plain(row["yaw_median"], 1), as_text(row["within_5"], "percent"),
                as_text(row["within_15"], "percent"), _plain(1000 * row["position_m_median"], 0), _plain(100 * row["scale_median"], 1),
                _plain(1000 * row["chamfer_m_median"], 1), _plain(100 * row["chamfer_share"], 2), _plain(row["milliseconds_median"], 1),
            )  # fmt: skip
        console.print(table)
    if report["skipped"]:
        console.print(f"not measured, hardly seen: {', '.join(report['skipped'])}")
    if report["without"]:
        console.print(report["without"])
    console.print(goals_table(report["goals"]))


def _plain(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:.{digits}f}"
