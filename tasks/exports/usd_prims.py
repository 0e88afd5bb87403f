"""Prims of a USD stage as physics sees them: which are bodies and colliders, and their geometry as plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    found = []
    for prim in subtree(body):
        owner = prim
        while not is_body(owner):
            owner = owner.GetParent()
        if owner == body and is_collider(prim):
            found.append(prim)
    return found


def triangles(prim: Any) -> Triangles | None:
    """Positions and triangles of a mesh prim in its own frame, or None when they do not fit together."""
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(prim)
    points, counts, indices = mesh.GetPointsAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
    if not points or not counts or not indices:
        return None
    vertices = np.asarray(points, dtype=np.float64)
    sizes, corners = np.asarray(counts, dtype=np.int64), np.asarray(indices, dtype=np.int64)
    if not np.isfinite(vertices).all() or sizes.min() < 3 or sizes.sum() != len(corners):
        return None
    if corners.min() < 0 or corners.max() >= len(vertices):
        return None
    first = np.cumsum(sizes) - sizes
    fans = np.repeat(np.arange(len(sizes)), sizes - 2)
    step = np.arange(len(fans)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return vertices, np.stack([corners[first[fans]], corners[first[fans] + step + 1], corners[first[fans] + step + 2]], axis=1)


def to_world(prim: Any) -> NDArray[np.float64]:
    """Prim to world, column vectors, 4x4."""
    from pxr import Usd, UsdGeom

    return np.array(UsdGeom.XformCache(Usd.TimeCode.Default()).GetLocalToWorldTransform(prim), dtype=np.float64).T


def dent(mesh: Triangles) -> float:
    """How far [m] a vertex of a mesh lies in front of one of its faces: 0 for a convex mesh with outward triangles."""
    vertices, faces = mesh
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-12] / lengths[lengths > 1e-12][:, None]
    offsets = np.einsum("ij,ij->i", normals, corners[lengths > 1e-12][:, 0])
    used = vertices[np.unique(faces)]
    # slivers have no direction to speak of: judge by faces that are larger than a square millimetre
    large = lengths[lengths > 1e-12] > 2e-6
    return float(((used @ normals.T) - offsets)[:, large].max(initial=0.0)) if large.any() else 0.0


def box_of(body: Any, wanted: Callable[[Any], bool]) -> NDArray[np.float64] | None:
    """Box of the mesh prims below a body that are `wanted`, in the body's frame [units of the stage], shape (2, 3)."""
    from pxr import UsdGeom

    inverse = np.linalg.inv(to_world(body))
    corners = []
    for prim in subtree(body):
        mesh = triangles(prim) if prim.IsA(UsdGeom.Mesh) and wanted(prim) else None
        if mesh is not None:
            local = inverse @ to_world(prim)
            corners.append(mesh[0] @ local[:3, :3].T + local[:3, 3])
    if not corners:
        return None
    points = np.concatenate(corners)
    return np.array([points.min(axis=0), points.max(axis=0)])


def is_visible(prim: Any) -> bool:
    """Whether a prim is drawn."""
    from pxr import UsdGeom

    image, tokens = UsdGeom.Imageable(prim), UsdGeom.Tokens
    shown = image.ComputePurpose() in (tokens.default_, tokens.render) and image.ComputeVisibility() != tokens.invisible
    return bool(prim.IsA(UsdGeom.Gprim)) and shown


def objects(stage: Any) -> list[Any]:
    """Rigid bodies, and models (kind component) that have colliders without being one."""
    from pxr import Kind, Usd

    components = [prim for prim in traverse(stage) if Usd.ModelAPI(prim).GetKind() == Kind.Tokens.component]
    fixed = [
        prim for prim in components
        if any(is_collider(below) for below in subtree(prim)) and not any(is_body(below) for below in subtree(prim))
    ]  # fmt: skip
    return bodies(stage) + fixed
