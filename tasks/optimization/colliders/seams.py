"""Seams: colliders cut back from one another, so that objects stay where they were scanned.

Scanned objects are beside each other; their assets bulge, and labels bleed. Engines see colliders only, so these give way before any
object moves: space that two colliders share belongs to the object whose scanned points lie there, and the other one ends at the seam. What
sank into its carrier ends at that carrier's top.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.hulls import Hull
from tasks.geometry.pieces import dump_pieces, read_pieces
from tasks.geometry.transforms import inverse
from tasks.geometry.triangles import face_planes
from tasks.optimization.colliders.cutting import beyond, shared_by, without
from tasks.optimization.contacts import FLOOR, Colliders, Penetration
from tasks.optimization.footing import stands_alone
from tasks.optimization.interior import Interior
from tasks.optimization.solids import ConvexParts
from tasks.optimization.support.supports import PlacedAsset
from tasks.stage import Blobs

Array = NDArray[np.float64]

SUNK_M = 0.03
"""Objects that sank less deep into their carrier [m] are lifted out of it: the F-score at 5 cm does not change."""

SEAM_M = 0.02
"""Objects that are less deep in each other [m] are moved apart: so short a way costs no F-score, and colliders stay simple."""

SLIGHT_M = 0.0005
"""Pieces that are less deep in each other [m] than this stay whole; the search parts them."""

CLEAR_M = 0.001
"""Gap between a collider that was cut and the piece that keeps its place [m]; twice as much where both are cut."""

BLEED_M = 0.02
"""Scanned points this far outside of what two pieces share [m] still count: surfaces are as far off."""

LEAST_LEFT = 0.5
"""Of the volume of a collider: one that would lose more is another object's."""

MOST_ROUNDS = 3
"""Most rounds of cutting: an object whose collider was cut may come to rest at another height, and meet others."""

MOST_PIECES = 128
"""Pieces of a collider; engines slow down with each."""

MOST_POINTS = 4000
"""Scanned points of an object that are asked where they lie."""


@dataclasses.dataclass(frozen=True)
class Seams:
    """An interior whose colliders end at seams. shares: of the volume of colliders that were cut what is gone, by instance."""

    interior: Interior
    shares: Mapping[str, float]


def cut_at_seams(
    interior: Interior, points: Mapping[str, Array], walls: Sequence[ConvexParts], at_rest: Callable[[Interior], Array],
    deepest: float = SEAM_M,
) -> Seams:  # fmt: skip
    """The interior with colliders cut back at carriers, walls and neighbors that they are deeper in than `deepest` [m].

    points: scanned points of instances in the world frame [m], shape (n, 3) each. walls: the room's, as thick as they keep objects in,
    world frame. at_rest: poses of an interior's objects at rest on their carriers, shape (n, 4, 4) [m].
    """
    whole = [_volume(solid.hulls) for solid in interior.solids]
    interior = _ended_at_carriers(interior)
    for _ in range(MOST_ROUNDS):
        made = _cut_once(interior, points, walls, at_rest(interior), whole, deepest)
        if made is None:
            break
        interior = made
    shares = {
        name: max(0.0, 1.0 - _volume(solid.hulls) / max(before, 1e-12))
        for name, solid, before in zip(interior.names, interior.solids, whole, strict=True)
        if solid.properties is None
    }
    return Seams(interior, shares)


def _cut_once(
    interior: Interior, points: Mapping[str, Array], walls: Sequence[ConvexParts], poses: Array, whole: Sequence[float],
    deepest: float,
) -> Interior | None:  # fmt: skip
    """The interior with colliders cut that are deeper in each other than `deepest` [m] at some poses, shape (n, 4, 4) [m]; None where none
    is. whole: volumes of colliders before anything was cut [m3]."""
    bodies = [list(solid.placed(pose)) for solid, pose in zip(interior.solids, poses, strict=True)]
    moved = (poses - interior.poses)[:, :3, 3]
    scanned = [_thinned(points.get(name, np.zeros((0, 3)))) + way for name, way in zip(interior.names, moved, strict=True)]
    fixed_parts = [list(wall.hulls) for wall in walls]
    meeting = [p for p in Colliders(interior.solids, walls).penetrations(poses) if p.depth_m > deepest and _may_cut(interior, p)]
    cut: set[int] = set()
    for pair in sorted(meeting, key=lambda p: (-p.depth_m, p.index_a, p.index_b)):
        a, b = pair.index_a, pair.index_b
        is_wall = b >= len(bodies)
        larger = _is_larger(whole, a, b)
        one_side: tuple[Way, ...] = ("first", "second") if larger else ("second", "first")
        for way in ("first",) if is_wall else ("points", *one_side, "both"):
            neighbor, its_points = (fixed_parts[b - len(bodies)], np.zeros((0, 3))) if is_wall else (bodies[b], scanned[b])
            first, second = _parted(bodies[a], neighbor, scanned[a], its_points, way, larger)
            sides = [(a, _same(bodies[a], _within(first, interior.ring)))] if is_wall else [(a, first), (b, second)]
            if all(_is_good(interior, i, bodies[i], made, whole[i]) for i, made in sides):
                cut |= {i for i, made in sides if made is not bodies[i]}
                for i, made in sides:
                    bodies[i] = made
                break
    if not cut:
        return None
    solids = list(interior.solids)
    for i in cut:
        back = inverse(poses[i])
        solids[i] = ConvexParts(solids[i].name, tuple(hull.transformed(back) for hull in bodies[i]))
    return dataclasses.replace(interior, solids=tuple(solids))


def with_stored_colliders(interior: Interior, blobs: Blobs) -> Interior:
    """The interior with the colliders that were changed, and the brackets, as they are read back from the blobs that are kept of them."""
    solids, brackets = [], []
    for bracket in interior.brackets:
        name = blobs.add(dump_pieces(bracket.hulls), "glb")
        brackets.append(dataclasses.replace(bracket, hulls=read_pieces(blobs[name], name), blob=name))
    for solid in interior.solids:
        if solid.properties is None:
            name = blobs.add(dump_pieces(solid.hulls), "glb")
            solid = dataclasses.replace(solid, hulls=read_pieces(blobs[name], name), blob=name)
        solids.append(solid)
    walls = interior.shell[: len(interior.shell) - len(brackets)]
    return dataclasses.replace(interior, solids=tuple(solids), brackets=tuple(brackets), shell=(*walls, *brackets))


def _ended_at_carriers(interior: Interior) -> Interior:
    """The interior with what sank into its carrier by more than `SUNK_M` cut at that top, collider and surface, instead of lifted."""
    solids, objects, carriers = list(interior.solids), list(interior.objects), list(interior.carriers)
    own = [c.lift - (carriers[p].lift if p >= 0 else 0.0) for c, p in zip(carriers, interior.parent.tolist(), strict=True)]
    for i, carrier in enumerate(interior.carriers):
        parent = int(interior.parent[i])
        if carrier.relation in ("floor", "on", "inside") and carrier.gap < -SUNK_M and not interior.covering[i] and not interior.fixed[i]:
            obj, pose = objects[i], interior.poses[i]
            level = float(obj.low[2]) - carrier.gap
            kept = [part for hull in solids[i].hulls if (part := beyond(hull, pose[2, :3], level - float(pose[2, 3])))]
            made = ConvexParts(solids[i].name, tuple(kept))
            if kept and _volume(kept) >= LEAST_LEFT * _volume(solids[i].hulls) and _still_stands(solids[i], made, pose):
                solids[i], own[i] = made, 0.0
                objects[i] = _ended(obj, level)
                carriers[i] = dataclasses.replace(carrier, gap=0.0)
        carriers[i] = dataclasses.replace(carriers[i], lift=own[i] + (carriers[parent].lift if parent >= 0 else 0.0))
    return dataclasses.replace(interior, solids=tuple(solids), objects=tuple(objects), carriers=tuple(carriers))


def _ended(obj: PlacedAsset, level: float) -> PlacedAsset:
    """A placed asset whose surface ends at a height [m]."""
    vertices = obj.surface.vertices.copy()
    vertices[:, 2] = np.maximum(vertices[:, 2], level)
    surface = dataclasses.replace(obj.surface, vertices=vertices)
    return dataclasses.replace(obj, surface=surface, low=np.array([obj.low[0], obj.low[1], level]))


def _may_cut(interior: Interior, pair: Penetration) -> bool:
    """True if two objects, or an object and a wall, may part at a seam."""
    a, b, count = pair.index_a, pair.index_b, len(interior.objects)
    sides = [i for i in (a, b) if i < count]
    if any(interior.covering[i] for i in sides):
        return False  # rugs lie below other objects, and end at walls
    if b >= count:
        return pair.b != FLOOR and not interior.fixed[a]
    return not (interior.fixed[a] and interior.fixed[b])


def _is_larger(volumes: Sequence[float], a: int, b: int) -> bool:
    """True if a is the larger of two bodies; a wall is larger than any."""
    return b < len(volumes) and (volumes[a], a) > (volumes[b], b)


def _within(pieces: list[Hull], ring: Array | None) -> list[Hull]:
    """Pieces whose middle lies within the outline of the floor, shape (m, 2) [m]; the rest lies behind a wall."""
    import shapely

    if ring is None:
        return pieces
    middles = np.array([piece.vertices[:, :2].mean(axis=0) for piece in pieces]).reshape(-1, 2)
    inside = shapely.contains_xy(shapely.Polygon(ring), middles)
    return [piece for piece, is_inside in zip(pieces, inside, strict=True) if is_inside]


Way = Literal["points", "first", "second", "both"]
"""The body that is cut: by points, the one with fewer of them in the shared space; the first; the second; or both in the middle."""


def _parted(
    first: list[Hull], second: list[Hull], points: Array, other_points: Array, way: Way, first_is_larger: bool
) -> tuple[list[Hull], list[Hull]]:
    """Pieces of two bodies in the world frame, parted. By points, of each pair of pieces the one is cut in whose space fewer of its
    object's points lie than of the other's, of equal ones the larger object's.

    points, other_points: scanned points of the two, shape (n, 3) [m].
    """
    waiting, done, rest = list(first), list[Hull](), list(second)
    while waiting and len(done) + len(waiting) + len(rest) < 2 * MOST_PIECES + len(first) + len(second):
        piece, at, is_whole = waiting.pop(0), 0, True
        while at < len(rest) and is_whole:
            other = rest[at]
            if not _overlap(piece, other):
                at += 1
                continue
            loses = way == "first"
            if way == "points":
                mine, theirs = _count(points, piece, other), _count(other_points, piece, other)
                loses = mine < theirs or (mine == theirs and first_is_larger)
            if way == "both":
                mine_left, rest[at : at + 1] = _halved(piece, other)
                waiting[:0] = mine_left
                is_whole = False
            elif loses:
                waiting[:0] = without(piece, other, CLEAR_M)
                is_whole = False
            else:
                rest[at : at + 1] = without(other, piece, CLEAR_M)
        if is_whole:
            done.append(piece)
    return _same(first, [*done, *waiting]), _same(second, rest)


def _same(before: list[Hull], after: list[Hull]) -> list[Hull]:
    """The list of before where nothing changed."""
    return before if len(before) == len(after) and all(a is b for a, b in zip(before, after, strict=True)) else after


def _halved(piece: Hull, other: Hull) -> tuple[list[Hull], list[Hull]]:
    """Two pieces that end in the middle of what they share, along the way on which that is shortest."""
    best: tuple[float, Array, float, Hull, Hull] | None = None
    for near, far in ((piece, other), (other, piece)):
        normals, offsets = face_planes(near.vertices, near.faces, 1e-14)
        starts = (far.vertices @ normals.T).min(axis=0)
        at = int((offsets - starts).argmin())
        if best is None or offsets[at] - starts[at] < best[0]:
            best = float(offsets[at] - starts[at]), normals[at], 0.5 * float(offsets[at] + starts[at]), near, far
    assert best is not None
    _, normal, middle, near, far = best
    kept = [part for part in (beyond(near, -normal, CLEAR_M - middle),) if part is not None]
    left = [part for part in (beyond(far, normal, middle + CLEAR_M),) if part is not None]
    return (kept, left) if near is piece else (left, kept)


def _overlap(piece: Hull, other: Hull) -> bool:
    """True if two pieces are in each other by more than `SLIGHT_M`, along the axes and the normals of both."""
    low = np.maximum(piece.vertices.min(axis=0), other.vertices.min(axis=0))
    high = np.minimum(piece.vertices.max(axis=0), other.vertices.max(axis=0))
    if (high - low).min() <= SLIGHT_M:
        return False
    normals, offsets = shared_by(piece, other)
    lowest = np.maximum((piece.vertices @ normals.T).min(axis=0), (other.vertices @ normals.T).min(axis=0))
    return bool((offsets - lowest).min() > SLIGHT_M)


def _count(points: Array, piece: Hull, other: Hull) -> int:
    """Number of points, shape (n, 3) [m], in or near the space that two pieces share."""
    low = np.maximum(piece.vertices.min(axis=0), other.vertices.min(axis=0)) - BLEED_M
    high = np.minimum(piece.vertices.max(axis=0), other.vertices.max(axis=0)) + BLEED_M
    near = points[((points >= low) & (points <= high)).all(axis=1)]
    normals, offsets = shared_by(piece, other)
    return int(((near @ normals.T) <= offsets + BLEED_M).all(axis=1).sum())


def _is_good(interior: Interior, i: int, before: list[Hull], after: list[Hull], whole: float) -> bool:
    """True if an object may have the collider that was cut: enough of it is left, and it still stands by itself if it did before."""
    if after is before:
        return True
    if not after or len(after) > max(MOST_PIECES, len(before)) or _volume(after) < LEAST_LEFT * whole:
        return False
    if interior.fixed[i] or interior.carriers[i].relation not in ("floor", "on", "inside"):
        return True
    name = interior.names[i]
    return _still_stands(ConvexParts(name, tuple(before)), ConvexParts(name, tuple(after)), np.eye(4))


def _still_stands(before: ConvexParts, after: ConvexParts, pose: Array) -> bool:
    """True if a solid at a pose, 4x4 [m], stands on level ground, or did not before."""
    return stands_alone(after, pose) or not stands_alone(before, pose)


def _volume(hulls: Sequence[Hull]) -> float:
    """Sum of the volumes of pieces [m3]."""
    return float(sum(hull.volume for hull in hulls))


def _thinned(points: Array) -> Array:
    """Every so many points, `MOST_POINTS` at most, shape (n, 3)."""
    return points[:: max(1, -(-len(points) // MOST_POINTS))]
