"""What views and macros read, as DuckDB's parser sees it: tables, other views, macros; and the page that says so both ways."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Set
from functools import cache
from typing import TYPE_CHECKING, Any

from schemas.tables import TABLES
from warehouse.questions.macros import Macro, macros
from warehouse.questions.views import View, views

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class Reads:
    """What a view or macro names directly, and the tables that it depends on in the end. All in the order of the catalog."""

    tables: tuple[str, ...]
    views: tuple[str, ...]
    macros: tuple[str, ...]
    rests_on: tuple[str, ...]


@cache
def reads() -> dict[str, Reads]:
    """What every view and macro reads, by its name: views first, then macros."""
    named = _named()
    direct = {name: names & (TABLES.keys() | named.keys()) for name, names in named.items()}

    def rests_on(name: str) -> frozenset[str]:
        below = direct[name]
        return (below & TABLES.keys()).union(*(rests_on(other) for other in below - TABLES.keys()))

    def among(known: Iterable[str], names: Set[str]) -> tuple[str, ...]:
        return tuple(name for name in known if name in names)

    all_views, all_macros = [view.name for view in views()], [macro.name for macro in macros()]
    return {
        name: Reads(among(TABLES, names), among(all_views, names), among(all_macros, names), among(TABLES, rests_on(name)))
        for name, names in direct.items()
    }


def sources(connection: duckdb.DuckDBPyConnection, query: str) -> frozenset[str]:
    """Names that a query reads from or calls, in lower case, but for those that its own WITH gives.

    Raises:
        ValueError: DuckDB cannot parse it.
    """
    tree = json.loads(connection.execute("SELECT json_serialize_sql(?)", [query]).fetchall()[0][0])
    if tree["error"]:
        raise ValueError(f"{tree['error_message']}: {query}")
    return frozenset(_names(tree["statements"], frozenset()))


def _named() -> dict[str, frozenset[str]]:
    """Names in the query of every view and macro."""
    import duckdb

    queries = {view.name: view.query for view in views()}
    queries |= {macro.name: macro.body if macro.is_table else f"SELECT {macro.body}" for macro in macros()}
    with duckdb.connect(":memory:") as connection:
        return {name: sources(connection, query) for name, query in queries.items()}


def _names(node: Any, hidden: frozenset[str]) -> Iterator[str]:
    """Names below a node of a parse tree. `hidden` are those that a WITH around it gives: a part of it sees the parts before it."""
    if isinstance(node, list):
        for item in node:
            yield from _names(item, hidden)
    if not isinstance(node, dict):
        return
    if node.get("type") == "BASE_TABLE" and node["table_name"].lower() not in hidden:
        yield node["table_name"].lower()
    if node.get("class") == "FUNCTION":
        yield node["function_name"].lower()
    if node.get("type") == "RECURSIVE_CTE_NODE":
        hidden |= {node["cte_name"].lower()}
    for part in node.get("cte_map", {}).get("map", []):
        yield from _names(part["value"], hidden)
        hidden |= {part["key"].lower()}
    for key, value in node.items():
        if key != "cte_map":
            yield from _names(value, hidden)


def reads_sentence(question: View | Macro) -> str:
    """What a view or macro reads and who reads it, with links from `docs/views.md`; empty for a macro that reads nothing."""
    read = reads()[question.name]
    parts = [f"Reads {_joined((*_links(read.tables, 'tables.md'), *_links((*read.views, *read.macros), '')))}."] if _all(read) else []
    readers = [name for name, other in reads().items() if question.name in (*other.views, *other.macros)]
    if readers:
        parts.append(f"Read by {_joined(_links(readers, ''))}.")
    return " ".join(parts)


def reads_page() -> str:
    """`docs/reads.md`: which views read which tables, and the other way round, Markdown."""
    parts = [
        "# From tables to views",
        "",
        "Generated from the SQL of views and macros, as DuckDB parses it: do not edit. What a stage writes is in [Tables](tables.md),",
        "what a view answers in [Views and macros](views.md).",
        "",
        "## What reads a table",
        "",
        "| table | read by | and through these by |",
        "|---|---|---|",
    ]
    for table in TABLES:
        directly = [name for name, read in reads().items() if table in read.tables]
        through = [name for name, read in reads().items() if table in read.rests_on and name not in directly]
        cells = (_links([table], "tables.md"), _links(directly, "views.md"), _links(through, "views.md"))
        parts.append(f"| {' | '.join(', '.join(cell) for cell in cells)} |")
    parts += ["", "## What a view or macro reads", "", "| view or macro | reads | rests on the tables |", "|---|---|---|"]
    for name, read in reads().items():
        read_itself = (*_links(read.tables, "tables.md"), *_links((*read.views, *read.macros), "views.md"))
        cells = (_links([name], "views.md"), list(read_itself), _links(read.rests_on, "tables.md"))
        parts.append(f"| {' | '.join(', '.join(cell) for cell in cells)} |")
    return "\n".join(parts) + "\n"


def _all(read: Reads) -> tuple[str, ...]:
    return (*read.tables, *read.views, *read.macros)


def _links(names: Iterable[str], page: str) -> list[str]:
    return [f"[`{name}`]({page}#{name})" for name in names]


def _joined(words: Iterable[str]) -> str:
    """Words as an enumeration: a, b and c."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
