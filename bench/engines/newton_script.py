"""Run by the interpreter of Newton's own environment, never imported: request.json in, result.json out.

Newton reads the USD file itself. Its contacts have no stiffness in USD, and with its default of 2,500 N/m objects sink in by centimeters.
"""

import json
import sys
from pathlib import Path
from typing import Any


def model_of(newton: Any, path: str, settings: dict[str, Any]) -> tuple[Any, dict[str, int]]:
    """The file's scene as a Newton model, and its free bodies by the names of their prims."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    if "ke" in settings:
        builder.default_shape_cfg.ke, builder.default_shape_cfg.kd = settings["ke"], settings["kd"]
    read = builder.add_usd(path, load_visual_shapes=False)
    bodies = {prim.rsplit("/", 1)[-1]: body for prim, body in read["path_body_map"].items()}
    return builder.finalize(device="cpu"), bodies


def solver_of(newton: Any, model: Any, settings: dict[str, Any]) -> tuple[Any, str]:
    """The solver, and what it is called."""
    if settings["solver"] == "xpbd":
        return newton.solvers.SolverXPBD(model, iterations=settings["iterations"]), "XPBD"
    import mujoco

    solver = newton.solvers.SolverMuJoCo(
        model, use_mujoco_cpu=True, enable_multiccd=settings["multiccd"], cone=settings["cone"], impratio=settings["impratio"],
        solver="newton", iterations=settings["iterations"],
    )  # fmt: skip
    solver.mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a state that went astray must not look like the start
    return solver, f"MuJoCo {mujoco.__version__}"


def poses(state: Any, bodies: dict[str, int]) -> dict[str, list[float]]:
    """Poses of bodies: x, y, z [m], then the quaternion w, x, y, z."""
    rows = state.body_q.numpy().astype(float).tolist() if bodies else []
    return {name: [*rows[body][:3], rows[body][6], *rows[body][3:6]] for name, body in bodies.items()}


def main(source: str, target: str) -> None:
    """Simulate the scene that `source` names once per velocity and write where its free bodies end to `target`."""
    import newton
    import numpy as np
    import warp as wp

    wp.config.quiet = True
    request = json.loads(Path(source).read_text())
    settings = request["settings"]
    model, bodies = model_of(newton, request["file"], settings)
    steps, ends, used = round(request["seconds"] / settings["timestep_s"]), [], ""
    at_first = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, at_first)
    for velocity in request["velocities"]:
        now, following, control = model.state(), model.state(), model.control()
        speeds = np.zeros(model.joint_qd.shape[0], dtype=np.float32).reshape(-1, 6)  # free joints: linear, then angular
        speeds[:, :3] = velocity
        now.joint_qd.assign(speeds.ravel())
        newton.eval_fk(model, model.joint_q, now.joint_qd, now)
        solver, used = solver_of(newton, model, settings)
        collides = settings["solver"] == "xpbd"
        for _ in range(steps):
            now.clear_forces()
            solver.step(now, following, control, model.collide(now) if collides else None, settings["timestep_s"])
            now, following = following, now
        ends.append(poses(now, bodies))
    version = f"{newton.__version__}, {used}"
    Path(target).write_text(json.dumps({"version": version, "starts": poses(at_first, bodies), "ends": ends}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
