"""Whether a MuJoCo model can be simulated as it is: what MuJoCo says of it, and what it lets pass without a word.

Works on anybody's file. The text is looked at first, so that what MuJoCo refuses has a reason; then the compiled model.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_irregular, is_there, read_file
from tasks.exports.findings import Finding
from tasks.exports.mjcf.expansion import Pairs, made
from tasks.exports.usd.prims import dent
from tasks.optimization.engines.mujoco_engine import LONGEST_TIMESTEP_S, mujoco_module
from tasks.unpacking import xml_root

RULES: dict[str, str] = {
    "xml": "the file is XML whose root is mujoco",
    "budget": "what is made of the file takes no more elements, points and pixels than a budget allows",
    "numbers": "numbers are finite",
    "closed_paths": "every file that is named is named by a relative path inside the scene's folder, and is there",
    "names": "every body has a name of its own, those at least that move freely",
    "free_joint": "free joints belong to bodies directly below the world",
    "unit_quaternion": "rotations are quaternions, of length 1 where MuJoCo alone would make them so",
    "mass": "every moving body has a mass above zero",
    "inertia": "inertias are those that a solid can have, and one as large as its body",
    "center_of_mass": "the center of mass of what moves freely lies inside its box",
    "references": "meshes, materials and textures that are named are there",
    "compiles": "MuJoCo compiles the model",
    "gravity": "gravity points down (-Z) and is the Earth's",
    "timestep": "time steps are short enough for contacts",
    "collider": "every moving body has a geom that collides, and contacts are not switched off",
    "explicit_hulls": "meshes that collide are convex as they are",
    "visual": "every moving body can be seen, where it collides",
    "friction": "friction lies within bounds",
    "viewing": "a scene has lights, and a camera among what collides",
    "penetration": "nothing is deeper in something else than 2 mm at the start",
    "step": "one step leaves every number finite",
}
"""Every rule, and what holds when it passes."""

DEEPEST_M = 0.002
"""Deeper than this objects are pushed apart with a jolt [m]."""

_HULL_TOLERANCE = 2e-3  # metres; as for USD
_PRODUCTS = 20_000_000  # vertices times triangles that are compared: 160 MB
_TEXTS = {"name", "class", "childclass", "file", "data", "model", "meshdir", "texturedir", "assetdir", "prefix", "text", "content_type"}
_NO_NUMBER = re.compile(r"(?i)(?<![\w.])[+-]?(nan|inf|infinity)(?![\w.])")
_DIRECTORIES = {"mesh": "meshdir", "texture": "texturedir", "hfield": "meshdir", "skin": "meshdir", "flexcomp": "meshdir"}
_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


def check_mjcf(path: Path) -> list[Finding]:
    """Everything that is wrong with a MuJoCo model, sorted; empty for one that can be simulated as it is."""
    findings: list[Finding] = []
    elements = _elements(path, path.parent.resolve(), findings)
    findings += made(path.name, elements)
    if not any(finding.rule in ("xml", "budget") for finding in findings):
        for check in (_numbers, _paths, _names, _rotations, _masses, _references):
            findings += check(path, elements)
        if not any(finding.message.endswith(_IRREGULAR) for finding in findings):  # to open a pipe waits
            findings += _model(path, elements)
    return sorted(set(findings))


def _elements(path: Path, root: Path, findings: list[Finding]) -> Pairs:
    """Every element with the file that it stands in; files that are included come after the one that includes them."""
    elements: Pairs = []
    queue, seen = [path], {path.resolve()}
    for file in queue:
        try:
            top = xml_root(read_file(file, file.name, BUDGET.xml_bytes))
        except (ElementTree.ParseError, InputError, ValueError, LookupError) as error:
            findings.append(Finding("xml", file.name, f"cannot be read ({error})"))
            continue
        if file == path and top.tag != "mujoco":
            findings.append(Finding("xml", path.name, f"root is {top.tag}, not mujoco"))
            return []
        own = [(file, element) for element in top.iter() if isinstance(element.tag, str)]
        elements += own
        for _, element in own:
            other = root / element.get("file", "")
            if element.tag == "include" and element.get("file") and is_there(other) and other.resolve() not in seen:
                seen.add(other.resolve())
                queue.append(other)
    return elements


def _where(path: Path, element: ElementTree.Element) -> str:
    name = element.get("name") or element.get("mesh") or element.get("file")
    return f"{path.name} {element.tag}" + (f" {name}" if name else "")


def _numbers(path: Path, elements: Pairs) -> Iterator[Finding]:
    for file, element in elements:
        for key, value in element.attrib.items():
            if key not in _TEXTS and element.tag != "text" and _NO_NUMBER.search(value):
                yield Finding("numbers", _where(file, element), f"{key} is not finite: {value[:60]}")


_IRREGULAR = "is no regular file"


def _paths(path: Path, elements: Pairs) -> Iterator[Finding]:
    """Files as named, resolved as MuJoCo does: from the folder of the model and its compiler's directories."""
    root = path.parent.resolve()
    compilers = [element for _, element in elements if element.tag == "compiler"]
    for file, element in elements:
        if element.tag == "compiler":
            for key in ("meshdir", "texturedir", "assetdir"):
                if not _is_inside(element.get(key, "")):
                    yield Finding("closed_paths", _where(file, element), f"{key} {element.get(key)!r} is absolute or leaves the folder")
        kind = _DIRECTORIES.get(element.tag)
        folder = next((c.attrib[k] for c in reversed(compilers) for k in (kind, "assetdir") if k and c.get(k)), "")
        for key in _FILES if element.tag not in ("compiler", "text") else ():
            name = element.get(key)
            if not name:
                continue
            target = root / (folder if element.tag != "include" else "") / name
            irregular = is_irregular(target)
            if irregular:
                yield Finding("closed_paths", _where(file, element), f"{key} {PurePosixPath(name).name!r} {_IRREGULAR}")
            if not _is_inside(name):
                yield Finding("closed_paths", _where(file, element), f"{key} {PurePosixPath(name).name!r} is absolute or leaves the folder")
            elif not is_there(target) and not irregular:
                yield Finding("closed_paths", _where(file, element), f"{key} {name!r} does not exist")


def _is_inside(name: str) -> bool:
    """Whether a path is relative and goes nowhere up."""
    pure = PurePosixPath(name)
    return not pure.is_absolute() and ".." not in pure.parts and ":" not in name and "\\" not in name


def _names(path: Path, elements: Pairs) -> Iterator[Finding]:
    parents = {id(child): element for _, element in elements for child in element}
    seen: set[str] = set()
    for file, element in elements:
        if element.tag == "freejoint" or (element.tag == "joint" and element.get("type") == "free"):
            owner = parents.get(id(element))
            above = parents.get(id(owner)) if owner is not None else None
            while above is not None and above.tag in ("frame", "replicate"):
                above = parents.get(id(above))
            if above is not None and above.tag == "body":
                name = owner.get("name", "") if owner is not None else ""
                yield Finding("free_joint", f"{file.name} body {name}", f"has a free joint, but lies inside body {above.get('name', '')}")
        if element.tag == "body":
            name = element.get("name", "")
            if not name:
                free = any(child.tag == "freejoint" or child.get("type") == "free" for child in element)
                yield Finding("names", _where(file, element), "a body has no name", free)
            elif name in seen:
                yield Finding("names", _where(file, element), "two bodies have this name")
            seen.add(name)


def _floats(text: str | None) -> NDArray[np.float64] | None:
    """Numbers of an attribute, or None where they are none: MuJoCo says so itself."""
    try:
        return np.array([float(word) for word in (text or "").split()])
    except ValueError:
        return None


def _rotations(path: Path, elements: Pairs) -> Iterator[Finding]:
    for file, element in elements:
        quaternion = _floats(element.get("quat"))
        if quaternion is not None and len(quaternion) == 4 and not abs(np.linalg.norm(quaternion) - 1.0) < 1e-4:
            length = float(np.linalg.norm(quaternion))  # `1 0 1 0` is how many write a quarter turn; MuJoCo normalizes it
            yield Finding("unit_quaternion", _where(file, element), f"quat has length {length:.6g}", not 1e-6 < length < np.inf)


def _masses(path: Path, elements: Pairs) -> Iterator[Finding]:
    """Masses and inertias as stated."""
    for file, element in elements:
        if element.tag == "body" and any(child.tag in ("joint", "freejoint") for child in element) and element.find("inertial") is None:
            yield Finding("inertia", _where(file, element), "is not stated: MuJoCo makes its own of the geoms", False)
        if element.tag != "inertial":
            continue
        mass = _floats(element.get("mass"))
        if mass is None or len(mass) != 1 or not (np.isfinite(mass[0]) and mass[0] > 0.0):
            yield Finding("mass", _where(file, element), f"mass is {element.get('mass')}")
        full, diagonal = _floats(element.get("fullinertia")), _floats(element.get("diaginertia"))
        if full is not None and len(full) == 6 and np.isfinite(full).all():
            a, b, c, ab, ac, bc = full
            moments = np.linalg.eigvalsh([[a, ab, ac], [ab, b, bc], [ac, bc, c]])
        elif diagonal is not None and len(diagonal) == 3 and np.isfinite(diagonal).all():
            moments = np.sort(diagonal)
        else:
            continue
        if not moments[0] > 0.0:
            yield Finding("inertia", _where(file, element), f"principal moments are {moments.tolist()}")
        elif moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
            yield Finding("inertia", _where(file, element), f"{moments.tolist()}: one moment exceeds the sum of the others")


def _references(path: Path, elements: Pairs) -> Iterator[Finding]:
    """Assets by name; those of MuJoCo's own making (an asset's file gives it its name) count."""
    known: dict[str, set[str]] = {"mesh": set(), "material": set(), "texture": set(), "hfield": set()}
    for _, element in elements:
        if element.tag in known:
            known[element.tag].add(element.get("name") or PurePosixPath(element.get("file", "")).stem)
    made = any(element.tag in ("model", "attach", "flexcomp", "composite", "replicate") for _, element in elements)
    for file, element in elements:
        for kind, names in known.items():
            name = element.get(kind)
            if name and element.tag in ("geom", "material", "site", "skin", "flex", "layer") and name not in names and not made:
                yield Finding("references", _where(file, element), f"{kind} {name!r} is not defined")


def _model(path: Path, elements: Pairs) -> Iterator[Finding]:
    """The model as MuJoCo compiles it, at its start."""
    mujoco = mujoco_module()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        text = " ".join(str(error).replace(f"{path.parent.resolve()}/", "").replace(f"{path.parent}/", "").split())
        yield Finding("compiles", path.name, text[:300])
        return
    yield from _world(path, model)
    yield from _viewing(path, model, any(element.tag == "statistic" for _, element in elements))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    yield from _keys(model, elements)
    mujoco.mj_forward(model, data)
    yield from _contacts(path, model, data)
    mujoco.mj_step(model, data)
    which = mujoco.mjtWarning
    spoiled = any(data.warning[w].number for w in (which.mjWARN_BADQPOS, which.mjWARN_BADQVEL, which.mjWARN_BADQACC))
    if spoiled or not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        yield Finding("step", path.name, "the state is not finite after one step")


def _keys(model: Any, elements: Pairs) -> Iterator[Finding]:
    """Rotations of free bodies in keyframes as written: the compiled model has them normalized."""
    free = np.flatnonzero(model.jnt_type == mujoco_module().mjtJoint.mjJNT_FREE)
    for file, element in elements:
        state = _floats(element.get("qpos")) if element.tag == "key" else None
        if state is None or len(state) != model.nq:
            continue
        for joint in free:
            first = model.jnt_qposadr[joint] + 3
            length = float(np.linalg.norm(state[first : first + 4]))
            if not abs(length - 1.0) < 1e-4:
                yield Finding("unit_quaternion", _where(file, element), f"{model.joint(joint).name} has a rotation of length {length:.6g}")


def _world(path: Path, model: Any) -> Iterator[Finding]:
    """Options, and what every moving body has."""
    gravity, which = np.asarray(model.opt.gravity), mujoco_module().mjtDisableBit
    for flag, rule in ((which.mjDSBL_GRAVITY, "gravity"), (which.mjDSBL_CONTACT, "collider"), (which.mjDSBL_CONSTRAINT, "collider")):
        if model.opt.disableflags & flag:
            yield Finding(rule, f"{path.name} option", f"{flag.name.removeprefix('mjDSBL_').lower()} is disabled")
    if np.linalg.norm(gravity[:2]) > 1e-3 * max(float(np.linalg.norm(gravity)), 1e-9) or gravity[2] > 0.0:
        yield Finding("gravity", f"{path.name} option", f"gravity points to {gravity.tolist()}")
    elif abs(gravity[2] + 9.81) > 0.05 * 9.81:
        yield Finding("gravity", f"{path.name} option", f"gravity is {-gravity[2]:g}, on Earth 9.81")
    if not 0.0 < model.opt.timestep < LONGEST_TIMESTEP_S:
        yield Finding("timestep", f"{path.name} option", f"timestep {model.opt.timestep:g} is not within 0 and {LONGEST_TIMESTEP_S:g}")
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    seen = (model.geom_group < 3) & ((model.geom_matid >= 0) | (model.geom_rgba[:, 3] > 0.0))
    for tree in range(1, model.nbody):
        if model.body_parentid[tree] != 0 or not model.body_dofnum[tree]:
            continue
        geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == tree)
        where = f"{path.name} body {model.body(tree).name}"
        if not solid[geoms].any():
            yield Finding("collider", where, "has no geom that collides")
        if not seen[geoms].any():
            yield Finding("visual", where, "has no geom in groups 0 to 2 that can be seen")
        if model.jnt_type[model.body_jntadr[tree]] == mujoco_module().mjtJoint.mjJNT_FREE and (model.body_rootid == tree).sum() == 1:
            yield from _object(where, model, tree, geoms[solid[geoms]], geoms[seen[geoms]])
    dents: dict[int, float] = {}
    for geom in np.flatnonzero(solid):
        where = f"{path.name} geom {model.geom(geom).name or model.body(model.geom_bodyid[geom]).name}"
        friction = float(model.geom_friction[geom, 0])
        if not 0.0 <= friction <= 2.0:
            yield Finding("friction", where, f"friction is {friction:g}, not within 0 and 2")
        mesh = int(model.geom_dataid[geom])
        if mesh < 0 or model.geom_type[geom] != mujoco_module().mjtGeom.mjGEOM_MESH:
            continue
        if mesh not in dents:
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            vertices = model.mesh_vert[first : first + count].astype(np.float64)
            every = -(-count * faces // _PRODUCTS)  # of very large meshes only some triangles are looked at
            dents[mesh] = dent((vertices, model.mesh_face[start : start + faces : every].astype(np.int64)))
        if dents[mesh] > _HULL_TOLERANCE:
            yield Finding("explicit_hulls", where, f"lies up to {dents[mesh] * 1000:.1f} mm inside its own hull")


ROOM_PREFIX = "room_"
"""Bodies of walls begin with it."""


def _viewing(path: Path, model: Any, is_lit: bool) -> Iterator[Finding]:
    """Whether anybody who opens a scene sees it lit, from inside. Others, and this project's older files, leave that to the viewer."""
    mujoco = mujoco_module()
    ours = is_lit and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "scene") >= 0
    if not model.nlight:
        yield Finding("viewing", path.name, "there is no light", ours)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    is_solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    bodies = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "" for body in range(model.nbody)]
    if ours and not any(name.startswith(ROOM_PREFIX) for name in bodies):
        is_solid |= True  # without walls a camera stands over the floor, which collides as a plane without a size
    solid = np.flatnonzero(is_solid & (model.geom_rbound > 0.0))
    low, high = (
        (end(data.geom_xpos[solid] + sign * model.geom_rbound[solid, None], axis=0) if len(solid) else np.zeros(3))
        for end, sign in ((np.min, -1.0), (np.max, 1.0))
    )
    if not model.ncam:
        yield Finding("viewing", path.name, "there is no camera", ours)
    elif len(solid) and not ((low <= data.cam_xpos) & (data.cam_xpos <= high)).all(axis=1).any():
        yield Finding("viewing", path.name, "no camera is among what collides", ours)


def _object(where: str, model: Any, body: int, solid: Any, seen: Any) -> Iterator[Finding]:
    """A free body without others in it: mass properties and what is seen of it, held against where it collides."""
    box, drawn = _box(model, solid), _box(model, seen)
    if box is None:
        return
    gap = 0.0 if drawn is None else float(np.maximum(drawn[0] - box[1], box[0] - drawn[1]).max())
    if gap > 1e-3:
        yield Finding("visual", where, f"what is seen lies {gap:.3g} m beside what collides")
    center, mass, moments = model.body_ipos[body], float(model.body_mass[body]), model.body_inertia[body]
    if ((center < box[0] - 1e-3) | (center > box[1] + 1e-3)).any():
        yield Finding("center_of_mass", where, f"{center.tolist()} lies outside of what collides")
    both = box if drawn is None else np.array([np.minimum(box[0], drawn[0]), np.maximum(box[1], drawn[1])])
    reach = np.abs(both - center).max(axis=0)
    if moments.max() > 2.0 * mass * float(reach @ reach):
        message = f"{moments.max():.3g} is more than its mass could have in its farthest corner, {mass * float(reach @ reach):.3g}"
        yield Finding("inertia", where, message)


def _box(model: Any, geoms: Any) -> NDArray[np.float64] | None:
    """Box around the boxes of geoms in their body's frame [m], shape (2, 3), or None: there are none, or one has no end."""
    if not len(geoms) or not np.isfinite(model.geom_aabb[geoms]).all() or (model.geom_rbound[geoms] == 0.0).any():
        return None
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    points = []
    for geom in geoms:
        turn = np.zeros(9)
        mujoco_module().mju_quat2Mat(turn, model.geom_quat[geom])
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        points.append((middle + corners * half) @ turn.reshape(3, 3).T + model.geom_pos[geom])
    cloud = np.concatenate(points)
    return np.array([cloud.min(axis=0), cloud.max(axis=0)])


def _contacts(path: Path, model: Any, data: Any) -> Iterator[Finding]:
    """Pairs of objects that are in one another at the start."""
    deepest: dict[tuple[str, str], float] = {}
    for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        if min(geoms) >= 0:  # else it is a flexible object's
            first, second = sorted((model.body(model.geom_bodyid[geom]).name or "without name" for geom in geoms), reverse=True)
            deepest[first, second] = max(deepest.get((first, second), 0.0), -float(distance))
    for (first, second), depth in sorted(deepest.items()):
        if depth > DEEPEST_M:
            yield Finding("penetration", f"{path.name} body {first}", f"is {depth * 1000:.1f} mm deep in {second}")
