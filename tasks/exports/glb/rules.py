"""Whether a GLB of a scene can be loaded as it is meant (glTF 2.0). Works on anybody's GLB.

What glTF allows, but makes a scene less useful to a simulator, is a warning.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.containers import GLB_MAGIC, open_glb, over_budget
from tasks.exports.findings import Finding
from tasks.exports.glb.tree import Document, listed, roots_of, seen_of, tree
from tasks.geometry.gltf.features import MAX_MODE, find_features
from tasks.geometry.gltf.plain import is_encoded, plain_glb

RULES: dict[str, str] = {
    "container": "the file is a GLB of version 2 whose JSON says so",
    "budget": "opening it takes no more memory, pixels, faces, nodes and depth than a budget allows",
    "features": "every feature that the file uses is read as it states it",
    "shape": "every value is of the kind that glTF has there",
    "references": "everything that is named by its number is there",
    "buffers": "buffers lie inside the file, views inside buffers, accessors inside views and at multiples of their numbers' size",
    "geometry": "positions are finite and within the bounds stated, corners are vertices that exist, objects have any at all",
    "images": "images lie inside the file and can be read",
    "tree": "nodes make trees, and the scene is made of their roots",
    "names": "every object at the top has a name of its own",
    "rigid_pose": "rotations are quaternions of length 1, matrices turn and scale only, numbers are finite, scales above zero",
    "mass": "masses that are stated are above zero, inertias are those that a solid can have",
    "labels": "every node at the top says what it is",
}
"""Every rule, and what holds when it passes."""

_REFERENCES = (
    ("nodes", "mesh", "meshes"), ("textures", "source", "images"), ("textures", "sampler", "samplers"),
    ("accessors", "bufferView", "bufferViews"), ("bufferViews", "buffer", "buffers"), ("images", "bufferView", "bufferViews"),
)  # fmt: skip
_LISTS = (
    "accessors", "bufferViews", "buffers", "images", "materials", "meshes", "nodes", "samplers", "scenes", "textures",
)  # fmt: skip
_FARTHEST = 1e30  # no number of a scene is larger, and its square still is a number
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def check_glb(path: Path) -> list[Finding]:
    """Everything that is wrong with a GLB, sorted; empty for one that can be used as it is."""
    try:
        data = read_file(path, path.name, BUDGET.scene_bytes, magic=GLB_MAGIC)
        document, binary = open_glb(data, path.name)
    except (InputError, OSError, RecursionError) as error:
        return [Finding("container", path.name, " ".join(str(error).split()))]
    version = document.get("asset", {}).get("version") if isinstance(document.get("asset"), dict) else None
    if version != "2.0":
        return [Finding("container", path.name, f"asset.version is {version!r}, not '2.0'")]
    excess = over_budget(document, binary)
    if excess is not None:
        return [Finding("budget", f"{path.name} {excess[0]}", excess[1])]
    findings = list(_shape(path.name, document))
    is_shaped = not findings
    findings += _features(path.name, document)
    if not is_shaped:
        return sorted(set(findings))
    # The other rules look into arrays and images, so they look at the decoded file.
    if is_encoded(document):
        try:
            plain = plain_glb(data, document, path.name)
        except InputError as error:
            return sorted({*findings, Finding("features", f"{path.name} {error.field}", error.problem)})
        found_texts = {entry.text for entry in find_features(document)}
        notes = [note.removeprefix(f"{path.name}: ") for note in plain.notes]
        findings += [Finding("features", path.name, note, False) for note in notes if note not in found_texts]
        document, binary = open_glb(plain.data, path.name)
    for check in (_references, _buffers, _geometry, _images, tree, _poses, _labels):
        broken = list(check(path.name, document, binary))
        findings += broken
        if broken and check in (_references, _buffers):
            break  # what follows goes along references, into buffers
    return sorted(set(findings))


def _features(file: str, document: Document) -> Iterator[Finding]:
    """Features that readers refuse, and, as warnings, those that they do not read."""
    for entry in find_features(document):
        if entry.feature.treatment != "read":
            yield Finding("features", f"{file} {entry.feature.name}", entry.text, entry.feature.treatment == "refused")


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _shape(file: str, document: Document) -> Iterator[Finding]:
    """Lists of objects, numbers where numbers are: all that the other rules take for granted."""
    for name in _LISTS:
        values = document.get(name, [])
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            yield Finding("shape", f"{file} {name}", "is no list of objects")
            return
    for kind, key, _ in _REFERENCES:
        for i, value in enumerate(listed(document, kind)):
            if key in value and not _is_index(value[key]):
                yield Finding("shape", f"{file} {kind} {i}", f"{key} is {value[key]!r}, no index")
    for kind, keys in (("bufferViews", ("byteOffset", "byteLength", "byteStride")), ("accessors", ("byteOffset", "count", "componentType")),
                       ("buffers", ("byteLength",))):  # fmt: skip
        for i, value in enumerate(listed(document, kind)):
            for key in keys:
                if not _is_index(value.get(key, 0)) or (key in ("byteLength", "count", "componentType") and key not in value):
                    yield Finding("shape", f"{file} {kind} {i}", f"{key} is {value.get(key)!r}, no number of bytes or elements")
    for i, accessor in enumerate(listed(document, "accessors")):
        if not isinstance(accessor.get("type"), str):
            yield Finding("shape", f"{file} accessors {i}", f"type is {accessor.get('type')!r}, no text")
    for i, node in enumerate(listed(document, "nodes")):
        for key, count in (("translation", 3), ("rotation", 4), ("scale", 3), ("matrix", 16)):
            if key in node and not _are_numbers(node[key], count):
                yield Finding("rigid_pose", f"{file} node {node.get('name', i)}", f"{key} is not {count} finite numbers")
        if not _are_indices(node.get("children", [])):
            yield Finding("shape", f"{file} node {node.get('name', i)}", "children are no indices")
    for i, scene in enumerate(listed(document, "scenes")):
        if not _are_indices(scene.get("nodes", [])):
            yield Finding("shape", f"{file} scene {i}", "nodes are no indices")
    if "scene" in document and not _is_index(document["scene"]):
        yield Finding("shape", f"{file} scene", "is no index")
    for i, mesh in enumerate(listed(document, "meshes")):
        where, primitives = f"{file} mesh {mesh.get('name', i)}", mesh.get("primitives")
        if not isinstance(primitives, list) or not primitives:
            yield Finding("shape", where, "has no primitives")
            continue
        for primitive in primitives:
            attributes = primitive.get("attributes") if isinstance(primitive, dict) else None
            fine = isinstance(attributes, dict) and "POSITION" in attributes and all(map(_is_index, attributes.values()))
            if not fine or not all(_is_index(primitive.get(key, 0)) for key in ("indices", "material", "mode")):
                yield Finding("shape", where, "a primitive has no POSITION, or what is no index")
            elif primitive.get("mode", 0) > MAX_MODE:
                yield Finding("shape", where, f"a primitive has the mode {primitive['mode']!r:.20}, above {MAX_MODE}")
    yield from _material_shapes(file, document)


def _material_shapes(file: str, document: Document) -> Iterator[Finding]:
    """What is read of a material."""
    for i, material in enumerate(listed(document, "materials")):
        where, plain = f"{file} material {material.get('name', i)}", material.get("pbrMetallicRoughness", {})
        if not isinstance(plain, dict):
            yield Finding("shape", where, "pbrMetallicRoughness is no object")
        elif "baseColorFactor" in plain and not _are_numbers(plain["baseColorFactor"], 4):
            yield Finding("shape", where, "baseColorFactor is not 4 finite numbers")


def _are_numbers(values: Any, count: int) -> bool:
    """Whether a value is so many finite numbers."""
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _FARTHEST for value in values)


def _are_indices(values: Any) -> bool:
    return isinstance(values, list) and all(map(_is_index, values))


def _references(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    for kind, key, target in _REFERENCES:
        count = len(listed(document, target))
        for i, value in enumerate(listed(document, kind)):
            if key in value and value[key] >= count:
                yield Finding("references", f"{file} {kind} {value.get('name', i)}", f"{key} {value[key]} of {count} {target}")
    counts = {name: len(listed(document, name)) for name in _LISTS}
    for i, mesh in enumerate(listed(document, "meshes")):
        for primitive in mesh["primitives"]:
            named = [("accessors", value) for value in primitive["attributes"].values()]
            named += [(kind, primitive[key]) for key, kind in (("indices", "accessors"), ("material", "materials")) if key in primitive]
            for kind, value in named:
                if value >= counts[kind]:
                    yield Finding("references", f"{file} mesh {mesh.get('name', i)}", f"names {value} of {counts[kind]} {kind}")
    for i, material in enumerate(listed(document, "materials")):
        for value in _textures(material):
            if not _is_index(value) or value >= counts["textures"]:
                yield Finding(
                    "references", f"{file} material {material.get('name', i)}", f"names {value!r} of {counts['textures']} textures"
                )
    for i, node in enumerate(listed(document, "nodes")):
        for child in node.get("children", []):
            if child >= counts["nodes"]:
                yield Finding("references", f"{file} node {node.get('name', i)}", f"child {child} of {counts['nodes']} nodes")
    for i, scene in enumerate(listed(document, "scenes")):
        for root in scene.get("nodes", []):
            if root >= counts["nodes"]:
                yield Finding("references", f"{file} scene {i}", f"node {root} of {counts['nodes']} nodes")
    if not counts["scenes"] or document.get("scene", 0) >= counts["scenes"]:
        yield Finding("references", f"{file} scene", f"scene {document.get('scene', 0)} of {counts['scenes']}")


def _textures(value: Any) -> Iterator[Any]:
    """Numbers of the textures of a material, those of its extensions too."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name.endswith("Texture"):
                yield inner.get("index") if isinstance(inner, dict) else inner
            elif name != "extras":
                yield from _textures(inner)


def _buffers(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    for i, buffer in enumerate(listed(document, "buffers")):
        if "uri" in buffer:
            yield Finding("buffers", f"{file} buffer {i}", "lies outside of the file's own chunk")
        elif i or buffer["byteLength"] > len(binary):
            yield Finding("buffers", f"{file} buffer {i}", f"has {len(binary) if not i else 0} bytes, says {buffer['byteLength']}")
    sizes = [buffer["byteLength"] for buffer in listed(document, "buffers")]
    for i, view in enumerate(listed(document, "bufferViews")):
        if "buffer" not in view or view.get("byteOffset", 0) + view["byteLength"] > sizes[view["buffer"]]:
            yield Finding("buffers", f"{file} bufferView {i}", "reaches beyond its buffer")
    views = listed(document, "bufferViews")
    for i, accessor in enumerate(listed(document, "accessors")):
        if accessor["componentType"] not in _TYPES or accessor.get("type") not in _COUNTS:
            yield Finding("buffers", f"{file} accessor {i}", f"is of no known type ({accessor['componentType']}, {accessor.get('type')})")
        elif (
            "bufferView" in accessor
            and accessor["count"]
            and _end(accessor, views[accessor["bufferView"]]) > (views[accessor["bufferView"]]["byteLength"])
        ):
            yield Finding("buffers", f"{file} accessor {i}", "reaches beyond its view")
        elif "bufferView" in accessor:
            start = accessor.get("byteOffset", 0) + views[accessor["bufferView"]].get("byteOffset", 0)
            if start % np.dtype(_TYPES[accessor["componentType"]]).itemsize:
                yield Finding("buffers", f"{file} accessor {i}", f"begins at byte {start}, which is no multiple of its numbers' size")


def _end(accessor: Document, view: Document) -> int:
    """Where the last element of an accessor ends, in bytes from the start of its view."""
    size = np.dtype(_TYPES[accessor["componentType"]]).itemsize * _COUNTS[accessor["type"]]
    stride = view.get("byteStride", 0) or size
    return int(accessor.get("byteOffset", 0) + stride * (accessor["count"] - 1) + size)


def _values(document: Document, binary: bytes, index: int) -> NDArray[Any] | None:
    """Elements of an accessor, shape (count, components), or None where they cannot be had plainly."""
    accessor = document["accessors"][index]
    if (
        "bufferView" not in accessor
        or "sparse" in accessor
        or accessor["componentType"] not in _TYPES
        or accessor.get("type") not in _COUNTS
    ):
        return None
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = np.dtype(_TYPES[accessor["componentType"]]), _COUNTS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", 0) or kind.itemsize * width
    if "uri" in document["buffers"][view["buffer"]] or start + _end(accessor, view) - accessor.get("byteOffset", 0) > len(binary):
        return None
    return np.ndarray((accessor["count"], width), kind, binary, start, (stride, kind.itemsize))


def _is_held(document: Document, index: int, primitive: Document) -> bool:
    """Whether the file holds the numbers of an accessor, plainly or packed; those of others are zeros."""
    accessor, extensions = document["accessors"][index], primitive.get("extensions")
    return not accessor["count"] or "bufferView" in accessor or "sparse" in accessor or bool(extensions)


def _geometry(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    for i, mesh in enumerate(listed(document, "meshes")):
        where = f"{file} mesh {mesh.get('name', i)}"
        for primitive in mesh["primitives"]:
            accessor = document["accessors"][primitive["attributes"]["POSITION"]]
            for name, index in (("POSITION", primitive["attributes"]["POSITION"]), ("indices", primitive.get("indices"))):
                if index is not None and not _is_held(document, index, primitive):
                    yield Finding("geometry", where, f"{name} is {document['accessors'][index]['count']} zeros that no buffer holds")
            points = _values(document, binary, primitive["attributes"]["POSITION"])
            if points is None:
                continue
            if not len(points) or points.shape[1] != 3 or not np.isfinite(points).all():
                yield Finding("geometry", where, "has positions that are missing or not finite")
                continue
            low, high = accessor.get("min"), accessor.get("max")
            if not _are_numbers(low, 3) or not _are_numbers(high, 3):
                yield Finding("geometry", where, "does not state the bounds of its positions")
            elif points.dtype.kind == "f":
                held = np.array([points.min(axis=0), points.max(axis=0)])
                if not np.allclose(held, np.array([low, high], dtype=np.float64), rtol=1e-5, atol=1e-6):
                    message = f"positions lie within {held[0].tolist()} and {held[1].tolist()}, not {low} and {high}"
                    yield Finding("geometry", where, message)
            for name, other in primitive["attributes"].items():
                count = document["accessors"][other]["count"]
                if count != len(points):
                    yield Finding("geometry", where, f"has {len(points)} positions, but {count} of {name}")
            count = document["accessors"][primitive["indices"]]["count"] if "indices" in primitive else len(points)
            if primitive.get("mode", 4) == 4 and count % 3:
                yield Finding("geometry", where, f"has {count} corners of triangles, no multiple of 3")
            corners = _values(document, binary, primitive["indices"]) if "indices" in primitive else None
            for corner in (corners.min(), corners.max()) if corners is not None and len(corners) else ():
                if not 0 <= corner < len(points):
                    yield Finding("geometry", where, f"names vertex {corner} of {len(points)}")


def _images(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    for i, image in enumerate(listed(document, "images")):
        where = f"{file} image {image.get('name', i)}"
        if "bufferView" not in image:
            yield Finding("images", where, "lies outside of the file" if "uri" in image else "has no contents")
            continue
        view = document["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        wrong = _unreadable(binary[start : start + view["byteLength"]])
        if wrong and image.get("mimeType") in ("image/png", "image/jpeg"):
            yield Finding("images", where, f"cannot be read ({wrong})")


def _unreadable(data: bytes) -> str | None:
    """Why an image's head cannot be read, or None."""
    from PIL import Image

    try:
        Image.open(io.BytesIO(data)).close()
    except Exception as error:  # the reader raises whatever the bytes lead it to
        return type(error).__name__
    return None


def _matrix(where: str, node: Document) -> Iterator[Finding]:
    """A pose as a matrix, column after column, which has to be one of a translation, a rotation and a scale (glTF 2.0, 3.5.3)."""
    if any(key in node for key in ("translation", "rotation", "scale")):
        yield Finding("rigid_pose", where, "has a matrix and a translation, rotation or scale as well")
    axes = np.array(node["matrix"], dtype=np.float64).reshape(4, 4)[:3, :3]
    lengths = np.linalg.norm(axes, axis=1)
    if not (lengths > 0.0).all():
        yield Finding("rigid_pose", where, "its matrix is flat")
    elif not np.allclose((axes / lengths[:, None]) @ (axes / lengths[:, None]).T, np.eye(3), atol=1e-3):
        yield Finding("rigid_pose", where, "its matrix is sheared")


def _poses(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    for i, node in enumerate(listed(document, "nodes")):
        where = f"{file} node {node.get('name', i)}"
        length = float(np.linalg.norm(np.array(node.get("rotation", [0, 0, 0, 1]), dtype=np.float64)))
        if abs(length - 1.0) > 1e-4:
            yield Finding("rigid_pose", where, f"rotation has length {length:.6g}")
        if "matrix" in node:
            yield from _matrix(where, node)
        scale = node.get("scale", [1, 1, 1])
        if not all(value > 0 for value in scale):
            yield Finding("rigid_pose", where, f"scale is {scale}", not all(scale))
        about = node.get("extras")
        if not isinstance(about, dict):
            continue
        mass, tensor = about.get("mass_kg"), about.get("inertia_kg_m2")
        if mass is not None and not (_are_numbers([mass], 1) and mass > 0.0):
            yield Finding("mass", where, f"mass_kg is {mass}")
        if tensor is not None:
            square = isinstance(tensor, list) and len(tensor) == 3 and all(_are_numbers(row, 3) for row in tensor)
            moments = np.linalg.eigvalsh(np.array(tensor, dtype=np.float64)) if square else np.zeros(3)
            if not moments[0] > 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
                yield Finding("mass", where, f"inertia_kg_m2 is none of a solid (principal moments {moments.tolist()})")


def _labels(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    nodes, roots = listed(document, "nodes"), roots_of(document)
    names, seen = Counter(str(nodes[root].get("name", "")) for root in roots), seen_of(document)
    for root in roots:
        name, about = str(nodes[root].get("name", "")), nodes[root].get("extras")
        is_object = isinstance(about, dict) and bool(about.get("category"))  # to glTF itself names are for people
        if not name:
            yield Finding("names", f"{file} node {root}", "has no name", is_object)
        elif names[name] > 1:
            yield Finding("names", f"{file} node {name}", f"{names[name]} nodes have this name", is_object)
        if is_object and root not in seen:
            yield Finding("geometry", f"{file} node {name or root}", "is an object without a mesh")
        if name != "room" and not is_object:
            yield Finding("labels", f"{file} node {name or root}", "has no category in its extras", False)
