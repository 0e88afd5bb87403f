"""SurfacePatches that meet in a smooth or a convex joint are of one object.

After Stein et al., "Object Partitioning using Local Convexity", CVPR 2014, without its rule that two patches must have a common convex
neighbor: on the grid of an image that takes everything apart.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.patches import SurfacePatches
from tasks.kernels import Kernels, compile_kernels
from tasks.settings import Config, Count, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class ConvexityConfig(Config):
    """When two patches are of one object."""

    reach_px: Count = 3  # between pixels of patches that touch: edges lose their depth
    least_pairs: Count = 3  # of pixels, fewer are chance
    least_share: Share = 0.5  # of these without a step in depth
    smooth_degrees: Positive = 20.0  # between normals that noise alone may turn so far: any joint; 10 takes surfaces apart
    singular_degrees: Positive = 60.0  # least angle between a sharp crease's direction and the line between two patches' middles ...
    crease_degrees: Positive = 25.0  # ... half of it where the crease is so sharp ...
    crease_slope: Positive = 4.0  # ... and how fast it comes: two that meet in a corner alone have no joint


@dataclasses.dataclass(frozen=True)
class PatchContacts:
    """Pairs of patches that touch: first < second, pixel pairs, and those of them without a step in depth; each of shape (n,)."""

    first: Indices
    second: Indices
    pairs: Indices
    passing: Indices


def contacts_of(label: Indices, depth: Array, step: Array, reach: int) -> PatchContacts:
    """Where labels of an image, shape (h, w), touch across up to `reach` pixels."""
    count = int(label.max(initial=-1)) + 1
    keys, is_passing = _compiled()["_pairs"](label, depth, step, reach, count)
    named, inverse = np.unique(keys, return_inverse=True)
    pairs, passing = np.bincount(inverse, minlength=len(named)), np.bincount(inverse[is_passing], minlength=len(named))
    return PatchContacts(named // max(count, 1), named % max(count, 1), pairs, passing)


def joined_patches(patches: SurfacePatches, contacts: PatchContacts, config: ConvexityConfig) -> Indices:
    """Region of each patch, shape (n,), numbered from 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    touch = (contacts.passing >= config.least_pairs) & (contacts.passing >= config.least_share * contacts.pairs)
    a, b = contacts.first[touch], contacts.second[touch]
    is_one = is_joint(patches.points[a], patches.normals[a], patches.points[b], patches.normals[b], config)
    a, b = a[is_one], b[is_one]
    count = len(patches.sizes)
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def is_joint(points: Array, normals: Array, far_points: Array, directions: Array, config: ConvexityConfig) -> Bools:
    """Whether patches, middles and normals of shapes (n, 3), and their neighbors are of one object, shape (n,)."""
    between = points - far_points
    between /= np.maximum(np.linalg.norm(between, axis=1), 1e-12)[:, None]
    angle = np.degrees(np.arccos(np.clip((normals * directions).sum(axis=1), -1.0, 1.0)))
    is_convex = ((normals - directions) * between).sum(axis=1) >= 0.0
    crease = np.cross(normals, directions)
    crease /= np.maximum(np.linalg.norm(crease, axis=1), 1e-12)[:, None]
    across = np.degrees(np.arccos(np.clip(np.abs((between * crease).sum(axis=1)), 0.0, 1.0)))
    least = config.singular_degrees / (1.0 + np.exp(-(angle - config.crease_degrees) / config.crease_slope))
    return np.asarray((angle < config.smooth_degrees) | (is_convex & (across > least)))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_pairs)


def _pairs(label: Any, depth: Any, step: Any, reach: int, count: int) -> Any:
    """A key for every pair of pixels of two labels, to the right and below, and whether there is no step in depth between them."""
    height, width = label.shape
    size = 0
    for turn in range(2):
        if turn == 1:
            keys, passing = np.empty(size, np.int64), np.empty(size, np.bool_)
            size = 0
        for v in range(height):
            for u in range(width):
                own = label[v, u]
                if own < 0:
                    continue
                for s in range(2 * reach):
                    far = s // 2 + 1
                    i, j = (v + far, u) if s % 2 else (v, u + far)
                    if i >= height or j >= width:
                        continue
                    other = label[i, j]
                    if other < 0 or other == own:
                        continue
                    if turn == 1:
                        keys[size] = min(own, other) * count + max(own, other)
                        passing[size] = abs(depth[i, j] - depth[v, u]) <= max(step[i, j], step[v, u])
                    size += 1
    return keys, passing
