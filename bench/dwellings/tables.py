"""The hard rooms' report as tables for people."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.dwellings.judgement import FIGURES
from bench.tables import add_row, as_text, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

BY_ROOM: tuple[tuple[str, str, str], ...] = (
    ("objects", "objects", "count"), ("free", "free", "count"), ("stable_1cm", "1 cm", "percent"), ("stable_5cm", "5 cm", "percent"),
    ("stable_nudged", "nudged", "percent"), ("left_out", "left out", "count"), ("anchored", "fixed", "count"),
    ("deep_pairs", "deep", "count"), ("moved_15cm", "> 15 cm", "count"), ("openings_seen", "openings", "percent"),
    ("categories_right", "categories", "percent"), ("true_rooms", "rooms", "count"), ("rooms_right", "right", "percent"),
    ("seconds", "seconds", "seconds"),
)  # fmt: skip
"""Figures of single rooms, and their headers."""


def print_dwellings(report: Mapping[str, Any], console: Console) -> None:
    """Print the figures of all rooms and of scans by others, of each room, what failed, and goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    if report["settings"]:
        console.print(f"told otherwise: {', '.join(report['settings'])}", markup=False, soft_wrap=True)
    if report["warm_up_seconds"] is not None:
        console.print(f"one more room went first, so that nothing is compiled below: {report['warm_up_seconds']:.0f} s")
    groups, foreign = report["groups"], report["others"]
    table = table_of(
        f"{report.get('kind', 'hard')} rooms", ("", False), *((name, True) for name in (*groups, *(scan["title"] for scan in foreign)))
    )
    add_row(table, "rooms", *(str(group["rooms"]) for group in groups.values()), *("" for _ in foreign))
    failed = [int(scan["error"] is not None) for scan in foreign]
    add_row(table, "of these failed", *(str(group["failed"]) for group in groups.values()), *map(str, failed))
    for key, words, unit in FIGURES:
        known = ("" if math.isnan(scan[key]) else as_text(scan[key], unit) for scan in foreign)
        add_row(table, words, *(as_text(group[key], unit) for group in groups.values()), *known)
    console.print(table)
    if foreign:
        console.print(
            "Of scans by others nobody says what is free: what the replica does not fix, and what it left out, is. Blank: no truth."
        )
    for line in report["not_measured"]:
        console.print(f"not measured: {line}", markup=False, soft_wrap=True)
    rooms = table_of("by room", ("", False), ("frames", False), *((words, True) for _, words, _ in BY_ROOM))
    for room in report["rooms"]:
        name = f"{room['room']}: {room['stage']} failed" if room["error"] else room["room"]
        add_row(rooms, name, "yes" if room["has_frames"] else "no", *(as_text(room[key], unit) for key, _, unit in BY_ROOM))
    if report["rooms"]:
        console.print(rooms)
    if report["errors"]:
        errors = table_of("what failed", ("room", False), ("stage", False), ("", False))
        for row in report["errors"]:
            add_row(errors, row["room"], row["stage"], row["error"])
        console.print(errors)
    console.print(goals_table(report["goals"]))
