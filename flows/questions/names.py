"""Names that a statement on a lake can use: what `\\d` lists, and what a half-typed word may become."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from warehouse.questions.attached import Attached
from warehouse.questions.catalog import CatalogEntry, entries

if TYPE_CHECKING:
    from warehouse.tables.snapshot import Reader

COMMANDS = {
    r"\d": "list tables, views, macros and attached files",
    r"\d NAME": "list the columns of one of them",
    r"\x": "rows as one line per column, or as a table again",
    r"\?": "this list",
    r"\q": "leave, as Ctrl-D does",
}
"""What a prompt understands besides SQL."""

_BEFORE_RELATIONS = frozenset({"from", "join", "describe", "summarize", "show", "table"})
_WORDS = re.compile(r"\w+")


class SqlNames:
    """Tables, views, macros, attached files, their columns, and words of SQL. All is looked up once, when it is first asked for."""

    def __init__(self, reader: Reader, attached: Sequence[Attached] = ()) -> None:
        self._reader, self._attached = reader, attached

    @cached_property
    def listed(self) -> tuple[CatalogEntry, ...]:
        """The catalog, attached files first."""
        files = (CatalogEntry("file", each.name, each.name, None, f"The file {each.path}.", "") for each in self._attached)
        return (*files, *entries())

    @cached_property
    def columns(self) -> dict[str, list[tuple[str, str, str]]]:
        """Columns of every table, view and file: name, type, and what is said of them."""
        columns: dict[str, list[tuple[str, str, str]]] = {}
        with self._reader.connect(attached=self._attached) as connection:
            sql = "SELECT table_name, column_name, data_type, coalesce(comment, '') FROM duckdb_columns() WHERE NOT internal"
            for table, *column in connection.execute(f"{sql} ORDER BY table_name, column_index").fetchall():
                columns.setdefault(table, []).append((column[0], column[1], column[2]))
        return columns

    @cached_property
    def keywords(self) -> tuple[str, ...]:
        """Words of SQL that are no names, in capitals."""
        import duckdb

        with duckdb.connect(":memory:") as connection:
            sql = "SELECT upper(keyword_name) FROM duckdb_keywords() WHERE keyword_category <> 'column_name' ORDER BY 1"
            return tuple(word for (word,) in connection.execute(sql).fetchall())

    def completions(self, before: str, word: str) -> list[str]:
        """What a word may become that stands behind `before`, the statement so far: sorted, nothing twice."""
        if word.startswith("\\"):
            return _beginning(word, sorted({command.split()[0] for command in COMMANDS}))
        relations = [entry.name for entry in self.listed if entry.kind != "macro"]
        if before.lstrip().startswith(r"\d"):
            return _beginning(word, relations)
        macros = [entry.name + "(" for entry in self.listed if entry.kind == "macro"]
        words = _WORDS.findall(before.lower())
        if words and words[-1] in _BEFORE_RELATIONS:
            return _beginning(word, [*relations, *macros])
        named = [self.columns[name] for name in dict.fromkeys(words) if name in self.columns]
        columns = [name for held in named or self.columns.values() for name, _, _ in held]
        keywords = [keyword.lower() if word.islower() else keyword for keyword in self.keywords]
        return _beginning(word, [*columns, *relations, *macros, *keywords])


def _beginning(word: str, names: Sequence[str]) -> list[str]:
    return sorted({name for name in names if name.lower().startswith(word.lower())})
