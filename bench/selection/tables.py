"""The report of asset selection as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

COLUMNS: tuple[tuple[str, str, float, int], ...] = (
    ("top_1", "top-1 [%]", 100, 1), ("top_5", "top-5 [%]", 100, 1), ("top_1_without_own", "without own [%]", 100, 1),
    ("chamfer_m", "CD [mm]", 1000, 1), ("ecd_m", "ECD [mm]", 1000, 1), ("box_iou", "IoU", 1, 3), ("color_kl", "color KL", 1, 3),
    ("regret_chamfer_m", "regret CD [mm]", 1000, 1), ("milliseconds", "ms", 1, 1),
)  # fmt: skip
"""Figures, their headers, what they are multiplied by, and digits."""

WITH_INTERVALS = ("top_1", "top_5", "top_1_without_own")


def print_selection(report: Mapping[str, Any], console: Console) -> None:
    """Print figures of all methods on held-out rooms, on held-out categories and of the house, what training took, and goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    counts = report["counts"]
    rooms, instances = counts["rooms"], counts["instances"]
    console.print(
        f"{instances['train']:,} instances of {rooms['train']} rooms to learn from, {instances['test']:,} of {rooms['test']} held-out "
        f"rooms, {counts['held_out']['test']:,} of these of held-out categories; all annotators are simulated"
    )
    cpu = ", ".join(f"{step} {value:.1f}" for step, value in counts["cpu_seconds"].items())
    console.print(f"processor seconds per room: {cpu}")
    for line in report["failed_rooms"]:
        console.print(line, markup=False, soft_wrap=True)
    for key, title in (("methods", "held-out rooms"), ("held_out_categories", "held-out categories"), ("house", "AWS small house")):
        if report[key]:
            console.print(_figures(title, report[key]))
    margin = table_of("top-1 of the model above others, of the same instances [points]", ("", False), ("above", True), ("95 %", True))
    for name, row in report["margin"].items():
        add_row(margin, name, f"{100 * row['value']:.1f}", f"{100 * row['low']:.1f} to {100 * row['high']:.1f}")
    console.print(margin)
    trainings = table_of("trainings", ("", False), ("seed", True), ("parameters", True), ("kB", True), ("seconds", True), ("device", False))
    for row in report["trainings"]:
        add_row(trainings, row["name"], str(row["seed"]), f"{row['parameters']:,}", f"{row['bytes'] / 1000:.0f}", f"{row['seconds']:.0f}",
                row["device"])  # fmt: skip
    console.print(trainings)
    for line in report["not_measured"]:
        console.print(f"not measured: {line}", markup=False, soft_wrap=True)
    console.print("hours: " + ", ".join(f"{step} {value / 3600:.2f}" for step, value in report["seconds"].items()))
    console.print(goals_table(report["goals"]))


def _figures(title: str, methods: Mapping[str, Any]) -> Any:
    """A row for every method."""
    table = table_of(title, ("", False), ("n", True), ("seeds", True), *((header, True) for _, header, _, _ in COLUMNS))
    for name, row in methods.items():
        cells = []
        for key, _, times, digits in COLUMNS:
            figure = row["figures"].get(key)
            text = "n/a" if figure is None else f"{times * figure['value']:.{digits}f}"
            if figure is not None and key in WITH_INTERVALS:
                text += f" ({times * figure['low']:.{digits}f}-{times * figure['high']:.{digits}f})"
            cells.append(text)
        add_row(table, name, str(row["instances"]), str(row["seeds"]), *cells)
    return table
