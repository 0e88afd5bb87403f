"""Newton as a second engine, in an environment of its own: it pins packages that the project has in other versions.

By default it runs Newton's MuJoCo solver on the CPU: another model of the scene, other settings and another version of
MuJoCo, but the same contact solver. Where the engines agree, that is a check of the model, no second opinion on the physics.
Newton's XPBD solver with Newton's own contacts is one; it drives apart by centimeters what overlaps by a millimeter.

Make one with `python -m venv FOLDER` and `FOLDER/bin/pip install -r requirements/newton.lock`, then name
`FOLDER/bin/python`.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from tasks.calls.command import run_apart
from tasks.geometry.transforms import pose_from_quaternion_wxyz, quaternion_xyzw
from tasks.optimization.engines.mujoco_engine import Simulation, Timestep, unfit
from tasks.optimization.solids import ConvexParts, RigidBody, mass_properties_of
from tasks.settings import Config, Count, NonNegative, Positive

Array = NDArray[np.float64]
OUT_OF_BOUNDS_M = 1e6
"""An object that is farther away than this has diverged [m]: in 2 s objects fall 20 m."""

SCRIPT = Path(__file__).with_name("newton_script.py")


@dataclasses.dataclass(frozen=True)
class Newton(Config):
    """Where Newton is and how its solvers are set; with the MuJoCo solver's own defaults chairs slide and books sink in."""

    python: str = ""  # interpreter of the environment that Newton is installed in; without one, Newton is not asked
    solver: Literal["mujoco", "xpbd"] = "mujoco"  # xpbd shares no contact solver with MuJoCo, and looks at neither stiffness nor impratio
    timestep_s: Timestep = 1 / 480  # what its examples take for contacts
    stiffness: Positive = 2e5  # of contacts [N/m]; with the default of 2500 objects sink in by centimeters
    damping: NonNegative = 1e3  # [N s/m], nearly critical for household masses
    impratio: Positive = 10.0  # friction 10 times as stiff as the contact, against creep on slopes
    iterations: Count = 100  # cut off earlier, piles explode
    xpbd_iterations: Count = 20  # per step; stacks of five rest to half a millimeter
    friction_floor: Positive = 1e-3  # the greater friction of a pair counts, and an object's is measured against floors: let it decide
    timeout_s: Positive = 900.0  # the first run on a machine compiles kernels, up to two minutes on two cores


def simulate(bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], seconds: float, settings: Newton) -> Simulation:
    """Objects left alone under gravity at `poses` [m], shape (n, 4, 4), in the order given.

    An object that no engine can take, or whose state diverges, has a problem and stays where it is. Penetration between two
    fixed objects is not measured. The version names Newton's and that of the solver: `1.8.0, solver MuJoCo 3.17.0`
    or `1.8.0, solver XPBD`.

    Raises:
        InputError: the interpreter or the package is not there, or Newton fails.
    """
    problems = [unfit(body) for body in bodies]
    steps = round(seconds / settings.timestep_s)
    with temporary_folder() as folder:
        source, target = folder / "scene.npz", folder / "settled.npz"
        np.savez(source, **_scene(bodies, poses, shell, problems, steps, settings))
        _run(settings, source, target)
        with np.load(target) as arrays:
            ends, depth, version = arrays["settled"], arrays["depth"], str(arrays["version"])
    settled, penetration = np.array(poses, dtype=np.float64), np.zeros(len(bodies))
    taken = [i for i, problem in enumerate(problems) if problem is None]
    for row, i in enumerate(taken):
        penetration[i] = depth[row] if np.isfinite(depth[row]) else 0.0
        if bodies[i].is_fixed:
            continue
        if not (np.isfinite(ends[row]).all() and np.abs(ends[row]).max() < OUT_OF_BOUNDS_M):
            problems[i] = "its state diverges"
            continue
        x, y, z, w = (float(v) for v in ends[row, 3:])
        settled[i] = pose_from_quaternion_wxyz((w, x, y, z), ends[row, :3])
    return Simulation("newton", version, seconds, settled, penetration, tuple(problems))


def _scene(
    bodies: Sequence[RigidBody], poses: Array, shell: Sequence[ConvexParts], problems: Sequence[str | None], steps: int, settings: Newton
) -> Mapping[str, Any]:
    """The scene as arrays: bodies without problems first, then walls as fixed bodies; pieces name their owner."""
    taken = [(body, pose) for body, pose, problem in zip(bodies, poses, problems, strict=True) if problem is None]
    solids = [body.solid for body, _ in taken] + list(shell)
    walls = len(shell)
    masses = [mass_properties_of(body.solid) for body, _ in taken]
    inertias = [properties.inertia * (body.mass_kg / properties.volume) for properties, (body, _) in zip(masses, taken, strict=True)]
    frames = [[*pose[:3, 3], *quaternion_xyzw(pose)] for _, pose in taken] + [[0, 0, 0, 0, 0, 0, 1]] * walls
    hulls = [(owner, hull) for owner, solid in enumerate(solids) for hull in solid.hulls]
    floor = settings.friction_floor
    return {
        "poses": np.array(frames, dtype=np.float64).reshape(-1, 7),
        "is_free": np.array([not body.is_fixed for body, _ in taken] + [False] * walls, dtype=bool),
        "masses": np.array([body.mass_kg for body, _ in taken]),
        "centers": np.array([properties.center for properties in masses]),
        "inertias": np.array(inertias),
        "frictions": np.array([max(body.friction, floor) for body, _ in taken] + [floor] * walls),
        "owners": np.array([owner for owner, _ in hulls], dtype=np.int64),
        "vertex_counts": np.array([len(hull.vertices) for _, hull in hulls], dtype=np.int64),
        "face_counts": np.array([len(hull.faces) for _, hull in hulls], dtype=np.int64),
        "vertices": np.concatenate([np.zeros((0, 3)), *(hull.vertices for _, hull in hulls)]),
        "faces": np.concatenate([np.zeros((0, 3), dtype=np.int64), *(hull.faces for _, hull in hulls)]),
        "contact": np.array([settings.stiffness, settings.damping]),
        "room_friction": floor, "impratio": settings.impratio, "iterations": settings.iterations,
        "solver": settings.solver, "xpbd_iterations": settings.xpbd_iterations,
        "timestep": settings.timestep_s, "steps": steps,
    }  # fmt: skip


def _run(settings: Newton, source: Path, target: Path) -> None:
    """The script in Newton's environment, in the folder of its files: the engine leaves a log there when it warns."""
    field, remedy = "optimization.certificate.newton.python", "make an environment from requirements/newton.lock and name its interpreter"
    python = shutil.which(settings.python)
    if python is None:
        raise InputError(settings.python, field, "is no program that can be run", remedy)
    command = [os.path.abspath(python), "-I", str(SCRIPT.resolve()), str(source), str(target)]
    try:
        ending = run_apart(command, source.parent, settings.timeout_s)
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or error
        raise InputError(settings.python, field, f"cannot be run: {problem}", remedy) from error
    if ending.problem:
        raise InputError(settings.python, field, f"Newton {ending.problem}", remedy if ending.code else "raise timeout_s")
    if not target.exists():
        raise InputError(settings.python, field, "Newton ended well, but it left no result", remedy)
