"""A mesh that names nothing, as a scan: in which units it is and which of its axes points up, by its file, its kind and its geometry."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.survey import shift_note, survey_shift
from tasks.capture.instances.resolution import is_uneven
from tasks.capture.reading import Reading
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP, translation
from tasks.geometry.triangles import face_areas, face_normals, welded

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

UNITS = (("metres", 1.0), ("centimetres", 0.01), ("millimetres", 0.001), ("inches", 0.0254), ("feet", 0.3048))
"""What meshes are written in, and how many metres [m] that is; the first that makes a mesh of a plausible height is taken."""

HEIGHTS_M = (0.25, 30.0)
"""A table at least, and no more than a house of some storeys."""

LENGTHS_M = (0.3, 200.0)
"""Longest side: of a small table, and of what a scan covers."""

STOREY_M = 2.6
"""Of several units the one is taken that makes a mesh so high."""

UPPER, RIM_SHARE = 0.9, 0.06
"""Part of a normal along an axis from which a face looks that way, and which share of the mesh's extent at either end is floor, ceiling or
walls: within, faces tell of furniture, whose tops are scanned and whose undersides are not."""

CLEAR, CLEARER, LEAST = 0.7, 0.2, 0.01
"""Of what looks along an axis inside of a mesh, so much more looks one way than the other, of all or than along the axis that the kind of
file has, where that axis is up; less of the surface than the last says nothing. In scans of generated rooms it is at least 0.78 along
the axis that is up, and at most 0.6 along others."""


@dataclasses.dataclass(frozen=True)
class Stated:
    """What a file or its kind says. unit_m: Metres per unit, None where neither does. up: `y` or `z`. by: Who says which is up, for a note.
    is_turned: Coordinates are turned from +Y up to +Z up already."""

    unit_m: float | None
    up: str
    by: str
    is_turned: bool = False


Y_UP = Stated(1.0, "y", "glTF", is_turned=True)
"""GLB: metres and +Y up by the standard (glTF 2.0, section 3.4)."""


@dataclasses.dataclass(frozen=True)
class MeshUnit:
    """Meters per unit of a file, and a line on how it was found, empty if the file states it."""

    meters: float
    note: str


def bare_reading(
    parts: Sequence[trimesh.Trimesh], stated: Stated, notes: Sequence[str], license: str | None, name: str, unit: MeshUnit | None = None
) -> Reading:
    """What is read of parts of a mesh whose instances are to be found in its geometry, +Z up [m]. name: The file.

    unit: the unit that the caller has found; None finds it by the extents of the mesh.

    Raises:
        InputError: coordinates are not finite, or of no size that any unit explains.
    """
    surface = surface_of(parts)
    check_area(surface, name)
    turn, up_note = _upright(surface, stated)
    unit = unit or unit_of(np.abs(turn[:3, :3]) @ np.ptp(surface.vertices, axis=0), stated.unit_m)
    change = np.diag([unit.meters, unit.meters, unit.meters, 1.0]) @ turn
    vertices = surface.vertices @ change[:3, :3].T
    # Doubles are moved here: whatever follows may make floats.
    shift = survey_shift(vertices, name)
    if shift is not None:
        change, vertices = translation(shift) @ change, vertices + shift
        notes = (*notes, shift_note(shift, name))
    first, place = welded(vertices)  # seams of textures split vertices, and some formats every corner
    surface = Surface(vertices[first], place[surface.faces], surface.colors[first])
    check_vertices(surface.vertices, name)
    is_dense = not is_uneven(surface)
    moved: list[trimesh.Trimesh] = []
    for part in parts if _has_looks(parts) or not is_dense else ():
        copy = part.copy()
        copy.apply_transform(change)
        copy.metadata["name"] = f"scan_{len(moved)}"
        moved.append(copy)
    lines = [f"{name}: {up_note}", *([f"{name}: {unit.note}"] if unit.note else [])]
    return Reading(
        surface=surface, parts=tuple(moved), license=license, is_dense=is_dense, degradations=(*notes, *lines), materials=_materials(parts),
        from_file=change @ Y_UP_TO_Z_UP if stated.is_turned else change,
    )  # fmt: skip


def check_area(surface: Surface, name: str) -> None:
    """Raise InputError unless a surface has finite corners and an area."""
    with np.errstate(invalid="ignore", over="ignore"):
        area = float(face_areas(surface.vertices, surface.faces).sum())
    if not np.isfinite(surface.vertices).all() or not np.isfinite(area):
        raise InputError(name, "vertices", "are not finite", "export it again")
    if area <= 0.0:
        raise InputError(name, "faces", "have no area", "export it again")


def _upright(surface: Surface, stated: Stated) -> tuple[Array, str]:
    """What turns a surface to +Z up, 4x4, and a line that says how up was told. HM3D and Matterport have GLBs whose z axis is up: what is
    scanned tells, since tops of furniture are seen and undersides are not."""
    here = 2 if stated.is_turned or stated.up == "z" else 1
    note = f"{stated.up} is taken to be up, as {stated.by} has it"
    sides = {axis: _one_sided(surface, axis) for axis in (1, 2)}
    if is_closed(surface):  # drawn with its undersides, of which nothing can be told
        sides = dict.fromkeys(sides, 0.0)
    if sides[3 - here] < max(CLEAR, sides[here] + CLEARER):
        return (np.eye(4) if here == 2 else Y_UP_TO_Z_UP), note
    axis = "z" if stated.up == "y" else "y"
    turn = Z_UP_TO_Y_UP if stated.is_turned else (np.eye(4) if here == 1 else Y_UP_TO_Z_UP)  # back to the file's own axes, or z for y
    return turn, f"{axis} is up by the geometry, of which tops were scanned and undersides were not; {stated.by} has {stated.up}"


def is_closed(surface: Surface) -> bool:
    """True if every edge has a face on each side, as no scanned surface has."""
    _, place = welded(surface.vertices)
    corners = place[surface.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    forward, counts = np.unique(edges, axis=0, return_counts=True)
    backward, backward_counts = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    return np.array_equal(forward, backward) and np.array_equal(counts, backward_counts)


def _one_sided(surface: Surface, axis: int) -> float:
    """How much more of what looks along an axis, inside of the mesh, looks one way than the other, 0 to 1."""
    areas, normals = face_areas(surface.vertices, surface.faces), face_normals(surface.vertices, surface.faces)[:, axis]
    height = surface.vertices[surface.faces, axis].mean(axis=1)
    low, high = np.percentile(surface.vertices[:, axis], [1, 99])
    rim = RIM_SHARE * float(high - low)
    inside = (height > low + rim) & (height < high - rim)
    up, down = (float(areas[inside & (sign * normals > UPPER)].sum()) for sign in (1.0, -1.0))
    return abs(up - down) / (up + down) if up + down > LEAST * float(areas.sum()) else 0.0


def unit_of(extents: Array, stated: float | None) -> MeshUnit:
    """The unit of a room: the stated one, or meters, unless its size is plausible in another unit only.

    extents: of the room with +Z up, shape (3,). stated: meters per unit by the file, None without any.
    """
    height, length = float(extents[2]), float(extents.max())

    def is_plausible(unit: float) -> bool:
        return HEIGHTS_M[0] <= height * unit <= HEIGHTS_M[1] and LENGTHS_M[0] <= length * unit <= LENGTHS_M[1]

    first = stated if stated is not None else 1.0
    if is_plausible(first):
        return MeshUnit(first, "" if stated is not None else "is taken to be in metres, which it does not say")
    plausible = [(word, unit) for word, unit in UNITS if is_plausible(unit)]
    if not plausible:
        return MeshUnit(first, "")  # what is wrong with it is said where its size is checked
    word, unit = min(plausible, key=lambda entry: abs(np.log(height * entry[1] / STOREY_M)))
    stating = "the unit that it states" if stated is not None else "metres"
    return MeshUnit(unit, f"is read as {word}: in {stating} it would be {height * first:.3g} m high")


def _has_looks(parts: Sequence[trimesh.Trimesh]) -> bool:
    """Whether any part has a texture, which the lake's mesh of the scan keeps."""
    return any(getattr(part.visual, "kind", None) == "texture" for part in parts)


def _materials(parts: Sequence[trimesh.Trimesh]) -> NDArray[np.int64]:
    """Texture of each face of all parts, by number, shape (m,): parts that share an image share a number, and so do those of one color."""
    known: dict[Any, int] = {}
    numbers = []
    for part in parts:
        visual: Any = part.visual
        material = getattr(visual, "material", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        color = getattr(material, "main_color", None)
        key = ("image", id(image)) if image is not None else ("color", None if color is None else tuple(np.asarray(color).tolist()))
        numbers.append(np.full(len(part.faces), known.setdefault(key, len(known)), dtype=np.int64))
    return np.concatenate(numbers)
