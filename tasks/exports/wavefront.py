"""Meshes as Wavefront OBJ files, for formats that know one color or one image per mesh.

Positions are written to a nanometre: readers that keep them in single precision lose more than the file does.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.exports.bodies import Shape
from tasks.exports.visuals import Texture, Visual, texture_of, visuals_of
from tasks.geometry.meshes import vertex_colors
from tasks.geometry.triangles import surface_area

if TYPE_CHECKING:
    import trimesh

COLORS = 16
"""A mesh without an image is split into this many of one color each at most: enough for furniture, few enough to draw."""


@dataclasses.dataclass(frozen=True)
class Painted:
    """A mesh of one color or one image.

    vertices: [m], shape (n, 3), in the frame that the holder states. faces: triangles, shape (m, 3). uv: texture coordinates,
    origin at the lower left, shape (n, 2), with a texture only. color: sRGB in 0..1; white with a texture.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64] | None
    color: tuple[float, ...]
    texture: Texture | None

    @property
    def can_be_seen(self) -> bool:
        """Whether it has an area."""
        return surface_area(self.vertices, self.faces) > 1e-12

    @cached_property
    def geometry(self) -> bytes:
        """The OBJ file without a material."""
        return _geometry(self.vertices, self.faces, self.uv)

    def obj(self, library: str | None = None) -> bytes:
        """The OBJ file. `library`: As of `dump_obj`."""
        return _head(library) + self.geometry


def painted_shape(shape: Shape) -> list[Painted]:
    """What is seen of a shape, in its own frame; what has no area cannot be seen."""
    return shape.once("painted", lambda: [mesh for visual in visuals_of(shape) for mesh in _painted(visual) if mesh.can_be_seen])


def painted_part(part: trimesh.Trimesh) -> list[Painted]:
    """A part of the room's shell."""
    vertices, faces = np.asarray(part.vertices, dtype=np.float64), np.asarray(part.faces, dtype=np.int64)
    texture, look = texture_of(part), cast(Any, part.visual)
    if texture is not None:
        return _painted(Visual("part", vertices, faces, None, np.asarray(look.uv, dtype=np.float64), texture, False))
    return _painted(Visual("part", vertices, faces, vertex_colors(part), None, None, False))


def dump_obj(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike | None = None, library: str | None = None) -> bytes:
    """An OBJ file of triangles: positions [m], shape (n, 3); faces, shape (m, 3); texture coordinates, shape (n, 2).

    `library`: MTL file beside it, whose only material is `look`.
    """
    return _head(library) + _geometry(vertices, faces, uv)


def _head(library: str | None) -> bytes:
    """What an OBJ file begins with."""
    return f"mtllib {library}\nusemtl look\n".encode() if library else b""


def _geometry(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike | None) -> bytes:
    """What an OBJ file has of a mesh, whatever material it names."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in _rounded(vertices)]
    if uv is not None:
        lines += [f"vt {u!r} {v!r}" for u, v in _rounded(uv)]
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    else:
        lines += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def load_obj(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Positions [m], shape (n, 3), and triangles, shape (m, 3), of an OBJ file as `dump_obj` writes it; None for any other."""
    vertices, faces = [], []
    for line in data.splitlines():
        kind, *words = line.split() or [b"#"]
        if kind in (b"v", b"f") and len(words) != 3:
            return None
        if kind == b"v":
            vertices.append(words)
        elif kind == b"f":
            faces.append([word.partition(b"/")[0] for word in words])
        elif kind not in (b"vt", b"mtllib", b"usemtl", b"#"):
            return None
    try:
        mesh = np.array(vertices).astype(np.float64).reshape(-1, 3), np.array(faces).astype(np.int64).reshape(-1, 3) - 1
    except ValueError:
        return None
    return mesh if len(mesh[1]) and mesh[1].min() >= 0 else None


def dump_mtl(color: Sequence[float], image: str | None = None) -> bytes:
    """An MTL file with the material `look`: color, sRGB in 0..1, shape (3,), and an image next to the file.

    MTL names no color space; readers show `Kd` as it is written or take it for sRGB, like `map_Kd`.
    """
    r, g, b = (round(float(value), 6) for value in color)
    lines = ["newmtl look", f"Kd {r!r} {g!r} {b!r}", "Ka 0.0 0.0 0.0", "Ks 0.0 0.0 0.0", "d 1.0", "illum 1"]
    return ("\n".join([*lines, f"map_Kd {image}"] if image else lines) + "\n").encode()


def obj_files(files: dict[str, bytes], name: str, meshes: Sequence[Painted]) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """OBJ files with MTL files and images of what is seen, put into `files` below `meshes/`; their paths and colors."""
    seen = []
    for index, mesh in enumerate(meshes):
        part = f"{name}_part_{index:02d}"
        image = mesh.texture.file if mesh.texture is not None else None
        files[f"meshes/{part}.obj"] = mesh.obj(f"{part}.mtl")
        files[f"meshes/{part}.mtl"] = dump_mtl(mesh.color, image)
        if mesh.texture is not None:
            files[f"meshes/{mesh.texture.file}"] = mesh.texture.data
        seen.append((f"meshes/{part}.obj", mesh.color))
    return tuple(seen)


def prepare(shape: Shape) -> None:
    """Make the texts that all formats with OBJ files have of a shape."""
    for mesh in painted_shape(shape):
        mesh.geometry  # noqa: B018  # is kept
    hull_files(shape)


def hull_files(shape: Shape) -> dict[str, bytes]:
    """OBJ files of a shape's convex pieces, below `meshes/`, by path."""
    return shape.once(
        "hull_files",
        lambda: {f"meshes/{shape.name}_hull_{i:02d}.obj": dump_obj(hull.vertices, hull.faces) for i, hull in enumerate(shape.hulls)},
    )


def as_png(texture: Texture) -> tuple[str, bytes]:
    """Name and bytes of a texture as PNG; one that is PNG already stays as it is."""
    if texture.file.endswith(".png"):
        return texture.file, texture.data
    from PIL import Image

    buffer = io.BytesIO()
    Image.open(io.BytesIO(texture.data)).convert("RGB").save(buffer, format="PNG", compress_level=1)  # five times as fast, a quarter larger
    return f"{texture.file.rsplit('.', 1)[0]}.png", buffer.getvalue()


def _rounded(values: ArrayLike) -> list[list[float]]:
    """Rows of numbers, rounded to a nanometre; no negative zeros."""
    rows: list[list[float]] = (np.round(np.asarray(values, dtype=np.float64), 9) + 0.0).tolist()
    return rows


def _painted(visual: Visual) -> list[Painted]:
    """A group of parts, split by color."""
    if visual.texture is not None:
        texture = visual.texture.baked()
        return [Painted(visual.vertices, visual.faces, visual.uv, texture.factor, texture)]
    assert visual.colors is not None
    if (visual.colors == visual.colors[0]).all():
        return [Painted(visual.vertices, visual.faces, None, _unit(visual.colors[0]), None)]
    of_faces = np.round(visual.colors[visual.faces].astype(np.float64).mean(axis=1)).astype(np.uint8)
    colors, which = np.unique(of_faces, axis=0, return_inverse=True)
    which = which.reshape(-1)
    if len(colors) > COLORS:
        colors, which = _fewer(of_faces)
    painted = []
    for index in np.unique(which).tolist():
        used, faces = np.unique(visual.faces[which == index], return_inverse=True)
        painted.append(Painted(visual.vertices[used], faces.reshape(-1, 3).astype(np.int64), None, _unit(colors[index]), None))
    return painted


def _fewer(colors: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Few colors that stand for many, shape (k, 3), and which stands for each, shape (n,) (Heckbert 1982: median cut)."""
    from PIL import Image

    image = Image.fromarray(colors[None]).quantize(COLORS, method=Image.Quantize.MEDIANCUT)
    palette = np.array(image.getpalette() or [], dtype=np.uint8).reshape(-1, 3)
    return palette, np.asarray(image, dtype=np.int64).reshape(-1)


def _unit(color: NDArray[np.uint8]) -> tuple[float, ...]:
    """A color of bytes as values in 0..1."""
    return tuple(round(float(value) / 255.0, 6) for value in color)
