"""Words of messages: counts agree with their noun, and what was meant is the known name that is nearest."""

from __future__ import annotations

import ast
import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.wording import counted, meant
from tests.conftest import REPOSITORY

NAMES = st.lists(st.from_regex(r"[a-z]{6,12}", fullmatch=True), unique=True, min_size=1, max_size=20)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((0, "scene"), "0 scenes"),
        ((1, "scene"), "1 scene"),
        ((2, "scene"), "2 scenes"),
        ((1500, "row"), "1500 rows"),
        ((1, "scene is", "scenes are"), "1 scene is"),
        ((0, "scene is", "scenes are"), "0 scenes are"),
        ((1, "entry", "entries"), "1 entry"),
        ((3, "entry", "entries"), "3 entries"),
    ],
)
def test_one_is_singular_and_every_other_count_is_not(words: tuple[int, str], text: str) -> None:
    assert counted(*words) == text


@given(names=NAMES, data=st.data())
def test_a_name_with_a_slip_is_told_itself_unless_another_is_as_near(names: list[str], data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(names))
    at = data.draw(st.integers(0, len(name) - 1))
    assert meant(name.upper(), names) == f"did you mean {name}? ", "capitals are no difference"
    assert meant(name[:at] + name[at + 1 :], [name]) == f"did you mean {name}? "
    assert meant(name[:at] + name[at + 1 :], names) in {f"did you mean {other}? " for other in names}


@given(names=NAMES)
def test_what_is_near_to_nothing_is_told_nothing(names: list[str]) -> None:
    assert meant("0123456789", names) == ""
    assert meant("anything", []) == ""


PLURAL = re.compile(
    r"^ (?:(?!in |of |has |is |was )[a-z]+ ){0,2}"
    r"(answers|blobs|checks|degradations|episodes|errors|files|frames|models|objects|rows|runs|scans|scenes|snapshots|trajectories)\b"
)
ALWAYS_SEVERAL = {
    "flows/training/models.py: len(meant)",  # one that begins so is the model
    "warehouse/lineage/walk.py: count",  # is not what was written, and stands beside that
    "warehouse/tables/staging.py: data.num_rows",
}
"""Counts with a plural of their own."""


def test_counts_in_messages_agree_with_their_noun() -> None:
    """No message puts a plural behind a count by itself: that is what `counted` and `noun` are for."""
    wrong = set()
    for path in (file for room in ("flows", "warehouse") for file in (REPOSITORY / room).rglob("*.py")):
        for text in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.JoinedStr)):
            for count, behind in itertools.pairwise(text.values):
                if isinstance(count, ast.FormattedValue) and isinstance(behind, ast.Constant) and PLURAL.match(str(behind.value)):
                    wrong.add(f"{path.relative_to(REPOSITORY)}: {ast.unparse(count.value)}")
    assert {each for each in wrong if "counted(" not in each and "noun(" not in each} == ALWAYS_SEVERAL
