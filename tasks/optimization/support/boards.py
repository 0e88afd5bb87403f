"""Boards of furniture that a scan lost behind the things on them, in colliders only.

What stands within a piece of furniture, where nothing seen carries it, stands on a board of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull
from tasks.mounting import HOLDS_NOTHING, mounting
from tasks.optimization.colliders.cutting import prism
from tasks.optimization.support.supports import Carrier, PlacedAsset

Array = NDArray[np.float64]

BOARD_M = 0.02
"""Thickness of a board [m]."""

EDGE_M = 0.01
"""A board reaches so far out of what it carries [m]."""

WITHIN_SHARE = 0.6
"""Of the plan of an object that must lie over a piece of furniture which is to have a board for it."""

LARGER = 2.0
"""Furniture has so many times the box of what stands in it, at least."""


def board_bearers(placed: Sequence[PlacedAsset], carriers: Mapping[str, Carrier]) -> dict[str, str]:
    """Of each object that nothing carries but perhaps a wall, and whose name does not say that it hangs, the smallest piece of furniture
    within which it is: that has a board there which was not seen. By instance; of those without any, nothing."""
    by_id = {obj.instance_id: obj for obj in placed}
    bearers: dict[str, str] = {}
    for name, carrier in sorted(carriers.items()):
        obj = by_id[name]
        kind = mounting(obj.category).kind
        may_stand = carrier.relation == "none" or (carrier.relation == "wall" and kind in ("either", "any"))
        if not may_stand or kind in ("ceiling", "let_in", "covering"):
            continue
        around = [
            other
            for other in placed
            if name not in _below(other.instance_id, carriers, bearers)
            and carriers[other.instance_id].relation != "none"
            and other.category not in HOLDS_NOTHING
            and other.low[2] < obj.low[2] < other.high[2] - EDGE_M
            and _shared(obj, other) >= WITHIN_SHARE * obj.plan_area
            and np.prod(other.high - other.low) > LARGER * np.prod(obj.high - obj.low)
        ]
        if around:
            bearers[name] = min(around, key=lambda other: (float(np.prod(other.high - other.low)), other.instance_id)).instance_id
    return bearers


def _below(name: str, carriers: Mapping[str, Carrier], bearers: Mapping[str, str]) -> set[str]:
    """An object and all that carries it, by instance."""
    below = {name}
    while (above := bearers.get(name) or carriers[name].parent_id) is not None and above not in below:
        below.add(above)
        name = above
    return below


def _shared(obj: PlacedAsset, other: PlacedAsset) -> float:
    """Area that the boxes of two objects share in plan [m2]."""
    return float(np.prod(np.maximum(np.minimum(obj.high, other.high) - np.maximum(obj.low, other.low), 0.0)[:2]))


def board(obj: PlacedAsset, bearer: PlacedAsset) -> Hull | None:
    """A board within the box of a piece of furniture, right below an object, world frame [m]; None where it would have no size."""
    low, high = np.maximum(obj.low - EDGE_M, bearer.low), np.minimum(obj.high + EDGE_M, bearer.high)
    top = float(obj.low[2])
    return prism(np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]), top - BOARD_M, top)
