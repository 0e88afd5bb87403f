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
    index, distance = compiled()["nearest"](np.ascontiguousarray(points), np.ascontiguousarray(samples))
    return np.asarray(index), np.asarray(distance)


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
    return compile_kernels(curve, _around, blocked, _clamped, _coarse, _ahead, search, nearest, _part_sum, pairwise_sum, discs)


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


def _coarse(points: Array, placed: Array) -> tuple[Array, Array]:
    poses, m = placed.shape[0], placed.shape[1]
    k = points.shape[0]
    out = np.full((poses, k), np.inf)
    back = np.full((poses, m), np.inf)
    for p in range(poses):
        for i in range(k):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            best = np.inf
            for j in range(m):
                a, b, c = placed[p, j, 0] - x, placed[p, j, 1] - y, placed[p, j, 2] - z
                d = a * a + b * b + c * c
                best = min(best, d)
                back[p, j] = min(back[p, j], d)
            out[p, i] = best
    return np.sqrt(out), np.sqrt(back)


def curve(samples: Array) -> NDArray[np.int64]:
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


def blocked(samples: Array, order: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Samples, shape (m, 3), in an order as columns, shape (3, m), with spheres around blocks of them and around groups of blocks."""
    columns = np.empty((3, samples.shape[0]))
    for j in range(samples.shape[0]):
        for a in range(3):
            columns[a, j] = samples[order[j], a]
    return columns, _around(columns, _BLOCK), _around(columns, _BLOCK * _BLOCK)


def _ahead(spheres: Array, groups: Array, x: float, y: float, z: float, middle: Array) -> int:
    """A block that is near to a point; puts the squares of distances to the middles of groups into `middle`."""
    near = 0
    for g in range(groups.shape[1]):
        p, q, r = groups[0, g] - x, groups[1, g] - y, groups[2, g] - z
        middle[g] = p * p + q * q + r * r
        if middle[g] < middle[near]:
            near = g
    start, least = near * _BLOCK, np.inf
    for b in range(near * _BLOCK, min((near + 1) * _BLOCK, spheres.shape[1])):
        p, q, r = spheres[0, b] - x, spheres[1, b] - y, spheres[2, b] - z
        d = p * p + q * q + r * r
        if d < least:
            start, least = b, d
    return start


def search(
    order: NDArray[np.int64], columns: Array, spheres: Array, groups: Array, middle: Array, x: float, y: float, z: float, both: bool
) -> tuple[int, float, float]:  # fmt: skip
    """The sample that is nearest to a point, of equal ones the first, its squared distance, and the next one's where both are asked for."""
    m, blocks = columns.shape[1], spheres.shape[1]
    start = _ahead(spheres, groups, x, y, z, middle)
    best, second, at, root = np.inf, np.inf, 0, np.inf
    for n in range(groups.shape[1] + 1):  # the near block first, then all that may hold a nearer sample
        g = n - 1
        if n and middle[g] > (root + groups[3, g]) ** 2:
            continue
        first, last = (g * _BLOCK, min((g + 1) * _BLOCK, blocks)) if n else (start, start + 1)
        for b in range(first, last):
            if n:
                p, q, r = spheres[0, b] - x, spheres[1, b] - y, spheres[2, b] - z
                if b == start or p * p + q * q + r * r > (root + spheres[3, b]) ** 2:
                    continue
            for j in range(b * _BLOCK, min((b + 1) * _BLOCK, m)):
                p, q, r = columns[0, j] - x, columns[1, j] - y, columns[2, j] - z
                d = p * p + q * q + r * r
                if d < best or (d == best and order[j] < at):
                    best, second, at = d, best, order[j]
                elif d < second:
                    second = d
            root = np.sqrt(second if both else best) * (1 + _SLACK)
    return at, best, second


def nearest(points: Array, samples: Array) -> tuple[NDArray[np.int64], Array]:
    """As `nearest_indices`, compiled."""
    k = points.shape[0]
    index = np.zeros(k, dtype=np.int64)
    distance = np.empty(k)
    order = curve(samples)
    columns, spheres, groups = blocked(samples, order)
    middle = np.empty(groups.shape[1])
    for i in range(k):
        index[i], best, _ = search(order, columns, spheres, groups, middle, points[i, 0], points[i, 1], points[i, 2], False)
        distance[i] = np.sqrt(best)
    return index, distance


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
    order = curve(centers)
    columns, spheres, groups = blocked(centers, order)
    blocks, middle = spheres.shape[1], np.empty(groups.shape[1])
    for i in range(k):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        start = _ahead(spheres, groups, x, y, z, middle)
        best, reach = np.inf, np.inf
        for n in range(groups.shape[1] + 1):
            g = n - 1
            if n and middle[g] > (reach + groups[3, g]) ** 2:
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
                    best = min(best, off * off + over * over)
                    reach = (np.sqrt(best) + radius) * (1 + _SLACK)
        distance[i] = np.sqrt(best)
    return distance
