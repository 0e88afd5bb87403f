"""Bare meshes: what scanning apps and collections of scans export, without a word on what is in it.

GLB (Polycam, Scaniverse, HM3D), OBJ with its materials and textures (Polycam, Matterport), PLY with colors of vertices (Scaniverse,
Replica, ScanNet's own), and USDZ (Polycam, Scaniverse).
"""

from __future__ import annotations

from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.bare_mesh.upright import Y_UP, Stated, bare_reading
from tasks.capture.files.documents import license_of, name_of, read_bytes
from tasks.capture.files.ply import read_ply
from tasks.capture.files.survey import MAX_SURVEY_OFFSET
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, files_named, license_path, single_file
from tasks.ingestion import models
from tasks.ingestion.materials import material_files

SUFFIXES = (".obj", ".ply", ".usdz", ".glb")
"""Endings of the files that are read. GLBs are tried as scenes of named objects first, unless this format is asked for by name."""

NO_FRAMES = "no frames in the scan: no views, no masks"


def read_mesh(scan: Scan) -> Reading:
    """The triangles of a mesh with their textures, +Z up [m]; its instances are left to be found in the geometry.

    Raises:
        InputError: the file is broken, larger than the budget, without triangles, or of no size that any unit explains.
    """
    from tasks.capture.point_cloud.ply import is_cloud, read_ply_points  # which builds on this package
    from tasks.capture.point_cloud.scene import cloud_reading
    from tasks.capture.roomplan.package import package_reading
    from tasks.library.obj import OBJ  # which read what this package reads, and so import it
    from tasks.library.usd import read_room

    path = single_file(scan, SUFFIXES)
    name, root = name_of(path, path.parent), path.parent
    license = license_of(license_path(scan.folder, scan.premises))
    kind = path.suffix.lower()
    if kind == ".ply":
        stated = Stated(None, "z", "most of its kind")
        if is_cloud(read_bytes(path, name, BUDGET.scene_bytes, b"ply"), name):
            return cloud_reading(read_ply_points(path, name), stated, name, license, (NO_FRAMES,))
        ply = read_ply(path, name, is_in_metres=False)
        return bare_reading([ply.surface.to_trimesh()], stated, (NO_FRAMES, *ply.notes), license, name)
    try:
        if kind == ".glb":
            parts, notes = models.read_model(path, root, is_z_up=False, limit=BUDGET.scene_bytes, max_offset=MAX_SURVEY_OFFSET)
            return bare_reading(parts, Y_UP, (NO_FRAMES, *notes), license, name)
        if kind == ".usdz":
            room = read_room(path, root)
            if room.elements:
                return package_reading(room, license, name, room.model.notes)
        model = OBJ.read(path, root) if kind == ".obj" else room.model
    except InputError as error:
        raise InputError(name, error.field, error.problem, error.remedy) from error
    stated = Stated(model.unit_m, model.up or "y", "its file" if model.up else "most of its kind")
    return bare_reading(model.parts, stated, (NO_FRAMES, *model.notes), license, name)


def _recognize(folder: Path) -> str | None:
    return folder.name if len(files_named(folder, SUFFIXES)) == 1 else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    path = single_file(scan, SUFFIXES)
    return [path, *(file for file in material_files(path, path.parent) if premises.admits(file))]


BARE_MESH = ScanFormat(
    name="bare_mesh",
    dataset="mesh",
    expected="one mesh as .obj, .ply, .usdz or .glb",
    recognize=_recognize,
    is_recorded=lambda folder: False,
    files=_files,
    read=read_mesh,
    suffixes=SUFFIXES,
    is_last_resort=True,
)
