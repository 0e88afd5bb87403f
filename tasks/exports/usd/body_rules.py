"""Rules for what is in a USD scene: rigid bodies, colliders, deformable bodies, materials, what is seen, labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tasks.exports.findings import Finding
from tasks.exports.usd.prims import (
    bodies,
    cloud_of,
    dent,
    is_body,
    is_collider,
    is_deformable,
    is_visible,
    moves,
    number,
    objects,
    own_colliders,
    simulation_kind,
    subtree,
    to_world,
    traverse,
    triangles,
    vector,
    within,
)

SUPPORT_M = 5e-4
"""How far colliders may reach below what is seen [m]: float32 positions in a room are good to a micrometre, hulls to a tenth."""

SOFT_SUPPORT_M = 1e-2
"""The same for deformable bodies [m]: their mesh is coarser than what is seen, and gives way."""

HULL_M = 2e-3
"""A collider whose vertices lie this far inside its own hull [m] is no hull."""

OVERLAP_M = 2e-3
"""How deep colliders may start in one another [m]: engines push them apart, from here on visibly."""


def nesting(stage: Any, path: Path) -> Iterator[Finding]:
    """A body that moves with another one's frame is moved twice."""
    from pxr import UsdGeom

    for body in bodies(stage):
        parent = body.GetParent()
        while parent and not parent.IsPseudoRoot():
            if is_body(parent) and not UsdGeom.Xformable(body).GetResetXformStack():
                yield Finding("nested_bodies", where(body), f"lies inside {parent.GetPath()}")
                break
            parent = parent.GetParent()


def one_body(stage: Any, path: Path) -> Iterator[Finding]:
    """Tools that take a model for one thing want one body in it; where there are more, joints hold them together."""
    from pxr import Kind, Usd, UsdPhysics

    for prim in traverse(stage):
        if Usd.ModelAPI(prim).GetKind() != Kind.Tokens.component or prim.IsInstanceProxy():
            continue
        below = list(subtree(prim))
        count = sum(is_body(one) for one in below)
        if count > 1 and not any(one.IsA(UsdPhysics.Joint) for one in below):
            yield Finding("one_body", where(prim), f"is one model with {count} rigid bodies, and no joint among them", False)


def poses(stage: Any, path: Path) -> Iterator[Finding]:
    """Engines drop scale from bodies, or bake it, each in its own way."""
    from pxr import UsdGeom

    for prim in traverse(stage):
        solid = is_body(prim) or is_collider(prim)
        if not (solid or simulation_kind(prim)):
            continue
        rotation = to_world(prim)[:3, :3]
        if not np.isfinite(rotation).all() or not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            lengths = ", ".join(f"{value:.4g}" for value in np.linalg.norm(rotation, axis=0))
            # cubes and spheres are scaled by everybody who writes them; engines agree about those
            serious = is_body(prim) or prim.IsA(UsdGeom.PointBased)
            yield Finding("rigid_pose", where(prim), f"is scaled or sheared (axes {lengths})", serious)


def animation(stage: Any, path: Path) -> Iterator[Finding]:
    """A body cannot follow forces and a recording at once."""
    from pxr import UsdGeom

    for body in bodies(stage):
        if moves(body) and any(op.MightBeTimeVarying() for op in UsdGeom.Xformable(body).GetOrderedXformOps()):
            yield Finding("animated_body", where(body), "is moved by forces, but its pose is animated; make it kinematic")


def geometry(stage: Any, path: Path) -> Iterator[Finding]:
    """Meshes that can be read, inside the boxes that they state."""
    from pxr import UsdGeom

    for prim in traverse(stage):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = triangles(prim)
        if mesh is None:
            yield Finding("finite_geometry", where(prim), "positions or triangles are missing, not finite or out of range")
            continue
        attribute = UsdGeom.Boundable(prim).GetExtentAttr()
        if not attribute.HasAuthoredValue() or UsdGeom.Mesh(prim).GetPointsAttr().ValueMightBeTimeVarying():
            continue
        stated = _box(attribute)
        low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
        slack = 1e-4 * float(np.abs(mesh[0]).max()) + 1e-9
        if stated is None or (low < stated[0] - slack).any() or (high > stated[1] + slack).any():
            yield Finding("extents", where(prim), "the extent that is stated does not hold the positions: it is culled and framed wrongly")


def colliders(stage: Any, path: Path) -> Iterator[Finding]:
    """Every body collides, with shapes that all engines read the same way."""
    from pxr import UsdGeom, UsdPhysics

    moving = set()
    for body in bodies(stage):
        own = own_colliders(body)
        if not own:
            yield Finding("collider", where(body), "has no collider")
        if moves(body):
            moving |= {prim.GetPath() for prim in own}
    for prim in traverse(stage):
        if not is_collider(prim) or not prim.IsA(UsdGeom.Mesh) or simulation_kind(prim):
            continue
        stated = prim.HasAPI(UsdPhysics.MeshCollisionAPI)
        kind = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() if stated else UsdPhysics.Tokens.none
        raw = kind in (None, UsdPhysics.Tokens.none, UsdPhysics.Tokens.meshSimplification)
        if raw and prim.GetPath() in moving:
            yield Finding("triangle_collider", where(prim), "collides with its raw triangles, but moves")
        elif kind == UsdPhysics.Tokens.convexDecomposition:
            yield Finding("explicit_hulls", where(prim), "is left to the engine to decompose")
        elif kind == UsdPhysics.Tokens.convexHull:
            mesh = triangles(prim)
            if mesh is not None and dent(mesh) > HULL_M:
                yield Finding("explicit_hulls", where(prim), f"lies up to {dent(mesh) * 1000:.1f} mm inside its own hull")


def masses(stage: Any, path: Path) -> Iterator[Finding]:
    """Mass and inertia are stated and possible; engines make up what is not, each something else."""
    from pxr import UsdPhysics

    for body in bodies(stage):
        if not moves(body):
            continue
        api = UsdPhysics.MassAPI(body)
        stated = body.HasAPI(UsdPhysics.MassAPI)
        mass = number(api.GetMassAttr()) if stated else None
        if mass is None or not (np.isfinite(mass) and mass > 0):
            yield Finding("mass", where(body), f"is {mass:g}" if mass is not None else "is not stated")
        moments = vector(api.GetDiagonalInertiaAttr()) if stated else None
        if moments is None or not moments.any():
            yield Finding("inertia", where(body), "is not stated: every engine makes its own")
        elif not (np.isfinite(moments).all() and (moments > 0).all()):
            yield Finding("inertia", where(body), f"is {tuple(map(float, moments))}")
        elif moments.max() > (moments.sum() - moments.max()) * (1 + 1e-3):
            yield Finding("inertia", where(body), f"{tuple(map(float, moments))}: one moment exceeds the sum of the others")
        axes: Any = api.GetPrincipalAxesAttr().Get() if stated else None
        length = axes.GetLength() if hasattr(axes, "GetLength") else 0.0
        if length > 0 and not abs(length - 1.0) <= 1e-3:
            yield Finding("inertia", where(body), "its axes are no unit quaternion")


def boxes(stage: Any, path: Path) -> Iterator[Finding]:
    """What is seen and what collides are the same thing in the same place."""
    from pxr import UsdGeom, UsdPhysics

    up = 1 if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else 2
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    meters = meters if np.isfinite(meters) and meters > 0 else 1.0
    for body in objects(stage):
        drawn = [prim for prim in subtree(body) if is_visible(prim)]
        if not drawn:
            yield Finding("visual", where(body), "nothing of it can be seen")
        elif not all(map(is_collider, drawn)) and any(map(is_collider, drawn)):
            first = next(prim for prim in drawn if is_collider(prim))
            yield Finding("guides", where(first), "is a collider that is drawn beside what is meant to be seen", False)
        seen, solid = cloud_of(body, is_visible), cloud_of(body, is_collider)
        if solid is not None and seen is not None:
            below = float(seen[:, up].min() - solid[:, up].min()) * meters
            if below > (SOFT_SUPPORT_M if is_deformable(body) else SUPPORT_M):
                yield Finding("support_plane", where(body), f"a collider reaches {below * 1000:.1f} mm below what is seen")
        box = within(solid, body)
        if is_body(body) and body.HasAPI(UsdPhysics.MassAPI) and box is not None:
            center = vector(UsdPhysics.MassAPI(body).GetCenterOfMassAttr())
            slack = 1e-3 / meters
            if center is not None and np.isfinite(center).all() and ((center < box[0] - slack) | (center > box[1] + slack)).any():
                yield Finding("center_of_mass", where(body), "lies outside the body's colliders")


def overlaps(stage: Any, path: Path) -> Iterator[Finding]:
    """Moving bodies whose convex meshes start inside others': they jump when the simulation begins."""
    from pxr import UsdGeom, UsdPhysics

    from tasks.optimization.contacts import penetrations
    from tasks.optimization.solids import Solid
    from tasks.pieces import Hull

    meters = UsdGeom.GetStageMetersPerUnit(stage)
    things = objects(stage)
    found: list[tuple[int, Any, Hull]] = []
    for thing, prim in enumerate(things):
        for collider in subtree(prim):
            if not (is_collider(collider) and collider.IsA(UsdGeom.Mesh)) or simulation_kind(collider):
                continue
            if UsdPhysics.MeshCollisionAPI(collider).GetApproximationAttr().Get() != UsdPhysics.Tokens.convexHull:
                continue
            mesh, place = triangles(collider), to_world(collider)
            if mesh is not None and np.isfinite(place).all():
                found.append((thing, mesh, Hull((mesh[0] @ place[:3, :3].T + place[:3, 3]) * meters, mesh[1])))
    solids: dict[int, list[Hull]] = {}
    for at in _near(found):
        thing, mesh, hull = found[at]
        if dent(mesh) <= HULL_M and _is_solid(hull):
            solids.setdefault(thing, []).append(hull)
    named = {thing: Solid(where(things[thing]), tuple(hulls)) for thing, hulls in solids.items()}
    moving = [solid for thing, solid in named.items() if is_body(things[thing]) and moves(things[thing])]
    still = [solid for thing, solid in named.items() if not (is_body(things[thing]) and moves(things[thing]))]
    if moving and np.isfinite(meters):
        names = {solid.name for solid in named.values()}  # the floor z = 0 is not in the file
        for one in penetrations(moving, np.tile(np.eye(4), (len(moving), 1, 1)), still):
            if one.depth_m > OVERLAP_M and {one.a, one.b} <= names:
                yield Finding("start_overlap", one.a, f"starts {one.depth_m * 1000:.1f} mm inside {one.b}", False)


def _near(found: Sequence[tuple[int, Any, Any]]) -> list[int]:
    """Places of hulls whose boxes reach into the box of another thing's hull."""
    if not found:
        return []
    owner = np.array([one[0] for one in found])
    low, high = (np.array([end(one[2].vertices, axis=0) for one in found]) for end in (np.min, np.max))
    near = [
        bool((((np.minimum(high, high[i]) - np.maximum(low, low[i])).min(axis=1) > OVERLAP_M) & (owner != owner[i])).any())
        for i in range(len(found))
    ]
    return np.flatnonzero(near).tolist()


def materials(stage: Any, path: Path) -> Iterator[Finding]:
    """Friction and restitution, within what is possible."""
    from pxr import UsdPhysics, UsdShade

    for prim in traverse(stage):
        if not is_collider(prim):
            continue
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            yield Finding("physics_material", where(prim), "has no physics material", False)
            continue
        api = UsdPhysics.MaterialAPI(material)
        for name, attribute, limit in (
            ("static friction", api.GetStaticFrictionAttr(), 2.0), ("dynamic friction", api.GetDynamicFrictionAttr(), 2.0),
            ("restitution", api.GetRestitutionAttr(), 1.0),
        ):  # fmt: skip
            value = number(attribute)
            if value is None or not 0.0 <= value <= limit:
                said = "is no number" if value is None else f"is {value:g}, not within 0 and {limit:g}"
                yield Finding("physics_material", where(prim), f"{name} {said}")


def labels(stage: Any, path: Path) -> Iterator[Finding]:
    """Bodies say what they are where tools look: on their root, not inside a prototype."""
    for body in objects(stage):
        if _labeled(body):
            continue
        inside = body.IsInstance() and any(_labeled(prim) for prim in subtree(body))
        said = "has its semantic labels inside its prototype, not on the instance" if inside else "has no semantic label"
        yield Finding("labels", where(body), said, False)


def _labeled(prim: Any) -> bool:
    """Whether a semantic label is stated on a prim itself."""
    from pxr import UsdSemantics

    taxonomies = UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim)
    return any(UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get() for taxonomy in taxonomies)


def _is_solid(hull: Any) -> bool:
    """Whether a hull has a volume that depths can be measured in."""
    flat = np.linalg.svd(hull.vertices - hull.vertices.mean(axis=0), compute_uv=False)
    return bool(len(hull.vertices) >= 4 and flat[-1] > 1e-6 * max(flat[0], 1e-9) and flat[-1] > 1e-7)


def _box(attribute: Any) -> Any:
    """Lowest and highest corner that an extent states, shape (2, 3), or None."""
    try:
        box = np.array(attribute.Get(), dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return box if box.shape == (2, 3) and np.isfinite(box).all() else None


def where(prim: Any) -> str:
    """Path of a prim."""
    return str(prim.GetPath().pathString)
