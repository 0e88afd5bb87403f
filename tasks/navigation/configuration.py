"""What the navigation stage can be told."""

from __future__ import annotations

import dataclasses
import math
from typing import TypeAlias

from tasks.navigation.follower import Motion
from tasks.navigation.navmesh import Settings


@dataclasses.dataclass(frozen=True)
class Agent:
    """Shape of the robot: an upright cylinder."""

    name: str = "cylinder_r18_h88"  # radius and height in centimetres
    radius_m: float = 0.18  # Habitat's object navigation on HSSD: a small mobile base
    height_m: float = 0.88  # the same; lower than a door handle, higher than a table, so tables block
    max_climb_m: float = 0.2  # Habitat's default: rugs and slippers are driven over; another value makes Habitat bake anew

    def __post_init__(self) -> None:
        if not (0 < self.radius_m < math.inf and math.inf > self.height_m > self.max_climb_m >= 0):
            raise ValueError("agent: radius must be positive, and height above max_climb_m")


@dataclasses.dataclass(frozen=True)
class PlanarConfig:
    """Exact shortest paths in the free polygon of the floor. Needs nothing but Python packages."""

    smallest_island_m2: float = 0.0625  # the square of one step: on less floor no step can be made

    def __post_init__(self) -> None:
        if not 0 <= self.smallest_island_m2 < math.inf:
            raise ValueError(f"smallest_island_m2: must be at least 0, is {self.smallest_island_m2:g}")


@dataclasses.dataclass(frozen=True)
class Voxels:
    """How a navmesh is baked. Lengths are habitat-sim's own: habitat-lab asks for them, and any other makes it bake anew, silently."""

    cell_size_m: float = 0.05  # habitat-sim's default; walls and furniture grow by the agent's radius, rounded up to cells
    cell_height_m: float = 0.2  # the same, and the agent's climb: one layer of voxels is climbed
    max_slope_degrees: float = 45.0  # the same
    region_min_cells: float = 20.0  # the same: parts of less than 20 x 20 cells (1 m2) are dropped
    region_merge_cells: float = 20.0  # the same
    edge_max_length_m: float = 12.0  # the same: longer outlines are cut, which no room's is
    edge_max_error_cells: float = 1.3  # the same: an outline may cut corners by 6.5 cm
    detail_sample_cells: float = 6.0  # the same; heights only
    detail_max_error_cells: float = 1.0  # the same; heights only

    def __post_init__(self) -> None:
        for name in ("cell_size_m", "cell_height_m", "edge_max_length_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0, is {getattr(self, name):g}")
        for name in ("region_min_cells", "region_merge_cells", "edge_max_error_cells", "detail_sample_cells", "detail_max_error_cells"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be at least 0, is {getattr(self, name):g}")
        if not 0 <= self.max_slope_degrees < 90:
            raise ValueError(f"max_slope_degrees: must be 0 to 90, is {self.max_slope_degrees:g}")


@dataclasses.dataclass(frozen=True)
class RecastConfig(Voxels):
    """Navmesh and paths as habitat-sim makes them, by the library that `make native` builds."""


@dataclasses.dataclass(frozen=True)
class HabitatConfig(Voxels):
    """Navmesh and paths by habitat-sim itself, where it is installed: the paper's path finder."""


PathFinderConfig: TypeAlias = PlanarConfig | RecastConfig | HabitatConfig
"""The path finders there are, one config each; a run picks one by the type of its config."""


@dataclasses.dataclass(frozen=True)
class NavigationConfig:
    """Agent, path finder and episodes."""

    agent: Agent = dataclasses.field(default_factory=Agent)
    path_finder: PathFinderConfig = dataclasses.field(default_factory=PlanarConfig)
    forward_m: float = 0.25  # the paper's action space, and Habitat's default
    turn_degrees: float = 30.0  # the same
    train_episodes: int = 100  # supplementary B.3: 100 trajectories in each training scene
    test_episodes: int = 50  # supplementary B.3: and 50 in each test scene
    test_share: float = 0.2  # supplementary B.3: training and test rooms 4:1
    success_m: float = 0.2  # Habitat's point navigation; steps of 0.25 m cannot always end within its 0.1 m for objects
    stop_m: float = 0.1875  # three quarters of a step, as Habitat's follower: a margin under success_m that every approach can meet
    max_steps: int = 500  # Habitat's limit for both navigation tasks
    min_geodesic_m: float = 1.0  # shorter ones need no navigation; Habitat's sampler has the same limit
    shortest_geodesic_m: float = 0.25  # in small rooms the limit is halved down to this, one step, and the halving is recorded
    max_path_ratio: float = 1.5  # travelled over shortest; an expert that wanders teaches wandering
    start_tries: int = 20  # starts drawn per target before its limit is halved; each costs a third of a millisecond
    view_reach_m: float = 1.0  # Habitat's object navigation: view points lie within a metre of the object
    view_spacing_m: float = 0.25  # one step: closer view points would not be told apart
    view_directions: int = 12  # at least one per heading, around objects however small
    search_expansions: int = 400  # of the searches that can succeed 49 in 50 do so within this many states (six crowded rooms)

    def __post_init__(self) -> None:
        for name in ("forward_m", "turn_degrees", "view_reach_m", "view_spacing_m", "success_m", "min_geodesic_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0, is {getattr(self, name):g}")
        for name, least in (
            ("train_episodes", 0), ("test_episodes", 0), ("max_steps", 1),
            ("start_tries", 1), ("view_directions", 1), ("search_expansions", 0),
        ):  # fmt: skip
            if getattr(self, name) < least:
                raise ValueError(f"{name}: must be at least {least}, is {getattr(self, name)}")
        if not 0 <= self.test_share <= 1:
            raise ValueError(f"test_share: must be 0 to 1, is {self.test_share:g}")
        if not self.max_path_ratio >= 1:
            raise ValueError(f"max_path_ratio: must be at least 1, is {self.max_path_ratio:g}")
        if abs(round(360 / self.turn_degrees) * self.turn_degrees - 360) > 1e-9:
            raise ValueError(f"turn_degrees: {self.turn_degrees:g} does not divide a full turn")
        if not 0 < self.stop_m <= self.success_m:
            raise ValueError("stop_m: must be positive and at most success_m")
        if not 0 < self.shortest_geodesic_m <= self.min_geodesic_m:
            raise ValueError("shortest_geodesic_m: must be positive and at most min_geodesic_m")

    @property
    def settings(self) -> Settings:
        """Header of the navmesh: what habitat-lab asks for with this agent, unless voxels were changed."""
        agent, voxels = self.agent, self.path_finder if isinstance(self.path_finder, Voxels) else Voxels()
        return Settings(
            cell_size=voxels.cell_size_m,
            cell_height=voxels.cell_height_m,
            agent_height=agent.height_m,
            agent_radius=agent.radius_m,
            agent_max_climb=agent.max_climb_m,
            agent_max_slope=voxels.max_slope_degrees,
            region_min_size=voxels.region_min_cells,
            region_merge_size=voxels.region_merge_cells,
            edge_max_length=voxels.edge_max_length_m,
            edge_max_error=voxels.edge_max_error_cells,
            detail_sample_distance=voxels.detail_sample_cells,
            detail_sample_max_error=voxels.detail_max_error_cells,
        )

    @property
    def motion(self) -> Motion:
        """What one action does."""
        return Motion(self.forward_m, math.radians(self.turn_degrees))
