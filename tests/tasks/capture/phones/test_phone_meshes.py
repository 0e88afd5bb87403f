"""LiDAR meshes of Scaniverse, Polycam and 3D Scanner App: up, scale and colors in each kind of file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tasks.capture import CaptureConfig, run
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.labels import label_map
from tasks.capture.leveling import read_with_meanings
from tasks.capture.reading import Reading
from tasks.capture.scan import PassedOver, Scan
from tasks.geometry.meshes import material_of
from tasks.stage import Context
from tests.tasks.capture.phones.phone_meshes import APPS, KINDS, phone_room

ROOM = phone_room()

CASES = [(app, kind) for app in APPS for kind in KINDS] + [("Polycam", "raw"), ("3D Scanner App", "all")]


def written(folder: Path, app: str, kind: str) -> Scan:
    """The one scan of an export; other lines only pass files over."""
    APPS[app](folder, kind, ROOM)
    (scan,), errors = find_scans(folder)
    assert all(isinstance(error, PassedOver) for error in errors)
    return scan


def reading_of(scan: Scan) -> Reading:
    return read_with_meanings(scan, label_map(None))[0]


def check(reading: Reading, kind: str) -> None:
    """The mesh lies where the phone saw it, +Z up in meters, with its colors, and names no instances."""
    assert reading.groups is None
    assert reading.surface is not None
    # glTF and OBJ have +Y up: turned back, places are those of the phone's frame.
    distance, nearest = cKDTree(ROOM.vertices).query(reading.surface.vertices, k=4)
    assert distance[:, 0].max() < 1e-4
    # Where surfaces meet, a place has the color of any of them.
    away = np.abs(reading.surface.colors[:, None].astype(int) - ROOM.colors[nearest].astype(int)).max(axis=2)
    assert np.where(distance < 1e-4, away, 255).min(axis=1).max() <= (0 if kind == "ply" else 4)
    if kind != "ply":
        assert reading.parts
        assert all(material_of(part)[0] is not None for part in reading.parts)


@pytest.mark.parametrize(("app", "kind"), [case for case in CASES if case[1] != "usdz"])
def test_an_export_is_read_upright_in_meters_with_its_colors(app: str, kind: str, tmp_path: Path) -> None:
    scan = written(tmp_path / "phone", app, kind)
    check(reading_of(scan), kind)
    endings = {path.suffix for path in scan_files(scan)}
    assert endings == ({".obj", ".mtl", ".jpg"} if kind in ("obj", "all") else {".glb"} if kind in ("glb", "raw") else {f".{kind}"})


@pytest.mark.whole
@pytest.mark.parametrize("app", APPS)
def test_a_package_is_read_upright_in_meters_with_its_colors(app: str, tmp_path: Path) -> None:
    check(reading_of(written(tmp_path / "phone", app, "usdz")), "usdz")


def test_key_frames_next_to_a_mesh_are_named_and_pass(tmp_path: Path) -> None:
    APPS["Polycam"](tmp_path / "phone", "raw", ROOM)
    (scan,), (line,) = find_scans(tmp_path / "phone")
    assert (scan.scene_id, isinstance(line, PassedOver)) == ("glb/5_4_2026-poly", True)
    assert "has key frames of Polycam, which are not read" in str(line)
    scans, (line,) = find_scans(tmp_path / "phone" / "5_4_2026-poly" / "keyframes")
    assert scans == []
    assert not isinstance(line, PassedOver)


@pytest.mark.whole
@pytest.mark.parametrize(("app", "kind"), [("Scaniverse", "glb"), ("Polycam", "ply"), ("3D Scanner App", "obj")])
def test_an_export_becomes_a_scene_whatever_its_heading(app: str, kind: str, tmp_path: Path) -> None:
    """Floor and walls level the scan and turn it to its axes."""
    scan = written(tmp_path / "phone", app, kind)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
    (shell,) = outcome.rows["shells"]
    assert shell.floor_area_m2 == pytest.approx(12.0, rel=0.05)
    assert shell.height_m == pytest.approx(2.5, abs=0.1)
    assert sum(row.category == "wall" for row in outcome.rows["instances"]) == 4
    assert sum(not row.is_structure for row in outcome.rows["instances"]) >= 2
