"""Scans that are links, or hold some: those that leave the folder of scans are left out and named, and nothing waits."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from flows.run.configuration import configure
from flows.run.fanout import coordinator
from flows.run.fingerprints import FileHashes
from flows.run.plan import make_plan
from flows.run.report import report_of
from flows.run.scene import SceneResult
from flows.scans.arrivals import look, watch_report
from flows.scans.choice import found_scans, scan_source, settled
from schemas.errors import InputError
from tasks.capture import CaptureConfig, run, scan_files
from tasks.capture.formats import find_scans, left_out
from tasks.capture.leveling import read_scan
from tasks.capture.premises import Premises
from tasks.capture.scan import Scan, license_path
from tasks.capture.wholeness import find_gap
from tasks.stage import Context, Outcome
from tests.capture_scans import box_room, well_formed, write_posed_rgbd, write_scannet
from warehouse.lake import Lake

SECRET = "the first line of somebody's file"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ScanNet scan and one of RGB-D frames, both with a license."""
    folder, room = tmp_path_factory.mktemp("made"), box_room(cameras=4)
    write_scannet(folder / "scene0001_00", room)
    write_posed_rgbd(folder / "kitchen", room)
    for scan in folder.iterdir():
        (scan / "LICENSE.txt").write_text("CC0-1.0\n")
    return folder


@pytest.fixture
def scans(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret").write_text(f"{SECRET}\n")
    return Path(shutil.copytree(made, tmp_path / "scans"))


def captured(scan: Scan) -> Outcome:
    return well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig(max_view_frames=2)))


def only(scans: Path, links_into: tuple[Path, ...] = ()) -> Scan:
    (scan,), errors = find_scans(scans, links_into=links_into)
    assert not errors
    return scan


def moved(path: Path, store: Path, relative: bool = False) -> Path:
    """Put a file or folder into a store, and a link in its place."""
    store.mkdir(exist_ok=True)
    target = store / path.name
    path.rename(target)
    path.symlink_to(os.path.relpath(target, path.parent) if relative else target)
    return target


def everything(scan: Scan) -> list[Path]:
    """All that a scan is made of by its reader."""
    return [path for path in scan.path.rglob("*") if path.is_file()]


@pytest.mark.whole
@pytest.mark.parametrize("name", ["scene0001_00", "kitchen"])
def test_a_license_that_leaves_is_left_out_and_named_everywhere(scans: Path, tmp_path: Path, name: str) -> None:
    (scans / name / "LICENSE.txt").unlink()
    (scans / name / "LICENSE.txt").symlink_to(tmp_path / "outside" / "secret")
    found, errors = find_scans(scans)
    assert not errors
    scan = next(scan for scan in found if scan.path.name == name)
    note = "LICENSE.txt: a link that leads out of the folder of scans, left out"
    assert left_out(scan) == note
    assert scan.path / "LICENSE.txt" not in scan_files(scan)
    outcome = captured(scan)
    assert outcome.rows["scenes"][0].license is None
    assert note in outcome.degradations
    assert SECRET not in repr(outcome.rows)
    assert SECRET.encode() not in b"".join(outcome.blobs.values())
    lake = Lake.open(tmp_path / "lake")
    plan = make_plan(lake, found, errors, configure())
    assert plan.left_out == (f"{scan.scene_id}: {note}",)
    assert watch_report(look(scans, lake, 0.0)).left_out == {scan.scene_id: note}
    allowed = next(s for s in find_scans(scans, links_into=[tmp_path / "outside"])[0] if s.path.name == name)
    assert left_out(allowed) == ""
    assert read_scan(allowed).license == SECRET


def test_a_link_of_one_scan_is_named_although_another_says_the_same(scans: Path, tmp_path: Path) -> None:
    for name in ("kitchen", "scene0001_00"):
        (scans / name / "LICENSE.txt").unlink(missing_ok=True)
        (scans / name / "LICENSE.txt").symlink_to(tmp_path / "outside" / "secret")
    found, errors = find_scans(scans)
    plan = make_plan(Lake.open(tmp_path / "lake"), found, errors, configure())
    assert len(plan.left_out) == 2
    here, there = sorted(plan.left_out)
    scene, _, note = here.partition(": ")
    computed = f"{scene}: capture: {note}"
    result = SceneResult(scene, ("capture",), None, None, (computed, f"{scene}: boxes: another"))
    assert report_of(plan, coordinator.RunOutcome(results=[result])).degradations == (there, *result.degradations)
    renamed = dataclasses.replace(plan, same={scene: "demo/known"})
    result = dataclasses.replace(result, scene_id="demo/known")
    assert report_of(renamed, coordinator.RunOutcome(results=[result])).degradations == (there, *result.degradations)


def said(scan: Scan) -> str:
    """What reading a scan says: its degradations, or why it could not be read."""
    try:
        return "; ".join(read_scan(scan).degradations)
    except InputError as error:
        return f"could not be read: {error}"


PARTS = {
    "scene0001_00": ["scene0001_00_vh_clean_2.ply", "scene0001_00.aggregation.json", "scene0001_00.txt",
                     "scene0001_00_vh_clean_2.0.010000.segs.json"],
    "kitchen": ["color", "depth", "pose.txt", "intrinsics.json"],
}  # fmt: skip


def parts(scan: Path) -> Iterator[Path]:
    """Each file and folder of a scan that is read, and one file of each of its folders."""
    for path in sorted(scan.iterdir()):
        yield path
        if path.is_dir():
            yield sorted(path.iterdir())[0]


@pytest.mark.parametrize("name", PARTS)
def test_whatever_leaves_is_not_opened_whichever_part_it_is(made: Path, tmp_path: Path, name: str) -> None:
    names = [path.relative_to(made / name) for path in parts(made / name)]
    assert set(PARTS[name]) < {path.as_posix() for path in names}
    for number, part in enumerate(names):
        here = tmp_path / str(number)
        scan = Path(shutil.copytree(made / name, here / "scans" / name))
        target = moved(scan / part, here / "store")
        opened = {path.resolve() for path in ([target] if target.is_file() else target.iterdir())}
        left = only(here / "scans")
        assert part.as_posix() in left_out(left)
        assert not opened & {path.resolve() for path in scan_files(left)}
        told = said(left)
        assert f"{part.as_posix()}: a link that leads out of the folder of scans, left out" in told
        assert "could not be read" not in told or "--links-into" in told
        allowed = only(here / "scans", (here / "store",))
        assert left_out(allowed) == ""
        assert [p.relative_to(scan) for p in scan_files(allowed)] == [p.relative_to(made / name) for p in scan_files(only(made / name))]


def test_a_scan_of_nothing_but_links_into_a_store_is_read_when_that_is_allowed(made: Path, scans: Path, tmp_path: Path) -> None:
    for folder in sorted(scans.iterdir()):
        for index, path in enumerate(sorted(path for path in folder.rglob("*") if path.is_file())):
            target = tmp_path / "store" / f"{index:03d}-{folder.name}"
            target.parent.mkdir(exist_ok=True)
            path.rename(target)
            path.symlink_to(os.path.relpath(target, path.parent))
    found, errors = find_scans(scans)
    assert [scan.scene_id for scan in found] == [scan.scene_id for scan in find_scans(made)[0]], "links count as names"
    assert not errors
    for scan in found:
        assert not scan_files(scan)
        with pytest.raises(InputError, match=r"out of the folder of scans, left out\); .*--links-into"):
            read_scan(scan)
        assert find_gap(scan) is not None
    allowed, _ = find_scans(scans, links_into=[tmp_path / "store"])
    for scan, original in zip(allowed, find_scans(made)[0], strict=True):
        read, expected = read_scan(scan), read_scan(original)
        assert [frame.color().tobytes() for frame in read.frames] == [frame.color().tobytes() for frame in expected.frames]
        assert (read.license, read.degradations, read.groups is None) == (expected.license, expected.degradations, expected.groups is None)


def test_the_folder_of_scans_and_a_scan_may_be_links(made: Path, tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "scene0001_00").symlink_to(made / "scene0001_00")
    (tmp_path / "other").symlink_to(tmp_path / "scans")
    scan = only(tmp_path / "other")
    assert left_out(scan) == ""
    assert read_scan(scan).license == "CC0-1.0"
    assert left_out(only(tmp_path / "other" / "scene0001_00")) == ""


def test_links_within_the_folder_of_scans_are_followed(scans: Path, tmp_path: Path) -> None:
    shared = scans / ".shared"
    shared.mkdir()
    (shared / "LICENSE.txt").write_text("MIT\n")
    (shared / "chain").symlink_to("LICENSE.txt")
    kitchen = scans / "kitchen"
    (kitchen / "LICENSE.txt").unlink()
    (kitchen / "LICENSE.txt").symlink_to("../../scans/.shared/chain")
    (kitchen / "color").rename(shared / "color")
    (kitchen / "color").symlink_to("../.shared/color")
    scan = next(scan for scan in find_scans(scans)[0] if scan.path.name == "kitchen")
    assert left_out(scan) == ""
    assert read_scan(scan).license == "MIT"
    alone = only(kitchen)
    assert left_out(alone) == "LICENSE.txt, color: links that lead out of the folder of scans, left out", "the scan itself is that folder"


def test_a_chain_of_links_counts_by_where_it_ends(scans: Path, tmp_path: Path) -> None:
    (tmp_path / "outside" / "back").symlink_to(scans / "scene0001_00" / "LICENSE.txt")
    (scans / "kitchen" / "LICENSE.txt").unlink()
    (scans / "kitchen" / "LICENSE.txt").symlink_to(tmp_path / "outside" / "back")
    (scans / "away").symlink_to(tmp_path / "outside" / "secret")
    (scans / "scene0001_00" / "LICENSE.txt").rename(scans / "license")
    (scans / "scene0001_00" / "LICENSE.txt").symlink_to("../away")
    (tmp_path / "outside" / "back").unlink()
    (tmp_path / "outside" / "back").symlink_to(scans / "license")
    found = {scan.path.name: scan for scan in find_scans(scans)[0]}
    assert left_out(found["kitchen"]) == ""
    assert left_out(found["scene0001_00"]) == "LICENSE.txt: a link that leads out of the folder of scans, left out"


def test_links_in_a_circle_end(scans: Path, tmp_path: Path) -> None:
    (scans / "loop").symlink_to(".")
    (scans / "up").symlink_to(tmp_path)
    for name in "abcdefghij":
        (scans / "kitchen" / name).symlink_to(".")
        (scans / "scene0001_00" / name).symlink_to("..")
    (scans / "kitchen" / "LICENSE.txt").unlink()
    (scans / "kitchen" / "LICENSE.txt").symlink_to("LICENSE.txt")
    (scans / "self.glb").symlink_to("self.glb")
    found, errors = find_scans(scans)
    assert [scan.scene_id for scan in found] == ["rgbd/kitchen", "scannet/scene0001_00"]
    assert [str(error).partition(";")[0] for error in errors] == ["self.glb: link: leads out of the folder of scans"]
    assert left_out(found[0]) == "LICENSE.txt: a link that leads out of the folder of scans, left out"
    listings, _ = scan_source(scans).listing()
    assert {scene: len(listing.files) for scene, listing in listings.items()} == {
        "rgbd/kitchen": len(everything(found[0])), "scannet/scene0001_00": len(everything(found[1]))
    }  # fmt: skip


def test_a_second_path_to_a_scan_is_no_second_scan(scans: Path) -> None:
    (scans / "alias").symlink_to("kitchen")
    (scans / "latest").symlink_to("scene0001_00")
    found, errors = find_scans(scans)
    assert [(scan.scene_id, scan.path.name) for scan in found] == [("rgbd/kitchen", "kitchen"), ("scannet/scene0001_00", "scene0001_00")]
    assert not errors


def test_a_folder_of_scans_elsewhere_is_named_and_can_be_allowed(made: Path, tmp_path: Path) -> None:
    scans = tmp_path / "scans"
    scans.mkdir()
    (scans / "archive").symlink_to(made)
    (scans / "house.glb").symlink_to(made / "kitchen" / "intrinsics.json")
    found, errors = find_scans(scans)
    assert not found
    assert sorted(map(str, errors)) == [
        f"{name}: link: leads out of the folder of scans; copy the files in, or allow their folder with --links-into"
        for name in ("archive", "house.glb")
    ]
    found, errors = find_scans(scans, links_into=[made])
    assert [scan.scene_id for scan in found] == ["glb/house", "rgbd/kitchen", "scannet/scene0001_00"]
    assert not errors


def test_a_store_that_is_not_there_is_misuse(scans: Path) -> None:
    with pytest.raises(InputError, match=r"^--links-into: .*nowhere: is no folder;"):
        found_scans(scans, links_into=[str(scans / "nowhere")])
    both = os.pathsep.join([str(scans), "", str(scans.parent)])
    assert found_scans(scans, links_into=["", both])[1] == []


def test_a_store_may_have_a_colon_in_its_name(scans: Path, tmp_path: Path) -> None:
    store = (tmp_path / "outside").rename(tmp_path / "a:b")
    (scans / "kitchen" / "LICENSE.txt").unlink()
    (scans / "kitchen" / "LICENSE.txt").symlink_to(store / "secret")
    for told in (str(store), f"{scans}:{store}", f"{store}:{scans}", f"{scans}::{store}:{scans}"):
        found, errors = found_scans(scans, links_into=[told])
        assert not errors
        assert [left_out(scan) for scan in found] == [""] * 2, told
    with pytest.raises(InputError, match=r"nowhere: is no folder"):
        found_scans(scans, links_into=[f"{store}:{tmp_path / 'nowhere'}"])


def test_a_listing_of_a_scan_does_not_walk_where_links_lead(scans: Path, tmp_path: Path) -> None:
    (scans / "kitchen" / "everything").symlink_to("/")
    (scans / "kitchen" / "more").symlink_to(tmp_path / "outside")
    listing = scan_source(scans).listing()[0]["rgbd/kitchen"]
    assert not [file.path for file in listing.files if file.path.startswith(("everything", "more"))]


def pipe(path: Path) -> None:
    os.mkfifo(path)


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**42)


@pytest.mark.parametrize("make", [pipe, sparse])
@pytest.mark.parametrize(
    "place",
    ["kitchen/color/1.png", "kitchen/depth/2.png", "kitchen/pose.txt", "kitchen/intrinsics.json", "kitchen/LICENSE.txt",
     "scene0001_00/scene0001_00.txt", "scene0001_00/scene0001_00_vh_clean_2.ply", "scene0001_00/scene0001_00.aggregation.json"],
)  # fmt: skip
def test_what_is_no_file_of_sane_size_hangs_nothing_and_names_itself(
    scans: Path, tmp_path: Path, place: str, make: Callable[[Path], None]
) -> None:
    path = scans / place
    path.unlink(missing_ok=True)
    make(path)
    name = path.relative_to(scans).as_posix()
    lake = Lake.open(tmp_path / "lake")
    found, errors = find_scans(scans)
    plan = make_plan(lake, found, errors, configure())
    assert [scene.scan.path.name for scene in plan.scenes if scene.scan.path.name != name.partition("/")[0]], (
        "the other scan is not concerned"
    )
    if not (make is pipe and path.name == "LICENSE.txt"):  # that is no license, as if it were a folder
        (error,) = plan.unusable
        assert str(error).startswith(f"{name}: {'file: is a pipe' if make is pipe else 'size: is 4398046511104 bytes'}")
    found_by_watch = look(scans, lake, 0.0)
    assert len(found_by_watch.arrivals) == 2
    settled(found, 0.0)


def test_a_device_among_frames_is_left_out_as_a_link_that_leaves(scans: Path) -> None:
    frame = sorted((scans / "kitchen" / "color").iterdir())[0]
    frame.unlink()
    endless(frame)
    scan = next(scan for scan in find_scans(scans)[0] if scan.path.name == "kitchen")
    assert left_out(scan).startswith(f"color/{frame.name}: a link that leads out")
    allowed = next(scan for scan in find_scans(scans, links_into=["/dev"])[0] if scan.path.name == "kitchen")
    with pytest.raises(InputError, match=f"^kitchen/color/{frame.name}: file: is a device, not a regular file;"):
        FileHashes().tree(allowed.folder, scan_files(allowed))


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_line_names_what_it_leaves_out_and_takes_stores(made: Path, scans: Path, tmp_path: Path) -> None:
    (scans / "kitchen" / "LICENSE.txt").unlink()
    (scans / "kitchen" / "LICENSE.txt").symlink_to(tmp_path / "outside" / "secret")
    os.mkfifo(scans / "scene0001_00" / "scene0001_00.txt.more")
    frame = sorted((scans / "scene0001_00").rglob("*.ply"))[0]
    frame.unlink()
    os.mkfifo(frame)

    def told(*more: str) -> str:
        command = [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", str(tmp_path / "lake"), "--dry-run", *more]
        ended = subprocess.run(command, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    note = "left out: rgbd/kitchen: LICENSE.txt: a link that leads out of the folder of scans, left out\n"
    said = told()
    assert note in said
    assert f"unusable: scene0001_00/{frame.name}: file: is a pipe, not a regular file" in said
    assert "left out" not in told("--links-into", str(tmp_path), "--links-into", str(tmp_path / "outside"))


def test_a_look_of_the_watch_reads_nothing_through_a_link(scans: Path, tmp_path: Path) -> None:
    done = threading.Event()

    def write() -> None:  # whoever opens the pipe for reading would let this end
        with (tmp_path / "outside" / "pipe").open("wb"):
            done.set()

    os.mkfifo(tmp_path / "outside" / "pipe")
    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    (scans / "kitchen" / "trajectory.log").symlink_to(tmp_path / "outside" / "pipe")
    os.mkfifo(scans / "kitchen" / "color" / "999999.jpg")
    assert look(scans, Lake.open(tmp_path / "lake"), 0.0).arrivals
    assert not done.is_set()
    descriptor = os.open(tmp_path / "outside" / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    writer.join()
    os.close(descriptor)


def test_a_license_that_is_a_link_to_nowhere_is_none(tmp_path: Path) -> None:
    scan = tmp_path / "kitchen"
    scan.mkdir()
    (scan / "LICENSE.txt").symlink_to("missing.txt")
    assert license_path(scan, Premises((tmp_path,))) is None
    (scan / "missing.txt").write_text("CC0-1.0")
    assert license_path(scan, Premises((tmp_path,))) == scan / "LICENSE.txt"
