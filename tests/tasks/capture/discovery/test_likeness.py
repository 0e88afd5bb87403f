"""What people are told whose folder is no scan that is known."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.families.scan_formats import SCAN_FORMATS
from tasks.capture.formats import FORMATS, find_scans
from tests.fuzzing import seeds
from tests.fuzzing.cases import write_case
from tests.tasks.capture.formats.written import put


def told(folder: Path) -> str:
    """The one line that is said of a folder."""
    scans, errors = find_scans(folder)
    assert scans == []
    (error,) = errors
    return str(error)


CASES: dict[str, tuple[Callable[[Path], None], str]] = {
    "scannetpp": (lambda folder: (folder / "scans" / "mesh_aligned_0.05.ply").unlink(), "scans/mesh_aligned_0.05.ply"),
    "replica_v1": (lambda folder: (folder / "habitat" / "mesh_semantic.ply").unlink(), "habitat/mesh_semantic.ply"),
    "tum_rgbd": (lambda folder: (folder / "depth.txt").unlink(), "depth.txt"),
    "stray_scanner": (lambda folder: (folder / "camera_matrix.csv").rename(folder.parent / "c"), "camera_matrix.csv"),
    "record3d": (lambda folder: (folder / "metadata").unlink(), "metadata"),
}
"""What is taken away of a sound scan of a format, and what it is told to lack."""


@pytest.mark.parametrize("format", CASES)
def test_a_scan_that_lacks_a_file_is_told_which(format: str, tmp_path: Path) -> None:
    """Where what is left could be posed frames, it is read as these."""
    folder = tmp_path / "home"
    write_case(seeds.capture(format)[0], folder)
    CASES[format][0](folder)
    for name in ("rgb", "depth"):
        if format == "stray_scanner":
            shutil.rmtree(folder / name)
    if format == "tum_rgbd":
        shutil.rmtree(folder / "depth")
    line = told(folder)
    assert line.startswith("home: folder: holds no scan of a known format (")
    assert f"; looks like {format} without {CASES[format][1]}" in line
    expected = next(one.expected for one in FORMATS if one.name == format)
    assert line.endswith(f"; {format} is {expected}")


@pytest.mark.parametrize(
    ("file", "advice"),
    [
        ("walk.bag", "write folders color and depth (16-bit PNG in millimetres), pose.txt and intrinsics.json"),
        ("house.fbx", "export it as GLB"),
        ("sequence.zip", "unpack it"),
    ],
)
def test_files_of_other_kinds_are_told_how_to_be_converted(file: str, advice: str, tmp_path: Path) -> None:
    assert advice in told(put(tmp_path / "home", {file: b"x"}))


def test_a_folder_like_nothing_is_told_where_layouts_are(tmp_path: Path) -> None:
    line = told(put(tmp_path / "home", {"notes.txt": b"x"}))
    layout = "folders color and depth with intrinsics, and with poses unless they are to be found"
    assert line.endswith(f"; expected one of the layouts of docs/formats.md, as {layout}")


@pytest.mark.parametrize("format", SCAN_FORMATS)
def test_a_whole_scan_of_a_format_has_its_signs(format: str, tmp_path: Path) -> None:
    """Signs that no scan of a format has would mislead: without its other files, each format is still told for what it is."""
    from tasks.capture.likeness import likeness

    member = next(one for one in FORMATS if one.name == format)
    write_case(seeds.capture(format)[0], tmp_path / "home")
    like = likeness(tmp_path / "home", (member,))
    assert like is None or len(like[0].partition(" without ")[2].split(", ")) < len(member.signs)
