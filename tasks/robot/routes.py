"""Ways that policies took, as carts drive them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from schemas.evaluation import Trajectory


@dataclasses.dataclass(frozen=True)
class DriveBatch:
    """Ways in one scene, of one trajectory batch, that a cart drives together. setup: What is not as by default, in a line."""

    batch_id: str
    scene_id: str
    ways: tuple[Trajectory, ...]
    setup: str = ""


def spread_ways(trajectories: Sequence[Trajectory], count: int) -> tuple[Trajectory, ...]:
    """So many of a scene's trajectories, evenly over its episodes in their order; all where there are no more.

    What never left its start is no way, and is not among them.
    """
    left = sorted((row for row in trajectories if row.travelled_m > 0), key=lambda row: row.episode_id)
    if len(left) <= count:
        return tuple(left)
    return tuple(left[index * len(left) // count] for index in range(count))
