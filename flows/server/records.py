"""The scene's rows in Prefect's SQLite database, found in every column of every table and removed while a server may use it."""

from __future__ import annotations

import contextlib
import json
import re
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from schemas.errors import InputError, LakeError
from tasks.batches import parse_json
from warehouse.questions.quoting import literal, quoted
from warehouse.upkeep.erasure import Traces
from warehouse.upkeep.erasure.traces import ERASED

WAIT_SECONDS = 30.0
"""Wait for a lock of a running server: its longest transactions clean up old events in batches and take seconds."""

KEPT_TABLES = frozenset({
    "automation", "automation_related_resource", "block_document", "concurrency_limit", "concurrency_limit_v2", "configuration",
    "deployment", "deployment_schedule", "deployment_version", "flow_run_state", "saved_search", "task_run_state", "variable",
    "work_pool", "work_queue",
})  # fmt: skip
"""Settings of people, and states of runs that may be about other scenes: their texts are redacted, the rows stay."""

_ID = re.compile(r"(?<![0-9a-f-])[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}(?![0-9a-f-])")


class PrefectDatabase:
    """A local database of Prefect. Its tables and their columns are read from the file: a new version may have others."""

    def __init__(self, file: Path, traces: Traces) -> None:
        """Open a database that exists.

        Raises:
            LakeError: the file cannot be opened as a database.
        """
        self.file, self._traces = file, traces
        self._gone: set[str] = set()
        self._connection = sqlite3.connect(f"{file.absolute().as_uri()}?mode=rw", uri=True, timeout=WAIT_SECONDS, isolation_level=None)
        try:
            self._prepare()
        except (sqlite3.Error, LakeError):
            self._connection.close()
            raise

    def _prepare(self) -> None:
        connect = self._connection
        connect.create_function("tells", 1, lambda value: _tells(value, self._traces), deterministic=True)
        connect.create_function("redacted", 1, lambda value: redacted_text(value, self._traces), deterministic=True)
        connect.create_function("names_gone", 1, lambda value: not self._gone.isdisjoint(_ID.findall(_text(value))))
        with self._asking():
            tables = connect.execute("SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite@_%' ESCAPE '@'")
            names = [name for (name,) in tables.fetchall()]
            # Hidden columns are those of virtual tables; generated ones follow from the others.
            self._columns = {
                name: [row[1] for row in connect.execute(f"PRAGMA table_xinfo({quoted(name)})") if row[6] == 0] for name in names
            }
            self._keys = {name: self._keys_to(name, names) for name in names}
            connect.execute("PRAGMA secure_delete = ON")
            # The rows that hang on others are removed here, whichever action a key declares.
            connect.execute("PRAGMA foreign_keys = OFF")

    def _keys_to(self, parent: str, names: Collection[str]) -> list[tuple[str, str, str, bool]]:
        """Foreign keys to a table: child, column, referenced column, and whether a child goes with its parent."""
        keys = []
        for child in names:
            needed = {row[1] for row in self._connection.execute(f"PRAGMA table_info({quoted(child)})") if row[3]}
            for row in self._connection.execute(f"PRAGMA foreign_key_list({quoted(child)})"):
                if row[2] == parent and child != parent:
                    keys.append((child, row[3], row[4] or "id", row[6] == "CASCADE" or row[3] in needed))
        return keys

    def count(self) -> dict[str, int]:
        """Rows per table that tell of the scene; tables without any are left out."""
        with self._asking():
            counts = {
                table: self._ask(f"SELECT count(*) FROM {quoted(table)} WHERE {self._telling(table)}")[0][0] for table in self._columns
            }
        return {table: count for table, count in counts.items() if count}

    def rows(self) -> int:
        """Number of rows in all tables."""
        with self._asking():
            return sum(int(self._ask(f"SELECT count(*) FROM {quoted(table)}")[0][0]) for table in self._columns)

    def erase(self) -> tuple[int, int]:
        """Delete the scene's rows and all that name a deleted row, and redact rows that others need; the number of each.

        Raises:
            LakeError: another process holds the database for too long; nothing changed then.
        """
        deleted = redacted = 0
        with self._asking():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                histories = [table for table in self._columns if not self._is_kept(table)]
                for table in histories:
                    deleted += self._delete(table, self._telling(table))
                for table in histories if self._gone else ():
                    # A task run of another scene may name one that went as its input: it stays.
                    if not self._dependents(table):
                        deleted += self._delete(table, _any("names_gone({})", self._columns[table]))
                for table in self._columns:
                    redacted += self._redact(table) if self._is_kept(table) else 0
                self._connection.execute("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):  # the first error is the one to report
                    self._connection.execute("ROLLBACK")
                raise
        return deleted, redacted

    def shrink(self) -> None:
        """Write the file again without its free pages, and empty its write-ahead log.

        Does nothing if another process reads for too long; a search of the files then finds the bytes that stay.
        """
        with contextlib.suppress(sqlite3.OperationalError):
            self._connection.execute("VACUUM")
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _is_kept(self, table: str) -> bool:
        """True if rows of a table are redacted: people set them up, or rows about other scenes hang on them."""
        return table in KEPT_TABLES or any(self._dependents(child) for child in self._dependents(table))

    def _dependents(self, table: str) -> set[str]:
        """Tables whose rows go with those of a table."""
        return {child for child, _, _, goes_along in self._keys[table] if goes_along}

    def _telling(self, table: str) -> str:
        """SQL that is true of rows that tell of the scene. The quick search for cores leaves few values to look at closely."""
        cores = " OR ".join(f"instr({{0}}, {literal(core)})" for core in self._traces.cores)
        hashes = " OR length({0}) >= 64" if self._traces.hashes else ""
        return _any(f"(({cores}{hashes}) AND tells({{0}}))", self._columns[table])

    def _delete(self, table: str, where: str, parents: tuple[str, ...] = ()) -> int:
        """Delete rows and those that hang on them; how many went, without these. `parents`: tables whose deletion led here."""
        for child, column, referenced, goes_along in self._keys[table]:
            if child in parents:
                continue
            hanging = f"{quoted(column)} IN (SELECT {quoted(referenced)} FROM {quoted(table)} WHERE {where})"
            if goes_along:
                self._delete(child, hanging, (*parents, table))
            else:
                self._ask(f"UPDATE {quoted(child)} SET {quoted(column)} = NULL WHERE {hanging}")
        if "id" in self._columns[table]:
            self._gone |= {str(name) for (name,) in self._ask(f"SELECT id FROM {quoted(table)} WHERE {where}")}
        return self._connection.execute(f"DELETE FROM {quoted(table)} WHERE {where}").rowcount

    def _redact(self, table: str) -> int:
        """Redact texts of rows that stay; how many rows changed."""
        where = self._telling(table)
        count = int(self._ask(f"SELECT count(*) FROM {quoted(table)} WHERE {where}")[0][0])
        for column in self._columns[table] if count else ():
            change = f"UPDATE {quoted(table)} SET {quoted(column)} = redacted({quoted(column)}){{}} WHERE tells({quoted(column)})"
            try:
                self._connection.execute(change.format(""))
            except sqlite3.IntegrityError:  # a name that may be there once only
                self._connection.execute(change.format(" || '-' || rowid"))
        return count

    def _ask(self, sql: str) -> list[tuple[Any, ...]]:
        return self._connection.execute(sql).fetchall()

    @contextlib.contextmanager
    def _asking(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise LakeError(
                f"{self.file}: the scene's rows cannot be removed ({error}); stop Prefect's server and give the same command again"
            ) from error


def redacted_text(value: Any, traces: Traces) -> Any:
    """A value of a row that stays: every JSON text or line that tells of the scene becomes `erased`."""
    text = _text(value)
    try:
        document = parse_json(text.encode(), "a value of Prefect")
    except InputError:
        document = None
    if isinstance(document, dict | list | str):
        return json.dumps(_redacted_value(document, traces), ensure_ascii=False)
    return _redacted_lines(text, traces)


def _redacted_value(value: Any, traces: Traces) -> Any:
    if isinstance(value, dict):
        return {_redacted_lines(name, traces): _redacted_value(item, traces) for name, item in value.items()}
    if isinstance(value, list):
        return [_redacted_value(item, traces) for item in value]
    return _redacted_lines(value, traces) if isinstance(value, str) else value


def _redacted_lines(text: str, traces: Traces) -> str:
    """A text without the lines that name the scene, since these may also name its objects."""
    return "\n".join(ERASED if traces.in_text(line) else line for line in text.split("\n"))


def _tells(value: Any, traces: Traces) -> bool:
    return value is not None and traces.in_text(_text(value))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _any(condition: str, columns: Collection[str]) -> str:
    """SQL that is true if a condition is true of any column."""
    return "(" + " OR ".join(["false", *(condition.format(quoted(column)) for column in columns)]) + ")"
