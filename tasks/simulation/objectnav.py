"""Object navigation as Habitat has it, over any number of agents: what is sensed of the way, when it is won, and what is rewarded."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.simulation.configuration import SimulationConfig

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def compass(yaw: Array, start_yaw: Array) -> NDArray[np.float32]:
    """Habitat's episodic compass: how far to the left of its first heading each agent looks [rad], from -pi to pi, shape (n, 1)."""
    turned = yaw - start_yaw
    return (turned - 2 * np.pi * np.rint(turned / (2 * np.pi))).astype(np.float32)[:, None]


def gps(position: Array, start: Array, direction: Array) -> NDArray[np.float32]:
    """Habitat's episodic GPS: how far ahead of its start, and how far to the right of it, each agent is, as it was heading there [m],
    shape (n, 2). `direction`: the unit vectors of those headings, shape (n, 2)."""
    (x, y), (c, s) = (position - start).T, direction.T
    return np.stack([c * x + s * y, s * x - c * y], axis=1).astype(np.float32)


def normalize_depth(depth: NDArray[np.float32], config: SimulationConfig) -> None:
    """Turn metres, in place, into what Habitat makes of them: 0 at `min_depth_m`, nearer, and where nothing is, 1 at `max_depth_m` and
    beyond."""
    _compiled()["_normalize"](depth.reshape(-1), np.float32(config.min_depth_m), np.float32(config.max_depth_m))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_normalize)


def _normalize(depth: NDArray[np.float32], low: np.float32, high: np.float32) -> None:
    """In one pass: three of NumPy take twice as long, and more where they ask for memory."""
    for i in range(len(depth)):
        depth[i] = (min(max(depth[i], low), high) - low) / (high - low)


class Course:
    """How the episodes of `count` agents go. Every array has an entry for each.

    start_m: Distance to the goal at the start [m]. distance_m: Now [m]. travelled_m: Length of the way so far [m]. steps, collisions:
    Counts. succeeded: The agent stopped of its own accord where it should.
    """

    def __init__(self, count: int, config: SimulationConfig) -> None:
        self.config = config
        self.start_m, self.distance_m, self.travelled_m = np.zeros(count), np.zeros(count), np.zeros(count)
        self.steps, self.collisions = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.succeeded = np.zeros(count, dtype=np.bool_)

    def begin(self, index: int, distance_m: float) -> None:
        """An episode of one agent begins, so far from its goal [m]."""
        self.start_m[index] = self.distance_m[index] = distance_m
        self.travelled_m[index] = 0.0
        self.steps[index] = self.collisions[index] = 0
        self.succeeded[index] = False

    def advance(
        self, moved_m: Array, distance_m: Array, collided: Flags, called_stop: Flags, sees: Flags, active: Flags
    ) -> tuple[Array, Flags, Flags]:
        """An action of every agent: rewards, who ended its episode by a stop, and whose episode was ended for its length, shape (n,) each.

        The reward is what the distance to the goal became less by, minus `slack_reward`, plus `success_reward` for a success: over an
        episode the first sums up to the distance at the start minus that at the end.

        Args:
            moved_m: How far each moved [m], shape (n,).
            distance_m: How far it is to the goal from there [m], shape (n,).
            collided: Whose step met an obstacle, shape (n,).
            called_stop: Who stopped, shape (n,).
            sees: Who has the target in view; looked at where somebody stops and `must_see` asks for it, shape (n,).
            active: Who acted; nothing changes for the others, shape (n,).
        """
        config, stopped = self.config, called_stop & active
        self.steps += active
        self.collisions += collided & active
        self.travelled_m += np.where(active, moved_m, 0.0)
        won = stopped & (distance_m < config.success_m) & (sees | (not config.must_see))
        rewards = self.distance_m - distance_m - config.slack_reward + config.success_reward * won
        self.succeeded = np.where(active, won, self.succeeded)
        self.distance_m = np.where(active, distance_m, self.distance_m)
        return np.where(active, rewards, 0.0), stopped, active & ~stopped & (self.steps >= config.max_steps)

    def measures(self) -> dict[str, NDArray[np.generic]]:
        """Habitat's measures, by its names, shape (n,) each: `distance_to_goal` [m], `success`, `spl`, `soft_spl`, `num_steps` and
        `collisions` so far. An agent that starts at its goal and stays there is as good as the best (Habitat has no number for it)."""
        longest = np.maximum(self.start_m, self.travelled_m)
        share = np.divide(self.start_m, longest, out=np.ones_like(longest), where=longest > 0)
        nearer = np.divide(self.distance_m, self.start_m, out=(self.distance_m > 0).astype(np.float64), where=self.start_m > 0)
        won = self.succeeded.astype(np.float64)
        return {
            "distance_to_goal": self.distance_m.copy(), "success": won, "spl": won * share,
            "soft_spl": np.maximum(0.0, 1.0 - nearer) * share, "num_steps": self.steps.copy(), "collisions": self.collisions.copy(),
        }  # fmt: skip
