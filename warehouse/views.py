"""Questions that every lake can answer: one SQL view per question, kept as one file each in `views/`.

A file's name is its view's name. Its first line is a comment that states the question, the second the version, further
comment lines say how to read the answer. The rest is one query over the lake's tables, other views, and scalar macros.
The version counts the changes that somebody's query may notice: columns that go, or mean something else.
"""

from __future__ import annotations

import dataclasses
import graphlib
import re
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from schemas.tables import TABLES
from warehouse import macros
from warehouse.renames import former_columns, former_views, with_former

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class View:
    """A question about the lake and the query that answers it. `note` says how to read the answer; often empty."""

    name: str
    question: str
    note: str
    query: str
    version: int

    @property
    def comment(self) -> str:
        """Question, version and note in one line, as SQL shows it."""
        return macros.comment(self.question, self.version, self.note)


@cache
def views() -> tuple[View, ...]:
    """All views, by name.

    Raises:
        ValueError: a file does not begin with its question and version, or has the name of a table.
    """
    folder = resources.files("warehouse") / "views"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".sql")), key=lambda entry: entry.name)
    return tuple(_parse(file.name.removesuffix(".sql"), file.read_text(encoding="utf-8")) for file in files)


def listing() -> list[tuple[str, str]]:
    """Name and question of every view, by name."""
    return [(view.name, view.question) for view in views()]


def install(connection: duckdb.DuckDBPyConnection) -> None:
    """Create every view and macro in `connection`, which has a table or view for each table of the lake.

    What others ask is created first: scalar macros, views, table macros. Installing twice changes nothing.

    Raises:
        ValueError: two views ask each other.
    """
    statements = [statement for macro in macros.macros() if not macro.is_table for statement in macro.statements]
    for view in _ordered():
        statements.append(f'CREATE OR REPLACE VIEW "{view.name}" AS {with_former(view.name, view.query)}')
        statements.append(f'COMMENT ON VIEW "{view.name}" IS {macros.literal(view.comment)}')
        statements += [
            f'COMMENT ON COLUMN "{view.name}"."{before}" IS {macros.literal(f"Old name of {after}; it goes with the next version.")}'
            for before, after in former_columns(view.name).items()
        ]
    for before, after in former_views().items():
        statements.append(f'CREATE OR REPLACE VIEW "{before}" AS FROM "{after}"')
        statements.append(f'COMMENT ON VIEW "{before}" IS {macros.literal(f"Old name of {after}; it goes with the next version.")}')
    statements += [statement for macro in macros.macros() if macro.is_table for statement in macro.statements]
    connection.execute(";\n".join(statements))


def _parse(name: str, text: str) -> View:
    """The view in one file."""
    header = macros.read_header(f"views/{name}.sql", text)
    if name in TABLES:
        raise ValueError(f"views/{name}.sql: {name} is a table")
    return View(name, header.question, header.note, header.body, header.version)


def _ordered() -> list[View]:
    """Views in an order in which each comes after those that it asks."""
    by_name = {view.name: view for view in views()}
    asks = {name: sorted(set(_ASKED.findall(view.query)) & by_name.keys()) for name, view in by_name.items()}
    try:
        return [by_name[name] for name in graphlib.TopologicalSorter(asks).static_order()]
    except graphlib.CycleError as error:
        raise ValueError(f"views ask each other: {' -> '.join(error.args[1])}") from error


_ASKED = re.compile(r"\b(?:FROM|JOIN)\s+(\w+)")
