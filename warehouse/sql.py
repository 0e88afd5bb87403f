"""SQL on a snapshot: only statements that read.

DuckDB's COPY can write wherever the connection may read, and a SELECT can hold an INSERT, UPDATE, DELETE or COPY in
its WITH. So a statement is admitted by what its parse tree holds, not by its first word.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator
from datetime import datetime
from typing import Any, Literal

import pyarrow as pa

from schemas.errors import InputError
from warehouse.snapshot import Reader

Output = Literal["table", "csv", "json", "parquet"]
OUTPUTS: tuple[Output, ...] = ("table", "csv", "json", "parquet")

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

_EXPLAIN = re.compile(r"\s*EXPLAIN\b(\s+ANALYZE\b|\s*\([^()]*\))?", re.IGNORECASE)

_REMEDY = "only reading is allowed: SELECT, FROM, VALUES, WITH, DESCRIBE, SHOW, SUMMARIZE, EXPLAIN"


def read_only(statement: str) -> None:
    """Admit SQL that only reads.

    Raises:
        InputError: it writes, changes settings, does not parse, or holds no statement.
    """
    import duckdb

    with duckdb.connect(":memory:", config={"enable_external_access": "false"}) as parser:
        try:
            statements = parser.extract_statements(statement)
        except duckdb.Error as error:
            raise InputError("SQL", "", str(error)) from error
        if not statements:
            raise InputError("SQL", "", "there is no statement", "write a SELECT")
        for one in statements:
            kind, text = one.type.name, one.query
            if kind == "EXPLAIN":
                kind, text = _explained(parser, text)
            if kind != "SELECT":
                remedy = "list the values: PIVOT t ON c IN (...)" if kind == "MULTI" else _REMEDY
                raise InputError("SQL", "", f"{_words(kind)} is not allowed", remedy)
            _check_tree(parser, text)


def query(reader: Reader, sql: str) -> pa.Table:
    """Run SQL on a snapshot and give the rows of its last statement.

    Raises:
        InputError: it does not only read, or DuckDB refuses it.
    """
    import duckdb

    read_only(sql)
    with reader.connect() as connection:
        try:
            return connection.sql(sql).to_arrow_table()
        except duckdb.Error as error:
            raise InputError("SQL", "", str(error)) from error


def format_table(data: pa.Table, output: Output = "table") -> str | bytes:
    """Rows as a text table, as CSV, as a JSON list of objects, or as a Parquet file (bytes)."""
    match output:
        case "table":
            return _text_table(data)
        case "csv":
            return _csv(data)
        case "json":
            rows = [{name: _json_value(value) for name, value in row.items()} for row in data.to_pylist()]
            return json.dumps(rows, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        case "parquet":
            import pyarrow.parquet as pq

            sink = io.BytesIO()
            pq.write_table(data, sink)
            return sink.getvalue()
    raise InputError("output", str(output), "there is no such output", f"choose one of {', '.join(OUTPUTS)}")


def _explained(parser: Any, text: str) -> tuple[str, str]:
    """Kind and text of the statement that an EXPLAIN explains, or runs when it is to ANALYZE."""
    import duckdb

    text = _EXPLAIN.sub("", _without_leading_comments(text), count=1)
    try:
        inner = parser.extract_statements(text)
    except duckdb.Error as error:  # comments between the words, for one
        raise InputError("SQL", "", "EXPLAIN of a statement that cannot be told apart", "write it without comments") from error
    return (inner[0].type.name if len(inner) == 1 else "EXPLAIN"), text


def _check_tree(parser: Any, text: str) -> None:
    """Refuse a statement whose parse tree holds anything that does not read."""
    tree = json.loads(parser.execute("SELECT json_serialize_sql(?)", [text]).fetchall()[0][0])
    if tree.get("error"):
        raise InputError("SQL", "", str(tree.get("error_message", "cannot be parsed")), _REMEDY)
    for node in _nodes(tree):
        kind = node.get("type")
        if isinstance(kind, str) and kind.endswith("_NODE") and kind not in _READING_NODES:
            verb = _words(kind.removesuffix("_NODE").removesuffix("_QUERY"))
            raise InputError("SQL", "", f"{verb} inside a statement is not allowed", _REMEDY)
        if kind == "TABLE_FUNCTION":
            name = str(node.get("function", {}).get("function_name", "")).lower()
            if name not in _TABLE_FUNCTIONS and not _CATALOG_FUNCTIONS.fullmatch(name):
                raise InputError("SQL", "", f"the table function {name} is not allowed", "read the lake's tables by name")


def _nodes(tree: Any) -> Iterator[dict[str, Any]]:
    """All objects of a parse tree. A stack, since statements may be nested deeper than Python's."""
    stack = [tree]
    while stack:
        one = stack.pop()
        if isinstance(one, dict):
            yield one
            stack.extend(one.values())
        elif isinstance(one, list):
            stack.extend(one)


def _without_leading_comments(text: str) -> str:
    return re.sub(r"^(\s+|--[^\n]*(\n|$)|/\*.*?\*/)+", "", text, flags=re.DOTALL)


def _words(kind: str) -> str:
    return kind.replace("_", " ")


def _json_value(value: Any) -> Any:
    """A value as JSON has it: no NaN or infinity, times in ISO 8601, anything unusual as text."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, dict):
        return {str(name): _json_value(item) for name, item in value.items()}
    if isinstance(value, datetime):
        return value.isoformat()
    return str(value)


def _cell(value: Any) -> str:
    """A value as one line of text."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | dict):
        return json.dumps(_json_value(value), ensure_ascii=False)
    return " ".join(str(_json_value(value)).split())


def _csv(data: pa.Table) -> str:
    import csv

    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(data.column_names)
    for row in zip(*(column.to_pylist() for column in data.columns), strict=True):
        writer.writerow([_json_value(value) if not isinstance(value, list | dict) else json.dumps(_json_value(value)) for value in row])
    return sink.getvalue()


def _text_table(data: pa.Table, widest: int = 60) -> str:
    """Rows in columns for a terminal: numbers to the right, long cells cut, the row count below."""
    names = data.column_names
    columns = [[_cell(value) for value in column.to_pylist()] for column in data.columns]
    columns = [[cell if len(cell) <= widest else cell[: widest - 1] + "…" for cell in column] for column in columns]
    widths = [max([len(name), *map(len, column)]) for name, column in zip(names, columns, strict=True)]
    types = pa.types
    right = [types.is_integer(one) or types.is_floating(one) or types.is_decimal(one) for one in data.schema.types]

    def line(cells: Any) -> str:
        return "  ".join(c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True)).rstrip()

    rule = "  ".join("-" * width for width in widths)
    body = [line(row) for row in zip(*columns, strict=True)]
    count = f"({data.num_rows} row{'' if data.num_rows == 1 else 's'})"
    return "\n".join([line(names), rule, *body, count]) + "\n"
