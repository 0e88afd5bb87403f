"""Brackets: thin boards at walls, in colliders alone, below what stood on a shelf of which the scan has nothing, glass or wire.

They belong to the room (`supports.bracket_blob`), so that what stands on them is as free as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.geometry.hulls import Hull
from tasks.geometry.transforms import inverse
from tasks.mounting import mounting
from tasks.optimization.colliders.cutting import beyond, prism
from tasks.optimization.colliders.undersides import DOWN, LOWER_SHARE, PLATE_M, apart_from, base_ring, holds
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.boards import BOARD_M
from tasks.optimization.support.supports import Carrier, PlacedAsset
from tasks.optimization.support.walls import WallFace, wall_contact, wall_faces

Array = NDArray[np.float64]

BRACKET = "bracket_"
"""Names of brackets begin so, and end with the instance that they carry."""

MOST_OFF_M = 0.35
"""The back of what stands on a shelf is no farther off its wall [m]: shelves are 20 to 40 cm deep."""

LEVEL_M = 0.04
"""Objects that end this near to the level of a bracket beside them [m] stood on the same shelf: scans lose their lowest centimeters."""

MOST_APART_M = 0.6
"""Things on one shelf are no farther apart [m], if nothing is seen between them."""

MOST_MATE_M = 0.5
"""Larger things that touch a wall hang on it [m]."""

SIDE_M = 0.02
"""A bracket reaches so far out of what it carries [m], on either side."""

CLEAR_M = 0.001
"""Gap between a bracket and what is beside it [m]."""


def with_brackets(
    objects: Sequence[PlacedAsset], solids: Sequence[ConvexParts], poses: Sequence[Array], carriers: Mapping[str, Carrier],
    room: Shell | None,
) -> tuple[list[ConvexParts], dict[str, Carrier], list[ConvexParts]]:  # fmt: skip
    """Solids and carriers of objects, and brackets in the world frame: what nothing carries near a wall, and whose name does not say that
    it hangs, has a flat plate below it and stands on a bracket at that wall, if there is room for both. What touches the wall beside it at
    the same level, and does not hang only, stood on the same shelf.

    poses: asset to world, 4x4 [m] each.
    """
    solids, carriers, brackets = list(solids), dict(carriers), list[ConvexParts]()
    faces = [face for face in wall_faces(room) if face.name is not None] if room is not None else []
    placed = [list(solid.placed(pose)) for solid, pose in zip(solids, poses, strict=True)]
    kinds = [mounting(obj.category).kind for obj in objects]
    relations = [carriers[obj.instance_id].relation for obj in objects]
    hanging = [
        i for i, relation in enumerate(relations) if relation == "none" and kinds[i] not in ("wall", "ceiling", "let_in", "covering")
    ]
    small = [i for i, obj in enumerate(objects) if relations[i] == "wall" and float((obj.high - obj.low).max()) <= MOST_MATE_M]
    mates = [i for i in small if kinds[i] in ("either", "any")]
    for i in [*hanging, *mates]:
        obj = objects[i]
        contact = wall_contact(obj, faces, MOST_OFF_M)
        if contact is None or (relations[i] == "wall" and not any(_is_mate(obj, contact.face, bracket) for bracket in brackets)):
            continue
        center = poses[i][:3, :3] @ mass_properties_of(solids[i]).center + poses[i][:3, 3]
        around = [hull for k, hulls in enumerate(placed) if k != i for hull in hulls]
        around += [hull for bracket in brackets for hull in bracket.hulls]
        plates, boards = _plates_and_boards(placed[i], center, contact.face, around)
        if not _hold(plates, center) or not _hold(boards, center):
            continue
        placed[i] += plates
        back = inverse(poses[i])
        solids[i] = ConvexParts(solids[i].name, tuple(hull.transformed(back) for hull in placed[i]))
        brackets.append(ConvexParts(f"{BRACKET}{obj.instance_id}", tuple(boards)))
        carriers[obj.instance_id] = Carrier("none", None, 0.0, 0.0, contact.face.name, is_inferred=True)
    return solids, carriers, brackets


def _plates_and_boards(hulls: Sequence[Hull], center: Array, face: WallFace, around: Sequence[Hull]) -> tuple[list[Hull], list[Hull]]:
    """A plate at the bottom of an object and a board right below it that begins at a wall, in parts that lie in nothing around. center:
    of the object's mass, shape (3,) [m]."""
    low = min(float(hull.vertices[:, 2].min()) for hull in hulls)
    height = max(float(hull.vertices[:, 2].max()) for hull in hulls) - low
    level = low + min(max(LOWER_SHARE * height, BOARD_M), height)
    lower = [part.vertices[:, :2] for hull in hulls if (part := beyond(hull, DOWN, -level)) is not None]
    ring = base_ring(np.concatenate([*lower, np.zeros((0, 2))]), center[:2])
    if ring is None:
        return [], []
    along, away = (ring - face.start) @ face.along, (ring - face.start) @ face.inward
    ends, depths = (along.min() - SIDE_M, along.max() + SIDE_M), (CLEAR_M, max(float(away.max()), 2 * SIDE_M))
    plan = np.array([face.start + a * face.along + b * face.inward for a in ends for b in depths])
    return _apart(prism(ring, low, low + PLATE_M), around), _apart(prism(plan, low - BOARD_M, low), around)


def _is_mate(obj: PlacedAsset, face: WallFace, bracket: ConvexParts) -> bool:
    """True if an object at a wall ends at the level of a bracket beside it there: both stood on one shelf."""
    vertices = np.concatenate([hull.vertices for hull in bracket.hulls])
    # A board behind the face is at another wall, as on the other side of a partition.
    off = float(((vertices[:, :2] - face.start) @ face.inward).min())
    if abs(float(vertices[:, 2].max() - obj.low[2])) > LEVEL_M or abs(off) > SIDE_M:
        return False
    own, other = (obj.plan_points - face.start) @ face.along, (vertices[:, :2] - face.start) @ face.along
    return bool(max(own.min() - other.max(), other.min() - own.max()) <= MOST_APART_M)


def _apart(hull: Hull | None, around: Sequence[Hull]) -> list[Hull]:
    """Convex parts of a hull that lie in none of several others; none if there is no hull."""
    if hull is None:
        return []
    first, last = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    near = [each for each in around if (each.vertices.min(axis=0) <= last).all() and (each.vertices.max(axis=0) >= first).all()]
    return apart_from(hull, near, CLEAR_M)


def _hold(parts: Sequence[Hull], center: Array) -> bool:
    """True if a center of mass, shape (3,), lies well within parts in plan."""
    return bool(parts) and holds(np.concatenate([part.vertices[:, :2] for part in parts]), center[:2])
