"""Labels that bleed over seams, so that a strip of one object is annotated as its neighbor; and colors as fusion blurs them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.scanner.scenery import STRUCTURE, Scenery
from tasks.segments import edges_of

Array = NDArray[np.float64]

TOUCH_M = 0.06
"""Objects whose vertices come this near to each other have a seam: two voxels of fusion and the noise of a sensor."""


@dataclasses.dataclass(frozen=True)
class BleedingSettings:
    """How far and how often labels bleed. A reach is drawn for each seam."""

    reach_m: tuple[float, float] = (0.05, 0.15)  # distances from the neighbor's vertices up to which its label reaches
    seams: float = 0.85  # share of the seams over which a label bleeds
    kept: float = 0.45  # least share of its vertices that an object keeps at a seam: a cup does not vanish in its table


@dataclasses.dataclass(frozen=True)
class Bleed:
    """A label that reaches over a seam. source, into: objects by number, whose vertices bear whose label; vertices: how many."""

    source: int
    into: int
    reach_m: float
    vertices: int


def bleed(
    scenery: Scenery, owner: NDArray[np.int64], points: Array, settings: BleedingSettings, rng: np.random.Generator
) -> tuple[NDArray[np.int64], list[Bleed]]:
    """Labels of vertices after bleeding, as numbers of objects, shape (n,), and the bleeds.

    Args:
        scenery: the scene, for the categories of its objects.
        owner: object that each vertex truly belongs to, shape (n,); -1 for none.
        points: vertices, shape (n, 3) [m].
        settings: how far and how often labels bleed.
        rng: decides which, in which direction, and how far.
    """
    from scipy.spatial import cKDTree

    labels, bleeds = owner.copy(), []
    members = {index: np.flatnonzero(owner == index) for index in range(len(scenery.objects))}
    trees = {index: cKDTree(points[mine]) for index, mine in members.items() if len(mine)}
    bounds = {index: (points[members[index]].min(axis=0), points[members[index]].max(axis=0)) for index in trees}
    is_structure = [obj.category in STRUCTURE for obj in scenery.objects]
    for first in sorted(trees):
        for other in (index for index in sorted(trees) if index > first):
            if is_structure[first] and is_structure[other]:
                continue
            low, high = np.maximum(bounds[first][0], bounds[other][0]), np.minimum(bounds[first][1], bounds[other][1])
            if (low > high + TOUCH_M).any():
                continue
            small, large = sorted((first, other), key=lambda index: len(members[index]))
            distances = trees[large].query(points[members[small]], distance_upper_bound=TOUCH_M)[0]
            if not np.isfinite(distances).any():
                continue
            chances, reach = rng.random(2), float(rng.uniform(*settings.reach_m))
            if chances[0] >= settings.seams:
                continue
            # A strip that would take most of an object goes the other way, or nowhere.
            for source, into in ((first, other), (other, first))[:: 1 if chances[1] < 0.5 else -1]:
                near = np.isfinite(trees[into].query(points[members[source]], distance_upper_bound=reach)[0])
                is_own = labels[members[source]] == source
                strip = members[source][near & is_own]
                if len(strip) and is_own.sum() - len(strip) >= settings.kept * len(members[source]):
                    labels[strip] = into
                    bleeds.append(Bleed(source, into, reach, len(strip)))
                    break
    return labels, bleeds


def cut_segments(segments: NDArray[np.int64], owner: NDArray[np.int64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Segments, shape (n,), cut along the borders of strips that bear another label than their owner's; the lowest vertex names each."""
    strip = np.where(labels == owner, -1, labels)
    _, part = np.unique(np.column_stack([segments, strip]), axis=0, return_inverse=True)
    part = part.ravel()
    lowest = np.full(int(part.max()) + 1, len(segments), dtype=np.int64)
    np.minimum.at(lowest, part, np.arange(len(segments)))
    return lowest[part]


def blurred(surface: Surface, rounds: int) -> Surface:
    """The surface with colors averaged over neighbors along edges, again and again, as fusion of many frames blurs them."""
    from scipy.sparse import coo_matrix

    count = len(surface.vertices)
    i, j = edges_of(surface.faces, count).T
    ends = np.arange(count)
    rows, columns = np.concatenate([i, j, ends]), np.concatenate([j, i, ends])
    near = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    weights = np.asarray(near.sum(axis=1)).reshape(-1, 1)
    colors = surface.colors.astype(np.float64)
    for _ in range(rounds):
        colors = (near @ colors) / weights
    return Surface(surface.vertices, surface.faces, np.rint(colors).astype(np.uint8))
