"""Shortest paths as actions of a robot that goes straight or turns on the spot, and the replay that checks them."""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.navigation.protocol import NO_PATH, DistanceField, PathFinder

Array = NDArray[np.float64]

FORWARD, LEFT, RIGHT, STOP = "forward", "left", "right", "stop"

_BLOCKED_M = 1e-9
"""A step that ends farther than this from where it should has met an obstacle [m]."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """What one action does."""

    forward_m: float = 0.25  # step of the paper's agent and of Habitat's default
    turn_radians: float = math.pi / 6  # 30 degrees: twelve turns are a full circle, so headings stay on twelve rays


@dataclasses.dataclass(frozen=True)
class FollowedPath:
    """Poses along a sequence of actions.

    poses: x, y [m] and yaw about +Z [rad] before the first action and after each, world frame, shape (n + 1, 3).
    collisions: Forward steps that met an obstacle.
    """

    poses: Array
    collisions: int

    @property
    def length(self) -> float:
        """Distance travelled [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def replay(actions: Sequence[str], start: ArrayLike, yaw: float, finder: PathFinder, motion: Motion) -> FollowedPath:
    """Carry out actions from a navigable start, world frame [m], shape (2,), heading `yaw` [rad].

    Raises:
        ValueError: an action has an unknown name, or follows a stop.
    """
    position, turns, collisions = np.asarray(start, dtype=np.float64)[:2], 0, 0
    poses = [(position[0], position[1], yaw)]
    for index, action in enumerate(actions):
        if action == FORWARD:
            moved = finder.try_step(position, _offset(yaw, turns, motion))
            collisions += int(is_short(moved - position, motion))
            position = moved
        elif action in (LEFT, RIGHT):
            turns += 1 if action == LEFT else -1
        elif action != STOP or index != len(actions) - 1:
            raise ValueError(f"actions: {action!r} at {index} is no action of this robot, or follows a stop")
        poses.append((position[0], position[1], heading_after(yaw, turns, motion)))
    return FollowedPath(np.array(poses), collisions)


def follow(
    start: ArrayLike, yaw: float, field: DistanceField, finder: PathFinder, motion: Motion, reach: float, max_steps: int, search_limit: int
) -> list[str] | None:
    """Actions from a start to within `reach` [m] of the goal of `field`, stop included; None when none were found.

    Greedy: turn to the next corner of the shortest path from here until the heading is off by half a turn step at most,
    then go forward. Where a step is blocked or brings the robot no closer, a best-first search over the twelve headings
    takes over until the robot is one step closer. The result never meets an obstacle.
    """
    position, turns = np.asarray(start, dtype=np.float64)[:2], 0
    actions: list[str] = []
    path = field.path(position)
    while path.exists and path.length > reach:
        if len(actions) >= max_steps:
            return None
        ahead = path.corners[1] - position
        wanted = round(_wrapped(math.atan2(ahead[1], ahead[0]) - yaw - turns * motion.turn_radians) / motion.turn_radians)
        moved = position + _offset(yaw, turns + wanted, motion)
        onward = field.path(moved) if finder.is_clear(position, moved) else NO_PATH
        if onward.length < path.length:
            actions += [LEFT if wanted > 0 else RIGHT] * abs(wanted) + [FORWARD]
            position, turns, path = moved, turns + wanted, onward
            continue
        steps = _search(position, turns, yaw, field, finder, motion, max(reach, path.length - 2 * motion.forward_m), search_limit)
        if steps is None:
            return None
        more, position, turns = steps
        actions += more
        path = field.path(position)
    return [*actions, STOP] if path.exists and len(actions) < max_steps else None


def _search(
    position: Array, turns: int, yaw: float, field: DistanceField, finder: PathFinder, motion: Motion, reach: float, limit: int
) -> tuple[list[str], Array, int] | None:
    """Fewest actions, nearly, until the goal is `reach` away, where they end and the turns by then; None after `limit` expansions.

    Weighted A* over positions and headings.
    """
    around = round(2 * math.pi / motion.turn_radians)

    def key(p: Array, k: int) -> tuple[int, int, int]:
        # A fifth of a step apart counts as the same place.
        x, y = p.tolist()
        return round(x / motion.forward_m * 5), round(y / motion.forward_m * 5), k % around

    # The heuristic weighs twice: a third fewer expansions cost at most a few actions.
    first = float(field.distances(position)[0])
    queue: list[tuple[float, int, int, float, Array, int]] = [(2 * first / motion.forward_m, 0, 0, first, position, turns)]
    parents: list[tuple[int, str]] = [(-1, "")]
    seen: set[tuple[int, int, int]] = set()
    while queue and len(seen) < limit:
        _, node, cost, distance, p, k = heapq.heappop(queue)
        if distance <= reach:
            actions = []
            while node > 0:
                node, action = parents[node]
                actions.append(action)
            return actions[::-1], p, k
        if key(p, k) in seen:
            continue
        seen.add(key(p, k))
        options = [(LEFT, p, k + 1, distance), (RIGHT, p, k - 1, distance)]
        moved = p + _offset(yaw, k, motion)
        if finder.is_clear(p, moved):
            options.append((FORWARD, moved, k, float(field.distances(moved)[0])))
        for action, q, heading, left in options:
            if key(q, heading) not in seen and math.isfinite(left):
                parents.append((node, action))
                heapq.heappush(queue, (cost + 1 + 2 * left / motion.forward_m, len(parents) - 1, cost + 1, left, q, heading))
    return None


def heading_after(yaw: float, turns: int, motion: Motion) -> float:
    """Heading after a number of turns to the left [rad], in (-pi, pi]; counted, so that errors do not add up."""
    return _wrapped(yaw + turns * motion.turn_radians)


def _offset(yaw: float, turns: int, motion: Motion) -> Array:
    heading = heading_after(yaw, turns, motion)
    return motion.forward_m * np.array([math.cos(heading), math.sin(heading)])


def is_short(moved: Array, motion: Motion) -> bool:
    """Whether a step forward that moved the robot by so much, shape (2,) [m], has met an obstacle."""
    return math.hypot(moved[0], moved[1]) < motion.forward_m - _BLOCKED_M


def _wrapped(angle: float) -> float:
    wrapped = math.remainder(angle, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped
