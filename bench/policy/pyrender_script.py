"""Run by an interpreter of its own, with `requirements/pyrender.lock`: a request in JSON in, pictures per CPU second out."""

import json
import os
import sys
import time
from typing import Any

import numpy as np


def drawn(request: dict[str, Any]) -> dict[str, Any]:
    """Pictures per CPU second of a scene from cameras, by size: color with depth, and parts in a second pass. Of the first camera at
    the first size `depth` [m], 0 for none, `parts` by number, -1 for none, and the mean of `color`."""
    import pyrender
    import trimesh

    loaded: Any = trimesh.load(request["scene"])
    scene = pyrender.Scene(bg_color=[0, 0, 0, 0])
    parts = {}
    for name in loaded.graph.nodes_geometry:  # part_<number>
        pose, geometry = loaded.graph[name]
        number = 1 + int(name.rpartition("_")[2])  # black is nothing
        node = scene.add(pyrender.Mesh.from_trimesh(loaded.geometry[geometry], smooth=False), pose=pose)
        parts[node] = [number >> 16 & 255, number >> 8 & 255, number & 255]
    yfov = np.radians(request["hfov_degrees"])  # pictures are square
    eye = scene.add(pyrender.PerspectiveCamera(yfov=yfov, znear=1e-3, aspectRatio=1.0))
    poses = np.array(request["poses"]) @ np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's cameras look along -z
    flat = pyrender.RenderFlags.FLAT | pyrender.RenderFlags.SKIP_CULL_FACES
    seen = pyrender.RenderFlags.SEG | pyrender.RenderFlags.SKIP_CULL_FACES
    rates: dict[str, dict[str, float]] = {"pyrender, color and depth": {}, "pyrender": {}}
    depth: Any = None
    numbers: Any = None
    color: Any = None
    for size in request["sizes"]:
        renderer = pyrender.OffscreenRenderer(size, size)

        def look(passes: int, renderer: Any = renderer) -> float:
            clock = time.process_time()
            for pose in poses:
                scene.set_pose(eye, pose)
                renderer.render(scene, flags=flat)
                if passes > 1:
                    renderer.render(scene, flags=seen, seg_node_map=parts)
            return time.process_time() - clock

        for name, passes in (("pyrender, color and depth", 1), ("pyrender", 2)):
            look(passes)
            seconds: list[float] = []
            end = time.perf_counter() + request["seconds"]
            while not seconds or time.perf_counter() < end:
                seconds.append(look(passes))
            rates[name][str(size)] = len(poses) / min(seconds)
        if depth is None:
            scene.set_pose(eye, poses[0])
            color, depth = renderer.render(scene, flags=flat)
            numbers = renderer.render(scene, flags=seen, seg_node_map=parts)[0].astype(int) @ [1 << 16, 1 << 8, 1]
        renderer.delete()
    first = {"depth": np.round(depth.astype(float), 4).tolist(), "parts": (numbers - 1).tolist(), "color": float(color.mean())}
    return {"rates": rates, **first}


if __name__ == "__main__":
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    answers = sys.stdout
    sys.stdout = sys.stderr  # whoever else prints
    answers.write(json.dumps(drawn(json.load(sys.stdin))))
