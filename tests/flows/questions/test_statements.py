"""Where statements end, held against DuckDB's own parser, and what a history makes of them."""

from __future__ import annotations

import duckdb
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.questions.statements import in_one_line, is_blank, parted

VALUES = st.sampled_from(
    (
        "1", "'a;b'", "'it''s;'", r"e'it\'s;'", "E'x'", '"a;b"', '"say "";"', "$$ ; ' $$", "$t$ ; $$ ; $t$", "a$b$", "name", "''", "';'",
        "'two\nlines;'", "'-- no; comment'", "'/*'",
    )
)  # fmt: skip
GAPS = st.sampled_from((" ", "\n", " -- a; comment 'of\n", "/* ; */", "/* a /* nested; */ 'b; */", "\t", " --\n"))
"""What may stand between words: all of it holds at least something."""


@st.composite
def statements(draw: st.DrawFn) -> str:
    """A statement that DuckDB parses."""
    values = draw(st.lists(VALUES, min_size=1, max_size=4))
    return "".join(["SELECT", draw(GAPS), f"{draw(GAPS)},{draw(GAPS)}".join(values), draw(GAPS)])


def tokens(statement: str) -> list[str]:
    """What a statement says, without space and comments."""
    data, found = statement.encode(), duckdb.tokenize(statement)
    ends = [begin for begin, _ in found[1:]] + [len(data)]
    pieces = [(data[begin:end].decode(), kind) for (begin, kind), end in zip(found, ends, strict=True)]
    return [piece.strip() for piece, kind in pieces if kind != duckdb.token_type.comment]


@settings(max_examples=200, deadline=None)
@given(several=st.lists(statements(), min_size=1, max_size=4), rest=st.sampled_from(("", " \n", "-- end\n")), cut=st.data())
def test_statements_end_where_duckdb_says_and_line_by_line_nothing_changes(several: list[str], rest: str, cut: st.DataObject) -> None:
    text = ";".join([*several, rest])
    assert len(duckdb.extract_statements(text)) == len(several)
    found, left = parted(text)
    assert found == several
    assert left == rest
    assert is_blank(left)
    at = cut.draw(st.integers(0, len(text)))
    first, begun = parted(text[:at])
    second, end = parted(begun + text[at:])
    assert (first + second, end) == (found, left), "a statement that is cut anywhere is put together again"


@settings(max_examples=200, deadline=None)
@given(statement=statements())
def test_a_statement_in_one_line_means_the_same(statement: str) -> None:
    line = in_one_line(statement)
    assert "\n" not in line
    (parsed,) = duckdb.extract_statements(line)
    assert parsed.type == duckdb.StatementType.SELECT
    assert in_one_line(line) == line
    assert "".join(tokens(line)).split() == "".join(tokens(statement)).split()


@pytest.mark.parametrize(
    "text", ["SELECT 'a;", 'SELECT "a;', "SELECT /* a; /* b */ ;", "SELECT $x$ ; $y$ ;", r"SELECT e'it\';", "SELECT 1 -- a;"]
)
def test_what_is_not_closed_yet_ends_nothing(text: str) -> None:
    assert parted(text) == ([], text)
    assert not is_blank(text)


def test_semicolons_alone_are_no_statements() -> None:
    assert parted(";; -- nothing\n;") == ([], "")
    assert is_blank(" -- a\n/* b */ ")
    assert not is_blank("/* b")
