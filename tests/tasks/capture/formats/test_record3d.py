"""Record3D: frames of an unzipped recording whose depth maps were unpacked."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import find_scans, format_of, scan_files
from tasks.capture.record3d import read_record3d
from tasks.capture.record3d.archive import unpack
from tasks.capture.scan import Scan
from tasks.capture.wholeness import find_gap
from tests.tasks.capture.formats.phones import pack_record3d, write_record3d, zip_record3d
from tests.tasks.capture.formats.written import assert_same_frames, only_scan, read, sample


def write_sample(folder: Path) -> None:
    """Three frames of a room with a chair."""
    write_record3d(folder, sample().frames)


def test_frames_are_those_of_the_native_format(tmp_path: Path) -> None:
    write_sample(tmp_path / "2024-05-01")
    assert_same_frames(read(tmp_path).frames, sample().frames, is_lossy=True)
    assert find_gap(only_scan(tmp_path)) is None


def test_what_the_sensor_has_no_confidence_in_is_no_reading(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "rgbd" / "0.conf"
    path.write_bytes(bytes(len(path.read_bytes())))
    frame = read(tmp_path).frames[0]
    assert frame.depth is not None
    assert not frame.depth().any()


def test_packed_depth_without_its_decoder_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_sample(tmp_path / "a")
    (tmp_path / "a" / "rgbd" / "0.depth").write_bytes(b"bvx2" + bytes(40))
    monkeypatch.setattr("tasks.capture.record3d.is_installed", lambda package: False)
    expected = r"^a/rgbd/0.depth: content: is decoded by lzfse, which is not installed; pip install .*, or .* lzfse -decode "
    with pytest.raises(InputError, match=expected):
        read(tmp_path)


def test_an_archive_without_its_decoder_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "room.r3d").write_bytes(b"PK")
    monkeypatch.setattr("tasks.capture.record3d.is_installed", lambda package: False)
    with pytest.raises(InputError, match=r"^room.r3d: depth: is decoded by lzfse, .* rename it to .zip and unzip it"):
        read(tmp_path)


@pytest.mark.whole
def test_packed_depth_is_decoded(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    pack_record3d(tmp_path / "a")
    assert_same_frames(read(tmp_path).frames, sample().frames, is_lossy=True)


@pytest.mark.whole
@pytest.mark.parametrize("below", ["", "recording/"])
def test_an_archive_is_a_scan(below: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "made")
    pack_record3d(tmp_path / "made")
    (tmp_path / "scans").mkdir()
    for name in ("a", "b"):
        zip_record3d(tmp_path / "made", tmp_path / "scans" / f"{name}.r3d", below)
    scans, errors = find_scans(tmp_path / "scans")
    assert ([scan.scene_id for scan in scans], errors) == (["record3d/a", "record3d/b"], [])
    for scan in scans:
        assert_same_frames(format_of(scan).read(scan).frames, sample().frames, is_lossy=True)
        assert [path.name for path in scan_files(scan)] == [scan.path.name]
    assert [scan.scene_id for scan in find_scans(tmp_path / "scans" / "b.r3d")[0]] == ["record3d/b"]


@pytest.mark.whole
@pytest.mark.parametrize("name", ["facts.json.r3d", "files.r3d", "rgbd.r3d"])
def test_an_archive_may_have_any_name(name: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "made")
    (tmp_path / "scans").mkdir()
    zip_record3d(tmp_path / "made", tmp_path / "scans" / name)
    assert_same_frames(read(tmp_path / "scans").frames, sample().frames, is_lossy=True)


def test_an_archive_of_dots_is_read_from_its_own_folder(tmp_path: Path) -> None:
    path = tmp_path / "scans" / "...r3d"
    write_sample(tmp_path / "made")
    path.parent.mkdir()
    zip_record3d(tmp_path / "made", path)
    scan = Scan("record3d", path, "record3d", "dots")
    assert_same_frames(read_record3d(scan).frames, sample().frames, is_lossy=True)


def test_the_directory_of_an_archive_is_read_by_the_child_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory of many small entries takes more memory than the file."""
    write_sample(tmp_path / "made")
    zip_record3d(tmp_path / "made", tmp_path / "a.r3d")

    def refused(*arguments: object) -> None:
        raise AssertionError("the archive is opened in this process")

    monkeypatch.setattr("zipfile.ZipFile", refused)
    scan = Scan("record3d", tmp_path / "a.r3d", "record3d", "a")
    assert_same_frames(read_record3d(scan).frames, sample().frames, is_lossy=True)


def test_of_many_frames_some_are_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are counted, whatever their numbers are."""
    monkeypatch.setattr("tasks.capture.files.unpacked.MAX_FRAMES", 2)
    with zipfile.ZipFile(tmp_path / "a.r3d", "w") as archive:
        for number in range(0, 30, 6):
            archive.writestr(f"rgbd/{number}.jpg", b"image")
            archive.writestr(f"rgbd/{number}.depth", b"depth")
    assert unpack(tmp_path / "a.r3d", tmp_path / "out") == {"frames": 5, "step": 3}
    files = sorted(path.name for path in (tmp_path / "out" / "rgbd").iterdir())
    assert files == ["0.depth", "0.jpg", "18.depth", "18.jpg"]


def test_an_archive_of_too_many_files_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tasks.capture.record3d.archive.MAX_ENTRIES", 3)
    write_sample(tmp_path / "made")
    zip_record3d(tmp_path / "made", tmp_path / "a.r3d")
    with pytest.raises(InputError, match=r"has 10 files \(limit 3\)"):
        unpack(tmp_path / "a.r3d", tmp_path / "out")


def test_a_mesh_next_to_a_recording_is_a_scan_of_its_own(tmp_path: Path) -> None:
    """A package next to an archive, and a mesh in the folder of a recording, hide neither."""
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "a.r3d").write_bytes(b"PK")
    (tmp_path / "shared" / "other.usdz").write_bytes(b"PK")
    assert [scan.scene_id for scan in find_scans(tmp_path / "shared")[0]] == ["mesh/other", "record3d/a"]
    write_sample(tmp_path / "unzipped" / "b")
    (tmp_path / "unzipped" / "b" / "export.usdz").write_bytes(b"PK")
    scans, errors = find_scans(tmp_path / "unzipped")
    assert [scan.scene_id for scan in scans] == ["record3d/b"]
    assert "export.usdz is not part of the record3d scan" in str(errors[0])


@pytest.mark.whole
@pytest.mark.parametrize("case", ["empty", "text", "cut", "without metadata", "bad depth"])
def test_a_broken_archive_is_refused(case: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "made")
    if case == "without metadata":
        (tmp_path / "made" / "metadata").unlink()
    if case == "bad depth":
        (tmp_path / "made" / "rgbd" / "0.depth").write_bytes(b"bvx2" + bytes(100))
    (tmp_path / "scans").mkdir()
    path = tmp_path / "scans" / "a.r3d"
    zip_record3d(tmp_path / "made", path)
    data = path.read_bytes()
    path.write_bytes({"empty": b"", "text": b"no archive", "cut": data[: len(data) // 2]}.get(case, data))
    with pytest.raises(InputError, match=r"^a"):
        read(tmp_path / "scans")


def test_each_frame_may_have_a_lens_of_its_own(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "metadata"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"perFrameIntrinsicCoeffs": [[30 + k, 31, 19, 15] for k in range(3)]}))
    assert [frame.intrinsics for frame in read(tmp_path).frames] == [(30 + k, 31, 19, 15) for k in range(3)]
    fx, fy, cx, cy = sample().frames[0].intrinsics
    video = {"w": document["w"] * 2, "h": document["h"] * 2, "K": [2 * fx, 0, 0, 0, 2 * fy, 0, 2 * cx + 0.5, 2 * cy + 0.5, 1]}
    path.write_text(json.dumps(document | video))
    np.testing.assert_allclose(read(tmp_path).frames[0].intrinsics, (fx, fy, cx, cy))
    path.write_text(json.dumps(document | {"w": document["w"] * 2, "h": document["h"] * 2}))
    with pytest.raises(InputError, match=r"^a/metadata: intrinsics: its principal point .* about 20 x 15 pixels, and the color images"):
        read(tmp_path)


@pytest.mark.parametrize(("key", "value"), [("K", [1.0]), ("dw", 0), ("dh", "many"), ("poses", 7)])
def test_metadata_that_is_none_is_refused(key: str, value: object, tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "metadata"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match=rf"^a/metadata: {key}"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("row", "problem"),
    [([1, 2], "must be 7 numbers"), (None, "must be 7 numbers"), ([0.0] * 7, "has a quaternion of length 0"), (["x"] * 7, "must be 7")],
)
def test_a_row_that_is_no_pose_costs_its_frame(row: object, problem: str, tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "metadata"
    document = json.loads(path.read_text())
    whole = read(tmp_path)
    document["poses"][1] = row
    path.write_text(json.dumps(document))
    reading = read(tmp_path)
    assert [frame.pose is None for frame in reading.frames] == [False, True, False]
    np.testing.assert_array_equal(reading.frames[2].pose, whole.frames[2].pose)
    (note,) = (line for line in reading.degradations if "poses[1]" in line)
    assert note.startswith(f"a/metadata: poses[1]: {problem}")
    assert note.endswith("1 frame of 3 without a pose")
