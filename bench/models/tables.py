"""The report of models of others as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.models.report import DEVICES, LIFTING, REPLIES, RETRIEVAL, TEXTURES, TRAINED, WITHHELD
from bench.models.texturing import print_texturing
from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

_SHARES = {
    "first": "first", "in_ten": "in ten", "first_unnamed": "no category: first", "in_ten_unnamed": "in ten",
    "category_withheld": "withheld: category",
}  # fmt: skip


def print_models(report: Mapping[str, Any], console: Console) -> None:
    """Print the report."""
    parts = report["parts"]
    console.print(headline(report["machine"], report["seed"], 1))
    if REPLIES in parts:
        table = table_of("corrupted replies", ("about", False), ("replies", True), ("read", True), ("wrong", True))
        for row in parts[REPLIES]["rows"]:
            add_row(table, row["replies about"], *(str(row[name]) for name in ("replies", "read", "wrong")))
        console.print(table)
    if LIFTING in parts:
        _print_lifting(parts[LIFTING]["rows"], console)
    if WITHHELD in parts:
        _print_withheld(parts[WITHHELD]["rows"], console)
    if TEXTURES in parts:
        print_texturing(parts[TEXTURES], console)
    if RETRIEVAL in parts:
        _print_retrieval(parts[RETRIEVAL]["rows"], console)
    if DEVICES in parts:
        _print_devices(parts[DEVICES], console)
    if TRAINED in parts:
        _print_trained(parts[TRAINED], console)
    console.print(goals_table(report["goals"]))


def _print_lifting(rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = (("scenes", True), ("objects", True), ("instances", True), ("precision", True), ("recall", True), ("seconds", True))
    table = table_of("small objects at point IoU 0.5", ("on", False), ("that stand", False), ("by", False), *columns)
    for row in rows:
        counts = [str(row[name]) for name in ("scenes", "objects", "instances")]
        shares = [f"{100 * row[name]:.1f} %" for name in ("precision", "recall")]
        stand = "touching" if row["touching"] else "apart"
        add_row(table, row["word"], stand, row["method"], *counts, *shares, f"{row['seconds'] / max(row['scenes'], 1):.2f}")
    console.print(table)


def _print_withheld(rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = ("rooms", "withheld", "of these back", "found then", "found beside all names", "of these true", "there twice")
    table = table_of("small objects that rooms do not name", *((text, True) for text in (*columns, "seconds", "without")))
    for row in rows:
        counts = [str(row[name]) for name in ("rooms", "withheld", "back", "added", "beside", "unnamed", "doubled")]
        add_row(table, *counts, *(f"{row[name] / max(row['rooms'], 1):.1f}" for name in ("seconds", "without")))
    console.print(table)


def _print_retrieval(rows: list[Mapping[str, Any]], console: Console) -> None:
    columns = (("queries", True), ("models", True), *((text, True) for text in _SHARES.values()), ("a query of 10,000", True))
    table = table_of("scanned models looked up", *columns)
    for row in rows:
        shares = [f"{100 * row[name]:.1f} %" for name in _SHARES]
        time = f"{1000 * row['median_seconds']:.1f} ms"
        add_row(table, str(row["queries"]), str(row["models"]), *shares, time)
    console.print(table)


def _print_devices(part: Mapping[str, Any], console: Console) -> None:
    columns = (("weights", True), ("against", False), ("boxes", True), ("scores", True), ("masks", True), ("pictures a second", True),
               ("memory", True))  # fmt: skip
    table = table_of(f"networks that see, on {part['card'] or 'no graphics card'}", ("by", False), *columns)
    for row in part["rows"]:
        speed = "not run" if row["pictures_per_second"] is None else f"{row['pictures_per_second']:.1f}"
        memory = "not run" if row["peak_mb"] is None else f"{row['peak_mb']:,.0f} MB"
        off = (f"{row['boxes_px']:.1e} px", f"{row['scores']:.1e}", f"{row['masks']:.1e}")
        add_row(table, row["provider"], f"{row['weights_mb']:,.0f} MB", row["against"], *off, speed, memory)
    console.print(table)


def _print_trained(part: Mapping[str, Any], console: Console) -> None:
    training = part["training"]
    console.print(
        f"a network of {training['parameters']:,} parameters, {training['steps']:,} steps on {training['frames']:,} frames in "
        f"{training['seconds']:,.0f} s"
    )
    columns = ("frames", "objects", "masks", "precision", "recall", "F1", "F1 at 0.75", "named", "seconds")
    table = table_of("masks of frames at pixel IoU 0.5", ("of", False), ("by", False), *((text, True) for text in columns))
    for row in part["frames"]:
        counts = [str(row[name]) for name in ("frames", "objects", "masks")]
        shares = [f"{row[name]:.3f}" for name in ("precision", "recall", "f1", "f1_exact", "named")]
        add_row(table, row["frames of"], row["member"], *counts, *shares, f"{row['seconds']:.2f}")
    console.print(table)
    table = table_of("F1 of the network less that of the better classical one", ("of", False), ("lead", True), ("of 95 %", True))
    for row in part["leads"]:
        add_row(table, row["frames of"], f"{row['lead']:+.3f}", f"{row['low']:+.3f} to {row['high']:+.3f}")
    console.print(table)
    _print_lifting([{**row, **_shares_of(row)} for row in part["lifting"]], console)
    for row in part["rooms"]:
        console.print(f"rooms whose small objects have no name, by {row['member']}:")
        _print_withheld([row], console)


def _shares_of(row: Mapping[str, Any]) -> dict[str, float]:
    return {"precision": row["matched"] / max(row["instances"], 1), "recall": row["matched"] / max(row["objects"], 1)}
