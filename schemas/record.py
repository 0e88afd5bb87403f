"""What a record is: a frozen dataclass whose fields carry type, unit, constraint and description.

A record type is the one truth about a table. From it come the Arrow schema (`arrow_schema`),
the check of every row (`check`), SQL comments and the documentation pages.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any, Literal, TypeVar, dataclass_transform

import pyarrow as pa

from schemas.errors import RecordError

Grain = Literal[
    "scene", "room", "rescan", "asset", "library", "annotation_batch", "trajectory_batch", "drive_batch", "dataset", "comparison", "lake"
]  # fmt: skip
WriteRule = Literal["replace", "append", "share"]

BLOB_PATTERN = r"[0-9a-f]{64}\.[a-z0-9]{1,8}"
SCENE_PATTERN = r"[a-z0-9][a-z0-9_.-]*/[A-Za-z0-9][A-Za-z0-9_.-]*"
INSTANCE_PATTERN = r"[0-9]{4,}"


@dataclasses.dataclass(frozen=True, slots=True)
class Column:
    """One field of a record: its type, unit, constraint and description."""

    name: str
    type: pa.DataType
    nullable: bool
    description: str
    unit: str
    key: bool
    volatile: bool
    minimum: float | None
    maximum: float | None
    values: tuple[str, ...]
    pattern: str
    length: int | None
    blob: bool
    earlier: int | bool | None

    @property
    def comment(self) -> str:
        """Description, unit and constraint in one line, as SQL and the documentation show it."""
        return f"{self.description} [{self.unit}]" if self.unit else self.description

    def broken_rule(self, value: Any) -> str | None:
        """The rule that `value` breaks, or None."""
        if value is None:
            return None if self.nullable else "must not be missing"
        if self.values and value not in self.values:
            return f"must be one of {', '.join(self.values)}, got {value!r}"
        if self.pattern and not re.fullmatch(self.pattern, value):
            return f"must match {self.pattern}, got {value!r}"
        if self.length is not None and len(value) != self.length:
            return f"must have {self.length} values, got {len(value)}"
        for number in _numbers(value):
            if isinstance(number, int) and not _fits(number, self):
                return f"must fit into 64 bits, got a number of {number.bit_length()} bits"
            if not math.isfinite(number):
                return f"must be finite, got {number}"
            if self.minimum is not None and number < self.minimum:
                return f"must be at least {self.minimum:g}, got {number:g}"
            if self.maximum is not None and number > self.maximum:
                return f"must be at most {self.maximum:g}, got {number:g}"
        return None


@dataclasses.dataclass(frozen=True, slots=True)
class Table:
    """What a table is: its record type, key, grain and how a stage's rows get into it.

    `rule` is ``replace`` (an owner's new rows take the place of its old ones: a scene's, a library's), ``append`` (history is
    kept) or ``share`` (rows are facts about a key that several scenes use; inserted when absent, and
    removed when no row of `shared_by` names the key any more).
    """

    name: str
    record: type
    key: tuple[str, ...]
    grain: Grain
    rule: WriteRule
    stage: str
    description: str
    shared_by: str
    columns: tuple[Column, ...]
    arrow_schema: pa.Schema = dataclasses.field(init=False, repr=False, compare=False)
    """The Arrow schema; descriptions and units are field metadata."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "arrow_schema", _arrow_schema(self))

    @property
    def owner(self) -> str:
        """The column that says whose a row is; '' where rows belong to nobody."""
        return _OWNERS.get(self.grain, "")

    @property
    def volatile_columns(self) -> tuple[str, ...]:
        """Columns that may differ between two runs with the same result (times, hosts, attempts)."""
        return tuple(c.name for c in self.columns if c.volatile)

    @property
    def blob_columns(self) -> tuple[str, ...]:
        """Columns whose values name blobs."""
        return tuple(c.name for c in self.columns if c.blob)

    @property
    def earlier(self) -> dict[str, int | bool]:
        """What rows have in columns that they are older than, by column; in others they miss it."""
        return {c.name: c.earlier for c in self.columns if c.earlier is not None}


def _arrow_schema(table: Table) -> pa.Schema:
    fields = [
        pa.field(c.name, c.type, nullable=c.nullable, metadata={"description": c.description, "unit": c.unit}) for c in table.columns
    ]  # fmt: skip
    return pa.schema(fields, metadata={"table": table.name, "description": table.description})


_OWNERS: dict[Grain, str] = {
    "scene": "scene_id", "rescan": "scene_id", "library": "library", "annotation_batch": "batch_id", "trajectory_batch": "batch_id",
    "drive_batch": "batch_id", "dataset": "training_id", "comparison": "comparison_id",
}  # fmt: skip


def column(
    description: str,
    *,
    unit: str = "",
    volatile: bool = False,
    minimum: float | None = None,
    maximum: float | None = None,
    values: tuple[str, ...] = (),
    pattern: str = "",
    length: int | None = None,
    blob: bool = False,
    earlier: int | bool | None = None,
) -> Any:
    """A field of a record. A field typed ``X | None`` may be missing; all others must be there.

    `earlier` is what rows have that are older than the field.
    """
    return dataclasses.field(
        metadata={
            "description": description,
            "unit": unit,
            "volatile": volatile,
            "minimum": minimum,
            "maximum": maximum,
            "values": values,
            "pattern": pattern or (BLOB_PATTERN if blob else ""),
            "length": length,
            "blob": blob,
            "earlier": earlier,
        }
    )


R = TypeVar("R")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(column,))
def record(
    table: str,
    *,
    key: tuple[str, ...],
    stage: str,
    grain: Grain = "scene",
    rule: WriteRule = "replace",
    shared_by: str = "",
) -> Callable[[type[R]], type[R]]:
    """Make a class the record type of `table`: frozen, keyword-only, with slots."""

    def declare(cls: type[R]) -> type[R]:
        made = dataclasses.dataclass(frozen=True, slots=True, kw_only=True)(cls)
        made.__table__ = {  # type: ignore[attr-defined]
            "name": table, "key": key, "stage": stage, "grain": grain, "rule": rule, "shared_by": shared_by,
        }  # fmt: skip
        return made

    return declare


def table_of(record_type: type[Any]) -> Table:
    """The table that `record_type` describes."""
    if record_type not in _DECLARED:
        _DECLARED[record_type] = _declare(record_type)
    return _DECLARED[record_type]


_DECLARED: dict[type[Any], Table] = {}


def _declare(record_type: type[Any]) -> Table:
    declared = record_type.__table__
    hints = typing.get_type_hints(record_type)
    columns = []
    for field in dataclasses.fields(record_type):
        arrow, nullable = _arrow_type(hints[field.name])
        columns.append(Column(name=field.name, type=arrow, nullable=nullable, key=field.name in declared["key"], **field.metadata))
    description = " ".join((record_type.__doc__ or "").split())
    return Table(record=record_type, description=description, columns=tuple(columns), **declared)


def rows_to_arrow(rows: Sequence[Any], record_type: type) -> pa.Table:
    """Rows as an Arrow table with the schema of `record_type`, sorted by its key.

    Raises:
        RecordError: a row breaks the schema, or two rows have one key.
    """
    table = table_of(record_type)
    check(rows, record_type)
    ordered = sorted(rows, key=lambda row: tuple(getattr(row, name) for name in table.key))
    arrays = [pa.array([getattr(row, c.name) for row in ordered], type=c.type) for c in table.columns]
    return pa.Table.from_arrays(arrays, schema=table.arrow_schema)


def arrow_to_rows(data: pa.Table, record_type: type[R]) -> list[R]:
    """Records of an Arrow table. Columns that an older version did not have are None."""
    table = table_of(record_type)
    columns = []
    for c in table.columns:
        values = data.column(c.name).to_pylist() if c.name in data.schema.names else [None] * data.num_rows
        columns.append([_frozen(value) for value in values] if pa.types.is_list(c.type) else values)
    names = [c.name for c in table.columns]
    return [record_type(**dict(zip(names, values, strict=True))) for values in zip(*columns, strict=True)]


def check(rows: Iterable[Any], record_type: type) -> None:
    """Check every row against its schema.

    Raises:
        RecordError: names table, row, field and rule.
    """
    table, rows = table_of(record_type), list(rows)
    if _are_sound(rows, table):
        return
    seen: set[tuple[Any, ...]] = set()
    for index, row in enumerate(rows):
        if type(row) is not record_type:
            raise RecordError(table.name, str(index), "row", f"must be a {record_type.__name__}, got {type(row).__name__}")
        key = tuple(getattr(row, name) for name in table.key)
        for c in table.columns:
            value = getattr(row, c.name)
            rule = _type_rule(value, c) or c.broken_rule(value)
            if rule:
                raise RecordError(table.name, f"{index} {key}", c.name, rule)
        if key in seen:
            raise RecordError(table.name, f"{index} {key}", ", ".join(table.key), "must be unique")
        seen.add(key)


def _are_sound(rows: Sequence[Any], table: Table) -> bool:
    """Whether rows are seen to keep every rule, column by column, in a tenth of the time of one value after another; false where one does
    not, or may not."""
    if not all(type(row) is table.record for row in rows):
        return False
    columns = {c.name: [getattr(row, c.name) for row in rows] for c in table.columns}
    if not all(_keeps_rules(columns[c.name], c) for c in table.columns):
        return False
    return len(set(zip(*(columns[name] for name in table.key), strict=True))) == len(rows)


def _keeps_rules(values: Sequence[Any], c: Column) -> bool:
    """Whether a column's values are all seen to keep its rules."""
    kinds = set(map(type, values))
    if type(None) in kinds:
        if not c.nullable:
            return False
        values, kinds = [value for value in values if value is not None], kinds - {type(None)}
    if not kinds <= set(_expected(c)):  # of a subclass, too: rare, and the rules take their time for it
        return False
    if (c.values or c.pattern) and not kinds <= {str}:
        return False
    if c.values and not set(values) <= set(c.values):
        return False
    if c.pattern and not all(re.fullmatch(c.pattern, value) for value in set(values)):
        return False
    if c.length is not None and not set(map(len, values)) <= {c.length}:
        return False
    while tuple in kinds:
        if kinds != {tuple}:
            return False
        values = list(itertools.chain.from_iterable(values))
        kinds = set(map(type, values))
    if not kinds & {int, float}:
        return kinds <= {str, bool, datetime}
    return (
        kinds <= {int, float}
        and (int not in kinds or all(_fits(value, c) for value in values if type(value) is int))
        and all(map(math.isfinite, values))
        and (c.minimum is None or min(values) >= c.minimum)
        and (c.maximum is None or max(values) <= c.maximum)
    )


_SCALARS: dict[Any, pa.DataType] = {
    str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_(), datetime: pa.timestamp("us", tz="UTC"),
}  # fmt: skip


def _arrow_type(hint: Any) -> tuple[pa.DataType, bool]:
    """Arrow type and nullability of a type hint."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        inner = [a for a in arguments if a is not type(None)]
        if len(inner) != 1 or len(arguments) != 2:
            raise TypeError(f"a column is one type or one type and None, not {hint}")
        return _arrow_type(inner[0])[0], True
    if origin is tuple:
        element = arguments[0]
        if any(a not in (element, Ellipsis) for a in arguments):
            raise TypeError(f"a tuple column has one element type, not {hint}")
        return pa.list_(_arrow_type(element)[0]), False
    return _SCALARS[hint], False


def _fits(number: int, c: Column) -> bool:
    """True if a whole number fits into 64 bits: as an integer, or as a double in a column of floats."""
    item = c.type.value_type if pa.types.is_list(c.type) else c.type
    return -(2**63) <= number < 2**63 if pa.types.is_integer(item) else abs(number) < 2**1023


def _type_rule(value: Any, c: Column) -> str | None:
    if value is None:
        return None
    expected = _expected(c)
    if not isinstance(value, expected) or (isinstance(value, bool) and expected != (bool,)):
        return f"must be {expected[0].__name__}, got {type(value).__name__} {value!r:.80}"
    return None


def _expected(c: Column) -> tuple[type, ...]:
    """Types of a column's values, that of messages first."""
    if pa.types.is_list(c.type):
        return (tuple,)
    if pa.types.is_string(c.type):
        return (str,)
    if pa.types.is_boolean(c.type):
        return (bool,)
    if pa.types.is_integer(c.type):
        return (int,)
    return (float, int) if pa.types.is_floating(c.type) else (datetime,)


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int | float):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)


def _frozen(value: Any) -> Any:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
