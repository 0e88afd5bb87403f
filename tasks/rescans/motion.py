"""How far an object went between two scans and how it turned about +Z, by laying its points onto each other."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import transform_points, yaw_of, yaw_pose
from tasks.rescans.surfaces import ScannedObject

Array = NDArray[np.float64]

_NEAR_M = 0.05
"""Within which surfaces of two scans are the same [m]: two voxels of a scan and what is left of drift."""

_TURNS = 24
"""Of which ICP starts: every 15 degrees, of which it pulls in half."""

_STEPS = 10
"""Of ICP from each start."""

_KEPT = 0.8
"""Share of the points that must meet: the others may be a side that the other scan did not see."""

_CAP_M = 0.1
"""A point that is farther off counts no more [m]: it is a side that the other scan did not see."""

_MARGIN = 1.15
"""A turn is taken for a smaller one that fits as well by this factor: round tables do not turn."""

_STILL_M = 0.004
"""Which adds to that what noise alone makes [m]."""

_MOST = 400
"""Points of an object: more tell no more."""


@dataclasses.dataclass(frozen=True)
class ObjectMotion:
    """From the earlier to the later scan. shift: Of the middle of the object [m], shape (3,); turn_radians: about +Z, in (-pi, pi]."""

    shift: Array
    turn_radians: float

    @property
    def distance_m(self) -> float:
        """How far its middle went."""
        return float(np.linalg.norm(self.shift))


def shares_in_place(first: Array, second: Array) -> tuple[float, float]:
    """Share of the points of either cloud within 5 cm of the other's, shape (n, 3) and (m, 3) [m]."""
    from scipy.spatial import cKDTree

    there, back = cKDTree(second).query(first)[0], cKDTree(first).query(second)[0]
    return float((there < _NEAR_M).mean()), float((back < _NEAR_M).mean())


def motion_between(old: ScannedObject, new: ScannedObject) -> ObjectMotion:
    """How an object went from one place to another, both in one frame.

    Where it is in place it is laid onto itself as it is; else from every side, and of turns that fit as well the smallest counts.
    """
    source, target = _few(old.points), _few(new.points)
    rise = float(np.quantile(target[:, 2], 0.95) - np.quantile(source[:, 2], 0.95))
    lifted = source + np.array([0.0, 0.0, rise])
    middle = 0.5 * (source.min(axis=0) + source.max(axis=0))
    starts = []
    if max(shares_in_place(source, target)) > 0.3:
        starts.append(np.eye(4))
    away = new.center - old.center
    for yaw in np.arange(_TURNS) * (2 * np.pi / _TURNS):
        turn = yaw_pose(yaw)
        turn[:2, 3] = old.center[:2] + away[:2] - turn[:2, :2] @ old.center[:2]
        starts.append(turn)
    fits = [_laid(lifted, target, start) for start in starts]
    best = min(error for _, error in fits)
    good = [(pose, error) for pose, error in fits if error <= _MARGIN * best + _STILL_M]
    least = min((yaw_of(pose) for pose, _ in good), key=lambda yaw: (round(abs(yaw), 3), yaw))
    pose = min((each for each in good if abs(yaw_of(each[0]) - least) < np.pi / _TURNS * 2), key=lambda each: each[1])[0]
    shift = transform_points(middle[None], pose)[0] - middle + [0.0, 0.0, rise]
    return ObjectMotion(shift, yaw_of(pose))


def _few(points: Array) -> Array:
    """Every so many of the points, which are ordered by voxel."""
    return points[:: max(1, -(-len(points) // _MOST))]


def _laid(source: Array, target: Array, start: Array) -> tuple[Array, float]:
    """A pose after trimmed ICP in plan, 4x4 [m], and the mean distance of the points of both there, none above `_CAP_M`."""
    from scipy.spatial import cKDTree

    tree, pose = cKDTree(target), start
    keep = max(2, round(_KEPT * len(source)))
    for _ in range(_STEPS):
        moved = transform_points(source, pose)
        distance, index = tree.query(moved)
        chosen = np.argsort(distance, kind="stable")[:keep]
        step = _plan_step(moved[chosen], target[index[chosen]])
        pose = step @ pose
        if float(np.abs(step - np.eye(4)).max()) < 1e-4:
            break
    moved = transform_points(source, pose)
    there, back = tree.query(moved)[0], cKDTree(moved).query(target)[0]
    return pose, 0.5 * float(np.minimum(there, _CAP_M).mean() + np.minimum(back, _CAP_M).mean())


def _plan_step(source: Array, target: Array) -> Array:
    """The turn about +Z and shift in plan, 4x4 [m], that bring points nearest to their counterparts."""
    first, second = source[:, :2].mean(axis=0), target[:, :2].mean(axis=0)
    a, b = source[:, :2] - first, target[:, :2] - second
    step = yaw_pose(float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())))
    step[:2, 3] = second - step[:2, :2] @ first
    return step
