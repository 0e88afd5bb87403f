"""Assets for drawn boxes: those of the lake that are of the category and about as large, else models of the furniture generator."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.candidates import Asset
from schemas.lineage.licenses import is_of_scan, is_unknown
from tasks.candidates.assets import MadeAsset, make_asset
from tasks.furniture import generate
from tasks.furniture.palette import (
    CERAMICS,
    DARKS,
    FABRICS,
    LINENS,
    METALS,
    PLASTICS,
    WHITES,
    WOODS,
    Color,
    pick,
)
from tasks.micro_scenes.categories import Categories, read_categories
from tasks.synthesis.scenes.drawn import Drawn
from tasks.synthesis.scenes.words import word_for

PROVIDER, VERSION = "synthesis", "1"
"""Who made an asset for a drawn box. VERSION goes up when the same box would get another."""

MADE_LICENSE = "CC0-1.0"
"""Of what the furniture generator draws."""

MOST_SCALE = 1.5
"""Factor by which an asset may be made larger or smaller along an axis: more bends what is round and thickens what is thin."""

MOST_LARGE_SCALE = 1.25
"""The same for the large object: drawn heights hang on where its top is."""

AS_NEAR = 0.1
"""Assets that are as near to a box as the nearest, give or take this (sum over sides of the logarithm's difference), fit alike."""

_WOODEN = frozenset({
    "bed", "cabinet", "chair", "coffee_table", "counter", "desk", "dining_table", "end_table", "nightstand", "round_table", "shelf",
    "stool", "table", "tv_stand", "wardrobe",
})  # fmt: skip
_ELECTRIC = frozenset({
    "computer", "cooking_machine", "earphone", "electronic_devices", "kettle", "keyboard", "laptop", "monitor", "mouse", "phone", "printer",
    "remote_control", "tv",
})  # fmt: skip
_TABLEWARE = frozenset({"cup", "kitchenware", "mug"})
_WOVEN = frozenset({"backpack", "bag", "blanket", "clothing", "mouse_pad", "pillow", "sofa", "towel"})
_KEPT = frozenset({"basket", "box", "bucket", "lamp", "organizer", "tissue_paper", "washing_stuff"})
"""Categories by what they are made of, each in one color of a scene; what is in none has colors of its own."""


@dataclasses.dataclass(frozen=True)
class Style:
    """Colors that a scene's objects share, RGB 0..255."""

    wood: Color
    device: Color
    ceramic: Color
    fabric: Color
    accent: Color

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Style:
        """A style by chance."""
        device = (DARKS, WHITES, METALS)[int(rng.choice(3, p=(0.6, 0.25, 0.15)))]
        return cls(pick(WOODS, rng), pick(device, rng), pick(CERAMICS, rng), pick((*FABRICS, *LINENS), rng), pick(PLASTICS, rng))

    def color(self, category: str) -> Color | None:
        """The color of what is of a merged category; None for what has its own, as plants and books do."""
        for categories, color in (
            (_WOODEN, self.wood), (_ELECTRIC, self.device), (_TABLEWARE, self.ceramic), (_WOVEN, self.fabric), (_KEPT, self.accent),
        ):  # fmt: skip
            if category in categories:
                return color
        return None


class Pool:
    """Assets of a lake that may stand for what is drawn, by merged category.

    What was cut from a scan, what states no license, and what an earlier synthesis made is not among them.
    """

    def __init__(self, assets: Sequence[Asset] = (), table: Categories | None = None) -> None:
        table = table or read_categories()
        kept: dict[str, list[Asset]] = {}
        for asset in sorted(assets, key=lambda row: row.asset_id):
            if may_stand(asset):
                kept.setdefault(table.merged(asset.category), []).append(asset)
        self._kept = {category: tuple(rows) for category, rows in kept.items()}
        self._sizes = {category: np.log(np.maximum([row.extents for row in rows], 1e-4)) for category, rows in self._kept.items()}

    @property
    def asset_ids(self) -> tuple[str, ...]:
        """Ids of all of them, sorted."""
        return tuple(sorted(row.asset_id for rows in self._kept.values() for row in rows))

    def fitting(self, category: str, size: Sequence[float], most: float = MOST_SCALE) -> list[Asset]:
        """Assets of a category that are about as large as a box [m], shape (3,), none when none is; all of them fit alike."""
        if category not in self._kept:
            return []
        factors = np.log(size) - self._sizes[category]
        away = np.where((np.abs(factors) <= np.log(most)).all(axis=1), np.abs(factors).sum(axis=1), np.inf)
        return [self._kept[category][i] for i in np.flatnonzero(away <= away.min() + AS_NEAR).tolist()] if np.isfinite(away).any() else []


def may_stand(asset: Asset) -> bool:
    """Whether an asset may stand for what is drawn in another scene."""
    return not is_of_scan(asset.license) and not is_unknown(asset.license) and asset.provider != PROVIDER


def chosen_assets(drawn: Drawn, pool: Pool, with_large: bool) -> list[Asset | None]:
    """An asset of the pool for each box of a layout, None where it has none; for the large object, too, first, if `with_large`.

    Of assets that fit alike, one that a scene shows already is taken again, so that its cups are of one set.
    """
    layout, rng = drawn.layout, drawn.rng("pool")
    wanted = [(layout.large.category, layout.large.size, MOST_LARGE_SCALE)] if with_large else []
    wanted += [(name, tuple(size), MOST_SCALE) for name, size in zip(layout.categories, layout.sizes.tolist(), strict=True)]
    chosen: list[Asset | None] = []
    for category, size, most in wanted:
        fitting = pool.fitting(category, size, most)
        index = int(rng.integers(len(fitting))) if fitting else 0
        again = next((asset for asset in fitting if asset in chosen), None)
        chosen.append(again or (fitting[index] if fitting else None))
    return chosen


@dataclasses.dataclass(frozen=True)
class StandIn:
    """An asset that stands for a box. word: What it is. scale: Along its own axes, so that it fills the box, shape (3,). files: New."""

    asset: Asset
    word: str
    scale: tuple[float, ...]
    files: Mapping[str, bytes]


def stand_for(
    category: str, size: Sequence[float], chosen: Asset | None, style: Style, rng: np.random.Generator, word: str = ""
) -> StandIn:
    """The asset of a box [m], shape (3,): the chosen one, else one that is made for it, of the word if one is given."""
    if chosen is not None:
        x, y, z = (float(a) / float(b) for a, b in zip(size, chosen.extents, strict=True))
        return StandIn(chosen, chosen.category, (x, y, z), {})
    word = word or word_for(category, size, rng)
    made = _made(word, size, style.color(category), rng)
    return StandIn(made.asset, word, (1.0, 1.0, 1.0), made.files)


def _made(word: str, size: Sequence[float], color: Color | None, rng: np.random.Generator) -> MadeAsset:
    x, y, z = (float(value) for value in size)
    model = generate(word, (x, y, z), rng, color)
    return make_asset(
        model.parts, provider=PROVIDER, name=model.name, category=word, source="furniture generator", license=MADE_LICENSE,
        pieces=model.pieces,
    )  # fmt: skip
