"""A captured room as a reading: its shell and an instance for each element."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import Reading, StatedRoom
from tasks.capture.roomplan.elements import RoomElement
from tasks.capture.roomplan.floors import storeys_of
from tasks.capture.roomplan.surfaces import ElementPart, assembled, box_part, corners_of, panel_part, sheets_of, wall_parts
from tasks.geometry.transforms import Y_UP_TO_Z_UP, transform_points

if TYPE_CHECKING:
    import trimesh

NO_SURFACE = "no mesh and no frames in the scan: objects are boxes, walls rectangles; no views, no masks"
BY_PRIMS = "read as a captured room, by the names of its prims; no frames in the scan: no views, no masks"


@dataclasses.dataclass(frozen=True)
class ElementMeshes:
    """Meshes that a file has of its elements in the +Z-up frame [m], and colors of all of them, by their fields."""

    meshes: Mapping[str, trimesh.Trimesh]
    colors: Mapping[str, NDArray[np.uint8]]


def room_reading(
    listed: Mapping[str, Sequence[RoomElement]], drawn: ElementMeshes, name: str, origin: str, notes: Sequence[str]
) -> Reading:
    """Walls without their openings, floors, doors, windows and objects, each an instance, with the storeys.

    Args:
        listed: elements by their list, `walls` to `objects`.
        drawn: meshes of elements that have one; others are rectangles and boxes.
        name: the file.
        origin: the file as the origins of labels name it, before the field.
        notes: degradations so far.

    Raises:
        InputError: nothing has an area, or the room is larger than a scan.
    """
    holes = [*listed["doors"], *listed["windows"], *listed["openings"]]
    sheets, curves = sheets_of(listed["walls"], name)
    walls, wall_notes = wall_parts(listed["walls"], sheets, holes, name)
    storeys = storeys_of(listed["walls"], sheets, listed["floors"], name)
    shell = [("wall", wall.field, part) for wall, part in zip(listed["walls"], walls, strict=True)]
    shell += [("floor", floor.field, floor.part) for floor in storeys.floors]
    parts = [(kind, element.field, panel_part(element)) for kind in ("door", "window") for element in listed[f"{kind}s"]]
    parts += [(element.category, element.field, box_part(element)) for element in listed["objects"]]
    elements = [
        ElementPart(f"{label} {number}", label, field, f"{origin} {field}", _own(label, field, part, drawn))
        for number, (label, field, part) in enumerate([*shell, *parts])
    ]
    whole = assembled(elements, name, "walls", "scan the room again")
    return Reading(
        surface=whole.surface,
        parts=whole.parts,
        groups=whole.groups,
        is_dense=False,
        degradations=(BY_PRIMS if drawn.meshes else NO_SURFACE, *notes, *curves, *wall_notes, *storeys.notes, *whole.notes),
        from_file=Y_UP_TO_Z_UP,
        levels=storeys.levels,
        stated=StatedRoom(
            tuple(transform_points(corners_of(opening), opening.pose) for opening in listed["openings"]),
            outline_of_floors([floor.part for floor in storeys.floors]) if storeys.levels is None else None,
            has_height=True,
        ),
    )


def outline_of_floors(parts: Sequence[trimesh.Trimesh]) -> NDArray[np.float64] | None:
    """Corners of the ground that floors cover, at the height of the first one with an area [m], shape (n, 3); None for pieces or holes."""
    import shapely

    solid = [part for part in parts if len(part.faces)]
    if not solid:
        return None
    triangles = [part.triangles[:, :, :2] for part in solid]
    ground = shapely.union_all(shapely.polygons(np.concatenate(triangles)), grid_size=1e-4).simplify(1e-3)
    if ground.geom_type != "Polygon" or ground.interiors:
        return None
    ring = np.asarray(ground.exterior.coords)[:-1]
    return np.column_stack([ring, np.full(len(ring), float(solid[0].bounds[0, 2]))])


def _own(label: str, field: str, part: trimesh.Trimesh, drawn: ElementMeshes) -> trimesh.Trimesh:
    """The mesh that a file has of an element, or the part in the color that it has. A floor derived from walls keeps its own."""
    if label != "floor" and field in drawn.meshes:
        return drawn.meshes[field]
    color = drawn.colors.get(field)
    if color is not None and len(part.faces):
        visual: Any = part.visual
        visual.vertex_colors = np.tile(np.append(color, np.uint8(255)), (len(part.vertices), 1))
    return part
