"""Matterport3D: regions of a house, each a scan of its own, whose faces are labelled."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import find_scans, room_of, scan_files
from tasks.capture.reading import groups_of_faces
from tasks.capture.wholeness import find_gap
from tasks.geometry.meshes import Surface
from tests.tasks.capture.formats.written import assert_same_instances, only_scan, read, sample, write_matterport3d


def write_sample(folder: Path) -> None:
    """A region with a chair."""
    write_matterport3d(folder, sample())


def test_instances_are_those_of_the_native_format(tmp_path: Path) -> None:
    write_sample(tmp_path / "17DRP5sb8fy")
    assert_same_instances(read(tmp_path), sample())
    scan = only_scan(tmp_path)
    assert (scan.scene_id, room_of(scan)) == ("matterport3d/17DRP5sb8fy_region0",) * 2
    assert only_scan(scan.path) == scan, "a region can be named by its mesh"
    assert {only_scan(scan.path.parents[k]) for k in (0, 1)} == {scan}
    place = tmp_path / "deeper" / "scans"
    write_sample(place / "17DRP5sb8fy")
    assert only_scan(tmp_path / "deeper").scan == scan.scan, "as deep as other scans are looked for"
    assert find_gap(scan) is None


def test_every_region_is_a_scan_of_its_own_files(tmp_path: Path) -> None:
    write_sample(tmp_path / "house")
    place = tmp_path / "house" / "region_segmentations"
    for ending in (".ply", ".fsegs.json", ".semseg.json"):
        shutil.copy(place / f"region0{ending}", place / f"region12{ending}")
    shutil.copy(place / "region0.ply", place / "region3.ply")
    scans, errors = find_scans(tmp_path)
    assert errors == []
    assert [scan.scan for scan in scans] == ["house_region0", "house_region12", "house_region3"]
    assert [path.name for path in scan_files(scans[1])] == ["region12.fsegs.json", "region12.ply", "region12.semseg.json"]
    gap = find_gap(scans[2])
    assert gap is not None
    assert gap.is_readable, "its annotation may be meant to be missing"


def test_a_vertex_is_of_the_instance_that_most_of_its_faces_are_of() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0]], dtype=float)
    surface = Surface(corners, np.array([[0, 1, 2], [1, 3, 2], [1, 4, 3]]), np.zeros((5, 3), np.uint8))
    groups = groups_of_faces([("a", "x"), ("b", "y"), ("c", "z")], np.array([0, 0, 1]), surface)
    assert [(g.source_id, g.vertices.tolist(), g.faces.tolist()) for g in groups] == [("a", [0, 1, 2, 3], [0, 1]), ("b", [4], [2])]


def test_segments_of_another_mesh_are_refused(tmp_path: Path) -> None:
    write_sample(tmp_path / "house")
    path = tmp_path / "house" / "region_segmentations" / "region0.fsegs.json"
    path.write_text(json.dumps({"segIndices": [1, 2, 3]}))
    with pytest.raises(InputError, match=r"^region_segmentations/region0.fsegs.json: segIndices: has 3 values, the mesh .* faces"):
        read(tmp_path)
