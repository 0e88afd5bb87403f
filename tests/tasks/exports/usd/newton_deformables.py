"""Run by the interpreter of Newton: a USD file's deformable bodies under gravity, on the CPU. Imports nothing of ours.

Arguments: the file, seconds, where to write the result as JSON: by simulation mesh its mass, and every tenth of the time
its lowest and highest corner, its center [m], and its greatest speed [m/s].
"""

import json
import sys

import newton
import numpy as np
import warp


def main(path: str, seconds: float, result: str) -> None:
    warp.config.quiet = True
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.default_particle_radius = 0.005  # of what is made of tetrahedra; ten centimetres else
    builder.add_usd(path, load_visual_shapes=False)
    builder.color()
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e4, 1e-3, 0.6
    solver = newton.solvers.SolverVBD(model, iterations=5, particle_enable_self_contact=False)
    now, then, control = model.state(), model.state(), model.control()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    steps = round(seconds * 300)
    spans = _spans(model)
    masses = model.particle_mass.numpy()
    found = {name: {"mass": float(masses[a:b].sum()), "at": []} for name, (a, b) in spans.items()}
    for step in range(steps + 1):
        if step % max(steps // 10, 1) == 0:
            q, v = now.particle_q.numpy().astype(float), now.particle_qd.numpy().astype(float)
            for name, (a, b) in spans.items():
                mine = q[a:b]
                state = [mine.min(axis=0).tolist(), mine.max(axis=0).tolist(), mine.mean(axis=0).tolist()]
                found[name]["at"].append([*state, float(np.linalg.norm(v[a:b], axis=1).max())])
        now.clear_forces()
        pipeline.collide(now, contacts)
        solver.step(now, then, control, contacts, 1 / 300)
        now, then = then, now
    with open(result, "w") as file:
        json.dump(found, file)


def _spans(model) -> dict:
    """Particles of every deformable body, by the path of its simulation mesh."""
    found = {}
    for kind in ("surface", "volume"):
        starts, ends = getattr(model, f"{kind}_particle_start"), getattr(model, f"{kind}_particle_end")
        labels = getattr(model, f"{kind}_label")
        found |= {label: (int(a), int(b)) for label, a, b in zip(labels, starts.numpy(), ends.numpy(), strict=True)}
    return found


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3])
