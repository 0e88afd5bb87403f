"""Items on a support as somebody names them, and what a model's list of them says (supplementary; specs A.3, F.3)."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence
from typing import Any

from tasks.calls.replies import UnreadableReply, number_in, table_of, word_in

ITEMS: dict[str, Any] = {
    "type": "object",
    "properties": {
        "items": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {"item": {"type": "string"}, "color": {"type": ["string", "null"]}, "count": {"type": "integer"}},
                "required": ["item", "color", "count"],
                "additionalProperties": False,
            },
        }
    },
    "required": ["items"],
    "additionalProperties": False,
}
"""JSON schema of a list; its root is an object, as strict servers want it."""

MOST_LETTERS, MOST_ITEMS, MOST_ALIKE = 60, 200, 100
"""Letters of a name, entries of a list, and things of one name and color: more is no answer."""

_NO_COLOR = ("", "none", "null", "n/a", "unknown", "transparent", "clear", "various", "multicolor", "multicolored")
_PLURAL_ONLY = ("glasses", "sunglasses", "scissors", "headphones", "earphones", "earbuds", "pants", "jeans", "shorts", "pliers", "tweezers",
                "binoculars", "clothes", "keys", "goggles")  # fmt: skip
_IRREGULAR = {"knives": "knife", "shelves": "shelf", "leaves": "leaf", "loaves": "loaf", "mice": "mouse", "dice": "die", "scarves": "scarf"}


@dataclasses.dataclass(frozen=True)
class SupportItem:
    """Things of one name and color on a support. name: Its last word in the singular. color: '' where it has none."""

    name: str
    color: str
    count: int = 1


def items_of(reply: str) -> tuple[SupportItem, ...]:
    """The items in a reply, each name and color once; none where there are none.

    Raises:
        UnreadableReply: it is no such list, or an entry of it says what cannot be.
    """
    table = table_of(reply, '{"items": [{"item": "mug", "color": "white", "count": 1}]}', is_alone=True, listed="items")
    fields = {str(key).strip().lower(): value for key, value in table.items()}
    entries = [table] if "item" in fields else fields.get("items")
    if not isinstance(entries, list):
        raise UnreadableReply("items must be a list")
    if len(entries) > MOST_ITEMS:
        raise UnreadableReply(f"items must be {MOST_ITEMS} at most")
    return merged([_item_of(entry) for entry in entries])


def _item_of(entry: Any) -> SupportItem:
    if not isinstance(entry, dict):
        raise UnreadableReply('each of items must be an object such as {"item": "mug", "color": "white", "count": 1}')
    fields = {str(key).strip().lower(): value for key, value in entry.items()}
    unknown = sorted(set(fields) - {"item", "color", "count"})
    if unknown or len(fields) < len(entry):
        raise UnreadableReply(f"each of items has item, color and count, and not {unknown[0][:40] if unknown else 'one of them twice'!r}")
    color = fields.get("color")
    count = number_in(1 if fields.get("count") is None else fields["count"], "count", {})
    if count != int(count) or not 1 <= count <= MOST_ALIKE:
        raise UnreadableReply(f"count must be a whole number from 1 to {MOST_ALIKE}, is {count:g}")
    shade = "" if color is None else _plain(word_in(color, "color") if color != "" else "", "color")
    name = _plain(word_in(fields.get("item"), "item"), "item")
    return SupportItem(lemma(name), "" if shade in _NO_COLOR else shade.replace("grey", "gray"), int(count))


def _plain(text: str, field: str) -> str:
    """A name in small letters, of letters, digits and what stands within words."""
    if len(text) > MOST_LETTERS or (text and not re.fullmatch(r"\w[\w '&/()+-]*\.?", text)):
        raise UnreadableReply(f"{field} must be a few words of {MOST_LETTERS} letters at most")
    return text.lower().rstrip(".").strip()


def lemma(name: str) -> str:
    """A name with its last word in the singular: coffee mugs as coffee mug."""
    *before, last = name.split()
    return " ".join([*before, _singular(last)])


def _singular(word: str) -> str:
    if word in _PLURAL_ONLY or len(word) <= 3 or not word.endswith(("s", "ice")):
        return word
    if word in _IRREGULAR:
        return _IRREGULAR[word]
    if word.endswith("ies") and len(word) > 5:
        return f"{word[:-3]}y"
    if word.endswith(("sses", "xes", "ches", "shes", "zzes", "toes")):
        return word[:-2]
    return word[:-1] if not word.endswith(("ss", "us", "is", "ice")) else word


def merged(items: Iterable[SupportItem]) -> tuple[SupportItem, ...]:
    """Items of one list, each name and color once, in the order in which they were first named; their counts are added."""
    counts: dict[tuple[str, str], int] = {}
    for item in items:
        key = (item.name, item.color)
        counts[key] = counts.get(key, 0) + item.count
    return tuple(SupportItem(name, color, count) for (name, color), count in counts.items())


def united(lists: Sequence[Sequence[SupportItem]]) -> tuple[SupportItem, ...]:
    """Items of several pictures of one support, each name and color once, as often as the picture shows it that shows it most."""
    counts: dict[tuple[str, str], int] = {}
    for item in (item for own in lists for item in own):
        key = (item.name, item.color)
        counts[key] = max(counts.get(key, 0), item.count)
    return tuple(SupportItem(name, color, count) for (name, color), count in counts.items())


def names_of(items: Iterable[SupportItem]) -> tuple[str, ...]:
    """Names of items, each once, in their order."""
    return tuple(dict.fromkeys(item.name for item in items))
