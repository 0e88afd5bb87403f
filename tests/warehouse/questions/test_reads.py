"""What views and macros read: the parser's answer held against DuckDB's plans."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import permutations, product

import duckdb
import pytest

from schemas.tables import TABLES
from tests.conftest import REPOSITORY
from warehouse.questions.catalog import empty_lake
from warehouse.questions.documentation import quoted
from warehouse.questions.macros import Macro, macros
from warehouse.questions.reads import reads, reads_page, reads_sentence, sources
from warehouse.questions.views import View, views

QUESTIONS: dict[str, View | Macro] = {question.name: question for question in (*views(), *macros())}


@pytest.fixture(scope="module")
def connection() -> Iterator[duckdb.DuckDBPyConnection]:
    with empty_lake() as made:
        made.execute("PRAGMA disable_optimizer")  # it leaves out what an empty table makes needless
        yield made


@pytest.fixture(scope="module")
def letters() -> Iterator[duckdb.DuckDBPyConnection]:
    with duckdb.connect(":memory:") as made:
        made.execute("PRAGMA disable_optimizer; CREATE TABLE a (n INT); CREATE TABLE b (n INT); CREATE TABLE c (n INT)")
        yield made


def asked(question: View | Macro) -> str:
    """SQL that asks a view or macro, NULL for every parameter without a default."""
    if isinstance(question, View):
        return f"FROM {quoted(question.name)}"
    call = f"{quoted(question.name)}({', '.join('NULL' for parameter in question.parameters if ':=' not in parameter)})"
    return f"FROM {call}" if question.is_table else f"SELECT {call}"


def scanned(connection: duckdb.DuckDBPyConnection, query: str) -> set[str]:
    """Tables that the plan of a query scans, views and macros unfolded."""
    nodes = json.loads(connection.execute(f"EXPLAIN (FORMAT JSON) {query}").fetchall()[0][1])
    tables = set()
    while nodes:
        node = nodes.pop()
        nodes += node["children"]
        if "Table" in node["extra_info"]:
            tables.add(node["extra_info"]["Table"].rpartition(".")[2])
    return tables


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_view_or_macro_rests_on_what_its_plan_scans(connection: duckdb.DuckDBPyConnection, name: str) -> None:
    assert scanned(connection, asked(QUESTIONS[name])) == set(reads()[name].rests_on)


def test_what_is_read_is_listed_once_and_known() -> None:
    assert reads().keys() == QUESTIONS.keys()
    for name, read in reads().items():
        named = (*read.tables, *read.views, *read.macros)
        assert len(set(named)) == len(named)
        assert set(read.tables) <= set(read.rests_on) <= TABLES.keys()
        assert name not in named
        through = {table for other in (*read.views, *read.macros) for table in reads()[other].rests_on}
        assert set(read.rests_on) == {*read.tables, *through}


@pytest.mark.parametrize(
    ("query", "names"),
    [
        ("FROM scenes", {"scenes"}),
        ('FROM "Scenes" AS s, main.rooms', {"scenes", "rooms"}),
        ("WITH scenes AS (FROM rooms) FROM scenes", {"rooms"}),
        ("WITH scenes AS (FROM scenes) FROM scenes", {"scenes"}),
        ("WITH a AS (FROM b), b AS (FROM a) FROM b", {"b"}),
        ("FROM (WITH rooms AS (SELECT 1) FROM rooms), rooms", {"rooms"}),
        ("WITH a AS (FROM x) SELECT * FROM a WHERE EXISTS (FROM a JOIN y USING (z))", {"x", "y"}),
        ("WITH RECURSIVE a AS (FROM x UNION ALL SELECT a.* FROM a, y) FROM a", {"x", "y"}),
        ("FROM x UNION FROM y EXCEPT FROM z", {"x", "y", "z"}),
        ("SELECT (SELECT n FROM x) + 1 FROM objects_of((SELECT s FROM y))", {"x", "y", "objects_of"}),
        ("-- FROM x\nSELECT 'FROM y' AS z /* FROM z */", set()),
    ],
)
def test_names_of_a_with_are_its_own(letters: duckdb.DuckDBPyConnection, query: str, names: set[str]) -> None:
    assert {name for name in sources(letters, query) if name.isidentifier()} == names


def test_names_that_hide_tables_are_told_apart_as_by_the_plan(letters: duckdb.DuckDBPyConnection) -> None:
    for count in (1, 2):
        for names in permutations("abc", count):
            for *tables, last in product("abc", repeat=count + 1):
                parts = ", ".join(f"{name} AS (FROM {table})" for name, table in zip(names, tables, strict=True))
                query = f"WITH {parts} {' UNION ALL '.join(f'FROM {name}' for name in (*names, last))}"
                assert sources(letters, query) == scanned(letters, query), query


def test_what_cannot_be_parsed_is_named(letters: duckdb.DuckDBPyConnection) -> None:
    with pytest.raises(ValueError, match="FROM FROM"):
        sources(letters, "SELECT FROM FROM")


def test_the_page_says_it_both_ways() -> None:
    page = reads_page()
    assert (REPOSITORY / "docs" / "reads.md").read_text() == page, "write it with: make golden"
    by_table, by_question = page.split("## What a view or macro reads")
    for table in TABLES:
        (row,) = [line for line in by_table.splitlines() if line.startswith(f"| [`{table}`]")]
        shown = row.split(" | ")[1:]
        for name, read in reads().items():
            link = f"[`{name}`](views.md#{name})"
            assert [link in cell for cell in shown] == [table in read.tables, table in read.rests_on and table not in read.tables]
    for name, read in reads().items():
        (row,) = [line for line in by_question.splitlines() if line.startswith(f"| [`{name}`]")]
        cells = row.strip("| ").split(" | ")
        assert row.count("](") == 1 + len(read.tables) + len(read.views) + len(read.macros) + len(read.rests_on)
        assert len(cells) == (3 if read.rests_on else 1)


def test_a_section_of_the_views_page_says_what_is_read_and_who_reads_it() -> None:
    page = (REPOSITORY / "docs" / "views.md").read_text()
    for question in QUESTIONS.values():
        assert reads_sentence(question) in page
    assert reads_sentence(QUESTIONS["stability"]).startswith("Reads [`placements`](tables.md#placements) and [`certificates`](")
    assert reads_sentence(QUESTIONS["box_plot"]) == ""
    assert reads_sentence(QUESTIONS["scene_objects"]).endswith(" Read by [`objects_of`](#objects_of).")
