"""Shapes that are made for the page from rows and blobs: the room, where an agent can go, and what collides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from schemas.capture import RoomSurface, Shell
from schemas.errors import InputError
from schemas.exports import ExportFile
from schemas.parsing import json_value


def shell_glb(shells: Sequence[Shell], surfaces: Sequence[RoomSurface], blobs: Mapping[str, bytes]) -> bytes | None:
    """Floor and walls with the images that the scan gave them, a node per part, GLB; None where the scene has no room."""
    from tasks.geometry.meshes import dump_glb
    from tasks.shell import room_shell
    from tasks.surfaces import textured

    if not shells:
        return None
    try:
        parts = textured(room_shell(shells[0]), surfaces, blobs)
    except InputError:  # a floor that crosses itself: the scene is shown without a room
        return None
    return dump_glb([mesh for _, mesh in parts], [name for name, _ in parts])


def navmesh_triangles(data: bytes) -> dict[str, Any]:
    """The polygons of a .navmesh that an agent on the floor may walk on, seen from above: `points` (x, y) [m] and `triangles`."""
    from tasks.navigation.navmesh import read_navmesh
    from tasks.navigation.regions import walkable_region

    points: list[list[float]] = []
    triangles: list[list[int]] = []
    for ring in walkable_region(read_navmesh(data), floor_only=True).rings if data else ():
        first = len(points)
        points += [[round(float(x), 4), round(float(y), 4)] for x, y in ring]
        triangles += [[first, first + k, first + k + 1] for k in range(1, len(ring) - 1)]
    return {"points": points, "triangles": triangles}


def colliders_of(files: Sequence[ExportFile], blobs: Mapping[str, bytes]) -> dict[str, str]:
    """Blob of the convex pieces of every object, by instance, as the Habitat export has them: in the asset's frame, scaled.

    Empty where the scene has no such export.
    """
    by_path = {file.path: file.file_blob for file in files if file.format == "habitat"}
    colliders: dict[str, str] = {}
    for file in files:
        scene = _document(file.file_blob, blobs) if file.format == "habitat" and file.role == "scene" else {}
        for placed in scene.get("object_instances", ()):
            instance, template = placed.get("user_defined", {}).get("instance_id"), str(placed.get("template_name"))
            config = by_path.get(f"objects/{template.rpartition('/')[2]}.object_config.json", "")
            blob = by_path.get(f"objects/{_document(config, blobs).get('collision_asset')}", "")
            if instance is not None and blob in blobs:
                colliders[str(instance)] = blob
    return colliders


def _document(name: str, blobs: Mapping[str, bytes]) -> dict[str, Any]:
    """The JSON object in a blob; an empty one where there is none."""
    try:
        value = json_value(blobs[name]) if name in blobs else {}
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}
