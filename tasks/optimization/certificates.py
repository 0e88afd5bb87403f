"""Certificates: whether things stay where they were put, by a physics engine that had no part in putting them there."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.optimization import Certificate
from tasks.captions.physics import materials
from tasks.optimization import mujoco_engine, newton_engine
from tasks.optimization.mujoco_engine import Mujoco, Simulation
from tasks.optimization.newton_engine import Newton
from tasks.optimization.solids import Body, Solid
from tasks.transforms import flat, is_rigid

Array = NDArray[np.float64]

SOFT: frozenset[str] = frozenset({"fabric", "foliage"})
"""Materials that are mostly air as they are used: stuffing, folds, leaves."""


@dataclasses.dataclass(frozen=True)
class CertificateConfig:
    """What a certificate asks."""

    mujoco: Mujoco = dataclasses.field(default_factory=Mujoco)
    newton: Newton = dataclasses.field(default_factory=Newton)  # asked as well when its interpreter is named
    seconds: float = 2.0  # a fall from a table takes 0.4 s; tipping begins slowly and takes longer
    near_m: float = 0.01  # a robot's grasp planned at the old place still succeeds
    far_m: float = 0.05  # still recognizably where the scan saw it: the noise of a scan's boxes
    far_tilt_radians: float = float(np.deg2rad(5.0))  # more, and a cup spills
    solid_share: float = 0.01  # of a hollow thing's volume: a box of 60 cm with walls of 1 mm
    soft_share: float = 0.004  # the same for stuffed and leafy things: down at 5 kg/m3, of fiber at 1300


@dataclasses.dataclass(frozen=True)
class Certified:
    """What an engine says of a thing. settled_pose: asset to world at the end, 4x4 [m]. density_low, density_high [kg/m3].

    problem: why it could not be simulated, or None. With a problem it is not stable, and settled_pose is where it was put.
    """

    name: str
    engine: str
    engine_version: str
    simulated_seconds: float
    is_fixed: bool
    settled_pose: Array
    displacement_m: float
    tilt_radians: float
    start_penetration_m: float
    is_stable_1cm: bool
    is_stable_5cm: bool
    mass_kg: float
    solid_volume_m3: float
    density_kg_m3: float
    density_low_kg_m3: float
    density_high_kg_m3: float
    is_density_plausible: bool
    problem: str | None


def certify(bodies: Sequence[Body], poses: Array, shell: Sequence[Solid], config: CertificateConfig) -> list[Certified]:
    """Certificates of things at `poses`, asset to world [m], shape (n, 4, 4), in the order given; MuJoCo's first, then
    Newton's when it is asked.

    They are left alone for `config.seconds` under gravity on the floor z = 0, among the walls `shell`. Fixed things do
    not move. The order of the bodies does not matter. A thing that an engine refuses is reported, not stable, and left
    out: what it carries falls.

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
    engines: list[Mujoco | Newton] = [config.mujoco, *([config.newton] if config.newton.python else [])]
    certified = []
    for engine in engines:
        simulation = _simulate([bodies[i] for i in order], poses[order], shell, config.seconds, engine)
        certified += [_certified(body, poses[i], simulation, int(rank[i]), config) for i, body in enumerate(bodies)]
    return certified


def certificate_rows(scene_id: str, certified: Sequence[Certified]) -> list[Certificate]:
    """Rows of the table `certificates`, by instance and engine."""
    rows = []
    for one in sorted(certified, key=lambda c: (c.name, c.engine)):
        values = dataclasses.asdict(one)
        del values["problem"]
        name, settled = values.pop("name"), flat(values.pop("settled_pose"))
        rows.append(Certificate(scene_id=scene_id, instance_id=name, settled_pose=settled, **values))
    return rows


def density_bounds(words: Sequence[str], config: CertificateConfig) -> tuple[float, float]:
    """Least and greatest mass over volume of pieces [kg/m3] that materials allow; `words` of `materials.csv`.

    The greatest is firm: nothing is denser than its densest material. The least is not: pieces are solid where things
    are hollow, stuffed or folded, so of the lightest material only a share has to be there.

    Raises:
        InputError: a material is unknown.
    """
    known = materials()
    for word in words:
        if word not in known:
            raise InputError("captions", "materials", f"{word!r} is no known material", f"use one of {', '.join(known)}")
    if not words:
        words = tuple(known)
    low = min(known[word].density_min_kg_m3 * (config.soft_share if word in SOFT else config.solid_share) for word in words)
    return low, max(known[word].density_max_kg_m3 for word in words)


def _simulate(bodies: Sequence[Body], poses: Array, shell: Sequence[Solid], seconds: float, engine: Mujoco | Newton) -> Simulation:
    """What an engine makes of it."""
    match engine:
        case Mujoco():
            return mujoco_engine.simulate(bodies, poses, shell, seconds, engine)
        case Newton():
            return newton_engine.simulate(bodies, poses, shell, seconds, engine)


def _certified(body: Body, pose: Array, simulation: Simulation, index: int, config: CertificateConfig) -> Certified:
    """The certificate of one body."""
    settled, problem = simulation.settled[index], simulation.problems[index]
    displacement = float(np.linalg.norm(settled[:3, 3] - pose[:3, 3]))
    before, after = pose[:3, 2], settled[:3, 2]
    tilt = float(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))
    mass = body.mass_kg if np.isfinite(body.mass_kg) and body.mass_kg > 0.0 else 0.0
    volume = mujoco_engine.solid_volume(body.solid)
    density = mass / volume if volume > 0.0 else 0.0
    low, high = density_bounds(body.materials, config)
    return Certified(
        name=body.solid.name, engine=simulation.engine, engine_version=simulation.version,
        simulated_seconds=simulation.seconds, is_fixed=body.is_fixed, settled_pose=settled, displacement_m=displacement,
        tilt_radians=0.0 if body.is_fixed else tilt, start_penetration_m=float(simulation.start_penetration[index]),
        is_stable_1cm=problem is None and displacement <= config.near_m,
        is_stable_5cm=problem is None and displacement <= config.far_m and tilt <= config.far_tilt_radians,
        mass_kg=mass, solid_volume_m3=volume, density_kg_m3=density, density_low_kg_m3=low, density_high_kg_m3=high,
        is_density_plausible=low <= density <= high, problem=problem,
    )  # fmt: skip
