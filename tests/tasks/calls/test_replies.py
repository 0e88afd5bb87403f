"""Tables in replies: read whatever their form, and not at all where that might be in part."""

from __future__ import annotations

from tasks.calls.replies import table_of


def test_the_first_table_that_can_be_read_counts() -> None:
    assert table_of('{not this} {"a": 1} {"b": 2}', "{}") == {"a": 1}
    assert table_of('x {"a": {"b": [1, 2]}} y', "{}") == {"a": {"b": [1, 2]}}
