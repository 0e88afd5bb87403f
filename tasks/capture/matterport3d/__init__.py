"""Matterport3D: a region of a house, its mesh, the segments of its faces, and the labels of its instances.

Written from the public description of the data set. Each region is a scan of its own: `<house>_region<number>`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.aggregation import face_groups
from tasks.capture.files.documents import integers, license_of, name_of, read_json
from tasks.capture.files.ply import read_ply
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, license_path, own_file

PLACE = "region_segmentations"
"""Folder of a house that has its regions."""

_REGION = re.compile(r"region(\d{1,6})\.ply", re.ASCII)

SEGMENTS, ANNOTATION = ".fsegs.json", ".semseg.json"


def read_matterport(scan: Scan) -> Reading:
    """The mesh of a region and its instances; without an annotation, they are found in its geometry.

    Raises:
        InputError: a file is missing or broken, or segments and mesh do not fit together.
    """
    folder, mesh = scan.folder, own_file(scan, scan.path.name)
    ply = read_ply(mesh, name_of(mesh, folder))
    surface = ply.surface
    notes = [*ply.notes, "no frames are read from this format: no views, no masks"]
    groups = None
    by_name = {path.name: path for path in _files(scan, scan.premises)}
    segments, annotation = (by_name.get(f"{mesh.stem}{ending}") for ending in (SEGMENTS, ANNOTATION))
    if annotation is None:
        notes.append(f"no {mesh.stem}{ANNOTATION} beside the mesh: instances found in its geometry")
    elif segments is None:
        raise InputError(name_of(folder / f"{mesh.stem}{SEGMENTS}", folder), "file", "is missing", "copy the segments beside the mesh")
    else:
        segmented, annotated = name_of(segments, folder), name_of(annotation, folder)
        of_face = integers(read_json(segments, segmented).get("segIndices"), segmented, "segIndices", minimum=-(2**62))
        if len(of_face) != len(surface.faces):
            problem = f"has {len(of_face)} values, the mesh {mesh.name} has {len(surface.faces)} faces"
            raise InputError(segmented, "segIndices", problem, "use segments and mesh of one and the same region")
        groups, more = face_groups(read_json(annotation, annotated), annotated, of_face, segmented, surface)
        notes += more
    return Reading(surface=surface, groups=groups, license=license_of(license_path(folder, scan.premises)), degradations=tuple(notes))


def _within(folder: Path) -> Sequence[tuple[Path, str]]:
    """Regions of a house, in its folder `region_segmentations`, which may be given itself, or in another one that has their files."""
    return [*_regions(folder), *_regions(folder / PLACE)]


def _regions(folder: Path) -> list[tuple[Path, str]]:
    if not folder.is_dir():
        return []
    files = {path.name: path for path in folder.iterdir() if not path.is_dir()}
    regions = {name for name in files if (match := _REGION.fullmatch(name)) and f"region{match[1]}{ANNOTATION}" in files}
    if folder.name == PLACE:
        regions |= {name for name in files if _REGION.fullmatch(name)}
    house = folder.parent.name if folder.name == PLACE and folder.parent.name else folder.name
    return [(files[name], f"{house}_{name.removesuffix('.ply')}") for name in sorted(regions)]


def _files(scan: Scan, premises: Premises) -> list[Path]:
    own = [scan.folder / scan.path.name, *(scan.folder / f"{scan.path.stem}{ending}" for ending in (SEGMENTS, ANNOTATION))]
    return [path for path in own if path.is_file() and premises.admits(path)]


MATTERPORT3D = ScanFormat(
    name="matterport3d",
    dataset="matterport3d",
    expected=f"{PLACE}/region0.ply with region0{SEGMENTS} and region0{ANNOTATION}",
    recognize=lambda folder: None,
    is_recorded=lambda folder: bool(_within(folder)),
    files=_files,
    read=read_matterport,
    signs=("region[0-9]*.ply", f"region[0-9]*{SEGMENTS}", f"region[0-9]*{ANNOTATION}"),
    within=_within,
)
