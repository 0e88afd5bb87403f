"""The body that stands for an agent in films: a round robot whose face says where it is heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

BODY, WHEELS, FACE, ARROW = (45, 120, 225), (52, 58, 68), (24, 28, 36), (255, 255, 255)
"""Colors, RGB."""

_SECTIONS = 48


def robot(radius: float, height: float) -> list[trimesh.Trimesh]:
    """Parts of a robot as wide and high as an agent [m], in its own frame: +Z up, front +X, origin on the floor below its center."""
    import trimesh

    dark = [(0.0, 0.0), (0.95, 0.0), (0.95, 0.13), (0.0, 0.13)]
    hull = [(0.0, 0.12), (1.0, 0.14), (1.0, 0.45), (0.80, 0.72), (0.78, 0.90), (0.66, 0.98), (0.0, 1.0)]
    parts = []
    for profile, color in ((dark, WHEELS), (hull, BODY)):
        turned = trimesh.creation.revolve(np.array(profile) * [radius, height], sections=_SECTIONS)
        parts.append(_painted(turned, color))
    face = trimesh.creation.box((0.30 * radius, 1.05 * radius, 0.13 * height))
    face.apply_translation((0.72 * radius, 0.0, 0.81 * height))
    parts.append(_painted(face, FACE))
    tip, back, side, top = 0.58 * radius, -0.42 * radius, 0.5 * radius, 1.004 * height
    corners = np.array([(tip, 0.0, top), (back, side, top), (-0.15 * radius, 0.0, top), (back, -side, top)])
    arrow = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    parts.append(_painted(arrow, ARROW))
    return parts


def _painted(part: trimesh.Trimesh, color: tuple[int, int, int]) -> trimesh.Trimesh:
    from trimesh.visual import ColorVisuals

    colors = np.tile(np.array([*color, 255], dtype=np.uint8), (len(part.vertices), 1))
    part.visual = ColorVisuals(part, vertex_colors=colors)
    return part
