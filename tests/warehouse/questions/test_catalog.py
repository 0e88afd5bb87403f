"""The catalog: golden columns of every view and macro, comments that SQL shows, and the page and the list of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.tables import TABLES
from tests.conftest import REPOSITORY
from warehouse.lake import Lake
from warehouse.questions.catalog import described, empty_lake, entries, views_page
from warehouse.questions.macros import Macro, macros
from warehouse.questions.views import View, install, views

GOLDEN = REPOSITORY / "tests" / "golden" / "views"
WRITE = "make golden"
ASKED: dict[str, View | Macro] = {one.name: one for one in (*views(), *macros())}


@pytest.fixture(scope="module")
def connection() -> Iterator[duckdb.DuckDBPyConnection]:
    with empty_lake() as made:
        yield made


def difference(golden: dict[str, Any], found: dict[str, Any]) -> str | None:
    """What is to be done about a view or macro that is not the golden one; None when it is."""
    if found == golden:
        return None
    if found["version"] <= golden["version"]:
        return f"{found['name']}: columns or parameters changed: raise the version in its file, then {WRITE}"
    return f"{found['name']}: a change on purpose is written with: {WRITE}"


@pytest.mark.parametrize("name", ASKED)
def test_view_or_macro_is_the_golden_one(connection: duckdb.DuckDBPyConnection, name: str) -> None:
    file = GOLDEN / f"{name}.json"
    assert file.exists(), f"write it with: {WRITE}"
    golden = json.loads(file.read_text())
    assert difference(golden, described(connection, ASKED[name])) is None


def test_every_golden_file_has_its_view_or_macro() -> None:
    assert {path.stem for path in GOLDEN.glob("*.json")} == ASKED.keys(), f"write them with: {WRITE}"
    assert len(ASKED) == len(views()) + len(macros())
    assert not ASKED.keys() & TABLES.keys()


def test_a_change_of_columns_wants_another_version(connection: duckdb.DuckDBPyConnection) -> None:
    golden = described(connection, ASKED["category_counts"])
    columns = {name: kind for name, kind in golden["columns"].items() if name != "share"}
    assert difference(golden, dict(golden)) is None
    assert "raise the version" in str(difference(golden, golden | {"columns": columns}))
    assert "raise the version" in str(difference(golden, golden | {"columns": golden["columns"] | {"share": "BIGINT"}}))
    assert "on purpose" in str(difference(golden, golden | {"columns": columns, "version": golden["version"] + 1}))
    assert "raise the version" in str(difference(golden | {"version": 2}, golden))


def test_sql_shows_every_view_and_macro_with_its_comment(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake").snapshot().connect()
    shown = dict(lake.execute("SELECT view_name, comment FROM duckdb_views() WHERE NOT internal").fetchall())
    standard = dict(lake.execute("SELECT table_name, table_comment FROM information_schema.tables").fetchall())
    functions = {
        name: (kind, parameters, comment)
        for name, kind, parameters, comment in lake.execute(
            "SELECT function_name, function_type, parameters, comment FROM duckdb_functions() WHERE NOT internal"
        ).fetchall()
    }
    for view in views():
        assert shown[view.name] == standard[view.name] == view.comment
        assert view.comment.startswith(f"{view.question} Version {view.version}.")
        assert view.note in view.comment
    assert set(shown) == {view.name for view in views()} | TABLES.keys()
    assert functions.keys() == {macro.name for macro in macros()}
    for macro in macros():
        kind, parameters, comment = functions[macro.name]
        assert kind == ("table_macro" if macro.is_table else "macro")
        assert parameters == [parameter.split(" :=")[0] for parameter in macro.parameters]
        assert comment == macro.comment
    assert all(standard[name] == table.description for name, table in TABLES.items())


def test_installing_twice_changes_nothing(connection: duckdb.DuckDBPyConnection) -> None:
    state = "SELECT view_name, sql, comment FROM duckdb_views() WHERE NOT internal ORDER BY 1"
    before = connection.execute(state).fetchall()
    install(connection)
    assert connection.execute(state).fetchall() == before


def test_the_page_is_what_the_files_say() -> None:
    page = REPOSITORY / "docs" / "views.md"
    said = views_page()
    assert page.read_text() == said, f"write it with: {WRITE}"
    for name, one in ASKED.items():
        assert f"\n## `{name}`\n\n{one.question} Version {one.version}.\n" in said


def test_every_example_of_a_macro_runs(connection: duckdb.DuckDBPyConnection) -> None:
    for macro in macros():
        _, example, code = macro.note.partition("Example: ")
        assert example, macro.name
        connection.execute(code)


def test_the_list_names_tables_views_and_macros_with_their_versions() -> None:
    told = CliRunner().invoke(cli, ["sql", "--list", "--json"])
    assert told.exit_code == 0
    rows = json.loads(told.output)
    assert [(row["kind"], row["name"]) for row in rows] == [(entry.kind, entry.name) for entry in entries()]
    assert {row["name"]: row["version"] for row in rows if row["kind"] != "table"} == {name: one.version for name, one in ASKED.items()}
    assert {row["name"] for row in rows if row["kind"] == "table"} == TABLES.keys()
    lines = CliRunner().invoke(cli, ["sql", "--list"]).output.splitlines()
    assert len(lines) == len(rows)
    for line, row in zip(lines, rows, strict=True):
        assert line.startswith(f"{row['kind']:<5}  {row['signature']}")
        assert line.endswith(row["text"])
        assert (f" v{row['version']} " in line) == (row["version"] is not None)
    assert CliRunner().invoke(cli, ["sql", "--list", "--json", "--output", "csv"]).exit_code == 2
