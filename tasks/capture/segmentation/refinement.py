"""Regions of a room's surface, and what frames see apart of them.

The surface knows all of a wardrobe or a kitchen, of which each frame shows a part; it has lost where a plate ends that lies on a table.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.settings import Config, Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class RefinementConfig(Config):
    """What of frames' instances is cut out of regions of the surface."""

    inside: Share = 0.8  # of an instance's surface in one region: it is of that; 0.7 or 0.9 hardly differ
    most: Share = 0.3  # of that region: what is more is the region itself, seen in part; 0.5 and 0.7 took furniture apart
    free: Share = 0.5  # of an instance's surface in no region: the surface has missed it


def refined(regions: Sequence[Indices], seen: Sequence[Indices], areas: Array, config: RefinementConfig) -> tuple[list[Indices], list[int]]:
    """Regions without what is cut out of them, and after them what is cut out or was missed, none of them empty; and of each the number of
    the instance in `seen` that it is, -1 for regions.

    regions, seen: Vertices of each region of the surface, and of each instance that frames see; within each list no vertex is in two.
    areas: Of all vertices [m2], shape (n,).
    """
    owner = np.full(len(areas), -1, dtype=np.int64)
    for number, members in enumerate(regions):
        owner[members] = number
    sizes = np.bincount(owner[owner >= 0], weights=areas[owner >= 0], minlength=len(regions))
    cutouts: list[tuple[Indices, int]] = []
    for number, members in enumerate(seen):
        shares = np.bincount(owner[members] + 1, weights=areas[members], minlength=len(regions) + 1)
        whole = float(shares.sum())
        best = int(shares[1:].argmax()) if len(regions) else -1
        if best >= 0 and shares[best + 1] >= config.inside * whole and shares[best + 1] < config.most * sizes[best]:
            cutouts.append((members, number))
        elif shares[0] >= config.free * whole:
            cutouts.append((members[owner[members] < 0], number))
    for members, _ in cutouts:
        owner[members] = -1
    kept = [members[owner[members] == number] for number, members in enumerate(regions)]
    parts = [(members, -1) for members in kept] + cutouts
    parts = [(members, number) for members, number in parts if len(members)]
    return [members for members, _ in parts], [number for _, number in parts]
