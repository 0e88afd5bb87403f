"""One color in every format, by the format's own definition: two wrong conversions cannot cancel here."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from PIL import Image

from tasks.containers import open_glb
from tasks.exports import ExportsConfig
from tasks.exports.bodies import Replica
from tasks.exports.files import File, write_folder
from tasks.exports.glb import glb_files
from tasks.exports.habitat import habitat_files
from tasks.exports.mjcf import mjcf_files
from tasks.exports.sdf import sdf_files
from tasks.exports.urdf import urdf_files
from tasks.exports.usd import write_usd
from tasks.exports.usd.assets import asset_name
from tasks.geometry.meshes import load_glb, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tasks.library.usd.stage import Flattened
from tasks.simulation.soups import soup_of
from tests.replicas import Object, replica_of, rows_of, translation
from tests.tasks.geometry.colored import COLORED, Colored, decoded, encoded

MAX_DIFFERENCE = 2.0
"""Of 255: each border rounds once, and 8 bits are two borders at most."""

Colors = dict[str, np.ndarray]

pytestmark = pytest.mark.whole


def object_of(made: Colored, index: int) -> Object:
    """A colored box as an object of a room."""
    parts = load_glb(made.glb())
    return Object("box", parts, parts, translation([-2.5 + 0.6 * (index % 6), -1.5 + 0.6 * (index // 6), 0.0]))


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_of([object_of(made, index) for index, made in enumerate(COLORED)]))


def agree(found: Colors) -> None:
    """Each box shows its color.

    Args:
        found: colors by number of the box as four digits, sRGB from 0 to 255, shape (3,) or (n, 3).
    """
    assert sorted(found) == [f"{index + 1:04d}" for index in range(len(COLORED))]
    for (number, color), made in zip(sorted(found.items()), COLORED, strict=True):
        assert np.abs(color - made.displayed).max() <= MAX_DIFFERENCE, (number, made.name, color, made.displayed)


def texels(data: bytes) -> np.ndarray:
    """Pixels of an image file of one color, shape (n, 3)."""
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).reshape(-1, 3)


def gltf_colors(data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Node names and colors of meshes, by glTF 2.0, sections 3.7.2.1 and 3.9.2: products of linear values."""
    document, binary = open_glb(data)

    def view(number: int) -> bytes:
        stated = document["bufferViews"][number]
        start = stated.get("byteOffset", 0)
        return binary[start : start + stated["byteLength"]]

    def walk(number: int, above: str) -> Iterator[tuple[str, np.ndarray]]:
        node = document["nodes"][number]
        name = f"{above}/{node.get('name', '')}"
        for child in node.get("children", ()):
            yield from walk(child, name)
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            linear = np.ones((1, 3))
            if "COLOR_0" in primitive["attributes"]:
                accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
                kind, most = {5121: ("u1", 255), 5123: ("<u2", 65535), 5126: ("<f4", 1)}[accessor["componentType"]]
                width = int(accessor["type"][-1])
                rows = np.frombuffer(view(accessor["bufferView"]), kind, width * accessor["count"], accessor.get("byteOffset", 0))
                linear = rows.reshape(-1, width)[:, :3] / most
            look = document["materials"][primitive["material"]].get("pbrMetallicRoughness", {}) if "material" in primitive else {}
            linear = linear * look.get("baseColorFactor", [1.0] * 4)[:3]
            if "baseColorTexture" in look:
                image = document["images"][document["textures"][look["baseColorTexture"]["index"]]["source"]]
                linear = linear * decoded(texels(view(image["bufferView"]))[0])
            yield name, encoded(linear).reshape(-1, 3)

    for root in document["scenes"][document["scene"]]["nodes"]:
        yield from walk(root, "")


def by_path(files: list[File]) -> dict[str, bytes]:
    return {file.path: file.data for file in files}


def test_glb_and_habitat_state_linear_colors(replica: Replica) -> None:
    (scene,) = glb_files(replica, ExportsConfig())
    agree({name.split("/")[1][-4:]: color for name, color in gltf_colors(scene.data) if name.startswith("/box_")})
    files = by_path(habitat_files(replica, None, (), ExportsConfig())[0])
    (instance,) = [json.loads(data) for path, data in files.items() if path.endswith(".scene_instance.json")]
    found: Colors = {}
    for index, placed in enumerate(instance["object_instances"]):
        (path,) = [p for p in files if p.endswith(f"/{placed['template_name'].rsplit('/')[-1]}.object_config.json")]
        asset = str(Path(path).parent / json.loads(files[path])["render_asset"])
        ((_, found[f"{index + 1:04d}"]),) = gltf_colors(files[asset])
    agree(found)


def test_usd_states_linear_colors_to_its_own_shading(replica: Replica, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(write_usd(tmp_path, replica, ExportsConfig())))
    found: Colors = {}
    for prim in stage.Traverse():
        path = str(prim.GetPath())
        if not prim.IsA(UsdGeom.Mesh) or "/Objects/" not in path or "/Visual" not in path:
            continue
        surface = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0].ComputeSurfaceSource()[0]
        (source,) = surface.GetInput("diffuseColor").GetConnectedSources()[0]
        shader = UsdShade.Shader(source.source.GetPrim())
        if shader.GetIdAttr().Get() == "UsdUVTexture":
            assert shader.GetInput("sourceColorSpace").Get() == "sRGB"
            image = texels(Path(shader.GetInput("file").Get().resolvedPath).read_bytes())[0]
            linear = decoded(image) * np.array(shader.GetInput("scale").Get())[:3]
        else:
            assert shader.GetInput("varname").Get() == "displayColor"
            linear = np.array(UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor").ComputeFlattened())
        found[path.split("/Objects/")[1].split("/")[0][-4:]] = encoded(linear).reshape(-1, 3)
    agree(found)


def test_usd_is_read_back_in_its_colors(replica: Replica, tmp_path: Path) -> None:
    write_usd(tmp_path, replica, ExportsConfig())
    found: Colors = {}
    for index, body in enumerate(replica.bodies):
        (path,) = tmp_path.rglob(f"{asset_name(body, ExportsConfig().usd)}.usda")
        found[f"{index + 1:04d}"] = surface_of(Flattened(path, path.parent).parts()).colors
    agree(found)


def mtl_color(library: bytes, folder: str, files: dict[str, bytes]) -> np.ndarray:
    """Color of an MTL file, shape (n, 3): `Kd` and image are display values; a white `Kd` has the same product in every reader."""
    words = dict(line.split(maxsplit=1) for line in library.decode().splitlines())
    kd = 255 * np.array([float(value) for value in words["Kd"].split()])
    if "map_Kd" not in words:
        return kd
    assert (kd == 255).all()
    return texels(files[f"{folder}/{words['map_Kd']}"])


def numbers(text: str) -> np.ndarray:
    return np.array([float(value) for value in text.split()])


def test_urdf_and_sdf_state_displayed_colors(replica: Replica) -> None:
    files = by_path(urdf_files(replica, ExportsConfig()))
    found: Colors = {}
    for path in (path for path in files if "/box_" in path and path.endswith(".urdf")):
        (visual,) = ElementTree.fromstring(files[path]).iterfind(".//visual")
        rgba = 255 * numbers(visual.find("material/color").attrib["rgba"])  # type: ignore[union-attr]
        mesh = f"{Path(path).parent}/{visual.find('geometry/mesh').attrib['filename']}"  # type: ignore[union-attr]
        color = mtl_color(files[mesh.replace(".obj", ".mtl")], str(Path(mesh).parent), files)
        assert (rgba[:3] == 255).all() or np.abs(rgba[:3] - color).max() < 0.01, "material and library say the same"
        found[Path(path).stem[-4:]] = color
    agree(found)
    files = by_path(sdf_files(replica, ExportsConfig()))
    found = {}
    (path,) = [path for path in files if path.endswith(".sdf")]
    for model in ElementTree.fromstring(files[path]).iterfind(".//model"):
        shown = model.find(".//visual")
        if shown is None or not model.attrib["name"].startswith("box_"):
            continue
        mesh = f"{Path(path).parent}/{shown.findtext('geometry/mesh/uri')}"
        color = mtl_color(files[mesh.replace(".obj", ".mtl")], str(Path(mesh).parent), files)
        diffuse = shown.findtext("material/diffuse")
        assert diffuse is None or np.abs(255 * numbers(diffuse)[:3] - color).max() < 0.01
        found[model.attrib["name"][-4:]] = color
    agree(found)


def test_mjcf_states_displayed_colors(replica: Replica) -> None:
    files = by_path(mjcf_files(replica, ExportsConfig()))
    (path,) = [path for path in files if path.endswith(".xml")]
    tree = ElementTree.fromstring(files[path])
    images = {texture.attrib["name"]: texture.get("file", "") for texture in tree.iterfind("asset/texture")}
    materials = {material.attrib["name"]: material for material in tree.iterfind("asset/material")}
    found: Colors = {}
    for body in (body for body in tree.iter("body") if body.attrib["name"].startswith("box_")):
        (geom,) = [geom for geom in body.iterfind("geom") if geom.get("class") == "visual"]
        if "material" in geom.attrib:
            material = materials[geom.attrib["material"]]
            assert numbers(material.attrib["rgba"]).tolist() == [1.0] * 4
            (image,) = [data for name, data in files.items() if Path(name).name == images[material.attrib["texture"]]]
            found[body.attrib["name"][-4:]] = texels(image)
        else:
            found[body.attrib["name"][-4:]] = 255 * numbers(geom.attrib["rgba"])[:3]
    agree(found)


def test_pictures_of_report_and_simulator_show_displayed_colors() -> None:
    drawn: Colors = {}
    simulated: Colors = {}
    for index, made in enumerate(COLORED):
        parts = load_glb(made.glb())
        camera = Camera.with_fov(look_at(np.array([1.0, 0.8, 1.0]), np.array([0, 0, 0.15])), 64, 64, 0.4)
        rendering = RayScene(parts).render(camera, shade=False)
        drawn[f"{index + 1:04d}"] = rendering.color[rendering.part >= 0]
        soup = soup_of(parts)
        simulated[f"{index + 1:04d}"] = soup.textures[0].reshape(-1, 3) if soup.textures else soup.colors
    agree(drawn)
    agree(simulated)


MUJOCO_DRAWS = """
import json, sys
import mujoco

model = mujoco.MjModel.from_xml_path(sys.argv[1])
model.light_active[:] = 0
light = model.vis.headlight
light.ambient[:], light.diffuse[:], light.specular[:] = 1.0, 0.0, 0.0
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 48, 48) as renderer:
    found = {}
    for number in range(1, int(sys.argv[2]) + 1):
        camera = mujoco.MjvCamera()
        camera.lookat[:] = data.body(f"box_{number:04d}").xpos + [0, 0, 0.15]
        camera.distance, camera.azimuth, camera.elevation = 0.6, 90.0, -80.0
        renderer.update_scene(data, camera)
        found[f"{number:04d}"] = renderer.render()[20:28, 20:28].reshape(-1, 3).tolist()
print(json.dumps(found))
"""


def test_mujoco_draws_the_colors(replica: Replica, tmp_path: Path) -> None:
    write_folder(tmp_path, by_path(mjcf_files(replica, ExportsConfig())))
    (path,) = tmp_path.rglob("*.xml")
    reasons = []
    for library in ("egl", "osmesa"):
        command = [sys.executable, "-c", MUJOCO_DRAWS, str(path), str(len(COLORED))]
        done = subprocess.run(command, env={**os.environ, "MUJOCO_GL": library}, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return agree({number: np.array(color, dtype=float) for number, color in json.loads(done.stdout).items()})
        reasons.append(f"{library}: {done.stderr.strip().splitlines()[-1]}")
    pytest.skip(f"no library draws without a screen: {reasons}")


def test_parts_of_the_room_agree_in_glb_and_usd(replica: Replica) -> None:
    (scene,) = glb_files(replica, ExportsConfig())
    shell = dict(replica.shell)
    walls = {name.rsplit("/room_")[-1]: color for name, color in gltf_colors(scene.data) if "/room_" in name}
    assert set(walls) == set(shell)
    for name, color in walls.items():
        assert np.abs(color - surface_of([shell[name]]).colors).max() <= 1


def test_the_judge_tells_linear_from_displayed() -> None:
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.tile(np.array([98, 96, 96, 255], np.uint8), (8, 1))
    wrong = bytes(trimesh.Scene(box).export(file_type="glb"))
    ((_, color),) = gltf_colors(wrong)
    assert color.min() > 150
