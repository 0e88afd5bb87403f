"""A replica as a world for Gazebo: `<stem>/world.sdf` (SDF 1.9) and the meshes and images in `<stem>/meshes/`.

Metres, kilograms, seconds, radians; +Z up, floor at z = 0. The room is one static model, every object a model of its own, with a link
whose frame is the object's own (+Z up, origin at the bottom center); what is fastened to the room is static.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.exports.bodies import Body, Replica
from tasks.exports.config import ExportsConfig
from tasks.exports.files import Export, File
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.lighting import lamps
from tasks.exports.mjcf import described, numbers
from tasks.exports.sdf.places import ABOUT, NAMESPACE
from tasks.exports.wavefront import Painted, dump_obj, hull_files, obj_files, painted_part, painted_shape, prepare
from tasks.geometry.pieces import PieceConfig, convex_hull
from tasks.shell import floor_ring

Element = ElementTree.Element

VERSION = "1.9"
"""The newest that Gazebo Fortress reads, which is the oldest that is still kept."""

WORLD = "world.sdf"
"""Name of the file that Gazebo opens."""

_LINK = "link"
_LIGHT = 0.8  # of one lamp alone, 0..1; lamps of larger rooms overlap and are weaker, by the root of their number
_LOCKED = 1e-6  # cosine of the pitch below which roll and yaw turn about the same axis: what is lost is no larger

_Seen = tuple[tuple[str, tuple[float, ...] | None], ...]
"""Paths of meshes that are seen, each with its color, or None where its own material has an image."""


def sdf_files(replica: Replica, config: ExportsConfig) -> list[File]:
    """Files of one scene, sorted by path."""
    root = Element("sdf", {"version": VERSION, "xmlns:metascenes": NAMESPACE})
    world = ElementTree.SubElement(root, "world", name=replica.stem)
    _settings(world, config)
    _about(world, {"scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type})
    _lights(world, replica)
    files: dict[str, bytes] = {}
    _room(world, files, replica, config)
    known: dict[str, tuple[_Seen, tuple[str, ...]]] = {}
    for body in replica.bodies:
        shape = body.shape
        if shape.name not in known:
            hulls = hull_files(shape)
            files |= hulls
            seen = _seen(files, shape.name, painted_shape(shape))
            known[shape.name] = (seen, tuple(hulls))
        _object(world, body, *known[shape.name])
    ElementTree.indent(root)
    files[WORLD] = ('<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n").encode()
    return [File(f"{replica.stem}/{name}", files[name], _role(name)) for name in sorted(files)]


def roll_pitch_yaw(rotation: ArrayLike) -> tuple[float, float, float]:
    """Angles [rad] about the fixed axes X, then Y, then Z that a rotation, shape (3, 3), is made of: Rz(yaw) Ry(pitch) Rx(roll)."""
    r: NDArray[np.float64] = np.asarray(rotation, dtype=np.float64)
    level = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], level)
    if level < _LOCKED:
        return 0.0, pitch, math.atan2(-r[0, 1], r[1, 1])
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def _settings(world: Element, config: ExportsConfig) -> None:
    """Gravity, the time step, and light from everywhere. Engines and systems are left to Gazebo: a world that names none gets them all."""
    physics = ElementTree.SubElement(world, "physics", name="default", type="ode")
    _put(physics, "max_step_size", [config.sdf.timestep_s])
    _put(physics, "real_time_factor", [1.0])
    _put(physics, "real_time_update_rate", [round(1.0 / config.sdf.timestep_s, 6)])
    _put(world, "gravity", [0.0, 0.0, -config.sdf.gravity_m_s2])
    scene = ElementTree.SubElement(world, "scene")
    _put(scene, "ambient", [config.sdf.ambient] * 3 + [1.0])
    _put(scene, "background", [0.7, 0.7, 0.7, 1.0])
    ElementTree.SubElement(scene, "shadows").text = "true"


def _lights(world: Element, replica: Replica) -> None:
    """Lamps below the ceiling, of which one casts shadows."""
    places = lamps(replica.room)
    bright = [round(_LIGHT / math.sqrt(len(places)), 3)] * 3 + [1.0]
    for index, place in enumerate(places):
        light = ElementTree.SubElement(world, "light", name=f"lamp_{index:02d}", type="point")
        _pose(light, np.round(place, 6), np.eye(3))
        ElementTree.SubElement(light, "cast_shadows").text = "true" if index == 0 else "false"
        _put(light, "diffuse", bright)
        _put(light, "specular", [0.1, 0.1, 0.1, 1.0])
        fading = ElementTree.SubElement(light, "attenuation")
        for name, value in (("range", 20.0), ("constant", 0.5), ("linear", 0.1), ("quadratic", 0.02)):
            _put(fading, name, [value])


def _room(world: Element, files: dict[str, bytes], replica: Replica, config: ExportsConfig) -> None:
    """Floor, walls and brackets as one static model of one link: Bullet wants no more of a model without joints.

    The floor collides as a plane, which has no edge and no depth to fall through.

    Gazebo's engines take the smaller friction of two: the room's is no smaller than any object's, so that the object's decides,
    as it does in the certificates.
    """
    friction = max([config.room_friction, *(body.friction for body in replica.bodies)])
    model = ElementTree.SubElement(world, "model", name="room")
    ElementTree.SubElement(model, "static").text = "1"  # Bullet reads no other word
    link = ElementTree.SubElement(model, "link", name=_LINK)
    visible = {name for name, _ in replica.shell}
    for name, part in (*replica.shell, *replica.brackets):
        if name in visible:
            _visuals(link, _seen(files, f"room_{name}", painted_part(part)), f"{name}_")
        if name == "floor":
            plane = ElementTree.SubElement(_collision(link, f"{name}_plane", friction, config.room_restitution), "plane")
            _put(plane, "normal", [0.0, 0.0, 1.0])
            _put(plane, "size", 2.0 * np.round(np.abs(floor_ring(replica.room)).max(axis=0) + config.shell.thickness_m, 6))
            continue
        # a ceiling with inner corners gets the hull of its slab: what that adds lies outside the room, above it
        hull = convex_hull(np.asarray(part.vertices, dtype=np.float64), PieceConfig())
        path = f"meshes/room_{name}_hull_00.obj"
        files[path] = dump_obj(hull.vertices, hull.faces)
        _mesh(_collision(link, f"{name}_hull_00", friction, config.room_restitution), path)


def _object(world: Element, body: Body, seen: _Seen, hulls: Sequence[str]) -> None:
    """The model of one object."""
    model = ElementTree.SubElement(world, "model", name=body.name)
    _pose(model, body.pose[:3, 3], body.pose[:3, :3])
    ElementTree.SubElement(model, "static").text = "1" if body.is_fixed else "0"
    link = ElementTree.SubElement(model, "link", name=_LINK)
    inertial = ElementTree.SubElement(link, "inertial")
    _pose(inertial, body.shape.properties.center, np.eye(3))
    _put(inertial, "mass", [body.mass_kg])
    inertia, tensor = ElementTree.SubElement(inertial, "inertia"), body.inertia
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _put(inertia, f"i{'xyz'[i]}{'xyz'[j]}", [tensor[i, j]])
    _visuals(link, seen)
    for index, path in enumerate(hulls):
        _mesh(_collision(link, f"hull_{index:02d}", body.friction, body.restitution), path)
    _about(model, described(body))


def _seen(files: dict[str, bytes], name: str, meshes: Sequence[Painted]) -> _Seen:
    """Files of what is seen, put into `files`."""
    paths = obj_files(files, name, meshes)
    return tuple((path, None if mesh.texture else color) for (path, color), mesh in zip(paths, meshes, strict=True))


def _visuals(link: Element, seen: _Seen, prefix: str = "") -> None:
    """What is seen of a link. A mesh with an image is drawn by its own material."""
    for index, (path, color) in enumerate(seen):
        visual = ElementTree.SubElement(link, "visual", name=f"{prefix}part_{index:02d}")
        _mesh(ElementTree.SubElement(visual, "geometry"), path)
        if color is not None:
            material = ElementTree.SubElement(visual, "material")
            for name, values in (("ambient", color), ("diffuse", color), ("specular", (0.1, 0.1, 0.1))):
                _put(material, name, [*values, 1.0])


def _collision(link: Element, name: str, friction: float, restitution: float) -> Element:
    """The geometry of a new collision, with its surface in the words of the engines that Gazebo has."""
    collision = ElementTree.SubElement(link, "collision", name=name)
    geometry, surface = ElementTree.SubElement(collision, "geometry"), ElementTree.SubElement(collision, "surface")
    _put(ElementTree.SubElement(surface, "bounce"), "restitution_coefficient", [restitution])
    rubs = ElementTree.SubElement(surface, "friction")
    for engine, names in (("ode", ("mu", "mu2")), ("bullet", ("friction", "friction2"))):
        words = ElementTree.SubElement(rubs, engine)
        for word in names:
            _put(words, word, [friction])
    return geometry


def _mesh(geometry: Element, path: str) -> None:
    """A mesh in the link's own frame."""
    ElementTree.SubElement(ElementTree.SubElement(geometry, "mesh"), "uri").text = path


def _pose(element: Element, place: ArrayLike, rotation: ArrayLike) -> None:
    """Where something is [m] and how it is turned [rad], in the frame of what it is in."""
    _put(element, "pose", [*np.asarray(place, dtype=np.float64), *roll_pitch_yaw(rotation)])


def _put(element: Element, name: str, values: ArrayLike) -> None:
    """Numbers as the text of a new element."""
    ElementTree.SubElement(element, name).text = numbers(values)


def _about(element: Element, facts: Mapping[str, str | int | bool]) -> None:
    """What something is and where it comes from: JSON in ASCII, in an element that SDF's readers pass by."""
    ElementTree.SubElement(element, f"metascenes:{ABOUT}").text = json.dumps(facts, sort_keys=True)


def _role(name: str) -> str:
    """Role of a file, by its path."""
    if name == WORLD:
        return "scene"
    if name.startswith("meshes/room_"):
        return "stage"
    if name.endswith((".png", ".jpg")):
        return "texture"
    return "collision" if "_hull_" in name else "asset"


def _make(scene: ExportedScene) -> Export:
    """The files, checked as they are."""
    files = sdf_files(scene.replica, scene.config)
    return checked(files, SDF, f"{scene.replica.stem}/{WORLD}")


def _gate() -> ModuleType:
    from tasks.exports.sdf import rules

    return rules


SDF = ExportFormat(
    name="sdf",
    title="Gazebo worlds",
    make=_make,
    gate=_gate,
    opened=lambda root: sorted(root.glob(f"*/{WORLD}")),
    doctor=Doctor(
        about="Check anybody's SDF file of a world or a model.",
        example=f"./replicas/sdf/scannet_scene0000_00/{WORLD}",
        names_others=True,
    ),
    prepare=prepare,
    is_held=True,
)
