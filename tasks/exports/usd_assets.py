"""One asset as a USD folder: an interface, and behind a payload its physics, its looks and its geometry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.exports.bodies import Body, Shape
from tasks.exports.config import UsdConfig
from tasks.exports.shading import corner_normals, face_normals, linear_colors
from tasks.exports.visuals import Texture, Visual, visuals_of
from tasks.mass import principal_axes
from tasks.pieces import Hull


def write_asset(folder: Path, body: Body, config: UsdConfig) -> str:
    """Write the asset of a body into `folder/<name>/` and return the name.

    Friction, restitution, mass and whether it moves are those of `body`; another body with the same shape may differ
    in the first three, which the scene then overrides.
    """
    name = asset_name(body)
    root = folder / name
    root.mkdir(parents=True)
    visuals = visuals_of(body.shape)
    _write_geometry(root / f"{name}_geometry.usdc", name, visuals, body.shape.hulls, config)
    _write_looks(root / f"{name}_looks.usda", name, visuals)
    _write_physics(root / f"{name}_physics.usda", name, body)
    _write_interface(root, name, body)
    for visual in visuals:
        if visual.texture is not None:
            target = root / "textures" / visual.texture.file
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(visual.texture.data)
    return name


def asset_name(body: Body) -> str:
    """Name of a body's asset: bodies of one shape share it, but not fixed ones with moving ones."""
    return f"{body.shape.name}_fixed" if body.is_fixed else body.shape.name


def new_stage(path: Path, root: str, kind: str = "Xform") -> Any:
    """A new USD stage with +Z up, metres, kilograms and a default prim `root`; the caller saves it."""
    from pxr import Usd, UsdGeom, UsdPhysics

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


def quaternion(rotation: ArrayLike) -> Any:
    """A rotation, shape (3, 3), as USD's single precision quaternion."""
    from pxr import Gf

    from tasks.transforms import quaternion_wxyz

    pose = np.eye(4)
    pose[:3, :3] = rotation
    w, x, y, z = quaternion_wxyz(pose)
    return Gf.Quatf(w, x, y, z)


def add_color_material(stage: Any, path: str) -> Any:
    """A preview material that takes its color from the mesh's vertex colors."""
    from pxr import Sdf, UsdShade

    material, surface = _preview_material(stage, path)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    return material


def add_display_color(mesh: Any, colors: NDArray[np.uint8]) -> None:
    """Vertex colors, shape (n, 3) sRGB, as the mesh's display color."""
    from pxr import UsdGeom, Vt

    values = np.ascontiguousarray(linear_colors(colors), dtype=np.float32)
    if (values == values[0]).all():
        primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant)
        values = values[:1]
    else:
        primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    primvar.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values)))


def _preview_material(stage: Any, path: str) -> tuple[Any, Any]:
    """A material with a UsdPreviewSurface, and that surface."""
    from pxr import Sdf, UsdShade

    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.7)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    return material, surface


def _add_texture_material(stage: Any, path: str, texture: Texture) -> Any:
    """A preview material that takes its color from an image through texture coordinates `st`."""
    from pxr import Gf, Sdf, UsdShade

    material, surface = _preview_material(stage, path)
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


def _write_geometry(path: Path, name: str, visuals: Sequence[Visual], hulls: Sequence[Hull], config: UsdConfig) -> None:
    """Positions, triangles, normals, colors and texture coordinates, in USD's binary form."""
    from pxr import Sdf, UsdGeom, Vt

    stage = new_stage(path, name)
    UsdGeom.Xform.Define(stage, f"/{name}/Visual")
    for visual in visuals:
        normals = corner_normals(visual.vertices, visual.faces, config.crease_radians)
        mesh = add_mesh(stage, f"/{name}/Visual/{visual.name}", visual.vertices, visual.faces, normals)
        mesh.CreateDoubleSidedAttr(visual.two_sided)
        if visual.colors is not None:
            add_display_color(mesh, visual.colors)
        if visual.uv is not None:
            st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
            st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(visual.uv, dtype=np.float32)))
    UsdGeom.Scope.Define(stage, f"/{name}/Colliders")
    for index, hull in enumerate(hulls):
        add_collider(stage, f"/{name}/Colliders/Hull_{index:02d}", hull)
    stage.GetRootLayer().Save()


def _write_looks(path: Path, name: str, visuals: Sequence[Visual]) -> None:
    """Preview materials and what they are bound to."""
    from pxr import UsdGeom, UsdShade

    stage = new_stage(path, name, kind="")
    UsdGeom.Scope.Define(stage, f"/{name}/Looks")
    for visual in visuals:
        place = f"/{name}/Looks/{visual.name}"
        material = add_color_material(stage, place) if visual.texture is None else _add_texture_material(stage, place, visual.texture)
        UsdShade.MaterialBindingAPI.Apply(stage.OverridePrim(f"/{name}/Visual/{visual.name}")).Bind(material)
    stage.GetRootLayer().Save()


def _write_physics(path: Path, name: str, body: Body) -> None:
    """The rigid body, its mass, its colliders and their material."""
    from pxr import UsdPhysics

    stage = new_stage(path, name, kind="")
    root = stage.GetDefaultPrim()
    if not body.is_fixed:
        UsdPhysics.RigidBodyAPI.Apply(root)
        set_mass(root, body)
    material = add_physics_material(stage, f"/{name}/PhysicsMaterial", body.friction, body.restitution)
    bind_physics(stage.OverridePrim(f"/{name}/Colliders"), material)
    for index in range(len(body.shape.hulls)):
        make_collider(stage.OverridePrim(f"/{name}/Colliders/Hull_{index:02d}"))
    stage.GetRootLayer().Save()


def _write_interface(root: Path, name: str, body: Body) -> None:
    """The file that a scene refers to, and the payload behind it."""
    from pxr import Kind, Sdf, Usd, UsdGeom, UsdSemantics

    payload = new_stage(root / f"{name}_payload.usda", name, kind="")
    for layer in ("physics.usda", "looks.usda", "geometry.usdc"):
        payload.GetRootLayer().subLayerPaths.append(f"./{name}_{layer}")
    payload.GetRootLayer().Save()
    stage = new_stage(root / f"{name}.usda", name)
    prim = stage.GetDefaultPrim()
    Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
    Usd.ModelAPI(prim).SetAssetName(name)
    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(extent(body.shape.bounds))
    UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([body.shape.asset.category])
    prim.SetCustomDataByKey("metascenes", asset_provenance(body.shape))
    prim.GetPayloads().AddPayload(Sdf.Payload(f"./{name}_payload.usda"))
    stage.GetRootLayer().Save()


def asset_provenance(shape: Shape) -> dict[str, str]:
    """Where an asset comes from and what may be done with it."""
    asset = shape.asset
    return {
        "asset_id": asset.asset_id, "provider": asset.provider, "source": asset.source, "license": asset.license,
        "author": asset.author or "unknown", "colliders": shape.method,
    }  # fmt: skip
