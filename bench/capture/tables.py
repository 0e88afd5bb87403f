"""The report of scans without labels as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.capture.report import FRAMES, MESHES, POSES, ROOMS, STOREYS
from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console


def print_capture(report: Mapping[str, Any], console: Console) -> None:
    """Print the report."""
    parts = report["parts"]
    console.print(headline(report["machine"], report["seed"], 1))
    if FRAMES in parts:
        _print_frames(parts[FRAMES]["rows"], console)
    if MESHES in parts:
        _print_rooms("instances of bare meshes", parts[MESHES]["rows"], console)
    if ROOMS in parts:
        _print_rooms("instances of rooms of frames", parts[ROOMS]["rows"], console)
    if POSES in parts:
        _print_poses(parts[POSES], console)
    if STOREYS in parts:
        _print_storeys(parts[STOREYS]["rows"], console)
    console.print(goals_table(report["goals"]))


def _print_frames(rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = ("frames", "objects", "regions", "P", "R", "F1", "at 0.75", "split", "merged", "level", "s")
    table = table_of("instances of single frames at point IoU 0.5", ("of", False), ("code", False), *((text, True) for text in columns))
    for row in rows:
        counts = [str(row[name]) for name in ("frames", "objects", "regions")]
        rates = [f"{row[name]:.2f}" for name in ("precision", "recall", "f1", "f1_well")]
        level = "n/a" if row["level"] is None else str(row["level"])
        add_row(
            table, row["material"], row["code"], *counts, *rates, str(row["in_pieces"]), str(row["shared"]), level, f"{row['seconds']:.2f}"
        )
    console.print(table)


def _print_rooms(title: str, rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = ("objects", "regions", "at 0.5", "at 0.25", "in > 4", "largest", "floor off", "s")
    table = table_of(title, ("of", False), ("code", False), *((text, True) for text in columns))
    for row in rows:
        counts = [str(row[name]) for name in ("objects", "regions", "half", "quarter", "in_pieces")]
        off = "n/a" if row["degrees"] is None else f"{row['degrees']:.2f} deg, {1000 * row['off_m']:.0f} mm"
        add_row(table, row["material"], row["code"], *counts, f"{row['largest']:.1%}", off, f"{row['seconds']:.1f}")
    console.print(table)


def _print_poses(part: Mapping[str, Any], console: Console) -> None:
    columns = ("seed", "frames", "way [m]", "posed", "error before [cm]", "after", "F at 5 cm before", "after", "with true poses", "s")
    table = table_of("poses of walks", ("room", False), ("poses", False), *((text, True) for text in columns))
    for row in part["rows"]:
        before = ("n/a", "n/a") if row["before_m"] is None else (f"{100 * row['before_m']:.1f}", f"{row['f_before']:.3f}")
        add_row(
            table, row["room"], row["given"], str(row["seed"]), str(row["frames"]), f"{row['way_m']:.1f}", str(row["posed"]), before[0],
            f"{100 * row['after_m']:.1f}", before[1], f"{row['f_score']:.3f}", f"{row['true_f_score']:.3f}", f"{row['seconds']:.0f}",
        )  # fmt: skip
    console.print(table)
    if part["note"]:
        console.print(part["note"])


def _print_storeys(rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = ("storeys", "houses", "divided right", "cut off middle [cm]", "beside slab [cm]", "lost", "misplaced", "s")
    table = table_of("storeys of houses, each figure at worst", ("of", False), *((text, True) for text in columns))
    for row in rows:
        cuts = ["n/a" if row[name] is None or row["storeys"] == 1 else f"{100 * row[name]:.1f}" for name in ("off_m", "beside_m")]
        misplaced = "n/a" if row["misplaced"] is None else f"{row['misplaced']:.2%}"
        counts = [str(row[name]) for name in ("storeys", "houses", "right")]
        add_row(table, row["kind"], *counts, *cuts, f"{row['lost']:.1e}", misplaced, f"{row['seconds']:.1f}")
    console.print(table)
