"""The benchmark's report as tables for people."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

FIGURES: tuple[tuple[str, str, str], ...] = (
    ("things", "things", "count"),
    ("unplaced", "instances that nothing was placed for", "count"),
    ("fixed_share", "fixed share", "percent"),
    ("fixed_wrongly", "fixed, though free when drawn", "count"),
    ("deep_pairs", "pairs deeper than 2 mm", "count"),
    ("scenes_with_deep_pairs", "scenes with such pairs", "count"),
    ("deepest_m", "deepest pair", "mm"),
    ("allowed_pairs", "deep pairs that are allowed", "count"),
    ("stable_5cm", "free things stable at 5 cm, 5 degrees", "percent"),
    ("stable_1cm", "free things stable at 1 cm", "percent"),
    ("displacement_mean_m", "horizontal displacement, mean", "mm"),
    ("displacement_p95_m", "horizontal displacement, 95th percentile", "mm"),
    ("floating", "free things that float", "count"),
    ("outside", "free things that reach out of the room", "count"),
    ("outside_silently", "of these not reported", "count"),
    ("supports_kept", "supports kept", "count"),
    ("supports_lost_reported", "supports lost and reported", "count"),
    ("supports_lost_silently", "supports lost and not reported", "count"),
    ("supports_misjudged", "carriers taken for others", "count"),
    ("rows_disagreeing", "depths that the rows have otherwise", "count"),
    ("depths_checked", "pairs whose depth was measured by every axis", "count"),
    ("seconds_mean", "seconds per scene, mean", "seconds"),
    ("seconds_max", "seconds per scene, most", "seconds"),
)
"""Key of a figure, what a person reads, and its unit."""

ONLY_OPTIMIZED = (
    "unplaced", "fixed_wrongly", "outside_silently", "supports_lost_reported", "supports_misjudged", "rows_disagreeing",
    "depths_checked", "seconds_mean", "seconds_max",
)  # fmt: skip
"""Figures that a state before any optimization does not have."""

BEFORE = ("drawn", "input")


def print_report(report: Mapping[str, Any], console: Console) -> None:
    """Print every table that the report has figures for."""
    machine = report["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}, {versions}; "
        f"seed {report['seed']}, {report['processes']} processes"
    )
    for table in (_states(report), _goals(report), _worst(report), _timings(report)):
        if table is not None:
            console.print(table)


def as_text(value: float | int | None, unit: str) -> str:
    """A figure as a person reads it; n/a for what nothing is known of."""
    if value is None or math.isnan(value):
        return "n/a"
    if unit == "percent":
        return f"{100 * value:.2f} %"
    if unit == "mm":
        return f"{1000 * value:.1f} mm"
    return f"{value:.2f}" if unit == "seconds" else f"{value:,}"


def _table(title: str, *columns: tuple[str, bool]) -> Any:
    """An empty table; columns as (header, set to the right)."""
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE, show_edge=False, pad_edge=False)
    for header, right in columns:
        table.add_column(header, justify="right" if right else "left", no_wrap=right)
    return table


def _add(table: Any, *cells: str) -> None:
    """A row whose cells are shown as they are: "[m]" is no markup."""
    from rich.text import Text

    table.add_row(*[Text(cell) for cell in cells])


def _states(report: Mapping[str, Any]) -> Any:
    if "states" not in report:
        return None
    states, scenes = report["states"], len(report["scenes"])
    table = _table(f"{scenes} scenes ({report['source']})", ("", False), *((state, True) for state in states))
    for key, words, unit in FIGURES:
        cells = ["" if key in ONLY_OPTIMIZED and name in BEFORE else as_text(state[key], unit) for name, state in states.items()]
        _add(table, words, *cells)
    return table


def _goals(report: Mapping[str, Any]) -> Any:
    table = _table("goals", ("", False), ("found", True), ("wanted", True), ("", False))
    for goal in report["goals"]:
        said = "n/a" if goal["met"] is None else "met" if goal["met"] else "MISSED"
        _add(table, goal["goal"], "n/a" if goal["found"] is None else f"{goal['found']:.5g}", goal["wanted"], said)
    return table


def _worst(report: Mapping[str, Any]) -> Any:
    if not report.get("worst"):
        return None
    table = _table(f"worst cases of {report['methods'][-1]}", ("scene", False), ("instances", False), ("", False), ("", True))
    for case in report["worst"]:
        pairs = zip(case["instances"], case["categories"], strict=True)
        names = ", ".join(name if name == category else f"{name} {category}" for name, category in pairs)
        _add(table, case["scene_id"], names, case["what"], "" if case["amount"] is None else f"{case['amount']:.3f}")
    return table


def _timings(report: Mapping[str, Any]) -> Any:
    table = _table("times", ("", False), ("", True))
    moves = report["moves"]
    _add(table, f"a move of Algorithm 1 at {moves['count']} things, plain Python", f"{1e6 * moves['plain_seconds']:.1f} us")
    _add(table, "the same compiled", f"{1e6 * moves['compiled_seconds']:.3f} us")
    _add(table, "times faster", f"{moves['speedup']:,.0f}")
    _add(table, "greatest difference of losses over the same moves", f"{moves['largest_difference_m3']:.1e} m3")
    for count, seconds in moves["seconds_per_move"].items():
        _add(table, f"a compiled move at {count} things", f"{1e6 * seconds:.3f} us")
    if "scene" in report:
        for method in report["methods"]:
            scene, words = report["scene"], f"a scene of {report['scene']['count']} things, {method}, pieces from the cache"
            _add(table, f"{words}, first run of a process", f"{scene['first_seconds'][method]:.2f} s")
            _add(table, f"{words}, warm", f"{scene[method]:.2f} s")
    if "chains" in report:
        same = "same rows" if report["chains"]["is_same"] else "DIFFERENT ROWS"
        for processes, seconds in report["chains"]["seconds_by_processes"].items():
            _add(
                table,
                f"a scene of {report['chains']['count']} things, default, chains on {processes} processes ({same})",
                f"{seconds:.2f} s",
            )
    for row in report.get("pieces", ()):
        _add(
            table,
            f"convex pieces of a mesh without any, cold: {row['category']} ({row['method']}, {row['pieces']})",
            f"{row['seconds']:.2f} s",
        )
    return table
