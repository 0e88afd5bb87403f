"""SQL on a snapshot: only statements that read, within bounds of memory and time.

DuckDB's COPY can write wherever the connection may read, and a SELECT can hold an INSERT, UPDATE, DELETE or COPY in
its WITH. So a statement is admitted by what its parse tree holds, not by its first word. What it may read is the
connection's affair: the files of one snapshot (see `warehouse.tables.snapshot`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from schemas.text import one_line
from warehouse.questions.macros import table_macros
from warehouse.questions.quoting import quoted
from warehouse.questions.views import asked_by
from warehouse.tables.snapshot import Reader

if TYPE_CHECKING:
    import duckdb

    from warehouse.questions.attached import Attached

BATCH_ROWS = 100_000
"""Rows of an answer that are held at a time: a few tens of MB of the widest tables."""

_SPILL = "20GB"  # what a sort or join may put on disk beyond its memory

# Longer or deeper ones are no questions, and tens of thousands of levels end DuckDB's parser, and the process with it.
_MOST_CHARACTERS = 100_000
_MOST_LEVELS = 200

_READING_NODES = frozenset({"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE", "STATEMENT_NODE"})

# Table functions that read what they are given, the catalog, or the lake's own files (others are out of reach).
# `query` is not among them: it runs any text that it is given.
_TABLE_FUNCTIONS = frozenset(
    (
        *("unnest", "range", "generate_series", "repeat", "repeat_row", "json_each", "json_tree"),
        *("read_parquet", "parquet_scan", "parquet_metadata", "parquet_schema", "parquet_file_metadata"),
        *("summary", "histogram", "histogram_values", "pragma_table_info", "pragma_version"),
    )
)
_CATALOG_FUNCTIONS = re.compile(r"duckdb_[a-z_]+")

# Functions that are called for what they do, not for what they give.
_ACTIONS = frozenset({"nextval", "setval", "setseed", "write_log"})

_EXPLAIN = re.compile(r"\s*EXPLAIN\b(\s+ANALYZE\b|\s*\([^()]*\))?", re.IGNORECASE)

_REMEDY = "only reading is allowed: SELECT, FROM, VALUES, WITH, DESCRIBE, SHOW, SUMMARIZE, EXPLAIN"

# Types without a counterpart in Parquet or JSON are given as DuckDB writes them.
_AS_TEXT = re.compile(r"\b(INTERVAL|UNION|BIT|BIGNUM|VARIANT|GEOMETRY|MAP|TIME WITH TIME ZONE)\b")


@dataclasses.dataclass(frozen=True)
class Answer:
    """The answer to a query: the columns, and the rows in batches that are computed on demand and can be taken once."""

    schema: pa.Schema
    batches: Iterator[pa.RecordBatch]


def read_only(statement: str) -> None:
    """Admit SQL that only reads.

    Raises:
        InputError: it writes, changes settings, does not parse, is not one statement, or is too long or too deep.
    """
    import duckdb

    if len(statement) > _MOST_CHARACTERS:
        problem = f"the statement has {len(statement)} characters, at most {_MOST_CHARACTERS} are read"
        raise InputError("SQL", "", problem, "ask for less at once")
    with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as parser:
        _check_depth(statement)
        try:
            statements = parser.extract_statements(statement)
        except duckdb.Error as error:
            raise InputError("SQL", "", _line(error)) from error
        if not statements:
            raise InputError("SQL", "", "there is no statement", "write a SELECT")
        for parsed in statements:
            kind, text = _kind(parsed), parsed.query
            if kind == "EXPLAIN":
                kind, text = _explained(parser, text)
            if kind != "SELECT":
                remedy = "list the values: PIVOT t ON c IN (...)" if kind == "MULTI" else _REMEDY
                raise InputError("SQL", "", f"{_words(kind)} is not allowed", remedy)
            _check_tree(parser, text)
        if len(statements) > 1:
            raise InputError("SQL", "", f"these are {len(statements)} statements, and one is answered at a time", "ask one after the other")


def query(reader: Reader, sql: str) -> pa.Table:
    """Run SQL on a snapshot and give its rows.

    Raises:
        InputError: it does not only read, or DuckDB refuses it.
    """
    with ask(reader, sql) as answer:
        return pa.Table.from_batches(answer.batches, answer.schema)


@contextlib.contextmanager
def ask(
    reader: Reader,
    sql: str,
    *,
    timeout: float | None = None,
    memory_mb: int | None = None,
    attached: Sequence[Attached] = (),
    begun: Callable[[Callable[[], None]], None] = lambda end: None,
) -> Iterator[Answer]:
    """The answer to SQL on a snapshot: ``with ask(reader, "FROM scenes") as answer: ...``.

    `attached` are files beside the lake's tables (`warehouse.questions.attached`). `begun` is called with what ends the work at once
    when another thread calls it.
    `timeout` [s] ends it, rows taken included. Beyond `memory_mb` [MB] sorts and joins go on in temporary files; values
    that are built whole, such as one list of everything, count only in part.

    Raises:
        InputError: it does not only read, DuckDB refuses it, it takes too long or too much memory, or was ended.
    """
    read_only(sql)
    with contextlib.ExitStack() as stack:
        settings: dict[str, str | int] = {"python_enable_replacements": "false"}
        if memory_mb is not None:
            folder = str(stack.enter_context(temporary_folder()))
            settings |= {"memory_limit": f"{memory_mb}MB", "temp_directory": folder, "max_temp_directory_size": _SPILL}
        names = asked_by(sql)
        connection = stack.enter_context(reader.connect(settings, names, attached))
        if names is not None and not _is_answered(connection, sql):  # DuckDB's refusal then names what comes near, of all there is
            connection = stack.enter_context(reader.connect(settings, attached=attached))
        alarm = _Alarm(connection, timeout)
        stack.callback(alarm.stop)
        begun(alarm.end)
        with _plain_errors(alarm, attached):
            relation = connection.sql(sql)
            stream = _portable(relation).to_arrow_reader(BATCH_ROWS)
        yield Answer(stream.schema, _batches(stream, alarm, attached))


def _is_answered(connection: duckdb.DuckDBPyConnection, sql: str) -> bool:
    """Whether a connection knows all that a statement names."""
    import duckdb

    try:
        connection.sql(sql)
    except duckdb.Error:
        return False
    return True


def _batches(stream: pa.RecordBatchReader, alarm: _Alarm, attached: Sequence[Attached]) -> Iterator[pa.RecordBatch]:
    while True:
        with _plain_errors(alarm, attached):
            if alarm.has_rung:
                raise alarm.error
            try:
                batch = stream.read_next_batch()
            except StopIteration:
                return
        yield batch


class _Alarm:
    """Interrupts a connection when its time is up, or when somebody ends it."""

    def __init__(self, connection: duckdb.DuckDBPyConnection, timeout: float | None) -> None:
        self._connection, self._timeout, self.has_rung, self._is_ended = connection, timeout, False, False
        self._timer = threading.Timer(timeout, self._ring) if timeout else None
        if self._timer:
            self._timer.daemon = True
            self._timer.start()

    @property
    def error(self) -> InputError:
        """What to say when it has rung."""
        if self._is_ended:
            return InputError("SQL", "", "it was interrupted")
        return InputError("SQL", "", f"it takes longer than {self._timeout:g} s", "ask for less, or give it more time")

    def end(self) -> None:
        """Ring now. From another thread than that of the question."""
        self._is_ended = True
        self._ring()

    def stop(self) -> None:
        """Never ring any more. A thread that still held the connection as the process ends would make DuckDB complain."""
        if self._timer:
            self._timer.cancel()
            self._timer.join()

    def _ring(self) -> None:
        self.has_rung = True
        self._connection.interrupt()


@contextlib.contextmanager
def _plain_errors(alarm: _Alarm, attached: Sequence[Attached]) -> Iterator[None]:
    """Errors of DuckDB, which come through Arrow while rows are taken, in one line."""
    import duckdb

    try:
        yield
    except InputError:
        raise
    except (duckdb.Error, pa.ArrowException, MemoryError, OSError) as error:
        if alarm.has_rung:
            raise alarm.error from error
        if isinstance(error, MemoryError | duckdb.OutOfMemoryException) or "Out of Memory" in str(error):
            raise InputError("SQL", "", "it takes more memory than it may", "ask for less, or give it more memory") from error
        text = str(error)
        for each in attached:
            text = text.replace(each.link, str(each.path))
        raise InputError("SQL", "", _line(text)) from error


def _portable(relation: duckdb.DuckDBPyRelation) -> duckdb.DuckDBPyRelation:
    """The relation with a name of its own for every column, and columns of types that only DuckDB has as text."""
    unusual = [bool(_AS_TEXT.search(str(kind))) for kind in relation.types]
    names = list(_unique(relation.columns))
    if not any(unusual) and names == relation.columns:
        return relation
    columns = [(f"CAST(#{i} AS VARCHAR)" if odd else f"#{i}", name) for i, (odd, name) in enumerate(zip(unusual, names, strict=True), 1)]
    return relation.project(", ".join(f"{value} AS {quoted(name)}" for value, name in columns))


def _unique(names: list[str]) -> Iterator[str]:
    """The names, with a number behind those that were there before: ``a``, ``a_1``."""
    seen: set[str] = set()
    for name in names:
        number, free = 0, name
        while free in seen or (number and free in names):
            number += 1
            free = f"{name}_{number}"
        seen.add(free)
        yield free


def _explained(parser: Any, text: str) -> tuple[str, str]:
    """Kind and text of the statement that an EXPLAIN explains, or runs when it is to ANALYZE."""
    import duckdb

    text = _EXPLAIN.sub("", _without_leading_comments(text), count=1)
    try:
        inner = parser.extract_statements(text)
    except duckdb.Error as error:  # comments between the words, for one
        raise InputError("SQL", "", "EXPLAIN of a statement that cannot be told apart", "write it without comments") from error
    return (_kind(inner[0]) if len(inner) == 1 else "EXPLAIN"), text


def _kind(statement: duckdb.Statement) -> str:
    try:
        return str(statement.type.name)
    except ValueError:  # kinds that DuckDB's Python package has no name for
        return "this kind of statement"


def _check_depth(statement: str) -> None:
    """Refuse brackets in brackets without end before the parser follows them."""
    import duckdb

    level = 0
    data = statement.encode()
    tokens = duckdb.tokenize(statement)  # where each begins, in bytes
    ends = [start for start, _ in tokens[1:]] + [len(data)]
    for (start, kind), end in zip(tokens, ends, strict=False):
        if kind == duckdb.token_type.operator:
            for character in data[start:end].decode(errors="replace"):
                level += (character in "([{") - (character in ")]}")
                if level > _MOST_LEVELS:
                    raise InputError("SQL", "", f"brackets are nested more than {_MOST_LEVELS} deep", "ask for less at once")


def _check_tree(parser: Any, text: str) -> None:
    """Refuse a statement whose parse tree holds anything that does not read."""
    tree = json.loads(parser.execute("SELECT json_serialize_sql(?)", [text]).fetchall()[0][0])
    if tree.get("error"):
        raise InputError("SQL", "", _line(tree.get("error_message", "cannot be parsed")), _REMEDY)
    for node in _nodes(tree):
        kind = node.get("type")
        if isinstance(kind, str) and kind.endswith("_NODE") and kind not in _READING_NODES:
            verb = _words(kind.removesuffix("_NODE").removesuffix("_QUERY"))
            raise InputError("SQL", "", f"{verb} inside a statement is not allowed", _REMEDY)
        if kind == "TABLE_FUNCTION":
            name = str(node.get("function", {}).get("function_name", "")).lower()
            if name not in _TABLE_FUNCTIONS and name not in table_macros() and not _CATALOG_FUNCTIONS.fullmatch(name):
                raise InputError("SQL", "", f"the table function {name} is not allowed", "read the lake's tables by name")
        if str(node.get("function_name", "")).lower() in _ACTIONS:
            raise InputError("SQL", "", f"the function {node['function_name']} is not allowed", _REMEDY)


def _nodes(tree: Any) -> Iterator[dict[str, Any]]:
    """All objects of a parse tree. A stack, since statements may be nested deeper than Python's."""
    stack = [tree]
    while stack:
        node = stack.pop()
        if isinstance(node, dict):
            yield node
            stack.extend(node.values())
        elif isinstance(node, list):
            stack.extend(node)


def _without_leading_comments(text: str) -> str:
    return re.sub(r"^(\s+|--[^\n]*(\n|$)|/\*.*?\*/)+", "", text, flags=re.DOTALL)


def _words(kind: str) -> str:
    return kind.replace("_", " ")


def _line(error: object) -> str:
    """An error of DuckDB in one line."""
    return one_line(error)
