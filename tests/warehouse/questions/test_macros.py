"""The SQL macros, each against a computation of its own, and what a macro cannot do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Instance
from schemas.errors import InputError
from tests.warehouse.questions.test_views_scenes import placed
from tests.warehouse.questions.view_answers import Database, by_key, quick, same, scenes
from warehouse.lake import Lake
from warehouse.questions import macros
from warehouse.questions.sql import query, read_only


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


numbers = st.floats(-1e6, 1e6) | st.integers(-5, 5).map(float)


@quick
@given(values=st.lists(st.none() | numbers, max_size=40))
def test_box_plot_is_that_of_matplotlib(database: Database, values: list[float | None]) -> None:
    from matplotlib.cbook import boxplot_stats

    answer = database.connection.execute("SELECT box_plot($1::DOUBLE[])", [values]).fetchone()[0]
    known = [value for value in values if value is not None]
    assert answer["numbers"] == len(known)
    if not known:
        assert answer["outliers"] == []
        assert {value for name, value in answer.items() if name not in ("numbers", "outliers")} == {None}
        return
    box = boxplot_stats(known)[0]
    expected = {"q1": box["q1"], "median": box["med"], "q3": box["q3"], "smallest": min(known), "largest": max(known)}
    for name, value in expected.items():
        assert answer[name] == pytest.approx(float(value), rel=1e-9, abs=1e-9), name
    reach = 1.5 * (answer["q3"] - answer["q1"])
    inside = [value for value in known if answer["q1"] - reach <= value <= answer["q3"] + reach]
    assert answer["whisker_low"] == min([answer["q1"], *inside])
    assert answer["whisker_high"] == max([answer["q3"], *inside])
    assert answer["outliers"] == sorted(value for value in known if not answer["q1"] - reach <= value <= answer["q3"] + reach)


@quick
@given(rows=scenes())
def test_box_plot_of_groups_says_what_the_view_of_volumes_says(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    question = "SELECT category, unnest(box_plot(list(box_volume_m3))) FROM instances WHERE NOT is_structure GROUP BY category"
    boxes = by_key(database.ask(question), "category")
    answer = by_key(database.ask("volume_by_category"), "category")
    assert boxes.keys() == answer.keys()
    for category, box in boxes.items():
        same(answer[category], **{f"{name}_m3": box[name] for name in ("q1", "median", "q3", "whisker_low", "whisker_high", "smallest")})
        assert (answer[category]["objects"], answer[category]["outliers"]) == (box["numbers"], len(box["outliers"]))


@quick
@given(trials=st.integers(1, 10_000), share=st.floats(0, 1), z=st.sampled_from([1.0, 1.96, 3.0]))
def test_wilson_interval_solves_its_equation(database: Database, trials: int, share: float, z: float) -> None:
    successes = round(share * trials)
    found = database.connection.execute("SELECT wilson_interval($1, $2, z := $3)", [successes, trials, z]).fetchone()[0]
    observed = successes / trials
    assert 0 <= found["low"] <= observed <= found["high"] <= 1
    for bound in found.values():  # both ends lie z standard errors of their own from what was seen
        assert abs(observed - bound) == pytest.approx(z * np.sqrt(bound * (1 - bound) / trials), abs=1e-9)


def test_wilson_interval_of_nothing_is_unknown(database: Database) -> None:
    assert database.connection.execute("SELECT wilson_interval(0, 0), wilson_interval(NULL, 3)").fetchone()[0] is None
    default = database.connection.execute("SELECT wilson_interval(3, 10) = wilson_interval(3, 10, z := 1.96)").fetchone()[0]
    assert default is True


@pytest.mark.whole
@quick
@given(rows=placed(), n=st.integers(0, 4))
def test_the_first_n_categories_and_their_boxes(database: Database, rows: list[Any], n: int) -> None:
    database.fill(*rows)
    assert database.ask(f"FROM top_categories({n})") == database.ask("category_counts")[:n]
    assert database.ask(f"FROM volume_boxes({n})") == database.ask("volume_by_category")[:n]
    assert database.ask(f"FROM solid_volume_boxes({n})") == database.ask("solid_volume_by_category")[:n]
    assert database.ask("FROM volume_boxes()") == database.ask("volume_by_category")[:50]
    for scene in {row.scene_id for row in rows if isinstance(row, Instance)}:
        expected = [row for row in database.ask("scene_objects") if row["scene_id"] == scene]
        assert database.connection.sql("FROM objects_of($1)", params=[scene]).to_arrow_table().to_pylist() == expected
    assert database.connection.execute("FROM objects_of($1)", ["x'); DROP TABLE instances; --"]).fetchall() == []


def test_every_macro_body_only_reads() -> None:
    assert macros.macros()
    for macro in macros.macros():
        read_only(macro.body if macro.is_table else f"SELECT {macro.body}")


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return Lake.open(tmp_path_factory.mktemp("macros") / "lake")


def test_the_lakes_macros_pass_the_gate_and_no_others(lake: Lake) -> None:
    reader = lake.snapshot()
    assert query(reader, "SELECT wilson_interval(1, 2).low AS low, box_plot([1.0]).median AS median").num_rows == 1
    for macro in macros.macros():
        if macro.is_table:
            given_values = ", ".join("'x'" for parameter in macro.parameters if ":=" not in parameter)
            assert query(reader, f"FROM {macro.name}({given_values})").num_rows == 0
    for statement in ("FROM read_text('/etc/passwd')", "FROM query('SELECT 1')", "FROM nothing_of_ours(1)"):
        with pytest.raises(InputError, match="not allowed"):
            query(reader, statement)


WRITING = [
    "CREATE MACRO top_categories(n) AS TABLE SELECT 1",
    "CREATE OR REPLACE MACRO objects_of(scene) AS TABLE FROM read_text('/etc/passwd')",
    "DROP MACRO TABLE objects_of",
    "FROM top_categories((WITH gone AS (DELETE FROM instances RETURNING 1) SELECT count(*) FROM gone))",
    "FROM objects_of((SELECT content FROM read_text('/etc/passwd')))",
]


@pytest.mark.parametrize("statement", WRITING)
def test_a_macro_is_no_way_to_write_or_to_reach_out(lake: Lake, statement: str) -> None:
    with pytest.raises(InputError) as refused:
        query(lake.snapshot(), statement)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_no_macro_is_refused(tmp_path: Path) -> None:
    head = "-- What?\n-- Version 2.\n-- Note.\n"
    good = macros._parse("odd", f"{head}CREATE MACRO odd(a, b := 2) AS TABLE\nSELECT a + b")
    assert (good.parameters, good.is_table, good.version, good.note) == (("a", "b := 2"), True, 2, "Note.")
    for text in ("SELECT 1", "CREATE MACRO other(a) AS a", "CREATE MACRO odd AS 1"):
        with pytest.raises(ValueError, match="must be one statement"):
            macros._parse("odd", head + text)
    with pytest.raises(ValueError, match="states the version"):
        macros._parse("odd", "-- What?\nCREATE MACRO odd(a) AS a")
