"""The catalog: every table, view and macro of a lake with what it answers, its version and its columns."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from schemas.tables import TABLES
from warehouse.questions.documentation import sql_type, tables_page
from warehouse.questions.macros import Macro, macros
from warehouse.questions.quoting import quoted
from warehouse.questions.reads import reads_sentence
from warehouse.questions.renames import former_columns, former_values, former_views, move_out_of
from warehouse.questions.views import View, install, views

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class CatalogEntry:
    """One name that SQL on a lake can use.

    kind: `table`, `view` or `macro`. version: Of a view or macro; None for tables, whose columns only ever grow. text: What a
    table holds, or the question that a view or macro answers. signature: Name and parameters of a macro, else the name.
    """

    kind: str
    name: str
    signature: str
    version: int | None
    text: str
    note: str


def entries() -> list[CatalogEntry]:
    """Tables in the order of the data path, then views and macros by name."""
    listed = [CatalogEntry("table", name, name, None, table.description, "") for name, table in TABLES.items()]
    listed += [CatalogEntry("view", view.name, view.name, view.version, view.question, view.note) for view in views()]
    listed += [
        CatalogEntry("view", old, old, None, f"Old name of {new}; it goes with the next version.", "")
        for old, new in former_views().items()
    ]
    listed += [CatalogEntry("macro", macro.name, macro.signature, macro.version, macro.question, macro.note) for macro in macros()]
    return listed


def empty_lake() -> duckdb.DuckDBPyConnection:
    """A DuckDB connection with every table, empty, and every view and macro, as those of a lake without rows."""
    import duckdb

    connection = duckdb.connect(":memory:")
    connection.execute("SET TimeZone = 'UTC'")
    for name, table in TABLES.items():
        columns = [f"{quoted(column.name)} {sql_type(column.type)}" for column in table.columns]
        columns += [f"{quoted(before)} AS ({quoted(after)})" for before, after in former_columns(name).items()]
        move = move_out_of(name)
        if move is not None:
            moved = {column.name: sql_type(column.type) for column in TABLES[move.after].columns}
            columns += [f"{quoted(column)} {moved[column]} AS (NULL)" for column in move.columns]
        connection.execute(f"CREATE TABLE {quoted(name)} ({', '.join(columns)})")
    install(connection)
    return connection


def described(connection: duckdb.DuckDBPyConnection, question: View | Macro) -> dict[str, Any]:
    """What of a view or macro a query may rely on: version, parameters, and the columns with their types, without old names.

    A scalar macro has none; a table macro's are those that it has with NULL for every parameter without a default.
    """
    facts: dict[str, Any] = {"name": question.name, "version": question.version}
    if isinstance(question, View):
        former = former_columns(question.name)
        return facts | {"columns": {n: kind for n, kind in _columns(connection, quoted(question.name)).items() if n not in former}}
    facts |= {"parameters": list(question.parameters), "is_table": question.is_table}
    if question.is_table:
        given = ", ".join("NULL" for parameter in question.parameters if ":=" not in parameter)
        facts |= {"columns": _columns(connection, f"{quoted(question.name)}({given})")}
    return facts


def views_page() -> str:
    """`docs/views.md`: every view and macro, Markdown."""
    parts = [
        "# Views and macros",
        "",
        "Generated from `warehouse/questions/views/` and `warehouse/questions/macros/`: do not edit. One question per file.",
        "A version is raised when columns of a view, or parameters of a macro, come, go or mean something else. Comments on",
        "views and macros in SQL say the same (`duckdb_views()`, `duckdb_functions()`, `information_schema.tables`);",
        "`metascenes sql --list` lists them. [From tables to views](reads.md) says what each reads.",
        "",
        "| name | version | question |",
        "|---|---|---|",
    ]
    asked: list[View | Macro] = [*views(), *macros()]
    parts += [f"| [`{question.name}`](#{question.name}) | {question.version} | {question.question} |" for question in asked]
    with empty_lake() as connection:
        parts += ["", *(_section(connection, question) for question in asked)]
    if former_views():
        old = [f"| `{before}` | [`{after}`](#{after}) |" for before, after in former_views().items()]
        parts += ["## Old names", "", "Views that can still be asked by their old names. These go with the next version.", "",
                  "| old name | name |", "|---|---|", *old, ""]  # fmt: skip
    return "\n".join(parts)


def _section(connection: duckdb.DuckDBPyConnection, question: View | Macro) -> str:
    """The section of a view or macro in the documentation."""
    lines = [f"## `{question.name}`", "", f"{question.question} Version {question.version}."]
    if isinstance(question, Macro):
        kind = "stands in FROM" if question.is_table else "stands where a value stands"
        lines += ["", f"Macro `{question.signature}`: {kind}."]
    if question.note:
        note, example, code = question.note.partition("Example: ")
        lines += ["", note.strip()] if note.strip() else []
        lines += ["", "```sql", code.strip(), "```"] if example else []
    sentence = reads_sentence(question)
    lines += ["", sentence] if sentence else []
    columns = described(connection, question).get("columns", {})
    if columns:
        lines += ["", "| column | type |", "|---|---|", *(f"| `{name}` | {kind} |" for name, kind in columns.items())]
        lines += [
            f"| `{before}` | old name of `{after}`, goes with the next version |" for before, after in former_values(question.name).items()
        ]
    return "\n".join(lines) + "\n"


def _columns(connection: duckdb.DuckDBPyConnection, relation: str) -> dict[str, str]:
    rows = connection.execute(f"DESCRIBE SELECT * FROM {relation}").fetchall()
    return {str(row[0]): str(row[1]) for row in rows}


if __name__ == "__main__":  # `make pages`
    from pathlib import Path

    from warehouse.questions.reads import reads_page

    docs = Path(__file__).resolve().parents[2] / "docs"
    docs.joinpath("tables.md").write_text(tables_page())
    docs.joinpath("views.md").write_text(views_page())
    docs.joinpath("reads.md").write_text(reads_page())
