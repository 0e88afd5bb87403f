"""Reader of a scene of a Habitat scene dataset. Its frame is +Y up, -Z forward; it is turned to +Z up once, here."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from schemas.errors import InputError
from tasks.capture.labels import NYU40, Label, LabelMap
from tasks.geometry.meshes import parse_node_name
from tasks.geometry.transforms import Y_UP_TO_Z_UP, pose_from_quaternion_wxyz, to_z_up, transform_points, translation
from tasks.ingestion.models import MAX_STAGE_BYTES, is_convex, read_model
from tasks.ingestion.scene import (
    MIRROR,
    Array,
    FinishedObject,
    FinishedScene,
    ImportedModel,
    Physics,
    Source,
    is_mirrored,
    mirrored_model,
    scaled_pose,
)  # fmt: skip

if TYPE_CHECKING:
    import trimesh

_FRICTION, _RESTITUTION = 0.5, 0.1
"""What habitat-sim takes where an object's config says nothing."""

_UP, _FRONT = (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)
"""Axes of a template that names none."""

_BARE_UP, _BARE_FRONT = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
"""Axes that habitat-sim takes a stage to have that is a mesh without a config: those of Matterport3D."""

_INSTANCE = re.compile(r"[0-9]{4,9}")


def read_habitat(source: Source, labels: LabelMap) -> FinishedScene:
    """A scene with its stage and its objects.

    Raises:
        InputError: a file cannot be used, or a value in it makes no sense; names both.
    """
    about = source.about
    file, scene = str(about["file"]), about["scene"]
    notes = list(about["notes"])
    stage = _stage(source, labels, notes)
    models: dict[str, ImportedModel | None] = {}
    mirrored: dict[str, ImportedModel] = {}
    objects: list[FinishedObject] = []
    names = _instance_ids(scene.get("object_instances") or [])
    for index, placed in enumerate(scene.get("object_instances") or []):
        field = f"object_instances[{index}]"
        template = about["templates"].get(placed.get("template_name"))
        if template is None:  # left out when the scene was found, with a note
            continue
        facts = _user_defined(placed)
        key = f"{template['handle']}|{_about_asset(facts)}"
        try:
            if key not in models:
                models[key] = None  # the next object of a broken mesh does not read it again
                models[key] = _model(source, template, facts, notes)
            model = models[key]
            if model is None:
                asset = template["values"].get("render_asset", "nothing")
                notes.append(f"{file}: {field}: {asset!r} has no mesh that can be read: left out")
                continue
            pose, scale, is_mirror_image = _pose(placed, template, model, scene.get("translation_origin"), file, field)
            physics = _physics(placed, template["values"], scale, str(template["file"]))
        except InputError as error:
            notes.append(f"{error}: {field} is left out")
            continue
        if is_mirror_image:
            model = mirrored[key] = mirrored.get(key) or mirrored_model(model)
        raw, label = _label(facts, template, labels)
        if not label.is_known:
            notes.append(f"{file}: {field}: {raw or template['handle']!r} is not in the label map, nyu40 class {label.nyu40_id}")
        objects.append(
            FinishedObject(names[index], template["handle"], raw, label, model, pose, scale, physics=physics)
        )  # fmt: skip
    own = scene.get("user_defined") or {}
    stated = own.get("license")
    return FinishedScene(
        objects=tuple(objects),
        stage=tuple(stage),
        layout=None,
        alignment=Y_UP_TO_Z_UP,
        room_type=own["room_type"] if isinstance(own.get("room_type"), str) else "",
        license=stated if isinstance(stated, str) and stated else about.get("license"),
        notes=tuple(dict.fromkeys(notes)),
    )


def _instance_ids(placed: Sequence[Mapping[str, Any]]) -> list[str]:
    """Ids of the objects: their own, where all have one and no two the same; else by their order."""
    own = [str(_user_defined(instance).get("instance_id", "")) for instance in placed]
    if own and all(_INSTANCE.fullmatch(name) for name in own) and len(set(own)) == len(own):
        return own
    return [f"{index:04d}" for index in range(len(placed))]


def _user_defined(placed: Mapping[str, Any]) -> Mapping[str, Any]:
    """What a scene states of an object beyond habitat-sim's own keys."""
    stated = placed.get("user_defined", {})
    return stated if isinstance(stated, dict) else {}


def _about_asset(facts: Mapping[str, Any]) -> tuple[str, str, str | None]:
    """Source, license and author of an asset, as far as its object states them."""
    stated = {name: facts[name] if isinstance(facts.get(name), str) and facts[name] else None for name in ("source", "license", "author")}
    author = stated["author"] if stated["author"] != "unknown" else None
    return stated["source"] or "", stated["license"] or "", author


def _stage(source: Source, labels: LabelMap, notes: list[str]) -> list[tuple[trimesh.Trimesh, Label]]:
    """Parts of the stage in the world frame, each with what its node's name means."""
    about = source.about
    template, placed = about["stage"], about["scene"]["stage_instance"]
    if not template["render"]:
        notes.append(f"{about['file']}: the stage {template['handle']!r} has no mesh: floor and walls come from what stands there")
        return []
    parts, more = read_model(source.root / template["render"], source.root, is_z_up=False, limit=MAX_STAGE_BYTES)
    notes += more
    origin = template["values"].get("origin", [0, 0, 0])
    if any(origin):
        notes.append(f"{template['file']}: origin {origin} is not applied")
    is_bare = template["file"].endswith(".glb")
    axes = _axes(template, _BARE_UP if is_bare else _UP, _BARE_FRONT if is_bare else _FRONT)
    pose, scale = _placed(placed, template["values"], str(about["file"]), "stage_instance")
    move = to_z_up(pose @ np.diag([*scale, 1.0]) @ axes)
    labelled = []
    for part in parts:
        named = parse_node_name(str(part.metadata.get("name", "")))
        part.apply_transform(move)
        labelled.append((part, labels.of_node(named["category"], named["model"])))
    return labelled


def _model(source: Source, template: Mapping[str, Any], stated: Mapping[str, Any], notes: list[str]) -> ImportedModel | None:
    """The mesh of a template, upright, with the convex pieces that it collides with where it has any; None without a mesh file."""
    if not template["render"]:
        return None
    axes = to_z_up(_axes(template, _UP, _FRONT))
    parts, more = read_model(source.root / template["render"], source.root, is_z_up=False)
    notes += more
    pieces: list[trimesh.Trimesh] = []
    if template["collision"] and template["collision"] != template["render"]:
        pieces, more = read_model(source.root / template["collision"], source.root, is_z_up=False)
        notes += more
        if not is_convex(pieces) or template["values"].get("join_collision_meshes") is True:
            pieces = []
    for part in (*parts, *pieces):
        part.apply_transform(axes)
    origin, license, author = _about_asset(stated)
    return ImportedModel(
        parts=tuple(parts),
        pieces=tuple(pieces),
        name=template["render"].rpartition("/")[2].rpartition(".")[0],
        source=origin or template["render"],
        license=license or source.about.get("license") or "unknown",
        author=author,
    )


def _axes(template: Mapping[str, Any], up: Sequence[float], front: Sequence[float]) -> Array:
    """Turn, 4x4, of a template's own axes to +Y up and -Z forward."""
    values = template["values"]
    named = {"up": values.get("up", up), "front": values.get("front", front)}
    if any(len(axis) != 3 for axis in named.values()):
        raise InputError(template["file"], "up, front", "are not three numbers each", "state both axes")
    high, ahead = (np.asarray(axis, dtype=np.float64) for axis in named.values())
    side = np.cross(ahead, high)
    if np.linalg.norm(side) < 1e-6:
        if "front" in values and "up" in values:
            raise InputError(template["file"], "up, front", "are parallel", "state two axes at right angles")
        ahead = np.roll(high, 1) if abs(high[1]) > 0.5 else np.array([0.0, 1.0, 0.0])
        side = np.cross(ahead, high)
    high, side = high / np.linalg.norm(high), side / np.linalg.norm(side)
    turn = np.eye(4)
    turn[:3, :3] = np.array([side, high, np.cross(side, high)])
    return turn


def _placed(placed: Mapping[str, Any], values: Mapping[str, Any], file: str, field: str) -> tuple[Array, Array]:
    """Pose, 4x4, and scale, shape (3,), of what a scene places, both in Habitat's frame; a negative scale mirrors."""
    offset = placed.get("translation", [0, 0, 0])
    turn = placed.get("rotation", [1, 0, 0, 0])
    if len(offset) != 3:
        raise InputError(file, f"{field}.translation", f"has {len(offset)} numbers, not 3", "give x, y, z in metres")
    if len(turn) != 4:
        raise InputError(file, f"{field}.rotation", f"has {len(turn)} numbers, not 4", "give a quaternion w, x, y, z")
    if np.linalg.norm(turn) < 1e-6:
        raise InputError(file, f"{field}.rotation", "has length 0", "give a quaternion w, x, y, z of length 1")
    uniform = float(placed.get("uniform_scale", 1.0)) * float(values.get("units_to_meters", 1.0))
    scale = uniform * np.asarray(placed.get("non_uniform_scale", [1, 1, 1]), float) * np.asarray(values.get("scale", [1, 1, 1]), float)
    if not (np.abs(scale) > 1e-3).all() or not (np.abs(scale) < 1e4).all():
        text = ", ".join(f"{factor:.4g}" for factor in scale)
        raise InputError(file, f"{field} scale", f"is {text} in all", "must lie between 0.001 and 10,000, or mirrored")
    return pose_from_quaternion_wxyz(turn, offset), scale


def _pose(
    placed: Mapping[str, Any], template: Mapping[str, Any], model: ImportedModel, origin: Any, file: str, field: str
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Pose and scale of an object in the world frame, of the upright model; True if they are those of its mirror image."""
    pose, scale = _placed(placed, template["values"], file, field)
    stated = placed.get("translation_origin") or origin or "com"
    if str(stated).lower() not in ("asset_local", "com"):
        raise InputError(file, f"{field}.translation_origin", f"is {stated!r}", "use asset_local or COM")
    if str(stated).lower() == "com":
        pose = pose @ translation(-_center(template, model) * scale)
    matrix = to_z_up(pose @ np.diag([*scale, 1.0]))
    is_mirror_image = is_mirrored(matrix)
    world, stretch = scaled_pose(matrix @ MIRROR if is_mirror_image else matrix, file, field)
    return world, stretch, is_mirror_image


def _center(template: Mapping[str, Any], model: ImportedModel) -> Array:
    """What habitat-sim takes as the center of mass: as stated, else the center of the mesh's box; in Habitat's frame [m]."""
    stated = template["values"].get("COM")
    if stated is not None:
        if len(stated) != 3:
            raise InputError(template["file"], "COM", f"has {len(stated)} numbers, not 3", "give x, y, z in metres")
        return np.asarray(stated, dtype=np.float64)
    bounds = np.array([part.bounds for part in model.parts])
    middle = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    return np.asarray(transform_points(middle[None], np.linalg.inv(Y_UP_TO_Z_UP))[0])


def _label(stated: Mapping[str, Any], template: Mapping[str, Any], labels: LabelMap) -> tuple[str, Label]:
    """Raw label and its meaning: by the object, its category table, its semantic class, else the words of its name."""
    own = template["values"].get("user_defined", {})
    for raw in (
        stated.get("category"),
        own.get("category") if isinstance(own, dict) else None,
        template["category"],
        template["class_name"],
    ):
        if isinstance(raw, str) and raw.strip():
            number = stated.get("nyu40_id") if raw is stated.get("category") else None
            if isinstance(number, int) and not isinstance(number, bool) and 0 < number < len(NYU40):
                return raw, Label(raw, number, is_known=True)  # a dataset of ours: the category is one already
            label = labels[raw]
            return raw, label if label.is_known else labels.of_node(raw, raw)
    label = labels.of_node(template["handle"], template["handle"])
    return (template["handle"], label) if label.is_known else ("", dataclasses.replace(label, category="unlabeled"))


def _physics(placed: Mapping[str, Any], values: Mapping[str, Any], scale: Array, file: str) -> Physics | None:
    """What the object's config states of its body; None when it states no mass."""
    if "mass" not in values:
        return None
    mass = float(values["mass"]) * float(placed.get("mass_scale", 1.0))
    if placed.get("apply_scale_to_mass") is True:
        mass *= float(np.prod(scale))
    if not mass > 0:
        return None
    friction, restitution = (float(values.get(f"{name}_coefficient", usual)) for name, usual in _COEFFICIENTS)
    return Physics(max(mass, 0.001), float(np.clip(friction, 0, 2)), float(np.clip(restitution, 0, 1)), file)


_COEFFICIENTS = (("friction", _FRICTION), ("restitution", _RESTITUTION))
