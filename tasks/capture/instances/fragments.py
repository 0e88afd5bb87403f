"""Fragments among regions: scraps of walls go to the walls, and pieces of one paint that nearly touch are one region.

Holes of a scan part the surface of one thing into pieces that share no edge of the mesh, so that merging along edges cannot join them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.regions import COLOR_STEP, RegionConfig, most_area
from tasks.capture.instances.structure import RoomPlane
from tasks.geometry.meshes import Surface
from tasks.settings import Config, NonNegative

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PLANE_M, PLANE_REACH_M = 0.08, 0.4
"""A scrap of a wall lies this near to the wall's plane and to surface of that wall [m]: the sides of openings, skirting, frames."""

MIN_PLANE_SHARE = 0.8
"""Least share of a scrap's surface that lies there."""

MIN_FACING = 0.9
"""Least cosine between the plane's normal and a wall's own surface from which the plane is measured."""

THIN_M = 0.02
"""One point in each cube of this size stands for a region: meshes may be finer."""


@dataclasses.dataclass(frozen=True)
class FragmentConfig(Config):
    """Limits below which regions are fragments."""

    wall_m2: NonNegative = 0.05  # largest scrap of a wall or of the floor: 22 by 22 cm; switches are scraps, pictures are larger
    reach_m: NonNegative = 0.05  # gap across which pieces of one thing belong together; 0.03 or 0.06 changes little
    color: NonNegative = 0.5  # largest difference of their colors, in steps of `COLOR_STEP`; 0 joins nothing
    small_m2: NonNegative = 0.015  # a smaller region is a part of what it nearly touches most


def without_wall_scraps(
    surface: Surface, normals: Array, areas: Array, planes: Sequence[RoomPlane], region: Indices, config: FragmentConfig
) -> tuple[list[RoomPlane], Indices]:
    """Planes of a room with the scraps that lie in them, and the region of each vertex without these, shape (n,).

    Args:
        surface: an aligned scan [m].
        normals: of its vertices, unit, shape (n, 3).
        areas: of its vertices [m2], shape (n,).
        planes: floor, walls and ceiling.
        region: number of each vertex's region from 0, -1 for none, shape (n,).
        config: see there.
    """
    from scipy.spatial import cKDTree

    region, points = region.copy(), surface.vertices
    count = int(region.max(initial=-1)) + 1
    if not count:
        return list(planes), region
    is_in = region >= 0
    sizes = np.bincount(region[is_in], weights=areas[is_in], minlength=count)
    candidates = np.flatnonzero(is_in & (sizes[np.maximum(region, 0)] <= config.wall_m2))
    grown = []
    for plane in planes:
        normal = areas[plane.members] @ normals[plane.members]
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        own = plane.members[np.abs(normals[plane.members] @ normal) > MIN_FACING]
        if not len(own) or not len(candidates):
            grown.append(plane)
            continue
        offset = float(np.median(points[own] @ normal))
        near = candidates[np.abs(points[candidates] @ normal - offset) < PLANE_M]
        near = near[np.isfinite(cKDTree(points[own]).query(points[near], distance_upper_bound=PLANE_REACH_M)[0])]
        shares = np.bincount(region[near], weights=areas[near], minlength=count) / np.maximum(sizes, 1e-12)
        scraps = candidates[shares[region[candidates]] >= MIN_PLANE_SHARE]
        grown.append(RoomPlane(plane.category, np.union1d(plane.members, scraps)))
        region[scraps] = -1
        candidates = candidates[region[candidates] >= 0]
    return grown, _numbered(region)


def joined_fragments(surface: Surface, areas: Array, region: Indices, config: FragmentConfig, regions: RegionConfig) -> Indices:
    """Region of each vertex, numbered from 0, -1 for none, shape (n,), in which the pieces of one thing are one.

    Args:
        surface: an aligned scan [m].
        areas: of its vertices [m2], shape (n,).
        region: number of each vertex's region from 0, -1 for none, shape (n,).
        config: see there.
        regions: its limit on a region's surface holds here, too.
    """
    count = int(region.max(initial=-1)) + 1
    if count < 2:
        return region
    pieces = _Pieces.of(surface, areas, region, count, most_area(areas, regions))
    pairs, contacts = _contacts(surface.vertices, region, config.reach_m)
    pieces.join_alike(pairs, config.color)
    pieces.join_small(pairs, contacts, config.small_m2)
    return _numbered(np.where(region >= 0, pieces.roots()[np.maximum(region, 0)], -1))


@dataclasses.dataclass
class _Pieces:
    """Regions that are joined. areas [m2], shape (k,); paints: area times color, shape (k, 3); parents, shape (k,); members of each root;
    most: largest surface of a region [m2]."""

    areas: Array
    paints: Array
    parents: Indices
    members: list[list[int]]
    most: float

    @classmethod
    def of(cls, surface: Surface, areas: Array, region: Indices, count: int, most: float) -> _Pieces:
        """Regions as they are."""
        is_in = region >= 0
        own, weights, colors = region[is_in], areas[is_in], surface.colors[is_in].astype(np.float64)
        sizes = np.zeros((count, 4))  # area, and area times each color
        for column, values in enumerate((weights, *(weights * colors[:, k] for k in range(3)))):
            sizes[:, column] = np.bincount(own, weights=values, minlength=count)
        return cls(sizes[:, 0].copy(), sizes[:, 1:].copy(), np.arange(count), [[k] for k in range(count)], most)

    def root(self, number: int) -> int:
        """The region that a region is part of by now."""
        while self.parents[number] != number:
            number = int(self.parents[number])
        return number

    def roots(self) -> Indices:
        """The same of all, shape (k,)."""
        return np.array([self.root(number) for number in range(len(self.parents))], dtype=np.int64)

    def join_alike(self, pairs: Indices, limit: float) -> None:
        """Join pairs, shape (m, 2), whose colors differ by less than a limit, the most alike first, until none are left."""
        while True:
            steps = [(self._step(a, b), a, b) for a, b in {tuple(sorted(map(self.root, pair))) for pair in pairs.tolist()} if a != b]
            alike = sorted(entry for entry in steps if entry[0] < limit)
            joined = [self._join(a, b) for _, a, b in alike if self.root(a) == a and self.root(b) == b and self._step(a, b) < limit]
            if not any(joined):
                return

    def join_small(self, pairs: Indices, contacts: Indices, limit_m2: float) -> None:
        """Join regions below a limit [m2] to those that they nearly touch most, the smallest first. contacts: of pairs, shape (m,)."""
        around: list[list[tuple[int, int]]] = [[] for _ in self.members]
        for (a, b), contact in zip(pairs.tolist(), contacts.tolist(), strict=True):
            around[a].append((b, contact))
            around[b].append((a, contact))
        for small in np.argsort(self.areas, kind="stable").tolist():
            if self.root(small) != small or self.areas[small] >= limit_m2:
                continue
            touched: dict[int, int] = {}
            for neighbor, contact in (entry for member in self.members[small] for entry in around[member]):
                root = self.root(neighbor)
                if root != small:
                    touched[root] = touched.get(root, 0) + contact
            for neighbor in sorted(touched, key=lambda key: (-touched[key], key)):
                if self._join(neighbor, small):
                    break

    def _step(self, a: int, b: int) -> float:
        difference = self.paints[a] / max(self.areas[a], 1e-9) - self.paints[b] / max(self.areas[b], 1e-9)
        return float(np.linalg.norm(difference)) / COLOR_STEP

    def _join(self, a: int, b: int) -> bool:
        """Join two regions if both are not too large; True if so."""
        if self.areas[a] + self.areas[b] > self.most:
            return False
        kept, gone = (a, b) if self.areas[a] >= self.areas[b] else (b, a)
        self.parents[gone] = kept
        self.members[kept] += self.members[gone]
        self.areas[kept] += self.areas[gone]
        self.paints[kept] += self.paints[gone]
        return True


def _contacts(points: Array, region: Indices, reach: float) -> tuple[Indices, Indices]:
    """Pairs of regions with points within reach [m], shape (m, 2), and how many such points each pair has, shape (m,)."""
    from scipy.spatial import cKDTree

    members = np.flatnonzero(region >= 0)
    cells = np.column_stack([np.floor(points[members] / THIN_M).astype(np.int64), region[members]])
    members = members[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
    near = members[cKDTree(points[members]).query_pairs(reach, output_type="ndarray")]
    own = np.sort(region[near], axis=1)
    pairs, contacts = np.unique(own[own[:, 0] != own[:, 1]], axis=0, return_counts=True)
    return pairs, contacts


def _numbered(region: Indices) -> Indices:
    """Regions numbered from 0 without gaps, -1 for none, shape (n,)."""
    names = np.unique(region[region >= 0])
    return np.where(region >= 0, np.searchsorted(names, region), -1).astype(np.int64)
