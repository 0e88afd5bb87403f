"""Triangles of many parts as flat arrays, with the colors and textures of their faces: what a rasterizer draws."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colors import tinted
from tasks.geometry.meshes import material_of, vertex_colors
from tasks.geometry.triangles import face_crosses

if TYPE_CHECKING:
    import trimesh

TEXTURE_PX = 128
"""Longest side of a texture: pictures of agents have few pixels, and shrunk textures flicker less."""


@dataclasses.dataclass(frozen=True)
class Soup:
    """n triangles, world frame.

    corners: Counterclockwise from outside [m], shape (n, 3, 3). part: Number of the part, shape (n,). double_sided: It may be seen from
    behind, as nothing says that there is no such side, shape (n,). colors: RGB, shape (n, 3). texture: Number of the texture in the color's
    place, -1 for none, shape (n,). uv: Where the corners are in it, origin at the lower left, shape (n, 3, 2). textures: RGB, shape
    (h, w, 3) each.
    """

    corners: NDArray[np.float32]
    part: NDArray[np.int32]
    double_sided: NDArray[np.bool_]
    colors: NDArray[np.uint8]
    texture: NDArray[np.int32]
    uv: NDArray[np.float32]
    textures: tuple[NDArray[np.uint8], ...] = ()

    def __len__(self) -> int:
        return len(self.corners)

    def taken(self, order: NDArray[np.int64]) -> Soup:
        """Some triangles, in another order."""
        arrays = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "textures"}
        return Soup(**{name: np.ascontiguousarray(values[order]) for name, values in arrays.items()}, textures=self.textures)


def soup_of(parts: Sequence[trimesh.Trimesh]) -> Soup:
    """The triangles of parts, which are numbered in their order. Faces of closed parts are seen from outside alone."""
    made, textures = [], []
    for number, part in enumerate(parts):
        vertices, faces = np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces, dtype=np.int64)
        image, colors, uv = _look(part, faces)
        if image is not None:
            textures.append(image)
        count = len(faces)
        made.append(
            Soup(
                corners=vertices[faces].astype(np.float32), part=np.full(count, number, np.int32), double_sided=~closed(vertices, faces),
                colors=colors, texture=np.full(count, len(textures) - 1 if image is not None else -1, np.int32), uv=uv,
            )
        )  # fmt: skip
    empty = Soup(*(np.zeros(shape, kind) for shape, kind in _SHAPES))  # type: ignore[arg-type]
    fields = [field.name for field in dataclasses.fields(Soup) if field.name != "textures"]
    joined = {name: np.concatenate([getattr(soup, name) for soup in (empty, *made)]) for name in fields}
    return Soup(**joined, textures=tuple(textures))


_SHAPES = (
    ((0, 3, 3), np.float32), ((0,), np.int32), ((0,), np.bool_), ((0, 3), np.uint8), ((0,), np.int32), ((0, 3, 2), np.float32),
)  # fmt: skip


def closed(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which faces belong to a connected surface that has an inside, and whose fronts look out of it, shape (n,).

    Vertices at the same place are one: textures have them several times. Each edge of such a surface is walked as often one way as the
    other, and it encloses more than nothing. That a part of it is turned inside out, through another part, is not seen.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return np.zeros(0, dtype=np.bool_)
    places = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)
    ring = places[faces]
    count = int(places.max()) + 1
    links = coo_array((np.ones(2 * len(ring)), (np.r_[ring[:, 0], ring[:, 0]], np.r_[ring[:, 1], ring[:, 2]])), shape=(count, count))
    body = connected_components(links, directed=False)[1][ring[:, 0]]
    bodies = int(body.max()) + 1
    tails, heads = ring.reshape(-1), np.roll(ring, -1, axis=1).reshape(-1)
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    edges, edge = np.unique(low * count + high, return_inverse=True)
    balance = np.bincount(edge, weights=np.sign(heads - tails), minlength=len(edges))
    is_open = np.bincount(np.repeat(body, 3), weights=(balance[edge] != 0) & (low != high), minlength=bodies) > 0
    corner = vertices[faces]
    volume = np.bincount(body, weights=np.einsum("nd,nd->n", face_crosses(vertices, faces), corner[:, 0] - vertices.mean(axis=0)) / 6)
    extent = np.ptp(vertices, axis=0).max(initial=0.0)
    return np.asarray((~is_open & (volume > 1e-9 * extent**3))[body])


def _look(part: trimesh.Trimesh, faces: NDArray[np.int64]) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8], NDArray[np.float32]]:
    """The texture of a part, if it has one, colors of its faces, shape (n, 3), and where their corners are in it, shape (n, 3, 2)."""
    visual: Any = part.visual
    colors = np.rint(vertex_colors(part)[faces].mean(axis=1)).astype(np.uint8).reshape(-1, 3)
    if visual.kind == "texture" and visual.uv is not None and len(visual.uv) == len(part.vertices):
        image, factor = material_of(part)
        if image is not None:
            uv = np.nan_to_num(np.asarray(visual.uv, dtype=np.float64))[faces]
            return _shrunk(image, factor), colors, uv.astype(np.float32)
    return None, colors, np.zeros((len(faces), 3, 2), np.float32)


def _shrunk(image: NDArray[np.uint8], factor: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A texture times a linear factor, its longest side `TEXTURE_PX` at most."""
    from PIL import Image

    product = tinted(image, factor)
    tall, wide = product.shape[:2]
    scale = TEXTURE_PX / max(tall, wide)
    if scale >= 1:
        return np.ascontiguousarray(product)
    size = max(1, round(wide * scale)), max(1, round(tall * scale))
    return np.asarray(Image.fromarray(product).resize(size, Image.Resampling.BOX))
