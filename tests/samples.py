"""Rows for tests, made from the schemas: one valid row of any record type (the benchmarks' own), and Hypothesis strategies of them."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa
from hypothesis import strategies as st

from bench.samples import START, fingerprint, sample, stage_run
from schemas.record import Column, table_of

__all__ = ["START", "fingerprint", "lasting", "rows", "sample", "stage_run"]


def lasting(row: Any) -> Any:
    """A row without what differs from run to run: its volatile columns, which may be missing."""
    return dataclasses.replace(row, **dict.fromkeys(table_of(type(row)).volatile_columns))


def rows(record: type, most: int = 4) -> st.SearchStrategy[list[Any]]:
    """Lists of valid rows of a record type with different keys."""
    table = table_of(record)
    row = st.builds(record, **{c.name: _values(c) for c in table.columns})
    return st.lists(row, max_size=most, unique_by=lambda one: tuple(getattr(one, name) for name in table.key))


def _values(column: Column) -> st.SearchStrategy[Any]:
    made = _typed(column, column.type)
    return st.none() | made if column.nullable else made


def _typed(column: Column, arrow: pa.DataType) -> st.SearchStrategy[Any]:
    if pa.types.is_list(arrow):
        outer = arrow is column.type
        size = {"min_size": column.length, "max_size": column.length} if column.length is not None and outer else {"max_size": 3}
        return st.lists(_typed(column, arrow.value_type), **size).map(tuple)  # type: ignore[arg-type]
    if pa.types.is_string(arrow):
        if column.values:
            return st.sampled_from(column.values)
        if column.blob or column.pattern == r"[0-9a-f]{64}":  # as the pattern says, but made twenty times as fast
            return st.integers(0, 2**256 - 1).map(lambda number: f"{number:064x}" + (".glb" if column.blob else ""))
        if column.pattern:
            return st.from_regex(column.pattern, fullmatch=True, alphabet=st.characters(codec="ascii"))
        return st.text(st.characters(codec="utf-8"), max_size=8)
    if pa.types.is_boolean(arrow):
        return st.booleans()
    if pa.types.is_timestamp(arrow):
        return st.datetimes(min_value=datetime(1970, 1, 1), max_value=datetime(2200, 1, 1), timezones=st.just(UTC))
    if pa.types.is_integer(arrow):
        low = -(2**63) if column.minimum is None else int(column.minimum)
        return st.integers(low, 2**63 - 1 if column.maximum is None else int(column.maximum))
    return st.floats(column.minimum, column.maximum, allow_nan=False, allow_infinity=False)
