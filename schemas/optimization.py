"""Rows of the optimization stage: where every asset ends up, and how it got there."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("placements", key=("scene_id", "instance_id"), stage="optimization")
class Placement:
    """The asset that stands for an instance, its proposed and its optimized pose."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    asset_id: str = column("Asset", pattern=r"[0-9a-f]{64}")
    origin: str = column("Who proposed it", values=("annotation", "selection"))
    annotator: str | None = column("Annotator whose answer won")
    annotation_match: str | None = column("How the annotation was matched to the instance", values=("same_box", "box_iou"))
    scale: tuple[float, ...] = column("Scale along the asset's own axes, applied before the pose", length=3, minimum=0.001)
    proposed_pose: tuple[float, ...] = column("Asset to world frame as proposed, 4x4 row by row", unit="m", length=16)
    optimized_pose: tuple[float, ...] = column("Asset to world frame after optimization, 4x4 row by row", unit="m", length=16)
    displacement_m: float = column("Horizontal distance between the proposed and the optimized pose", unit="m", minimum=0)
    lift_m: float = column("Optimized height minus proposed height", unit="m")
    method: str = column("Optimization method", values=("paper", "default"))


@record("supports", key=("scene_id", "instance_id"), stage="optimization")
class Support:
    """What carries an instance."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Carried instance", pattern=INSTANCE_PATTERN)
    relation: str = column("How it is carried", values=("floor", "on", "wall", "ceiling", "none"))
    parent_id: str | None = column("Carrying instance for 'on'", pattern=INSTANCE_PATTERN)
    gap_m: float = column("Height of the proposed asset's bottom above what carries it; negative when it sinks in", unit="m")


@record("contacts", key=("scene_id", "phase", "instance_a", "instance_b"), stage="optimization")
class Contact:
    """Two instances whose boxes overlap, before or after optimization."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    phase: str = column("Pose that was tested", values=("proposed", "optimized"))
    instance_a: str = column("First instance of the pair, the smaller id", pattern=INSTANCE_PATTERN)
    instance_b: str = column("Second instance of the pair", pattern=INSTANCE_PATTERN)
    overlap_m3: float = column("Volume of the overlap of the axis-aligned boxes", unit="m3", minimum=0)
    penetration_m: float = column("Least movement along one axis that parts the boxes", unit="m", minimum=0)


@record("optimization_steps", key=("scene_id", "step"), stage="optimization")
class OptimizationStep:
    """One step of the optimization. Replaying the kept moves gives the optimized poses."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    step: int = column("Step, 0 is the proposed state", minimum=0)
    instance_id: str | None = column("Moved instance; missing for step 0", pattern=INSTANCE_PATTERN)
    dx_m: float = column("Move along x", unit="m")
    dy_m: float = column("Move along y", unit="m")
    loss: float = column("Collision loss after the move (equation A1)", unit="m3", minimum=0)
    smallest_loss: float = column("Smallest loss so far, this step included", unit="m3", minimum=0)
    outcome: str = column("What became of the move", values=("start", "kept", "reverted", "left_room", "left_support"))
