"""The scene from above: free floor, obstacles and trajectories in one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from schemas.navigation import Episode
from tasks.stats.style import WIDTH_INCHES, Picture, in_style, picture
from tasks.stats.tips import name_mark

if TYPE_CHECKING:
    import shapely


LETTER_POINTS = 2.8
"""Mean width of a letter of the names on a plan [pt]."""


@in_style
def draw_plan(
    free: shapely.Geometry,
    footprints: Mapping[str, shapely.Geometry],
    episodes: Sequence[Episode],
    floor: ArrayLike | None = None,
    most_paths: int = 40,
    walls: Sequence[shapely.Geometry] = (),
    name: str = "plan",
    of: str = "a scene",
) -> Picture:
    """A floor plan, world frame, x to the right, y up. The same input gives the same bytes.

    Args:
        free: Where the agent's center can be [m].
        footprints: What blocks it, by the name to be written on it [m].
        episodes: Paths to draw, start as a dot, goal as a cross; beyond `most_paths` evenly spread ones.
        floor: Corners of the floor polygon [m], shape (n, 2), when the room's outline is wanted.
        most_paths: Paths that a reader can still tell apart.
        walls: Interior walls [m].
        name: Name of the picture.
        of: Whose plan it is, for those who do not see it.
    """
    import shapely
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    reach = shapely.total_bounds([free, *footprints.values(), *walls, *([shapely.Polygon(floor)] if floor is not None else [])])
    wide, deep = np.maximum(reach[2:] - reach[:2], 0.5) if np.isfinite(reach).all() else (1.0, 1.0)
    figure = Figure(figsize=(WIDTH_INCHES, float(np.clip(WIDTH_INCHES * 0.86 * deep / wide + 0.7, 2.0, 7.0))), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(visible=False)
    if floor is not None:
        ring = np.asarray(floor, dtype=np.float64)
        axes.fill(*ring.T, facecolor="#f3efe6", edgecolor="#4a4a4a", linewidth=1.4)

    def paint(shape: shapely.Geometry, text: str = "", **style: object) -> None:
        for part in shapely.get_parts(shape):
            if part.geom_type != "Polygon" or part.is_empty:
                continue
            turned = shapely.orient_polygons(part)
            rings = [Outline(shapely.get_coordinates(ring), closed=True) for ring in (turned.exterior, *turned.interiors)]
            drawn = axes.add_patch(PathPatch(Outline.make_compound_path(*rings), **style))
            if text:
                name_mark(drawn, text)

    paint(free, facecolor="#d5e8d4", edgecolor="#82b366", linewidth=0.8)
    for wall in walls:
        paint(wall, facecolor="#4a4a4a", edgecolor="#4a4a4a", linewidth=0.8)
    for label, shape in footprints.items():
        if shape.is_empty:
            continue
        paint(shape, f"{label}: {shape.area:.2f} m² in the way", facecolor="#b0a18f", edgecolor="#5d5348", linewidth=0.8)
        if LETTER_POINTS * len(label) / (0.86 * 72 * WIDTH_INCHES) * wide > 1.2 * np.ptp(shape.bounds[0::2]):
            continue  # it would lie over what stands beside it; pointed at, the footprint says its name
        spot = shape.representative_point()
        axes.annotate(label, (spot.x, spot.y), ha="center", va="center", fontsize=5, color="#1f1b16", zorder=5)
    shown = [episodes[int(i)] for i in np.linspace(0, len(episodes) - 1, min(most_paths, len(episodes)))] if episodes else []
    for episode in shown:
        line = np.array(episode.path)
        (drawn,) = axes.plot(*line.T, linewidth=1.0, alpha=0.75, color=_color(episode.instance_id), zorder=3)
        name_mark(
            drawn, f"episode {episode.episode_id}: {episode.geodesic_m:.2f} m to {episode.category} {episode.instance_id}", along=True
        )
        axes.plot(*line[0], marker="o", markersize=3, color=drawn.get_color(), zorder=4)
        axes.plot(*line[-1], marker="x", markersize=5, color=drawn.get_color(), zorder=4)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    title = f"{len(shown)} of {len(episodes)} paths" if len(shown) < len(episodes) else f"{len(episodes)} paths"
    axes.set_title(f"{free.area:.1f} m² free for the agent's center, {title}", fontsize=8.5)
    return picture(figure, name, "Floor plan", f"Floor plan of {of}: navmesh, footprints and paths of episodes")


def _color(instance_id: str) -> str:
    """One of ten colors, the same for every path to one target."""
    return f"C{int(instance_id) % 10}"
