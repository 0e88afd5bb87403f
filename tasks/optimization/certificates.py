"""Certificates: whether objects stay where they were put, by a physics engine that had no part in putting them there, unless they fell."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from schemas.errors import InputError
from schemas.optimization import Certificate
from tasks.captions.physics import materials
from tasks.geometry.transforms import flat, is_rigid
from tasks.optimization.engines import mujoco_engine, newton_engine
from tasks.optimization.engines.mujoco_engine import Mujoco, Simulation
from tasks.optimization.engines.newton_engine import Newton
from tasks.optimization.solids import ConvexParts, RigidBody
from tasks.settings import Config, NonNegative, Positive
from tasks.stage import Spread, in_turn

Array = NDArray[np.float64]

NEAR_M = 0.01
"""What moved no farther has not moved [m]: a robot's grasp planned at the old place still succeeds. `is_stable_1cm` names it."""

FAR_M = 0.05
"""What moved no farther is where the scan saw it [m]: the noise of a scan's boxes. `is_stable_5cm` names it."""

FAR_TILT_RADIANS = float(np.deg2rad(5.0))
"""What tilted farther spills its coffee [rad]."""

SOFT: frozenset[str] = frozenset({"fabric", "foliage"})
"""Materials that are mostly air as they are used: stuffing, folds, leaves."""

SOLID_SHARE = 0.01
"""Share of a hollow object's volume that its material fills: a box of 60 cm with walls of 1 mm."""

SOFT_SHARE = 0.004
"""The same for stuffed and leafy objects: down at 5 kg/m3, of fiber at 1300."""


@dataclasses.dataclass(frozen=True)
class CertificateConfig(Config):
    """What a certificate asks."""

    mujoco: Mujoco = dataclasses.field(default_factory=Mujoco)  # always asked
    newton: Newton = dataclasses.field(default_factory=Newton)  # asked as well when its interpreter is named
    mujoco_defaults: bool = True  # asked as well: MuJoCo as others leave it; where the two differ, a verdict hangs on the solver
    nudge_m_s: NonNegative = 0.05  # a door that falls shut; who balances on an edge falls at 0.03, what stands well withstands 0.1; 0: none
    nudge_sleep_m_s: NonNegative = 0.001  # after a nudge, what is slower for 10 steps sleeps until it is touched: it would go 2 mm in 2 s
    seconds: Positive = 2.0  # a fall from a table takes 0.4 s; tipping begins slowly and takes longer

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, engine in (("mujoco", self.mujoco), ("newton", self.newton)):
            if self.seconds < engine.timestep_s:
                raise ValueError(f"seconds: must be at least {name}.timestep_s, {engine.timestep_s:g}, is {self.seconds:g}")
        return self


@dataclasses.dataclass(frozen=True)
class Certified:
    """What an engine says of an object: fields as in the table `certificates`.

    settled_pose: asset to world at the end, 4x4 [m]. displacement_m: of the asset's origin. tilt_radians: angle between the
    upright axes before and after; turning about that axis does not count. problem: why the engine could not simulate it;
    then these and start_penetration_m are None, and it is not stable. nudged_displacement_m, nudged_tilt_radians: the greatest after any
    of the nudges; None, as is_stable_nudged, where there were none. fallen_pose: asset to world at the end [m], 4x4, of the run in
    which it did not stay, left alone or else nudged where that took it farthest; None where it stays.
    """

    name: str
    engine: str
    engine_version: str
    simulated_seconds: float
    is_fixed: bool
    problem: str | None
    settled_pose: Array | None
    displacement_m: float | None
    tilt_radians: float | None
    start_penetration_m: float | None
    is_stable_1cm: bool
    is_stable_5cm: bool
    nudged_displacement_m: float | None
    nudged_tilt_radians: float | None
    is_stable_nudged: bool | None
    mass_kg: float
    solid_volume_m3: float
    density_kg_m3: float
    density_low_kg_m3: float | None
    density_high_kg_m3: float | None
    is_density_plausible: bool | None
    fallen_pose: Array | None = None


def certify(
    bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], config: CertificateConfig, spread: Spread = in_turn,
    asleep: Collection[int] = (),
) -> list[Certified]:  # fmt: skip
    """Certificates of objects at `poses`, asset to world [m], shape (n, 4, 4), in the order given; MuJoCo's first, then
    those of its defaults and Newton's when these are asked.

    They are left alone for `config.seconds` under gravity on the floor z = 0, among the walls `shell`; by MuJoCo again from
    the same poses with a nudge in each of four directions. Fixed objects do not move. The order of the bodies does not
    matter. An object that an engine refuses has a problem, no settled pose, is not stable, and is left out: what it carries
    falls. asleep: Bodies, by number, that MuJoCo lets stand as they are until something touches them.

    Raises:
        InputError: a pose is not rigid, two bodies have one name, a material is unknown, or Newton is not there.
    """
    poses = np.asarray(poses, dtype=np.float64).reshape(-1, 4, 4)
    names = [body.solid.name for body in bodies]
    if len(poses) != len(bodies) or len(set(names)) != len(names):
        raise InputError("certificates", "bodies", f"{len(bodies)} bodies, {len(set(names))} names, {len(poses)} poses", "give each one")
    for body, pose in zip(bodies, poses, strict=True):
        if not is_rigid(pose):
            raise InputError("placements", f"{body.solid.name} optimized_pose", "is no rigid pose", "run the optimization again")
    order = sorted(range(len(bodies)), key=lambda i: names[i])  # engines depend on it, certificates shall not
    rank = np.argsort(order)
    ordered = [bodies[i] for i in order], poses[order], shell, config.seconds
    engines = {"mujoco": config.mujoco}
    if config.mujoco_defaults:  # what is not set otherwise
        engines["mujoco_defaults"] = dataclasses.replace(config.mujoco, cone="pyramidal", impratio=1.0, integrator="Euler")
    sleeping = [int(rank[i]) for i in asleep]
    simulations = mujoco_engine.simulate_all(*ordered, engines, config.nudge_m_s, config.nudge_sleep_m_s, spread, sleeping)
    if config.newton.python:
        simulations.append(newton_engine.simulate(*ordered, config.newton))
    certified = []
    for simulation in simulations:
        certified += [_certified(body, poses[i], simulation, int(rank[i])) for i, body in enumerate(bodies)]
    return certified


def certificate_rows(scene_id: str, certified: Sequence[Certified]) -> list[Certificate]:
    """Rows of the table `certificates`, by instance and engine."""
    rows = []
    for certificate in sorted(certified, key=lambda c: (c.name, c.engine)):
        values = dataclasses.asdict(certificate)
        name, settled, _ = values.pop("name"), values.pop("settled_pose"), values.pop("fallen_pose")
        rows.append(Certificate(scene_id=scene_id, instance_id=name, settled_pose=None if settled is None else flat(settled), **values))
    return rows


def density_bounds(words: Sequence[str]) -> tuple[float, float] | None:
    """Least and greatest plausible mass over volume of pieces [kg/m3]; `words` of `materials.csv`. None without words.

    The greatest is firm: nothing is denser than its densest material. The least is a guess: pieces are solid where objects
    are hollow, stuffed or folded, so it is a share, `SOLID_SHARE` or `SOFT_SHARE`, of the least density of a material.

    Raises:
        InputError: a material is unknown.
    """
    known = materials()
    for word in words:
        if word not in known:
            raise InputError("captions", "materials", f"{word!r} is no known material", f"use one of {', '.join(known)}")
    if not words:
        return None
    low = min(known[word].density_min_kg_m3 * (SOFT_SHARE if word in SOFT else SOLID_SHARE) for word in words)
    return low, max(known[word].density_max_kg_m3 for word in words)


def _certified(body: RigidBody, pose: Array, simulation: Simulation, index: int) -> Certified:
    """The certificate of one body."""
    problem, settled = simulation.problems[index], simulation.settled[index]
    displacement, tilt = _moved(body, pose, settled)
    ways = np.array([_moved(body, pose, end[index]) for end in simulation.nudged]).reshape(-1, 2)
    nudged = ways.max(axis=0).tolist() if len(ways) else None
    is_known = problem is None
    is_stable_nudged = None if nudged is None else is_known and nudged[0] <= NEAR_M and nudged[1] <= FAR_TILT_RADIANS
    fallen = None
    if is_known and not (displacement <= NEAR_M and tilt <= FAR_TILT_RADIANS):
        fallen = settled
    elif is_stable_nudged is False and is_known:
        fallen = simulation.nudged[int((ways / (NEAR_M, FAR_TILT_RADIANS)).max(axis=1).argmax())][index]
    mass = body.mass_kg if np.isfinite(body.mass_kg) and body.mass_kg > 0.0 else 0.0
    volume = mujoco_engine.solid_volume(body.solid)
    density = mass / volume if volume > 0.0 else 0.0
    bounds = density_bounds(body.materials)
    return Certified(
        name=body.solid.name, engine=simulation.engine, engine_version=simulation.version,
        simulated_seconds=simulation.seconds, is_fixed=body.is_fixed, problem=problem, settled_pose=settled if is_known else None,
        displacement_m=displacement if is_known else None, tilt_radians=tilt if is_known else None,
        start_penetration_m=float(simulation.start_penetration[index]) if is_known else None,
        is_stable_1cm=is_known and displacement <= NEAR_M and tilt <= FAR_TILT_RADIANS,
        is_stable_5cm=is_known and displacement <= FAR_M and tilt <= FAR_TILT_RADIANS,
        nudged_displacement_m=nudged[0] if nudged and is_known else None, nudged_tilt_radians=nudged[1] if nudged and is_known else None,
        is_stable_nudged=is_stable_nudged,
        mass_kg=mass, solid_volume_m3=volume, density_kg_m3=density, density_low_kg_m3=None if bounds is None else bounds[0],
        density_high_kg_m3=None if bounds is None else bounds[1],
        is_density_plausible=None if bounds is None or density == 0.0 else bounds[0] <= density <= bounds[1],
        fallen_pose=fallen,
    )  # fmt: skip


def _moved(body: RigidBody, pose: Array, settled: Array) -> tuple[float, float]:
    """How far a body's origin moved [m], and by how much its upright axis tilted [rad]."""
    before, after = pose[:3, 2], settled[:3, 2]
    tilt = 0.0 if body.is_fixed else float(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))
    return float(np.linalg.norm(settled[:3, 3] - pose[:3, 3])), tilt
