"""What a vision-language model answers, read with tolerance for form and none for content (specs F.3)."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Sequence
from typing import Any

MOST_CHARACTERS = 100_000
"""Of a reply that is looked at; a choice among ten needs some hundreds."""

_QUOTES = str.maketrans({"\u201c": '"', "\u201d": '"', "\u201e": '"', "\u2018": "'", "\u2019": "'", "`": '"'})


class UnreadableReply(ValueError):
    """A reply that does not say what was asked for. The text is what the model is told, too."""


def ranking_of(reply: str, count: int) -> tuple[int, ...]:
    """Numbers of candidates from 1 to `count`, best first, as a reply ranks them: its choice, then the rest that it names.

    Raises:
        UnreadableReply: it holds no table, or one that names no candidate, none that there is, or one twice.
    """
    table = table_of(reply)
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


def table_of(reply: str) -> dict[str, Any]:
    """The table in a reply: JSON, or nearly.

    What stands around it, code fences, curly quotes, trailing commas, Python's words and brackets that were never closed are put right.

    Raises:
        UnreadableReply: there is none.
    """
    text = reply[:MOST_CHARACTERS]
    starts = [match.start() for match in re.finditer(r"\{", text)][:20]
    attempts: Sequence[Callable[[str], Any]] = (json.loads, _mended, _as_python)
    for attempt in attempts:
        for start in starts:
            part = _balanced(text, start)
            try:
                table = attempt(part)
            except (ValueError, SyntaxError, RecursionError, MemoryError):
                continue
            if isinstance(table, list) and len(table) == 1:
                table = table[0]
            if isinstance(table, dict):
                return table
    raise UnreadableReply('it holds no JSON object such as {"choice": 1, "ranking": [1, 2, 3]}')


def _balanced(text: str, start: int) -> str:
    """From a brace to the one that closes it; to the end, with what is missing, where none does."""
    closing: list[str] = []
    in_text, escaped = False, False
    for place in range(start, len(text)):
        letter = text[place]
        if in_text:
            escaped, in_text = (letter == "\\" and not escaped), in_text and (letter != '"' or escaped)
        elif letter == '"':
            in_text = True
        elif letter in "{[":
            closing.append("}" if letter == "{" else "]")
        elif letter in "}]":
            if not closing or closing.pop() != letter:
                return text[start : place + 1]
            if not closing:
                return text[start : place + 1]
    rest = text[start:].rstrip().rstrip("`").rstrip()
    return rest + ('"' if in_text else "") + "".join(reversed(closing))


def _mended(text: str) -> Any:
    """JSON with curly quotes, trailing commas and comments put right."""
    text = re.sub(r"//[^\n\"]*$", "", text.translate(_QUOTES), flags=re.MULTILINE)
    return json.loads(re.sub(r",\s*([}\]])", r"\1", text))


def _as_python(text: str) -> Any:
    """Literals as Python writes them; nothing is run."""
    return ast.literal_eval(text.translate(_QUOTES))


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
