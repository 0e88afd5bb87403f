"""Rows of the evaluation stage: what agents did in episodes."""

from __future__ import annotations

from schemas.families.path_finders import PATH_FINDERS
from schemas.families.policies import POLICIES
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

ACTIONS = ("forward", "left", "right", "stop")
"""What an agent of the paper can do: 0.25 m forward, 30 degrees left or right, stop."""


@record(
    "trajectories", key=("batch_id", "scene_id", "episode_id"), stage="evaluation", grain="trajectory_batch", rule="append"
)  # fmt: skip
class Trajectory:
    """An episode as a policy carried it out. All that metrics need is copied here: a later change of the episode changes no metric."""

    batch_id: str = column("Trajectory batch: one policy's trajectories, imported together", pattern=r"[A-Za-z0-9][A-Za-z0-9_.-]*")
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    episode_id: str = column("Episode as it was then", pattern=r"[0-9]{4,}")
    policy: str = column(f"Who chose the actions: a model, or the built-in {' or '.join(map(repr, POLICIES))}")
    run_name: str = column("Run of the policy: a checkpoint, a seed; several batches may belong to one")
    agent: str = column("Agent whose navmesh was used")
    split: str = column("Split of the room", values=("train", "test"))
    instance_id: str = column("Target of the episode", pattern=INSTANCE_PATTERN)
    category: str = column("Category of the target")
    start_position: tuple[float, ...] = column("Start of the episode on the floor in the world frame", unit="m", length=3)
    start_yaw_radians: float = column("Heading at the start of the episode, about +Z from +X", unit="rad")
    actions: tuple[str, ...] = column("Actions that were executed: forward, left, right, stop")
    poses: tuple[tuple[float, ...], ...] = column(
        "Pose before the first action and after every action: x, y, yaw about +Z from +X; world frame", unit="m, rad"
    )
    called_stop: bool = column("Whether the last action is stop; without it no episode succeeds")
    collisions: int = column("Forward steps that met an obstacle", minimum=0)
    travelled_m: float = column("Length of the way along the poses", unit="m", minimum=0)
    start_distance_m: float = column("Geodesic distance from the episode's start to the nearest view point", unit="m", minimum=0)
    final_distance_m: float | None = column(
        "Geodesic distance from the last pose to the nearest view point; missing when it lies off the navmesh or has no path there",
        unit="m", minimum=0,
    )  # fmt: skip
    is_target_seen: bool | None = column(
        "Whether the target is in a level picture from the last pose; missing where the scene cannot be drawn, or the target is not in it"
    )
    success_distance_m: float = column("Stopped nearer than this to a view point, the agent has arrived", unit="m", minimum=0)
    expert_actions: int = column("Actions of the episode's expert, stop included", minimum=0)
    path_finder: str = column("Path finder that measured the distances", values=PATH_FINDERS)
    problem: str | None = column("What is odd about the trajectory, in a line: poses off the navmesh, an end without a path")
    source_file: str | None = column("File that it came from; missing for built-in policies")
