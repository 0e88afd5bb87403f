"""Exported scenes left alone under gravity in MuJoCo, by nothing but their files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.optimization import Certificate
from tasks.optimization.engines.mujoco_engine import mujoco_module


@dataclasses.dataclass(frozen=True)
class Settled:
    """Where a free body ends. displacement: of its origin [m]. tilt: of its upright axis [rad]. place: of its origin [m], (3,)."""

    displacement: float
    tilt: float
    place: NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Unstable:
    """Free objects that moved farther than certificates allow: 1 cm, and 5 cm, or 5 degrees each; by instance."""

    at_1cm: frozenset[str]
    at_5cm: frozenset[str]


def left_alone(model: Any, seconds: float) -> dict[str, Settled]:
    """What the free bodies of a compiled MuJoCo model do in so many seconds, by the body's name.

    Raises:
        ValueError: a state is not finite, or too large for MuJoCo, which would begin anew from the start.
    """
    mujoco = mujoco_module()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    free = [int(model.jnt_bodyid[joint]) for joint in range(model.njnt) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE]
    start, upright = data.xpos[free].copy(), data.xmat[free].reshape(-1, 3, 3)[:, :, 2].copy()
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_kinematics(model, data)
    place, axes = data.xpos[free], data.xmat[free].reshape(-1, 3, 3)[:, :, 2]
    which = mujoco.mjtWarning
    astray = any(data.warning[kind].number for kind in (which.mjWARN_BADQPOS, which.mjWARN_BADQVEL, which.mjWARN_BADQACC))
    if astray or not np.isfinite(place).all():
        raise ValueError("the state diverges")
    moved = np.linalg.norm(place - start, axis=1)
    tilt = np.arccos(np.clip(np.einsum("ij,ij->i", upright, axes), -1.0, 1.0))
    return {model.body(body).name: Settled(float(moved[i]), float(tilt[i]), place[i].copy()) for i, body in enumerate(free)}


def unstable_of(settled: Mapping[str, Settled]) -> Unstable:
    """The objects among settled bodies, whose names end in `_<instance>`, that certificates would call unstable."""
    tilted = frozenset(instance_of(name) for name, pose in settled.items() if pose.tilt > math.radians(5.0))
    return Unstable(*(tilted | {instance_of(name) for name, pose in settled.items() if pose.displacement > far} for far in (0.01, 0.05)))


def certified_unstable(certificates: Iterable[Certificate]) -> Unstable:
    """What MuJoCo's certificates of a scene say."""
    free = [row for row in certificates if row.engine == "mujoco" and not row.is_fixed]
    return Unstable(
        frozenset(row.instance_id for row in free if not row.is_stable_1cm),
        frozenset(row.instance_id for row in free if not row.is_stable_5cm),
    )


def farthest_apart(settled: Mapping[str, Settled], certificates: Iterable[Certificate]) -> float:
    """Greatest distance between where a free body ends and where its certificate has it end [m]; 0 without bodies."""
    ends = {row.instance_id: row.settled_pose for row in certificates if row.engine == "mujoco" and not row.is_fixed}
    apart = 0.0
    for name, settled_pose in settled.items():
        pose = ends.get(instance_of(name))
        if pose is not None:
            apart = max(apart, float(np.linalg.norm(settled_pose.place - np.asarray(pose).reshape(4, 4)[:3, 3])))
    return apart


def instance_of(name: str) -> str:
    """Instance of a body that is named `<category>_<instance>`."""
    return name.rsplit("_", 1)[-1]
