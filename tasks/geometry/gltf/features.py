"""The table of glTF features: read, noted as unused, or refused by name. Every reader of GLBs and `doctor glb` consult it.

A feature is noted if only appearance suffers, and refused if geometry would. Extensions that the table lacks are refused if a file
requires them, and noted otherwise: by the standard, a file without its optional extensions still shows the same geometry.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from schemas.errors import InputError

Document = Mapping[str, Any]
Treatment = Literal["read", "noted", "refused"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
INSTANCING = "EXT_mesh_gpu_instancing"
TRANSFORM = "KHR_texture_transform"
GLOSS = "KHR_materials_pbrSpecularGlossiness"
VISIBILITY = "KHR_node_visibility"
BASIS = "KHR_texture_basisu"
IMAGE_EXTENSIONS = (BASIS, "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")
"""Extensions of textures that name another image, in the order in which they are tried."""


@dataclasses.dataclass(frozen=True)
class Feature:
    """A feature of glTF.

    name: an extension, or a feature of glTF itself. treatment: its use by the readers. effect: its consequence for what is read.
    """

    name: str
    treatment: Treatment
    effect: str = ""


def _extensions(treatment: Treatment, effect: str, *names: str) -> Iterator[tuple[str, Feature]]:
    return ((name, Feature(name, treatment, effect)) for name in names)


_MATERIAL = "is not read: colors are those of the base color"
_NO_EFFECT = "is not read; it changes neither geometry nor color"

EXTENSIONS: dict[str, Feature] = dict([
    *_extensions("read", "is decoded", DRACO, *MESHOPT, BASIS),
    *_extensions("read", "is applied", INSTANCING, TRANSFORM, VISIBILITY, "KHR_mesh_quantization"),
    *_extensions("read", "image is read", "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds"),
    *_extensions("read", "diffuse color and texture are read as base color", GLOSS),
    *_extensions("read", "base color is read", "KHR_materials_unlit"),
    *_extensions("read", "multiplies the emitted light, up to 1", "KHR_materials_emissive_strength"),
    *_extensions("read", "changes no triangle", "FB_ngon_encoding", "KHR_xmp", "KHR_xmp_json_ld", "EXT_mesh_manifold"),
    *_extensions("noted", "are not read: the default materials are", "KHR_materials_variants"),
    *_extensions(
        "noted", _MATERIAL,
        "KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_diffuse_transmission", "KHR_materials_dispersion",
        "KHR_materials_ior", "KHR_materials_iridescence", "KHR_materials_sheen", "KHR_materials_specular",
        "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_volume_scatter",
        "ADOBE_materials_clearcoat_specular", "ADOBE_materials_clearcoat_tint", "ADOBE_materials_thin_transparency",
        "EXT_materials_specular_edge_color", "MSFT_packing_normalRoughnessMetallic", "MSFT_packing_occlusionRoughnessMetallic",
    ),
    *_extensions("noted", "is not read", "KHR_lights_punctual", "EXT_lights_ies", "EXT_lights_image_based", "CESIUM_primitive_outline"),
    *_extensions("noted", "is not read: the pose at rest is", "KHR_animation_pointer"),
    *_extensions("noted", "is not read: the finest level is", "MSFT_lod"),
    *_extensions(
        "noted", _NO_EFFECT,
        "EXT_mesh_features", "EXT_instance_features", "EXT_structural_metadata", "KHR_audio", "KHR_audio_emitter", "KHR_interactivity",
        "KHR_node_hoverability", "KHR_node_selectability", "KHR_physics_rigid_bodies", "KHR_implicit_shapes", "OMI_physics_body",
        "OMI_physics_shape",
    ),
])  # fmt: skip
"""Extensions that the project knows."""

CORE: dict[str, Feature] = {
    feature.name: feature
    for feature in (
        Feature("triangles, strips and fans", "read", "with or without indices"),
        Feature("sparse accessors", "read", "are applied"),
        Feature("numbers of every component type", "read", "normalized ones are scaled"),
        Feature("skins", "read", "in the pose of their joints"),
        Feature("morph targets", "read", "by their default weights"),
        Feature("texture coordinate sets", "read", "the set that the base color names"),
        Feature("wrap modes of samplers", "read", "by repeating, mirroring or extending the image"),
        Feature("vertex colors", "read", "times the base color factor"),
        Feature("color spaces", "read", "factors and vertex colors linear, images sRGB"),
        Feature("PNG, JPEG, WebP, AVIF and Basis Universal images", "read", "in the file itself"),
        Feature("points and lines", "noted", "are not read: they have no surface"),
        Feature("animations", "noted", "are not played: the pose at rest is read"),
        Feature("cameras", "noted", "are not read"),
        Feature("several scenes", "noted", "one scene is read"),
        Feature("meshes outside the scene", "noted", "are not read"),
        Feature("cut-outs and transparency", "noted", "are read as solid surfaces, colors without their alpha"),
        Feature("data in other files", "refused", "a GLB holds its own geometry"),
        Feature("glTF 1.0", "refused", "glTF 2.0 is read"),
        Feature("no scene", "refused", "nothing says which nodes are shown"),
    )
}
"""Features of glTF itself."""


@dataclasses.dataclass(frozen=True)
class FoundFeature:
    """A feature that a file uses. places: number of its places in the file, 0 if it is only declared."""

    feature: Feature
    places: int
    is_required: bool = False

    @property
    def text(self) -> str:
        """The feature and its consequence, in one line."""
        often = f" ({self.places} times)" if self.places > 1 else ""
        return f"{self.feature.name}{often}: {self.feature.effect}"


def find_features(document: Document) -> list[FoundFeature]:
    """Features that a file uses, sorted by name; values of the wrong kind count as absent."""
    uses = [FoundFeature(CORE[name], count) for name, count in _core_counts(document).items() if count]
    places = Counter(_named_extensions(document))
    used, required = (set(_texts(document.get(key))) for key in ("extensionsUsed", "extensionsRequired"))
    for name in places.keys() | used | required:
        feature = EXTENSIONS.get(name)
        if feature is None and name in required:
            feature = Feature(name, "refused", "the file requires it, and it is not read")
        uses.append(FoundFeature(feature or Feature(name, "noted", "is not read"), places[name], name in required))
    return sorted(uses, key=lambda entry: entry.feature.name)


def check_features(document: Document, file: str) -> tuple[str, ...]:
    """Notes on the features of a file that are not read, a line each.

    Raises:
        InputError: the file uses a feature without which its geometry would be wrong, or a value is of the wrong kind; names it.
    """
    notes = []
    for entry in find_features(document):
        if entry.feature.treatment == "refused":
            field = "extensionsRequired" if entry.is_required else "feature"
            problem = f"uses {entry.feature.name}: {entry.feature.effect}"
            raise InputError(file, field, problem, "export it as a glTF 2.0 binary without it")
        if entry.feature.treatment == "noted":
            notes.append(f"{file}: {entry.text}")
    for field, problem in _misshapen(document):
        raise InputError(file, field, problem, "export it again")
    primitives = primitives_of(document)
    if primitives and all(map(is_surfaceless, primitives)):
        raise InputError(file, "meshes", "holds no triangles, only points and lines", "export it with its faces")
    return tuple(notes)


MAX_MODE = 6
"""Highest mode of a primitive; 0 to 3 are points and lines, 4 to 6 triangles (glTF 2.0, 3.7.2.1)."""


def _misshapen(document: Document) -> Iterator[tuple[str, str]]:
    """Values of lists, materials and extensions that are of the wrong kind, and nodes below themselves: field and problem."""
    yield from _broken_lists(document)
    textures = len(entries(document, "textures"))
    for index, material in enumerate(entries(document, "materials")):
        plain = material.get("pbrMetallicRoughness", {})
        if not isinstance(plain, dict):
            yield f"material {index}", "pbrMetallicRoughness is not an object"
        for holder in (entry for entry in (material, plain) if isinstance(entry, dict)):
            for key, value in holder.items():
                number = value.get("index") if isinstance(value, dict) else value
                if key.endswith("Texture") and not (type(number) is int and 0 <= number < textures):
                    yield f"material {index}", f"{key} names texture {number!r:.20} of {textures}"
    level: list[Any] = [dict(document)]
    while level:
        level, values = [], level
        for value in values:
            if isinstance(value, dict):
                extensions = value.get("extensions")
                for name, entry in extensions.items() if isinstance(extensions, dict) else ():
                    if not isinstance(entry, dict):
                        yield "extensions", f"{name:.60} is not an object"
                level += [inner for key, inner in value.items() if key != "extras"]
            elif isinstance(value, list):
                level += value


_LISTS = (
    "accessors", "animations", "bufferViews", "buffers", "cameras", "images", "materials", "meshes", "nodes", "samplers", "scenes",
    "skins", "textures",
)  # fmt: skip


def _broken_lists(document: Document) -> Iterator[tuple[str, str]]:
    """Lists that are not lists of objects or of numbers, and nodes that lie below themselves."""
    holders: list[tuple[str, Any]] = [(key, document[key]) for key in _LISTS if key in document]
    holders += [(f"mesh {index}: primitives", mesh.get("primitives")) for index, mesh in enumerate(entries(document, "meshes"))]
    for field, value in holders:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            yield field, "is not a list of objects"
    for index, mesh in enumerate(entries(document, "meshes")):
        for primitive in entries(mesh, "primitives"):
            mode = primitive.get("mode", 4)
            if type(mode) is not int or not 0 <= mode <= MAX_MODE:
                yield f"mesh {index}", f"a primitive has the mode {mode!r:.20}, not a number from 0 to {MAX_MODE}"
    for key in _LISTS:
        for index, entry in enumerate(entries(document, key)):
            if not isinstance(entry.get("name"), str | None):
                yield f"{key} {index}", f"has the name {entry['name']!r:.20}, which is not a text"
    nodes = entries(document, "nodes")
    number = document.get("scene", 0)
    if type(number) is not int or number < 0:
        yield "scene", f"is {number!r:.20}, not a number"
    children = [node.get("children", []) for node in nodes]
    named = [(f"node {index}: children", value) for index, value in enumerate(children)]
    named += [(f"scene {index}: nodes", scene.get("nodes", [])) for index, scene in enumerate(entries(document, "scenes"))]
    for field, value in named:
        if not isinstance(value, list):
            yield field, "is not a list of nodes"
            return
        wrong = [entry for entry in value if type(entry) is not int or not 0 <= entry < len(nodes)]
        if wrong:
            yield field, f"names node {wrong[0]!r:.20} of {len(nodes)}"
            return
    # A tree loses a leaf at a time; what is left then lies on a circle, or above one.
    parents: dict[int, list[int]] = {}
    for index, below in enumerate(children):
        for child in below:
            parents.setdefault(child, []).append(index)
    left = [len(below) for below in children]
    leaves = [index for index, count in enumerate(left) if not count]
    for leaf in leaves:
        for parent in parents.get(leaf, ()):
            left[parent] -= 1
            leaves += [parent] if not left[parent] else []
    circle = next((index for index, count in enumerate(left) if count), None)
    if circle is not None:
        yield f"node {circle}", "lies below itself, or above a node that does"


def _core_counts(document: Document) -> dict[str, int]:
    """Places of the features of glTF itself that are not read in full."""
    version = objects(document.get("asset"))[0].get("version", "2.0") if isinstance(document.get("asset"), dict) else "2.0"
    nodes, scenes = entries(document, "nodes"), entries(document, "scenes")
    drawn = drawn_nodes(document)
    shown = {nodes[index].get("mesh") for index in drawn if isinstance(nodes[index].get("mesh"), int)}
    placed = {node["mesh"] for node in nodes if isinstance(node.get("mesh"), int)}
    return {
        "points and lines": sum(map(is_surfaceless, primitives_of(document))),
        "animations": len(entries(document, "animations")),
        "cameras": len(entries(document, "cameras")),
        "several scenes": len(scenes) if len(scenes) > 1 else 0,
        "meshes outside the scene": len(placed - shown) if scenes else 0,
        "cut-outs and transparency": sum(entry.get("alphaMode") in ("MASK", "BLEND") for entry in entries(document, "materials")),
        "data in other files": sum(is_elsewhere(entry) for entry in entries(document, "buffers")),
        "glTF 1.0": int(str(version).startswith("1") or isinstance(document.get("meshes"), dict)),
        "no scene": int(bool(placed) and not scenes),
    }


def primitives_of(document: Document) -> list[dict[str, Any]]:
    """Primitives of all meshes."""
    return [primitive for mesh in entries(document, "meshes") for primitive in entries(mesh, "primitives")]


def is_surfaceless(primitive: Document) -> bool:
    """True for points and lines."""
    mode = primitive.get("mode", 4)
    return type(mode) is int and 0 <= mode <= 3


def is_elsewhere(holder: Document) -> bool:
    """True if a buffer or an image lies in another file."""
    uri = holder.get("uri")
    return isinstance(uri, str) and not uri.startswith("data:")


def drawn_nodes(document: Document) -> list[int]:
    """Nodes of the scene that is read, in order of their first visit; hidden ones are left out with all below them."""
    nodes, scenes, number = entries(document, "nodes"), entries(document, "scenes"), document.get("scene", 0)
    scene = scenes[number] if isinstance(number, int) and 0 <= number < len(scenes) else {}
    visited: dict[int, None] = {}
    level = _indices(scene.get("nodes"), len(nodes))
    while level:
        level = [index for index in level if index not in visited and not is_hidden(nodes[index])]
        visited.update(dict.fromkeys(level))
        level = [child for index in level for child in _indices(nodes[index].get("children"), len(nodes))]
    return list(visited)


def is_hidden(node: Document) -> bool:
    """True if a node hides itself and all nodes below it."""
    return extension_of(node, VISIBILITY).get("visible") is False


def extension_of(holder: Document, name: str) -> dict[str, Any]:
    """Values of an extension of a node, primitive, material, texture or view; empty without it."""
    extensions = holder.get("extensions")
    value = extensions.get(name) if isinstance(extensions, dict) else None
    return value if isinstance(value, dict) else {}


def _named_extensions(value: Any) -> Iterator[str]:
    """Names of the extensions in a document, one for each place."""
    level = [value]
    while level:
        level, values = [], level
        for entry in values:
            if isinstance(entry, dict):
                extensions = entry.get("extensions")
                yield from extensions if isinstance(extensions, dict) else ()
                level += [inner for key, inner in entry.items() if key != "extras"]
            elif isinstance(entry, list):
                level += entry


def entries(document: Document, name: str) -> list[dict[str, Any]]:
    """A list of objects; other values are empty."""
    value = document.get(name)
    return objects(value) if isinstance(value, list) else []


def objects(value: Any) -> list[dict[str, Any]]:
    """The objects in a list, or the one object; members of another kind are empty."""
    values = value if isinstance(value, list) else [value] if isinstance(value, dict) else []
    return [entry if isinstance(entry, dict) else {} for entry in values]


def _texts(value: Any) -> list[str]:
    return [entry for entry in value if isinstance(entry, str)] if isinstance(value, list) else []


def _indices(value: Any, count: int) -> list[int]:
    """Indices below a count, each once."""
    values = value if isinstance(value, list) else []
    return list(dict.fromkeys(entry for entry in values if type(entry) is int and 0 <= entry < count))
