"""Other people's tools read the lake: releases and Delta tables give them the rows that the lake's own reader gives."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet as pq
import pytest

from bench.samples import _made_up
from schemas.record import table_of
from schemas.runs import StageRun
from schemas.tables import TABLES
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, stage_run
from tests.warehouse.questions.test_sql import state
from warehouse.lake import Lake
from warehouse.questions.renames import former_columns, move_out_of
from warehouse.questions.views import views
from warehouse.release import make_release
from warehouse.tables.delta import nullable
from warehouse.tables.snapshot import Reader

STAGES = ("capture", "captions", "selection", "optimization", "navigation", "exports")
BIN = Path(sys.executable).parent
ENVIRONMENT = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(REPOSITORY)}


def varied(record: type, scene_id: str, number: int, blob: str) -> Any:
    """A row; every other one has a value where one may be missing, an empty list or text where there may be one."""
    table = table_of(record)
    values: dict[str, Any] = {}
    for column in table.columns:
        full = dataclasses.replace(column, nullable=column.nullable and number % 2 == 0)
        value = _made_up(full)
        if column.blob and value is not None:
            value = blob
        elif number % 2 == 0 and pa.types.is_list(column.type) and column.length is None:
            value = ()
        elif number == 0 and value == "text":
            value = ""
        elif number == 1 and value == "text":
            value = 'a "chair", 50 % oak;\nüñ\\'
        elif number == 1 and isinstance(value, float) and column.maximum is None and "box" not in column.name:
            value = 1.7976931348623157e308 if not column.minimum else value
        elif column.name == "is_structure":
            value = number % 2 == 1
        values[column.name] = value
    values["scene_id"] = scene_id
    if "room_id" in values:
        values["room_id"] = scene_id.removesuffix("_00")
    return record(**values)


def stage(lake: Lake, number: int, version: int, blob: str) -> None:
    scene_id = f"demo/scene{number:04d}_00"
    for name in STAGES:
        rows = {
            table.name: [varied(table.record, scene_id, number + version, blob)]
            for table in TABLES.values()
            if table.stage == name and table.rule == "replace" and any(column.name == "scene_id" for column in table.columns)
        }
        run: StageRun = stage_run(scene_id, name, fingerprint(number, name, version), at=100 * version + number)
        lake.stage_rows(run, rows)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a lake of two snapshots and a release of the first."""
    folder = tmp_path_factory.mktemp("doors")
    lake = Lake.open(folder / "lake")
    blob = lake.blobs.put(b"mesh", "glb")
    for number in range(4):
        stage(lake, number, 0, blob)
    lake.commit("first")
    make_release(lake, "v1")
    for number in (1, 4):
        stage(lake, number, 1, blob)
    lake.commit("second")
    return folder


@pytest.fixture(scope="module")
def released(home: Path) -> Reader:
    return Lake.open(home / "lake").snapshot(1)


def truth(reader: Reader) -> dict[str, pa.Table]:
    """What the lake's own reader says, by table."""
    return {name: ordered(name, reader.arrow(name)) for name in TABLES if name not in ("releases", "snapshots")}


def ordered(name: str, data: pa.Table) -> pa.Table:
    """Rows under the schema of a table, sorted by key, in one piece. A type that another tool changed in more than its size fails."""
    schema, move = nullable(TABLES[name].arrow_schema).remove_metadata(), move_out_of(name)
    old = (*(move.columns if move is not None else ()), *former_columns(name))
    data = data.drop_columns([column for column in old if column in data.column_names])
    assert data.column_names == schema.names, name
    for field in data.schema:
        assert plain(field.type) == plain(schema.field(field.name).type), f"{name}.{field.name}"
    cast = data.replace_schema_metadata().cast(pa.schema([field.with_metadata({}) for field in schema]))
    return cast.sort_by([(key, "ascending") for key in TABLES[name].key]).combine_chunks()


def plain(kind: pa.DataType) -> str:
    """A type without what is only its layout: large offsets, views, names of items."""
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return f"list<{plain(kind.value_type)}>"
    if pa.types.is_timestamp(kind):
        return f"timestamp[{kind.unit}, {'UTC' if kind.tz in ('UTC', 'Etc/UTC') else kind.tz}]"
    return re.sub(r"large_|_view", "", str(kind))


def same(found: Mapping[str, pa.Table], expected: Mapping[str, pa.Table]) -> None:
    assert found.keys() == expected.keys()
    for name, data in expected.items():
        assert ordered(name, found[name]).equals(data), name
    assert sum(data.num_rows for data in expected.values()) > 50
    assert any(data.num_rows == 0 for data in expected.values())


def committed(home: Path, snapshot_id: int) -> dict[str, list[str]]:
    """Files of every Delta table that has some at a snapshot, as Delta itself lists them."""
    from deltalake import DeltaTable

    versions = Lake.open(home / "lake").snapshot(snapshot_id).versions
    listed = {name: DeltaTable(home / "lake" / "tables" / name, version=version).file_uris() for name, version in versions.items()}
    return {name: files for name, files in listed.items() if files and name not in ("releases", "snapshots")}


def at(home: Path, snapshot_id: int) -> dict[str, pa.Table]:
    expected = truth(Lake.open(home / "lake").snapshot(snapshot_id))
    return {name: expected[name] for name in committed(home, snapshot_id)}


def release_file(home: Path, name: str) -> Path:
    return home / "lake" / "releases" / "v1" / f"{name}.parquet"


def test_the_two_snapshots_differ(home: Path) -> None:
    """Else reading a version would prove nothing."""
    first, second = at(home, 1), at(home, 2)
    assert first.keys() == second.keys()
    assert all(not first[name].equals(second[name]) for name in first)
    assert {"instances", "captions", "placements", "episodes", "stage_runs"} <= first.keys()


def test_pandas_reads_a_release(home: Path, released: Reader) -> None:
    import pandas as pd

    expected = truth(released)
    frames = {name: pd.read_parquet(release_file(home, name), dtype_backend="pyarrow") for name in expected}
    same({name: pa.Table.from_pandas(frame, preserve_index=False) for name, frame in frames.items()}, expected)


def test_pandas_without_arrow_types_reads_the_same_values(home: Path, released: Reader) -> None:
    import pandas as pd

    frame = pd.read_parquet(release_file(home, "stage_runs"))
    assert str(frame["started_at"].dtype.tz) == "UTC"
    errors = released.arrow("stage_runs")["error"].to_pylist()
    assert sorted(frame["error"].isna()) == sorted(value is None for value in errors)
    assert None in errors
    boxes = pd.read_parquet(release_file(home, "instances"))["box_pose"]
    assert [list(map(float, box)) for box in boxes] == released.arrow("instances")["box_pose"].to_pylist()


@pytest.mark.parametrize("snapshot_id", [1, 2])
def test_pandas_reads_delta_tables_at_a_version(home: Path, snapshot_id: int) -> None:
    from deltalake import DeltaTable

    found = {}
    versions = Lake.open(home / "lake").snapshot(snapshot_id).versions
    for name in committed(home, snapshot_id):
        frame = DeltaTable(home / "lake" / "tables" / name, version=versions[name]).to_pandas(types_mapper=_arrow_backed)
        found[name] = pa.Table.from_pandas(frame, preserve_index=False)
    same_rows(found, at(home, snapshot_id))


def _arrow_backed(kind: pa.DataType) -> Any:
    import pandas as pd

    return pd.ArrowDtype(kind)


def same_rows(found: Mapping[str, pa.Table], expected: Mapping[str, pa.Table]) -> None:
    """As `same`, of tables that have rows."""
    assert found.keys() == expected.keys()
    for name, data in expected.items():
        assert ordered(name, found[name]).equals(data), name
        assert data.num_rows, name


def test_polars_reads_a_release(home: Path, released: Reader) -> None:
    import polars as pl

    expected = truth(released)
    same({name: pl.read_parquet(release_file(home, name)).to_arrow() for name in expected}, expected)
    same({name: pl.scan_parquet(release_file(home, name)).collect().to_arrow() for name in expected}, expected)


@pytest.mark.parametrize("snapshot_id", [1, 2])
def test_polars_reads_delta_tables_at_a_version(home: Path, snapshot_id: int) -> None:
    import polars as pl

    versions = Lake.open(home / "lake").snapshot(snapshot_id).versions
    tables = {name: str(home / "lake" / "tables" / name) for name in committed(home, snapshot_id)}
    same_rows({name: pl.read_delta(path, version=versions[name]).to_arrow() for name, path in tables.items()}, at(home, snapshot_id))


def shell(text: str, *options: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What DuckDB's own shell, of another version than ours, makes of SQL."""
    command = [str(BIN / "duckdb"), "-no-init", "-batch", "-bail", *options]
    return subprocess.run(command, input=text, capture_output=True, text=True, cwd=folder, check=False, timeout=600)


def copied(home: Path, folder: Path, sources: Mapping[str, list[str]], before: str = "") -> dict[str, pa.Table]:
    """Tables as DuckDB's shell copies them from Parquet files or, without files, from the views of their name."""
    lines = ["SET TimeZone = 'UTC';", before]
    for name, files in sources.items():
        source = f"read_parquet({files}, union_by_name = true)" if files else f"v1.{name}"
        lines.append(f"COPY (SELECT * FROM {source}) TO '{folder}/{name}.parquet' (FORMAT parquet);")
    done = shell("\n".join(lines), folder=home)
    assert done.returncode == 0, done.stderr
    return {name: pq.read_table(folder / f"{name}.parquet") for name in sources}


def test_the_shell_is_of_another_version() -> None:
    import duckdb

    told = subprocess.run([str(BIN / "duckdb"), "--version"], capture_output=True, text=True, check=True).stdout
    assert told.startswith("v1.")
    assert not duckdb.__version__.startswith("1.")


def test_the_shell_reads_a_release(home: Path, released: Reader, tmp_path: Path) -> None:
    expected = truth(released)
    same(copied(home, tmp_path, {name: [str(release_file(home, name))] for name in expected}), expected)


@pytest.mark.parametrize("snapshot_id", [1, 2])
def test_the_shell_reads_delta_tables_at_a_version(home: Path, snapshot_id: int, tmp_path: Path) -> None:
    same_rows(copied(home, tmp_path, committed(home, snapshot_id)), at(home, snapshot_id))


def test_the_shell_attaches_the_catalog(home: Path, released: Reader, tmp_path: Path) -> None:
    expected = truth(released)
    attach = "ATTACH 'lake/releases/v1/v1.duckdb' AS v1 (READ_ONLY);"
    same(copied(home, tmp_path, {name: [] for name in expected}, attach), expected)


@pytest.mark.whole
def test_every_view_of_the_catalog_answers_as_the_lake(home: Path, released: Reader) -> None:
    """In a process of its own, which has nothing of ours."""
    text = "; ".join(
        [
            "import duckdb, json, sys",
            "c = duckdb.connect()",
            "c.execute(\"SET TimeZone = 'UTC'\")",
            "c.execute(\"ATTACH 'lake/releases/v1/v1.duckdb' AS v1 (READ_ONLY)\")",
            "c.execute('USE v1')",
            "print(json.dumps({n: [str(r) for r in c.execute(f'SELECT * FROM {n} ORDER BY ALL').fetchall()] for n in sys.argv[1:]}))",
        ]
    )
    asked = [view.name for view in views() if "release" not in view.name]
    done = subprocess.run([sys.executable, "-I", "-c", text, *asked], capture_output=True, text=True, cwd=home, check=False)
    assert done.returncode == 0, done.stderr
    answers = json.loads(done.stdout)
    with released.connect() as connection:
        for name in asked:
            own = [str(row) for row in connection.execute(f"SELECT * FROM {name} ORDER BY ALL").fetchall()]
            assert answers[name] == own, name
    assert sum(map(len, answers.values())) > 50


def test_the_shell_asks_every_view(home: Path, released: Reader) -> None:
    lines = ["SET TimeZone = 'UTC';", "ATTACH 'lake/releases/v1/v1.duckdb' AS v1 (READ_ONLY);", "USE v1;"]
    asked = [view.name for view in views() if "release" not in view.name]
    lines += [f"SELECT '{name}' AS name, count(*) AS n FROM {name};" for name in asked]
    done = shell("\n".join(lines), "-jsonlines", folder=home)
    assert done.returncode == 0, done.stderr
    told = {row["name"]: row["n"] for row in map(json.loads, done.stdout.splitlines())}
    with released.connect() as connection:
        assert told == {name: connection.execute(f"SELECT count(*) FROM {name}").fetchall()[0][0] for name in asked}


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE TABLE v1.t (a INT)", "DROP VIEW v1.scenes", "CREATE OR REPLACE VIEW v1.scenes AS SELECT 1", "CREATE MACRO v1.f(x) AS x",
        "DELETE FROM v1.scenes", "UPDATE v1.scenes SET dataset = 'x'", "COMMENT ON VIEW v1.scenes IS 'x'", "CHECKPOINT v1",
        "INSERT INTO v1.scenes VALUES (1)", "ALTER VIEW v1.scenes RENAME TO x",
    ],
)  # fmt: skip
def test_an_attached_release_cannot_be_changed(home: Path, statement: str) -> None:
    before = state(home / "lake")
    attach = "ATTACH 'lake/releases/v1/v1.duckdb' AS v1 (READ_ONLY);"
    done = shell(f"{attach}\n{statement};", folder=home)
    assert done.returncode != 0 or statement.startswith("CHECKPOINT")
    import duckdb

    with duckdb.connect() as connection:
        connection.execute(attach.replace("lake/", f"{home}/lake/"))
        if not statement.startswith("CHECKPOINT"):
            with pytest.raises(duckdb.Error):
                connection.execute(statement)
    assert state(home / "lake") == before


BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
BLOCKS = [match.groups() for match in BLOCK.finditer((REPOSITORY / "docs" / "clients.md").read_text())]
SPARK = [text for kind, text in BLOCKS if text.startswith("# spark")]
PLAIN = [(kind, text) for kind, text in BLOCKS if text not in SPARK]


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(("kind", "text"), PLAIN, ids=[f"{kind}-{i}" for i, (kind, _) in enumerate(PLAIN)])
def test_every_step_of_the_page_works(home: Path, tmp_path: Path, kind: str, text: str) -> None:
    """As it stands, beside the lake, which stays as it is."""
    (tmp_path / "lake").symlink_to(home / "lake")
    (tmp_path / "docs").symlink_to(REPOSITORY / "docs")
    before = state(home / "lake")
    match kind:
        case "bash":
            done = run(["bash", "-euc", text], tmp_path)
        case "python":
            done = run([sys.executable, "-c", text], tmp_path)
        case "sql":
            done = shell(text, folder=tmp_path)
            ours = "import duckdb, sys; c = duckdb.connect(); [print(s := c.sql(t) or '') for t in sys.argv[1:]]"
            again = run([sys.executable, "-I", "-c", ours, *(part for part in text.split(";") if part.strip())], tmp_path)
            assert again.returncode == 0, again.stderr
            assert "rows" in again.stdout or "│" in again.stdout
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert state(home / "lake") == before


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=ENVIRONMENT, check=False, timeout=300)


def test_the_lock_of_spark_names_versions_and_no_host() -> None:
    lines = [line for line in (REPOSITORY / "requirements" / "spark.lock").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9_.-]+==[A-Za-z0-9.]+", line) for line in lines)
    assert {"pyspark", "pyarrow"} <= {line.partition("==")[0] for line in lines}


READ_WITH_SPARK = """
import json, sys
import pyarrow as pa
from pyspark.sql import SparkSession
settings = {"spark.sql.session.timeZone": "UTC", "spark.ui.enabled": "false"}
spark = SparkSession.builder.master("local[1]").config(map=settings).getOrCreate()
for out, files in json.load(open(sys.argv[1])).items():
    data = spark.read.parquet(*files).toArrow()
    with pa.ipc.new_file(out, data.schema) as writer:
        writer.write_table(data)
spark.stop()
"""


@pytest.mark.slow
def test_spark_reads_releases_and_delta_tables(home: Path, released: Reader, tmp_path: Path) -> None:
    python = os.environ.get("METASCENES_SPARK_PYTHON")
    if not python:
        pytest.skip("METASCENES_SPARK_PYTHON names no interpreter with requirements/spark.lock installed (and Java 17)")
    expected = truth(released)
    asked = {str(tmp_path / f"release-{name}"): [str(release_file(home, name))] for name in expected}
    for snapshot_id in (1, 2):
        asked |= {str(tmp_path / f"delta{snapshot_id}-{name}"): files for name, files in committed(home, snapshot_id).items()}
    (tmp_path / "asked.json").write_text(json.dumps(asked))
    done = run([python, "-c", READ_WITH_SPARK, str(tmp_path / "asked.json")], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]

    def found(head: str) -> dict[str, pa.Table]:
        files = {path.name.removeprefix(head): path for path in tmp_path.glob(f"{head}*")}
        return {name: pa.ipc.open_file(path.read_bytes()).read_all() for name, path in files.items()}

    same(found("release-"), expected)
    for snapshot_id in (1, 2):
        same_rows(found(f"delta{snapshot_id}-"), at(home, snapshot_id))
    for text in SPARK:
        (tmp_path / "lake").symlink_to(home / "lake")
        shown = run([python, "-c", text], tmp_path)
        assert shown.returncode == 0, shown.stderr[-2000:]
        assert "category" in shown.stdout
