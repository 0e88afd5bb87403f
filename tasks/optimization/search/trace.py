"""Traces: every step of an optimization, and how the optimized poses follow from them, bit for bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.optimization import APPLIED, OptimizationStep, Placement, Support
from tasks.geometry.transforms import rotation_of
from tasks.optimization.interior import Interior
from tasks.optimization.support.supports import descendants

Array = NDArray[np.float64]


Move = tuple[float, float, float, float, float, float]
"""A shift [m] and a turn about the object's own origin as a rotation vector [rad], both along the world's axes."""


@dataclasses.dataclass(frozen=True)
class SearchStep:
    """One step. move: how the object, with all it carries, was moved. loss, smallest: after it, in the method's unit.
    number: of the move; 0 before the first and after the last."""

    name: str
    move: Move
    loss: float
    smallest: float
    outcome: str
    number: int = 0


@dataclasses.dataclass(frozen=True)
class Resolution:
    """What a method came to: its steps, the loss at rest and in the end in the method's unit, how many moves were tried
    by how many chains, why it ended (as `optimizations.ended` has it), what could not be put right, a line each, the
    same by object, the interior where it was found that other objects carry some than was thought, and those, a line each.
    settled: the loss before anything was put elsewhere as a last resort."""

    steps: tuple[SearchStep, ...]
    start: float
    final: float
    tried: int
    chains: int
    ended: str
    notes: tuple[str, ...]
    problems: Mapping[str, str]
    interior: Interior | None = None
    noted: tuple[str, ...] = ()
    settled: float = 0.0


def with_falls(resolution: Resolution, falls: Sequence[tuple[str, Move]], final: float) -> Resolution:
    """A resolution after which objects fell to where they stay, by moves of single ones, in order: no more problem of theirs is left.

    final: the loss after that, in the method's unit.
    """
    smallest = min([step.smallest for step in resolution.steps] + [final], default=resolution.start)
    steps = [SearchStep(name, move, final, smallest, "fallen") for name, move in falls]
    if final == 0.0 < resolution.final:
        resolution = dataclasses.replace(resolution, ended="zero_loss", notes=())
    problems = {name: text for name, text in resolution.problems.items() if name not in dict(falls)}
    return dataclasses.replace(resolution, steps=(*resolution.steps, *steps), problems=problems, final=final)


def with_shifts(resolution: Resolution, shifts: Sequence[tuple[str, Move]]) -> Resolution:
    """A resolution after which objects were shifted out of slight overlaps, by moves in order; the loss does not count those."""
    smallest = min([step.smallest for step in resolution.steps] + [resolution.final], default=resolution.start)
    steps = [SearchStep(name, move, resolution.final, smallest, "rested") for name, move in shifts]
    return dataclasses.replace(resolution, steps=(*resolution.steps, *steps))


def step_rows(scene_id: str, start: float, steps: Sequence[SearchStep]) -> list[OptimizationStep]:
    """Step 0 for the proposed state, then a row per step, numbered without a gap where no moves were left out."""
    rows = [
        OptimizationStep(
            scene_id=scene_id, step=0, instance_id=None, dx_m=0.0, dy_m=0.0, dz_m=0.0, turn_x_radians=0.0, turn_y_radians=0.0,
            turn_z_radians=0.0, loss=start, smallest_loss=start, outcome="start",
        )
    ]  # fmt: skip
    ahead, last = 0, 0
    for step in steps:
        # steps before the first move and after the last have numbers of their own
        if step.number == 0:
            last += 1
            ahead = last
        else:
            last = max(last + 1, ahead + step.number)
        dx, dy, dz, tx, ty, tz = (value + 0.0 for value in step.move)
        rows.append(
            OptimizationStep(
                scene_id=scene_id, step=last, instance_id=step.name, dx_m=dx, dy_m=dy, dz_m=dz,
                turn_x_radians=tx, turn_y_radians=ty, turn_z_radians=tz, loss=step.loss, smallest_loss=step.smallest, outcome=step.outcome,
            )
        )  # fmt: skip
    return rows


def replayed_poses(placements: Sequence[Placement], supports: Sequence[Support], steps: Sequence[OptimizationStep]) -> dict[str, Array]:
    """Optimized poses [m], 4x4 by instance id, from the proposed ones, what carries what, and the steps: bit for bit
    those of the placements. What an object carries moves along."""
    moves = [
        (row.instance_id, (row.dx_m, row.dy_m, row.dz_m, row.turn_x_radians, row.turn_y_radians, row.turn_z_radians))
        for row in sorted(steps, key=lambda s: s.step)
        if row.outcome in APPLIED and row.instance_id is not None
    ]
    poses = {row.instance_id: np.reshape(np.asarray(row.proposed_pose, dtype=np.float64), (4, 4)) for row in placements}
    return moved_poses(poses, {row.instance_id: row.parent_id for row in supports}, moves)


def moved_poses(poses: Mapping[str, Array], parents: Mapping[str, str | None], moves: Sequence[tuple[str, Move]]) -> dict[str, Array]:
    """Poses [m], 4x4 by name, after moves of single objects, in order; what an object carries moves along rigidly.

    A move turns about the object's own origin by a rotation vector [rad], then shifts [m], both in the world frame.
    """
    below = descendants(parents)
    turned = {name: np.array(pose[:3, :3], dtype=np.float64) for name, pose in poses.items()}
    place = {name: [float(v) for v in pose[:3, 3]] for name, pose in poses.items()}
    for name, (dx, dy, dz, *turn) in moves:
        group = [name, *sorted(below.get(name, ()))]
        if any(turn):
            rotation, (ox, oy, oz) = rotation_of(turn), place[name]
            for other in group:
                x, y, z = rotation @ np.array([place[other][0] - ox, place[other][1] - oy, place[other][2] - oz])
                place[other] = [ox + float(x), oy + float(y), oz + float(z)]
                turned[other] = rotation @ turned[other]
        for other in group:
            own = place[other]
            own[0], own[1], own[2] = own[0] + dx, own[1] + dy, own[2] + dz
    moved = {}
    for name in poses:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned[name], place[name]
        moved[name] = pose
    return moved
