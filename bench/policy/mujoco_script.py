"""Run by an interpreter of its own, which has the OpenGL that it is told to have: a request in JSON in, pictures per CPU second out."""

import json
import sys
import time
from typing import Any

import numpy as np


def drawn(request: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Pictures per CPU second of a scene from cameras, by size: color alone, and color, depth and parts in three passes."""
    import mujoco

    spec = mujoco.MjSpec.from_file(request["scene"])
    spec.worldbody.add_camera(name="eye", fovy=request["hfov_degrees"])
    spec.visual.map.znear, spec.visual.quality.offsamples = 1e-3, 0
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    poses = np.array(request["poses"])
    rates: dict[str, dict[str, float]] = {"MuJoCo, color": {}, "MuJoCo": {}}
    for size in request["sizes"]:
        renderer = mujoco.Renderer(model, size, size)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_HAZE):
            renderer.scene.flags[flag] = 0
        for name, passes in (("MuJoCo, color", 1), ("MuJoCo", 3)):
            look(mujoco, renderer, model, data, poses, passes)
            seconds: list[float] = []
            end = time.perf_counter() + request["seconds"]
            while not seconds or time.perf_counter() < end:
                seconds.append(look(mujoco, renderer, model, data, poses, passes))
            rates[name][str(size)] = len(poses) / min(seconds)
        renderer.close()
    return rates


def look(mujoco: Any, renderer: Any, model: Any, data: Any, poses: Any, passes: int) -> float:
    """CPU seconds that pictures from OpenCV cameras, camera-to-world, shape (n, 4, 4) [m], take."""
    eye = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "eye")
    clock = time.process_time()
    for pose in poses:
        data.cam_xpos[eye], data.cam_xmat[eye] = pose[:3, 3], (pose[:3, :3] * [1, -1, -1]).reshape(-1)
        renderer.update_scene(data, camera=eye)
        renderer.render()
        if passes > 1:
            renderer.enable_depth_rendering()
            renderer.render()
            renderer.disable_depth_rendering()
            renderer.enable_segmentation_rendering()
            renderer.render()
            renderer.disable_segmentation_rendering()
    return time.process_time() - clock


if __name__ == "__main__":
    print(json.dumps({"rates": drawn(json.load(sys.stdin))}))
