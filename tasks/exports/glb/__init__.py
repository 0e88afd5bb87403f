"""A whole replica as one glTF binary: `<stem>.glb`, +Y up, a node per object, geometry of equal assets stored once.

Assets go in as they are: their geometry and images are copied byte for byte, their scale stands in the object's node.
Animations, skins, cameras and lights of assets are left out.
"""

from __future__ import annotations

import base64
import copy
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from schemas.errors import InputError
from tasks.containers import close_glb, open_glb
from tasks.exports.bodies import Body, Replica
from tasks.exports.config import ExportsConfig
from tasks.exports.files import Export, File
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.gltf import aim
from tasks.exports.mjcf import described
from tasks.geometry.meshes import dump_glb
from tasks.geometry.transforms import Z_UP_TO_Y_UP, quaternion_xyzw, to_y_up

Document = dict[str, Any]

_COPIED = ("bufferViews", "accessors", "images", "samplers", "textures", "materials", "meshes")


def glb_files(replica: Replica, config: ExportsConfig) -> list[File]:
    """The one file of a scene."""
    scene = _Scene()
    room = scene.add_asset(dump_glb([part for _, part in replica.shell], [name for name, _ in replica.shell]), "room.glb")
    children = [scene.add_node(scene.copy_of(room, node, "room_")) for node in scene.roots(room)]
    top = [scene.add_node({"name": "room", "children": children})]
    assets: dict[str, Document] = {}
    for body in replica.bodies:
        key = body.shape.asset.asset_id
        if key not in assets:
            assets[key] = scene.add_asset(body.shape.glb, f"{body.shape.asset.name}.glb")
        top.append(scene.add_node(_node(scene, body, assets[key])))
    about = {"scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type}
    return [File(f"{replica.stem}.glb", scene.dump(top, replica.stem, about), "scene")]


def _node(scene: _Scene, body: Body, asset: Document) -> Document:
    """The node of an object: its pose, its scale along its own axes, and what it is."""
    pose = to_y_up(body.pose)
    x, y, z = (float(value) for value in body.shape.scale)
    node: Document = {
        "name": body.name, "translation": _numbers(pose[:3, 3]), "rotation": _numbers(quaternion_xyzw(pose)), "scale": [x, z, y],
        "extras": {**described(body), **_physics(body)},
    }  # fmt: skip
    node["children"] = [scene.add_node(scene.copy_of(asset, root, f"{body.name}_")) for root in scene.roots(asset)]
    return node


def _physics(body: Body) -> dict[str, Any]:
    """Mass properties of the object in the node's frame without its scale (+Y up): glTF itself has no words for them."""
    turn = Z_UP_TO_Y_UP[:3, :3]
    tensor = turn @ body.inertia @ turn.T
    return {
        "mass_kg": float(body.mass_kg), "center_of_mass_m": _numbers(turn @ body.shape.properties.center),
        "inertia_kg_m2": [_numbers(row) for row in tensor], "friction": float(body.friction), "restitution": float(body.restitution),
    }  # fmt: skip


def _numbers(values: ArrayLike) -> list[float]:
    """Numbers as JSON has them; no negative zeros."""
    return [float(value) + 0.0 for value in np.asarray(values, dtype=np.float64).reshape(-1)]


class _Scene:
    """A glTF document that grows by whole assets."""

    def __init__(self) -> None:
        self.document: Document = {name: [] for name in (*_COPIED, "nodes")}
        self.extensions: dict[str, set[str]] = {"extensionsUsed": set(), "extensionsRequired": set()}
        self.binary = bytearray()

    def add_asset(self, data: bytes, file: str) -> Document:
        """Copy geometry, materials and images of a GLB; returns its own document with the nodes' meshes renumbered."""
        document, binary = open_glb(data, file)
        document = copy.deepcopy(document)
        first = {name: len(self.document[name]) for name in _COPIED}
        places = [self._buffer(buffer, binary, file) for buffer in document.get("buffers", [])]
        for view in document.get("bufferViews", []):
            view["byteOffset"] = places[view["buffer"]] + view.get("byteOffset", 0)
            view["buffer"] = 0
        aim(document)
        for mesh in document.get("meshes", []):
            for primitive in mesh.get("primitives", []):
                for target in (primitive.get("attributes", {}), *primitive.get("targets", [])):
                    for key in target:
                        target[key] += first["accessors"]
                _shift(primitive, "indices", first["accessors"])
                _shift(primitive, "material", first["materials"])
        for kind in ("accessors", "images", "meshes"):
            _shift_below(document.get(kind, []), "bufferView", first["bufferViews"])
        for texture in document.get("textures", []):
            _shift(texture, "sampler", first["samplers"])
            _shift_below(texture, "source", first["images"])
        _shift_textures(document.get("materials", []), first["textures"])
        for node in document.get("nodes", []):
            _shift(node, "mesh", first["meshes"])
        for name in _COPIED:
            self.document[name] += document.get(name, [])
        for name, extensions in self.extensions.items():
            extensions |= {str(extension) for extension in document.get(name, []) if "lights" not in str(extension)}
        return document

    def roots(self, asset: Document) -> list[int]:
        """Nodes of an asset's scene."""
        scenes = asset.get("scenes", [])
        return list(scenes[asset.get("scene", 0)].get("nodes", [])) if scenes else []

    def copy_of(self, asset: Document, index: int, prefix: str) -> Document:
        """A node of an asset with all below it, which are added; what is not geometry is left out."""
        node = asset["nodes"][index]
        kept = {key: node[key] for key in ("mesh", "matrix", "translation", "rotation", "scale") if key in node}
        kept["name"] = f"{prefix}{node.get('name', index)}"
        if node.get("children"):
            kept["children"] = [self.add_node(self.copy_of(asset, child, prefix)) for child in node["children"]]
        return kept

    def add_node(self, node: Document) -> int:
        """Index of a new node."""
        self.document["nodes"].append({key: value for key, value in node.items() if key != "children" or value})
        return len(self.document["nodes"]) - 1

    def dump(self, top: list[int], name: str, about: Mapping[str, str]) -> bytes:
        """The file: top nodes and what is known of the scene."""
        document: Document = {
            "asset": {"version": "2.0", "generator": "metascenes", "copyright": about["license"]},
            "scene": 0,
            "scenes": [{"name": name, "nodes": top, "extras": dict(about)}],
            **{key: values for key, values in self.document.items() if values},
            **{key: sorted(values) for key, values in self.extensions.items() if values},
        }
        if self.binary:
            document["buffers"] = [{"byteLength": len(self.binary)}]
        return close_glb(document, bytes(self.binary))

    def _buffer(self, buffer: Document, binary: bytes, file: str) -> int:
        """Where the bytes of an asset's buffer begin in this one's."""
        uri = buffer.get("uri")
        if uri is not None and not str(uri).startswith("data:"):
            raise InputError(file, "buffers", "lie in another file", "export it as one GLB")
        data = binary if uri is None else base64.b64decode(str(uri).partition(",")[2])
        self.binary += b"\0" * (-len(self.binary) % 16)
        place = len(self.binary)
        self.binary += data[: buffer.get("byteLength", len(data))]
        return place


def _shift(value: Document, key: str, by: int) -> None:
    """Renumber a reference."""
    if key in value:
        value[key] += by


def _shift_below(value: Any, key: str, by: int) -> None:
    """Renumber a reference wherever it stands, in extensions too."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name == key and isinstance(inner, int):
                value[name] = inner + by
            elif name != "extras":
                _shift_below(inner, key, by)
    elif isinstance(value, list):
        for inner in value:
            _shift_below(inner, key, by)


def _shift_textures(value: Any, by: int) -> None:
    """Renumber the textures of materials, those of extensions too: every `...Texture` has an index."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name.endswith("Texture") and isinstance(inner, dict) and isinstance(inner.get("index"), int):
                inner["index"] += by
            elif name != "extras":
                _shift_textures(inner, by)
    elif isinstance(value, list):
        for inner in value:
            _shift_textures(inner, by)


def _make(scene: ExportedScene) -> Export:
    """The files, written to a temporary folder and checked there."""
    files = glb_files(scene.replica, scene.config)
    return checked(files, GLB, files[0].path)


def _gate() -> ModuleType:
    from tasks.exports.glb import rules

    return rules


GLB = ExportFormat(
    name="glb",
    title="GLB scenes",
    make=_make,
    gate=_gate,
    opened=lambda root: sorted(root.glob("*.glb")),
    doctor=Doctor(
        about="Check anybody's GLB of a scene.",
        example="./replicas/glb/scannet_scene0000_00.glb",
    ),
)
