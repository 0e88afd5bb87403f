"""Tops as arrays: what stands on a large object of a kind in a kind of room."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.tops.laws import Extents, Rule
from tasks.furniture.tops.living import BEDROOM, LIVING_ROOM, OFFICE
from tasks.furniture.tops.placing import bodies_of, place
from tasks.furniture.tops.service import BATHROOM, DINING_ROOM, KITCHEN
from tasks.furniture.tops.sizes import surface
from tasks.micro_scenes.categories import Categories, read_categories

Array = NDArray[np.float64]

RULES: dict[tuple[str, str], Rule] = {
    (word, room_type): rule
    for room_type, rules in (
        ("bathroom", BATHROOM),
        ("bedroom", BEDROOM),
        ("dining room", DINING_ROOM),
        ("kitchen", KITCHEN),
        ("living room", LIVING_ROOM),
        ("office", OFFICE),
    )
    for word, rule in rules.items()
}
"""The rule of each pair of a large object's word and a room type."""

PAIRS: tuple[tuple[str, str], ...] = tuple(sorted(RULES))
"""Pairs of a large object's word and a room type that have a rule."""

LEAST_M = 0.2
"""Smallest extent of a large object on which tops are drawn."""


@dataclasses.dataclass(frozen=True)
class Top:
    """What stands on a large object, n objects, in its frame: right-handed, +Z up, origin at the middle of the bottom of its box, +X its
    front.

    words: Of the objects. parents: Index of what carries each, -1 for the large object, shape (n,); it comes before what it carries.
    relations: How it carries it, `on` or `inside`. centers: Middles of the boxes [m], shape (n, 3). sizes: Their extents along axes turned
    by the yaws [m], shape (n, 3). yaws: Turns about +Z from the large object's front, -pi to pi [rad], shape (n,).
    """

    words: tuple[str, ...]
    parents: NDArray[np.int64]
    relations: tuple[str, ...]
    centers: Array
    sizes: Array
    yaws: Array

    def __post_init__(self) -> None:
        for value in (self.parents, self.centers, self.sizes, self.yaws):
            value.setflags(write=False)

    def __len__(self) -> int:
        return len(self.words)


def rule(word: str, room_type: str) -> Rule:
    """The rule of a pair.

    Raises:
        ValueError: nothing is declared for it.
    """
    if (word, room_type) not in RULES:
        raise ValueError(f"nothing is declared to stand on a {word!r} in a {room_type!r}; see PAIRS")
    return RULES[word, room_type]


def stated_distribution(word: str, room_type: str, categories: Categories | None = None) -> dict[str, float]:
    """Share of each merged category among all small objects on tops of a pair: what follows from its rule, not a sample.

    Raises:
        ValueError: nothing is declared for the pair.
    """
    table = categories or read_categories()
    means = rule(word, room_type).means()
    total = sum(means.values())
    shares: dict[str, float] = {}
    for small, mean in means.items():
        name = table.merged(small)
        shares[name] = shares.get(name, 0.0) + mean / total
    return dict(sorted(shares.items()))


def stated_count(word: str, room_type: str) -> Array:
    """Probabilities that 0, 1, 2, ... objects stand on a top of a pair, shape (most + 1,); of 0 it is 0.

    Raises:
        ValueError: nothing is declared for the pair.
    """
    return rule(word, room_type).count_law()


def draw(word: str, size: Extents, room_type: str, rng: np.random.Generator) -> Top:
    """What stands on a large object of a word with extents `size` [m], shape (3,): depth, width, height.

    Which objects these are follows the rule of the pair, whatever the size; on tops that are too small for them they are drawn smaller.

    Raises:
        ValueError: nothing is declared for the pair, or an extent is not finite or below 0.2 m.
    """
    x, y, z = (float(value) for value in size)
    if not (math.isfinite(x + y + z) and min(x, y, z) >= LEAST_M):
        raise ValueError(f"extents of a {word!r} must be at least {LEAST_M} m, are {(x, y, z)}")
    items = rule(word, room_type).draw(rng)
    top = surface(word, (x, y, z))
    bodies = bodies_of(items, top, rng)
    place(bodies, top, rng)
    rows = []
    for body in bodies:
        if body.carrier < 0:
            rows.append((body.x, body.y, body.bottom, body.yaw))
        else:
            across, along, bottom, yaw = rows[body.carrier]
            c, s = math.cos(yaw), math.sin(yaw)
            rows.append((across + c * body.x - s * body.y, along + s * body.x + c * body.y, bottom + body.bottom, yaw + body.yaw))
    poses, sizes = np.array(rows), np.array([body.size for body in bodies])
    centers = poses[:, :3].copy()
    centers[:, 2] += 0.5 * sizes[:, 2]
    inner = "inside" if word == "bookshelf" else "on"
    return Top(
        tuple(body.item.word for body in bodies),
        np.array([body.carrier for body in bodies], dtype=np.int64),
        tuple(inner if body.carrier < 0 else "on" for body in bodies),
        centers,
        sizes,
        np.remainder(poses[:, 3] + np.pi, 2 * np.pi) - np.pi,
    )
