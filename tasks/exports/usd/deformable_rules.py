"""Rules for deformable bodies in a USD scene, by either family of names that engines read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.exports.findings import Finding
from tasks.exports.usd.prims import applied, array_of, is_body, is_deformable, number, simulation_kind, subtree, traverse, triangles
from tasks.geometry.tetrahedra import surface_of, volumes_of


def deformables(stage: Any, path: Path) -> Iterator[Finding]:
    """One simulation mesh per deformable body, sound, with a mass and a material, and nothing rigid about it."""
    for prim in traverse(stage):
        if is_deformable(prim):
            yield from _body(prim)
        kind = simulation_kind(prim)
        if kind is not None:
            if not is_deformable(prim) and not is_deformable(prim.GetParent()):
                yield Finding("deformable", _path(prim), "is deformed, but neither it nor its parent is a deformable body")
            yield from _mesh(prim, kind)
            yield from _material(prim, kind)


def _body(prim: Any) -> Iterator[Finding]:
    """A deformable body itself."""
    from pxr import Usd

    rigid = [child for child in subtree(prim) if is_body(child)]
    if rigid:
        yield Finding("deformable_body", _path(prim), f"is deformed, but {rigid[0].GetPath()} is a rigid body")
    meshes = [child for child in (prim, *prim.GetFilteredChildren(Usd.TraverseInstanceProxies())) if simulation_kind(child) is not None]
    if len(meshes) != 1:
        yield Finding("deformable", _path(prim), f"{len(meshes)} simulation meshes, on it and right below it, not one")
    for family in ("physics", "omniphysics"):
        attribute = prim.GetAttribute(f"{family}:mass")
        if not attribute or not attribute.IsValid():
            continue
        mass = number(attribute)
        if mass is None or not np.isfinite(mass) or mass <= 0:
            yield Finding("deformable_mass", _path(prim), f"{family}:mass is {'no number' if mass is None else f'{mass:g}'}")
    if all(number(prim.GetAttribute(f"{family}:mass")) is None for family in ("physics", "omniphysics")):
        yield Finding("deformable_mass", _path(prim), "is not stated: engines take water's density", False)


def _mesh(prim: Any, kind: str) -> Iterator[Finding]:
    """What is deformed: tetrahedra that are not inverted, with a closed surface, or a manifold sheet of triangles."""
    from pxr import UsdGeom

    if kind == "Volume":
        if not prim.IsA(UsdGeom.TetMesh):
            yield Finding("tetrahedra", _path(prim), f"is a {prim.GetTypeName() or 'prim without type'}, not a TetMesh")
            return
        mesh = UsdGeom.TetMesh(prim)
        vertices = array_of(mesh.GetPointsAttr(), np.float64, 3)
        corners = array_of(mesh.GetTetVertexIndicesAttr(), np.int64, 4)
        if vertices is None or corners is None or not np.isfinite(vertices).all() or corners.min() < 0 or corners.max() >= len(vertices):
            yield Finding("tetrahedra", _path(prim), "positions or tetrahedra are missing, not finite or out of range")
            return
        sign = -1.0 if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded else 1.0
        volumes = sign * volumes_of(vertices, corners)
        if (volumes <= 0).any():
            yield Finding("tetrahedra", _path(prim), f"{int((volumes <= 0).sum())} of {len(corners)} tetrahedra are flat or inverted")
        surface = surface_of(corners)
        if not _closed(surface):
            yield Finding("tetrahedra", _path(prim), "its surface is not closed, or touches itself along an edge")
        stated = array_of(mesh.GetSurfaceFaceVertexIndicesAttr(), np.int64, 3)
        if stated is None or sorted(map(tuple, np.sort(stated, axis=1))) != sorted(map(tuple, np.sort(surface, axis=1))):
            yield Finding("tetrahedra", _path(prim), "surfaceFaceVertexIndices are not the surface of the tetrahedra")
    elif kind == "Surface":
        mesh = triangles(prim) if prim.IsA(UsdGeom.Mesh) else None
        if mesh is None:
            yield Finding("sheet", _path(prim), "is no mesh with finite positions and triangles that name them")
            return
        faces = mesh[1]
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        most = int(np.unique(edges, axis=0, return_counts=True)[1].max())
        if most > 2:
            yield Finding("sheet", _path(prim), f"{most} triangles meet in one edge")
        a, b, c = (mesh[0][faces[:, i]] for i in range(3))
        flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) <= 1e-12
        if flat.any():
            yield Finding("sheet", _path(prim), f"{int(flat.sum())} of {len(faces)} triangles have no area")


def _closed(surface: NDArray[np.int64]) -> bool:
    """Whether every edge of a surface, shape (k, 3), is passed once in each direction."""
    edges = surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    there, count = np.unique(edges, axis=0, return_counts=True)
    back = np.unique(edges[:, ::-1], axis=0)
    return bool((count == 1).all() and there.shape == back.shape and (there == back).all())


def _material(prim: Any, kind: str) -> Iterator[Finding]:
    """Young's modulus above zero, Poisson's ratio of a stable solid."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    names = applied(material.GetPrim()) if material else set()
    if not names & {f"Physics{kind}DeformableMaterialAPI", f"OmniPhysics{kind}DeformableMaterialAPI", "OmniPhysicsDeformableMaterialAPI"}:
        yield Finding("deformable_material", _path(prim), "no deformable material is bound: every engine takes its own stiffness", False)
        return
    for family in ("physics", "omniphysics"):
        young, poisson = (number(material.GetPrim().GetAttribute(f"{family}:{name}")) for name in ("youngsModulus", "poissonsRatio"))
        if young is not None and not (np.isfinite(young) and young > 0):
            yield Finding("deformable_material", _path(prim), f"{family}:youngsModulus is {young:g}")
        if poisson is not None and not -1.0 < poisson < 0.5:
            yield Finding("deformable_material", _path(prim), f"{family}:poissonsRatio is {poisson:g}, not within -1 and 0.5")


def _path(prim: Any) -> str:
    return str(prim.GetPath().pathString)
