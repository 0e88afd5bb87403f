"""JSON read within the budget: text that is nested too deep or would take too much memory is refused as a ValueError."""

from __future__ import annotations

import json
from typing import Any

from schemas.budget import BUDGET


class TooMuch(ValueError):
    """Content of a file that would take more memory than the budget."""


_COSTS = {b"[": 88, b"{": 240, b",": 32, b":": 60, b'"': 25}
"""Bytes of memory behind every such sign of a JSON text, more rather than less (CPython 3.11 and 3.12)."""


def json_value(data: bytes | str, **hooks: Any) -> Any:
    """The value in a JSON text; `hooks` are those of `json.loads`.

    Raises:
        ValueError: it is no JSON, would take more memory than `BUDGET.memory_bytes`, or is nested deeper than `BUDGET.depth`.
    """
    weigh_json(data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data)
    too_deep = f"is nested deeper than {BUDGET.depth} values"
    try:
        value = json.loads(data, **hooks)
    except RecursionError as error:
        raise ValueError(too_deep) from error
    level, depth = [value], 1
    while level := [inner for node in level if isinstance(node, dict | list) for inner in _within(node)]:
        depth += 1
        if depth > BUDGET.depth:
            raise ValueError(too_deep)
    return value


def weigh_json(text: bytes, a_line: int = 0) -> None:
    """Raise TooMuch when the values in JSON texts, one or many, would take more memory than `BUDGET.memory_bytes`.

    a_line: Bytes of memory behind every line, where lines are values.
    """
    needed = len(text) + sum(text.count(sign) * cost for sign, cost in _COSTS.items()) + text.count(b"\n") * a_line
    if needed > BUDGET.memory_bytes:
        raise TooMuch(f"its values take about {needed >> 20} MB, more than {BUDGET.memory_bytes >> 20}")


def _within(value: Any) -> list[Any]:
    """The lists and objects directly inside a list or an object."""
    return [inner for inner in (value.values() if isinstance(value, dict) else value) if type(inner) in (dict, list)]
