"""Instances found in the geometry of a scan that names none: the room first, then regions of what is left, merged.

No learned model is asked. Categories are guesses from size and place (`naming`), and the raw label says so: `geometry:table`.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.fragments import FragmentConfig, joined_fragments, without_wall_scraps
from tasks.capture.instances.islands import islands_of
from tasks.capture.instances.naming import PROVIDER, UNKNOWN, ShapeNamingConfig, name_by_shape, shape_of
from tasks.capture.instances.regions import RegionConfig, merged_regions, region_segments
from tasks.capture.instances.resolution import Evened, evened, is_uneven
from tasks.capture.instances.structure import FLOOR_BAND_M, SLIVER_M, RoomPlane, outward, structure_of
from tasks.capture.instances.things import joined_bodies
from tasks.capture.reading import Group, groups_of
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import face_areas, vertex_normals
from tasks.settings import Config

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEAST_VERTICES = 4
"""An instance with fewer vertices has no shape."""


@dataclasses.dataclass(frozen=True)
class SegmentationConfig(Config):
    """How instances are found in a mesh that names none."""

    regions: RegionConfig = dataclasses.field(default_factory=RegionConfig)  # see there
    fragments: FragmentConfig = dataclasses.field(default_factory=FragmentConfig)  # see there
    naming: ShapeNamingConfig = dataclasses.field(default_factory=ShapeNamingConfig)  # see there


@dataclasses.dataclass(frozen=True)
class GeometryInstances:
    """What the geometry of a scan shows. groups: Room and objects. probabilities: Of a guessed category, 0 to 1, by the group's source id;
    parts of the room have none. notes: A line each."""

    groups: tuple[Group, ...]
    probabilities: dict[str, float]
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class _Segmented:
    """A mesh with its room and its regions. normals: Outward, shape (n, 3). areas [m2], region: Of each vertex of `even`, shape (n,)."""

    even: Evened
    normals: Array
    areas: Array
    planes: list[RoomPlane]
    region: Indices

    def shape(self, members: Indices) -> Array:
        """What names a region: see `naming.shape_of`."""
        return shape_of(self.even.surface.vertices[members], self.normals[members], self.areas[members])


def geometry_instances(world: Surface, config: SegmentationConfig, materials: Indices | None = None) -> GeometryInstances:
    """Instances of an aligned scan (floor at z = 0): floor, walls, ceiling and objects.

    materials: Which of its textures each face has, shape (m,), where the scan has several: who draws furniture gives each its own.
    """
    made = _segmented(world, config, materials)
    named: list[tuple[str, Indices]] = [(plane.category, plane.members) for plane in made.planes]
    probabilities: dict[str, float] = {}
    for members in _members(made.region):
        if len(members) >= _LEAST_VERTICES:
            name = name_by_shape(made.shape(members), config.naming)
            probabilities[str(len(named))] = name.probability
            named.append((name.category, members))
    groups = _groups(named, made.even, world)
    unnamed = sum(category == UNKNOWN for category, _ in named)
    note = f"instances found in the geometry: {len(probabilities)} objects, categories guessed from their sizes"
    return GeometryInstances(groups, probabilities, (f"{note}, {unnamed} of them unknown" if unnamed else note,))


def found_shapes(world: Surface, config: SegmentationConfig) -> list[tuple[Array, Array]]:
    """Vertices [m], shape (n, 3), and shape, as `naming` has it, of each region in an aligned scan."""
    made = _segmented(world, config, None)
    points = made.even.surface.vertices
    return [(points[members], made.shape(members)) for members in _members(made.region) if len(members) >= _LEAST_VERTICES]


def _segmented(world: Surface, config: SegmentationConfig, materials: Indices | None) -> _Segmented:
    is_coarse = is_uneven(world)
    even = evened(world, is_coarse)
    surface = even.surface
    areas = vertex_areas(surface)
    normals = outward(surface.vertices, vertex_normals(surface.vertices, surface.faces), areas)
    planes = structure_of(surface.vertices, normals, areas)
    islands = islands_of(even, world, planes, materials) if is_coarse else None
    if islands is not None:
        return _Segmented(even, normals, areas, *islands)
    segments = region_segments(surface, normals, areas, config.regions)
    for plane in planes:
        segments[plane.members] = -1
    if any(plane.category == "floor" for plane in planes):
        segments[surface.vertices[:, 2] < -FLOOR_BAND_M] = -1  # what lies below the floor was seen in a mirror, or is noise
    region = merged_regions(surface, normals, areas, segments, config.regions, is_room=bool(planes))
    planes = _with_slivers(planes, surface.vertices[:, 2], region)
    if any(plane.category == "wall" for plane in planes):
        planes, region = without_wall_scraps(surface, normals, areas, planes, region, config.fragments)
        region = joined_fragments(surface, areas, region, config.fragments, config.regions)
    if [plane.category for plane in planes] == ["floor"]:
        region = joined_bodies(surface, normals, region)
    return _Segmented(even, normals, areas, planes, region)


def _with_slivers(planes: list[RoomPlane], z: Array, region: Indices) -> list[RoomPlane]:
    """The planes of the room, the floor with regions that rise no higher than `SLIVER_M`, which are no regions any more."""
    floor = next((number for number, plane in enumerate(planes) if plane.category == "floor"), None)
    if floor is None:
        return planes
    low = [members for members in _members(region) if np.percentile(np.abs(z[members]), 95) < SLIVER_M]
    for members in low:
        region[members] = -1
    planes = list(planes)
    planes[floor] = RoomPlane("floor", np.unique(np.concatenate([planes[floor].members, *low])))
    kept = np.unique(region[region >= 0])
    region[region >= 0] = np.searchsorted(kept, region[region >= 0])
    return planes


def _members(region: Indices) -> list[Indices]:
    """Vertices of each region, in the order of their numbers."""
    order = np.argsort(region, kind="stable")
    starts = np.searchsorted(region[order], np.arange(int(region.max(initial=-1)) + 2))
    return [order[start:end] for start, end in itertools.pairwise(starts.tolist())]


def _groups(named: list[tuple[str, Indices]], even: Evened, world: Surface) -> tuple[Group, ...]:
    """Instances in vertices and faces of the scan; where a face was refined, it is that one's which has most of it."""
    owner = np.full(len(even.surface.vertices), -1, dtype=np.int64)
    for number, (_, members) in enumerate(named):
        owner[members] = number
    own = owner[even.place]
    rows = [(str(number), f"{PROVIDER}:{category}", np.flatnonzero(own == number)) for number, (category, _) in enumerate(named)]
    if len(even.parent) == len(world.faces):
        return tuple(group for group in groups_of(rows, own, world) if len(group.vertices))
    corners = owner[even.surface.faces]
    part = np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])  # two corners of three, else the first
    weights = face_areas(even.surface.vertices, even.surface.faces)
    keys, of_key = np.unique(even.parent * (len(named) + 1) + part + 1, return_inverse=True)
    share = np.bincount(of_key, weights=weights)
    order = np.lexsort((keys, share))  # the last of each face is the one with most of it
    whose = np.full(len(world.faces), -1, dtype=np.int64)
    whose[keys[order] // (len(named) + 1)] = keys[order] % (len(named) + 1) - 1
    groups = []
    for number, (source, label, _) in enumerate(rows):
        faces = np.flatnonzero(whose == number)
        if len(faces):
            groups.append(Group(source, label, np.unique(world.faces[faces]), faces))
    return tuple(groups)
