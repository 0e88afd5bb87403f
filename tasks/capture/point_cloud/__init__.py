"""Point clouds: files of points of scanners, phones and depth cameras, without surfaces between them.

PCD of the Point Cloud Library, XYZ and PTS as text, LAS and LAZ of laser scanners, E57. Points in PLY are read with bare meshes.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tasks.capture.bare_mesh import NO_FRAMES
from tasks.capture.bare_mesh.upright import Stated
from tasks.capture.files.documents import license_of, name_of
from tasks.capture.point_cloud.confined import read_confined
from tasks.capture.point_cloud.organized import grid_frame
from tasks.capture.point_cloud.pcd import read_pcd
from tasks.capture.point_cloud.ply import read_ply_points
from tasks.capture.point_cloud.points import Points
from tasks.capture.point_cloud.rows import read_point_rows
from tasks.capture.point_cloud.scene import cloud_reading
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, files_named, license_path, single_file

SUFFIXES = (".pcd", ".xyz", ".pts", ".las", ".laz", ".e57", ".ply")
"""Endings of the files that are read. PLY files are tried as meshes first, unless this format is asked for by name."""


def read_cloud(scan: Scan) -> Reading:
    """The surface of a cloud, +Z up [m], or the frame of a depth camera whose grid a PCD holds.

    Raises:
        InputError: the file is broken, larger than the budget, or of no size that any unit explains.
    """
    path = single_file(scan, SUFFIXES)
    name = name_of(path, path.parent)
    license = license_of(license_path(scan.folder, scan.premises))
    if path.suffix.lower() == ".pcd":
        pcd = read_pcd(path, name)
        grid = grid_frame(pcd, path, name)
        if grid is not None:
            notes = (*pcd.points.notes, *grid.notes)
            return Reading(surface=None, frames=(grid.frame,), license=license, degradations=notes, from_file=grid.from_file)
        points = pcd.points
    else:
        points = file_points(path, name)
    stated = Stated(points.unit_m, "z", "most of its kind")
    reading = cloud_reading(points, stated, name, license, (NO_FRAMES,))
    if points.from_file is None or reading.from_file is None:
        return reading
    return dataclasses.replace(reading, from_file=reading.from_file @ points.from_file)


def file_points(path: Path, name: str) -> Points:
    """All points that a file states, in its own frame and unit."""
    kind = path.suffix.lower()
    if kind == ".pcd":
        return read_pcd(path, name).points
    if kind == ".ply":
        return read_ply_points(path, name)
    if kind in (".las", ".laz"):
        return read_confined(path, name, "las")
    if kind == ".e57":
        return read_confined(path, name, "e57")
    return read_point_rows(path, name)


POINT_CLOUD = ScanFormat(
    name="point_cloud",
    dataset="cloud",
    expected="one point cloud as .pcd, .xyz, .pts, .las, .laz, .e57 or .ply",
    recognize=lambda folder: folder.name if len(files_named(folder, SUFFIXES)) == 1 else None,
    is_recorded=lambda folder: False,
    files=lambda scan, premises: [single_file(scan, SUFFIXES)],
    read=read_cloud,
    suffixes=SUFFIXES,
    is_last_resort=True,
)
