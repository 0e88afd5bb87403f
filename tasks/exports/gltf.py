"""GLB containers opened without decoding: scale a whole file, take its textures out as they are.

A texture that is decoded and encoded again costs time and, as JPEG, quality; nothing here does that.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from schemas.errors import InputError

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_EXTENSIONS = {"image/png": "png", "image/jpeg": "jpg"}


def open_glb(data: bytes, file: str = "asset.glb") -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary chunk of a GLB (glTF 2.0, section 4.4).

    Raises:
        InputError: the bytes are no GLB of version 2.
    """
    try:
        magic, version, length = struct.unpack_from("<III", data, 0)
        if magic != _MAGIC or version != 2 or length > len(data):
            raise ValueError(f"magic {magic:#x}, version {version}, length {length} of {len(data)}")
        size, kind = struct.unpack_from("<II", data, 12)
        if kind != _JSON:
            raise ValueError("the first chunk is not JSON")
        document = json.loads(data[20 : 20 + size])
        if not isinstance(document, dict):
            raise ValueError("the JSON chunk is no object")
        offset, binary = 20 + size, b""
        if offset + 8 <= length:
            size, kind = struct.unpack_from("<II", data, offset)
            binary = data[offset + 8 : offset + 8 + size] if kind == _BIN else b""
    except (struct.error, ValueError) as error:
        raise InputError(file, "container", f"is not a GLB ({error})", "export it again as glTF binary") from error
    return document, binary


def close_glb(document: dict[str, Any], binary: bytes) -> bytes:
    """A GLB of a JSON document and a binary chunk; inverse of `open_glb`."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    body = binary + b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text
    if body:
        chunks += struct.pack("<II", len(body), _BIN) + body
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks


def scaled_glb(data: bytes, scale: ArrayLike, file: str = "asset.glb") -> bytes:
    """A canonical asset's GLB, scaled along the asset's own axes (x, y, z with +Z up), shape (3,).

    A root node carries the scale, so geometry and textures stay byte for byte what they were.
    """
    x, y, z = (float(v) for v in np.asarray(scale, dtype=np.float64))
    if (x, y, z) == (1.0, 1.0, 1.0):
        return data
    document, binary = open_glb(data, file)
    nodes = document.setdefault("nodes", [])
    for scene in document.get("scenes", []):
        nodes.append({"name": "scaled", "children": list(scene.get("nodes", [])), "scale": [x, z, y]})
        scene["nodes"] = [len(nodes) - 1]
    return close_glb(document, binary)


def node_textures(data: bytes, file: str = "asset.glb") -> dict[str, tuple[bytes, str]]:
    """Base color image of every node whose mesh has one part, by node name: encoded bytes and `png` or `jpg`."""
    document, binary = open_glb(data, file)
    found = {}
    for node in document.get("nodes", []):
        if "mesh" not in node:
            continue
        primitives = document["meshes"][node["mesh"]].get("primitives", [])
        image = _image_of(document, binary, primitives[0]) if len(primitives) == 1 else None
        if image is not None:
            found[str(node.get("name", ""))] = image
    return found


def _image_of(document: dict[str, Any], binary: bytes, primitive: dict[str, Any]) -> tuple[bytes, str] | None:
    """Encoded base color image of a primitive's material, where it lies inside the file."""
    try:
        material = document["materials"][primitive["material"]]
        texture = document["textures"][material["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
        image = document["images"][texture["source"]]
        view = document["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        return binary[start : start + view["byteLength"]], _EXTENSIONS[image["mimeType"]]
    except (KeyError, IndexError, TypeError):
        return None
