"""Run by the interpreter of PyBullet's own environment, never imported: request.json in, result.json out.

Reads `poses.json` and lets PyBullet load the URDF files that it names. PyBullet multiplies the frictions of a pair.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any


def load(bullet: Any, poses: Path) -> dict[str, int]:
    """Room and objects where `poses.json` has them, and the free ones by name."""
    stated = json.loads(poses.read_text())
    flags = bullet.URDF_USE_INERTIA_FROM_FILE  # else PyBullet takes the inertia of the bounding box
    bullet.loadURDF(str(poses.parent / stated["room"]), useFixedBase=True, flags=flags)
    free = {}
    for item in stated["objects"]:
        w, x, y, z = item["rotation_wxyz"]
        body = bullet.loadURDF(
            str(poses.parent / item["file"]), item["position_m"], [x, y, z, w], useFixedBase=item["is_fixed"], flags=flags
        )  # fmt: skip
        if not item["is_fixed"]:
            free[item["name"]] = body
    return free


def pose_of(bullet: Any, body: int) -> list[float]:
    """Pose of a body's link frame: x, y, z [m], then the quaternion w, x, y, z."""
    center, turn = bullet.getBasePositionAndOrientation(body)  # of the center of mass, along the principal axes
    dynamics = bullet.getDynamicsInfo(body, -1)
    place, (x, y, z, w) = bullet.multiplyTransforms(center, turn, *bullet.invertTransform(dynamics[3], dynamics[4]))
    return [*place, w, x, y, z]


def main(source: str, target: str) -> None:
    """Simulate the scene that `source` names once per velocity and write where its free bodies end to `target`."""
    import pybullet as bullet

    request = json.loads(Path(source).read_text())
    step = request["settings"]["timestep_s"]
    bullet.connect(bullet.DIRECT)
    starts, ends = {}, []
    for velocity in request["velocities"]:
        bullet.resetSimulation()
        bullet.setGravity(0.0, 0.0, -9.81)
        bullet.setTimeStep(step)
        free = load(bullet, Path(request["file"]))
        starts = {name: pose_of(bullet, body) for name, body in free.items()}
        for body in free.values():
            bullet.resetBaseVelocity(body, velocity, [0.0, 0.0, 0.0])
        for _ in range(round(request["seconds"] / step)):
            bullet.stepSimulation()
        ends.append({name: pose_of(bullet, body) for name, body in free.items()})
    Path(target).write_text(json.dumps({"version": version("pybullet"), "starts": starts, "ends": ends}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
