"""The schemas: golden files, rows that must be refused, and the way of a row to Parquet and back."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.errors import RecordError
from schemas.record import Table, _are_sound, _type_rule, arrow_to_rows, check, rows_to_arrow, table_of
from schemas.tables import RECORDS, TABLES
from tests.conftest import REPOSITORY
from tests.samples import rows, sample
from warehouse.questions.documentation import sql_type, tables_page

GOLDEN = REPOSITORY / "tests" / "golden" / "schemas"
COUNTEREXAMPLES = REPOSITORY / "tests" / "counterexamples"


def described(table: Table) -> dict[str, Any]:
    """What of a table a change of the schema would show."""
    return {
        "table": table.name,
        "key": list(table.key),
        "grain": table.grain,
        "rule": table.rule,
        "stage": table.stage,
        "shared_by": table.shared_by,
        "columns": {
            c.name: {"type": str(c.type), "nullable": c.nullable}
            | {name: value for name in ("unit", "minimum", "maximum", "pattern", "length") if (value := getattr(c, name)) not in ("", None)}
            | ({"values": list(c.values)} if c.values else {})
            | {name: True for name in ("volatile", "blob") if getattr(c, name)}
            for c in table.columns
        },
    }


@pytest.mark.parametrize("name", TABLES)
def test_schema_is_the_golden_one(name: str) -> None:
    file = GOLDEN / f"{name}.json"
    golden = json.loads(file.read_text()) if file.exists() else None
    assert described(TABLES[name]) == golden, "a change on purpose is written with: make golden"


def test_every_golden_schema_has_its_table() -> None:
    assert {path.stem for path in GOLDEN.glob("*.json")} == set(TABLES), "write them with: make golden"


@pytest.mark.parametrize("path", sorted(COUNTEREXAMPLES.glob("*.json")), ids=lambda path: path.stem)
def test_counterexample_is_refused(path: Path) -> None:
    case = json.loads(path.read_text())
    record = TABLES[case["table"]].record
    given_rows = [sample(record, **{name: _plain(value) for name, value in values.items()}) for values in case["rows"]]
    with pytest.raises(RecordError) as refused:
        rows_to_arrow(given_rows, record)
    assert (refused.value.table, refused.value.field) == (case["table"], case["field"])
    assert case["rule"] in str(refused.value)
    assert "\n" not in str(refused.value)


def test_counterexamples_cover_every_table() -> None:
    assert {json.loads(path.read_text())["table"] for path in COUNTEREXAMPLES.glob("*.json")} == set(TABLES)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_sample_row_is_valid(record: type) -> None:
    check([sample(record)], record)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_rows_come_back_from_parquet(record: type, data: st.DataObject) -> None:
    before = data.draw(rows(record))
    table = table_of(record)
    arrow = rows_to_arrow(before, record)
    sink = io.BytesIO()
    pq.write_table(arrow, sink)
    read = pq.read_table(io.BytesIO(sink.getvalue()))
    assert read.schema.equals(table.arrow_schema)  # the name of a list's element is not kept, so metadata is compared by field
    assert [field.metadata for field in read.schema] == [field.metadata for field in table.arrow_schema]
    after = arrow_to_rows(read, record)
    assert after == sorted(before, key=lambda row: tuple(getattr(row, name) for name in table.key))
    check(after, record)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_a_duplicate_key_and_a_stranger_are_refused(record: type) -> None:
    row = sample(record)
    with pytest.raises(RecordError, match="must be unique"):
        rows_to_arrow([row, dataclasses.replace(row)], record)
    stranger = sample(RECORDS[0] if record is not RECORDS[0] else RECORDS[1])
    with pytest.raises(RecordError, match=record.__name__):
        rows_to_arrow([stranger], record)


def first_rule(rows: list[Any], table: Table) -> str | None:
    """What is wrong with rows, by one value after another; None where nothing is."""
    seen: set[tuple[Any, ...]] = set()
    for index, row in enumerate(rows):
        key = tuple(getattr(row, name) for name in table.key)
        for c in table.columns:
            rule = _type_rule(getattr(row, c.name), c) or c.broken_rule(getattr(row, c.name))
            if rule:
                return str(RecordError(table.name, f"{index} {key}", c.name, rule))
        if key in seen:
            return str(RecordError(table.name, f"{index} {key}", ", ".join(table.key), "must be unique"))
        seen.add(key)
    return None


SINGLE = st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=3) | st.sampled_from([1, 1.0, ""])
VALUES = SINGLE | st.lists(SINGLE, max_size=4).map(tuple) | st.lists(st.lists(st.floats(), max_size=3).map(tuple), max_size=3).map(tuple)


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: table.name)
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=20)
@given(data=st.data())
def test_whole_columns_are_checked_as_their_values_are(table: Table, data: st.DataObject) -> None:
    made = data.draw(rows(table.record, 3))
    made += made[: data.draw(st.integers(0, 1))]
    if made and data.draw(st.booleans()):
        place, column = data.draw(st.integers(0, len(made) - 1)), data.draw(st.sampled_from([c.name for c in table.columns]))
        other = data.draw(VALUES | st.sampled_from([getattr(row, column) for row in made]))
        made[place] = dataclasses.replace(made[place], **{column: other})
    try:
        check(made, table.record)
        found = None
    except RecordError as error:
        found = str(error)
    assert found == first_rule(made, table)


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: table.name)
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=5)
@given(data=st.data())
def test_sound_rows_are_checked_by_columns_alone(table: Table, data: st.DataObject) -> None:
    made = list({tuple(getattr(row, name) for name in table.key): row for row in data.draw(rows(table.record, 3))}.values())
    assert _are_sound(made, table)


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: table.name)
def test_every_column_that_must_be_there_is_missed(table: Table) -> None:
    for c in table.columns:
        row = dataclasses.replace(sample(table.record), **{c.name: None})
        if c.nullable:
            check([row], table.record)
        else:
            with pytest.raises(RecordError) as refused:
                check([row], table.record)
            assert refused.value.field == c.name
            assert "missing" in refused.value.rule


@pytest.mark.parametrize("number", [10**400, -(10**400), 2**63])
def test_whole_numbers_that_no_column_holds_are_refused(number: int) -> None:
    """Python's own have no limit, and JSON may state any."""
    tried = 0
    for table in TABLES.values():
        row = sample(table.record)
        for c in table.columns:
            is_integer = pa.types.is_integer(c.type)
            if c.maximum is None and (is_integer or (pa.types.is_floating(c.type) and number != 2**63)):
                with pytest.raises(RecordError, match="64 bits"):
                    check([dataclasses.replace(row, **{c.name: number})], table.record)
                tried += 1
    assert tried > 50


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: table.name)
def test_table_is_well_declared(table: Table) -> None:
    names = [c.name for c in table.columns]
    assert set(table.key) <= set(names)
    assert table.description.endswith((".", ")"))
    assert all(c.description and not c.description.endswith(" ") for c in table.columns)
    assert not any(c.key and c.nullable for c in table.columns)
    if table.rule == "replace" and table.grain != "lake":
        assert table.owner in names
    if table.rule == "share":
        assert len(table.key) == 1
        assert table.key[0] in [c.name for c in TABLES[table.shared_by].columns]
    units = {"_m": "m", "_m2": "m2", "_m3": "m3", "_radians": "rad", "_kg": "kg", "seconds": "s", "_mb": "MB", "_bytes": "B"}
    for c in table.columns:
        for suffix, unit in units.items():
            if c.name.endswith(suffix) and not c.name.endswith("_kg_m3"):
                assert c.unit == unit, c.name
    assert all(sql_type(c.type) for c in table.columns)


def test_rows_are_stored_in_the_order_of_their_key() -> None:
    record = TABLES["captions"].record
    given_rows = [sample(record, instance_id=name) for name in ("0003", "0001", "0002")]
    assert rows_to_arrow(given_rows, record).column("instance_id").to_pylist() == ["0001", "0002", "0003"]
    assert rows_to_arrow(given_rows, record).equals(rows_to_arrow(given_rows[::-1], record))


def test_column_that_an_older_file_lacks_reads_as_missing() -> None:
    record = TABLES["placements"].record
    old = rows_to_arrow([sample(record)], record).drop_columns(["annotator"])
    assert arrow_to_rows(old, record)[0].annotator is None


def test_arrow_schema_carries_descriptions_and_units() -> None:
    field = TABLES["captions"].arrow_schema.field("mass_kg")
    assert field.metadata[b"unit"] == b"kg"
    assert field.metadata[b"description"].decode() == next(c for c in TABLES["captions"].columns if c.name == "mass_kg").description
    assert field.type == pa.float64()
    assert not field.nullable


def test_committed_page_is_what_the_schemas_say() -> None:
    page = REPOSITORY / "docs" / "tables.md"
    assert page.read_text() == tables_page(), "write it with: make golden"
    for table in TABLES.values():
        assert f"\n## `{table.name}`\n" in tables_page()
        for c in table.columns:
            assert f"| `{c.name}` |" in tables_page()


def _plain(value: Any) -> Any:
    return tuple(_plain(item) for item in value) if isinstance(value, list) else value
