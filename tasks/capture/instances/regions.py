"""Regions of a mesh: an over-segmentation by its normals, and the merging of regions, cheapest pair first.

What is worth how much, against constants and on which material, was measured before (a labelled room with its labels withheld): normals
must not be smoothed before the over-segmentation, and the term of size decides how many regions are left.
"""

from __future__ import annotations

import dataclasses
import heapq

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.segments import edges_of, graph_segments
from tasks.settings import Config, NonNegative, Positive, Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

COLOR_STEP = 50.0
"""Distance of two mean colors, in 0..255, that weighs as much as a right concave crease: shades of one paint differ by less."""

FLAT_RADIANS, SHARP_RADIANS = 0.17, 0.97
"""Below the first angle a crease is noise, from the second on it is a whole one."""

PATCH_M2 = 4e-4
"""Surface that a vertex stands for where there is one every 2 cm: thresholds of the over-segmentation are told for it."""


@dataclasses.dataclass(frozen=True)
class RegionConfig(Config):
    """How a mesh without labels is cut into regions, and how these are merged."""

    threshold: Positive = 0.01  # as in the names of ScanNet's segment files; halved or doubled it changes little
    least_m2: Positive = 0.008  # of a region: 20 vertices of a mesh of 2 cm, half the visible surface of a mug
    color: NonNegative = 0.1  # of an edge's weight: a book on a table has no other; more takes patterns of cloth apart
    concave: NonNegative = 0.4  # cost of a border that is a concave crease all along
    unlike: NonNegative = 0.3  # of two colors that are `COLOR_STEP` apart
    loose: NonNegative = 0.2  # of a border that is a small part of both outlines
    small_m2: NonNegative = 0.02  # a region so small joins whatever it touches; a third of it leaves half as many regions again
    limit: Positive = 0.4  # pairs that cost more stay apart
    most_share: Share = 0.1  # of all surface: more is no object of a room
    most_m2: Positive = 4.0  # but an object may be as large as a sofa shows, in the scan of a corner


def region_segments(surface: Surface, normals: Array, areas: Array, config: RegionConfig) -> Indices:
    """Segment of each vertex, shape (n,), by normals and colors: a concave bend parts, a convex one is an object's own edge.

    normals: Unit, shape (n, 3). areas: Of each vertex [m2], shape (n,), from which the resolution is told.
    """
    edges = edges_of(surface.faces, len(surface.vertices))
    i, j = edges.T
    bend = 1.0 - np.einsum("nd,nd->n", normals[i], normals[j])
    is_convex = np.einsum("nd,nd->n", normals[j] - normals[i], surface.vertices[j] - surface.vertices[i]) > 0
    colors = surface.colors.astype(np.float64) / 255
    weights = np.where(is_convex, bend**2, bend) + config.color * np.linalg.norm(colors[i] - colors[j], axis=1)
    patch = float(np.median(areas[areas > 0])) if (areas > 0).any() else PATCH_M2
    return graph_segments(edges, weights, len(areas), config.threshold * PATCH_M2 / patch, max(4, int(config.least_m2 / patch)))


def merged_regions(
    surface: Surface, normals: Array, areas: Array, segments: Indices, config: RegionConfig, is_room: bool = True
) -> Indices:
    """Region of each vertex after merging, numbered from 0, shape (n,); -1 for what `segments` leaves out (-1), for what is too small to
    be anything and touches nothing, and for a single region that is too large. is_room: There is a room around; a thing alone may be
    all there is."""
    is_in = segments >= 0
    if not is_in.any():
        return np.full(len(segments), -1, dtype=np.int64)
    names, dense = np.unique(segments[is_in], return_inverse=True)
    region = np.full(len(segments), -1, dtype=np.int64)
    region[is_in] = dense
    most = most_area(areas, config) if is_room else np.inf
    forest = _Merging.of(surface, normals, areas, region, len(names))
    forest.merge(config, most)
    root = np.array([forest.root(number) for number in range(len(names))], dtype=np.int64)
    size = np.bincount(root[dense], weights=areas[is_in], minlength=len(names))
    kept = np.flatnonzero((size >= config.least_m2) & (size <= most) & (root == np.arange(len(names))))
    number = np.full(len(names), -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    region[is_in] = number[root[dense]]
    return region


def most_area(areas: Array, config: RegionConfig) -> float:
    """The largest surface that a region of a room may have [m2]. areas: of the scan's vertices [m2], shape (n,)."""
    return max(config.most_share * float(areas.sum()), config.most_m2)


@dataclasses.dataclass
class _Merging:
    """Regions that grow. areas [m2], paints (sum of area times color), outlines [m]; borders: of each region, by its neighbor, length
    [m] and concave length [m]."""

    areas: list[float]
    paints: list[Array]
    outlines: list[float]
    borders: list[dict[int, tuple[float, float]]]
    parents: list[int]
    changes: list[int]

    @classmethod
    def of(cls, surface: Surface, normals: Array, areas: Array, region: Indices, count: int) -> _Merging:
        """Regions of a mesh as they are. region: Of each vertex, -1 for none, shape (n,)."""
        points, colors = surface.vertices, surface.colors.astype(np.float64)
        edges = edges_of(surface.faces, len(points))
        i, j = edges.T
        span = points[j] - points[i]
        length = np.linalg.norm(span, axis=1)
        is_in = region >= 0
        own = region[is_in]
        size = np.bincount(own, weights=areas[is_in], minlength=count)
        paint = np.stack([np.bincount(own, weights=areas[is_in] * colors[is_in, k], minlength=count) for k in range(3)], axis=1)
        outline = np.zeros(count)
        for a, b in ((i, j), (j, i)):
            rim = (region[a] >= 0) & (region[a] != region[b])
            outline += np.bincount(region[a[rim]], weights=length[rim], minlength=count)
        smooth = _within(normals, areas, i, j, (region[i] == region[j]) & is_in[i])
        rim = is_in[i] & is_in[j] & (region[i] != region[j])
        i, j, span, length = i[rim], j[rim], span[rim], length[rim]
        angle = np.arccos(np.clip(np.einsum("nd,nd->n", smooth[i], smooth[j]), -1.0, 1.0))
        is_concave = np.einsum("nd,nd->n", smooth[j] - smooth[i], span) < 0
        crease = np.where(is_concave, np.clip((angle - FLAT_RADIANS) / (SHARP_RADIANS - FLAT_RADIANS), 0.0, 1.0), 0.0)
        keys = np.minimum(region[i], region[j]) * count + np.maximum(region[i], region[j])
        pairs, pair = np.unique(keys, return_inverse=True)
        lengths = np.bincount(pair, weights=length, minlength=len(pairs))
        creases = np.bincount(pair, weights=length * crease, minlength=len(pairs))
        borders: list[dict[int, tuple[float, float]]] = [{} for _ in range(count)]
        for key, border in zip(pairs.tolist(), zip(lengths.tolist(), creases.tolist(), strict=True), strict=True):
            a, b = divmod(key, count)
            borders[a][b] = borders[b][a] = border
        return cls(size.tolist(), list(paint), outline.tolist(), borders, list(range(count)), [0] * count)

    def root(self, number: int) -> int:
        """The region that one is part of by now."""
        while self.parents[number] != number:
            number = self.parents[number]
        return number

    def merge(self, config: RegionConfig, most: float) -> None:
        """Join the cheapest pair, again and again, unless both are more than `most` [m2], until all that are left cost too much."""
        heap = [(self._cost(a, b, config), a, b, 0, 0) for a, around in enumerate(self.borders) for b in around if a < b]
        heapq.heapify(heap)
        while heap:
            cost, a, b, of_a, of_b = heapq.heappop(heap)
            if cost > config.limit:
                return
            if self.parents[a] != a or self.parents[b] != b or (self.changes[a], self.changes[b]) != (of_a, of_b):
                continue  # one of them has grown meanwhile, and the pair is in the heap again
            if self.areas[a] + self.areas[b] > most:
                continue
            kept, gone = (a, b) if self.areas[a] >= self.areas[b] else (b, a)
            self._join(kept, gone)
            for other in self.borders[kept]:
                x, y = min(kept, other), max(kept, other)
                heapq.heappush(heap, (self._cost(x, y, config), x, y, self.changes[x], self.changes[y]))

    def _cost(self, a: int, b: int, config: RegionConfig) -> float:
        length, concave = self.borders[a][b]
        colors = self.paints[a] / max(self.areas[a], 1e-9) - self.paints[b] / max(self.areas[b], 1e-9)
        step = float(np.sqrt(colors @ colors)) / COLOR_STEP
        shared = min(length / max(min(self.outlines[a], self.outlines[b]), 1e-9), 1.0)
        crease = concave / max(length, 1e-9)
        small = config.small_m2 / max(min(self.areas[a], self.areas[b]), 1e-6)
        return crease * (config.concave + step) + config.unlike * step + config.loose * (1.0 - shared) - small

    def _join(self, kept: int, gone: int) -> None:
        length, _ = self.borders[kept].pop(gone)
        del self.borders[gone][kept]
        self.parents[gone] = kept
        self.changes[kept] += 1
        self.outlines[kept] += self.outlines[gone] - 2.0 * length
        self.areas[kept] += self.areas[gone]
        self.paints[kept] = self.paints[kept] + self.paints[gone]
        for other, (more, concave) in self.borders[gone].items():
            del self.borders[other][gone]
            known = self.borders[kept].get(other, (0.0, 0.0))
            self.borders[kept][other] = self.borders[other][kept] = (known[0] + more, known[1] + concave)
        self.borders[gone] = {}


def _within(normals: Array, areas: Array, i: Indices, j: Indices, is_same: NDArray[np.bool_]) -> Array:
    """Unit normals, shape (n, 3), averaged twice over neighbors of the same region: a crease at a border is measured across it."""
    i, j = i[is_same], j[is_same]
    mean = normals * areas[:, None]
    for _ in range(2):
        total = mean.copy()
        for axis in range(3):
            total[:, axis] += np.bincount(i, weights=mean[j, axis], minlength=len(mean))
            total[:, axis] += np.bincount(j, weights=mean[i, axis], minlength=len(mean))
        mean = total / np.maximum(np.linalg.norm(total, axis=1), 1e-12)[:, None]
    return mean
