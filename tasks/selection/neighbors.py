"""What else is where an asset would stand: points of other instances, and the floor that was seen there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance
from tasks.alignment.distances import nearest_indices
from tasks.geometry.meshes import read_points
from tasks.geometry.triangles import distinct_rows
from tasks.mounting import mounting

Array = NDArray[np.float64]

CELL_M = 0.04
"""Space is counted in cubes of this edge."""

DEEP_M = 0.03
"""Points deeper in an asset than this are in it; the rest touch it."""

ABOVE_FLOOR_M = 0.06
"""So far above a floor that was seen there is nothing."""

MOST_CUBES = 600
"""More cubes tell no more of a share."""

FLOOR = "floor"
"""The NYU40 class of floors."""


@dataclasses.dataclass(frozen=True)
class Neighborhood:
    """What was seen in a scene: middles of cubes in the world frame [m], shape (n, 3), by instance; a floor's are what is free above it.
    coverings: those that lie flat to be stood upon, and are nobody's foreign space."""

    seen: Mapping[str, Array]
    coverings: frozenset[str] = frozenset()

    @staticmethod
    def of(instances: Sequence[Instance], blobs: Mapping[str, bytes]) -> Neighborhood:
        """The cubes of all instances but ceilings and walls.

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
        return Neighborhood(seen, frozenset(coverings))

    def within(self, own: str, low: Array, high: Array) -> Array:
        """Cubes of all but one instance in a box along the world's axes [m], shape (n, 3)."""
        parts = [points for name, points in self.seen.items() if name != own and name not in self.coverings]
        near = [points[((points >= low) & (points <= high)).all(axis=1)] for points in parts]
        return np.concatenate([np.zeros((0, 3)), *near])


def cubes(points: Array) -> Array:
    """Middles of the cubes that points are in [m], shape (n, 3) to (m, 3)."""
    cells = np.floor(points / CELL_M).astype(np.int64)
    return np.asarray((cells[distinct_rows(cells)[0]] + 0.5) * CELL_M)


def foreign_share(foreign: Array, own: int, placed: Array, normals: Array) -> float:
    """Of an instance's own cubes, as many as `own`, and the foreign ones in its asset, shape (n, 3) [m], how many are foreign. placed,
    normals: samples of the asset's surface [m] and their outward normals, shape (m, 3).

    A sheet, or a mesh that is open below, has nothing in it that is farther from it than half of its narrowest side.
    """
    if not len(foreign) or not len(placed):
        return 0.0
    count = len(foreign)
    keys = np.floor(foreign / CELL_M).astype(np.int64) * [73_856_093, 19_349_663, 83_492_791]
    order = np.lexsort((*foreign.T, np.bitwise_xor.reduce(keys, axis=1) & 0xFFFF))  # scattered, and the same whatever order they come in
    foreign = foreign[order[:MOST_CUBES]]
    index, distance = nearest_indices(foreign, placed)
    depth = ((placed[index] - foreign) * normals[index]).sum(axis=1)
    reach = 0.5 * float(np.ptp(placed, axis=0).min()) + CELL_M
    inside = count * float(((depth > DEEP_M) & (distance <= reach)).mean())
    return inside / (inside + own) if inside > 0.0 else 0.0
