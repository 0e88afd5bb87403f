"""Rules for how what is seen of an object, what collides of it, and where its mass is, fit one another in a USD scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tasks.exports.findings import Finding
from tasks.exports.usd.body_rules import where
from tasks.exports.usd.prims import (
    cloud_of,
    is_body,
    is_collider,
    is_deformable,
    is_visible,
    number,
    objects,
    subtree,
    to_world,
    vector,
    within,
)

SUPPORT_M = 5e-4
"""How far colliders may reach below what is seen [m]: float32 positions in a room are good to a micrometre, hulls to a tenth."""

TIPPED_SUPPORT_M = 1e-2
"""The same for what leans or was laid down [m]: only the bottoms of colliders end where what is seen does; rounded sides may be off by
as much (`PieceConfig.deviation_m`), the corner of a leaning pillow by 5.2 mm."""

TIPPED = 0.02
"""What leans by more than this is tipped [rad]: a degree."""

SOFT_SUPPORT_M = 1e-2
"""The same for deformable bodies [m]: their mesh is coarser than what is seen, and gives way."""

PROTRUSION_M, PROTRUSION = 0.05, 0.1
"""How far colliders may reach out of the box of what is seen [m], and as a share of its diagonal; the greater counts."""


def boxes(stage: Any, path: Path) -> Iterator[Finding]:
    """What is seen and what collides are the same object in the same place."""
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
            if not _has_inferred_support(body) and below > (
                SOFT_SUPPORT_M if is_deformable(body) else TIPPED_SUPPORT_M if _is_tipped(body, up) else SUPPORT_M
            ):
                yield Finding("support_plane", where(body), f"a collider reaches {below * 1000:.1f} mm below what is seen")
            yield from _apart(body, seen, solid, meters)
        if is_body(body) and body.HasAPI(UsdPhysics.MassAPI):
            yield from _balance(body, seen, solid, meters)


def _apart(body: Any, seen: Any, solid: Any, meters: float) -> Iterator[Finding]:
    """Whether the boxes of what is seen and of what collides, world positions of shape (n, 3), fit one another."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    gap = float(np.maximum(low - solid.max(axis=0), solid.min(axis=0) - high).max()) * meters
    out = float(np.maximum(low - solid.min(axis=0), solid.max(axis=0) - high).max()) * meters
    if gap > 1e-3:
        yield Finding("visual", where(body), f"what is seen lies {gap:.3g} m beside what collides")
    elif out > max(PROTRUSION_M, PROTRUSION * float(np.linalg.norm(high - low)) * meters):
        yield Finding("protrusion", where(body), f"a collider reaches {out:.3g} m out of the box of what is seen", False)


def _balance(body: Any, seen: Any, solid: Any, meters: float) -> Iterator[Finding]:
    """Center of mass and inertia, held against where the body is."""
    from pxr import UsdPhysics

    api = UsdPhysics.MassAPI(body)
    center, moments, mass = vector(api.GetCenterOfMassAttr()), vector(api.GetDiagonalInertiaAttr()), number(api.GetMassAttr())
    if center is None or np.isneginf(center).all():  # how USD says that it is not stated
        return
    if not np.isfinite(center).all():
        yield Finding("center_of_mass", where(body), f"is {tuple(map(float, center))}")
        return
    box, slack = within(solid, body), 1e-3 / meters
    if box is not None and ((center < box[0] - slack) | (center > box[1] + slack)).any():
        yield Finding("center_of_mass", where(body), "lies outside the body's colliders")
    whole = [bounds for bounds in (within(seen, body), box) if bounds is not None]
    if not whole or moments is None or not np.isfinite(moments).all() or mass is None or not 0.0 < mass < np.inf:
        return
    reach = np.maximum(*(np.abs(end([bounds[i] for bounds in whole], axis=0) - center) for i, end in enumerate((np.min, np.max))))
    if moments.max() > 2.0 * mass * float(reach @ reach):
        message = f"{moments.max():.3g} is more than its mass could have in its farthest corner, {mass * float(reach @ reach):.3g}"
        yield Finding("inertia", where(body), message)


def _has_inferred_support(body: Any) -> bool:
    """True if the scan of an object of this project does not show what it stands on: a part of its collider alone stands in for that."""
    return bool((body.GetCustomDataByKey("metascenes") or {}).get("support") == "inferred")


def _is_tipped(body: Any, up: int) -> bool:
    """Whether a body's own axis `up` (1: y, 2: z) leans in the world."""
    axis = to_world(body)[:3, up]
    length = float(np.linalg.norm(axis))
    return length > 0.0 and float(axis[up]) < length * np.cos(TIPPED)
