"""What is seen of a shape, as plain arrays: its parts grouped by the image they are drawn with."""

from __future__ import annotations

import dataclasses
import hashlib
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.exports.bodies import Shape, digest
from tasks.exports.gltf import node_textures
from tasks.geometry.colors import tinted
from tasks.geometry.encoded_images import encoded_file
from tasks.geometry.meshes import material_of, vertex_colors

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class Texture:
    """An image file: its name in the folder `textures`, its bytes, and the linear factor, 0 to 1, shape (3,)."""

    file: str
    data: bytes
    factor: tuple[float, ...]
    alpha: str

    def baked(self) -> Texture:
        """The same look with the factor in the image.

        Formats with display values have no linear factor, and their readers multiply in different color spaces.
        """
        from PIL import Image

        if all(value == 1.0 for value in self.factor):
            return self
        image = Image.open(io.BytesIO(self.data))
        has_alpha = image.mode in ("RGBA", "LA") or "transparency" in image.info
        pixels = np.asarray(image.convert("RGBA" if has_alpha else "RGB"))
        data = _png(tinted(pixels, self.factor))
        name = f"{digest(hashlib.sha256(data).hexdigest(), 12)}.png"
        return dataclasses.replace(self, file=name, data=data, factor=(1.0, 1.0, 1.0))


@dataclasses.dataclass(frozen=True)
class Visual:
    """Parts drawn with one material: positions [m] (n, 3), triangles (m, 3), and colors or texture coordinates per vertex.

    solids: Which connected surface each vertex belongs to, shape (n,): where two touch they keep vertices of their own.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None
    uv: NDArray[np.float64] | None
    texture: Texture | None
    two_sided: bool
    solids: NDArray[np.int64] | None = None


def visuals_of(shape: Shape) -> list[Visual]:
    """Parts of a shape grouped by texture; all parts without one go together."""
    return shape.once("visuals", lambda: _grouped(shape))


def _grouped(shape: Shape) -> list[Visual]:
    images = node_textures(shape.glb, f"{shape.asset.name}.glb")
    plain: list[trimesh.Trimesh] = []
    textured: dict[Texture, list[trimesh.Trimesh]] = {}
    for part in shape.parts:
        texture = texture_of(part, images.get(part.metadata.get("name", "")))
        if texture is None:
            plain.append(part)
        else:
            textured.setdefault(texture, []).append(part)
    groups: list[tuple[Texture | None, list[trimesh.Trimesh]]] = [(None, plain)] if plain else []
    groups += list(textured.items())
    return [_visual(index, texture, parts) for index, (texture, parts) in enumerate(groups)]


def _visual(index: int, texture: Texture | None, parts: list[trimesh.Trimesh]) -> Visual:
    """One group of parts as arrays, as one surface or several, without triangles that have no area in single precision."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    uv = None if texture is None else np.concatenate([np.nan_to_num(np.asarray(_look(part).uv, dtype=np.float64)) for part in parts])
    vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    faces = np.concatenate([np.asarray(part.faces, dtype=np.int64) + offset for part, offset in zip(parts, offsets, strict=True)])
    colors = np.concatenate([vertex_colors(part) for part in parts]) if texture is None else None
    kept, faces, solids = _welded(vertices, faces, np.column_stack([look for look in (colors, uv) if look is not None]))
    return Visual(
        name=f"Part_{index:02d}",
        vertices=vertices[kept],
        faces=faces,
        colors=None if colors is None else colors[kept],
        uv=None if uv is None else uv[kept],
        texture=texture,
        two_sided=not all(part.is_watertight for part in parts),
        solids=solids,
    )


def _welded(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], look: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Vertices to keep, shape (k,), triangles of these, shape (m, 3), and the connected surface that each belongs to, shape (k,).

    Vertices that are equal in place and look, shape (n, d), become one, but for those where surfaces touch in an edge or a corner: there
    each keeps its own, so that the result is a manifold. Where that would take more vertices than there are, as in a sheet that
    is there twice, all stay as they are. Triangles without area are left out, unless none has one.
    """
    points = vertices.astype(np.float32)
    rows = np.column_stack([points, look.astype(np.float32)]) + np.float32(0.0)  # no negative zeros
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    joined = first[place.reshape(-1)][faces]
    corners = points[joined]
    solid = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any(axis=1)
    solid |= not solid.any()
    joined, own = joined[solid], faces[solid]
    # corners of two triangles are one vertex where these two, and no third, share an edge that ends there
    ends = np.arange(joined.size).reshape(-1, 3)
    edges = np.stack([ends, np.roll(ends, -1, axis=1)], axis=-1).reshape(-1, 2)
    names = joined.ravel()[edges]
    flipped = names[:, 0] > names[:, 1]
    edges[flipped], names[flipped] = edges[flipped][:, ::-1], names[flipped][:, ::-1]
    _, which, count = np.unique(names, axis=0, return_inverse=True, return_counts=True)
    pairs = edges[np.argsort(which.reshape(-1), kind="stable")][np.repeat(count == 2, count)].reshape(-1, 2, 2)
    links = np.concatenate([pairs[:, :, 0], pairs[:, :, 1]])
    fan = _components(links, joined.size)
    _, corner, renumbered = np.unique(fan, return_index=True, return_inverse=True)
    kept, again = np.unique(own, return_inverse=True)
    if len(corner) > len(kept):
        index = again.reshape(-1, 3)
        return kept, index, _components(np.concatenate([index[:, :2], index[:, 1:]]), len(kept))
    surface = _components(np.concatenate([links, ends[:, :2], ends[:, 1:]]), joined.size)
    return joined.ravel()[corner], renumbered.reshape(-1, 3), surface[corner]


def _components(links: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """The connected component that each of `count` nodes belongs to, shape (count,), given pairs of nodes, shape (n, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), dtype=bool), links.T), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def texture_of(part: trimesh.Trimesh, encoded: tuple[bytes, str] | None = None) -> Texture | None:
    """The image that a part is drawn with, or None: `encoded` as it lies in the part's file, else as it was read, else encoded again."""
    visual = _look(part)
    if visual.kind != "texture" or visual.uv is None or len(visual.uv) != len(part.vertices):
        return None
    image, factor = material_of(part)
    if image is None:
        return None
    data, extension = encoded or encoded_file(part) or (_png(image), "png")
    return Texture(
        file=f"{digest(hashlib.sha256(data).hexdigest(), 12)}.{extension}",
        data=data,
        factor=tuple(float(value) for value in factor),
        alpha=str(getattr(visual.material, "alphaMode", None) or "OPAQUE"),
    )


def _look(part: trimesh.Trimesh) -> Any:
    """How a part looks: its colors, or its material and texture coordinates."""
    return part.visual


def _png(image: NDArray[np.uint8]) -> bytes:
    """An image, shape (h, w, 3 or 4), as PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()
