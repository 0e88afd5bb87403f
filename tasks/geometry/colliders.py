"""How well an asset's collider stands for what is seen of it: parallel rays from six sides, cast at both.

A ray stops early where the collider fills an opening: a robot that reaches into it is held by nothing that a camera shows.
A ray misses where the collider lies behind the surface: an object that is pushed against it sinks in.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import RayScene

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

GRID_M = 0.015
"""Distance between neighboring rays: the width of a finger."""

MOST_RAYS = 300
"""Rays along one side of the box at most, evenly spread: above 4.5 m they lie farther apart than `GRID_M`."""

EARLY_M = 0.02
"""A ray that stops this far before what is seen stops in an opening; hulls around rounded edges lie nearer."""

MISS_M = 0.01
"""A ray that goes this far beyond what is seen went past the collider."""

_MARGIN_M = 0.5
"""Rays start so far outside of the box: colliders of what is flat reach out of it by millimetres."""


class TriangleMesh(Protocol):
    """A triangle mesh."""

    @property
    def vertices(self) -> Array:
        """Corners [m], shape (n, 3)."""

    @property
    def faces(self) -> NDArray[np.int64]:
        """Triangles as indices of corners, shape (m, 3)."""


class ColliderShares(NamedTuple):
    """early, miss: shares of rays (see `Sightlines.shares`), 0 to 1."""

    early: float
    miss: float


@dataclasses.dataclass(frozen=True)
class Sightlines:
    """Rays from six sides over the box of an asset, and where they meet what is seen of it, in the asset's frame [m].

    rays: origin and unit direction along an axis, shape (n, 6). seen: distance to the visual, inf where it is not met, shape (n,).
    counts: cells of the grid along each axis, shape (3,). vertices, faces: The visual. scale: of the lengths that are asked for: small
    objects are cut by a finer measure than all are told by.
    """

    scale: float
    counts: NDArray[np.int64]
    rays: NDArray[np.float32]
    seen: NDArray[np.float32]
    vertices: Array
    faces: NDArray[np.int64]

    @property
    def early_m(self) -> float:
        """`EARLY_M` at this scale [m]."""
        return self.scale * EARLY_M

    def stops(self, hulls: Sequence[TriangleMesh]) -> NDArray[np.float32]:
        """Distance at which each ray meets the union of hulls [m], inf where it does not, shape (n,)."""
        return _cast(*_joined(hulls), self.rays)

    def early(self, stops: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Rays that stop more than `EARLY_M` before the visual, shape (n,).

        A ray that misses the visual is early where it stops at all and no part of the visual is within `EARLY_M` of that place:
        a collider that bulges past a silhouette by less fills no opening.
        """
        early = stops < self.seen - self.early_m
        beside = np.flatnonzero(early & np.isinf(self.seen))
        if len(beside):
            places = self.rays[beside, :3] + stops[beside, None] * self.rays[beside, 3:]
            early[beside] = closest_points(self.vertices, self.faces, places).distance > self.early_m
        return np.asarray(early)

    def shares(self, hulls: Sequence[TriangleMesh]) -> ColliderShares:
        """Shares of the rays that meet the visual or stop early beside it, which stop early (`early`) or miss.

        A ray misses when it meets the visual and not the collider, or the collider more than `MISS_M` behind the visual.
        Both are 0 where no ray meets the visual.
        """
        stops = self.stops(hulls)
        early, seen = self.early(stops), np.isfinite(self.seen)
        count = int((early | seen).sum())
        missed = seen & (stops > np.where(seen, self.seen, 0) + self.scale * MISS_M)
        return ColliderShares(float(early.sum() / count), float(missed.sum() / count)) if count else ColliderShares(0.0, 0.0)


def sightlines(parts: Sequence[trimesh.Trimesh], scale: float = 1.0) -> Sightlines:
    """Rays on a grid of `GRID_M` times `scale` over the box of `parts`, along both directions of every axis."""
    vertices, faces = _joined(parts)
    counts, rays = _box_rays(vertices.min(axis=0), vertices.max(axis=0), scale * GRID_M)
    return Sightlines(scale, counts, rays, _cast(vertices, faces, rays), vertices, faces)


def collider_shares(parts: Sequence[trimesh.Trimesh], hulls: Sequence[TriangleMesh]) -> ColliderShares:
    """How well hulls stand for the parts that are seen, both in one frame [m]."""
    return sightlines(parts).shares(hulls)


def _box_rays(low: Array, high: Array, grid: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Cells of a grid over a box, shape (3,), and rays into it from its six sides through the middles of all cells, shape (n, 6)."""
    groups = []
    counts = np.clip(np.ceil((high - low) / grid - 1e-9), 1, MOST_RAYS).astype(np.int64)
    middles = [low[i] + (high[i] - low[i]) * (np.arange(counts[i]) + 0.5) / counts[i] for i in range(3)]
    for axis in range(3):
        across = [middles[i] for i in range(3) if i != axis]
        places = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, 2)
        for sign, start in ((1.0, low[axis] - _MARGIN_M), (-1.0, high[axis] + _MARGIN_M)):
            rays = np.zeros((len(places), 6), dtype=np.float32)
            rays[:, [i for i in range(3) if i != axis]] = places
            rays[:, axis], rays[:, 3 + axis] = start, sign
            groups.append(rays)
    return counts, np.concatenate(groups)


def _joined(bodies: Sequence[TriangleMesh] | Sequence[trimesh.Trimesh]) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and faces of bodies as one mesh."""
    offsets = np.cumsum([0, *(len(body.vertices) for body in bodies[:-1])])
    vertices = np.concatenate([np.asarray(body.vertices, dtype=np.float64).reshape(-1, 3) for body in bodies])
    faces = [np.asarray(body.faces, dtype=np.int64).reshape(-1, 3) + at for body, at in zip(bodies, offsets, strict=True)]
    return vertices, np.concatenate(faces)


def _cast(vertices: Array, faces: NDArray[np.int64], rays: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance to the first hit of rays on a mesh, inf where there is none, shape (n,)."""
    import trimesh

    return np.asarray(RayScene([trimesh.Trimesh(vertices, faces, process=False)]).cast(rays)["t_hit"])
