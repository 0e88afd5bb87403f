"""Settings of the navigation stage."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from tasks.navigation.follower import Motion
from tasks.navigation.navmesh import Settings
from tasks.navigation.path_finders import PATH_FINDERS
from tasks.navigation.voxels import Voxels
from tasks.settings import Config, Count, Natural, NonNegative, Positive, Share, union_of

if TYPE_CHECKING:
    PathFinderConfig = Config
else:
    PathFinderConfig = union_of(finder.config for finder in PATH_FINDERS)


@dataclasses.dataclass(frozen=True)
class Agent(Config):
    """Shape of the robot: an upright cylinder."""

    name: str = "cylinder_r18_h88"  # radius and height in centimetres
    radius_m: Positive = 0.18  # Habitat's object navigation on HSSD: a small mobile base
    height_m: Positive = 0.88  # Habitat's object navigation on HSSD; lower than a door handle, higher than a table, so tables block
    max_climb_m: NonNegative = 0.2  # Habitat's default: rugs and slippers are driven over; another value makes Habitat bake anew

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.height_m <= self.max_climb_m:
            raise ValueError(f"height_m: must be above max_climb_m, {self.max_climb_m:g}, is {self.height_m:g}")
        return self


@dataclasses.dataclass(frozen=True)
class NavigationConfig(Config):
    """Agent, path finder and episodes."""

    agent: Agent = dataclasses.field(default_factory=Agent)
    path_finder: PathFinderConfig = dataclasses.field(default_factory=PATH_FINDERS[0].config)  # needs no native library
    forward_m: Positive = 0.25  # the paper's action space, and Habitat's default
    turn_degrees: Positive = 30.0  # the paper's action space, and Habitat's default
    train_episodes: Natural = 100  # supplementary B.3: 100 trajectories in each training scene
    test_episodes: Natural = 50  # supplementary B.3: and 50 in each test scene
    test_share: Share = 0.2  # supplementary B.3: training and test rooms 4:1
    success_m: Positive = 0.2  # Habitat's point navigation; steps of 0.25 m cannot always end within its 0.1 m for objects
    stop_m: Positive = 0.1875  # three quarters of a step, as Habitat's follower: a margin under success_m that every approach can meet
    max_steps: Count = 500  # Habitat's limit for both navigation tasks
    min_geodesic_m: Positive = 1.0  # shorter ones need no navigation; Habitat's sampler has the same limit
    shortest_geodesic_m: Positive = 0.25  # in small rooms the limit is halved down to this, one step, and the halving is recorded
    max_path_ratio: Annotated[float, Field(ge=1)] = 1.5  # travelled over shortest; an expert that wanders teaches wandering
    start_tries: Count = 20  # starts drawn per target before its limit is halved; each costs a third of a millisecond
    view_reach_m: Positive = 1.0  # Habitat's object navigation: view points lie within a metre of the object
    view_spacing_m: Positive = 0.25  # one step: closer view points would not be told apart
    view_directions: Count = 12  # at least one per heading, around objects however small
    search_expansions: Natural = 400  # of the searches that can succeed 49 in 50 do so within this many states (six crowded rooms)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if abs(math.remainder(360, self.turn_degrees)) > 1e-9:
            raise ValueError(f"turn_degrees: {self.turn_degrees:g} does not divide a full turn")
        if self.stop_m > self.success_m:
            raise ValueError(f"stop_m: must be at most success_m, {self.success_m:g}, is {self.stop_m:g}")
        if self.shortest_geodesic_m > self.min_geodesic_m:
            raise ValueError(
                f"shortest_geodesic_m: must be at most min_geodesic_m, {self.min_geodesic_m:g}, is {self.shortest_geodesic_m:g}"
            )
        return self

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
