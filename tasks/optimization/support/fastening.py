"""What is fastened to the room: what hangs, what is built in, worktops along walls, and what is built in below them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tasks.mounting import mounting

if TYPE_CHECKING:
    from tasks.optimization.support.supports import Carrier, PlacedAsset

WORKTOP_M, WORKTOP_LENGTH_M = 0.2, 0.9
"""A worktop is no thicker and no shorter [m]: a thicker one is a cabinet with its top, a shorter one a board."""

WORKTOPS = frozenset({"kitchen island", "kitchen counter", "counter", "kitchen worktop", "worktop", "countertop", "bar", "table"})
"""What worktops are called, by those who take them for what is like them."""

WORKTOP_LEVELS_M = (0.75, 1.15)
"""Between these heights people work standing [m]; at the lower ones they sit."""

BELOW_SHARE = 0.5
"""Of the plan of what is built in below a worktop, that the worktop covers."""

BELOW_M = 0.1
"""What is built in ends this near the worktop [m]: both heights are a scan's."""


def is_fixed(carrier: Carrier, category: str, against: str | None = None) -> bool:
    """Whether an object is fastened to the room: it hangs on a wall or ceiling, is built in, or is fitted and stands `against` a wall; or
    nothing seen carries it, and its name does not say that it stands: then what holds it was not seen."""
    kind = mounting(category)
    if carrier.relation == "none" and kind.kind == "any":
        return True
    return carrier.relation in ("wall", "ceiling") or kind.is_built_in or (kind.is_fitted and against is not None)


def is_worktop(obj: PlacedAsset, carrier: Carrier) -> bool:
    """Whether an object is a long slab at the height of kitchens that lies on something, by a name that worktops go by."""
    if carrier.relation != "on" or obj.height > WORKTOP_M or not WORKTOP_LEVELS_M[0] <= float(obj.high[2]) <= WORKTOP_LEVELS_M[1]:
        return False
    is_called_so = obj.category in WORKTOPS or (mounting(obj.category).is_fitted and mounting(obj.category).is_flat_topped)
    return is_called_so and float((obj.high - obj.low)[:2].max()) >= WORKTOP_LENGTH_M


def is_below(worktop: PlacedAsset, obj: PlacedAsset) -> bool:
    """Whether most of an object's plan is below a worktop, and its top near the worktop's underside."""
    shared = np.minimum(worktop.high[:2], obj.high[:2]) - np.maximum(worktop.low[:2], obj.low[:2])
    if (shared <= 0.0).any() or float(np.prod(shared)) < BELOW_SHARE * obj.plan_area:
        return False
    return bool(worktop.low[2] - BELOW_M <= obj.high[2] <= worktop.high[2] + BELOW_M and obj.low[2] < worktop.low[2] - BELOW_M)


def built_in(carriers: Mapping[str, Carrier], by_id: Mapping[str, PlacedAsset]) -> dict[str, Carrier]:
    """Carriers in which nothing fixed is carried by what is moved: all that stands below a fastened worktop is built in, whichever of it
    was found to carry the worktop; what is fastened over a table hangs on its wall."""
    made = dict(carriers)
    worktops = [by_id[name] for name, known in sorted(carriers.items()) if known.is_fixed and is_worktop(by_id[name], known)]
    for name, known in carriers.items():
        if known.relation == "floor" and mounting(by_id[name].category).is_boxy and any(is_below(top, by_id[name]) for top in worktops):
            made[name] = dataclasses.replace(known, is_fixed=True)
    for name, known in sorted(carriers.items()):
        below = made.get(known.parent_id or "")
        if not known.is_fixed or below is None or below.is_fixed or known.parent_id is None:
            continue
        carrying = mounting(by_id[known.parent_id].category)
        is_at_wall = below.against is not None or known.against is not None
        if below.relation == "floor" and carrying.is_boxy and is_at_wall:  # built in below a worktop, or below a sink
            made[known.parent_id] = dataclasses.replace(below, is_fixed=True)
        elif known.against is not None and known.relation == "on" and not mounting(by_id[name].category).is_built_in:
            made[name] = dataclasses.replace(known, relation="wall", parent_id=None, gap=0.0, lift=0.0)

    def lift(name: str) -> float:
        known = made[name]
        return known.lift if known.parent_id is None else lift(known.parent_id) - known.gap

    return {name: dataclasses.replace(made[name], lift=lift(name)) for name in sorted(made)}
