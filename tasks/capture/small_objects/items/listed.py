"""Items that are looked for on a support whoever sees it: a list by categories of supports, `items.csv`, that people edit.

A row has categories of `supports.csv`, items, both with semicolons between, and why. A support that no row has gets the first row's.
"""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

from schemas.errors import InputError
from tasks.capture.files.documents import read_text
from tasks.capture.small_objects.supports import support_kind
from tasks.settings import Config, Texts

FILE = "items.csv"

OTHERS = ""
"""Where the items of supports stand that no row has."""


@dataclasses.dataclass(frozen=True)
class ListedItems(Config):
    """Items out of a list, without an endpoint."""

    kind: ClassVar[str] = "listed"
    names: Texts = ()  # in the place of those that the list has for the support's category
    version: str = "1"  # goes up when the same list would give other items


def listed_names(category: str, settings: ListedItems) -> tuple[str, ...]:
    """What is looked for on a support of a category.

    Raises:
        InputError: the list has a row that says nothing.
    """
    if settings.names:
        return settings.names
    known = item_lists()
    kind = support_kind(category)
    return known.get(category) or known.get(kind.category if kind is not None else "") or known[OTHERS]


@cache
def item_lists() -> Mapping[str, tuple[str, ...]]:
    """Items by category of the support; under '' those of any other one.

    Raises:
        InputError: the list has a row that says nothing.
    """
    path = Path(__file__).with_name(FILE)
    return MappingProxyType(parsed_lists(read_text(path, path.name), path.name))


def parsed_lists(text: str, name: str) -> dict[str, tuple[str, ...]]:
    """Items by category of the support, from the text of a list; `name` is that of its file.

    Raises:
        InputError: a column is missing, a row has no items, or a support is none or has two rows.
    """
    rows = csv.DictReader(io.StringIO(text, newline=None))
    for field in ("supports", "items"):
        if field not in (rows.fieldnames or ()):
            raise InputError(name, field, "the column is missing", "write supports, items, why into the first line")
    lists: dict[str, tuple[str, ...]] = {}
    for line, row in enumerate(rows, start=2):
        supports, items = (
            tuple(dict.fromkeys(" ".join(part.lower().split()) for part in (row[field] or "").split(";")))
            for field in ("supports", "items")
        )
        if "" in items:
            raise InputError(name, f"line {line}, items", "is empty, or has an empty entry", "write names with semicolons between")
        for support in supports:
            if support_kind(support) is None or support in lists:
                problem = f"{support[:20]!r} carries nothing, or a line above has it already"
                raise InputError(name, f"line {line}, supports", problem, "write categories of supports.csv with semicolons between")
            lists[support] = items
        lists.setdefault(OTHERS, items)
    if not lists:
        raise InputError(name, "items", "has no row", "write one")
    return lists
