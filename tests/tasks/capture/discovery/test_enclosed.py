"""Scans in the folder of another scan: each is a scan of its own, or is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tasks.capture.formats import find_scans, scan_files
from tasks.capture.scan import PassedOver, UnusableScan
from tests.tasks.capture.discovery.test_search import PLY, captured_room, frames, put, scannet


def tum(folder: Path) -> None:
    for name in ("rgb.txt", "depth.txt", "rgb/1.png", "depth/1.png"):
        put(folder / name)


def flat(folder: Path) -> None:
    for ending in ("color.png", "depth.png", "pose.txt"):
        put(folder / f"frame-000000.{ending}")


INNER: dict[str, tuple[Callable[[Path], None], str]] = {
    "tum": (tum, "tum_rgbd"),
    "hall": (frames, "posed_rgbd"),
    "scene0009_00": (scannet, "scannet"),
    "group/tum": (tum, "tum_rgbd"),
    "room": (lambda folder: captured_room(folder / "kitchen.json"), "roomplan"),
    "house": (lambda folder: put(folder / "region_segmentations" / "region0.ply"), "matterport3d"),
    "flat": (flat, "posed_rgbd"),
}
OUTER: dict[str, tuple[Callable[[Path], None], str]] = {"home": (frames, "posed_rgbd"), "scene0001_00": (scannet, "scannet")}


@pytest.mark.parametrize("inner", INNER)
@pytest.mark.parametrize("outer", OUTER)
def test_a_scan_in_the_folder_of_another_one_is_named(outer: str, inner: str, tmp_path: Path) -> None:
    OUTER[outer][0](tmp_path / outer)
    assert find_scans(tmp_path / outer)[1] == []
    INNER[inner][0](tmp_path / outer / inner)
    (scan,), errors = find_scans(tmp_path / outer)
    if outer == "scene0001_00" and inner in ("hall", "flat"):
        assert any(path.parent.parent.name == inner or path.parent.name == inner for path in scan_files(scan)), "they are its own frames"
        assert errors == []
        return
    assert scan.format == OUTER[outer][1]
    error = errors[-1]
    assert isinstance(error, PassedOver)
    assert str(error) == (
        f"{outer}: {inner} ({INNER[inner][1]}) is a scan in the folder of the {scan.format} scan and not read; move it next to that folder"
    )


def test_frames_next_to_the_frames_of_a_scan_are_named(tmp_path: Path) -> None:
    scannet(tmp_path / "scene0001_00")
    frames(tmp_path / "scene0001_00" / "frames")
    frames(tmp_path / "scene0001_00" / "more")
    _, (error,) = find_scans(tmp_path / "scene0001_00")
    assert "more (posed_rgbd) is a scan in the folder of the scannet scan" in str(error)


def test_a_recording_in_a_recording_of_its_kind_is_named(tmp_path: Path) -> None:
    tum(tmp_path / "walk")
    tum(tmp_path / "walk" / "second")
    (scan,), (error,) = find_scans(tmp_path / "walk")
    assert scan.scene_id == "tum_rgbd/walk"
    assert str(error).startswith("walk: second (tum_rgbd) is a scan in the folder of the tum_rgbd scan")


@pytest.mark.parametrize("inner", INNER)
def test_a_captured_room_hides_no_scan_below_it(inner: str, tmp_path: Path) -> None:
    put(tmp_path / "root" / "CapturedRoom.json", b"{}")
    INNER[inner][0](tmp_path / "root" / inner)
    scans, errors = find_scans(tmp_path / "root")
    assert errors == []
    assert sorted(scan.format for scan in scans) == sorted(["roomplan", INNER[inner][1]])


def test_other_folders_of_scan_formats_are_not_named(tmp_path: Path) -> None:
    place = tmp_path / "scans" / "0a5c013435"
    put(place / "scans" / "mesh_aligned_0.05.ply", PLY)
    for name in ("iphone/rgb/0.jpg", "iphone/depth/0.png", "dslr/color/0.jpg", "dslr/depth/0.png"):
        put(place / name)
    (scan,), errors = find_scans(tmp_path / "scans")
    assert (scan.format, errors) == ("scannetpp", [])


def test_a_recording_that_lies_too_deep_is_named(tmp_path: Path) -> None:
    put(tmp_path / "scans" / "attic.ply", PLY)
    tum(tmp_path / "scans" / "a" / "b" / "c" / "walk")
    (_,), (error,) = find_scans(tmp_path / "scans")
    assert isinstance(error, UnusableScan)
    assert "a/b/c: folder: lies more than 2 folders deep and is not searched (walk (tum_rgbd))" in str(error)
    assert all(isinstance(line, PassedOver) for line in find_scans(tmp_path / "scans", "bare_mesh")[1])
