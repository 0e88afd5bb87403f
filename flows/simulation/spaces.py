"""Spaces of object navigation, named and typed as Habitat's, and what an agent's observation and information are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.objectnav import compass, gps, normalize_depth
from tasks.simulation.protocol import ACTIONS, NO_OBJECT, AgentView

Array = NDArray[np.float64]

_FAR = float(np.finfo(np.float32).max)
"""Habitat's own bound of its GPS."""


def observation_space(categories: int, config: SimulationConfig) -> gymnasium.spaces.Dict:
    """What one agent observes, of so many categories of targets.

    rgb: (h, w, 3) uint8. depth: (h, w, 1), from 0 at `min_depth_m` to 1 at `max_depth_m`. semantic: (h, w, 1), the number of the
    instance, -1 where there is none. objectgoal: (1,), the target's category by number. compass: (1,) [rad]. gps: (2,) [m].
    """
    picture = (config.height, config.width)
    box = gymnasium.spaces.Box
    return gymnasium.spaces.Dict(
        {
            "rgb": box(0, 255, (*picture, 3), np.uint8),
            "depth": box(0.0, 1.0, (*picture, 1), np.float32),
            "semantic": box(NO_OBJECT, np.iinfo(np.int32).max, (*picture, 1), np.int32),
            "objectgoal": box(0, max(categories - 1, 1), (1,), np.int64),  # a box of one number would not pass for one
            "compass": box(-np.pi, np.pi, (1,), np.float32),
            "gps": box(-_FAR, _FAR, (2,), np.float32),
        }
    )


def action_space() -> gymnasium.spaces.Discrete:
    """Actions by Habitat's numbers: stop 0, move_forward 1, turn_left 2, turn_right 3."""
    return gymnasium.spaces.Discrete(len(ACTIONS))


def observations(
    sight: AgentView, goals: Sequence[int] | NDArray[np.int64], yaw: Array, start_yaw: Array, position: Array, start: Array,
    direction: Array, config: SimulationConfig,
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """What agents observe, one behind another, shape (n, ...) each.

    Args:
        sight: What all see, n by height by width. Its arrays become those of the observation, the depth normalized in place.
        goals: Categories of their targets by number, shape (n,).
        yaw: Their headings, shape (n,) [rad].
        start_yaw: Those at their starts, shape (n,) [rad].
        position: Where they are, shape (n, 2) [m].
        start: Where they started, shape (n, 2) [m].
        direction: Unit vectors of the headings at the start, shape (n, 2).
        config: Of the camera.
    """
    normalize_depth(sight.depth, config)
    return {
        "rgb": sight.rgb,
        "depth": sight.depth[..., None],
        "semantic": sight.semantic[..., None],
        "objectgoal": np.array(goals, dtype=np.int64)[:, None],
        "compass": compass(yaw, start_yaw),
        "gps": gps(position, start, direction),
    }
