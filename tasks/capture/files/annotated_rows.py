"""Values of one row of an annotation, in the kinds in which files hold them: a wrong value costs its row at most."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.documents import plain_text

MAX_NUMBER = 2**62
"""Ids stay below this, so that arithmetic on 64 bits cannot overflow."""

_DIGITS = re.compile(r"\s*[+-]?[0-9]{1,19}(\.0*)?\s*", re.ASCII)


def whole_number(value: Any, minimum: int = 0) -> int | None:
    """An integer that a file holds as a number, a float or a text; None if it is something else, or below `minimum`."""
    if isinstance(value, str) and _DIGITS.fullmatch(value):
        value = int(value.strip().partition(".")[0])
    elif isinstance(value, float) and value.is_integer():
        value = int(value)
    is_number = isinstance(value, int) and not isinstance(value, bool) and minimum <= value < MAX_NUMBER
    return value if is_number else None


def whole_numbers(value: Any, minimum: int = -MAX_NUMBER) -> tuple[NDArray[np.int64], int]:
    """The integers of a list, shape (n,), and the number of other values in it; of no list, none."""
    if not isinstance(value, list):
        return np.zeros(0, dtype=np.int64), int(value is not None)
    numbers = [number for item in value if (number := whole_number(item, minimum)) is not None]
    return np.array(numbers, dtype=np.int64), len(value) - len(numbers)


def label_text(value: Any) -> tuple[str, bool]:
    """A label in one line, and True if the value was one; numbers count, anything else is an empty label."""
    if isinstance(value, str):
        return plain_text(value), True
    if isinstance(value, int | float) and not isinstance(value, bool):
        return plain_text(f"{value}"), True
    return "", False


def distinct_numbers(numbers: list[int | None], minimum: int = 0) -> list[int]:
    """Numbers of rows, of which each is different: rows without one, or with an earlier one's, get those after the highest."""
    following = max((number for number in numbers if number is not None), default=minimum - 1) + 1
    seen: set[int] = set()
    result: list[int] = []
    for number in numbers:
        if number is None or number in seen:
            number, following = following, following + 1
        seen.add(number)
        result.append(number)
    return result


@dataclasses.dataclass(frozen=True)
class InstanceRow:
    """A row of a list of instances: its place in the list, its number (unique), its label, and the row itself."""

    index: int
    number: int
    label: str
    entry: dict[str, Any]


def instance_rows(
    listed: list[Any], file: str, field: str, label_key: str = "label", minimum: int = 0, is_renumbered: bool = True
) -> tuple[list[InstanceRow], list[str]]:
    """Rows of a list of instances, and a note for each value that is wrong.

    Args:
        listed: rows as the file has them.
        file, field: names of the file and the list, for notes.
        label_key: key of the label in a row.
        minimum: smallest number of an instance.
        is_renumbered: True if a row without a number of its own gets another one; otherwise it is left out.
    """
    notes: list[str] = []
    entries: list[tuple[int, dict[str, Any]]] = []
    for index, entry in enumerate(listed):
        if isinstance(entry, dict):
            entries.append((index, entry))
        else:
            notes.append(f"{file}: {field}[{index}]: is not an object: left out")
    stated = [_number_of(entry, minimum) for _, entry in entries]
    rows: list[InstanceRow] = []
    for (index, entry), own, number in zip(entries, stated, distinct_numbers(stated, minimum), strict=True):
        if own != number:
            problem = "has no number" if own is None else f"{own} names two instances"
            notes.append(f"{file}: {field}[{index}]: {problem}: {f'this one is called {number}' if is_renumbered else 'left out'}")
            if not is_renumbered:
                continue
        label, is_label = label_text(entry.get(label_key))
        if not is_label:
            notes.append(f"{file}: {field}[{index}].{label_key}: is missing, or not a text: the instance is unlabeled")
        rows.append(InstanceRow(index, number, label, entry))
    return rows, notes


def _number_of(entry: dict[str, Any], minimum: int) -> int | None:
    numbers = (whole_number(entry.get(key), minimum) for key in ("objectId", "id"))
    return next((number for number in numbers if number is not None), None)


def labels_by_number(
    listed: list[Any], file: str, field: str, label_key: str = "label", minimum: int = 0
) -> tuple[dict[int, tuple[str, int]], list[str]]:
    """Labels and places in the list by the number by which a mesh names instances, and a note for each value that is wrong.

    Of two rows with one number, the first has it; a row without a number names nothing of the mesh.
    """
    rows, notes = instance_rows(listed, file, field, label_key, minimum, is_renumbered=False)
    return {row.number: (row.label, row.index) for row in rows}, notes
