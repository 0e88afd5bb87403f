"""A scan from above, colored by how far the replica is from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.fidelity.marked_points import SHELL, MarkedPoints
from tasks.stats.style import INK, MUTED, Picture, in_style, picture
from tasks.stats.tips import area

if TYPE_CHECKING:
    from schemas.capture import Shell

CELL_M = 0.05
"""Edge of a cell: objects are sampled every 3 cm, so that few cells of a level top stay empty."""

MOST_CELLS = 400
"""Cells along an edge of the map, 20 m of them; where points lie farther apart, cells are larger."""

FARTHEST_M = 0.2
"""Distances beyond are drawn alike: a hand's length off is another place."""

TOLD_M = 0.25
"""Edge of the squares that say how far off their farthest point is: as small as a finger hits."""

_NEAR_M = 0.05
"""Squares that are nearer than that say nothing."""

_INCHES = 4.5
_MOST_SQUARES = 40
"""Along an edge of the map."""

_MAP_SHARE = 0.72
"""Of the picture's width, beside the bar and the labels."""

_FLOOR = "#e9e7e1"
_COLORS = "YlOrRd"


@in_style
def heat_map(marked: MarkedPoints, room: Shell | None, scene_id: str) -> Picture:
    """The floor from above, x to the right, y up: in each cell the scanned point farthest from the replica.

    Points of floor, walls and ceiling are left out. The same points give the same bytes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_INCHES, _height(marked.points)), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(visible=False)
    if room is not None and room.floor_polygon:
        axes.fill(*np.asarray(room.floor_polygon, dtype=np.float64).T, facecolor=_FLOOR, edgecolor=INK.light, linewidth=1.2)
    shown = marked.part != SHELL
    points, distance = marked.points[shown], np.minimum(marked.distance[shown], FARTHEST_M)
    if len(points):
        farthest, (x0, y0), (x1, y1) = farthest_of_cells(points[:, :2], distance)
        image = axes.imshow(
            np.ma.masked_less(farthest.T, 0.0), origin="lower", extent=(x0, x1, y0, y1), cmap=_COLORS, vmin=0.0, vmax=FARTHEST_M,
            interpolation="nearest", zorder=2,
        )  # fmt: skip
        for low, high, most in _squares(points[:, :2], distance):
            text = (
                f"x {low[0]:.2f} to {high[0]:.2f} m, y {low[1]:.2f} to {high[1]:.2f} m: {'over ' if most >= FARTHEST_M else ''}{most:.2f} m"
            )
            area(axes, (low[0], high[0]), (low[1], high[1]), text)
        bar = figure.colorbar(image, ax=axes, extend="max")
        bar.set_label("Farthest from the replica [m]")
    else:
        axes.text(0.5, 0.5, "nothing was scanned but the room", transform=axes.transAxes, ha="center", color=MUTED.light)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    title = f"Distance of the scan of {scene_id} to its replica"
    return picture(figure, f"heat_{scene_id}", title, f"{title}, from above")


def _squares(points: NDArray[np.float64], distance: NDArray[np.float64]) -> list[tuple[list[float], list[float], float]]:
    """Squares of the plane with a point that is farther than `_NEAR_M`: corners and the largest distance [m]."""
    size = TOLD_M * max(1.0, np.ceil(float(np.ptp(points, axis=0).max()) / (TOLD_M * _MOST_SQUARES)))
    far = distance > _NEAR_M
    cells, inverse = np.unique(np.floor(points[far] / size).astype(np.int64), axis=0, return_inverse=True)
    most = np.zeros(len(cells))
    np.maximum.at(most, inverse.reshape(-1), distance[far])
    return [((cell * size).tolist(), ((cell + 1) * size).tolist(), value) for cell, value in zip(cells, most.tolist(), strict=True)]


def farthest_of_cells(
    points: NDArray[np.float64], distance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The largest distance in each cell of the plane [m], -1 where no point is, shape (nx, ny), with the map's corners [m], shape (2,).

    points: At least one [m], shape (n, 2).
    """
    size = CELL_M * max(1.0, np.ceil(float(np.ptp(points, axis=0).max()) / (CELL_M * (MOST_CELLS - 2))))
    low = np.floor(points.min(axis=0) / size)
    cell = (np.floor(points / size) - low).astype(np.int64)
    farthest = np.full(cell.max(axis=0) + 1, -1.0)
    np.maximum.at(farthest, (cell[:, 0], cell[:, 1]), distance)
    return farthest, low * size, (low + farthest.shape) * size


def _height(points: NDArray[np.float64]) -> float:
    """Height of the picture in inches, so that a map as wide as there is room for fits."""
    wide, deep = np.maximum(np.ptp(points[:, :2], axis=0), 0.5) if len(points) else (1.0, 1.0)
    return float(np.clip(_INCHES * _MAP_SHARE * deep / wide + 0.6, 2.0, 1.6 * _INCHES))
