"""Make a plain GLB of any: triangles of floats, one set of texture coordinates, PNG and JPEG images, no extension that matters.

Every reader loads the plain GLB. A file that is plain already stays byte for byte as it is.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import io
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from schemas.errors import InputError
from tasks.containers import close_glb, over_budget, weigh_glb
from tasks.geometry.colors.gltf import numbers_of
from tasks.geometry.gltf.arrays import Array, Arrays, ArrayWriter, Floats, natural
from tasks.geometry.gltf.decoding import decoded_accessors, decoded_views
from tasks.geometry.gltf.features import (
    DRACO,
    GLOSS,
    IMAGE_EXTENSIONS,
    INSTANCING,
    MESHOPT,
    TRANSFORM,
    VISIBILITY,
    Document,
    check_features,
    entries,
    find_features,
)
from tasks.geometry.gltf.images import REPEAT
from tasks.geometry.gltf.looks import PlainLook, PlainLooks
from tasks.geometry.gltf.posing import PosedMesh, joint_poses, morphed, plain_tree, skinned
from tasks.geometry.plain_glb import read_plain

_REWRITTEN = {DRACO, GLOSS, INSTANCING, TRANSFORM, VISIBILITY, "KHR_mesh_quantization", *MESHOPT, *IMAGE_EXTENSIONS}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_BROKEN = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, ArithmeticError, struct.error)


@dataclasses.dataclass(frozen=True)
class PlainGlb:
    """A GLB that every loader reads alike. data: the file. document: its JSON. notes: features that are not read, a line each."""

    data: bytes
    document: Document
    notes: tuple[str, ...] = ()


def read_features(data: bytes, file: str = "mesh.glb") -> PlainGlb:
    """The plain GLB of a file of others, with notes on the features that are not read.

    Raises:
        InputError: it is not a GLB, would take more than the budget, or uses a feature without which its geometry would be wrong.
    """
    document = weigh_glb(data, file)
    return PlainGlb(data, document) if read_plain(data, document) is not None else plain_glb(data, document, file)


def plain_glb(data: bytes, document: Document, file: str) -> PlainGlb:
    """The plain GLB of a file, and notes on the features that are not read.

    Args:
        data: the file, checked against the budget.
        document: its JSON.
        file: its name, for messages.

    Raises:
        InputError: a feature is refused, compressed contents cannot be decoded, or the file contradicts itself.
    """
    notes = check_features(document, file)
    length = int.from_bytes(data[12:16], "little")
    binary = data[28 + length :]
    try:
        reasons = tuple(_special_features(document, binary))
    except _BROKEN:
        reasons = ("a broken value",)
    if not reasons:
        return PlainGlb(data, document, notes)
    try:
        return _rewritten(document, binary, notes, file)
    except InputError:
        raise
    except _BROKEN as error:
        problem = f"is not a readable GLB ({type(error).__name__}: {error})"[:300]
        raise InputError(file, "content", problem, "export it again as glTF binary") from error


def is_encoded(document: Document) -> bool:
    """True if a file uses an extension that is decoded or applied."""
    return any(entry.feature.name in _REWRITTEN for entry in find_features(document))


def _special_features(document: Document, binary: bytes) -> Iterator[str]:
    """Features that the general loader reads otherwise than stated, or not at all."""
    yield from (entry.feature.name for entry in find_features(document) if entry.feature.name in _REWRITTEN)
    buffers, accessors, meshes = (entries(document, key) for key in ("buffers", "accessors", "meshes"))
    if len(buffers) > 1 or any("uri" in entry for entry in buffers):
        yield "buffers"
    for node in entries(document, "nodes"):
        if "skin" in node or "camera" in node or any(node.get("weights", ())):
            yield "nodes"
        if not node.get("name") and "mesh" in node and meshes[natural(node["mesh"])].get("name"):
            yield "names of meshes"
    for mesh in meshes:
        if any(mesh.get("weights", ())):
            yield "morph targets"
        for primitive in entries(mesh, "primitives"):
            attributes = primitive["attributes"]
            if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
                yield "primitives"
            if "COLOR_0" in attributes and any(_is_mixed(material) for material in _materials_of(document, primitive)):
                yield "vertex colors"
            named = [accessors[natural(attributes[key])] for key in attributes if key.startswith(("POSITION", "NORMAL", "TEXCOORD"))]
            named += [entry for key in ("COLOR_0",) if key in attributes and not _is_color(entry := accessors[natural(attributes[key])])]
            indices = [accessors[natural(primitive["indices"])]] if "indices" in primitive else []
            if any(entry.get("componentType") != 5126 for entry in named) or any("sparse" in entry for entry in (*named, *indices)):
                yield "numbers"
            if len({entry.get("count") for entry in named}) > 1:
                yield "attributes of different lengths"
            if any(_is_looked_up(material, attributes) for material in _materials_of(document, primitive)):
                yield "textures"
    if any(key in entry for entry in entries(document, "samplers") for key in ("wrapS", "wrapT") if entry.get(key, REPEAT) != REPEAT):
        yield "samplers"
    yield from ("textures" for texture in entries(document, "textures") if "source" not in texture)
    yield from ("images" for image in entries(document, "images") if not _is_plain_image(document, image, binary))


def _is_color(accessor: Document) -> bool:
    """True for colors that are floats, or normalized bytes."""
    return accessor.get("componentType") == 5126 or (accessor.get("componentType") == 5121 and accessor.get("normalized") is True)


def _materials_of(document: Document, primitive: Document) -> list[dict[str, Any]]:
    return [entries(document, "materials")[natural(primitive["material"])]] if "material" in primitive else []


def _is_looked_up(material: Document, attributes: Document) -> bool:
    """True for textures at coordinates other than the first, or at coordinates that the mesh lacks."""
    plain = material.get("pbrMetallicRoughness", {})
    infos = [value for holder in (material, plain) for key, value in holder.items() if key.endswith("Texture")]
    return any(info.get("texCoord", 0) != 0 or "TEXCOORD_0" not in attributes for info in infos)


def _is_mixed(material: Document) -> bool:
    """True for a material that changes vertex colors, or has textures next to them."""
    plain = material.get("pbrMetallicRoughness", {})
    factor = numbers_of(plain.get("baseColorFactor", [1.0] * 4), 4)
    is_textured = any(key.endswith("Texture") for holder in (material, plain) for key in holder)
    return is_textured or factor is None or bool((factor != 1.0).any())


def _is_plain_image(document: Document, image: Document, binary: bytes) -> bool:
    """True for a PNG or JPEG image in the file's own chunk."""
    from PIL import Image

    if "bufferView" not in image:
        return False
    view = entries(document, "bufferViews")[natural(image["bufferView"])]
    start = natural(view.get("byteOffset", 0))
    try:
        with Image.open(io.BytesIO(binary[start : start + natural(view["byteLength"])])) as opened:
            return opened.format in ("PNG", "JPEG")
    except Exception:  # the decoder raises whatever the bytes lead it to
        return False


def _contents(document: Document, binary: bytes) -> list[bytes]:
    """Contents of each buffer: the file's own chunk, base64 text, or nothing for one that only stands in for compressed data."""
    contents = []
    for index, buffer in enumerate(entries(document, "buffers")):
        uri = buffer.get("uri")
        if isinstance(uri, str):
            contents.append(base64.b64decode(uri.partition("base64,")[2], validate=False))
        else:
            contents.append(binary if index == 0 else b"")
    return contents


def _rewritten(document: Document, binary: bytes, notes: tuple[str, ...], file: str) -> PlainGlb:
    try:
        buffers = _contents(document, binary)
    except binascii.Error as error:
        raise InputError(file, "buffers", f"have no readable base64 ({error})", "export it again as glTF binary") from error
    arrays = Arrays(document, buffers, decoded_views(document, buffers, file), {})
    arrays = Arrays(document, buffers, arrays.decoded, decoded_accessors(document, arrays, file))
    writer = ArrayWriter()
    looks = PlainLooks(document, arrays, writer, file)
    tree = plain_tree(document, arrays)
    meshes: list[dict[str, Any]] = []
    numbers: dict[PosedMesh, int | None] = {}
    for index, shape in tree.shapes.items():
        if shape not in numbers:
            mesh = _mesh(document, shape, arrays, writer, looks)
            numbers[shape] = len(meshes) if mesh["primitives"] else None
            meshes += [mesh] if mesh["primitives"] else []
        if numbers[shape] is not None:
            tree.nodes[index]["mesh"] = numbers[shape]
    chunk = writer.binary()
    plain: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": tree.roots}], "nodes": tree.nodes, "meshes": meshes,
        "materials": looks.materials, "textures": looks.textures, "images": looks.images, "accessors": writer.accessors,
        "bufferViews": writer.views, "buffers": [{"byteLength": len(chunk)}] if chunk else [],
    }  # fmt: skip
    plain = {key: value for key, value in plain.items() if value != []}
    if any("extensions" in material for material in looks.materials):
        plain["extensionsUsed"] = ["KHR_materials_unlit"]
    excess = over_budget(plain, chunk)
    if excess is not None:
        raise InputError(file, *excess)
    return PlainGlb(close_glb(plain, chunk), plain, (*notes, *looks.notes))


def _mesh(document: Document, shape: PosedMesh, arrays: Arrays, writer: ArrayWriter, looks: PlainLooks) -> dict[str, Any]:
    """A mesh as a node shows it, with plain primitives; those without triangles are left out."""
    mesh = entries(document, "meshes")[shape.mesh]
    joints = None if shape.skin is None else joint_poses(document, shape.skin, arrays)
    name, primitives = str(mesh.get("name", shape.mesh)), []
    for primitive in entries(mesh, "primitives"):
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            continue
        attributes = _attributes(primitive, shape.weights, arrays, looks)
        positions = attributes.pop("POSITION")
        if positions.shape[1] != 3:
            raise ValueError(f"mesh {name} has positions of {positions.shape[1]} numbers")
        if "indices" in primitive:
            corners = arrays.raw(natural(primitive["indices"]))[:, 0]
            if corners.dtype.kind != "u":
                raise ValueError(f"mesh {name} has indices that are not whole numbers")
        else:
            corners = np.arange(len(positions), dtype=np.uint32)
        faces = triangles_of(corners, mode)
        if len(faces) and faces.max() >= len(positions):
            raise ValueError(f"mesh {name} has triangles of vertices that are not there")
        if not len(faces):
            continue
        if joints is not None:
            positions = skinned(positions, attributes, joints)
        fitting = {key: values for key, values in attributes.items() if len(values) == len(positions)}
        looks.note_misfits(sorted(set(attributes) - set(fitting)), name)
        look = looks.of(primitive, fitting, faces, name)
        is_rigid = joints is None and not shape.weights
        primitives.append(_written(positions, faces, fitting.get("NORMAL") if is_rigid else None, look, writer))
    return {"primitives": primitives} | ({"name": mesh["name"]} if isinstance(mesh.get("name"), str) else {})


def _attributes(primitive: Document, weights: tuple[float, ...], arrays: Arrays, looks: PlainLooks) -> dict[str, Floats]:
    """Attributes of a primitive as numbers, morph targets applied, shape (n, width) each."""
    targets = primitive.get("targets", []) if weights else []
    numbers = {
        key: looks.colors(index) if key == "COLOR_0" else arrays.numbers(natural(index))
        for key, index in primitive["attributes"].items()
        if not key.startswith("_")
    }
    return {key: morphed(values, targets, key, weights, arrays) for key, values in numbers.items()}


def triangles_of(corners: Array, mode: int) -> Array:
    """Vertices of the triangles of a primitive, shape (m, 3) uint32; triangles with a vertex twice are left out of strips and fans.

    corners: vertices in their order, shape (k,). mode: 4 triangles, 5 strip, 6 fan (glTF 2.0, 3.7.2.1).
    """
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3).astype(np.uint32)
    count = max(len(corners) - 2, 0)
    if mode == _FAN:
        faces = np.column_stack([corners[1 : count + 1], corners[2 : count + 2], np.repeat(corners[:1], count)])
    else:
        first = np.arange(count)
        faces = np.column_stack([corners[first], corners[first + 1 + first % 2], corners[first + 2 - first % 2]])
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)].astype(np.uint32)


def _written(positions: Floats, faces: Array, normals: Floats | None, look: PlainLook, writer: ArrayWriter) -> dict[str, Any]:
    """A primitive of the new document."""
    attributes = {"POSITION": writer.accessor(positions.astype("<f4"))}
    if normals is not None and normals.shape[1] == 3:
        attributes["NORMAL"] = writer.accessor(normals.astype("<f4"))
    if look.uv is not None and look.uv.shape[1] == 2:
        attributes["TEXCOORD_0"] = writer.accessor(look.uv.astype("<f4"))
    if look.colors is not None:
        attributes["COLOR_0"] = writer.accessor(look.colors.astype("<f4"))
    primitive: dict[str, Any] = {"attributes": attributes, "indices": writer.accessor(faces.reshape(-1, 1).astype("<u4"), is_index=True)}
    return primitive | ({} if look.material is None else {"material": look.material})
