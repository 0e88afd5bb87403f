"""An exported USD scene in a simulator: what stands rests, what hangs in the air falls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tasks import exports
from tasks.exports.usd import write_usd
from tasks.exports.usd_rules import check_usd
from tasks.transforms import translation, yaw_pose
from tests.replicas import cube, furnished, rows_of, thing
from tests.test_exports_usd import open_stage, replica_of


def to_mujoco(path: Path) -> Any:
    """The bodies and colliders of a USD scene as a MuJoCo model; nothing but the file is looked at."""
    import mujoco
    from pxr import UsdGeom, UsdPhysics, UsdShade

    stage, spec = open_stage(path), mujoco.MjSpec()
    spec.option.timestep = 0.002
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    cache, bodies = UsdGeom.XformCache(), {}
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            pose = cache.GetLocalToWorldTransform(prim)
            turn = pose.ExtractRotationQuat()
            body = spec.worldbody.add_body(
                name=prim.GetName(), pos=list(pose.ExtractTranslation()), quat=[turn.GetReal(), *turn.GetImaginary()]
            )  # fmt: skip
            body.add_freejoint()
            mass = UsdPhysics.MassAPI(prim)
            axes = mass.GetPrincipalAxesAttr().Get()
            body.explicitinertial = True
            body.mass, body.ipos = mass.GetMassAttr().Get(), list(mass.GetCenterOfMassAttr().Get())
            body.iquat = [axes.GetReal(), *axes.GetImaginary()]
            body.inertia = list(mass.GetDiagonalInertiaAttr().Get())
            bodies[prim.GetPath()] = body
    for index, prim in enumerate(p for p in stage.Traverse() if p.HasAPI(UsdPhysics.CollisionAPI)):
        owner = prim
        while owner and owner.GetPath() not in bodies:
            owner = owner.GetParent()
        target = bodies[owner.GetPath()] if owner else spec.worldbody
        root = cache.GetLocalToWorldTransform(owner) if owner else cache.GetLocalToWorldTransform(stage.GetPseudoRoot())
        local = np.array(cache.GetLocalToWorldTransform(prim) * root.GetInverse())
        points = np.array(prim.GetAttribute("points").Get(), dtype=np.float64) @ local[:3, :3] + local[3, :3]
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        friction = UsdPhysics.MaterialAPI(material).GetStaticFrictionAttr().Get()
        spec.add_mesh(name=f"hull{index}", uservert=points.reshape(-1).tolist())
        target.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull{index}", friction=[friction, 0.005, 0.0001])
    return spec.compile()


def test_objects_that_stand_rest_in_mujoco(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    things = [
        *furnished(),
        thing("bookshelf", yaw_pose(1.5707963, [-2.2, -1.7, 0.0]), seed=6, mass_kg=20.0),
        thing("mug", translation([-0.5, -0.2, 0.0]), seed=7, mass_kg=0.3),
        thing("nightstand", yaw_pose(0.0, [0.6, -0.5, 0.0]), seed=8, mass_kg=40.0),
        cube((0.2, 0.2, 0.2), translation([0.4, 0.4, 0.5]), mass_kg=1.0),  # half a metre in the air
    ]
    rows, blobs = rows_of(things)
    path = write_usd(tmp_path, replica_of(rows, blobs), exports.ExportsConfig())
    assert check_usd(path) == []
    model = to_mujoco(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.xpos.copy()
    for _ in range(500):
        mujoco.mj_step(model, data)
        assert np.isfinite(data.qpos).all()
    moved = {model.body(i).name: float(np.linalg.norm(data.xpos[i] - start[i])) for i in range(1, model.nbody)}
    assert len(moved) == len(things) - 1, "the picture hangs: it is no body"
    fallen = moved.pop("box_0010")
    assert fallen == pytest.approx(0.5, abs=0.01), "it falls to the floor, and stays on it"
    assert max(moved.values()) < 0.01, moved
