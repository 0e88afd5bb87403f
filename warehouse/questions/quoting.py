"""Names, values and files as they stand in SQL."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from typing import Any


def quoted(name: str) -> str:
    """A name as SQL identifier."""
    return '"' + name.replace('"', '""') + '"'


def literal(value: Any) -> str:
    """A text, a number, a time, or a tuple of texts as an SQL literal."""
    if isinstance(value, tuple):
        return f"[{listed(value)}]::VARCHAR[]"
    if isinstance(value, datetime):
        return f"{literal(value.isoformat())}::TIMESTAMPTZ"
    return str(value) if isinstance(value, int) else "'" + value.replace("'", "''") + "'"


def listed(values: Iterable[Any]) -> str:
    """Literals with commas between them, in the order of the values."""
    return ", ".join(map(literal, values))


def parquet_files(paths: Iterable[str], extra: str = "") -> str:
    """Parquet files as one relation; `extra` are more options of DuckDB's `read_parquet`."""
    return f"read_parquet([{listed(paths)}], union_by_name = true{extra})"
