"""Things that stand about in training frames: the generator's small objects in many sizes and colors, and plain solids that nobody has."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from tasks.furniture import generate
from tasks.furniture.tops.sizes import SMALL

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

WORDS = tuple(sorted(SMALL))
"""What a thing can be called; its place here is its category."""

NAMELESS = -1
"""The category of what has no name."""

_LEFT_OUT = ("blanket", "computer tower", "tv")
"""Too large, or cloth that lies where it falls."""

_NAMED_SHARE = 0.68
"""The rest are solids: what stands in rooms is seldom in a list of sixty."""

_TIPPED_SHARE = 0.12


@dataclasses.dataclass(frozen=True)
class Thing:
    """A thing at the origin, the middle of its bottom. size: Extents [m]. category: Place in `WORDS`, or `NAMELESS`."""

    category: int
    parts: list[trimesh.Trimesh]
    size: tuple[float, float, float]


def drawn_thing(rng: np.random.Generator) -> Thing:
    """Something by chance: one of eight lies on its side or leans."""
    import trimesh

    category, parts = _named(rng) if rng.random() < _NAMED_SHARE else (NAMELESS, _solids(rng))
    if rng.random() < _TIPPED_SHARE:
        angle = float(rng.choice([0.5 * math.pi, 0.5 * math.pi, rng.uniform(0.1, 0.5)]))
        turn = trimesh.transformations.rotation_matrix(angle, [*rng.normal(size=2), 0.0])
        for part in parts:
            part.apply_transform(turn)
    bounds = np.array([part.bounds for part in parts])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    for part in parts:
        part.apply_translation([-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -low[2]])
    x, y, z = (float(value) for value in high - low)
    return Thing(category, parts, (x, y, z))


def _named(rng: np.random.Generator) -> tuple[int, list[trimesh.Trimesh]]:
    word = str(rng.choice([word for word in WORDS if word not in _LEFT_OUT]))
    x, y, z = np.array(SMALL[word].extents) * rng.uniform(0.8, 1.25) * rng.uniform(0.85, 1.15, 3)
    parts = list(generate(word, (float(x), float(y), float(z)), rng).parts)
    if rng.random() < 0.4:
        tint = rng.uniform(0.3, 1.6, 3)
        for visual in (cast("Any", part.visual) for part in parts):
            if visual.kind == "vertex":
                visual.vertex_colors = _opaque(visual.vertex_colors[:, :3] * tint)
    return WORDS.index(word), parts


def _solids(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A solid, or two that are one thing."""
    size = np.exp(rng.uniform(np.log(0.03), np.log(0.3), 3))
    parts = [_solid(size, rng)]
    if rng.random() < 0.5:
        other = _solid(size * rng.uniform(0.3, 0.9, 3), rng)
        on_top = rng.random() < 0.5
        offset = [0, 0, size[2] * rng.uniform(0.7, 1.0)] if on_top else [*(size[:2] * rng.uniform(-0.6, 0.6, 2)), 0]
        other.apply_translation(offset)
        parts.append(other)
    return parts


def _solid(size: Array, rng: np.random.Generator) -> trimesh.Trimesh:
    """A box, cylinder, ellipsoid, capsule, turned body, ring or irregular polyhedron of these extents [m], shape (3,), on the floor."""
    import trimesh

    kind = int(rng.integers(7))
    if kind == 0:
        solid = trimesh.creation.box((1.0, 1.0, 1.0))
    elif kind == 1:
        solid = trimesh.creation.cylinder(0.5, 1.0, sections=20)
    elif kind == 2:
        solid = trimesh.creation.icosphere(2, 0.5)
    elif kind == 3:
        solid = trimesh.creation.capsule(1.0, 0.3, count=[12, 8])
    elif kind == 4:
        height = np.linspace(0, 1, 8)
        radius = np.clip(0.25 + 0.25 * np.cos(height * rng.uniform(0, 5) + rng.uniform(0, 6)), 0.12, 0.5)
        solid = trimesh.creation.revolve(np.vstack([[0, 0], np.column_stack([radius, height]), [0, 1]]), sections=20)
    elif kind == 5:
        solid = trimesh.creation.annulus(0.35, 0.5, 1.0, sections=20)
    else:
        solid = trimesh.convex.convex_hull(rng.normal(size=(14, 3)))
    solid.apply_scale(size / solid.extents)
    solid.apply_translation([0, 0, -solid.bounds[0, 2]])
    solid.visual.vertex_colors = _opaque(np.tile(rng.integers(10, 250, 3), (len(solid.vertices), 1)))
    return solid


def _opaque(colors: NDArray[np.generic]) -> NDArray[np.uint8]:
    """RGB 0 to 255, shape (n, 3), as RGBA."""
    clipped = np.clip(np.asarray(colors, dtype=np.float64), 0, 255).astype(np.uint8)
    return np.column_stack([clipped, np.full(len(clipped), 255, dtype=np.uint8)])
