"""What a model answers, read with tolerance for form and none for content (specs F.3)."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from schemas.parsing import json_value
from schemas.text import one_line

MOST_CHARACTERS = 100_000
"""Of a reply that is looked at; what is asked for needs some hundreds."""

_QUOTES = str.maketrans({"\u201c": '"', "\u201d": '"', "\u201e": '"', "\u2018": "'", "\u2019": "'", "`": '"'})


class UnreadableReply(ValueError):
    """A reply that does not say what was asked for. The text is what the model is told, too."""


def table_of(reply: str, example: str, *, is_alone: bool = False, listed: str = "") -> dict[str, Any]:
    """The table in a reply: JSON, or nearly.

    What stands around it, code fences, curly quotes, trailing commas, Python's words and brackets that were never closed are put right.
    example: What is asked for, as the model is told. is_alone: Whether nothing else in the reply may look like a part of a table, and no
    key be there twice: what lost or gained a bracket somewhere else is not read at all, rather than in part. listed: Field of the
    table that holds a list of tables; a list alone is taken for it.

    Raises:
        UnreadableReply: there is none.
    """
    text = re.sub(r"\s{2,}", " ", reply[:MOST_CHARACTERS]) if is_alone else reply[:MOST_CHARACTERS]
    starts = [match.start() for match in re.finditer(r"[{\[]" if listed else r"\{", text)][: 1 if is_alone else 20]
    attempts: Sequence[Callable[[str], Any]] = (json_value, _mended, _as_python)
    for attempt in attempts:
        for start in starts:
            part = _balanced(text, start)
            try:
                table = attempt(part)
            except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
                continue
            if isinstance(table, list) and listed:
                table = {listed: table}
            if isinstance(table, list) and len(table) == 1:
                table = table[0]
            if isinstance(table, dict):
                if is_alone:
                    _check_alone(text, start, part, re.findall(r"\{[^{}]*\}", part) if listed else [part])
                return table
    raise UnreadableReply(f"it holds no JSON object such as {example}")


def _check_alone(text: str, start: int, part: str, tables: Sequence[str]) -> None:
    """Raises UnreadableReply where what stands around a table looks like more of it, it has no end, or one of some tables in it has a key
    twice."""
    if not text.startswith(part, start):
        raise UnreadableReply("it has no end")  # nobody knows whether its last value has
    rest = text[start + len(part) :]
    around = f"{text[:start]} {rest}".replace("```", " ").translate(_QUOTES)
    if re.search(r'[{}\[\]"]|(?:^|\s)[:,]?\s*\d+(?:\.\d+)?\s*[,}]', around):
        raise UnreadableReply("there is more than one JSON object, or a bracket too many")
    for table in tables:
        keys = re.findall(r"""["'](\w+)["']\s*:""", table.translate(_QUOTES))
        if len(set(keys)) < len(keys):
            raise UnreadableReply("a field is there twice")


def number_in(value: Any, field: str, units: Mapping[str, float]) -> float:
    """A number, however it is written: 3, "3.5", [3.5], "20 kg". units: Known ones, lower case, and what one of each is [the field's].

    Raises:
        UnreadableReply: it is none, or of an unknown unit.
    """
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    scale = 1.0
    if isinstance(value, str) and len(value) < 40:
        written = re.fullmatch(r"\s*([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*([a-zA-Z]*)\.?\s*", value)
        unit = written[2].lower() if written is not None else ""
        if written is None or (unit and unit not in units):
            known = ", ".join(units) or "none"
            raise UnreadableReply(f"{field} must be a number, not {value[:40]!r} (units: {known})")
        value, scale = float(written[1]), units.get(unit, 1.0)
    try:
        number = float(value) * scale if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:  # a model that repeats a digit without end
        number = math.nan
    if not math.isfinite(number):
        raise UnreadableReply(f"{field} must be a number")
    return number


def word_in(value: Any, field: str) -> str:
    """A text in one line, without what commands a terminal.

    Raises:
        UnreadableReply: it is none.
    """
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    if not isinstance(value, str) or not value.strip():
        raise UnreadableReply(f"{field} must be a text")
    return " ".join(one_line(value).split())


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
    return json_value(re.sub(r",\s*([}\]])", r"\1", text))


def _as_python(text: str) -> Any:
    """Literals as Python writes them; nothing is run. Two texts side by side would be one: a comma is missing there."""
    if re.search(r"""["']\s*["'](?=\s*[^\s,:}\]])""", text.translate(_QUOTES)):
        raise ValueError("two texts without a comma between")
    return ast.literal_eval(text.translate(_QUOTES))
