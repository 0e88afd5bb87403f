"""SQL on the lake: what reads is let through, what writes is not, and nothing on disk changes."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.cli import cli
from schemas.captions import Caption
from schemas.errors import InputError, LakeError
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.questions.view_answers import format_table
from warehouse.lake import Lake
from warehouse.questions.answers import OUTPUTS
from warehouse.questions.sql import ask, query, read_only
from warehouse.tables.snapshot import Reader


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sql")


@pytest.fixture(scope="module")
def reader(folder: Path) -> Reader:
    lake = Lake.open(folder / "lake")
    rows = [sample(Caption, scene_id="demo/a", instance_id=f"{i:04d}", sentence=text) for i, text in enumerate(("red chair", "oak; table"))]
    lake.stage_rows(stage_run("demo/a", "captions", fingerprint(1)), {"captions": rows})
    lake.commit()
    (folder / "outside.parquet").write_bytes(format_table(pa.table({"secret": [42]}), "parquet"))  # type: ignore[arg-type]
    (folder / "secret.txt").write_text("secret")
    return lake.snapshot()


READING = [
    "SELECT count(*) FROM captions",
    "  -- a comment; with a semicolon\n SELECT 1",
    "/* COPY captions TO 'x' */ SELECT 1",
    "FROM captions",
    "FROM captions SELECT sentence",
    "VALUES (1), (2)",
    "TABLE captions",
    "(SELECT 1) UNION ALL (SELECT 2) ORDER BY 1",
    "WITH a AS (SELECT * FROM captions) SELECT * FROM a",
    "WITH a AS MATERIALIZED (SELECT 1 AS x) SELECT * FROM a",
    "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r WHERE n < 5) SELECT * FROM r",
    "SELECT 'COPY captions TO ''x''' AS text",
    "SELECT (SELECT max(mass_kg) FROM captions) AS most, EXISTS (SELECT 1) AS any",
    "SELECT * FROM captions WHERE sentence LIKE '%; DROP TABLE captions%'",
    "SELECT unnest(colors) FROM captions",
    "SELECT * FROM range(3)",
    "SELECT * FROM duckdb_columns() LIMIT 1",
    "SELECT * FROM captions USING SAMPLE 1",
    "SELECT row_number() OVER (PARTITION BY scene_id ORDER BY mass_kg) FROM captions QUALIFY true",
    "PIVOT captions ON body_type IN ('rigid', 'soft') USING count(*)",
    "UNPIVOT (SELECT 1 AS a, 2 AS b) ON a, b",
    "DESCRIBE captions",
    "DESCRIBE SELECT 1",
    "SHOW TABLES",
    "SHOW ALL TABLES",
    "SUMMARIZE captions",
    "SELECT * FROM (SUMMARIZE captions)",
    "EXPLAIN SELECT * FROM captions",
    "EXPLAIN ANALYZE SELECT * FROM captions",
    "EXPLAIN (FORMAT json) SELECT 1",
    "SELECT 1;",
    "SELECT 1; -- and no more;\n;",
]

WRITING = [
    "COPY captions TO '{out}'",
    "COPY (SELECT 1) TO '{out}' (FORMAT csv)",
    "COPY captions TO '{lake}' (USE_TMP_FILE false)",
    "COPY (SELECT 1 AS sentence) TO '{lake}' (FORMAT parquet, USE_TMP_FILE false)",
    "COPY captions FROM '{outside}'",
    "COPY FROM DATABASE memory TO x",
    "EXPORT DATABASE '{out}'",
    "IMPORT DATABASE '{out}'",
    "ATTACH '{out}' AS x",
    "ATTACH ':memory:' AS x",
    "DETACH memory",
    "USE memory",
    "INSTALL httpfs",
    "LOAD httpfs",
    "SET threads = 1",
    "SET enable_external_access = true",
    "RESET threads",
    "PRAGMA threads = 1",
    "PRAGMA enable_profiling",
    "PRAGMA table_info('captions')",
    "CALL pragma_version()",
    "CHECKPOINT",
    "VACUUM",
    "ANALYZE",
    "BEGIN",
    "COMMIT",
    "CREATE TABLE t (a INT)",
    "CREATE TEMP TABLE t AS SELECT 1",
    "CREATE OR REPLACE VIEW captions AS SELECT 1",
    "CREATE MACRO f(x) AS x",
    "CREATE SECRET s (TYPE s3)",
    "CREATE TYPE t AS ENUM ('a')",
    "CREATE SEQUENCE s",
    "CREATE SCHEMA s",
    "DROP VIEW captions",
    "ALTER TABLE captions RENAME TO x",
    "COMMENT ON VIEW captions IS 'x'",
    "INSERT INTO captions VALUES (1)",
    "UPDATE captions SET sentence = 'x'",
    "DELETE FROM captions",
    "DELETE FROM captions RETURNING *",
    "TRUNCATE captions",
    "MERGE INTO captions USING captions AS o ON true WHEN MATCHED THEN DELETE",
    "PREPARE p AS SELECT 1",
    "PREPARE p AS COPY captions TO '{out}'",
    "EXECUTE p",
    "DEALLOCATE p",
    "EXPLAIN COPY captions TO '{out}'",
    "EXPLAIN ANALYZE COPY captions TO '{out}'",
    "EXPLAIN (ANALYZE, FORMAT json) COPY captions TO '{out}'",
    "explain/**/analyze/**/copy captions to '{out}'",
    "EXPLAIN ANALYZE CREATE TABLE t AS SELECT 1",
    "EXPLAIN ANALYZE WITH a AS (COPY captions TO '{out}') SELECT * FROM a",
    "WITH a AS (COPY (SELECT 1) TO '{out}') SELECT 1",
    "WITH a AS (COPY (SELECT 1) TO '{lake}' (USE_TMP_FILE false)) SELECT * FROM a",
    "WITH a AS (SELECT 1), b AS (WITH c AS (COPY captions TO '{out}') SELECT 1) SELECT * FROM b",
    "SELECT * FROM (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "SELECT (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "SELECT 1 WHERE EXISTS (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "SELECT 1 UNION ALL (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "WITH RECURSIVE r AS (SELECT 1 UNION ALL (WITH a AS (COPY captions TO '{out}') SELECT 1)) SELECT * FROM r",
    "DESCRIBE WITH a AS (COPY captions TO '{out}') SELECT 1",
    "SUMMARIZE WITH a AS (COPY captions TO '{out}') SELECT 1",
    "VALUES ((WITH a AS (COPY captions TO '{out}') SELECT 1))",
    "SELECT * FROM captions ORDER BY (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "SELECT * FROM captions LIMIT (WITH a AS (COPY captions TO '{out}') SELECT 1)",
    "WITH a AS (INSERT INTO captions VALUES (1) RETURNING *) SELECT * FROM a",
    "WITH a AS (DELETE FROM captions RETURNING *) SELECT * FROM a",
    "WITH a AS (UPDATE captions SET sentence = 'x' RETURNING *) SELECT * FROM a",
    "SELECT * FROM query('WITH a AS (COPY captions TO ''{out}'') SELECT 1')",
    "SELECT * FROM query_table('captions')",
    "SELECT * FROM read_csv('{secret}')",
    "SELECT * FROM read_text('{secret}')",
    "SELECT * FROM glob('/*')",
    "SELECT * FROM sniff_csv('{secret}')",
    "SELECT * FROM checkpoint()",
    "SELECT * FROM read_blob('{secret}')",
    "SELECT * FROM read_json('{secret}')",
    "SELECT * FROM read_duckdb('{out}')",
    "SELECT nextval('s')",
    "SELECT write_log('x')",
    "SELECT setseed(0.5)",
    "SELECT list_transform([1], lambda x: nextval('s'))",
    "SELECT * FROM json_execute_serialized_sql(json_serialize_sql('SELECT 1'))",
    "SELECT * FROM register_external_resource('x')",
    "SELECT * FROM truncate_duckdb_logs()",
    "SELECT * FROM copy_database('memory', 'x')",
    "SELECT * FROM add_parquet_key('k', 'v')",
    "SELECT * FROM enable_logging()",
    "SELECT * FROM import_database('{out}')",
    "SELECT * FROM (PIVOT captions ON body_type USING count(*))",
    "SET VARIABLE v1_folder = '/etc'",
    "RESET VARIABLE v1_folder",
    "SET lock_configuration = false",
    "SET allowed_paths = ['/etc/passwd']",
    "SET python_enable_replacements = true",
    "LOAD '{out}'",
    "FORCE INSTALL httpfs FROM community",
    "UPDATE EXTENSIONS",
    "DROP SCHEMA main CASCADE",
    "CREATE OR REPLACE MACRO box_plot(x) AS 1",
    "CREATE TRIGGER t AFTER INSERT ON captions FOR EACH ROW SELECT 1",
    "WITH a AS MATERIALIZED (DELETE FROM captions RETURNING *) FROM a",
    "FROM (DELETE FROM captions RETURNING *)",
    "SELECT 1 /* */ ; /* SELECT */ COPY captions TO '{out}'",
    "SELECT '--'; COPY captions TO '{out}' --'",
    "SELECT $$;$$; COPY captions TO '{out}'",
    "SELECT * FROM force_checkpoint()",
    "PIVOT captions ON body_type USING count(*)",
    "SELECT 1; COPY captions TO '{out}'",
    "COPY captions TO '{out}'; SELECT 1",
    "SELECT 1; SET threads = 1; SELECT 2",
    "SELECT 1;\n-- nothing\n;DROP VIEW captions",
]

# Reading, but of what the connection cannot see.
OUT_OF_REACH = [
    "SELECT * FROM '{secret}'",
    "SELECT * FROM '/etc/passwd'",
    "SELECT * FROM 'https://example.org/x.parquet'",
    "SELECT * FROM read_parquet('s3://bucket/x.parquet')",
    "SELECT * FROM read_parquet('{outside}')",
    "SELECT * FROM read_parquet('/**/*.parquet')",
    "SELECT * FROM parquet_metadata('{outside}')",
    "SELECT getenv('HOME')",
]


def state(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """Every file below a folder: size, time of change, contents."""
    return {
        str(path): (path.stat().st_size, path.stat().st_mtime_ns, path.read_bytes()) for path in sorted(folder.rglob("*")) if path.is_file()
    }


@pytest.mark.parametrize("statement", READING)
def test_reading_is_let_through(reader: Reader, statement: str) -> None:
    read_only(statement)
    assert query(reader, statement).num_columns > 0


@pytest.mark.parametrize("statement", WRITING + OUT_OF_REACH)
def test_writing_is_refused_and_changes_nothing(reader: Reader, folder: Path, statement: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    before = state(folder)
    places = {
        "out": str(folder / "out.parquet"),
        "outside": str(folder / "outside.parquet"),
        "secret": str(folder / "secret.txt"),
        "lake": str(folder / "lake" / reader.files("captions")[0]),
    }
    text = statement.format(**places)
    with pytest.raises(InputError) as refused:
        query(reader, text)
    assert str(refused.value).startswith("SQL: ")
    assert "\n" not in str(refused.value)
    if statement not in OUT_OF_REACH:
        with pytest.raises(InputError):
            read_only(text)
    assert state(folder) == before


@pytest.mark.parametrize("statement", ["", " ", ";", "-- only a comment", "/* */"])
def test_nothing_to_run_is_refused(statement: str) -> None:
    with pytest.raises(InputError, match="there is no statement"):
        read_only(statement)


WORDS = st.sampled_from(
    [
        "SELECT", "1", "*", "FROM", "captions", "WITH", "a", "AS", "(", ")", "COPY", "TO", "'hacked.csv'", ";", "EXPLAIN", "ANALYZE",
        "INSERT", "INTO", "VALUES", "DELETE", "UNION", "ALL", ",", "--\n", "/*", "*/", "SET", "query", "'", "CREATE", "TABLE", "ATTACH",
    ]
)  # fmt: skip


@pytest.mark.whole
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(words=st.lists(WORDS, min_size=1, max_size=14))
def test_no_text_writes(reader: Reader, folder: Path, words: list[str]) -> None:
    """Whatever is let through and runs, nothing on disk changes and no file appears in the working folder."""
    here, before = os.getcwd(), state(folder)
    os.chdir(folder)
    try:
        with_error = None
        try:
            query(reader, " ".join(words))
        except InputError as error:
            with_error = error
        assert with_error is None or "\n" not in str(with_error)
    finally:
        os.chdir(here)
    assert state(folder) == before


DEEP = {
    "brackets": "SELECT " + "(" * 5000 + "1" + ")" * 5000,
    "subqueries": "(FROM " * 10_000 + "captions" + ")" * 10_000,
    "lists": "SELECT " + "[" * 300 + "]" * 300,
    "length": "SELECT '" + "x" * 200_000 + "'",
    "negations": "SELECT " + "NOT " * 20_000 + "true",
    "sum": "SELECT " + "1+" * 20_000 + "1",
    "joins": "FROM range(2)" + ", range(2)" * 10_000,
}


@pytest.mark.parametrize("shape", DEEP)
def test_statements_without_end_are_refused_at_once(reader: Reader, shape: str) -> None:
    """Some of them would end the process: DuckDB's parser follows brackets on its stack."""
    with pytest.raises(InputError) as refused:
        query(reader, DEEP[shape])
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400


def test_brackets_that_are_no_brackets_count_for_nothing(reader: Reader) -> None:
    text = "([{" * 500
    found = query(reader, f"SELECT '{text}ü' AS a, 1 AS \"{text}\" -- {text}\n /* {text} */ , $${text}$$ AS c").to_pylist()
    assert found == [{"a": f"{text}ü", text: 1, "c": text}]


ENDLESS = {
    "range": "FROM range(1000000000000000)",
    "recursion": "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r",
    "join": "SELECT count(*) FROM range(10000000) AS a, range(10000000) AS b WHERE a.range + b.range = -1",
}


@pytest.mark.parametrize("shape", ENDLESS)
def test_questions_without_end_are_ended(reader: Reader, folder: Path, shape: str) -> None:
    before = state(folder)
    with (
        pytest.raises(InputError, match=r"SQL: it takes longer than 0.5 s; ask for less"),
        ask(reader, ENDLESS[shape], timeout=0.5) as answer,
    ):
        for _ in answer.batches:
            pass
    assert state(folder) == before


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT list(range) FROM range(1000000000000)",
        "SELECT string_agg(repeat('x', 1000000)) FROM range(1000000)",
        "SELECT repeat('x', 1000000000000000)",
        "SELECT range(1000000000000000)",
    ],
)
def test_answers_that_fit_nowhere_are_refused(reader: Reader, sql: str) -> None:
    with pytest.raises(InputError) as refused, ask(reader, sql, timeout=60, memory_mb=200) as answer:
        list(answer.batches)
    assert "\n" not in str(refused.value)


@pytest.mark.whole
def test_sorts_beyond_memory_go_on_in_files_that_do_not_stay(reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with ask(reader, "SELECT range AS n FROM range(6000000) ORDER BY hash(range)", memory_mb=60) as answer:
        assert sum(batch.num_rows for batch in answer.batches) == 6_000_000
    assert list(tmp_path.iterdir()) == []


def test_a_timer_rings_for_its_own_question_only(reader: Reader) -> None:
    with ask(reader, "SELECT 1 AS n", timeout=0.2) as answer:
        assert [batch.to_pylist() for batch in answer.batches] == [[{"n": 1}]]
    time.sleep(0.4)
    assert query(reader, "SELECT 2 AS n").to_pylist() == [{"n": 2}]


INJECTIONS = (
    "demo/x'; DROP VIEW captions; --", "demo/x' OR '1'='1", 'demo/"; COPY captions TO "x', "demo/$$;DROP$$", "demo/x\\'", "demo/x\x00y",
    "demo/../../etc/passwd", "demo/x') UNION SELECT 1 --",
)  # fmt: skip


@pytest.mark.parametrize("name", INJECTIONS)
def test_a_scene_name_is_never_sql(reader: Reader, folder: Path, name: str) -> None:
    """Not where rows are staged, read, removed, compared or exported."""
    lake, before = Lake.open(folder / "lake"), state(folder / "lake")
    with pytest.raises(LakeError) as refused:
        lake.stage_rows(stage_run(name, "captions", fingerprint(2)), {"captions": [sample(Caption, scene_id=name)]})
    assert "\n" not in str(refused.value)
    assert reader.rows(Caption, scene_id=name) == []
    assert reader.arrow("captions", scene_id=name).num_rows == 0
    assert reader.rows_by_key(Caption, [name]) == []
    assert reader.matching("captions", {"scene_id": [name]}).num_rows == 0
    assert lake.rows_of("captions", name, fingerprint(1)) is None
    for command in (("explain", name), ("export", "--out", str(folder / "out"), "--scenes", name), ("lake", "erase", name, "--yes")):
        done = CliRunner().invoke(cli, [*command, "--lake", str(folder / "lake")])
        assert done.exit_code != 0, command
    assert {path: kept[2] for path, kept in state(folder / "lake").items()} == {path: kept[2] for path, kept in before.items()}
    assert Lake.open(folder / "lake").snapshot().rows(Caption) == reader.rows(Caption)


@pytest.mark.whole
def test_files_outside_the_snapshot_are_out_of_reach(reader: Reader, folder: Path) -> None:
    for path in (folder / "outside.parquet", folder / "lake" / "lake.json", "/etc/passwd"):
        for sql in (f"SELECT * FROM '{path}'", f"SELECT * FROM read_parquet('{path}')"):
            with pytest.raises(InputError):
                query(reader, sql)
    own = folder / "lake" / reader.files("captions")[0]
    assert query(reader, f"SELECT * FROM read_parquet('{own}')").num_rows == 2


def test_errors_are_one_line(reader: Reader) -> None:
    for sql in ("SELEC 1", "SELECT nothing FROM captions", "SELECT * FROM chairs", "SELECT 1 +", "SELECT 'x'::INT"):
        with pytest.raises(InputError) as wrong:
            query(reader, sql)
        assert "\n" not in str(wrong.value)


def test_connection_is_locked(reader: Reader) -> None:
    import duckdb

    with reader.connect() as connection:
        for sql in ("SET enable_external_access = true", "SET allowed_paths = ['/etc/passwd']", "SET lock_configuration = false"):
            with pytest.raises(duckdb.Error, match=r"locked|cannot be"):
                connection.execute(sql)


@pytest.mark.parametrize("sql", ["SELECT 1 AS a; SELECT 2 AS b", "SELECT 1;SELECT 2;SELECT 3;", "EXPLAIN SELECT 1; SELECT 2"])
def test_no_answer_of_several_is_dropped_in_silence(reader: Reader, sql: str) -> None:
    count = sql.rstrip(";").count(";") + 1
    with pytest.raises(InputError, match=f"^SQL: these are {count} statements, and one is answered at a time; ask one after the other$"):
        query(reader, sql)


def test_times_are_in_utc(reader: Reader) -> None:
    found = query(reader, "SELECT started_at, started_at::VARCHAR AS text FROM stage_runs").to_pylist()
    assert found[0]["text"] == "2026-01-01 00:00:00+00"
    assert found[0]["started_at"].isoformat() == "2026-01-01T00:00:00+00:00"


def test_every_output_holds_every_value(reader: Reader) -> None:
    sql = (
        "SELECT sentence, colors, mass_kg, is_fallback, NULL AS nothing, 'NaN'::DOUBLE AS nan, 1::HUGEINT AS big, DATE '2026-01-02' AS day,"
        " {'a': [1, 2]} AS nested, 'ü \"q\", x' AS text FROM captions ORDER BY sentence"
    )
    data = query(reader, sql)
    objects = json.loads(format_table(data, "json"))
    assert objects[0]["sentence"] == "oak; table"
    assert objects[0]["colors"] == ["word", "word"]
    assert objects[0]["nested"] == {"a": [1, 2]}
    assert (objects[0]["nan"], objects[0]["nothing"], objects[0]["day"], objects[0]["text"]) == ("NaN", None, "2026-01-02", 'ü "q", x')
    lines = list(csv.reader(io.StringIO(str(format_table(data, "csv")))))
    assert lines[0] == data.column_names
    assert lines[1][0] == "oak; table"
    assert json.loads(lines[1][1]) == ["word", "word"]
    assert lines[1][-1] == 'ü "q", x'
    assert len(lines) == 3
    packed = format_table(data, "parquet")
    assert isinstance(packed, bytes)
    assert pq.read_table(io.BytesIO(packed)).num_rows == 2
    text = str(format_table(data, "table")).splitlines()
    assert text[0].split()[:2] == ["sentence", "colors"]
    assert text[-1] == "(2 rows)"
    assert len(text) == 5
    assert all(line == line.rstrip() for line in text)


@pytest.mark.parametrize("output", OUTPUTS)
def test_answer_without_rows_has_its_columns(reader: Reader, output: str) -> None:
    made = format_table(query(reader, "SELECT sentence, mass_kg FROM captions WHERE false"), output)  # type: ignore[arg-type]
    match output:
        case "table":
            assert made == "sentence  mass_kg\n--------  -------\n(0 rows)\n"
        case "expanded":
            assert made == "(0 rows)\n"
        case "csv":
            assert made == "sentence,mass_kg\n"
        case "json":
            assert made == "[]\n"
        case "jsonl":
            assert made == ""
        case _:
            assert pq.read_table(io.BytesIO(made)).column_names == ["sentence", "mass_kg"]  # type: ignore[arg-type]


def test_unknown_output_is_refused() -> None:
    with pytest.raises(InputError, match="choose one of table, expanded, csv, json, jsonl, parquet"):
        format_table(pa.table({"a": [1]}), "xml")  # type: ignore[arg-type]


def test_text_table_aligns_numbers_and_cuts_long_cells() -> None:
    data = pa.table({"name": ["a", "x" * 99], "count": [5, 12345], "share": [0.5, 1 / 3]})
    lines = str(format_table(data)).splitlines()
    assert lines[2].endswith("       0.5")
    assert lines[3].split()[0] == "x" * 59 + "…"
    assert lines[3].endswith("12345  0.333333")
