"""Rows for tests, made from the schemas: one valid row of any record type, and Hypothesis strategies of them."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta
from typing import Any

import pyarrow as pa
from hypothesis import strategies as st

from schemas.optimization import BODY_PATTERN
from schemas.record import Column, table_of
from schemas.runs import StageRun

START = datetime(2026, 1, 1, tzinfo=UTC)


def fingerprint(*words: object) -> str:
    """A fingerprint made of words."""
    return hashlib.sha256("|".join(map(str, words)).encode()).hexdigest()


def stage_run(scene_id: str, stage: str, print_: str, *upstream: str, at: float = 0.0, **values: Any) -> StageRun:
    """A done run that started `at` seconds after START."""
    given: dict[str, Any] = {
        "scene_id": scene_id, "stage": stage, "fingerprint": print_, "attempt": 1, "outcome": "done", "upstream": upstream,
        "reasons": (), "config": "{}", "row_counts": (), "degradations": (), "error": None, "error_kind": None,
        "started_at": START + timedelta(seconds=at), "seconds": 1.0, "host": "here:1", "peak_memory_mb": 1.0, "snapshot_id": 0,
    }  # fmt: skip
    return StageRun(**(given | values))


def sample(record: type, **values: Any) -> Any:
    """A valid row of a record type; `values` are taken as given, the others made up from the column."""
    return record(**{c.name: values[c.name] if c.name in values else _made_up(c) for c in table_of(record).columns})


_PATTERNS = {
    r"[0-9]{4,}": "0001",
    r"[0-9]{6}": "000001",
    r"[0-9a-f]{64}": "a" * 64,
    r"[A-Za-z0-9][A-Za-z0-9_.-]*": "batch-1",
    BODY_PATTERN: "wall_00",
}


def _made_up(column: Column) -> Any:
    if column.nullable:
        return None
    if column.values:
        return column.values[0]
    if column.blob:
        return "b" * 64 + ".glb"
    if column.pattern:
        return _PATTERNS.get(column.pattern, "demo/room_a")
    if pa.types.is_list(column.type):
        inner = column.type.value_type
        number: Any = max(1, int(column.minimum or 1)) if pa.types.is_integer(inner) else max(1.0, column.minimum or 1.0)
        if column.maximum is not None:
            number = min(number, type(number)(column.maximum))
        item: Any = "word" if pa.types.is_string(inner) else (1.0, 2.0) if pa.types.is_list(inner) else number
        return (item,) * (column.length or 2)
    if pa.types.is_string(column.type):
        return "text"
    if pa.types.is_boolean(column.type):
        return True
    if pa.types.is_timestamp(column.type):
        return START
    number = max(1.0, column.minimum or 1.0) if column.maximum is None else min(max(1.0, column.minimum or 1.0), column.maximum)
    return int(number) if pa.types.is_integer(column.type) else number


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
