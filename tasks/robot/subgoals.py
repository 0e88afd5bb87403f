"""Sub-goals: the track that a policy's actions make, as places that a cart can reach one after the other (supplementary B.3)."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.robot.configuration import Cart, Planner

if TYPE_CHECKING:
    import shapely

    from tasks.robot.floor_map import Floor

Array = NDArray[np.float64]

SPARE_M = 0.01
"""What a cart keeps beside it where there is no room for the margin [m]: five times what its estimate errs by."""


@dataclasses.dataclass(frozen=True)
class Subgoals:
    """Where a cart goes, in this order.

    points: World frame [m], shape (n, 2); empty where there is a problem. goal_snapped_m: How far the way's end was moved to where the cart
    fits. dropped: Sub-goals left out because the cart does not fit near them. problem: Why no cart can drive this way, in a line.
    """

    points: Array
    goal_snapped_m: float
    dropped: int
    problem: str | None = None


def subgoals(poses: ArrayLike, floor: Floor, cart: Cart, planner: Planner) -> Subgoals:
    """Sub-goals of a track.

    They are `spacing_m` apart along it, its end the last, each moved to the nearest place with the cart's clearance that can be reached
    from the start: with `margin_m` beside the cart where there is one within `snap_m`, else with what there is.

    Args:
        poses: The track: x, y [m] and yaw [rad], world frame, shape (n, 3).
        floor: As the map has it.
        cart: Its radius counts.
        planner: Spacing, margin and how far a place may be moved.
    """
    import shapely

    track = np.asarray(poses, dtype=np.float64).reshape(-1, 3)[:, :2]
    fitting = floor.free(cart.radius_m)
    reachable = _part_at(fitting, track[0])
    if reachable is None:
        if fitting.is_empty:
            return Subgoals(np.zeros((0, 2)), 0.0, 0, "the cart fits nowhere on this floor")
        short = float(shapely.distance(fitting, shapely.Point(track[0])))
        return Subgoals(np.zeros((0, 2)), 0.0, 0, f"the cart does not fit where the way begins; the next place is {short:.2f} m off")
    rooms = [
        shapely.intersection(floor.free(cart.radius_m + spare), reachable) for spare in (planner.margin_m, min(SPARE_M, planner.margin_m))
    ]
    if all(room.is_empty for room in rooms):
        problem = f"where the way begins the cart has less than {100 * SPARE_M:g} cm to spare, and nowhere to go"
        return Subgoals(np.zeros((0, 2)), 0.0, 0, problem)
    marks = _resampled(track, planner.spacing_m)
    points, dropped, far = [], 0, 0.0
    for index, mark in enumerate(marks):
        place, far = _snapped(mark, rooms, planner.snap_m)
        if place is not None:
            points.append(place)
        elif index < len(marks) - 1:
            dropped += 1
        else:
            problem = f"the way ends {far:.2f} m from where the cart can be; planner.snap_m allows {planner.snap_m:g} m"
            return Subgoals(np.zeros((0, 2)), far, dropped, problem)
    return Subgoals(np.array(points), far, dropped)


def _resampled(track: Array, spacing: float) -> Array:
    """Places so far apart along a polyline, shape (n, 2), without its start and with its end."""
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    count = int(np.floor(lengths[-1] / spacing + 1e-9))
    at = spacing * np.arange(1, count + 1)
    if not count or lengths[-1] - at[-1] > 1e-9:
        at = np.append(at, lengths[-1])
    return np.column_stack([np.interp(at, lengths, track[:, axis]) for axis in (0, 1)])


def _part_at(region: shapely.MultiPolygon, place: Array) -> shapely.Polygon | None:
    """The part of a region that a place lies in, or on to rounding."""
    import shapely

    point = shapely.Point(place)
    return next((part for part in shapely.get_parts(region) if part.distance(point) < 1e-6), None)


def _snapped(mark: Array, rooms: list[shapely.Geometry], reach: float) -> tuple[Array | None, float]:
    """The nearest place of the first region that has one within reach [m], and how far that is; the farthest of all where none has."""
    import shapely

    point, far = shapely.Point(mark), np.inf
    for room in rooms:
        if room.is_empty:
            continue
        far = float(shapely.distance(room, point))
        if far <= reach:
            place = mark if far == 0.0 else shapely.get_coordinates(shapely.shortest_line(room, point))[0]
            return np.asarray(place, dtype=np.float64), far
    return None, far
