"""Scanned instances, from their rows: the frame that assets are laid in, and the points that they are laid onto."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.targets import ScannedInstance, make_target
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import inverse, transform_points, yaw_of, yaw_pose
from tasks.mounting import mounting

if TYPE_CHECKING:
    from schemas.capture import Instance
    from tasks.alignment.configuration import AlignmentConfig
    from tasks.stage import Context

Array = NDArray[np.float64]

LEAST_WITHIN = 0.3
"""A box that holds less than this share of its points is none to go by."""

FLOOR_SNAP_M = 0.05
"""Scans bleed: what ends this near the floor stands on it."""

BESIDE_M = 0.05
"""Points farther out of the instance's box than its own noise are another object's."""


def instance_frame(
    instance: Instance, context: Context, config: AlignmentConfig, floor_snap_m: float = FLOOR_SNAP_M, beside_m: float = BESIDE_M
) -> tuple[Array, ScannedInstance, Array, NDArray[np.uint8]]:
    """The instance's frame in the world, 4x4 [m], standing where the asset is to stand; its points in that frame, as alignment takes
    them and all of them, shape (n, 3) [m], with their colors (n, 3)."""
    box, size = grown_box(instance.box_pose, instance.box_size, instance.hidden_m)
    bottom, top = box[2, 3] - 0.5 * size[2], box[2, 3] + 0.5 * size[2]
    is_grounded = abs(bottom) <= floor_snap_m < top
    if is_grounded:
        bottom = 0.0
    frame = yaw_pose(yaw_of(box), [box[0, 3], box[1, 3], bottom])
    points, colors = read_points(context.blobs[instance.points_blob], instance.points_blob)
    local = transform_points(points, inverse(frame))
    extent = np.array([size[0], size[1], top - bottom])
    within = (np.abs(local - [0.0, 0.0, 0.5 * extent[2]]) <= 0.5 * extent + beside_m).all(axis=1)
    if within.mean() >= LEAST_WITHIN:  # what lies farther off was annotated with it and is another object
        local, colors = local[within], colors[within]
    rng = context.rng("instance", instance.instance_id)
    is_let_in = mounting(instance.category).kind == "let_in"
    target = make_target(local, colors, extent, config, rng, instance.hidden_m, is_let_in)
    return frame, dataclasses.replace(target, is_grounded=is_grounded), local, colors


def covered_within(diagonal: float, usual_m: float = 0.03, share: float = 0.05, least_m: float = 0.01) -> float:
    """How near a surface covers a scanned point of an instance with a box of that diagonal [m]: usually so near, less on what is small."""
    return max(min(usual_m, share * diagonal), least_m)
