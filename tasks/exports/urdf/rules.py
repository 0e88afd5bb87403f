"""Whether URDF files, and the `poses.json` beside them, can be simulated as they are. Works on anybody's URDF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import AnyPath, read_file
from schemas.parsing import json_value
from tasks.exports.findings import Finding
from tasks.exports.inertias import impossible, too_large
from tasks.exports.mesh_files import HULL_TOLERANCE_M, hollow, named_mesh
from tasks.exports.urdf.places import POSES
from tasks.unpacking import xml_root

RULES: dict[str, str] = {
    "xml": "the file is XML whose root is robot",
    "names": "the robot, its links and its joints have names of their own",
    "tree": "joints make one tree out of all links",
    "numbers": "numbers are finite and as many as they should be",
    "closed_paths": "every file that is named is named by a relative path inside the folder, and is there",
    "mesh": "every mesh can be read, has triangles, finite positions and a scale; one that collides has a volume",
    "mass": "every link that is not the room's has a mass above zero",
    "inertia": "inertias are those that a solid can have, and one as large as its colliders",
    "center_of_mass": "the center of mass lies inside the colliders' box",
    "collider": "every link with a mass collides",
    "explicit_hulls": "meshes that collide are convex as they are",
    "visual": "every link with a mass can be seen",
    "poses": "poses.json names every object and every file once, with a rigid pose and the mass that the file says",
}
"""Every rule, and what holds when it passes."""

_COUNTS = {"xyz": 3, "rpy": 3, "rgba": 4, "scale": 3, "size": 3}
_NUMBERS = {"value", "ixx", "ixy", "ixz", "iyy", "iyz", "izz", "radius", "length", "lower", "upper", "effort", "velocity"}

Element = ElementTree.Element


def check_urdf(path: AnyPath) -> list[Finding]:
    """Everything that is wrong with a URDF file, or with all of a folder and its `poses.json`, sorted."""
    if path.is_dir():
        files: list[AnyPath] = sorted(path.glob("*.urdf"), key=lambda file: file.name)
        known: dict[Any, Any] = {}
        findings = [finding for file in files for finding in _check(file, known)]
        findings += _poses(path, [file.name for file in files])
        return sorted(set(findings))
    return sorted(set(_check(path, {})))


def _check(path: AnyPath, known: dict[Any, Any]) -> list[Finding]:
    """Findings about one file."""
    try:
        robot = xml_root(read_file(path, path.name, BUDGET.xml_bytes))
    except (ElementTree.ParseError, InputError, ValueError, LookupError) as error:
        return [Finding("xml", path.name, f"cannot be read ({error})")]
    if robot.tag != "robot":
        return [Finding("xml", path.name, f"root is {robot.tag}, not robot")]
    return [*_structure(path, robot), *_numeric(path, robot), *_links(path, robot, known)]


def _structure(path: AnyPath, robot: Element) -> Iterator[Finding]:
    """Names, and the tree that links and joints make."""
    links, joints = robot.findall("link"), robot.findall("joint")
    if not robot.get("name"):
        yield Finding("names", path.name, "the robot has no name")
    for kind, elements in (("link", links), ("joint", joints)):
        for name, count in Counter(element.get("name", "") for element in elements).items():
            if not name:
                yield Finding("names", path.name, f"a {kind} has no name")
            elif count > 1:
                yield Finding("names", f"{path.name} {kind} {name}", f"{count} have this name")
    names = {link.get("name", "") for link in links}
    parent: dict[str, str] = {}
    for joint in joints:
        where = f"{path.name} joint {joint.get('name', '')}"
        above, below = (_attribute(joint, kind, "link") for kind in ("parent", "child"))
        for kind, name in (("parent", above), ("child", below)):
            if name not in names:
                yield Finding("tree", where, f"{kind} link {name!r} does not exist")
        if below in parent:
            yield Finding("tree", where, f"link {below!r} hangs on two joints")
        parent[below] = above
    if not links:
        yield Finding("tree", path.name, "has no link")
        return
    roots = sorted(names - set(parent))
    if len(roots) != 1:
        yield Finding("tree", path.name, f"{len(roots)} links hang on nothing, not one: {', '.join(roots[:3])}")
    sound: set[str] = set()
    for name in sorted(parent):
        seen, at = set[str](), name
        while at in parent and at not in seen and at not in sound:
            seen.add(at)
            at = parent[at]
        if at in seen:
            yield Finding("tree", f"{path.name} link {name}", "hangs on itself")
            return
        sound |= seen


def _attribute(element: Element, tag: str, key: str) -> str:
    """An attribute of a child, empty when there is none."""
    child = element.find(tag)
    return child.get(key, "") if child is not None else ""


def _floats(text: str | None) -> NDArray[np.float64] | None:
    """Finite numbers of an attribute, or None."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def _numeric(path: AnyPath, robot: Element) -> Iterator[Finding]:
    for link in [*robot.findall("link"), *robot.findall("joint")]:
        for element in link.iter():
            for key, text in element.attrib.items():
                count = _COUNTS.get(key, 1 if key in _NUMBERS else 0)
                values = _floats(text) if count else None
                if count and (values is None or len(values) != count):
                    where = f"{path.name} {link.tag} {link.get('name', '')}"
                    yield Finding("numbers", where, f"{element.tag} {key} is not {count} finite numbers: {text[:60]}")


def _links(path: AnyPath, robot: Element, known: dict[Any, Any]) -> Iterator[Finding]:
    """Geometry and mass of every link."""
    links = robot.findall("link")
    for link in links:
        where = f"{path.name} link {link.get('name', '')}"
        boxes = []
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                for mesh in shape.iterfind("geometry/mesh"):
                    name = mesh.get("filename", "")
                    findings, loaded = named_mesh(path, where, name, known)
                    yield from findings
                    scale = _floats(mesh.get("scale", "1 1 1"))
                    if scale is not None and not (scale > 0.0).all():  # many mirror one side of a robot into the other
                        yield Finding("mesh", where, f"scale of {name} is {mesh.get('scale')}", not scale.all())
                    if kind == "collision" and loaded is not None:
                        boxes.append(loaded if _plain(shape, scale) else None)
                        is_flat, gap = hollow(path.parent / name, loaded, known)
                        if is_flat:
                            yield Finding("mesh", where, f"{name} collides, but is flat")
                        elif gap > HULL_TOLERANCE_M:
                            yield Finding("explicit_hulls", where, f"{name} lies up to {gap * 1000:.1f} mm inside its own hull")
        inertial = link.find("inertial")
        if inertial is None:
            if link.find("collision") is not None and len(links) == 1:
                yield Finding("mass", where, "is not stated")
            continue
        yield from _mass(where, inertial)
        if link.find("collision") is None:
            yield Finding("collider", where, "has a mass, but no collision")
        if link.find("visual") is None:
            yield Finding("visual", where, "has a mass, but nothing of it can be seen")
        center = _floats(_attribute(inertial, "origin", "xyz") or "0 0 0")
        if boxes and all(box is not None for box in boxes) and center is not None and len(center) == 3:
            points = np.concatenate([box[0] for box in boxes if box is not None])
            if ((center < points.min(axis=0) - 1e-3) | (center > points.max(axis=0) + 1e-3)).any():
                yield Finding("center_of_mass", where, f"{center.tolist()} lies outside the link's colliders")
            yield from _reach(where, inertial, np.abs(points - center).max(axis=0))


def _plain(shape: Element, scale: NDArray[np.float64] | None) -> bool:
    """Whether a mesh stands in the link's frame as it is."""
    moved = [_floats(_attribute(shape, "origin", key) or "0 0 0") for key in ("xyz", "rpy")]
    return scale is not None and bool((scale == 1.0).all()) and all(value is not None and not value.any() for value in moved)


def _mass(where: str, inertial: Element) -> Iterator[Finding]:
    mass = _floats(_attribute(inertial, "mass", "value"))
    if mass is None or len(mass) != 1 or not mass[0] > 0.0:
        yield Finding("mass", where, f"is {_attribute(inertial, 'mass', 'value') or 'not stated'}")
    element = inertial.find("inertia")
    if element is None:
        yield Finding("inertia", where, "is not stated: every engine makes its own")
        return
    entries = [_floats(element.get(key)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    if any(entry is None or len(entry) != 1 for entry in entries):
        yield Finding("inertia", where, "is not six finite numbers")
        return
    for fault in impossible([float(entry[0]) for entry in entries if entry is not None]):
        yield Finding("inertia", where, fault)


def _reach(where: str, inertial: Element, reach: NDArray[np.float64]) -> Iterator[Finding]:
    """Inertia of a link whose colliders reach so far from its center of mass along its axes [m], shape (3,)."""
    mass, element = _floats(_attribute(inertial, "mass", "value")), inertial.find("inertia")
    trace = [_floats(element.get(key)) for key in ("ixx", "iyy", "izz")] if element is not None else [None]
    if mass is None or len(mass) != 1 or any(entry is None or len(entry) != 1 for entry in trace):
        return
    xx, yy, zz = (float(entry[0]) for entry in trace if entry is not None)
    for fault in too_large(float(mass[0]), (xx, 0.0, 0.0, yy, 0.0, zz), reach):
        yield Finding("inertia", where, fault)


def _poses(folder: AnyPath, files: list[str]) -> Iterator[Finding]:
    """The file that says where the objects stand."""
    path = folder / POSES
    try:
        document = json_value(read_file(path, POSES, BUDGET.json_bytes))
        objects = [dict(item) for item in document["objects"]]
        named = Counter([*(str(item["file"]) for item in objects), str(document["room"])])
    except (InputError, ValueError, KeyError, TypeError) as error:
        yield Finding("poses", POSES, f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:100]})")
        return
    there = set(files)
    for name in sorted(set(named) | there):
        if named[name] != 1 or name not in there:
            yield Finding("poses", f"{POSES} {name}", f"is named {named[name]} times, and {'' if name in there else 'not '}there")
    for name, count in Counter(str(item.get("name", "")) for item in objects).items():
        if count > 1 or not name:
            yield Finding("poses", f"{POSES} {name}", f"{count} objects have this name")
    for item in objects:
        where = f"{POSES} {item.get('name', '')}"
        try:
            place, turn = np.array(item["position_m"], dtype=np.float64), np.array(item["rotation_wxyz"], dtype=np.float64)
            mass = float(item["mass_kg"])
        except (KeyError, ValueError, TypeError, OverflowError) as error:
            yield Finding("poses", where, f"has no pose or mass ({type(error).__name__}: {error})")
            continue
        if place.shape != (3,) or not np.isfinite(place).all():
            yield Finding("poses", where, f"position_m is {item['position_m']}, not three finite numbers")
        if turn.shape != (4,) or not abs(np.linalg.norm(turn) - 1.0) < 1e-6:
            yield Finding("poses", where, f"rotation_wxyz is {item['rotation_wxyz']}, no quaternion of length 1")
        stated = _stated_mass(folder / str(item["file"])) if str(item["file"]) in there else None
        if stated is not None and not abs(stated - mass) <= 1e-6 * abs(stated):
            yield Finding("poses", where, f"mass_kg is {mass:g}, in the file {stated:g}")


def _stated_mass(path: AnyPath) -> float | None:
    """Mass of all links of a file [kg]."""
    try:
        robot = xml_root(read_file(path, path.name, BUDGET.xml_bytes))
        values = [float(element.get("value", "")) for element in robot.iterfind("link/inertial/mass")]
    except (ElementTree.ParseError, InputError, ValueError, LookupError):
        return None
    return sum(values)
