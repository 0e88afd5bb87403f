"""Layouts as arrays that networks learn, and back. Vocabulary and bounds are learned from layouts and kept with a model's weights.

An object is a vector of `8 + k + 1` numbers: place of its box (3), its half extents (3), both scaled to -1..1 by what training layouts
have; cosine and sine of its yaw; its category among k as one-hot of -1 and +1, `empty` last. The place is the middle of the box, as
published (`middles`), or its bottom, above the large object's top (`bottoms`): what rests on a top, whatever the height of that, then has
one and the same number, which a small network tells to a millimeter. Slot 0 is the large object, the frame's own:
its middle and its turn say nothing, so that middle and sine are 0 and the cosine is 1, and its half extents are scaled by those of large
objects. Slots without an object have zeros before the one-hot.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.synthesis.layout import UNKNOWN_ROOM, Array, Large, Layout

Vectors = NDArray[np.float32]

BOX = 8
"""Numbers of a vector before its category: place, half extents, cosine and sine."""

Heights = Literal["middles", "bottoms"]

LEAST_SPAN = 1e-3
"""Of bounds [m]: where all layouts agree on a number, it is still scaled."""

VOCABULARY, BOUNDS = "encoding.vocabulary", "encoding.bounds"
"""Names of the arrays in a model's weights: JSON text as bytes; rows of bounds [m]: low, high of small ones, low, high of large ones."""


@dataclasses.dataclass(frozen=True)
class Encoding:
    """What turns layouts into arrays.

    classes: Categories that an object can have, in order; `empty` follows. small: Those of them that small objects have. large: Categories
    of large objects. rooms: Kinds of rooms, the unknown one first. low, high: Of places and half extents of small objects [m], shape (6,).
    large_low, large_high: Of half extents of large ones [m], shape (3,). heights: What a place says of heights.
    """

    classes: tuple[str, ...]
    small: tuple[str, ...]
    large: tuple[str, ...]
    rooms: tuple[str, ...]
    low: Array
    high: Array
    large_low: Array
    large_high: Array
    heights: Heights = "middles"

    @property
    def width(self) -> int:
        """Numbers of a vector."""
        return BOX + len(self.classes) + 1

    @property
    def empty(self) -> int:
        """Place of `empty` among the categories."""
        return len(self.classes)

    @property
    def is_small(self) -> NDArray[np.bool_]:
        """Whether a small object can have a category, shape (k + 1,); `empty` is one that it can have."""
        return np.array([name in self.small for name in self.classes] + [True])

    def condition(self, large: Large) -> tuple[int, int]:
        """Places of a large object's category and room in the vocabulary; a room that is not in it counts as unknown.

        Raises:
            InputError: no training layout had a large object of that category.
        """
        if large.category not in self.large:
            raise InputError(
                "synthesis", "large", f"{large.category!r} is no large object that the model knows", f"it knows {', '.join(self.large)}"
            )
        room = large.room_type if large.room_type in self.rooms else UNKNOWN_ROOM
        return self.large.index(large.category), self.rooms.index(room)

    def large_vector(self, large: Large) -> Vectors:
        """The vector of slot 0, shape (d,); what is larger or smaller than all of training counts as the largest or smallest of it."""
        vector = np.zeros(self.width, dtype=np.float32)
        vector[3:6] = np.clip(_scaled(0.5 * np.asarray(large.size), self.large_low, self.large_high), -1.0, 1.0)
        vector[6] = 1.0
        vector[BOX:] = self._one_hot(np.array([self.classes.index(large.category)]))[0]
        return vector

    def vectors(self, layout: Layout, slots: int) -> Vectors:
        """A layout as vectors, shape (slots, d): the large object, then the small ones in their order, as many as there is room for.

        Raises:
            InputError: a category is not in the vocabulary.
        """
        unknown = sorted({*layout.categories} - {*self.classes})
        if unknown:
            raise InputError("synthesis", "category", f"the model knows no {', '.join(unknown)}", "train it on layouts that have them")
        self.condition(layout.large)
        count = min(len(layout), slots - 1)
        made = np.zeros((slots, self.width), dtype=np.float32)
        index = np.full(slots, self.empty)
        index[1 : 1 + count] = [self.classes.index(name) for name in layout.categories[:count]]
        made[:, BOX:] = self._one_hot(index)
        made[1 : 1 + count, :6] = self.scaled(layout.centers[:count], 0.5 * layout.sizes[:count], layout.large.size[2])
        made[1 : 1 + count, 6] = np.cos(layout.yaws[:count])
        made[1 : 1 + count, 7] = np.sin(layout.yaws[:count])
        made[0] = self.large_vector(layout.large)
        return made

    def layout(self, vectors: NDArray[np.floating], large: Large) -> Layout:
        """The layout that vectors (slots, d) show: of every slot but the first the likeliest category that a small object can have.

        Boxes stay within the bounds.
        """
        rest = np.asarray(vectors, dtype=np.float64)[1:]
        index = self.categories(rest)
        kept = index != self.empty
        middles, halves = self.boxes(np.clip(rest[kept, :6], -1.0, 1.0), large.size[2])
        yaws = np.arctan2(rest[kept, 7], rest[kept, 6])
        return Layout(large, tuple(self.classes[i] for i in index[kept]), middles, 2.0 * halves, yaws)

    def categories(self, vectors: NDArray[np.floating]) -> NDArray[np.int64]:
        """Places of the likeliest category that a small object can have, `empty` among them, of vectors (..., d), shape (...)."""
        return np.asarray(np.where(self.is_small, vectors[..., BOX:], -np.inf).argmax(axis=-1))

    def scaled(self, middles: Array, halves: Array, tops: Array | float) -> Array:
        """Places and half extents of small objects as -1..1, shape (n, 6).

        middles, halves: Of their boxes [m], shapes (n, 3). tops: Heights of the large objects [m], shape (n,) or one.
        """
        return _scaled(np.concatenate([_places(middles, halves, tops, self.heights), halves], axis=1), self.low, self.high)

    def boxes(self, numbers: Array, tops: Array | float) -> tuple[Array, Array]:
        """Middles and half extents [m], shapes (n, 3), of numbers that `scaled` gives. tops: Heights of the large objects [m]."""
        metric = 0.5 * (numbers + 1.0) * (self.high - self.low) + self.low
        middles, halves = metric[:, :3].copy(), metric[:, 3:]
        if self.heights == "bottoms":
            middles[:, 2] += halves[:, 2] + tops
        return middles, halves

    def _one_hot(self, index: NDArray[np.int64]) -> NDArray[np.float64]:
        return 2.0 * np.eye(len(self.classes) + 1)[index] - 1.0

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As arrays of a model's weights."""
        words: dict[str, Any] = {"classes": self.classes, "small": self.small, "large": self.large, "rooms": self.rooms}
        if self.heights != "middles":
            words["heights"] = self.heights
        text = json.dumps(words, separators=(",", ":")).encode()
        bounds = np.zeros((4, 6))
        bounds[0], bounds[1], bounds[2, :3], bounds[3, :3] = self.low, self.high, self.large_low, self.large_high
        return {VOCABULARY: np.frombuffer(text, dtype=np.uint8), BOUNDS: bounds}


def _scaled(values: Array, low: Array, high: Array) -> Array:
    """Numbers between bounds as -1..1."""
    return np.asarray(2.0 * (values - low) / (high - low) - 1.0)


def _places(middles: Array, halves: Array, tops: Array | float, heights: Heights) -> Array:
    places = middles.copy()
    if heights == "bottoms":
        places[:, 2] -= halves[:, 2] + tops
    return places


def encoding_of(layouts: Sequence[Layout], names: Iterable[str] = (), heights: Heights = "middles") -> Encoding:
    """The encoding of training layouts. names: Further categories that the vocabulary has, beside those of the layouts.

    Raises:
        InputError: there is no small object among them.
    """
    small = sorted({name for layout in layouts for name in layout.categories})
    if not small:
        raise InputError("synthesis", "micro_scenes", "hold no small object", "take scenes whose tables carry something")
    large = sorted({layout.large.category for layout in layouts})
    rooms = [UNKNOWN_ROOM, *sorted({layout.large.room_type for layout in layouts} - {UNKNOWN_ROOM})]
    filled = [layout for layout in layouts if len(layout)]
    halves = [0.5 * layout.sizes for layout in filled]
    places = [_places(layout.centers, half, layout.large.size[2], heights) for layout, half in zip(filled, halves, strict=True)]
    box = np.concatenate([np.concatenate(places), np.concatenate(halves)], axis=1)
    given = 0.5 * np.array([layout.large.size for layout in layouts])
    low, high = _bounds(box)
    large_low, large_high = _bounds(given)
    classes = tuple(sorted({*small, *large, *names}))
    return Encoding(classes, tuple(small), tuple(large), tuple(rooms), low, high, large_low, large_high, heights)


def _bounds(values: Array) -> tuple[Array, Array]:
    low, high = values.min(axis=0), values.max(axis=0)
    return low, np.maximum(high, low + LEAST_SPAN)


def encoding_in(arrays: Mapping[str, NDArray[Any]], file: str = "weights") -> Encoding:
    """The encoding among the arrays of a model's weights.

    Raises:
        InputError: it is missing or no such thing.
    """
    remedy = "take weights that `metascenes train` wrote, whole"
    for name in (VOCABULARY, BOUNDS):
        if name not in arrays:
            raise InputError(file, name, "is missing", remedy)
    bounds = np.asarray(arrays[BOUNDS], dtype=np.float64)
    try:
        words = json_value(np.asarray(arrays[VOCABULARY]).tobytes().decode())
        lists = [tuple(words[name]) for name in ("classes", "small", "large", "rooms")]
        heights = words.get("heights", "middles")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(file, VOCABULARY, "is no vocabulary", remedy) from error
    classes, small, large, rooms = lists
    are_words = all(isinstance(word, str) for part in lists for word in part) and all(len({*part}) == len(part) for part in lists)
    if (
        not are_words
        or not classes
        or not {*small, *large} <= {*classes}
        or not small
        or not large
        or rooms[:1] != (UNKNOWN_ROOM,)
        or heights not in get_args(Heights)
    ):
        raise InputError(file, VOCABULARY, "is no vocabulary", remedy)
    if bounds.shape != (4, 6) or not np.isfinite(bounds).all() or (bounds[1] <= bounds[0]).any() or (bounds[3, :3] <= bounds[2, :3]).any():
        raise InputError(file, BOUNDS, "are no bounds", remedy)
    return Encoding(classes, small, large, rooms, bounds[0], bounds[1], bounds[2, :3], bounds[3, :3], heights)
