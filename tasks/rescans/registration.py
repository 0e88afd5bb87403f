"""Where a scan lies in the world frame of another scan of the same room: correlated in plan, refined by ICP, held against a fit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import transform_points, yaw_pose
from tasks.rescans.configuration import RegistrationConfig
from tasks.rescans.surfaces import RoomScan

Array = NDArray[np.float64]

CELL_M = 0.1
"""Of plans that are correlated [m]: twice the spacing of points, a quarter of what ICP can still pull in."""

_COLUMN_M = (0.3, 1.8)
"""Heights [m] over which a wall that counts goes: above baseboards, below what scans with a level camera miss."""

_COLUMN_SHARE = 0.5
"""Of the voxels between these heights that make a column of the plan a wall: windows and clutter take the rest."""

_NEAR_M = 0.1
"""Within which surfaces of two scans are the same [m]: drift and voxels of two good scans come to half of it."""

_CUTS_M = (0.4, 0.2, 0.1, 0.1)
"""Distances from which on ICP takes points for moved, in turn [m]."""

_STEPS = 12
"""Of ICP with each of these; they settle in half as many."""

_SETTLED = 1e-4
"""A step of ICP below which it ends [m, rad]: a hundredth of what scans are off."""

_MOST = 4000
"""Points that ICP moves: a wall of a few hundred is a plane to it."""


@dataclasses.dataclass(frozen=True)
class Registration:
    """How a scan fits onto a reference.

    pose: The scan's world frame to the reference's, 4x4 [m]. wall_share: Of standing surfaces that are no object's, the share within
    10 cm of the other scan's, of the scan of which more fits. object_share: The same of objects' surfaces; None where one has no objects.
    conflict_share: Share of the walls of one that stand where the other saw bare floor, the larger one. problem: Why it does not fit;
    '' where it does.
    """

    pose: Array
    wall_share: float
    object_share: float | None
    conflict_share: float
    problem: str


def registration(room: RoomScan, reference: RoomScan, config: RegistrationConfig) -> Registration:
    """The best of all ways to lay a scan onto a reference by a turn about +Z and a shift in plan: both frames have their floor at z = 0."""
    starts = correlated(room, reference, config)
    fits = [measured(refined(room, reference, start), room, reference, config) for start in starts]
    return max(fits, key=lambda each: (not each.problem, _score(each)))


def _score(fit: Registration) -> float:
    return fit.wall_share + (fit.object_share or 0.0) - fit.conflict_share


def correlated(room: RoomScan, reference: RoomScan, config: RegistrationConfig) -> list[Array]:
    """Poses, 4x4 [m], at which the plans of two scans agree best, best first: walls with walls and objects with objects."""
    from scipy.ndimage import gaussian_filter

    marks, own = (reference.is_wall, reference.is_loose), (room.is_wall, room.is_loose)
    low = reference.points[:, :2].min(axis=0) - CELL_M
    reach = np.linalg.norm(room.points[:, :2] - _middle(room), axis=1).max()
    last = np.ceil(np.ptp(reference.points[:, :2], axis=0) / CELL_M).astype(np.int64) + 2  # farther shifts are those the other way
    shape = tuple(_fast(int(side)) for side in last + int(np.ceil(2 * reach / CELL_M)) + 2)
    fixed = [np.fft.rfft2(gaussian_filter(_plan(reference.points[mark], low, shape), 1.0)) for mark in marks]
    peaks: list[tuple[float, float, Array]] = []
    for yaw in np.arange(config.yaws) * (2 * np.pi / config.yaws):
        turned = transform_points(room.points - [*_middle(room), 0.0], yaw_pose(yaw))
        moved = [np.fft.rfft2(_plan(turned[mark], np.array([-reach, -reach]), shape)) for mark in own]
        score = np.fft.irfft2(sum(plan * np.conj(other) for plan, other in zip(fixed, moved, strict=True)), s=shape)
        for _ in range(config.starts):
            at = np.unravel_index(int(np.argmax(score)), shape)
            cells = np.array([place if place <= end else place - side for place, end, side in zip(at, last, shape, strict=True)])
            peaks.append((float(score[at]), float(yaw), low + reach + cells * CELL_M))
            rows, columns = (np.arange(-4, 5) + place for place in at)
            score[np.ix_(rows % shape[0], columns % shape[1])] = -np.inf
    chosen: list[tuple[float, Array]] = []
    for _, yaw, offset in sorted(peaks, key=lambda each: -each[0]):
        if all(abs(np.sin(0.5 * (yaw - other))) > 0.1 or np.linalg.norm(offset - place) > 0.3 for other, place in chosen):
            chosen.append((yaw, offset))
        if len(chosen) == config.starts:
            break
    return [yaw_pose(yaw, [*(offset - yaw_pose(yaw)[:2, :2] @ _middle(room)), 0.0]) for yaw, offset in chosen]


def _middle(room: RoomScan) -> Array:
    return 0.5 * (room.points[:, :2].min(axis=0) + room.points[:, :2].max(axis=0))


def _fast(side: int) -> int:
    """The next size of which transforms are fast."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(side, real=True))


def _plan(points: Array, low: Array, shape: tuple[int, ...]) -> Array:
    """How much stands over every cell from a corner [m] on, as a root: a wall outweighs a chair, and not all of them."""
    cells = np.floor((points[:, :2] - low) / CELL_M).astype(np.int64)
    plan = np.bincount(cells[:, 0] * shape[1] + cells[:, 1], minlength=shape[0] * shape[1])
    return np.sqrt(plan.reshape(shape))


def refined(room: RoomScan, reference: RoomScan, pose: Array) -> Array:
    """A pose, 4x4 [m], after ICP in plan, from points to planes; what moved is left out by its distance."""
    from scipy.spatial import cKDTree

    of_reference = reference.is_steep
    points, normals = reference.points[of_reference], reference.normals[of_reference]
    moving = room.points[room.is_steep]
    moving = moving[:: max(1, len(moving) // _MOST)]
    if not len(points) or not len(moving):
        return pose
    tree = cKDTree(points)
    for cut in _CUTS_M:
        for _ in range(_STEPS):
            step = _plane_step(transform_points(moving, pose), tree, points, normals, cut)
            pose = step @ pose
            if float(np.abs(step - np.eye(4)).max()) < _SETTLED:
                break
    return pose


def _plane_step(moved: Array, tree: Any, points: Array, normals: Array, cut: float) -> Array:
    """The small turn and shift in plan, 4x4 [m], that brings points nearest to the planes of their counterparts."""
    distance, index = tree.query(moved, distance_upper_bound=cut)
    is_met = distance < cut
    if is_met.sum() < 3:
        return np.eye(4)
    source, target, normal = moved[is_met], points[index[is_met]], normals[index[is_met]]
    weight = (1 - (distance[is_met] / cut) ** 2) ** 2
    middle = source[:, :2].mean(axis=0)
    arm = source[:, :2] - middle
    rows = np.stack([arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0], normal[:, 0], normal[:, 1]], axis=1)
    residual = np.einsum("nk,nk->n", (target - source)[:, :2], normal[:, :2])
    square = (rows * weight[:, None]).T @ rows
    square += 1e-3 * weight.sum() * np.eye(3)  # along walls that are all parallel nothing says how far
    turn, x, y = np.linalg.solve(square, (rows * weight[:, None]).T @ residual)
    step = yaw_pose(turn)
    step[:2, 3] = middle + np.array([x, y]) - step[:2, :2] @ middle
    return step


def measured(pose: Array, room: RoomScan, reference: RoomScan, config: RegistrationConfig) -> Registration:
    """How well a scan fits onto a reference at a pose, 4x4 [m]."""
    points = transform_points(room.points, pose)
    walls = _shares(points[room.is_wall], reference.points[reference.is_wall])
    objects = _shares(points[room.is_loose], reference.points[reference.is_loose])
    conflict = _conflict(points, room, reference)
    wall_share = max(walls) if walls else 0.0
    object_share = max(objects) if objects else None
    problem = ""
    if wall_share < config.least_wall_share:
        problem = f"{wall_share:.0%} of the walls fit"
    elif conflict > config.most_conflict:
        problem = f"{conflict:.0%} of the walls stand on the other's bare floor"
    elif object_share is not None and object_share < config.least_object_share:
        problem = f"{object_share:.0%} of the objects' surfaces are where the other has some"
    return Registration(pose, wall_share, object_share, conflict, problem)


def _shares(first: Array, second: Array) -> tuple[float, float] | None:
    """Share of the points of either that are near the other's; None where one has none."""
    from scipy.spatial import cKDTree

    if not len(first) or not len(second):
        return None
    there, back = (
        float((cKDTree(to).query(points, distance_upper_bound=_NEAR_M)[0] < _NEAR_M).mean())
        for points, to in ((first, second), (second, first))
    )
    return there, back


def _conflict(points: Array, room: RoomScan, reference: RoomScan) -> float:
    """The larger share of either's walls, in cells of the plan, that stand on floor that the other saw bare."""
    both = np.concatenate([points[:, :2], reference.points[:, :2]])
    low = both.min(axis=0) - CELL_M
    shape = tuple(int(side) for side in np.ceil(np.ptp(both, axis=0) / CELL_M) + 3)
    plans = [_walls_and_floor(each, of, low, shape) for each, of in ((points, room), (reference.points, reference))]
    (first_walls, first_floor), (second_walls, second_floor) = plans
    return max(
        float((walls & floor).sum()) / max(int(walls.sum()), 1)
        for walls, floor in ((first_walls, second_floor), (second_walls, first_floor))
    )


def _walls_and_floor(
    points: Array, room: RoomScan, low: Array, shape: tuple[int, ...]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # fmt: skip
    """Cells of the plan in which a wall stands, and those that lie on floor with bare floor all around."""
    from scipy.ndimage import binary_erosion

    from tasks.rescans.surfaces import SPACING_M

    cells = np.floor((points[:, :2] - low) / CELL_M).astype(np.int64)
    bottom, top = _COLUMN_M
    levels = np.zeros((*shape, round((top - bottom) / SPACING_M)), bool)
    height = np.floor((points[:, 2] - bottom) / SPACING_M).astype(np.int64)
    inside = room.is_wall & (height >= 0) & (height < levels.shape[2])
    levels[cells[inside, 0], cells[inside, 1], height[inside]] = True
    walls = levels.mean(axis=2) >= _COLUMN_SHARE
    floor = np.zeros(shape, bool)
    level = cells[(points[:, 2] < 0.1) & (np.abs(room.normals[:, 2]) > 0.9)]
    floor[level[:, 0], level[:, 1]] = True
    stands = np.zeros(shape, bool)
    over = cells[room.is_wall & (points[:, 2] > bottom)]
    stands[over[:, 0], over[:, 1]] = True
    return walls, binary_erosion(floor & ~stands, np.ones((3, 3)))
