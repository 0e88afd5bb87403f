"""Interiors for tests: objects out of a few convex parts, and the bodies that the default method moves."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
import trimesh

from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from tasks.geometry.meshes import dump_glb
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull
from tasks.optimization.interior import Interior, furnish
from tasks.optimization.proposals import Proposal
from tasks.optimization.search.arrangement import FIXED, STANDING, Arrangement
from tasks.optimization.search.trace import Move, moved_poses
from tasks.optimization.shapes import Shapes, Stand, compiled, shapes_of, stand_of
from tasks.optimization.solids import ConvexParts
from tasks.optimization.support.supports import SupportConfig
from tests.samples import sample

Array = np.ndarray
Object = tuple[str, Sequence[trimesh.Trimesh], Array]
"""Category, convex parts in their own frame [m], pose 4x4 [m]."""

_caches: dict[str, dict[str, bytes]] = defaultdict(dict)


def block(size: Sequence[float], at: Sequence[float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """A box of a size with its bottom center at a point [m]."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([at[0], at[1], at[2] + size[2] / 2])
    return mesh


def hull(mesh: trimesh.Trimesh) -> Hull:
    """A convex mesh as a piece."""
    return convex_hull(np.asarray(mesh.vertices), PieceConfig())


def interior_of(objects: Sequence[Object], polygon: Sequence[Sequence[float]] | None = None) -> Interior:
    """Objects in a room, or without any, as the stage takes them; named 0000, 0001, ..."""
    blobs: dict[str, bytes] = {}
    assets: dict[str, Asset] = {}
    proposals = []
    for i, (category, parts, pose) in enumerate(objects):
        data = dump_glb(parts)
        key = hashlib.sha256(data).hexdigest()
        blobs[key] = data
        assets[key] = sample(Asset, asset_id=key, mesh_blob=key, pieces_blob=key, is_watertight=True, category=category, name=category)
        instance = sample(Instance, instance_id=f"{i:04d}", category=category, is_structure=False)
        proposals.append(Proposal(instance, key, np.asarray(pose), np.ones(3), "selection"))
    room = None
    if polygon is not None:
        ring = tuple((float(x), float(y)) for x, y in polygon)
        room = sample(Shell, floor_polygon=ring, walls=(), interior_walls=(), height_m=2.6)
    interior, said = furnish(proposals, assets, blobs, room, SupportConfig(), PieceConfig(), _caches)
    assert not [line for line in said if "no room is known" not in line]
    return interior


def bodies_of(interior: Interior) -> tuple[Shapes, Stand]:
    """The objects of an interior where they were proposed."""
    shapes = shapes_of(interior.solids, interior.poses)
    return shapes, stand_of(shapes, interior.poses[:, :3, 3])


def poses_after(interior: Interior, moves: Sequence[tuple[int, Move]]) -> Array:
    """Poses after moves of objects, with what they carry, shape (n, 4, 4) [m]."""
    parents: Mapping[str, str | None] = {name: c.parent_id for name, c in zip(interior.names, interior.carriers, strict=True)}
    found = moved_poses(dict(zip(interior.names, interior.poses, strict=True)), parents, [(interior.names[i], move) for i, move in moves])
    return np.array([found[name] for name in interior.names])


def turned(shapes: Shapes, place: Array, yaws: Sequence[float]) -> Stand:
    """Bodies at places, shape (n, 3) [m], turned about their pivots [rad]."""
    stand = stand_of(shapes, place)
    for body, yaw in enumerate(yaws):
        stand.turn[body] = np.cos(yaw), np.sin(yaw)
        compiled()["bound"](shapes, stand, body)
    return stand


def world_vertices(shapes: Shapes, stand: Stand, body: int) -> Array:
    """Vertices of a body in the world frame [m], shape (n, 3)."""
    first, last = shapes.first_piece[body], shapes.first_piece[body + 1]
    local = shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]]
    c, s = stand.turn[body]
    return local @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + stand.place[body]


def arrangement(
    hulls: Sequence[Hull], poses: Array, kinds: Sequence[int], along: Sequence[Sequence[float]] | None = None,
    parents: Sequence[int] | None = None, lever: float = 0.1,
) -> Arrangement:  # fmt: skip
    """Bodies of one piece each; those that are fixed are not counted against each other. `parents`: only of bodies before."""
    n = len(hulls)
    shapes = shapes_of([ConvexParts(f"{i:04d}", (piece,)) for i, piece in enumerate(hulls)], poses)
    parent = np.full(n, -1, dtype=np.int64) if parents is None else np.array(parents, dtype=np.int64)
    groups: list[list[int]] = [[i] for i in range(n)]
    for i in reversed(range(n)):
        if parent[i] >= 0:
            groups[parent[i]] += groups[i]
    kind = np.array(kinds, dtype=np.int64)
    counted = ~np.eye(n, dtype=np.bool_) & ~((kind[:, None] == FIXED) & (kind[None] == FIXED))
    for i in range(n):  # what stands on another object only touches it
        if parent[i] >= 0:
            counted[i, parent[i]] = counted[parent[i], i] = False
    return Arrangement(
        shapes=shapes, pivots=np.asarray(poses)[:, :3, 3].copy(), counted=counted, parent=parent,
        first_carried=np.concatenate([[0], np.cumsum([len(g) for g in groups])]).astype(np.int64),
        carried=np.concatenate([sorted(g) for g in groups]).astype(np.int64), kind=kind,
        along=np.zeros((n, 2)) if along is None else np.array(along, dtype=np.float64), map_of=np.full(n, -1, dtype=np.int64),
        maps=np.zeros((0, 3, 3), dtype=np.bool_), cell=0.02, lever=np.full(n, lever),
    )  # fmt: skip


__all__ = ["FIXED", "STANDING", "arrangement", "block", "bodies_of", "hull", "interior_of", "poses_after", "turned", "world_vertices"]
