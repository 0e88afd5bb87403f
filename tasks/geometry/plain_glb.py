"""GLBs of triangles with one color per vertex, or none: what nearly every mesh of a lake is, written and read without a scene graph.

The document is the one that trimesh and `put_linear` make. Other meshes are for the general reader and writer
(`tasks.geometry.meshes`).
"""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.colors import bytes_of_shorts, shorts_of_bytes
from tasks.geometry.colors.gltf import BARE, PAINT

if TYPE_CHECKING:
    import trimesh

Integers = NDArray[np.int64]

_GENERATOR = "https://github.com/mikedh/trimesh"
_WORLD = "world"  # the root of trimesh's scenes, which no node may be called
_TRIANGLES = 4
_FACES = {"componentType": 5125, "type": "SCALAR"}
_POINTS = {"componentType": 5126, "type": "VEC3", "byteOffset": 0}
_COLORS = {"componentType": 5123, "normalized": True, "type": "VEC4", "byteOffset": 0}
_TREE = {"scene", "scenes", "asset", "accessors", "materials", "meshes", "nodes", "buffers", "bufferViews"}


@dataclasses.dataclass(frozen=True)
class PlainBody:
    """A node of a GLB. vertices: +Z up [m], shape (n, 3). faces: shape (m, 3). colors: sRGB and alpha, shape (n, 4) uint8, or None."""

    name: str
    vertices: NDArray[np.float64]
    faces: Integers
    colors: NDArray[np.uint8] | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it has faces, and a color for every vertex or none at all."""
        fits = self.colors is None or self.colors.shape == (len(self.vertices), 4)
        return bool(len(self.vertices) and len(self.faces) and fits and self.name and self.name != _WORLD)

    @staticmethod
    def of(mesh: trimesh.Trimesh, name: str) -> PlainBody | None:
        """A mesh as a body; None where it has a texture, colors of faces or attributes of its own."""
        visual: Any = mesh.visual
        if getattr(visual, "kind", "") not in (None, "vertex") or mesh.vertex_attributes or mesh.units is not None:
            return None
        colors = np.asarray(visual.vertex_colors, dtype=np.uint8) if visual.kind == "vertex" else None
        return PlainBody(name, np.asarray(mesh.vertices), np.asarray(mesh.faces), colors)

    def mesh(self) -> trimesh.Trimesh:
        """The body as a mesh that knows its name."""
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        if self.colors is not None:
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=self.colors)
        mesh.metadata["name"] = self.name
        return mesh


def write_plain(bodies: Sequence[PlainBody]) -> bytes | None:
    """A GLB (+Y up) of bodies in a +Z-up frame [m]; None where they are not plain: without faces, or two of one name."""
    if not bodies or not all(body.is_whole for body in bodies) or len({body.name for body in bodies}) < len(bodies):
        return None
    views: dict[bytes, int] = {}
    accessors: list[dict[str, Any]] = []
    known: dict[tuple[int, str], int] = {}

    def accessor(kind: Mapping[str, Any], data: bytes, count: int, most: list[Any], least: list[Any]) -> int:
        view = views.setdefault(data, len(views))
        key = (view, str(kind["type"]))
        if key not in known:
            known[key] = len(accessors)
            accessors.append({**kind, "bufferView": view, "count": count, "max": most, "min": least})
        return known[key]

    x, y, z = np.concatenate([np.asarray(body.vertices, dtype=np.float64) for body in bodies]).T
    places = _Rows((np.column_stack([x, z, -y]) + 0.0).astype(np.float32), [len(body.vertices) for body in bodies])  # no negative zeros
    corners = _Rows(
        np.concatenate([np.asarray(body.faces).reshape(-1, 1) for body in bodies]).astype(np.uint32), [body.faces.size for body in bodies]
    )
    meshes, materials = [], []
    for number, body in enumerate(bodies):
        indices = accessor(_FACES, *corners.of(number))
        attributes = {"POSITION": accessor(_POINTS, *places.of(number))}
        if body.colors is not None:
            colors = np.ascontiguousarray(shorts_of_bytes(np.asarray(body.colors, dtype=np.uint8)))
            limits = colors.max(axis=0).tolist(), colors.min(axis=0).tolist()
            attributes["COLOR_0"] = accessor(_COLORS, colors.tobytes(), len(colors), *limits)
        look = BARE if body.colors is None else PAINT
        if look not in materials:
            materials.append(look)
        primitive = {"attributes": attributes, "indices": indices, "mode": _TRIANGLES, "material": materials.index(look)}
        meshes.append({"name": body.name, "extras": {}, "primitives": [primitive]})
    starts = np.cumsum([0, *(len(view) for view in views)]).tolist()
    tree = {
        "scene": 0,
        "scenes": [{"nodes": list(range(len(bodies)))}],
        "asset": {"version": "2.0", "generator": _GENERATOR},
        "accessors": accessors,
        "meshes": meshes,
        "nodes": [{"name": body.name, "mesh": index} for index, body in enumerate(bodies)],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": len(view)} for a, view in zip(starts[:-1], views, strict=True)],
        "materials": materials,
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (4 - (len(text) + 20) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, len(text) + starts[-1] + 28, len(text), 0x4E4F534A)
    return b"".join([head, text, struct.pack("<II", starts[-1], 0x004E4942), *views])


class _Rows:
    """Rows of all bodies, with how many are of each: what an accessor says of them is found for all at once."""

    def __init__(self, rows: NDArray[Any], counts: Sequence[int]) -> None:
        ends = np.cumsum(np.asarray(counts, dtype=np.int64))
        starts = np.concatenate([[0], ends[:-1]]).astype(np.int64)
        self._rows, self._bounds = rows, list(zip(starts.tolist(), ends.tolist(), strict=True))
        self._most, self._least = (limit.reduceat(rows, starts, axis=0).tolist() for limit in (np.maximum, np.minimum))

    def of(self, number: int) -> tuple[bytes, int, list[Any], list[Any]]:
        """Bytes and count of the rows of a body, and the largest and least numbers in each column."""
        first, last = self._bounds[number]
        return self._rows[first:last].tobytes(), last - first, self._most[number], self._least[number]


def read_plain(data: bytes, document: Mapping[str, Any]) -> list[PlainBody] | None:
    """The bodies of a GLB that `write_plain` could have written, in the order of their names; None for any other.

    document: the JSON of the same GLB.
    """
    try:
        return _bodies(data, document)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, struct.error):
        return None


def _bodies(data: bytes, document: Mapping[str, Any]) -> list[PlainBody] | None:
    """As `read_plain`; raises whatever a document of another form leads to."""
    magic, version, length, size, kind = struct.unpack_from("<4sIIII", data)
    bytes_long, second = struct.unpack_from("<II", data, 20 + size)
    binary = data[28 + size : 28 + size + bytes_long]
    is_container = (magic, version, length, kind, second) == (b"glTF", 2, len(data), 0x4E4F534A, 0x004E4942)
    nodes, meshes = document["nodes"], document["meshes"]
    is_flat = document["scenes"] == [{"nodes": list(range(len(nodes)))}] and document["scene"] == 0 and len(meshes) == len(nodes)
    if not is_container or set(document) != _TREE or document["asset"]["generator"] != _GENERATOR or not is_flat or not nodes:
        return None
    if document["buffers"] != [{"byteLength": len(binary)}] or len(binary) != bytes_long:
        return None
    bodies = []
    for index, (node, mesh) in enumerate(zip(nodes, meshes, strict=True)):
        (primitive,), name = mesh["primitives"], node["name"]
        attributes = primitive["attributes"]
        is_plain = node == {"name": name, "mesh": index} and mesh == {"name": name, "extras": {}, "primitives": [primitive]}
        if not is_plain or not isinstance(name, str) or set(primitive) != {"attributes", "indices", "mode", "material"}:
            return None
        if primitive["mode"] != _TRIANGLES or not {"POSITION"} <= set(attributes) <= {"POSITION", "COLOR_0"}:
            return None
        faces = _array(document, binary, primitive["indices"], _FACES, "<u4", 1).reshape(-1, 3).astype(np.int64)
        x, y, z = _array(document, binary, attributes["POSITION"], _POINTS, "<f4", 3).astype(np.float64).T
        is_painted = "COLOR_0" in attributes
        if document["materials"][primitive["material"]] != (PAINT if is_painted else BARE):
            return None
        colors = bytes_of_shorts(_array(document, binary, attributes["COLOR_0"], _COLORS, "<u2", 4)) if is_painted else None
        body = PlainBody(name, np.column_stack([x, -z, y]) + 0.0, faces, colors)
        if not body.is_whole or faces.max() >= len(x) or not np.isfinite(body.vertices).all():
            return None
        bodies.append(body)
    bodies.sort(key=lambda body: body.name)
    return bodies if len({body.name for body in bodies}) == len(bodies) else None


def _array(document: Mapping[str, Any], binary: bytes, index: int, kind: Mapping[str, Any], dtype: str, width: int) -> NDArray[Any]:
    """The rows of an accessor of a kind, shape (count, width).

    Raises:
        ValueError: it is of another kind, or does not lie within its view.
    """
    if type(index) is not int or index < 0:
        raise ValueError("no index of an accessor")
    accessor = document["accessors"][index]
    number, count = accessor["bufferView"], accessor["count"]
    if type(number) is not int or number < 0 or type(count) is not int or count < 1:
        raise ValueError("no accessor of ours")
    view = document["bufferViews"][number]
    start, long = view["byteOffset"], view["byteLength"]
    stated = {key: value for key, value in view.items() if key != "target"}  # what it holds, which changes nothing of how it is read
    bytes_wide = np.dtype(dtype).itemsize * width
    is_ours = {key: value for key, value in accessor.items() if key not in ("bufferView", "count", "max", "min")} == kind
    if not is_ours or stated != {"buffer": 0, "byteOffset": start, "byteLength": long} or type(start) is not int or type(long) is not int:
        raise ValueError("no accessor of ours")
    if long != count * bytes_wide or start < 0 or start + long > len(binary):
        raise ValueError("its numbers do not lie within its view")
    return np.frombuffer(binary, dtype=dtype, count=count * width, offset=start).reshape(count, width)
