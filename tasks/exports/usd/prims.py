"""Prims of a USD stage as physics sees them: which are bodies and colliders, and their geometry as plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.triangles import face_planes

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Positions in the prim's own frame, shape (n, 3), and triangles, shape (m, 3)."""


def traverse(stage: Any) -> Iterator[Any]:
    """All prims of a stage, those below instances too."""
    from pxr import Usd

    return iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


def subtree(prim: Any) -> Iterator[Any]:
    """A prim and all prims below it, those below instances too."""
    from pxr import Usd

    return iter(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))


def is_ours(stage: Any) -> bool:
    """Whether this project wrote the root layer of a stage: then what USD would allow is held against it all the same."""
    prim = stage.GetDefaultPrim()
    return "metascenes" in stage.GetRootLayer().customLayerData or bool(prim and "metascenes" in prim.GetCustomData())


def is_lit(stage: Any) -> bool:
    """Whether this project wrote a stage since scenes have lights and a camera; what it asks for since then is a warning in older ones."""
    return is_ours(stage) and "cameraSettings" in stage.GetRootLayer().customLayerData


def is_body(prim: Any) -> bool:
    """Whether a prim is a rigid body."""
    from pxr import UsdPhysics

    return bool(prim.HasAPI(UsdPhysics.RigidBodyAPI))


def is_collider(prim: Any) -> bool:
    """Whether a prim collides."""
    from pxr import UsdPhysics

    if not prim.HasAPI(UsdPhysics.CollisionAPI):
        return False
    enabled = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get()
    return enabled is not False


def applied(prim: Any) -> set[str]:
    """Names of the schemas applied to a prim, those too that USD does not know."""
    return set(prim.GetPrimTypeInfo().GetAppliedAPISchemas())


def is_deformable(prim: Any) -> bool:
    """Whether a prim is a deformable body, by either family of names in use."""
    return bool(applied(prim) & {"PhysicsDeformableBodyAPI", "OmniPhysicsDeformableBodyAPI"})


def simulation_kind(prim: Any) -> str | None:
    """`Surface`, `Volume` or `Curves` for a mesh that an engine deforms, else None."""
    names = applied(prim)
    for kind in ("Surface", "Volume", "Curves"):
        if names & {f"Physics{kind}DeformableSimAPI", f"OmniPhysics{kind}DeformableSimAPI"}:
            return kind
    return None


def number(attribute: Any) -> float | None:
    """Value of an attribute, or None: it has none, or one that is no number."""
    value = attribute.Get() if attribute and attribute.IsValid() else None
    try:
        return float(value) if value is not None else None
    except (TypeError, ValueError):
        return None


def vector(attribute: Any, length: int = 3) -> NDArray[np.float64] | None:
    """Value of an attribute, shape (length,), or None: it has none, or one that is no such vector."""
    value = attribute.Get() if attribute and attribute.IsValid() else None
    try:
        array = np.array(value if value is not None else (), dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.shape == (length,) else None


def bodies(stage: Any) -> list[Any]:
    """All rigid bodies of a stage."""
    return [prim for prim in traverse(stage) if is_body(prim)]


def moves(prim: Any) -> bool:
    """Whether a rigid body is moved by forces."""
    from pxr import UsdPhysics

    api = UsdPhysics.RigidBodyAPI(prim)
    return api.GetRigidBodyEnabledAttr().Get() is not False and not api.GetKinematicEnabledAttr().Get()


def own_colliders(body: Any) -> list[Any]:
    """Colliders that belong to a body and not to one below it."""
    colliders = []
    for prim in subtree(body):
        owner = prim
        while not is_body(owner):
            owner = owner.GetParent()
        if owner == body and is_collider(prim):
            colliders.append(prim)
    return colliders


def triangles(prim: Any) -> Triangles | None:
    """Positions and triangles of a mesh prim in its own frame, or None when they do not fit together."""
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(prim)
    vertices = array_of(mesh.GetPointsAttr(), np.float64, 3)
    sizes, corners = array_of(mesh.GetFaceVertexCountsAttr(), np.int64), array_of(mesh.GetFaceVertexIndicesAttr(), np.int64)
    if vertices is None or sizes is None or corners is None:
        return None
    if not np.isfinite(vertices).all() or sizes.min() < 3 or sizes.sum() != len(corners):
        return None
    if corners.min() < 0 or corners.max() >= len(vertices):
        return None
    first = np.cumsum(sizes) - sizes
    fans = np.repeat(np.arange(len(sizes)), sizes - 2)
    step = np.arange(len(fans)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return vertices, np.stack([corners[first[fans]], corners[first[fans] + step + 1], corners[first[fans] + step + 2]], axis=1)


def array_of(attribute: Any, dtype: Any, width: int = 1) -> NDArray[Any] | None:
    """An array attribute at its first time, shape (n,) or (n, width), or None: it has none, or not of that shape."""
    from pxr import Usd

    if not attribute or not attribute.IsValid():
        return None
    value = attribute.Get()
    if value is None and attribute.GetNumTimeSamples():
        value = attribute.Get(Usd.TimeCode.EarliestTime())
    try:
        array = np.asarray(value if value is not None else (), dtype=dtype)
    except (TypeError, ValueError):
        return None
    fits = array.ndim == 1 if width == 1 else array.ndim == 2 and array.shape[1] == width
    return array if fits and len(array) else None


def to_world(prim: Any, known: Any = None) -> NDArray[np.float64]:
    """Prim to world, column vectors, 4x4. known: `UsdGeom.XformCache` of the same stage, which remembers the prims above."""
    from pxr import Usd, UsdGeom

    frames = known if known is not None else UsdGeom.XformCache(Usd.TimeCode.Default())
    return np.array(frames.GetLocalToWorldTransform(prim), dtype=np.float64).T


def dent(mesh: Triangles) -> float:
    """How far [m] a vertex of a mesh lies in front of one of its faces: 0 for a convex mesh with outward triangles."""
    vertices, faces = mesh
    # slivers have no direction to speak of: judge by faces that are larger than a square millimetre
    normals, offsets = face_planes(vertices, faces, 2e-6)
    return float((vertices[np.unique(faces)] @ normals.T - offsets).max(initial=0.0))


def cloud_of(body: Any, wanted: Callable[[Any], bool]) -> NDArray[np.float64] | None:
    """World positions [units of the stage] of all that is `wanted` below a body, shape (n, 3); of cubes, spheres and the
    like the corners of their boxes. None without any."""
    from pxr import Usd, UsdGeom

    clouds, frames = [], UsdGeom.XformCache(Usd.TimeCode.Default())
    for prim in subtree(body):
        local = _points(prim) if wanted(prim) else None
        if local is not None and np.isfinite(local).all():
            place = to_world(prim, frames)
            clouds.append(local @ place[:3, :3].T + place[:3, 3])
    return np.concatenate(clouds) if clouds else None


def _points(prim: Any) -> NDArray[np.float64] | None:
    """Positions of a prim's geometry in its own frame, shape (n, 3)."""
    from pxr import Usd, UsdGeom

    if prim.IsA(UsdGeom.PointBased):
        return array_of(UsdGeom.PointBased(prim).GetPointsAttr(), np.float64, 3)
    if not prim.IsA(UsdGeom.Boundable) or prim.IsA(UsdGeom.PointInstancer):
        return None
    box = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), Usd.TimeCode.Default())
    if not box or len(box) != 2:
        return None
    low, high = np.array(box, dtype=np.float64)
    return np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def within(points: NDArray[np.float64] | None, body: Any) -> NDArray[np.float64] | None:
    """Box of world positions, shape (n, 3), in a body's frame, shape (2, 3); None for a frame without volume."""
    place = to_world(body)
    if points is None or not np.isfinite(place).all() or abs(np.linalg.det(place)) < 1e-18:
        return None
    inverse = np.linalg.inv(place)
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    return np.array([local.min(axis=0), local.max(axis=0)])


def is_visible(prim: Any) -> bool:
    """Whether a prim is drawn."""
    from pxr import UsdGeom

    image, tokens = UsdGeom.Imageable(prim), UsdGeom.Tokens
    shown = image.ComputePurpose() in (tokens.default_, tokens.render) and image.ComputeVisibility() != tokens.invisible
    return bool(prim.IsA(UsdGeom.Gprim)) and shown


def objects(stage: Any) -> list[Any]:
    """Rigid bodies, and models (kind component) that have colliders without being one: fixed or deformable objects."""
    from pxr import Kind, Usd

    components = [prim for prim in traverse(stage) if Usd.ModelAPI(prim).GetKind() == Kind.Tokens.component]
    fixed = [
        prim for prim in components
        if any(is_collider(below) for below in subtree(prim)) and not any(is_body(below) for below in subtree(prim))
    ]  # fmt: skip
    return bodies(stage) + fixed
