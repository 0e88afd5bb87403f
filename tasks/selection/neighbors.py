"""What else is where an asset would stand: points of other instances, the floor that was seen there, and space that was seen empty."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Frame, Instance
from tasks.alignment.distances import nearest_indices
from tasks.geometry.meshes import read_points
from tasks.geometry.transforms import transform_points
from tasks.geometry.triangles import distinct_rows
from tasks.mounting import mounting
from tasks.views.sightlines import FREE_DISTANCE_M, DepthMap, box_cells, is_seen_empty, scene_depth_maps

Array = NDArray[np.float64]

CELL_M = 0.04
"""Space is counted in cubes of this edge."""

DEEP_M = 0.03
"""Points deeper in an asset than this are in it; the rest touch it."""

ABOVE_FLOOR_M = 0.06
"""So far above a floor that was seen there is nothing."""

MOST_CUBES = 600
"""More cubes tell no more of a share."""

NEAR_SAMPLES, AGREEING_SHARE = 8, 0.85
"""Of so many samples near to an empty cube this share looks away from it if it is in a solid; on a board half of them do."""

FLOOR = "floor"
"""The NYU40 class of floors."""


@dataclasses.dataclass(frozen=True)
class Neighborhood:
    """What was seen in a scene: middles of cubes in the world frame [m], shape (n, 3), by instance; a floor's are what is free above it.
    coverings: those that lie flat to be stood upon, and are nobody's foreign space. views: depth maps of the frames."""

    seen: Mapping[str, Array]
    coverings: frozenset[str] = frozenset()
    views: Sequence[DepthMap] = ()

    @staticmethod
    def of(instances: Sequence[Instance], blobs: Mapping[str, bytes], frames: Sequence[Frame] = ()) -> Neighborhood:
        """The cubes of all instances but ceilings and walls, and what the frames saw of all.

        Raises:
            InputError: points of an instance are no point cloud of this lake.
        """
        seen, coverings = {}, set()
        for instance in sorted(instances, key=lambda row: row.instance_id):
            is_floor = instance.is_structure and instance.nyu40_label == FLOOR
            if (instance.is_structure and not is_floor) or instance.points_blob not in blobs:
                continue
            if mounting(instance.category).kind == "covering":
                coverings.add(instance.instance_id)
            points, _ = read_points(blobs[instance.points_blob], instance.points_blob)
            if is_floor:
                points = points + np.array([0.0, 0.0, ABOVE_FLOOR_M])
            seen[instance.instance_id] = cubes(points)
        return Neighborhood(seen, frozenset(coverings), scene_depth_maps(frames, instances, blobs))

    def within(self, own: str, low: Array, high: Array) -> Array:
        """Cubes of all but one instance in a box along the world's axes [m], shape (n, 3)."""
        parts = [points for name, points in self.seen.items() if name != own and name not in self.coverings]
        near = [points[((points >= low) & (points <= high)).all(axis=1)] for points in parts]
        return np.concatenate([np.zeros((0, 3)), *near])

    def empty_within(self, frame: Array, size: Array, points: Array) -> Array:
        """Cells of an instance's box that the frames saw empty, in the instance's frame [m], shape (n, 3).

        Args:
            frame: instance to world, 4x4 [m]; the box stands on its origin.
            size: extents of the box [m], shape (3,).
            points: scanned points of the instance in its frame [m], shape (k, 3).
        """
        if not self.views:
            return np.zeros((0, 3))
        high = np.array([0.5 * size[0], 0.5 * size[1], size[2]])
        cells = box_cells(high * [-1.0, -1.0, 0.0], high, CELL_M)
        cells = cells[is_seen_empty(transform_points(cells, frame), self.views)]
        if not len(cells) or not len(points):
            return cells
        return cells[nearest_indices(cells, points)[1] > FREE_DISTANCE_M]


def cubes(points: Array) -> Array:
    """Middles of the cubes that points are in [m], shape (n, 3) to (m, 3)."""
    cells = np.floor(points / CELL_M).astype(np.int64)
    return np.asarray((cells[distinct_rows(cells)[0]] + 0.5) * CELL_M)


def foreign_share(foreign: Array, own: int, placed: Array, normals: Array, empty: Array | None = None) -> float:
    """Share of foreign cubes among those of an instance and the foreign ones in its asset, 0 to 1.

    A sheet, or a mesh that is open below, has nothing in it that is farther from it than half of its narrowest side.

    Args:
        foreign: cubes in which others were seen [m], shape (n, 3).
        own: number of the instance's cubes.
        placed: samples of the asset's surface [m], shape (m, 3).
        normals: their outward normals, shape (m, 3).
        empty: cubes that were seen empty [m], shape (k, 3).
    """
    inside = _cubes_inside(foreign, placed, normals)
    if empty is not None and len(empty):
        inside += _cubes_inside(empty, placed, normals, NEAR_SAMPLES)
    return inside / (inside + own) if inside > 0.0 else 0.0


def _cubes_inside(cubes: Array, placed: Array, normals: Array, agreeing: int = 1) -> float:
    """Number of cubes, shape (n, 3) [m], in an asset, estimated from at most `MOST_CUBES` of them.

    agreeing: number of the nearest samples of which nearly all must look away from a cube; of one alone, its own side counts.
    """
    if not len(cubes) or not len(placed):
        return 0.0
    count = len(cubes)
    keys = np.floor(cubes / CELL_M).astype(np.int64) * [73_856_093, 19_349_663, 83_492_791]
    order = np.lexsort((*cubes.T, np.bitwise_xor.reduce(keys, axis=1) & 0xFFFF))  # scattered, and the same whatever order they come in
    cubes = cubes[order[:MOST_CUBES]]
    index, distance = nearest_indices(cubes, placed)
    depth = ((placed[index] - cubes) * normals[index]).sum(axis=1)
    reach = 0.5 * float(np.ptp(placed, axis=0).min()) + CELL_M
    is_inside = (depth > DEEP_M) & (distance <= reach)
    if agreeing > 1 and is_inside.any():
        from scipy.spatial import cKDTree

        near = cKDTree(placed).query(cubes, k=min(agreeing, len(placed)))[1].reshape(len(cubes), -1)
        away = ((placed[near] - cubes[:, None]) * normals[near]).sum(axis=2) > 0.0
        is_inside &= away.mean(axis=1) >= AGREEING_SHARE
    return count * float(is_inside.mean())
