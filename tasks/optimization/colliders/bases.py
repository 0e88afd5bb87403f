"""Bases: colliders that reach down to what carries an object whose lower part the scan did not see.

The lower part of many things is hidden behind others. What was seen of them stays where it was scanned; engines, which see colliders only,
get a prism below it, as wide as its lower part, or in line with it where it leans.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.geometry.hulls import Hull
from tasks.geometry.transforms import inverse
from tasks.geometry.triangles import face_planes
from tasks.mounting import mounting
from tasks.optimization.colliders.cutting import beyond, solid_hull
from tasks.optimization.colliders.undersides import DOWN, LOWER_SHARE, apart_from, base_ring, holds
from tasks.optimization.solids import ConvexParts, mass_properties_of
from tasks.optimization.support.leaning import LEAST_LEAN_RADIANS, MOST_LEAN_RADIANS, is_leaning, lean_of
from tasks.optimization.support.supports import Carrier, PlacedAsset, SupportConfig, is_covering
from tasks.optimization.support.walls import wall_faces

Array = NDArray[np.float64]

HIGH_M = 0.05
"""Objects that are less high above their carrier [m] are let down: the F-score at 5 cm hardly changes."""

MOST_TOP_M, TOP_SHARE = 1.2, 0.34
"""Furniture of which so small a share of the height above the floor was seen, and that ends no higher than this [m], does not hang:
cabinets on walls are seen from below as well."""

SLICE_M = 0.05
"""Height of the lowest part of what leans, which goes on downwards in line with it [m]."""

FOOT_M = 0.01
"""The part of a base that is this near to the carrier [m] is what the object stands on."""

FOOT_SHARE = 0.5
"""Minimum share of the foot of a leaning object that is free: on a smaller stub the object would turn and fall."""

CLEAR_M = 0.001
"""Gap between a base and what is beside it [m]."""

CARRIED_SHARE = 0.5
"""Of the points of a base that lie over a body which is to carry it."""


@dataclasses.dataclass(frozen=True)
class _Standing:
    """An object whose base is looked for. hulls: its pieces in the world frame. lower: points of its lower part, shape (n, 3) [m].
    ring: corners of its base in plan, shape (k, 2) [m]. center: of its mass, world frame, shape (3,) [m]. up: unit vector up along it
    where it leans, else None."""

    low: float
    height: float
    lower: Array
    ring: Array
    center: Array
    up: Array | None


def with_bases(
    objects: Sequence[PlacedAsset], solids: Sequence[ConvexParts], poses: Sequence[Array], carriers: Mapping[str, Carrier],
    room: Shell | None, config: SupportConfig,
) -> tuple[list[PlacedAsset], list[ConvexParts], dict[str, Carrier]]:  # fmt: skip
    """Objects, their solids and carriers, in which what is higher above its carrier than `HIGH_M` has a collider that reaches down to it,
    and so has what nothing carries, or what leans at a wall, and whose name does not say that it hangs, if anything is at most
    `config.stand_drop_m` below it. What has no room for that, or would not stand on it, is left as it is.

    poses: asset to world, 4x4 [m] each.
    """
    faces = {face.name: face for face in wall_faces(room) if face.name is not None} if room is not None else {}
    objects, solids, carriers = list(objects), list(solids), dict(carriers)
    placed = [list(solid.placed(pose)) for solid, pose in zip(solids, poses, strict=True)]
    index = {obj.instance_id: i for i, obj in enumerate(objects)}
    own = {n: c.lift - (carriers[c.parent_id].lift if c.parent_id is not None else 0.0) for n, c in carriers.items()}
    below = {name: carrier.parent_id for name, carrier in carriers.items()}
    for name in sorted(carriers, key=lambda name: (float(objects[index[name]].low[2]), name)):
        carrier, i = carriers[name], index[name]
        is_high = carrier.relation in ("floor", "on", "inside") and carrier.gap > HIGH_M
        may_stand = mounting(objects[i].category).kind not in ("wall", "ceiling", "let_in", "covering")
        face = faces.get(carrier.against or "") if carrier.relation == "wall" else None
        stands_at_wall = face is not None and (is_leaning(objects[i], face) or _is_top_of_furniture(objects[i]))
        is_loose = may_stand and (carrier.relation == "none" or stands_at_wall)
        if not (is_high or is_loose) or (carrier.is_fixed and is_high) or is_covering(objects[i], config):
            continue
        standing = _standing(objects[i], placed[i], solids[i], poses[i], carrier)
        if standing is None:
            continue
        parent = index[carrier.parent_id] if carrier.parent_id is not None else None
        level = float(objects[i].low[2]) - carrier.gap
        if is_loose:
            on = [k for k, obj in enumerate(objects) if k != i and not _rests_on(obj.instance_id, name, below)]
            parent, level = _rest_below(standing, placed, on)
            if standing.low - level > config.stand_drop_m:
                continue
        base = _base(standing, placed, i, parent, level)
        if not base:
            continue
        placed[i] += base
        back = inverse(poses[i])
        solids[i] = ConvexParts(solids[i].name, tuple(hull.transformed(back) for hull in placed[i]))
        reach = float(objects[i].low[2]) - level
        objects[i], own[name] = _reaching(objects[i], level), 0.0
        above = None if parent is None else objects[parent].instance_id
        relation = carrier.relation if is_high else "floor" if above is None else "on"
        below[name] = above
        carriers[name] = Carrier(relation, above, 0.0, 0.0, carrier.against, is_inferred=True, reach=reach)

    def lift(name: str) -> float:
        above = below[name]
        return own[name] + (lift(above) if above is not None else 0.0)

    return objects, solids, {name: dataclasses.replace(carrier, lift=lift(name)) for name, carrier in carriers.items()}


def _is_top_of_furniture(obj: PlacedAsset) -> bool:
    """True if an object is low furniture that stands on its body or legs, of which the upper part alone was seen."""
    kind = mounting(obj.category)
    if kind.base is None or kind.is_fitted or kind.is_built_in or float(obj.high[2]) > MOST_TOP_M:
        return False
    return obj.height <= TOP_SHARE * float(obj.high[2])


def _standing(obj: PlacedAsset, hulls: Sequence[Hull], solid: ConvexParts, pose: Array, carrier: Carrier) -> _Standing | None:
    """The lower part of an object, for its base; None where it has no width."""
    low = min(float(hull.vertices[:, 2].min()) for hull in hulls)
    height = max(float(hull.vertices[:, 2].max()) for hull in hulls) - low
    lean = lean_of(obj) if carrier.against is not None else None
    up = lean.up if lean is not None and LEAST_LEAN_RADIANS <= lean.radians <= MOST_LEAN_RADIANS else None
    top = low + min(max(SLICE_M if up is not None else LOWER_SHARE * height, 0.02), height)
    lower = [part.vertices for hull in hulls if (part := beyond(hull, DOWN, -top)) is not None]
    center = pose[:3, :3] @ mass_properties_of(solid).center + pose[:3, 3]
    points = np.concatenate([*lower, np.zeros((0, 3))])
    ring = base_ring(points[:, :2], center[:2])
    return None if ring is None or not len(points) else _Standing(low, height, points, ring, center, up)


def _rest_below(standing: _Standing, placed: Sequence[Sequence[Hull]], on: Sequence[int]) -> tuple[int | None, float]:
    """The body, None for the floor, right below an object, of those numbered in `on`, and the height of its top there [m]."""
    middle = standing.ring.mean(axis=0)
    plan = np.concatenate([middle + share * (standing.ring - middle) for share in (0.95, 0.6, 0.3)] + [middle[None]])
    parent, level = None, 0.0
    for k in on:
        tops = np.full(len(plan), -np.inf)
        for hull in placed[k]:
            tops = np.maximum(tops, _tops(hull, plan, standing.low + FOOT_M))
        if np.isfinite(tops).mean() >= CARRIED_SHARE and float(tops.max()) > level:
            parent, level = k, float(tops.max())
    return parent, level


def _tops(hull: Hull, plan: Array, most: float) -> Array:
    """Heights of the top of a hull over points in plan, shape (n, 2) [m], shape (n,); -inf beside it, and where it is higher than
    `most` [m]."""
    if float(hull.vertices[:, 2].min()) > most:
        return np.full(len(plan), -np.inf)
    normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
    left = offsets - plan @ normals[:, :2].T
    up, down = normals[:, 2] > 1e-9, normals[:, 2] < -1e-9
    high = (left[:, up] / normals[up, 2]).min(axis=1)
    low = (left[:, down] / normals[down, 2]).max(axis=1)
    is_over = (left[:, ~up & ~down] >= 0.0).all(axis=1) & (high >= low) & (high <= most)
    return np.where(is_over, high, -np.inf)


def _base(standing: _Standing, placed: Sequence[Sequence[Hull]], i: int, parent: int | None, level: float) -> list[Hull]:
    """Pieces that reach from an object, by number, down to a height [m], world frame, none of them in anything; none where there is no
    room."""
    up = standing.up
    if up is not None:
        foot = standing.lower - ((standing.lower[:, 2] - level) / up[2])[:, None] * up
        hull = solid_hull(np.concatenate([standing.lower, foot]))
    else:
        top = standing.low + min(FOOT_M, standing.height)
        hull = solid_hull(np.concatenate([np.column_stack([standing.ring, np.full(len(standing.ring), z)]) for z in (level, top)]))
    if hull is None:
        return []
    first, last = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    around = [
        other
        for k, pieces in enumerate(placed)
        for other in pieces
        if k != i and (other.vertices.min(axis=0) <= last).all() and (other.vertices.max(axis=0) >= first).all()
        if not (k == parent and float(other.vertices[:, 2].max()) <= level + HIGH_M)  # it carries the base
    ]
    parts = apart_from(hull, around, CLEAR_M)
    if not parts:
        return []
    if up is not None:
        # Its center of mass is beside its foot, between that and the wall.
        return parts if _foot_volume(parts, level) >= FOOT_SHARE * _foot_volume([hull], level) else []
    feet = [part.vertices[part.vertices[:, 2] <= level + FOOT_M][:, :2] for part in parts]
    return parts if holds(np.concatenate(feet), standing.center[:2]) else []


def _foot_volume(parts: Sequence[Hull], level: float) -> float:
    """Volume of convex parts within `FOOT_M` of a height [m], in m^3."""
    feet = (beyond(part, DOWN, -(level + FOOT_M)) for part in parts)
    return sum(foot.volume for foot in feet if foot is not None)


def _rests_on(name: str, other: str, below: Mapping[str, str | None]) -> bool:
    """True if an object rests on another one, directly or through others. below: what carries each, by instance."""
    above: str | None = name
    while above is not None and above != other:
        above = below.get(above)
    return above == other


def _reaching(obj: PlacedAsset, level: float) -> PlacedAsset:
    """A placed asset whose lowest part is at a height [m]."""
    vertices = obj.surface.vertices.copy()
    lowest = vertices[:, 2] <= obj.low[2] + FOOT_M
    vertices[lowest, 2] = level
    surface = dataclasses.replace(obj.surface, vertices=vertices)
    return dataclasses.replace(obj, surface=surface, low=np.array([obj.low[0], obj.low[1], level]))
