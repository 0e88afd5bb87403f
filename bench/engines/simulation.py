"""One exported scene in one engine: where its free bodies go, from what the engine itself reads."""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.engines.scenes import SceneFiles
from bench.engines.setups import RUNS, SECONDS, Setup
from bench.gravity import instance_of
from tasks.calls.command import run_apart
from tasks.geometry.transforms import pose_from_quaternion_wxyz
from tasks.optimization.engines.mujoco_engine import mujoco_module

Pose = list[float]
"""x, y, z [m], then the quaternion w, x, y, z."""

TIMEOUT_S = 3600.0
"""An engine that takes longer over one scene has failed [s]; a first run also compiles."""


@dataclasses.dataclass(frozen=True)
class Ends:
    """What an engine made of a scene, by body: poses before the first step, and after each of `RUNS`."""

    version: str
    starts: Mapping[str, Pose]
    ends: tuple[Mapping[str, Pose], ...]


@dataclasses.dataclass(frozen=True)
class Moved:
    """How far a free object went from its exported pose, by run: its origin [m], its upright axis [rad].

    Infinite where the engine has no such body or its state diverged.
    """

    metres: tuple[float, ...]
    radians: tuple[float, ...]

    def stays(self, limit_m: float, run: int) -> bool:
        """Whether it stays within so many metres, and 5 degrees, in a run."""
        return self.metres[run] <= limit_m and self.radians[run] <= math.radians(5.0)

    def is_stable(self, limit_m: float, nudged: bool) -> bool:
        """Whether it does so at rest, or at rest and after every nudge."""
        return all(self.stays(limit_m, run) for run in range(len(self.metres) if nudged else 1))


@dataclasses.dataclass(frozen=True)
class SceneRuns:
    """A scene in an engine. apart_m: greatest distance between an exported place and the one that the engine read [m].

    failure: why there is no result; then every object has gone infinitely far.
    """

    scene_id: str
    setup: str
    version: str | None
    moved: Mapping[str, Moved]
    apart_m: float | None
    seconds: float
    failure: str | None = None


def simulate(scene: SceneFiles, setup: Setup, python: Path | None) -> SceneRuns:
    """The free objects of a scene left alone at their exported poses, and nudged. python: the engine's interpreter."""
    clock = time.perf_counter()
    try:
        ends = _in_mujoco(scene, setup) if python is None else _in_interpreter(scene, setup, python)
    except (EngineError, ValueError) as error:
        far = (math.inf,) * len(RUNS)
        moved = {name: Moved(far, far) for name in scene.poses}
        return SceneRuns(scene.scene_id, setup.name, None, moved, None, time.perf_counter() - clock, " ".join(str(error).split()))
    starts = {instance_of(name): pose for name, pose in ends.starts.items()}
    by_run = [{instance_of(name): pose for name, pose in run.items()} for run in ends.ends]
    far_each = {name: [distances(pose, run.get(name)) for run in by_run] for name, pose in scene.poses.items()}
    moved = {name: Moved(tuple(m for m, _ in far), tuple(r for _, r in far)) for name, far in far_each.items()}
    apart = max((distances(pose, starts.get(name))[0] for name, pose in scene.poses.items()), default=0.0)
    return SceneRuns(scene.scene_id, setup.name, ends.version, moved, apart, time.perf_counter() - clock)


class EngineError(Exception):
    """An engine did not come to an end with a scene; the message is its own."""


def distances(exported: NDArray[np.float64], pose: Pose | None) -> tuple[float, float]:
    """How far a pose is from the exported one: of the origin [m], of the upright axis [rad]; infinite where there is none."""
    if pose is None or not np.isfinite(pose).all():
        return math.inf, math.inf
    w, x, y, z = pose[3:]
    reached = pose_from_quaternion_wxyz((w, x, y, z), np.array(pose[:3]))
    cosine = float(np.clip(exported[:3, 2] @ reached[:3, 2], -1.0, 1.0))
    return float(np.linalg.norm(reached[:3, 3] - exported[:3, 3])), math.acos(cosine)


def _in_mujoco(scene: SceneFiles, setup: Setup) -> Ends:
    """MuJoCo, which needs no interpreter of its own."""
    mujoco = mujoco_module()
    model = mujoco.MjModel.from_xml_path(str(scene.files[setup.format]))
    _set(mujoco, model.opt, setup.settings)
    free = [joint for joint in range(model.njnt) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE]
    names = [model.body(int(model.jnt_bodyid[joint])).name for joint in free]
    starts: dict[str, Pose] = {}
    ends = []
    for velocity in RUNS.values():
        data = mujoco.MjData(model)
        starts = _poses(model, data, free, names)
        for joint in free:
            first = model.jnt_dofadr[joint]
            data.qvel[first : first + 3] = velocity
        mujoco.mj_step(model, data, round(SECONDS / model.opt.timestep))
        ends.append(_poses(model, data, free, names))
    return Ends(mujoco.__version__, starts, tuple(ends))


def _set(mujoco: Any, option: Any, settings: Mapping[str, Any]) -> None:
    """Set options of a model; what is not named stays as the file has it."""
    if "cone" in settings:
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{settings['cone'].upper()}")
    if "integrator" in settings:
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{settings['integrator'].upper()}")
    option.impratio = settings.get("impratio", option.impratio)
    option.timestep = settings.get("timestep_s", option.timestep)
    if not settings.get("sleep", True):
        option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        option.sleep_tolerance = 0.0


def _poses(model: Any, data: Any, free: list[int], names: list[str]) -> dict[str, Pose]:
    """Poses of the bodies of free joints."""
    firsts = [int(model.jnt_qposadr[joint]) for joint in free]
    return {name: data.qpos[first : first + 7].tolist() for name, first in zip(names, firsts, strict=True)}


def _in_interpreter(scene: SceneFiles, setup: Setup, python: Path) -> Ends:
    """An engine in an environment of its own, in a folder of its own: some leave logs there."""
    assert setup.engine.script is not None
    with tempfile.TemporaryDirectory(prefix="bench-") as place:
        source, target = Path(place) / "request.json", Path(place) / "result.json"
        request = {
            "file": str(scene.files[setup.format]), "settings": dict(setup.settings), "seconds": SECONDS,
            "velocities": [list(velocity) for velocity in RUNS.values()],
        }  # fmt: skip
        source.write_text(json.dumps(request))
        command = [str(python), "-I", str(Path(__file__).with_name(setup.engine.script)), str(source), str(target)]
        try:
            ending = run_apart(command, Path(place), TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise EngineError(f"{python} cannot be run: {getattr(error, 'strerror', None) or error}") from error
        if ending.problem or not target.exists():
            raise EngineError(ending.problem or "ended well, but it left no result")
        result = json.loads(target.read_text())
        return Ends(result["version"], result["starts"], tuple(result["ends"]))
