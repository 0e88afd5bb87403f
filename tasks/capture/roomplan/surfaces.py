"""Surfaces of the elements of a captured room: rectangles with holes, outlines, panels and boxes, in the +Z-up frame."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.ply import check_vertices
from tasks.capture.reading import Group
from tasks.capture.roomplan.curves import Flat, Neighbors, WallSheet, arc_of, unrolled_corners
from tasks.capture.roomplan.elements import RoomElement
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.transforms import inverse, transform_points

if TYPE_CHECKING:
    import shapely
    import trimesh
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]

PANEL_M = 0.04
"""Thickness of doors and windows, which the file does not state: that of a leaf."""

LEAST_M = 0.01
"""Boxes are no thinner: an object without depth is a picture or a screen."""

BESIDE_M = 0.3
"""What does not say which wall it is in is in the one that it is nearer to than this."""

_MOST_WALLS = 16
"""That a door may lie in: both sides of a wall, of two rooms, and as many again where a wall is listed in pieces."""

GRAY, FLOOR_GRAY, OBJECT_GRAY = (225, 222, 215), (170, 150, 130), (190, 190, 190)
"""The file states no colors: those of plaster, wood and nothing in particular."""


@dataclasses.dataclass(frozen=True)
class ElementPart:
    """The surface of an element, and what instance it is. field: Where the element stands in the file. origin: Where its label does."""

    source_id: str
    label: str
    field: str
    origin: str
    part: trimesh.Trimesh


@dataclasses.dataclass(frozen=True)
class Assembly:
    """Surfaces of elements as one. parts: Those that have an area, in the order of the faces of `surface`, a group for each."""

    surface: Surface
    parts: tuple[trimesh.Trimesh, ...]
    groups: tuple[Group, ...]
    notes: tuple[str, ...]


def assembled(elements: Sequence[ElementPart], name: str, list_of: str, remedy: str) -> Assembly:
    """Elements as one surface with an instance for each; those without an area are left out, with a note.

    name, list_of, remedy: File and field that an error names where none has an area, and what is to be done.

    Raises:
        InputError: none has an area, or they are larger than a scan.
    """
    groups: list[Group] = []
    vertices, faces = 0, 0
    kept = [element for element in elements if len(element.part.faces)]
    if not kept:
        raise InputError(name, list_of, "no element has an area", remedy)
    for element in kept:
        part = element.part
        own = (np.arange(vertices, vertices + len(part.vertices)), np.arange(faces, faces + len(part.faces)))
        vertices, faces = vertices + len(part.vertices), faces + len(part.faces)
        part.metadata["name"] = element.source_id
        groups.append(Group(element.source_id, element.label, *own, origin=element.origin))
    parts = tuple(element.part for element in kept)
    surface = surface_of(parts)
    check_vertices(surface.vertices, name)
    notes = tuple(f"{element.field}: has no area, left out" for element in elements if not len(element.part.faces))
    return Assembly(surface, parts, tuple(groups), notes)


def wall_parts(
    walls: Sequence[RoomElement], sheets: Sequence[WallSheet], holes: Sequence[RoomElement], name: str
) -> tuple[list[trimesh.Trimesh], list[str]]:
    """Walls without the doors, windows and openings in them, in their order, in the +Z-up frame [m], and notes on contradictions.

    A hole is in the wall that it names. One that names no wall, or a wall that is elsewhere, is in those that it lies in.

    sheets: Of the walls. name: The file, for errors and notes.

    Raises:
        InputError: a hole lies in more walls than there are in a place.
    """
    import shapely

    notes: list[str] = []
    middles = np.array([transform_points(corners_of(hole), hole.pose).mean(axis=0) for hole in holes]).reshape(-1, 3)
    is_near = np.zeros((len(walls), len(holes)), dtype=bool)
    is_parent = np.zeros_like(is_near)
    for row, (wall, sheet) in enumerate(zip(walls, sheets, strict=True)):
        middle = sheet.unroll(transform_points(middles, inverse(wall.pose)))
        is_along = (middle[:, 0] >= sheet.seams[0]) & (middle[:, 0] <= sheet.seams[-1])
        is_near[row] = (np.abs(middle[:, 2]) < BESIDE_M) & is_along & (np.abs(middle[:, 1]) <= 0.5 * wall.size[1])
    rows_of: dict[str, list[int]] = {}
    for row, wall in enumerate(walls):
        rows_of.setdefault(wall.identifier, []).append(row)
    for column, hole in enumerate(holes):
        if hole.parent:
            is_parent[rows_of.get(hole.parent, []), column] = True
    is_in = is_near.copy()
    for column, hole in enumerate(holes):
        if is_parent[:, column].any() and (is_parent & is_near)[:, column].any():
            is_in[:, column] = is_parent[:, column]
        elif hole.parent and is_near[:, column].any():
            named = "a wall that it does not lie in" if is_parent[:, column].any() else "a wall that is not listed"
            notes.append(f"{name}: {hole.field}.parentIdentifier: names {named}: its place decides")
        elif not is_near[:, column].any():
            notes.append(f"{name}: {hole.field}: lies in no wall")
    counts = is_in.sum(axis=0)
    if (counts > _MOST_WALLS).any():
        crowded = holes[int(counts.argmax())].field
        raise InputError(name, crowded, f"lies in more than {_MOST_WALLS} walls", "is the same wall listed again and again?")
    parts = []
    for row, (wall, sheet) in enumerate(zip(walls, sheets, strict=True)):
        shape = shapely.make_valid(shapely.Polygon(unrolled_corners(sheet, corners_of(wall), float(wall.size[0]))))
        if is_in[row].any():
            own = [_rectangle(sheet.unroll(_in_frame(holes[k], wall))) for k in np.flatnonzero(is_in[row]).tolist()]
            shape = shape.difference(shapely.union_all(own))
        parts.append(_sheet_part(shape, sheet, wall.pose))
    return parts, notes


def sheets_of(walls: Sequence[RoomElement], name: str) -> tuple[list[WallSheet], list[str]]:
    """The surface that each wall lies in, and a note for each that is not flat."""
    from scipy.spatial import cKDTree

    flats = [np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * wall.size[0] for wall in walls]
    ends = np.array([transform_points(line, wall.pose) for line, wall in zip(flats, walls, strict=True)]).reshape(-1, 3)
    tree, total = cKDTree(ends[:, :2]), ends.sum(axis=0)
    sheets: list[WallSheet] = []
    notes = []
    for row, wall in enumerate(walls):
        if wall.curve is None or wall.size[0] <= 0.0:
            sheets.append(Flat(float(wall.size[0])))
            continue
        neighbors = None
        if len(walls) > 1:
            center = (total - ends[2 * row] - ends[2 * row + 1]) / (len(ends) - 2)
            middle = transform_points(center[None], inverse(wall.pose))[0, [0, 2]]
            neighbors = Neighbors(middle, partial(_gaps, tree, row, wall.pose))
        arc, remark = arc_of(wall.curve, float(wall.size[0]), neighbors)
        sheets.append(arc)
        pieces = f"{arc.chords} flat pieces, {arc.sagitta:.2f} m off at most"
        field = f"{name}: {wall.field}.curve"
        notes.append(f"{field}: an arc of {arc.radius:.2f} m radius becomes {pieces}{f'; {remark}' if remark else ''}")
    return sheets, notes


def _gaps(tree: cKDTree, row: int, pose: Array, points: Array) -> Array:
    """Distances from points of a wall's x-z plane (n, 2) to the nearest end of another wall from above [m], shape (n,).

    tree: ends of all walls from above, two for each. row, pose: of the wall.
    """
    placed = transform_points(np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]]), pose)[:, :2]
    distances, numbers = tree.query(placed, k=3)
    return np.where(numbers // 2 == row, np.inf, distances).min(axis=1)


def _sheet_part(shape: Any, sheet: WallSheet, pose: Array) -> trimesh.Trimesh:
    """A part of a wall's sheet in place, as triangles that no seam crosses."""
    import shapely
    import trimesh

    seams = sheet.seams
    if len(seams) == 2:
        return flat_part(shape, pose, GRAY)
    _, low, _, high = shape.bounds if not shape.is_empty else (0.0, 0.0, 0.0, 0.0)
    pieces = [shape.intersection(shapely.box(a, low, b, high)) for a, b in itertools.pairwise(seams)]
    flat = [part for part in (flat_part(piece, np.eye(4), GRAY) for piece in pieces) if len(part.faces)]
    if not flat:
        return trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    for part in flat:
        part.vertices = transform_points(sheet.roll(np.asarray(part.vertices)), pose)
    whole: Any = trimesh.util.concatenate(flat)
    return cast("trimesh.Trimesh", whole)


def ceiling_part(ceiling: RoomElement) -> trimesh.Trimesh:
    """A ceiling with its outline, of plaster like walls, in the +Z-up frame [m]."""
    return flat_part(outline_of(ceiling), ceiling.pose, GRAY)


def floor_part(floor: RoomElement) -> trimesh.Trimesh:
    """A floor with its outline, looking up."""
    part = flat_part(outline_of(floor), floor.pose, FLOOR_GRAY)
    if floor.pose[2, 2] < 0.0:
        part.invert()
    return part


def panel_part(element: RoomElement) -> trimesh.Trimesh:
    """A door or window: a panel in the plane of its wall."""
    return _box(element, np.array([*element.size[:2], max(float(element.size[2]), PANEL_M)]))


def box_part(element: RoomElement) -> trimesh.Trimesh:
    """An object: its box."""
    return _box(element, np.maximum(element.size, LEAST_M))


def _box(element: RoomElement, size: Array) -> trimesh.Trimesh:
    import trimesh

    part = trimesh.creation.box(size) if (size > 0.0).all() else trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    part.apply_transform(element.pose)
    return _colored(part, OBJECT_GRAY)


def corners_of(element: RoomElement) -> Array:
    """Corners in the element's own frame [m], shape (n, 3)."""
    if len(element.corners) >= 3:
        return element.corners
    x, y = 0.5 * element.size[:2]
    return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])


def outline_of(element: RoomElement) -> Any:
    """An element's outline in the plane that it lies in; outlines that cross themselves are mended."""
    import shapely

    if element.outline is not None:
        return element.outline
    return shapely.make_valid(shapely.Polygon(corners_of(element)[:, :2]))


def _in_frame(hole: RoomElement, wall: RoomElement) -> Array:
    """Corners of a hole in a wall's frame [m], shape (n, 3)."""
    return transform_points(transform_points(corners_of(hole), hole.pose), inverse(wall.pose))


def _rectangle(corners: Array) -> Any:
    import shapely

    return shapely.box(*corners[:, :2].min(axis=0), *corners[:, :2].max(axis=0))


def flat_part(shape: shapely.Geometry, pose: Array, color: tuple[int, int, int]) -> trimesh.Trimesh:
    """A part of a plane, shape in its x and y [m], as triangles that `pose` puts in place."""
    import shapely
    import trimesh

    pieces = [piece for piece in shapely.get_parts(shapely.get_parts(shape)) if piece.geom_type == "Polygon" and piece.area > 0.0]
    try:
        triangles = [triangle for piece in pieces for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(piece))]
    except shapely.errors.GEOSException:  # an outline that cannot be mended has no surface
        triangles = []
    if not triangles:
        return trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    rings = shapely.get_coordinates(shapely.orient_polygons(np.array(triangles))).reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
    vertices = transform_points(np.column_stack([rings, np.zeros(len(rings))]), pose)
    return _colored(trimesh.Trimesh(vertices, np.arange(len(rings)).reshape(-1, 3), process=False), color)


def _colored(part: trimesh.Trimesh, color: tuple[int, int, int]) -> trimesh.Trimesh:
    visual: Any = part.visual
    visual.vertex_colors = np.tile(np.array([*color, 255], dtype=np.uint8), (len(part.vertices), 1))
    return part
