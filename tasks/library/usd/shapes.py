"""Geometry of USD prims as triangles over corners: meshes of any polygons, and the solids that USD knows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.polygons import triangulate

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CYCLES = {"X": (2, 0, 1), "Y": (1, 2, 0), "Z": (0, 1, 2)}
"""Order of coordinates that turns a solid around z to another axis."""

SECTIONS = 24
"""Sides of round solids."""


@dataclasses.dataclass(frozen=True)
class Polygons:
    """Faces of any number of corners. points: In the prim's frame, shape (n, 3). point_of: every corner's point, shape (c,). face_of:
    every corner's face, shape (c,). triangles: of corners, shape (m, 3). owner: every triangle's face, shape (m,).
    notes: faces that are not exact, a line each."""

    points: Array
    point_of: Integers
    face_of: Integers
    triangles: Integers
    owner: Integers
    notes: tuple[str, ...] = ()


def polygons_of(prim: Any, name: str) -> Polygons | None:
    """The geometry of a gprim in its own frame; None for kinds that have no surface.

    Raises:
        InputError: counts, indices and points do not fit together.
    """
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.Mesh):
        return _mesh(UsdGeom.Mesh(prim), name)
    solid = _solid(prim)
    if solid is None:
        return None
    faces = np.asarray(solid.faces, dtype=np.int64)
    corners = np.arange(faces.size).reshape(-1, 3)
    owner = np.arange(len(faces))
    return Polygons(np.asarray(solid.vertices, dtype=np.float64), faces.reshape(-1), np.repeat(owner, 3), corners, owner)


def first(attribute: Any) -> Any:
    """The value of an attribute, or its earliest sample."""
    from pxr import Usd

    return attribute.Get(Usd.TimeCode.EarliestTime())


def numbers(value: Any, kind: Any, width: int) -> NDArray[Any]:
    """Values of an attribute that may have none, shape (n, width)."""
    return np.array([] if value is None else value, dtype=kind).reshape(-1, width)


def _mesh(mesh: Any, name: str) -> Polygons:
    points = numbers(first(mesh.GetPointsAttr()), np.float64, 3)
    counts = numbers(first(mesh.GetFaceVertexCountsAttr()), np.int64, 1)[:, 0]
    point_of = numbers(first(mesh.GetFaceVertexIndicesAttr()), np.int64, 1)[:, 0]
    path = str(mesh.GetPath())
    if counts.min(initial=0) < 0 or counts.sum() != len(point_of):
        raise InputError(name, path, f"has {len(point_of)} corners where its faces count {counts.sum()}", "export it again")
    if len(point_of) and not 0 <= point_of.min() <= point_of.max() < len(points):
        raise InputError(name, path, "has faces of points that are not there", "export it again")
    triangulation = triangulate(points[point_of], counts)
    triangles = triangulation.corners
    if first(mesh.GetOrientationAttr()) == "leftHanded":
        triangles = triangles[:, ::-1]
    face_of = np.repeat(np.arange(len(counts)), counts)
    return Polygons(points, point_of, face_of, triangles, triangulation.owner, triangulation.notes)


def _solid(prim: Any) -> Any:
    """A solid of USD as a trimesh around the origin, None for other kinds."""
    import trimesh
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.Cube):
        return trimesh.creation.box([float(first(UsdGeom.Cube(prim).GetSizeAttr()))] * 3)
    if prim.IsA(UsdGeom.Sphere):
        return trimesh.creation.uv_sphere(float(first(UsdGeom.Sphere(prim).GetRadiusAttr())), (SECTIONS, SECTIONS))
    makers = {
        UsdGeom.Cylinder: lambda height, radius: trimesh.creation.cylinder(radius, height, sections=SECTIONS),
        UsdGeom.Cone: lambda height, radius: trimesh.creation.cone(radius, height, sections=SECTIONS),
        UsdGeom.Capsule: lambda height, radius: trimesh.creation.capsule(height, radius, count=(SECTIONS, SECTIONS)),
    }
    for kind, make in makers.items():
        if prim.IsA(kind):
            shape = kind(prim)
            solid = make(float(first(shape.GetHeightAttr())), float(first(shape.GetRadiusAttr())))
            vertices = np.asarray(solid.vertices) - [0.0, 0.0, 0.5 * float(solid.bounds[:, 2].sum())]
            solid.vertices = vertices[:, CYCLES[str(first(shape.GetAxisAttr()))]]
            return solid
    return None


def subsets(prim: Any, shape: Polygons) -> Iterator[tuple[Any, NDArray[np.bool_]]]:
    """Prims that carry a material, and the triangles that it is of, shape (m,): subsets of a mesh, and the mesh with what they leave."""
    from pxr import UsdGeom, UsdShade

    left = np.ones(len(shape.triangles), dtype=bool)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets() if prim.IsA(UsdGeom.Mesh) else ():
        chosen = left & np.isin(shape.owner, numbers(first(subset.GetIndicesAttr()), np.int64, 1)[:, 0])
        left &= ~chosen
        if chosen.any():
            yield subset.GetPrim(), chosen
    if left.any():
        yield prim, left
