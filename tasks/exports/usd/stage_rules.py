"""Rules for a USD file as a whole: its metadata, the files that it names, gravity, joints."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from schemas.files import is_there
from tasks.exports.findings import Finding
from tasks.exports.usd.package import names_in
from tasks.exports.usd.prims import (
    bodies,
    cloud_of,
    is_body,
    is_collider,
    is_deformable,
    is_lit,
    moves,
    number,
    subtree,
    to_world,
    traverse,
    vector,
)


def metadata(stage: Any, path: Path) -> Iterator[Finding]:
    """What a file must say of itself before anything in it can be placed."""
    from pxr import UsdGeom, UsdPhysics

    if not stage.GetDefaultPrim():
        yield Finding("default_prim", path.name, "is not named, or names a prim that does not exist")
    for name, stated, value in (
        ("metersPerUnit", UsdGeom.StageHasAuthoredMetersPerUnit(stage), UsdGeom.GetStageMetersPerUnit(stage)),
        ("kilogramsPerUnit", UsdPhysics.StageHasAuthoredKilogramsPerUnit(stage), UsdPhysics.GetStageKilogramsPerUnit(stage)),
    ):
        if not stated:  # what is not stated is a centimetre, but one kilogram
            yield Finding("units", path.name, f"{name} is not stated", name == "metersPerUnit")
        elif value != 1.0:
            yield Finding("units", path.name, f"{name} is {value:g}, not 1")
    if not stage.HasAuthoredMetadata("upAxis"):
        yield Finding("up_axis", path.name, "is not stated")
    elif UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.z:
        yield Finding("up_axis", path.name, f"is {UsdGeom.GetStageUpAxis(stage)}")


def layers(stage: Any, path: Path) -> Iterator[Finding]:
    """USD places what a layer of other units holds without converting it: a room in metres around chairs in centimetres."""
    from pxr import UsdGeom

    root = stage.GetRootLayer()
    for layer in _used_layers(stage):
        if layer == root or layer == stage.GetSessionLayer():
            continue
        info = layer.pseudoRoot
        meters, up = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)
        if info.HasInfo("metersPerUnit") and not np.isclose(info.GetInfo("metersPerUnit"), meters):
            yield Finding(
                "layer_units", _name(layer, path), f"metersPerUnit is {info.GetInfo('metersPerUnit'):g}, the stage's is {meters:g}"
            )
        if info.HasInfo("upAxis") and info.GetInfo("upAxis") != up:
            yield Finding("layer_units", _name(layer, path), f"upAxis is {info.GetInfo('upAxis')}, the stage's is {up}")


def paths(stage: Any, path: Path) -> Iterator[Finding]:
    """Asset paths as written, in every layer that is used; they must be relative, stay inside and exist."""
    from pxr import Ar, Sdf, UsdUtils

    packed = names_in(path)
    root = PurePosixPath("/") if packed else PurePosixPath(path.parent.resolve())
    for layer in _used_layers(stage):
        if layer.anonymous:
            continue
        if packed:
            outer, inner = Ar.SplitPackageRelativePathOuter(layer.realPath)
            inside = Path(outer or layer.realPath).resolve() == path.resolve()
            real = root / (inner or packed[0]) if outer else root / packed[0]
        else:
            real = PurePosixPath(Path(layer.realPath).resolve())
            inside = real.is_relative_to(root)
        if not inside:
            yield Finding("closed_paths", PurePosixPath(layer.realPath).name, "is used, but lies outside the scene's folder")
            continue
        written: list[str] = []
        copy = Sdf.Layer.CreateAnonymous()
        copy.TransferContent(layer)
        UsdUtils.ModifyAssetPaths(copy, lambda text, keep=written: (keep.append(text), text)[1])
        where = real.relative_to(root).as_posix()
        for text in sorted(set(written) - {""}):
            if PurePosixPath(text).is_absolute() or ":" in text or "\\" in text:
                yield Finding("closed_paths", where, f"{PurePosixPath(text).name} is named by an absolute path")
                continue
            target = PurePosixPath(os.path.normpath(real.parent / text))
            depth = len(real.parent.relative_to(root).parts)
            if not target.is_relative_to(root) or _climbs(text) > depth:
                yield Finding("closed_paths", where, f"{text} leaves the scene's folder")
            elif not _exists(target, root, packed):
                known = text.lower().endswith(".mdl") and "/" not in text  # found along a search path, by those who have it
                yield Finding("closed_paths", where, f"{text} {'is known to Omniverse only' if known else 'does not exist'}", not known)


def _exists(target: PurePosixPath, root: PurePosixPath, packed: Sequence[str]) -> bool:
    """Whether a file is there, in the folder or in the package; of an image in tiles (`<UDIM>`) whether one of them is."""
    if "<UDIM>" in target.name:
        tile = re.compile(re.escape(target.name).replace("<UDIM>", r"1\d{3}"))
        folder = target.parent.relative_to(root).as_posix()
        places = [PurePosixPath(name) for name in packed] if packed else [PurePosixPath(p) for p in Path(target.parent).glob("*")]
        return any(tile.fullmatch(place.name) and (not packed or place.parent.as_posix() == folder) for place in places)
    return target.relative_to(root).as_posix() in packed if packed else is_there(Path(target))


def _climbs(text: str) -> int:
    """How many folders above its own a relative path goes."""
    level = lowest = 0
    for part in PurePosixPath(text).parts:
        level += -1 if part == ".." else 0 if part == "." else 1
        lowest = min(lowest, level)
    return -lowest


def _used_layers(stage: Any) -> list[Any]:
    """Layers of a stage in the order of their names."""
    return sorted(stage.GetUsedLayers(), key=lambda used: used.identifier)


def _name(layer: Any, path: Path) -> str:
    """A layer's name from the scene's folder, so it is the same wherever that lies."""
    return str(layer.identifier).replace(f"{path.parent.resolve()}/", "").replace(f"{path.parent}/", "")


def hierarchy(stage: Any, path: Path) -> Iterator[Finding]:
    """A component that is not below groups only is no model to USD, and is left out where models are listed."""
    from pxr import Kind, Usd

    for prim in traverse(stage):
        if prim.IsInstanceProxy() or Usd.ModelAPI(prim).GetKind() != Kind.Tokens.component or prim.IsModel():
            continue
        yield Finding("model_hierarchy", prim.GetPath().pathString, "is a component, but a prim above it is no group or assembly", False)


def joints(stage: Any, path: Path) -> Iterator[Finding]:
    """What joints hold, and what articulations consist of."""
    from pxr import UsdPhysics

    joined = _joined(stage)
    for prim in traverse(stage):
        where = prim.GetPath().pathString
        if prim.IsA(UsdPhysics.Joint):
            joint = UsdPhysics.Joint(prim)
            held = [joint.GetBody0Rel().GetTargets(), joint.GetBody1Rel().GetTargets()]
            places = [target for targets in held for target in targets]
            if not places:
                yield Finding("joints", where, "is a joint that holds nothing")
            if len(places) == 2 and places[0] == places[1]:
                yield Finding("joints", where, f"is a joint of {places[0]} with itself")
            for place in places:
                owner = stage.GetPrimAtPath(place)
                if not owner:
                    yield Finding("joints", where, f"is a joint of {place}, which does not exist")
                    continue
                while owner and not is_body(owner):
                    owner = owner.GetParent()
                if not owner and len(places) == 1:
                    yield Finding("joints", where, f"is a joint of {place}, which is no rigid body, with the world")
        elif prim.HasAPI(UsdPhysics.ArticulationRootAPI) and not (prim.GetPath() in joined or _has_joint(prim)):
            yield Finding("joints", where, "is the root of an articulation without a joint")


def _has_joint(prim: Any) -> bool:
    """Whether a joint lies below a prim."""
    from pxr import UsdPhysics

    return any(below.IsA(UsdPhysics.Joint) for below in subtree(prim))


def _joined(stage: Any) -> set[Any]:
    """Paths of all prims that a joint holds."""
    from pxr import UsdPhysics

    joints = [UsdPhysics.Joint(prim) for prim in traverse(stage) if prim.IsA(UsdPhysics.Joint)]
    return {target for joint in joints for end in (joint.GetBody0Rel(), joint.GetBody1Rel()) for target in end.GetTargets()}


def point_instancers(stage: Any, path: Path) -> Iterator[Finding]:
    """Copies that a point instancer scatters are drawn, but are no prims that an engine could find."""
    from pxr import UsdGeom

    for prim in traverse(stage):
        if prim.IsA(UsdGeom.PointInstancer):
            physical = next((below for below in subtree(prim) if is_body(below) or is_collider(below)), None)
            if physical is not None:
                yield Finding("point_instancer", prim.GetPath().pathString, f"scatters {physical.GetPath()}, which is to be simulated")


def ground(stage: Any, path: Path) -> Iterator[Finding]:
    """What moves, and has nothing below it that stays in place, falls for ever. What hangs on joints is left out."""
    from pxr import Kind, Usd, UsdGeom

    root = stage.GetDefaultPrim()
    if root and Usd.ModelAPI(root).GetKind() == Kind.Tokens.component:
        return  # one object, which stands in another file
    moving = {prim.GetPath(): prim for prim in bodies(stage) if moves(prim)}
    still = [prim for prim in traverse(stage) if is_collider(prim) and not any(path in moving for path in prim.GetPath().GetPrefixes())]
    if any(prim.IsA(UsdGeom.Plane) for prim in still):
        return  # which has no end
    up = 1 if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else 2
    flat = [axis for axis in range(3) if axis != up]
    clouds = [cloud for prim in still if (cloud := cloud_of(prim, is_collider)) is not None]
    low, high = (np.array([end(cloud, axis=0) for cloud in clouds]).reshape(-1, 3) for end in (np.min, np.max))
    joined = _joined(stage)
    for place, prim in moving.items():
        cloud = cloud_of(prim, is_collider) if place not in joined else None
        if cloud is None:
            continue
        bottom, middle = cloud.min(axis=0), (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
        over = ((low[:, flat] <= middle[flat]) & (middle[flat] <= high[:, flat])).all(axis=1)
        if not (over & (low[:, up] <= bottom[up])).any():
            yield Finding("ground", place.pathString, "nothing that stays in place lies below it: it falls for ever", False)


def viewing(stage: Any, path: Path) -> Iterator[Finding]:
    """Whether anybody who opens a scene sees something. A file of one object leaves that to the scene that refers to it."""
    from pxr import Kind, Usd, UsdGeom, UsdLux

    root = stage.GetDefaultPrim()
    if not root or Usd.ModelAPI(root).GetKind() == Kind.Tokens.component or not any(is_collider(prim) for prim in traverse(stage)):
        return
    prims = list(traverse(stage))
    if not any(prim.HasAPI(UsdLux.LightAPI) for prim in prims):
        yield Finding("viewing", path.name, "there is no light", is_lit(stage))
    eyes = [to_world(prim)[:3, 3] for prim in prims if prim.IsA(UsdGeom.Camera)]
    solid = cloud_of(root, is_collider)
    if not eyes:
        yield Finding("viewing", path.name, "there is no camera", is_lit(stage))
    elif solid is not None and not any(((solid.min(axis=0) <= eye) & (eye <= solid.max(axis=0))).all() for eye in eyes):
        yield Finding("viewing", path.name, "no camera is inside the box of what collides", is_lit(stage))


def physics_scene(stage: Any, path: Path) -> Iterator[Finding]:
    """Gravity, once. A file of one object, or of a room in which nothing moves, leaves it to the scene that refers to it."""
    from pxr import Kind, Usd, UsdGeom, UsdPhysics

    scenes = [prim for prim in traverse(stage) if prim.IsA(UsdPhysics.Scene)]
    root = stage.GetDefaultPrim()
    is_object = root and Usd.ModelAPI(root).GetKind() == Kind.Tokens.component
    moving = any(is_body(prim) or is_deformable(prim) for prim in traverse(stage))
    if len(scenes) > 1 or not (scenes or is_object or (not moving and any(is_collider(prim) for prim in traverse(stage)))):
        yield Finding("physics_scene", path.name, f"{len(scenes)} physics scenes")
    down = (0.0, -1.0, 0.0) if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else (0.0, 0.0, -1.0)
    for prim in scenes:
        scene = UsdPhysics.Scene(prim)
        direction, magnitude = vector(scene.GetGravityDirectionAttr()), number(scene.GetGravityMagnitudeAttr())
        if direction is None or magnitude is None or np.isnan(magnitude) or not np.isfinite(direction).all():
            yield Finding("physics_scene", prim.GetPath().pathString, "gravity is no direction and magnitude")
            continue
        if np.linalg.norm(direction) > 0 and not np.allclose(direction / np.linalg.norm(direction), down, atol=1e-3):
            yield Finding("physics_scene", prim.GetPath().pathString, f"gravity points to {tuple(map(float, direction))}")
        meters = UsdGeom.GetStageMetersPerUnit(stage)
        expected = 9.81 / meters if meters > 0 else np.nan
        if np.isfinite(magnitude) and magnitude >= 0 and not abs(magnitude - expected) <= 0.05 * expected:
            yield Finding("physics_scene", prim.GetPath().pathString, f"gravity is {magnitude:g}, on Earth {expected:g}")
