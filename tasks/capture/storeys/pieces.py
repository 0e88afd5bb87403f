"""The storeys of a scan as readings of their own, in the scan's own frame.

What nobody named, and walls, are cut at the height between two storeys. An instance that reaches across, such as a flight of stairs, is
the storey's that has most of it; a frame is that of the storey in which its camera was.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.labels import CEILING, FLOOR, Label
from tasks.capture.reading import FrameSource, Group, Reading, by_owner, groups_of
from tasks.capture.storeys.cutting import Strips, strips
from tasks.capture.storeys.levels import Levels
from tasks.geometry.meshes import Surface, surface_of, vertex_colors
from tasks.geometry.transforms import transform_points
from tasks.geometry.triangles import face_areas

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_LEVEL_M = 1.0
"""Floors and ceilings that are no higher are one storey's, a slab with both of its sides."""

_SLIVER = 0.05
"""Share of an instance on the other side of a cut that is only its rim."""

_CUT = -1
"""Faces that are cut rather than given to a storey whole."""


@dataclasses.dataclass(frozen=True)
class Storey:
    """A storey of a scan. number: From 0, the lowest. floor: Its height in the leveled frame [m]. reading: What the scan has of it, in the
    scan's own frame."""

    number: int
    floor: float
    reading: Reading


def storeys_of(reading: Reading, meanings: Sequence[Label], pose: Array, levels: Levels) -> tuple[Storey, ...]:
    """What each storey has of a scan, the lowest first. meanings: Of its instances. pose: Scan frame to the leveled frame of the levels,
    4x4 [m]. Together they have all of the scan's surface, once, and all frames with a pose."""
    target = _targets(reading, meanings, pose, levels)
    if reading.surface is None:
        pieces = [dataclasses.replace(reading) for _ in levels.floors]
    elif reading.parts:
        pieces = _cut_parts(reading, target, pose, levels)
    else:
        pieces = _cut_surface(reading, reading.surface, target, pose, levels)
    frames = frames_of(reading.frames, pose, levels)
    return tuple(
        Storey(number, floor, dataclasses.replace(piece, frames=frames[number], glb=None, materials=None, alignment=None))
        for number, (floor, piece) in enumerate(zip(levels.floors, pieces, strict=True))
    )


def frames_of(frames: Sequence[FrameSource], pose: Array, levels: Levels) -> list[tuple[FrameSource, ...]]:
    """Frames of each storey, by the height of their cameras; those without a pose are nobody's."""
    own: list[list[FrameSource]] = [[] for _ in levels.floors]
    for frame in frames:
        if frame.pose is not None:
            own[int(levels.storey_of(transform_points(frame.pose[None, :3, 3], pose)[:, 2])[0])].append(frame)
    return [tuple(part) for part in own]


def _targets(reading: Reading, meanings: Sequence[Label], pose: Array, levels: Levels) -> Integers:
    """The storey that each face is given to whole, `_CUT` for those that are cut, shape (m,)."""
    if reading.surface is None:
        return np.zeros(0, dtype=np.int64)
    vertices, faces = reading.surface.vertices, reading.surface.faces
    target = np.full(len(faces), _CUT, dtype=np.int64)
    height, areas = transform_points(vertices, pose)[:, 2], face_areas(vertices, faces)
    for group, label in zip(reading.groups or (), meanings, strict=True):
        if len(group.faces):
            target[group.faces] = _target(height[faces[group.faces]], areas[group.faces], label, levels)
    return target


def _target(height: Array, areas: Array, label: Label, levels: Levels) -> int:
    """The storey of an instance, or `_CUT`. height: Of the corners of its faces [m], shape (m, 3). areas: Of these [m2]."""
    low, high = np.percentile(height, [2, 98])
    if label.nyu40_id in (FLOOR, CEILING) and high - low < _LEVEL_M:
        return int(levels.storey_of(np.array([high if label.nyu40_id == FLOOR else low]))[0])
    shares = np.bincount(levels.storey_of(height.mean(axis=1)), weights=areas, minlength=len(levels.floors))
    most = int(np.argmax(shares))
    return _CUT if label.is_structure and shares[most] < (1.0 - _SLIVER) * shares.sum() else most


def _cut_surface(reading: Reading, surface: Surface, target: Integers, pose: Array, levels: Levels) -> list[Reading]:
    """Storeys of a scan whose instances are sets of vertices."""
    cut = _strips(surface.vertices, surface.faces, target, pose, levels)
    vertices, colors = cut.extended(surface.vertices), cut.extended(surface.colors)
    named = reading.groups or ()
    owner = np.full(len(surface.vertices), -1, dtype=np.int64)
    storey_of_group = np.full(len(named) + 1, _CUT, dtype=np.int64)
    for number, group in enumerate(named):
        owner[group.vertices] = number
        if len(group.faces):
            storey_of_group[number] = target[group.faces[0]]
    owner = cut.extended_owner(owner)
    pieces = []
    for number, faces in enumerate(cut.faces):
        used, corners = np.unique(faces, return_inverse=True)
        piece = Surface(vertices[used], corners.reshape(-1, 3).astype(np.int64), colors[used])
        own = owner[used]
        own[(storey_of_group[own] != _CUT) & (storey_of_group[own] != number)] = -1  # rims of what is another storey's
        groups = _groups(named, own, piece) if reading.groups is not None else None
        pieces.append(dataclasses.replace(reading, surface=piece, groups=groups))
    return pieces


def _groups(named: Sequence[Group], owner: Integers, surface: Surface) -> tuple[Group, ...]:
    """Instances that have vertices in a piece, by their owners, shape (n,)."""
    members = by_owner(owner, len(named))
    kept = [number for number, vertices in enumerate(members) if len(vertices)]
    place = np.full(len(named) + 1, -1, dtype=np.int64)
    place[kept] = np.arange(len(kept))
    listed = [(named[number].source_id, named[number].raw_label, members[number]) for number in kept]
    groups = groups_of(listed, place[owner], surface)
    return tuple(dataclasses.replace(group, origin=named[number].origin) for group, number in zip(groups, kept, strict=True))


def _cut_parts(reading: Reading, target: Integers, pose: Array, levels: Levels) -> list[Reading]:
    """Storeys of a scan with textures, or whose instances are parts."""
    starts = np.cumsum([0, *(len(part.faces) for part in reading.parts)])
    group_of = np.full(starts[-1], -1, dtype=np.int64)
    for number, group in enumerate(reading.groups or ()):
        group_of[group.faces] = number
    parts: list[list[trimesh.Trimesh]] = [[] for _ in levels.floors]
    owners: list[list[Integers]] = [[] for _ in levels.floors]
    for part, start, end in zip(reading.parts, starts[:-1], starts[1:], strict=True):
        cut = _strips(np.asarray(part.vertices), np.asarray(part.faces, dtype=np.int64), target[start:end], pose, levels)
        for number, (faces, origins) in enumerate(zip(cut.faces, cut.origins, strict=True)):
            if len(faces):
                parts[number].append(_part_of(part, cut, faces))
                owners[number].append(group_of[start:end][origins])
    return [_of_parts(reading, own, owner) for own, owner in zip(parts, owners, strict=True)]


def _of_parts(reading: Reading, parts: Sequence[trimesh.Trimesh], owners: Sequence[Integers]) -> Reading:
    if not parts:
        nothing = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.uint8))
        return dataclasses.replace(reading, surface=nothing, parts=(), groups=None if reading.groups is None else ())
    surface, groups = surface_of(parts), None
    if reading.groups is not None:
        named = reading.groups
        members = by_owner(np.concatenate(owners), len(named))
        groups = tuple(
            dataclasses.replace(group, vertices=np.unique(surface.faces[faces]), faces=faces)
            for group, faces in zip(named, members, strict=True)
            if len(faces)
        )
    return dataclasses.replace(reading, surface=surface, parts=tuple(parts), groups=groups)


def _part_of(part: trimesh.Trimesh, cut: Strips, faces: Integers) -> trimesh.Trimesh:
    """Some faces of a part that was cut, with their textures or colors."""
    import trimesh

    used, corners = np.unique(faces, return_inverse=True)
    made = trimesh.Trimesh(cut.extended(np.asarray(part.vertices))[used], corners.reshape(-1, 3), process=False)
    visual: Any = part.visual
    if visual.kind == "texture":
        uv = None if visual.uv is None else cut.extended(np.asarray(visual.uv, dtype=np.float64))[used]
        made.visual = trimesh.visual.TextureVisuals(uv=uv, material=visual.material)
    else:
        colors = cut.extended(vertex_colors(part))[used]
        made.visual = trimesh.visual.ColorVisuals(made, vertex_colors=np.column_stack([colors, np.full(len(colors), 255, np.uint8)]))
    made.metadata["name"] = part.metadata["name"]
    return made


def _strips(vertices: Array, faces: Integers, target: Integers, pose: Array, levels: Levels) -> Strips:
    """A mesh cut between storeys, but for faces that are given to one whole."""
    loose = np.flatnonzero(target == _CUT)
    cut = strips(transform_points(vertices, pose)[:, 2], faces[loose], levels.cuts)
    own_faces, own_origins = [], []
    for number, (part, origins) in enumerate(zip(cut.faces, cut.origins, strict=True)):
        whole = np.flatnonzero(target == number)
        origin = np.concatenate([loose[origins], whole])
        order = np.argsort(origin, kind="stable")
        own_faces.append(np.concatenate([part, faces[whole]])[order])
        own_origins.append(origin[order])
    return Strips(cut.crossings, tuple(own_faces), tuple(own_origins))
