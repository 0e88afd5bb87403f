"""What a template is: parameters with bounds and starts, and the blocks that they make.

Canonical frame: +Z up, front +X, x and y zero in the middle of the box, z zero at its bottom.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence

Extents = tuple[float, float, float]
Values = dict[str, float]

THIN_M = 0.004
"""Thinner blocks are left out."""


@dataclasses.dataclass(frozen=True)
class Block:
    """An upright box of a part of a model [m]. is_soft: its edges are rounded when it is made."""

    part: str
    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]
    is_soft: bool = False

    @property
    def spans(self) -> tuple[float, ...]:
        """x0, x1, y0, y1, z0, z1."""
        return (*self.x, *self.y, *self.z)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A length of a template [m]: its bounds, and what the search starts from, ascending."""

    name: str
    low: float
    high: float
    starts: tuple[float, ...]

    @staticmethod
    def of(name: str, low: float, high: float, *starts: float) -> Parameter:
        """A parameter whose starts are brought within its bounds; a range without width is its lower bound."""
        high = max(low, high)
        return Parameter(name, low, high, tuple(sorted({min(max(s, low), high) for s in starts})))


@dataclasses.dataclass(frozen=True)
class FurnitureTemplate:
    """A form of furniture in a box of certain extents. blocks: what values of the parameters make. turns: quarter turns of its front that
    differ."""

    name: str
    extents: Extents
    parameters: tuple[Parameter, ...]
    draw: Callable[[Values, Extents], Iterable[Block]]
    turns: Sequence[int] = (0, 1, 2, 3)

    def blocks(self, values: Sequence[float]) -> list[Block]:
        """The blocks that values make, in the order of the parameters, without those that are too thin."""
        named = {parameter.name: value for parameter, value in zip(self.parameters, values, strict=True)}
        drawn = self.draw(named, self.extents)
        return [b for b in drawn if min(b.x[1] - b.x[0], b.y[1] - b.y[0], b.z[1] - b.z[0]) > THIN_M]
