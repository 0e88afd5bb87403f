"""The report of a campaign of kills as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console


def print_campaign(report: Mapping[str, Any], console: Console) -> None:
    """Print a report."""
    console.print(headline(report["machine"], report["seed"], 1))
    table = table_of("batches", ("kind", False), ("batches", True), ("operations", True), ("kills", True), ("full disks", True),
                     ("hours", True), ("faults", True))  # fmt: skip
    for kind, totals in report["kinds"].items():
        numbers = [f"{totals[name]:,}" for name in ("batches", "operations", "kills", "full")]
        add_row(table, kind, *numbers, f"{totals['hours']:.2f}", f"{totals['faults']:,}")
    console.print(table)
    table = table_of("what was killed, and how", ("", False), ("kills", True))
    for what, count in report["kills"].items():
        add_row(table, what, f"{count:,}")
    for what, count in report["full"].items():
        add_row(table, f"{what} on a full disk", f"{count:,}")
    console.print(table)
    console.print(f"{sum(report['kills'].values()):,} kills in {report['hours']:.2f} hours", markup=False)
    for fault in report["faults"]:
        console.print(f"  {fault}", markup=False)
    console.print(goals_table(report["goals"]))
