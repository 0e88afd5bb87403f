"""Files of somebody's own beside the lake's tables: their rows are what is in them, whatever they are called, and nothing else is read."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.capture import Scene
from schemas.errors import InputError
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.questions.attached import Attached, attached
from warehouse.questions.catalog import entries
from warehouse.questions.sql import ask

ROWS = [{"scene_id": "demo/a", "weight": 2.5, "words": "say \"so\", 'now'"}, {"scene_id": "demo/c", "weight": None, "words": "é;--"}]


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    made = Lake.open(tmp_path_factory.mktemp("lake"))
    rows = {"scenes": [sample(Scene, scene_id="demo/a", mesh_blob=made.blobs.put(b"mesh", "glb"))]}
    made.stage_rows(stage_run("demo/a", "capture", fingerprint(1)), rows)
    made.commit()
    return made


def answer(lake: Lake, sql: str, files: tuple[Attached, ...]) -> list[dict[str, Any]]:
    with ask(lake.snapshot(), sql, attached=files) as given:
        return pa.Table.from_batches(given.batches, given.schema).to_pylist()


def write(path: Path, rows: list[dict[str, Any]] = ROWS) -> Path:
    """The rows as the ending of a path says."""
    table = pa.Table.from_pylist(rows)
    match path.suffix.lower():
        case ".parquet":
            pq.write_table(table, path)
        case ".csv":
            pa.csv.write_csv(table, path)
        case ".json":
            path.write_text(json.dumps(rows))
        case _:
            path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return path


@pytest.mark.parametrize("ending", ["csv", "CSV", "parquet", "json", "jsonl", "ndjson"])
def test_rows_of_a_file_are_joined_as_they_are(lake: Lake, tmp_path: Path, ending: str) -> None:
    with attached({"mine": write(tmp_path / f"w.{ending}")}) as files:
        assert answer(lake, "FROM mine ORDER BY scene_id", files) == ROWS
        assert answer(lake, "SELECT weight FROM scenes JOIN MINE USING (scene_id)", files) == [{"weight": 2.5}]
        assert answer(lake, "SELECT column_name FROM (DESCRIBE mine)", files) == [{"column_name": name} for name in ROWS[0]]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.text(st.characters(codec="utf-8", exclude_characters="/\0"), min_size=1, max_size=40).filter(
        lambda text: len(text.encode()) < 200
    )
)
def test_a_file_may_be_called_whatever_it_likes(lake: Lake, tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    folder = tmp_path_factory.mktemp("files") / "year=1'); COPY x TO 'y' --*[a]"
    folder.mkdir()
    with attached({"mine": write(folder / f"{name}.csv")}) as files:
        assert answer(lake, "FROM mine ORDER BY scene_id", files) == ROWS


@pytest.mark.parametrize("name", ["", "1a", "a b", 'a"; DROP VIEW scenes --', "a.b", "é", "a" * 64, "select", "TABLE"])
def test_a_name_that_sql_does_not_take_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="--attach"), attached({name: write(tmp_path / "w.csv")}):
        pass


def test_no_name_of_the_lake_is_taken_away(tmp_path: Path) -> None:
    file = write(tmp_path / "w.csv")
    for entry in entries():
        for name in (entry.name, entry.name.upper()):
            with pytest.raises(InputError, match=f"is a {entry.kind} of the lake"), attached({name: file}):
                pass


def test_what_cannot_be_read_is_one_line_that_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "torn.parquet").write_bytes(b"PAR1 and nothing")
    (tmp_path / "torn.json").write_text('[{"a": 1}, {"a"')
    (tmp_path / "noise.csv").write_bytes(os.urandom(1000) + b"\xff\x00")
    (tmp_path / "rows.xlsx").write_bytes(b"PK")
    (tmp_path / "rows").write_text("a\n1\n")
    for name, problem in {
        "absent.csv": "No such file", "folder.csv": "a folder, not a regular file", "pipe.csv": "a pipe, not a regular file",
        "torn.parquet": "cannot be read", "torn.json": "cannot be read", "noise.csv": "cannot be read", "rows.xlsx": "has no ending",
        "rows": "has no ending",
    }.items():  # fmt: skip
        with pytest.raises(InputError) as refused, attached({"mine": tmp_path / name}):
            pass
        assert str(tmp_path / name) in str(refused.value)
        assert problem in str(refused.value)
        assert "metascenes-sql-" not in str(refused.value), "the path by which DuckDB knows it is nobody's business"
        assert "\n" not in str(refused.value)


def test_a_row_that_does_not_fit_is_told_of_the_file_by_its_own_name(lake: Lake, tmp_path: Path) -> None:
    file = tmp_path / "long.csv"
    file.write_text("a\n" + "1\n" * 100_000 + "x\n")
    with attached({"mine": file}) as files, pytest.raises(InputError) as refused:
        answer(lake, "SELECT sum(a) FROM mine", files)
    assert str(file) in str(refused.value)
    assert "metascenes-sql-" not in str(refused.value)


@pytest.mark.parametrize("statement", ["DELETE FROM mine", "INSERT INTO mine VALUES ('a', 1, 'b')", "COPY (SELECT 1) TO '{link}'"])
def test_nothing_is_written_to_it(lake: Lake, tmp_path: Path, statement: str) -> None:
    file = write(tmp_path / "w.csv")
    before = file.read_bytes()
    with attached({"mine": file}) as files, pytest.raises(InputError, match="is not allowed"):
        answer(lake, statement.format(link=files[0].link), files)
    assert file.read_bytes() == before


def test_no_other_file_comes_within_reach(lake: Lake, tmp_path: Path) -> None:
    secret = write(tmp_path / "secret.parquet")
    with attached({"mine": write(tmp_path / "w.csv")}) as files, pytest.raises(InputError):
        answer(lake, f"FROM read_parquet('{secret}')", files)
    with attached({"mine": write(tmp_path / "w.csv")}) as files, pytest.raises(InputError):
        answer(lake, f"FROM '{secret}'", files)
