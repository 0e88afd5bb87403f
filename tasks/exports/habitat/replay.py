"""Episodes carried out with nothing but the dataset's own files: its shortest paths' actions over its navmesh's polygons."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.exports.habitat.ground import Ground, Island
from tasks.navigation.path_finders import PATH_FINDERS

Array = NDArray[np.float64]

_NUMBERS = {"stop": 0, "move_forward": 1, "turn_left": 2, "turn_right": 3, "look_up": 4, "look_down": 5}
_STOP, _FORWARD, _LEFT, _RIGHT = 0, 1, 2, 3
_LOOKS = (4, 5)
_SAME_M = 1e-3  # between where a state says that the agent is and where its actions take it; a step is 250 times as long
_SAME_RADIANS = 1e-3  # the same for headings; a turn is 500 times as far
_EXACT_M = 0.01  # between an exact geodesic distance and that over the file's polygons, whose corners are rounded
_EXACT = tuple(finder.name for finder in PATH_FINDERS if finder.is_exact)
_DETOUR_SHARE, _DETOUR_M = 2.0, 0.25  # Detour's paths are no shortest ones: up to 1.4 times as long in 300, with room to spare


@dataclasses.dataclass(frozen=True)
class AgentSteps:
    """What the dataset says of its agent: step [m], turn [rad] and how near to a goal [m] an episode is done."""

    forward: float
    turn: float
    success: float


@dataclasses.dataclass(frozen=True)
class Trip:
    """An episode to carry out. Points are x, y and z [m].

    where: Names it in a finding. start: Shape (3,). heading: About +Y from -Z [rad]. goals: Points that it may end at,
    shape (n, 3). paths: Its shortest paths as the file has them. info: Its free dictionary.
    """

    where: str
    start: Array
    heading: float
    goals: Array
    paths: Sequence[Sequence[Any]]
    info: Mapping[str, Any]


def steps_of(agent: Mapping[str, Any] | None) -> AgentSteps | None:
    """The documented agent's steps, or None where they are not documented."""
    if agent is None or "forward_step_size" not in agent or "turn_angle" not in agent:
        return None
    return AgentSteps(float(agent["forward_step_size"]), math.radians(agent["turn_angle"]), float(agent.get("success_distance", 0.2)))


def heading_of(rotation: Sequence[float]) -> float:
    """Turn about +Y [rad] of a quaternion (x, y, z, w) that turns about +Y alone."""
    return 2.0 * math.atan2(rotation[1], rotation[3])


def check_trips(trips: Sequence[Trip], ground: Ground, steps: AgentSteps | None) -> Iterator[Finding]:
    """What is wrong with episodes of one scene. A start that is not on the navmesh is another rule's."""
    if not trips:
        return
    islands = ground.island_of(np.array([trip.start for trip in trips]))
    moves: dict[int, list[_Moves]] = {}
    for trip, number in zip(trips, islands, strict=True):
        if number < 0:
            continue
        reached = trip.goals[ground.island_of(trip.goals) == number][:, [0, 2]]
        if not len(reached):
            yield Finding("reachable", trip.where, "goals: none is connected to start_position on the navmesh")
            continue
        island = ground.island(int(number))
        yield from _distance(trip, reached, island)
        for index, path in enumerate(trip.paths if steps is not None else ()):
            if steps is not None:  # always: mypy does not see it
                yield from _walk(trip, f"shortest_paths[{index}]", path, reached, island, steps, moves.setdefault(int(number), []))
    for number, walked in moves.items():
        yield from _strays(walked, ground.island(number))


@dataclasses.dataclass(frozen=True)
class _Moves:
    """Straight moves of one path, shape (n, 2) each: which steps of which path of which episode they are."""

    where: str
    path: str
    steps: NDArray[np.int64]
    starts: Array
    ends: Array


def _strays(walked: Sequence[_Moves], island: Island) -> Iterator[Finding]:
    """The first step of every path that leaves the navmesh; all steps are looked at together."""
    if not walked:
        return
    inside = island.contains_moves(np.concatenate([m.starts for m in walked]), np.concatenate([m.ends for m in walked]))
    begin = 0
    for moves in walked:
        out = np.flatnonzero(~inside[begin : begin + len(moves.steps)])
        begin += len(moves.steps)
        if len(out):
            (x, z), (to_x, to_z) = moves.starts[out[0]], moves.ends[out[0]]
            step = f"{moves.path}[{moves.steps[out[0]]}]"
            line = f"from ({x:.3f}, {z:.3f}) to ({to_x:.3f}, {to_z:.3f}) (x, z)"
            yield Finding("replay", moves.where, f"{step}: the step {line} leaves the navmesh")


def _distance(trip: Trip, goals: Array, island: Island) -> Iterator[Finding]:
    """The geodesic distance that the episode states against the shortest path over the file's polygons."""
    stated = trip.info.get("geodesic_distance")
    if shapes.number(stated):
        return
    low, high = island.geodesic(trip.start[[0, 2]], goals)
    if trip.info.get("path_finder") not in _EXACT:
        high = _DETOUR_SHARE * high + _DETOUR_M
    if not low - _EXACT_M <= float(stated or 0) <= high + _EXACT_M:
        yield Finding("geodesic", trip.where, f"geodesic_distance is {stated:.4g}, the shortest path on the navmesh {low:.4g}")


def _walk(
    trip: Trip, name: str, path: Sequence[Any], goals: Array, island: Island, steps: AgentSteps, moves: list[_Moves]
) -> Iterator[Finding]:  # fmt: skip
    """Carry out one path; its forward steps are added to `moves`, to be held against the navmesh together."""
    actions = [_number(step.get("action") if isinstance(step, dict) else step) for step in path]
    unknown = next((i for i, action in enumerate(actions) if action is None), None)
    if unknown is not None:
        yield Finding("replay", trip.where, f"{name}[{unknown}]: action is none that this agent has")
        return
    if not actions or actions[-1] != _STOP or _STOP in actions[:-1]:
        yield Finding("replay_end", trip.where, f"{name}: its last action, and no other, must be stop (0)")
        return
    places, headings = walk(trip.start[[0, 2]], trip.heading, np.array(actions), steps)
    went = np.flatnonzero(np.array(actions) == _FORWARD)
    moves.append(_Moves(trip.where, name, went, places[went], places[went + 1]))
    for index, state in enumerate(path):
        wrong = _differs(state, places[index], headings[index]) if isinstance(state, dict) else None
        if wrong:
            yield Finding("replay", trip.where, f"{name}[{index}].{wrong}")
            break
    if island.geodesic(places[-1], goals)[0] > steps.success:
        away = float(np.hypot(*(goals - places[-1]).T).min())
        end = f"({places[-1][0]:.3f}, {places[-1][1]:.3f}) (x, z)"
        yield Finding("replay_end", trip.where, f"{name}: ends at {end}, {away:.2f} m from the goal, not within {steps.success:g} m")


def walk(start: Array, heading: float, actions: NDArray[np.int64], steps: AgentSteps) -> tuple[Array, Array]:
    """Places (n + 1, 2) [m] and headings (n + 1,) [rad] before the first action and after each, without any obstacle."""
    turns = (actions == _LEFT).astype(np.int64) - (actions == _RIGHT)
    headings = heading + steps.turn * np.concatenate([[0], np.cumsum(turns)])
    ahead = np.column_stack([-np.sin(headings[:-1]), -np.cos(headings[:-1])])
    moved = steps.forward * (actions == _FORWARD)[:, None] * ahead
    return start + np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)]), headings


def _number(action: Any) -> int | None:
    """habitat-sim's number of an action that is a number or a name, or None."""
    if isinstance(action, str):
        return _NUMBERS.get(action.lower())
    known = isinstance(action, int) and not isinstance(action, bool) and action in (_STOP, _FORWARD, _LEFT, _RIGHT, *_LOOKS)
    return int(action) if known else None


def _differs(state: Mapping[str, Any], place: Array, heading: float) -> str | None:
    """How a state differs from where the replay stands, or None. A state may leave out position and rotation."""
    position, rotation = state.get("position"), state.get("rotation")
    if position is not None:
        if shapes.mismatch(position, [shapes.number]) or len(position) != 3:
            return "position is not three finite numbers"
        if math.hypot(position[0] - place[0], position[2] - place[1]) > _SAME_M:
            return f"position is ({position[0]:.4g}, {position[2]:.4g}) (x, z), the replay stands at ({place[0]:.4g}, {place[1]:.4g})"
    if rotation is not None:
        if shapes.mismatch(rotation, [shapes.number]) or len(rotation) != 4:
            return "rotation is not four finite numbers"
        if abs(math.remainder(heading_of(rotation) - heading, 2 * math.pi)) > _SAME_RADIANS:
            return f"rotation is {rotation}, the replay has turned {math.degrees(heading):.4g} degrees"
    return None
