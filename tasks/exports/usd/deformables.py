"""Cloth and soft bodies in USD: the mesh that an engine deforms, and what it is made of, behind a variant of the asset.

USD has no schema for deformables yet. Two families of one shape are in use, and both are written: `Physics...` with
attributes `physics:*`, the proposal that Newton reads, and `OmniPhysics...` with `omniphysics:*`, which Isaac Sim reads.
Neither is registered with USD; names are applied as they are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.exports.bodies import Body, Shape
from tasks.exports.usd.layers import add_mesh, add_physics_material, bind_physics, extent, new_stage
from tasks.exports.visuals import Visual
from tasks.geometry.sheets import Sheet, sheet_of
from tasks.geometry.tetrahedra import CELLS, COVERED, OUTSIDE_M, Tetrahedra, distance_to, tetrahedralize
from tasks.geometry.triangles import corner_normals

SIMULATION = "Simulation"
"""Name of the prim, below the asset's root, that an engine deforms."""

FABRIC_M = 0.001
"""Thickness of one layer of cloth [m], which its stiffness comes from: terry and quilts 1 to 3 mm, shirts 0.3 mm."""


@dataclasses.dataclass(frozen=True)
class Elasticity:
    """Young's modulus [Pa] and Poisson's ratio, for small strains."""

    youngs_modulus: float
    poissons_ratio: float


CLOTH = Elasticity(1e6, 0.3)
"""Knits stretch at 0.1 to 1 MPa, woven cloth at 1 to 100 MPa along its threads; its bias, which drapes, at about 1 MPa."""

SOFT: Mapping[str, Elasticity] = {
    "fabric": Elasticity(3e4, 0.2),  # stuffed with fiber or foam: polyurethane foam of 30 kg/m3 has 20 to 100 kPa
    "leather": Elasticity(2e5, 0.3),  # a bag's or a shoe's body: hollow, so a share of leather's 10 to 100 MPa
    "paper": Elasticity(1e5, 0.2),  # a roll squeezed across its layers; along them it is 2 GPa
    "plastic": Elasticity(2e5, 0.3),  # hollow and thin-walled; the solid has 1 GPa
    "rubber": Elasticity(1e6, 0.45),  # soft vulcanized rubber 1 to 5 MPa, nearly incompressible
    "foliage": Elasticity(5e4, 0.45),  # muscle and fat at rest 5 to 100 kPa
}
"""Of soft bodies by their first material in `materials.csv`."""

SOFT_BY_CATEGORY: Mapping[str, Elasticity] = {
    "pillow": Elasticity(1e4, 0.1),  # loose fiber or down: gives way by a third under a head's 3 kPa
    "mattress": Elasticity(5e4, 0.2),  # firm foam, gives way by a tenth under a sleeper's 3 to 5 kPa
    "bean bag": Elasticity(2e4, 0.2),  # polystyrene beads in a slack cover
}
"""The same where a category says more than its material."""

OTHER = Elasticity(5e4, 0.3)
"""Of soft bodies whose material says nothing: between a cushion and a rubber mat."""


@dataclasses.dataclass(frozen=True)
class Deformable:
    """What an engine deforms: a sheet for cloth, tetrahedra for soft bodies, in the asset's frame [m]; and its material.

    density: mass over volume of the mesh [kg/m3]; a sheet's volume is its area times its thickness.
    """

    mesh: Sheet | Tetrahedra
    elasticity: Elasticity
    density: float


def deformable_of(body: Body) -> Deformable | None:
    """The deformable of a body, or None: when it is rigid, is fastened to the room, or its mesh would be another volume."""
    if body.body_type == "rigid" or body.is_fixed:
        return None
    shape = body.shape
    if body.body_type == "cloth":
        sheet = sheet_of(shape.hulls, shape.properties.volume)
        return Deformable(sheet, CLOTH, body.mass_kg / (sheet.area * sheet.thickness))
    solid = next((made for cells in (CELLS, 2 * CELLS) if _is_like(made := tetrahedralize(shape.hulls, cells), shape)), None)
    if solid is None:
        return None
    known = [SOFT[material] for material in body.materials if material in SOFT]
    elasticity = SOFT_BY_CATEGORY.get(body.category) or (known[0] if known else OTHER)
    return Deformable(solid, elasticity, body.mass_kg / float(solid.volumes.sum()))


def _is_like(solid: Tetrahedra, shape: Shape) -> bool:
    """Whether tetrahedra have about the volume of a shape, and nowhere lie far outside it."""
    share = float(solid.volumes.sum()) / shape.properties.volume
    return COVERED <= share <= 1.0 / COVERED and float(distance_to(shape.hulls, solid.vertices)[0].max()) <= OUTSIDE_M


def write_simulation(path: Path, name: str, deformable: Deformable, visuals: list[Visual]) -> None:
    """The geometry that is deformed, and the poses in which what is seen is tied to it."""

    stage = new_stage(path, name, kind="")
    stage.GetDefaultPrim().SetSpecifier(_def())
    stage.GetDefaultPrim().SetTypeName("Xform")
    place = f"/{name}/{SIMULATION}"
    mesh = deformable.mesh
    points = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
    prim = _tetrahedra(stage, place, mesh) if isinstance(mesh, Tetrahedra) else _sheet(stage, place, mesh)
    _set_rest(prim, mesh)
    _add_pose(prim, points)
    for visual in visuals:
        _add_pose(stage.OverridePrim(f"/{name}/Visual/{visual.name}"), np.ascontiguousarray(visual.vertices, dtype=np.float32))
    stage.GetRootLayer().Save()


def write_deformable(path: Path, name: str, body: Body, deformable: Deformable) -> None:
    """What makes the simulation mesh a deformable body, in place of the rigid body and its colliders."""
    from pxr import Sdf, UsdPhysics, UsdShade

    stage = new_stage(path, name, kind="")
    root = stage.GetDefaultPrim()
    _apply(root, "DeformableBodyAPI")
    _set(root, Sdf.ValueTypeNames.Float, "mass", body.mass_kg)
    stage.OverridePrim(f"/{name}/Colliders").SetActive(False)
    material = add_physics_material(stage, f"/{name}/PhysicsMaterial", body.friction, body.restitution).GetPrim()
    UsdPhysics.MaterialAPI(material).CreateDensityAttr(deformable.density)
    kind = "Volume" if isinstance(deformable.mesh, Tetrahedra) else "Surface"
    _apply(material, f"{kind}DeformableMaterialAPI", omni="DeformableMaterialAPI" if kind == "Volume" else None)
    for attribute, value in _material(deformable).items():
        _set(material, Sdf.ValueTypeNames.Float, attribute, value)
    for attribute, value in (("density", deformable.density), ("staticFriction", body.friction), ("dynamicFriction", body.friction)):
        material.CreateAttribute(f"omniphysics:{attribute}", Sdf.ValueTypeNames.Float, custom=False).Set(value)
    if isinstance(deformable.mesh, Sheet):
        material.CreateAttribute("omniphysics:surfaceThickness", Sdf.ValueTypeNames.Float, custom=False).Set(deformable.mesh.thickness)
    prim = stage.OverridePrim(f"/{name}/{SIMULATION}")
    UsdPhysics.CollisionAPI.Apply(prim)
    _apply(prim, f"{kind}DeformableSimAPI")
    bind_physics(prim, UsdShade.Material(material))
    stage.GetRootLayer().Save()


def _material(deformable: Deformable) -> dict[str, float]:
    """Attributes of the material that both families have. A plate's stiffness per width [N/m], and against bending [N m]."""
    young, poisson = deformable.elasticity.youngs_modulus, deformable.elasticity.poissons_ratio
    values = {"youngsModulus": young, "poissonsRatio": poisson}
    if isinstance(deformable.mesh, Sheet):  # as thick as the object where it touches, as stiff as one layer of its cloth
        values["surfaceStretchStiffness"] = young * FABRIC_M / (1.0 - poisson**2)
        values["surfaceShearStiffness"] = young * FABRIC_M / (2.0 * (1.0 + poisson))
        values["surfaceBendStiffness"] = young * FABRIC_M**3 / (12.0 * (1.0 - poisson**2))
    return values


def _sheet(stage: Any, path: str, sheet: Sheet) -> Any:
    """A sheet as a mesh that is drawn only as a guide."""
    from pxr import UsdGeom

    mesh = add_mesh(stage, path, sheet.vertices, sheet.triangles, corner_normals(sheet.vertices, sheet.triangles, np.pi))
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    mesh.CreateDoubleSidedAttr(True)
    return mesh.GetPrim()


def _tetrahedra(stage: Any, path: str, solid: Tetrahedra) -> Any:
    """Tetrahedra with their surface, drawn only as a guide."""
    from pxr import UsdGeom, Vt

    points = np.ascontiguousarray(solid.vertices, dtype=np.float32)
    mesh = UsdGeom.TetMesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateTetVertexIndicesAttr(Vt.Vec4iArray.FromNumpy(np.ascontiguousarray(solid.tetrahedra, dtype=np.int32)))
    mesh.CreateSurfaceFaceVertexIndicesAttr(Vt.Vec3iArray.FromNumpy(np.ascontiguousarray(solid.surface, dtype=np.int32)))
    mesh.CreateExtentAttr(extent(points))
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    return mesh.GetPrim()


def _set_rest(prim: Any, mesh: Sheet | Tetrahedra) -> None:
    """The shape at rest is the one that is placed: it neither swells nor unfolds when it is let go."""
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    points = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32))
    _set(prim, types.Point3fArray, "restShapePoints", points)
    if isinstance(mesh, Tetrahedra):
        corners = Vt.Vec4iArray.FromNumpy(np.ascontiguousarray(mesh.tetrahedra, dtype=np.int32))
        prim.CreateAttribute("physics:restTetVertexIndices", types.Int4Array, custom=False).Set(corners)
        prim.CreateAttribute("omniphysics:restTetVtxIndices", types.Int4Array, custom=False).Set(corners)
        return
    corners = Vt.Vec3iArray.FromNumpy(np.ascontiguousarray(mesh.triangles, dtype=np.int32))
    prim.CreateAttribute("physics:restTriVertexIndices", types.Int3Array, custom=False).Set(corners)
    prim.CreateAttribute("omniphysics:restTriVtxIndices", types.Int3Array, custom=False).Set(corners)
    prim.CreateAttribute("physics:restBendAnglesDefault", types.Token, False, Sdf.VariabilityUniform).Set("restShape")
    prim.CreateAttribute("omniphysics:restBendAnglesDefault", types.Token, False, Sdf.VariabilityUniform).Set("restShapeDefault")
    prim.CreateAttribute("physics:thicknesses", types.FloatArray, custom=False).Set([mesh.thickness])
    prim.CreateAttribute("physics:thicknesses:elementType", types.Token, custom=False).Set("constant")


def _add_pose(prim: Any, points: NDArray[np.float32]) -> None:
    """The pose in which the meshes of a deformable body belong together; positions [m], shape (n, 3)."""
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    _apply(prim, "DeformablePoseAPI:default")
    for prefix in ("physics:deformablePose:default:", "deformablePose:default:omniphysics:"):
        prim.CreateAttribute(f"{prefix}points", types.Point3fArray, custom=False).Set(Vt.Vec3fArray.FromNumpy(points))
        prim.CreateAttribute(f"{prefix}purposes", types.TokenArray, False, Sdf.VariabilityUniform).Set(["bindPose"])


def _apply(prim: Any, name: str, omni: str | None = None) -> None:
    """Apply a schema of both families, by names that USD does not know."""
    prim.AddAppliedSchema(f"Physics{name}")
    prim.AddAppliedSchema(f"OmniPhysics{omni or name}")


def _set(prim: Any, type_: Any, name: str, value: Any) -> None:
    """Set an attribute of both families."""
    for family in ("physics", "omniphysics"):
        prim.CreateAttribute(f"{family}:{name}", type_, custom=False).Set(value)


def _def() -> Any:
    from pxr import Sdf

    return Sdf.SpecifierDef
