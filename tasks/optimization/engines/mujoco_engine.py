"""MuJoCo on the CPU: objects under gravity on the floor z = 0, among the room's walls.

Only convex pieces are looked at, each as a hull of its own, with the union's mass properties; nothing that MuJoCo would
make of a mesh by itself is used.
"""

from __future__ import annotations

import dataclasses
import os
import pickle
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tasks.geometry.transforms import pose_from_quaternion_wxyz, quaternion_wxyz
from tasks.optimization.solids import ConvexParts, RigidBody, mass_properties_of
from tasks.settings import LISTED, Config, Count, NonNegative, Positive
from tasks.stage import Spread, in_turn

Array = NDArray[np.float64]
CLOSE_M = 1e-5
"""What is farther apart than this does not overlap, whatever is rounded [m]."""

LONGEST_TIMESTEP_S = 0.02
"""From here on a fall of one step goes deeper than objects are thick [s]: contacts are missed or shoot objects away."""


Timestep = Annotated[float, Field(gt=0, lt=LONGEST_TIMESTEP_S)]
"""At which an engine's contacts are stable [s]."""

_Inner = Annotated[float, Field(gt=0, lt=1)]
Impedance = Annotated[tuple[_Inner, _Inner, Positive], LISTED]
"""Two shares, then a width."""


@dataclasses.dataclass(frozen=True)
class Mujoco(Config):
    """How MuJoCo is set."""

    cone: Literal["elliptic", "pyramidal"] = "elliptic"  # of friction; the pyramid, MuJoCo's default, lets go sooner along its edges
    integrator: Literal["implicitfast", "Euler"] = "implicitfast"  # MuJoCo's default is Euler, which needs shorter steps
    timestep_s: Timestep = 0.004  # verdicts of 2 in 1,000 objects differ from those at 1 ms, by fractions of a millimeter
    impratio: Positive = 10.0  # friction 10 times as stiff as the contact, against creep on slopes
    stiffness_s: Positive = 0.02  # time constant of a contact: a 1 cm overlap is pushed apart by 1 cm; at 8 ms it is shot 4 cm away
    impedance: Impedance = (0.99, 0.999, 0.001)  # objects sink in by 0.01 mm, by 1 mm under a hundredfold load
    iterations: Count = 100  # of Newton's method, which needs few; cut off at 10, piles explode
    tolerance: NonNegative = 1e-8  # MuJoCo's own default
    sleep_m_s: NonNegative = 1e-6  # slower for 10 steps, an object is not computed until touched; at 1e-4 the balanced never tip; 0: never
    friction_floor: Positive = 1e-3  # MuJoCo takes the greater friction of a pair, and an object's is measured against floors
    memory_bytes: Count = 2**28  # room for 10,000 contacts and more; what is not touched costs nothing
    check_steps: Count = 5  # how often the state is looked at for having gone astray


NUDGES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Directions, x and y of the world frame, in which all free objects are nudged at once."""


@dataclasses.dataclass(frozen=True)
class Simulation:
    """What an engine makes of objects left alone.

    settled: asset to world at the end [m], shape (n, 4, 4). start_penetration: deepest at the start [m], shape (n,).
    problems: why an object could not be simulated, or None. seconds: simulated time. nudged: as settled after each nudge,
    shape (k, n, 4, 4), k 0 where there was none.
    """

    engine: str
    version: str
    seconds: float
    settled: Array
    start_penetration: Array
    problems: tuple[str | None, ...]
    nudged: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 4, 4)))


def simulate(
    bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], seconds: float, settings: Mujoco, nudge: float = 0.0,
    name: str = "mujoco", nudged_sleep: float = 0.0, spread: Spread = in_turn,
) -> Simulation:  # fmt: skip
    """`simulate_all` by one engine, named `name` and set so."""
    return simulate_all(bodies, poses, shell, seconds, {name: settings}, nudge, nudged_sleep, spread)[0]


def simulate_all(
    bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], seconds: float, engines: Mapping[str, Mujoco],
    nudge: float = 0.0, nudged_sleep: float = 0.0, spread: Spread = in_turn, asleep: Collection[int] = (),
) -> list[Simulation]:  # fmt: skip
    """Objects left alone under gravity at `poses` [m], shape (n, 4, 4), in the order given; then again from there, with every free object
    at a speed of `nudge` [m/s] in each direction of `NUDGES`, unless that is 0; by MuJoCo as each of `engines` sets it, by name; one run
    after another, or as `spread` does them.

    nudged_sleep: after a nudge objects sleep below this speed [m/s] if it is above `Mujoco.sleep_m_s`; where nothing ever sleeps, it
    does nothing. asleep: Bodies, by number, that sleep from the start, and get no speed, until something touches them; of these, all or
    none that touch one another.
    An object that MuJoCo refuses, or whose state diverges, has a problem: it is left out and stays where it is.
    """
    refused = tuple(unfit(body) for body in bodies)
    problems = dict.fromkeys(engines, refused)
    speeds = [np.zeros(2), *(nudge * np.array(direction) for direction in (NUDGES if nudge > 0.0 else ()))]
    scenes: dict[tuple[tuple[str | None, ...], Mujoco], _Scene] = {}
    made: dict[str, Simulation] = {}
    while waiting := [name for name in engines if name not in made]:
        begun: dict[str, _Scene] = {}
        pushes: list[_Push] = []
        for name in waiting:
            settings = engines[name]
            key = (problems[name], dataclasses.replace(settings, **_ANY_SOLVER))
            if key not in scenes:
                scenes[key] = _scene(bodies, poses, shell, problems[name], settings, asleep)
            begun[name] = scene = scenes[key]
            steps = round(seconds / settings.timestep_s) if scene.free else 0
            sleeps = [settings.sleep_m_s, *[max(settings.sleep_m_s, nudged_sleep)] * (len(speeds) - 1)]
            pushes += [_Push(scene.compiled, speed, sleep, steps, settings) for speed, sleep in zip(speeds, sleeps, strict=True)]
        done = iter(spread(_pushed, pushes))
        for name, scene in begun.items():
            runs: list[_Pushed] = [next(done) for _ in speeds]
            failure = next((run for run in runs if run.failed), None)
            if failure is not None:
                failed = {scene.free[row] for row in failure.failed}
                problems[name] = tuple(failure.problem if i in failed else problem for i, problem in enumerate(scene.problems))
                continue
            ends = np.array([_settled(poses, scene.free, run.places) for run in runs]).reshape(len(runs), len(bodies), 4, 4)
            made[name] = Simulation(name, mujoco_module().__version__, seconds, ends[0], scene.depth, scene.problems, ends[1:])
    return [made[name] for name in engines]


@dataclasses.dataclass(frozen=True)
class _Scene:
    """A scene. problems: Of every body, in the order given, why it is not in it, or None. free: Which bodies move, by number.
    depth: Their deepest penetrations at the start [m], shape (n,)."""

    compiled: _Compiled
    problems: tuple[str | None, ...]
    free: list[int]
    depth: Array


def _scene(
    bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], problems: Sequence[str | None], settings: Mujoco,
    asleep: Collection[int],
) -> _Scene:  # fmt: skip
    """The scene without the bodies that have problems, or that MuJoCo refuses."""
    mujoco, reasons = mujoco_module(), list(problems)
    model = _model(bodies, poses, shell, reasons, settings)
    for i in asleep:
        if not bodies[i].is_fixed and reasons[i] is None:
            model.tree_sleep_policy[model.body_treeid[model.body(f"b{i}").id]] = mujoco.mjtSleepPolicy.mjSLEEP_INIT
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    free = [i for i, body in enumerate(bodies) if not body.is_fixed and reasons[i] is None]
    return _Scene(_Compiled(model), tuple(reasons), free, _start_penetration(model, data, len(bodies)))


class _Compiled:
    """A scene as MuJoCo's model. Runs in other processes are sent the same bytes, and each process unpacks them once."""

    def __init__(self, model: Any) -> None:
        self.model = model

    @cached_property
    def _packed(self) -> bytes:
        return pickle.dumps(self.model)

    def __reduce__(self) -> tuple[Callable[[bytes], _Compiled], tuple[bytes]]:
        return _unpacked, (self._packed,)


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> _Compiled:
    """A scene from another process: those of two engines in turn."""
    mujoco_module()
    return _Compiled(pickle.loads(packed))


@dataclasses.dataclass(frozen=True)
class _Push:
    """A run of a scene: from its start, with a speed along x and y for all that is free [m/s], shape (2,). sleep: The speed below which
    things sleep [m/s]."""

    scene: _Compiled
    speed: Array
    sleep: float
    steps: int
    settings: Mujoco


class _Pushed(NamedTuple):
    """How a run ended. places: Of what is free, position [m] and quaternion (w, x, y, z), shape (n, 7). failed, problem: As of `_run`."""

    places: Array
    failed: list[int]
    problem: str


def _pushed(push: _Push) -> _Pushed:
    """Do a run."""
    model = push.scene.model
    _set_solver(model.opt, push.settings)
    model.opt.sleep_tolerance = push.sleep
    data = mujoco_module().MjData(model)
    data.qvel.reshape(-1, 6)[data.tree_awake > 0, :2] = push.speed
    failed, problem = _run(model, data, push.steps, push.settings)
    return _Pushed(np.array(data.qpos).reshape(-1, 7), failed, problem)


def _settled(poses: Array, free: Sequence[int], places: Array) -> Array:
    """Poses, shape (n, 4, 4), of which those of the free bodies, by number, are places [m], shape (k, 7)."""
    settled = np.array(poses, dtype=np.float64)
    for row, i in enumerate(free):
        settled[i] = pose_from_quaternion_wxyz(places[row, 3:].tolist(), places[row, :3].tolist())
    return settled


def _run(model: Any, data: Any, steps: int, settings: Mujoco) -> tuple[list[int], str]:
    """Simulate so many steps, or until it fails: the objects, by number, that it fails for, and why."""
    mujoco = mujoco_module()
    which, warnings = mujoco.mjtWarning, data.warning.number
    full = [int(w) for w in (which.mjWARN_CONTACTFULL, which.mjWARN_CNSTRFULL)]
    bad = [int(w) for w in (which.mjWARN_BADQPOS, which.mjWARN_BADQVEL, which.mjWARN_BADQACC)]
    parts = ((data.qpos, 7), (data.qvel, 6), (data.qacc, 6))
    for done in range(0, steps, settings.check_steps):
        mujoco.mj_step(model, data, min(settings.check_steps, steps - done))
        if warnings[full].any():
            return list(range(model.njnt)), "MuJoCo has no room for the scene's contacts"
        if warnings[bad].any() or not all(np.isfinite(values).all() for values, _ in parts):
            state = np.column_stack([values.reshape(-1, width) for values, width in parts])
            size = np.where(np.isfinite(state), np.abs(state), np.inf).max(axis=1)
            worst = min(float(size.max()), mujoco.mjMAXVAL)
            return np.flatnonzero(size >= worst).tolist(), f"its state diverges after {data.time:.3g} s"
        if data.ntree_awake == 0:  # nothing that sleeps moves, and nobody is left to wake it
            break
    return [], ""


def solid_volume(solid: ConvexParts) -> float:
    """Volume of the union of a solid's pieces [m3]; 0 when they are none."""
    if not all(volume > 0.0 for volume in solid.volumes) or not solid.hulls:
        return 0.0
    volume = mass_properties_of(solid).volume
    return volume if np.isfinite(volume) else 0.0


def mujoco_module() -> Any:
    """MuJoCo without a window system, unless the user has chosen one."""
    os.environ.setdefault("MUJOCO_GL", "disable")
    import mujoco

    mujoco.set_mju_user_warning(_quiet)  # else it writes a log file into the current folder
    return mujoco


def _quiet(warning: str) -> None:
    """Take a warning of MuJoCo's, which counts it as well."""


def contact_of(settings: Mujoco) -> dict[str, list[float]]:
    """Attributes of a geom that say how its contacts give way."""
    return {"solref": [settings.stiffness_s, 1.0], "solimp": [*settings.impedance, 0.5, 2.0]}


def friction_of(friction: float, settings: Mujoco) -> list[float]:
    """Sliding, torsional and rolling friction of a geom; of a pair of geoms MuJoCo takes the greater."""
    return [max(friction, settings.friction_floor), 0.005, 0.0001]


def unfit(body: RigidBody) -> str | None:
    """Why a body cannot be simulated by any engine, or None."""
    if not body.solid.hulls:
        return "it has no pieces"
    for number, volume in enumerate(body.solid.volumes):
        if not volume > 0.0:
            is_finite = np.isfinite(body.solid.hulls[number].vertices).all()
            return f"piece {number} has no volume" if is_finite else f"piece {number} has a vertex that is not finite"
    if not (np.isfinite(body.mass_kg) and body.mass_kg > 0.0):
        return f"its mass is {body.mass_kg:g} kg"
    return None if solid_volume(body.solid) > 0.0 else "its pieces have no volume"


def _model(bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], problems: list[str | None], settings: Mujoco) -> Any:
    """The compiled scene without the bodies that have problems; those that MuJoCo refuses are added to these."""
    try:
        return _spec(bodies, poses, shell, problems, settings).compile()
    except ValueError:
        for i, body in enumerate(bodies):  # each alone, to know whom it refuses
            if problems[i] is None:
                try:
                    _spec([body], poses[i : i + 1], (), [None], settings).compile()
                except ValueError as error:
                    problems[i] = "MuJoCo refuses it: " + " ".join(str(error).split())
        return _spec(bodies, poses, shell, problems, settings).compile()


def empty_spec(settings: Mujoco) -> Any:
    """MuJoCo's specification of nothing, with the options of `settings`."""
    mujoco = mujoco_module()
    spec = mujoco.MjSpec()
    option = spec.option
    _set_solver(option, settings)
    option.timestep = settings.timestep_s
    option.iterations, option.tolerance = settings.iterations, settings.tolerance
    option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a state that went astray must not look like the start
    if settings.sleep_m_s > 0.0:
        option.enableflags, option.sleep_tolerance = mujoco.mjtEnableBit.mjENBL_SLEEP, settings.sleep_m_s
    spec.compiler.usethread = False
    spec.memory = settings.memory_bytes
    return spec


_ANY_SOLVER: Mapping[str, Any] = {"cone": Mujoco.cone, "integrator": Mujoco.integrator, "impratio": Mujoco.impratio}
"""What a compiled scene does not depend on: scenes that differ in nothing else are compiled once."""


def _set_solver(option: Any, settings: Mujoco) -> None:
    """Set what `_ANY_SOLVER` names in MuJoCo's options."""
    mujoco = mujoco_module()
    option.impratio = settings.impratio
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if settings.cone == "elliptic" else mujoco.mjtCone.mjCONE_PYRAMIDAL
    which = mujoco.mjtIntegrator
    option.integrator = which.mjINT_IMPLICITFAST if settings.integrator == "implicitfast" else which.mjINT_EULER


def _spec(bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], problems: Sequence[str | None], settings: Mujoco) -> Any:
    """The scene as MuJoCo's specification: body i has the name `b<i>`."""
    mujoco = mujoco_module()
    spec = empty_spec(settings)
    contact, small = contact_of(settings), friction_of(0.0, settings)
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=small, **contact)

    def colliders(body: Any, solid: ConvexParts, name: str, friction: Sequence[float]) -> None:
        for number, hull in enumerate(solid.hulls):
            mesh = f"{name}_{number}"
            spec.add_mesh(
                name=mesh, uservert=hull.vertices.ravel(), userface=hull.faces.ravel().astype(np.int32),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )  # fmt: skip
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, friction=friction, **contact)

    for number, wall in enumerate(shell):
        colliders(spec.worldbody.add_body(name=f"s{number}"), wall, f"s{number}", small)
    for i, body in enumerate(bodies):
        if problems[i] is not None:
            continue
        added = spec.worldbody.add_body(name=f"b{i}", pos=poses[i][:3, 3], quat=quaternion_wxyz(poses[i]))
        if not body.is_fixed:
            added.add_freejoint()
        properties = mass_properties_of(body.solid)
        inertia = properties.inertia * (body.mass_kg / properties.volume)
        added.explicitinertial, added.mass, added.ipos = True, body.mass_kg, properties.center
        added.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        colliders(added, body.solid, f"b{i}", friction_of(body.friction, settings))
    return spec


def _start_penetration(model: Any, data: Any, count: int) -> Array:
    """Deepest penetration of every object with anything [m], shape (count,). Pairs of fixed objects, which MuJoCo does not
    collide, are measured one by one."""
    mujoco = mujoco_module()
    depth = np.zeros(count)
    names = (model.body(number).name for number in range(model.nbody))
    owner = np.array([int(name[1:]) if name.startswith("b") else -1 for name in names])[model.geom_bodyid]

    def deepen(geoms: NDArray[Any], distance: float | Array) -> None:
        for geom in np.asarray(geoms).reshape(-1, 2).T:
            known = owner[geom] >= 0
            np.maximum.at(depth, owner[geom][known], 0.0 - np.broadcast_to(distance, known.shape)[known])  # no zero below zero

    deepen(data.contact.geom, data.contact.dist)
    static = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
    fixed, (low, high) = static[owner[static] >= 0], _world_boxes(model, data)
    for a in fixed[low[fixed, 2] < CLOSE_M].tolist():
        deepen(np.array([a, 0]), min(float((_world_vertices(model, data, a)[:, 2]).min()), 0.0))
    met = np.ones((len(fixed), len(static)), dtype=np.bool_)
    for k in range(3):
        met &= (low[None, static, k] <= high[fixed, None, k] + CLOSE_M) & (high[None, static, k] >= low[fixed, None, k] - CLOSE_M)
    met &= (static != 0) & (owner[static] != owner[fixed, None]) & ((owner[static] < 0) | (static > fixed[:, None]))
    rows, columns = np.nonzero(met)
    for a, b in zip(fixed[rows].tolist(), static[columns].tolist(), strict=True):
        deepen(np.array([a, b]), min(float(mujoco.mj_geomDistance(model, data, a, b, 0.0, None)), 0.0))
    return depth


def _world_boxes(model: Any, data: Any) -> tuple[Array, Array]:
    """Low and high corners of boxes around geoms in the world frame [m], shape (n, 3) each."""
    turn, box = data.geom_xmat.reshape(-1, 3, 3), model.geom_aabb
    center = np.einsum("nij,nj->ni", turn, box[:, :3]) + data.geom_xpos
    half = np.einsum("nij,nj->ni", np.abs(turn), box[:, 3:])
    return center - half, center + half


def _world_vertices(model: Any, data: Any, geom: int) -> Array:
    """Vertices of a mesh geom in the world frame [m], shape (k, 3)."""
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    turned: Array = model.mesh_vert[first : first + count].astype(np.float64) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    return turned
