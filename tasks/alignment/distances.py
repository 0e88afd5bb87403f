"""Distances between the points of a scanned instance and the surface of a placed asset, compiled.

A surface is a set of discs: evenly spread samples with their normals, each standing for its share of the area, so
that a few hundred samples give the distance to a surface of square metres to the centimetre.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels

Array = NDArray[np.float64]

_BLOCK = 8  # samples that lie together, of which none is looked at where their sphere is too far; and as many such blocks together
_BITS = 4  # of each coordinate, for the order of samples
_SLACK = 1e-9  # bounds are this much looser than the numbers: rounding rules nothing out


def coarse_distances(points: Array, placed: Array) -> tuple[Array, Array]:
    """Nearest distances both ways for several placements of one cloud [m].

    Points: shape (k, 3). Placed samples: shape (p, m, 3). Returns shapes (p, k), from the points to the samples, and
    (p, m), from the samples to the points.
    """
    out, back = compiled()["_coarse"](np.ascontiguousarray(points), np.ascontiguousarray(placed))
    return np.asarray(out), np.asarray(back)


def nearest_indices(points: Array, samples: Array) -> tuple[NDArray[np.int64], Array]:
    """Index of and distance to the nearest sample of every point [m]. Shapes (k, 3) and (m, 3) to (k,) and (k,)."""
    index, distance = compiled()["_nearest"](np.ascontiguousarray(points), np.ascontiguousarray(samples))
    return np.asarray(index), np.asarray(distance)


def nearest_turn(points: Array, placed: Array, keep: int, ranks: NDArray[np.int64] | None = None) -> tuple[float, float, Array, Array]:
    """How the `keep` points that are nearest to samples must be met: sums over the pairs of a point and its nearest sample, about their
    middles in plan, of the sine and of the cosine of the turn between them, times both lengths [m2], and the middles of these samples and
    points, both shape (2,) [m]. Shapes (k, 3) and (m, 3).

    ranks: The points in their order at the last step, shape (k,), brought into that of this one, which is much the same.
    """
    ranks = np.arange(len(points)) if ranks is None else ranks
    across, along, source, to = compiled()["_turned"](np.ascontiguousarray(points), np.ascontiguousarray(placed), keep, ranks)
    return float(across), float(along), source, to


def disc_distances(points: Array, centers: Array, normals: Array, radius: float) -> Array:
    """Distance of every point to the nearest of flat discs [m]: shape (k,). Centers and unit normals: shape (m, 3)."""
    kernel = compiled()["discs"]
    return np.asarray(kernel(np.ascontiguousarray(points), np.ascontiguousarray(centers), np.ascontiguousarray(normals), float(radius)))


def clamped(ratio: Array, weight: Array, half: float, least: float, most: float) -> Array:
    """Scales, shape (n, 3), of which each row's logarithms are the nearest in weighted least squares to those of `ratio` that lie within a
    window of twice `half`, then from `least` to `most`."""
    return np.asarray(compiled()["_clamped"](ratio, weight, half, least, most))


def spacing(points: Array) -> float:
    """Median distance of a point to its nearest neighbor [m], 0 for a single point. Shape (k, 3)."""
    if len(points) < 2:
        return 0.0
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


@cache
def compiled() -> Kernels:
    """Kernels that others call, too."""
    distances = (_columns, _least, _coarse, _nearest, back_distances)
    return compile_kernels(_curve, _around, _blocked, _clamped, *distances, _part_sum, pairwise_sum, _ranked, _turned, discs)


def _clamped(ratio: Array, weight: Array, half: float, least: float, most: float) -> Array:
    scale = np.empty(ratio.shape)
    for n in range(len(ratio)):
        logs = np.log(ratio[n])
        # all logarithms are brought into a window of this half width; the squared change is convex in the window's middle
        low, high = logs.min() - half, logs.max() + half
        for _ in range(50):
            middle = 0.5 * (low + high)
            slope = 0.0
            for a in range(len(logs)):
                slope += weight[n, a] * (min(max(logs[a], middle - half), middle + half) - logs[a])
            if slope < 0:
                low = middle
            else:
                high = middle
        # clipping to the limits moves no two logarithms farther apart
        for a in range(len(logs)):
            scale[n, a] = np.exp(min(max(min(max(logs[a], middle - half), middle + half), least), most))
    return scale


def _columns(points: Array) -> Array:
    """Points, shape (n, 3), one coordinate after another, shape (3, n)."""
    columns = np.empty((3, len(points)))
    for i in range(len(points)):
        for a in range(3):
            columns[a, i] = points[i, a]
    return columns


def _least(points: Array, samples: Array) -> Array:
    """Squared distance of each of the points to the nearest sample, both as columns. The inner loop is one of vectors: it beats a tree."""
    least = np.full(points.shape[1], np.inf)
    for j in range(samples.shape[1]):
        x, y, z = samples[0, j], samples[1, j], samples[2, j]
        for i in range(points.shape[1]):
            a, b, c = points[0, i] - x, points[1, i] - y, points[2, i] - z
            least[i] = min(least[i], a * a + b * b + c * c)
    return least


def _coarse(points: Array, placed: Array) -> tuple[Array, Array]:
    out, back = np.empty((len(placed), len(points))), np.empty(placed.shape[:2])
    wanted = _columns(points)
    for p in range(len(placed)):
        has = _columns(placed[p])
        out[p], back[p] = np.sqrt(_least(wanted, has)), np.sqrt(_least(has, wanted))
    return out, back


def _nearest(points: Array, samples: Array) -> tuple[NDArray[np.int64], Array]:
    columns = _columns(points)
    least, index = np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
    for j in range(len(samples)):
        x, y, z = samples[j, 0], samples[j, 1], samples[j, 2]
        for i in range(len(points)):
            a, b, c = columns[0, i] - x, columns[1, i] - y, columns[2, i] - z
            d = a * a + b * b + c * c
            is_nearer = d < least[i]  # of equal ones the first stays
            least[i] = d if is_nearer else least[i]
            index[i] = j if is_nearer else index[i]
    return index, np.sqrt(least)


def back_distances(placed: Array, points: Array) -> Array:
    """Distance of each of the samples to the nearest point [m], compiled."""
    return np.sqrt(_least(_columns(placed), _columns(points)))


def _ranked(distance: Array, ranks: NDArray[np.int64]) -> None:
    """Put points into the order of their distances, of equal ones the first: from an order that is nearly so, or anew."""
    left = 4 * len(ranks)
    for i in range(1, len(ranks)):
        point, at = ranks[i], i
        while at > 0:
            other = ranks[at - 1]
            if distance[other] < distance[point] or (distance[other] == distance[point] and other < point):
                break
            ranks[at] = other
            at -= 1
        ranks[at] = point
        left -= i - at
        if left < 0:
            ranks[:] = np.argsort(distance, kind="mergesort")
            return


def _turned(points: Array, placed: Array, keep: int, ranks: NDArray[np.int64]) -> tuple[float, float, Array, Array]:
    index, distance = _nearest(points, placed)
    _ranked(distance, ranks)
    used = ranks[:keep]
    count = len(used)
    source, to = np.zeros(2), np.zeros(2)
    for i in used:
        for a in range(2):
            source[a] += placed[index[i], a]
            to[a] += points[i, a]
    source, to = source / count, to / count
    across, along = np.empty(count), np.empty(2 * count)
    for n in range(count):
        i, j = used[n], index[used[n]]
        x, y = placed[j, 0] - source[0], placed[j, 1] - source[1]
        u, v = points[i, 0] - to[0], points[i, 1] - to[1]
        across[n] = x * v - y * u
        along[2 * n], along[2 * n + 1] = x * u, y * v
    return pairwise_sum(across), pairwise_sum(along), source, to


def _curve(samples: Array) -> NDArray[np.int64]:
    """Samples, shape (m, 3), in their order along a curve that fills space, shape (m,)."""
    m = samples.shape[0]
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for j in range(m):
        for a in range(3):
            low[a], high[a] = min(low[a], samples[j, a]), max(high[a], samples[j, a])
    side = max(high[0] - low[0], high[1] - low[1], high[2] - low[2], 1e-12) / 2**_BITS * (1 + _SLACK)
    code, starts = np.empty(m, dtype=np.int64), np.zeros(8**_BITS + 1, dtype=np.int64)
    for j in range(m):
        code[j] = 0
        for a in range(3):
            cell = int((samples[j, a] - low[a]) / side)
            for bit in range(_BITS):
                code[j] |= (cell >> bit & 1) << (3 * bit + a)
        starts[code[j] + 1] += 1
    for c in range(8**_BITS):
        starts[c + 1] += starts[c]
    order = np.empty(m, dtype=np.int64)
    for j in range(m):
        order[starts[code[j]]] = j
        starts[code[j]] += 1
    return order


def _around(columns: Array, width: int) -> Array:
    """Spheres around every `width` points that follow one another, shape (3, m): their middles and radii [m], shape (4, spheres)."""
    m = columns.shape[1]
    spheres = np.zeros((4, -(-m // width)))
    for b in range(spheres.shape[1]):
        first, last = b * width, min((b + 1) * width, m)
        for a in range(3):
            near, far = columns[a, first], columns[a, first]
            for j in range(first + 1, last):
                near, far = min(near, columns[a, j]), max(far, columns[a, j])
            spheres[a, b] = 0.5 * (near + far)
        for j in range(first, last):
            x, y, z = columns[0, j] - spheres[0, b], columns[1, j] - spheres[1, b], columns[2, j] - spheres[2, b]
            spheres[3, b] = max(spheres[3, b], x * x + y * y + z * z)
        spheres[3, b] = np.sqrt(spheres[3, b]) * (1 + _SLACK) + _SLACK
    return spheres


def _blocked(samples: Array, order: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Samples, shape (m, 3), in an order as columns, shape (3, m), with spheres around blocks of them and around groups of blocks."""
    columns = np.empty((3, samples.shape[0]))
    for j in range(samples.shape[0]):
        for a in range(3):
            columns[a, j] = samples[order[j], a]
    return columns, _around(columns, _BLOCK), _around(columns, _BLOCK * _BLOCK)


def _part_sum(values: Array, start: int, count: int) -> float:
    """Sum of a few values, eight at a time."""
    lanes, last = np.zeros(8), start + count - count % 8
    for i in range(start, last, 8):
        for lane in range(8):
            lanes[lane] += values[i + lane]
    total = ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]))
    for i in range(last, start + count):
        total += values[i]
    return float(total)


def pairwise_sum(values: Array) -> float:
    """Sum of values by halves, in the order of NumPy's: errors stay small. Halves wait on a stack, -1 for two to be added."""
    starts, counts, sums = np.zeros(128, dtype=np.int64), np.zeros(128, dtype=np.int64), np.zeros(128)
    counts[0], depth, done = len(values), 1, 0
    while depth > 0:
        depth -= 1
        start, count = starts[depth], counts[depth]
        if count < 0:
            done -= 1
            sums[done - 1] += sums[done]
        elif count <= 128:
            sums[done] = _part_sum(values, start, count)
            done += 1
        else:
            half = count // 2 - (count // 2) % 8
            counts[depth] = -1
            starts[depth + 1], counts[depth + 1] = start + half, count - half
            starts[depth + 2], counts[depth + 2] = start, half
            depth += 3
    return float(sums[0])


def discs(points: Array, centers: Array, normals: Array, radius: float) -> Array:
    """As `disc_distances`, compiled."""
    k, m = points.shape[0], centers.shape[0]
    distance = np.empty(k)
    order = _curve(centers)
    columns, spheres, groups = _blocked(centers, order)
    blocks, start = spheres.shape[1], 0
    for i in _curve(points):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best, reach, nearest_block = np.inf, np.inf, start
        for n in range(groups.shape[1] + 1):
            g = n - 1
            if n:
                p, q, r = groups[0, g] - x, groups[1, g] - y, groups[2, g] - z
                if p * p + q * q + r * r > (reach + groups[3, g]) ** 2:
                    continue
            first, last = (g * _BLOCK, min((g + 1) * _BLOCK, blocks)) if n else (start, start + 1)
            for b in range(first, last):
                if n:
                    p, q, r = spheres[0, b] - x, spheres[1, b] - y, spheres[2, b] - z
                    if b == start or p * p + q * q + r * r > (reach + spheres[3, b]) ** 2:
                        continue
                for j in range(b * _BLOCK, min((b + 1) * _BLOCK, m)):
                    p, q, r = x - columns[0, j], y - columns[1, j], z - columns[2, j]
                    whole = p * p + q * q + r * r
                    if whole >= reach * reach:  # even the disc's rim is farther than the best so far
                        continue
                    o = order[j]
                    off = p * normals[o, 0] + q * normals[o, 1] + r * normals[o, 2]
                    along = np.sqrt(max(whole - off * off, 0.0))
                    over = max(along - radius, 0.0)
                    if off * off + over * over < best:
                        best, nearest_block = off * off + over * over, b
                        reach = (np.sqrt(best) + radius) * (1 + _SLACK)
        distance[i], start = np.sqrt(best), nearest_block
    return distance
