"""GLBs that use features of glTF, each a table whose plain twin is known."""

from __future__ import annotations

import base64
import io
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from tasks.containers import close_glb

Array = NDArray[Any]
Document = dict[str, Any]

SIZE = (1.2, 0.75, 0.7)
"""Extents of the table along the file's axes, +Y up [m]."""

RED, GRAY = (160, 60, 40), (200, 200, 195)
"""Colors of the right and the left half of the image."""

_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

KTX2 = {
    "etc1s": (
        "c-mX-9TK5nWU!l;ONxsD2pEA_0Ejsl5P%U0X8^Gd5KjSO6(HULRnr2cZ5R=Hkbw@AW@6A_Sj@=8z|4$nhdrG29|+`uG|*Y)MVTe3MGQ`f#hJwl"
        "p?R5QsYS(!ISNL4h6W&W7{O+;0<kulUC4F|A8>&%E-|nPm^*-2MkhFh7<?e23QP^05EhFJYe;BlD60regODS`3~*2|IEXN*F@eP<n6Vw;fk+26"
        "FfafB$=o3O"
    ),
    "uastc": (
        "c-mX-9TK5nWU!l;ONxsD2pEA_0Ejsl5P%ViK_CN&b%1yZltu>!pmYNo4O7d+puw<=k%@ts8Db9v)Wcc-fj}Ne1D#b~lv$Em#Nd=zoLQ_8nwMFY"
        "T2!2vqhO?GXu!b00@4N4CN5d|qyCg6GfY1Qe+v84cvmF`oO}xP0|1^LEXM"
    ),
}
"""The image as Basis Universal encoders write it (16 x 8 pixels), compressed and in base 85."""


def box(size: tuple[float, float, float], center: tuple[float, float, float]) -> tuple[Array, Array]:
    """Vertices (8, 3) and faces (12, 3) of a box."""
    mesh = trimesh.creation.box(size)
    return np.asarray(mesh.vertices) + center, np.asarray(mesh.faces)


def table() -> tuple[Array, Array]:
    """Vertices and faces of a table, +Y up, its feet at 0."""
    width, height, depth = SIZE
    parts = [box((width, 0.04, depth), (0, height - 0.02, 0))]
    for x in (-1, 1):
        for z in (-1, 1):
            parts.append(box((0.06, height - 0.04, 0.06), (x * (width / 2 - 0.05), (height - 0.04) / 2, z * (depth / 2 - 0.05))))
    vertices = np.concatenate([part[0] for part in parts])
    return vertices, np.concatenate([part[1] + 8 * number for number, part in enumerate(parts)])


class Gltf:
    """A GLB that states only what a test gives it."""

    def __init__(self) -> None:
        self.document: Document = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "accessors": [],
            "bufferViews": [], "materials": [], "textures": [], "images": [], "samplers": [],
        }  # fmt: skip
        self.binary = b""

    def view(self, data: bytes, **more: Any) -> int:
        """A view of bytes; the number."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **more})
        self.binary += data
        return len(self.document["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str = "f4", **more: Any) -> int:
        """An accessor of rows; the number."""
        rows = np.ascontiguousarray(values, dtype=f"<{dtype}").reshape(len(values), -1)
        width = rows.shape[1]
        wide = -(rows.itemsize * width) % 4
        data = np.column_stack([rows.view(np.uint8).reshape(len(rows), -1), np.zeros((len(rows), wide), np.uint8)]) if wide else rows
        view = self.view(data.tobytes(), **({"byteStride": rows.itemsize * width + wide} if wide and width > 1 else {}))
        if wide and width == 1:
            self.document["bufferViews"].pop()
            view = self.view(rows.tobytes())
        return self.stated(rows, view, **more)

    def stated(self, rows: Array, view: int | None, **more: Any) -> int:
        """An accessor of rows that lie in a view, or elsewhere."""
        entry = {"componentType": _COMPONENTS[rows.dtype.str[1:]], "count": len(rows), "type": _KINDS[rows.shape[1]], **more}
        entry |= {} if view is None else {"bufferView": view}
        entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()} if rows.shape[1] == 3 else {}
        self.document["accessors"].append(entry)
        return len(self.document["accessors"]) - 1

    def mesh(self, vertices: Array, faces: Array, name: str = "", **more: Any) -> int:
        """A mesh of triangles; the number."""
        primitive = {"attributes": {"POSITION": self.accessor(vertices)}, "indices": self.accessor(faces.reshape(-1, 1), "u4"), **more}
        return self.parts([primitive], name)

    def parts(self, primitives: list[Document], name: str = "", **more: Any) -> int:
        """A mesh of primitives; the number."""
        self.document["meshes"].append({"primitives": primitives, **({"name": name} if name else {}), **more})
        return len(self.document["meshes"]) - 1

    def node(self, name: str = "", is_root: bool = True, **more: Any) -> int:
        """A node; the number."""
        self.document["nodes"].append({**({"name": name} if name else {}), **more})
        number = len(self.document["nodes"]) - 1
        if is_root:
            self.document["scenes"][0]["nodes"].append(number)
        return number

    def use(self, *names: str, is_required: bool = True) -> Gltf:
        """Declare extensions."""
        for key in ("extensionsUsed", *(["extensionsRequired"] if is_required else [])):
            self.document[key] = sorted({*self.document.get(key, []), *names})
        return self

    def data(self) -> bytes:
        """The GLB."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        stated = {key: value for key, value in self.document.items() if value != []}
        stated["buffers"] = [{"byteLength": len(self.binary)}, *stated.get("buffers", [])]
        return close_glb(stated, self.binary)


def plain() -> Gltf:
    """The table, as plain as can be."""
    made = Gltf()
    made.node("table_1", mesh=made.mesh(*table()))
    return made


def not_indexed() -> Gltf:
    """A vertex for every corner."""
    made, (vertices, faces) = Gltf(), table()
    made.node("table_1", mesh=made.parts([{"attributes": {"POSITION": made.accessor(vertices[faces.ravel()])}}]))
    return made


def stripped() -> Gltf:
    """A strip for each triangle's pair of corners: every face is a strip of three, joined by degenerate triangles."""
    made, (vertices, faces) = Gltf(), table()
    corners: list[int] = []
    for a, b, c in faces.tolist():
        # Repeated corners join strips; the winding of a triangle depends on its place being even.
        corners += [a, a] if corners else []
        corners += [a] if len(corners) % 2 else []
        corners += [a, b, c, c]
    attributes = {"POSITION": made.accessor(vertices)}
    made.node("table_1", mesh=made.parts([{"attributes": attributes, "indices": made.accessor(np.array(corners), "u2"), "mode": 5}]))
    return made


def fanned() -> Gltf:
    """A fan for each pair of triangles."""
    made, (vertices, faces) = Gltf(), table()
    attributes = {"POSITION": made.accessor(vertices)}
    fans = [{"attributes": attributes, "indices": made.accessor(face, "u2"), "mode": 6} for face in faces]
    made.node("table_1", mesh=made.parts(fans))
    return made


def quantized(dtype: str = "i2", is_normalized: bool = True) -> Gltf:
    """Positions as integers, which the node scales back."""
    made, (vertices, faces) = Gltf(), table()
    most = float(np.iinfo(dtype).max)
    low, wide = (vertices.min(axis=0), 1.2) if dtype.startswith("u") else (np.zeros(3), 1.2)
    whole = np.round((vertices - low) / wide * most)
    primitive = {
        "attributes": {"POSITION": made.accessor(whole, dtype, normalized=is_normalized)},
        "indices": made.accessor(faces.reshape(-1, 1), "u2"),
    }  # fmt: skip
    scale = wide if is_normalized else wide / most
    made.node("table_1", mesh=made.parts([primitive]), scale=[scale] * 3, translation=low.tolist())
    return made.use("KHR_mesh_quantization")


def sparse() -> Gltf:
    """Positions and indices of which some are stated by themselves."""
    made, (vertices, faces) = Gltf(), table()
    wrong = vertices.copy()
    wrong[:8] *= 0.1
    position = made.accessor(wrong)
    corners = made.stated(faces.reshape(-1, 1).astype("<u4"), None)
    for accessor, rows, values in ((position, range(8), vertices[:8].astype("<f4")), (corners, range(faces.size), faces.astype("<u4"))):
        made.document["accessors"][accessor]["sparse"] = {
            "count": len(rows),
            "indices": {"bufferView": made.view(np.array(rows, "<u2").tobytes()), "componentType": 5123},
            "values": {"bufferView": made.view(values.tobytes())},
        }
    made.node("table_1", mesh=made.parts([{"attributes": {"POSITION": position}, "indices": corners}]))
    return made


def draco() -> Gltf:
    """Draco's bitstream alone."""
    import DracoPy

    made, (vertices, faces) = Gltf(), table()
    packed = DracoPy.encode(vertices, faces, quantization_bits=16, preserve_order=True)
    attributes = {"POSITION": made.stated(vertices.astype("<f4"), None)}
    extension = {"bufferView": made.view(packed), "attributes": {"POSITION": 0}}
    primitive = {
        "attributes": attributes, "indices": made.stated(faces.reshape(-1, 1).astype("<u4"), None),
        "extensions": {"KHR_draco_mesh_compression": extension},
    }  # fmt: skip
    made.node("table_1", mesh=made.parts([primitive]))
    return made.use("KHR_draco_mesh_compression")


def meshopt(name: str = "EXT_meshopt_compression", filter_: str = "NONE") -> Gltf:
    """Views that meshoptimizer compressed, over a buffer that holds nothing."""
    import meshopt as codec

    made, (vertices, faces) = Gltf(), table()
    made.document["buffers"] = [{"byteLength": 12 * len(vertices) + 4 * faces.size, "extensions": {name: {"fallback": True}}}]
    rows = vertices.astype("<f4") if filter_ == "NONE" else codec.encode_filter_exp(vertices, 20)
    version = 1 if name.startswith("KHR") else 0
    start = 0
    for mode, values, stride in (("ATTRIBUTES", rows, 12), ("TRIANGLES", faces.reshape(-1).astype("<u4"), 4)):
        packed = codec.encode_gltf_buffer(values, mode, version)
        view = made.view(packed)
        count = len(vertices) if mode == "ATTRIBUTES" else faces.size
        stored = made.document["bufferViews"][view]
        extension = {
            "buffer": 0,
            "byteOffset": stored["byteOffset"],
            "byteLength": len(packed),
            "byteStride": stride,
            "count": count,
            "mode": mode,
        }
        extension |= {"filter": filter_} if mode == "ATTRIBUTES" and filter_ != "NONE" else {}
        stride_stated = {"byteStride": stride} if mode == "ATTRIBUTES" else {}
        made.document["bufferViews"][view] = {
            "buffer": 1, "byteOffset": start, "byteLength": stride * count, "extensions": {name: extension}, **stride_stated
        }  # fmt: skip
        start += stride * count
    primitive = {
        "attributes": {"POSITION": made.stated(vertices.astype("<f4"), 0)},
        "indices": made.stated(faces.reshape(-1, 1).astype("<u4"), 1),
    }
    made.node("table_1", mesh=made.parts([primitive]))
    return made.use(name)


def skinned() -> Gltf:
    """A table at half size that two joints move and scale to its own; the pose of its own node does not count."""
    made, (vertices, faces) = Gltf(), table()
    mesh = made.mesh(vertices * 0.5 + [3, 0, 0], faces)
    attributes = made.document["meshes"][mesh]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = made.accessor(np.tile([0, 1, 0, 0], (len(vertices), 1)), "u1")
    attributes["WEIGHTS_0"] = made.accessor(np.tile([0.25, 0.75, 0, 0], (len(vertices), 1)))
    inverse = np.eye(4)
    inverse[:3, 3] = [-3, 0, 0]
    bind = made.accessor(np.tile(inverse.T.reshape(16), (2, 1)))
    joints = [made.node("joint", scale=[2, 2, 2]), made.node("joint_2", scale=[2, 2, 2])]
    made.document["skins"] = [{"joints": joints, "inverseBindMatrices": bind}]
    made.node("table_1", mesh=mesh, skin=0, translation=[50, 0, 0])
    return made


def morphed() -> Gltf:
    """A flat table that its default weights raise."""
    made, (vertices, faces) = Gltf(), table()
    mesh = made.mesh(vertices * [1, 0, 1], faces)
    document = made.document["meshes"][mesh]
    document["primitives"][0]["targets"] = [{"POSITION": made.accessor(vertices * [0, 2, 0])}, {"POSITION": made.accessor(vertices)}]
    document["weights"] = [0.5, 0.0]
    made.node("table_1", mesh=mesh)
    return made


def hidden() -> Gltf:
    """The table, and a larger one that is not shown."""
    made = plain()
    made.node("ghost", mesh=0, scale=[9, 9, 9], extensions={"KHR_node_visibility": {"visible": False}})
    return made.use("KHR_node_visibility", is_required=False)


def filmed() -> Gltf:
    """A table below a node with a camera, which moves it."""
    made, (vertices, faces) = Gltf(), table()
    child = made.node("table_1", is_root=False, mesh=made.mesh(vertices * 0.5, faces))
    made.node("camera", camera=0, children=[child], scale=[2, 2, 2])
    made.document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    return made


def embedded() -> Gltf:
    """A buffer as text."""
    made = plain()
    text = base64.b64encode(made.binary).decode()
    for view in made.document["bufferViews"]:
        view["buffer"] = 1
    made.document["buffers"] = [{"byteLength": len(made.binary), "uri": f"data:application/octet-stream;base64,{text}"}]
    made.binary = b""
    return made


def mirrored() -> Gltf:
    """A node that mirrors the table: its faces still look outward."""
    made = plain()
    made.document["nodes"][0]["scale"] = [-1, 1, 1]
    return made


TABLES: dict[str, Callable[[], Gltf]] = {
    "plain": plain, "not indexed": not_indexed, "strip": stripped, "fan": fanned, "shorts": quantized,
    "unsigned shorts": lambda: quantized("u2"), "bytes": lambda: quantized("i1"), "whole shorts": lambda: quantized("i2", False),
    "sparse": sparse, "draco": draco, "meshopt": meshopt, "meshopt of Khronos": lambda: meshopt("KHR_meshopt_compression"),
    "meshopt exponents": lambda: meshopt(filter_="EXPONENTIAL"), "skin": skinned, "morph": morphed, "hidden": hidden, "camera": filmed,
    "base64": embedded, "mirrored": mirrored,
}  # fmt: skip
"""The same table by features of glTF."""

TOLERANCES = {"bytes": 0.02, "draco": 1e-4, "shorts": 1e-4, "unsigned shorts": 1e-4, "whole shorts": 1e-4, "meshopt exponents": 1e-5}
"""Largest shift of a vertex where numbers are stored coarsely [m]; elsewhere it is that of floats."""


def instanced(name: str = "chair_1") -> Gltf:
    """A node with four instances, turned and scaled, next to a table."""
    made = plain()
    attributes = {
        "TRANSLATION": made.accessor(np.array([[-2, 0, 1], [0, 0, 2], [2, 0, 1], [0, 0, -2]])),
        "ROTATION": made.accessor(np.array([[0, 0, 0, 127], [0, 90, 0, 90], [0, 0, 0, 127], [0, 0, 0, 127]]), "i1", normalized=True),
        "SCALE": made.accessor(np.array([[1, 1, 1], [1, 1, 1], [1, 2, 1], [1, 1, 1]])),
    }
    mesh = made.mesh(*box((0.4, 0.9, 0.6), (0, 0.45, 0)), name="chair")
    made.node(name, mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}, translation=[0, 0, 0.5])
    return made.use("EXT_mesh_gpu_instancing")


def picture(kind: str = "PNG") -> bytes:
    """The image, gray on its left half and red on its right; 16 x 8 pixels."""
    if kind in KTX2:
        return zlib.decompress(base64.b85decode(KTX2[kind]))
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:, :8], pixels[:, 8:] = GRAY, RED
    packed = io.BytesIO()
    Image.fromarray(pixels).save(
        packed, kind, **({} if kind == "PNG" else {"quality": 100, **({"lossless": True} if kind == "WEBP" else {})})
    )
    return packed.getvalue()


def painted(material: Document, sets: dict[str, Any], image: bytes | None = None, mime: str = "image/png", **texture: Any) -> Gltf:
    """A cube with a material and attributes, each one row for all vertices or a row for each."""
    made = Gltf()
    mesh = made.mesh(*box((1, 1, 1), (0, 0, 0)), material=0)
    attributes = made.document["meshes"][mesh]["primitives"][0]["attributes"]
    for name, rows in sets.items():
        attributes[name] = made.accessor(np.tile(rows, (8, 1)) if np.ndim(rows) == 1 else rows)
    made.document["images"] = [{"bufferView": made.view(picture() if image is None else image), "mimeType": mime}]
    made.document["textures"] = [texture or {"source": 0}]
    made.document["materials"] = [material]
    made.node("cube_1", mesh=mesh)
    return made


def colored_by(**info: Any) -> Document:
    """A material with the image as its base color."""
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **info}}}
