"""The scene from above: free floor, obstacles and trajectories in one picture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from schemas.navigation import Episode

if TYPE_CHECKING:
    import shapely


def draw_plan(
    free: shapely.Geometry,
    footprints: Mapping[str, shapely.Geometry],
    episodes: Sequence[Episode],
    floor: ArrayLike | None = None,
    most_paths: int = 40,
    inches: float = 7.0,
    walls: Sequence[shapely.Geometry] = (),
) -> bytes:
    """PNG of a floor plan, world frame, x to the right, y up. The same input gives the same bytes.

    Args:
        free: Where the agent's center can be [m].
        footprints: What blocks it, by the name to be written on it [m].
        episodes: Paths to draw, start as a dot, goal as a cross; beyond `most_paths` evenly spread ones.
        floor: Corners of the floor polygon [m], shape (n, 2), when the room's outline is wanted.
        most_paths: Paths that a reader can still tell apart.
        inches: Width and height at 110 pixels per inch.
        walls: Interior walls [m].
    """
    import shapely
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    figure = Figure(figsize=(inches, inches), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    if floor is not None:
        ring = np.asarray(floor, dtype=np.float64)
        axes.fill(*ring.T, facecolor="#f3efe6", edgecolor="#4a4a4a", linewidth=2)

    def paint(shape: shapely.Geometry, **style: object) -> None:
        for part in shapely.get_parts(shape):
            if part.geom_type != "Polygon" or part.is_empty:
                continue
            turned = shapely.orient_polygons(part)
            rings = [Outline(shapely.get_coordinates(ring), closed=True) for ring in (turned.exterior, *turned.interiors)]
            axes.add_patch(PathPatch(Outline.make_compound_path(*rings), **style))

    paint(free, facecolor="#d5e8d4", edgecolor="#82b366", linewidth=0.8)
    for wall in walls:
        paint(wall, facecolor="#4a4a4a", edgecolor="#4a4a4a", linewidth=0.8)
    for name, shape in footprints.items():
        if shape.is_empty:
            continue
        paint(shape, facecolor="#b0a18f", edgecolor="#5d5348", linewidth=0.8)
        spot = shape.representative_point()
        axes.annotate(name, (spot.x, spot.y), ha="center", va="center", fontsize=6, color="#1f1b16", zorder=5)
    shown = [episodes[int(i)] for i in np.linspace(0, len(episodes) - 1, min(most_paths, len(episodes)))] if episodes else []
    for episode in shown:
        line = np.array(episode.path)
        (drawn,) = axes.plot(*line.T, linewidth=1.0, alpha=0.75, color=_color(episode.instance_id), zorder=3)
        axes.plot(*line[0], marker="o", markersize=3, color=drawn.get_color(), zorder=4)
        axes.plot(*line[-1], marker="x", markersize=5, color=drawn.get_color(), zorder=4)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    title = f"{len(shown)} of {len(episodes)} paths" if len(shown) < len(episodes) else f"{len(episodes)} paths"
    axes.set_title(f"{free.area:.1f} m² free for the agent's center, {title}", fontsize=10)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def _color(instance_id: str) -> str:
    """One of ten colors, the same for every path to one target."""
    return f"C{int(instance_id) % 10}"
