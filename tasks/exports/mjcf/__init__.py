"""A replica as a MuJoCo model: `<stem>/scene.xml` and the meshes and images in `<stem>/assets/`.

Physics is that of the certificates: the same options, hulls, mass properties, friction and contacts, in the same order.
Hulls stand in the XML itself, because MuJoCo reads numbers there in double precision and files in single; what is only
seen is an OBJ file beside it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from tasks.exports.bodies import Body, Replica, Shape
from tasks.exports.config import ExportsConfig
from tasks.exports.files import Export, File
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.lighting import FIELD_OF_VIEW_DEGREES, lamps, viewpoint
from tasks.exports.wavefront import Painted, as_png, dump_obj, painted_part, painted_shape, prepare
from tasks.geometry.pieces import Hull, convex_hull
from tasks.geometry.transforms import quaternion_wxyz
from tasks.optimization.engines.mujoco_engine import Mujoco, contact_of, friction_of
from tasks.shell import floor_ring

Element = ElementTree.Element

ABOUT = (
    " Metres, kilograms, seconds, radians; +Z up, floor at z = 0. Geoms of group 3 collide, geoms of group 2 are seen. "
    "MuJoCo takes the greater friction of two geoms: the room's is small, so that the object's decides. "
    "Texts under custom say where every body comes from. "
)


CAMERA = "room"
"""Name of the camera that looks into the room: `mujoco.Renderer.update_scene(data, "room")`."""

LIGHT = 0.9
"""Of one lamp alone, 0..1; lamps of larger rooms overlap and are weaker, by the root of their number."""


def mjcf_files(replica: Replica, config: ExportsConfig) -> list[File]:
    """Files of one scene, sorted by path."""
    settings = config.mjcf.engine
    root = Element("mujoco", model=replica.stem)
    root.append(ElementTree.Comment(ABOUT))
    ElementTree.SubElement(root, "compiler", angle="radian", meshdir="assets", texturedir="assets", usethread="false")
    _options(root, settings, config)
    custom = ElementTree.SubElement(root, "custom")
    _defaults(root, settings)
    _views(root, replica)
    assets = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    files: dict[str, bytes] = {}
    _text(custom, "scene", {"scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type})
    _lights(world, replica)
    _room(world, assets, files, replica, settings, config)
    known: dict[str, list[dict[str, str]]] = {}
    for body in replica.bodies:
        if body.shape.name not in known:
            known[body.shape.name] = _shape(assets, files, body.shape)
        _body(world, body, known[body.shape.name], settings)
        _text(custom, body.name, described(body))
    state = [value for body in replica.bodies if not body.is_fixed for value in (*body.pose[:3, 3], *quaternion_wxyz(body.pose))]
    frames = ElementTree.SubElement(root, "keyframe")
    ElementTree.SubElement(frames, "key", {"name": "start", **({"qpos": numbers(state)} if state else {})})
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode") + "\n"
    made = [File(f"{replica.stem}/scene.xml", text.encode(), "scene")]
    made += [File(f"{replica.stem}/assets/{name}", data, _role(name)) for name, data in files.items()]
    return sorted(made, key=lambda file: file.path)


def described(body: Body) -> dict[str, str | int | bool]:
    """What a body is and where it comes from."""
    about: dict[str, str | int | bool] = {
        "category": body.category, "nyu40_id": body.nyu40_id, "nyu40_label": body.nyu40_label, "is_fixed": body.is_fixed,
    }  # fmt: skip
    return about | dict(body.provenance)


def _options(root: Element, settings: Mujoco, config: ExportsConfig) -> None:
    """Options of the simulation: those of `tasks.optimization.engines.mujoco_engine`."""
    option = ElementTree.SubElement(
        root, "option", timestep=repr(settings.timestep_s), cone=settings.cone, impratio=repr(settings.impratio),
        integrator=settings.integrator, iterations=str(settings.iterations), tolerance=repr(settings.tolerance),
        gravity=numbers([0.0, 0.0, -config.mjcf.gravity_m_s2]),
    )  # fmt: skip
    flags = {"autoreset": "disable"}  # a state that went astray must not look like the start
    if settings.sleep_m_s > 0.0:
        option.set("sleep_tolerance", repr(settings.sleep_m_s))
        flags["sleep"] = "enable"
    ElementTree.SubElement(option, "flag", flags)
    ElementTree.SubElement(root, "size", memory=str(settings.memory_bytes))


def _defaults(root: Element, settings: Mujoco) -> None:
    """What all geoms of a kind have in common."""
    top = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(top, "mesh", inertia="shell")  # masses are stated; this one asks nothing of a mesh but an area
    collision = ElementTree.SubElement(top, "default", {"class": "collision"})
    contact = {key: numbers(values) for key, values in contact_of(settings).items()}
    ElementTree.SubElement(collision, "geom", {"type": "mesh", "group": "3", "rgba": "0.4 0.7 0.4 0.4", **contact})
    visual = ElementTree.SubElement(top, "default", {"class": "visual"})
    ElementTree.SubElement(visual, "geom", type="mesh", group="2", contype="0", conaffinity="0", mass="0")


def _views(root: Element, replica: Replica) -> None:
    """What a viewer shows first: the whole room, lit by its lamps rather than from the viewer's head."""
    ring = floor_ring(replica.room)
    low, high = np.array([*ring.min(axis=0), 0.0]), np.array([*ring.max(axis=0), replica.room.height_m])
    extent = 0.5 * float(np.linalg.norm(high - low))
    ElementTree.SubElement(root, "statistic", center=numbers(np.round(0.5 * (low + high), 6)), extent=repr(round(extent, 6)))
    visual = ElementTree.SubElement(root, "visual")
    ElementTree.SubElement(visual, "headlight", ambient="0.3 0.3 0.3", diffuse="0.2 0.2 0.2", specular="0 0 0")


def _lights(world: Element, replica: Replica) -> None:
    """Lamps that shine down, of which one casts shadows, and a camera that looks into the room."""
    places = lamps(replica.room)
    bright = numbers([round(LIGHT / math.sqrt(len(places)), 3)] * 3)
    for index, place in enumerate(places):
        ElementTree.SubElement(
            world, "light", name=f"lamp_{index:02d}", pos=numbers(np.round(place, 6)), dir="0 0 -1", cutoff="90", exponent="1",
            diffuse=bright, specular="0.1 0.1 0.1", castshadow="true" if index == 0 else "false",
        )  # fmt: skip
    pose = viewpoint(replica)
    fovy = math.degrees(2.0 * math.atan(math.tan(math.radians(0.5 * FIELD_OF_VIEW_DEGREES)) * 9.0 / 16.0))
    look = {
        "name": CAMERA,
        "pos": numbers(np.round(pose[:3, 3], 6)),
        "quat": numbers(quaternion_wxyz(pose)),
        "fovy": repr(round(fovy, 4)),
    }
    ElementTree.SubElement(world, "camera", look)


def _room(
    world: Element, assets: Element, files: dict[str, bytes], replica: Replica, settings: Mujoco, config: ExportsConfig
) -> None:  # fmt: skip
    """The floor as a plane, walls and brackets as static bodies. A plane has no edge and no depth to fall through."""
    rubs = numbers(friction_of(0.0, settings))
    ElementTree.SubElement(world, "geom", {"name": "room_floor", "class": "collision", "type": "plane", "size": "0 0 1", "friction": rubs})
    for name, part in replica.shell:
        seen = _visuals(assets, files, f"room_{name}", painted_part(part))
        if name == "floor":
            _add_visuals(world, f"room_{name}", seen)
            continue
        body = ElementTree.SubElement(world, "body", name=f"room_{name}")
        vertices = np.asarray(part.vertices, dtype=np.float64)
        # a ceiling with inner corners gets the hull of its slab: what that adds lies outside the room, above it
        is_ceiling = name == "ceiling"
        hull = convex_hull(vertices, config.pieces) if is_ceiling else Hull(vertices, np.asarray(part.faces, dtype=np.int64))
        _mesh(assets, f"room_{name}_hull_00", hull)
        _collide(body, f"room_{name}", f"room_{name}", 1, rubs)
        _add_visuals(body, f"room_{name}", seen)
    for name, board in replica.brackets:
        body = ElementTree.SubElement(world, "body", name=f"room_{name}")
        _mesh(assets, f"room_{name}_hull_00", Hull(np.asarray(board.vertices, np.float64), np.asarray(board.faces, np.int64)))
        _collide(body, f"room_{name}", f"room_{name}", 1, rubs)


def _shape(assets: Element, files: dict[str, bytes], shape: Shape) -> list[dict[str, str]]:
    """Meshes of a shape, which all bodies of that shape share; attributes of the geoms that show them."""
    for index, hull in enumerate(shape.hulls):
        _mesh(assets, f"{shape.name}_hull_{index:02d}", hull)
    return _visuals(assets, files, shape.name, painted_shape(shape))


def _mesh(assets: Element, name: str, hull: Hull) -> None:
    """A hull in the XML itself."""
    faces = " ".join(str(value) for value in hull.faces.reshape(-1).tolist())
    ElementTree.SubElement(assets, "mesh", name=name, vertex=numbers(hull.vertices), face=faces)


def _visuals(assets: Element, files: dict[str, bytes], name: str, meshes: Sequence[Painted]) -> list[dict[str, str]]:
    """Meshes to be seen, as OBJ files, and attributes of the geoms that show them."""
    shown = []
    for index, mesh in enumerate(meshes):
        part = f"{name}_part_{index:02d}"
        files[f"{part}.obj"] = mesh.obj() if len(mesh.vertices) > 3 else _with_four(mesh)
        ElementTree.SubElement(assets, "mesh", name=part, file=f"{part}.obj")
        look = {"mesh": part, "rgba": numbers([*mesh.color, 1.0])}
        if mesh.texture is not None:
            look = {"mesh": part, "material": _material(assets, files, mesh)}
        shown.append(look)
    return shown


def _with_four(mesh: Painted) -> bytes:
    """The OBJ file of a single triangle, its last vertex there twice: MuJoCo wants four."""
    uv = None if mesh.uv is None else np.concatenate([mesh.uv, mesh.uv[-1:]])
    return dump_obj(np.concatenate([mesh.vertices, mesh.vertices[-1:]]), mesh.faces, uv)


def _material(assets: Element, files: dict[str, bytes], mesh: Painted) -> str:
    """Name of the material that draws a mesh with its image; MuJoCo reads PNG only."""
    assert mesh.texture is not None
    image = f"{mesh.texture.file.rsplit('.', 1)[0]}.png"
    color = numbers([*mesh.color, 1.0])
    texture = f"image_{image.removesuffix('.png')}"
    if image not in files:
        files[image] = as_png(mesh.texture)[1]
        ElementTree.SubElement(assets, "texture", name=texture, type="2d", file=image)
    material = next((m for m in assets.iterfind("material") if (m.get("texture"), m.get("rgba")) == (texture, color)), None)
    if material is None:
        name = f"look_{sum(1 for _ in assets.iterfind('material')):03d}"
        material = ElementTree.SubElement(assets, "material", name=name, texture=texture, rgba=color, specular="0", shininess="0")
    return material.attrib["name"]


def _body(world: Element, body: Body, seen: Sequence[Mapping[str, str]], settings: Mujoco) -> None:
    """A body with its joint, its mass properties and its geoms."""
    place, turn = body.pose[:3, 3], quaternion_wxyz(body.pose)
    element = ElementTree.SubElement(world, "body", name=body.name, pos=numbers(place), quat=numbers(turn))
    if not body.is_fixed:
        ElementTree.SubElement(element, "freejoint", name=body.name)
    inertia = body.inertia
    upper = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    ElementTree.SubElement(
        element, "inertial", pos=numbers(body.shape.properties.center), mass=repr(float(body.mass_kg)), fullinertia=numbers(upper)
    )  # fmt: skip
    _collide(element, body.name, body.shape.name, len(body.shape.hulls), numbers(friction_of(body.friction, settings)))
    _add_visuals(element, body.name, seen)


def _collide(element: Element, name: str, mesh: str, count: int, friction: str) -> None:
    """One geom per hull."""
    for index in range(count):
        hull = f"hull_{index:02d}"
        ElementTree.SubElement(
            element, "geom", {"name": f"{name}_{hull}", "class": "collision", "mesh": f"{mesh}_{hull}", "friction": friction}
        )  # fmt: skip


def _add_visuals(element: Element, name: str, seen: Iterable[Mapping[str, str]]) -> None:
    """Geoms that are seen and touch nothing."""
    for index, look in enumerate(seen):
        ElementTree.SubElement(element, "geom", {"name": f"{name}_part_{index:02d}", "class": "visual", **look})


def _text(custom: Element, name: str, about: Mapping[str, str | int | bool]) -> None:
    """A text of the model that MuJoCo carries along: JSON in ASCII, so that no character is one that XML forbids."""
    ElementTree.SubElement(custom, "text", name=name, data=json.dumps(about, sort_keys=True))


def numbers(values: ArrayLike) -> str:
    """Numbers as the shortest text that reads back as the same doubles; no negative zeros."""
    return " ".join(repr(value + 0.0) for value in np.asarray(values, dtype=np.float64).reshape(-1).tolist())


def _role(name: str) -> str:
    """Role of a file beside the scene."""
    return "texture" if name.endswith(".png") else "stage" if name.startswith("room_") else "asset"


def _make(scene: ExportedScene) -> Export:
    """The files, written to a temporary folder and checked there."""
    files = mjcf_files(scene.replica, scene.config)
    return checked(files, MJCF, f"{scene.replica.stem}/scene.xml")


def _gate() -> ModuleType:
    from tasks.exports.mjcf import rules

    return rules


MJCF = ExportFormat(
    name="mjcf",
    title="MuJoCo scenes",
    make=_make,
    gate=_gate,
    opened=lambda root: sorted(root.glob("*/scene.xml")),
    doctor=Doctor(
        about="Check anybody's MuJoCo model: what MuJoCo refuses, and what it lets pass without a word.",
        example="./replicas/mjcf/scannet_scene0000_00/scene.xml",
        names_others=True,
    ),
    prepare=prepare,
)
