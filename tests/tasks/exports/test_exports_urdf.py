"""URDF files of a scene: what is written, read by others' readers, and a gate that catches damage."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks import exports
from tasks.exports import write_folder
from tasks.exports.bodies import Replica
from tasks.exports.urdf import urdf_files
from tasks.exports.urdf.rules import RULES, check_urdf
from tasks.exports.wavefront import dump_obj, load_obj
from tasks.geometry.meshes import canonical, load_glb
from tasks.shell import room_shell
from tests.replicas import Object, furnished, rows_of
from tests.tasks.exports.mesh_damage import dent, edited, flatten, held, lose_image
from tests.tasks.exports.usd.test_exports_usd import replica_of


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_of(furnished()))


def written(root: Path, replica: Replica) -> Path:
    """A replica's URDF files in a folder."""
    write_folder(root, {file.path: file.data for file in urdf_files(replica, exports.ExportsConfig())})
    return root / replica.stem


@pytest.fixture(scope="module")
def folder(replica: Replica, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("urdf"), replica)


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "moved" / "elsewhere"))


def test_a_sound_scene_has_no_findings_wherever_it_lies(folder: Path, copy: Path) -> None:
    assert check_urdf(folder) == []
    assert check_urdf(copy) == []
    assert check_urdf(held(folder)) == []
    for file in sorted(folder.glob("*.urdf")):
        assert check_urdf(file) == []
    text = b"".join(path.read_bytes() for path in (*folder.glob("*.urdf"), *folder.glob("meshes/*.obj"), *folder.glob("meshes/*.mtl")))
    for path in folder.glob("meshes/*"):
        assert path.name.encode() in text, "nothing is there that is not used"


def test_mujoco_reads_every_file_with_its_hulls(replica: Replica, folder: Path) -> None:
    import mujoco

    for body in replica.bodies:
        model = mujoco.MjModel.from_xml_path(str(folder / f"{body.name}.urdf"))
        index = model.body(body.name).id
        assert model.body_mass[index] == pytest.approx(body.mass_kg, rel=1e-9)
        np.testing.assert_allclose(model.body_ipos[index], body.shape.properties.center, atol=1e-9)
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[index])
        turn = axes.reshape(3, 3)
        np.testing.assert_allclose(
            turn @ np.diag(model.body_inertia[index]) @ turn.T, body.inertia, atol=1e-9 * np.trace(body.inertia), rtol=1e-7
        )
        assert model.ngeom == len(body.shape.hulls)


def test_hulls_lose_a_nanometre_at_most(replica: Replica, folder: Path) -> None:
    for body in replica.bodies:
        for index, hull in enumerate(body.shape.hulls):
            mesh: Any = trimesh.load_mesh(folder / "meshes" / f"{body.shape.name}_hull_{index:02d}.obj", process=False)
            np.testing.assert_allclose(mesh.vertices, hull.vertices, atol=1e-9)
            np.testing.assert_array_equal(mesh.faces, hull.faces)
            assert mesh.is_watertight
            assert mesh.volume == pytest.approx(hull.volume, rel=1e-6)


def test_the_room_is_the_replicas_room(replica: Replica, folder: Path) -> None:
    import yourdfpy

    robot = yourdfpy.URDF.load(str(folder / "room.urdf"))
    shell = room_shell(replica.room)
    assert {link.name for link in robot.robot.links} == {"room", *(f"room_{name}" for name, _ in shell)}
    points = np.concatenate([mesh.vertices for _, mesh in shell])
    np.testing.assert_allclose(robot.scene.bounds, [points.min(axis=0), points.max(axis=0)], atol=1e-8)


def test_poses_say_what_urdf_cannot(replica: Replica, folder: Path) -> None:
    told = json.loads((folder / "poses.json").read_text())
    assert [item["name"] for item in told["objects"]] == [body.name for body in replica.bodies]
    for item, body in zip(told["objects"], replica.bodies, strict=True):
        assert (item["is_fixed"], item["category"], item["friction"]) == (body.is_fixed, body.category, body.friction)
        assert {key: item[key] for key in body.provenance} == dict(body.provenance)
        assert item["position_m"] == body.pose[:3, 3].tolist()


def test_images_are_kept_byte_for_byte(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    from tasks.exports.gltf import node_textures

    parts = canonical(load_glb((realdata("assets") / "aws_ShoeRack_01.glb").read_bytes()))
    rows, blobs = rows_of([Object("shoe rack", parts, [], np.eye(4), known=False)])
    place = written(tmp_path, replica_of(rows, blobs))
    assert check_urdf(place) == []
    images = {data for data, _ in node_textures(blobs[rows["assets"][0].mesh_blob]).values()}
    assert {path.read_bytes() for path in (place / "meshes").iterdir() if path.suffix in (".jpg", ".png")} == images
    mesh: Any = trimesh.load_mesh(place / "meshes" / next((place / "meshes").glob("shoe*part_00.obj")).name)
    assert mesh.visual.material.image is not None, "another reader finds the image through the MTL file"


_PLACE = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


@settings(max_examples=100, deadline=None)
@given(points=st.lists(_PLACE, min_size=3, max_size=12), seed=st.integers(0, 99), textured=st.booleans())
def test_meshes_come_back_as_another_reader_has_them(
    points: list[tuple[float, ...]], seed: int, textured: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rng = np.random.default_rng(seed)
    faces = np.array([rng.choice(len(points), 3, replace=False) for _ in range(5)])
    data = dump_obj(points, faces, rng.random((len(points), 2)) if textured else None)
    found = load_obj(data)
    assert found is not None
    np.testing.assert_allclose(found[0], points, atol=5.1e-10)
    np.testing.assert_array_equal(found[1], faces)
    file = tmp_path_factory.mktemp("obj") / "mesh.obj"
    file.write_bytes(data)
    other: Any = trimesh.load_mesh(file, process=False)
    np.testing.assert_array_equal(found[0][found[1]], other.vertices[other.faces])


@pytest.mark.parametrize("line", ["f 1 2 3 4", "f 1 2 -1", "v 1 2", "v 1 2 x", "vn 0 0 1", "l 1 2"])
def test_what_others_write_besides_is_left_to_a_reader_for_all(line: str) -> None:
    assert load_obj(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" + line.encode()) is None


# ---- damage


def xml(change: Callable[[ElementTree.Element], None], file: str = "box_0004.urdf") -> Callable[[Path], None]:
    """Change a file's XML."""

    def damage(folder: Path) -> None:
        root = ElementTree.fromstring((folder / file).read_bytes())
        change(root)
        (folder / file).write_bytes(ElementTree.tostring(root))

    return damage


def put(where: str, key: str, value: str, file: str = "box_0004.urdf") -> Callable[[Path], None]:
    """Set an attribute of an element that is there."""

    def change(root: ElementTree.Element) -> None:
        element = root.find(where) if where != "." else root
        assert element is not None, where
        element.set(key, value)

    return xml(change, file)


def drop(pattern: str, where: str = "link", file: str = "box_0004.urdf") -> Callable[[Path], None]:
    """Take children out of an element that is there."""

    def change(root: ElementTree.Element) -> None:
        parent = root.find(where) if where != "." else root
        assert parent is not None, where
        found = parent.findall(pattern)
        assert found, pattern
        for child in found:
            parent.remove(child)

    return xml(change, file)


def told(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    """Change what poses.json says."""

    def damage(folder: Path) -> None:
        about = json.loads((folder / "poses.json").read_text())
        change(about)
        (folder / "poses.json").write_text(json.dumps(about))

    return damage


def hull_file(folder: Path) -> Path:
    """The box's only hull."""
    root = ElementTree.fromstring((folder / "box_0004.urdf").read_bytes())
    mesh = root.find("link/collision/geometry/mesh")
    assert mesh is not None
    return folder / mesh.attrib["filename"]


def other_units(root: ElementTree.Element) -> None:
    """Kilograms times square centimetres."""
    inertia = root.find("link/inertial/inertia")
    assert inertia is not None
    for key, value in inertia.attrib.items():
        inertia.set(key, repr(1e4 * float(value)))


INERTIA = "link/inertial/inertia"
JOINT = "joint[@name='room_floor']/child"
DAMAGES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "cut file": ("xml", lambda folder: (folder / "box_0004.urdf").write_text("<robot name='r'"), "box_0004.urdf"),
    "another root": ("xml", lambda folder: (folder / "box_0004.urdf").write_text("<mujoco/>"), "mujoco"),
    "robot without name": ("names", put(".", "name", ""), "no name"),
    "link without name": ("names", put("link", "name", ""), "link has no name"),
    "one name twice": ("names", put("link[@name='room_floor']", "name", "room_wall_00", "room.urdf"), "room_wall_00"),
    "joint to nothing": ("tree", put(JOINT, "link", "cellar", "room.urdf"), "cellar"),
    "link that hangs on nothing": ("tree", drop("joint", ".", "room.urdf"), "hang on nothing"),
    "link that hangs on itself": ("tree", put("joint[@name='room_floor']/parent", "link", "room_floor", "room.urdf"), "itself"),
    "no link": ("tree", drop("link", "."), "no link"),
    "position that is no number": ("numbers", put("link/inertial/origin", "xyz", "nan 0 0"), "origin xyz"),
    "two numbers for three": ("numbers", put("link/collision/origin", "xyz", "0 0"), "3 finite numbers"),
    "lost mesh": ("closed_paths", lambda folder: hull_file(folder).unlink(), "does not exist"),
    "absolute path": ("closed_paths", put("link/visual/geometry/mesh", "filename", "/srv/box.obj"), "box.obj"),
    "path out of the folder": ("closed_paths", put("link/visual/geometry/mesh", "filename", "../box.obj"), "leaves"),
    "lost image": ("closed_paths", lose_image, "lost.png"),
    "lost material": ("closed_paths", lambda folder: sorted(folder.glob("meshes/*.mtl"))[0].unlink(), ".mtl"),
    "empty mesh": ("mesh", lambda folder: hull_file(folder).write_text("v 0 0 0\n"), "box_0004"),
    "mesh that is none": ("mesh", lambda folder: hull_file(folder).write_bytes(b"\x00\xff" * 50), "box_0004"),
    "mesh without a size": ("mesh", put("link/collision/geometry/mesh", "scale", "0 1 1"), "scale"),
    "flat mesh": ("mesh", edited(hull_file, flatten), "flat"),
    "no mass": ("mass", put("link/inertial/mass", "value", "0"), "is 0"),
    "mass below zero": ("mass", put("link/inertial/mass", "value", "-2"), "-2"),
    "nothing said of mass": ("mass", drop("inertial"), "not stated"),
    "inertia of no solid": ("inertia", put(INERTIA, "ixx", "90"), "exceeds"),
    "inertia in other units": ("inertia", xml(other_units), "farthest corner"),
    "inertia below zero": ("inertia", put(INERTIA, "ixx", "-1"), "principal moments"),
    "no inertia": ("inertia", drop("inertia", "link/inertial"), "not stated"),
    "center of mass outside": ("center_of_mass", put("link/inertial/origin", "xyz", "3 0 0"), "outside"),
    "no collision": ("collider", drop("collision"), "no collision"),
    "nothing is seen": ("visual", drop("visual"), "seen"),
    "dented hull": ("explicit_hulls", edited(hull_file, dent), "inside its own hull"),
    "no poses": ("poses", lambda folder: (folder / "poses.json").unlink(), "poses.json"),
    "file that stands nowhere": ("poses", told(lambda about: about["objects"].pop(0)), "table_0001"),
    "file that is not there": ("poses", lambda folder: (folder / "chair_0002.urdf").unlink(), "chair_0002"),
    "rotation of length 2": ("poses", told(lambda about: about["objects"][1].update(rotation_wxyz=[2, 0, 0, 0])), "chair_0002"),
    "position of two numbers": ("poses", told(lambda about: about["objects"][1].update(position_m=[2, 0])), "position_m"),
    "two objects of one name": ("poses", told(lambda about: about["objects"][1].update(name="table_0001")), "2 objects have this name"),
    "another mass": ("poses", told(lambda about: about["objects"][1].update(mass_kg=4.1)), "mass_kg is 4.1"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    rule, damage, words = DAMAGES[name]
    damage(copy)
    found = [finding for finding in check_urdf(copy) if finding.is_error]
    assert check_urdf(held(copy)) == check_urdf(copy), "files in memory are checked as those of a folder"
    named = [finding for finding in found if finding.rule == rule]
    assert any(words in str(finding) for finding in named), found
    assert all(finding.where.split()[0].endswith((".urdf", "poses.json")) for finding in named), "each names the file"
    assert all(len(str(finding).splitlines()) == 1 and str(copy.parent) not in str(finding) for finding in found)


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _, _ in DAMAGES.values()} == set(RULES)


_VALUES = ("", "x", "-1", "0", "1e300", "0 0 0", "nan", "../x", "meshes", "1 2 3 4")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_no_damage_makes_the_gate_fall_over(data: st.DataObject, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Some attributes changed, some elements gone: findings or none, but no error."""
    file = data.draw(st.sampled_from(["box_0004.urdf", "room.urdf"]))
    root = ElementTree.fromstring((folder / file).read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        parent = data.draw(st.sampled_from([element for element in root.iter() if len(element)] or [root]))
        if not len(parent):
            break
        child = data.draw(st.sampled_from(list(parent)))
        if data.draw(st.booleans()) or not child.attrib:
            parent.remove(child)
        else:
            child.set(data.draw(st.sampled_from(sorted(child.attrib))), data.draw(st.sampled_from(_VALUES)))
    place = tmp_path_factory.mktemp("damaged")
    (place / "meshes").symlink_to(folder / "meshes")
    (place / file).write_bytes(ElementTree.tostring(root))
    assert all(finding.rule in RULES for finding in check_urdf(place / file))
    assert check_urdf(held(place) / file) == check_urdf(place / file)


_JSON = st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=5), lambda inner: st.lists(inner, max_size=4), max_leaves=6)


@settings(max_examples=100, deadline=None)
@given(field=st.sampled_from(["name", "file", "position_m", "rotation_wxyz", "mass_kg"]), value=_JSON, whole=st.booleans())
def test_no_poses_make_the_gate_fall_over(
    field: str, value: Any, whole: bool, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    about = json.loads((folder / "poses.json").read_text())
    about["objects"][0][field] = value
    if whole:
        about["objects"] = value
    place = tmp_path_factory.mktemp("poses")
    (place / "poses.json").write_text(json.dumps(about))
    assert all(finding.rule in RULES for finding in check_urdf(place))


def test_mirrored_meshes_and_those_of_unknown_kinds_are_not_wrong(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "arm.stl")
    (tmp_path / "arm.dae").write_text("<COLLADA/>")
    (tmp_path / "arm.urdf").write_text(
        """<robot name='arm'><link name='base'><visual><geometry><mesh filename='arm.dae'/></geometry></visual>
        <collision><geometry><mesh filename='arm.stl' scale='1 -1 1'/></geometry></collision>
        <inertial><mass value='1'/><inertia ixx='.01' iyy='.01' izz='.01' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>"""
    )
    found = check_urdf(tmp_path / "arm.urdf")
    assert {(finding.rule, finding.is_error) for finding in found} == {("mesh", False)}
    assert len(found) == 2
    assert "pycollada" in str(found)


def test_files_of_others_are_read(tmp_path: Path) -> None:
    """Primitives, no inertia where nothing moves, meshes that only ROS finds: no error."""
    (tmp_path / "lamp.urdf").write_text(
        """<robot name='lamp'><link name='base'><visual><geometry><mesh filename='package://lamp/base.stl'/></geometry></visual>
        <collision><geometry><box size='.1 .1 .1'/></geometry></collision></link><link name='arm'><inertial><mass value='1'/>
        <inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial><visual><geometry><sphere radius='1'/></geometry></visual>
        <collision><geometry><sphere radius='1'/></geometry></collision></link>
        <joint name='hinge' type='revolute'><parent link='base'/><child link='arm'/><limit lower='0' upper='1' effort='1' velocity='1'/>
        </joint></robot>"""
    )
    found = check_urdf(tmp_path / "lamp.urdf")
    assert [finding for finding in found if finding.is_error] == []
    assert {finding.rule for finding in found} == {"closed_paths"}
