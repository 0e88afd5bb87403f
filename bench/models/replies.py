"""Replies of a language model, corrupted at random: how many are read, and whether anything is read that was not meant."""

from __future__ import annotations

import dataclasses
import json
import random
from collections.abc import Mapping
from typing import Any

from bench.goals import goal
from tasks.calls.replies import UnreadableReply
from tasks.captions.wording import appearance_of, attributes_of
from tasks.capture.small_objects.items.item import items_of

SIZE = (0.5, 0.5, 0.95)
"""Box of the chair that is asked about [m]."""

LOOKS: Mapping[str, Any] = {
    "category": "chair", "colors": ["dark red", "Grey"], "materials": ["wooden", "cotton"], "texture": "smooth", "shape": "with one arm",
    "sentence": "a dark red wooden chair with one arm.",
}  # fmt: skip
"""What a model says of its looks."""

BEHAVES: Mapping[str, Any] = {"physics_attributes": {"category": "Rigid Body", "mass": 6.5, "friction": 0.45, "bounciness": 0}}
"""What a model says of its behavior."""

FORMS = (
    json.dumps(BEHAVES),
    json.dumps({"physics_attributes": {"bounciness": 0, "friction": 0.45, "category": "Rigid Body", "mass": 6.5}}),
    json.dumps({"physics_attributes": {"category": "Rigid Body", "friction": 0.45, "bounciness": 0, "mass": "6500 g"}}, indent=1),
)
"""The same, in forms that models take."""


LISTS = (
    json.dumps({"items": [{"item": "coffee mug", "color": "white", "count": 2}, {"item": "Book", "color": None, "count": 1},
                          {"item": "book", "color": "red", "count": 3}]}),
    json.dumps([{"item": "coffee mugs", "color": "White", "count": 2}, {"item": "books", "color": ""},
                {"item": "book", "color": "red", "count": "3"}]),
    json.dumps({"items": [{"item": "Coffee mug", "color": "white", "count": 2}, {"item": "book", "color": "none"},
                          {"item": "book", "color": "red", "count": 1}, {"item": "book", "color": "red", "count": 2}]}, indent=1),
)  # fmt: skip
"""A list of what is on a support, in forms that models take."""

READ = 0.2
"""Share of corrupted replies that have to be read: who refuses all of them accepts nothing wrong, either."""


@dataclasses.dataclass(frozen=True)
class ReplyFigures:
    """What became of so many corrupted replies: how many were read, and how many of these said something that was not meant."""

    replies: int
    read: int
    wrong: int


def corrupted(plain: str, draw: random.Random) -> str:
    """A bracket, quote, colon or comma deleted, doubled, moved or put in, the end cut off, fences and words around, other quotes, twice."""
    marks = [i for i, letter in enumerate(plain) if letter in '{}[]",:']
    at, place = draw.choice(marks), draw.randrange(len(plain) + 1)
    match draw.randrange(8):
        case 0:
            return plain[:at] + plain[at + 1 :]
        case 1:
            return plain[:at] + draw.choice([plain[at], " ", "\n"]) + plain[at:]
        case 2:
            return plain[:place] + draw.choice('{}[]",:') + plain[place:]
        case 3:
            return f"Sure, here it is:\n```json\n{plain}\n```\nHope it helps {{:)"
        case 4:
            return plain[: len(plain) - draw.randrange(12)]
        case 5:
            return plain.replace('"', draw.choice(["'", "`", "\u201d"]))
        case 6:
            return plain + draw.choice(["\n" + plain, "}", "]", ' "mass": 3}'])
        case _:
            low, high = sorted((at, draw.choice(marks)))
            return plain[:low] + plain[high] + plain[low + 1 : high] + plain[low] + plain[high + 1 :] if low < high else plain


def physics_figures(count: int, seed: int) -> ReplyFigures:
    """Of replies about physical attributes."""
    draw, read, wrong = random.Random(seed), 0, 0
    for _ in range(count):
        try:
            answer = attributes_of(corrupted(draw.choice(FORMS), draw), SIZE)
        except UnreadableReply:
            continue
        read += 1
        wrong += (answer.body_type, answer.mass_kg, answer.friction, answer.is_bouncy) != ("rigid", 6.5, 0.45, False)
    return ReplyFigures(count, read, wrong)


def looks_figures(count: int, seed: int) -> ReplyFigures:
    """Of replies about looks; a letter more in a sentence changes neither colors nor materials."""
    plain = json.dumps(LOOKS)
    draw, read, wrong, right = random.Random(seed), 0, 0, appearance_of(plain)
    for _ in range(count):
        try:
            answer = appearance_of(corrupted(plain, draw))
        except UnreadableReply:
            continue
        read += 1
        wrong += (answer.colors, answer.materials) != (right.colors, right.materials)
    return ReplyFigures(count, read, wrong)


def list_figures(count: int, seed: int) -> ReplyFigures:
    """Of lists of what is on a support."""
    draw, read, wrong, right = random.Random(seed), 0, 0, items_of(LISTS[0])
    for _ in range(count):
        try:
            answer = items_of(corrupted(draw.choice(LISTS), draw))
        except UnreadableReply:
            continue
        read += 1
        wrong += answer != right
    return ReplyFigures(count, read, wrong)


def reply_report(count: int, seed: int) -> dict[str, Any]:
    """All of them, against the goal that nothing wrong is accepted."""
    parts = {
        "physical attributes": physics_figures(count, seed), "looks": looks_figures(count, seed), "items": list_figures(count, seed)
    }  # fmt: skip
    wrong, read = sum(each.wrong for each in parts.values()), sum(each.read for each in parts.values()) / (len(parts) * count)
    rows = [{"replies about": name, **dataclasses.asdict(figures)} for name, figures in parts.items()]
    return {
        "rows": rows,
        "goals": [goal("wrong values that were accepted", wrong, "==", 0), goal("share of replies that were read", read, ">=", READ)],
    }
