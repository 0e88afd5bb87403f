"""The benchmark of the flows: its scenes are scans like any other, and its figures follow from what it saw."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import re
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.flows import report as reporting
from bench.flows.chaos import Chaos, Kill, _is_said
from bench.flows.overhead import speed_up
from bench.flows.projection import Prices, projection
from bench.flows.report import FlowsBench, added_share, goals, real_share, steps_of
from bench.flows.requests import Requests, kind_of
from bench.flows.runs import (
    PLAIN,
    Figures,
    MemorySample,
    Samples,
    _keeping_to,
    command_of,
    figures_of,
    gaps_of,
    measured_run,
    sampled,
    surroundings,
)
from bench.flows.scale import ScaleBench, exponents, run_scale_bench
from bench.flows.sharing import Sharing
from bench.flows.small_scenes import SETTINGS, write_crowded_scan, write_small_scans
from bench.flows.tables import print_flows, print_scale
from bench.flows.verdicts import LakeVerdict
from bench.flows.warm_scenes import WarmScene, warm_goals, warm_scenes
from flows.commands.bench import command
from flows.run.configuration import configure
from schemas.errors import LakeError
from schemas.runs import StageRun
from tasks.capture.formats import find_scans
from tasks.pipeline import SCENE_STAGES
from tests.samples import fingerprint, stage_run
from tests.services import have_been_started
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole

SOUND = LakeVerdict((), (), (), (), (), ())


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_same_seed_and_number_give_the_same_bytes(tmp_path: Path) -> None:
    whole = contents(write_small_scans(tmp_path / "whole", 4, seed=7))
    write_small_scans(tmp_path / "parts", 3, seed=7, first=1)
    assert contents(write_small_scans(tmp_path / "parts", 1, seed=7)) == whole
    assert contents(write_small_scans(tmp_path / "others", 4, seed=8)).keys() == whole.keys()
    meshes = [content for name, content in whole.items() if name.endswith(".ply")]
    others = [content for name, content in contents(tmp_path / "others").items() if name.endswith(".ply")]
    assert len({*meshes, *others}) == 8, "every room is another one"


def test_small_scans_are_scans_and_the_settings_are_accepted(tmp_path: Path) -> None:
    found, unusable = find_scans(write_small_scans(tmp_path, 3))
    assert unusable == []
    assert [scan.scene_id for scan in found] == [f"scannet/scene000{number}_00" for number in range(3)]
    short, usual = configure(None, SETTINGS).stages, configure(None, ()).stages
    changed = {name for name in usual if short[name] != usual[name]}
    assert changed == {setting.split(".")[0] for setting in SETTINGS}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Figures, float]:
    """Two small scenes by the plain loop: their lake, its figures, and how long a clock says that it took."""
    folder = tmp_path_factory.mktemp("plain")
    scans = write_small_scans(folder / "scans", 2)
    clock = time.perf_counter()
    figures = measured_run(PLAIN, scans, folder / "lake", 2, folder)
    return folder / "lake", figures, time.perf_counter() - clock


@pytest.mark.slow
def test_figures_are_those_of_the_lake_and_the_clock(plain: tuple[Path, Figures, float]) -> None:
    lake, figures, seconds = plain
    runs = Lake.open(lake).snapshot().rows(StageRun)
    assert {(run.stage, run.outcome) for run in runs} == {(stage.name, "done") for stage in SCENE_STAGES}
    assert (figures.scenes, figures.workers, figures.stage_runs) == (2, 2, 2 * len(SCENE_STAGES))
    assert figures.stage_seconds == pytest.approx(sum(run.seconds for run in runs))
    parts = figures.startup_seconds + figures.work_seconds + figures.ending_seconds
    assert parts == pytest.approx(figures.seconds, abs=0.01)
    assert min(figures.startup_seconds, figures.work_seconds, figures.ending_seconds) > 0
    assert figures.seconds <= seconds
    assert figures.overhead_seconds * figures.stage_runs + figures.stage_seconds == pytest.approx(2 * figures.work_seconds)
    assert 20 < figures.peak_memory_mb < 2000
    assert 0 < figures.cpu_seconds < figures.seconds * 2


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_plain_loop_and_the_flow_give_the_same_lake(plain: tuple[Path, Figures, float], tmp_path: Path) -> None:
    """Otherwise one would be held against something else."""
    have_been_started(tmp_path / "prefect")
    measured_run("pool", plain[0].parent / "scans", tmp_path / "lake", 1, tmp_path)
    assert digests(Lake.open(tmp_path / "lake").snapshot()) == digests(Lake.open(plain[0]).snapshot())


def test_a_run_that_fails_is_no_measurement(tmp_path: Path) -> None:
    scans = write_small_scans(tmp_path / "scans", 1)
    with pytest.raises(LakeError, match=r"ended with [12].*no_such_field"):
        measured_run(PLAIN, scans, tmp_path / "lake", 1, tmp_path, ("capture.no_such_field=1",))


def test_overhead_is_what_the_workers_did_not_spend_in_stages(tmp_path: Path) -> None:
    """A lake whose times are known: two workers, 10 s from the first stage to the commit, 12 s in stages."""
    lake = Lake.open(tmp_path / "lake")
    start = datetime.now(UTC) - timedelta(seconds=10)
    for number in range(4):
        run = stage_run(f"demo/scene{number}", "capture", fingerprint(number))
        lake.stage_rows(dataclasses.replace(run, started_at=start + timedelta(seconds=number), seconds=3.0, row_counts=()))
    lake.commit()
    found = figures_of(lake, "pool", 2, start.timestamp() - 5, 20.0, 0.0, Samples())
    assert found.startup_seconds == pytest.approx(5)
    assert found.work_seconds == pytest.approx(10, abs=2)
    assert found.overhead_seconds == pytest.approx((2 * found.work_seconds - 12) / 4)
    assert found.share == pytest.approx(1 - 12 / (2 * found.work_seconds))


def figures(
    seconds: float = 10.0, workers: int = 2, samples: tuple[MemorySample, ...] = (), scenes: int = 1000, runner: str = "pool"
) -> Figures:
    return Figures(
        runner=runner, scenes=scenes, workers=workers, stage_runs=7 * scenes, seconds=seconds + 8, startup_seconds=5.0,
        work_seconds=seconds, ending_seconds=3.0, stage_seconds=0.9 * workers * seconds, cpu_seconds=1.0, load=0.0, samples=samples,
    )  # fmt: skip


@given(slope=st.floats(-5, 5), level=st.floats(50, 500), scenes=st.integers(1, 10_000))
def test_growth_is_the_slope_of_the_second_half(slope: float, level: float, scenes: int) -> None:
    """The first half, start-up and the ending may do what they like."""
    inside = [MemorySample(5 + 100 * k / 200, level + slope * k, 0.0) for k in range(100, 201)]
    wild = [MemorySample(second, 5000.0 * (second % 2), 0.0) for second in (0.0, 1.0, 20.0, 54.9, 105.5, 107.0)]
    found = figures(100.0, samples=(*wild, *inside), scenes=scenes).growth_mb
    assert found == pytest.approx(slope * 200 / scenes * 1000, abs=1e-3 * 1000 / scenes)
    assert figures(100.0, samples=tuple(inside[:19])).growth_mb is None


def test_memory_of_a_process_is_seen_while_it_runs() -> None:
    code = "import time; held = bytearray(b'1') * 200_000_000; time.sleep(3)"
    process = subprocess.Popen([sys.executable, "-c", code])
    with sampled(process.pid) as watched:
        process.wait()
    assert max(sample.memory_mb for sample in watched.samples) == pytest.approx(210, abs=30)
    assert [s.seconds for s in watched.samples] == sorted(s.seconds for s in watched.samples)


def test_the_speed_up_compares_medians() -> None:
    timed = [figures(seconds, workers) for seconds, workers in ((20, 1), (11, 2), (30, 1), (9, 2), (22, 1), (100, 2))]
    assert speed_up(timed) == pytest.approx(22 / 11)


def whole_report(**changes: object) -> dict:
    """A report in which every goal is met, but for what is changed."""
    samples = tuple(MemorySample(5 + k, 200.0, 800.0) for k in range(100))
    made = [reporting._plain(figures(100.0, samples=samples, runner=runner)) for runner in (PLAIN, "pool", "dask")]
    real = reporting._plain(figures(700.0, workers=1, scenes=10))
    timed = [figures(30, 1, scenes=100), figures(15, 2, scenes=100)]
    speed = [reporting._plain(one) for one in timed]
    sharing = Sharing(9, 3, 10.0, (0, 0), (4, 5), (1, 2), (), (), SOUND)
    kills = (Kill("worker", 1.0, 1), Kill("run", 2.0, 1), Kill("database", 3.0, 2))
    chaos = Chaos(50, 99.0, (-9, 1, 0), kills, ("a: capture",), (), (), 0, SOUND)
    report = {
        "machine": {"processor": "a", "cores": 2, "system": "b", "python": "3", "versions": {}}, "seed": 0, "workers": 2,
        "startup": {"import": 1.0}, "real": real, "overhead": made, "speed": speed,
        "speed_up": speed_up(timed), "room_speed": speed, "room_speed_up": speed_up(timed),
        "scene": [dataclasses.asdict(WarmScene(25, cores, {"capture": 4.0, "exports": 2.0 / cores})) for cores in (1, 2)],
        "sharing": dataclasses.asdict(sharing), "chaos": dataclasses.asdict(chaos),
    }  # fmt: skip
    report |= changes
    report["goals"] = goals(report)
    return report


def missed(report: dict) -> list[str]:
    return [one["goal"] for one in report["goals"] if one["met"] is not True]


def test_goals_are_missed_by_what_they_are_about() -> None:
    good = whole_report()
    assert missed(good) == []
    sharing, chaos = good["sharing"], good["chaos"]
    broken = dataclasses.asdict(dataclasses.replace(SOUND, doubled=("episodes",)))
    assert len(missed(whole_report(sharing=sharing | {"codes": (0, 1)}))) == 1
    assert len(missed(whole_report(sharing=sharing | {"both": ("a",)}))) == 1
    assert len(missed(whole_report(sharing=sharing | {"verdict": broken}))) == 1
    assert len(missed(whole_report(chaos=chaos | {"verdict": broken}))) == 1
    for change in ({"codes": (0, 1)}, {"hung": 1}, {"redone": ("a",)}, {"unsaid": ("a",)}, {"kills": ()}, {"lost": ()}):
        assert len(missed(whole_report(chaos=chaos | change))) == 1, change
    assert missed(whole_report(speed_up=1.79)) == ["small scenes: two workers are so many times as fast as one on one core"]
    assert missed(whole_report(room_speed_up=1.79)) == ["rooms: two workers are so many times as fast as one on one core"]
    slow_scene = [dataclasses.asdict(WarmScene(objects, cores, {"capture": 15.0 / cores})) for objects in (25, 45) for cores in (1, 2)]
    assert missed(whole_report(scene=slow_scene)) == ["a scanned room of 25 objects on two cores [s]"], "on one core there is no goal"
    large = [one | {"peak_memory_mb": 2500.0, "growth_mb": 150.0} for one in good["overhead"]]
    assert len(missed(whole_report(overhead=large))) == 2
    slow = [one | {"overhead_seconds": 1.0} for one in good["overhead"]]
    assert len(missed(whole_report(overhead=slow))) == 2, "the plain loop has no goal of its own"
    slower = [one | {"overhead_seconds": 0.004 if one["runner"] == "pool" else 0.002} for one in good["overhead"]]
    assert missed(whole_report(overhead=slower)) == ["what Prefect adds to a plain loop, its share of 1,000 small scenes' run"]


def test_what_is_added_is_held_against_the_plain_loop_over_the_same_scenes() -> None:
    plain = {"runner": PLAIN, "scenes": 10, "overhead_seconds": 0.02}
    one = {"runner": "dask", "scenes": 10, "overhead_seconds": 0.05, "stage_runs": 70, "work_seconds": 6.0, "workers": 2}
    assert added_share(one, [{**plain, "scenes": 100, "overhead_seconds": 9.0}, plain, one]) == pytest.approx(0.03 * 70 / 12)


def test_the_share_of_a_real_run_is_that_of_its_stages() -> None:
    assert real_share({"overhead_seconds": 0.05}, {"stage_seconds": 70.0, "stage_runs": 70}) == pytest.approx(0.05 / 1.05)


def test_a_report_is_printed_whole_and_fits_json() -> None:
    report = whole_report()
    file = io.StringIO()
    print_flows(report, Console(file=file, width=200))
    said = " ".join(file.getvalue().split())  # a title is as wide as its table
    for words in ("before the first stage", "overhead per stage run", "memory [MB]", "one core and two", "two runs at once over 9 scenes",
                  "chaos: 3 kills (1 database, 1 run, 1 worker)", "goals"):  # fmt: skip
        assert words in said
    assert "all 6.0 5.0" in said, "seconds of a scene, on one core and on two"
    assert file.getvalue().count("\n") > 30
    assert json.loads(json.dumps(report))["overhead"][1]["share"] == pytest.approx(0.1)


@pytest.mark.parametrize("line", ["x scannet/a_00: capture: worker lost, attempt 1", "scannet/a_00: capture: worker lost"])
def test_a_lost_worker_is_told_by_a_line_of_its_own(line: str) -> None:
    assert _is_said("scannet/a_00: capture", f"one\n{line}\ntwo")
    assert not _is_said("scannet/b_00: capture", line)
    assert not _is_said("scannet/a_00: exports", line)


def test_commands_are_those_that_a_person_types_and_leave_nothing_of_theirs_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:1/api")
    monkeypatch.setenv("METASCENES_LAKE", "elsewhere")
    around = surroundings(tmp_path)
    assert not {"PREFECT_API_URL", "METASCENES_LAKE"} & set(around)
    assert {around[name].startswith(str(tmp_path)) for name in ("PREFECT_HOME", "METASCENES_CACHE")} == {True}
    typed = command_of("dask", tmp_path, tmp_path / "lake", 3)
    assert typed[1:4] == ["-m", "flows.cli", "run"]
    assert typed[typed.index("--runner") + 1] == "dask"
    assert typed.count("--set") == len(SETTINGS)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--scenes", "ten"), ("--scenes", "0"), ("--runners", "fork"), ("--parts", "all")],
)
def test_misuse_is_told(option: str, value: str) -> None:
    done = CliRunner().invoke(command, ["flows", option, value])
    assert done.exit_code == 2
    assert option in done.output
    assert value in done.output


def test_steps_are_counted() -> None:
    assert steps_of(FlowsBench(parts=("startup",))) == 2
    assert steps_of(FlowsBench(scenes=(10, 100), runners=("pool",), parts=("overhead",))) == 1 + 1 + 2 * 2


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_benchmark_runs_as_a_command(tmp_path: Path) -> None:
    asked = ["bench", "flows", "--scenes", "3", "--runners", "pool", "--parts", "startup,overhead,sharing", "--json"]
    done = subprocess.run([sys.executable, "-m", "flows.cli", *asked], capture_output=True, text=True, timeout=1800)
    assert done.returncode in (0, 1), done.stderr
    report = json.loads(done.stdout)
    assert [one["runner"] for one in report["overhead"]] == [PLAIN, "pool"]
    assert [one["met"] for one in report["goals"] if re.match("two runs at once", one["goal"])] == [True] * 3
    assert min(report["startup"].values()) > 0


def test_a_crowded_hall_is_a_scan_with_so_many_objects(tmp_path: Path) -> None:
    for objects in (1, 5, 30):
        found, unusable = find_scans(write_crowded_scan(tmp_path / str(objects), objects))
        assert (len(found), unusable) == (1, [])
        groups = json.loads((tmp_path / str(objects) / "scene0000_00" / "scene0000_00.aggregation.json").read_text())["segGroups"]
        assert len(groups) == objects + 6


def sizes(power: float, *counts: int) -> list[dict[str, object]]:
    return [{"size": n, "stages": {"steep": {"cpu_seconds": 1e-4 * n**power}, "short": {"cpu_seconds": 1e-6 * n**3}}} for n in counts]


@given(power=st.floats(1.5, 3))
def test_the_power_that_seconds_grow_with_is_found(power: float) -> None:
    assert exponents(sizes(power, 30, 100, 300)) == {"steep": pytest.approx(power), "short": pytest.approx(3)}
    assert exponents(sizes(power, 30, 300)) == {}, "two sizes make any line"
    assert exponents(sizes(power, 5, 10, 30)) == {} or power > 2


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_warm_scene_is_timed_by_stage_on_one_core_and_on_two(tmp_path: Path) -> None:
    told: list[str] = []
    measured = warm_scenes(tmp_path / "scene", 0, told.append, sizes=(6,))
    assert [scene.objects for scene in measured] == [6] * len(told)
    assert [scene.cores for scene in measured] == [1, 2][: os.cpu_count()]
    for scene in measured:
        assert list(scene.seconds) == [stage.name for stage in SCENE_STAGES]
        assert min(scene.seconds.values()) > 0
    assert warm_goals([dataclasses.asdict(scene) for scene in measured]) == [], "rooms of six have none"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_scale_is_measured_by_stage(tmp_path: Path) -> None:
    report = run_scale_bench(ScaleBench(objects=(2,), scenes=(1, 2), requests=(1, 2), held=(2, 3)), folder=tmp_path)
    for what, counts in (("objects", (2,)), ("scenes", (1, 2))):
        assert tuple(one["size"] for one in report[what]["sizes"]) == counts
        for one in report[what]["sizes"]:
            assert set(one["stages"]) == {"plan", "commit", "plan again", *(stage.name for stage in SCENE_STAGES)}
            assert all(part["cpu_seconds"] > 0 and 50 < part["memory_mb"] < 4000 for part in one["stages"].values())
        assert report[what]["exponents"] == {}
        for one in report[what]["sizes"]:
            held = one["holds"]["bytes"]
            assert all(held[name] > 0 for name in ("capture", "candidates", "exports", "stage_runs", "other"))
            assert held["training"] == 0, "nothing trains here"
    for one in report["requests"]:
        asked = {name: part["requests"] for name, part in one["stages"].items()}
        assert asked["captions"]["put"] == 2 * one["size"], "a file of rows, and the run's own"
        assert asked["plan"]["put"] == asked["plan again"]["put"] == 0
        assert asked["commit"]["delete"] >= sum(1 for name in asked if name not in ("plan", "commit", "plan again")) * one["size"]
    for one, count in zip(report["held"], (2, 3), strict=True):
        assert one["size"] == count
        assert set(one["stages"]) == {"plan", "commit", "plan again", *(stage.name for stage in SCENE_STAGES)}
        assert one["holds"]["bytes"]["capture"] > report["scenes"]["sizes"][-1]["holds"]["bytes"]["capture"], "those it held, and its own"
    assert (report["steep"], report["goals"][0]["met"]) == ([], None), "too few sizes to say"
    shown = io.StringIO()
    print_scale(report | {"steep": ["objects: navigation"]}, Console(file=shown, width=160))
    assert "grows faster than linearly: objects: navigation" in shown.getvalue()
    assert CliRunner().invoke(command, ["scale", "--objects", "x"]).exit_code == 2
    assert "no more than 200" in CliRunner().invoke(command, ["scale", "--requests", "10,300"]).output
    assert "25 near-empty scenes in a lake that holds so many others" in shown.getvalue()
    assert "requests to a store of objects, 2 near-empty scenes" in shown.getvalue()
    assert list(tmp_path.iterdir()) == []


@given(st.lists(st.tuples(st.sampled_from(["a", "b", "c"]), st.floats(0, 9), st.floats(0, 99)), min_size=1, max_size=20))
def test_workers_are_in_a_stage_between_two_or_at_an_end(taken: list[tuple[str, float, float]]) -> None:
    clocks: dict[str, float] = {}
    runs = []
    for number, (host, pause, seconds) in enumerate(taken):
        begun = clocks.get(host, 0.0) + pause
        clocks[host] = begun + seconds
        run = stage_run(f"demo/{number}", "captions", fingerprint(number))
        began = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=begun)
        runs.append(dataclasses.replace(run, host=host, started_at=began, seconds=seconds))
    between, edge = gaps_of(runs)
    first, last = min(run.started_at for run in runs), max(run.started_at + timedelta(seconds=run.seconds) for run in runs)
    whole = (last - first).total_seconds() * len(clocks)
    assert between + edge + sum(run.seconds for run in runs) == pytest.approx(whole, abs=1e-3)


@pytest.mark.parametrize(
    ("method", "query", "kind"),
    [("GET", "", "get"), ("GET", "list-type=2&prefix=a", "list"), ("GET", "prefix=a&x=1", "list"), ("GET", "versionId=1", "get"),
     ("HEAD", "", "head"), ("PUT", "", "put"), ("POST", "uploads", "put"), ("DELETE", "", "delete")],
)  # fmt: skip
def test_requests_are_of_the_kind_that_stores_charge_for(method: str, query: str, kind: str) -> None:
    requests = Requests()
    requests.part = "capture"
    requests.note(method, query)
    assert kind_of(method, query) == kind
    assert requests.of("capture") == {name: int(name == kind) for name in ("put", "get", "list", "head", "delete")}
    assert sum(requests.of("captions").values()) == 0


@given(
    stage=st.integers(0, 50), own=st.integers(0, 50), fixed=st.integers(0, 500), seconds=st.floats(0.1, 99), size=st.integers(1, 10**6),
    scenes=st.integers(1, 10**7), dear=st.floats(0.1, 9),
)  # fmt: skip
def test_more_scenes_are_taken_to_be_like_those_that_were_measured(
    stage: int, own: int, fixed: int, seconds: float, size: int, scenes: int, dear: float
) -> None:
    def counted(number: int) -> dict[str, object]:
        asked = {"capture": stage * number, "commit": fixed + own * number, "plan": 7, "plan again": 8}
        kinds = ("put", "get", "list", "head", "delete")
        return {"size": number, "stages": {name: {"requests": dict.fromkeys(kinds, value)} for name, value in asked.items()}}

    parts = {"capture": {"cpu_seconds": seconds * 100}, "plan": {"cpu_seconds": 5.0}, "commit": {"cpu_seconds": 6.0}}
    measured = {"size": 100, "stages": parts, "holds": {"files": 3, "bytes": {"capture": 100 * size, "other": 0}}}
    report = {"scenes": {"sizes": [measured]}, "requests": [counted(10), counted(30)]}
    found = projection(report, scenes, Prices(core_hour=dear, thousand_puts=1.0, thousand_gets=0.0, gb_month=1.0))
    assert found["core_hours"] == pytest.approx(scenes * seconds / 3600)
    assert found["core_usd"] == pytest.approx(scenes * seconds / 3600 * dear)
    assert found["month_usd"] * 1e9 == pytest.approx(found["bytes"]) == pytest.approx(scenes * size)
    assert found["put"] == found["get"] == pytest.approx(scenes * (stage + own + fixed / 25), abs=1e-3)
    assert found["requests_usd"] == pytest.approx((found["put"] + found["list"]) / 1000)


@pytest.mark.parametrize("cores", [None, 1])
def test_a_run_and_its_children_are_kept_to_cores(cores: int | None) -> None:
    code = "import os, subprocess, sys; print(len(os.sched_getaffinity(0))); sys.stdout.flush(); "
    nested = code + f"subprocess.run([sys.executable, '-c', {code!r}])"
    done = subprocess.run([sys.executable, "-c", nested], preexec_fn=_keeping_to(cores), capture_output=True, text=True, check=True)
    wanted = cores or len(os.sched_getaffinity(0))
    assert done.stdout.split() == [str(wanted)] * 2
