"""Models like those that rooms hold, out of which lineups are made: a catalog in which the scanned model is nothing special.

Distractors that are drawn round the scanned model give it away to whoever sees the ten alone: sides that are equal stop being so, colors
leave their palette, and most of the ten have something in common. So lineups take models of other rooms, of the same generator, sizes and
palettes, and of these a cell in which the scanned one may be anywhere: `cell` uses the scanned one to choose which half to keep, and for
nothing else.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.selection.rooms import made_room
from schemas.files import write_whole
from tasks.furniture import generate
from tasks.geometry.meshes import surface_of
from tasks.geometry.triangles import face_crosses

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Color = tuple[int, int, int]
Extents = tuple[float, float, float]

ROOMS = 800
"""Whose models are in the catalog; none of them is scanned."""

FIRST = 1_000_000
"""Number of the first of them."""

SIZE, COLOR = 0.06, 12.0
"""How far apart, in the logarithm of a side and in a channel of 255, counts as much."""


@dataclasses.dataclass(frozen=True)
class CatalogModel:
    """A model that can be drawn. extents: Sides of its box in its own frame [m], shape (3,). color: RGB 0..255 of most of its surface.
    seed: Of the generator that draws it."""

    category: str
    extents: Extents
    color: Color
    seed: int

    def parts(self) -> list[trimesh.Trimesh]:
        """What is seen of it, in its own frame [m]."""
        return generate(self.category, self.extents, np.random.default_rng(self.seed)).parts


Catalog = Mapping[str, Sequence[CatalogModel]]
"""Models by category."""


def models_of_room(seed: int, index: int) -> list[CatalogModel]:
    """Models as a room has them, drawn anew: one of each category and size, as sets of chairs are of one model."""
    kept: dict[tuple[str, Extents], CatalogModel] = {}
    for number, obj in enumerate(made_room(FIRST + index, seed).furnished.objects):
        own = int(np.random.default_rng([seed, 5, index, number]).integers(2**62))
        parts = generate(obj.category, obj.extents, np.random.default_rng(own)).parts
        kept.setdefault((obj.category, obj.extents), CatalogModel(obj.category, obj.extents, main_color(parts), own))
    return list(kept.values())


def made_catalog(path: Path, seed: int, spread: Callable[[Callable[[int], Any], Sequence[int]], Iterator[Any]] = map) -> None:
    """Write the catalog of a seed where there is none. spread: a map whose results come in the order of the items."""
    if not path.exists():
        rows = [dataclasses.astuple(model) for models in spread(partial(models_of_room, seed), range(ROOMS)) for model in models]
        write_whole(path, json.dumps(rows).encode())


@cache
def read_catalog(path: Path) -> Catalog:
    """The catalog in a file."""
    models: dict[str, list[CatalogModel]] = {}
    for category, extents, color, seed in json.loads(path.read_bytes()):
        models.setdefault(category, []).append(CatalogModel(category, tuple(extents), tuple(color), seed))
    return models


def features(extents: Sequence[Extents], colors: Sequence[Color]) -> Array:
    """What models are near by, shape (n, 6): logarithms of their sides [m] in steps of `SIZE`, and channels of 255 in steps of `COLOR`."""
    return np.column_stack([np.log(np.array(extents, dtype=np.float64)) / SIZE, np.array(colors, dtype=np.float64) / COLOR])


def cell(values: Array, at: int, count: int, rng: np.random.Generator) -> list[int]:
    """Rows near row `at`, `count` of them with it where there are so many, in no order. values: Features of models, shape (n, d).

    All rows are halved at the middle of what varies most while `count` remain, and of what remains any are taken. With the same `rng` each
    of these has the same cell, so none of it is likelier to be `at`.
    """
    rows = rng.permutation(len(values))
    while len(rows) // 2 >= count:
        rows = rows[np.argsort(values[rows, int(values[rows].std(axis=0).argmax())], kind="stable")]
        first, second = np.split(rows, [len(rows) // 2])
        rows = first if at in first else second
    near = rng.permutation(rows[rows != at])[: count - 1]
    return [int(row) for row in rng.permutation(np.append(near, at))]


def main_color(parts: Sequence[trimesh.Trimesh]) -> Color:
    """The color of most of a model's surface, RGB 0..255."""
    surface = surface_of(parts)
    area = 0.5 * np.linalg.norm(face_crosses(surface.vertices, surface.faces), axis=1)
    colors, which = np.unique(surface.colors[surface.faces[:, 0]] // 12, axis=0, return_inverse=True)
    best = int(np.bincount(which.reshape(-1), area, minlength=len(colors)).argmax())
    r, g, b = np.round(np.average(surface.colors[surface.faces[which.reshape(-1) == best, 0]], axis=0)).astype(int).tolist()
    return r, g, b
