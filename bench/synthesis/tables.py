"""The report of learned synthesis as tables for people."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.synthesis.rooms import ROOM_TYPES
from bench.tables import add_row, as_text, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

LIKENESS: tuple[tuple[str, str, float, int], ...] = (
    ("ckl", "CKL", 1, 4), ("sca.value", "SCA [%]", 100, 1), ("pictures.kid", "KID", 1, 4), ("pictures.fid", "FID", 1, 3),
    ("objects_per_layout", "objects", 1, 2),
)  # fmt: skip
"""Figures of likeness to held-out layouts: headers, what they are multiplied by, and digits."""

BOXES: tuple[tuple[str, str, float, int], ...] = (
    ("collides", "collide [%]", 100, 2), ("layouts_collide", "layouts [%]", 100, 1), ("off_edge", "off the edge [%]", 100, 2),
    ("floats", "float [%]", 100, 2), ("off_support", "off support [%]", 100, 2),
)  # fmt: skip
"""Figures of what cannot be."""

VARIETY: tuple[tuple[str, str, float, int], ...] = (
    ("variety_ratio", "variety", 1, 3), ("distinct", "distinct sets [%]", 100, 1), ("nearest.ratio", "to learned", 1, 3),
    ("nearest.copies", "copies [%]", 100, 2), ("seconds_per_1000", "s per 1,000", 1, 2),
)  # fmt: skip
"""Figures of how varied layouts are, how far from what was learned from, over the truth's, and how long they take."""


def print_synthesis(report: Mapping[str, Any], console: Console) -> None:
    """Print figures of all who draw, of kinds of rooms, of the house, what training took, and goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    console.print(
        f"{report['rooms']:,} generated rooms, {report['learned']:,} layouts to learn from; figures against {report['held_out']:,} layouts "
        f"of other rooms, mean (range) over seeds",
        soft_wrap=True,
    )
    figures = report["figures"]
    features = next((row["pictures"]["features"] for rows in report["measured"].values() for row in rows if "pictures" in row), "")
    if figures:
        console.print(_figures(f"likeness to held-out layouts; pictures: {features}", figures, LIKENESS))
        console.print(_figures("objects that cannot be where they are", figures, BOXES))
        console.print(_figures("variety and distance to what was learned from, over the truth's", figures, VARIETY))
        console.print(_rooms(report))
    if report["scenes_made"]:
        _print_scenes(report["scenes_made"], console)
    if report["house"]:
        _print_house(report["house"], console)
    console.print(_trainings(report["trainings"]))
    for line in report["not_measured"]:
        console.print(f"not measured: {line}", markup=False, soft_wrap=True)
    for path in report["pictures"]:
        console.print(f"picture: {path}", markup=False, soft_wrap=True)
    console.print(goals_table(report["goals"]))


def _figures(title: str, figures: Mapping[str, Any], columns: tuple[tuple[str, str, float, int], ...]) -> Any:
    table = table_of(title, ("", False), ("seeds", True), *((header, True) for _, header, _, _ in columns))
    for name, row in figures.items():
        add_row(table, name, str(row["seeds"]), *(_cell(row, key, times, digits) for key, _, times, digits in columns))
    return table


def _rooms(report: Mapping[str, Any]) -> Any:
    """How far categories on one table are from what is stated for a kind of room, and for the others."""
    title = f"one table, {report['per_room']} layouts in each kind of room: total variation from what is stated (for other kinds)"
    table = table_of(title, ("", False), *((room_type, True) for room_type in ROOM_TYPES))
    for name, row in report["figures"].items():
        keys = [(f"rooms.{room_type}.own", f"rooms.{room_type}.others") for room_type in ROOM_TYPES]
        if all(key in row for pair in keys for key in pair):
            add_row(table, name, *(f"{row[own]['mean']:.3f} ({row[neighbors]['mean']:.2f})" for own, neighbors in keys))
    return table


def _print_scenes(scenes: Mapping[str, Any], console: Console) -> None:
    """What came of scenes made of drawn layouts."""
    table = table_of(f"{scenes['scenes']} scenes made of drawn layouts, {scenes['objects']:,} drawn objects", ("", False), ("", True))
    for title, key, unit in (
        ("objects stable at 1 cm as drawn", "drawn_stable", "percent"), ("objects stable at 1 cm in the end", "stable_1cm", "percent"),
        ("objects stable at 5 cm in the end", "stable_5cm", "percent"),
        ("scenes all of whose objects are stable at 1 cm", "scenes_stable_1cm", "percent"),
        ("median move by the optimization", "moved_median_m", "mm"), ("95 % of objects moved less than", "moved_p95_m", "mm"),
        ("scenes whose exports pass all gates", "passed", "percent"), ("seconds per scene", "seconds_per_scene", "seconds"),
    ):  # fmt: skip
        add_row(table, title, as_text(scenes[key], unit))
    console.print(table)
    console.print("seconds by stage: " + ", ".join(f"{stage} {value:.2f}" for stage, value in scenes["seconds"].items()), soft_wrap=True)
    for rule, count in scenes["broken"].items():
        console.print(f"broken in {count} scenes: {rule}", markup=False, soft_wrap=True)
    for line in scenes["failed"]:
        console.print(f"failed: {line}", markup=False, soft_wrap=True)


def _print_house(house: Mapping[str, Any], console: Console) -> None:
    """What the house has, and how far generated and drawn tops are from it."""
    larges, smalls = (", ".join(f"{name} {count}" for name, count in house[key].items()) for key in ("larges", "smalls"))
    console.print(
        f"AWS small house, as its authors placed things: {house['objects']} objects on {house['micro_scenes']} large ones ({larges}): "
        f"{smalls}; {100 * house['collides']:.0f} % of them in another. CKL of generated tops from these {house['ckl_generated']:.2f}, of "
        f"drawn ones on the {house['drawn_on']} large objects that the model knows {house['ckl_drawn']:.2f}",
        markup=False,
        soft_wrap=True,
    )


def _trainings(rows: Any) -> Any:
    table = table_of("trainings", ("", False), ("seeds", True), ("parameters", True), ("minutes", True), ("device", False))
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        minutes = [row["seconds"] / 60 for row in own]
        spread = f"{sum(minutes) / len(minutes):.1f} ({min(minutes):.1f}-{max(minutes):.1f})"
        add_row(table, name, str(len(own)), f"{own[0]['parameters']:,}", spread, own[0]["device"])
    return table


def _cell(row: Mapping[str, Any], key: str, times: float, digits: int) -> str:
    """A figure as text, with its range where there are several seeds; n/a where there is none."""
    figure = row.get(key)
    if figure is None or math.isnan(figure["mean"]):
        return "n/a"
    mean, low, high = (f"{times * figure[end]:.{digits}f}" for end in ("mean", "low", "high"))
    return f"{mean} ({low}-{high})" if row["seeds"] > 1 else mean
