"""Regions of a scan of things: parts of one body are joined, and what stands on another stays apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LEVEL = 0.5
"""Vertical part of the normal of a top where others stand on it: at their foot it is the mean of both surfaces, 45 degrees."""

ABOVE_M = 0.02
"""What stands on a top reaches this far above the contact [m]."""

MAX_STANDING_SHARE = 0.5
"""Most of a contact along which a region stands on the other one before the two are apart."""

MIN_CONTACT = 0.25
"""Least vertices of a contact, as a share of the root of the smaller region's: things that lean on each other touch in less."""


def joined_bodies(surface: Surface, normals: Array, region: Indices) -> Indices:
    """Regions, by number of each vertex with -1 for none, shape (n,), in which the parts of one body are one.

    Args:
        surface: a scan without walls, world frame [m].
        normals: of its vertices, unit, outward, shape (n, 3).
        region: number of each vertex's region, -1 for none, shape (n,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(region.max(initial=-1)) + 1
    if count < 2:
        return region
    a, b = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]]).T
    is_contact = (region[a] >= 0) & (region[b] >= 0) & (region[a] != region[b])
    a, b = a[is_contact], b[is_contact]
    z = surface.vertices[:, 2]
    sizes = np.bincount(region[region >= 0], minlength=count)
    middle = np.bincount(region[region >= 0], weights=z[region >= 0], minlength=count) / np.maximum(sizes, 1)
    # Both directions: the first vertex may be on the top, or the second one.
    stands = _stands_on(a, b, z, normals, middle[region[b]]) | _stands_on(b, a, z, normals, middle[region[a]])
    low, high = np.minimum(region[a], region[b]), np.maximum(region[a], region[b])
    keys, of_pair = np.unique(low * count + high, return_inverse=True)
    lengths, standing = np.bincount(of_pair), np.bincount(of_pair, weights=stands)
    first, second = keys // count, keys % count
    is_joint = (standing <= MAX_STANDING_SHARE * lengths) & (lengths >= MIN_CONTACT * np.sqrt(np.minimum(sizes[first], sizes[second])))
    graph = coo_array((np.ones(int(is_joint.sum()), dtype=np.int8), (first[is_joint], second[is_joint])), shape=(count, count))
    _, body = connected_components(graph, directed=False)
    return np.where(region >= 0, body[region], -1).astype(np.int64)


def _stands_on(top: Indices, other: Indices, z: Array, normals: Array, middle: Array) -> NDArray[np.bool_]:
    """True for contacts at which the region of `other`, whose middle is at heights of shape (k,) [m], stands on a level top."""
    return np.asarray((normals[top, 2] > LEVEL) & (middle > z[top] + ABOVE_M) & (z[other] >= z[top] - ABOVE_M))
