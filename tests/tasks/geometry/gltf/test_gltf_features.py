"""The table of glTF features: read, noted or refused, and never silent."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import InputError
from tasks.exports.glb.rules import check_glb
from tasks.geometry.gltf.features import CORE, EXTENSIONS, check_features, find_features
from tasks.geometry.gltf.plain import read_features
from tasks.geometry.meshes import load_glb
from tests.conftest import REPOSITORY
from tests.tasks.geometry.gltf import files as gltf_files
from tests.tasks.geometry.gltf.files import TABLES, Gltf, box


def notes_of(made: Gltf) -> list[str]:
    notes = read_features(made.data(), "room.glb").notes
    assert all(note.startswith("room.glb: ") for note in notes)
    return [note.removeprefix("room.glb: ") for note in notes]


@pytest.mark.parametrize("name", ["ACME_shapes", "KHR_technique_webgl", "KHR_gaussian_splatting"])
def test_unknown_extensions_are_refused_if_required_and_noted_otherwise(name: str) -> None:
    with pytest.raises(InputError, match=rf"^room\.glb: extensionsRequired: uses {name}: "):
        load_glb(gltf_files.plain().use(name).data(), "room.glb")
    assert notes_of(gltf_files.plain().use(name, is_required=False)) == [f"{name}: is not read"]
    undeclared = gltf_files.plain()
    undeclared.document["nodes"][0]["extensions"] = {name: {}}
    assert notes_of(undeclared) == [f"{name}: is not read"]


@pytest.mark.parametrize("name", [name for name, feature in EXTENSIONS.items() if feature.treatment == "noted"])
@pytest.mark.parametrize("is_required", [False, True])
def test_known_extensions_that_are_not_read_are_noted(name: str, is_required: bool) -> None:
    made = gltf_files.plain().use(name, is_required=is_required)
    assert notes_of(made) == [f"{name}: {EXTENSIONS[name].effect}"]
    assert len(load_glb(made.data())[0].faces) == 60


def with_points() -> Gltf:
    made = gltf_files.plain()
    made.document["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 0})
    return made


def with_animation() -> Gltf:
    made = gltf_files.plain()
    made.document["animations"] = [{"channels": [], "samplers": []}]
    return made


def with_scenes() -> Gltf:
    made = gltf_files.plain()
    made.document["scenes"].append({"nodes": []})
    return made


def with_outsider() -> Gltf:
    made = gltf_files.plain()
    made.node("spare", is_root=False, mesh=made.mesh(*box((9, 9, 9), (0, 0, 0))))
    return made


def with_cut_out() -> Gltf:
    made = gltf_files.plain()
    made.document["materials"] = [{"alphaMode": "MASK"}]
    return made


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (with_points, "points and lines"), (with_animation, "animations"), (gltf_files.filmed, "cameras"),
        (with_scenes, "several scenes"), (with_outsider, "meshes outside the scene"), (with_cut_out, "cut-outs and transparency"),
    ],
)  # fmt: skip
def test_features_of_the_standard_that_are_not_read_are_noted(make: Any, name: str) -> None:
    (note,) = notes_of(make())
    assert re.fullmatch(rf"{name}( \(\d+ times\))?: {CORE[name].effect}", note)
    assert sum(len(part.faces) for part in load_glb(make().data())) == 60


def without_scene() -> Gltf:
    made = gltf_files.plain()
    del made.document["scenes"], made.document["scene"]
    return made


def of_version_1() -> Gltf:
    made = gltf_files.plain()
    made.document["asset"]["version"] = "1.0"
    return made


def elsewhere() -> Gltf:
    made = gltf_files.plain()
    made.document["buffers"] = [{"byteLength": 9, "uri": "room.bin"}]
    return made


@pytest.mark.parametrize(("make", "name"), [(without_scene, "no scene"), (of_version_1, "glTF 1.0"), (elsewhere, "data in other files")])
def test_features_without_which_geometry_is_wrong_are_refused(make: Any, name: str) -> None:
    with pytest.raises(InputError, match=rf"^room\.glb: feature: uses {name}: {CORE[name].effect}; "):
        load_glb(make().data(), "room.glb")


@pytest.mark.parametrize(
    ("material", "problem"),
    [
        ({"pbrMetallicRoughness": ["wood"]}, "material 0: pbrMetallicRoughness is not an object"),
        (gltf_files.colored_by(index=-1), "material 0: baseColorTexture names texture -1 of 1"),
        (gltf_files.colored_by(index=5), "material 0: baseColorTexture names texture 5 of 1"),
        ({"normalTexture": {"scale": "much"}}, "material 0: normalTexture names texture None of 1"),
        (gltf_files.colored_by(extensions={"KHR_texture_transform": "turned"}), "extensions: KHR_texture_transform is not an object"),
    ],
)
def test_values_of_the_wrong_kind_are_refused(material: dict[str, Any], problem: str) -> None:
    data = gltf_files.painted(material, {"TEXCOORD_0": [0.5, 0.5]}).data()
    with pytest.raises(InputError, match=rf"^room\.glb: {problem}; "):
        load_glb(data, "room.glb")


def test_a_plain_table_uses_nothing_that_is_told() -> None:
    assert notes_of(gltf_files.plain()) == []
    assert find_features(gltf_files.plain().document) == []
    data = gltf_files.plain().data()
    assert read_features(data, "room.glb").data is data


@pytest.mark.parametrize("name", [name for name in TABLES if name != "base64"])  # which the rule of buffers finds
def test_doctor_finds_no_fault_in_features_that_are_read(name: str, tmp_path: Any) -> None:
    path = tmp_path / "table.glb"
    path.write_bytes(TABLES[name]().data())
    allowed = {"labels", "features", "rigid_pose"}
    assert {finding.rule for finding in check_glb(path)} <= allowed
    assert not [finding for finding in check_glb(path) if finding.is_error]


@pytest.mark.parametrize(
    ("make", "message", "is_error"),
    [
        (lambda: gltf_files.plain().use("ACME_shapes"), "ACME_shapes: the file requires it, and it is not read", True),
        (lambda: gltf_files.plain().use("ACME_shapes", is_required=False), "ACME_shapes: is not read", False),
        (with_animation, "animations: are not played: the pose at rest is read", False),
        (without_scene, "no scene: nothing says which nodes are shown", True),
    ],
)
def test_doctor_tells_features_from_the_same_table(make: Any, message: str, is_error: bool, tmp_path: Any) -> None:
    path = tmp_path / "room.glb"
    path.write_bytes(make().data())
    found = [finding for finding in check_glb(path) if finding.rule == "features"]
    assert [(finding.message, finding.is_error) for finding in found] == [(message, is_error)]


def test_doctor_finds_compressed_data_that_cannot_be_decoded(tmp_path: Any) -> None:
    path = tmp_path / "table.glb"
    made = gltf_files.meshopt()
    made.binary = bytes(len(made.binary))
    path.write_bytes(made.data())
    (finding,) = [finding for finding in check_glb(path) if finding.is_error]
    assert finding.rule == "features"
    assert "EXT_meshopt_compression cannot be decoded" in finding.message


def test_the_documentation_names_every_feature_of_the_table() -> None:
    text = (REPOSITORY / "docs" / "formats.md").read_text()
    assert [name for name in (*EXTENSIONS, *CORE) if name not in text] == []


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        (("meshes", 0, "primitives"), {}, "mesh 0: primitives: is not a list of objects"),
        (("meshes", 0, "primitives"), [1], "mesh 0: primitives: is not a list of objects"),
        (("materials",), {}, "materials: is not a list of objects"),
        (("samplers",), [None], "samplers: is not a list of objects"),
        (("scenes", 0, "nodes"), 0, "scene 0: nodes: is not a list of nodes"),
        (("scenes", 0, "nodes"), [0, 99], "scene 0: nodes: names node 99 of"),
        (("nodes", 0, "children"), None, "node 0: children: is not a list of nodes"),
        (("nodes", 0, "children"), ["0"], "node 0: children: names node '0' of"),
        (("nodes", 0, "children"), [0], "node 0: lies below itself"),
        (("nodes", 0, "name"), 7, "nodes 0: has the name 7, which is not a text"),
        (("scenes", 0, "name"), [], "scenes 0: has the name"),
        (("scene",), "0", "scene: is '0', not a number"),
    ],
)
def test_values_of_the_wrong_kind_are_refused_by_name(path: tuple[str | int, ...], value: Any, problem: str) -> None:
    made = gltf_files.plain()
    holder: Any = made.document
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    with pytest.raises(InputError, match=rf"^room\.glb: {re.escape(problem)}"):
        read_features(made.data(), "room.glb")


@pytest.mark.parametrize("mode", range(4))
def test_a_file_of_points_and_lines_alone_is_refused_by_name(mode: int) -> None:
    made = gltf_files.plain()
    made.document["meshes"][0]["primitives"][0]["mode"] = mode
    with pytest.raises(InputError, match="holds no triangles, only points and lines"):
        read_features(made.data(), "room.glb")


ODD_VALUES: list[Any] = [[1], [], {}, {"a": [1]}, "x", None, True, 1.5, 4.0, -1, 7, 10**30, [[]], float("nan"), float("inf")]


def paths_of(value: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Keys that lead to each value of a document."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path for key, entry in inner for path in ((*above, key), *paths_of(entry, (*above, key)))]


def odd_documents() -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """Documents of one odd value each, and its place."""
    for make in (gltf_files.plain, gltf_files.filmed, with_cut_out, with_scenes, with_animation):
        document = {**make().document, "extensionsUsed": ["KHR_xmp"], "extensionsRequired": ["KHR_xmp"]}
        document["meshes"][0]["primitives"][0]["mode"] = 4
        document["nodes"][0].setdefault("extensions", {"KHR_node_visibility": {"visible": True}})
        for *above, last in paths_of(document):
            for value in ODD_VALUES:
                altered = copy.deepcopy(document)
                holder: Any = altered
                for key in above:
                    holder = holder[key]
                holder[last] = copy.deepcopy(value)
                yield (*above, last), altered


def test_values_of_any_kind_are_read_or_refused_in_one_line() -> None:
    refused = set()
    for path, document in odd_documents():
        find_features(document)
        try:
            check_features(document, "room.glb")
        except InputError as error:
            refused |= {path} if "\n" not in str(error) else set()
    assert {("meshes", 0, "primitives", 0, "mode"), ("scene",), ("nodes",), ("scenes", 0, "nodes", 0)} <= refused


@pytest.mark.parametrize("mode", [[1], {}, "4", None, True, 4.0, -1, 7, 10**30])
def test_a_mode_that_is_not_a_mode_is_refused_by_readers_and_doctor(mode: Any, tmp_path: Path) -> None:
    made = gltf_files.plain()
    made.document["meshes"][0]["primitives"][0]["mode"] = mode
    with pytest.raises(InputError, match=r"^room\.glb: mesh 0: a primitive has the mode .*, not a number from 0 to 6"):
        load_glb(made.data(), "room.glb")
    (tmp_path / "room.glb").write_bytes(made.data())
    assert [finding.rule for finding in check_glb(tmp_path / "room.glb")] == ["shape"]
