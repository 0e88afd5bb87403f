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

    A root node carries the scale, so geometry and textures stay byte for byte what they were. Parts of the buffer say what they hold.
    """
    x, y, z = (float(v) for v in np.asarray(scale, dtype=np.float64))
    document, binary = open_glb(data, file)
    aim(document)
    nodes = document.setdefault("nodes", [])
    for scene in document.get("scenes", []) if (x, y, z) != (1.0, 1.0, 1.0) else ():
        nodes.append({"name": "scaled", "children": list(scene.get("nodes", [])), "scale": [x, z, y]})
        scene["nodes"] = [len(nodes) - 1]
    return close_glb(document, binary)


def aimed_glb(data: bytes, file: str = "asset.glb") -> bytes:
    """A GLB that says what every part of its buffer holds."""
    return scaled_glb(data, (1.0, 1.0, 1.0), file)


def aim(document: dict[str, Any]) -> None:
    """Say of every part of the buffer whether it holds vertices or indices, where the asset does not (glTF 2.0, 5.11.5)."""
    views, accessors = document.get("bufferViews", []), document.get("accessors", [])
    uses: dict[int, set[int]] = {}
    for mesh in document.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            used = [(accessor, 34962) for accessor in primitive.get("attributes", {}).values()]
            used += [(primitive["indices"], 34963)] if "indices" in primitive else []
            for accessor, target in used:
                if "bufferView" in accessors[accessor]:
                    uses.setdefault(accessors[accessor]["bufferView"], set()).add(target)
    for view, targets in uses.items():
        if len(targets) == 1:
            views[view].setdefault("target", targets.pop())


def node_textures(data: bytes, file: str = "asset.glb") -> dict[str, tuple[bytes, str]]:
    """Base color image of every node whose mesh has one part, by node name: encoded bytes and `png` or `jpg`."""
    document, binary = open_glb(data, file)
    textures = {}
    for node in document.get("nodes", []):
        if "mesh" not in node:
            continue
        primitives = document["meshes"][node["mesh"]].get("primitives", [])
        image = _image_of(document, binary, primitives[0]) if len(primitives) == 1 else None
        if image is not None:
            textures[str(node.get("name", ""))] = image
    return textures


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
