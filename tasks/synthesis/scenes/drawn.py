"""What was asked for and what a model drew: all that a synthesized scene follows from, but the assets that it may take."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Room, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement, Support
from schemas.selection import Selection
from tasks.synthesis.layout import Layout

LEAST_M, MOST_M = 0.004, 4.0
"""Extents of drawn boxes [m]: what is thinner no simulator holds apart, and what is longer stands on no furniture."""

FARTHEST_M = 10.0
"""From the large object [m]: what a model draws beyond is none of it."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A layout, and who drew it.

    word: The large object's own word. license: Of what the model learned from, and of the base where there is one. seconds: That drawing
    took.
    """

    scene_id: str
    layout: Layout
    word: str
    model_id: str
    model_kind: str
    seed: int
    number: int
    license: str | None
    seconds: float = 0.0

    def rng(self, *words: object) -> np.random.Generator:
        """A generator seeded by (seed, number, words): the same whatever the scene is called and who makes it."""
        text = "\x1f".join(["synthesis", str(self.seed), str(self.number), *map(str, words)])
        return np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))


@dataclasses.dataclass(frozen=True)
class BaseScene:
    """A scene of the lake, of which one large object is furnished anew. Rows are its own; belonging: small objects that make room."""

    scene: Scene
    shell: Shell
    rooms: tuple[Room, ...]
    surfaces: tuple[RoomSurface, ...]
    instances: tuple[Instance, ...]
    captions: tuple[Caption, ...]
    candidates: tuple[Candidate, ...]
    selections: tuple[Selection, ...]
    placements: tuple[Placement, ...]
    supports: tuple[Support, ...]
    assets: tuple[Asset, ...]
    instance_id: str
    belonging: frozenset[str]


def usable(layout: Layout) -> Layout:
    """A layout whose boxes can be made: extents within bounds, yaws within a turn.

    Raises:
        InputError: numbers are not finite, or a box is far from the large object.
    """
    numbers = np.column_stack([layout.centers, layout.sizes, layout.yaws]) if len(layout) else np.zeros((0, 7))
    if not np.isfinite(numbers).all() or (np.abs(numbers[:, :3]) > FARTHEST_M).any():
        raise InputError("layout", layout.large.category, "has boxes that are nowhere near it", "name another model")
    yaws = np.remainder(layout.yaws + np.pi, 2.0 * np.pi) - np.pi
    return dataclasses.replace(layout, sizes=np.clip(layout.sizes, LEAST_M, MOST_M), yaws=yaws)


def small_ids(count: int, taken: Sequence[str] = ()) -> list[str]:
    """Ids of drawn objects: after the large one, or after the highest of a base."""
    first = 1 + max((int(name) for name in taken), default=0)
    return [f"{first + i:04d}" for i in range(count)]
