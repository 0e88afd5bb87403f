"""Engines that exported scenes are simulated in: what they read, how they are set, where they come from."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from schemas.machine.environment import child_environment

SECONDS = 2.0
"""Simulated time [s], that of certificates."""

NUDGE_M_S = 0.05
"""Speed that all free objects get at once [m/s], in runs of their own along +x, -x, +y and -y."""

RUNS: Mapping[str, tuple[float, float, float]] = {
    "at rest": (0.0, 0.0, 0.0), "nudged +x": (NUDGE_M_S, 0.0, 0.0), "nudged -x": (-NUDGE_M_S, 0.0, 0.0),
    "nudged +y": (0.0, NUDGE_M_S, 0.0), "nudged -y": (0.0, -NUDGE_M_S, 0.0),
}  # fmt: skip
"""Velocity at the start of each run [m/s]; every one begins at the exported poses."""


@dataclasses.dataclass(frozen=True)
class Engine:
    """A physics engine. package: of its version, as pip names it. install: what puts it into a new environment.

    script: what its interpreter runs, beside this module; None for MuJoCo, which the project has itself.
    """

    name: str
    package: str
    script: str | None
    install: str

    @property
    def variable(self) -> str:
        """The environment variable that names its interpreter."""
        return f"METASCENES_{self.name.upper()}_PYTHON"


@dataclasses.dataclass(frozen=True)
class Setup:
    """An engine with settings: a row of the table. same_as: the row that it is no second opinion beside."""

    name: str
    engine: Engine
    format: str
    settings: Mapping[str, Any]
    same_as: str | None = None


MUJOCO = Engine("mujoco", "mujoco", None, "")
PYBULLET = Engine("pybullet", "pybullet", "pybullet_script.py", "pip install -r requirements/pybullet.lock")
OVPHYSX = Engine(
    "ovphysx", "ovphysx", "ovphysx_script.py", "pip install ovphysx==0.7.0.74035321 physx-usd-schemas newton-usd-schemas (proprietary)"
)
NEWTON = Engine("newton", "newton", "newton_script.py", "pip install -r requirements/newton.lock")

FOREIGN = (PYBULLET, OVPHYSX, NEWTON)
"""Engines that want an interpreter of their own."""

SETUPS = (
    Setup("MuJoCo, shipped", MUJOCO, "mjcf", {}),
    Setup(
        "MuJoCo, defaults", MUJOCO, "mjcf",
        {"cone": "pyramidal", "impratio": 1.0, "integrator": "Euler", "timestep_s": 0.002, "sleep": False},
    ),
    Setup("PyBullet", PYBULLET, "urdf", {"timestep_s": 1 / 240}),
    Setup("PhysX", OVPHYSX, "usd", {"timestep_s": 1 / 60, "warmup": False}),
    Setup("PhysX, warmed up", OVPHYSX, "usd", {"timestep_s": 1 / 60, "warmup": True}, same_as="PhysX"),
    Setup(
        "Newton, MuJoCo", NEWTON, "usd",
        {
            "solver": "mujoco", "timestep_s": 1 / 480, "ke": 2e5, "kd": 1e3, "cone": "elliptic", "impratio": 10.0, "multiccd": True,
            "iterations": 100,
        },
    ),
    Setup("Newton, XPBD", NEWTON, "usd", {"solver": "xpbd", "timestep_s": 0.004, "iterations": 20}),
)  # fmt: skip
"""The rows of the table. What is not named is as the file or the engine has it."""


def interpreters(named: Sequence[str]) -> dict[str, Path]:
    """Interpreters by engine, of words `engine=python`; of an engine without one METASCENES_<ENGINE>_PYTHON counts.

    Raises:
        InputError: a word is none of these, names no engine, or its interpreter has no such package.
    """
    known = {engine.name: engine for engine in FOREIGN}
    chosen = {name: os.environ[engine.variable] for name, engine in known.items() if os.environ.get(engine.variable)}
    for word in named:
        name, _, python = word.partition("=")
        if name not in known or not python:
            raise InputError(word, "--engine", f"names none of {', '.join(known)} with its interpreter", "write pybullet=/path/to/python")
        chosen[name] = python
    return {name: _interpreter(known[name], python) for name, python in sorted(chosen.items())}


def _interpreter(engine: Engine, python: str) -> Path:
    """The interpreter, once it is known to have the package."""
    remedy = f"make an environment for it: {engine.install}"
    path = shutil.which(python)
    if path is None:
        raise InputError(python, f"--engine {engine.name}", "is no program that can be run", remedy)
    command = [os.path.abspath(path), "-I", "-c", f"import importlib.metadata as m; m.version({engine.package!r})"]
    try:
        done = subprocess.run(command, env=child_environment(), capture_output=True, text=True, check=False)
    except OSError as error:
        raise InputError(python, f"--engine {engine.name}", f"cannot be run: {error.strerror}", remedy) from error
    if done.returncode != 0:
        raise InputError(python, f"--engine {engine.name}", f"has no package {engine.package}", remedy)
    return Path(os.path.abspath(path))
