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
from tasks.meshes import material_of, vertex_colors

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class Texture:
    """An image file: its name in the folder `textures`, its bytes, and the factor [0..1] (3,) that it is multiplied by."""

    file: str
    data: bytes
    factor: tuple[float, ...]
    alpha: str


@dataclasses.dataclass(frozen=True)
class Visual:
    """Parts drawn with one material: positions [m] (n, 3), triangles (m, 3), and colors or texture coordinates per vertex."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None
    uv: NDArray[np.float64] | None
    texture: Texture | None
    two_sided: bool


def visuals_of(shape: Shape) -> list[Visual]:
    """Parts of a shape grouped by texture; all parts without one go together."""
    images = node_textures(shape.glb, f"{shape.asset.name}.glb")
    plain: list[trimesh.Trimesh] = []
    textured: dict[Texture, list[trimesh.Trimesh]] = {}
    for part in shape.parts:
        texture = _texture_of(part, images.get(part.metadata.get("name", "")))
        if texture is None:
            plain.append(part)
        else:
            textured.setdefault(texture, []).append(part)
    groups: list[tuple[Texture | None, list[trimesh.Trimesh]]] = [(None, plain)] if plain else []
    groups += list(textured.items())
    return [_visual(index, texture, parts) for index, (texture, parts) in enumerate(groups)]


def _visual(index: int, texture: Texture | None, parts: list[trimesh.Trimesh]) -> Visual:
    """One group of parts as arrays."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    uv = None if texture is None else np.concatenate([np.nan_to_num(np.asarray(_look(part).uv, dtype=np.float64)) for part in parts])
    return Visual(
        name=f"Part_{index:02d}",
        vertices=np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts]),
        faces=np.concatenate([np.asarray(part.faces, dtype=np.int64) + offset for part, offset in zip(parts, offsets, strict=True)]),
        colors=np.concatenate([vertex_colors(part) for part in parts]) if texture is None else None,
        uv=uv,
        texture=texture,
        two_sided=not all(part.is_watertight for part in parts),
    )


def _texture_of(part: trimesh.Trimesh, encoded: tuple[bytes, str] | None) -> Texture | None:
    """The image that a part is drawn with, or None: as it lies in the file, else encoded again."""
    visual = _look(part)
    if visual.kind != "texture" or visual.uv is None or len(visual.uv) != len(part.vertices):
        return None
    image, factor = material_of(part)
    if image is None:
        return None
    if encoded is None:
        encoded = _png(image), "png"
    data, extension = encoded
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
    """An image, shape (h, w, 3), as PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()
