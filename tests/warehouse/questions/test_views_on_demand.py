"""A statement is answered with the views that it names alone, and answers the same as with all of them."""

from __future__ import annotations

import pytest

from schemas.errors import InputError
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.questions.macros import macros
from warehouse.questions.sql import query
from warehouse.questions.views import asked_by, views
from warehouse.tables.snapshot import Reader


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    lake = Lake.open(tmp_path_factory.mktemp("demand") / "lake")
    stage_whole_scene(lake, "demo/scene0000_00", "once", at=0)
    lake.commit()
    return lake.snapshot()


@pytest.mark.whole
def test_every_question_is_answered_as_by_a_connection_with_all_of_them(reader: Reader) -> None:
    asked = [f"FROM {view.name}" for view in views()] + [macro.note.partition("Example: ")[2] for macro in macros()]
    with reader.connect() as everything:
        for sql in asked:
            names = asked_by(sql)
            assert names is not None
            assert names, sql
            relation = everything.sql(sql)
            with reader.connect(names=names) as few:
                assert (few.sql(sql).columns, few.sql(sql).types) == (relation.columns, relation.types), sql
                assert sorted(map(repr, few.sql(sql).fetchall())) == sorted(map(repr, relation.fetchall())), sql


def test_names_count_however_they_are_written() -> None:
    (plain,) = {
        asked_by(sql) for sql in ("FROM scene_timing", 'SELECT * FROM "SCENE_Timing"', "FROM main.scene_timing s", "TABLE/**/scene_timing")
    }
    assert plain is not None
    assert "scene_timing" in plain
    assert asked_by("SELECT 1") == asked_by("FROM scenes") == frozenset()


@pytest.mark.parametrize("sql", ["SHOW TABLES", "FROM duckdb_views()", "FROM information_schema.tables", "FROM pg_views", "describe"])
def test_who_looks_about_sees_every_view(reader: Reader, sql: str) -> None:
    assert asked_by(sql) is None
    seen = {value for row in query(reader, sql).to_pylist() for value in row.values() if isinstance(value, str)}
    assert {view.name for view in views()} <= seen


@pytest.mark.parametrize(
    "sql", ["FROM headlin", "FROM scene_timings", "SELECT wilson_intervall(1, 2)", "SELECT nothing FROM headline", "FROM box_plots()"]
)
def test_a_refusal_is_that_of_a_connection_with_all_of_them(reader: Reader, sql: str, monkeypatch: pytest.MonkeyPatch) -> None:
    refusals = []
    for _ in range(2):
        with pytest.raises(InputError) as refused:
            query(reader, sql)
        refusals.append(str(refused.value))
        monkeypatch.setattr("warehouse.questions.sql.asked_by", lambda sql: None)
    assert refusals[0] == refusals[1]
