"""A replica as the files of one scene in a Habitat dataset (habitat-sim 0.3, habitat-lab 0.3).

Habitat's frame is glTF's: +Y up, -Z forward. Scene instances have quaternions (w, x, y, z), episodes (x, y, z, w).
Templates and scenes are looked up by name and, failing that, by any name that contains the one asked for; therefore
handles end in a hash of the scene or in a padded number, so that none contains another.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from schemas.navigation import Episode, Navmesh
from tasks.exports.bodies import Body, Replica, digest, identifier, stem
from tasks.exports.config import ExportsConfig, HabitatConfig
from tasks.exports.files import Export, File, write_folder
from tasks.exports.format import Doctor, ExportedScene, ExportFormat
from tasks.exports.gltf import aimed_glb, scaled_glb
from tasks.exports.habitat.dataset import dataset_files, describe
from tasks.exports.habitat.json_files import dump_json, dump_json_gz
from tasks.exports.habitat.library import LIGHTS
from tasks.exports.habitat.poses import numbers, position, positions, rotation, rotations, unit
from tasks.exports.lighting import lamps
from tasks.geometry.meshes import dump_glb
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import Z_UP_TO_Y_UP, quaternion_wxyz, to_y_up, transform_points, yaw_pose

ACTIONS: Mapping[str, int] = {"stop": 0, "forward": 1, "left": 2, "right": 3}
"""habitat-sim's numbers of the actions that episodes are made of."""

_Path = list[dict[str, Any]] | None

OF_THE_DATASET = ("dataset", "dataset_folder", "forward_m", "turn_degrees", "success_m")
"""Settings that all scenes of a dataset share; each scene states them, and the dataset's own files are made from that."""

UPRIGHT = {"up": [0, 1, 0], "front": [0, 0, -1]}
"""Every file is in Habitat's own frame; a stage that does not say so is taken to be +Z up."""


MARGIN_M = 0.0
"""Shell that habitat-sim puts around colliders [m]. Its default of 40 mm throws apart what touches as soon as it is DYNAMIC."""

LAMP_INTENSITY = 2.0
"""Of a lamp in habitat-sim, which falls off with 1 / (1 + distance squared): four lamps make a floor about as bright as its color."""

LAMP_COLOR = (1.0, 0.97, 0.92)
"""Warm white, linear RGB."""


def scene_handle(scene_id: str) -> str:
    """Name of a scene in the dataset; no scene's name contains another's."""
    name, mark = stem(scene_id), digest(scene_id)
    return name if name.endswith(f"_{mark}") else f"{name}_{mark}"


def object_handles(replica: Replica) -> dict[str, str]:
    """Name of every object's template, by instance; numbers are padded to one width."""
    width = max((len(body.instance_id) for body in replica.bodies), default=4)
    handle = scene_handle(replica.scene_id)
    return {body.instance_id: f"{handle}_{body.instance_id.zfill(width)}" for body in replica.bodies}


def habitat_files(
    replica: Replica, navmesh: tuple[Navmesh, bytes] | None, episodes: Sequence[Episode], config: ExportsConfig
) -> tuple[list[File], list[str]]:
    """Files of one scene, sorted by path, and what had to be left out."""
    handle = scene_handle(replica.scene_id)
    files = _stage_files(handle, replica, config)
    files += _object_files(replica, config)
    files.append(File(f"scenes/{handle}.scene_instance.json", dump_json(_scene_instance(replica, navmesh, config)), "scene"))
    missed: list[str] = []
    if navmesh is not None:
        files.append(File(f"navmeshes/{handle}.navmesh", navmesh[1], "navmesh"))
        written, missed = _episode_files(handle, replica, navmesh[0], episodes, config.habitat)
        files += written
    return sorted(files, key=lambda file: file.path), missed


def _stage_files(handle: str, replica: Replica, config: ExportsConfig) -> list[File]:
    """Floor, walls and lamps. Where there are brackets, the stage collides by a file of its own, which has them, too."""
    shell, stage = replica.shell, f"{handle}.glb"
    collision = f"{handle}.collider.glb" if replica.brackets else stage
    settings = {
        "render_asset": stage, "collision_asset": collision, **UPRIGHT, "origin": [0, 0, 0], "scale": [1, 1, 1],
        "units_to_meters": 1, "gravity": [0, -config.habitat.gravity_m_s2, 0], "is_collidable": True, "margin": MARGIN_M,
        "friction_coefficient": config.room_friction, "restitution_coefficient": config.room_restitution,
    }  # fmt: skip
    files = [
        File(f"stages/{stage}", aimed_glb(dump_glb([mesh for _, mesh in shell], [name for name, _ in shell])), "stage"),
        File(f"stages/{handle}.stage_config.json", dump_json(settings), "stage"),
        File(f"lights/{light_handle(handle)}.lighting_config.json", dump_json(_lights(replica)), "stage"),
    ]
    if replica.brackets:
        files.append(File(f"stages/{collision}", _stage_collider(replica), "stage"))
    return files


def _stage_collider(replica: Replica) -> bytes:
    """Shell and brackets as a GLB with one node each, without looks."""
    import trimesh

    parts = [*replica.shell, *replica.brackets]
    bare = [trimesh.Trimesh(part.vertices, part.faces, process=False) for _, part in parts]
    return aimed_glb(dump_glb(bare, [name for name, _ in parts]))


def light_handle(handle: str) -> str:
    """Name of the lights of a scene in the dataset."""
    return f"{handle}{LIGHTS}"


def _lights(replica: Replica) -> dict[str, Any]:
    """A point light for every lamp under the ceiling."""
    lamp = {"type": "point", "intensity": LAMP_INTENSITY, "color": list(LAMP_COLOR)}
    return {"lights": {str(index): lamp | {"position": position(place)} for index, place in enumerate(lamps(replica.room))}}


def _object_files(replica: Replica, config: ExportsConfig) -> list[File]:
    """A template per object. Geometry is named by what it holds, so that a dataset has it once, however many scenes show it."""
    handles = object_handles(replica)
    geometry: dict[str, tuple[str, str]] = {}
    files: dict[str, File] = {}
    for body in replica.bodies:
        if body.shape.name not in geometry:
            seen = scaled_glb(body.shape.glb, body.shape.scale, f"{body.shape.name}.glb")
            kind, hulls = identifier(body.shape.asset.category), _collider(body.shape.hulls)
            names = f"{kind}_{_mark(seen)}.glb", f"{kind}_{_mark(hulls)}.collider.glb"
            geometry[body.shape.name] = names
            files |= {names[0]: File(f"objects/{names[0]}", seen, "object")}
            files |= {names[1]: File(f"objects/{names[1]}", hulls, "collision")}
        handle, (render, collision) = handles[body.instance_id], geometry[body.shape.name]
        settings = {
            "render_asset": render, "collision_asset": collision, **UPRIGHT, "scale": [1, 1, 1],
            "units_to_meters": 1, **_mass_properties(body), "friction_coefficient": body.friction,
            "restitution_coefficient": body.restitution, "is_collidable": True, "use_bounding_box_for_collision": False,
            "margin": MARGIN_M, "join_collision_meshes": False, "semantic_id": body.nyu40_id,
        }  # fmt: skip
        files[handle] = File(f"objects/{handle}.object_config.json", dump_json(settings), "object")
    return list(files.values())


def _mark(data: bytes) -> str:
    """Short hash of a file's contents."""
    return hashlib.sha256(data).hexdigest()[:16]


def _mass_properties(body: Body) -> dict[str, Any]:
    """Mass, center of mass and inertia; the latter's products, for which habitat-sim has no place, stand beside them."""
    turn = Z_UP_TO_Y_UP[:3, :3]
    tensor = (turn @ body.inertia @ turn.T).tolist()
    center = (turn @ body.shape.properties.center).tolist()
    return {
        "mass": float(body.mass_kg), "COM": center, "inertia": [tensor[axis][axis] for axis in range(3)],
        "user_defined": {"inertia_kg_m2": tensor},
    }  # fmt: skip


def _collider(hulls: Sequence[Hull]) -> bytes:
    """Convex pieces as a GLB with one node each."""
    import trimesh

    meshes = [trimesh.Trimesh(hull.vertices, hull.faces, process=False) for hull in hulls]
    return aimed_glb(dump_glb(meshes, [f"hull_{index:02d}" for index in range(len(meshes))]))


def _scene_instance(replica: Replica, navmesh: tuple[Navmesh, bytes] | None, config: ExportsConfig) -> dict[str, Any]:
    """The scene: its stage, its objects with poses, its navmesh and its semantic lexicon."""
    handle, handles = scene_handle(replica.scene_id), object_handles(replica)
    origin = {"translation_origin": "asset_local"}
    about = {
        "scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type, "object_count": len(replica.bodies),
        "dataset": {name: getattr(config.habitat, name) for name in OF_THE_DATASET},
    }  # fmt: skip
    scene: dict[str, Any] = {
        **origin,
        "stage_instance": {"template_name": handle, **origin, "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]},
        "object_instances": [],
        "default_lighting": light_handle(handle),
        "semantic_scene_instance": f"{config.habitat.dataset}_lexicon",
        "user_defined": about,
    }
    if navmesh is not None:
        scene["navmesh_instance"] = f"{handle}_navmesh"
    for body in replica.bodies:
        pose = to_y_up(body.pose)
        known: dict[str, Any] = {
            "category": body.category, "nyu40_id": body.nyu40_id, "nyu40_label": body.nyu40_label, "is_fixed": body.is_fixed,
        }  # fmt: skip
        scene["object_instances"].append(
            {
                "template_name": handles[body.instance_id], **origin, "translation": numbers(pose[:3, 3]),
                "rotation": numbers(unit(quaternion_wxyz(pose))), "motion_type": config.habitat.motion_type,
                "user_defined": known | dict(body.provenance),
            }
        )  # fmt: skip
    return scene


def _episode_files(
    handle: str, replica: Replica, navmesh: Navmesh, episodes: Sequence[Episode], config: HabitatConfig
) -> tuple[list[File], list[str]]:
    """ObjectNav and PointNav episodes, one file per split."""
    handles = object_handles(replica)
    bodies = {body.instance_id: body for body in replica.bodies}
    chosen = sorted((e for e in episodes if e.agent == navmesh.agent), key=lambda row: row.episode_id)
    lost = sorted({e.instance_id for e in chosen if e.instance_id not in bodies})
    missed = [f"{instance}: its episodes are left out of the Habitat dataset, as it is itself" for instance in lost]
    chosen = [e for e in chosen if e.instance_id in bodies]
    files = []
    for split in sorted({e.split for e in chosen}):
        rows = [e for e in chosen if e.split == split]
        where = f"{split}/content/{handle}.json.gz"
        source = {"scene_id": replica.scene_id, "license": replica.license, "agent": navmesh.agent}
        paths = [_replay(row, config) for row in rows]
        points = [_point_episode(str(i), handle, row, path, config) for i, (row, path) in enumerate(zip(rows, paths, strict=True))]
        files.append(File(f"pointnav/{where}", dump_json_gz({"episodes": points, "provenance": source}), "episodes"))
        goals = _goals(handle, rows, bodies, handles, navmesh, config)
        objects = [
            _object_episode(str(i), handle, row, handles[row.instance_id], path, config)
            for i, (row, path) in enumerate(zip(rows, paths, strict=True))
        ]
        lost = [row.episode_id for row, path in zip(rows, paths, strict=True) if path is None]
        if lost:
            missed.append(f"{len(lost)} episodes ({split}) have no shortest path in the Habitat dataset: {lost[0]}'s actions end elsewhere")
        content = {"goals_by_category": goals, "episodes": objects, "provenance": source}
        files.append(File(f"objectnav/{where}", dump_json_gz(content), "episodes"))
    return files, missed


def _episode(episode_id: str, handle: str, row: Episode, config: HabitatConfig) -> dict[str, Any]:
    """What both tasks have in common."""
    return {
        "episode_id": episode_id,
        "scene_id": handle,
        "scene_dataset_config": f"{config.dataset_folder}/{config.dataset}.scene_dataset_config.json",
        "additional_obj_config_paths": [],
        "start_position": position(row.start_position),
        "start_rotation": rotation(row.start_yaw_radians),
        "info": {
            "geodesic_distance": row.geodesic_m, "euclidean_distance": row.euclidean_m, "scene": row.scene_id,
            "episode": row.episode_id, "instruction": row.instruction, "path_finder": row.path_finder,
        },
        "start_room": None,
    }  # fmt: skip


def _point_episode(episode_id: str, handle: str, row: Episode, path: _Path, config: HabitatConfig) -> dict[str, Any]:
    """A PointNav episode; its shortest path is a list of dictionaries, as habitat-lab wants it there."""
    return {
        **_episode(episode_id, handle, row, config),
        "goals": [{"position": position(row.goal_position), "radius": None}],
        "shortest_paths": None if path is None else [path],
    }


def _object_episode(episode_id: str, handle: str, row: Episode, target: str, path: _Path, config: HabitatConfig) -> dict[str, Any]:
    """An ObjectNav episode; its goals are those of its category."""
    episode = _episode(episode_id, handle, row, config)
    episode["info"]["target_object_id"] = target
    return {**episode, "goals": [], "shortest_paths": None if path is None else [path], "object_category": row.category}


def _replay(row: Episode, config: HabitatConfig) -> _Path:
    """States along the actions, each with the action taken there; None when the actions do not end where the row says.

    Raises:
        InputError: an action has no number in Habitat.
    """
    place, yaw = np.array(row.start_position), row.start_yaw_radians
    places, yaws = [], []
    for action in row.actions:
        if action not in ACTIONS:
            raise InputError("episodes", f"{row.episode_id} actions", f"{action!r} is none of {', '.join(ACTIONS)}")
        places.append(place)
        yaws.append(yaw)
        if action == "forward":
            place = place + config.forward_m * np.array([math.cos(yaw), math.sin(yaw), 0.0])
        elif action in ("left", "right"):
            yaw += math.radians(config.turn_degrees) * (1 if action == "left" else -1)
    steps: list[dict[str, Any]] = [
        {"position": at, "rotation": turned, "action": ACTIONS[action]}
        for at, turned, action in zip(positions(places), rotations(yaws), row.actions, strict=True)
    ]
    return steps if np.linalg.norm(place - np.array(row.final_position)) < 0.01 else None


def _goals(
    handle: str, rows: Sequence[Episode], bodies: Mapping[str, Body], handles: Mapping[str, str], navmesh: Navmesh, config: HabitatConfig
) -> dict[str, list[dict[str, Any]]]:  # fmt: skip
    """Goals by `<scene>_<category>`: every object of the category that some episode knows view points of."""
    views: dict[str, set[tuple[float, ...]]] = {}
    category = {}
    for row in rows:
        views.setdefault(row.instance_id, set()).update(row.view_points or ((*row.goal_position, 0.0),))
        category[row.instance_id] = row.category
    goals: dict[str, list[dict[str, Any]]] = {}
    for number, instance in enumerate(sorted(views)):
        body = bodies[instance]
        box = body.shape.bounds
        corners = transform_points(np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]]), body.pose)
        goal = {
            "position": position(corners.mean(axis=0)), "radius": None, "object_id": handles[instance],
            "object_name": body.name, "object_name_id": number, "object_category": category[instance], "room_id": None, "room_name": None,
            "view_points": [
                {
                    "agent_state": {"position": position(view[:3]), "rotation": rotation(view[3])},
                    "iou": round(view_overlap(corners, view, navmesh.agent_height_m, config), 5),
                }
                for view in sorted(views[instance])
            ],
        }  # fmt: skip
        goals.setdefault(f"{handle}_{category[instance]}", []).append(goal)
    return dict(sorted(goals.items()))


def view_overlap(corners: NDArray[np.float64], view: Sequence[float], eye_height: float, config: HabitatConfig) -> float:
    """Share of the image that the object's box covers as seen from a view point, which Habitat's own view points call `iou`.

    corners: Of the box in the world frame [m], shape (8, 3). view: x, y, z [m], yaw [rad]. The image is that of a level
    camera at `eye_height` above the view point. What lies behind the camera counts as not seen.
    """
    from shapely.geometry import MultiPoint, box

    local = (corners - np.array([view[0], view[1], view[2] + eye_height])) @ yaw_pose(view[3])[:3, :3]
    depth = local[:, 0]
    ahead = local[depth > 0.05]
    if len(ahead) < 3:
        return 0.0
    half = math.tan(math.radians(config.view_fov_degrees) / 2)
    image = box(-half, -half / config.view_aspect, half, half / config.view_aspect)
    outline = MultiPoint(np.column_stack([-ahead[:, 1], ahead[:, 2]]) / ahead[:, :1]).convex_hull
    return float(outline.intersection(image).area / image.area)


def _make(scene: ExportedScene) -> Export:
    """The scene's part of the dataset, checked as a dataset of this one scene."""
    config, replica = scene.config, scene.replica
    navmesh = _navmesh(scene.navmeshes, scene.episodes, config)
    missed = [] if navmesh is not None else ["no navmesh: the Habitat scene has neither navmesh nor episodes"]
    left_out = sorted(row.agent for row in scene.navmeshes if navmesh is not None and row.agent != navmesh.agent)
    missed += [f"navmesh and episodes of agent {agent!r} are left out: a Habitat scene has one navmesh" for agent in left_out]
    blob = None if navmesh is None else (navmesh, scene.blobs[navmesh.navmesh_blob])
    files, lost = habitat_files(replica, blob, scene.episodes, config)
    contents = {file.path: file.data for file in files}
    with temporary_folder() as place:
        root = place.resolve() / HABITAT.name
        write_folder(root, contents | _shared([({file.path: file.role for file in files}, contents.__getitem__)]))
        return Export(files, HABITAT.rules, HABITAT.check(root), [*missed, *lost])


def _navmesh(navmeshes: Sequence[Navmesh], episodes: Sequence[Episode], config: ExportsConfig) -> Navmesh | None:
    """The navmesh to export: of the agent that is asked for, else of the one with the most episodes."""
    wanted = config.habitat.agent
    count = Counter(episode.agent for episode in episodes)
    rows = [row for row in navmeshes if wanted is None or row.agent == wanted]
    return min(rows, key=lambda row: (-count[row.agent], row.agent), default=None)


def _shared(scenes: Sequence[tuple[Mapping[str, str], Callable[[str], bytes]]]) -> dict[str, bytes]:
    """Files of the dataset beside those of its scenes."""
    return dataset_files([describe(roles, read) for roles, read in scenes])


def _gate() -> ModuleType:
    from tasks.exports.habitat import rules

    return rules


HABITAT = ExportFormat(
    name="habitat",
    title="Habitat dataset",
    make=_make,
    gate=_gate,
    opened=lambda root: [root],
    doctor=Doctor(
        about="Check a Habitat scene dataset against everything that habitat-sim and habitat-lab stumble over.",
        example="./replicas/habitat",
        takes="either",
    ),
    shared=_shared,
)
