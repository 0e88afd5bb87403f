"""Stacks of boxes of which it is known what carries what."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from tasks.geometry.transforms import yaw_pose
from tasks.micro_scenes.boxes import StandingBox, standing_box
from tasks.micro_scenes.carrying import CarriedBy

QUARTERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


@dataclasses.dataclass(frozen=True)
class Stack:
    """Upright boxes by instance: extents, pose of the middle of the bottom, what carries them, and the box at the bottom."""

    extents: dict[str, tuple[float, float, float]]
    poses: dict[str, np.ndarray]
    carried: dict[str, CarriedBy]
    roots: dict[str, str]

    @property
    def boxes(self) -> list[StandingBox]:
        return [standing_box(name, self.extents[name], (1.0, 1.0, 1.0), self.poses[name]) for name in self.extents]

    def depth(self, name: str) -> int:
        return 0 if name not in self.carried else 1 + self.depth(self.carried[name].parent)


@st.composite
def stacks(draw: st.DrawFn) -> Stack:
    """Some large boxes on a floor, apart from each other, with smaller ones on and in them, and smaller ones on and in those."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    stack = Stack({}, {}, {}, {})

    def put(pose: np.ndarray, size: Sequence[float], level: int, root: str, ceiling: float) -> str:
        name = f"{len(stack.extents) + 1:04d}"
        stack.extents[name], stack.poses[name] = tuple(map(float, size)), pose
        stack.roots[name] = root or name
        most = (4, 2, 1)[level] if level < 3 else 0
        quarters = rng.permutation(4)[: int(rng.integers(0, most + 1))]
        for quarter in quarters:
            side = 0.28 * min(size[:2])
            is_inside = bool(size[2] > 0.35 and rng.random() < 0.4)
            # what is inside begins above the bottom, and it and all that it carries end below the top, by more than any tolerance
            height = float(rng.uniform(0.2, 0.4) * size[2]) if is_inside else float(rng.uniform(0.2, 0.9))
            rise = float(rng.uniform(0.25, 0.35) * size[2]) if is_inside else float(size[2] + rng.uniform(-0.015, 0.015))
            least = min(ceiling, pose[2, 3] + 0.94 * size[2]) if is_inside else ceiling
            height = min(height, least - pose[2, 3] - rise)
            if height < 0.03:
                continue
            offset = [0.25 * size[0] * QUARTERS[quarter][0], 0.25 * size[1] * QUARTERS[quarter][1], rise]
            child_size = (*rng.uniform(0.6 * side, side, 2), height)
            child = put(pose @ yaw_pose(float(rng.uniform(-3.1, 3.1)), offset), child_size, level + 1, stack.roots[name], least)
            stack.carried[child] = CarriedBy(name, "inside" if is_inside else "on")
        return name

    for place in range(draw(st.integers(1, 2))):
        put(yaw_pose(float(rng.uniform(-3.1, 3.1)), [4.0 * place, 0.0, 0.0]), rng.uniform([0.5, 0.5, 0.5], [1.8, 1.8, 1.5]), 0, "", np.inf)
    return stack
