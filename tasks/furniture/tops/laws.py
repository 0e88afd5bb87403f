"""What a rule about tops is made of, and the distributions that follow from it, without sampling."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Span = tuple[float, float]
Extents = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Zone:
    """A part of what carries: spans of the way that an object's middle is free to go, -1 to 1 from back to front and from left to right
    of who sits at the front; `levels` from the lowest, 0, to the highest, 1, of those that a shelf has."""

    x: Span = (-1.0, 1.0)
    y: Span = (-1.0, 1.0)
    levels: Span = (0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Beside:
    """Next to another object: the n-th of an item to the n-th of its anchor.

    side: Direction in the anchor's own frame, of (front, right): (1, 0) is in front of it, (-1, 1) behind it to the right. gap: Between the
    two [m]. shift: How far along the anchor's side it may be off [m]. otherwise: Where it goes when no anchor is there.
    """

    anchor: str
    side: tuple[float, float]
    gap: Span = (0.01, 0.05)
    shift: float = 0.03
    otherwise: Zone = Zone()


@dataclasses.dataclass(frozen=True)
class Seats:
    """At the edge where someone sits, turned to him: seats every 0.6 m round a table, each for one object."""


Place = Zone | Beside | Seats


@dataclasses.dataclass(frozen=True)
class TopItem:
    """Some objects of one word.

    counts: Probabilities that there are 0, 1, 2, ... of them. carriers: Words of objects that it may stand on, each of which carries one
    object at most; `carried`: probability that it does where one is free and large enough. size: Usual extents [m], where they are not
    those of `sizes.SMALL`.
    """

    word: str
    counts: tuple[float, ...]
    place: Place = Zone()
    carriers: tuple[str, ...] = ()
    carried: float = 0.0
    size: Extents | None = None

    def __post_init__(self) -> None:
        if abs(sum(self.counts) - 1.0) > 1e-9 or min(self.counts) < 0:
            raise ValueError(f"counts of {self.word!r} must be probabilities, are {self.counts}")

    @property
    def mean(self) -> float:
        """Expected number of its objects."""
        return sum(number * share for number, share in enumerate(self.counts))


@dataclasses.dataclass(frozen=True)
class Choice:
    """At most one of several sets of items. options: Probability of each set; nothing for what they leave over."""

    options: tuple[tuple[float, tuple[TopItem, ...]], ...]

    def __post_init__(self) -> None:
        total = sum(share for share, _ in self.options)
        if total > 1.0 + 1e-9 or min(share for share, _ in self.options) < 0:
            raise ValueError(f"options must be probabilities of at most 1 together, are {total}")

    def items(self) -> Iterator[TopItem]:
        """Items of all options."""
        for _, items in self.options:
            yield from items


@dataclasses.dataclass(frozen=True)
class Rule:
    """What may stand on a kind of large object in a kind of room: independent choices, drawn anew while nothing comes of them."""

    choices: tuple[Choice, ...]

    def items(self) -> tuple[TopItem, ...]:
        """Items of all choices, in the order of placing."""
        return tuple(item for choice in self.choices for item in choice.items())

    def means(self) -> dict[str, float]:
        """Expected number of objects by word before empty draws are discarded, which scales them all alike."""
        matches: dict[str, float] = {}
        for choice in self.choices:
            for share, items in choice.options:
                for item in items:
                    matches[item.word] = matches.get(item.word, 0.0) + share * item.mean
        return {word: mean for word, mean in sorted(matches.items()) if mean > 0}

    def count_law(self) -> Array:
        """Probabilities that there are 0, 1, 2, ... objects, none of 0, shape (most + 1,)."""
        law = np.ones(1)
        for choice in self.choices:
            law = np.convolve(law, _choice_law(choice))
        law[0] = 0.0
        return np.trim_zeros(law, "b") / law.sum()

    def draw(self, rng: np.random.Generator) -> list[TopItem]:
        """Items of a top, as often as they occur on it, in the order of placing; at least one."""
        drawn: list[TopItem] = []
        while not drawn:
            for choice in self.choices:
                at = rng.random()
                for share, items in choice.options:
                    at -= share
                    if at < 0:
                        for item in items:
                            drawn.extend([item] * _drawn_count(item, rng))
                        break
        return drawn


def _drawn_count(item: TopItem, rng: np.random.Generator) -> int:
    """How many of an item there are."""
    at, last = rng.random(), len(item.counts) - 1
    for number, share in enumerate(item.counts):
        at -= share
        if at < 0:
            return number
    return last


def _choice_law(choice: Choice) -> Array:
    """Probabilities of 0, 1, 2, ... objects out of a choice."""
    laws = [(1.0 - sum(share for share, _ in choice.options), np.ones(1))]
    for share, items in choice.options:
        law = np.ones(1)
        for item in items:
            law = np.convolve(law, np.array(item.counts))
        laws.append((share, law))
    total = np.zeros(max(len(law) for _, law in laws))
    for share, law in laws:
        total[: len(law)] += share * law
    return total


def rule_of(parts: Iterable[TopItem | Choice]) -> Rule:
    """A rule of independent items and choices."""
    return Rule(tuple(part if isinstance(part, Choice) else Choice(((1.0, (part,)),)) for part in parts))


def some(
    word: str,
    counts: float | tuple[float, ...],
    place: Place = Zone(),
    on: tuple[str, ...] = (),
    carried: float = 0.6,
    size: Extents | None = None,
) -> TopItem:
    """An item; `counts` may be the probability that there is one."""
    law = (1.0 - counts, counts) if isinstance(counts, float) else counts
    return TopItem(word, law, place, on, carried if on else 0.0, size)


def either(*options: tuple[float, TopItem | tuple[TopItem, ...]]) -> Choice:
    """At most one of several sets of items, each with its probability."""
    return Choice(tuple((share, (items,) if isinstance(items, TopItem) else items) for share, items in options))
