"""Worlds for Gazebo: what is written, read by Gazebo's own reader and by others, and a gate that catches damage."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks import exports
from tasks.exports import write_folder
from tasks.exports.bodies import Replica
from tasks.exports.sdf import VERSION, roll_pitch_yaw, sdf_files
from tasks.exports.sdf.rules import RULES, check_sdf
from tasks.geometry.transforms import is_rigid
from tests.conftest import REPOSITORY
from tests.replicas import cube, furnished, replica_of, rows_of
from tests.tasks.exports.mesh_damage import dent, edited, flatten, held, lose_image
from tests.tasks.exports.test_exports_agreement import Read, moving, posed


def numbers_of(element: ElementTree.Element, path: str) -> np.ndarray:
    """Numbers that are the text of an element."""
    return np.array([float(word) for word in (element.findtext(path) or "").split()])


def read_objects(root: Path) -> dict[str, Read]:
    """Objects of the one world in a folder of exports, in the world frame."""
    (file,) = (root / "sdf").glob("*/world.sdf")
    objects = {}
    for model in ElementTree.parse(file).getroot().iterfind("world/model"):
        link = model.find("link")
        assert link is not None
        if model.get("name") == "room":
            continue
        numbers = numbers_of(model, "pose")
        pose = posed(Rotation.from_euler("xyz", numbers[3:]).as_matrix(), numbers[:3])
        cloud = [
            np.asarray(trimesh.load_mesh(file.parent / (uri.text or "")).vertices) for uri in link.iterfind("visual/geometry/mesh/uri")
        ]
        xx, xy, xz, yy, yz, zz = (float(numbers_of(link, f"inertial/inertia/i{pair}")[0]) for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
        center, mass = numbers_of(link, "inertial/pose"), float(numbers_of(link, "inertial/mass")[0])
        assert not center[3:].any(), "inertia is told along the link's axes"
        points = trimesh.transform_points(np.concatenate(cloud), pose)
        objects[model.attrib["name"]] = moving(pose, mass, center[:3], [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], points)
    return objects


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_of(furnished()))


def written(root: Path, replica: Replica, config: exports.ExportsConfig | None = None) -> Path:
    """A replica's world in a folder."""
    write_folder(root, {file.path: file.data for file in sdf_files(replica, config or exports.ExportsConfig())})
    return root / replica.stem / "world.sdf"


@pytest.fixture(scope="module")
def world(replica: Replica, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("sdf"), replica)


@pytest.fixture
def copy(world: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(world.parent, tmp_path / "moved" / "elsewhere")) / "world.sdf"


@pytest.fixture(scope="module")
def gazebo(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], dict[str, Any]]:
    """Gazebo's own reader of SDF: a world as it understands it."""
    needed = [name for name in ("g++", "pkg-config") if shutil.which(name) is None]
    found = needed or subprocess.run(["pkg-config", "--cflags", "--libs", "sdformat12"], capture_output=True, text=True)
    if isinstance(found, list) or found.returncode:
        pytest.skip("there is no libsdformat 12 to read worlds with: apt-get install libsdformat-dev pkg-config g++")
    made = tmp_path_factory.mktemp("gazebo") / "read"
    source = str(REPOSITORY / "tests" / "sdformat.cpp")
    subprocess.run(["g++", "-std=c++17", "-O0", "-Wall", "-Werror", "-o", str(made), source, *found.stdout.split()], check=True)

    def read(file: Path) -> dict[str, Any]:
        done = subprocess.run([str(made), str(file)], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        seen: dict[str, Any] = json.loads(done.stdout)
        return seen

    return read


def test_a_sound_world_has_no_findings_wherever_it_lies(world: Path, copy: Path) -> None:
    assert check_sdf(world) == []
    assert check_sdf(copy) == []
    assert check_sdf(held(world.parent) / world.name) == []
    text = b"".join(path.read_bytes() for path in (world, *world.parent.glob("meshes/*.obj"), *world.parent.glob("meshes/*.mtl")))
    for path in world.parent.glob("meshes/*"):
        assert path.name.encode() in text, "nothing is there that is not used"


def test_gazebos_reader_has_the_world_as_it_was_meant(gazebo: Callable[[Path], dict[str, Any]], replica: Replica, world: Path) -> None:
    seen = gazebo(world)
    assert (seen["name"], seen["gravity"], seen["step"]) == (replica.stem, [0.0, 0.0, -9.81], [0.001])
    assert seen["lights"][0] >= 1
    models = {model["name"]: model for model in seen["models"]}
    assert list(models) == ["room", *(body.name for body in replica.bodies)]
    assert models["room"]["static"]
    for body in replica.bodies:
        model = models[body.name]
        x, y, z, qw, qx, qy, qz = model["pose"]
        np.testing.assert_allclose([x, y, z], body.pose[:3, 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(Rotation.from_quat([qx, qy, qz, qw]).as_matrix(), body.pose[:3, :3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(model["center"], [*body.shape.properties.center, 1, 0, 0, 0], rtol=0, atol=1e-12)
        assert model["mass"] == [body.mass_kg]
        np.testing.assert_allclose(model["moments"], body.inertia[np.triu_indices(3)], rtol=1e-12, atol=1e-15)
        assert model["static"] == body.is_fixed
        assert [rubs[1:] for rubs in model["collisions"]] == [[body.friction, body.friction]] * len(body.shape.hulls)
        assert model["visuals"]
    named = {uri for model in seen["models"] for uri in (*model["visuals"], *(rubs[0] for rubs in model["collisions"])) if uri}
    assert all((world.parent / uri).is_file() for uri in named)
    assert {rubs[0] for rubs in models["room"]["collisions"]} >= {"", "meshes/room_wall_00_hull_00.obj"}
    # of two that touch Gazebo's engines take the smaller friction
    assert min(mu for _, mu, _ in models["room"]["collisions"]) >= max(body.friction for body in replica.bodies)


def test_gazebos_reader_takes_a_textured_world(
    gazebo: Callable[[Path], dict[str, Any]], realdata: Callable[[str], Path], tmp_path: Path
) -> None:
    from tasks.geometry.meshes import canonical, load_glb
    from tests.replicas import Object

    parts = canonical(load_glb((realdata("assets") / "aws_ShoeRack_01.glb").read_bytes()))
    hull: Any = trimesh.util.concatenate(parts)
    hull = hull.convex_hull
    rack = replica_of(*rows_of([Object("shoe rack", parts, [hull], np.eye(4))]))
    file = written(tmp_path, rack)
    assert check_sdf(file) == []
    (_, model) = gazebo(file)["models"]
    materials = [(file.parent / uri).with_suffix(".mtl").read_text() for uri in model["visuals"]]
    images = [line.split()[1] for text in materials for line in text.splitlines() if line.startswith("map_Kd")]
    assert images
    assert all((file.parent / "meshes" / image).is_file() for image in images)


def test_collision_meshes_are_the_replicas_hulls(replica: Replica, world: Path) -> None:
    models = {model.get("name"): model for model in ElementTree.parse(world).getroot().iter("model")}
    for body in replica.bodies:
        uris = [uri.text or "" for uri in models[body.name].iterfind("link/collision/geometry/mesh/uri")]
        for uri, hull in zip(uris, body.shape.hulls, strict=True):
            mesh = trimesh.load_mesh(world.parent / uri, process=False)
            np.testing.assert_allclose(np.asarray(mesh.vertices)[np.asarray(mesh.faces)], hull.vertices[hull.faces], rtol=0, atol=1e-9)


def test_walls_collide_where_the_room_has_them(replica: Replica, world: Path) -> None:
    walls = {name: part for name, part in replica.shell if name != "floor"}
    for name, part in walls.items():
        mesh = trimesh.load_mesh(world.parent / "meshes" / f"room_{name}_hull_00.obj")
        assert mesh.volume == pytest.approx(part.volume, rel=1e-6)
        np.testing.assert_allclose(mesh.bounds, part.bounds, rtol=0, atol=1e-9)


@given(turn=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3), locked=st.sampled_from([None, 1.0, -1.0]))
def test_angles_turn_as_the_rotation_that_they_are_made_of(turn: tuple[float, ...], locked: float | None) -> None:
    """Also where the pitch is a quarter turn, nearly or exactly, and roll and yaw are one."""
    rotation = Rotation.from_quat(turn)
    if locked is not None:
        rotation = Rotation.from_euler("xyz", [3.0 * turn[0], locked * (np.pi / 2 - 1e-9 * turn[1]), turn[2]])
    again = Rotation.from_euler("xyz", roll_pitch_yaw(rotation.as_matrix()))
    assert (rotation.inv() * again).magnitude() < 3e-6
    assert is_rigid(posed(again.as_matrix(), np.zeros(3)))


def test_objects_without_images_have_colors_in_the_world_itself(tmp_path: Path) -> None:
    file = written(tmp_path, replica_of(*rows_of([cube((0.2, 0.2, 0.2), np.eye(4))])))
    (model,) = [model for model in ElementTree.parse(file).getroot().iter("model") if model.get("name") != "room"]
    np.testing.assert_allclose(numbers_of(model, "link/visual/material/diffuse"), [200 / 255, 40 / 255, 30 / 255, 1], atol=1e-6)


# ---- damage


def xml(change: Callable[[ElementTree.Element], None]) -> Callable[[Path], None]:
    """Change the world's XML."""

    def damage(file: Path) -> None:
        root = ElementTree.fromstring(file.read_bytes())
        change(root)
        file.write_bytes(ElementTree.tostring(root))

    return damage


def text(where: str, value: str) -> Callable[[Path], None]:
    """Change the text of an element that is there."""

    def change(root: ElementTree.Element) -> None:
        element = root.find(where)
        assert element is not None, where
        element.text = value

    return xml(change)


def name(where: str, value: str) -> Callable[[Path], None]:
    """Rename an element that is there."""

    def change(root: ElementTree.Element) -> None:
        element = root.find(where)
        assert element is not None, where
        element.set("name", value)

    return xml(change)


def drop(pattern: str, where: str) -> Callable[[Path], None]:
    """Take children out of an element that is there."""

    def change(root: ElementTree.Element) -> None:
        parent = root.find(where)
        assert parent is not None, where
        children = parent.findall(pattern)
        assert children, pattern
        for child in children:
            parent.remove(child)

    return xml(change)


BOX = "world/model[@name='box_0004']"
HULL = f"{BOX}/link/collision/geometry/mesh"


def hull_file(file: Path) -> Path:
    """The box's only hull."""
    return file.parent / (ElementTree.parse(file).getroot().findtext(f"{HULL}/uri") or "")


def other_units(root: ElementTree.Element) -> None:
    """Kilograms times square centimetres."""
    inertia = root.find(f"{BOX}/link/inertial/inertia")
    assert inertia is not None
    for element in inertia:
        element.text = repr(1e4 * float(element.text or ""))


def scaled(value: str) -> Callable[[Path], None]:
    def change(root: ElementTree.Element) -> None:
        mesh = root.find(HULL)
        assert mesh is not None
        ElementTree.SubElement(mesh, "scale").text = value

    return xml(change)


def mapped(value: str) -> Callable[[Path], None]:
    def change(root: ElementTree.Element) -> None:
        material = root.find(f"{BOX}/link/visual/material")
        assert material is not None
        ElementTree.SubElement(ElementTree.SubElement(ElementTree.SubElement(material, "pbr"), "metal"), "albedo_map").text = value

    return xml(change)


DAMAGES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "cut file": ("xml", lambda file: file.write_bytes(file.read_bytes()[:500]), "cannot be read"),
    "another root": ("xml", lambda file: file.write_text("<robot name='r'/>"), "robot"),
    "no version": ("xml", lambda file: file.write_text("<sdf><world name='a'/></sdf>"), "version None"),
    "no world": ("world", drop("world", "."), "0 worlds"),
    "model without name": ("names", name(BOX, ""), "no name"),
    "one name twice": ("names", name(BOX, "room"), "2 things in it are called room"),
    "name of a frame of SDF's own": ("names", name(f"{BOX}/link", "__model__"), "keeps for itself"),
    "name with a scope": ("names", name(BOX, "box::one"), "keeps for itself"),
    "collision by the name of a visual": ("names", name(f"{BOX}/link/collision", "part_00"), "called part_00"),
    "position that is no number": ("numbers", text(f"{BOX}/pose", "nan 0 0 0 0 0"), "6 finite numbers"),
    "quaternion for angles": ("numbers", text(f"{BOX}/pose", "0 0 0 1 0 0 0"), "6 finite numbers"),
    "gravity of the moon": ("gravity", text("world/gravity", "0 0 -1.62"), "1.62"),
    "gravity along Y": ("gravity", text("world/gravity", "0 -9.81 0"), "gravity"),
    "long steps": ("timestep", text("world/physics/max_step_size", "0.1"), "0.1"),
    "darkness": ("viewing", drop("light", "world"), "no light"),
    "lost mesh": ("closed_paths", lambda file: hull_file(file).unlink(), "does not exist"),
    "absolute path": ("closed_paths", text(f"{HULL}/uri", "/srv/box.obj"), "box.obj"),
    "address of a file": ("closed_paths", text(f"{HULL}/uri", "file:///srv/box.obj"), "box.obj"),
    "path out of the folder": ("closed_paths", text(f"{HULL}/uri", "../box.obj"), "leaves"),
    "lost image": ("closed_paths", lambda file: lose_image(file.parent), "lost.png"),
    "lost albedo": ("closed_paths", mapped("meshes/lost.png"), "lost.png"),
    "albedo out of the folder": ("closed_paths", mapped("../lost.png"), "leaves"),
    "empty mesh": ("mesh", lambda file: hull_file(file).write_text("v 0 0 0\n"), "box_0004"),
    "mesh without a size": ("mesh", scaled("0 1 1"), "scale"),
    "flat mesh": ("mesh", edited(hull_file, flatten), "flat"),
    "no mass": ("mass", text(f"{BOX}/link/inertial/mass", "0"), "is 0"),
    "nothing said of mass": ("mass", drop("inertial", f"{BOX}/link"), "not stated"),
    "inertia of no solid": ("inertia", text(f"{BOX}/link/inertial/inertia/ixx", "90"), "exceeds"),
    "inertia below zero": ("inertia", text(f"{BOX}/link/inertial/inertia/ixx", "-1"), "principal moments"),
    "inertia in other units": ("inertia", xml(other_units), "farthest corner"),
    "no inertia": ("inertia", drop("inertia", f"{BOX}/link/inertial"), "not stated"),
    "center of mass outside": ("center_of_mass", text(f"{BOX}/link/inertial/pose", "3 0 0 0 0 0"), "outside"),
    "no collision": ("collider", drop("collision", f"{BOX}/link"), "no collision"),
    "nothing is seen": ("visual", drop("visual", f"{BOX}/link"), "seen"),
    "dented hull": ("explicit_hulls", edited(hull_file, dent), "inside its own hull"),
    "friction below zero": ("friction", text(f"{BOX}/link/collision/surface/friction/ode/mu", "-1"), "mu is -1"),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_refused_by_its_rule(kind: str, copy: Path) -> None:
    rule, damage, words = DAMAGES[kind]
    damage(copy)
    errors = [finding for finding in check_sdf(copy) if finding.is_error]
    assert check_sdf(held(copy.parent) / copy.name) == check_sdf(copy), "files in memory are checked as those of a folder"
    named = [finding for finding in errors if finding.rule == rule]
    assert any(words in str(finding) for finding in named), errors
    assert all(finding.where.split()[0] == "world.sdf" for finding in named), "each names the file"
    assert all(len(str(finding).splitlines()) == 1 and str(copy.parent) not in str(finding) for finding in errors)


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _, _ in DAMAGES.values()} == set(RULES)


_VALUES = ("", "x", "-1", "0", "1e300", "0 0 0", "nan", "../x", "meshes", "1 2 3 4 5 6", "true")


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_no_damage_makes_the_gate_fall_over(data: st.DataObject, world: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Some texts and names changed, some elements gone: findings or none, but no error."""
    root = ElementTree.fromstring(world.read_bytes())
    for model in root.findall("world/model")[:-3]:
        root[0].remove(model)  # three objects are enough, and read sooner
    for _ in range(data.draw(st.integers(1, 3))):
        parent = data.draw(st.sampled_from([element for element in root.iter() if len(element)] or [root]))
        if not len(parent):
            break
        child = data.draw(st.sampled_from(list(parent)))
        match data.draw(st.sampled_from(["drop", "name", "text"])):
            case "drop":
                parent.remove(child)
            case "name":
                child.set("name", data.draw(st.sampled_from(_VALUES)))
            case _:
                child.text = data.draw(st.sampled_from(_VALUES))
    place = tmp_path_factory.mktemp("damaged")
    (place / "meshes").symlink_to(world.parent / "meshes")
    (place / "world.sdf").write_bytes(ElementTree.tostring(root))
    assert all(finding.rule in RULES for finding in check_sdf(place / "world.sdf"))
    assert check_sdf(held(place) / "world.sdf") == check_sdf(place / "world.sdf")


def test_files_of_others_are_read(tmp_path: Path) -> None:
    """A model alone, primitives, meshes that only Gazebo finds, a pose by a quaternion, one that is empty: no error."""
    (tmp_path / "model.sdf").write_text(
        f"""<sdf version='{VERSION}'><model name='cart'><pose/><link name='base'><pose rotation_format='quat_xyzw'>0 0 0 0 0 0 1</pose>
        <inertial><mass>2</mass><inertia><ixx>.1</ixx><ixy>0</ixy><ixz>0</ixz><iyy>.1</iyy><iyz>0</iyz><izz>.1</izz></inertia></inertial>
        <visual name='seen'><geometry><mesh><uri>model://cart/base.dae</uri></mesh></geometry></visual>
        <collision name='box'><geometry><box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"""
    )
    found = check_sdf(tmp_path / "model.sdf")
    assert [finding for finding in found if finding.is_error] == []
    assert {finding.rule for finding in found} == {"closed_paths"}


LINK = """<inertial><mass>2</mass><inertia><ixx>.1</ixx><ixy>0</ixy><ixz>0</ixz><iyy>.1</iyy><iyz>0</iyz><izz>.1</izz></inertia></inertial>
<visual name='seen'><geometry><box><size>1 1 1</size></box></geometry></visual>
<collision name='box'><geometry><box><size>1 1 1</size></box></geometry></collision>"""


@pytest.mark.parametrize(
    ("in_world", "in_model", "in_link"),
    [
        ("", "", "<gravity>true</gravity>"),
        ("", "", "<sensor name='bumper' type='contact'><contact><collision>box</collision></contact></sensor>"),
        ("", "", "<sensor name='force' type='force_torque'><force_torque><frame>child</frame></force_torque></sensor>"),
        ("<state world_name='w'><model name='cart'><link name='base'><pose>0 0 0 0 0 0</pose></link></model></state>", "", ""),
        ("<actor name='walker'><skin><filename>walk.dae</filename><scale>1.0</scale></skin></actor>", "", ""),
        ("", "<plugin name='p' filename='f'><joint>wheel</joint><link>base</link><model/><gravity>9.8</gravity></plugin>", ""),
        ("", "<static>True</static><link name='nothing'/>", ""),
    ],
)
def test_words_that_mean_something_else_elsewhere_are_passed_by(in_world: str, in_model: str, in_link: str, tmp_path: Path) -> None:
    (tmp_path / "world.sdf").write_text(
        f"<sdf version='{VERSION}'><world name='w'><light name='sun' type='directional'/>{in_world}<model name='cart'>{in_model}"
        f"<link name='base'>{LINK}{in_link}</link></model></world></sdf>"
    )
    assert check_sdf(tmp_path / "world.sdf") == []


def test_meshes_that_gazebo_fetches_are_told_from_those_that_are_lost(tmp_path: Path) -> None:
    for address in ("https://fuel.gazebosim.org/box.obj", "model://box/box.obj"):
        link = LINK.replace("<box><size>1 1 1</size></box>", f"<mesh><uri>{address}</uri></mesh>", 1)
        (tmp_path / "model.sdf").write_text(f"<sdf version='{VERSION}'><model name='cart'><link name='base'>{link}</link></model></sdf>")
        assert [(finding.rule, finding.is_error) for finding in check_sdf(tmp_path / "model.sdf")] == [("closed_paths", False)]
