"""Small files that ask for much are refused before they are unpacked; sound files are read as before."""

from __future__ import annotations

import contextlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks import containers
from tasks.exports.glb.rules import check_glb
from tasks.exports.urdf.rules import _poses
from tasks.geometry.meshes import load_glb, surface_of
from tasks.unpacking import image_pixels
from tests import attacks

LOADED = """
import sys
from pathlib import Path
from schemas.errors import InputError
from tasks.geometry.meshes import load_glb, surface_of
for name in sys.argv[1:]:
    try:
        surface_of(load_glb(Path(name).read_bytes(), "scene.glb"))
    except InputError as error:
        print(error)
    else:
        print("read")
"""

CHECKED = """
import sys
from pathlib import Path
from tasks.exports.glb.rules import check_glb
for name in sys.argv[1:]:
    print([str(finding) for finding in check_glb(Path(name)) if finding.is_error])
"""


@pytest.fixture(scope="module")
def bombs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bombs")
    paths = {name: folder / f"{name}.glb" for name in attacks.GLB_BOMBS}
    for name, path in paths.items():
        path.write_bytes(attacks.GLB_BOMBS[name]())
    return paths


@pytest.mark.whole
def test_a_glb_that_asks_for_more_than_the_budget_is_refused(bombs: dict[str, Path]) -> None:
    said = attacks.below_ceiling(LOADED, *bombs.values()).splitlines()
    assert len(said) == len(bombs)
    for name, line in zip(bombs, said, strict=True):
        assert line.startswith("scene.glb: "), (name, line)


def test_the_check_of_a_glb_says_what_asks_for_more_than_the_budget(bombs: dict[str, Path]) -> None:
    said = attacks.below_ceiling(CHECKED, *bombs.values()).splitlines()
    assert len(said) == len(bombs)
    for name, line in zip(bombs, said, strict=True):
        assert line.startswith(("['budget: ", "['container: ")), (name, line)


def test_a_small_accessor_that_no_buffer_holds_is_found(tmp_path: Path) -> None:
    path = tmp_path / "scene.glb"
    path.write_bytes(attacks.glb([{"mesh": 0}], [0], accessors=[{"componentType": 5126, "count": 3, "type": "VEC3"}]))
    assert "POSITION is 3 zeros that no buffer holds" in str(check_glb(path))


def test_bytes_may_be_shared_as_often_as_a_vertex_has_attributes() -> None:
    assert len(load_glb(attacks.views_of_one_buffer(views=8))) == 1
    assert len(load_glb(attacks.views_of_one_buffer(views=8, plain=True))) == 1
    assert len(load_glb(attacks.attribute_placed(count=1000))) == 200


def test_an_image_is_looked_at_once_however_many_name_it(monkeypatch: pytest.MonkeyPatch) -> None:
    data, looked = attacks.textured(attacks.png(4), images=50), []

    def look(image: bytes) -> int | None:
        looked.append(image)
        return image_pixels(image)

    monkeypatch.setattr(containers, "image_pixels", look)
    containers.weigh_glb(data, "scene.glb")
    assert len(looked) == 1


def test_what_lies_just_within_the_budget_is_read() -> None:
    assert len(load_glb(attacks.nested(BUDGET.depth))) == BUDGET.depth
    with pytest.raises(InputError, match=f"deeper than {BUDGET.depth}"):
        load_glb(attacks.nested(BUDGET.depth + 1))
    assert json_value("[" * BUDGET.depth + "1" + "]" * BUDGET.depth)
    for depth in (BUDGET.depth + 1, 900, 100_000):
        with pytest.raises(ValueError, match="nested deeper"):
            json_value("[" * depth + "]" * depth)


def test_nodes_stand_where_those_above_them_put_them() -> None:
    turn = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]  # a quarter turn about glTF's up axis
    chain = [{"translation": [1, 0, 0], "rotation": turn, "children": [i + 1]} for i in range(4)]
    (part,) = load_glb(attacks.glb([*chain, {"mesh": 0, "name": "chair", "translation": [0, 2, 0]}], [0]))
    # four steps, each a meter ahead and a quarter turn: back where they began; then two meters up
    assert np.allclose(part.vertices, [[0, 0, 2], [1, 0, 2], [0, 0, 3]], atol=1e-9)


def test_nodes_that_lie_below_themselves_are_refused() -> None:
    with pytest.raises(InputError, match="lies below itself"):
        load_glb(attacks.glb([{"children": [1]}, {"mesh": 0, "children": [0]}], [0]))


@pytest.mark.parametrize(
    "material",
    [{"pbrMetallicRoughness": {"baseColorTexture": value}} for value in (5, "wood", True, 1.5)]
    + [{"pbrMetallicRoughness": {"baseColorFactor": value}} for value in (1, [], [1, 1], ["a"] * 4, [[1, 1, 1, 1]])]
    + [{"normalTexture": 1}, {"pbrMetallicRoughness": 3}],
    ids=str,
)  # fmt: skip
def test_a_material_of_odd_values_is_refused_and_found(material: dict[str, object], tmp_path: Path) -> None:
    data = attacks.textured(attacks.png(4), material)
    with pytest.raises(InputError, match=r"^chair\.glb: "):
        load_glb(data, "chair.glb")
    path = tmp_path / "chair.glb"
    path.write_bytes(data)
    assert any(finding.rule in ("shape", "references") for finding in check_glb(path))


def test_a_cut_texture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^chair\.glb: images: cannot be decoded"):
        load_glb(attacks.textured(attacks.png(400)[:200]), "chair.glb")


ODD = (float("nan"), 1e400, 10**400, 10**30, -1, 1.5, "3", None, True, [], {})


@pytest.mark.parametrize("place", [
    "accessors.0.count", "accessors.0.byteOffset", "accessors.0.componentType", "accessors.0.type", "accessors.0.min", "accessors.0.max",
    "accessors.0.bufferView", "bufferViews.0.byteLength", "bufferViews.0.byteOffset", "bufferViews.0.byteStride", "bufferViews.0.buffer",
    "buffers.0.byteLength", "nodes.0.mesh", "nodes.0.children", "nodes.0.translation", "nodes.0.rotation", "nodes.0.scale", "nodes.0.name",
    "nodes.0.matrix", "nodes.0.extras", "scenes.0.nodes", "scenes", "scene", "meshes.0.primitives", "meshes.0.primitives.0.attributes",
    "meshes.0.primitives.0.attributes.POSITION", "meshes.0.primitives.0.mode", "meshes.0.primitives.0.indices",
    "meshes.0.primitives.0.material", "nodes", "meshes", "accessors", "bufferViews", "buffers", "asset", "asset.version",
])  # fmt: skip
@pytest.mark.parametrize("shape", ["value", "list of 3", "list of 4"])
def test_odd_values_anywhere_are_findings_or_refusals_and_no_defect(place: str, shape: str, tmp_path: Path) -> None:
    for value in ODD:
        made = attacks.document([{"mesh": 0, "name": "chair"}], [0])
        at, keys = made, [int(key) if key.isdigit() else key for key in place.split(".")]
        for key in keys[:-1]:
            at = at[key]  # type: ignore[index]
        at[keys[-1]] = value if shape == "value" else [value] * int(shape[-1])  # type: ignore[index]
        data = attacks.close_glb(made, attacks.TRIANGLE.tobytes())
        path = tmp_path / "scene.glb"
        path.write_bytes(data)
        json.dumps([str(finding) for finding in check_glb(path)])
        with contextlib.suppress(InputError):
            surface_of(load_glb(data))


def test_every_model_of_others_is_read_and_found_as_sound_as_before(realdata: Callable[[str], Path]) -> None:
    files = sorted(realdata("assets").glob("*.glb")) + sorted(realdata("scene_aws_small_house").rglob("*.glb"))
    files += sorted(realdata("habitat_sim_test_assets").rglob("*.glb"))
    assert len(files) > 50
    for file in files:
        assert not [finding for finding in check_glb(file) if finding.rule in ("budget", "container")], file
        try:
            load_glb(file.read_bytes(), file.name)
        except InputError as error:
            raise AssertionError(file) from error


UNPACKED = """
import sys
from pathlib import Path
from tasks.exports.habitat.library import read_json
from tasks.exports.habitat.navmesh_file import read_polygons
for name in sys.argv[1:]:
    path, found = Path(name), []
    if path.suffix == ".navmesh":
        try:
            read_polygons(path.read_bytes())
        except ValueError as error:
            print(error)
        continue
    print(read_json(path, path.parent, found, {}), *found)
"""


@pytest.mark.whole
def test_what_is_packed_is_unpacked_to_the_budget_and_no_further(tmp_path: Path) -> None:
    for name, data in {
        "json.json.gz": attacks.json_bomb(),
        "zeros.json.gz": attacks.zero_bomb(),
        "a.navmesh": attacks.navmesh_bomb(),
    }.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "wide.json").write_bytes(b"[" + b"{}," * 20_000_000 + b"{}]")
    said = attacks.below_ceiling(UNPACKED, *(tmp_path / name for name in ("json.json.gz", "zeros.json.gz", "wide.json", "a.navmesh")))
    values, zeros, wide, navmesh = said.splitlines()
    assert values.startswith("None json: json.json.gz: cannot be read (TooMuch: its values take about")
    assert zeros.startswith("None json: zeros.json.gz: cannot be read (ValueError: unpacks to more than 512 MB")
    assert wide.startswith("None json: wide.json: cannot be read (TooMuch: its values take about")
    assert navmesh == "has polygons that lie on one another, more than 256 on each"


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
MODELS = {
    "two numbers.obj": "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n",
    "four of three.obj": "v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n",
    "word.obj": OBJ + "f a b c\n",
    "far corner.obj": OBJ + "f 1 2 99999999999999999999\n",
    "texture.obj": "mtllib large.mtl\nusemtl look\nvt 0 0\n" + OBJ.replace("f 1 2 3", "f 1/1 2/1 3/1"),
    "cut texture.obj": "mtllib cut.mtl\nusemtl look\nvt 0 0\n" + OBJ.replace("f 1 2 3", "f 1/1 2/1 3/1"),
    "counts.ply": "ply\nformat ascii 1.0\nelement vertex 9999999999\nproperty float x\nelement face 1\nend_header\n",
    "empty elements.ply": "ply\nformat binary_little_endian 1.0\nelement nothing 999999999999\nelement vertex 3\nend_header\n",
    "head.ply": "ply\nformat ascii 1.0\nelement vertex\nend_header\n",
    "facets.stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid a\n",
}

IMPORTED = """
import sys
from pathlib import Path
from schemas.errors import InputError
from tasks.ingestion.models import read_model
from tasks.geometry.meshes import surface_of
root = Path(sys.argv[1])
for name in sys.argv[2:]:
    try:
        surface_of(read_model(root / name, root, True)[0])
    except InputError as error:
        print(error)
    else:
        print(f"{name} is read")
"""


@pytest.mark.whole
def test_odd_models_of_finished_datasets_are_refused_in_one_line_each(tmp_path: Path) -> None:
    for name, text in MODELS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "large.png").write_bytes(attacks.png(13_000))
    (tmp_path / "cut.png").write_bytes(attacks.png(300)[:100])
    for name in ("large", "cut"):
        (tmp_path / f"{name}.mtl").write_text(f"newmtl look\nmap_Kd {name}.png\n")
    said = attacks.below_ceiling(IMPORTED, tmp_path, *MODELS).splitlines()
    assert len(said) == len(MODELS), said
    for name, line in zip(MODELS, said, strict=True):
        assert line.startswith(f"{tmp_path.name}/{name}: "), (name, line)
    assert "has not 3 numbers (it has 2)" in said[0]
    assert "pixels" in said[4]
    assert "cannot be decoded" in said[5]


ROBOTS = {
    "deep.urdf": '<robot name="a"><link name="b">' + "<c>" * 100_000 + "</c>" * 100_000 + "</link></robot>",
    "chain.urdf": '<robot name="a">'
    + "".join(f'<link name="l{i}"/>' for i in range(20_001))
    + "".join(f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(20_000))
    + "</robot>",
    "zip.urdf": '<robot name="a"><link name="b"><visual><geometry><mesh filename="bomb.zip"/></geometry></visual></link></robot>',
    "hollow.urdf": '<robot name="a"><link name="b"><visual><geometry><mesh filename="hollow.glb"/></geometry></visual></link></robot>',
}


@pytest.mark.whole
def test_odd_robots_are_findings(tmp_path: Path) -> None:
    for name, text in ROBOTS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "hollow.glb").write_bytes(attacks.without_buffer())
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("0.stl", bytes(1_000_000))
    posed = {"file": "a", "position_m": [0] * 3, "rotation_wxyz": [1, 0, 0, 0], "mass_kg": 1}
    large = {**posed, "position_m": [10**400] * 3}
    for objects in ([["file", "x"]], [[["file", "x"]]], [large], [{**posed, "file": "/dev/zero", "mass_kg": 10**400}]):
        (tmp_path / "poses.json").write_text(json.dumps({"room": "room.urdf", "objects": objects}))
        assert any(finding.rule == "poses" for finding in _poses(tmp_path, []))
    code = "import sys; from pathlib import Path; from tasks.exports.urdf.rules import check_urdf; print(*check_urdf(Path(sys.argv[1])))"
    said = attacks.below_ceiling(code, tmp_path)
    assert "bomb.zip is of a kind that cannot be read here" in said
    assert "hollow.glb cannot be read" in said
    assert "hangs on itself" not in said
