"""Whether a Habitat dataset loads, and loads as what it is meant to be.

habitat-sim and habitat-lab let most mistakes pass without a word: a missing object becomes another one with a similar
name, a missing navmesh becomes none, one whose header differs from the agent's settings is baked anew without the
furniture, a stage without an up axis is tipped over. Every such trap is a rule here. What another author may have meant
so, as positions of box centers, is a warning in a dataset that this project did not write.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_there, read_file
from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.exports.habitat.episode_rules import EPISODE_RULES, check_episodes, numbers
from tasks.exports.habitat.library import Library, Template, read_json, read_library
from tasks.exports.habitat.navmesh_file import DEFAULTS, NavmeshPolygons, read_polygons

RULES: dict[str, str] = {
    "dataset_config": "there is one scene dataset config, with sections that habitat-sim reads and paths inside the folder",
    "json": "every JSON file can be read",
    "shape": "every value is of the kind that Habitat reads there",
    "files_exist": "every file that is named exists",
    "handle_exact": "every template, navmesh and lexicon is named exactly as it is, and by one name only",
    "handle_contained": "no name contains another name of its kind, nor is part of the folder's own path",
    "stage_instance": "every scene has a stage",
    "upright": "up and front are stated for every stage and object, have length 1 and are not parallel",
    "gravity": "gravity points down (-Y) and nothing is in other units than metres",
    "geometry": "every GLB can be read and has triangles with finite positions",
    "rotation": "rotations in scenes are four numbers (w, x, y, z) of length 1",
    "rotation_order": "no object stands on its head as (x, y, z, w) read as (w, x, y, z) would have it",
    "translation": "translations in scenes are three finite numbers",
    "translation_origin": "positions are those of the object's own origin, not of its box's center",
    "motion_type": "motion types are known, and static where the navmesh goes around objects",
    "object_count": "a scene has as many objects as it says",
    "physics": "masses are above zero, friction, restitution and inertia not below",
    "margin": "what collides says that it does so at its surface: habitat-sim's default of 40 mm throws apart what touches",
    "collider": "colliders of several convex pieces are not joined into one",
    "navmesh": "every navmesh can be read, is of version 2 and has polygons",
    "navmesh_settings": "the header of every navmesh equals the documented agent, so that nobody bakes another one",
    "lights": "every scene names lights of the dataset, or none on purpose",
    "semantics": "lexicons have unique ids from 0 to 10000, and every object's id is in its scene's lexicon",
    "provenance": "in a dataset of this project, objects name instance, asset, source and license, and the list of assets has them",
    **EPISODE_RULES,
}
"""Every rule, and what holds when it passes."""

_SHORTEST = 1e-5  # habitat-sim's own tolerance when it compares settings of navmeshes
_PRIMITIVE = re.compile(r"(capsule3D|cone|cube|cylinder|icosphere|uvSphere)(Solid|Wireframe).*")  # made by habitat-sim itself
_THICKEST_M = 0.002  # as deep as exported objects may start in one another
_BUILT_IN = ("", "no_lights")  # what habitat-sim knows without any file
_MOTIONS = ("static", "kinematic", "dynamic")


def check_habitat(path: Path) -> list[Finding]:
    """Every fault of a Habitat dataset, sorted; empty when it can be used as it is. path: its folder, or its config."""
    root = path if path.is_dir() else path.parent
    library = read_library(root, None if path.is_dir() else path.name)
    findings = list(library.findings)
    if not library.config:
        return sorted(set(findings))
    findings += _names(library)
    seen: dict[Path, list[Finding]] = {}
    for kind in ("stages", "objects"):
        for template in library.sections[kind].values():
            findings += _asset(library, template, kind, seen)
    agent = _agent(root, findings)
    navmeshes = _navmeshes(library, agent, findings)
    lexicons = _lexicons(library, findings)
    for scene in library.sections["scene_instances"].values():
        findings += _scene(library, scene, navmeshes, lexicons)
    if not library.sections["scene_instances"]:
        findings.append(Finding("dataset_config", library.config, "scene_instances: there are none", library.is_ours))
    scenes = library.sections["scene_instances"]
    findings += _provenance(library)
    named = {handle: str(scene.values.get("navmesh_instance", "")) for handle, scene in scenes.items()}
    findings += check_episodes(library, {handle: navmeshes.get(name) for handle, name in named.items()}, agent)
    return sorted(set(findings))


def _names(library: Library) -> Iterator[Finding]:
    """Names that habitat-sim could take for another one: it looks for the name anywhere in the path, ignoring case."""
    kinds: dict[str, Sequence[str]] = {kind: sorted(names) for kind, names in library.sections.items()}
    kinds |= {"navmesh_instances": sorted(library.navmeshes), "semantic_scene_descriptor_instances": sorted(library.semantics)}
    above = library.root.resolve().as_posix().lower()
    for kind, names in kinds.items():
        text = "\n".join(names).lower()
        for name in names:
            if text.count(name.lower()) > 1:
                other = next((n for n in names if n != name and name.lower() in n.lower()), name)
                yield Finding("handle_contained", library.config, f"{kind}: {name!r} is part of {other!r}", library.is_ours)
            if kind in library.sections and len(names) > 1 and name.lower() in above:
                message = f"{kind}: {name!r} is part of the path of the dataset's folder"
                yield Finding("handle_contained", library.config, message, library.is_ours)


def _asset(library: Library, template: Template, kind: str, seen: dict[Path, list[Finding]]) -> Iterator[Finding]:
    """A stage's or an object's own settings and files. `seen`: what was found in GLBs before, as many templates share one."""
    values, ours = template.values, library.is_ours
    where = f"{template.file} {template.handle}" if template.file == library.config else template.file
    if not values.get("render_asset"):
        yield Finding("files_exist", where, "render_asset is not named")
    for key in ("render_asset", "collision_asset", "semantic_asset", "nav_asset"):
        if values.get(key) and not (key == "collision_asset" and _PRIMITIVE.fullmatch(Path(str(values[key])).name)):
            yield from _glb(library.root, template.folder / str(values[key]), where, key, seen)
    up, front = (numbers(values.get(key), 3) for key in ("up", "front"))
    if up is None or front is None:
        message = "a stage without them is taken to be +Z up" if kind == "stages" else "an object without them is taken to be +Y up"
        yield Finding("upright", where, f"up or front is not stated; {message}", ours)
    elif abs(np.linalg.norm(up) - 1) > 1e-6 or abs(np.linalg.norm(front) - 1) > 1e-6:
        yield Finding("upright", where, "up or front is not of length 1")
    elif np.linalg.norm(np.cross(up, front)) < 1e-3:
        yield Finding("upright", where, "up and front are parallel")
    gravity = numbers(values.get("gravity", [0, -9.8, 0]), 3)
    if kind == "stages" and (gravity is None or gravity[1] >= 0 or abs(gravity[0]) + abs(gravity[2]) > 1e-6):
        yield Finding("gravity", where, f"gravity is {values.get('gravity')}, not down (-Y)", ours)
    if values.get("units_to_meters", 1) != 1:
        yield Finding("gravity", where, f"units_to_meters is {values['units_to_meters']}, not 1", ours)
    for key, least in (("mass", 1e-9), ("friction_coefficient", 0.0), ("restitution_coefficient", 0.0)):
        value = values.get(key, 1.0)
        if value < least:
            yield Finding("physics", where, f"{key} is {value}, which no body has")
    for key, least in (("COM", -np.inf), ("inertia", 0.0)):
        vector = numbers(values.get(key, [0, 0, 0]), 3)
        if vector is None or (vector < least).any():
            yield Finding("physics", where, f"{key} is {values.get(key)}, not three numbers that a body can have")
    if values.get("is_collidable", True):
        yield from _margin(values.get("margin"), where, library.is_lit(template))
    apart = values.get("collision_asset") not in (None, values.get("render_asset"))
    if kind == "objects" and apart and values.get("join_collision_meshes", True):
        yield Finding("collider", where, "join_collision_meshes makes one hull of all pieces", ours)
    if kind == "objects" and apart and values.get("use_bounding_box_for_collision"):
        yield Finding("collider", where, "use_bounding_box_for_collision puts a box in the place of the pieces", ours)


def _margin(margin: float | None, where: str, ours: bool) -> Iterator[Finding]:
    """The shell around a collider. Up to a few millimeters it is what Bullet was made for; from there on what touches overlaps."""
    if margin is None:
        yield Finding(
            "margin", where, "margin is not stated: habitat-sim takes 0.04 m, and what touches is thrown apart when it moves", ours
        )
    elif not 0.0 <= margin <= _THICKEST_M:
        yield Finding("margin", where, f"margin is {margin:g} m: what touches is thrown apart when it moves", ours)


def _lights(library: Library, scene: Template) -> Iterator[Finding]:
    """Lights that a scene names."""
    name, is_lit = scene.values.get("default_lighting", ""), library.is_lit(scene)
    setups = library.sections["light_setups"]
    named = [known for known in sorted(setups) if name and (name in known or PurePosixPath(name).name == known)]  # as habitat-sim looks
    known = setups.get(name) or (setups[named[0]] if named and not library.is_ours else None)
    if known is not None and not known.values.get("lights"):
        yield Finding("lights", known.file, "lights: there are none", is_lit)
    elif known is None and name not in _BUILT_IN:
        message = f"default_lighting {name!r} is not in the dataset config: other lights would be taken"
        yield Finding("lights", scene.file, message, is_lit)
    elif known is None and is_lit:
        yield Finding("lights", scene.file, f"default_lighting {name!r} names no lights of the dataset")


def _glb(root: Path, path: Path, where: str, key: str, seen: dict[Path, list[Finding]]) -> Iterator[Finding]:
    """A GLB that a config names."""
    from tasks.containers import GLB_MAGIC
    from tasks.geometry.meshes import load_glb

    try:
        name = path.resolve().relative_to(root.resolve()).as_posix()
    except (ValueError, OSError, RuntimeError):  # outside, too long, links in a circle
        yield Finding("files_exist", where, f"{key} leaves the dataset's folder")
        return
    if not is_there(path):
        yield Finding("files_exist", where, f"{key} {name} does not exist; another object with a similar name would be shown")
        return
    if path not in seen:
        try:
            load_glb(read_file(path, name, BUDGET.scene_bytes, magic=GLB_MAGIC), name)
            seen[path] = []
        except InputError as error:
            seen[path] = [Finding("geometry", name, str(error).removeprefix(f"{name}: "))]
    yield from seen[path]


def _agent(root: Path, findings: list[Finding]) -> Mapping[str, Any] | None:
    """The documented agent of a dataset of this project; other datasets have none."""
    path = root / "metadata" / "agent.json"
    agent: Mapping[str, Any] | None = read_json(path, root, findings, shapes.AGENT) if path.is_file() else None
    return agent


def _navmeshes(library: Library, agent: Mapping[str, Any] | None, findings: list[Finding]) -> dict[str, NavmeshPolygons]:
    """Navmeshes that can be read, by name."""
    readable = {}
    for name, path in sorted(library.navmeshes.items()):
        file = library.root / str(path)
        if not is_there(file):
            message = f"navmesh_instances: {name}: {path} does not exist; the scene would have no navmesh"
            findings.append(Finding("files_exist", library.config, message))
            continue
        try:
            navmesh = read_polygons(read_file(file, str(path), BUDGET.model_bytes))
        except (ValueError, InputError) as error:
            findings.append(Finding("navmesh", str(path), str(error).removeprefix(f"{path}: ")))
            continue
        readable[name] = navmesh
        if not navmesh.polygons:
            findings.append(Finding("navmesh", str(path), "polygons: none is walkable"))
        if navmesh.settings is None:
            message = "version is 1, without settings: habitat-lab would bake another one"
            findings.append(Finding("navmesh", str(path), message, library.is_ours))
        else:
            findings += _settings(str(path), navmesh.settings, agent, library.is_ours)
    if library.navmeshes and agent is None:
        message = "navmesh_instances: no metadata/agent.json says which agent the navmeshes are for"
        findings.append(Finding("navmesh_settings", library.config, message, library.is_ours))
    return readable


def _settings(path: str, settings: Mapping[str, float], agent: Mapping[str, Any] | None, ours: bool) -> Iterator[Finding]:
    """Settings of a navmesh against those that habitat-lab would ask for with the documented agent."""
    expected = dict(DEFAULTS)
    for name, key in (("radius", "agentRadius"), ("height", "agentHeight"), ("max_climb", "agentMaxClimb"), ("max_slope", "agentMaxSlope")):
        expected[key] = float((agent or {}).get(name, settings[key]))
    expected["includeStaticObjects"] = float((agent or {}).get("navmesh_include_static_objects", True))
    for key, value in expected.items():
        if abs(settings[key] - value) > _SHORTEST:
            message = f"{key} is {settings[key]:g} in the file, {value:g} for the agent: it would be baked anew"
            yield Finding("navmesh_settings", path, message, ours)
    if not settings["includeStaticObjects"]:
        yield Finding("navmesh_settings", path, "includeStaticObjects is off: the navmesh would be baked without furniture", ours)


def _lexicons(library: Library, findings: list[Finding]) -> dict[str, set[int]]:
    """Ids of every lexicon, by name."""
    readable = {}
    for name, path in sorted(library.semantics.items()):
        if not is_there(library.root / path):
            message = f"semantic_scene_descriptor_instances: {name}: {path} does not exist; habitat-sim stops"
            findings.append(Finding("files_exist", library.config, message))
            continue
        document = read_json(library.root / path, library.root, findings, shapes.LEXICON)
        if document is None or "classes" not in document:
            if document is not None and not str(path).endswith(".semantic_config.json"):
                findings.append(Finding("semantics", str(path), "classes are missing"))
            continue
        ids = [item.get("id") for item in document["classes"]]
        wrong = [i for i in ids if not 0 <= i <= 10000]
        if wrong or len(set(ids)) != len(ids):
            findings.append(Finding("semantics", str(path), f"classes: ids must be unique numbers from 0 to 10000 (wrong: {wrong[:3]})"))
        readable[name] = set(ids)
    return readable


def _scene(
    library: Library, scene: Template, navmeshes: Mapping[str, NavmeshPolygons], lexicons: Mapping[str, set[int]]
) -> Iterator[Finding]:
    """One scene: its stage, its objects, its navmesh and its lexicon."""
    values, where = scene.values, scene.file
    stage = values.get("stage_instance")
    if not isinstance(stage, dict):
        yield Finding("stage_instance", where, "stage_instance is missing: habitat-sim stops")
    else:
        if stage.get("template_name") not in library.sections["stages"]:
            yield Finding(
                "handle_exact", where, f"stage_instance: template_name {stage.get('template_name')!r} is no stage's: habitat-sim crashes"
            )
        yield from _placed(stage, where, "stage_instance")
    yield from _lights(library, scene)
    navmesh = values.get("navmesh_instance")
    if navmesh is not None and navmesh not in library.navmeshes:
        yield Finding("handle_exact", where, f"navmesh_instance {navmesh!r} is not in the dataset config: the scene would have none")
    semantic = values.get("semantic_scene_instance")
    if semantic is not None and "%%" not in str(semantic) and semantic not in library.semantics:
        yield Finding("handle_exact", where, f"semantic_scene_instance {semantic!r} is not in the dataset config: habitat-sim stops")
    objects = values.get("object_instances", [])
    count = (values.get("user_defined") or {}).get("object_count")
    if count is not None and count != len(objects):
        yield Finding("object_count", where, f"object_instances are {len(objects)}, object_count is {count}")
    known_navmesh = navmeshes.get(str(navmesh))
    baked = known_navmesh is not None and bool((known_navmesh.settings or {}).get("includeStaticObjects"))
    for index, item in enumerate(objects):
        yield from _object(library, values, item, f"object_instances[{index}]", where, baked, lexicons.get(str(semantic)))


def _object(
    library: Library, scene: Mapping[str, Any], item: Mapping[str, Any], place: str, where: str, baked: bool, lexicon: set[int] | None
) -> Iterator[Finding]:
    """One object of a scene."""
    template = library.sections["objects"].get(str(item.get("template_name")))
    if template is None:
        yield Finding(
            "handle_exact", where, f"{place}: template_name {item.get('template_name')!r} is no object's: a similar one would be shown"
        )
    elif lexicon is not None and template.values.get("semantic_id", 0) not in lexicon:
        yield Finding("semantics", template.file, f"semantic_id {template.values.get('semantic_id')} is not in the lexicon")
    yield from _placed(item, where, place)
    rotation = numbers(item.get("rotation", [1, 0, 0, 0]), 4)
    if rotation is not None and abs(rotation[0]) < 1e-9 and abs(rotation[2]) < 1e-9:
        message = f"{place}: rotation {item['rotation']} turns the object upside down; is it (x, y, z, w)?"
        yield Finding("rotation_order", where, message, library.is_ours)
    if str(item.get("translation_origin", scene.get("translation_origin", ""))).lower() != "asset_local":
        message = (
            f"{place}: translation_origin is not asset_local: the translation would be taken as that of the center of the object's box"
        )
        yield Finding("translation_origin", where, message, library.is_ours)
    motion = str(item.get("motion_type", "dynamic")).lower()
    if motion not in _MOTIONS:
        yield Finding("motion_type", where, f"{place}: motion_type {item.get('motion_type')!r} is ignored")
    elif baked and motion != "static":
        message = f"{place}: motion_type is {motion}, but the navmesh goes around it; only static objects are baked"
        yield Finding("motion_type", where, message, library.is_ours)


def _provenance(library: Library) -> Iterator[Finding]:
    """Where objects come from, in a dataset that this project wrote."""
    if not library.is_ours:
        return
    listed = _attributions(library.root / "metadata" / "attribution.csv")
    if listed is None:
        yield Finding("provenance", library.config, "metadata/attribution.csv does not exist or cannot be read")
        return
    for scene in library.sections["scene_instances"].values():
        for index, item in enumerate(scene.values.get("object_instances", [])):
            stated = item.get("user_defined") or {}
            for key in ("instance_id", "asset_id", "source", "license"):
                if not isinstance(stated.get(key), str) or not stated[key]:
                    yield Finding("provenance", scene.file, f"object_instances[{index}]: user_defined has no {key}")
            line = listed.get(str(stated.get("asset_id")), {})
            agrees = all(line.get(key) == stated.get(key) for key in ("source", "author", "license"))
            if not (agrees and scene.handle in (line.get("scenes") or "").split()):
                message = (
                    f"object_instances[{index}]: asset_id is not in metadata/attribution.csv with this source, author, license and scene"
                )
                yield Finding("provenance", scene.file, message)


def _attributions(path: Path) -> dict[str, dict[str, str]] | None:
    """Lines of the list of assets by asset, None when it cannot be read."""
    try:
        text = read_file(path, path.name, BUDGET.table_bytes).decode(errors="replace")
        return {str(line.get("asset_id")): line for line in csv.DictReader(io.StringIO(text, newline=""))}
    except (InputError, csv.Error):
        return None


def _placed(item: Mapping[str, Any], where: str, place: str) -> Iterator[Finding]:
    """Position and rotation of a stage or an object."""
    if numbers(item.get("translation", [0, 0, 0]), 3) is None:
        yield Finding("translation", where, f"{place}: translation {item.get('translation')} is not three finite numbers")
    rotation = numbers(item.get("rotation", [1, 0, 0, 0]), 4)
    if rotation is None:
        yield Finding("rotation", where, f"{place}: rotation {item.get('rotation')} is not four finite numbers and would be ignored")
    elif abs(np.linalg.norm(rotation) - 1.0) > 1e-5:
        yield Finding("rotation", where, f"{place}: rotation has length {np.linalg.norm(rotation):.6g}")
