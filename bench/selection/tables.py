"""The report of asset selection as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

CHOICES: tuple[tuple[str, str, float, int], ...] = (
    ("top_1", "top-1 [%]", 100, 1), ("top_5", "top-5 [%]", 100, 1), ("top_1_without_own", "without own [%]", 100, 1),
)  # fmt: skip
"""Figures of choices, with intervals: headers, what they are multiplied by, and digits."""

SURFACES: tuple[tuple[str, str, float, int], ...] = (
    ("chamfer_m", "CD [mm]", 1000, 1), ("ecd_m", "ECD [mm]", 1000, 1), ("box_iou", "IoU", 1, 3), ("color_kl", "color KL", 1, 2),
    ("regret_chamfer_m", "CD above best [mm]", 1000, 1), ("milliseconds", "ms", 1, 1),
)  # fmt: skip
"""Figures of what was chosen."""


MOST_NAMES = 6
"""Of what a category is called, so many are shown."""


def print_selection(report: Mapping[str, Any], console: Console) -> None:
    """Print figures of all methods on held-out rooms, on held-out categories and of the house, what training took, and goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    counts = report["counts"]
    rooms, instances = counts["rooms"], counts["instances"]
    console.print(
        f"{instances['train']:,} instances of {rooms['train']} rooms to learn from, {instances['test']:,} of {rooms['test']} held-out "
        f"rooms, {counts['held_out']['test']:,} of these of held-out categories; all annotators are simulated",
        soft_wrap=True,
    )
    cpu = ", ".join(f"{step} {value:.1f}" for step, value in counts["cpu_seconds"].items())
    console.print(f"processor seconds per room: {cpu}", soft_wrap=True)
    for line in report["failed_rooms"]:
        console.print(line, markup=False, soft_wrap=True)
    for key, title in (("methods", "held-out rooms"), ("held_out_categories", "held-out categories"), ("house", "AWS small house")):
        if report[key]:
            console.print(_choices(title, report[key]))
            console.print(_surfaces(f"{title}: what was chosen", report[key]))
    margin = table_of("top-1 of the model above others, of the same instances [points]", ("", False), ("above", True), ("95 %", True))
    for name, row in report["margin"].items():
        add_row(margin, name, f"{100 * row['value']:.1f}", f"{100 * row['low']:.1f} to {100 * row['high']:.1f}")
    console.print(margin)
    if report["naming"]:
        console.print(_names(report["naming"]["shares"]))
        console.print(_confusion(report["naming"]["confusion"]))
    trainings = table_of("trainings", ("", False), ("seed", True), ("parameters", True), ("kB", True), ("seconds", True), ("device", False))
    for row in report["trainings"]:
        add_row(trainings, row["name"], str(row["seed"]), f"{row['parameters']:,}", f"{row['bytes'] / 1000:.0f}", f"{row['seconds']:.0f}",
                row["device"])  # fmt: skip
    console.print(trainings)
    for line in report["not_measured"]:
        console.print(f"not measured: {line}", markup=False, soft_wrap=True)
    console.print("hours: " + ", ".join(f"{step} {value / 3600:.2f}" for step, value in report["seconds"].items()))
    console.print(goals_table(report["goals"]))


def _names(shares: Mapping[str, Any]) -> Any:
    """How often instances are called what they are."""
    table = table_of("right names, by points alone [%]", ("", False), ("instances", True), ("rules of sizes", True), ("encoder", True))
    titles = {"all": "all", "learned": "of categories that were learned", "ruled": "of categories that the rules name"}
    for group, row in shares.items():
        cells = (f"{100 * who['value']:.1f} ({100 * who['low']:.1f}-{100 * who['high']:.1f})" for who in (row["by_rules"], row["by_model"]))
        add_row(table, titles[group], str(row["by_model"]["examples"]), *cells)
    return table


def _confusion(counts: Mapping[str, Mapping[str, int]]) -> Any:
    """What the model takes the most frequent categories for."""
    table = table_of("what the model calls them", ("", False), ("instances", True), ("called", False))
    for category, names in counts.items():
        shown = [f"{name} {count}" for name, count in list(names.items())[:MOST_NAMES]]
        add_row(table, category, str(sum(names.values())), ", ".join(shown + ["..."] * (len(names) > MOST_NAMES)))
    return table


def _choices(title: str, methods: Mapping[str, Any]) -> Any:
    """How often each method finds the truth, with intervals of 95 % over rooms."""
    table = table_of(title, ("", False), ("instances", True), ("seeds", True), *((header, True) for _, header, _, _ in CHOICES))
    for name, row in methods.items():
        add_row(table, name, str(row["instances"]), str(row["seeds"]), *(_cell(row, *column, with_interval=True) for column in CHOICES))
    return table


def _surfaces(title: str, methods: Mapping[str, Any]) -> Any:
    """How far what each method chooses is from the scanned model."""
    table = table_of(title, ("", False), *((header, True) for _, header, _, _ in SURFACES))
    for name, row in methods.items():
        add_row(table, name, *(_cell(row, *column) for column in SURFACES))
    return table


def _cell(row: Mapping[str, Any], key: str, header: str, times: float, digits: int, with_interval: bool = False) -> str:
    """A figure of a method as text; n/a where there is none."""
    figure = row["figures"].get(key)
    if figure is None:
        return "n/a"
    value, low, high = (f"{times * figure[end]:.{digits}f}" for end in ("value", "low", "high"))
    return f"{value} ({low}-{high})" if with_interval else value
