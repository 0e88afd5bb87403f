"""The face that each pixel shows: clusters from near to far, sifted many triangles at once, and the few that are left drawn exactly.

Sifting takes 32-bit numbers, which are enough to leave a triangle out for sure; what is drawn is computed with 64 bits.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.simulation.rasterizer import painting
from tasks.simulation.rasterizer.clusters import CLUSTER, LANES, SOLID, Clusters, Doubles, Floats, Indices
from tasks.simulation.rasterizer.painting import FaceLooks, paint

NEAR_M = 0.01
"""Nothing nearer to the plane of the camera is drawn [m], as in Habitat."""

ROUNDING = 1e-6
"""No place that 32-bit numbers give is off by more than this share of the coordinates that it is computed from."""

NEARBY_M = 0.1
"""Nearer to the plane of the camera rounding may move a corner by pixels [m]: triangles that reach there are not sifted by it."""

SLACK_PX = 0.01
"""How much wider a triangle counts in sifting than it is [px], besides rounding."""

SHELVES_PER_M, SHELVES = 8.0, 128
"""Clusters are sorted by depth to an eighth of a meter, up to 16 m: a finer order hides no more."""

SEEN, ABOVE = 1, 2
"""What a cluster may be: in the picture, and in the way from the camera straight up."""


@cache
def compiled() -> Kernels:
    """The functions below and those of `painting` as machine code, by name."""
    return compile_kernels(
        slack_of, look, is_left_of, is_inside, in_order, is_hidden, least, sift, fill, draw, render, known=painting.compiled()
    )


def render(
    cameras: Doubles, focal: float, clusters: Clusters, looks: FaceLooks, rgb: NDArray[np.uint8], depth: Floats, part: NDArray[np.int32]
) -> None:
    """Draw every picture, in memory that stays in the cache for all of them."""
    height, width = depth.shape[1], depth.shape[2]
    inverse, face = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
    states = np.empty((len(clusters.spheres), LANES), np.uint8)
    nears = np.empty((len(clusters.spheres), LANES), np.float32)
    order = np.empty(len(clusters.starts) - 1, np.int64)
    chosen = np.empty((CLUSTER // LANES, LANES), np.bool_)
    for index in range(len(cameras)):
        camera = cameras[index]
        look(camera, focal, width, height, clusters, False, states, nears)
        shows_backs = is_inside(camera, clusters, states)
        if shows_backs:
            look(camera, focal, width, height, clusters, True, states, nears)
        count = in_order(clusters, states, nears, order)
        if draw(camera, focal, clusters, order[:count], shows_backs, chosen, inverse, face):
            look(camera, focal, width, height, clusters, True, states, nears)
            count = in_order(clusters, states, nears, order)
            draw(camera, focal, clusters, order[:count], True, chosen, inverse, face)
        paint(camera, focal, looks, inverse, face, rgb[index], depth[index], part[index])


def slack_of(camera: Doubles, clusters: Clusters) -> float:
    """How far 32-bit numbers may be off [m]."""
    return ROUNDING * (clusters.reach + max(abs(camera[0, 3]), abs(camera[1, 3]), abs(camera[2, 3])))


def look(
    camera: Doubles, focal: float, width: int, height: int, clusters: Clusters, shows_backs: bool, states: NDArray[np.uint8], nears: Floats
) -> None:
    """What each cluster is, `SEEN` and `ABOVE`, and depth of its nearest end [m], shape (s, `LANES`)."""
    p, r = camera[:3, 3].astype(np.float32), camera[:3, :3].astype(np.float32)
    slack = np.float32(slack_of(camera, clusters))
    wide, tall = np.hypot(focal, 0.5 * width), np.hypot(focal, 0.5 * height)
    # How much a step aside, and one ahead, count towards the planes around what the camera sees.
    out_x, in_x = np.float32(focal / wide), np.float32(0.5 * width / wide)
    out_y, in_y = np.float32(focal / tall), np.float32(0.5 * height / tall)
    never = np.float32(np.inf if shows_backs else 0.0)
    for s in range(len(clusters.spheres)):
        sphere = clusters.spheres[s]
        for i in range(LANES):
            x, y, z, radius = sphere[0, i] - p[0], sphere[1, i] - p[1], sphere[2, i] - p[2], sphere[3, i] + slack
            along = x * sphere[4, i] + y * sphere[5, i] + z * sphere[6, i]
            shows = along < sphere[7, i] * np.sqrt(x * x + y * y + z * z) + radius + never
            ahead = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
            aside, below = abs(r[0, 0] * x + r[1, 0] * y + r[2, 0] * z), abs(r[0, 1] * x + r[1, 1] * y + r[2, 1] * z)
            is_in = (ahead > -radius) & (aside * out_x - ahead * in_x <= radius) & (below * out_y - ahead * in_y <= radius)
            states[s, i] = SEEN * (shows & is_in) + ABOVE * ((x * x + y * y <= radius * radius) & (z >= -radius))
            nears[s, i] = ahead - radius


def is_left_of(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> bool:
    """Whether a point is left of an edge at its height: the same for both directions of the edge, so that no point is between two faces."""
    if (ay > y) == (by > y):
        return False
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    return x < ax + (bx - ax) * (y - ay) / (by - ay)


def is_inside(camera: Doubles, clusters: Clusters, states: NDArray[np.uint8]) -> bool:
    """Whether the camera is inside of a solid: whether a ray straight up leaves more of them than it enters."""
    px, py, pz = camera[0, 3], camera[1, 3], camera[2, 3]
    left = 0
    flat = states.reshape(-1)
    for c in range(len(clusters.starts) - 1):
        if not flat[c] & ABOVE:
            continue
        for packet in range(clusters.starts[c], clusters.starts[c + 1]):
            for i in range(LANES):
                t = clusters.triangles[packet]
                ax, ay, bx, by, gx, gy = t[0, i], t[1, i], t[3, i], t[4, i], t[6, i], t[7, i]
                edges_right = is_left_of(px, py, ax, ay, bx, by) + is_left_of(px, py, bx, by, gx, gy) + is_left_of(px, py, gx, gy, ax, ay)
                if t[12, i] != SOLID or edges_right != 1:
                    continue
                ux, uy, uz = np.float64(bx) - ax, np.float64(by) - ay, np.float64(t[5, i]) - t[2, i]
                vx, vy, vz = np.float64(gx) - ax, np.float64(gy) - ay, np.float64(t[8, i]) - t[2, i]
                nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                if t[2, i] - (nx * (px - ax) + ny * (py - ay)) / nz > pz:
                    left += 1 if nz > 0.0 else -1
    return left != 0


def in_order(clusters: Clusters, states: NDArray[np.uint8], nears: Floats, order: Indices) -> int:
    """Clusters that are in the picture, from near to far, into `order`; how many they are."""
    seen, depths = states.reshape(-1), nears.reshape(-1)
    ends = np.zeros(SHELVES + 1, np.int64)
    for c in range(len(order)):
        if seen[c] & SEEN:
            ends[1 + int(min(max(depths[c] * SHELVES_PER_M, 0.0), SHELVES - 1.0))] += 1
    count = ends.sum()
    ends = np.cumsum(ends)
    for c in range(len(order)):
        if seen[c] & SEEN:
            shelf = int(min(max(depths[c] * SHELVES_PER_M, 0.0), SHELVES - 1.0))
            order[ends[shelf]] = c
            ends[shelf] += 1
    return count


def is_hidden(camera: Doubles, focal: float, sphere: Floats, lane: int, slack: float, inverse: Floats) -> bool:
    """Whether something nearer was drawn on every pixel that a cluster may cover, or it covers none."""
    height, width = inverse.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    x, y, z = sphere[0, lane] - camera[0, 3], sphere[1, lane] - camera[1, 3], sphere[2, lane] - camera[2, 3]
    radius = sphere[3, lane] + slack
    ahead = camera[0, 2] * x + camera[1, 2] * y + camera[2, 2] * z
    near, far = ahead - radius, ahead + radius
    if near <= NEAR_M:
        return False
    aside = camera[0, 0] * x + camera[1, 0] * y + camera[2, 0] * z
    below = camera[0, 1] * x + camera[1, 1] * y + camera[2, 1] * z
    close, distant = focal / near, focal / far
    left = int(np.ceil(max(0.0, min((aside - radius) * close, (aside - radius) * distant) + cx)))
    right = int(np.floor(min(width - 1.0, max((aside + radius) * close, (aside + radius) * distant) + cx)))
    top = int(np.ceil(max(0.0, min((below - radius) * close, (below - radius) * distant) + cy)))
    bottom = int(np.floor(min(height - 1.0, max((below + radius) * close, (below + radius) * distant) + cy)))
    limit = 1.0 / near
    for v in range(top, bottom + 1):
        for u in range(left, right + 1):
            if inverse[v, u] <= limit:
                return False
    return True


def least(a: np.float32, b: np.float32, c: np.float32) -> np.float32:
    """The least of three numbers."""
    low = a if a < b else b
    return low if low < c else c


def sift(
    camera: Doubles, focal: float, width: int, height: int, triangles: Floats, start: int, end: int, slack_m: float, shows_backs: bool,
    chosen: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Which triangles of the packets from start to end may cover the middle of a pixel with a side that is shown, (k, `LANES`)."""
    r00, r01, r02, px = np.float32(camera[0, 0]), np.float32(camera[0, 1]), np.float32(camera[0, 2]), np.float32(camera[0, 3])
    r10, r11, r12, py = np.float32(camera[1, 0]), np.float32(camera[1, 1]), np.float32(camera[1, 2]), np.float32(camera[1, 3])
    r20, r21, r22, pz = np.float32(camera[2, 0]), np.float32(camera[2, 1]), np.float32(camera[2, 2]), np.float32(camera[2, 3])
    f, right, bottom = np.float32(focal), np.float32(width - 1), np.float32(height - 1)
    cx, cy = np.float32(0.5) * right, np.float32(0.5) * bottom
    nearby, zero = np.float32(NEARBY_M + slack_m), np.float32(0.0)
    wider, behind = np.float32(SLACK_PX + slack_m * focal / NEARBY_M), np.float32(np.inf if shows_backs else slack_m)
    for packet in range(start, end):
        t = triangles[packet]
        for i in range(LANES):
            x, y, z = t[0, i] - px, t[1, i] - py, t[2, i] - pz
            is_shown = x * t[9, i] + y * t[10, i] + z * t[11, i] < t[12, i] + behind
            az = r02 * x + r12 * y + r22 * z
            ua, va = (r00 * x + r10 * y + r20 * z) * (f / az), (r01 * x + r11 * y + r21 * z) * (f / az)
            x, y, z = t[3, i] - px, t[4, i] - py, t[5, i] - pz
            bz = r02 * x + r12 * y + r22 * z
            ub, vb = (r00 * x + r10 * y + r20 * z) * (f / bz), (r01 * x + r11 * y + r21 * z) * (f / bz)
            x, y, z = t[6, i] - px, t[7, i] - py, t[8, i] - pz
            gz = r02 * x + r12 * y + r22 * z
            ug, vg = (r00 * x + r10 * y + r20 * z) * (f / gz), (r01 * x + r11 * y + r21 * z) * (f / gz)
            first, last = np.ceil(least(ua, ub, ug) + cx - wider), np.floor(cx + wider - least(-ua, -ub, -ug))
            highest, lowest = np.ceil(least(va, vb, vg) + cy - wider), np.floor(cy + wider - least(-va, -vb, -vg))
            covers = (first <= last) & (highest <= lowest) & (last >= zero) & (lowest >= zero) & (first <= right) & (highest <= bottom)
            chosen[packet - start, i] = is_shown & ((least(az, bz, gz) < nearby) | covers)


def draw(
    camera: Doubles, focal: float, clusters: Clusters, order: Indices, shows_backs: bool, chosen: NDArray[np.bool_], inverse: Floats,
    face: NDArray[np.int32],
) -> bool:  # fmt: skip
    """The nearest face of each pixel, shape (h, w), and one over its depth [1/m]; 0 for none.

    Returns:
        Whether the near plane cuts a solid open, so that it has to be drawn with its backs; the picture is not finished then.
    """
    inverse[:], face[:] = 0.0, 0
    height, width = face.shape
    cx, cy, slack = 0.5 * (width - 1), 0.5 * (height - 1), slack_of(camera, clusters)
    r00, r01, r02, px = camera[0, 0], camera[0, 1], camera[0, 2], camera[0, 3]
    r10, r11, r12, py = camera[1, 0], camera[1, 1], camera[1, 2], camera[1, 3]
    r20, r21, r22, pz = camera[2, 0], camera[2, 1], camera[2, 2], camera[2, 3]
    for c in order:
        if is_hidden(camera, focal, clusters.spheres[c // LANES], c % LANES, slack, inverse):
            continue
        start, end = clusters.starts[c], clusters.starts[c + 1]
        sift(camera, focal, width, height, clusters.triangles, start, end, slack, shows_backs, chosen)
        for packet in range(start, end):
            t = clusters.triangles[packet]
            for i in range(LANES):
                if not chosen[packet - start, i]:
                    continue
                x, y, z = t[0, i] - px, t[1, i] - py, t[2, i] - pz
                ax, ay, az = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
                x, y, z = t[3, i] - px, t[4, i] - py, t[5, i] - pz
                bx, by, bz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
                x, y, z = t[6, i] - px, t[7, i] - py, t[8, i] - pz
                gx, gy, gz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
                # Normals of the planes through the camera and each edge: a pixel's ray is inside where all three are on one side.
                nax, nay, naz = by * gz - bz * gy, bz * gx - bx * gz, bx * gy - by * gx
                facing = ax * nax + ay * nay + az * naz  # below 0: seen from the front, with y down
                is_culled = t[12, i] == SOLID and not shows_backs
                if facing == 0.0 or (facing > 0.0 and is_culled) or max(az, bz, gz) <= 0.0:
                    continue
                left, right, top, bottom = 0, width - 1, 0, height - 1
                is_cut = min(az, bz, gz) < NEAR_M
                if not is_cut:
                    ua, ub, ug = ax * focal / az + cx, bx * focal / bz + cx, gx * focal / gz + cx
                    va, vb, vg = ay * focal / az + cy, by * focal / bz + cy, gy * focal / gz + cy
                    left, right = int(np.ceil(max(min(ua, ub, ug), 0.0))), int(np.floor(min(max(ua, ub, ug), width - 1.0)))
                    top, bottom = int(np.ceil(max(min(va, vb, vg), 0.0))), int(np.floor(min(max(va, vb, vg), height - 1.0)))
                    if left > right or top > bottom:
                        continue
                nbx, nby, nbz = gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax
                ngx, ngy, ngz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                whole = 1.0 / facing
                across = whole / focal
                opens = fill(
                    nax * across, nay * across, naz * whole, nbx * across, nby * across, nbz * whole, ngx * across, ngy * across,
                    ngz * whole, left, right, top, bottom, packet * LANES + i, inverse, face,
                )  # fmt: skip
                if opens and is_cut and is_culled:
                    return True
    return False


def fill(
    nax: float, nay: float, naz: float, nbx: float, nby: float, nbz: float, ngx: float, ngy: float, ngz: float,
    left: int, right: int, top: int, bottom: int, t: int, inverse: Floats, face: NDArray[np.int32],
) -> bool:  # fmt: skip
    """Draw one triangle between these pixels.

    The planes of its edges, by pixels from the middle of the picture: their values at a pixel sum up to one over its depth.

    Returns:
        Whether some of it is before the near plane.
    """
    height, width = face.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    naz, nbz, ngz = naz - nax * cx - nay * cy, nbz - nbx * cx - nby * cy, ngz - ngx * cx - ngy * cy
    # A row enters a plane that rises to the right, and leaves any other; along one that does not rise it is inside at once, or never.
    enters_a, enters_b, enters_g = nax >= 0.0, nbx >= 0.0, ngx >= 0.0
    over_a = 1.0 / nax if nax != 0.0 else np.inf
    over_b = 1.0 / nbx if nbx != 0.0 else np.inf
    over_g = 1.0 / ngx if ngx != 0.0 else np.inf
    slope, nearest = nax + nbx + ngx, np.float32(1.0 / NEAR_M)
    begin, finish = float(left), float(right)
    opens, index = False, np.int32(t)
    for v in range(top, bottom + 1):
        ea, eb, eg = nay * v + naz, nby * v + nbz, ngy * v + ngz
        ua, ub, ug = -ea * over_a, -eb * over_b, -eg * over_g
        low = max(max(begin, ua if enters_a else begin), max(ub if enters_b else begin, ug if enters_g else begin))
        high = min(min(finish, finish if enters_a else ua), min(finish if enters_b else ub, finish if enters_g else ug))
        if not low <= high:
            continue
        first, last = int(np.ceil(low)), int(np.floor(high))
        if first > last:
            continue
        base, step = np.float32(ea + eb + eg + slope * first), np.float32(slope)
        near_row, face_row = inverse[v, first : last + 1], face[v, first : last + 1]
        if max(base, base + step * np.float32(last - first)) > nearest:
            opens = True
        for u in range(len(near_row)):
            one_over = step * np.float32(np.int32(u)) + base  # 32-bit numbers are converted twice as fast
            is_nearer = (one_over > near_row[u]) & (one_over <= nearest)
            near_row[u] = one_over if is_nearer else near_row[u]
            face_row[u] = index if is_nearer else face_row[u]
    return opens
