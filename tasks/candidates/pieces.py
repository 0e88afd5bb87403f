"""A few convex pieces that stand for a scanned object: the solid is cut into slabs where its cross-section changes, each
slab into its separate or convex parts, and every part is replaced by its hull. A slanted strip or sheet, whose slabs share
no plan, is cut along its length instead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.closing import SolidField
from tasks.candidates.cutting import best_cut, hull_area

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLAB_PRICE = 0.008
"""What one more slab costs, as a share of the solid's cells: a board of a shelf is 3 to 15 percent of its cells and takes
two slabs, a layer of noise is below one."""

MAX_PIECES = 40
"""More pieces slow a simulator down. Until there are fewer, slabs cost more, then parts are cut less (a bucket's wall
becomes a full disc), then slabs cost more again."""

MAX_LAYERS = 80
"""Taller grids are cut at every second, third, ... layer only: the search is quadratic."""

CONVEXITY = 0.87
"""A part that fills this share of its hull's area is one piece: a disc of cells fills 0.92, an L 0.6 to 0.8."""

MAX_CUTS = 3
"""Cuts in a row of one part of a slab: eight pieces hold any L, U or cross."""

_THRIFT = ((MAX_CUTS, 1.0), (MAX_CUTS, 2.5), (2, 2.5), (1, 2.5), (0, 2.5), (0, 5.0), (0, 10.0))
# Cuts per part and factor on the price of a slab, from lavish to thrifty.

CUT_POSITIONS = 9
"""Places along a part where a cut is tried: an arm rest is about an eighth of its sofa."""

WORTHWHILE = 0.92
"""A cut that leaves more than this share of the hull's area gains nothing that anybody sees."""

MIN_PIECE_CELLS = 10
"""Parts of a slab of fewer cells (over its whole height) are specks; a leg one cell wide has twenty."""

MIN_COVERED_SHARE = 0.5
"""Least share of the solid's cells in the pieces of slabs; furniture has nine tenths, a sheet on its edge at 45 degrees none."""

SLANTED_CONVEXITY = 0.5
"""A slanted part that fills this share of its hull is one piece: the steps of the grid alone take up to half."""


def convex_pieces(field: SolidField) -> list[Array]:
    """Corner points of every convex piece [m], shape (n, 3), in the frame of `field`; at least one piece.

    Raises:
        ValueError: nothing is inside.
    """
    solid = field.values < 0
    if not solid.any():
        raise ValueError("the crop encloses nothing")
    pieces: list[Array] = []
    covered = 0
    for cuts, price in _THRIFT:
        pieces, covered = _pieces(solid, field, cuts, price * SLAB_PRICE)
        if len(pieces) <= MAX_PIECES:
            break
    if covered < MIN_COVERED_SHARE * solid.sum():
        parts = _parts_by_length(np.argwhere(solid).astype(np.float64), MAX_CUTS)
        return [field.origin + field.step * part for part in parts]
    return pieces


def _parts_by_length(nodes: Array, cuts: int) -> list[Array]:
    """Points around the parts of a solid, in cells, shape (n, 3), cut across its length until they are nearly convex.

    Args:
        nodes: nodes of the solid, in cells, shape (n, 3).
        cuts: most cuts in a row.
    """
    from scipy.spatial import ConvexHull

    tips = 0.5 * np.concatenate([np.eye(3), -np.eye(3)])
    points = (nodes[:, None] + tips).reshape(-1, 3)
    if cuts == 0 or len(nodes) < 2 or len(nodes) >= SLANTED_CONVEXITY * ConvexHull(points).volume:
        return [points]
    centered = nodes - nodes.mean(axis=0)
    along = centered @ np.linalg.eigh(centered.T @ centered)[1][:, -1]
    is_first = along < 0.0
    return [part for half in (nodes[is_first], nodes[~is_first]) for part in _parts_by_length(half, cuts - 1)]


def _pieces(solid: Mask, field: SolidField, cuts: int, slab_price: float) -> tuple[list[Array], int]:
    """Corner points of the pieces with so many cuts per part and one price per slab, and how many cells they share with the solid."""
    pieces, covered = [], 0
    for low, high in _slabs(solid, slab_price):
        # A cell belongs to the slab's plan when it is solid in at least half of its layers: else one noisy layer rules.
        plan = solid[:, :, low:high].sum(axis=2) * 2 >= high - low
        for body in _bodies(plan):
            for part in _convex_parts(body, cuts):
                if part.sum() * (high - low) >= MIN_PIECE_CELLS:
                    pieces.append(_corners(part, low, high, field))
                    covered += int(solid[:, :, low:high][part].sum())
    return pieces, covered


def _bodies(plan: Mask) -> list[Mask]:
    """Connected parts of cells in plan."""
    from scipy.ndimage import label

    parts, count = label(plan)
    return [parts == index for index in range(1, count + 1)]


def _slabs(solid: Mask, slab_price: float) -> list[tuple[int, int]]:
    """Ranges of layers [low, high), bottom to top, that one plan each describes best.

    The best cut has the least sum of misfit (cells that differ from the plan of their slab) and price per slab; found
    by dynamic programming over the last cut.
    """
    filled = np.flatnonzero(solid.any(axis=(0, 1)))
    first, last = int(filled[0]), int(filled[-1]) + 1
    edges = np.unique(np.append(np.arange(first, last, (last - first) // MAX_LAYERS + 1), last))
    counts = np.zeros((len(edges), solid.shape[0] * solid.shape[1]), dtype=np.int32)
    layers = solid.transpose(2, 0, 1).reshape(solid.shape[2], -1)
    counts[1:] = np.cumsum(np.add.reduceat(layers.astype(np.int32), edges[:-1], axis=0), axis=0)
    price = slab_price * float(solid.sum())
    best, cut_before = np.zeros(len(edges)), np.zeros(len(edges), dtype=np.int64)
    for end in range(1, len(edges)):
        heights = (edges[end] - edges[:end])[:, None]
        inside = counts[end] - counts[:end]
        totals = best[:end] + np.minimum(inside, heights - inside).sum(axis=1) + price
        cut_before[end] = int(totals.argmin())
        best[end] = totals[cut_before[end]]
    slabs, end = [], len(edges) - 1
    while end > 0:
        slabs.append((int(edges[cut_before[end]]), int(edges[end])))
        end = int(cut_before[end])
    return slabs[::-1]


def _convex_parts(plan: Mask, cuts: int) -> list[Mask]:
    """A connected part of a slab in plan, cut along x or y where the hulls of what remains become smallest, until all
    are nearly convex."""
    area = hull_area(plan)
    if cuts == 0 or plan.sum() >= CONVEXITY * area or plan.sum() < 4:
        return [plan]
    best, best_axis, best_position = best_cut(plan, *(_positions(np.asarray(plan.any(axis=1 - axis))) for axis in (0, 1)))
    if best > WORTHWHILE * area:
        return [plan]
    side = np.zeros(plan.shape, dtype=bool)
    np.moveaxis(side, best_axis, 0)[:best_position] = True
    bodies = _bodies(plan & side) + _bodies(plan & ~side)
    return [part for body in bodies for part in _convex_parts(body, cuts - 1)]


def _positions(filled: NDArray[np.bool_]) -> list[int]:
    """Where a part is cut along an axis, by which of its rows are filled."""
    rows = np.flatnonzero(filled)
    first, last = int(rows[0]) + 1, int(rows[-1])
    step = (last - first) / (CUT_POSITIONS - 1)
    return sorted({*(int(k * step + first) for k in range(CUT_POSITIONS - 1)), last})


def _outline(plan: Mask) -> Array:
    """Corners of the convex hull of cells in plan, in cells (cell (i, j) spans i to i + 1), counter-clockwise, shape (n, 2)."""
    from scipy.spatial import ConvexHull

    rows = np.flatnonzero(plan.any(axis=1))
    first = plan[rows].argmax(axis=1)
    last = plan.shape[1] - plan[rows, ::-1].argmax(axis=1)
    corners = np.array([[rows, first], [rows + 1, first], [rows, last], [rows + 1, last]]).transpose(0, 2, 1).reshape(-1, 2)
    return np.asarray(corners[ConvexHull(corners).vertices], dtype=np.float64)


def _corners(plan: Mask, low: int, high: int, field: SolidField) -> Array:
    """Corners of the prism over the hull of `plan` from layer `low` to `high` [m], shape (n, 3)."""
    outline = _outline(plan) - 0.5
    nodes = np.concatenate([np.column_stack([outline, np.full(len(outline), level)]) for level in (low - 0.5, high - 0.5)])
    return field.origin + field.step * nodes
