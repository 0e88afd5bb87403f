"""Run by the interpreter of Newton's own environment, never imported: scene.npz in, settled.npz out.

Only Newton, Warp and NumPy are there; `newton_engine` writes the one file, starts this and reads the other.
"""

import sys
from typing import Any

import numpy as np


def model_of(scene: Any, newton: Any, wp: Any) -> Any:
    """The scene as a Newton model. Shapes are named `<body>/<piece>`; fixed bodies' and walls' belong to the world."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -9.81))
    stiffness, damping = (float(v) for v in scene["contact"])

    def config(friction: float) -> Any:
        return newton.ModelBuilder.ShapeConfig(density=0.0, ke=stiffness, kd=damping, mu=friction)

    builder.add_ground_plane(cfg=config(float(scene["room_friction"])))
    corners = [np.concatenate([[0], np.cumsum(scene[key])]) for key in ("vertex_counts", "face_counts")]
    links = {}
    for number, pose in enumerate(scene["poses"]):
        if scene["is_free"][number]:
            links[number] = builder.add_body(
                xform=wp.transform(*pose), mass=float(scene["masses"][number]), com=wp.vec3(*scene["centers"][number]),
                inertia=wp.mat33(*scene["inertias"][number].ravel()), lock_inertia=True, label=f"{number}",
            )  # fmt: skip
    for piece, owner in enumerate(int(v) for v in scene["owners"]):
        mesh = newton.Mesh(
            scene["vertices"][corners[0][piece] : corners[0][piece + 1]].astype(np.float32),
            scene["faces"][corners[1][piece] : corners[1][piece + 1]].astype(np.int32).ravel(), compute_inertia=False,
        )  # fmt: skip
        builder.add_shape_convex_hull(
            links.get(owner, -1), mesh=mesh, cfg=config(float(scene["frictions"][owner])), label=f"{owner}/{piece}",
            xform=None if owner in links else wp.transform(*scene["poses"][owner]),
        )  # fmt: skip
    return builder.finalize(device="cpu"), links


def start_penetration(solver: Any, scene: Any) -> np.ndarray:
    """Deepest penetration of every body with anything, as Newton's engine sees it at the start [m], shape (n,)."""
    import mujoco

    model, data = solver.mj_model, solver.mj_data
    mujoco.mj_forward(model, data)
    depth = np.zeros(len(scene["poses"]))
    for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        for geom in geoms:
            owner = model.geom(int(geom)).name.split("/")[0]
            if owner.isdigit():
                depth[int(owner)] = max(depth[int(owner)], -float(distance))
    return depth


def contact_penetration(model: Any, state: Any, contacts: Any, scene: Any) -> np.ndarray:
    """The same by Newton's own contacts, which XPBD takes. Shape 0 is the ground, then come the pieces."""
    count = int(contacts.rigid_contact_count.numpy()[0])
    bodies, poses = model.shape_body.numpy(), state.body_q.numpy() if model.body_count else np.zeros((0, 7))
    ends = []
    for side in "01":
        shapes = getattr(contacts, f"rigid_contact_shape{side}").numpy()[:count]
        points = getattr(contacts, f"rigid_contact_point{side}").numpy()[:count].astype(np.float64)
        for row, body in enumerate(bodies[shapes]):
            if body >= 0:
                place, axis, w = poses[body, :3], poses[body, 3:6], poses[body, 6]
                points[row] += 2.0 * np.cross(axis, np.cross(axis, points[row]) + w * points[row]) + place
        ends.append((shapes, points, getattr(contacts, f"rigid_contact_margin{side}").numpy()[:count]))
    (first, start, near), (second, end, far) = ends
    distances = ((end - start) * contacts.rigid_contact_normal.numpy()[:count]).sum(axis=1) - near - far
    depth = np.zeros(len(scene["poses"]))
    for a, b, distance in zip(first, second, distances, strict=True):
        for shape in (a, b):
            if shape > 0:
                owner = int(scene["owners"][shape - 1])
                depth[owner] = max(depth[owner], -float(distance))
    return depth


def main(source: str, target: str) -> None:
    """Simulate the scene in `source` and write what became of it to `target`."""
    import newton
    import warp as wp

    wp.config.quiet = True
    scene = np.load(source)
    model, links = model_of(scene, newton, wp)
    now, following, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, now)
    is_xpbd = str(scene["solver"]) == "xpbd"
    if is_xpbd:
        solver = newton.solvers.SolverXPBD(model, iterations=int(scene["xpbd_iterations"]))
        depth, used = contact_penetration(model, now, model.collide(now), scene), "XPBD"
    else:
        import mujoco

        solver = newton.solvers.SolverMuJoCo(
            model, use_mujoco_cpu=True, enable_multiccd=True, cone="elliptic", impratio=float(scene["impratio"]), solver="newton",
            iterations=int(scene["iterations"]),
        )  # fmt: skip
        solver.mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a state that went astray must not look like the start
        depth, used = start_penetration(solver, scene), f"MuJoCo {mujoco.__version__}"
    steps = int(scene["steps"])
    for _ in range(steps):
        now.clear_forces()
        solver.step(now, following, control, model.collide(now) if is_xpbd else None, float(scene["timestep"]))
        now, following = following, now
    settled = np.array(scene["poses"], dtype=np.float64)
    states = now.body_q.numpy().astype(np.float64) if links else np.zeros((0, 7))
    for number, link in links.items():
        settled[number] = states[link]
    version = f"{newton.__version__}, solver {used}"
    np.savez(target, settled=settled, depth=depth, version=np.array(version))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
