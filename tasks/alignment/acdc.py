"""ACDC's alignment (Dai et al., "Automated Creation of Digital Cousins", 2024): the best of 100 snapshots says the yaw, then one scale
is found by rendering and comparing boxes.

With weights of DINOv2 the snapshot whose patches are nearest to the photo's is the best; without them, or without a photo, it
is the one whose silhouette and depth are nearest to those of the scanned points, from several sides.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.method import AlignmentMethod
from tasks.alignment.refined import refine
from tasks.alignment.samples import Fit, Sample
from tasks.alignment.snapshots import box_in_view, differences, hull_corners, points_snapshot, surface_snapshot, view_axes
from tasks.alignment.targets import ScannedInstance
from tasks.settings import Config, Count, NonNegative, Positive

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Acdc(Config):
    """The yaw of the best of many snapshots, then one scale by boxes in the views."""

    kind: ClassVar[str] = "acdc"
    snapshots: Count = 100  # ACDC has as many of an asset: every 3.6 degrees
    views: Count = 4  # sides from which the points are looked at, where no camera is known: one alone takes fronts for backs
    elevation: float = 0.45  # radians above the horizon, where no camera is known: as people look at furniture
    between: Count = 9  # yaws tried as scales are, from halfway before the best to halfway after; ACDC has 1: 2 degrees move boxes by 3 %
    pixels: Count = 64  # of a snapshot's side: points lie a fortieth of the diagonal apart
    depth_weight: NonNegative = 1.0  # of depth beside the silhouette, both are shares of one
    smallest_scale: Positive = 0.5  # of the asset as it is in the library; ACDC's range
    largest_scale: Positive = 1.5  # as smallest_scale
    scale_step: Positive = 0.02  # of the asset's size: below it boxes in an image of 64 pixels do not differ
    dinov2: str = ""  # folder of DINOv2's weights (config.json, model.safetensors); none: by silhouettes and depths
    picture_pixels: Count = 224  # of the side of pictures for DINOv2: sixteen patches of 14
    refines: bool = False  # ACDC does not; true adds our refinement of yaw and place


def lacks(target: ScannedInstance, own: Acdc) -> str | None:
    """Pictures are compared with a photo."""
    if own.dinov2 and (target.sight is None or target.sight.picture is None):
        return "no photo of it; by silhouettes and depths"
    return None


def pose(target: ScannedInstance, sample: Sample, threshold: float, config: AlignmentConfig, own: Acdc) -> Fit:
    """The yaw of the best snapshot, the scale whose boxes differ least from the scan's, middle on middle.

    Raises:
        ValueError: the sample has no surface to take snapshots of.
    """
    if sample.surface is None:
        raise ValueError("acdc: the asset was sampled without its surface")
    sight, count = target.sight, own.snapshots
    start, elevation = (sight.azimuth, sight.elevation) if sight is not None else (0.0, own.elevation)
    asset = [surface_snapshot(sample.surface, 2 * np.pi * i / count, elevation, own.pixels) for i in range(count)]
    turns = [0] if sight is not None else [round(count * k / own.views) for k in range(own.views)]
    azimuths = [start + 2 * np.pi * turn / count for turn in turns]
    scan = [points_snapshot(target.points, target.spacing, azimuth, elevation, own.pixels) for azimuth in azimuths]
    if own.dinov2 and sight is not None and sight.picture is not None:
        from tasks.alignment.pictures import picture_distances

        costs = picture_distances(sight.picture, sample.surface, elevation, own)
    else:
        turned = [np.roll(differences(view, asset, own.depth_weight), -turn) for view, turn in zip(scan, turns, strict=True)]
        costs = np.sum(turned, axis=0)
    best = int(np.argmin(np.round(costs, 9)))
    step = 2 * np.pi / count
    between = np.linspace(-0.5, 0.5, own.between) if own.between > 1 and len(turns) > 1 else np.zeros(1)
    yaws = start - step * best + step * between  # one box alone does not tell a yaw from a scale
    corners = hull_corners(sample.surface.vertices)
    boxes = [[box_in_view(corners, azimuth - yaw, elevation) for azimuth in azimuths] for yaw in yaws]
    at, scale = _best_scale(np.array([[size for size, _ in each] for each in boxes]), np.array([view.size for view in scan]), own)
    rights = np.stack([view_axes(azimuth, elevation)[0, :2] for azimuth in azimuths])
    aside = np.array([view.middle[0] - scale * middle[0] for view, (_, middle) in zip(scan, boxes[at], strict=True)])
    moved = np.linalg.lstsq(rights, aside, rcond=1e-6)[0]  # where one view leaves a direction open, the box's middle is as good as any
    fit = Fit(math.remainder(float(yaws[at]), 2 * math.pi), np.array([*moved, 0.0]), np.full(3, scale))
    return refine(target.thinned(config.refine_points), sample, fit, config) if own.refines else fit


def _best_scale(has: Array, wanted: Array, own: Acdc) -> tuple[int, float]:
    """Which yaw, and the scale of the grid, at which the asset's boxes in the views, shape (yaws, views, 2), differ least from the
    scan's, shape (views, 2), by shares of their sides."""
    grid = own.smallest_scale + own.scale_step * np.arange(round((own.largest_scale - own.smallest_scale) / own.scale_step) + 1)
    costs = np.abs(grid[:, None, None] * has[:, None] / np.maximum(wanted, 1e-3) - 1.0).sum(axis=(2, 3))
    yaw, scale = np.unravel_index(int(np.argmin(np.round(costs, 9))), costs.shape)
    return int(yaw), float(grid[scale])


ACDC = AlignmentMethod(name="acdc", config=Acdc, pose=pose, lacks=lacks, reads_surface=True, reads_sight=True)
