"""Renderers by others that cameras are timed beside, each in an interpreter of its own, in software: MuJoCo's and pyrender."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError
from schemas.machine.environment import child_environment
from tasks import exports

if TYPE_CHECKING:
    import trimesh

    from bench.policy.frames import BenchedScene

Rates = dict[str, dict[str, float]]
"""Pictures per CPU second, by what is drawn and size."""

PYRENDER_PYTHON = "METASCENES_PYRENDER_PYTHON"
"""The environment variable that names an interpreter with `requirements/pyrender.lock`."""

MUJOCO_SCRIPT, PYRENDER_SCRIPT = (Path(__file__).with_name(f"{name}_script.py") for name in ("mujoco", "pyrender"))

LIBRARIES = ("egl", "osmesa")
"""OpenGL without a screen, in the order in which it is tried."""


@dataclasses.dataclass(frozen=True)
class RenderRequest:
    """What is drawn. poses: Camera-to-world, OpenCV, as lists [m]. sizes: Pixels of a side. seconds: Everything is repeated for so long."""

    poses: Sequence[Any]
    sizes: Sequence[int]
    hfov_degrees: float
    seconds: float


def foreign_rates(scene: BenchedScene, wanted: RenderRequest) -> tuple[Rates, dict[str, str]]:
    """Pictures per CPU second of those that can draw the scene, and why the others do not, by name."""
    rates: Rates = {}
    missing: dict[str, str] = {}
    for name, rate in (("MuJoCo", mujoco_rates), ("pyrender", pyrender_rates)):
        answer = rate(scene, wanted)
        if isinstance(answer, str):
            missing[name] = answer
        else:
            rates |= answer
    return rates, missing


def mujoco_rates(scene: BenchedScene, wanted: RenderRequest) -> Rates | str:
    """Of MuJoCo: color alone, and color, depth and parts; or why it draws nothing."""
    if not scene.mjcf:
        return "it has no export in MJCF"
    with tempfile.TemporaryDirectory() as folder:
        exports.write_folder(Path(folder), scene.mjcf)
        answer = _drawn(sys.executable, MUJOCO_SCRIPT, "MUJOCO_GL", Path(folder, next(iter(scene.mjcf))), wanted)
    return answer if isinstance(answer, str) else answer["rates"]


def pyrender_rates(scene: BenchedScene, wanted: RenderRequest) -> Rates | str:
    """Of pyrender: color with depth, and with parts besides; or why it draws nothing."""
    answer = pyrender_answer(scene.parts, wanted)
    return answer if isinstance(answer, str) else answer["rates"]


def pyrender_answer(parts: Sequence[trimesh.Trimesh], wanted: RenderRequest) -> dict[str, Any] | str:
    """What pyrender makes of parts: `rates`, and what the first camera sees; or why it draws nothing.

    Raises:
        InputError: the interpreter that is named cannot be run.
    """
    import trimesh

    named = os.environ.get(PYRENDER_PYTHON, "")
    if not named:
        return f"{PYRENDER_PYTHON} names no interpreter with requirements/pyrender.lock"
    python = shutil.which(named)
    if python is None:
        raise InputError(named, PYRENDER_PYTHON, "is no program that can be run", "make an environment from requirements/pyrender.lock")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.glb")
        named_parts: dict[str, trimesh.parent.Geometry] = {f"part_{number}": part for number, part in enumerate(parts)}
        file.write_bytes(trimesh.Scene(named_parts).export(file_type="glb"))
        return _drawn(python, PYRENDER_SCRIPT, "PYOPENGL_PLATFORM", file, wanted)


def _drawn(python: str, script: Path, variable: str, file: Path, wanted: RenderRequest) -> dict[str, Any] | str:
    """What a script answers, by the first library with which it ends well; or why none did. variable: Where the library is named."""
    request = json.dumps({"scene": str(file), **dataclasses.asdict(wanted)})
    reasons = []
    for library in LIBRARIES:
        settings = {variable: library, "LIBGL_ALWAYS_SOFTWARE": "1", "LP_NUM_THREADS": "0"}
        command = [python, "-I", str(script)]
        done = subprocess.run(command, input=request, capture_output=True, text=True, check=False, env=child_environment() | settings)
        if done.returncode == 0:
            answer: dict[str, Any] = json.loads(done.stdout)
            return answer
        reasons.append(f"{library}: {(done.stderr.strip() or f'ended with code {done.returncode}').splitlines()[-1]}")
    return "; ".join(reasons)
