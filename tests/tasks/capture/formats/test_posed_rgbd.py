"""Posed frames whose intrinsics lie one folder above, as where several walks were recorded with one camera."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from flows.run.fingerprints import FileHashes
from flows.scans.listing import ScanFile, files_of, listed_folder
from flows.scans.mirror import _needed
from schemas.errors import InputError
from tasks.capture.formats import find_scans, left_out, scan_files
from tasks.capture.wholeness import find_gap
from tests.capture_scans import box_room, write_posed_rgbd
from tests.tasks.capture.formats.written import assert_same_frames, only_scan, read


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A scan of two frames with its intrinsics, in a folder of its own."""
    room = box_room(cameras=2)
    small = [dataclasses.replace(c, width=40, height=30, fx=c.fx / 4, fy=c.fy / 4, cx=19.5, cy=14.5) for c in room.cameras]
    return write_posed_rgbd(tmp_path / "scans" / "office" / "seq-01", dataclasses.replace(room, cameras=tuple(small)))


def test_intrinsics_above_are_those_beside_the_frames(walk: Path) -> None:
    """The scan says the same, and has the same content, whether they lie in its folder or above it."""
    before, hashes = read(walk), FileHashes(walk.parents[2] / "hashes.json")
    content = hashes.tree(walk, scan_files(only_scan(walk)))
    (walk / "intrinsics.json").rename(walk.parent / "intrinsics.json")
    assert_same_frames(read(walk).frames, before.frames)
    scan = only_scan(walk.parents[1])
    assert walk.parent / "intrinsics.json" in scan_files(scan)
    assert hashes.tree(walk, scan_files(scan)) == content
    assert find_gap(scan) is None


def test_a_watch_sees_a_change_above(walk: Path) -> None:
    (walk / "intrinsics.json").rename(walk.parent / "intrinsics.json")
    before = files_of(only_scan(walk))
    (walk.parent / "intrinsics.json").write_text((walk.parent / "intrinsics.json").read_text() + "\n")
    assert {file.path for file in set(files_of(only_scan(walk))) - set(before)} == {"../intrinsics.json"}


def test_a_store_gives_them_to_every_scan(walk: Path) -> None:
    (walk / "intrinsics.json").rename(walk.parent / "intrinsics.json")
    root = walk.parents[1]
    files = [ScanFile(path.relative_to(root).as_posix(), 1, 1) for path in sorted(root.rglob("*.*")) if path.is_file()]
    (scan,), errors = find_scans(listed_folder("scans", files))
    assert errors == []
    assert {below for _, below in _needed(scan)} == {path.relative_to(walk).as_posix() for path in walk.rglob("*.*")} | {"intrinsics.json"}


def test_a_link_above_that_leaves_is_left_out_and_named(walk: Path, tmp_path: Path) -> None:
    (walk / "intrinsics.json").rename(tmp_path / "intrinsics.json")
    (walk.parent / "intrinsics.json").symlink_to(tmp_path / "intrinsics.json")
    scan = only_scan(walk.parents[1])
    assert left_out(scan) == "intrinsics.json: a link that leads out of the folder of scans, left out"
    with pytest.raises(InputError, match="intrinsics: the scan states none"):
        read(walk)
