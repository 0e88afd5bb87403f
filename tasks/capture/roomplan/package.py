"""RoomPlan's own USDZ: elements by the names of its prims, with their meshes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.ply import check_vertices
from tasks.capture.reading import Reading
from tasks.capture.roomplan.elements import RoomElement
from tasks.capture.roomplan.room import ElementMeshes, room_reading
from tasks.geometry.meshes import vertex_colors
from tasks.geometry.transforms import Y_UP_TO_Z_UP
from tasks.geometry.triangles import face_normals
from tasks.library.usd.rooms import MESH, PARAMETRIC, RoomPrim

if TYPE_CHECKING:
    import trimesh

    from tasks.library.usd import RoomModel

Array = NDArray[np.float64]

HEIGHTS_M = (0.5, 30.0)
"""Heights of walls: of a parapet and of a hall."""

MAX_CORNER_M = 0.005
"""Distance of a wall's vertices from the corners of its box: others have holes or slopes."""

MIN_PIECE_M2 = 1e-4
"""Area of a piece of a floor: smaller ones are slits between triangles."""

MAX_NAMED = 12
"""Prims that a note names."""

_LEVEL = 0.9
"""Vertical part of the normal of a floor's upper side."""

_FILLINGS = {"Door": "doors", "Window": "windows", "Opening": "openings"}


@dataclasses.dataclass(frozen=True)
class _PrimMesh:
    """An element with its mesh in the +Z-up frame [m]."""

    prim: RoomPrim
    mesh: trimesh.Trimesh

    @property
    def label(self) -> str:
        """Label as RoomPlan's JSON has it: `washerDryer`; without a category, that of the JSON's elements without one."""
        return self.prim.category[:1].lower() + self.prim.category[1:] or "object"


def package_reading(room: RoomModel, license: str | None, name: str, notes: Sequence[str]) -> Reading:
    """The room of a package: walls that are plain boxes lose their doors, windows and openings, as those of the JSON.

    name: The file.

    Raises:
        InputError: coordinates are not finite, or walls have no height that any unit explains.
    """
    change, unit_notes = _change(room, name)
    solids, more = _solids(room, change, name)
    listed: dict[str, list[RoomElement]] = {kind: [] for kind in ("walls", "doors", "windows", "openings", "floors", "objects")}
    meshes: dict[str, trimesh.Trimesh] = {}
    for solid in solids:
        field, category = solid.prim.path, solid.prim.category
        if category == "Floor":
            listed["floors"] += [_floor(solid, field)]
        elif category in ("Wall", *_FILLINGS):
            upright = _upright(solid, field)
            kind = _FILLINGS.get(category, "walls")
            listed[kind].append(upright)
            if category != "Wall" or not _is_box(solid, upright):
                meshes[field] = solid.mesh
        else:
            listed["objects"].append(dataclasses.replace(_upright(solid, field), category=solid.label))
            meshes[field] = solid.mesh
    colors = {solid.prim.path: vertex_colors(solid.mesh).mean(axis=0).round().astype(np.uint8) for solid in solids}
    drawn = ElementMeshes(meshes, colors)
    reading = room_reading(listed, drawn, name, f"{name}: prim", (*notes, *unit_notes, *more))
    return dataclasses.replace(reading, license=license, is_modelled=True, from_file=change)


def _change(room: RoomModel, name: str) -> tuple[Array, list[str]]:
    """The file's frame to the +Z-up frame, 4x4 [m], and notes on facts that the file lacks."""
    notes = []
    up = room.model.up
    if up is None:
        notes.append(f"{name}: upAxis: is not stated: y is taken to be up, as RoomPlan has it")
    turn = np.eye(4) if up == "z" else Y_UP_TO_Z_UP
    axis = 2 if up == "z" else 1
    walls = [
        float(np.ptp(np.asarray(part.vertices)[:, axis]))
        for part, number in zip(room.model.parts, room.part_elements, strict=True)
        if room.elements[number].category == "Wall"
    ]
    height = float(np.median(walls)) if walls else 0.0
    unit = room.model.unit_m
    if unit is None:
        unit = next((unit for unit in (1.0, 0.01, 0.001) if HEIGHTS_M[0] <= height * unit <= HEIGHTS_M[1]), 1.0)
        notes.append(f"{name}: metersPerUnit: is not stated: {unit:g} is taken, by the height of the walls")
    if not HEIGHTS_M[0] <= height * unit <= HEIGHTS_M[1]:
        problem = f"walls are {height * unit:.3g} m high (limits {HEIGHTS_M[0]:g} and {HEIGHTS_M[1]:g} m)"
        raise InputError(name, "metersPerUnit", problem, "state the unit that the coordinates have")
    return np.diag([unit, unit, unit, 1.0]) @ turn, notes


def _solids(room: RoomModel, change: Array, name: str) -> tuple[list[_PrimMesh], list[str]]:
    """Elements with their meshes, in the order of the file, and notes on prims that are not used."""
    import trimesh

    notes = [f"{name}: {element.remark}" for element in room.elements if element.remark]
    groups = {element.path: {part for part in element.path.split("/") if part in (PARAMETRIC, MESH)} for element in room.elements}
    has_both = len(set().union(*groups.values())) > 1
    own: dict[int, list[trimesh.Trimesh]] = {}
    for part, number in zip(room.model.parts, room.part_elements, strict=True):
        own.setdefault(number, []).append(part)
    solids, skipped = [], 0
    for number, element in enumerate(room.elements):
        # One export may hold the room twice: as boxes and as the scanned surfaces.
        if has_both and MESH in groups[element.path]:
            skipped += 1
            continue
        parts = own.get(number, [])
        if not parts:
            continue
        mesh: Any = parts[0].copy() if len(parts) == 1 else trimesh.util.concatenate(parts)
        mesh.apply_transform(change)
        check_vertices(np.asarray(mesh.vertices), name)
        solids.append(_PrimMesh(element, mesh))
    if skipped:
        notes.append(f"{name}: {MESH}: shows the room of {PARAMETRIC} again: left out")
    unnamed = [solid.prim.name for solid in solids if not solid.prim.category]
    if unnamed:
        more = f" and {len(unnamed) - MAX_NAMED} more" if len(unnamed) > MAX_NAMED else ""
        notes.append(f"{name}: prims without a category are objects without a label: {', '.join(unnamed[:MAX_NAMED])}{more}")
    return solids, notes


def _upright(solid: _PrimMesh, field: str) -> RoomElement:
    """An upright box around an element: x along its longer side, y up."""
    import shapely

    vertices = np.asarray(solid.mesh.vertices)
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    rectangle = shapely.MultiPoint(vertices[:, :2]).minimum_rotated_rectangle
    corners = shapely.get_coordinates(rectangle)
    if len(corners) < 4:  # a point or a line
        ends = corners if len(corners) > 1 else np.repeat(corners, 2, axis=0)
        corners = np.array([ends[0], ends[-1], ends[-1], ends[0]])
    sides = corners[1:3] - corners[:2]
    lengths = np.linalg.norm(sides, axis=1)
    longer = int(lengths.argmax())
    along = sides[longer] / lengths[longer] if lengths[longer] > 0 else np.array([1.0, 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = [*along, 0.0], [0.0, 0.0, 1.0], [along[1], -along[0], 0.0]
    pose[:3, 3] = [*corners[:4].mean(axis=0), 0.5 * (low + high)]
    size = np.array([lengths[longer], high - low, lengths[1 - longer]])
    return RoomElement(field, solid.label, pose, size, np.zeros((0, 3)), "", field)


def _is_box(solid: _PrimMesh, box: RoomElement) -> bool:
    """True if a mesh has vertices at the corners of its box alone."""
    local = (np.asarray(solid.mesh.vertices) - box.pose[:3, 3]) @ box.pose[:3, :3]
    return bool((np.abs(np.abs(local) - 0.5 * box.size) <= MAX_CORNER_M).all())


def _floor(solid: _PrimMesh, field: str) -> RoomElement:
    """A floor: the outline of what lies level of its mesh, at the height of its upper side."""
    import shapely

    vertices, faces = np.asarray(solid.mesh.vertices), np.asarray(solid.mesh.faces)
    vertical = face_normals(vertices, faces)[:, 2]
    level = faces[np.abs(vertical) > _LEVEL]
    ground = shapely.union_all([shapely.Polygon(triangle[:, :2]) for triangle in vertices[level]]) if len(level) else shapely.Polygon()
    pieces = shapely.get_parts(ground.buffer(1e-4).buffer(-1e-4).simplify(1e-3))
    outline = shapely.MultiPolygon([piece for piece in pieces if piece.geom_type == "Polygon" and piece.area > MIN_PIECE_M2])
    pose = np.eye(4)
    pose[2, 3] = float(vertices[level, 2].max()) if len(level) else float(vertices[:, 2].max())
    hull = shapely.get_coordinates(outline.convex_hull)[:-1]
    corners = np.column_stack([hull, np.zeros(len(hull))])
    return RoomElement(field, "floor", pose, np.zeros(3), corners, "", field, outline=None if outline.is_empty else outline)
