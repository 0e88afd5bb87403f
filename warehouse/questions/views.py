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
from typing import TYPE_CHECKING

from schemas.tables import TABLES
from warehouse.questions import macros
from warehouse.questions.quoting import literal
from warehouse.questions.renames import former_values, former_views, with_former

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class View(macros.Question):
    """A question about the lake and the query that answers it."""

    query: str


@cache
def views() -> tuple[View, ...]:
    """All views, by name.

    Raises:
        ValueError: a file does not begin with its question and version, or has the name of a table.
    """
    return tuple(_parse(name, text) for name, text in macros.sql_files("views"))


def install(connection: duckdb.DuckDBPyConnection, names: frozenset[str] | None = None) -> None:
    """Create every view and macro in `connection`, which has a table or view for each table of the lake; or only those of `names`.

    What others ask is created first: scalar macros, views, table macros. Installing twice changes nothing.

    Raises:
        ValueError: two views ask each other.
    """
    asked = [macro for macro in macros.macros() if names is None or macro.name in names]
    statements = [statement for macro in asked if not macro.is_table for statement in macro.statements]
    for view in (view for view in _ordered() if names is None or view.name in names):
        statements.append(f'CREATE OR REPLACE VIEW "{view.name}" AS {with_former(view.name, view.query)}')
        statements.append(f'COMMENT ON VIEW "{view.name}" IS {literal(view.comment)}')
        statements += [
            f'COMMENT ON COLUMN "{view.name}"."{before}" IS {literal(f"Old name of {after}; it goes with the next version.")}'
            for before, after in former_values(view.name).items()
        ]
    for before, after in former_views().items():
        if names is None or before in names:
            statements.append(f'CREATE OR REPLACE VIEW "{before}" AS FROM "{after}"')
            statements.append(f'COMMENT ON VIEW "{before}" IS {literal(f"Old name of {after}; it goes with the next version.")}')
    statements += [statement for macro in asked if macro.is_table for statement in macro.statements]
    connection.execute(";\n".join(statements))


def asked_by(sql: str) -> frozenset[str] | None:
    """Views and macros that a statement names, with all that they depend on; None where it inspects the catalog and may see any.

    Every word that is a name counts, wherever it stands: one too many does no harm.
    """
    if _LOOKS_ABOUT.search(sql):
        return None
    texts = {view.name: view.query for view in views()} | {macro.name: macro.body for macro in macros.macros()} | former_views()
    names: set[str] = set()
    ahead = [sql]
    while ahead:
        fresh = ({word.lower() for word in _WORD.findall(ahead.pop())} & texts.keys()) - names
        names |= fresh
        ahead += [texts[name] for name in fresh]
    return frozenset(names)


def _parse(name: str, text: str) -> View:
    """The view in one file."""
    question, note, version, statement = macros.read_header(f"views/{name}.sql", text)
    if name in TABLES:
        raise ValueError(f"views/{name}.sql: {name} is a table")
    return View(name, question, note, version, statement)


def _ordered() -> list[View]:
    """Views in an order in which each comes after those that it asks."""
    by_name = {view.name: view for view in views()}
    asks = {name: sorted(set(_ASKED.findall(view.query)) & by_name.keys()) for name, view in by_name.items()}
    try:
        return [by_name[name] for name in graphlib.TopologicalSorter(asks).static_order()]
    except graphlib.CycleError as error:
        raise ValueError(f"views ask each other: {' -> '.join(error.args[1])}") from error


_ASKED = re.compile(r"\b(?:FROM|JOIN)\s+(\w+)")
_WORD = re.compile(r"\w+")
_LOOKS_ABOUT = re.compile(r"show|describe|explain|duckdb_|pragma|information_schema|pg_|sqlite_", re.IGNORECASE)
