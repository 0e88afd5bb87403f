"""Run by the interpreter of ovphysx's own environment, never imported: request.json in, result.json out.

PhysX reads the USD file itself, through ovstage, and runs as it comes, on the CPU. Its warm-up, which tensor bindings and the GPU
want, steps by a nanosecond: what overlaps leaves at full speed. A nudge is added to the speed that a body then has.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any


def attach(physx: Any, ovstage: Any, path: str) -> Any:
    """A stage populated from the file, attached to the engine."""
    stage = ovstage.Stage("scene")
    ovstage.population.open_usd(stage, path, ordinal=1, domains=ovstage.PopulationDomain.ALL)
    stage.advance_write_floor(ordinal=1).wait()
    physx.wait_task(physx.attach_ovstage(stage, read_ordinal=1))
    return stage


def read(physx: Any, ovstage: Any, stage: Any, attribute: str) -> dict[str, list[float]]:
    """A vector of every rigid body by the name of its prim."""
    from ovphysx.types import ObjectScope, SimObjectType

    rows = {}
    with (
        ovstage.PathDictionary(stage) as paths,
        physx.read_sync(SimObjectType.RIGID_BODY, [attribute], scope=ObjectScope.ALL) as result,
    ):
        for group in result.groups:
            if group.is_delete or not group.tensors:
                continue
            values = group.tensors[0].numpy().astype(float).tolist()
            for path, value in zip(paths.get_path_strings(group.prim_list), values, strict=True):
                rows[path.rsplit("/", 1)[-1]] = value
    return rows


def poses(physx: Any, ovstage: Any, stage: Any) -> dict[str, list[float]]:
    """Poses of bodies: x, y, z [m], then the quaternion w, x, y, z."""
    turns = read(physx, ovstage, stage, "orientation")
    return {name: [*place, turns[name][3], *turns[name][:3]] for name, place in read(physx, ovstage, stage, "position").items()}


def nudge(physx: Any, velocity: list[float]) -> None:
    """Add a velocity [m/s] to that of every rigid body."""
    import numpy as np
    from ovphysx.types import ObjectScope, SimObjectType

    speeds = []
    with physx.read_sync(SimObjectType.RIGID_BODY, ["linearVelocity"], scope=ObjectScope.ALL) as result:
        speeds = [group.tensors[0].numpy() + np.array(velocity, dtype=np.float32) for group in result.groups if group.tensors]
    with physx.write_sync(SimObjectType.RIGID_BODY, "linearVelocity") as session:
        for group, rows in zip([group for group in session.groups if group.tensors], speeds, strict=True):
            group.tensors[0].assign(rows)
            session.commit_sync(group)


def main(source: str, target: str) -> None:
    """Simulate the scene that `source` names once per velocity and write where its free bodies end to `target`."""
    import ovphysx
    import ovstage
    from ovphysx.samples.python_samples.schema_support import physx_schema_paths

    request = json.loads(Path(source).read_text())
    step = request["settings"]["timestep_s"]
    ovphysx.PhysX.set_cpu_mode(True)
    physx = ovphysx.PhysX()
    ovstage.population.register_usd_schemas([*map(str, physx_schema_paths()), str(ovphysx.newton_schema_root())])
    starts: dict[str, list[float]] = {}
    ends = []
    for velocity in request["velocities"]:
        stage = attach(physx, ovstage, request["file"])
        starts = starts or poses(physx, ovstage, stage)
        if request["settings"]["warmup"]:
            physx.warmup()
            physx.wait_all()
        if any(velocity):
            nudge(physx, velocity)
        for _ in range(round(request["seconds"] / step)):
            physx.step_sync(step)
        ends.append(poses(physx, ovstage, stage))
        physx.wait_task(physx.detach_ovstage())
        stage.destroy()
    physx.destroy()
    Path(target).write_text(json.dumps({"version": version("ovphysx"), "starts": starts, "ends": ends}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
