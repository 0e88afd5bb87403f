"""Settings of the exports."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import model_validator

from schemas.families.export_formats import EXPORT_FORMATS
from tasks.geometry.pieces import PieceConfig
from tasks.optimization.engines.mujoco_engine import Mujoco
from tasks.settings import LISTED, Config, Natural, NonNegative, Positive, Share
from tasks.shell import ShellConfig

if TYPE_CHECKING:
    Formats = tuple[str, ...]
else:
    Formats = Annotated[tuple[Literal[EXPORT_FORMATS], ...], LISTED]


@dataclasses.dataclass(frozen=True)
class UsdConfig(Config):
    """USD with physics."""

    instanceable: bool = False  # instances share memory, but Isaac tools cannot edit a collider or material under them
    deformables: bool = True  # cloth and soft bodies get a variant `physics` = `deformable`; `rigid` stays selected
    crease_radians: float = 0.6  # about 35 degrees: edges sharper than this stay sharp when shaded
    gravity_m_s2: float = 9.81  # standard gravity, rounded as engines do
    max_depenetration_m_s: Positive = 0.1  # PhysX: micrometers of overlap leave gently; at its default of 3 a quarter of a room jumps


@dataclasses.dataclass(frozen=True)
class HabitatConfig(Config):
    """Habitat dataset with episodes."""

    dataset: str = "metascenes"  # name of the dataset's config file and of its semantic lexicon
    dataset_folder: str = "data/scene_datasets/metascenes"  # where habitat-lab finds the dataset, from where it is started
    motion_type: str = "STATIC"  # habitat-sim bakes only static objects into a navmesh; dynamic ones would be walked through
    agent: str | None = None  # whose navmesh and episodes are exported; none: the agent with the most episodes
    gravity_m_s2: float = 9.8  # habitat-sim's own default
    forward_m: float = 0.25  # what `forward` means in episodes (supplementary B.3), for the states along a path
    turn_degrees: float = 30.0  # what `left` and `right` mean in episodes (supplementary B.3)
    success_m: float = 0.2  # how near to a goal they end: steps of 0.25 m cannot always end within habitat-lab's 0.1 m for objects
    view_fov_degrees: float = 79.0  # camera of the ObjectNav challenge's agent, for the overlap of a view point
    view_aspect: float = 4.0 / 3.0  # 640 x 480


@dataclasses.dataclass(frozen=True)
class MjcfConfig(Config):
    """MuJoCo's own format."""

    engine: Mujoco = dataclasses.field(default_factory=Mujoco)  # what certificates are made with: the same objects stay in place
    gravity_m_s2: float = 9.81  # MuJoCo's own default, and the certificates'


@dataclasses.dataclass(frozen=True)
class Nav2Config(Config):
    """Maps of the floor for nav2's map_server."""

    resolution_m: Positive = 0.05  # nav2's own default, of its costmaps and of who makes maps
    lowest_m: NonNegative = 0.02  # what small robots drive over: rugs and thresholds; the agents of episodes climb more
    highest_m: Positive = 0.5  # a small mobile base with its sensors; a table is its legs, and what hangs on a wall is not in its way
    margin_cells: Natural = 4  # around the walls, unknown: planners and costmaps want to look over the edge
    closed_doors: bool = False  # a map that is made once is made with doors open; leaves in the simulators' scenes are shut

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.highest_m <= self.lowest_m:
            raise ValueError(f"highest_m: must be above lowest_m, {self.lowest_m:g}, is {self.highest_m:g}")
        return self


@dataclasses.dataclass(frozen=True)
class SdfConfig(Config):
    """Worlds for Gazebo."""

    timestep_s: Positive = 0.001  # Gazebo's own default
    gravity_m_s2: float = 9.81  # standard gravity, rounded as in the other formats
    ambient: Share = 0.4  # light from everywhere, Gazebo's own default: what lamps do not reach is seen


@dataclasses.dataclass(frozen=True)
class ExportsConfig(Config):
    """What is exported, and what physics is given where nothing is known."""

    formats: Formats = EXPORT_FORMATS  # all of them: a file nobody asked for costs less than a scene exported again
    pieces: PieceConfig = dataclasses.field(default_factory=PieceConfig)  # those of certificates: what is exported is what was certified
    shell: ShellConfig = dataclasses.field(default_factory=ShellConfig)
    usd: UsdConfig = dataclasses.field(default_factory=UsdConfig)
    habitat: HabitatConfig = dataclasses.field(default_factory=HabitatConfig)
    mjcf: MjcfConfig = dataclasses.field(default_factory=MjcfConfig)
    nav2: Nav2Config = dataclasses.field(default_factory=Nav2Config)
    sdf: SdfConfig = dataclasses.field(default_factory=SdfConfig)
    room_friction: float = 0.8  # painted plaster and varnished wood against furniture; between the tables' 0.5 and rubber's 1
    room_restitution: float = 0.05  # a room does not bounce
    default_density_kg_m3: float = 300.0  # of an object without a caption: light wood with hollows
    default_friction: float = 0.5  # of an object without a caption: wood on wood
    default_restitution: float = 0.1  # of an object without a caption: wood on wood
