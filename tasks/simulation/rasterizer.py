"""Pictures of triangles, many a second: a rasterizer in machine code that draws clusters of triangles from near to far.

What is drawn is what the first hit of a ray through the middle of each pixel would be. A cluster is left out when it looks away from the
camera, lies outside of what the camera sees, or behind what was drawn already.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.simulation.soups import Soup

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int64]

CLUSTER = 64
"""Triangles of a cluster at most: fewer cost more tests, more are seldom left out as a whole."""

NEAR_M = 0.01
"""Nothing nearer to the plane of the camera is drawn [m], as in Habitat."""

NARROW = 0.1
"""A cluster whose normals lie within a cone of a smaller cosine is turned every way, and never looks away."""

EVERY_WAY = 2.0
"""In the place of the sine of a cone: a cluster that may be seen from behind."""

MORTON_BITS = 10


@dataclasses.dataclass(frozen=True)
class Pictures:
    """What cameras see, one behind another: b pictures of h by w pixels.

    rgb: Shape (b, h, w, 3), uint8; black where nothing is. depth: Along the axis of the camera [m], 0 where nothing is, shape (b, h, w).
    part: Part of the soup, -1 where nothing is, shape (b, h, w).
    """

    rgb: NDArray[np.uint8]
    depth: Floats
    part: NDArray[np.int32]

    @staticmethod
    def empty(count: int, width: int, height: int) -> Pictures:
        """Room for so many pictures."""
        size = (count, height, width)
        return Pictures(np.empty((*size, 3), np.uint8), np.empty(size, np.float32), np.empty(size, np.int32))


class Rasterizer:
    """A soup of triangles that cameras look at. Any number of threads may ask at once: drawing lets go of the interpreter."""

    def __init__(self, soup: Soup) -> None:
        order, self._starts, self._spheres = _clusters(soup)
        self.soup = soup.taken(order)
        self._corners = np.ascontiguousarray(self.soup.corners.reshape(-1, 9))
        self._light = _light(self.soup.corners)
        self._lit = np.clip(np.rint(self.soup.colors * self._light[:, None]), 0, 255).astype(np.uint8)
        self._maps = _texture_maps(self.soup)
        self._texels, self._tiles = _packed(self.soup.textures)

    def render(self, poses: ArrayLike, width: int, height: int, hfov_radians: float, out: Pictures | None = None) -> Pictures:
        """What cameras with square pixels and their center in the middle of the picture see.

        Args:
            poses: OpenCV camera to world [m], shape (b, 4, 4).
            width: Of a picture [px].
            height: Of a picture [px].
            hfov_radians: Angle that a picture spans from left to right, below pi.
            out: Pictures to draw into; new ones where there are none.
        """
        cameras = np.ascontiguousarray(np.asarray(poses, dtype=np.float64).reshape(-1, 4, 4))
        pictures = out if out is not None else Pictures.empty(len(cameras), width, height)
        if pictures.depth.shape != (len(cameras), height, width):
            raise ValueError(f"out: has room for {pictures.depth.shape}, {(len(cameras), height, width)} is asked for")
        focal = 0.5 * width / np.tan(0.5 * hfov_radians)
        soup = self.soup
        _compiled()["_render"](
            cameras, focal, self._corners, self._starts, self._spheres, soup.double_sided, self._lit, self._light, soup.part, soup.texture,
            self._maps, self._tiles, self._texels, pictures.rgb, pictures.depth, pictures.part,
        )  # fmt: skip
        return pictures


def _light(corners: Floats) -> Floats:
    """How bright faces are, from 0.6 to 1, shape (n,): brightest from above and below, then along x. Light does not move with cameras."""
    normals = np.abs(_unit_normals(corners))
    return np.asarray(0.6 + 0.25 * normals[:, 2] + 0.15 * normals[:, 0], dtype=np.float32)


def _unit_normals(corners: Floats) -> Doubles:
    wide = corners.astype(np.float64)
    crosses = np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    return crosses / np.maximum(np.linalg.norm(crosses, axis=1), 1e-300)[:, None]


def _texture_maps(soup: Soup) -> Doubles:
    """How places in the world become places in a texture, for each face, shape (n, 8): three factors [1/m] and a summand across it, from
    the left, then down it, from the top."""
    corners, uv = soup.corners.astype(np.float64), soup.uv.astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    dots = [np.einsum("nd,nd->n", left, right) for left, right in ((first, first), (first, second), (second, second))]
    whole = np.maximum(dots[0] * dots[2] - dots[1] ** 2, 1e-300)[:, None]
    # Of a place on the face: its shares of the second and of the third corner, as products with these.
    of_first = (dots[2][:, None] * first - dots[1][:, None] * second) / whole
    of_second = (dots[0][:, None] * second - dots[1][:, None] * first) / whole
    maps = np.zeros((len(corners), 8))
    for axis, at in ((0, slice(0, 3)), (1, slice(4, 7))):
        maps[:, at] = of_first * (uv[:, 1] - uv[:, 0])[:, axis, None] + of_second * (uv[:, 2] - uv[:, 0])[:, axis, None]
        maps[:, 3 + 4 * axis] = uv[:, 0, axis] - np.einsum("nd,nd->n", maps[:, at], corners[:, 0])
    maps[:, 4:] *= -1.0
    maps[:, 7] += 1.0
    return maps


def _packed(textures: tuple[NDArray[np.uint8], ...]) -> tuple[NDArray[np.uint8], Indices]:
    """Texels of all textures one after another, shape (t, 3), and where each begins, its width and its height, shape (k, 3)."""
    if not textures:
        return np.zeros((1, 3), np.uint8), np.zeros((1, 3), np.int64)
    sizes = np.array([image.shape[:2] for image in textures], dtype=np.int64)
    firsts = np.cumsum(sizes.prod(axis=1)) - sizes.prod(axis=1)
    return np.concatenate([image.reshape(-1, 3) for image in textures]), np.column_stack([firsts, sizes[:, 1], sizes[:, 0]])


def _clusters(soup: Soup) -> tuple[Indices, Indices, Doubles]:
    """Clusters of triangles of one part that look much the same way and lie near each other.

    Returns:
        Order of the triangles, without those that have no area, shape (m,); where each cluster begins, shape (c + 1,); and its sphere and
        cone, shape (c, 8): center and radius [m], mean normal, and sine of the angle within which its normals lie, or `EVERY_WAY`.
    """
    normals, middles = _unit_normals(soup.corners), soup.corners.mean(axis=1, dtype=np.float64)
    main = np.abs(normals).argmax(axis=1)
    side = 2 * main + (normals[np.arange(len(main)), main] > 0)
    order = np.lexsort((_morton(middles), side, soup.double_sided, soup.part))
    order = order[np.linalg.norm(normals[order], axis=1) > 0.5]  # the others have no area
    if not len(order):
        return order, np.zeros(1, np.int64), np.zeros((0, 8))
    keys = np.column_stack([soup.part, soup.double_sided, side])[order]
    firsts = np.flatnonzero(np.r_[True, (keys[1:] != keys[:-1]).any(axis=1)])
    lengths = np.diff(np.r_[firsts, len(order)])
    pieces = -(-lengths // CLUSTER)
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    starts = np.repeat(firsts, pieces) + CLUSTER * within
    counts = np.diff(np.r_[starts, len(order)])
    owner = np.repeat(np.arange(len(starts)), counts)
    corners = soup.corners[order].astype(np.float64)
    low, high = np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)
    center = (low + high) / 2
    away = np.linalg.norm(corners - center[owner][:, None], axis=2).max(axis=1)
    axis = np.add.reduceat(normals[order], starts)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-9)[:, None]
    cosine = np.minimum.reduceat(np.einsum("nd,nd->n", normals[order], axis[owner]), starts)
    turns_away = (cosine > NARROW) & ~soup.double_sided[order][starts]
    sine = np.where(turns_away, np.sqrt(np.clip(1 - cosine**2, 0, 1)), EVERY_WAY)
    return order, np.r_[starts, len(order)], np.column_stack([center, np.maximum.reduceat(away, starts) * (1 + 1e-6), axis, sine])


def _morton(points: Doubles) -> Indices:
    """Places along a curve that keeps near what is near, shape (n,)."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    cells = ((points - low) / (high - low + 1e-9) * (2**MORTON_BITS - 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


@cache
def _compiled() -> Kernels:
    return compile_kernels(_sorted_clusters, _is_hidden, _fill, _draw, _along_ray, _paint, _render)


def _render(
    cameras: Doubles, focal: float, corners: Floats, starts: Indices, spheres: Doubles, double_sided: NDArray[np.bool_],
    lit: NDArray[np.uint8], light: Floats, part: NDArray[np.int32], texture: NDArray[np.int32], maps: Doubles, tiles: Indices,
    texels: NDArray[np.uint8], rgb: NDArray[np.uint8], depth: Floats, parts: NDArray[np.int32],
) -> None:  # fmt: skip
    """Draw every picture."""
    height, width = depth.shape[1], depth.shape[2]
    inverse = np.empty((height, width), np.float32)
    face = np.empty((height, width), np.int32)
    live, keys = np.empty(len(spheres), np.int64), np.empty(len(spheres), np.float64)
    for index in range(len(cameras)):
        inverse[:] = 0.0
        face[:] = -1
        _draw(cameras[index], focal, corners, starts, spheres, double_sided, inverse, face, live, keys)
        _paint(
            cameras[index], focal, lit, light, part, texture, maps, tiles, texels, inverse, face, rgb[index], depth[index], parts[index],
        )  # fmt: skip


def _draw(
    camera: Doubles, focal: float, corners: Floats, starts: Indices, spheres: Doubles, double_sided: NDArray[np.bool_], inverse: Floats,
    face: NDArray[np.int32], live: Indices, keys: Doubles,
) -> None:  # fmt: skip
    """The nearest face of each pixel, shape (h, w), and one over its depth [1/m]."""
    height, width = face.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    r00, r01, r02, px = camera[0, 0], camera[0, 1], camera[0, 2], camera[0, 3]
    r10, r11, r12, py = camera[1, 0], camera[1, 1], camera[1, 2], camera[1, 3]
    r20, r21, r22, pz = camera[2, 0], camera[2, 1], camera[2, 2], camera[2, 3]
    count = _sorted_clusters(camera, focal, width, height, spheres, live, keys)
    for place in range(count):
        cluster = live[place]
        if _is_hidden(camera, focal, spheres[cluster], inverse):
            continue
        for t in range(starts[cluster], starts[cluster + 1]):
            x, y, z = corners[t, 0] - px, corners[t, 1] - py, corners[t, 2] - pz
            ax, ay, az = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
            x, y, z = corners[t, 3] - px, corners[t, 4] - py, corners[t, 5] - pz
            bx, by, bz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
            x, y, z = corners[t, 6] - px, corners[t, 7] - py, corners[t, 8] - pz
            gx, gy, gz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
            if az < NEAR_M and bz < NEAR_M and gz < NEAR_M:
                continue
            # Normals of the planes through the camera and each edge: a pixel's ray is inside where all three are on one side.
            nax, nay, naz = by * gz - bz * gy, bz * gx - bx * gz, bx * gy - by * gx
            facing = ax * nax + ay * nay + az * naz  # below 0: seen from the front, with y down
            if facing == 0.0 or (facing > 0.0 and not double_sided[t]):
                continue
            left, right, top, bottom = 0, width - 1, 0, height - 1
            if az >= NEAR_M and bz >= NEAR_M and gz >= NEAR_M:
                ua, ub, ug = ax * focal / az + cx, bx * focal / bz + cx, gx * focal / gz + cx
                va, vb, vg = ay * focal / az + cy, by * focal / bz + cy, gy * focal / gz + cy
                left, right = int(np.ceil(max(min(ua, ub, ug), 0.0))), int(np.floor(min(max(ua, ub, ug), width - 1.0)))
                top, bottom = int(np.ceil(max(min(va, vb, vg), 0.0))), int(np.floor(min(max(va, vb, vg), height - 1.0)))
                if left > right or top > bottom:
                    continue
            nbx, nby, nbz = gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax
            ngx, ngy, ngz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            _fill(
                nax / facing, nay / facing, naz / facing, nbx / facing, nby / facing, nbz / facing, ngx / facing, ngy / facing,
                ngz / facing, focal, left, right, top, bottom, t, inverse, face,
            )  # fmt: skip


def _fill(
    nax: float, nay: float, naz: float, nbx: float, nby: float, nbz: float, ngx: float, ngy: float, ngz: float, focal: float,
    left: int, right: int, top: int, bottom: int, t: int, inverse: Floats, face: NDArray[np.int32],
) -> None:  # fmt: skip
    """Draw one triangle between these pixels: planes of its edges, whose values at a ray of depth 1 sum up to one over its depth."""
    height, width = face.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    nax, nay, nbx, nby, ngx, ngy = nax / focal, nay / focal, nbx / focal, nby / focal, ngx / focal, ngy / focal
    naz, nbz, ngz = naz - nax * cx - nay * cy, nbz - nbx * cx - nby * cy, ngz - ngx * cx - ngy * cy
    slope = nax + nbx + ngx
    nearest = np.float32(1.0 / NEAR_M)
    for v in range(top, bottom + 1):
        ea, eb, eg = nay * v + naz, nby * v + nbz, ngy * v + ngz
        low, high = float(left), float(right)
        # Where the row enters and leaves each plane, solved instead of tried pixel by pixel.
        if nax > 0.0:
            low = max(low, -ea / nax)
        elif nax < 0.0:
            high = min(high, -ea / nax)
        elif ea < 0.0:
            continue
        if nbx > 0.0:
            low = max(low, -eb / nbx)
        elif nbx < 0.0:
            high = min(high, -eb / nbx)
        elif eb < 0.0:
            continue
        if ngx > 0.0:
            low = max(low, -eg / ngx)
        elif ngx < 0.0:
            high = min(high, -eg / ngx)
        elif eg < 0.0:
            continue
        if low > high:
            continue
        first, last = int(np.ceil(low)), int(np.floor(high))
        if first > last:
            continue
        base = np.float32(ea + eb + eg + slope * first)
        step = np.float32(slope)
        near_row, face_row = inverse[v, first : last + 1], face[v, first : last + 1]
        for u in range(len(near_row)):
            one_over = step * np.float32(u) + base
            is_nearer = one_over > near_row[u] and one_over <= nearest
            near_row[u] = one_over if is_nearer else near_row[u]
            face_row[u] = t if is_nearer else face_row[u]


def _sorted_clusters(camera: Doubles, focal: float, width: int, height: int, spheres: Doubles, live: Indices, keys: Doubles) -> int:
    """Clusters that the camera may see, the nearest first, into `live`; how many they are."""
    across, along = 0.5 * width, 0.5 * height
    wide, tall = np.sqrt(focal * focal + across * across), np.sqrt(focal * focal + along * along)
    px, py, pz = camera[0, 3], camera[1, 3], camera[2, 3]
    count = 0
    for c in range(len(spheres)):
        x, y, z, radius = spheres[c, 0] - px, spheres[c, 1] - py, spheres[c, 2] - pz, spheres[c, 3]
        if spheres[c, 7] < EVERY_WAY:
            away = np.sqrt(x * x + y * y + z * z)
            if x * spheres[c, 4] + y * spheres[c, 5] + z * spheres[c, 6] >= spheres[c, 7] * away + radius:
                continue
        ahead = camera[0, 2] * x + camera[1, 2] * y + camera[2, 2] * z
        if ahead + radius < NEAR_M:
            continue
        aside = camera[0, 0] * x + camera[1, 0] * y + camera[2, 0] * z
        below = camera[0, 1] * x + camera[1, 1] * y + camera[2, 1] * z
        if (abs(aside) * focal - ahead * across) / wide > radius or (abs(below) * focal - ahead * along) / tall > radius:
            continue
        live[count], keys[count] = c, ahead - radius
        count += 1
    order = np.argsort(keys[:count])
    live[:count] = live[:count][order]
    return count


def _is_hidden(camera: Doubles, focal: float, sphere: Doubles, inverse: Floats) -> bool:
    """Whether something nearer was drawn on every pixel that a sphere, shape (8,), may cover, or it covers none."""
    height, width = inverse.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    x, y, z, radius = sphere[0] - camera[0, 3], sphere[1] - camera[1, 3], sphere[2] - camera[2, 3], sphere[3]
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


def _paint(
    camera: Doubles, focal: float, lit: NDArray[np.uint8], light: Floats, part: NDArray[np.int32], texture: NDArray[np.int32],
    maps: Doubles, tiles: Indices, texels: NDArray[np.uint8], inverse: Floats, face: NDArray[np.int32], rgb: NDArray[np.uint8],
    depth: Floats, parts: NDArray[np.int32],
) -> None:  # fmt: skip
    """Color, depth and part of each pixel from its face."""
    height, width = face.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    for v in range(height):
        y = (v - cy) / focal
        last, k = -1, -1
        here_across = ahead_across = aside_across = here_down = ahead_down = aside_down = bright = 0.0
        first, wide, tall = 0, 1, 1
        for u in range(width):
            t = face[v, u]
            if t < 0:
                rgb[v, u, 0] = rgb[v, u, 1] = rgb[v, u, 2] = 0
                depth[v, u] = 0.0
                parts[v, u] = -1
                continue
            d = np.float32(1.0) / inverse[v, u]
            depth[v, u] = d
            parts[v, u] = part[t]
            if t != last:  # what is the same for all pixels of a face in a row
                last, k = t, texture[t]
                if k >= 0:
                    here_across, aside_across, ahead_across = _along_ray(camera, y, maps[t, :4])
                    here_down, aside_down, ahead_down = _along_ray(camera, y, maps[t, 4:])
                    first, wide, tall, bright = tiles[k, 0], tiles[k, 1], tiles[k, 2], light[t]
            if k < 0:
                rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2] = lit[t, 0], lit[t, 1], lit[t, 2]
                continue
            x = (u - cx) / focal
            across = here_across + d * (ahead_across + aside_across * x)
            down = here_down + d * (ahead_down + aside_down * x)
            column, row = int((across - np.floor(across)) * wide), int((down - np.floor(down)) * tall)
            texel = first + min(row, tall - 1) * wide + min(column, wide - 1)
            rgb[v, u, 0] = np.uint8(texels[texel, 0] * bright)
            rgb[v, u, 1] = np.uint8(texels[texel, 1] * bright)
            rgb[v, u, 2] = np.uint8(texels[texel, 2] * bright)


def _along_ray(camera: Doubles, y: float, place: Doubles) -> tuple[float, float, float]:
    """Where the camera is in a texture, and how fast a ray moves in it per meter of depth: for its x, and for all of its row."""
    here = place[0] * camera[0, 3] + place[1] * camera[1, 3] + place[2] * camera[2, 3] + place[3]
    right = place[0] * camera[0, 0] + place[1] * camera[1, 0] + place[2] * camera[2, 0]
    below = place[0] * camera[0, 1] + place[1] * camera[1, 1] + place[2] * camera[2, 1]
    ahead = place[0] * camera[0, 2] + place[1] * camera[1, 2] + place[2] * camera[2, 2]
    return here, right, below * y + ahead
