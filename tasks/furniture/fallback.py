"""A plain body for a category that nobody draws: chosen by the silhouette that its extents give."""

from __future__ import annotations

from tasks.furniture.drafting import Draft
from tasks.furniture.palette import FABRICS, METALS, PAINTS, PLASTICS, WOODS, shade
from tasks.furniture.solids import cylinder, rounded_square, turned_body


def silhouette(extents: tuple[float, float, float]) -> str:
    """`panel`, `plank`, `sheet`, `post`, `block` or `lump`, from extents (depth, width, height) [m]."""
    x, y, z = extents
    if z < 0.12 * min(x, y):
        return "sheet"
    if x < 0.15 * min(y, z):
        return "panel"
    if y < 0.15 * min(x, z):
        return "plank"
    if z > 3.0 * max(x, y):
        return "post"
    return "lump" if max(x, y, z) < 0.35 else "block"


def draw(d: Draft) -> None:
    """A body of the draft's silhouette."""
    d.variant = silhouette((d.X, d.Y, d.Z))
    if d.variant == "sheet":
        color = d.main(FABRICS + WOODS)
        d.box("sheet", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, 0.8 * d.Z))
        d.box("field", shade(color, 1.1), (-0.85 * d.hx, 0.85 * d.hx), (-0.85 * d.hy, 0.85 * d.hy), (0, d.Z))
    elif d.variant == "panel":
        color = d.main(WOODS + PAINTS)
        d.box("panel", color, (-d.hx, 0.7 * d.hx), (-d.hy, d.hy), (0, d.Z))
        d.box("field", shade(color, 1.1), (0, d.hx), (-0.86 * d.hy, 0.86 * d.hy), (0.07 * d.Z, 0.93 * d.Z))
    elif d.variant == "plank":
        color = d.main(WOODS + PAINTS)
        d.box("plank", color, (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z))
    elif d.variant == "post":
        color = d.main(METALS + WOODS)
        r = min(d.hx, d.hy)
        d.add("foot", color, turned_body([(d.hx, 0), (0.95 * d.hx, 0.05 * d.Z)], rounded_square(), d.Y / d.X))
        d.add("post", color, cylinder(0.45 * r, (0.04 * d.Z, 0.92 * d.Z)))
        d.add("top", shade(color, 0.8), turned_body([(0.6 * r, 0.9 * d.Z), (0.75 * r, 0.94 * d.Z), (0.5 * r, d.Z)]))
    elif d.variant == "lump":
        d.cushion("body", d.main(PLASTICS + FABRICS), (-d.hx, d.hx), (-d.hy, d.hy), (0, d.Z), 0.2 * min(d.X, d.Y, d.Z))
    else:
        color = d.main(WOODS + PAINTS)
        d.box("plinth", shade(color, 0.75), (-0.95 * d.hx, 0.95 * d.hx), (-0.95 * d.hy, 0.95 * d.hy), (0, 0.06 * d.Z))
        d.box("body", color, (-d.hx, 0.97 * d.hx), (-d.hy, d.hy), (0.06 * d.Z, d.Z))
        d.box("front", shade(color, 1.08), (0.9 * d.hx, d.hx), (-0.92 * d.hy, 0.92 * d.hy), (0.12 * d.Z, 0.94 * d.Z))
