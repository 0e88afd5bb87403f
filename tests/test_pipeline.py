"""The whole path from scans to exports as a person runs it: the command line, a real Prefect server, a real lake."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from bench.flows.small_scenes import SETTINGS
from flows.cli import EXIT_CODES
from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.optimization import Placement
from schemas.selection import Selection
from tasks.geometry.transforms import flat, translation
from tasks.pipeline import SCENE_STAGES, STAGES, upstream
from tests.samples import fingerprint, sample, stage_run
from tests.scans import OBJECTS, write_scan
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole

STAGE_NAMES = [stage.name for stage in SCENE_STAGES]
OBJECT = OBJECTS[1:2]
QUICK = [word for setting in SETTINGS if not setting.startswith(("capture.", "exports.")) for word in ("--set", setting)]
"""Settings of every run here: short stages, of which the scan is read and the exports are made and checked as ever."""


@pytest.fixture(scope="session")
def home(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment with an empty home, as a new user has it; shared, so that Prefect's database is made once."""
    folder = tmp_path_factory.mktemp("home")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    return {**kept, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / ".cache")}


def metascenes(home: dict[str, str], *arguments: object, timeout: float = 600) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "flows.cli", *map(str, arguments)]
    return subprocess.run(command, env=home, capture_output=True, text=True, timeout=timeout)


def run(home: dict[str, str], scans: Path, lake: Path, *more: object) -> subprocess.CompletedProcess[str]:
    return metascenes(home, "run", "--scans", scans, "--lake", lake, *QUICK, *more)


def write_rooms(folder: Path) -> Path:
    """Scans of a room with three objects and of one with a single object: most of a run goes into candidates, by object."""
    write_scan(folder, "scene0000_00", objects=OBJECTS[:3])
    write_scan(folder, "scene0001_00", size=(4.5, 3.2, 2.5), objects=OBJECT)
    return folder


@pytest.fixture(scope="session")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rooms(tmp_path_factory.mktemp("scans"))


@pytest.fixture(scope="session")
def lake(home: dict[str, str], scans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake of two scenes, run without disturbance on two workers. Tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("lake") / "lake"
    done = run(home, scans, folder, "--workers", 2)
    assert done.returncode == 0, done.stderr + done.stdout
    return folder


def leftovers(lake: Path) -> list[Path]:
    return [path for name in ("staged", "tmp") if (lake / name).exists() for path in (lake / name).rglob("*") if path.is_file()]


def stale(lake: Path, scans: Path, home: dict[str, str], *more: object) -> dict[tuple[str, str], str]:
    """What a dry run would compute, and why."""
    said = run(home, scans, lake, "--dry-run", "--json", *more)
    assert said.returncode == 0, said.stderr
    return {(s["scene_id"], s["stage"]): s["why"] for s in json.loads(said.stdout)["steps"] if s["action"] == "run"}


def test_every_stage_of_every_scene_is_done_and_nothing_is_left_behind(lake: Path) -> None:
    found = Lake.open(lake)
    history = found.history()
    assert {key for key, state in history.items() if state.done} == {
        (s, n) for s in ("scannet/scene0000_00", "scannet/scene0001_00") for n in STAGE_NAMES
    }
    assert leftovers(lake) == []
    connection = found.snapshot().connect()
    counts = {
        name: connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0]
        for name in ("scenes", "rooms", "instances", "placements", "export_files")
    }
    assert counts["scenes"] == counts["rooms"] == 2
    assert counts["placements"] == 4, "three objects in one room, one in the other"
    assert connection.execute("SELECT count(*) FROM export_checks WHERE NOT passed").fetchone()[0] == 0
    slots = connection.execute(
        "SELECT count(*), min(n), max(n) FROM (SELECT count(*) AS n FROM candidates GROUP BY scene_id, instance_id)"
    ).fetchone()
    assert slots == (4, 10, 10)


def test_boxes_come_out_where_they_were_put(lake: Path) -> None:
    connection = Lake.open(lake).snapshot().connect()
    rows = connection.execute(
        "SELECT category, box_size, box_volume_m3 FROM instances WHERE scene_id = 'scannet/scene0000_00' AND NOT is_structure"
    ).fetchall()
    found = {category: ([*sorted(size[:2]), size[2]], volume) for category, size, volume in rows}
    for label, size, volume in (
        ("table", (0.7, 1.2, 0.72), 0.6048),
        ("cabinet", (0.45, 0.8, 1.0), 0.36),
        ("chair", (0.45, 0.45, 0.9), 0.18225),
    ):
        assert np.allclose(found[label][0], size, atol=0.03), label
        assert found[label][1] == pytest.approx(volume, rel=0.1)
    area, height = connection.execute("SELECT floor_area_m2, height_m FROM shells WHERE scene_id = 'scannet/scene0000_00'").fetchone()
    assert area == pytest.approx(4.4 * 3.2, rel=0.05)
    assert height == pytest.approx(2.5, abs=0.05)


def test_the_same_run_again_does_nothing_and_leaves_prefect_alone(home: dict[str, str], lake: Path, tmp_path: Path) -> None:
    scans = write_rooms(tmp_path / "scans")  # other files with the same content: content decides, not time stamps
    code = (
        "import sys; from flows.cli import main\n"
        f"sys.argv = ['metascenes', 'run', '--scans', {str(scans)!r}, '--lake', {str(lake)!r}, *{QUICK!r}]\n"
        "try: main()\nexcept SystemExit as end: print('prefect' in sys.modules, end.code)"
    )
    done = subprocess.run([sys.executable, "-c", code], env=home, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said, measured = done.stdout.strip().splitlines()
    assert said == "nothing to do: 2 scenes are up to date"
    assert measured.split() == ["False", "0"]


@pytest.mark.parametrize(
    ("setting", "stage"),
    [("optimization.method.max_moves=77", "optimization"), ("navigation.max_steps=123", "navigation"), ("seed", "capture")],
)
def test_one_changed_value_redoes_exactly_what_depends_on_it(
    home: dict[str, str], lake: Path, scans: Path, setting: str, stage: str
) -> None:
    expected = {stage}
    for other in STAGES:
        if expected & {above.name for above in upstream(other)}:
            expected.add(other.name)
    if setting == "seed":
        expected, options = set(STAGE_NAMES), ("--seed", 5)
    else:
        options = ("--set", setting)
    todo = stale(lake, scans, home, *options)
    assert {name for _, name in todo} == expected & set(STAGE_NAMES)
    assert len({scene for scene, _ in todo}) == 2
    assert all(("seed" if setting == "seed" else "config") in why or "redone" in why for why in todo.values())


@pytest.mark.slow
def test_one_worker_and_two_give_the_same_result(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    done = run(home, scans, tmp_path / "lake", "--workers", 1)
    assert done.returncode == 0, done.stderr
    assert digests(Lake.open(tmp_path / "lake").snapshot()) == digests(Lake.open(lake).snapshot())


@pytest.mark.slow
def test_a_changed_scan_is_redone_and_its_neighbor_is_not(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    changed, copy = tmp_path / "scans", tmp_path / "lake"
    shutil.copytree(scans, changed)
    shutil.copytree(lake, copy)
    shutil.rmtree(changed / "scene0001_00")
    write_scan(changed, "scene0001_00", size=(5.0, 3.4, 2.5), objects=OBJECT, shift=(0.1, 0.0))
    assert {scene for scene, _ in stale(copy, changed, home)} == {"scannet/scene0001_00"}
    before = Lake.open(copy).snapshot()
    done = run(home, changed, copy, "--workers", 2)
    assert done.returncode == 0, done.stderr
    after = Lake.open(copy).snapshot()
    for table in ("instances", "placements", "episodes", "export_files"):
        assert before.arrow(table, "scannet/scene0000_00") == after.arrow(table, "scannet/scene0000_00")
        assert before.arrow(table, "scannet/scene0001_00") != after.arrow(table, "scannet/scene0001_00")
    assert leftovers(copy) == []


def test_a_failing_scene_stops_no_other_and_is_not_computed_again(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    mixed, copy = tmp_path / "scans", tmp_path / "lake"
    shutil.copytree(scans, mixed)
    shutil.copytree(lake, copy)
    broken = write_scan(mixed, "scene0002_00", objects=OBJECT)
    ply = broken / "scene0002_00_vh_clean_2.ply"
    ply.write_bytes(ply.read_bytes()[:-1000])
    write_scan(mixed, "scene0003_00", size=(4.9, 3.2, 2.5), objects=OBJECT)
    (mixed / "scene0004_00").mkdir()
    (mixed / "scene0004_00" / "scene0004_00.aggregation.json").write_text("{}")
    done = run(home, mixed, copy, "--workers", 2)
    assert done.returncode == 1
    failed = [line for line in done.stderr.splitlines() if line.startswith("failed: ")]
    assert len(failed) == 2, done.stderr
    assert any("scene0002_00" in line and "scene0002_00_vh_clean_2.ply" in line for line in failed)
    assert any("scene0004_00" in line for line in failed)
    history = Lake.open(copy).history()
    assert all(history[("scannet/scene0003_00", name)].done for name in STAGE_NAMES)
    before, after = Lake.open(lake).snapshot(), Lake.open(copy).snapshot()
    assert before.arrow("placements", "scannet/scene0000_00") == after.arrow("placements", "scannet/scene0000_00")
    again = run(home, mixed, copy)
    assert again.returncode == 1
    assert sorted(line for line in again.stderr.splitlines() if line.startswith("failed: ")) == sorted(failed)
    assert stale(copy, mixed, home) == {}
    assert {stage for _, stage in stale(copy, mixed, home, "--retry-failed")} == {"capture", *STAGE_NAMES[1:]}


@pytest.mark.slow
def test_an_annotation_redoes_its_scene_from_optimization_on(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    copy = tmp_path / "lake"
    shutil.copytree(lake, copy)
    connection = Lake.open(copy).snapshot().connect()
    scene, instance, asset = connection.execute(
        "SELECT scene_id, instance_id, asset_id FROM selections WHERE rank = 2 ORDER BY scene_id, instance_id LIMIT 1"
    ).fetchone()
    answer = {"scene_id": scene, "instance_id": instance, "annotator": "a1", "answered_at": "2026-01-02T03:04:05+00:00", "choice": asset,
              "transform": None, "ranking": []}  # fmt: skip
    file = tmp_path / "batch.json"
    file.write_text(json.dumps({"batch_id": "batch1", "annotations": [answer]}))
    done = metascenes(home, "annotate", "import", file, "--lake", copy)
    assert done.returncode == 0, done.stderr
    assert "next: " in done.stdout
    assert stale(copy, scans, home) == {}, "nobody has reviewed it"
    review = {"review_id": "r1", "reviewer": "r", "reviewed_at": "2026-01-03T00:00:00Z", "sampled": 1, "wrong": 0, "verdict": "accepted"}
    (tmp_path / "review.json").write_text(json.dumps({"batch_id": "batch1", "reviews": [review]}))
    assert metascenes(home, "annotate", "review", tmp_path / "review.json", "--lake", copy).returncode == 0
    todo = stale(copy, scans, home)
    assert set(todo) == {(scene, name) for name in STAGE_NAMES[STAGE_NAMES.index("optimization") :]}
    assert "annotations" in todo[(scene, "optimization")]
    assert run(home, scans, copy).returncode == 0
    row = Lake.open(copy).snapshot().connect().execute(
        "SELECT asset_id, origin, annotator FROM placements WHERE scene_id = ? AND instance_id = ?", [scene, instance]
    ).fetchone()  # fmt: skip
    assert row == (asset, "annotation", "a1")
    assert "nothing to do" in metascenes(home, "annotate", "import", file, "--lake", copy).stdout
    file.write_text(json.dumps({"batch_id": "batch2", "annotations": [{**answer, "instance_id": "9999"}]}))
    refused = metascenes(home, "annotate", "import", file, "--lake", copy)
    assert refused.returncode == 2
    assert "batch.json" in refused.stderr
    assert "9999" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_no_answer_of_a_returned_batch_reaches_a_scene(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    copy = tmp_path / "lake"
    shutil.copytree(lake, copy)
    store = Lake.open(copy)
    (scene, instance), *_ = store.snapshot().connect().execute(
        "SELECT scene_id, instance_id FROM selections GROUP BY ALL HAVING count(*) > 3 ORDER BY ALL"
    ).fetchall()  # fmt: skip
    ranked = [row.asset_id for row in store.snapshot().rows(Selection, scene) if row.instance_id == instance]
    file = tmp_path / "file.json"

    def annotate(batch: str, day: int, choice: str) -> None:
        answer = {"scene_id": scene, "instance_id": instance, "annotator": "ada", "answered_at": f"2026-01-{day:02d}T03:04:05Z"}
        file.write_text(json.dumps({"batch_id": batch, "annotations": [answer | {"choice": choice}]}))
        trusted = ("--set", "annotation.unreviewed_imports_count=true")
        assert metascenes(home, "annotate", "import", file, "--lake", copy, *trusted).returncode == 0

    def review(batch: str, name: str, day: int, verdict: str) -> None:
        said = {"review_id": name, "reviewer": "rita", "reviewed_at": f"2026-02-{day:02d}T03:04:05Z", "sampled": 1}
        file.write_text(json.dumps({"batch_id": batch, "reviews": [said | {"verdict": verdict, "wrong": int(verdict == "returned")}]}))
        assert metascenes(home, "annotate", "review", file, "--lake", copy).returncode == 0

    def placed() -> tuple[str, str, str | None]:
        """What stands there after a run, which had nothing to do but this scene from the optimization on."""
        assert {key[0] for key in stale(copy, scans, home)} <= {scene}
        done = run(home, scans, copy, "--scene", scene)
        assert done.returncode == 0, done.stderr
        assert stale(copy, scans, home) == {}
        (row,) = [row for row in store.snapshot().rows(Placement, scene) if row.instance_id == instance]
        told = [text for state in store.history({scene}).values() if state.done is not None for text in state.done.degradations]
        assert not [text for text in told if "gone" in text], "an orphaned answer of a returned batch is nothing to mend"
        return row.asset_id, row.origin, row.annotator

    box = {"box_pose": flat(translation([40.0, 0.0, 0.0])), "box_size": (1.0, 1.0, 1.0)}
    orphan = sample(Annotation, batch_id="gone", scene_id=scene, instance_id=instance, annotator="bob", choice=ranked[3], **box)
    store.stage_rows(stage_run("gone", "annotation", fingerprint("gone")), {"annotations": [orphan]})
    store.commit()
    review("gone", "r1", 1, "returned")
    annotate("older", 1, ranked[1])
    annotate("newer", 2, ranked[2])
    review("newer", "r1", 1, "accepted")
    assert placed() == (ranked[2], "annotation", "ada")
    review("newer", "r2", 2, "returned")
    assert placed() == (ranked[1], "annotation", "ada"), "the accepted older batch"
    review("older", "r1", 3, "returned")
    assert placed() == (ranked[0], "selection", None), "as if nobody had answered"
    review("newer", "r3", 4, "accepted")
    assert placed() == (ranked[2], "annotation", "ada"), "reviewed again"


@pytest.mark.slow
def test_a_check_that_an_export_does_not_pass_fails_the_run_and_is_named(
    home: dict[str, str], lake: Path, scans: Path, tmp_path: Path
) -> None:
    copy, scene = tmp_path / "lake", "scannet/scene0000_00"
    shutil.copytree(lake, copy)
    reader = Lake.open(copy).snapshot()
    (first, *rest) = reader.rows(Placement, scene)
    (asset,) = reader.rows_by_key(Asset, [first.asset_id])
    assert first.asset_id not in {row.asset_id for row in [*rest, *reader.rows(Placement, "scannet/scene0001_00")]}
    (file,) = (copy / "blobs").rglob(asset.mesh_blob)
    file.chmod(0o644)
    file.write_bytes(b"no mesh")
    line = f"{scene}: exports: urdf breaks the rule complete: 2 of 3 objects"
    done = run(home, scans, copy, "--set", "exports.default_friction=0.61")
    assert done.returncode == 1, done.stderr
    assert f"failed: {line}" in done.stderr
    assert "2 scenes done" in done.stdout
    assert f"{len(EXPORT_FORMATS)} checks of exports failed" in done.stdout
    again = run(home, scans, copy, "--set", "exports.default_friction=0.61")
    assert (again.returncode, f"failed: {line}" in again.stderr) == (1, True), "said again, as every failure is"
    assert "2 unchanged" in again.stdout
    told = metascenes(home, "status", "--lake", copy).stdout
    assert line in told
    assert f"{len(EXPORT_FORMATS)} checks of exports failed" in told.splitlines()[0]
    assert line in json.loads(metascenes(home, "status", "--lake", copy, "--json").stdout)["broken_checks"]
    broken = json.loads(run(home, scans, copy, "--set", "exports.default_friction=0.61", "--json").stdout)["broken"]
    assert len(broken) == len(EXPORT_FORMATS)


def test_a_statement_that_writes_is_refused_in_one_line(home: dict[str, str], lake: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    refused = metascenes(home, "sql", f"COPY (SELECT 1) TO '{target}'", "--lake", lake)
    assert refused.returncode == 2
    assert len(refused.stderr.strip().splitlines()) == 1
    assert not target.exists()
    asked = metascenes(home, "sql", "SELECT count(*) AS n FROM scenes", "--lake", lake, "--output", "json")
    assert json.loads(asked.stdout) == [{"n": 2}]


def start(home: dict[str, str], lake: Path, scans: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "flows.cli", "run", "--scans", str(scans), "--lake", str(lake), "--workers", "2", *QUICK]
    return subprocess.Popen(
        command,
        env=home,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        # A shell's background job ignores Ctrl-C, and so would all that it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def assert_gone(processes: list[psutil.Process], seconds: float = 10) -> None:
    """What a run had started ends by itself soon after the run."""
    _, alive = psutil.wait_procs(processes, timeout=seconds)
    assert not alive, [process.cmdline() for process in alive]


def killed_runs(home: dict[str, str], lake: Path, scans: Path, undisturbed: Path, trials: int) -> None:
    """Kill a run's coordinator at a random moment, give the same command again, compare; `trials` times.

    Its workers and its server are left to follow it by themselves. The moment is a number of finished stages and a
    time after them, so that it falls into the run however fast the machine is.
    """
    rng = random.Random(7)
    expected = digests(Lake.open(undisturbed).snapshot())
    hit = 0
    for trial in range(trials):
        target = lake / f"trial{trial}"
        process = start(home, target, scans)
        number, delay = rng.randrange(2 * len(STAGE_NAMES)), rng.uniform(0.0, 2.0)
        while process.poll() is None and sum(bool(state.done) for state in Lake.open(target).history().values()) < number:
            time.sleep(0.1)
        time.sleep(delay)
        hit += process.poll() is None
        children = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert_gone(children)
        kept = {key: state.done.started_at for key, state in Lake.open(target).history().items() if state.done}
        done = run(home, scans, target, "--workers", 2)
        assert done.returncode == 0, f"trial {trial}: {done.stderr}"
        assert digests(Lake.open(target).snapshot()) == expected, f"trial {trial}"
        assert leftovers(target) == [], f"trial {trial}"
        after = Lake.open(target).history()
        assert all(after[key].done.started_at == started for key, started in kept.items()), "what was finished is not done again"
    assert hit >= trials / 2, "most kills must fall into the run"


@pytest.mark.parametrize(
    ("number", "codes"), [(signal.SIGINT, {130}), pytest.param(signal.SIGTERM, {143, -signal.SIGTERM}, marks=pytest.mark.slow)]
)
def test_a_signal_ends_a_run_in_the_middle(home: dict[str, str], scans: Path, tmp_path: Path, number: int, codes: set[int]) -> None:
    process = start(home, tmp_path / "lake", scans)
    deadline = time.monotonic() + 120
    while not list((tmp_path / "lake" / "staged").glob("*")) and time.monotonic() < deadline:
        time.sleep(0.1)
    children = psutil.Process(process.pid).children(recursive=True)
    assert children
    os.kill(process.pid, number)
    assert process.wait() in codes
    assert codes & {*EXIT_CODES, -signal.SIGTERM} == codes, "as the help of the command line says"
    assert_gone(children)


def test_a_run_killed_at_a_random_moment_loses_nothing(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    killed_runs(home, tmp_path, scans, lake, trials=1)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_twenty_runs_killed_at_random_moments_lose_nothing(home: dict[str, str], lake: Path, scans: Path, tmp_path: Path) -> None:
    killed_runs(home, tmp_path, scans, lake, trials=20)
