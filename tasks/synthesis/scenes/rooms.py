"""A plain room around a large object and what is on it."""

from __future__ import annotations

import numpy as np

from schemas.capture import Room, Shell
from tasks.furniture.palette import PAINTS, WOODS, pick
from tasks.synthesis.layout import Array, Layout
from tasks.synthesis.scenes.drawn import Drawn

FREE_M = 1.5
"""Between the large object and the walls [m]: a robot gets around it, and has starts a metre away from it."""

HEIGHT_M, OVER_M = 2.6, 0.4
"""Usual height of a room, and what is free above the highest object where that asks for more [m]."""


def plain_room(drawn: Drawn) -> tuple[Shell, Room]:
    """A rectangular room, the large object's frame in the middle of its floor, its front along +X. Colors by chance."""
    low, high = _bounds(drawn.layout)
    x, y = np.maximum(-low[:2], high[:2]) + FREE_M
    corners = ((-x, -y), (x, -y), (x, y), (-x, y))
    polygon = tuple((float(a), float(b)) for a, b in corners)
    walls = tuple((*a, *b) for a, b in zip(polygon, (*polygon[1:], polygon[0]), strict=True))
    room_type, rng = drawn.layout.large.room_type, drawn.rng("room")
    area = float(4.0 * x * y)
    shell = Shell(
        scene_id=drawn.scene_id, room_type=room_type, floor_polygon=polygon, floor_area_m2=area, floor_source="layout", walls=walls,
        interior_walls=(), openings=(), lintels=(), slopes=(), height_m=float(max(HEIGHT_M, high[2] + OVER_M)), height_source="layout",
        floor_color=pick(WOODS, rng), wall_color=pick(PAINTS[:2], rng),
    )  # fmt: skip
    return shell, Room(scene_id=drawn.scene_id, room_index=0, room_type=room_type, floor_polygon=polygon, floor_area_m2=area)


def _bounds(layout: Layout) -> tuple[Array, Array]:
    """Lowest and highest corner of the large object and of all boxes, in its frame [m], shape (3,) each; boxes turned anyhow."""
    half = 0.5 * np.asarray(layout.large.size)
    reach = np.column_stack([np.hypot(layout.sizes[:, 0], layout.sizes[:, 1])] * 2 + [layout.sizes[:, 2]]) / 2.0
    low = np.concatenate([[[-half[0], -half[1], 0.0]], layout.centers - reach])
    high = np.concatenate([[[half[0], half[1], 2.0 * half[2]]], layout.centers + reach])
    return low.min(axis=0), high.max(axis=0)
