"""A scan made of points: their surface, in meters with +Z up, with the objects that the file names."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.bare_mesh.upright import Stated, bare_reading, unit_of
from tasks.capture.files.ply import check_vertices
from tasks.capture.files.ply_elements import GRAY
from tasks.capture.files.survey import survey_shift
from tasks.capture.point_cloud.normals import oriented_normals
from tasks.capture.point_cloud.points import MIN_POINTS, LabelledPoints, Points
from tasks.capture.point_cloud.surface import MAX_BLOCKS, REACH_VOXELS, blocks_of, surface_of_points
from tasks.capture.point_cloud.thinning import extents_of, first_in_voxels, lonely_points, spacing_of, thinned
from tasks.capture.reading import Group, Reading, groups_of
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import transform_points

Array = NDArray[np.float64]

MIN_VOXEL_M, MAX_VOXEL_M = 0.02, 0.08
"""Sides of voxels: that of fused frames, and the largest one whose faces still count as dense."""

MIN_VOXELS_ALONG = 100
"""Voxels along the longest side at least: a table top is resolved better than a room."""

VOXEL_SPACINGS = 1.5
"""Side of a voxel in spacings of the points: then each cell that a surface crosses has points in its reach."""

MAX_VOXELS = 600_000
"""Voxels with points: about as many vertices has the surface. A room of 240 m2 surface has them at 2 cm."""

MAX_SPACING_M = 2 * MAX_VOXEL_M
"""Spacing above which no cell of the largest voxels has points at all of its corners."""

MAX_LISTED_IDS = 100
"""Objects that a note lists."""

POINTS_PER_VOXEL = 2.0
"""Thinned points along a voxel's side: more do not change its mean."""


def cloud_reading(points: Points, stated: Stated, name: str, license: str | None, notes: Sequence[str]) -> Reading:
    """Reading of a cloud. stated: unit and axes by the file or its kind.

    Raises:
        InputError: too few points, or of no size that any unit explains.
    """
    lines = [*notes, *points.notes]
    points, left_out = _finite(points, name)
    lines += left_out
    if len(points.positions) < MIN_POINTS:
        raise InputError(name, "points", f"are {len(points.positions)}, a surface needs {MIN_POINTS}", "is it a scan of a room?")
    # Found once, before the surface: its voxels and its size then have the same unit.
    extents = extents_of(points.positions)
    mesh_unit = unit_of(extents if stated.up == "z" else extents[[0, 2, 1]], stated.unit_m)
    unit = mesh_unit.meters
    low = points.positions.min(axis=0)
    check_vertices((points.positions - low) * unit, name)
    survey_shift(points.positions * unit, name)  # refuses coordinates that were stored too coarsely
    points = dataclasses.replace(points, positions=points.positions - low, sensors=None if points.sensors is None else points.sensors - low)
    cloud = _surface(points, unit, name)
    surface = dataclasses.replace(cloud.surface, vertices=cloud.surface.vertices + low)
    if points.colors is None:
        lines.append(f"{name}: has no colors: drawn in gray")
    lines += [f"{name}: {note}" for note in cloud.notes]
    reading = bare_reading([surface.to_trimesh()], stated, lines, license, name, mesh_unit)
    if cloud.points.objects is None or reading.surface is None:
        return reading
    # The reading welds, turns and moves vertices: each gets the object of the place that it came from.
    assert reading.from_file is not None
    places = transform_points(reading.surface.vertices, np.linalg.inv(reading.from_file)) - low
    groups = groups_of_points(cloud.points.positions, cloud.points.objects, places, reading.surface, name)
    return dataclasses.replace(reading, groups=groups, degradations=(*reading.degradations, *_lost(cloud.points.objects, groups, name)))


DENSER = "export them more densely, a point every 2 cm"


@dataclasses.dataclass(frozen=True)
class CloudSurface:
    """A surface, the thinned points that it lies on, in the same frame and unit, and notes."""

    surface: Surface
    points: Points
    notes: tuple[str, ...]


def _surface(points: Points, unit: float, name: str) -> CloudSurface:
    """The surface of points near the origin. unit: meters per unit."""
    from scipy.spatial import cKDTree

    # Thin before the spacing is measured: scanners leave a hundred points in a voxel near them, and none farther away.
    finest = min(MIN_VOXEL_M / unit, float(extents_of(points.positions).max()) / MIN_VOXELS_ALONG)
    if not finest > 0.0:
        raise InputError(name, "points", "lie on one place", "export the points of a room")
    cloud = thinned(points, finest / POINTS_PER_VOXEL)
    spacing = spacing_of(cloud.positions)
    too_far = InputError(name, "points", f"lie {spacing * unit:.3g} m apart, too far for a surface", DENSER)
    if spacing * unit > MAX_SPACING_M:
        raise too_far
    voxel = float(np.clip(VOXEL_SPACINGS * spacing, finest, MAX_VOXEL_M / unit))
    while (filled := len(first_in_voxels(cloud.positions, voxel))) > MAX_VOXELS and voxel < MAX_VOXEL_M / unit:
        voxel = min(voxel * 1.25, MAX_VOXEL_M / unit)
    # Points without others in the reach of both make no piece of a surface, only blocks of the grid.
    distance = 2 * REACH_VOXELS * voxel
    is_lonely = lonely_points(cloud.positions, distance)
    lonely = int(is_lonely.sum())
    cloud = cloud.at(~is_lonely)
    if len(cloud.positions) < MIN_POINTS:
        raise too_far
    places = blocks_of(cloud.positions, voxel)
    if filled - lonely > MAX_VOXELS or len(places) > MAX_BLOCKS:
        problem = f"are spread over {filled} voxels of {100 * voxel * unit:.3g} cm and {len(places)} blocks of them"
        limits = f"more than {MAX_VOXELS} or {MAX_BLOCKS}"
        raise InputError(name, "points", f"{problem}, {limits}", "export each room or storey as a file, without stray points")
    if voxel / POINTS_PER_VOXEL > spacing:
        cloud = thinned(cloud, voxel / POINTS_PER_VOXEL)
    tree = cKDTree(cloud.positions)
    normals = oriented_normals(cloud, tree, voxel, unit)
    colors = cloud.colors if cloud.colors is not None else np.full(cloud.positions.shape, GRAY, np.uint8)
    surface = surface_of_points(cloud.positions, normals.values, colors, voxel, tree, places)
    if not len(surface.faces):
        raise too_far if spacing * unit > MAX_VOXEL_M else InputError(name, "points", "show no surface", DENSER)
    notes = [
        f"a point cloud of {len(points.positions)} points: its surface is estimated, with voxels of {100 * voxel * unit:.3g} cm",
        normals.note,
    ]
    if lonely:
        notes.append(f"{lonely} points lie more than {100 * distance * unit:.3g} cm from others: left out")
    if spacing * unit > MAX_VOXEL_M / VOXEL_SPACINGS:
        notes.append(f"points lie {100 * spacing * unit:.3g} cm apart: the surface has holes")
    return CloudSurface(surface, cloud, tuple(notes))


def groups_of_points(positions: Array, objects: LabelledPoints, vertices: Array, surface: Surface, name: str) -> tuple[Group, ...]:
    """Objects of a surface by those of the nearest points; objects without a vertex are left out.

    positions: of the points, shape (n, 3). vertices: those of `surface` in the frame of the points, shape (m, 3).
    """
    from scipy.spatial import cKDTree

    owner = objects.owner[cKDTree(positions).query(vertices)[1]]
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(len(objects.named) + 1))
    named = [(*objects.named[i], np.sort(order[starts[i] : starts[i + 1]])) for i in range(len(objects.named))]
    groups = groups_of(named, owner, surface)
    return tuple(dataclasses.replace(group, origin=f"{name}: object {group.source_id}") for group in groups if len(group.vertices))


def _lost(objects: LabelledPoints, groups: Sequence[Group], name: str) -> list[str]:
    """A line on the objects without a vertex of the surface."""
    with_surface = {group.source_id for group in groups}
    ids = [id for id, _ in objects.named if id not in with_surface]
    if not ids:
        return []
    more = f" and {len(ids) - MAX_LISTED_IDS} others" if len(ids) > MAX_LISTED_IDS else ""
    return [f"{name}: {len(ids)} objects have no surface: {', '.join(ids[:MAX_LISTED_IDS])}{more}: left out"]


def _finite(points: Points, name: str) -> tuple[Points, list[str]]:
    """Points with coordinates, and a line on the others."""
    is_finite = np.all(np.isfinite(points.positions) & (np.abs(points.positions) < 1e12), axis=1, keepdims=True)[:, 0]
    missing = int((~is_finite).sum())
    if not missing:
        return points, []
    return points.at(is_finite), [f"{name}: {missing} points without coordinates: left out"]
