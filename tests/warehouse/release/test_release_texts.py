"""Texts of foreign files in pages of a release and in model cards: tables keep their shape, and nothing commands a terminal."""

from __future__ import annotations

import json
import re
from typing import Any

import duckdb
from hypothesis import example, given
from hypothesis import strategies as st

from flows.training.folders import card_of
from schemas.text import escaped, is_one_line, markdown_cell, page_text
from tests.flows.training.test_training_folders import FIGURE, model_row
from warehouse.release.attribution import Attribution, Credit
from warehouse.release.card import _Answers

HOSTILE = "a | b\n\n| c |\t\x00\x1b[31m\u202e\u2066\u2028\r\x85<script>[x](javascript:1) ![i](http://h/i.png) `c` **b** \\| \\"
TEXTS = st.text(max_size=80) | st.text("|\\`[]()<>!*\n\r\t\x00\x1b\u202e\u2066a ", max_size=40)


def table_rows(page: str) -> list[list[str]]:
    """Cells of the table lines of a page, split at bars that no backslash stands before."""
    lines = [line for line in page.split("\n") if line.startswith("|")]
    return [re.split(r"(?<!\\)(?:\\\\)*\|", line)[1:-1] for line in lines]


def is_plain(page: str) -> bool:
    return all(is_one_line(line) for line in page.split("\n"))


@given(TEXTS)
@example(HOSTILE)
def test_a_cell_is_one_line_of_plain_text(text: str) -> None:
    cell = markdown_cell(text)
    assert is_one_line(cell)
    bare = re.sub(r"\\.", "", cell)
    assert not set(bare) & set("|`[]*<\\")
    assert is_plain(page_text(text.replace("\r", "")))


@given(TEXTS, TEXTS, TEXTS)
@example(HOSTILE, HOSTILE, HOSTILE)
def test_an_attribution_keeps_its_tables(license_: str, author: str, what: str) -> None:
    page = Attribution((Credit(license_, author, what, 1, 2),), (Credit(license_, author, what, 3, 4),) * 2).page("Attribution")
    assert is_plain(page)
    assert [len(row) for row in table_rows(page)] == [6] * 7, "two heads, their lines, and three credits"


@given(TEXTS, TEXTS)
@example(HOSTILE, HOSTILE)
def test_a_table_of_answers_keeps_its_shape(scene: str, error: str) -> None:
    with duckdb.connect() as connection:
        connection.execute("CREATE TABLE t (scene VARCHAR, error VARCHAR, n BIGINT)")
        values = [text.encode("utf-8", "replace").decode() for text in (scene, error)]
        connection.execute("INSERT INTO t VALUES (?, ?, 1)", values)
        page = _Answers(connection).table("SELECT * FROM t")
    assert is_plain(page)
    assert [len(row) for row in table_rows(page)] == [3, 3, 3]


@given(TEXTS, TEXTS, TEXTS)
@example(HOSTILE, HOSTILE, HOSTILE)
def test_a_model_card_keeps_its_table(license_: str, note: str, dataset: str) -> None:
    row = model_row()
    document: dict[str, Any] = {
        **{name: getattr(row, name) for name in ("kind", "architecture", "model_id", "parameter_count", "dataset_fingerprint", "seed")},
        "code_fingerprint": row.code_fingerprint, "device": "cpu", "parent_id": None, "is_fallback": False, "examples": {"train": 5},
        "license": license_, "notes": [note], "dataset": dataset, "measures": [FIGURE | {"dataset": dataset}],
    }  # fmt: skip
    card = card_of(document, 100)
    assert is_plain(card)
    assert [len(row) for row in table_rows(card)] == [7, 7, 7]
    assert sum(line.startswith("- ") for line in card.split("\n")) == 5


@given(TEXTS)
@example(HOSTILE)
def test_json_says_the_same_once_it_is_fit_to_show(text: str) -> None:
    document = escaped(json.dumps({"text": text}, ensure_ascii=False))
    assert json.loads(document) == {"text": text}
