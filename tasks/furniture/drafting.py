"""The drawing board of the furniture families: a draft collects solids, the registry knows who draws what."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.halves import Half, variants_in
from tasks.furniture.palette import Color, pick, shade
from tasks.furniture.solids import Solid, Span, box, cushion, cylinder, wedge
from tasks.geometry.pieces import Hull

if TYPE_CHECKING:
    import trimesh

Extents = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class FurnitureModel:
    """A generated object in the canonical frame: +Z up, front +X, origin at the bottom center of its box [m].

    parts: What is seen, closed volumes with vertex colors. hulls: Convex pieces that together cover the parts.
    """

    name: str
    category: str
    parts: list[trimesh.Trimesh]
    hulls: list[Hull]

    @cached_property
    def pieces(self) -> list[trimesh.Trimesh]:
        """The pieces as closed meshes."""
        import trimesh

        return [trimesh.Trimesh(hull.vertices, hull.faces, process=False) for hull in self.hulls]


class Draft:
    """One model while it is drawn, in x from -X/2 to X/2 (front +x), y from -Y/2 to Y/2, z from 0 to Z [m].

    The drawn object should nearly fill these extents; `model` fits it exactly.
    """

    def __init__(
        self, category: str, extents: Extents, rng: np.random.Generator, color: Color | None, half: Half = "all",
        has_plain_front: bool = False,
    ) -> None:  # fmt: skip
        self.category = category
        self.X, self.Y, self.Z = extents
        self.hx, self.hy = 0.5 * self.X, 0.5 * self.Y
        self.rng = rng
        self.variant = ""
        self.half: Half = half
        self.has_plain_front = has_plain_front
        self.has_variants = False
        self._color = color
        self._solids: list[tuple[str, Color, Solid]] = []

    def main(self, colors: tuple[Color, ...]) -> Color:
        """The color of the whole object: the one asked for, else one of these."""
        chosen = pick(colors, self.rng)
        return self._color or chosen

    def pick(self, colors: tuple[Color, ...]) -> Color:
        """A color of a lesser part."""
        return pick(colors, self.rng)

    def one_of(self, *variants: str) -> str:
        """A variant of the draft's half by chance; it becomes part of the model's name."""
        self.has_variants |= len(variants) > 1
        allowed = variants_in(self.half, variants)
        chosen = allowed[int(self.rng.integers(len(allowed)))]
        self.variant = chosen if not self.variant else f"{self.variant} {chosen}"
        return chosen

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return bool(self.rng.random() < probability)

    def between(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.rng.uniform(low, high))

    def add(self, part: str, color: Color, solid: Solid) -> None:
        """Put a solid under a part; its color varies by a hair, as pieces of one object do."""
        self._solids.append((part, shade(color, 1 + 0.03 * float(self.rng.uniform(-1, 1))), solid))

    def box(self, part: str, color: Color, x: Span, y: Span, z: Span) -> None:
        """A box from spans [m]."""
        self.add(part, color, box(x, y, z))

    def cushion(self, part: str, color: Color, x: Span, y: Span, z: Span, radius: float) -> None:
        """A box with rounded edges [m]."""
        self.add(part, color, cushion(x, y, z, radius))

    def leg(
        self, part: str, color: Color, foot: tuple[float, float], top: tuple[float, float], z: Span, side: float, tip: float = 1.0
    ) -> None:
        """A square leg from a foot to a top in plan [m], `side` wide at the top and `tip` times that at the foot."""
        a, b = 0.5 * side * tip, 0.5 * side
        bottom = ((foot[0] - a, foot[0] + a), (foot[1] - a, foot[1] + a))
        above = ((top[0] - b, top[0] + b), (top[1] - b, top[1] + b))
        self.add(part, color, wedge(bottom, above, z))

    def round_leg(self, part: str, color: Color, x: float, y: float, z: Span, radius: float) -> None:
        """A round upright leg about (x, y) [m]."""
        self.add(part, color, cylinder(radius, z, 10).at(x, y, 0.0))

    def corners(self, inset: float) -> list[tuple[float, float]]:
        """The four corners in plan, moved in by `inset` [m]: front left, back left, back right, front right."""
        x, y = self.hx - min(inset, 0.45 * self.X), self.hy - min(inset, 0.45 * self.Y)
        return [(x, y), (-x, y), (-x, -y), (x, -y)]

    def model(self, extents: Extents) -> FurnitureModel:
        """The drawn object, fitted exactly into extents [m]."""
        import trimesh

        everything = np.concatenate([solid.vertices for _, _, solid in self._solids])
        low, high = everything.min(axis=0), everything.max(axis=0)
        scale = np.array(extents) / np.maximum(high - low, 1e-9)
        center = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])

        parts, order = [], list(dict.fromkeys(part for part, _, _ in self._solids))
        for name in order:
            solids = [(color, solid) for part, color, solid in self._solids if part == name]
            offsets = np.cumsum([0] + [len(solid.vertices) for _, solid in solids])
            vertices = np.concatenate([solid.vertices for _, solid in solids])
            faces = np.concatenate([solid.faces + offset for (_, solid), offset in zip(solids, offsets, strict=False)])
            colors: NDArray[np.uint8] = np.concatenate(
                [np.tile(np.array([*c, 255], dtype=np.uint8), (len(s.vertices), 1)) for c, s in solids]
            )
            part = trimesh.Trimesh((vertices - center) * scale, faces, process=False)
            part.visual = trimesh.visual.ColorVisuals(part, vertex_colors=colors)
            part.metadata["name"] = name
            parts.append(part)
        hulls = [Hull((piece.vertices - center) * scale, piece.faces) for _, _, solid in self._solids for piece in solid.pieces]
        name = f"{self.variant} {self.category}" if self.variant else self.category
        return FurnitureModel(name, self.category, parts, hulls)


@dataclasses.dataclass(frozen=True)
class FurnitureCategory:
    """A category: its usual extents [m], shape (3,), depth x width x height, and who draws it.

    free: Whether it is drawn at any proportions (it may stand, lie or hang); others are drawn at proportions that occur
    and stretched from there.
    """

    name: str
    extents: Extents
    draw: Callable[[Draft], None]
    free: bool

    def drawn_extents(self, extents: Extents) -> Extents:
        """The extents to draw at for a model of these extents [m]."""
        if self.free:
            return extents
        x, y, z = np.clip(extents, np.array(self.extents) * PROPORTIONS[0], np.array(self.extents) * PROPORTIONS[1])
        return float(x), float(y), float(z)


PROPORTIONS: tuple[float, float] = (0.4, 3.0)
"""Share of the usual extents within which parameters are adjusted: boards keep their thickness, legs stay legs."""

REGISTRY: dict[str, FurnitureCategory] = {}
ALIASES: dict[str, str] = {}


def category(
    name: str, extents: Extents, *aliases: str, free: bool = False
) -> Callable[[Callable[[Draft], None]], Callable[[Draft], None]]:
    """Registers a drawing under a category with its usual extents (depth, width, height) [m], and under other words for it.

    `free`: see `FurnitureCategory`.
    """

    def register(draw: Callable[[Draft], None]) -> Callable[[Draft], None]:
        for word in (name, *aliases):
            if word in REGISTRY or word in ALIASES:
                raise ValueError(f"category {word!r} is drawn twice")
        REGISTRY[name] = FurnitureCategory(name, extents, draw, free)
        ALIASES.update(dict.fromkeys(aliases, name))
        return draw

    return register
