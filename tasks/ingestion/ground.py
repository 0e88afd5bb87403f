"""The shell of a finished dataset's scene: as it is stated, else estimated from its stage and its objects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.capture.cloud import sampled_cloud
from tasks.capture.labels import FLOOR, WALL
from tasks.capture.rooms.room import RoomShape, estimate_room
from tasks.geometry.meshes import Surface, surface_of, union_of
from tasks.ingestion.scene import Array, FinishedScene
from tasks.stage import Context

_MIN_SIDE_M = 0.1
"""A floor plan thinner than this is none."""

_MIN_HEIGHT_M = 0.1
"""As rows of `shells` have it."""


def scene_shell(scene: FinishedScene, surfaces: Sequence[Surface], context: Context) -> tuple[Shell, list[str]]:
    """The shell, of unknown kind, and what had to be assumed. `surfaces`: Objects in the world frame."""
    top = max((float(surface.bounds[1, 2]) for surface in surfaces), default=0.0)
    notes: list[str] = []
    if scene.layout is not None:
        height = scene.layout.height
        shape = _stated(scene.layout.polygon, height if height is not None else max(top, _MIN_HEIGHT_M), height is not None)
    else:
        whole = [surface_of([part]) for part, _ in scene.stage] + list(surfaces)
        points = np.concatenate([surface.vertices for surface in whole])
        low, high = points.min(axis=0), points.max(axis=0)
        if (high - low)[:2].min() < _MIN_SIDE_M:
            notes.append("too narrow for a room: its floor is the extent of what stands there")
            shape = _extent(low, np.maximum(high, low + _MIN_SIDE_M))
        elif scene.stage:
            shape = _estimated(scene, whole, context)
            notes += shape.notes
        else:
            notes.append("no stage and no layout: the floor is the extent of what stands there")
            shape = _extent(low, high)
    shape = dataclasses.replace(shape, height=max(shape.height, _MIN_HEIGHT_M))
    parts = [(surface_of([part]).colors, label) for part, label in scene.stage if label.nyu40_id in (FLOOR, WALL)]
    return shape.row(context.scene_id, parts), notes


def _stated(polygon: Array, height: float, is_height_stated: bool) -> RoomShape:
    area = 0.5 * abs(float(polygon[:, 0] @ np.roll(polygon[:, 1], -1) - polygon[:, 1] @ np.roll(polygon[:, 0], -1)))
    walls = np.column_stack([polygon, np.roll(polygon, -1, axis=0)])
    return RoomShape(polygon, area, "layout", walls, np.zeros((0, 6)), height, "layout" if is_height_stated else "extent", ())


def _extent(low: Array, high: Array) -> RoomShape:
    """The rectangle around everything."""
    polygon = np.array([low[:2], [high[0], low[1]], high[:2], [low[0], high[1]]])
    walls = np.column_stack([polygon, np.roll(polygon, -1, axis=0)])
    area, height = float(np.prod(high[:2] - low[:2])), float(high[2])
    return RoomShape(polygon, area, "extent", walls, np.zeros((0, 6)), height, "extent", ())


def _estimated(scene: FinishedScene, surfaces: Sequence[Surface], context: Context) -> RoomShape:
    """The room as capture finds it, from points spread over everything; parts of the stage count as what their names say."""
    classes = [label.nyu40_id for _, label in scene.stage] + [instance.label.nyu40_id for instance in scene.objects]
    owner: NDArray[np.int64] = np.repeat(np.arange(len(surfaces)), [len(surface.faces) for surface in surfaces])
    cloud = sampled_cloud(union_of(surfaces), owner, context.rng("room"))
    return estimate_room(cloud, np.array([0, *classes], dtype=np.int64)[cloud.instance + 1])
