"""Colors of pixels from the faces that they show."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasks.kernels import Kernels, compile_kernels
from tasks.simulation.rasterizer.clusters import Doubles, Floats, Indices, unit_normals
from tasks.simulation.soups import Soup


class Looks(NamedTuple):
    """What n faces look like.

    part: Number of the part, shape (n,). lit: Color in its light, shape (n, 3). light: From 0 to 1, shape (n,). texture: Number of the
    texture in the color's place, -1 for none, shape (n,). maps: How places in the world become places in it, shape (n, 8): three factors
    [1/m] and a summand across it, from the left, then down it, from the top. tiles: Where the texels of each begin, its width and its
    height, shape (k, 3). texels: Of all textures, row by row, shape (t, 3).
    """

    part: NDArray[np.int32]
    lit: NDArray[np.uint8]
    light: Floats
    texture: NDArray[np.int32]
    maps: Doubles
    tiles: Indices
    texels: NDArray[np.uint8]


def looks_of(soup: Soup, faces: Indices) -> Looks:
    """Looks of some triangles of a soup, shape (n,); where there is none, -1, black of no part."""
    where = np.flatnonzero(faces >= 0)
    taken = soup.taken(faces[where])
    part, texture = np.full(len(faces), -1, np.int32), np.full(len(faces), -1, np.int32)
    lit, light, maps = np.zeros((len(faces), 3), np.uint8), np.zeros(len(faces), np.float32), np.zeros((len(faces), 8))
    part[where], texture[where], light[where], maps[where] = taken.part, taken.texture, _light(taken.corners), _texture_maps(taken)
    lit[where] = np.clip(np.rint(taken.colors * light[where, None]), 0, 255).astype(np.uint8)
    return Looks(part, lit, light, texture, maps, *_packed(soup.textures))


def _light(corners: Floats) -> Floats:
    """How bright faces are, from 0.6 to 1, shape (n,): brightest from above and below, then along x. Light does not move with cameras."""
    normals = np.abs(unit_normals(corners))
    return np.asarray(0.6 + 0.25 * normals[:, 2] + 0.15 * normals[:, 0], dtype=np.float32)


def _texture_maps(soup: Soup) -> Doubles:
    """The `maps` of the looks of triangles."""
    corners, uv = soup.corners.astype(np.float64), soup.uv.astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    dots = [np.einsum("nd,nd->n", *pair) for pair in ((first, first), (first, second), (second, second))]
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


def _packed(textures: tuple[NDArray[np.uint8], ...]) -> tuple[Indices, NDArray[np.uint8]]:
    """Tiles and texels of textures, shape (h, w, 3) each."""
    if not textures:
        return np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8)
    sizes = np.array([image.shape[:2] for image in textures], dtype=np.int64)
    firsts = np.cumsum(sizes.prod(axis=1)) - sizes.prod(axis=1)
    return np.column_stack([firsts, sizes[:, 1], sizes[:, 0]]), np.concatenate([image.reshape(-1, 3) for image in textures])


@cache
def compiled() -> Kernels:
    """The functions below as machine code, by name."""
    return compile_kernels(along_ray, cover, paint)


def paint(
    camera: Doubles, focal: float, looks: Looks, inverse: Floats, face: NDArray[np.int32], rgb: NDArray[np.uint8], depth: Floats,
    parts: NDArray[np.int32],
) -> None:  # fmt: skip
    """Color, depth and part of each pixel of a picture, from one over its depth [1/m], 0 for none, and its face, shape (h, w)."""
    unit, zero = np.float32(1.0), np.float32(0.0)
    over, drawn, far, owner, colors = inverse.reshape(-1), face.reshape(-1), depth.reshape(-1), parts.reshape(-1), rgb.reshape(-1, 3)
    for i in range(len(over)):
        far[i] = unit / over[i] if over[i] > zero else zero
    for i in range(len(drawn)):
        t = drawn[i]
        owner[i] = looks.part[t]
        colors[i, 0], colors[i, 1], colors[i, 2] = looks.lit[t, 0], looks.lit[t, 1], looks.lit[t, 2]
    if len(looks.texels):
        cover(camera, focal, looks, face, depth, rgb)


def cover(camera: Doubles, focal: float, looks: Looks, face: NDArray[np.int32], depth: Floats, rgb: NDArray[np.uint8]) -> None:
    """The texels of pixels whose faces, shape (h, w), have a texture, at their depths [m]."""
    height, width = depth.shape
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    for v in range(height):
        y = (v - cy) / focal
        last, k = -1, -1
        here_across = ahead_across = aside_across = here_down = ahead_down = aside_down = bright = 0.0
        first, wide, tall = 0, 1, 1
        for u in range(width):
            t = face[v, u]
            if t != last:  # what is the same for all pixels of a face in a row
                last, k = t, looks.texture[t]
                if k >= 0:
                    here_across, aside_across, ahead_across = along_ray(camera, y, looks.maps[t, :4])
                    here_down, aside_down, ahead_down = along_ray(camera, y, looks.maps[t, 4:])
                    first, wide, tall, bright = looks.tiles[k, 0], looks.tiles[k, 1], looks.tiles[k, 2], looks.light[t]
            if k < 0:
                continue
            x, d = (u - cx) / focal, depth[v, u]
            across = here_across + d * (ahead_across + aside_across * x)
            down = here_down + d * (ahead_down + aside_down * x)
            column, row = int((across - np.floor(across)) * wide), int((down - np.floor(down)) * tall)
            texel = first + min(row, tall - 1) * wide + min(column, wide - 1)
            rgb[v, u, 0] = np.uint8(looks.texels[texel, 0] * bright)
            rgb[v, u, 1] = np.uint8(looks.texels[texel, 1] * bright)
            rgb[v, u, 2] = np.uint8(looks.texels[texel, 2] * bright)


def along_ray(camera: Doubles, y: float, place: Doubles) -> tuple[float, float, float]:
    """Where the camera is in a texture, and how fast a ray moves in it per meter of depth: for its x, and for all of its row."""
    here = place[0] * camera[0, 3] + place[1] * camera[1, 3] + place[2] * camera[2, 3] + place[3]
    right = place[0] * camera[0, 0] + place[1] * camera[1, 0] + place[2] * camera[2, 0]
    below = place[0] * camera[0, 1] + place[1] * camera[1, 1] + place[2] * camera[2, 1]
    ahead = place[0] * camera[0, 2] + place[1] * camera[1, 2] + place[2] * camera[2, 2]
    return here, right, below * y + ahead
