"""The MuJoCo model of a scene: the certificate's own physics, read from files; a gate that catches damage."""

from __future__ import annotations

import dataclasses
import io
import json
import shutil
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from PIL import Image

from bench.rooms import generated_scene
from tasks import exports, optimization
from tasks.capture.rooms.openings import open_sides
from tasks.exports import write_folder
from tasks.exports.bodies import Replica
from tasks.exports.mjcf import mjcf_files
from tasks.exports.mjcf.rules import DEEPEST_M, RULES, check_mjcf
from tasks.geometry.meshes import canonical, load_glb
from tasks.geometry.transforms import pose_from_quaternion_wxyz, rotation_of, translation, yaw_pose
from tasks.optimization.certificates import CertificateConfig, Certified, certify
from tasks.optimization.engines.mujoco_engine import Mujoco, simulate
from tasks.optimization.solids import ConvexParts, RigidBody, shell_solids
from tasks.stage import Context
from tests.replicas import Object, cube, furnished, obj, rows_of
from tests.tasks.exports.test_exports_agreement import posed
from tests.tasks.exports.usd.test_exports_usd import replica_of

LEFT_ALONE = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0)


def written(root: Path, replica: Replica, config: exports.ExportsConfig | None = None) -> Path:
    """A replica's MuJoCo model in a folder."""
    write_folder(root, {file.path: file.data for file in mjcf_files(replica, config or exports.ExportsConfig())})
    return root / replica.stem / "scene.xml"


def bodies_of(replica: Replica) -> tuple[list[RigidBody], np.ndarray]:
    """The bodies of a replica as certificates take them, and their poses."""
    bodies = [
        RigidBody(ConvexParts(b.instance_id, b.shape.hulls, b.shape.properties), b.mass_kg, b.friction, (), b.is_fixed)
        for b in replica.bodies
    ]
    return bodies, np.array([body.pose for body in replica.bodies])


def certified(replica: Replica) -> dict[str, Certified]:
    bodies, poses = bodies_of(replica)
    return {one.name: one for one in certify(bodies, poses, shell_solids(replica.room), LEFT_ALONE)}


def left_alone(model: Any, seconds: float) -> dict[str, np.ndarray]:
    """Poses of the free bodies before and after, shape (2, 4, 4) [m], by name."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    start = data.qpos.reshape(-1, 7).copy()
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    assert np.isfinite(data.qpos).all()
    pairs = zip(names, start, data.qpos.reshape(-1, 7), strict=True)
    return {name: np.array([pose_from_quaternion_wxyz(q[3:], q[:3]) for q in states]) for name, *states in pairs}


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_of(furnished()))


@pytest.fixture(scope="module")
def model(replica: Replica, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("mjcf"), replica)


@pytest.fixture
def copy(model: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(model.parent, tmp_path / "moved" / "elsewhere")) / model.name


def compiled(path: Path) -> Any:
    import mujoco

    return mujoco.MjModel.from_xml_path(str(path))


def test_a_sound_scene_has_no_findings_wherever_it_lies(model: Path, copy: Path) -> None:
    assert check_mjcf(model) == []
    assert check_mjcf(copy) == []
    used = {element.get("file") for element in ElementTree.fromstring(model.read_bytes()).iter() if element.get("file")}
    assert used == {path.name for path in (model.parent / "assets").iterdir()}, "nothing is there that is not used"


def test_a_scene_without_walls_is_sound(replica: Replica, tmp_path: Path) -> None:
    """A scan of objects has a floor alone, over which the camera stands; one far away is a finding as in any other scene."""
    room = dataclasses.replace(replica.room, openings=open_sides(np.array(replica.room.floor_polygon), replica.room.height_m))
    floor = {name: part for name, part in replica.shell if name == "floor"}
    path = written(tmp_path, dataclasses.replace(replica, room=room, shell=tuple(floor.items()), bodies=replica.bodies[:1]))
    assert check_mjcf(path) == []
    put("worldbody/camera", "pos", "0 0 90")(path)
    assert [finding.rule for finding in check_mjcf(path)] == ["viewing"]


def test_options_are_those_of_the_certificates(model: Path) -> None:
    import mujoco

    option, engine = compiled(model).opt, Mujoco()
    assert (option.timestep, option.impratio, option.iterations, option.tolerance) == (
        engine.timestep_s, engine.impratio, engine.iterations, engine.tolerance,
    )  # fmt: skip
    assert option.sleep_tolerance == engine.sleep_m_s
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    assert option.gravity.tolist() == [0.0, 0.0, -9.81]


def test_every_body_says_where_it_comes_from(replica: Replica, model: Path) -> None:
    import mujoco

    loaded = compiled(model)
    data = bytes(loaded.text_data)
    for body in replica.bodies:
        index = mujoco.mj_name2id(loaded, mujoco.mjtObj.mjOBJ_TEXT, body.name)
        start, size = loaded.text_adr[index], loaded.text_size[index]
        told = json.loads(data[start : start + size].rstrip(b"\0"))
        assert told["instance_id"] == body.instance_id
        assert told["asset_id"] == body.shape.asset.asset_id
        assert (told["category"], told["license"], told["is_fixed"]) == (body.category, "Apache-2.0", body.is_fixed)


def test_hulls_lose_nothing_but_what_single_precision_loses(replica: Replica, model: Path) -> None:
    """MuJoCo keeps a mesh's vertices, centered, as float32; the file gives them in full."""
    told = {m.get("name"): m.get("vertex") for m in ElementTree.fromstring(model.read_bytes()).iterfind("asset/mesh")}
    loaded = compiled(model)
    import mujoco

    data = mujoco.MjData(loaded)
    mujoco.mj_forward(loaded, data)
    for body in replica.bodies:
        for index, hull in enumerate(body.shape.hulls):
            text = told[f"{body.shape.name}_hull_{index:02d}"]
            np.testing.assert_array_equal(np.array(text.split(), dtype=np.float64).reshape(-1, 3), hull.vertices)
            geom = loaded.geom(f"{body.name}_hull_{index:02d}").id
            mesh = loaded.geom_dataid[geom]
            kept = loaded.mesh_vert[loaded.mesh_vertadr[mesh] :][: loaded.mesh_vertnum[mesh]].astype(np.float64)
            found = kept @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            np.testing.assert_allclose(found, trimesh.transform_points(hull.vertices, body.pose), atol=1e-7)


def test_equal_shapes_share_their_meshes(replica: Replica, model: Path) -> None:
    loaded = compiled(model)
    first, second = (body for body in replica.bodies if body.category == "chair")
    for index in range(len(first.shape.hulls)):
        a, b = (loaded.geom_dataid[loaded.geom(f"{body.name}_hull_{index:02d}").id] for body in (first, second))
        assert a == b


def test_images_are_drawn_pixel_for_pixel(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    """MuJoCo reads PNG only: what is JPEG in the asset is decoded, once."""
    from tasks.exports.gltf import node_textures

    parts = canonical(load_glb((realdata("assets") / "aws_ShoeRack_01.glb").read_bytes()))
    rows, blobs = rows_of([Object("shoe rack", parts, [], np.eye(4), known=False, scale=(1.1, 0.9, 1.0))])
    path = written(tmp_path, replica_of(rows, blobs))
    assert check_mjcf(path) == []
    images = {np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).tobytes()
              for data, _ in node_textures(blobs[rows["assets"][0].mesh_blob]).values()}  # fmt: skip
    found = {np.asarray(Image.open(file).convert("RGB")).tobytes() for file in path.parent.rglob("*.png")}
    assert found == images
    loaded = compiled(path)
    assert loaded.ntex == len(images)
    assert loaded.nmeshtexcoord > 0


def test_many_colors_become_few_near_ones() -> None:
    from tasks.exports.wavefront import COLORS, painted_part

    mesh = trimesh.creation.icosphere(3)
    shades = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3))
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.column_stack([shades, np.full(len(shades), 255)]).astype(np.uint8))
    found = painted_part(mesh)
    assert 1 < len(found) <= COLORS
    assert sum(len(one.faces) for one in found) == len(mesh.faces), "every triangle is drawn, once"
    corners = np.concatenate([one.vertices[one.faces].reshape(-1, 9) for one in found])
    expected = mesh.vertices[mesh.faces].reshape(-1, 9)
    np.testing.assert_array_equal(corners[np.lexsort(corners.T)], expected[np.lexsort(expected.T)])


# ---- stability

UNSTABLE = (
    cube((0.2, 0.2, 0.2), translation([0.4, 0.4, 0.5]), mass_kg=1.0),  # half a metre in the air
    cube((0.1, 0.1, 0.1), translation([1.8, -1.7, 0.03]), mass_kg=0.5),  # 3 cm
    cube((0.06, 0.06, 0.9), posed(rotation_of([0.0, 0.2, 0.0]), np.array([-2.0, 1.4, 0.006])), mass_kg=0.5),  # leans, and falls over
)


def assert_same_as_certificate(replica: Replica, path: Path) -> tuple[set[str], set[str]]:
    """What is unstable by the file and by the certificate, which must be the same objects."""
    rows = {name: one for name, one in certified(replica).items() if not one.is_fixed}
    assert all(row.problem is None for row in rows.values())
    settled = left_alone(compiled(path), CertificateConfig().seconds)
    assert {name.rsplit("_", 1)[1] for name in settled} == set(rows), "every free object is a body, and nothing else"
    moved = {name.rsplit("_", 1)[1]: float(np.linalg.norm(after[:3, 3] - before[:3, 3])) for name, (before, after) in settled.items()}
    tilted = {name.rsplit("_", 1)[1]: float(np.arccos(min(before[:3, 2] @ after[:3, 2], 1.0))) for name, (before, after) in settled.items()}
    near = {name for name, distance in moved.items() if distance > 0.01 or tilted[name] > np.deg2rad(5.0)}
    far = {name for name, distance in moved.items() if distance > 0.05 or tilted[name] > np.deg2rad(5.0)}
    assert near == {name for name, row in rows.items() if not row.is_stable_1cm}
    assert far == {name for name, row in rows.items() if not row.is_stable_5cm}
    return near, far


def test_what_falls_and_what_rests_is_what_the_certificate_says(tmp_path: Path) -> None:
    objects = [*furnished(), obj("bookshelf", yaw_pose(1.5707963, [-2.2, -1.7, 0.0]), seed=6, mass_kg=20.0), *UNSTABLE]
    replica = replica_of(*rows_of(objects))
    path = written(tmp_path, replica)
    assert check_mjcf(path) == []
    near, far = assert_same_as_certificate(replica, path)
    assert near == {"0008", "0009", "0010"}
    assert far == {"0008", "0010"}


_NUMBER = st.floats(-1.0, 1.0, allow_nan=False)
_SIZE = st.floats(0.05, 0.5)


@st.composite
def piles(draw: st.DrawFn) -> list[Object]:
    """Boxes and mugs in the air, on, beside and in one another."""
    found = []
    for _ in range(draw(st.integers(1, 6))):
        turn = rotation_of([2 * draw(_NUMBER) for _ in range(3)])
        pose = posed(turn, np.array([0.5 * draw(_NUMBER), 0.5 * draw(_NUMBER), 0.5 + 0.5 * draw(_NUMBER)]))
        rest: dict[str, Any] = {"mass_kg": draw(st.floats(0.01, 50.0)), "friction": draw(st.floats(0.0, 1.2))}
        rest["relation"] = draw(st.sampled_from(["floor", "floor", "wall"]))
        one = cube(tuple(draw(_SIZE) for _ in range(3)), pose, **rest) if draw(st.booleans()) else obj("mug", pose, 7, **rest)
        found.append(one)
    return found


@pytest.mark.whole
@settings(max_examples=25, deadline=None, phases=(Phase.explicit, Phase.generate))  # smaller piles say nothing more
@given(objects=piles())
def test_every_state_is_the_certificates_bit_for_bit(objects: list[Object], tmp_path_factory: pytest.TempPathFactory) -> None:
    """The file and the certificate's own model are one and the same to MuJoCo, piles that explode included."""
    replica = replica_of(*rows_of(objects))
    bodies, poses = bodies_of(replica)
    expected = simulate(bodies, poses, shell_solids(replica.room), 0.4, Mujoco())
    if any(expected.problems):  # those are left out of the certificate, and the rest is simulated without them
        return
    settled = left_alone(compiled(written(tmp_path_factory.mktemp("pile"), replica)), 0.4)
    for body, pose in zip(replica.bodies, expected.settled, strict=True):
        if not body.is_fixed:
            np.testing.assert_array_equal(settled[body.name][1], pose)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(3))
def test_generated_rooms_fall_as_certificates_say(index: int, tmp_path: Path) -> None:
    """Rooms as the optimization leaves them, and the same with objects thrown about."""
    scene = generated_scene(index, 12, 5)
    rows: dict[str, list[Any]] = {**scene.rows, "scenes": []}
    stage = optimization.STAGE
    context = Context(scene.scene_id, stage.name, 5, scene.blobs, defaultdict(dict))
    needed = {table: rows[table] for table in dict.fromkeys((*stage.reads, *stage.history))}
    outcome = stage.run(**needed, context=context, config=optimization.OptimizationConfig())
    still = replica_of(rows | outcome.rows, {**scene.blobs, **outcome.blobs})
    path = written(tmp_path / "still", still)
    deep = [row.start_penetration_m for row in outcome.rows["certificates"] if row.engine == "mujoco" and not row.is_fixed]
    assert check_mjcf(path) == [] or max(deep) > DEEPEST_M
    near, _ = assert_same_as_certificate(still, path)
    stable = {row.instance_id for row in outcome.rows["certificates"] if row.engine == "mujoco" and row.is_stable_1cm}
    assert near == {body.instance_id for body in still.bodies if not body.is_fixed} - stable, "the stage's own rows"
    rng, bodies = np.random.default_rng(index), list(still.bodies)
    for number in range(0, len(bodies), 4):
        turn = posed(rotation_of(rng.uniform(-0.7, 0.7, 3)), np.zeros(3))
        pose = translation([0.0, 0.0, float(rng.uniform(0.02, 0.12))]) @ bodies[number].pose @ turn
        bodies[number] = dataclasses.replace(bodies[number], pose=pose)
    thrown = dataclasses.replace(still, bodies=tuple(bodies))
    near_thrown, _ = assert_same_as_certificate(thrown, written(tmp_path / "thrown", thrown))
    assert len(near_thrown) > len(near)


# ---- damage


def xml(change: Callable[[ElementTree.Element], None]) -> Callable[[Path], None]:
    """Change the model's XML."""

    def damage(path: Path) -> None:
        root = ElementTree.fromstring(path.read_bytes())
        change(root)
        path.write_bytes(ElementTree.tostring(root))

    return damage


def put(where: str, key: str, value: str) -> Callable[[Path], None]:
    """Set an attribute of an element that is there."""

    def change(root: ElementTree.Element) -> None:
        element = root.find(where)
        assert element is not None, where
        element.set(key, value)

    return xml(change)


def drop(where: str, pattern: str) -> Callable[[Path], None]:
    """Take children out of elements that are there."""

    def change(root: ElementTree.Element) -> None:
        parent = root.find(where)
        assert parent is not None, where
        found = parent.findall(pattern)
        assert found, pattern
        for child in found:
            parent.remove(child)

    return xml(change)


def drop_key(where: str, key: str) -> Callable[[Path], None]:
    """Take an attribute away that is there."""

    def change(root: ElementTree.Element) -> None:
        element = root.find(where)
        assert element is not None, where
        del element.attrib[key]

    return xml(change)


def copies(root: ElementTree.Element) -> None:
    """A million of the same."""
    world = root.find("worldbody")
    assert world is not None
    ElementTree.SubElement(ElementTree.SubElement(world, "replicate", count="1000001"), "geom", size="1")


def nest(root: ElementTree.Element) -> None:
    """Hang one free body on another."""
    world = root.find("worldbody")
    assert world is not None
    box, chair = world.find("body[@name='box_0004']"), world.find("body[@name='chair_0002']")
    assert box is not None
    assert chair is not None
    world.remove(box)
    chair.append(box)


def dent_mesh(root: ElementTree.Element) -> None:
    """Push a corner of a box to its middle."""
    geom = root.find(f"{BOX}/geom[@class='collision']")
    assert geom is not None
    mesh = root.find(f"asset/mesh[@name='{geom.get('mesh')}']")
    assert mesh is not None
    values = np.array(mesh.attrib["vertex"].split(), dtype=np.float64).reshape(-1, 3)
    values[0] = 0.7 * values.mean(axis=0) + 0.3 * values[0]
    mesh.set("vertex", " ".join(map(repr, values.reshape(-1).tolist())))


def sink(path: Path) -> None:
    """The box on the table, 4 mm lower."""
    root = ElementTree.fromstring(path.read_bytes())
    box = root.find(BOX)
    assert box is not None
    x, y, z = map(float, box.attrib["pos"].split())
    box.set("pos", f"{x} {y} {z - 0.004}")
    frames = root.find("keyframe")
    assert frames is not None
    frames.clear()
    path.write_bytes(ElementTree.tostring(root))


BOX, CHAIR = "worldbody/body[@name='box_0004']", "worldbody/body[@name='chair_0002']"
VISUAL = "asset/mesh[@file]"
DAMAGES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "cut file": ("xml", lambda path: path.write_bytes(path.read_bytes()[:-40]), "scene.xml"),
    "another root": ("xml", lambda path: path.write_text("<robot name='r'/>"), "robot"),
    "a million copies": ("budget", xml(copies), "1000000 copies"),
    "position that is no number": ("numbers", put(BOX, "pos", "nan 0 0"), "box_0004: pos"),
    "endless friction": ("numbers", put(f"{BOX}/geom", "friction", "inf 0 0"), "friction"),
    "lost mesh": ("closed_paths", lambda path: sorted((path.parent / "assets").glob("*.obj"))[0].unlink(), "does not exist"),
    "absolute path": ("closed_paths", put(VISUAL, "file", "/srv/meshes/chair.obj"), "chair.obj"),
    "path out of the folder": ("closed_paths", put("compiler", "meshdir", "../assets"), "meshdir"),
    "no light": ("viewing", drop("worldbody", "light"), "no light"),
    "no camera": ("viewing", drop("worldbody", "camera"), "no camera"),
    "camera outside of the room": ("viewing", put("worldbody/camera", "pos", "0 0 90"), "no camera is among"),
    "no name": ("names", drop_key(CHAIR, "name"), "no name"),
    "one name twice": ("names", put(CHAIR, "name", "box_0004"), "box_0004"),
    "free joint on a nested body": ("free_joint", xml(nest), "box_0004"),
    "rotation of length 0": ("unit_quaternion", put(CHAIR, "quat", "0 0 0 0"), "chair_0002: quat"),
    "key with a rotation of length 0": ("unit_quaternion", put("keyframe/key", "qpos", "0 0 0 0 0 0 0 " * 5), "key start"),
    "no mass": ("mass", put(f"{BOX}/inertial", "mass", "0"), "mass"),
    "mass below zero": ("mass", put(f"{BOX}/inertial", "mass", "-1"), "-1"),
    "inertia of no solid": ("inertia", put(f"{BOX}/inertial", "fullinertia", "1 1 9 0 0 0"), "exceeds"),
    "inertia below zero": ("inertia", put(f"{BOX}/inertial", "fullinertia", "-1 1 1 0 0 0"), "principal moments"),
    "inertia in other units": ("inertia", put(f"{BOX}/inertial", "fullinertia", "900 900 900 0 0 0"), "farthest corner"),
    "center of mass outside": ("center_of_mass", put(f"{BOX}/inertial", "pos", "3 0 0"), "box_0004"),
    "what is seen away from what collides": ("visual", put(f"{BOX}/geom[@class='visual']", "pos", "3 0 0"), "beside what collides"),
    "no contacts": ("collider", put("option/flag", "contact", "disable"), "contact is disabled"),
    "gravity switched off": ("gravity", put("option/flag", "gravity", "disable"), "gravity is disabled"),
    "mesh of another name": ("references", put(f"{BOX}/geom[@class='collision']", "mesh", "nothing"), "nothing"),
    "material that is not there": ("references", put(f"{BOX}/geom[@class='visual']", "material", "oak"), "oak"),
    "unknown element": ("compiles", xml(lambda root: root.append(ElementTree.Element("scenery"))), "scenery"),
    "gravity up": ("gravity", put("option", "gravity", "0 0 9.81"), "gravity"),
    "gravity of the moon": ("gravity", put("option", "gravity", "0 0 -1.62"), "1.62"),
    "long steps": ("timestep", put("option", "timestep", "0.1"), "0.1"),
    "nothing collides": ("collider", drop(CHAIR, "geom[@class='collision']"), "chair_0002"),
    "dented hull": ("explicit_hulls", xml(dent_mesh), "inside its own hull"),
    "nothing is seen": ("visual", drop(CHAIR, "geom[@class='visual']"), "chair_0002"),
    "friction of 7": ("friction", put(f"{BOX}/geom[@class='collision']", "friction", "7 0.005 0.0001"), "friction is 7"),
    "box in the table": ("penetration", sink, "4.0 mm deep"),
    "speed beyond all numbers": ("step", put("keyframe/key", "qvel", "1e200 " * 30), "not finite"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    rule, damage, words = DAMAGES[name]
    damage(copy)
    found = [finding for finding in check_mjcf(copy) if finding.is_error]
    named = [finding for finding in found if finding.rule == rule]
    assert named, found
    assert any(words in str(finding) and copy.name in finding.where for finding in named), named
    assert all(len(str(finding).splitlines()) == 1 and str(copy.parent) not in str(finding) for finding in found)


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _, _ in DAMAGES.values()} == set(RULES)


_VALUES = ("", "x", "-1", "0", "1e30", "0 0 0", "nan", "true", "../x", "1 2 3 4 5 6 7 8")


@pytest.mark.whole
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_no_damage_makes_the_gate_fall_over(data: st.DataObject, model: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Some attributes changed, some elements gone: findings or none, but no error."""
    root = ElementTree.fromstring(model.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        parents = [element for element in root.iter() if len(element)]
        parent = data.draw(st.sampled_from(parents))
        child = data.draw(st.sampled_from(list(parent)))
        if data.draw(st.booleans()) or not child.attrib:
            parent.remove(child)
        elif child.tag != "size":
            child.set(data.draw(st.sampled_from(sorted(child.attrib))), data.draw(st.sampled_from(_VALUES)))
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "assets").symlink_to(model.parent / "assets")
    (folder / "scene.xml").write_bytes(ElementTree.tostring(root))
    assert all(finding.rule in RULES for finding in check_mjcf(folder / "scene.xml"))


def test_what_mujoco_makes_good_is_not_refused(tmp_path: Path) -> None:
    """An arm as its makers write it: rotations that MuJoCo normalizes, links without a name, a link whose weight is elsewhere."""
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><worldbody><geom type='plane' size='1 1 1'/>
        <body name='base' pos='0 0 1' quat='1 0 1 0'><geom type='box' size='.1 .1 .1'/>
        <body pos='0 0 .3'><joint axis='1 0 0'/><inertial mass='1' pos='0 0 .9' quat='1 1 0 0' diaginertia='.01 .01 .01'/>
        <geom type='capsule' size='.05 .1'/></body></body></worldbody></mujoco>"""
    )
    found = check_mjcf(path)
    assert {(finding.rule, finding.is_error) for finding in found} == {("unit_quaternion", False), ("names", False), ("viewing", False)}


def test_models_of_others_are_read(tmp_path: Path) -> None:
    """Includes, primitives, degrees, a chain of hinges on a fixed base: nothing of ours, and sound."""
    (tmp_path / "parts.xml").write_text("<mujoco><worldbody><geom name='ground' type='plane' size='1 1 1'/></worldbody></mujoco>")
    (tmp_path / "arm.xml").write_text(
        """<mujoco><compiler angle='degree'/><include file='parts.xml'/><worldbody><light pos='0 0 3'/>
        <body name='base' pos='0 0 1'><geom type='box' size='.1 .1 .1'/>
        <body name='link' pos='0 0 .3'><joint name='hinge' type='hinge' axis='1 0 0' range='-90 90'/><geom type='capsule' size='.05 .1'/>
        </body></body><body name='ball' pos='1 0 .1'><freejoint/><geom type='sphere' size='.1'/></body></worldbody></mujoco>"""
    )
    found = check_mjcf(tmp_path / "arm.xml")
    assert [finding for finding in found if finding.is_error] == []
    assert {finding.rule for finding in found} == {"inertia", "viewing"}, "masses are MuJoCo's own making; a camera is the viewer's"
    (tmp_path / "parts.xml").unlink()
    assert "closed_paths" in {finding.rule for finding in check_mjcf(tmp_path / "arm.xml")}
