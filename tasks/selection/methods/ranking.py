"""The ranking of candidates in a model's reply."""

from __future__ import annotations

import re
from typing import Any

from tasks.calls.replies import UnreadableReply, table_of

EXAMPLE = '{"choice": 1, "ranking": [1, 2, 3]}'
"""What is asked for."""


def ranking_of(reply: str, count: int) -> tuple[int, ...]:
    """Numbers of candidates from 1 to `count`, best first, as a reply ranks them: its choice, then the rest that it names.

    Raises:
        UnreadableReply: it holds no table, or one that names no candidate, none that there is, or one twice.
    """
    table = table_of(reply, EXAMPLE)
    lowered = {str(key).strip().lower(): value for key, value in table.items()}
    named = [_number(lowered["choice"], "choice")] if lowered.get("choice") is not None else []
    ranked = lowered.get("ranking")
    rest = [_number(item, "ranking") for item in (ranked if isinstance(ranked, list) else [] if ranked is None else [ranked])]
    if named and rest and rest[0] != named[0] and named[0] in rest:
        raise UnreadableReply(f"choice is {named[0]}, but ranking begins with {rest[0]}")
    order = [*named, *(number for number in rest if not named or number != named[0])]
    if not order:
        raise UnreadableReply("choice is missing: it must be the number of a candidate")
    wrong = next((number for number in order if not 1 <= number <= count), None)
    if wrong is not None:
        raise UnreadableReply(f"there is no candidate {wrong}; they are numbered from 1 to {count}")
    if len(set(order)) < len(order) or len(set(rest)) < len(rest):
        raise UnreadableReply("a candidate is named twice")
    return tuple(order)


def _number(value: Any, field: str) -> int:
    """The number of a candidate, however it is written: 3, 3.0, "3", "Candidate 3", {"candidate": 3}.

    Raises:
        UnreadableReply: it is none.
    """
    if (isinstance(value, dict) and len(value) == 1) or (isinstance(value, list) and len(value) == 1):
        value = next(iter(value.values())) if isinstance(value, dict) else value[0]
    if isinstance(value, bool):
        raise UnreadableReply(f"{field} must hold numbers of candidates")
    if isinstance(value, int) or (isinstance(value, float) and value.is_integer()):
        return int(value)
    written = re.findall(r"-?\d+(?:\.\d+)?", value) if isinstance(value, str) and len(value) < 60 else []
    if len(written) == 1 and "." not in written[0]:
        return int(written[0])
    raise UnreadableReply(f"{field} must hold numbers of candidates")
