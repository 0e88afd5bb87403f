"""A replica as a USD scene with physics.

`<stem>/scene.usda` refers to `room/room.usda` and to one folder per asset under `assets/`; see `usd.assets`. Every
object is one rigid body with explicit convex colliders, its scale baked into the geometry. What hangs on a wall or
a ceiling is a static collider without a rigid body, like the room.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any, cast

import numpy as np

from schemas.machine.scratch import temporary_folder
from tasks.exports.bodies import Body, Replica
from tasks.exports.config import ExportsConfig
from tasks.exports.files import Export, files_below
from tasks.exports.format import Doctor, ExportedScene, ExportFormat
from tasks.exports.lighting import FIELD_OF_VIEW_DEGREES, lamps, viewpoint
from tasks.exports.usd.assets import asset_name, write_asset
from tasks.exports.usd.layers import (
    add_collider,
    add_color_material,
    add_display_color,
    add_mesh,
    add_physics_material,
    add_texture_coordinates,
    add_texture_material,
    bind_physics,
    label,
    make_collider,
    new_stage,
    set_mass,
)
from tasks.exports.visuals import texture_of, visuals_of
from tasks.geometry.meshes import vertex_colors
from tasks.geometry.pieces import Hull, convex_hull
from tasks.geometry.transforms import quaternion_wxyz
from tasks.geometry.triangles import corner_normals

CAMERA = "/World/Camera"
APERTURE = 20.955
"""Width of the camera's film [tenths of a meter, as USD counts them]: USD's own default, of 35 mm film."""

SKY_NITS, LAMP_NITS, LAMP_RADIUS_M = 500.0, 1e5, 0.1
"""Luminance of the sky and of a lamp, and a lamp's radius [m]: on the floor below it a lamp is about half as bright as the sky."""


def write_usd(root: Path, replica: Replica, config: ExportsConfig) -> Path:
    """Write a replica under `root/<stem>/` and return the path of its `scene.usda`."""
    folder = root / replica.stem
    folder.mkdir(parents=True)
    _write_room(folder / "room", replica, config)
    first: dict[str, Body] = {}
    for body in replica.bodies:
        if asset_name(body, config.usd) not in first:
            first[asset_name(body, config.usd)] = body
            write_asset(folder / "assets", body, config.usd)
    _write_scene(folder / "scene.usda", replica, first, config)
    return folder / "scene.usda"


def _write_room(folder: Path, replica: Replica, config: ExportsConfig) -> None:
    """Floor, walls, a ceiling that was asked for, and brackets, which nobody sees: static colliders without a rigid body."""
    from pxr import Kind, Usd, UsdGeom, UsdShade

    folder.mkdir()
    geometry = new_stage(folder / "room_geometry.usdc", "Room")
    stage = new_stage(folder / "room.usda", "Room")
    stage.GetRootLayer().subLayerPaths.append("./room_geometry.usdc")
    Usd.ModelAPI(stage.GetDefaultPrim()).SetKind(Kind.Tokens.group)
    for name, mesh in replica.shell:
        path = f"/Room/{name.capitalize()}"
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
        UsdGeom.Xform.Define(geometry, path)
        visual = add_mesh(geometry, f"{path}/Visual", vertices, faces, corner_normals(vertices, faces, 0.1))
        texture = texture_of(mesh)
        if texture is None:
            add_display_color(visual, vertex_colors(mesh))
        else:
            add_texture_coordinates(visual, cast(Any, mesh.visual).uv)
            (folder / "textures").mkdir(exist_ok=True)
            (folder / "textures" / texture.file).write_bytes(texture.data)
        # a floor with inner corners gets the hull of its slab: what that adds lies outside the room, below z = 0
        hull: Hull = convex_hull(vertices, config.pieces)
        add_collider(geometry, f"{path}/Collider", hull)
        part = stage.OverridePrim(path)
        Usd.ModelAPI(part).SetKind(Kind.Tokens.component)
        kind = name if name in ("floor", "ceiling") else "wall"
        label(part, {"class": [kind], "category": [kind]})
        UsdGeom.Scope.Define(stage, f"{path}/Looks")
        paint = f"{path}/Looks/Paint"
        look = add_color_material(stage, paint) if texture is None else add_texture_material(stage, paint, texture)
        UsdShade.MaterialBindingAPI.Apply(stage.OverridePrim(f"{path}/Visual")).Bind(look)
        _make_static(stage, path, config)
    for name, board in replica.brackets:  # no components and without labels: these are what can be seen
        path = f"/Room/{name.capitalize()}"
        UsdGeom.Xform.Define(geometry, path)
        add_collider(geometry, f"{path}/Collider", convex_hull(np.asarray(board.vertices, dtype=np.float64), config.pieces))
        _make_static(stage, path, config)
    geometry.GetRootLayer().Save()
    stage.GetRootLayer().Save()


def _make_static(stage: Any, path: str, config: ExportsConfig) -> None:
    """Let the collider of a part of the room collide, with the room's friction and restitution."""
    collider = stage.OverridePrim(f"{path}/Collider")
    make_collider(collider)
    bind_physics(collider, add_physics_material(stage, f"{path}/PhysicsMaterial", config.room_friction, config.room_restitution))


def _write_scene(path: Path, replica: Replica, first: dict[str, Body], config: ExportsConfig) -> None:
    """The scene file: gravity, lights, a camera, the room, and every body as a reference with a pose."""
    from pxr import Gf, Kind, Usd, UsdGeom, UsdPhysics

    stage = new_stage(path, "World")
    world = stage.GetDefaultPrim()
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    origin = {"scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type}
    stage.GetRootLayer().customLayerData = {"metascenes": origin, "cameraSettings": {"boundCamera": CAMERA}}
    world.SetCustomDataByKey("metascenes", origin)
    physics = UsdPhysics.Scene.Define(stage, "/World/PhysicsScene")
    physics.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
    physics.CreateGravityMagnitudeAttr(config.usd.gravity_m_s2)
    _add_lights(stage, replica)
    _add_camera(stage, replica)
    room = stage.DefinePrim("/World/Room")
    room.GetReferences().AddReference("./room/room.usda")
    objects = UsdGeom.Xform.Define(stage, "/World/Objects")
    Usd.ModelAPI(objects.GetPrim()).SetKind(Kind.Tokens.group)
    materials: dict[tuple[float, float], Any] = {}
    for body in replica.bodies:
        _add_body(stage, body, first[asset_name(body, config.usd)], materials, config)
    stage.GetRootLayer().Save()


def _add_lights(stage: Any, replica: Replica) -> None:
    """A sky, which lights a room without a ceiling, and a lamp wherever one would hang."""
    from pxr import Gf, UsdGeom, UsdLux

    UsdGeom.Scope.Define(stage, "/World/Lights")
    UsdLux.DomeLight.Define(stage, "/World/Lights/Sky").CreateIntensityAttr(SKY_NITS)
    for index, place in enumerate(lamps(replica.room)):
        lamp = UsdLux.SphereLight.Define(stage, f"/World/Lights/Lamp_{index:02d}")
        lamp.CreateRadiusAttr(LAMP_RADIUS_M)
        lamp.CreateIntensityAttr(LAMP_NITS)
        lamp.CreateTreatAsPointAttr(False)
        UsdGeom.Xformable(lamp).AddTranslateOp().Set(Gf.Vec3d(*map(float, place)))


def _add_camera(stage: Any, replica: Replica) -> None:
    """A camera that looks into the room."""
    from pxr import Gf, UsdGeom

    camera = UsdGeom.Camera.Define(stage, CAMERA)
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE * 9.0 / 16.0)
    camera.CreateFocalLengthAttr(0.5 * APERTURE / math.tan(math.radians(0.5 * FIELD_OF_VIEW_DEGREES)))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.05, 100.0))
    pose = viewpoint(replica)
    place = UsdGeom.Xformable(camera)
    place.AddTranslateOp().Set(Gf.Vec3d(*map(float, pose[:3, 3])))
    place.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*quaternion_wxyz(pose)))


def _add_body(stage: Any, body: Body, first: Body, materials: dict[tuple[float, float], Any], config: ExportsConfig) -> None:
    """One body: a reference, a pose, labels, where it comes from, and what its asset's file says otherwise."""
    from pxr import Gf, UsdGeom

    name = asset_name(body, config.usd)
    prim = stage.DefinePrim(f"/World/Objects/{body.name}")
    prim.GetReferences().AddReference(f"./assets/{name}/{name}.usda")
    if config.usd.instanceable:
        prim.SetInstanceable(True)
    place = UsdGeom.Xformable(prim)
    place.AddTranslateOp().Set(Gf.Vec3d(*map(float, body.pose[:3, 3])))
    # USD takes the angle from acos(w): in single precision a turn of 2 mrad is wrong by 2 %
    place.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*quaternion_wxyz(body.pose)))
    label(prim, {"class": [body.category], "category": [body.category], "nyu40": [body.nyu40_label]})
    prim.SetCustomDataByKey("metascenes", dict(body.provenance))
    if not body.is_fixed and body.mass_kg != first.mass_kg:
        set_mass(prim, body)
    surface = (body.friction, body.restitution)
    if surface != (first.friction, first.restitution):
        if surface not in materials:
            UsdGeom.Scope.Define(stage, "/World/PhysicsMaterials")
            materials[surface] = add_physics_material(stage, f"/World/PhysicsMaterials/Surface_{len(materials):02d}", *surface)
        bind_physics(prim, materials[surface], stronger=True)


def with_release(scene: bytes, snapshot_id: int, release: str | None) -> bytes:
    """A `scene.usda` that says which snapshot of the lake it was exported from, and the release's name if it has one.

    Both are in the layer's `customLayerData` and in `customData` of its default prim and of every object, beside what was there.
    """
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(scene.decode())
    stated: dict[str, Any] = {"snapshot_id": snapshot_id} | ({} if release is None else {"release": release})
    layer.customLayerData = _joined(layer.customLayerData, stated)
    world = layer.GetPrimAtPath(f"/{layer.defaultPrim}")
    objects = layer.GetPrimAtPath(f"/{layer.defaultPrim}/Objects")
    for prim in (world, *objects.nameChildren):
        prim.customData = _joined(prim.customData, stated)
    return bytes(layer.ExportToString().encode())


def _joined(known: Any, stated: dict[str, Any]) -> dict[str, Any]:
    """A dictionary of a layer or prim with more said under this project's name."""
    values = dict(known)
    return values | {"metascenes": dict(values.get("metascenes", {})) | stated}


_ROLES = {"scene.usda": "scene", "textures": "texture", "room": "stage"}


def _make(scene: ExportedScene) -> Export:
    """The scene, written to a temporary folder, checked there, read back."""
    with temporary_folder() as place:
        root = place.resolve()
        findings = USD.check(write_usd(root, scene.replica, scene.config))
        return Export(files_below(root, _role), USD.rules, findings)


def _role(name: str) -> str:
    """Role of a file by its path."""
    parts = PurePosixPath(name).parts
    return next((role for part, role in _ROLES.items() if part in parts), "asset")


def _gate() -> ModuleType:
    from tasks.exports.usd import rules

    return rules


def _package(files: Mapping[str, bytes], root: str) -> bytes:
    from tasks.exports.usd.package import package

    return package(files, root)


USD = ExportFormat(
    name="usd",
    title="USD scenes",
    make=_make,
    gate=_gate,
    opened=lambda root: [*sorted(root.glob("*/scene.usda")), *sorted(root.glob("*.usdz"))],
    doctor=Doctor(
        about="Check anybody's USD file or .usdz: UsdValidation's rules and those for scenes with physics.\n\n"
        "Objects with a variant set `physics` are checked in each of its variants.",
        example="scene.usda --omniverse",
        names_others=True,
        validators=(("omniverse", "Ask NVIDIA's omniverse-asset-validator too, where it is installed."),),
    ),
    with_release=with_release,
    package=_package,
    suffix=".usdz",
    is_nested=True,
    prepare=visuals_of,
)
