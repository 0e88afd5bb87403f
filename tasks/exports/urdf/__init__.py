"""A replica as URDF: a file per object, one for the room, meshes they share, and `poses.json`, which says where they stand.

URDF knows one robot, no scene: `poses.json` has what it cannot say. A link's frame is the object's own (+Z up, origin at
the bottom center). Inertias are full tensors about the center of mass, in the link's axes.
"""

from __future__ import annotations

import dataclasses
import json
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.exports.bodies import Body, Replica
from tasks.exports.config import ExportsConfig
from tasks.exports.files import Export, File
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.mjcf import described, numbers
from tasks.exports.urdf.places import POSES
from tasks.exports.wavefront import dump_obj, hull_files, obj_files, painted_part, painted_shape, prepare
from tasks.geometry.transforms import quaternion_wxyz

Element = ElementTree.Element


@dataclasses.dataclass(frozen=True)
class _Meshes:
    """Files of a shape, by path from the URDF files: those that are seen, each with its color, and hulls."""

    seen: tuple[tuple[str, tuple[float, ...]], ...]
    hulls: tuple[str, ...]


def urdf_files(replica: Replica, config: ExportsConfig) -> list[File]:
    """Files of one scene, sorted by path."""
    files: dict[str, bytes] = {}
    known: dict[str, _Meshes] = {}
    for body in replica.bodies:
        shape = body.shape
        if shape.name not in known:
            hulls = hull_files(shape)
            files |= hulls
            known[shape.name] = _Meshes(obj_files(files, shape.name, painted_shape(shape)), tuple(hulls))
        files[f"{body.name}.urdf"] = _object(body, known[shape.name])
    files["room.urdf"] = _room(files, replica, config)
    files[POSES] = (json.dumps(_poses(replica), indent=1, allow_nan=False) + "\n").encode()
    return [File(f"{replica.stem}/{name}", files[name], _role(name)) for name in sorted(files)]


def _object(body: Body, meshes: _Meshes) -> bytes:
    """The URDF of one object."""
    robot = _robot(body.name)
    link = ElementTree.SubElement(robot, "link", name=body.name)
    tensor = body.inertia
    inertial = ElementTree.SubElement(link, "inertial")
    _origin(inertial, body.shape.properties.center)
    ElementTree.SubElement(inertial, "mass", value=repr(float(body.mass_kg)))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(tensor[i, j]) + 0.0) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)
    _geometry(link, meshes)
    _contact(link, body.friction, body.restitution)
    return _dump(robot)


def _room(files: dict[str, bytes], replica: Replica, config: ExportsConfig) -> bytes:
    """The URDF of the room: floor, walls and brackets, which nobody sees, as links that are fixed to one without a body."""
    robot = _robot("room")
    ElementTree.SubElement(robot, "link", name="room")
    visible = {name for name, _ in replica.shell}
    for name, part in (*replica.shell, *replica.brackets):
        # a floor with inner corners gets the hull of its slab: what that adds lies outside the room, below z = 0
        hull = f"meshes/room_{name}_hull_00.obj"
        files[hull] = dump_obj(*_hull_of(np.asarray(part.vertices, dtype=np.float64)))
        link = ElementTree.SubElement(robot, "link", name=f"room_{name}")
        seen = obj_files(files, f"room_{name}", painted_part(part)) if name in visible else ()
        _geometry(link, _Meshes(seen, (hull,)))
        _contact(link, config.room_friction, config.room_restitution)
        joint = ElementTree.SubElement(robot, "joint", name=f"room_{name}", type="fixed")
        ElementTree.SubElement(joint, "parent", link="room")
        ElementTree.SubElement(joint, "child", link=f"room_{name}")
    return _dump(robot)


def _hull_of(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Convex hull of points, shape (n, 3) [m]: vertices and outward triangles."""
    from tasks.geometry.pieces import PieceConfig, convex_hull

    hull = convex_hull(vertices, PieceConfig())
    return hull.vertices, hull.faces


def _poses(replica: Replica) -> dict[str, Any]:
    """What URDF cannot say: where every object stands, whether it moves, what it is."""
    objects = [
        {
            "name": body.name, "file": f"{body.name}.urdf", "position_m": [float(v) + 0.0 for v in body.pose[:3, 3]],
            "rotation_wxyz": list(quaternion_wxyz(body.pose)), "mass_kg": float(body.mass_kg), "friction": float(body.friction),
            "restitution": float(body.restitution), **described(body),
        }
        for body in replica.bodies
    ]  # fmt: skip
    return {
        "scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type, "up": "+Z", "units": "m, kg, rad",
        "room": "room.urdf", "objects": objects,
    }  # fmt: skip


def _robot(name: str) -> Element:
    """The root of a file. MuJoCo's own element keeps it from dropping folders and bodies; others ignore it."""
    robot = Element("robot", name=name)
    mujoco = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(mujoco, "compiler", strippath="false", fusestatic="false")
    return robot


def _geometry(link: Element, meshes: _Meshes) -> None:
    """What is seen of a link, and what collides."""
    for index, (path, color) in enumerate(meshes.seen):
        visual = ElementTree.SubElement(link, "visual", name=f"{link.attrib['name']}_part_{index:02d}")
        _mesh(visual, path)
        material = ElementTree.SubElement(visual, "material", name=f"{link.attrib['name']}_{index:02d}")
        ElementTree.SubElement(material, "color", rgba=numbers([*color, 1.0]))
    for index, path in enumerate(meshes.hulls):
        _mesh(ElementTree.SubElement(link, "collision", name=f"{link.attrib['name']}_hull_{index:02d}"), path)


def _mesh(element: Element, path: str) -> None:
    """A mesh in the link's own frame."""
    _origin(element, np.zeros(3))
    ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), "mesh", filename=path)


def _origin(element: Element, place: ArrayLike) -> None:
    """A frame that is moved [m] and not turned."""
    ElementTree.SubElement(element, "origin", xyz=numbers(place), rpy="0 0 0")


def _contact(link: Element, friction: float, restitution: float) -> None:
    """Friction and restitution, in the words of Bullet's importer; URDF itself has none."""
    contact = ElementTree.SubElement(link, "contact")
    ElementTree.SubElement(contact, "lateral_friction", value=repr(float(friction)))
    ElementTree.SubElement(contact, "restitution", value=repr(float(restitution)))


def _dump(robot: Element) -> bytes:
    ElementTree.indent(robot)
    return (ElementTree.tostring(robot, encoding="unicode") + "\n").encode()


def _role(name: str) -> str:
    """Role of a file, by its path."""
    if name == POSES:
        return "scene"
    if name == "room.urdf" or name.startswith("meshes/room_"):
        return "stage"
    if name.endswith(".urdf"):
        return "object"
    if name.endswith((".png", ".jpg")):
        return "texture"
    return "collision" if "_hull_" in name else "asset"


def _make(scene: ExportedScene) -> Export:
    """The files, checked as they are."""
    files = urdf_files(scene.replica, scene.config)
    return checked(files, URDF, scene.replica.stem)


def _gate() -> ModuleType:
    from tasks.exports.urdf import rules

    return rules


URDF = ExportFormat(
    name="urdf",
    title="URDF objects",
    make=_make,
    gate=_gate,
    opened=lambda root: sorted(path.parent for path in root.glob(f"*/{POSES}")),
    doctor=Doctor(
        about="Check anybody's URDF file, or a folder of them with its poses.json.",
        example="./replicas/urdf/scannet_scene0000_00",
        takes="either",
        names_others=True,
    ),
    prepare=prepare,
    is_held=True,
)
