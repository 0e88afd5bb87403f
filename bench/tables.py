"""Reports of benchmarks as tables for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def headline(machine: Mapping[str, Any], seed: int, processes: int) -> str:
    """What was measured on, in one line."""
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}, {versions}; "
        f"seed {seed}, {processes} processes"
    )


def as_text(value: float | int | None, unit: str) -> str:
    """A figure as a person reads it; n/a for what nothing is known of."""
    if value is None or math.isnan(value):
        return "n/a"
    if unit == "percent":
        return f"{100 * value:.2f} %"
    if unit == "mm":
        return f"{1000 * value:.1f} mm"
    if unit == "score":
        return f"{value:.3f}"
    return f"{value:.2f}" if unit == "seconds" else f"{value:,}"


def table_of(title: str, *columns: tuple[str, bool]) -> Any:
    """An empty table; columns as (header, set to the right)."""
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE, show_edge=False, pad_edge=False)
    for header, right in columns:
        table.add_column(header, justify="right" if right else "left", no_wrap=right)
    return table


def add_row(table: Any, *cells: str) -> None:
    """A row whose cells are shown as they are: "[m]" is no markup."""
    from rich.text import Text

    table.add_row(*[Text(cell) for cell in cells])


def goals_table(goals: Sequence[Mapping[str, Any]]) -> Any:
    """A line for every goal: what was found, what was wanted, and whether it is met."""
    table = table_of("goals", ("", False), ("found", True), ("wanted", True), ("", False))
    for goal in goals:
        verdict = "n/a" if goal["met"] is None else "met" if goal["met"] else "MISSED"
        add_row(table, goal["goal"], "n/a" if goal["found"] is None else f"{goal['found']:.5g}", goal["wanted"], verdict)
    return table
