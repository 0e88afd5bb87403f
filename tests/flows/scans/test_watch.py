"""The watcher: what is still being copied waits, what is whole and new by content is asked for once, the rest is left alone."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.run.configuration import configure
from flows.run.fingerprints import FileHashes
from flows.run.plan import make_plan
from flows.scans.arrivals import ATTEMPTS, HERE, PATIENCE, Arrival, Look, look, remember, request_key, watch_report
from flows.scans.choice import DAY_SECONDS
from flows.server.artifacts import artifact_key
from tasks.capture.formats import FORMATS, find_scans
from tasks.capture.likeness import likeness
from tasks.capture.wholeness import find_gap, is_temporary
from tests.capture_scans import box_room, write_posed_rgbd, write_scannet
from tests.conftest import REPOSITORY
from tests.samples import stage_run
from tests.scans import write_scan, write_scans
from tests.services import S3, PrefectServer, environment_of, prefect_server_process, s3_server
from warehouse.lake import Lake
from warehouse.sharing.looks import FOLDER

SETTLE = 120.0
T0 = 1_800_000_000.0
"""When the first look is taken [s since the epoch]; looks are told the time."""


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return Lake.open(tmp_path / "lake")


def looked(scans: Path | str, lake: Lake, now: float = T0, settle: float = SETTLE) -> Look:
    """A look that is remembered."""
    found = look(scans, lake, settle, now=now)
    remember(found, scans, lake)
    return found


def states(found: Look) -> dict[str, str]:
    return {arrival.scan: arrival.state for arrival in found.arrivals}


def settled(scans: Path | str, lake: Lake, now: float = T0) -> Look:
    """The second of two looks at the same files."""
    looked(scans, lake, now)
    return looked(scans, lake, now + SETTLE)


def record(scans: Path, lake: Lake, outcome: str = "done", at: float = 0.0, **values: Any) -> None:
    """Have captures of all scans in the lake, of their content as a run's own plan reads it."""
    plan = make_plan(lake, *find_scans(scans), configure(), hashes=FileHashes(scans.parent / "plan_hashes.json"))
    for scene in plan.scenes:
        step = scene.steps[0]
        assert step.stage == "capture"
        failure = {} if outcome == "done" else {"error": "mesh: is broken", "error_kind": "input" if outcome == "failed" else "lost"}
        lake.stage_rows(stage_run(scene.scan.scene_id, "capture", step.fingerprint.value, at=at, reasons=step.fingerprint.parts,
                                  outcome=outcome, **failure, **values))  # fmt: skip
    lake.commit()


# ------------------------------------------------------------------------------------------------ whole or not


def glb_bytes() -> bytes:
    body = json.dumps({"asset": {"version": "2.0"}, "nodes": []}).encode().ljust(64)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(body), len(body), 0x4E4F534A) + body


@functools.cache
def wholes(kind: str) -> dict[str, bytes]:
    """Files of a whole scan `scene0007_00`, by path below its folder."""
    room = box_room(cameras=3)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "scene0007_00"
        if kind == "posed_rgbd":
            write_posed_rgbd(folder, room)
        elif kind == "glb":
            folder.mkdir()
            (folder / "scene0007_00.glb").write_bytes(glb_bytes())
        elif kind == "boxes":
            write_scan(folder.parent, folder.name)
        else:
            write_scannet(folder, room, frames=kind)
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


KINDS = ("boxes", "none", "sens", "exported", "posed_rgbd", "glb")


def laid_out(folder: Path, files: Mapping[str, bytes]) -> None:
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)


def renamed(files: Mapping[str, bytes], scan: str) -> dict[str, bytes]:
    """A scan of another name, with a little white space that makes it another content."""
    white = b"\n" * int(scan[5:9])
    found = {}
    for path, data in files.items():
        if path.endswith(".glb"):
            data = data[: -len(white)] + white
        found[path.replace("scene0007_00", scan)] = data + white if path.endswith(".txt") else data
    return found


def could_be_meant_so(there: Mapping[str, bytes], whole: Mapping[str, bytes]) -> bool:
    """Whether what is there of a scan could be all of a smaller one, as nobody can tell who does not know the whole: a text
    that ends with a line, or some frames of which everything is there."""
    kinds = {(path.rpartition("/")[0], Path(path).suffix) if "/" in path else path for path in there}
    if kinds != {(path.rpartition("/")[0], Path(path).suffix) if "/" in path else path for path in whole}:
        return False
    for path, data in there.items():
        if data != whole[path] and not (path.endswith(".txt") and data.endswith(b"\n")):
            return False
    stems = [{Path(path).stem for path in there if path.startswith(f"{folder}/")} for folder in ("color", "depth", "pose")]
    frames = [found for found in stems if found]
    if "pose.txt" in there and frames and there["pose.txt"].count(b"\n") < len(frames[0]):
        return False
    return all(found == frames[0] for found in frames)


@st.composite
def copies(draw: st.DrawFn) -> tuple[dict[str, bytes], dict[str, bytes], str]:
    """A scan, a copy of it that is under way, and the temporary name of the file that is being written, if it has one."""
    whole = wholes(draw(st.sampled_from(KINDS)))
    order = draw(st.permutations(sorted(whole)))
    count = draw(st.integers(0, len(order)))
    there = {path: whole[path] for path in order[:count]}
    temporary = ""
    if draw(st.booleans()) and count < len(order):
        last = order[count]
        size = len(whole[last])
        end = draw(st.one_of(st.integers(0, size), st.integers(max(0, size - 40), size)))
        name = Path(last).name
        temporary = draw(st.sampled_from(["", "", f".{name}.aB3xY9", f"{name}.part", f"{name}.7dEf0A1b", f".~tmp~/{name}"]))
        temporary = (Path(last).parent / temporary).as_posix() if temporary else ""
        if temporary and draw(st.booleans()):
            there = dict(whole)  # a newer version of one file is being copied over the whole scan
        there[temporary or last] = whole[last][:end]
    return whole, there, temporary


@pytest.mark.whole
@settings(deadline=None, max_examples=150)
@given(copies())
def test_no_part_of_a_copy_is_taken_for_the_scan_and_the_whole_is(case: tuple[dict[str, bytes], dict[str, bytes], str]) -> None:
    whole, there, temporary = case
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        patch.setenv("METASCENES_CACHE", f"{place}/cache")
        scans, lake = Path(place) / "scans", Lake.open(f"{place}/lake")
        for other in ("scene0001_00", "scene0002_00"):
            laid_out(scans / other, renamed(whole, other))
        copy = scans / "scene0007_00"
        copy.mkdir()
        laid_out(copy, there)
        first = states(looked(scans, lake))
        assert set(first.values()) == {"waiting"}, "before it has settled nothing is taken"
        second = states(looked(scans, lake, T0 + SETTLE))
        dataset = next(iter(second)).partition("/")[0]
        own = {scan: state for scan, state in second.items() if scan.endswith("scene0007_00")}
        assert list(second.values()).count("new") == 2 + (own == {f"{dataset}/scene0007_00": "new"})
        if there == whole:
            assert own == {f"{dataset}/scene0007_00": "new"}
        elif temporary or not could_be_meant_so(there, whole):
            assert set(own.values()) <= {"waiting"}, sorted(there)
            assert own or likeness(copy, FORMATS) is None, "only a folder that looks like no scan yet is passed over"
        for path in there:
            (copy / path).unlink()
        shutil.rmtree(copy)
        laid_out(copy, whole)
        assert set(states(settled(scans, lake, T0 + 1000)).values()) == {"new"}


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("kind", KINDS)
def test_every_byte_of_every_file_is_missed_when_it_is_cut(kind: str, tmp_path: Path) -> None:
    whole = wholes(kind)
    laid_out(tmp_path / "scene0007_00", whole)
    (scan,), _ = find_scans(tmp_path)
    assert find_gap(scan) is None
    for path, data in whole.items():
        step = max(1, len(data) // 40)
        for end in sorted({*range(0, len(data), step), *range(max(0, len(data) - 20), len(data))}):
            if path.endswith(".txt") and data[:end].endswith(b"\n"):
                continue
            (scan.path / path).write_bytes(data[:end])
            assert find_gap(scan) is not None, f"{path} cut at {end} of {len(data)}"
        (scan.path / path).write_bytes(data)


def test_images_and_meshes_of_other_kinds_are_missed_when_they_are_cut(tmp_path: Path) -> None:
    import numpy as np
    from PIL import Image

    from tasks.capture.wholeness import _CHECKS

    color, depth = np.arange(18 * 11 * 3, dtype=np.uint8).reshape(11, 18, 3), np.arange(198, dtype=np.uint16).reshape(11, 18)
    Image.fromarray(color).save(tmp_path / "color.ppm")
    Image.fromarray(color).save(tmp_path / "color.bmp")
    Image.fromarray(depth).save(tmp_path / "depth.pgm")
    rows = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    (tmp_path / "text.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}"
    )
    for path in tmp_path.iterdir():
        data, check = path.read_bytes(), _CHECKS[path.suffix]
        assert check(path, len(data)) is None
        for end in range(1, len(data)):
            path.write_bytes(data[:end])
            assert check(path, end) is not None, f"{path.name} cut at {end}"


def test_damage_that_is_no_cut_is_left_to_the_reader(tmp_path: Path) -> None:
    laid_out(tmp_path / "scene0007_00", wholes("sens"))
    (scan,), _ = find_scans(tmp_path)
    aggregation = "scene0007_00.aggregation.json"
    deep, wrong = b"[" * 100_000 + b"]" * 100_000, b'{"a": [1, nonsense, 2, 3, 4, 5, 6, 7]}'
    for name, damage in ((aggregation, wrong), (aggregation, deep), ("scene0007_00.sens", b"\3\0\0\0" * 99)):
        before = (scan.path / name).read_bytes()
        (scan.path / name).write_bytes(damage)
        assert find_gap(scan) is None
        (scan.path / name).write_bytes(before)


def test_names_of_copying_programs() -> None:
    for name in (".a.ply.Xy12Zq", "a.ply.part", "a.ply.partial", "a.tmp", "a.crdownload", "x/.rsync-partial/a.ply", "a.sens.6eF5b5Da",
                 ".~tmp~/a.ply", "a.ply.filepart"):  # fmt: skip
        assert is_temporary(name), name
    for name in (
        "a.ply",
        "frame-000000.color.jpg",
        "a_vh_clean_2.0.010000.segs.json",
        ".DS_Store",
        "notes.20240101",
        "part/a.ply",
        "a.txt",
    ):
        assert not is_temporary(name), name


def test_what_can_be_read_waits_longer_and_not_for_ever(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 3)
    (scans / "scene0002_00" / "scene0002_00.aggregation.json").unlink()
    found = settled(scans, lake)
    assert states(found)["scannet/scene0002_00"] == "waiting"
    assert "scene0002_00.aggregation.json: is missing" in found.arrivals[2].why
    assert states(looked(scans, lake, T0 + PATIENCE * SETTLE))["scannet/scene0002_00"] == "new"


# ------------------------------------------------------------------------------------------------ by content


def test_content_decides(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 3)
    record(scans, lake)
    assert set(states(settled(scans, lake)).values()) == {"known"}
    mesh, text = scans / "scene0000_00" / "scene0000_00_vh_clean_2.ply", scans / "scene0001_00" / "scene0001_00.txt"
    before = mesh.stat()
    data = bytearray(mesh.read_bytes())
    data[-1] ^= 1
    mesh.write_bytes(data)
    os.utime(mesh, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (mesh.stat().st_size, mesh.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    os.utime(text, (1, 1))
    copied = scans / "scene0002_00.copied"
    shutil.copytree(scans / "scene0002_00", copied)
    shutil.rmtree(scans / "scene0002_00")
    copied.rename(scans / "scene0002_00")
    later = T0 + 10 * SETTLE
    assert set(states(looked(scans, lake, later)).values()) == {"waiting"}
    found = looked(scans, lake, later + SETTLE)
    assert states(found) == {"scannet/scene0000_00": "changed", "scannet/scene0001_00": "known", "scannet/scene0002_00": "known"}
    data[-1] ^= 1
    mesh.write_bytes(data)
    assert set(states(settled(scans, lake, later + 10 * SETTLE)).values()) == {"known"}, "back to what the lake has"


def test_what_failed_on_the_same_content_is_not_asked_for_again(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    record(scans, lake, "failed")
    found = settled(scans, lake)
    assert (found.arrivals[0].state, found.arrivals[0].why) == ("failed before", "mesh: is broken")
    assert found.due(lambda run: True) == []
    (scans / "scene0000_00" / "scene0000_00.txt").write_text("sceneType = Garage\n")
    assert set(states(settled(scans, lake, T0 + 1000)).values()) == {"changed"}
    record(scans, lake, "lost", at=10)
    assert set(states(settled(scans, lake, T0 + 2000)).values()) == {"changed"}, "a lost worker says nothing of the scan"


def test_one_run_is_asked_for_and_again_only_when_it_ended_in_vain(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    found = settled(scans, lake)
    first = found.due(lambda run: pytest.fail("there is no run yet"))
    assert [arrival.scan for arrival in first] == ["scannet/scene0000_00"]
    found.asked(first, "run-1")
    remember(found, scans, lake)
    write_scan(scans, "scene0001_00")
    found = settled(scans, lake, T0 + 1000)
    second = found.due({"run-1": False}.__getitem__)
    assert [arrival.scan for arrival in second] == ["scannet/scene0001_00"]
    assert found.arrivals[0].why == "run run-1 is under way"
    keys = {request_key("s", "l", due) for due in (first, second, [*first, *second])}
    assert len(keys) == 3
    for attempt in range(1, ATTEMPTS):
        due = found.due(lambda run: True)
        assert [(arrival.scan, arrival.attempt) for arrival in due][:1] == [("scannet/scene0000_00", attempt)]
        assert request_key("s", "l", due[:1]) not in keys
        found.asked(due[:1], f"run-{attempt + 1}")
        remember(found, scans, lake)
        found = looked(scans, lake, T0 + 2000)
    assert [arrival.scan for arrival in found.due(lambda run: True)] == ["scannet/scene0001_00"]
    report = watch_report(found)
    assert "3 runs ended and it is not in the lake" in report.failed_before["scannet/scene0000_00"]
    (scans / "scene0000_00" / "scene0000_00.txt").write_text("sceneType = Garage\n")
    found = settled(scans, lake, T0 + 3000)
    again = found.due(lambda run: True)[0]
    assert (again.scan, again.attempt) == ("scannet/scene0000_00", 0), "new content"


def test_after_many_runs_in_vain_one_a_day_is_asked_for(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    looked(scans, lake)
    asked = []
    for hour in range(1, 97):
        found = looked(scans, lake, T0 + 3600 * hour)
        due = found.due(lambda run: True)
        if due:
            asked.append(hour)
            found.asked(due, f"run-{hour}")
            remember(found, scans, lake)
    assert asked == [*range(1, ATTEMPTS + 1), *(ATTEMPTS + 24 * day for day in (1, 2, 3))]


def test_a_run_that_nobody_starts_blocks_its_scans_for_a_day(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    found = settled(scans, lake)
    found.asked(found.due(lambda run: False), "run-1")
    remember(found, scans, lake)
    begun = found.now
    for age, count in ((-60.0, 0), (60.0, 0), (DAY_SECONDS - 1, 0), (DAY_SECONDS, 1)):
        assert len(looked(scans, lake, begun + age).due(lambda run: False)) == count, age


def test_content_that_is_back_is_another_request(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    text = scans / "scene0000_00" / "scene0000_00.txt"
    before, keys, contents = text.read_bytes(), [], []
    for turn, data in enumerate((before, b"sceneType = Garage\n", before)):
        text.write_bytes(data)
        found = settled(scans, lake, T0 + 1000 * turn)
        due = found.due(lambda run: True)
        same = look(scans, lake, SETTLE, now=found.now + 60).due(lambda run: True)
        keys.append(request_key("s", "l", due))
        assert request_key("s", "l", same) == keys[-1], "two looks at one state ask for one run"
        contents.append(due[0].content)
        found.asked(due, f"run-{turn}")
        remember(found, scans, lake)
    assert contents[0] == contents[2]
    assert len(set(keys)) == 3


def test_an_incomplete_scan_is_told_of_once_a_day(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    mesh = scans / "scene0000_00" / "scene0000_00_vh_clean_2.ply"
    mesh.write_bytes(mesh.read_bytes()[:-1])
    (scans / "empty").mkdir()
    told = []
    for hour in range(0, 73, 3):
        found = looked(scans, lake, T0 + 3600 * hour)
        told += [(hour, arrival.scan) for arrival in found.arrivals if arrival.is_overdue]
        if hour:
            assert watch_report(found).waiting["scannet/scene0000_00"].startswith("scene0000_00/scene0000_00_vh_clean_2.ply: needs ")
    assert told == [(hour, "scannet/scene0000_00") for hour in (27, 51)], "an empty folder is a note"
    mesh.write_bytes(wholes("boxes")["scene0007_00_vh_clean_2.ply"])
    found = looked(scans, lake, T0 + 4 * DAY_SECONDS)
    assert states(looked(scans, lake, T0 + 4 * DAY_SECONDS + SETTLE))["scannet/scene0000_00"] == "new"
    assert not found.arrivals[0].is_overdue or found.arrivals[0].why.startswith("its files changed")


def test_the_memory_is_the_lakes_and_names_no_scene(tmp_path: Path, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = write_scans(tmp_path / "scans", 1)
    looked(scans, lake)
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "another machine"))
    assert set(states(looked(scans, Lake.open(lake.address), T0 + SETTLE)).values()) == {"new"}
    (path,) = lake.storage.entries(FOLDER)
    data = lake.storage.read(path.path)
    assert b"scene0000" not in data
    changed = path.modified
    looked(scans, lake, T0 + 2 * SETTLE)
    assert lake.storage.entries(FOLDER)[0].modified == changed, "a look without news writes nothing"
    for damage in (b"", b"[]", data[:-2], b'{"scans": 3}', b'{"scans": {"' + json.loads(data)["scans"].popitem()[0].encode() + b'": []}}'):
        lake.storage.write(path.path, damage)
        assert set(states(looked(scans, lake, T0 + 3 * SETTLE)).values()) == {"waiting"}
    doctor = subprocess.run([sys.executable, "-m", "flows.cli", "doctor", "lake", "--lake", lake.address], capture_output=True, text=True)
    assert "foreign" not in doctor.stdout


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("xy"), st.integers(0, 2)), max_size=3, unique_by=lambda t: t[0]),
    st.randoms(),
)
def test_the_key_of_a_request_is_of_scans_content_and_attempts(due: list[tuple[str, str, int]], random: Any) -> None:
    arrivals = [Arrival(scan, "new", content=content, attempt=attempt) for scan, content, attempt in due]
    shuffled = list(arrivals)
    random.shuffle(shuffled)
    assert request_key("s", "l", arrivals) == request_key("s", "l", shuffled)
    for index in range(len(arrivals)):
        for other in (dataclasses.replace(arrivals[index], content="z"), dataclasses.replace(arrivals[index], attempt=7)):
            assert request_key("s", "l", [*arrivals[:index], other, *arrivals[index + 1 :]]) != request_key("s", "l", arrivals)


# ------------------------------------------------------------------------------------------------ a copy under way


def slowly(source: Path, target: Path, names: Callable[[str], str], done: threading.Event) -> None:
    """Copy a folder in small pieces with pauses, each file under the name that it has meanwhile."""
    for path in sorted(source.rglob("*")):
        if path.is_file():
            place = target / path.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            data, meanwhile = path.read_bytes(), place.with_name(names(place.name))
            with meanwhile.open("wb") as file:
                for start in range(0, len(data), max(1, len(data) // 8)):
                    file.write(data[start : start + max(1, len(data) // 8)])
                    file.flush()
                    time.sleep(0.02)
            meanwhile.rename(place)
    done.set()


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("names", [str, lambda name: f".{name}.aB3xY9"], ids=["cp", "rsync"])
def test_a_real_copy_is_never_taken_before_its_end_and_always_after(names: Callable[[str], str], tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    whole = tmp_path / "scene0007_00"
    laid_out(whole, wholes("exported"))
    for scan in ("scene0000_00", "scene0001_00"):  # those beside it have frames, too
        laid_out(scans / scan, {path: data for path, data in wholes("exported").items() if "/" in path})
    done = threading.Event()
    thread = threading.Thread(target=slowly, args=(whole, scans / whole.name, names, done))
    thread.start()
    seen = []
    give_up = time.monotonic() + 120
    while time.monotonic() < give_up:
        was_done = done.is_set()
        found = looked(scans, lake, time.time(), settle=0.4)
        state = states(found).get("scannet/scene0007_00", "not there")
        seen.append((was_done, state))
        assert was_done or done.is_set() or state in ("waiting", "not there"), found.arrivals
        if was_done and state == "new":
            break
        time.sleep(0.05)
    thread.join()
    assert seen[-1] == (True, "new"), seen
    assert any(not was_done for was_done, _ in seen)


def test_an_interrupted_copy_waits_until_it_is_completed(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    code = (
        "import sys, time; data = open(sys.argv[1], 'rb').read(); out = open(sys.argv[2], 'wb', buffering=0)\n"
        "out.write(data[: len(data) // 2]); print('half', flush=True); time.sleep(600)"
    )
    write_scan(tmp_path, "scene0007_00")
    source, target = tmp_path / "scene0007_00", scans / "scene0007_00"
    shutil.copytree(source, target)
    mesh = "scene0007_00_vh_clean_2.ply"
    with subprocess.Popen([sys.executable, "-c", code, str(source / mesh), str(target / mesh)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.kill()
    for at in (0.0, SETTLE, PATIENCE * SETTLE, 3 * DAY_SECONDS):
        assert states(looked(scans, lake, T0 + at))["scannet/scene0007_00"] == "waiting"
    shutil.copyfile(source / mesh, target / mesh)
    assert states(settled(scans, lake, T0 + 4 * DAY_SECONDS))["scannet/scene0007_00"] == "new"


# ------------------------------------------------------------------------------------------------ in a store


@pytest.fixture(scope="module")
def server() -> Iterator[S3]:
    with s3_server() as running, environment_of(running):
        running.make_bucket("incoming")
        yield running


@pytest.mark.whole
@pytest.mark.s3
def test_scans_in_a_store(server: S3, tmp_path: Path, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    from flows.scans.mirror import StoreSource

    fetched = []
    really = StoreSource._object

    def recorded(self: StoreSource, entry: Any, path: Path) -> None:
        fetched.append(entry.path)
        really(self, entry, path)

    monkeypatch.setattr(StoreSource, "_object", recorded)
    local = write_scans(tmp_path / "scans", 3)
    address = "s3://incoming/scans"
    assert looked(address, lake).arrivals[0].state == "waiting", "nothing is there"

    def put(scan: str, name: str) -> None:
        server.make_object(f"incoming/scans/{scan}/{name}", (local / scan / name).read_bytes())

    names = {scan.name: sorted(path.name for path in scan.iterdir()) for scan in local.iterdir()}
    for scan in ("scene0000_00", "scene0001_00"):
        for name in names[scan]:
            put(scan, name)
    now = T0
    for name in names["scene0002_00"]:
        now += 10 * SETTLE
        looked(address, lake, now)
        assert states(looked(address, lake, now + SETTLE)).get("scannet/scene0002_00", "waiting") == "waiting", "not all is there"
        put("scene0002_00", name)
    now += 10 * SETTLE
    fetched.clear()
    looked(address, lake, now)
    assert not fetched, "before it has settled nothing is fetched"
    found = looked(address, lake, now + SETTLE)
    assert set(states(found).values()) == {"new"}
    own = {arrival.scan: arrival.content for arrival in settled(local, lake).arrivals}
    assert {arrival.scan: arrival.content for arrival in found.arrivals} == own, "content, whatever the store's tags say"

    record(local, lake)
    assert set(states(looked(address, lake, now + 2 * SETTLE)).values()) == {"known"}
    fetched.clear()
    mesh = "scene0000_00_vh_clean_2.ply"
    key = {"Bucket": "incoming", "Key": f"scans/scene0000_00/{mesh}"}
    before = server.client.head_object(**key)["ETag"]
    upload = server.client.create_multipart_upload(**key)["UploadId"]
    part = server.client.upload_part(**key, UploadId=upload, PartNumber=1, Body=(local / "scene0000_00" / mesh).read_bytes())
    done = {"Parts": [{"PartNumber": 1, "ETag": part["ETag"]}]}
    server.client.complete_multipart_upload(**key, UploadId=upload, MultipartUpload=done)
    assert server.client.head_object(**key)["ETag"] != before
    text = (local / "scene0001_00" / "scene0001_00.txt").read_text().replace("Office", "Garage")
    server.make_object("incoming/scans/scene0001_00/scene0001_00.txt", text.encode())
    now += 100 * SETTLE
    assert states(settled(address, lake, now)) == {
        "scannet/scene0000_00": "known", "scannet/scene0001_00": "changed", "scannet/scene0002_00": "known",
    }  # fmt: skip
    assert sorted(fetched) == [f"scene0000_00/{mesh}", "scene0001_00/scene0001_00.txt"]


# ------------------------------------------------------------------------------------------------ asking for runs


@pytest.fixture(scope="module")
def prefect(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectServer]:
    with prefect_server_process(tmp_path_factory.mktemp("server")) as started:
        yield started


_ASKS = """
import dataclasses, json, sys
from pathlib import Path
from uuid import UUID
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import DeploymentFilter, DeploymentFilterId
from prefect.states import Cancelled
from flows.pipeline import replicate
from flows.watch import watch
from schemas.errors import InputError
from tests.scans import write_scan, write_scans

place = Path(sys.argv[1])
scans, lake = write_scans(place / "scans", 1), str(place / "lake")
id = replicate.to_deployment("backfill-lake", parameters={"workers": 1}).apply()

def look():
    report = watch(str(scans), lake, settle_seconds=0)
    with get_client(sync_client=True) as client:
        runs = client.read_flow_runs(deployment_filter=DeploymentFilter(id=DeploymentFilterId(any_=[id])))
    return {"report": dataclasses.asdict(report), "runs": {str(run.id): run.parameters for run in runs}}

said = [look(), look()]
for memory in (place / "lake" / "looks").iterdir():
    memory.unlink()
said.append(look())
write_scan(scans, "scene0001_00")
said.append(look())
with get_client(sync_client=True) as client:
    client.set_flow_run_state(UUID(said[0]["report"]["run"]), Cancelled(), force=True)
said.append(look())
dry = watch(str(scans), lake, settle_seconds=0, dry_run=True)
try:
    watch(str(write_scans(place / "others", 1)), lake, settle_seconds=0, deployment="replicate/nothing")
except InputError as error:
    said.append(str(error))
for memory in (place / "lake" / "looks").iterdir():
    memory.unlink()
said.append(look())
(write_scan(scans, "scene0002_00"), (scans / "scene0002_00" / "scene0002_00_vh_clean_2.ply").write_bytes(b"ply\\n"))
look()
for path in (place / "lake" / "looks").iterdir():
    memory = json.loads(path.read_bytes())
    for entry in memory["scans"].values():
        if "incomplete" in entry:
            entry["incomplete"] -= 2 * 86400
    path.write_text(json.dumps(memory))
states = [watch(str(scans), lake, settle_seconds=0, return_state=True) for _ in range(2)]
said.append([[state.type.value, state.message] for state in states])
print(json.dumps(said))
"""


@pytest.mark.slow
@pytest.mark.whole
def test_a_deployment_is_asked_once_for_what_was_found(prefect: PrefectServer, tmp_path: Path) -> None:
    environment = os.environ | {
        **prefect.access,
        "PREFECT_HOME": str(tmp_path / "home"),
        "METASCENES_CACHE": str(tmp_path / "cache"),
    }
    done = subprocess.run([sys.executable, "-c", _ASKS, str(tmp_path)], cwd=REPOSITORY, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    first, second, forgotten, another, cancelled, refused, back, ends = json.loads(done.stdout.splitlines()[-1])
    run = first["report"]["run"]
    assert list(first["runs"]) == [run]
    wanted = {"scans": str(tmp_path / "scans"), "lake": str(tmp_path / "lake"), "scenes": ["scannet/scene0000_00"], "workers": 1}
    assert first["runs"][run] == wanted
    assert first["report"]["new"] == first["report"]["asked"] == ["scannet/scene0000_00"]
    assert (second["report"]["asked"], list(second["runs"])) == ([], [run])
    assert (forgotten["report"]["run"], list(forgotten["runs"])) == (run, [run]), "without its memory it asks for the same run"
    assert another["report"]["asked"] == ["scannet/scene0001_00"]
    (fresh,) = set(another["runs"]) - {run}
    assert another["runs"][fresh]["scenes"] == ["scannet/scene0001_00"]
    assert cancelled["report"]["asked"] == ["scannet/scene0000_00"], "its run was cancelled, the other's is under way"
    assert len(cancelled["runs"]) == 3
    request = urllib.request.Request(f"{prefect.url}/artifacts/filter", b"{}", {"Content-Type": "application/json", **prefect.header})
    with urllib.request.urlopen(request, timeout=600) as reply:
        artifacts = [one for one in json.load(reply) if one["key"] == artifact_key("arrivals", str(tmp_path / "lake"))]
    tables = [json.loads(one["data"]) for one in sorted(artifacts, key=lambda one: one["created"])]
    assert [(row["scan"], row["state"]) for row in tables[0]] == [("scannet/scene0000_00", "new")]
    *_, remembered, _ = (table for table in tables if len(table) == 2)  # the last of them is without memory again
    assert [row["scan"] for row in remembered] == ["scannet/scene0000_00", "scannet/scene0001_00"]
    assert remembered[1]["why"].startswith("run ")
    assert tables[-1][0]["scan"] == "scannet/scene0002_00", "what somebody is to be told comes first"
    assert back["report"]["run"] not in cancelled["runs"], "the run that the request once gave has ended"
    assert [kind for kind, _ in ends] == ["FAILED", "COMPLETED"], "once a day"
    assert ends[0][1].startswith("1 scan incomplete for more than a day: scannet/scene0002_00: ")
    assert (
        refused == "--deployment: replicate/nothing: the Prefect server does not know it; metascenes deploy sets up replicate/backfill-lake"
    )


def command(scans: Path, lake: str, *options: str, **environment: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "flows.cli", "watch", "--scans", str(scans), "--lake", lake, *options]
    return subprocess.run(line, cwd=REPOSITORY, env=os.environ | environment, capture_output=True, text=True, timeout=550)


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_looks_and_says_what_it_saw(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    done = command(scans, lake.address, "--once", "--dry-run", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(json.loads(done.stdout)["waiting"]) == ["scannet/scene0000_00", "scannet/scene0001_00"]
    assert not lake.storage.names("lake.json"), "a dry run writes nothing"
    record(scans, lake)
    done = command(scans, lake.address, "--once", "--settle", "0")
    assert (done.returncode, done.stdout, done.stderr) == (0, "2 scans: 2 known\n", "")
    (scans / "scene0000_00" / "x.part").write_bytes(b"")
    done = command(scans, lake.address, "--once", "--settle", "0")
    assert done.stdout.splitlines()[-1] == "2 scans: 1 waiting, 1 known"
    assert "waiting: x.part is still being copied" in done.stdout
    for wrong in (("--every", "0"), ("--settle", "-1"), ("--deployment", "replicate/backfill")):
        assert command(scans, lake.address, "--once", *wrong, PREFECT_API_URL="").returncode == 2
    assert command(tmp_path / "nowhere", lake.address, "--once").returncode == 2


@pytest.mark.slow
def test_the_command_computes_what_arrives_and_leaves_the_rest(tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    (scans / "scene0001_00" / "scene0001_00_vh_clean_2.ply").write_bytes(b"ply\n")
    done = command(scans, lake.address, "--once", "--settle", "0", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["asked"], report["run"], list(report["waiting"])) == (["scannet/scene0000_00"], HERE, ["scannet/scene0001_00"])
    done = command(scans, lake.address, "--once", "--settle", "0")
    assert done.stdout.splitlines()[-1] == "2 scans: 1 waiting, 1 known"
    assert {scene for scene, _ in lake.history()} == {"scannet/scene0000_00"}


_HERE = """
import dataclasses, json, sys
from flows.watch import watch
state = watch(sys.argv[1], sys.argv[2], settle_seconds=0, deployment=None, return_state=True)
print(json.dumps([state.type.value, dataclasses.asdict(state.result(raise_on_failure=False))]))
"""


@pytest.mark.slow
def test_without_a_deployment_the_flow_computes_by_itself(prefect: PrefectServer, tmp_path: Path, lake: Lake) -> None:
    scans = write_scans(tmp_path / "scans", 2)
    mesh = scans / "scene0001_00" / "scene0001_00_vh_clean_2.ply"
    mesh.write_bytes(mesh.read_bytes().replace(b"element vertex", b"element broken", 1))
    environment = os.environ | {**prefect.access, "PREFECT_HOME": str(tmp_path / "home")}
    said = []
    for _ in range(2):
        line = [sys.executable, "-c", _HERE, str(scans), lake.address]
        done = subprocess.run(line, cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=550)
        assert done.returncode == 0, done.stderr
        said.append(json.loads(done.stdout.splitlines()[-1]))
    (kind, first), (again, second) = said
    assert (kind, again) == ("FAILED", "COMPLETED")
    assert first["asked"] == ["scannet/scene0000_00", "scannet/scene0001_00"]
    assert first["failures"][0].startswith("scannet/scene0001_00: capture: ")
    assert (second["known"], list(second["failed_before"]), second["asked"]) == (1, ["scannet/scene0001_00"], [])
