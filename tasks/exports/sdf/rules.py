"""Whether an SDF file can be simulated as it is. Works on anybody's world or model, as far as it stands in the file itself."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import AnyPath, is_there, read_file
from tasks.exports.findings import Finding
from tasks.exports.inertias import impossible, too_large
from tasks.exports.mesh_files import ELSEWHERE, HULL_TOLERANCE_M, hollow, named_mesh
from tasks.unpacking import xml_root

RULES: dict[str, str] = {
    "xml": "the file is XML whose root is sdf, with a version",
    "world": "there is one world, or one model",
    "names": "worlds, models, links, visuals, collisions and lights have names that SDF allows, each of its own where it stands",
    "numbers": "numbers are finite and as many as they should be",
    "gravity": "gravity points down (-Z) and is the Earth's",
    "timestep": "time steps are short enough for contacts",
    "viewing": "a world has a light",
    "closed_paths": "every file that is named is named by a relative path inside the folder, and is there",
    "mesh": "every mesh can be read, has triangles, finite positions and a scale; one that collides has a volume",
    "mass": "every link that moves states a mass above zero",
    "inertia": "inertias are those that a solid can have, and one as large as its colliders",
    "center_of_mass": "the center of mass lies inside the colliders' box",
    "collider": "every link that moves collides",
    "explicit_hulls": "meshes that collide are convex as they are, but for those that stand still",
    "visual": "every link that moves can be seen",
    "friction": "friction lies within bounds",
}
"""Every rule, and what holds when it passes."""

Element = ElementTree.Element

LONGEST_TIMESTEP_S = 0.02
"""Longer steps let things pass through one another [s]."""

_COUNTS = {
    "pose": (6,), "mass": (1,), "ixx": (1,), "ixy": (1,), "ixz": (1,), "iyy": (1,), "iyz": (1,), "izz": (1,),
    "max_step_size": (1,), "real_time_factor": (1,), "real_time_update_rate": (1,), "mu": (1,), "mu2": (1,),
    "diffuse": (3, 4), "ambient": (3, 4), "specular": (3, 4), "background": (3, 4), "normal": (3,), "range": (1,), "constant": (1,),
    "linear": (1,), "quadratic": (1,), "restitution_coefficient": (1,), "friction2": (1,), "radius": (1,), "length": (1,),
}  # fmt: skip
_COUNTS_IN = {("world", "gravity"): (3,), ("mesh", "scale"): (3,)}
"""Of elements that are something else in other ones: a link's gravity is yes or no."""

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NAMED = {
    "sdf": ("world", "model", "light"), "world": ("model", "light", "joint", "frame"), "link": ("visual", "collision", "light", "sensor"),
    "model": ("model", "link", "joint", "frame"),
}  # fmt: skip
"""What has a name of its own where it stands, by what it stands in: `frame` and `collision` in others name what they mean."""

_OTHERS = ("plugin", "state")
"""Elements of programs and of saved moments, in which the same words mean what these want."""


def check_sdf(path: AnyPath) -> list[Finding]:
    """Everything that is wrong with an SDF file and the meshes that it names, sorted."""
    try:
        root = xml_root(read_file(path, path.name, BUDGET.xml_bytes))
    except (ElementTree.ParseError, InputError, ValueError, LookupError) as error:
        return [Finding("xml", path.name, f"cannot be read ({error})")]
    if root.tag != "sdf" or not re.fullmatch(r"1\.\d+", root.get("version", "")):
        return [Finding("xml", path.name, f"root is {root.tag} of version {root.get('version')}, not sdf of a version 1.x")]
    findings = [*_names(path, root), *_numbers(path, root), *_world(path, root), *_paths(path, root)]
    known: dict[Any, Any] = {}
    for model in (element for element in _own(root) if element.tag == "model"):
        is_static = (model.findtext("static") or "false").strip().lower() in ("true", "1")
        for link in model.findall("link"):
            where = f"{path.name} model {model.get('name', '')} link {link.get('name', '')}"
            findings += _link(path, where, link, is_static, known)
    return sorted(set(findings))


def _names(path: AnyPath, root: Element) -> Iterator[Finding]:
    """Names, each of its own among what stands in the same element."""
    for above in _own(root):
        named = [child for child in above if child.tag in _NAMED.get(str(above.tag), ())]
        for child in named:
            name = child.get("name", "")
            where = f"{path.name} {child.tag} {name}"
            if not name:
                yield Finding("names", f"{path.name} {child.tag}", "has no name")
            elif "::" in name or re.fullmatch(r"__.*__", name):
                yield Finding("names", where, "is a name that SDF keeps for itself: without :: or __ around it")
            elif name in ("world", "model") and child.tag != "world":
                yield Finding("names", where, f"is called {name}, as frames of SDF's own", name == "world")
        counts = Counter(child.get("name", "") for child in named if child.get("name"))
        for name in sorted(name for name, count in counts.items() if count > 1):
            yield Finding("names", f"{path.name} {above.tag} {above.get('name', '')}", f"{counts[name]} things in it are called {name}")


def _floats(text: str | None) -> NDArray[np.float64] | None:
    """Finite numbers of a text, or None."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def _single(text: str | None) -> float | None:
    """One finite number of a text, or None."""
    values = _floats(text)
    return float(values[0]) if values is not None and len(values) == 1 else None


def _own(above: Element) -> Iterator[Element]:
    """An element and all in it that is SDF's."""
    waiting = [above]  # no recursion: files of others may be nested as deep as they like
    while waiting:
        element = waiting.pop()
        yield element
        waiting += [child for child in element if child.tag not in _OTHERS and not {*":}"} & {*str(child.tag)}]


def _numbers(path: AnyPath, root: Element) -> Iterator[Finding]:
    for above in _own(root):
        for element in above:
            yield from _count(path, element, _COUNTS_IN.get((str(above.tag), str(element.tag)), _COUNTS.get(str(element.tag))))


def _count(path: AnyPath, element: Element, counts: tuple[int, ...] | None) -> Iterator[Finding]:
    """An element that is so many numbers."""
    if counts is None or len(element):
        return
    if element.tag == "pose" and element.get("rotation_format") == "quat_xyzw":
        counts = (7,)
    values = _floats(element.text)
    if values is None or len(values) not in (counts if element.tag != "pose" or len(values) else (0,)):
        many = " or ".join(map(str, counts))
        yield Finding("numbers", f"{path.name} {element.tag}", f"is not {many} finite numbers: {(element.text or '').strip()[:60]}")


def _paths(path: AnyPath, root: Element) -> Iterator[Finding]:
    """Files that are named, but for those of meshes, which are read: images, height maps, models of others."""
    meshes = {id(uri) for mesh in root.iter("mesh") for uri in mesh.findall("uri")}
    for element in _own(root):
        name = (element.text or "").strip()
        if not name or id(element) in meshes or not (element.tag == "uri" or str(element.tag).endswith("_map")):
            continue
        where = f"{path.name} {element.tag}"
        pure = PurePosixPath(name)
        if ELSEWHERE.match(name):
            yield Finding("closed_paths", where, f"{name} is found by ROS or Gazebo only", is_error=False)
        elif pure.is_absolute() or ".." in pure.parts or ":" in name or "\\" in name:
            yield Finding("closed_paths", where, f"{pure.name!r} is absolute or leaves the folder")
        elif not is_there(path.parent / name):
            yield Finding("closed_paths", where, f"{name!r} does not exist")


def _world(path: AnyPath, root: Element) -> Iterator[Finding]:
    """What holds for a world as a whole."""
    worlds, models = root.findall("world"), root.findall("model")
    if len(worlds) + len(models) != 1:
        yield Finding("world", path.name, f"has {len(worlds)} worlds and {len(models)} models, not one")
    for world in worlds:
        where = f"{path.name} world {world.get('name', '')}"
        gravity = _floats(world.findtext("gravity", "0 0 -9.8"))
        if gravity is not None and len(gravity) == 3 and not (abs(gravity[:2]).max() < 1e-6 and 9.7 <= -gravity[2] <= 9.9):
            yield Finding("gravity", where, f"gravity is {gravity.tolist()}")
        step = _single(world.findtext("physics/max_step_size", "0.001"))
        if step is not None and not 0.0 < step <= LONGEST_TIMESTEP_S:
            yield Finding("timestep", where, f"max_step_size is {step:g}")
        if world.find("light") is None and world.find("include") is None:  # what is included may shine
            yield Finding("viewing", where, "has no light")


def _link(path: AnyPath, where: str, link: Element, is_static: bool, known: dict[Any, Any]) -> Iterator[Finding]:
    """Geometry, mass and friction of a link."""
    boxes: list[NDArray[np.float64] | None] = []
    for kind in ("visual", "collision"):
        for shape in link.findall(kind):
            meshes = shape.findall("geometry/mesh")
            if kind == "collision" and not meshes:
                boxes.append(None)
            for mesh in meshes:
                name = (mesh.findtext("uri") or "").strip()
                findings, loaded = named_mesh(path, where, name, known)
                yield from findings
                scale = _floats(mesh.findtext("scale", "1 1 1"))
                if scale is not None and not (scale > 0.0).all():
                    yield Finding("mesh", where, f"scale of {name} is {mesh.findtext('scale')}", not scale.all())
                if kind == "collision" and loaded is not None:
                    boxes.append(loaded[0] if _plain(shape, scale) else None)
                    is_flat, gap = hollow(path.parent / name, loaded, known)
                    if is_flat:
                        yield Finding("mesh", where, f"{name} collides, but is flat")
                    elif gap > HULL_TOLERANCE_M:
                        message = f"{name} lies up to {gap * 1000:.1f} mm inside its own hull"
                        yield Finding("explicit_hulls", where, message, not is_static)  # what stands still collides as it is
    for word in ("ode/mu", "ode/mu2", "bullet/friction", "bullet/friction2"):
        for element in link.iterfind(f"collision/surface/friction/{word}"):
            friction = _single(element.text)
            if friction is None or not 0.0 <= friction <= 2.0:
                yield Finding("friction", where, f"{element.tag} is {(element.text or '').strip()[:60]}, not within 0 and 2")
    inertial = link.find("inertial")
    if is_static and inertial is None:
        return
    if not is_static and link.find("collision") is None:
        yield Finding("collider", where, "moves, but has no collision")
    if not is_static and link.find("visual") is None:
        yield Finding("visual", where, "moves, but nothing of it can be seen")
    yield from _mass(where, inertial, boxes)


def _plain(shape: Element, scale: NDArray[np.float64] | None) -> bool:
    """Whether a mesh stands in the link's frame as it is."""
    pose = _floats(shape.findtext("pose", "0 0 0 0 0 0"))
    return scale is not None and bool((scale == 1.0).all()) and pose is not None and not pose.any()


def _mass(where: str, inertial: Element | None, boxes: list[NDArray[np.float64] | None]) -> Iterator[Finding]:
    """Mass properties, held against the positions of the colliders, shape (n, 3) each, where these are known."""
    mass = _single(inertial.findtext("mass")) if inertial is not None else None
    if inertial is None or mass is None or not mass > 0.0:
        yield Finding("mass", where, "is not stated" if mass is None else f"is {mass:g}")
        return
    entries = [_single(inertial.findtext(f"inertia/{name}")) for name in _MOMENTS]
    stated = [entry for entry in entries if entry is not None]
    if inertial.find("inertia") is None or len(stated) < len(_MOMENTS):
        yield Finding("inertia", where, "is not stated by six finite numbers: Gazebo takes those of a unit for it")
        return
    for fault in impossible(stated):
        yield Finding("inertia", where, fault)
    pose = _floats(inertial.findtext("pose", "0 0 0 0 0 0"))
    clouds = [cloud for cloud in boxes if cloud is not None]
    if pose is None or len(pose) != 6 or pose[3:].any() or not clouds or len(clouds) < len(boxes):
        return
    points, center = np.concatenate(clouds), pose[:3]
    if ((center < points.min(axis=0) - 1e-3) | (center > points.max(axis=0) + 1e-3)).any():
        yield Finding("center_of_mass", where, f"{center.tolist()} lies outside the link's colliders")
    for fault in too_large(mass, stated, np.abs(points - center).max(axis=0)):
        yield Finding("inertia", where, fault)
