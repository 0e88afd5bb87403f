"""Small files that ask for much, made in code, and a child with a ceiling of memory to open them in."""

from __future__ import annotations

import gzip
import io
import resource
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tasks.containers import close_glb
from tests.conftest import REPOSITORY

CEILING = 3 * 2**30
"""Address space of a child: libraries that are loaded take 1 GiB of it."""

CPU_SECONDS = 240
"""A backstop: what is refused before it is unpacked takes one of them."""

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")

Document = dict[str, Any]


def document(nodes: list[Document], roots: list[int], **more: Any) -> Document:
    """A glTF of one triangle, mesh 0, in so many nodes."""
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": roots}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36}], **more,
    }  # fmt: skip


def glb(nodes: list[Document], roots: list[int], **more: Any) -> bytes:
    return close_glb(document(nodes, roots, **more), TRIANGLE.tobytes())


def sound() -> bytes:
    return glb([{"mesh": 0, "name": "chair"}], [0])


def without_buffer() -> bytes:
    """556 bytes that ask for 11 GB."""
    return glb([{"mesh": 0}], [0], accessors=[{"componentType": 5126, "count": 900_000_000, "type": "VEC3"}])


def placed(times: int = 1000, faces: int = 100_000) -> bytes:
    """One mesh, many times."""
    indices = np.tile(np.arange(3, dtype="<u2"), faces)
    made = document([{"mesh": 0, "name": f"chair {i}"} for i in range(times)], list(range(times)))
    made["meshes"][0]["primitives"][0]["indices"] = 1
    made["accessors"].append({"bufferView": 1, "componentType": 5123, "count": len(indices), "type": "SCALAR"})
    made["bufferViews"].append({"buffer": 0, "byteOffset": 36, "byteLength": indices.nbytes})
    made["buffers"][0]["byteLength"] += indices.nbytes
    return close_glb(made, TRIANGLE.tobytes() + indices.tobytes())


def vertices_placed(count: int = 100_000, times: int = 2000) -> bytes:
    """A mesh of one triangle and many corners that no triangle has."""
    held = np.zeros((count, 3), dtype="<f4")
    held[:3] = TRIANGLE
    made = document([{"mesh": 0, "name": f"chair {i}"} for i in range(times)], list(range(times)))
    made["accessors"][0]["count"] = count
    made["meshes"][0]["primitives"][0]["indices"] = 1
    made["accessors"].append({"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"})
    made["bufferViews"] = [{"buffer": 0, "byteLength": held.nbytes}, {"buffer": 0, "byteOffset": held.nbytes, "byteLength": 6}]
    made["buffers"][0]["byteLength"] = held.nbytes + 8
    return close_glb(made, held.tobytes() + np.arange(4, dtype="<u2").tobytes())


def shared_bytes(accessors: int = 500) -> bytes:
    """Many accessors that each copy the same bytes, which lie apart."""
    held = np.zeros((400_000, 3), dtype="<f4")
    made = document([{"mesh": 0}], [0])
    made["bufferViews"] = [{"buffer": 0, "byteLength": held.nbytes, "byteStride": 12}]
    made["buffers"][0]["byteLength"] = held.nbytes
    made["accessors"] += [{"bufferView": 0, "componentType": 5126, "count": 400_000, "type": "VEC3"} for _ in range(accessors)]
    return close_glb(made, held.tobytes())


def views_of_one_buffer(views: int = 200, plain: bool = False, size: int = 8_000_000) -> bytes:
    """Many views of the same bytes, or many accessors of the same view, none of which lie apart."""
    made = document([{"mesh": 0}], [0])
    made["bufferViews"] = [{"buffer": 0, "byteLength": size}] * (1 if plain else views)
    made["buffers"][0]["byteLength"] = size
    if plain:
        made["accessors"] += [{"bufferView": 0, "componentType": 5126, "count": size // 4, "type": "SCALAR"}] * views
    return close_glb(made, TRIANGLE.tobytes().ljust(size, b"\0"))


def attribute_placed(name: str = "TEXCOORD_0", count: int = 1_000_000, times: int = 200, names: int = 1) -> bytes:
    """A triangle with an attribute, or the same one under many names, that is longer than its corners, placed many times."""
    made = document([{"mesh": 0, "name": f"chair {i}"} for i in range(times)], list(range(times)))
    attributes = made["meshes"][0]["primitives"][0]["attributes"]
    attributes.update({f"{name}{i or ''}": 1 for i in range(names)})
    made["meshes"][0]["primitives"][0]["material"] = 0
    made["materials"] = [{}]
    made["accessors"].append({"bufferView": 1, "componentType": 5126, "count": count, "type": "VEC2"})
    made["bufferViews"].append({"buffer": 0, "byteOffset": 36, "byteLength": 8 * count})
    made["buffers"][0]["byteLength"] += 8 * count
    return close_glb(made, TRIANGLE.tobytes() + bytes(8 * count))


def nested(count: int = 50_000) -> bytes:
    return glb([{"mesh": 0, "children": [i + 1]} for i in range(count - 1)] + [{"mesh": 0}], [0])


def many_nodes(count: int = 300_000) -> bytes:
    return glb([{"mesh": 0} for _ in range(count)], list(range(count)))


def many_parents(parents: int = 2000, primitives: int = 100) -> bytes:
    """A node with many parents: its mesh is placed under each of them."""
    nodes = [{"children": [parents]} for _ in range(parents)] + [{"mesh": 0}]
    return glb(nodes, list(range(parents)), meshes=[{"primitives": [{"attributes": {"POSITION": 0}}] * primitives}])


def png(side: int) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.new("L", (side, side)).save(out, format="PNG")
    return out.getvalue()


def textured(image: bytes, material: Any = None, images: int = 1) -> bytes:
    """A triangle with an image."""
    made = document([{"mesh": 0, "name": "chair"}], [0])
    uv = np.array([[0, 0], [1, 0], [0, 1]], dtype="<f4").tobytes()
    made["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": i}]} for i in range(images)]
    made["nodes"] = [{"mesh": i, "name": f"chair {i}"} for i in range(images)]
    made["scenes"] = [{"nodes": list(range(images))}]
    made["accessors"].append({"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"})
    made["bufferViews"] += [{"buffer": 0, "byteOffset": 36, "byteLength": 24}, {"buffer": 0, "byteOffset": 60, "byteLength": len(image)}]
    made["buffers"][0]["byteLength"] = 60 + len(image)
    made["images"] = [{"bufferView": 2, "mimeType": "image/png"} for _ in range(images)]
    made["textures"] = [{"source": i} for i in range(images)]
    made["materials"] = [material or {"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}} for i in range(images)]
    return close_glb(made, TRIANGLE.tobytes() + uv + image)


def large_texture() -> bytes:
    return textured(png(13_000))


def many_textures() -> bytes:
    """Each within the bounds, all of them not."""
    return textured(png(8_000), images=20)


def deep_extras() -> bytes:
    made = sound()
    return made.replace(b'"name":"chair"', b'"extras":' + b"[" * 100_000 + b"]" * 100_000)


def deep_json() -> bytes:
    """A GLB whose JSON is nested as deeply as its parser lets through, and no deeper."""
    text = b'{"asset":{"version":"2.0"},"extras":' + b"[" * 900 + b"]" * 900 + b"}"
    text += b" " * (-len(text) % 4)
    return b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, 20 + len(text), len(text), 0x4E4F534A)) + text


GLB_BOMBS: dict[str, Callable[[], bytes]] = {
    "accessor without buffer": without_buffer, "mesh placed 1,000 times": placed, "vertices placed 2,000 times": vertices_placed,
    "bytes shared by 500 accessors": shared_bytes, "50,000 nested nodes": nested, "300,000 nodes": many_nodes,
    "node with 2,000 parents": many_parents, "texture of 13,000 pixels": large_texture, "20 textures": many_textures,
    "nested JSON": deep_json, "200 views of one buffer": views_of_one_buffer,
    "200 accessors of one view": lambda: views_of_one_buffer(plain=True), "attribute placed 200 times": attribute_placed,
    "attribute under 300 names": lambda: attribute_placed("_A", times=2, names=300),
}  # fmt: skip
"""GLBs that ask for more than the budget has."""


def json_bomb() -> bytes:
    """Half a megabyte of gzip that holds half a gigabyte of JSON."""
    return gzip.compress(b"[" + b"{}," * 60_000_000 + b"{}]", 1)


def zero_bomb() -> bytes:
    """Six megabytes of gzip that hold 6 GB."""
    packed = gzip.compress(bytes(100_000_000), 9)
    return packed * 60


def navmesh_bomb(polygons: int = 20_000) -> bytes:
    """A navmesh of two tiles whose polygons all lie on one another."""
    vertices = TRIANGLE[:, [0, 2, 1]].tobytes()
    polygon = struct.pack("<I6H6HHBB", 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 3, 0)
    head = struct.pack("<ii", 0x444E4156, 7) + bytes(16) + struct.pack("<ii", polygons, 3)
    tile = head.ljust(100, b"\0") + vertices + polygon * polygons
    return struct.pack("<4sii", b"TESM", 1, 2).ljust(40, b"\0") + (struct.pack("<Ii", 0, len(tile)) + tile) * 2


def below_ceiling(code: str, *arguments: str | Path) -> str:
    """What Python code prints in a process that may not take more than `CEILING`; fails when the process does."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (CEILING, CEILING))
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))

    command = [sys.executable, "-c", code, *map(str, arguments)]
    ended = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, preexec_fn=limit)
    assert ended.returncode == 0, f"{ended.returncode}: {ended.stdout[-1000:]} {ended.stderr[-2000:]}"
    return ended.stdout
