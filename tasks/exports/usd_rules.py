"""Whether a USD scene can be simulated as it is: USD's own validators, and rules that they do not know.

Works on anybody's file. What only makes a scene less portable, or is a choice of this project, is a warning there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from tasks.exports.findings import Finding
from tasks.exports.usd_prims import (
    bodies,
    box_of,
    dent,
    is_body,
    is_collider,
    is_visible,
    moves,
    objects,
    own_colliders,
    subtree,
    to_world,
    traverse,
    triangles,
)

RULES: dict[str, str] = {
    "stage_opens": "the file opens as a USD stage",
    "usd_validation": "USD's own validators report no error",
    "default_prim": "a default prim is named and exists",
    "units": "metres and kilograms are stated, one unit each",
    "up_axis": "+Z is stated to be up",
    "closed_paths": "every file that is named is named by a relative path inside the scene's folder, and is there",
    "physics_scene": "there is one physics scene whose gravity points down",
    "nested_bodies": "no rigid body lies inside another one",
    "rigid_pose": "bodies and colliders are moved and turned, but not scaled, sheared or mirrored",
    "finite_geometry": "positions are finite and triangles name vertices that exist",
    "collider": "every rigid body has a collider",
    "triangle_collider": "no moving body collides with its raw triangles",
    "explicit_hulls": "colliders are convex as they are, so no engine has to decompose them",
    "mass": "every moving body has a mass above zero",
    "inertia": "every moving body has an inertia that a solid can have",
    "center_of_mass": "the center of mass lies inside the body's box",
    "support_plane": "colliders do not reach below what is seen of their object",
    "physics_material": "every collider has friction and restitution within bounds",
    "visual": "every body can be seen",
    "labels": "every body says what it is",
}
"""Every rule, and what holds when it passes."""

_SUPPORT_TOLERANCE = 5e-4  # metres: float32 positions in a room of ten metres are good to a micrometre; hulls to a tenth of this
_HULL_TOLERANCE = 2e-3  # metres; a collider whose vertices lie this far inside its own hull is no hull


def check_usd(path: Path) -> list[Finding]:
    """Everything that is wrong with a USD scene, sorted; empty for one that can be simulated as it is."""
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        return [Finding("stage_opens", path.name, _line(str(error), path))]
    findings: list[Finding] = []
    for check in _CHECKS:
        try:
            findings += check(stage, path)
        except Tf.ErrorException as error:  # a layer behind a reference is broken: it is only read when it is needed
            findings.append(Finding("stage_opens", path.name, _line(str(error), path)))
    return sorted(set(findings))


def _line(text: str, path: Path) -> str:
    """A message of USD's in one line, with files named from the scene's folder, so it is the same wherever that lies."""
    plain = text.replace(f"{path.parent.resolve()}/", "").replace(f"{path.parent}/", "")
    return re.sub(r"Error in '\S+' at line \d+ in file \S+ : ", "", " ".join(plain.split()))[:300]


def _validators(stage: Any, path: Path) -> Iterator[Finding]:
    """USD's own validators."""
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for error in UsdValidation.ValidationContext(validators).Validate(stage):
        kind = error.GetType()
        serious = kind == UsdValidation.ValidationErrorType.Error
        text = _line(error.GetMessage(), path)
        sites = [site.GetPrim().GetPath().pathString for site in error.GetSites() if site.IsPrim()]
        yield Finding("usd_validation", sites[0] if sites else path.name, f"{error.GetName()}: {text}", serious)


def _metadata(stage: Any, path: Path) -> Iterator[Finding]:
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


def _paths(stage: Any, path: Path) -> Iterator[Finding]:
    """Asset paths as written, in every layer that is used; they must be relative, stay inside and exist."""
    from pxr import Sdf, UsdUtils

    root = path.parent.resolve()
    for layer in sorted(stage.GetUsedLayers(), key=lambda used: used.identifier):
        if layer.anonymous:
            continue
        real = Path(layer.realPath).resolve()
        if not real.is_relative_to(root):
            yield Finding("closed_paths", real.name, "is used, but lies outside the scene's folder")
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
            target = (real.parent / text).resolve()
            if not target.is_relative_to(root):
                yield Finding("closed_paths", where, f"{text} leaves the scene's folder")
            elif not target.is_file():
                yield Finding("closed_paths", where, f"{text} does not exist")


def _physics_scene(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdGeom, UsdPhysics

    scenes = [prim for prim in traverse(stage) if prim.IsA(UsdPhysics.Scene)]
    if len(scenes) != 1:
        yield Finding("physics_scene", path.name, f"{len(scenes)} physics scenes")
    down = (0.0, -1.0, 0.0) if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else (0.0, 0.0, -1.0)
    for prim in scenes:
        scene = UsdPhysics.Scene(prim)
        direction = np.array(scene.GetGravityDirectionAttr().Get(), dtype=np.float64)
        magnitude = float(scene.GetGravityMagnitudeAttr().Get())
        if np.linalg.norm(direction) > 0 and not np.allclose(direction / np.linalg.norm(direction), down, atol=1e-3):
            yield Finding("physics_scene", prim.GetPath().pathString, f"gravity points to {tuple(map(float, direction))}")
        expected = 9.81 / UsdGeom.GetStageMetersPerUnit(stage)
        if np.isfinite(magnitude) and magnitude >= 0 and abs(magnitude - expected) > 0.05 * expected:
            yield Finding("physics_scene", prim.GetPath().pathString, f"gravity is {magnitude:g}, on Earth {expected:g}")


def _nesting(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdGeom

    for body in bodies(stage):
        parent = body.GetParent()
        while parent and not parent.IsPseudoRoot():
            if is_body(parent) and not UsdGeom.Xformable(body).GetResetXformStack():
                yield Finding("nested_bodies", body.GetPath().pathString, f"lies inside {parent.GetPath()}")
                break
            parent = parent.GetParent()


def _poses(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdGeom

    for prim in traverse(stage):
        if not (is_body(prim) or is_collider(prim)):
            continue
        rotation = to_world(prim)[:3, :3]
        if not np.isfinite(rotation).all() or not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            lengths = ", ".join(f"{value:.4g}" for value in np.linalg.norm(rotation, axis=0))
            # cubes and spheres are scaled by everybody who writes them; engines agree about those
            serious = is_body(prim) or prim.IsA(UsdGeom.Mesh)
            yield Finding("rigid_pose", prim.GetPath().pathString, f"is scaled or sheared (axes {lengths})", serious)


def _geometry(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdGeom

    for prim in traverse(stage):
        if prim.IsA(UsdGeom.Mesh) and triangles(prim) is None:
            yield Finding("finite_geometry", prim.GetPath().pathString, "positions or triangles are missing, not finite or out of range")


def _colliders(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdGeom, UsdPhysics

    moving = set()
    for body in bodies(stage):
        own = own_colliders(body)
        if not own:
            yield Finding("collider", body.GetPath().pathString, "has no collider")
        if moves(body):
            moving |= {prim.GetPath() for prim in own}
    for prim in traverse(stage):
        if not is_collider(prim) or not prim.IsA(UsdGeom.Mesh):
            continue
        where = prim.GetPath().pathString
        stated = prim.HasAPI(UsdPhysics.MeshCollisionAPI)
        kind = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() if stated else UsdPhysics.Tokens.none
        raw = kind in (None, UsdPhysics.Tokens.none, UsdPhysics.Tokens.meshSimplification)
        if raw and prim.GetPath() in moving:
            yield Finding("triangle_collider", where, "collides with its raw triangles, but moves")
        elif kind == UsdPhysics.Tokens.convexDecomposition:
            yield Finding("explicit_hulls", where, "is left to the engine to decompose")
        elif kind == UsdPhysics.Tokens.convexHull:
            mesh = triangles(prim)
            if mesh is not None and dent(mesh) > _HULL_TOLERANCE:
                yield Finding("explicit_hulls", where, f"lies up to {dent(mesh) * 1000:.1f} mm inside its own hull")


def _masses(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdPhysics

    for body in bodies(stage):
        if not moves(body):
            continue
        where = body.GetPath().pathString
        api = UsdPhysics.MassAPI(body)
        stated = body.HasAPI(UsdPhysics.MassAPI)
        mass = float(api.GetMassAttr().Get() or 0.0) if stated else 0.0
        if not (np.isfinite(mass) and mass > 0):
            yield Finding("mass", where, f"is {mass:g}" if stated else "is not stated")
        moments = np.array((api.GetDiagonalInertiaAttr().Get() if stated else None) or (0, 0, 0), dtype=np.float64)
        if not moments.any():
            yield Finding("inertia", where, "is not stated: every engine makes its own")
        elif not (np.isfinite(moments).all() and (moments > 0).all()):
            yield Finding("inertia", where, f"is {tuple(map(float, moments))}")
        elif moments.max() > (moments.sum() - moments.max()) * (1 + 1e-3):
            yield Finding("inertia", where, f"{tuple(map(float, moments))}: one moment exceeds the sum of the others")
        axes = api.GetPrincipalAxesAttr().Get() if stated else None
        if axes is not None and axes.GetLength() > 0 and abs(axes.GetLength() - 1.0) > 1e-3:
            yield Finding("inertia", where, "its axes are no unit quaternion")


def _boxes(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdPhysics

    for body in objects(stage):
        where = body.GetPath().pathString
        if not any(is_visible(prim) for prim in subtree(body)):
            yield Finding("visual", where, "nothing of it can be seen")
        seen, solid = box_of(body, is_visible), box_of(body, is_collider)
        if solid is not None and seen is not None and solid[0, 2] < seen[0, 2] - _SUPPORT_TOLERANCE:
            yield Finding("support_plane", where, f"a collider reaches {(seen[0, 2] - solid[0, 2]) * 1000:.1f} mm below what is seen")
        if is_body(body) and body.HasAPI(UsdPhysics.MassAPI) and solid is not None:
            center = np.array(UsdPhysics.MassAPI(body).GetCenterOfMassAttr().Get() or (0, 0, 0), dtype=np.float64)
            stated = np.isfinite(center).all()
            if stated and ((center < solid[0] - 1e-3) | (center > solid[1] + 1e-3)).any():
                yield Finding("center_of_mass", where, "lies outside the body's colliders")


def _materials(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdPhysics, UsdShade

    for prim in traverse(stage):
        if not is_collider(prim):
            continue
        where = prim.GetPath().pathString
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            yield Finding("physics_material", where, "has no physics material", False)
            continue
        api = UsdPhysics.MaterialAPI(material)
        for name, attribute, limit in (
            ("static friction", api.GetStaticFrictionAttr(), 2.0), ("dynamic friction", api.GetDynamicFrictionAttr(), 2.0),
            ("restitution", api.GetRestitutionAttr(), 1.0),
        ):  # fmt: skip
            value = float(attribute.Get())
            if not 0.0 <= value <= limit:
                yield Finding("physics_material", where, f"{name} is {value:g}, not within 0 and {limit:g}")


def _labels(stage: Any, path: Path) -> Iterator[Finding]:
    from pxr import UsdSemantics

    for body in objects(stage):
        taxonomies = UsdSemantics.LabelsAPI.GetDirectTaxonomies(body)
        if not any(UsdSemantics.LabelsAPI(body, taxonomy).GetLabelsAttr().Get() for taxonomy in taxonomies):
            yield Finding("labels", body.GetPath().pathString, "has no semantic label", False)


_CHECKS: tuple[Callable[[Any, Path], Iterator[Finding]], ...] = (
    _validators, _metadata, _paths, _physics_scene, _nesting, _poses, _geometry, _colliders, _masses, _boxes, _materials, _labels,
)  # fmt: skip
