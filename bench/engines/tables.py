"""The report on engines as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console


def print_engines(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables: scenes, engines with their settings, disagreements by name, goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    _print_scenes(report, console)
    _print_engines(report, console)
    if report["failures"]:
        table = table_of("scenes without a result", ("scene", False), ("engine", False), ("", False))
        for line in report["failures"]:
            add_row(table, *line)
        console.print(table)
    if report["disagreements"]:
        table = table_of(
            "judged otherwise than by the certificate at 1 cm", ("scene", False), ("object", False), ("engine", False),
            ("certificate", False), ("engine says", False), ("when", False), ("moved", True), ("tilt", True),
        )  # fmt: skip
        for line in report["disagreements"]:
            words = (line["scene"], line["body"], line["engine"], line["certificate"], line["verdict"], line["when"])
            add_row(table, *words, f"{line['moved_mm']:.1f} mm", f"{line['tilt_degrees']:.1f} deg")
        console.print(table)
    console.print(goals_table(report["goals"]))


def settings_text(settings: Mapping[str, Any]) -> str:
    """Settings in one line; those of the file where there are none."""
    words = [f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}" for name, value in settings.items()]
    return ", ".join(words) or "those of the file"


def _print_scenes(report: Mapping[str, Any], console: Console) -> None:
    """The scenes, by what made them, and what was left out."""
    table = table_of("scenes", ("from", False), ("scenes", True), ("objects", True), ("free", True), ("certified at 1 cm", True))
    for source in dict.fromkeys(scene["source"] for scene in report["scenes"]):
        rows = [scene for scene in report["scenes"] if scene["source"] == source]
        add_row(table, source, str(len(rows)), *(str(sum(row[key] for row in rows)) for key in ("objects", "free", "certified_1cm")))
    console.print(table)
    for line in report["left_out"]:
        console.print(f"left out: {line}", markup=False)


def _print_engines(report: Mapping[str, Any], console: Console) -> None:
    """A row for every engine, those that are not installed too."""
    table = table_of(
        f"free objects that stay, left alone for {report['seconds']:g} s; nudged by {report['nudge_m_s']:g} m/s from four sides, too",
        ("engine", False), ("reads", False), ("version", False), ("objects", True), ("1 cm", True), ("5 cm", True), ("nudged 1 cm", True),
        ("nudged 5 cm", True), ("seconds", True),
    )  # fmt: skip
    for row in report["engines"]:
        if row["missing"]:
            add_row(table, row["engine"], row["format"], "not installed", str(row["objects"]), *["-"] * 5)
            continue
        counts = (str(row[key]) for key in ("objects", "rest_1cm", "rest_5cm", "nudged_1cm", "nudged_5cm"))
        add_row(table, row["engine"], row["format"], row["version"] or "no result", *counts, f"{row['seconds']:.0f}")
    console.print(table)
    table = table_of("settings, and what is not installed", ("engine", False), ("", False))
    for row in report["engines"]:
        add_row(table, row["engine"], settings_text(row["settings"]))
        if row["missing"]:
            add_row(table, "", f"not installed: {row['missing']}")
    console.print(table)
