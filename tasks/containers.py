"""GLB containers: opened and closed without decoding, and weighed before anything in them is unpacked."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.unpacking import image_pixels

GLB_MAGIC = b"glTF"
"""What every GLB begins with."""

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_MOST = dict.fromkeys(("nodes", "meshes", "materials", "images", "textures", "scenes"), BUDGET.nodes) | dict.fromkeys(
    ("accessors", "bufferViews"), 8 * BUDGET.nodes
)
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_SHARED = 8
"""How often views, or accessors, may name the same bytes: as often as a vertex has attributes that lie beside one another."""
_NUMBERS = 8
"""Numbers of a vertex: its position, its normal and its place in a texture."""

Document = dict[str, Any]


def open_glb(data: bytes, file: str = "asset.glb") -> tuple[Document, bytes]:
    """The JSON document and the binary chunk of a GLB (glTF 2.0, section 4.4).

    Raises:
        InputError: the bytes are no GLB of version 2, or its JSON is larger or deeper than the budget.
    """
    try:
        magic, version, length = struct.unpack_from("<III", data, 0)
        if magic != _MAGIC or version != 2 or length > len(data):
            raise ValueError(f"magic {magic:#x}, version {version}, length {length} of {len(data)}")
        size, kind = struct.unpack_from("<II", data, 12)
        if kind != _JSON:
            raise ValueError("the first chunk is not JSON")
        if size > BUDGET.glb_json_bytes:
            raise ValueError(f"its JSON is {size} bytes, more than {BUDGET.glb_json_bytes}")
        document = json_value(data[20 : 20 + size])
        if not isinstance(document, dict):
            raise ValueError("the JSON chunk is no object")
        offset, binary = 20 + size, b""
        if offset + 8 <= length:
            size, kind = struct.unpack_from("<II", data, offset)
            binary = data[offset + 8 : offset + 8 + size] if kind == _BIN else b""
    except (struct.error, ValueError) as error:
        raise InputError(file, "container", f"is not a GLB ({error})", "export it again as glTF binary") from error
    return document, binary


def close_glb(document: Document, binary: bytes) -> bytes:
    """A GLB of a JSON document and a binary chunk; inverse of `open_glb`."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    body = binary + b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text
    if body:
        chunks += struct.pack("<II", len(body), _BIN) + body
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks


def weigh_glb(data: bytes, file: str) -> Document:
    """Hold a GLB against the budget by what it declares, its JSON document. Whether it is sound otherwise is for its reader to say.

    Raises:
        InputError: it is no GLB, or would take more than the budget; names what.
    """
    size = int.from_bytes(data[12:16], "little")
    text = data[20 : 20 + size]
    try:
        if data[:4] != b"glTF":
            raise ValueError("does not begin as one")
        if len(text) > BUDGET.glb_json_bytes:
            raise ValueError(f"its JSON is {len(text)} bytes, more than {BUDGET.glb_json_bytes}")
        document = json_value(text.decode("utf-8-sig", "replace"))
    except ValueError as error:
        raise InputError(file, "content", f"is not a readable GLB ({error})", "export it again as glTF binary") from error
    document = document if isinstance(document, dict) else {}
    excess = over_budget(document, data[28 + size :])
    if excess is not None:
        raise InputError(file, *excess)
    return document


def over_budget(document: Document, binary: bytes) -> tuple[str, str, str] | None:
    """What of a GLB would take more than the budget: field, problem and remedy; None when nothing does.

    Values of the wrong kind count as nothing: readers refuse them.
    """
    problems = (problem for check in (_accessors, _tree, _images) for problem in check(document, binary))
    return next(problems, None)


Problems = Iterator[tuple[str, str, str]]


def _accessors(document: Document, binary: bytes) -> Problems:
    """Numbers that are made anew: those that no view holds, and those that lie apart in it, which are copied.

    A loader has bytes of their own for every view and every accessor, however many of them name the same bytes of the file.
    """
    made, views = 0, _listed(document, "bufferViews")
    cut = sum(_whole(view.get("byteLength")) for view in views)
    asked = sum(_whole(accessor.get("count")) * _size(accessor) for accessor in _listed(document, "accessors"))
    is_packed = _is_packed(document)
    for name, count in (("bufferViews", cut), ("accessors", asked)):
        most = BUDGET.zero_bytes + (BUDGET.scene_bytes if is_packed else _SHARED * len(binary))
        if count > most:
            yield name, f"ask for {count} bytes of a file that holds {len(binary)}, more than {most}", "export it again"
    for accessor in _listed(document, "accessors"):
        view = _at(views, accessor.get("bufferView")) if "bufferView" in accessor else None
        if view is None or "byteStride" in view or "sparse" in accessor:
            made += _whole(accessor.get("count")) * _size(accessor)
    most = max(BUDGET.zero_bytes, BUDGET.scene_bytes if is_packed else len(binary))
    if made > most:
        yield "accessors", f"ask for {made} bytes that the file does not hold, more than {most}", "export it again"


def _is_packed(document: Document) -> bool:
    """True if meshes are compressed, so that their numbers take more than the bytes of the file."""
    views = [name for view in _listed(document, "bufferViews") for name in _extensions(view)]
    primitives = [primitive for mesh in _listed(document, "meshes") for primitive in _listed(mesh, "primitives")]
    names = [*views, *(name for primitive in primitives for name in _extensions(primitive))]
    return any(name.endswith(("_meshopt_compression", "_draco_mesh_compression")) for name in names)


def _extensions(holder: Document) -> Document:
    values = holder.get("extensions")
    return values if isinstance(values, dict) else {}


def _times(document: Document, node: Document) -> int:
    """Number of times that a node places its mesh: once, or once for each of its instances."""
    values = _extensions(node).get("EXT_mesh_gpu_instancing")
    attributes = values.get("attributes") if isinstance(values, dict) else None
    if not isinstance(attributes, dict):
        return 1
    accessors = _listed(document, "accessors")
    return max((_whole(_at(accessors, index).get("count")) for index in attributes.values()), default=1)


def _tree(document: Document, binary: bytes) -> Problems:
    """Nodes, how deep they lie, and what they place."""
    for name, most in _MOST.items():
        count = len(_listed(document, name))
        if count > most:
            yield name, f"are {count}, more than {most}", "join the meshes, or split the file"
    nodes, scenes = _listed(document, "nodes"), _listed(document, "scenes")
    seen, placed, edges = set[int](), Counter[int](), 0
    level = [*dict.fromkeys(_indices(_at(scenes, document.get("scene", 0)).get("nodes")))]
    for _ in range(BUDGET.depth):
        if not level:
            break
        edges += len(level)
        for node in (_at(nodes, index) for index in level):
            placed[_whole(node.get("mesh"))] += _times(document, node) if "mesh" in node else 0
        level = [index for index in dict.fromkeys(level) if index not in seen]
        seen.update(level)
        level = [child for index in level for child in dict.fromkeys(_indices(_at(nodes, index).get("children")))]
    if any(index not in seen for index in level):
        yield "nodes", f"lie deeper than {BUDGET.depth} below one another", "flatten the tree of nodes"
    if edges > 2 * BUDGET.nodes:
        yield "nodes", f"are named as children {edges} times, more than {2 * BUDGET.nodes}", "export it again"
    yield from _placed(document, placed)


def _placed(document: Document, placed: Mapping[int, int]) -> Problems:
    """Parts, faces and vertices of meshes that are placed so often, by the meshes' numbers; once, where they are not.

    Every attribute is kept with every placement: the longest counts as the vertices, and all of them as numbers.
    """
    accessors, parts, faces, vertices, numbers = _listed(document, "accessors"), 0, 0, 0, 0
    for index, mesh in enumerate(_listed(document, "meshes")):
        times, primitives = max(placed.get(index, 0), 1), mesh.get("primitives")
        for primitive in primitives if isinstance(primitives, list) else ():
            if not isinstance(primitive, dict):
                continue
            attributes = primitive.get("attributes")
            attributes = attributes if isinstance(attributes, dict) else {}
            corners = _whole(_at(accessors, attributes.get("POSITION")).get("count"))
            count = _whole(_at(accessors, primitive["indices"]).get("count")) if "indices" in primitive else corners
            read = [_at(accessors, value) for value in attributes.values()]
            parts, vertices = parts + times, vertices + times * max((_whole(accessor.get("count")) for accessor in read), default=0)
            numbers += times * sum(_whole(accessor.get("count")) * _width(accessor) for accessor in read)
            faces += times * (count // 3 if primitive.get("mode", 4) == 4 else count)
    if parts > BUDGET.nodes:
        yield "meshes", f"are {parts} parts, as often as they are placed, more than {BUDGET.nodes}", "join the meshes, or split the file"
    if faces > BUDGET.faces:
        yield "faces", f"are {faces}, as often as they are placed, more than {BUDGET.faces}", "decimate the mesh"
    if vertices > BUDGET.vertices:
        yield "vertices", f"are {vertices}, as often as they are placed, more than {BUDGET.vertices}", "decimate the mesh"
    if numbers > _NUMBERS * BUDGET.vertices:
        problem = f"are {numbers} numbers, as often as they are placed, more than {_NUMBERS * BUDGET.vertices}"
        yield "attributes", problem, "leave out those that nothing shows, or decimate the mesh"


def _images(document: Document, binary: bytes) -> Problems:
    """Pixels that the images' heads declare."""
    sizes = list(_image_pixels(document, binary))
    for index, pixels in enumerate(sizes):
        if pixels > BUDGET.pixels:
            yield f"image {index}", f"is {pixels} pixels, more than {BUDGET.pixels}", "shrink it"
    if sum(sizes) > BUDGET.all_pixels:
        yield "images", f"are {sum(sizes)} pixels, more than {BUDGET.all_pixels}", "shrink them"


def _image_pixels(document: Document, binary: bytes) -> Iterator[int]:
    """Pixels of every image; 0 where it does not lie in the file. A view is looked at once, however many images name it."""
    views, known = _listed(document, "bufferViews"), dict[tuple[int, int], int]()
    for image in _listed(document, "images"):
        view, uri = _at(views, image.get("bufferView")), image.get("uri")
        if isinstance(uri, str) and uri.startswith("data:"):
            try:
                yield image_pixels(base64.b64decode(uri.partition("base64,")[2])) or 0
            except (ValueError, binascii.Error):
                yield 0
            continue
        start = _whole(view.get("byteOffset"))
        place = start, start + _whole(view.get("byteLength"))
        if place not in known:
            known[place] = image_pixels(binary[slice(*place)]) or 0
        yield known[place]


def _listed(document: Document, name: str) -> list[Document]:
    """A list of objects; what is none is empty."""
    values = document.get(name)
    return [value if isinstance(value, dict) else {} for value in values] if isinstance(values, list) else []


def _at(values: list[Document], index: Any) -> Document:
    return values[index] if isinstance(index, int) and -len(values) <= index < len(values) else {}


def _indices(values: Any) -> list[int]:
    return [value for value in values if isinstance(value, int)] if isinstance(values, list) else []


def _whole(value: Any) -> int:
    """A count, 0 for what is none."""
    return max(value, 0) if isinstance(value, int) else 0


def _size(accessor: Document) -> int:
    """Bytes of an element."""
    kind = accessor.get("componentType")
    return _SIZES.get(kind, 0) * _width(accessor) if isinstance(kind, int) else 0


def _width(accessor: Document) -> int:
    """Numbers of an element."""
    shape = accessor.get("type")
    return _COUNTS.get(shape, 0) if isinstance(shape, str) else 0
