"""The optimization's report as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, as_text, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

FIGURES: tuple[tuple[str, str, str], ...] = (
    ("objects", "objects", "count"),
    ("unplaced", "instances that nothing was placed for", "count"),
    ("fixed_share", "fixed share", "percent"),
    ("fixed_wrongly", "fixed, though free when drawn", "count"),
    ("deep_pairs", "pairs deeper than 2 mm", "count"),
    ("scenes_with_deep_pairs", "scenes with such pairs", "count"),
    ("deepest_m", "deepest pair", "mm"),
    ("allowed_pairs", "deep pairs that are allowed", "count"),
    ("stable_5cm", "free objects stable at 5 cm, 5 degrees", "percent"),
    ("stable_1cm", "free objects stable at 1 cm, 5 degrees", "percent"),
    ("stable_nudged", "the same after each of four nudges", "percent"),
    ("laid_down", "objects laid down because of nudges", "count"),
    ("fallen", "objects put where they come to rest", "count"),
    ("displacement_mean_m", "horizontal displacement, mean", "mm"),
    ("displacement_p95_m", "horizontal displacement, 95th percentile", "mm"),
    ("floating", "free objects that float", "count"),
    ("outside", "free objects that reach out of the room", "count"),
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
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    for table in (_states(report), goals_table(report["goals"]), _worst(report), _timings(report)):
        if table is not None:
            console.print(table)


def _states(report: Mapping[str, Any]) -> Any:
    if "states" not in report:
        return None
    states, scenes = report["states"], len(report["scenes"])
    table = table_of(f"{scenes} scenes ({report['source']})", ("", False), *((state, True) for state in states))
    for key, words, unit in FIGURES:
        cells = ["" if key in ONLY_OPTIMIZED and name in BEFORE else as_text(state[key], unit) for name, state in states.items()]
        add_row(table, words, *cells)
    return table


def _worst(report: Mapping[str, Any]) -> Any:
    if not report.get("worst"):
        return None
    table = table_of(f"worst cases of {report['methods'][-1]}", ("scene", False), ("instances", False), ("", False), ("", True))
    for case in report["worst"]:
        pairs = zip(case["instances"], case["categories"], strict=True)
        names = ", ".join(name if name == category else f"{name} {category}" for name, category in pairs)
        add_row(table, case["scene_id"], names, case["what"], "" if case["amount"] is None else f"{case['amount']:.3f}")
    return table


def _timings(report: Mapping[str, Any]) -> Any:
    table = table_of("times", ("", False), ("", True))
    moves = report["moves"]
    add_row(table, f"a move of Algorithm 1 at {moves['count']} objects, plain Python", f"{1e6 * moves['plain_seconds']:.1f} us")
    add_row(table, "the same compiled", f"{1e6 * moves['compiled_seconds']:.3f} us")
    add_row(table, "times faster", f"{moves['speedup']:,.0f}")
    add_row(table, "greatest difference of losses over the same moves", f"{moves['largest_difference_m3']:.1e} m3")
    for count, seconds in moves["seconds_per_move"].items():
        add_row(table, f"a compiled move at {count} objects", f"{1e6 * seconds:.3f} us")
    if "scene" in report:
        for method in report["methods"]:
            scene, words = report["scene"], f"a scene of {report['scene']['count']} objects, {method}, pieces from the cache"
            add_row(table, f"{words}, first run of a process", f"{scene['first_seconds'][method]:.2f} s")
            add_row(table, f"{words}, warm", f"{scene[method]:.2f} s")
    if "chains" in report:
        same = "same rows" if report["chains"]["is_same"] else "DIFFERENT ROWS"
        for processes, seconds in report["chains"]["seconds_by_processes"].items():
            add_row(
                table,
                f"a scene of {report['chains']['count']} objects, default, chains on {processes} processes ({same})",
                f"{seconds:.2f} s",
            )
    for row in report.get("pieces", ()):
        add_row(
            table,
            f"convex pieces of a mesh without any, cold: {row['category']} ({row['method']}, {row['pieces']})",
            f"{row['seconds']:.2f} s",
        )
    return table
