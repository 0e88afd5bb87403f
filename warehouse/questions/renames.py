"""Names that SQL used to have. For one version the old name stands beside the new one, so that nobody's query breaks over night.

Whoever renames a view, a column of a view or a column of a table adds a line to `RENAMES`, and whoever gives columns of a table to a
new one of one row per scene a line to `MOVES`, and nothing else: SQL on lakes, releases and their catalogs then knows both names,
files that were written under the old one are read, and `docs/views.md` and `docs/tables.md` name it. A line goes with the next
version: tests hold it against what the version before knew (tests/earlier).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from warehouse.questions.quoting import literal


@dataclasses.dataclass(frozen=True)
class Rename:
    """``Rename("old", "new")`` of a view, ``Rename("old", "new", of="relation")`` of a column of a view or table.

    value: SQL for what a view's column was under its old name, where it is more than another name: ``value="NOT is_new"``.
    """

    before: str
    after: str
    of: str = ""
    value: str = ""


@dataclasses.dataclass(frozen=True)
class Move:
    """Columns that a table of one row per scene, `before`, gave to another one, `after`, and has no more.

    A row of old files that has the first of them is a row of both.
    """

    before: str
    after: str
    columns: tuple[str, ...]


_NAVIGATION = ("navigation_groups", "navigation_metrics", "navigation_metrics_by_category", "navigation_metrics_by_scene")

RENAMES: tuple[Rename, ...] = (
    *(
        Rename(f"curvature_{reading}", f"curvature_{reading}_per_m", of=view)
        for view in ("trajectory_curvature", "trajectory_metrics", *_NAVIGATION)
        for reading in ("finite_differences", "turning_angle")
    ),
    *(Rename("collisions", "mean_collisions", of=view) for view in _NAVIGATION),
    Rename("visible_fraction", "visible_share", of="masks"),
    Rename("box_size_m", "box_size", of="scene_objects"),
    Rename("fails_5cm", "is_stable_5cm", of="unstable_objects", value="NOT is_stable_5cm"),
)
"""What the version before called otherwise."""

MOVES: tuple[Move, ...] = (
    Move("rooms", "shells", ("walls", "interior_walls", "floor_source", "height_m", "height_source", "floor_color", "wall_color")),
)
"""What the version before had in another table."""


def move_into(table: str) -> Move | None:
    """The move that gave a table columns, which it may have rows of in files of the other."""
    return next((move for move in MOVES if move.after == table), None)


def move_out_of(table: str) -> Move | None:
    """The move that took columns from a table."""
    return next((move for move in MOVES if move.before == table), None)


def former_views() -> dict[str, str]:
    """Views by their old names."""
    return {rename.before: rename.after for rename in RENAMES if not rename.of}


def former_columns(relation: str) -> dict[str, str]:
    """Columns of a view or table by their old names."""
    return {rename.before: rename.after for rename in RENAMES if rename.of == relation}


def former_values(relation: str) -> dict[str, str]:
    """SQL for the old columns of a view or table by their names: mostly the new name alone."""
    return {rename.before: rename.value or rename.after for rename in RENAMES if rename.of == relation}


def with_former(relation: str, query: str) -> str:
    """A query for a view or table with the old names of its columns after the others."""
    former, move = former_values(relation), move_out_of(relation)
    if former:
        old = ", ".join(f'{value} AS "{before}"' for before, value in former.items())
        known = ", ".join(map(literal, former))  # a view that takes all of another has its old names, too
        query = f"SELECT COLUMNS(lambda name: name NOT IN ({known})), {old} FROM ({query})"
    if move is not None:
        moved = ", ".join(f'"{move.after}"."{column}"' for column in move.columns)
        query = f'SELECT kept.*, {moved} FROM ({query}) AS kept LEFT JOIN "{move.after}" USING (scene_id)'
    return query


def merged(relation: str, columns: Iterable[str]) -> list[str]:
    """SQL for a table's columns, of files some of which may have them under their old names."""
    former = {after: before for before, after in former_columns(relation).items()}
    return [f'coalesce("{name}", "{former[name]}") AS "{name}"' if name in former else f'"{name}"' for name in columns]
