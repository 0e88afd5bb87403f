"""The carts' report as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.robot.report import DRIVES, KILLED
from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

MOST_REASONS = 12
"""Runs that did not arrive, of which it is said why; all of them are in the column `robot_runs.problem`."""


def print_robot(report: Mapping[str, Any], console: Console) -> None:
    """Print the report."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    parts = report["parts"]
    if DRIVES in parts:
        _print_setups(parts[DRIVES]["setups"], console)
    if KILLED in parts:
        killed = parts[KILLED]
        console.print(
            f"\nkilled: {killed['killed']} drive by SIGKILL, given again it drove {killed['went_on_with']} of {killed['runs']} ways; "
            f"the rows are {'' if killed['same_rows'] else 'NOT '}those of a whole drive"
        )
    for line in report["failed"]:
        console.print(f"failed: {line}", markup=False)
    console.print()
    console.print(goals_table(report["goals"]))


def _print_setups(rows: list[Mapping[str, Any]], console: Console) -> None:
    """What carts did, and how well they knew where they were."""
    done = table_of(
        "carts on the shortest paths of episodes", ("", False), ("replicas", False), ("runs", True), ("arrived", True), ("stuck", True),
        ("timeout", True), ("unreachable", True), ("collisions", True), ("least clearance", True), ("things moved", True),
    )  # fmt: skip
    known = table_of(
        "where they believe to be", ("", False), ("replicas", False), ("error, mean", True), ("greatest", True), ("end: wheels", True),
        ("with gyro", True), ("with lidar", True), ("NEES", True), ("95 % band", True), ("decision", True), ("99 of 100", True),
    )  # fmt: skip
    for row in rows:
        counts = [str(row[name]) for name in ("stuck", "timeout", "unreachable", "collisions")]
        clearance = f"{100 * row['least_clearance_m']:.1f} cm"
        add_row(
            done,
            row["setup"],
            row["replicas"],
            str(row["runs"]),
            f"{100 * row['arrived_share']:.1f} %",
            *counts,
            clearance,
            str(row["moved"]),
        )
        far = [f"{100 * row[name]:.1f} cm" for name in ("error_m", "greatest_error_m", "final_wheels_m", "final_wheels_gyro_m", "final_m")]
        times = [f"{1000 * row[name]:.1f} ms" for name in ("decision_seconds", "slowest_decision_seconds")]
        add_row(
            known, row["setup"], row["replicas"], *far, f"{row['nees']:.2f}", f"{row['nees_low']:.2f} to {row['nees_high']:.2f}", *times
        )
    console.print()
    console.print(done)
    console.print()
    console.print(known)
    for row in rows:
        if row["replicas"] == "all":
            for place, why in list(row["why"].items())[:MOST_REASONS]:
                console.print(f"{row['setup']}: {place}: {why}", markup=False)
