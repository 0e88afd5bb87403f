"""Rows of the navigation stage: where an agent can go, and trajectories to learn from."""

from __future__ import annotations

from schemas.families.path_finders import PATH_FINDERS
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("navmeshes", key=("scene_id", "agent"), stage="navigation")
class Navmesh:
    """The navigable floor of a scene for one agent."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    agent: str = column("Name of the agent's shape")
    agent_radius_m: float = column("Radius of the agent", unit="m", minimum=0)
    agent_height_m: float = column("Height of the agent", unit="m", minimum=0)
    navmesh_blob: str = column("Navmesh, habitat-sim's .navmesh format, glTF frame", blob=True)
    area_m2: float = column("Navigable area", unit="m2", minimum=0)
    largest_island_m2: float = column("Area of the largest connected part", unit="m2", minimum=0)
    island_count: int = column("Connected parts", minimum=0)
    path_finder: str = column("Path finder that made it; imported is unknown, of a finished dataset", values=(*PATH_FINDERS, "imported"))


@record("episodes", key=("scene_id", "episode_id"), stage="navigation")
class Episode:
    """A trajectory from a random navigable start to a random object (supplementary B.3)."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    episode_id: str = column("Episode, zero-padded, unique in the scene", pattern=r"[0-9]{4,}")
    agent: str = column("Agent whose navmesh was used")
    split: str = column("Split of the room", values=("train", "test"))
    instance_id: str = column("Target", pattern=INSTANCE_PATTERN)
    category: str = column("Category of the target")
    instruction: str = column("What the agent is told")
    start_position: tuple[float, ...] = column("Start on the floor in the world frame", unit="m", length=3)
    start_yaw_radians: float = column("Heading at the start, about +Z from +X", unit="rad")
    goal_position: tuple[float, ...] = column("View point of the target that the path ends at, world frame", unit="m", length=3)
    view_points: tuple[tuple[float, ...], ...] = column("View points of the target: x, y, z, yaw towards the target", unit="m, rad")
    geodesic_m: float = column("Length of the shortest path", unit="m", minimum=0)
    euclidean_m: float = column("Straight distance from start to goal", unit="m", minimum=0)
    path: tuple[tuple[float, ...], ...] = column("Corners of the shortest path (x, y) in the world frame", unit="m")
    actions: tuple[str, ...] = column("Actions: forward 0.25 m, left and right 30 degrees, stop last")
    final_position: tuple[float, ...] = column("Where the replayed actions end, world frame", unit="m", length=3)
    final_distance_m: float = column("Distance from there to the goal", unit="m", minimum=0)
    path_finder: str = column("Path finder that found it", values=PATH_FINDERS)


@record("unreachable_targets", key=("scene_id", "instance_id"), stage="navigation")
class UnreachableTarget:
    """An object that no episode could be made for, and why."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    reason: str = column("Why no view point can be reached")


@record("splits", key=("room_id",), stage="navigation", grain="room", rule="share", shared_by="scenes")
class Split:
    """Train or test, by room, so that rescans never leak; a stable hash of the room's name without its dataset decides, 4:1."""

    room_id: str = column("Physical room, or dwelling of several", pattern=SCENE_PATTERN)
    split: str = column("Split", values=("train", "test"))
