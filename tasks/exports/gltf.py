"""GLBs changed without decoding: scale a whole file, take its textures out as they are.

A texture that is decoded and encoded again costs time and, as JPEG, quality; nothing here does that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tasks.containers import close_glb, open_glb

_EXTENSIONS = {"image/png": "png", "image/jpeg": "jpg"}


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
