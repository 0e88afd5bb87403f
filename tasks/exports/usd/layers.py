"""What USD files of this project are made of: stages, meshes, colliders, materials, mass and labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.exports.bodies import Body
from tasks.exports.visuals import Texture
from tasks.geometry.colors import linear_of_bytes
from tasks.geometry.mass import principal_axes
from tasks.geometry.pieces import Hull
from tasks.geometry.triangles import face_normals

DEPENETRATION = "physxRigidBody:maxDepenetrationVelocity"
"""An attribute of PhysX; USD without it carries it along."""


def new_stage(path: Path, root: str, kind: str = "Xform") -> Any:
    """A new USD stage with +Z up, metres, kilograms and a default prim `root`; the caller saves it."""
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics

    if path.suffix == ".usda":  # `CreateNew` writes an empty file first, from which a binary one takes its order
        stage = Usd.Stage.Open(Sdf.Layer.New(Sdf.FileFormat.FindByExtension("usda"), str(path)), Usd.Stage.LoadNone)
    else:
        stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    prim = stage.DefinePrim(f"/{root}", kind) if kind else stage.OverridePrim(f"/{root}")
    stage.SetDefaultPrim(prim)
    return stage


def add_mesh(stage: Any, path: str, vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike) -> Any:
    """A triangle mesh: positions [m] (n, 3), triangles (m, 3), a normal per corner (m, 3, 3). Returns the UsdGeom.Mesh."""
    from pxr import UsdGeom, Vt

    points = np.ascontiguousarray(vertices, dtype=np.float32)
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.reshape(-1)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(np.asarray(normals, dtype=np.float32).reshape(-1, 3))))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(extent(points))
    return mesh


def extent(points: ArrayLike) -> Any:
    """Lowest and highest corner of points, shape (n, 3), as USD's extent."""
    from pxr import Vt

    array = np.asarray(points, dtype=np.float32)
    return Vt.Vec3fArray.FromNumpy(np.array([array.min(axis=0), array.max(axis=0)], dtype=np.float32))


def add_collider(stage: Any, path: str, hull: Hull) -> Any:
    """The geometry of a convex piece, drawn only as a guide; physics is added by `make_collider`."""
    from pxr import UsdGeom

    flat = np.repeat(face_normals(hull.vertices, hull.faces)[:, None], 3, axis=1)
    mesh = add_mesh(stage, path, hull.vertices, hull.faces, flat)
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    return mesh


def make_collider(prim: Any) -> None:
    """Make a mesh prim a collider that is its own convex hull."""
    from pxr import UsdPhysics

    UsdPhysics.CollisionAPI.Apply(prim)
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)


def add_physics_material(stage: Any, path: str, friction: float, restitution: float) -> Any:
    """A physics material; static and dynamic friction are the same."""
    from pxr import UsdPhysics, UsdShade

    material = UsdShade.Material.Define(stage, path)
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateStaticFrictionAttr(friction)
    api.CreateDynamicFrictionAttr(friction)
    api.CreateRestitutionAttr(restitution)
    return material


def bind_physics(prim: Any, material: Any, stronger: bool = False) -> None:
    """Bind a physics material to a prim and what is below it."""
    from pxr import UsdShade

    tokens = UsdShade.Tokens
    strength = tokens.strongerThanDescendants if stronger else tokens.weakerThanDescendants
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, strength, "physics")


def set_mass(prim: Any, body: Body) -> None:
    """Mass, center of mass and inertia of a body on its root prim."""
    from pxr import Gf, UsdPhysics

    properties = body.shape.properties
    moments, axes = principal_axes(properties.inertia * (body.mass_kg / properties.volume))
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(body.mass_kg)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, properties.center)))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*map(float, moments)))
    mass.CreatePrincipalAxesAttr(quaternion(axes))


def limit_depenetration(prim: Any, speed: float) -> None:
    """How fast PhysX may push a rigid body out of others [m/s]: from its own default of 3 m/s objects that touch are thrown."""
    from pxr import Sdf

    prim.AddAppliedSchema("PhysxRigidBodyAPI")
    prim.CreateAttribute(DEPENETRATION, Sdf.ValueTypeNames.Float, custom=False).Set(speed)


def quaternion(rotation: ArrayLike) -> Any:
    """A rotation, shape (3, 3), as USD's single precision quaternion."""
    from pxr import Gf

    from tasks.geometry.transforms import quaternion_wxyz

    pose = np.eye(4)
    pose[:3, :3] = rotation
    w, x, y, z = quaternion_wxyz(pose)
    return Gf.Quatf(w, x, y, z)


def add_color_material(stage: Any, path: str) -> Any:
    """A preview material that takes its color from the mesh's vertex colors."""
    from pxr import Sdf, UsdShade

    material, surface = preview_material(stage, path)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    return material


def add_display_color(mesh: Any, colors: NDArray[np.uint8]) -> None:
    """Vertex colors, shape (n, 3) sRGB, as the mesh's display color."""
    from pxr import UsdGeom, Vt

    values, index = _indexed(linear_of_bytes(colors))
    primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant if len(values) == 1 else UsdGeom.Tokens.vertex)
    primvar.Set(Vt.Vec3fArray.FromNumpy(values))
    if len(values) > 1:
        primvar.SetIndices(index)


def add_texture_coordinates(mesh: Any, uv: ArrayLike) -> None:
    """Texture coordinates per vertex, shape (n, 2), as the mesh's primvar `st`."""
    from pxr import Sdf, UsdGeom, Vt

    values, index = _indexed(uv)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    primvar.Set(Vt.Vec2fArray.FromNumpy(values))
    primvar.SetIndices(index)


def add_solids(mesh: Any, solids: NDArray[np.int64]) -> None:
    """Which connected surface each vertex belongs to, shape (n,), as the primvar `solid`: what touches is not one surface."""
    from pxr import Sdf, UsdGeom, Vt

    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("solid", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex)
    primvar.Set(Vt.IntArray.FromNumpy(solids.astype(np.int32)))


def _indexed(values: ArrayLike) -> tuple[NDArray[np.float32], Any]:
    """The different rows of values, shape (k, d), in single precision, and which of them each row is, as USD's integers."""
    from pxr import Vt

    rows, index = np.unique(np.asarray(values, dtype=np.float32) + np.float32(0.0), axis=0, return_inverse=True)
    return np.ascontiguousarray(rows), Vt.IntArray.FromNumpy(index.reshape(-1).astype(np.int32))


def preview_material(stage: Any, path: str) -> tuple[Any, Any]:
    """A material with a UsdPreviewSurface, and that surface."""
    from pxr import Sdf, UsdShade

    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.7)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    return material, surface


def add_texture_material(stage: Any, path: str, texture: Texture) -> Any:
    """A preview material that takes its color from an image through texture coordinates `st`."""
    from pxr import Gf, Sdf, UsdShade

    material, surface = preview_material(stage, path)
    reader = UsdShade.Shader.Define(stage, f"{path}/Coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    image = UsdShade.Shader.Define(stage, f"{path}/Image")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./textures/{texture.file}"))
    image.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    image.CreateInput("wrapS", Sdf.ValueTypeNames.Token).Set("repeat")
    image.CreateInput("wrapT", Sdf.ValueTypeNames.Token).Set("repeat")
    image.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*texture.factor, 1.0))
    image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float2))
    color = image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(color)
    if texture.alpha in ("MASK", "BLEND"):
        surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).ConnectToSource(image.CreateOutput("a", Sdf.ValueTypeNames.Float))
        surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(0.5 if texture.alpha == "MASK" else 0.0)
    return material


def label(prim: Any, labels: Mapping[str, Sequence[str]]) -> None:
    """Semantic labels on a prim, by taxonomy."""
    from pxr import UsdSemantics

    for taxonomy, values in labels.items():
        UsdSemantics.LabelsAPI.Apply(prim, taxonomy).CreateLabelsAttr(list(values))
