"""Meshes in and out of GLB, and as plain arrays. Here, and only here, +Z up meets glTF's +Y up."""

from __future__ import annotations

import dataclasses
import io
import itertools
import warnings
from collections import Counter
from collections.abc import Mapping, MutableMapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.containers import weigh_glb
from tasks.geometry.colors import bytes_of_linear, linear_of, shorts_of_bytes, tinted
from tasks.geometry.colors.gltf import COLORS, GRAY, displayed_glb, put_linear
from tasks.geometry.encoded_images import keep_encoded, put_encoded, textures
from tasks.geometry.gltf.plain import plain_glb
from tasks.geometry.plain_glb import PlainBody, read_plain, write_plain
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP
from tasks.geometry.triangles import face_crosses, spread_by

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class Surface:
    """Triangles as plain arrays, in the frame that the holder states.

    vertices: Positions [m], shape (n, 3) float64. faces: Vertex indices, shape (m, 3) int64.
    colors: sRGB per vertex, shape (n, 3) uint8.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.vertices)
        if self.vertices.shape != (n, 3) or self.faces.ndim != 2 or self.faces.shape[1] != 3 or self.colors.shape != (n, 3):
            raise ValueError(f"surface: shapes {self.vertices.shape}, {self.faces.shape}, {self.colors.shape} do not fit together")
        if len(self.faces) and (self.faces.min() < 0 or self.faces.max() >= n):
            raise ValueError("surface: a face names a vertex that does not exist")

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner [m], shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def transformed(self, pose: ArrayLike, scale: ArrayLike = (1.0, 1.0, 1.0)) -> Surface:
        """The surface scaled along its own axes, shape (3,), then moved by a 4x4 pose."""
        m = np.asarray(pose, dtype=np.float64)
        return dataclasses.replace(self, vertices=(self.vertices * np.asarray(scale)) @ m[:3, :3].T + m[:3, 3])

    def to_trimesh(self) -> trimesh.Trimesh:
        """The same triangles and vertex colors as a trimesh, untouched by its processing."""
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        visual: Any = mesh.visual
        visual.vertex_colors = np.column_stack([self.colors, np.full(len(self.colors), 255, dtype=np.uint8)])
        return mesh


def load_glb(data: bytes, file: str = "mesh.glb") -> list[trimesh.Trimesh]:
    """Parts of a GLB in a +Z-up frame [m], node transforms applied, in the order of the file's node names.

    Every part's `metadata["name"]` is its node's name; where a node's mesh has several primitives, their numbers are parts of
    it: `floor||0`, `chair_2|chair|seat_0`. Textures stay; colors are display values, white where the file states none.

    Raises:
        InputError: the file is no GLB, would take more than the budget, holds no triangles, triangles of vertices that are
            not there, coordinates that are not finite, images that cannot be decoded, or a feature that is refused.
    """
    import trimesh

    document = weigh_glb(data, file)
    bodies = read_plain(data, document)
    if bodies is not None:
        return [body.mesh() for body in bodies]
    plain = plain_glb(data, document, file)
    document = dict(plain.document)
    data = displayed_glb(plain.data, document, file)
    try:
        with warnings.catch_warnings(), np.errstate(invalid="ignore", over="ignore"):
            warnings.simplefilter("ignore")  # Pillow's own, of images that are refused here
            scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
            poses, names = _poses(scene.graph), _names(scene, document)
    except Exception as error:  # the loader raises whatever the bytes lead it to
        raise InputError(
            file, "content", f"is not a readable GLB ({type(error).__name__}: {error})"[:300], "export it again as glTF binary"
        ) from error
    check_looks(scene, file)
    parts = []
    for node, name in names.items():
        geometry = scene.geometry[scene.graph.transforms.node_data[node]["geometry"]]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        if geometry.vertices.shape[1:] != (3,) or geometry.faces.min() < 0 or geometry.faces.max() >= len(geometry.vertices):
            raise InputError(file, f"node {name}", "has triangles of vertices that are not there", "export it again")
        part = _copied(geometry)
        with np.errstate(invalid="ignore", over="ignore"):  # what comes of it is looked at below
            part.apply_transform(Y_UP_TO_Z_UP @ poses[node])
        part.metadata["name"] = name
        if cast(Any, part.visual).kind is None:  # the color of glTF's default material
            cast(Any, part.visual).vertex_colors = np.full((len(part.vertices), 4), 255, dtype=np.uint8)
        if not np.isfinite(part.vertices).all():
            raise InputError(file, f"node {name}", "has coordinates that are not finite", "export it again")
        parts.append(part)
    if not parts:
        raise InputError(file, "meshes", "holds no triangles", "export it with its geometry")
    return parts


def surface_of_glb(data: bytes, file: str = "mesh.glb") -> Surface:
    """All triangles of a GLB as one surface in a +Z-up frame [m]: the parts that `load_glb` gives, merged; raises as that does."""
    plain = read_plain(data, weigh_glb(data, file))
    if plain is None:
        return surface_of(load_glb(data, file))
    return union_of([Surface(b.vertices, b.faces, _gray(len(b.vertices)) if b.colors is None else b.colors[:, :3]) for b in plain])


def _names(scene: trimesh.Scene, document: Mapping[str, Any]) -> dict[Any, str]:
    """Names of the nodes that hold geometry, in their order.

    The loader makes a node of each primitive of a mesh that has several, and calls it by chance; its number is what stays.
    """
    from trimesh.util import unique_name

    given: dict[str, None] = {}
    counts: dict[str | None, int] = {}
    for index, node in enumerate(document.get("nodes") or ()):
        given[unique_name(node.get("name", str(index)), given, counts=counts)] = None
    numbers = {name: number for number, name in enumerate(scene.geometry)}
    placed: dict[str, dict[str, Any]] = {}
    for node in scene.graph.nodes_geometry:
        above = str(scene.graph.transforms.parents.get(node))
        is_primitive = str(node) not in given and str(node)[: -_CHANCE - 1] == above
        geometry = scene.graph.transforms.node_data[node]["geometry"]
        placed.setdefault(above if is_primitive else str(node), {}).setdefault(geometry, node)
    names: dict[Any, str] = {}
    taken, counts = dict.fromkeys(placed), {}
    for owner, primitives in sorted(placed.items()):
        if len(primitives) == 1:
            names[next(iter(primitives.values()))] = owner
            continue
        for number, geometry in enumerate(sorted(primitives, key=lambda name: numbers[name])):
            bars = "" if owner.count("|") > 1 else "|" * (2 - owner.count("|"))
            name = unique_name(f"{owner}{bars or '_'}{number}", taken, counts=counts)
            names[primitives[geometry]], taken[name] = name, None
    return names


_CHANCE = 6
"""Characters that the loader puts behind a node's name and a bar, for its primitives."""


def _poses(graph: Any) -> dict[Any, NDArray[np.float64]]:
    """Pose of every node of a scene in its base frame, 4x4, each from that of the node above it.

    Raises:
        ValueError: nodes lie below themselves.
    """
    parents, edges = graph.transforms.parents, graph.transforms.edge_data
    poses: dict[Any, NDArray[np.float64]] = {graph.base_frame: np.eye(4)}
    for node in graph.nodes_geometry:
        way = [node]
        while way[-1] not in poses:
            if len(way) > len(parents):
                raise ValueError(f"node {node} lies below itself")
            way.append(parents[way[-1]])
        for above, below in itertools.pairwise(reversed(way)):
            poses[below] = poses[above] @ edges[above, below]["matrix"]
    return poses


def _copied(geometry: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of its own that shares its material: images are kept once, however often they are placed."""
    import trimesh

    copied, visual = geometry.copy(include_visual=False), cast(Any, geometry.visual)
    if visual.kind == "texture":
        uv = None if visual.uv is None else visual.uv.copy()
        copied.visual = trimesh.visual.TextureVisuals(uv=uv, material=visual.material)
    else:
        copied.visual = visual.copy()
    return copied


def check_looks(scene: trimesh.Scene, file: str) -> None:
    """Remember images as they are in the file, then decode them, once each; refuse what is no material.

    Raises:
        InputError: images are larger than the budget or cannot be decoded, a texture is no image, a factor no color.
    """
    images: dict[int, Any] = {}
    drawn: Counter[str] = Counter(scene.graph.transforms.node_data[node]["geometry"] for node in scene.graph.nodes_geometry)
    pixels = 0
    for name, geometry in scene.geometry.items():
        keep_encoded(geometry)
        geometry.metadata.clear()  # extras are not read, and would be copied with every placement
        material = getattr(getattr(geometry, "visual", None), "material", None)
        factor = getattr(material, "baseColorFactor", None)
        if factor is not None and (np.ndim(factor) != 1 or len(factor) < 3 or not np.isfinite(np.asarray(factor)).all()):
            raise InputError(file, f"mesh {name}", "has a baseColorFactor that is no color", "give four numbers from 0 to 1")
        for _, texture, image in textures(geometry, of_any_kind=True):
            if not hasattr(image, "info"):
                raise InputError(file, f"mesh {name}", f"has a {texture} that is no texture", "export it again with its images")
            images[id(image)] = image
            pixels += image.size[0] * image.size[1] * max(drawn[name], 1)
    sizes = [image.size[0] * image.size[1] for image in images.values()]
    for count, most, what in (
        (max(sizes, default=0), BUDGET.pixels, "one has"), (sum(sizes), BUDGET.all_pixels, "they have"),
        (pixels, BUDGET.drawn_pixels, "as often as they are placed, they have"),
    ):  # fmt: skip
        if count > most:
            raise InputError(file, "images", f"{what} {count} pixels, more than {most}", "shrink them")
    for image in images.values():
        try:
            image.load()
        except Exception as error:  # the decoder raises whatever the bytes lead it to
            raise InputError(file, "images", f"cannot be decoded ({type(error).__name__}: {error})"[:200], "export it again") from error


def dump_glb(parts: Sequence[trimesh.Trimesh], names: Sequence[str] | None = None) -> bytes:
    """A GLB (+Y up) of parts in a +Z-up frame [m], one node each. The same parts give the same bytes."""
    import trimesh

    names = names or [f"part_{index:03d}" for index in range(len(parts))]
    bodies = [PlainBody.of(part, name) for part, name in zip(parts, names, strict=True)]
    plain = write_plain([body for body in bodies if body is not None]) if None not in bodies else None
    if plain is not None:
        return plain
    scene = trimesh.Scene()
    for part, name in zip(parts, names, strict=True):
        turned = part.copy()
        turned.apply_transform(Z_UP_TO_Y_UP)
        turned.metadata.clear()
        put_encoded(turned)
        visual: Any = turned.visual
        if visual.kind in ("vertex", "face"):
            turned.vertex_attributes[COLORS] = shorts_of_bytes(np.asarray(visual.vertex_colors, dtype=np.uint8))
            turned.visual = trimesh.visual.ColorVisuals(turned)
        scene.add_geometry(turned, node_name=name, geom_name=name)
    data = scene.export(file_type="glb", include_normals=False, tree_postprocessor=put_linear)
    return bytes(data)


def dump_bodies(bodies: Sequence[PlainBody]) -> bytes:
    """The GLB that `dump_glb` makes of bodies as meshes."""
    return write_plain(bodies) or dump_glb([body.mesh() for body in bodies], [body.name for body in bodies])


def surface_of(parts: Sequence[trimesh.Trimesh]) -> Surface:
    """Parts merged into one surface, in their frame; textures are sampled at the vertices."""
    vertices, faces, colors, offset = [], [], [], 0
    for part in parts:
        vertices.append(np.asarray(part.vertices, dtype=np.float64))
        faces.append(np.asarray(part.faces, dtype=np.int64) + offset)
        colors.append(vertex_colors(part))
        offset += len(part.vertices)
    return Surface(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors))


def union_of(surfaces: Sequence[Surface]) -> Surface:
    """Surfaces of one frame as one, in their order; of none, a surface without faces."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    return Surface(
        np.concatenate([np.zeros((0, 3)), *(surface.vertices for surface in surfaces)]),
        np.concatenate([np.zeros((0, 3), np.int64), *(s.faces + start for s, start in zip(surfaces, starts[:-1], strict=True))]),
        np.concatenate([np.zeros((0, 3), np.uint8), *(surface.colors for surface in surfaces)]),
    )


def asset_surface(blob: str, blobs: Mapping[str, bytes], file: str, cache: MutableMapping[str, bytes]) -> Surface:
    """The parts of a GLB merged into one surface, in its own frame, remembered in `cache` by the blob's name.

    Raises:
        InputError: the file is no GLB, holds no triangles, or holds coordinates that are not finite.
    """
    if blob not in cache:
        surface = surface_of_glb(blobs[blob], file)
        counts = np.array([len(surface.vertices), len(surface.faces)], dtype="<i8")
        columns = (counts, surface.vertices.astype("<f8"), surface.faces.astype("<i8"), surface.colors)
        cache[blob] = b"".join(np.ascontiguousarray(column).tobytes() for column in columns)
    data = cache[blob]
    n, m = (int(v) for v in np.frombuffer(data, dtype="<i8", count=2))
    vertices = np.frombuffer(data, dtype="<f8", offset=16, count=3 * n).reshape(n, 3)
    faces = np.frombuffer(data, dtype="<i8", offset=16 + 24 * n, count=3 * m).reshape(m, 3)
    return Surface(vertices, faces, np.frombuffer(data, dtype=np.uint8, offset=16 + 24 * (n + m)).reshape(n, 3))


def vertex_colors(part: trimesh.Trimesh) -> NDArray[np.uint8]:
    """sRGB per vertex, shape (n, 3): vertex colors, else the texture at the vertex, else the material's color."""
    visual: Any = part.visual
    if visual.kind == "texture":
        uv, (image, factor) = visual.uv, material_of(part)
        if image is not None and uv is not None and len(uv) == len(part.vertices):
            return sample_texture(image, np.asarray(uv), factor)
        return np.tile(bytes_of_linear(factor), (len(part.vertices), 1))
    if visual.kind is None:
        return _gray(len(part.vertices))
    return np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3]


def _gray(count: int) -> NDArray[np.uint8]:
    """Colors of vertices that have none, shape (count, 3)."""
    return np.full((count, 3), GRAY, dtype=np.uint8)


def material_of(part: trimesh.Trimesh) -> tuple[NDArray[np.uint8] | None, NDArray[np.float64]]:
    """Base color texture of a textured part, sRGB, shape (h, w, 3), or None; and its linear base color factor, shape (3,).

    Materials hold display values here, those of a GLB too.
    """
    visual: Any = part.visual
    material = visual.material
    image = getattr(material, "baseColorTexture", None)
    factor = getattr(material, "baseColorFactor", None)
    if image is None and factor is None:
        image = getattr(material, "image", None)
        factor = getattr(material, "diffuse", None)
    color = np.ones(3) if factor is None else np.asarray(factor)[:3]
    linear = linear_of(color / 255.0 if color.dtype.kind in "ui" else color)
    return (None if image is None else np.asarray(image.convert("RGB"))), linear


def sample_texture(image: NDArray[np.uint8], uv: NDArray[np.float64], factor: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Texture color at `uv`, shape (n, 2), wrapped, origin at the lower left, nearest pixel; times a linear `factor`. Shape (n, 3)."""
    height, width = image.shape[:2]
    wrapped = np.nan_to_num(uv) % 1.0
    column = np.minimum((wrapped[:, 0] * width).astype(np.int64), width - 1)
    row = np.minimum(((1.0 - wrapped[:, 1]) * height).astype(np.int64), height - 1)
    return tinted(image[row, column], factor)


def sample_surface(
    surface: Surface, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Points spread evenly over a surface: positions (count, 3) [m], colors (count, 3), unit normals (count, 3)."""
    crosses = face_crosses(surface.vertices, surface.faces)
    lengths = np.linalg.norm(crosses, axis=1)
    if not lengths.sum() > 0:
        raise ValueError("surface: has no area")
    face, weights = spread_by(lengths, count, rng)
    corners = surface.faces[face]
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[corners])
    colors = np.einsum("nk,nkd->nd", weights, surface.colors[corners].astype(np.float64))
    return points, np.round(colors).astype(np.uint8), crosses[face] / np.maximum(lengths[face], 1e-300)[:, None]


def read_points(data: bytes, file: str = "points.ply") -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points [m], shape (n, 3), and colors, shape (n, 3), of a binary PLY as `dump_points` writes it.

    Raises:
        InputError: the bytes are no such PLY.
    """
    head, mark, body = data.partition(b"end_header\n")
    rows = np.frombuffer(body[: len(body) // _POINT.itemsize * _POINT.itemsize], dtype=_POINT)
    if not mark or len(body) % _POINT.itemsize or f"element vertex {len(rows)}\n".encode() not in head:
        raise InputError(file, "header", "is not a point cloud of this lake", "run the stage that made it again")
    return np.stack([rows["x"], rows["y"], rows["z"]], axis=1).astype(np.float64), np.stack(
        [rows["red"], rows["green"], rows["blue"]], axis=1
    )


def dump_points(points: ArrayLike, colors: ArrayLike) -> bytes:
    """A binary PLY of points [m], shape (n, 3), stored as float32, and colors, shape (n, 3) uint8."""
    p, c = np.asarray(points), np.asarray(colors)
    rows = np.empty(len(p), dtype=_POINT)
    for index, (axis, channel) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        rows[axis], rows[channel] = p[:, index], c[:, index]
    properties = "".join(f"property float {a}\n" for a in "xyz") + "".join(f"property uchar {a}\n" for a in ("red", "green", "blue"))
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {len(p)}\n{properties}end_header\n".encode() + rows.tobytes()


_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])


def canonical(parts: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """Parts moved so that the bottom center of their common box is the origin; +Z up and front +X are the caller's."""
    bounds = surface_of(parts).bounds
    offset = -np.array([bounds[:, 0].mean(), bounds[:, 1].mean(), bounds[0, 2]])
    moved = []
    for part in parts:
        copy = part.copy()
        copy.apply_translation(offset)
        moved.append(copy)
    return moved


def parse_node_name(name: str) -> Mapping[str, str]:
    """Name of a scene node, `model|category|part` where it has bars, as a mapping with `model`, `category`, `part`."""
    model, category, part = [*name.split("|"), "", ""][:3]
    return {"model": model, "category": category or model, "part": part}
