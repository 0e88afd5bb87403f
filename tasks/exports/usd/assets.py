"""One asset as a USD folder: an interface, and behind a payload its physics, its looks and its geometry.

Cloth and soft bodies have a variant set `physics`: `rigid`, which is selected, is what every other asset is; `deformable`
is another payload, in which a simulation mesh is deformed and the visuals follow it. Neither composes prims of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tasks.exports.bodies import Body, Shape, digest
from tasks.exports.config import UsdConfig
from tasks.exports.usd.deformables import Deformable, deformable_of, write_deformable, write_simulation
from tasks.exports.usd.layers import (
    add_collider,
    add_color_material,
    add_display_color,
    add_mesh,
    add_physics_material,
    add_solids,
    add_texture_coordinates,
    add_texture_material,
    bind_physics,
    extent,
    label,
    limit_depenetration,
    make_collider,
    new_stage,
    set_mass,
)
from tasks.exports.visuals import Visual, visuals_of
from tasks.geometry.pieces import Hull
from tasks.geometry.triangles import corner_normals


def write_asset(folder: Path, body: Body, config: UsdConfig) -> str:
    """Write the asset of a body into `folder/<name>/` and return the name.

    Friction, restitution, mass and whether it moves are those of `body`; another body with the same shape may differ
    in the first three, which the scene then overrides.
    """
    name = asset_name(body, config)
    root = folder / name
    root.mkdir(parents=True)
    visuals = visuals_of(body.shape)
    _write_geometry(root / f"{name}_geometry.usdc", name, visuals, body.shape.hulls, config)
    _write_looks(root / f"{name}_looks.usda", name, visuals)
    _write_physics(root / f"{name}_physics.usda", name, body, config)
    _write_payload(root / f"{name}_payload.usda", name, ("physics.usda", "looks.usda", "geometry.usdc"))
    deformable = deformable_of(body) if config.deformables else None
    if deformable is not None:
        write_simulation(root / f"{name}_simulation.usdc", name, deformable, visuals)
        write_deformable(root / f"{name}_deformable.usda", name, body, deformable)
        layers = ("deformable.usda", "looks.usda", "simulation.usdc", "geometry.usdc")
        _write_payload(root / f"{name}_deformable_payload.usda", name, layers)
    _write_interface(root / f"{name}.usda", name, body, deformable)
    for visual in visuals:
        if visual.texture is not None:
            target = root / "textures" / visual.texture.file
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(visual.texture.data)
    return name


def asset_name(body: Body, config: UsdConfig) -> str:
    """Name of a body's asset: bodies of one shape share it, but not fixed ones with moving ones.

    Cloth and soft bodies share it only where mass and material are the same too: those are part of what is deformed.
    """
    if body.is_fixed:
        return f"{body.shape.name}_fixed"
    if body.body_type == "rigid" or not config.deformables:
        return body.shape.name
    made_of = f"{body.mass_kg!r} {body.friction!r} {body.restitution!r} {body.body_type} {body.category} {body.materials}"
    return f"{body.shape.name}_{digest(made_of)}"


def _write_geometry(path: Path, name: str, visuals: Sequence[Visual], hulls: Sequence[Hull], config: UsdConfig) -> None:
    """Positions, triangles, normals, colors and texture coordinates, in USD's binary form."""
    from pxr import UsdGeom

    stage = new_stage(path, name)
    UsdGeom.Xform.Define(stage, f"/{name}/Visual")
    for visual in visuals:
        normals = corner_normals(visual.vertices, visual.faces, config.crease_radians)
        mesh = add_mesh(stage, f"/{name}/Visual/{visual.name}", visual.vertices, visual.faces, normals)
        mesh.CreateDoubleSidedAttr(visual.two_sided)
        if visual.colors is not None:
            add_display_color(mesh, visual.colors)
        if visual.uv is not None:
            add_texture_coordinates(mesh, visual.uv)
        if visual.solids is not None and visual.solids.any():
            add_solids(mesh, visual.solids)
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
        material = add_color_material(stage, place) if visual.texture is None else add_texture_material(stage, place, visual.texture)
        UsdShade.MaterialBindingAPI.Apply(stage.OverridePrim(f"/{name}/Visual/{visual.name}")).Bind(material)
    stage.GetRootLayer().Save()


def _write_physics(path: Path, name: str, body: Body, config: UsdConfig) -> None:
    """The rigid body, its mass, its colliders and their material."""
    from pxr import UsdPhysics

    stage = new_stage(path, name, kind="")
    root = stage.GetDefaultPrim()
    if not body.is_fixed:
        UsdPhysics.RigidBodyAPI.Apply(root)
        set_mass(root, body)
        limit_depenetration(root, config.max_depenetration_m_s)
    material = add_physics_material(stage, f"/{name}/PhysicsMaterial", body.friction, body.restitution)
    for index in range(len(body.shape.hulls)):
        collider = stage.OverridePrim(f"/{name}/Colliders/Hull_{index:02d}")
        make_collider(collider)
        bind_physics(collider, material)  # on each: USD's own physics parser sees no binding of a prim above
    stage.GetRootLayer().Save()


def _write_payload(path: Path, name: str, layers: Sequence[str]) -> None:
    """Layers of the asset `name`, strongest first, as one."""
    from pxr import Sdf

    stage = new_stage(path, name, kind="")
    payload = Sdf.Layer.FindOrOpen(stage.GetRootLayer().identifier)
    del stage  # it would read every layer that is put below it
    for layer in layers:
        payload.subLayerPaths.append(f"./{name}_{layer}")
    payload.Save()


def _write_interface(path: Path, name: str, body: Body, deformable: Deformable | None) -> None:
    """The file that a scene refers to, and the payload behind it, or the two behind its variants."""
    from pxr import Kind, Sdf, Usd, UsdGeom

    stage = new_stage(path, name)
    prim = stage.GetDefaultPrim()
    model = Usd.ModelAPI(prim)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(name)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{name}.usda"))
    model.SetAssetVersion(body.shape.asset.asset_id[:12])  # an asset is named by its content
    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(extent(body.shape.bounds))
    label(prim, {"class": [body.shape.asset.category]})
    prim.SetCustomDataByKey("metascenes", asset_provenance(body.shape))
    if deformable is None:
        prim.GetPayloads().AddPayload(Sdf.Payload(f"./{name}_payload.usda"))
    else:
        variants = prim.GetVariantSets().AddVariantSet("physics")
        for variant, file in (("rigid", "payload"), ("deformable", "deformable_payload")):
            variants.AddVariant(variant)
            variants.SetVariantSelection(variant)
            with variants.GetVariantEditContext():
                prim.GetPayloads().AddPayload(Sdf.Payload(f"./{name}_{file}.usda"))
        variants.SetVariantSelection("rigid")
    stage.GetRootLayer().Save()


def asset_provenance(shape: Shape) -> dict[str, str]:
    """Where an asset comes from and what may be done with it."""
    asset = shape.asset
    return {
        "asset_id": asset.asset_id, "provider": asset.provider, "source": asset.source, "license": asset.license,
        "author": asset.author or "unknown", "colliders": shape.method,
    }  # fmt: skip
