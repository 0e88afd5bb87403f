"""Questions that every lake can answer: one SQL view per question, kept as one file each in `views/`.

A file's name is its view's name. Its first line is a comment that states the question; it becomes the view's comment.
The rest is one query over the lake's tables and other views.
"""

from __future__ import annotations

import dataclasses
import graphlib
import re
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from schemas.tables import TABLES

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class View:
    """A question about the lake and the query that answers it. `note` says how to read the answer; often empty."""

    name: str
    question: str
    note: str
    query: str


@cache
def views() -> tuple[View, ...]:
    """All views, by name.

    Raises:
        ValueError: a file does not begin with its question, or has the name of a table.
    """
    folder = resources.files("warehouse") / "views"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".sql")), key=lambda entry: entry.name)
    return tuple(_parse(file.name.removesuffix(".sql"), file.read_text(encoding="utf-8")) for file in files)


def listing() -> list[tuple[str, str]]:
    """Name and question of every view, by name."""
    return [(view.name, view.question) for view in views()]


def install(connection: duckdb.DuckDBPyConnection) -> None:
    """Create every view in `connection`, which has a table or view for each table of the lake.

    Views that other views ask are created first. Installing twice changes nothing.

    Raises:
        ValueError: two views ask each other.
    """
    for view in _ordered():
        connection.execute(f'CREATE OR REPLACE VIEW "{view.name}" AS {view.query}')
        comment = view.question.replace("'", "''")
        connection.execute(f"COMMENT ON VIEW \"{view.name}\" IS '{comment}'")


def _parse(name: str, text: str) -> View:
    """The view in one file."""
    lines = text.strip().splitlines()
    header = []
    while lines and lines[0].startswith("--"):
        header.append(lines.pop(0).removeprefix("--").strip())
    if not header or not header[0].endswith("?"):
        raise ValueError(f"views/{name}.sql: the first line must be a comment that asks a question")
    if name in TABLES:
        raise ValueError(f"views/{name}.sql: {name} is a table")
    return View(name, header[0], " ".join(header[1:]), "\n".join(lines).strip().removesuffix(";"))


def _ordered() -> list[View]:
    """Views in an order in which each comes after those that it asks."""
    by_name = {view.name: view for view in views()}
    asks = {name: sorted(set(_ASKED.findall(view.query)) & by_name.keys()) for name, view in by_name.items()}
    try:
        return [by_name[name] for name in graphlib.TopologicalSorter(asks).static_order()]
    except graphlib.CycleError as error:
        raise ValueError(f"views ask each other: {' -> '.join(error.args[1])}") from error


_ASKED = re.compile(r"\b(?:FROM|JOIN)\s+(\w+)")
