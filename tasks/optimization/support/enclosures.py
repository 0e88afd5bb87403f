"""What is inside what it stands on: compartments have a board above, containers have sides all around."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tasks.optimization.support.heights import occupancy, plan_view
from tasks.optimization.support.standing import MOST_CELLS

if TYPE_CHECKING:
    from tasks.optimization.support.supports import PlacedAsset, SupportConfig


def encloses(parent: PlacedAsset, obj: PlacedAsset, gap: float, config: SupportConfig) -> bool:
    """Whether the surface that carries an object has parts of the same parent above it, or all around it.

    `gap`: of the object's bottom above that surface [m].
    """
    rest = float(obj.low[2]) - gap
    center = np.array([*(0.5 * (obj.low + obj.high)[:2]), rest + 0.5 * obj.height])
    if (center < parent.low).any() or (center > parent.high).any():
        return False
    cells, under = obj.footprint(config.cell_m)
    over = plan_view(parent.surface, obj.low[:2], obj.high[:2], math.inf, config.cell_m, False, parent.blocks).at(cells)
    # a tablecloth hangs down past the table, but its top lies over it
    if (over > np.maximum(center[2], under - gap + config.base_m)).mean() >= 0.5:
        return True
    span = float((parent.high - parent.low)[:2].max())
    cell = max(min(max(span / 64, 0.005), 0.04), span / MOST_CELLS)
    top = max(float(center[2]), rest + 2 * config.base_m)
    sides = occupancy(parent.surface, parent.low[:2], parent.high[:2], rest + config.base_m, top, cell, parent.blocks)
    points = (np.argwhere(np.isfinite(sides.heights)) + np.array(sides.first) + 0.5) * cell - center[:2]
    if not len(points):
        return False
    # sectors of the horizon of 1/24 turn in which a side stands
    sectors = np.floor(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * 24).astype(np.int64) % 24
    return bool(len(np.unique(sectors)) >= config.enclosed_share * 24)
