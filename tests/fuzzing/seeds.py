"""Sound inputs to begin from, small, written by the project's own writers or, where others' files differ, number by number."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from tasks import exports
from tasks.exports.bodies import Replica
from tasks.exports.formats import FORMATS
from tasks.families import member
from tasks.geometry.meshes import dump_glb
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import translation, yaw_pose
from tasks.models import model_id_of
from tasks.weights import to_safetensors
from tests import capture_scans, scans
from tests.conftest import REPOSITORY
from tests.fuzzing.cases import Case, read_case
from tests.replicas import Object, cube, rows_of, with_navigation
from tests.tasks.geometry.colored import COLORED
from tests.tasks.geometry.gltf import files as gltf_files

REALDATA = Path(os.environ.get("METASCENES_REALDATA") or REPOSITORY.parent / "shared" / "realdata")
"""Files of others, where there are any (see tests/conftest.py)."""

MAX_REAL_BYTES = 400_000
"""Larger files of others are no seeds: what is wanted are many inputs."""


def folder_of(write: Callable[[Path], object]) -> Case:
    """What a function writes into a folder."""
    with tempfile.TemporaryDirectory() as place:
        root = Path(place) / "case"
        write(root)
        return read_case(root)


def real(pattern: str, name: str, most: int = 4) -> list[Case]:
    """Files of others that match, each as a case in which it is called `name`."""
    found = [path for path in sorted(REALDATA.glob(pattern)) if path.is_file() and path.stat().st_size <= MAX_REAL_BYTES]
    return [{name.format(stem=path.stem): path.read_bytes()} for path in found[:: max(1, len(found) // most)][:most]]


def _image(size: tuple[int, int] = (8, 6), kind: str = "PNG", mode: str = "RGB") -> bytes:
    out = io.BytesIO()
    pixels = np.arange(size[0] * size[1] * 3, dtype=np.uint8).reshape(size[1], size[0], 3)
    depth = pixels[..., 0].astype(np.uint16) + 1000
    image = Image.fromarray({"RGB": pixels, "I;16": depth, "F": depth.astype(np.float32) / 1000}[mode])
    image.save(out, format=kind)
    return out.getvalue()


def _painted() -> trimesh.Trimesh:
    """A box with a texture."""
    mesh = trimesh.creation.box((0.4, 0.5, 0.6))
    image = Image.open(io.BytesIO(_image()))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=[255, 255, 255, 255])
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)), material=material)
    return mesh


def _objects() -> list[Object]:
    painted = _painted()
    painted.apply_translation([0, 0, 0.3])
    return [
        cube((0.3, 0.2, 0.25), yaw_pose(-0.7, [-0.2, -1.2, 0.0])),
        cube((0.3, 0.2, 0.25), yaw_pose(0.3, [1.2, -0.6, 0.0]), scale=(1.0, 2.0, 1.5), known=False),
        Object("table", [painted], [trimesh.creation.box((0.4, 0.5, 0.6), translation([0, 0, 0.3]))], yaw_pose(0.4, [-1.5, 0.5, 0.0])),
        cube((0.1, 0.1, 0.1), translation([-1.5, 0.5, 0.6]), relation="on", parent_id="0003"),
    ]


@cache
def replica() -> tuple[Replica, dict[str, list[Any]], dict[str, bytes]]:
    """A small replica, its rows and its blobs."""
    rows, blobs = with_navigation(*rows_of(_objects()), episodes=2)
    tables = ("scenes", "shells", "instances", "captions", "assets", "placements", "supports")
    made, _ = exports.gather(*[rows[name] for name in tables], blobs, exports.ExportsConfig())
    return made, rows, blobs


def _export(format_: str) -> Iterator[tuple[str, bytes]]:
    from tasks.stage import Context

    _, rows, blobs = replica()
    config = exports.ExportsConfig(formats=(format_,))
    context = Context(rows["scenes"][0].scene_id, "exports", 0, blobs)
    outcome = exports.run(**{name: rows[name] for name in exports.STAGE.reads}, context=context, config=config)
    yield from ((row.path, outcome.blobs[row.file_blob]) for row in outcome.rows["export_files"])


def _below(files: dict[str, bytes], name: str, called: str) -> Case:
    """The folder in which the file lies whose name ends so, with that file called `called`."""
    found = next(path for path in sorted(files) if path.endswith(name))
    root = found.rpartition("/")[0]
    inside = {path.removeprefix(f"{root}/"): data for path, data in files.items() if path.startswith(f"{root}/")}
    inside[called] = inside.pop(found.removeprefix(f"{root}/"))
    return inside


@cache
def exported(format_: str) -> list[Case]:
    """What is written in a format: the folder that its doctor takes, or that of the file which is opened, called `scene`."""
    files = dict(_export(format_))
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        exports.write_folder(root, files)
        (opened,) = member(FORMATS, format_).opened(root)
        if not opened.is_dir():
            opened = opened.rename(opened.with_name("scene" + "".join(opened.suffixes))).parent
        return [read_case(opened)]


@cache
def glb() -> list[Case]:
    """GLBs: of objects with colors and a texture, of a scene with nodes in nodes, of colors stated in every way, of others."""
    boxes = dump_glb([trimesh.creation.box((0.3, 0.4, 0.5)), _painted()], ["chair|chair|1", "table_2"])
    tree = trimesh.Scene()
    tree.add_geometry(trimesh.creation.box((4.0, 0.1, 3.0)), node_name="floor", geom_name="a")
    tree.add_geometry(
        trimesh.creation.icosphere(1, 0.3), node_name="ball", geom_name="b", parent_node_name="floor", transform=translation([0, 1, 0])
    )
    tree.add_geometry(_painted(), node_name="cabinet", geom_name="c", parent_node_name="ball")
    scene = dict(_export("glb"))
    stated = ("all three", "vertices and factor", "light alone", "diffuse image and color")
    colored = [made.glb() for made in COLORED if made.name in stated]
    found = [boxes, bytes(tree.export(file_type="glb")), next(iter(scene.values())), *colored]
    return [{"scene.glb": data} for data in found] + real("**/*.glb", "scene.glb")


PACKED_GLTF = ("draco", "meshopt", "meshopt of Khronos", "meshopt exponents")
"""Tables whose numbers a native decoder unpacks, in a process of its own."""


def gltf() -> list[Case]:
    """GLBs that use features of glTF: instances, skins, morph targets, sparse and whole numbers, textures and colors of all kinds."""
    made = [make() for name, make in gltf_files.TABLES.items() if name not in PACKED_GLTF]
    sampler = {"wrapS": 33071, "wrapT": 33648}
    moved = gltf_files.colored_by(texCoord=1, extensions={"KHR_texture_transform": {"offset": [0.5, 2.0], "rotation": 1.0}})
    cubes = [
        gltf_files.painted(moved, {"TEXCOORD_1": [1.5, 0.5], "COLOR_0": [1.0, 0.5, 0.5, 1.0]}, source=0, sampler=0),
        gltf_files.painted(
            gltf_files.colored_by(), {"TEXCOORD_0": [0.5, 0.5]}, gltf_files.picture("WEBP"), extensions={"EXT_texture_webp": {"source": 0}}
        ),
        gltf_files.painted(
            {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}}}, {"TEXCOORD_0": [0, 0]}
        ),
    ]
    cubes[0].document["samplers"] = [sampler]
    return [{"scene.glb": one.data()} for one in (*made, gltf_files.instanced(), *cubes)]


def packed_gltf() -> list[Case]:
    """GLBs whose meshes or images a native decoder unpacks."""
    basis = {"KHR_texture_basisu": {"source": 0}}
    images = [
        gltf_files.painted(gltf_files.colored_by(), {"TEXCOORD_0": [0.7, 0.5]}, gltf_files.picture(kind), "image/ktx2", extensions=basis)
        for kind in gltf_files.KTX2
    ]
    return [{"scene.glb": one.data()} for one in (*(gltf_files.TABLES[name]() for name in PACKED_GLTF), *images)]


def doctor_urdf() -> list[Case]:
    """A folder of URDF files with poses; the case's own folder is what is checked."""
    files = dict(_export("urdf"))
    root = next(path for path in files if path.endswith("poses.json")).rpartition("/")[0]
    whole = {path.removeprefix(f"{root}/"): data for path, data in files.items() if path.startswith(root)}
    arm = """<?xml version="1.0"?><robot name="arm"><link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="hand"><inertial><origin xyz="0 0 0"/><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><mesh filename="m/a.stl"/></geometry></visual><collision><origin xyz="0 0 1" rpy="0 0 1"/><geometry>
<mesh filename="m/b.ply" scale="1 1 2"/></geometry></collision></link><joint name="j" type="revolute"><parent link="base"/>
<child link="hand"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    box = trimesh.creation.box((1, 1, 1))
    other = {"arm.urdf": arm.encode(), "m/a.stl": box.export(file_type="stl"), "m/b.ply": box.export(file_type="ply")}
    return [whole, other]


def doctor_mjcf() -> list[Case]:
    """MuJoCo models: a scene of ours, and one with what others use."""
    ours = _below(dict(_export("mjcf")), "scene.xml", "scene.xml")
    other = b"""<mujoco model="x"><compiler angle="radian" meshdir="m"/><option timestep="0.002" gravity="0 0 -9.81"/>
<default><geom friction="1 0.005 0.0001"/><default class="a"><geom rgba="1 0 0 1"/></default></default>
<asset><texture name="t" type="2d" builtin="checker" width="32" height="32" rgb1="0 0 0" rgb2="1 1 1"/><material name="m" texture="t"/>
<mesh name="b" file="b.stl" scale="1 1 1"/><hfield name="h" nrow="4" ncol="4" size="1 1 1 .1"/></asset>
<worldbody><light pos="0 0 3"/><geom type="plane" size="5 5 .1" material="m"/>
<body name="one" pos="0 0 1"><freejoint/><geom type="mesh" mesh="b" class="a"/><site name="s" size=".01"/>
<body name="two" pos="0 0 1"><joint name="j" type="hinge" axis="0 1 0" range="-1 1" limited="true"/>
<geom type="capsule" fromto="0 0 0 0 0 1" size=".1"/></body></body>
<body name="rope" pos="2 0 1"><composite type="cable" curve="s" count="5 1 1" size="1" initial="none">
<geom type="capsule" size=".01"/></composite></body>
</worldbody><actuator><motor joint="j" ctrlrange="-1 1" ctrllimited="true"/></actuator>
<sensor><jointpos joint="j"/></sensor></mujoco>"""
    return [ours, {"scene.xml": other, "m/b.stl": trimesh.creation.box((0.2, 0.2, 0.2)).export(file_type="stl")}]


@cache
def doctor_usd() -> list[Case]:
    """USD scenes: ours as text and packed, one layer as a crate, one of others."""
    from pxr import Sdf, Usd, UsdGeom, UsdUtils

    ours = _below(dict(_export("usd")), "scene.usda", "scene.usda")
    found = [ours]
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        for name, data in ours.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(data if isinstance(data, bytes) else b"")
        flat = Usd.Stage.Open(str(root / "scene.usda")).Flatten()
        flat.Export(str(root / "flat.usdc"))
        found.append({"scene.usda": (root / "flat.usdc").read_bytes()})
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(root / "flat.usdc")), str(root / "flat.usdz"))
        found.append({"scene.usdz": (root / "flat.usdz").read_bytes()})
        stage = Usd.Stage.CreateInMemory()
        UsdGeom.Cube.Define(stage, "/World/Cube")
        UsdGeom.PointInstancer.Define(stage, "/World/Many").CreatePositionsAttr([(0, 0, 0), (1, 1, 1)])
        found.append({"scene.usda": stage.GetRootLayer().ExportToString().encode()})
    return found + real("usd_physics/**/*.usda", "scene.usda", 3)


@cache
def doctor_habitat() -> list[Case]:
    """A Habitat dataset of one scene, with episodes and a navmesh."""
    from tasks.exports.layout import layout, shared_files
    from tests.tasks.exports.test_exports import export

    _, rows, blobs = replica()
    outcome = export(rows, blobs, exports.ExportsConfig(formats=("habitat",)))
    files = outcome.rows["export_files"]
    data = {path: outcome.blobs[name] for path, name in layout(files).items()} | shared_files(files, outcome.blobs)
    return [{path.removeprefix("habitat/"): content for path, content in data.items() if path.startswith("habitat/")}]


def import_habitat() -> list[Case]:
    """The same, with a table of categories and a lexicon beside."""
    (ours,) = doctor_habitat()
    extra = {
        "metadata/objects.csv": b"id,main_category,wnsynsetkey\nbox,box,box.n.01\nx,chair,chair.n.01\n",
        "LICENSE": b"CC BY 4.0\n",
    }
    return [ours, {**ours, **extra}]


def import_metascenes() -> list[Case]:
    """A release of one small scan, with layouts."""
    from tests.flows.inputs.metascenes_release import write_release

    return [folder_of(lambda root: write_release(root, {"scene0001_00": _objects()}))]


def models(ending: str) -> list[Case]:
    """An object as a mesh file of that kind, with its materials where it has any."""
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    match ending:
        case ".glb":
            return [{"model.glb": case["scene.glb"]} for case in glb()]
        case ".obj":
            lines = ["mtllib model.mtl", "o box", "usemtl paint", *(f"v {x} {y} {z}" for x, y, z in box.vertices)]
            lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vn 0 0 1", *(f"f {a + 1}/1/1 {b + 1}/2/1 {c + 1}/3/1" for a, b, c in box.faces)]
            quads = ["v 0 0 0", "v 1 0 0", "v 1 1 0 0.5 0.5 0.5", "v 0 1 0", "s off", "g a", "f 1 2 3 4", "f -1//1 -2 -3"]
            mtl = b"newmtl paint\nKd 0.8 0.2 0.1\nd 1.0\nmap_Kd model.png\n"
            arrow = ["mtllib other.mtl model.mtl", "v 0 0 0 255 0 0", "v 2 2 0 0 255 0", "v 0 1 0 0 0 255", "v -2 2 0", "vt 0.5", "p 1"]
            arrow += ["usemtl", "f 2/1 3/-1 \\", "4/1 1/1", "l 1 2", "usemtl old  oak", "f -1 -2 -3"]
            odd = b"newmtl\nKd 0.5\nMAP_KD -s 2 2 -o 0.5 0 -clamp on C:\\x\\MODEL.png\nnewmtl old oak\nKa 1 1 1\nmap_Ka gone.png\n"
            return [
                {"model.obj": "\n".join(lines).encode() + b"\n", "model.mtl": mtl, "model.png": _image()},
                {"model.obj": "\n".join(quads).encode() + b"\n"},
                {"model.obj": "\n".join(arrow).encode() + b"\n", "model.mtl": odd, "model.png": _image()},
            ]
        case ".ply":
            return [{"model.ply": case["mesh.ply"]} for case in ply()]
        case ".stl":
            return [{"model.stl": box.export(file_type="stl")}, {"model.stl": box.export(file_type="stl_ascii").encode()}]
    raise NotImplementedError(f"write a sound model for the fuzzing of {ending}")


@cache
def ply() -> list[Case]:
    """PLY meshes: binary of either order, text, polygons, and one that is cut, for which there is code of its own."""
    box = trimesh.creation.box((1.0, 2.0, 1.5))
    from tasks.geometry.meshes import Surface

    surface = Surface(np.asarray(box.vertices), np.asarray(box.faces), np.full((8, 3), 90, np.uint8))
    text = (
        "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n"
        "property uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0.5 1 2 3\n3 0 1 2\n4 0 1 2 3\n"
    )
    quads = text.replace("ascii", "binary_little_endian").split("end_header\n")[0].replace("face 2", "face 1") + "end_header\n"
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)], "<f4")
    polygon = b"".join(row.tobytes() + b"\1\2\3" for row in corners) + b"\4" + np.arange(4, dtype="<i4").tobytes()
    found = [capture_scans.ply_bytes(surface), capture_scans.ply_bytes(surface, ">"), text.encode(), quads.encode() + polygon]
    found.append(found[0][:-5])
    return [{"mesh.ply": data} for data in found]


@cache
def _shots() -> tuple[list[capture_scans.Shot], Camera]:
    room = capture_scans.box_room(cameras=3)
    small = tuple(dataclasses.replace(camera, **_quarter(camera)) for camera in room.cameras)
    room = dataclasses.replace(room, cameras=small)
    return capture_scans.rendered(room), small[0]


def _quarter(camera: Camera) -> dict[str, Any]:
    names = {"width": camera.width // 4, "height": camera.height // 4}
    return names | {name: getattr(camera, name) / 4 for name in ("fx", "fy", "cx", "cy")}


def sens() -> list[Case]:
    """Containers of three frames: jpeg and zlib, raw and raw."""
    shots, camera = _shots()
    packed = capture_scans.sens_bytes(shots, camera)
    header = packed.index(b"StructureSensor") + 15 + 4 * 64
    plain = bytearray(packed[: header + 8 + 16 + 4 + 8])
    plain[header : header + 8] = np.array([0, 0], "<i4").tobytes()
    for color, depth, pose in shots:
        plain += (
            pose.astype("<f4").tobytes() + np.array([0, 0, color.nbytes, depth.nbytes], "<u8").tobytes() + color.tobytes() + depth.tobytes()
        )
    return [{"scan.sens": packed}, {"scan.sens": bytes(plain)}]


@cache
def posed_rgbd() -> list[Case]:
    """Folders of posed frames: a trajectory of quaternions, poses by file, frames side by side."""
    from tasks.geometry.transforms import quaternion_xyzw

    shots, camera = _shots()
    paired = folder_of(lambda root: capture_scans.write_frames(root, shots, camera))
    numbers = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "width": camera.width, "height": camera.height}
    lines = [" ".join(f"{v:.6f}" for v in (*pose[:3, 3], *quaternion_xyzw(pose))) for _, _, pose in shots]
    trajectory = {name: data for name, data in paired.items() if name.startswith(("color/", "depth/"))}
    trajectory |= {"pose.txt": "\n".join(lines).encode() + b"\n", "LICENSE.txt": b"CC0\n"}
    trajectory["intrinsics.json"] = json.dumps({**numbers, "depth_scale": 1000, "pose_format": "camera-to-world"}).encode()
    flat: dict[str, Any] = {"intrinsic.txt": paired["intrinsic/intrinsic_color.txt"]}
    for index in range(len(shots)):
        flat |= {f"frame-{index:06d}.color.jpg": paired[f"color/{index}.jpg"], f"frame-{index:06d}.depth.png": paired[f"depth/{index}.png"]}
        flat |= {f"frame-{index:06d}.pose.txt": paired[f"pose/{index}.txt"]}
    images = {name: data for name, data in paired.items() if not name.startswith(("color/", "depth/"))}
    for index, (color, depth, _) in enumerate(shots):
        images |= {f"color/{index}.{'bmp' if index else 'ppm'}": _encoded(color, "BMP" if index else "PPM")}
        images |= {f"depth/{index}.pgm": _encoded(depth, "PPM")}
    return [paired, trajectory, flat, images]


def _encoded(pixels: np.ndarray, kind: str) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, format=kind)
    return out.getvalue()


def poses() -> list[Case]:
    """Trajectory files in each of the known layouts."""
    shots, _ = _shots()
    quaternions = "0.0 1 2 3 0 0 0 1\n0.033 1 2 3 0 0.1 0 0.995\n# x\n0.066, 1, 2, 3, 0, 0, 0.1, 0.995\n"
    log = "".join(f"{i} {i} {i + 1}\n{capture_scans.matrix_text(pose)}" for i, (_, _, pose) in enumerate(shots))
    rows = "".join(" ".join(map(str, pose[:3].ravel())) + "\n" for _, _, pose in shots)
    columns = "".join(" ".join(map(str, pose.T.ravel())) + "\n" for _, _, pose in shots)
    headed = "timestamp,tx,ty,tz,qw,qx,qy,qz\r\n\t1305031102000000000;1;2;3;1;0;0;0 # first\r\n1305031102033000000;1;2;3;1;0;0;0\r\n"
    plain = quaternions.replace("0.0 ", "", 1).split("\n")[0] + "\n"
    return [{"poses.txt": text.encode()} for text in (quaternions, log, rows, plain, columns, headed)]


@cache
def capture(format_: str) -> list[Case]:
    """A whole scan of that format, as small as one can be that becomes a scene: the sample of its test, where it has none here."""
    match format_:
        case "scannet":
            plain = folder_of(lambda root: scans.write_scan(root, "scene0001_00"))
            bare = {name.removeprefix("scene0001_00/"): data for name, data in plain.items()}
            (container, _) = sens()
            shots, camera = _shots()
            frames = folder_of(lambda root: capture_scans.write_frames(root, shots, camera))
            return [bare, {**bare, "scene0001_00.sens": container["scan.sens"]}, {**bare, **frames}]
        case "posed_rgbd":
            return posed_rgbd()
        case "glb":
            return glb()
        case "bare_mesh":
            return meshes()
    places = [f"tests.tasks.capture.{place}test_{format_}" for place in ("formats.", "")]
    module = next((place for place in places if find_spec(place) is not None), places[-1])
    test = import_module(module)
    return [folder_of(write) for write in (test.write_sample, *getattr(test, "FURTHER_SAMPLES", ()))]


def meshes() -> list[Case]:
    """A bare mesh in each kind of file, and points in a PLY."""
    from tasks.geometry.meshes import Surface
    from tests.tasks.capture.formats import clouds
    from tests.tasks.capture.phones.room_packages import furnished_room, write_package
    from tests.tasks.capture.test_mesh_files import KINDS, written

    box = trimesh.creation.box((0.8, 0.6, 0.7))
    surface = Surface(np.asarray(box.vertices), np.asarray(box.faces), np.full((8, 3), 90, np.uint8))
    found = [folder_of(lambda root, kind=kind: written(root, surface, kind)) for kind in KINDS]
    package = folder_of(lambda root: write_package(root / "Room.usdz", furnished_room()))
    points = {"room.ply": clouds.ply_bytes(clouds.small_cloud(), objects=True)}
    return [*found, package, points, {"room.ply": ply_with_image(surface.vertices, surface.faces), "room.png": _image()}]


def confined() -> list[Case]:
    """A cloud as LAS and as E57, a recording as archive and as a folder with packed depth, and a video."""
    from tests.tasks.capture.formats import clouds, phones
    from tests.tasks.capture.formats.test_record3d import sample

    cloud, frames = clouds.small_cloud(300), sample().frames
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        recording = phones.write_record3d(place / "recording", frames)
        phones.pack_record3d(recording)
        packed = {f"rgbd/{path.name}": path.read_bytes() for path in sorted((recording / "rgbd").iterdir())}
        clouds.write_las(place / "a.las", cloud)
        clouds.write_e57(place / "a.e57", cloud)
        phones.zip_record3d(recording, place / "a.r3d")
        phones.write_video(place / "rgb.mp4", [frame.color() for frame in frames])
        files = [{file: (place / file).read_bytes()} for file in ("a.las", "a.e57", "a.r3d", "rgb.mp4")]
    return [*files, packed]


def ply_with_image(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bytes:
    """A text PLY whose comment names the image `room.png`, with texture coordinates of each corner of a face."""
    head = ["ply", "format ascii 1.0", "comment TextureFile room.png", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "property list uchar float texcoord", "end_header"]
    rows = [" ".join(map(str, row)) for row in vertices.tolist()]
    rows += [f"3 {a} {b} {c} 6 0.1 0.2 0.8 0.2 0.5 0.9" for a, b, c in faces.tolist()]
    return "\n".join([*head, *rows, ""]).encode()


def library() -> list[Case]:
    """A library of two files with an index and a licence."""
    first, second = glb()[:2]
    index = [{"file": "a.glb", "category": "chair", "license": "CC0", "author": "x", "source": "y"}, {"file": "more/b.glb", "repo": "z"}]
    files = {"a.glb": first["scene.glb"], "more/b.glb": second["scene.glb"], "LICENSE": b"CC BY 4.0\n"}
    return [{**files, "index.json": json.dumps(index).encode()}, files]


def models_folder() -> list[Case]:
    """Folders of models with what Objaverse, ABO and a list say of them."""
    from tests.tasks.library.models import as_obj, chair
    from tests.tasks.library.test_library_metadata import ANNOTATION, LISTING, TABLE

    models = {"models/aa11.glb": glb()[0]["scene.glb"], "models/B07ABC.obj": as_obj(chair()), "models/LICENSE": b"CC BY-NC 4.0\n"}
    objaverse = {"annotations.json": json.dumps({"aa11": ANNOTATION}).encode(), "lvis.json": json.dumps({"chair": ["aa11"]}).encode()}
    abo = {"3dmodels.csv": TABLE.encode(), "listings.json": json.dumps(LISTING).encode()}
    stated = [{"file": "aa11.glb", "unit_m": 0.01, "up": "z", "front": "+x", "extents_m": [0.5, 0.5, 0.9], "license": "MIT"}]
    return [{**models, **objaverse}, {**models, **abo}, {**models, "list.json": json.dumps(stated).encode()}]


def model() -> list[Case]:
    """The folder of a model, as it is exported."""
    weights = to_safetensors({"bias": np.zeros(3, np.float32), "weight": np.ones((3, 2), np.float16)})
    config = {"kind": "selection", "half": True}
    document = {
        "format": 1, "model_id": model_id_of(weights, json.dumps(config, sort_keys=True, separators=(",", ":"))), "kind": "selection",
        "architecture": "small", "parameter_count": 9, "config": config, "dataset": "snapshot 1", "dataset_fingerprint": "a" * 64,
        "examples": {"train": 2}, "seed": 0, "code_fingerprint": "b" * 64, "device": "cpu", "license": "CC0-1.0", "parent_id": None,
        "is_fallback": False, "notes": [], "measures": [],
    }  # fmt: skip
    return [{"model.json": json.dumps(document).encode(), "weights.safetensors": weights}]


def annotation_batch() -> list[Case]:
    """A batch with every kind of answer, and one that spans files."""
    transform = {"position": [1.2, -0.1, 0.05], "yaw_degrees": 30, "scale": [1, 1.1, 0.9]}
    turned = {"position": [1, 2, 0], "rotation_wxyz": [1, 0, 0, 0], "scale": [1, 1, 1]}
    usual = {"scene_id": "demo/room_a", "annotator": "ada", "answered_at": "2026-03-01T14:05:00+02:00"}
    answers = [
        usual | {"instance_id": "0001", "choice": 2, "ranking": [2, 1, "a" * 64], "transform": transform, "seconds": 12.5},
        usual | {"instance_id": "0002", "choice": None},
        usual | {"instance_id": "0003", "choice": "a" * 64, "transform": turned, "tool": "page", "simulated": True},
        usual | {"instance_id": "0004", "withdrawn": True},
    ]
    more = [usual | {"instance_id": "0001", "annotator": "bob", "choice": 1}]
    whole = {"batch_id": "batch-1", "annotations": answers}
    return [
        {"batch.json": json.dumps(whole).encode()},
        {
            "batch.json": json.dumps(whole | {"files": ["more/c.json"]}).encode(),
            "more/c.json": json.dumps({"batch_id": "batch-1", "annotations": more}).encode(),
        },
    ]


def label_studio_batch() -> list[Case]:
    """An export of Label Studio: an answer with a ranking, none that fits, a skipped task."""
    data = {"batch_id": "batch-1", "scene_id": "demo/room_a", "instance_id": "0001"}
    choice = {"from_name": "choice", "to_name": "sheet", "type": "choices", "value": {"choices": ["2"]}}
    ranking = {"from_name": "ranking", "to_name": "candidates", "type": "ranker", "value": {"ranker": {"next": ["1", "3"], "_": ["4"]}}}
    usual = {"completed_by": {"id": 1, "email": "ada@example.org"}, "was_cancelled": False, "updated_at": "2026-03-01T14:05:00.0Z"}
    tasks = [
        {"id": 1, "data": data, "annotations": [usual | {"result": [choice, ranking], "lead_time": 12.5}]},
        {"id": 2, "data": data | {"instance_id": "0002"}, "annotations": [usual | {"result": [choice | {"value": {"choices": ["none"]}}]}]},
        {"id": 3, "data": data | {"instance_id": "0003"}, "annotations": [usual | {"result": [], "was_cancelled": True}]},
    ]
    return [{"export.json": json.dumps(tasks).encode()}]


def cvat_batch() -> list[Case]:
    """Exports of CVAT, of a job and of a project."""
    person = "<assignee><username>ada</username><email>ada@example.org</email></assignee><updated>2026-03-01 14:05:00.5+00:00</updated>"
    words = {"choice": "2", "second": "1", "third": "3", "fourth": "__undefined__", "fifth": "__undefined__"}
    tag = "".join(f'<attribute name="{name}">{word}</attribute>' for name, word in words.items())
    images = [
        f'<image id="{number}" name="batch-1~demo~room_a~000{number}.jpg" task_id="7"><tag label="answer">{tag}</tag></image>'
        for number in "12"
    ]
    metas = [f"<job>{person}</job>", f"<project><tasks><task><id>7</id>{person}</task></tasks></project>"]
    texts = [f"<annotations><version>1.1</version><meta>{meta}</meta>{''.join(images)}</annotations>" for meta in metas]
    return [{"annotations.xml": f'<?xml version="1.0" encoding="utf-8"?>\n{text}'.encode()} for text in texts]


def review_batch() -> list[Case]:
    """Reviews, one with a note."""
    usual = {"reviewer": "rita", "reviewed_at": "2026-03-02T10:30:00+01:00", "sampled": 2, "wrong": 1, "verdict": "returned"}
    reviews = [usual | {"review_id": "r1"}, usual | {"review_id": "r2", "wrong": 0, "verdict": "accepted", "note": " better "}]
    return [{"reviews.json": json.dumps({"batch_id": "batch-1", "reviews": reviews}).encode()}]


def verdict_batch() -> list[Case]:
    """Verdicts of a reviewer, one with a remark."""
    usual = {"scene_id": "demo/room_a", "annotator": "ada", "reviewed_at": "2026-03-02T10:30:00+01:00"}
    verdicts = [usual | {"instance_id": "0001", "passes": True}, usual | {"instance_id": "0002", "passes": False, "remark": "too low"}]
    return [{"verdicts.json": json.dumps({"batch_id": "batch-1", "reviewer": "rita", "verdicts": verdicts}).encode()}]


def trajectory_batch() -> list[Case]:
    """Trajectories with and without poses, in both frames, as JSON and as JSON Lines."""
    world = {"scene_id": "demo/a", "episode_id": "000001", "actions": ["forward", "left", "stop"], "collisions": 1}
    world["poses"] = [[0, 0, 0], [0.25, 0, 0], [0.25, 0, 0.17], [0.25, 0, 0.17]]
    bare = {"scene_id": "demo/a", "episode_id": "000002", "actions": ["right", "stop"]}
    head = {"batch_id": "mine-1", "policy": "mine", "run_name": "seed 7", "frame": "world"}
    habitat = {"scene_id": "demo/a", "episode_id": "000001", "actions": ["move_forward", "turn_left", "stop"]}
    habitat |= {"positions": [[0, 0, 0], [0, 0, -0.25], [0, 0, -0.25], [0, 0, -0.25]], "rotations": [[0, 0, 0, 1]] * 4}
    lines = b"\n".join(json.dumps(item).encode() for item in (head, world, bare)) + b"\n"
    return [
        {"batch.json": json.dumps({**head, "trajectories": [world, bare]}).encode()},
        {"batch.json": json.dumps({**head, "frame": "habitat", "trajectories": [habitat]}).encode()},
        {"batch.jsonl": lines},
    ]


def navmesh() -> list[Case]:
    """Navmeshes: ours, and others' of either version."""
    _, rows, blobs = replica()
    ours = [{"scene.navmesh": blobs[row.navmesh_blob]} for row in rows["navmeshes"]]
    return ours + real("habitat_sim_test_assets/**/*.navmesh", "scene.navmesh", 3)


def records() -> list[Case]:
    """Records that the project writes itself, as JSON: storeys, hashed files, a holder, a release, a mirrored scan, tokens, an erasure."""
    from bench.samples import sample
    from schemas.runs import Release
    from tasks.capture.layout import STOREYS_RECORD
    from warehouse.tables.released import record_fields
    from warehouse.upkeep.erasure.plan import PATH

    key = {"token": "t" * 43, "since": "2026-01-01T00:00:00+00:00", "roles": ["annotator"]}
    names = {name: ["a"] for name in ("names", "spared", "blobs", "assets", "releases")}
    made = {
        STOREYS_RECORD: {"scene_id": "a/b", "storeys": [{"scan": "b_0", "floor_m": 0.0}, {"scan": "b_1", "floor_m": 2.7}]},
        "file_hashes.json": {"/a/b": [1, 2, 3, 4, "5" * 64]},
        "held.json": {"token": "a", "host": "b", "expires": 1.0, "life": 2.0},
        "release.json": record_fields(sample(Release)),
        "version.json": {"scene": "a/b", "scan": "b", "content": "c" * 64, "bytes": 3, "files": {"a.ply": 3}},
        "tokens.json": {"port": 4321, "origin": "http://127.0.0.1:4321", "people": {"ada": key, "bob": {**key, "token": None}}},
        PATH: {"scene_id": "a/b", "started_at": "2026-01-01T00:00:00+00:00", "last": 3, **names},
    }
    return [{name: json.dumps(value).encode()} for name, value in made.items()]


def settings() -> list[Case]:
    """A file of settings, and settings as the command line has them."""
    text = """seed = 3
[capture]
max_points = 1000
fusion = { voxel_m = 0.05 }
[optimization]
method = "paper"
[candidates]
slots = [{ provider = "procedural" }, { provider = { kind = "library", k = 2 }, fallback = { variant = 5 } }]
[navigation]
path_finder = "planar"
agent = { radius_m = 0.2 }
[exports]
formats = ["usd", "glb"]
[exports.habitat]
forward_m = 0.25
"""
    lines = 'capture.max_points=500\nexports.formats=["usd"]\noptimization.method=paper\nnavigation.agent.radius_m=0.25\n'
    lines += "candidates.slots=[{provider={kind='scan_crop',mode='pieces'}}]\noptimization.method.kind=default\n"
    return [{"settings.toml": text.encode()}, {"sets.txt": lines.encode()}]


def parameters() -> list[Case]:
    """Parameters of every flow that is deployed."""
    from tests.fuzzing.targets import deployed

    stages = {
        "capture": {"max_points": 100},
        "navigation": {"max_steps": 250},
        "exports": {"formats": ["usd"]},
        "optimization": {"method": {"kind": "paper"}},
        "candidates": {"slots": [{"provider": {"kind": "scan_crop", "mode": "closed"}}, {"provider": "library", "fallback": "procedural"}]},
    }
    found = []
    for entrypoint, told in deployed().items():
        values = {name: value if name != "stages" else stages for name, value in told.items()}
        found.append({"parameters.json": json.dumps({"flow": entrypoint, "parameters": values}).encode()})
    found.append(
        {
            "parameters.json": json.dumps(
                {"flow": "flows.pipeline.replicate", "parameters": {"scans": "/s", "lake": "/l", "stages": stages}}
            ).encode()
        }
    )
    return found


def labels() -> list[Case]:
    """Label maps: ours, and as ScanNet's is written."""
    rows = b'raw_label,category,nyu40_id\nchair,chair,5\noffice chair,chair,5\n"a, b",table,7\n'
    table = b"id\traw_category\tcategory\tcount\tnyu40id\n1\tchair\tchair\t10\t5\n2\tsofa\tcouch\t3\t6\n"
    return [{"labels.csv": rows}, {"labels.csv": table}]


def images() -> list[Case]:
    """Images of color and depth in every kind that frames may have."""
    from tasks.capture.files.images import COLOR_SUFFIXES, DEPTH_SUFFIXES

    kinds = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".ppm": "PPM", ".bmp": "BMP", ".pgm": "PPM", ".tif": "TIFF", ".tiff": "TIFF"}
    found = [{f"color{ending}": _image((16, 12), kinds[ending])} for ending in COLOR_SUFFIXES]
    found += [{f"depth{ending}": _image((16, 12), kinds[ending], "I;16")} for ending in DEPTH_SUFFIXES]
    return [*found, {"depth.tiff": _image((16, 12), "TIFF", "F")}]
