"""The SQL views: their headers, and that each is one statement that reads."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from schemas.tables import TABLES
from tests.warehouse.questions.view_answers import (
    Database,
)
from warehouse.questions import views


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def test_every_view_asks_a_question_and_answers_an_empty_lake(database: Database) -> None:
    database.fill()
    comments = dict(database.connection.execute("SELECT view_name, comment FROM duckdb_views() WHERE NOT internal").fetchall())
    assert len(views.views()) >= 20
    for name, question in ((view.name, view.question) for view in views.views()):
        assert question.endswith("?")
        assert comments[name].startswith(f"{question} Version ")
        assert len(database.ask(name)) == {"headline": 1, "annotation_timing": 4}.get(name, 0), name
    assert {name: value for name, value in database.ask("headline")[0].items() if value} == {}


def test_views_name_no_table_and_each_is_a_single_reading_statement(database: Database) -> None:
    import duckdb

    for view in views.views():
        assert view.name not in TABLES
        statements = database.connection.extract_statements(view.query)
        assert [s.type for s in statements] == [duckdb.StatementType.SELECT]


def test_a_view_without_a_question_is_refused() -> None:
    with pytest.raises(ValueError, match="asks a question"):
        views._parse("odd", "SELECT 1")
    with pytest.raises(ValueError, match="is a table"):
        views._parse("scenes", "-- What?\n-- Version 1.\nSELECT 1")
    with pytest.raises(ValueError, match="states the version"):
        views._parse("odd", "-- What?\nSELECT 1")
