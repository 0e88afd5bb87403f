"""Rules for what is in a USD scene: rigid bodies, colliders, deformable bodies, materials, what is seen, labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tasks.exports.findings import Finding
from tasks.exports.usd.layers import DEPENETRATION
from tasks.exports.usd.prims import (
    bodies,
    dent,
    is_body,
    is_collider,
    is_lit,
    is_ours,
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
)
from tasks.geometry.hulls import are_few, complexity, hull_of, is_within

UNIT = 2e-3
"""How far from 1 a quaternion's length may be: half precision is good to half of it."""

HULL_M = 2e-3
"""A collider whose vertices lie this far inside its own hull [m] is no hull."""

OVERLAP_M = 2e-3
"""How deep colliders may start in one another [m]: engines push them apart, from here on visibly."""


FASTEST_M_S = 1.0
"""From here on what PhysX pushes out of another object jumps [m/s]: at 1 m/s an object flies 5 cm high."""


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
    """Tools that take a model for one object want one body in it; where there are more, joints hold them together."""
    from pxr import Kind, Usd, UsdPhysics

    for prim in traverse(stage):
        if Usd.ModelAPI(prim).GetKind() != Kind.Tokens.component or prim.IsInstanceProxy():
            continue
        below = list(subtree(prim))
        count = sum(is_body(below_prim) for below_prim in below)
        if count > 1 and not any(below_prim.IsA(UsdPhysics.Joint) for below_prim in below):
            yield Finding("one_body", where(prim), f"is one model with {count} rigid bodies, and no joint among them", False)


def poses(stage: Any, path: Path) -> Iterator[Finding]:
    """Engines drop scale from bodies, or bake it, each in its own way; and of a rotation that is none each makes another."""
    from pxr import Usd, UsdGeom

    frames, sound = UsdGeom.XformCache(Usd.TimeCode.Default()), set[bytes]()
    for prim in traverse(stage):
        for op in UsdGeom.Xformable(prim).GetOrderedXformOps() if prim.IsA(UsdGeom.Xformable) else ():
            turn: Any = op.Get() if op.GetOpType() == UsdGeom.XformOp.TypeOrient else None
            if hasattr(turn, "GetLength") and not abs(turn.GetLength() - 1.0) <= UNIT:
                yield Finding("rigid_pose", where(prim), f"{op.GetOpName()} is no unit quaternion, but has length {turn.GetLength():.4g}")
        if not (is_body(prim) or is_collider(prim) or simulation_kind(prim)):
            continue
        axes = to_world(prim, frames)[:3, :3]
        if axes.tobytes() in sound:  # a body's colliders stand in its own frame
            continue
        lengths = np.linalg.norm(axes, axis=0)
        if not (np.isfinite(axes).all() and (lengths > 0.0).all()):
            yield Finding("rigid_pose", where(prim), "has no place: its frame is not finite, or has no volume")
            continue
        turned = np.allclose((axes / lengths).T @ (axes / lengths), np.eye(3), atol=1e-4) and np.linalg.det(axes) > 0
        if not turned or not np.allclose(lengths, 1.0, atol=5e-5):
            # cubes and spheres are scaled by everybody who writes them, meshes of rooms too; engines agree about those
            serious = is_body(prim) or (prim.IsA(UsdGeom.PointBased) and (not turned or simulation_kind(prim) is not None))
            text = ", ".join(f"{value:.4g}" for value in lengths)
            yield Finding("rigid_pose", where(prim), f"is {'scaled' if turned else 'sheared or mirrored'} (axes {text})", serious)
        else:
            sound.add(axes.tobytes())


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
            yield Finding("explicit_hulls", where(prim), "is left to the engine to decompose", is_ours(stage))
        elif kind == UsdPhysics.Tokens.convexHull:
            mesh = triangles(prim)
            if mesh is not None and not _is_solid(mesh[0]):
                yield Finding("collider", where(prim), "is flat: there is no hull with a volume")
            elif mesh is not None and dent(mesh) > HULL_M:
                yield Finding("explicit_hulls", where(prim), f"lies up to {dent(mesh) * 1000:.1f} mm inside its own hull", is_ours(stage))
            elif mesh is not None and not are_few(len(mesh[0])) and not is_within(hull := hull_of(mesh[0])):
                counts = complexity(hull)
                message = f"has {counts.vertices} vertices and {counts.polygons} faces: PhysX takes 64 of each, and cooks a smaller one"
                yield Finding("hull_limits", where(prim), message, is_lit(stage))
        elif kind in ("sdf", "sphereFill"):
            yield Finding("explicit_hulls", where(prim), f"collides as {kind}, which only PhysX knows", False)
        elif not raw and kind not in (UsdPhysics.Tokens.boundingCube, UsdPhysics.Tokens.boundingSphere):
            yield Finding("explicit_hulls", where(prim), f"its approximation {str(kind)!r} is none that engines know")


def masses(stage: Any, path: Path) -> Iterator[Finding]:
    """Mass and inertia are possible, and stated: engines make up what is not, each something else, as USD allows them to."""
    from pxr import UsdPhysics

    for body in bodies(stage):
        if not moves(body):
            continue
        api = UsdPhysics.MassAPI(body)
        stated = body.HasAPI(UsdPhysics.MassAPI)
        mass = (number(api.GetMassAttr()) if stated else None) or None  # 0 says that it is not stated
        weighed = mass is None and _is_weighed(body)
        if weighed:
            yield Finding("mass", where(body), "is left to the density or mass of its colliders", False)
        elif mass is None or not (np.isfinite(mass) and mass > 0):
            yield Finding("mass", where(body), f"is {mass:g}" if mass is not None else "is not stated", mass is not None or is_ours(stage))
        moments = vector(api.GetDiagonalInertiaAttr()) if stated else None
        if moments is None or not moments.any():
            yield Finding("inertia", where(body), "is not stated: every engine makes its own", is_ours(stage))
        elif not (np.isfinite(moments).all() and (moments > 0).all()):
            yield Finding("inertia", where(body), f"is {tuple(map(float, moments))}")
        elif moments.max() > (moments.sum() - moments.max()) * (1 + 1e-3):
            yield Finding("inertia", where(body), f"{tuple(map(float, moments))}: one moment exceeds the sum of the others")
        axes: Any = api.GetPrincipalAxesAttr().Get() if stated else None
        length = axes.GetLength() if hasattr(axes, "GetLength") else 0.0
        if length > 0 and not abs(length - 1.0) <= 1e-3:
            yield Finding("inertia", where(body), "its axes are no unit quaternion")


def _is_weighed(body: Any) -> bool:
    """Whether the mass of a body follows from a density, or from masses of its colliders, that are stated."""
    from pxr import UsdPhysics, UsdShade

    attributes = [UsdPhysics.MassAPI(body).GetDensityAttr()]
    for prim in own_colliders(body):
        attributes += [UsdPhysics.MassAPI(prim).GetMassAttr(), UsdPhysics.MassAPI(prim).GetDensityAttr()]
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        attributes += [UsdPhysics.MaterialAPI(material).GetDensityAttr()] if material else []
    return any(0.0 < (number(attribute) or 0.0) < np.inf for attribute in attributes)


def overlaps(stage: Any, path: Path) -> Iterator[Finding]:
    """Moving bodies whose convex meshes start inside others': they jump when the simulation begins."""
    from pxr import UsdGeom, UsdPhysics

    from tasks.geometry.pieces import Hull
    from tasks.optimization.contacts import penetrations
    from tasks.optimization.solids import ConvexParts

    meters = UsdGeom.GetStageMetersPerUnit(stage)
    prims = objects(stage)
    bodies_hulls: list[tuple[int, Any, Hull]] = []
    for obj, prim in enumerate(prims):
        for collider in subtree(prim):
            if not (is_collider(collider) and collider.IsA(UsdGeom.Mesh)) or simulation_kind(collider):
                continue
            if UsdPhysics.MeshCollisionAPI(collider).GetApproximationAttr().Get() != UsdPhysics.Tokens.convexHull:
                continue
            mesh, place = triangles(collider), to_world(collider)
            if mesh is not None and np.isfinite(place).all():
                bodies_hulls.append((obj, mesh, Hull((mesh[0] @ place[:3, :3].T + place[:3, 3]) * meters, mesh[1])))
    solids: dict[int, list[Hull]] = {}
    for at in _near(bodies_hulls):
        obj, mesh, hull = bodies_hulls[at]
        if dent(mesh) <= HULL_M and _is_solid(hull.vertices):
            solids.setdefault(obj, []).append(hull)
    named = {obj: ConvexParts(where(prims[obj]), tuple(hulls)) for obj, hulls in solids.items()}
    moving = [solid for obj, solid in named.items() if is_body(prims[obj]) and moves(prims[obj])]
    still = [solid for obj, solid in named.items() if not (is_body(prims[obj]) and moves(prims[obj]))]
    if moving and np.isfinite(meters):
        names = {solid.name for solid in named.values()}  # the floor z = 0 is not in the file
        for contact in penetrations(moving, np.tile(np.eye(4), (len(moving), 1, 1)), still):
            if contact.depth_m > OVERLAP_M and {contact.a, contact.b} <= names:
                yield Finding("start_overlap", contact.a, f"starts {contact.depth_m * 1000:.1f} mm inside {contact.b}")


def _near(hulls: Sequence[tuple[int, Any, Any]]) -> list[int]:
    """Places of hulls whose boxes reach into the box of another object's hull."""
    if not hulls:
        return []
    owner = np.array([entry[0] for entry in hulls])
    low, high = (np.array([end(entry[2].vertices, axis=0) for entry in hulls]) for end in (np.min, np.max))
    near = [
        bool((((np.minimum(high, high[i]) - np.maximum(low, low[i])).min(axis=1) > OVERLAP_M) & (owner != owner[i])).any())
        for i in range(len(hulls))
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
        if not prim.HasAPI(UsdShade.MaterialBindingAPI):
            message = "inherits its physics material: USD's own physics parser sees only what is bound on a collider"
            yield Finding("physics_material", where(prim), message, is_lit(stage))
        api = UsdPhysics.MaterialAPI(material)
        for name, attribute, limit in (
            ("static friction", api.GetStaticFrictionAttr(), 2.0), ("dynamic friction", api.GetDynamicFrictionAttr(), 2.0),
            ("restitution", api.GetRestitutionAttr(), 1.0),
        ):  # fmt: skip
            value = number(attribute)
            if value is None or not 0.0 <= value <= limit:
                message = "is no number" if value is None else f"is {value:g}, not within 0 and {limit:g}"
                yield Finding("physics_material", where(prim), f"{name} {message}")


def depenetration(stage: Any, path: Path) -> Iterator[Finding]:
    """How fast what overlaps at the start is driven apart in PhysX, whose first step takes micrometers for a collision."""
    for body in bodies(stage):
        if not moves(body):
            continue
        speed = number(body.GetAttribute(DEPENETRATION))
        if speed is None:
            yield Finding("depenetration", where(body), f"{DEPENETRATION} is not stated: PhysX takes 3 m/s", is_lit(stage))
        elif not 0.0 < speed <= FASTEST_M_S:
            yield Finding(
                "depenetration", where(body), f"{DEPENETRATION} is {speed:g}, not above 0 and at most {FASTEST_M_S:g}", is_ours(stage)
            )


def labels(stage: Any, path: Path) -> Iterator[Finding]:
    """Bodies say what they are where tools look: on their root, not inside a prototype."""
    for body in objects(stage):
        if _labeled(body):
            continue
        inside = body.IsInstance() and any(_labeled(prim) for prim in subtree(body))
        message = "has its semantic labels inside its prototype, not on the instance" if inside else "has no semantic label"
        yield Finding("labels", where(body), message, False)


def _labeled(prim: Any) -> bool:
    """Whether a semantic label is stated on a prim itself."""
    from pxr import UsdSemantics

    taxonomies = UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim)
    return any(UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get() for taxonomy in taxonomies)


def _is_solid(vertices: Any) -> bool:
    """Whether positions, shape (n, 3), span a volume that depths can be measured in."""
    flat = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    return bool(len(vertices) >= 4 and flat[-1] > 1e-6 * max(flat[0], 1e-9) and flat[-1] > 1e-7)


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
