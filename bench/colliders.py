"""The benchmark of colliders: convex pieces of library files and of the generator's models, held against what is seen of them."""

from __future__ import annotations

import dataclasses
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.shelves import models_in
from bench.tables import add_row, goals_table, headline, table_of
from tasks.furniture import CATEGORIES, generate
from tasks.geometry.hulls import LIMITS, is_within
from tasks.geometry.pieces import PieceConfig, Pieces, pieces

if TYPE_CHECKING:
    import trimesh
    from rich.console import Console

SHARE = 0.02
"""Share of rays above which an asset is over the bar."""

KEPT = 0.95
"""Share of the assets that keep it."""

MOST_SECONDS = 10.0
"""Processor time that the pieces of a library's asset may take [s]."""


@dataclasses.dataclass(frozen=True)
class CollidersBench:
    """What is measured. library: folder of GLB files; None measures none. models: of the generator, per category."""

    library: str | None = None
    models: int = 2
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Measured:
    """One asset. early, miss: shares of its rays. seconds: of processor time for its pieces. beyond: hulls that engines do not take."""

    source: str
    name: str
    method: str
    early: float
    miss: float
    pieces: int
    faces: int
    seconds: float
    beyond: int


def steps_of(config: CollidersBench) -> int:
    """Assets that will be measured, for a progress bar."""
    return len(CATEGORIES) * config.models + len(models_in(config.library or None))


def run_colliders_bench(config: CollidersBench, advance: Callable[[], None]) -> dict[str, Any]:
    """Figures of every asset, and goals of each source."""
    rows = []
    warm = generate("book", None, np.random.default_rng(0))
    pieces(warm.parts, None, PieceConfig())  # what is compiled at first use is not an asset's time
    for source, name, parts, known in _assets(config):
        rows.append(measured(source, name, parts, known))
        advance()
    goals = []
    for source in dict.fromkeys(row.source for row in rows):
        of = [row for row in rows if row.source == source]
        for figure, words in (("early", "stop early"), ("miss", "miss")):
            kept = sum(getattr(row, figure) <= SHARE for row in of) / len(of)
            goals.append(goal(f"{source}: share of assets of whose rays at most 2 % {words}", kept, ">=", KEPT))
        goals.append(goal(f"{source}: most pieces of an asset", max(row.pieces for row in of), "<=", PieceConfig().max_pieces))
        goals.append(goal(f"{source}: hulls that PhysX would make smaller", sum(row.beyond for row in of), "==", 0))
    if config.library:
        slowest = max(row.seconds for row in rows if row.source == "library")
        goals.append(goal("library: processor seconds of the slowest asset", slowest, "<=", MOST_SECONDS))
    return {"machine": machine(), "seed": config.seed, "assets": [dataclasses.asdict(row) for row in rows], "goals": goals}


def measured(source: str, name: str, parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] | None) -> Measured:
    """Make the pieces of an asset, and measure them."""
    clock = time.process_time()
    made: Pieces = pieces(parts, known, PieceConfig())
    return Measured(
        source, name, made.method, *made.shares, len(made.hulls), sum(len(hull.faces) for hull in made.hulls),
        time.process_time() - clock, sum(not is_within(hull, LIMITS) for hull in made.hulls),
    )  # fmt: skip


def _assets(config: CollidersBench) -> Iterator[tuple[str, str, list[trimesh.Trimesh], list[trimesh.Trimesh] | None]]:
    """Source, name, what is seen, and pieces from construction."""
    for model in models_in(config.library or None):
        yield "library", model.made.asset.name, model.parts(), None
    for category in CATEGORIES:
        for number in range(config.models):
            drawn = generate(category, None, np.random.default_rng([config.seed, number, zlib.crc32(category.encode())]))
            yield "generator", f"{drawn.name} {number}", drawn.parts, drawn.pieces


def print_colliders(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables: every asset of a library, and those of the generator that are over the bar."""
    console.print(headline(report["machine"], report["seed"], 1))
    table = table_of(
        "rays that stop more than 2 cm early, and that go more than 1 cm too far",
        ("", False), ("asset", False), ("made by", False), ("early", True), ("miss", True), ("pieces", True), ("faces", True), ("s", True),
    )  # fmt: skip
    for row in report["assets"]:
        over = max(row["early"], row["miss"]) > SHARE
        if over or row["source"] == "library":
            shares = [f"{100 * row[name]:.2f} %" for name in ("early", "miss")]
            name = f"{row['name']} (over)" if over else row["name"]
            add_row(table, row["source"], name, row["method"], *shares, str(row["pieces"]), str(row["faces"]), f"{row['seconds']:.1f}")
    for source in dict.fromkeys(row["source"] for row in report["assets"]):
        of = [row for row in report["assets"] if row["source"] == source]
        middle = [float(np.median([row[name] for row in of])) for name in ("early", "miss", "pieces", "faces", "seconds")]
        add_row(
            table, source, f"median of {len(of)}", "", f"{100 * middle[0]:.2f} %", f"{100 * middle[1]:.2f} %",
            f"{middle[2]:.0f}", f"{middle[3]:.0f}", f"{middle[4]:.1f}",
        )  # fmt: skip
    console.print(table)
    console.print(goals_table(report["goals"]))
