"""Shoring: thin plates, in colliders only, under what would tip because the scan did not see what it stands on.

A scan loses the flat undersides of small things, and bends the tops below them. What stood there stood flat: it gets a plate below it, and
what carries it a board, no larger than needed, and is marked (`supports.is_inferred`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull
from tasks.geometry.transforms import inverse
from tasks.optimization.colliders.cutting import beyond, prism
from tasks.optimization.colliders.undersides import DOWN, LOWER_SHARE, PLATE_M, apart_from, base_ring, holds
from tasks.optimization.interior import Interior
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.boards import BOARD_M

Array = NDArray[np.float64]


def with_plates(interior: Interior, poses: Array, wanted: Collection[int], clear: float) -> tuple[Interior, frozenset[int]]:
    """The interior, and the objects by number, of which those in `wanted` that are at rest at `poses`, shape (n, 4, 4) [m], got a flat
    plate at their lowest point, as wide as their lower part and what is below their center of mass, and a board below it in the collider of
    what carries them; neither reaches into anything.

    clear: gap that plates keep beside others [m].
    """
    solids, parents = interior.solids, interior.parent.tolist()
    placed = [list(solid.placed(pose)) for solid, pose in zip(solids, poses, strict=True)]
    plated: set[int] = set()
    changed: set[int] = set()
    for i in sorted(wanted):
        vertices = np.concatenate([hull.vertices for hull in placed[i]])
        low, height = float(vertices[:, 2].min()), float(np.ptp(vertices[:, 2]))
        center = poses[i][:3, :3] @ mass_properties_of(solids[i]).center + poses[i][:3, 3]
        level = low + max(LOWER_SHARE * height, BOARD_M)
        lower = [part.vertices[:, :2] for hull in placed[i] if (part := beyond(hull, DOWN, -level)) is not None]
        ring = base_ring(np.concatenate([*lower, np.zeros((0, 2))]), center[:2])
        if ring is None or not holds(ring, center[:2]):
            continue
        around = [hull for k, hulls in enumerate(placed) if k != i for hull in hulls if _is_near(hull, ring, low)]
        plates = apart_from(prism(ring, low, low + PLATE_M), around, clear)
        if not plates or not holds(np.concatenate([plate.vertices[:, :2] for plate in plates]), center[:2]):
            continue
        parent = parents[i]
        if parent >= 0 and low > BOARD_M:
            apart = [hull for k, hulls in enumerate(placed) if k not in (i, parent) for hull in hulls if _is_near(hull, ring, low)]
            boards = apart_from(prism(ring, low - BOARD_M, low), apart, clear)
            if not boards:
                continue
            placed[parent] += boards
            changed.add(parent)
        placed[i] += plates
        changed.add(i)
        plated.add(i)
    made = list(solids)
    for i in changed:
        back = inverse(poses[i])
        made[i] = ConvexParts(made[i].name, tuple(hull.transformed(back) for hull in placed[i]))
    carriers = tuple(dataclasses.replace(c, is_inferred=c.is_inferred or i in plated) for i, c in enumerate(interior.carriers))
    return dataclasses.replace(interior, solids=tuple(made), carriers=carriers), frozenset(plated)


def _is_near(hull: Hull, ring: Array, low: float) -> bool:
    """True if a piece may reach into a plate, or the board below it."""
    first, last = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    in_plan = bool((first[:2] <= ring.max(axis=0)).all() and (last[:2] >= ring.min(axis=0)).all())
    return in_plan and bool(first[2] < low + PLATE_M and last[2] > low - BOARD_M)
