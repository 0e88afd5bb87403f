"""What the scan could not see of furniture: legs and bases down to what it stands on, and bodies back to the wall behind."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance, Shell
from tasks.capture.instances.boxes import oriented_box
from tasks.geometry.boxes import grown_box
from tasks.geometry.transforms import flat, inverse, matrix, transform_points, yaw_of
from tasks.mounting import UNNAMED, Mounting, carried, mounting

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

SEEN_M = 0.03
"""What ends this near to the floor, or to its wall, was seen whole."""

MOST_BELOW_M = {"legs": 0.85, "body": 0.65, "pole": 1.8}
"""Legs are no longer than a table's; of a body more than this is not hidden without the rest; a pole is that of a floor lamp."""

MOST_BELOW_STANDING_M = {"legs": 1.05, "body": 1.3, "pole": 1.8}
"""The same of what never hangs: a chair of which the upper edge of its back was seen, a refrigerator behind a table."""

LET_IN = ("oven", "stove", "dishwasher", "washing machine", "clothes dryer", "mini fridge")
"""What stands on the floor, or is let into worktops and tall cabinets: not so far above it."""

POLE_WIDTH_M = 0.3
"""What stands on a pole has a foot of this width, of which the scan saw none."""

MOST_BEHIND_M = 0.75
"""Farther from a wall than this, furniture does not stand against it."""

PLINTH_M = 0.15
"""Nobody hangs a cabinet or a shelf this low [m]: the scan lost its feet, or a plinth that stands back, whatever floor was seen below."""

FRONT_M = 0.12
"""Of a body that is no deeper the front alone was seen [m], whose plinth stands back by some centimetres: the floor that is seen before
it says nothing, that behind it would."""

ASKEW_RADIANS = (0.05, 0.35)
"""A worktop lies along its wall: a box that is turned by 3 degrees is as good as a scan; at 20 it may lie along another one."""

LID_M = 0.1
"""A body of which no more than this is seen in height [m] is seen from above, its top alone: none hangs below the eyes."""

EYES_M = 1.3
"""Lower than this people look down on furniture [m]."""

MOST_DEPTH_M = 0.8
"""Furniture of which the front alone was seen is not deeper."""

CELL_M = 0.05
"""Cells in which it is known what was seen below and behind furniture."""

OVER_SHARE = 0.5
"""Of the box of furniture, that lies over a platform that it stands on."""

CARRIED_SHARE = 0.2
"""Of the cells below furniture, in which something else ends right below it, from which on that carries it."""

FRONTS_SHARE, SLAB_M = 0.5, 0.2
"""Along so much of a slab, no thicker [m], and in its first and last quarter, cabinets end right below it, of which the scan saw the
fronts alone: they carry it."""

BELOW_M, UPPER_QUANTILE = 0.04, 0.98
"""So near below a slab ends what carries it [m], by its uppermost points but for noise."""

ENDS_M = 0.03
"""What ends no farther above the bottom of furniture carries it; what reaches higher stands beside or on it."""

TOP_QUANTILE = 0.9
"""Of an object's points within the plan of furniture: its top there, a tenth of them being noise."""

FLOOR_SHARE = 0.1
"""Of the cells below a body, or between furniture and a wall, in which the floor was seen, from which on nothing of it is there."""

FILLED_SHARE = 0.3
"""Of those cells, in which something else was seen, from which on that stands there."""

RAISED_M = 0.1
"""What never hangs and ends higher above the floor stands on other furniture, which nobody pushes it over to reach the wall."""

HOOD = "hood"
"""Last word of what hangs and is as deep as the cabinets beside it."""

RAISED = ("platform", "stage", "step", "steps", "stairs")
"""What furniture stands on as on the floor."""


@dataclasses.dataclass(frozen=True)
class _Seen:
    """Points of all objects [m], shape (n, 3), whose each is, shape (n,), of the floor, shape (m, 2), and which objects are boxes."""

    points: Array
    owners: NDArray[np.int64]
    floor: Array
    boxes: Booleans


def with_hidden_parts(
    rows: Sequence[Instance], points: Sequence[Array], floor: Array, room: Shell, leaves: Mapping[int, Array] | None = None
) -> list[Instance]:
    """The rows of a scan, `hidden_m` filled in. points: of each [m], shape (n, 3). floor: points of the floor that was seen [m],
    shape (m, 2). leaves: corners of doors and windows with what was not seen of them, by number [m], shape (8, 3)."""
    movable = [i for i, row in enumerate(rows) if not row.is_structure]
    seen = _Seen(
        np.concatenate([np.zeros((0, 3)), *(points[i] for i in movable)]),
        np.concatenate([np.zeros(0, dtype=np.int64), *(np.full(len(points[i]), i) for i in movable)]),
        floor,
        np.array([mounting(row.category).is_boxy for row in rows], dtype=np.bool_),
    )
    raised = np.array([row.category.split(" ")[-1] in RAISED for row in rows], dtype=np.bool_)
    passed = raised | np.array([mounting(row.category).kind == "covering" for row in rows], dtype=np.bool_)
    walls = np.array(room.walls, dtype=np.float64).reshape(-1, 4)
    rows = [_along_its_wall(row, cloud, walls) for row, cloud in zip(rows, points, strict=True)]
    made = list(rows)
    for i in movable:
        kind = carried(rows[i].category, rows[i].box_size, rows[i].found_by == "geometry")
        below = _below(i, rows[i], kind, seen, {k: rows[k] for k in np.flatnonzero(raised).tolist() if k != i}, passed, walls)
        sides = np.array([0.0, 0.0, 0.0, 0.0, below, 0.0])
        bottom = float(rows[i].box_pose[11]) - 0.5 * rows[i].box_size[2] - below
        is_hood = rows[i].category.split(" ")[-1] == HOOD
        if is_hood or (kind.is_boxy and (kind.is_fitted or not (kind.kind == "stands" and bottom > RAISED_M))):
            sides[:4] = _behind(i, rows[i], sides, seen, walls)
        if kind.base == "pole" and below > 0.0:
            sides[:4] = np.repeat(np.maximum(0.5 * (POLE_WIDTH_M - np.array(rows[i].box_size[:2])), 0.0), 2)
        if leaves and i in leaves:
            made[i] = _along_wall(rows[i], points[i], leaves[i])
            sides = _beyond(made[i], leaves[i])
        made[i] = dataclasses.replace(made[i], hidden_m=tuple(float(v) for v in sides))
    return made


def _along_its_wall(row: Instance, points: Array, walls: Array) -> Instance:
    """The row of a worktop with a box along the wall beside it, where the least box of its points, shape (n, 3), is askew because its
    corners were not seen. walls: ends of each, shape (n, 4) [m]."""
    kind = mounting(row.category)
    if not (kind.is_fitted and kind.is_flat_topped) or not len(walls) or row.is_structure:
        return row
    along, away = walls[:, 2:] - walls[:, :2], _from_walls(row, walls)
    nearest = int(np.argmin(away))
    yaw = yaw_of(matrix(row.box_pose))
    turn = (float(np.arctan2(along[nearest, 1], along[nearest, 0])) - yaw + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi
    if away[nearest] > MOST_DEPTH_M or not ASKEW_RADIANS[0] < abs(turn) < ASKEW_RADIANS[1]:
        return row
    return _with_yaw(row, points, yaw + turn)


def _with_yaw(row: Instance, points: Array, yaw: float) -> Instance:
    """The row with the box of its points, shape (n, 3) [m], that is turned so [rad]."""
    pose, extents = oriented_box(points, yaw=yaw)
    size = tuple(float(v) for v in extents)
    return dataclasses.replace(row, box_pose=flat(pose), box_size=size, box_volume_m3=size[0] * size[1] * size[2])


def _along_wall(row: Instance, points: Array, corners: Array) -> Instance:
    """The row of a door or window with the box of its points, shape (n, 3), turned as its wall runs: of a part of it nobody can tell.
    corners: of the whole, the first and the fifth apart along the wall, shape (8, 3) [m]."""
    along, yaw = corners[4] - corners[0], yaw_of(matrix(row.box_pose))
    turn = (float(np.arctan2(along[1], along[0])) - yaw + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi
    return _with_yaw(row, points, yaw + turn)


def _beyond(row: Instance, corners: Array) -> Array:
    """How far corners, shape (k, 3) [m], reach beyond the box of an instance on its sides -x, +x, -y, +y, -z, +z [m]."""
    local, half = transform_points(corners, inverse(matrix(row.box_pose))), 0.5 * np.asarray(row.box_size)
    return np.asarray(np.maximum(np.column_stack([-local.min(axis=0) - half, local.max(axis=0) - half]).ravel(), 0.0))


def _below(index: int, row: Instance, kind: Mounting, seen: _Seen, stages: Mapping[int, Instance], passed: Booleans, walls: Array) -> float:
    """How far furniture reaches below its box, to the floor or a platform [m]. stages: the platforms, by number. passed: by object,
    which of them carry no furniture although they end below it: platforms and rugs. walls: ends of each, shape (n, 4) [m]."""
    if kind.base is None:
        return 0.0
    pose, size = matrix(row.box_pose), np.asarray(row.box_size)
    bottom = float(pose[2, 3] - 0.5 * size[2])
    if bottom <= SEEN_M:
        return 0.0
    local = transform_points(seen.points, inverse(pose))
    inside = (np.abs(local[:, :2]) < 0.5 * size[:2]).all(axis=1) & (seen.owners != index)
    under = inside & (seen.points[:, 2] < bottom + 0.05)
    ends_below = np.zeros(len(passed), dtype=np.bool_)
    for other in np.unique(seen.owners[under & (seen.points[:, 2] > bottom - 0.12)]).tolist():
        top = np.quantile(seen.points[inside & (seen.owners == other), 2], TOP_QUANTILE)
        ends_below[other] = not passed[other] and top <= bottom + ENDS_M
    cells = max(float(np.prod(np.maximum(size[:2] / CELL_M, 1.0))), 1.0)
    near = inside & (seen.points[:, 2] > bottom - 0.12) & ends_below[seen.owners]
    if _filled(local[near, :2]) > CARRIED_SHARE * cells:
        return 0.0
    if kind.is_flat_topped and size[2] <= SLAB_M and _has_fronts(local, inside & ends_below[seen.owners], size, seen):
        return 0.0
    tops = [_top(cloud[:, :2], cloud[:, 2]) for k in _under(row, stages) if len(cloud := seen.points[seen.owners == k])]
    lost = bottom - max((top for top in tops if top < bottom + 0.05), default=0.0)
    is_front = kind.is_boxy and size[:2].min() <= FRONT_M and _behind(index, row, lost * np.eye(6)[4], seen, walls).any()
    is_low = kind.kind == "either" and lost <= PLINTH_M
    if kind.base == "body" and not is_front and not is_low:
        on_floor = transform_points(np.column_stack([seen.floor, np.full(len(seen.floor), pose[2, 3])]), inverse(pose))
        on_floor = on_floor[(np.abs(on_floor[:, :2]) < 0.5 * size[:2]).all(axis=1)]
        if len(_cells(on_floor[:, :2]) & _cells(local[seen.owners == index, :2])) > FLOOR_SHARE * cells:  # not in its bend
            return 0.0
    if row.category == UNNAMED and (_hangs(row, walls) or _filled(local[under, :2]) > CARRIED_SHARE * cells):
        return 0.0  # over a sofa nobody knows what holds it
    is_let_in = row.category.endswith(LET_IN)
    is_lid = kind.is_boxy and size[2] <= LID_M and bottom + size[2] <= EYES_M
    most = MOST_BELOW_STANDING_M if (kind.kind == "stands" or is_lid) and not is_let_in else MOST_BELOW_M
    return lost if SEEN_M < lost <= most[kind.base] else 0.0


def _hangs(row: Instance, walls: Array) -> bool:
    """Whether a box without a name lies flat against a wall. walls: ends of each, shape (n, 4) [m]."""
    return bool(len(walls) and min(row.box_size[:2]) <= FRONT_M and _from_walls(row, walls).min() <= FRONT_M)


def _from_walls(row: Instance, walls: Array) -> Array:
    """How far the middle of a box is from each wall in plan [m], shape (n,). walls: ends of each, shape (n, 4) [m]."""
    along, from_start = walls[:, 2:] - walls[:, :2], np.array([row.box_pose[3], row.box_pose[7]]) - walls[:, :2]
    share = np.clip((from_start * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(from_start - share[:, None] * along).T))


def _has_fronts(local: Array, below: Booleans, size: Array, seen: _Seen) -> bool:
    """Whether boxes below a slab carry it, of which the scan saw the fronts. local: all points in its frame, shape (n, 3) [m]. below: which
    lie in its plan and are of what ends below it, shape (n,)."""
    axis = int(np.argmax(size[:2]))
    cells: set[int] = set()
    for k in np.unique(seen.owners[below]).tolist():
        own = seen.owners == k
        is_under = bool(seen.boxes[k]) and below[own].mean() > 0.5  # what stands beside it is not
        if is_under and np.quantile(local[own, 2], UPPER_QUANTILE) >= -0.5 * size[2] - BELOW_M:
            cells |= set(np.floor(local[own & below, axis] / CELL_M).astype(int).tolist())
    quarter = 0.25 * size[axis]
    reaches = bool(cells) and min(cells) * CELL_M < -quarter and max(cells) * CELL_M > quarter
    return reaches and len(cells) > FRONTS_SHARE * size[axis] / CELL_M


def _behind(index: int, row: Instance, sides: Array, seen: _Seen, walls: Array) -> Array:
    """How far furniture reaches beyond its box on its sides -x, +x, -y, +y, to the nearest wall that nothing is seen before [m]."""
    pose, size = grown_box(row.box_pose, row.box_size, sides)
    best, nearest = np.zeros(4), MOST_BEHIND_M
    if not len(seen.floor):  # nobody knows where it would have been seen
        return best
    local = transform_points(seen.points, inverse(pose))
    floor = transform_points(np.column_stack([seen.floor, np.zeros(len(seen.floor))]), inverse(pose))
    for side in range(4):
        axis, sign = side // 2, 1.0 if side % 2 else -1.0
        if size[axis] > 1.3 * size[1 - axis]:  # its end, not its front or back
            continue
        outward, half = sign * pose[:2, axis], 0.5 * size
        for x0, y0, x1, y1 in walls.tolist():
            along = np.array([x1 - x0, y1 - y0])
            length = float(np.hypot(*along))
            normal = np.array([along[1], -along[0]])
            if length < CELL_M or float(normal @ outward) < 0.97 * length:
                continue
            # To the wall's line right behind it: along a long wall, of which a box is a few degrees askew, its ends are farther or nearer.
            away = float((np.array([x0, y0]) - pose[:2, 3]) @ normal / (normal @ outward) - half[axis])
            if not SEEN_M < away < nearest or size[axis] + away > MOST_DEPTH_M:
                continue
            ends = np.sort((np.array([[x0, y0], [x1, y1]]) - pose[:2, 3]) @ pose[:2, 1 - axis])
            if min(ends[1], half[1 - axis]) - max(ends[0], -half[1 - axis]) < 0.6 * size[1 - axis]:
                continue
            cells = away * float(size[1 - axis]) / CELL_M**2
            high = np.abs(local[:, 2]) < half[2] - min(0.05, 0.2 * float(size[2]))
            strangers = _between(local, axis, sign, half, away) & high & (seen.owners != index)
            if _filled(floor[_between(floor, axis, sign, half, away), :2]) < FLOOR_SHARE * cells and (
                _filled(local[strangers, :2]) < FILLED_SHARE * cells
            ):
                best, nearest = np.zeros(4), away
                best[side] = away
    return best


def _between(local: Array, axis: int, sign: float, half: Array, away: float) -> Booleans:
    """Which points, shape (n, 3), in a box's frame [m] lie beside it, up to `away` from a side."""
    out = sign * local[:, axis] - half[axis]
    return np.asarray((out > 0.02) & (out < away - 0.02) & (np.abs(local[:, 1 - axis]) < half[1 - axis]))


def _cells(plan: Array) -> set[tuple[int, int]]:
    """Cells that points are in, shape (n, 2) [m]."""
    return set(map(tuple, np.unique(np.floor(plan / CELL_M).astype(np.int64), axis=0).tolist()))


def _filled(plan: Array) -> int:
    """How many cells points are in, shape (n, 2) [m]."""
    return len(_cells(plan))


def _under(row: Instance, stages: Mapping[int, Instance]) -> list[int]:
    """The platforms that furniture stands on, by number: most of its box lies over theirs. Their tops were not seen below it."""
    corners = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    plan = np.stack(np.meshgrid(corners * row.box_size[0], corners * row.box_size[1]), axis=-1).reshape(-1, 2)
    points = transform_points(np.column_stack([plan, np.zeros(len(plan))]), matrix(row.box_pose))
    inside = {
        k: np.abs(transform_points(points, inverse(matrix(stage.box_pose)))[:, :2]) <= 0.5 * np.array(stage.box_size[:2])
        for k, stage in stages.items()
    }
    return [k for k, is_over in inside.items() if is_over.all(axis=1).mean() > OVER_SHARE]


def _top(plan: Array, heights: Array) -> float:
    """Height of what points are of, shape (n, 2) and (n,), seen from above [m]."""
    _, cell = np.unique(np.floor(plan / CELL_M).astype(np.int64), axis=0, return_inverse=True)
    highest = np.full(int(cell.max()) + 1, -np.inf)
    np.maximum.at(highest, cell.ravel(), heights)
    return float(np.median(highest))
