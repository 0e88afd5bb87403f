"""Times, numbers and order in the names of files, and which names belong together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal

import numpy as np

STAMP_SECONDS = 0.02
"""Largest gap [s] between color, depth and pose of one frame: less than a period of 30 Hz, as in TUM's own tools."""

_NUMBER = re.compile(r"\d+\.\d+|\d+", re.ASCII)
_TIME = re.compile(r"(?:.*[^\d.])?(\d{1,18}\.\d{1,18})", re.ASCII | re.DOTALL)
_SPLIT = re.compile(r"(?:.*\D)?([1-9]\d{8,9})[_-](\d{1,9})", re.ASCII | re.DOTALL)

_UNITS = {10: 1.0, 13: 1e3, 16: 1e6, 19: 1e9}
"""Units per second of times since 1970, by their digits: seconds to nanoseconds from the year 2001 on."""


def natural_order(name: str) -> tuple[tuple[Decimal, ...], str]:
    """Sort key of a file's name: its numbers from left to right, decimals as one number, then the name itself."""
    return tuple(Decimal(number) for number in _NUMBER.findall(name)), name


def time_of(name: str) -> float | None:
    """Time [s] that a name ends with: `rgb_1305031102.175304`, seconds and nanoseconds, or nanoseconds since 1970.

    None if the name ends with a shorter whole number, one with leading zeros (a frame's number), or none.
    """
    if match := _TIME.fullmatch(name):
        return float(match[1])
    if match := _SPLIT.fullmatch(name):
        # Robots write the nanoseconds of a time as a number of their own, with or without leading zeros.
        return int(match[1]) + int(match[2]) * (1e-6 if len(match[2]) == 6 else 1e-9)
    digits = last_digits(name)
    is_time = len(digits) in _UNITS and not digits.startswith("0")
    return int(digits) / _UNITS[len(digits)] if is_time else None


def in_seconds(times: Sequence[float]) -> list[float]:
    """Times [s] of a table whose times since 1970 may be in milli-, micro- or nanoseconds, by the digits of their median."""
    finite = [time for time in times if np.isfinite(time)]
    digits = len(str(int(abs(np.median(finite))))) if finite else 0
    return [time / _UNITS.get(digits, 1.0) for time in times]


def last_digits(name: str) -> str:
    """Digits of the whole number that a name ends with, empty without one or with a time."""
    match = None if _TIME.fullmatch(name) or _SPLIT.fullmatch(name) else re.search(r"\d+\Z", name, re.ASCII)
    return match[0] if match else ""


def number_of(name: str) -> int | None:
    """Whole number of at most nine digits, leading zeros not counted, that a name ends with, otherwise None."""
    digits = last_digits(name)
    return int(digits) if digits and len(digits.lstrip("0")) <= 9 else None


def associated(first: Sequence[float], second: Sequence[float], seconds: float = STAMP_SECONDS) -> list[tuple[int, int]]:
    """Indices of times [s] that belong together, sorted: nearest pairs first, each time once, no gap above `seconds`."""
    times = np.array(second, dtype=np.float64)
    order = np.argsort(times, kind="stable")
    candidates = []
    for i, time in enumerate(first):
        at = int(np.searchsorted(times[order], time))
        for near in range(max(0, at - 2), min(len(order), at + 2)):
            gap = abs(float(times[order[near]]) - time)
            if gap <= seconds:
                candidates.append((gap, i, int(order[near])))
    pairs: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in sorted(candidates):
        if i not in pairs and j not in taken:
            pairs[i] = j
            taken.add(j)
    return sorted(pairs.items())


def partners(names: Sequence[str], other_names: Sequence[str]) -> dict[str, str]:
    """The other name of each name that has one: the same, the nearest in time, or the one with the same number."""
    same = {name: name for name in set(names) & set(other_names)}
    if len(same) in (len(names), len(other_names)):
        return same
    times, other_times = [time_of(name) for name in names], [time_of(name) for name in other_names]
    if None not in times and None not in other_times:
        pairs = associated([t for t in times if t is not None], [t for t in other_times if t is not None])
        return {names[i]: other_names[j] for i, j in pairs}
    if same:
        return same
    own, their = _by_number(names), _by_number(other_names)
    return {own[number]: their[number] for number in own.keys() & their.keys()}


def _by_number(names: Sequence[str]) -> Mapping[int, str]:
    """Names by the number that they end with; empty if two have the same or one has none."""
    numbers = [number_of(name) for name in names]
    unique = {number: name for number, name in zip(numbers, names, strict=True) if number is not None}
    return unique if len(unique) == len(names) else {}
