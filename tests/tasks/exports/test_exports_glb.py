"""The GLB of a whole scene: what is stored once, what is kept as it is, and a gate that catches damage."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks import exports
from tasks.containers import close_glb, open_glb
from tasks.exports.bodies import Replica
from tasks.exports.glb import glb_files
from tasks.exports.glb.rules import RULES, check_glb
from tasks.geometry.meshes import canonical, load_glb
from tasks.shell import room_shell
from tests.replicas import Object, cube, furnished, rows_of
from tests.tasks.exports.usd.test_exports_usd import replica_of

Document = dict[str, Any]


def glb_of(replica: Replica) -> bytes:
    (file,) = glb_files(replica, exports.ExportsConfig())
    assert file.path == f"{replica.stem}.glb"
    return file.data


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_of(furnished()))


@pytest.fixture(scope="module")
def data(replica: Replica) -> bytes:
    return glb_of(replica)


@pytest.fixture(scope="module")
def path(data: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same in a file: short to print."""
    file = tmp_path_factory.mktemp("glb") / "scene.glb"
    file.write_bytes(data)
    return file


@pytest.fixture(scope="module")
def textured(realdata: Callable[[str], Path]) -> tuple[Replica, bytes]:
    """Two assets with images, one of them twice at different sizes."""
    parts = {n: canonical(load_glb((realdata("assets") / f"{n}.glb").read_bytes())) for n in ("aws_ShoeRack_01", "aws_Ball_01")}
    hulls = {name: [trimesh.util.concatenate(found).convex_hull] for name, found in parts.items()}
    rack, ball = (Object("thing", parts[name], hulls[name], np.eye(4)) for name in parts)
    larger = Object("thing", parts["aws_ShoeRack_01"], hulls["aws_ShoeRack_01"], np.eye(4), scale=(1.5, 1.0, 2.0))
    replica = replica_of(*rows_of([rack, ball, larger]))
    return replica, glb_of(replica)


def checked(data: bytes, folder: Path) -> list[Any]:
    path = folder / "scene.glb"
    path.write_bytes(data)
    return check_glb(path)


def test_a_sound_scene_has_no_findings(data: bytes, textured: tuple[Replica, bytes], tmp_path: Path) -> None:
    assert checked(data, tmp_path) == []
    assert checked(textured[1], tmp_path) == []


def test_another_reader_sees_the_room_and_every_object(replica: Replica, data: bytes, tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(data)
    scene: Any = trimesh.load_scene(tmp_path / "scene.glb")
    nodes = set(scene.graph.nodes)
    assert {body.name for body in replica.bodies} <= nodes
    assert {f"room_{name}" for name, _ in room_shell(replica.room)} <= nodes
    shell = np.concatenate([mesh.vertices for _, mesh in room_shell(replica.room)])
    low, high = shell.min(axis=0), shell.max(axis=0)
    np.testing.assert_allclose(scene.bounds, [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]], atol=1e-6)
    parts = [part for body in replica.bodies for part in body.shape.parts] + [mesh for _, mesh in room_shell(replica.room)]
    assert sum(len(mesh.faces) for mesh in scene.dump()) == sum(len(part.faces) for part in parts)


def test_equal_assets_are_stored_once_at_any_size(replica: Replica, data: bytes, textured: tuple[Replica, bytes]) -> None:
    for scene, file in ((replica, data), textured):
        document, binary = open_glb(file)
        assets = {body.shape.asset.asset_id: open_glb(body.shape.glb)[0] for body in scene.bodies}
        room = len(room_shell(scene.room))
        assert len(document["meshes"]) == room + sum(len(asset["meshes"]) for asset in assets.values())
        assert len(assets) < len(scene.bodies)
        whole = sum(len(body.shape.glb) for body in scene.bodies)
        assert len(binary) < whole


def test_geometry_and_images_are_kept_byte_for_byte(textured: tuple[Replica, bytes]) -> None:
    scene, file = textured
    document, binary = open_glb(file)

    def pieces(document: Document, binary: bytes) -> list[bytes]:
        return [binary[v.get("byteOffset", 0) :][: v["byteLength"]] for v in document["bufferViews"]]

    found = pieces(document, binary)
    images = [found[image["bufferView"]] for image in document["images"]]
    assert images
    for body in scene.bodies:
        own, chunk = open_glb(body.shape.glb)
        kept = pieces(own, chunk)
        assert set(kept) <= set(found)
        assert {kept[image["bufferView"]] for image in own["images"]} <= set(images)
    for material in document["materials"]:
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        assert texture is None or document["textures"][texture["index"]]["source"] < len(images)


def test_every_object_says_what_it_is(replica: Replica, data: bytes) -> None:
    document, _ = open_glb(data)
    nodes = {node["name"]: node for node in document["nodes"]}
    for body in replica.bodies:
        about = nodes[body.name]["extras"]
        assert (about["category"], about["nyu40_label"], about["is_fixed"]) == (body.category, body.nyu40_label, body.is_fixed)
        assert {key: about[key] for key in body.provenance} == dict(body.provenance)
        assert about["mass_kg"] == body.mass_kg
    assert document["asset"]["copyright"] == replica.license
    assert document["scenes"][0]["extras"]["scene_id"] == replica.scene_id


def test_buffers_say_what_they_hold(data: bytes, textured: tuple[Replica, bytes]) -> None:
    """Khronos' validator asks for it."""
    for file in (data, textured[1]):
        document, _ = open_glb(file)
        images = {image["bufferView"] for image in document.get("images", [])}
        targets = [view.get("target") for i, view in enumerate(document["bufferViews"]) if i not in images]
        assert set(targets) == {34962, 34963}
        assert all("target" not in document["bufferViews"][i] for i in images)


def test_an_asset_with_its_own_tree_keeps_it(tmp_path: Path) -> None:
    """Nested nodes with matrices, a camera, an animation: geometry stays where the asset has it, the rest is left out."""
    obj = cube((0.2, 0.3, 0.4), np.eye(4))
    rows, blobs = rows_of([obj])
    name = rows["assets"][0].mesh_blob
    document, binary = open_glb(blobs[name])
    plain = replica_of(rows, blobs)
    mesh = next(node["mesh"] for node in document["nodes"] if "mesh" in node)
    lift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.25, 0, 0, 1]
    document |= {
        "nodes": [
            {"name": "top", "children": [1, 2], "translation": [-0.25, 0, 0]},
            {"name": "inner", "matrix": lift, "mesh": mesh},
            {"name": "eye", "camera": 0},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        "scenes": [{"nodes": [0]}],
    }  # fmt: skip
    rebuilt = {**blobs, name: close_glb(document, binary)}
    nested = replica_of(rows, rebuilt)
    data = glb_of(nested)
    assert checked(data, tmp_path) == []
    found, _ = open_glb(data)
    assert "cameras" not in found
    assert all("camera" not in node for node in found["nodes"])
    boxes = []
    for number, file in enumerate((glb_of(plain), data)):
        (tmp_path / f"{number}.glb").write_bytes(file)
        boxes.append(trimesh.load_scene(tmp_path / f"{number}.glb").bounds)
    np.testing.assert_array_equal(*boxes)


# ---- damage


def edited(change: Callable[[Document], None]) -> Callable[[bytes], bytes]:
    """Change the JSON of a file."""

    def damage(data: bytes) -> bytes:
        document, binary = open_glb(data)
        change(document)
        return close_glb(document, binary)

    return damage


def node(document: Document, name: str) -> Document:
    return next(node for node in document["nodes"] if node["name"] == name)


def set_node(name: str, /, **values: Any) -> Callable[[bytes], bytes]:
    return edited(lambda document: node(document, name).update(values))


def set_extras(name: str, /, **values: Any) -> Callable[[bytes], bytes]:
    return edited(lambda document: node(document, name)["extras"].update(values))


def shared_child(document: Document) -> None:
    node(document, "chair_0002")["children"] = node(document, "chair_0003")["children"]


def circle(document: Document) -> None:
    """Two nodes below one another."""
    document["nodes"] += [{"name": "a", "children": [len(document["nodes"]) + 1]}, {"name": "b", "children": [len(document["nodes"])]}]


def spoil_position(data: bytes) -> bytes:
    """A position that is no number."""
    document, binary = open_glb(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    return close_glb(document, binary[:start] + struct.pack("<f", float("nan")) + binary[start + 4 :])


def spoil_index(data: bytes) -> bytes:
    """A triangle of a vertex that does not exist."""
    document, binary = open_glb(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    return close_glb(document, binary[:start] + b"\x7f\x7f\x00\x00" + binary[start + 4 :])


def shift_indices(document: Document) -> None:
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    accessor.update(byteOffset=1, count=3)


def drop_corner(document: Document) -> None:
    document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["count"] -= 1


def shorten_attribute(document: Document) -> None:
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    other = next(value for name, value in attributes.items() if name != "POSITION")
    document["accessors"][other]["count"] = 1


def shear(document: Document) -> None:
    box = node(document, BOX)
    for key in ("translation", "rotation", "scale"):
        del box[key]
    box["matrix"] = [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def add_image(document: Document, image: Document) -> None:
    document["images"] = [image]


def drop_bounds(document: Document) -> None:
    for accessor in document["accessors"]:
        accessor.pop("min", None)


def grow_bounds(document: Document) -> None:
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    accessor["max"] = [value + 1.0 for value in accessor["max"]]


BOX = "box_0004"
ENDLESS = {"componentType": 5126, "count": 10**9, "type": "VEC3"}

DAMAGES: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "cut file": ("container", lambda data: data[: len(data) // 2], "is not a GLB"),
    "no glTF": ("container", lambda data: b"not a binary at all" * 5, "does not begin with 'glTF'"),
    "glTF 1.0": ("container", edited(lambda d: d["asset"].update(version="1.0")), "1.0"),
    "nodes that are none": ("shape", edited(lambda d: d.update(nodes=[1, 2])), "nodes"),
    "mesh without primitives": ("shape", edited(lambda d: d["meshes"][0].update(primitives=[])), "primitives"),
    "mesh by name": ("shape", edited(lambda d: d["nodes"][0].update(mesh="box")), "mesh is 'box'"),
    "mesh that is not there": ("references", edited(lambda d: d["nodes"][0].update(mesh=999)), "mesh 999"),
    "material that is not there": ("references", edited(lambda d: d["meshes"][0]["primitives"][0].update(material=99)), "99"),
    "texture that is not there": (
        "references", edited(lambda d: d.update(materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 7}}}])), "7 of 0",
    ),
    "no scene": ("references", edited(lambda d: d.update(scenes=[])), "scene 0 of 0"),
    "child that is not there": ("references", set_node(BOX, children=[12345]), "12345"),
    "buffer elsewhere": ("buffers", edited(lambda d: d["buffers"][0].update(uri="scene.bin")), "outside"),
    "buffer that is longer": ("buffers", edited(lambda d: d["buffers"][0].update(byteLength=10**8)), "100000000"),
    "view beyond its buffer": ("buffers", edited(lambda d: d["bufferViews"][0].update(byteLength=10**7)), "beyond its buffer"),
    "accessor beyond its view": ("buffers", edited(lambda d: d["accessors"][0].update(count=10**6)), "beyond its view"),
    "unknown numbers": ("buffers", edited(lambda d: d["accessors"][0].update(componentType=5130)), "5130"),
    "position that is no number": ("geometry", spoil_position, "not finite"),
    "triangle of no vertex": ("geometry", spoil_index, "names vertex"),
    "no bounds": ("geometry", edited(drop_bounds), "bounds"),
    "more than there is": ("budget", edited(lambda d: d["accessors"].append(ENDLESS)), "ask for"),
    "wrong bounds": ("geometry", edited(grow_bounds), "lie within"),
    "indices between numbers": ("buffers", edited(shift_indices), "no multiple of its numbers' size"),
    "corners that make no triangle": ("geometry", edited(drop_corner), "no multiple of 3"),
    "fewer colors than positions": ("geometry", edited(lambda d: shorten_attribute(d)), "positions, but 1 of"),
    "object without a mesh": ("geometry", edited(lambda d: node(d, BOX).pop("children")), "without a mesh"),
    "image elsewhere": ("images", edited(lambda d: add_image(d, {"uri": "wood.png"})), "outside"),
    "image that is none": ("images", edited(lambda d: add_image(d, {"bufferView": 0, "mimeType": "image/png"})), "cannot be read"),
    "node with two parents": ("tree", edited(shared_child), "2 parents"),
    "required extension": ("features", edited(lambda d: d.update(extensionsRequired=["ACME_walls"])), "ACME_walls"),
    "nodes in a circle": ("tree", edited(circle), "below itself"),
    "empty scene": ("tree", edited(lambda d: d["scenes"][0].update(nodes=[])), "no nodes"),
    "no name": ("names", edited(lambda d: node(d, BOX).pop("name")), "no name"),
    "one name twice": ("names", set_node(BOX, name="chair_0002"), "chair_0002"),
    "rotation of length 2": ("rigid_pose", set_node(BOX, rotation=[0, 0, 0, 2]), "length 2"),
    "matrix and rotation": ("rigid_pose", set_node(BOX, matrix=np.eye(4).ravel().tolist()), "as well"),
    "sheared matrix": ("rigid_pose", edited(shear), "sheared"),
    "rotation of three numbers": ("rigid_pose", set_node(BOX, rotation=[0, 0, 1]), "4 finite numbers"),
    "flat": ("rigid_pose", set_node(BOX, scale=[1, 0, 1]), "scale"),
    "place that is no number": ("rigid_pose", set_node(BOX, translation=[float("inf"), 0, 0]), "translation"),
    "mass below zero": ("mass", set_extras(BOX, mass_kg=-1.0), "-1.0"),
    "inertia of no solid": ("mass", set_extras(BOX, inertia_kg_m2=[[1, 0, 0], [0, 1, 0], [0, 0, 9]]), "inertia"),
    "no category": ("labels", edited(lambda d: node(d, BOX)["extras"].pop("category")), "category"),
}  # fmt: skip
WARNINGS = {"no category"}
"""Damage that only makes a scene worse, not wrong."""


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, data: bytes, tmp_path: Path) -> None:
    rule, damage, words = DAMAGES[name]
    found = checked(damage(data), tmp_path)
    named = [finding for finding in found if finding.rule == rule and finding.is_error != (name in WARNINGS)]
    assert any(words in str(finding) and "scene.glb" in finding.where for finding in named), found
    assert all(len(str(finding).splitlines()) == 1 and str(tmp_path) not in str(finding) for finding in found)


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _, _ in DAMAGES.values()} == set(RULES)


_VALUES = st.sampled_from([None, -1, 0, 1, 10**12, 1.5, float("nan"), "x", [], {}, [0], [1, 2, 3], {"index": 3}, True])


@pytest.mark.whole
@settings(max_examples=300, deadline=None)
@given(draw=st.data())
def test_no_damage_makes_the_gate_fall_over(draw: st.DataObject, path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Values anywhere in the JSON changed: findings or none, but no error."""
    document, binary = open_glb(path.read_bytes())
    document = copy.deepcopy(document)
    for _ in range(draw.draw(st.integers(1, 3))):
        value: Any = document
        while True:
            keys = sorted(value) if isinstance(value, dict) else range(len(value))
            if not keys:
                break
            key = draw.draw(st.sampled_from(keys))
            inner = value[key]
            if not isinstance(inner, dict | list) or not inner or draw.draw(st.integers(0, 5)) == 0:
                value[key] = copy.deepcopy(draw.draw(_VALUES))
                break
            value = inner
    found = checked(close_glb(json.loads(json.dumps(document)), binary), tmp_path_factory.mktemp("damaged"))
    assert all(finding.rule in RULES for finding in found)


@settings(max_examples=100, deadline=None)
@given(junk=st.binary(max_size=200), keep=st.integers(0, 400))
def test_no_bytes_make_the_gate_fall_over(junk: bytes, keep: int, path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert checked(path.read_bytes()[:keep] + junk, tmp_path_factory.mktemp("junk"))


def test_names_are_asked_of_objects_only(data: bytes, tmp_path: Path) -> None:
    def change(document: Document) -> None:
        for name in (BOX, "chair_0002"):
            node(document, name).pop("extras")
        node(document, BOX).pop("name")

    found = checked(edited(change)(data), tmp_path)
    assert {(finding.rule, finding.is_error) for finding in found} == {("names", False), ("labels", False)}


def test_long_names_are_cut_in_what_is_said(data: bytes, tmp_path: Path) -> None:
    damage = edited(lambda d: node(d, BOX).update(name="n" * 100_000, rotation=[1.0, 1.0, 0.0, 0.0]))
    (tmp_path / "scene.glb").write_bytes(damage(data))
    findings = check_glb(tmp_path / "scene.glb")
    assert findings
    assert all("nnn..." in str(one) and len(str(one)) < 1300 for one in findings)


def test_files_of_others_are_read(realdata: Callable[[str], Path]) -> None:
    """Assets and whole scenes by others: what they lack for a simulator is a warning, and nothing is wrong."""
    files = sorted(realdata("assets").glob("*.glb")) + sorted(realdata("scene_aws_small_house").rglob("*.glb"))
    assert len(files) > 10
    for file in files:
        assert [finding for finding in check_glb(file) if finding.is_error] == []
