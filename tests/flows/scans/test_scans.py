"""Where scans lie: a listing finds what a folder finds, a mirror is whole or not there, and a choice is what a plain rule says."""

from __future__ import annotations

import dataclasses
import datetime
import fnmatch
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.run.fanout.quota import GB, KEEP_FREE_GB
from flows.run.fingerprints import FileHashes, cache_folder
from flows.scans.choice import DAY_SECONDS, arrived, chosen, found_scans, scan_source, settled
from flows.scans.erasure import erase_from_caches
from flows.scans.listing import MAX_NAME_BYTES, ScanFile, listed_folder, usable_paths
from flows.scans.mirror import FetchError, StoreSource
from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.scan import Scan
from tests.conftest import REPOSITORY
from tests.scans import write_scans
from tests.services import S3, environment_of, s3_server
from warehouse.upkeep.erasure.traces import traces_of

LONG_AGO = 1_700_000_000
"""A time [s since the epoch] that is neither now nor any object's."""


def contents(root: Path) -> dict[str, bytes]:
    """Every file below a folder, through links."""
    found = {}
    for folder, _, names in os.walk(root, followlinks=True):
        found |= {(Path(folder) / name).relative_to(root).as_posix(): (Path(folder) / name).read_bytes() for name in names}
    return found


# ------------------------------------------------------------------------------------------------ choosing


def scans_at(folder: Path, times: dict[str, int]) -> list[Scan]:
    """GLB scans with the given names (`dataset/scan`) and times of arrival [s since the epoch]."""
    found = []
    for number, (scene, at) in enumerate(sorted(times.items())):
        path = folder / f"{number}.glb"
        path.write_bytes(b"glb")
        os.utime(path, (at, at))
        dataset, _, scan = scene.partition("/")
        found.append(Scan("glb", path, dataset, scan))
    return found


WORDS = st.text(alphabet="ab01_", min_size=1, max_size=3).map(lambda text: f"s{text}")
IDS = st.builds(lambda dataset, scan: f"{dataset}/{scan}", st.sampled_from(["d", "e"]), WORDS)
DAYS = st.dates(datetime.date(2024, 1, 1), datetime.date(2024, 1, 20))
MOMENTS = st.datetimes(datetime.datetime(2024, 1, 1), datetime.datetime(2024, 1, 20)).map(lambda moment: moment.replace(microsecond=0))
ZONES = st.sampled_from(["", "Z", "+02:00", "-05:30"])
BOUNDS = st.one_of(st.none(), DAYS.map(str), st.builds(lambda moment, zone: f"{moment.isoformat()}{zone}", MOMENTS, ZONES))


def reference_bounds(text: str) -> tuple[datetime.datetime, datetime.datetime]:
    """First and last moment that a day or a time names."""
    if len(text) == 10:
        day = datetime.datetime.strptime(text, "%Y-%m-%d").replace(tzinfo=datetime.UTC)
        return day, day + datetime.timedelta(days=1, microseconds=-1)
    moment = datetime.datetime.fromisoformat(text.replace("Z", "+00:00"))
    moment = moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)
    return moment, moment


@pytest.mark.whole
@settings(deadline=None, max_examples=300)
@given(
    st.dictionaries(IDS, st.datetimes(datetime.datetime(2024, 1, 1), datetime.datetime(2024, 1, 20)), min_size=1, max_size=8),
    st.lists(st.one_of(IDS, WORDS, st.sampled_from(["*", "d/*", "*/s0*", "s?", "s[ab]*", "nothing*"])), max_size=3),
    st.one_of(st.none(), IDS, WORDS),
    st.one_of(st.none(), IDS, WORDS),
    BOUNDS,
    BOUNDS,
)
def test_chosen_is_what_a_plain_rule_says(
    arrivals: dict[str, datetime.datetime], scenes: list[str], first: str | None, last: str | None, since: str | None, until: str | None
) -> None:
    times = {scene: int(moment.replace(tzinfo=datetime.UTC).timestamp()) for scene, moment in arrivals.items()}

    def part(scene: str, text: str) -> str:
        return scene if "/" in text else scene.split("/")[1]

    begin = reference_bounds(since)[0] if since else None
    end = reference_bounds(until)[1] if until else None
    is_wrong = any(not any(fnmatch.fnmatchcase(part(scene, pattern), pattern) for scene in times) for pattern in scenes)
    is_wrong |= first is not None and last is not None and ("/" in first) == ("/" in last) and first > last
    is_wrong |= begin is not None and end is not None and begin > end
    expected = []
    for scene in sorted(times):
        at = datetime.datetime.fromtimestamp(times[scene], datetime.UTC)
        keep = not scenes or any(fnmatch.fnmatchcase(part(scene, pattern), pattern) for pattern in scenes)
        keep &= first is None or part(scene, first) >= first
        keep &= last is None or part(scene, last) <= last
        keep &= begin is None or at >= begin
        keep &= end is None or at <= end
        expected += [scene] * keep
    with tempfile.TemporaryDirectory() as folder:
        found = scans_at(Path(folder), times)
        choice: dict[str, Any] = {"scenes": scenes, "first": first, "last": last, "since": since, "until": until}
        if is_wrong:
            with pytest.raises(InputError) as error:
                chosen(found, **choice)
            assert "\n" not in str(error.value)
        else:
            assert [scan.scene_id for scan in chosen(found, **choice)] == expected


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"since": "yesterday"}, r"^--since: yesterday: is no date; write \d{4}-\d\d-\d\d or "),
        ({"until": "2024-13-01"}, r"^--until: 2024-13-01: is no date"),
        ({"scenes": ["d/x*"]}, r"^--scene: d/x\*: no scan matches, of 1; there are d/a$"),
        ({"first": "d/b", "last": "d/a"}, r"^--first: d/b: is after --last d/a; swap them$"),
        ({"since": "2024-02-01", "until": "2024-01-31"}, r"^--since: .*is after --until 2024-01-31"),
    ],
)
def test_a_wrong_choice_is_one_line(tmp_path: Path, choice: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        chosen(scans_at(tmp_path, {"d/a": LONG_AGO}), **choice)


def test_the_newest_file_says_when_a_scan_arrived(tmp_path: Path) -> None:
    (scan,), _ = find_scans(write_scans(tmp_path, 1))
    for path in scan_files(scan):
        os.utime(path, (LONG_AGO, LONG_AGO))
    os.utime(scan_files(scan)[1], (LONG_AGO + 90_000, LONG_AGO + 90_000))
    assert arrived(scan) == LONG_AGO + 90_000
    day = datetime.datetime.fromtimestamp(LONG_AGO + 90_000, datetime.UTC).date()
    assert chosen([scan], since=str(day), until=str(day)) == [scan]
    assert chosen([scan], until=str(day - datetime.timedelta(days=1))) == []
    shutil.rmtree(scan.path)
    assert arrived(scan) is None
    assert chosen([scan], since="2024-01-01") == [scan], "what cannot be looked at is reported by the run, not passed over"


def test_a_scan_that_its_reader_could_not_read_is_left_for_a_day(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", 3)
    cut = scans / "scene0000_00" / "scene0000_00_vh_clean_2.ply"
    cut.write_bytes(cut.read_bytes()[:-1])
    (scans / "scene0001_00" / "scene0001_00.aggregation.json").unlink()
    found, _ = find_scans(scans)

    def left(age: float) -> list[str]:
        moment = time.time() - age
        for scan in found:
            for file in scan.path.iterdir():
                os.utime(file, (moment, moment))
        calm, busy = settled(found, 60, by_change=False)
        assert [scan for scan in found if scan in calm or scan in busy] == found
        return [scan.scan for scan in busy]

    assert left(3600) == left(DAY_SECONDS - 60) == ["scene0000_00"], "the other can be read without what it lacks"
    assert left(DAY_SECONDS + 60) == [], "now it fails with its own error"


def test_who_names_scenes_hears_nothing_of_the_rest(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    (scans / "half").mkdir()
    for scenes, count, wrong in (
        ((), 2, ["half"]),
        (("scannet/*",), 2, ["half"]),
        (("scannet/scene0001_00",), 1, []),
        (("scene0000_00",), 1, []),
    ):
        found, errors = found_scans(scans, scenes=scenes)
        assert (len(found), [error.file for error in errors]) == (count, wrong)


# ------------------------------------------------------------------------------------------------ listings

NAMES = st.sampled_from(
    [
        "a", "scene0001_00", "color", "depth", "pose", "frames", "intrinsic", ".hidden", "rgb", "scans", "habitat", "region_segmentations",
        "rgbd", "a_frames", "lowres_wide", "sequence",
    ]
)  # fmt: skip
ENDS = st.sampled_from(
    [
        "scene0001_00_vh_clean_2.ply", "scene0001_00.aggregation.json", "scene0001_00_vh_clean_2.0.010000.segs.json", "scene0001_00.sens",
        "scene0001_00.txt", "a.glb", "b.glb", ".c.glb.X1y2Z3", "0.jpg", "1.jpg", "0.png", "1.png", "0.txt", "pose.txt", "intrinsics.json",
        "frame-000000.color.jpg", "frame-000000.depth.pgm", "LICENSE.txt", "a", "color", "intrinsic_color.txt",
        "rgb.txt", "depth.txt", "odometry.csv", "camera_matrix.csv", "metadata", "metadata.csv", "mesh_aligned_0.05.ply", "region0.ply",
        "region0.semseg.json", "mesh_semantic.ply", "info_semantic.json", "3RScan.json", "semseg.v2.json", "mesh.refined.v2.obj",
        "a_3dod_mesh.ply", "lowres_wide.traj", "Room.json", "Room.usdz",
    ]
)  # fmt: skip
TREES = st.lists(st.builds(lambda folders, name: "/".join([*folders, name]), st.lists(NAMES, max_size=4), ENDS), max_size=14, unique=True)


def outcome(folder: Path, format: str) -> Any:
    """What is found in a folder, by names."""
    found, errors = find_scans(folder, format)
    root = folder if folder.name == "scans" else folder.parent
    files = [(scan, sorted(path.relative_to(root if folder.is_dir() else folder.parent).as_posix() for path in scan_files(scan)))
             for scan in found]  # fmt: skip
    return [(scan.format, scan.scene_id, paths) for scan, paths in files], [str(error) for error in errors]


@pytest.mark.whole
@settings(deadline=None, max_examples=400)
@given(TREES, st.sampled_from(["auto", *SCAN_FORMATS]))
def test_a_listing_finds_what_the_folder_finds(paths: list[str], format: str) -> None:
    files, _ = usable_paths(ScanFile(path, len(path), LONG_AGO * 10**9, "tag") for path in paths)
    if not files:
        return
    with tempfile.TemporaryDirectory() as place:
        root = Path(place).resolve() / "scans"
        for file in files:
            (root / file.path).parent.mkdir(parents=True, exist_ok=True)
            (root / file.path).write_text(file.path)
        assert outcome(listed_folder("scans", files), format) == outcome(root, format)
        real, listed = scan_source(root).listing(format)[0], [*listed_folder("scans", files).iterdir()]
        assert sorted(path.name for path in listed) == sorted(path.name for path in root.iterdir())
        for listing in real.values():
            assert {file.path for file in listing.files} >= {
                path.relative_to(listing.scan.path if listing.scan.path.is_dir() else listing.scan.path.parent).as_posix()
                for path in scan_files(listing.scan)
                if path.is_relative_to(listing.scan.folder)
            }


@given(st.lists(st.text(alphabet="ab./\\\n", min_size=1, max_size=8), max_size=8, unique=True))
def test_no_path_of_a_listing_leaves_its_folder(paths: list[str]) -> None:
    files, errors = usable_paths(ScanFile(path, 1, 1) for path in paths)
    assert len(files) + len(errors) == len(paths)
    assert not any("\n" in str(error) for error in errors)
    with tempfile.TemporaryDirectory() as place:
        root = Path(place) / "root"
        root.mkdir()
        for file in files:
            (root / file.path).parent.mkdir(parents=True, exist_ok=True)
            (root / file.path).write_text("x")
        assert sorted(contents(root)) == [file.path for file in files]
        assert sorted(path.name for path in Path(place).iterdir()) == ["root"]


def test_names_that_no_folder_holds_are_refused() -> None:
    bad = ["../up", "a/../../b", "/abs", "a//b", "a/./b", "tab\tbed", "x" * (MAX_NAME_BYTES + 1), "both", "c\\d"]
    files, errors = usable_paths(ScanFile(path, 1, 1) for path in [*bad, "both/below", "good"])
    assert [file.path for file in files] == ["both/below", "good"]
    assert len(errors) == len(bad)


def test_an_unknown_kind_of_address_is_refused_without_repeating_its_secrets() -> None:
    with pytest.raises(InputError) as error:
        scan_source("https://user:secret@host/scans")
    assert "secret" not in str(error.value)
    with pytest.raises(InputError, match="needs a bucket"):
        scan_source("s3://")


# ------------------------------------------------------------------------------------------------ mirrors


@pytest.fixture(scope="module")
def server() -> Iterator[S3]:
    with s3_server() as running, environment_of(running):
        running.make_bucket("store")
        yield running


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv("METASCENES_CACHE", str(folder))
    return folder


def upload(server: S3, folder: Path, prefix: str) -> None:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            server.make_object(f"{prefix}/{path.relative_to(folder).as_posix()}", path.read_bytes())


@pytest.fixture
def fetched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Paths of the objects that are fetched while the test runs, in order."""
    seen: list[str] = []
    really = StoreSource._object

    def recorded(self: StoreSource, entry: ScanFile, path: Path) -> None:
        seen.append(entry.path)
        really(self, entry, path)

    monkeypatch.setattr(StoreSource, "_object", recorded)
    return seen


@pytest.mark.whole
@pytest.mark.s3
def test_a_mirror_is_the_store_and_fetches_what_changed(server: S3, cache: Path, tmp_path: Path, fetched: list[str]) -> None:
    local = write_scans(tmp_path / "scans", 3)
    (local / "scene0001_00" / "LICENSE.txt").write_text("CC0-1.0\n")
    (local / "README.txt").write_text("no scan")
    upload(server, local, "store/first/scans")
    address = "s3://store/first/scans"
    source = scan_source(address)
    folder = source.folder()
    assert contents(folder) == {path: data for path, data in contents(local).items() if path != "README.txt"}
    assert [scan.scene_id for scan in find_scans(folder)[0]] == [scan.scene_id for scan in find_scans(local)[0]]
    assert len(fetched) == 13
    found, errors = found_scans(address)
    assert not errors
    hashes = FileHashes(tmp_path / "hashes.json")
    for scan, own in zip(found, find_scans(local)[0], strict=True):
        assert hashes.tree(scan.path, scan_files(scan)) == hashes.tree(own.path, scan_files(own))
        assert (scan.format, scan.scene_id, scan.path.name) == (own.format, own.scene_id, own.path.name)
    assert len(fetched) == 13, "nothing is fetched twice"

    before = {path: path.stat().st_ino for path in found[0].path.iterdir()}
    fetched.clear()
    changed = local / "scene0000_00" / "scene0000_00.txt"
    changed.write_text(changed.read_text().replace("Office", "Closet"))
    upload(server, local / "scene0000_00", "store/first/scans/scene0000_00")
    server.remove("store/first/scans/scene0001_00")
    source.close()
    again = scan_source(address)
    listing, _ = again.listing()
    assert list(listing) == ["scannet/scene0000_00", "scannet/scene0002_00"]
    ready, errors = again.fetch([listing["scannet/scene0000_00"].scan])
    assert not errors
    assert fetched == ["scene0000_00/scene0000_00.txt"], "of a changed scan, only the changed object"
    assert (ready[0].path / changed.name).read_bytes() == changed.read_bytes()
    same = {path.name for path, inode in before.items() if (ready[0].path / path.name).stat().st_ino == inode}
    assert same == {path.name for path in before} - {changed.name}
    assert found[0].path.is_dir(), "a version that a living process was given stays"


@pytest.mark.s3
def test_objects_keep_the_time_at_which_they_were_put(server: S3, cache: Path, tmp_path: Path) -> None:
    upload(server, write_scans(tmp_path / "scans", 1), "store/times")
    listing, _ = scan_source("s3://store/times").listing()
    (scan,), _ = found_scans("s3://store/times")
    (entry,) = listing.values()
    assert {path.name: path.stat().st_mtime_ns for path in scan.path.iterdir()} == {file.path: file.modified_ns for file in entry.files}
    assert arrived(entry.scan) == arrived(scan)
    today = str(datetime.datetime.fromtimestamp(entry.files[0].modified_ns / 1e9, datetime.UTC).date())
    assert len(found_scans("s3://store/times", since=today)[0]) == 1
    assert found_scans("s3://store/times", until="2020-01-01") == ([], [])


@pytest.mark.whole
@pytest.mark.s3
def test_scans_of_all_kinds_and_places(server: S3, cache: Path, tmp_path: Path) -> None:
    root = "store/kinds/set"
    for key in ("a.glb", "b.glb", "LICENSE.txt", "deep/kitchen/color/0.jpg", "deep/kitchen/depth/0.png", "deep/kitchen/pose.txt",
                "deep/kitchen/intrinsics.json", "deep/kitchen/notes/unread.bin", "deep/house/house.glb",
                "../escape.glb", "scene0001_00/scene0001_00.sens", "scene0001_00/x/color/0.jpg", "scene0001_00/x/depth/0.png"):  # fmt: skip
        server.make_object(f"{root}/{key}", key.encode())
    found, errors = found_scans(f"s3://{root}")
    assert [scan.scene_id for scan in found] == ["glb/a", "glb/b", "glb/house", "rgbd/kitchen", "scannet/scene0001_00"]
    assert [str(error) for error in errors] == ["../escape.glb: key: has an empty, . or .. folder in its path; rename the object"]
    for scan in found:
        again, wrong = find_scans(scan.path, scan.format)
        assert (again, wrong) == ([scan], [])
        assert all(path.read_bytes() for path in scan_files(scan))
    assert [path.name for path in scan_files(found[0])] == ["LICENSE.txt", "a.glb"]
    assert not (found[3].path / "notes").exists(), "what no reader reads is not fetched"
    assert (found[4].path / "scene0001_00.sens").is_file(), "unless the scan would not be known without"
    source = scan_source(f"s3://{root}")
    assert [scan.scene_id for scan in find_scans(source.folder(), links_into=[cache_folder()])[0]] == [scan.scene_id for scan in found]
    for single, scene in (
        (f"{root}/a.glb", "glb/a"),
        (f"{root}/deep/kitchen", "rgbd/kitchen"),
        (f"{root}/scene0001_00", "scannet/scene0001_00"),
    ):
        own = scan_source(f"s3://{single}")
        assert [scan.scene_id for scan in find_scans(own.folder(), links_into=[cache_folder()])[0]] == [scene]
        assert [scan.scene_id for scan in found_scans(f"s3://{single}")[0]] == [scene]
    assert not list(tmp_path.rglob("escape*"))
    found, errors = found_scans("s3://store/kinds/nothing")
    assert (found, [str(error) for error in errors]) == (
        [],
        ["s3://store/kinds/nothing: --scans: holds no objects; name a scan, or a folder of scans"],
    )
    with pytest.raises(InputError, match=r"^s3://nosuchbucket/x: --scans: cannot be listed \(.*\); check the address"):
        found_scans("s3://nosuchbucket/x")


@pytest.mark.whole
@pytest.mark.s3
def test_an_object_that_changes_meanwhile_fails_its_scan_only(server: S3, cache: Path, tmp_path: Path) -> None:
    upload(server, write_scans(tmp_path / "scans", 2), "store/meanwhile")
    source = scan_source("s3://store/meanwhile")
    found, _ = source.find()
    server.make_object("store/meanwhile/scene0000_00/scene0000_00.txt", b"sceneType = Garage\n")
    ready, errors = source.fetch(found)
    assert [scan.scene_id for scan in ready] == ["scannet/scene0001_00"]
    (error,) = errors
    assert isinstance(error, FetchError)
    assert str(error).startswith("scannet/scene0000_00: objects: cannot be fetched (")
    assert not list(cache.rglob("scene0000_00*.ply")), "a scan is whole or not there"
    ready, errors = found_scans("s3://store/meanwhile")
    assert (len(ready), errors) == (2, [])
    (ready[0].path / "scene0000_00.txt").write_bytes(b"cut")
    os.remove(ready[1].path / "scene0001_00.aggregation.json")
    mended, errors = found_scans("s3://store/meanwhile")
    assert not errors
    assert (mended[0].path / "scene0000_00.txt").read_bytes() == b"sceneType = Garage\n", "a mirror that was damaged is made anew"
    assert (mended[1].path / "scene0001_00.aggregation.json").is_file()


@pytest.mark.s3
def test_a_full_disk_ends_the_fetching_and_not_the_disk(
    server: S3, cache: Path, tmp_path: Path, fetched: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    local = write_scans(tmp_path / "scans", 3)
    upload(server, local, "store/full")
    size = sum(len(data) for data in contents(local / "scene0000_00").values())
    usage = shutil.disk_usage(tmp_path)
    free = int(KEEP_FREE_GB * GB) + size
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=free - 1 if fetched else free))
    source = scan_source("s3://store/full")
    found, _ = source.find()
    first, errors = source.fetch(found[:1])
    assert (len(first), errors) == (1, []), "there is room for this one"
    fetched_then = list(fetched)
    ready, errors = source.fetch(found)
    assert [scan.path for scan in ready] == [first[0].path], "what is here needs no room"
    assert [error.file for error in errors] == ["scannet/scene0001_00", "scannet/scene0002_00"]
    assert all(isinstance(error, FetchError) and f"{KEEP_FREE_GB:g} GB left" in str(error) for error in errors)
    assert fetched == fetched_then
    assert not list(cache.glob("scans/*/making/*"))
    assert not list(cache.rglob("scene0001_00*.ply"))
    free += 10 * size
    assert len(source.fetch(found)[0]) == 3, "with room again, the rest is fetched"


@pytest.mark.s3
def test_a_mirror_forgets_an_erased_scene(server: S3, cache: Path, tmp_path: Path) -> None:
    local = write_scans(tmp_path / "scans", 2)
    (local / "kitchen").mkdir()
    (local / "kitchen" / "kitchen.glb").write_bytes(b"glTF")
    upload(server, local, "store/erased")
    found_scans("s3://store/erased")
    assert erase_from_caches(traces_of("scannet/scene0001_00", [], ["scannet/scene0000_00"]), [], cache) == 1
    assert erase_from_caches(traces_of("glb/kitchen", [], []), [], cache) == 1
    left = [path.name for path in cache.rglob("*")]
    assert "scene0000_00" in left
    assert not [name for name in left if "scene0001_00" in name or "kitchen" in name]
    assert len(found_scans("s3://store/erased")[0]) == 3, "as long as the store has them, they can be had again"


_FETCH = """
import sys
from flows.scans.erasure import erase_from_caches
from flows.run.fingerprints import FileHashes
from flows.scans.choice import found_scans
from tasks.capture.formats import scan_files
found, errors = found_scans(sys.argv[1])
assert not errors, errors
print(*(FileHashes().tree(scan.path, scan_files(scan)) for scan in found))
"""


@pytest.mark.whole
@pytest.mark.s3
def test_two_processes_at_once_and_one_that_is_killed(server: S3, cache: Path, tmp_path: Path) -> None:
    local = write_scans(tmp_path / "scans", 4)
    upload(server, local, "store/two")
    command = [sys.executable, "-c", _FETCH, "s3://store/two"]
    killed = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    give_up = time.monotonic() + 60
    while not list(cache.glob("scans/*/making/*")) and killed.poll() is None and time.monotonic() < give_up:
        time.sleep(0.005)
    killed.kill()
    killed.wait()
    both = [subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=600)[0].split() for process in both]
    hashes = FileHashes(tmp_path / "own.json")
    expected = [hashes.tree(scan.path, scan_files(scan)) for scan in find_scans(local)[0]]
    assert said == [expected, expected]
    found_scans("s3://store/two")
    (root,) = cache.glob("scans/*")
    assert len(list((root / "views").iterdir())) == 1, "views of processes that ended are swept"
    assert not list((root / "making").iterdir())
    assert len(list((root / "versions").glob("*.json"))) == 4
    server.remove("store/two/scene0003_00")
    source = scan_source("s3://store/two")
    source.fetch(source.find()[0])
    assert len(list((root / "versions").glob("*.json"))) == 4, "used by a scan that this process was given"
    subprocess.run(command, cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL)
    assert dataclasses.asdict(source.find()[0][0])["scan"] == "scene0000_00"
