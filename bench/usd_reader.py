"""A USD scene as a MuJoCo model, out of nothing but its files: a reader that had no part in writing them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.optimization.engines.mujoco_engine import Mujoco, contact_of, empty_spec, friction_of, mujoco_module

ROOM = frozenset({"floor", "wall", "ceiling"})
"""Labels of the class `class` that make a static collider a part of the room."""


def model_of(path: Path, settings: Mujoco | None = None) -> Any:
    """The bodies and colliders of a USD scene as a compiled MuJoCo model, with the settings of certificates by default.

    Bodies have the names of their prims and free joints; what collides without being a body is static. An object's friction
    is measured against floors, and MuJoCo takes the greater of a pair: so the room gets next to none, as in certificates.
    Restitution is not read, since MuJoCo has none.

    Raises:
        ValueError: MuJoCo refuses the scene, or a collider is no mesh.
    """
    from pxr import Usd

    mujoco = mujoco_module()
    options = settings or Mujoco()
    stage = Usd.Stage.Open(str(path))
    spec = _spec(stage, options)
    owners = {prim.GetPath(): _add_body(spec, prim) for prim in _prims(stage) if _has(prim, "RigidBodyAPI")}
    for number, prim in enumerate(prim for prim in _prims(stage) if _has(prim, "CollisionAPI")):
        owner = prim
        while owner and owner.GetPath() not in owners:
            owner = owner.GetParent()
        vertices, faces = _collider(prim, owner if owner else stage.GetPseudoRoot())
        name = f"hull_{number}"
        spec.add_mesh(
            name=name, uservert=vertices.ravel(), userface=faces.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        )  # fmt: skip
        target = owners[owner.GetPath()] if owner else spec.worldbody
        friction = friction_of(0.0 if not owner and _is_room(prim) else _friction(prim), options)
        target.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, friction=friction, **contact_of(options))
    return spec.compile()


def _spec(stage: Any, settings: Mujoco) -> Any:
    """An empty scene with the gravity of the file."""
    from pxr import UsdPhysics

    spec = empty_spec(settings)
    for prim in _prims(stage):
        if prim.IsA(UsdPhysics.Scene):
            scene = UsdPhysics.Scene(prim)
            spec.option.gravity = np.array(scene.GetGravityDirectionAttr().Get()) * scene.GetGravityMagnitudeAttr().Get()
    return spec


def _add_body(spec: Any, prim: Any) -> Any:
    """A rigid body with a free joint and the mass properties that its prim states."""
    from pxr import UsdGeom, UsdPhysics

    place = UsdGeom.XformCache().GetLocalToWorldTransform(prim)
    turn = place.ExtractRotationQuat()
    body = spec.worldbody.add_body(
        name=prim.GetName(), pos=list(place.ExtractTranslation()), quat=[turn.GetReal(), *turn.GetImaginary()]
    )  # fmt: skip
    body.add_freejoint()
    mass = UsdPhysics.MassAPI(prim)
    axes = mass.GetPrincipalAxesAttr().Get()
    body.explicitinertial = True
    body.mass, body.ipos = mass.GetMassAttr().Get(), list(mass.GetCenterOfMassAttr().Get())
    body.iquat, body.inertia = [axes.GetReal(), *axes.GetImaginary()], list(mass.GetDiagonalInertiaAttr().Get())
    return body


def _collider(prim: Any, owner: Any) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices of a collider in its owner's frame [m], shape (n, 3), and its triangles, shape (m, 3)."""
    from pxr import UsdGeom

    if not prim.IsA(UsdGeom.Mesh):
        raise ValueError(f"{prim.GetPath()}: is a {prim.GetTypeName()}, not a mesh")
    cache, mesh = UsdGeom.XformCache(), UsdGeom.Mesh(prim)
    local = np.array(cache.GetLocalToWorldTransform(prim) * cache.GetLocalToWorldTransform(owner).GetInverse())
    points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64) @ local[:3, :3] + local[3, :3]
    return points, np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int32).reshape(-1, 3)


def _friction(prim: Any) -> float:
    """Coefficient of friction of the physics material that is bound to a prim."""
    from pxr import UsdPhysics, UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    return float(UsdPhysics.MaterialAPI(material).GetStaticFrictionAttr().Get())


def _is_room(prim: Any) -> bool:
    """Whether a static collider belongs to what its labels call the room."""
    from pxr import UsdSemantics

    while prim and not prim.IsPseudoRoot():
        labels = UsdSemantics.LabelsAPI(prim, "class").GetLabelsAttr()
        if labels and labels.Get():
            return bool(ROOM & set(labels.Get()))
        prim = prim.GetParent()
    return False


def _prims(stage: Any) -> Iterator[Any]:
    """All prims of a stage, those below instances too."""
    from pxr import Usd

    return iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


def _has(prim: Any, name: str) -> bool:
    """Whether a schema of UsdPhysics is applied to a prim."""
    from pxr import UsdPhysics

    return bool(prim.HasAPI(getattr(UsdPhysics, name)))
