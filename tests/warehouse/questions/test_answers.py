"""Forms of an answer: whatever the values, what is written is read back as it was, by readers that are not ours."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.cli import cli
from schemas.captions import Caption
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.questions.test_sql import state
from tests.warehouse.questions.view_answers import format_table
from warehouse.lake import Lake

SCHEMA = pa.schema(
    {
        "number": pa.float64(),
        "single": pa.float32(),
        "whole": pa.int64(),
        "flag": pa.bool_(),
        "text": pa.string(),
        "time": pa.timestamp("us", tz="UTC"),
        "decimal": pa.decimal128(38, 4),
        "numbers": pa.list_(pa.float64()),
        "polygon": pa.list_(pa.list_(pa.float64())),
        "words": pa.list_(pa.string()),
        "pair": pa.struct({"a": pa.int64(), 'b "c"': pa.list_(pa.string())}),
    }
)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=6) | st.sampled_from(
    ["", " a ", '"', "a,b", "NULL", "\r\n", "1.0"]
)
NUMBER = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf, -0.0, 5e-324, 1.7976931348623157e308, 1e22, 3.0])
ROW = st.fixed_dictionaries(
    {
        "number": st.none() | NUMBER,
        "single": st.none() | st.floats(width=32),
        "whole": st.none() | st.integers(-(2**63), 2**63 - 1),
        "flag": st.none() | st.booleans(),
        "text": st.none() | TEXT,
        "time": st.none() | st.datetimes(datetime(1, 1, 2), datetime(9999, 1, 1), timezones=st.just(UTC)),
        "decimal": st.none() | st.decimals(-(10**20), 10**20, places=4),
        "numbers": st.none() | st.lists(st.none() | NUMBER, max_size=3),
        "polygon": st.none() | st.lists(st.none() | st.lists(NUMBER, max_size=2), max_size=3),
        "words": st.none() | st.lists(st.none() | TEXT, max_size=3),
        "pair": st.none() | st.fixed_dictionaries({"a": st.none() | st.integers(-9, 9), 'b "c"': st.none() | st.lists(TEXT, max_size=2)}),
    }
)
ROWS = st.lists(ROW, max_size=5)


def number(value: Any) -> Any:
    """A number as JSON gives it: what it has no number for is a text."""
    return float(value) if isinstance(value, str) else value


def revived(name: str, value: Any) -> Any:
    """A value of JSON as it was."""
    if value is None:
        return None
    match name:
        case "number":
            return number(value)
        case "single":  # as few digits as tell it from other numbers of its size
            return float(np.float32(number(value)))
        case "time":
            return datetime.fromisoformat(value)
        case "numbers":
            return [number(item) for item in value]
        case "polygon":
            return [None if part is None else [number(item) for item in part] for part in value]
    return value


def alike(one: Any, other: Any) -> bool:
    """Equal, where NaN is NaN and -0.0 is not 0.0; a decimal may be read as a float of the same text."""
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, float) and isinstance(other, float):
        return math.isnan(one) == math.isnan(other) and (
            math.isnan(one) or (one == other and math.copysign(1, one) == math.copysign(1, other))
        )
    return type(one) is type(other) and one == other


@settings(max_examples=80, deadline=None)
@given(rows=ROWS, piece=st.integers(1, 3))
def test_json_is_read_back_as_it_was(rows: list[dict[str, Any]], piece: int) -> None:
    data = pa.Table.from_pylist(rows, SCHEMA)
    parts = pa.Table.from_batches([batch for part in range(0, len(rows), piece) for batch in data.slice(part, piece).to_batches()], SCHEMA)
    whole = json.loads(format_table(parts, "json"), parse_constant=_no_constant)
    lines = [json.loads(line, parse_constant=_no_constant) for line in str(format_table(parts, "jsonl")).split("\n")[:-1]]
    assert whole == lines
    expected = data.drop_columns(["decimal"]).to_pylist()
    for found, row in zip(whole, expected, strict=True):
        assert list(found) == SCHEMA.names
        assert all(alike(revived(name, found[name]), value) for name, value in row.items()), (found, row)


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


@settings(max_examples=80, deadline=None)
@given(rows=ROWS)
def test_csv_is_read_back_as_it_was(rows: list[dict[str, Any]]) -> None:
    """By Arrow's reader with the types named; NULL and the empty text apart."""
    data = pa.Table.from_pylist(rows, SCHEMA)
    written = str(format_table(data, "csv"))
    types = {name: pa.string() if pa.types.is_nested(kind) else kind for name, kind in zip(SCHEMA.names, SCHEMA.types, strict=True)}
    found = pyarrow.csv.read_csv(
        io.BytesIO(written.encode()),
        parse_options=pyarrow.csv.ParseOptions(newlines_in_values=True),
        convert_options=pyarrow.csv.ConvertOptions(
            column_types=types, null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False
        ),
    )
    for name in SCHEMA.names:
        values = found[name].to_pylist() if rows else []
        if pa.types.is_nested(SCHEMA.field(name).type):
            values = [revived(name, None if value is None else json.loads(value)) for value in values]
        assert len(values) == len(rows)
        assert all(map(alike, values, data[name].to_pylist())), name


@pytest.mark.whole
@settings(max_examples=80, deadline=None)
@given(rows=ROWS)
def test_csv_is_what_python_and_duckdb_read(rows: list[dict[str, Any]]) -> None:
    import duckdb

    data = pa.Table.from_pylist(rows, SCHEMA).select(["text", "whole"])
    written = str(format_table(data, "csv"))
    lines = list(csv.reader(io.StringIO(written, newline="")))
    assert lines == [
        ["text", "whole"],
        *([row["text"] or "", "" if row["whole"] is None else str(row["whole"])] for row in data.to_pylist()),
    ]
    with duckdb.connect() as connection:
        relation = connection.read_csv(
            io.StringIO(written), header=True, columns={"text": "VARCHAR", "whole": "BIGINT"}, quotechar='"', escapechar='"',
            delimiter=",", auto_detect=False, allow_quoted_nulls=False,
        )  # fmt: skip
        assert relation.fetchall() == [(row["text"], row["whole"]) for row in data.to_pylist()]


@settings(max_examples=40, deadline=None)
@given(rows=ROWS)
def test_parquet_is_read_back_as_it_was(rows: list[dict[str, Any]]) -> None:
    data = pa.Table.from_pylist(rows, SCHEMA)
    written = format_table(data, "parquet")
    assert isinstance(written, bytes)
    found = pq.read_table(io.BytesIO(written))
    assert found.schema.equals(SCHEMA)
    assert all(alike(one, other) for one, other in zip(found.to_pylist(), data.to_pylist(), strict=True))


def test_a_table_says_what_it_leaves_out() -> None:
    data = pa.table({"n": list(range(2500))})
    lines = str(format_table(data, "table", 1000)).splitlines()
    assert lines[-1] == "(the first 1000 of 2500 rows)"
    assert [int(line) for line in lines[2:-1]] == list(range(1000))
    assert str(format_table(data, "table", 2500)).splitlines()[-1] == "(2500 rows)"


def test_an_expanded_table_has_every_value_of_every_row_in_full() -> None:
    rows = [{"name": f"{i}" * 99, "n": i, "none": None, "list": [i, i + 1]} for i in range(5)]
    data = pa.Table.from_pylist(rows)
    lines = str(format_table(data, "expanded")).splitlines()
    for i, row in enumerate(rows):
        head, *told = lines[5 * i : 5 * i + 5]
        assert head == f"[row {i + 1}]"
        assert told == [f"name  {row['name']}", f"n     {i}", "none", f"list  [{i}, {i + 1}]"]
    assert lines[-1] == "(5 rows)"
    assert str(format_table(data, "expanded", 2)).splitlines() == [*lines[:10], "(the first 2 of 5 rows)"]


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    lake = Lake.open(tmp_path_factory.mktemp("answers") / "lake")
    lake.stage_rows(stage_run("demo/a", "captions", fingerprint(1)), {"captions": [sample(Caption, scene_id="demo/a")]})
    lake.commit()
    return lake


def ask(lake: Lake, *words: object, typed: str | bytes | None = None) -> Any:
    return CliRunner().invoke(cli, ["sql", *map(str, words), "--lake", lake.address], input=typed)


def test_a_statement_comes_from_anywhere(lake: Lake, tmp_path: Path) -> None:
    (tmp_path / "question.sql").write_text("-- how many?\nSELECT count(*) AS n, 'ü' AS u\nFROM captions;\n")
    said = ask(lake, "SELECT count(*) AS n, 'ü' AS u FROM captions", "--output", "csv").stdout
    assert said == "n,u\n1,ü\n"
    assert ask(lake, "--file", tmp_path / "question.sql", "--output", "csv").stdout == said
    for source in (["-"], ["--file", "-"]):
        assert ask(lake, *source, "--output", "csv", typed="SELECT count(*) AS n, 'ü' AS u FROM captions").stdout == said
    for words, message in (
        (["SELECT 1", "--file", "x"], "give a statement or --file, not both"),
        (["--file", tmp_path / "none.sql"], "cannot be read"),
    ):
        done = ask(lake, *words)
        assert done.exit_code != 0
        assert message in done.output + str(done.exception)
    assert "UTF-8" in str(ask(lake, "-", typed=b"SELECT '\xff'").exception)


@pytest.mark.parametrize("ending", ["csv", "json", "jsonl", "parquet", "txt"])
def test_a_file_has_the_form_of_its_ending(lake: Lake, tmp_path: Path, ending: str) -> None:
    sql, file = "SELECT range AS n, 'ü' AS u FROM range(3)", tmp_path / f"answer.{ending}"
    done = ask(lake, sql, "--out", file)
    assert done.exit_code == 0, done.output
    assert done.stdout == ""
    assert file.read_bytes() == ask(lake, sql, "--output", "table" if ending == "txt" else ending).stdout_bytes
    assert list(tmp_path.iterdir()) == [file]


def test_an_ending_that_says_nothing_is_refused(lake: Lake, tmp_path: Path) -> None:
    for name in ("answer", "answer.xlsx", "answer.csv.gz"):
        assert "has no ending that says" in str(ask(lake, "SELECT 1 AS n", "--out", tmp_path / name).exception)
    assert list(tmp_path.iterdir()) == []
    assert ask(lake, "SELECT 1 AS n", "--out", tmp_path / "answer", "--output", "csv").exit_code == 0
    assert (tmp_path / "answer").read_text() == "n\n1\n"


def test_a_table_in_a_file_has_all_rows_unless_told_otherwise(lake: Lake, tmp_path: Path) -> None:
    sql, file = "SELECT range AS n FROM range(1500)", tmp_path / "answer.txt"
    done = ask(lake, sql, "--out", file)
    assert file.read_text().splitlines()[2:] == [f"{n:4}" for n in range(1500)] + ["(1500 rows)"]
    assert done.stderr == f"{file}: 1500 rows\n"
    done = ask(lake, sql, "--out", file, "--force", "--limit", 10)
    assert file.read_text().splitlines()[-1] == "(the first 10 of 1500 rows)"
    assert done.stderr == f"{file}: the first 10 of 1500 rows\n"
    assert ask(lake, sql).stdout.splitlines()[-1] == "(the first 1000 of 1500 rows)"


def test_a_file_is_written_whole_or_not_at_all(lake: Lake, tmp_path: Path) -> None:
    file, before = tmp_path / "answer.csv", state(Path(lake.address))
    late = "SELECT CASE WHEN range = 999999 THEN error('late') ELSE range END AS n FROM range(1000000)"
    assert "late" in str(ask(lake, late, "--out", file).exception)
    assert list(tmp_path.iterdir()) == []
    assert ask(lake, "SELECT 1 AS n", "--out", file).exit_code == 0
    assert "is there already" in str(ask(lake, "SELECT 2 AS n", "--out", file).exception)
    assert "late" in str(ask(lake, late, "--out", file, "--force").exception)
    assert file.read_text() == "n\n1\n"
    assert ask(lake, "SELECT 2 AS n", "--out", file, "--force").exit_code == 0
    assert file.read_text() == "n\n2\n"
    for place, message in (
        (Path(lake.address) / "x.csv", "lies in the lake"),
        (Path(lake.address) / "tables" / "captions" / "x.parquet", "lies in the lake"),
        (tmp_path / "none" / "x.csv", "cannot be made"),
        (tmp_path, "is there already"),
    ):
        assert message in str(ask(lake, "SELECT 1", "--out", place, "--force").exception)
    (tmp_path / "link").symlink_to(Path(lake.address), target_is_directory=True)
    assert "lies in the lake" in str(ask(lake, "SELECT 1", "--out", tmp_path / "link" / "x.csv").exception)
    assert state(Path(lake.address)) == before


def test_names_that_come_twice_and_types_that_only_duckdb_has_are_kept(lake: Lake) -> None:
    sql = "SELECT 1 AS a, 2 AS a, INTERVAL 2 DAY AS i, MAP {'x': 1} AS m, '101'::BIT AS b, 3 AS a_1, sum(4) AS s"
    said = json.loads(ask(lake, sql, "--output", "json").stdout)
    assert said == [{"a": 1, "a_2": 2, "i": "2 days", "m": "{x=1}", "b": "101", "a_1": 3, "s": 4}]
    for output in ("csv", "table", "parquet"):
        assert ask(lake, sql, "--output", output).exit_code == 0


PEAK = """
import resource, sys
from flows.cli import main
try:
    main()
finally:
    print("peak", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, file=sys.stderr)
"""


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["csv", "json", "parquet"])
def test_millions_of_rows_pass_through(lake: Lake, tmp_path: Path, ending: str) -> None:
    sql = "SELECT 'demo/scene' || range % 1000 AS scene_id, range AS n, random() AS x, [random(), random()] AS box FROM range(4000000)"
    file = tmp_path / f"answer.{ending}"
    command = [sys.executable, "-c", PEAK, "sql", sql, "--out", str(file), "--lake", lake.address]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": str(Path.cwd())})
    assert done.returncode == 0, done.stderr
    assert int(done.stderr.split("peak")[1]) < 700
    if ending == "parquet":
        assert pq.ParquetFile(file).metadata.num_rows == 4_000_000
    else:
        with open(file, "rb") as lines:
            assert sum(1 for _ in lines) == 4_000_000 + (1 if ending == "csv" else 2)
