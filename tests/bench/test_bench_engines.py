"""The benchmark of engines: its table from recorded runs, what is not installed, MuJoCo and what is installed on a small scene."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from bench.disorder import certificates_of
from bench.engines import scenes as scenes_module
from bench.engines.report import EnginesBench, report_of, run_engines_bench
from bench.engines.scenes import FILES, SceneChoice, SceneFiles, exported_scenes
from bench.engines.setups import FOREIGN, PYBULLET, RUNS, SETUPS, Setup, interpreters
from bench.engines.simulation import Moved, SceneRuns, distances, simulate
from bench.engines.tables import print_engines
from flows.commands.bench import command
from schemas.errors import InputError
from tasks import exports
from tasks.geometry.transforms import quaternion_wxyz, rotation_of, translation, yaw_pose
from tasks.stage import Context
from tests.replicas import cube, furnished, rows_of
from tests.tasks.exports.usd.test_exports_usd import replica_of
from tests.test_documents import refusal

pytestmark = pytest.mark.whole

BY_NAME = {setup.name: setup for setup in SETUPS}
STILL = Moved((0.0,) * len(RUNS), (0.0,) * len(RUNS))

IN_THE_AIR, ROD = "0007", "0008"
"""Of the small scene: a box half a metre up, and a rod that stands until it is nudged."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SceneFiles:
    """An office in files, with a box in the air and a rod on its end."""
    objects = [
        *furnished(), cube((0.2, 0.2, 0.2), translation([0.4, 0.4, 0.5]), mass_kg=1.0),
        cube((0.01, 0.01, 0.6), yaw_pose(0.0, [2.5, -1.5, 0.0]), mass_kg=0.2, friction=0.9),
    ]  # fmt: skip
    rows, blobs = rows_of(objects)
    replica = replica_of(rows, blobs)
    out = tmp_path_factory.mktemp("small")
    context = Context("demo/room_01", "exports", 0, blobs, defaultdict(dict))
    tables = {table: rows.get(table, []) for table in exports.STAGE.reads}
    outcome = exports.run(**tables, context=context, config=exports.ExportsConfig(formats=tuple(FILES)))
    for row in outcome.rows["export_files"]:
        exports.write_folder(out / row.format, {row.path: outcome.blobs[row.file_blob]})
    free = [body for body in replica.bodies if not body.is_fixed]
    certified = {row.instance_id: row.is_stable_1cm for row in certificates_of(replica) if not row.is_fixed}
    files = {format_: out / format_ / replica.stem / name for format_, name in FILES.items()}
    names, poses = {body.instance_id: body.name for body in free}, {body.instance_id: body.pose for body in free}
    return SceneFiles(replica.scene_id, "test", len(replica.bodies), files, names, poses, certified)


def fell(*runs: str) -> Moved:
    """An object that goes 30 cm and tips by 80 degrees in some runs, and stays in the rest."""
    return Moved(tuple(0.3 * (run in runs) for run in RUNS), tuple(math.radians(80.0) * (run in runs) for run in RUNS))


def recorded(setup: str, moved: Mapping[str, Moved], failure: str | None = None) -> SceneRuns:
    return SceneRuns("demo/a", setup, None if failure else "1.2.3", moved, None if failure else 1e-7, 2.0, failure)


@pytest.fixture
def scene() -> SceneFiles:
    """Three free objects of a scene that was recorded; the last is certified to fall."""
    names = {"0001": "table_0001", "0002": "pillow_0002", "0003": "ball_0003"}
    certified = {"0001": True, "0002": True, "0003": False}
    return SceneFiles("demo/a", "demo", 4, {}, names, dict.fromkeys(names, np.eye(4)), certified)


def printed(report: Mapping[str, object]) -> str:
    stream = io.StringIO()
    head = {
        "machine": {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}, "seed": 0, "processes": 1,
        "seconds": 2.0, "nudge_m_s": 0.05, "left_out": ["the house: [no] folder"],
    }  # fmt: skip
    print_engines(head | report, Console(file=stream, width=200))
    return stream.getvalue()


# --- recorded runs ---------------------------------------------------------------------------------------------------


def test_the_table_counts_what_stays_and_names_who_contradicts_the_certificate(scene: SceneFiles) -> None:
    sound = {"0001": STILL, "0002": STILL, "0003": fell(*RUNS)}
    near = Moved((0.02,) * len(RUNS), (0.0,) * len(RUNS))
    runs = [
        recorded("MuJoCo, shipped", sound),
        recorded("MuJoCo, defaults", {**sound, "0002": fell("nudged -y")}),
        recorded("PyBullet", {**sound, "0002": fell("at rest", "nudged +x"), "0001": near}),
        recorded("PhysX", {**sound, "0003": STILL}),
        recorded("PhysX, warmed up", {**sound, "0003": STILL}),
    ]
    report = report_of([scene], runs)
    rows = {row["engine"]: row for row in report["engines"]}
    assert list(rows) == [setup.name for setup in SETUPS], "all of them, installed or not"
    counts = {name: [row[f"{when}_{key}"] for when in ("rest", "nudged") for key in ("1cm", "5cm")] for name, row in rows.items()}
    assert counts["MuJoCo, shipped"] == [2, 2, 2, 2]
    assert counts["MuJoCo, defaults"] == [2, 2, 1, 1]
    assert counts["PyBullet"] == [0, 1, 0, 1]
    assert counts["PhysX"] == [3, 3, 3, 3]
    lines = {(line["instance"], line["engine"]): line for line in report["disagreements"]}
    assert lines.keys() == {
        ("0002", "MuJoCo, defaults"),
        ("0002", "PyBullet"),
        ("0001", "PyBullet"),
        ("0003", "PhysX"),
        ("0003", "PhysX, warmed up"),
    }
    toppled = lines["0002", "MuJoCo, defaults"]
    assert (toppled["certificate"], toppled["verdict"], toppled["when"]) == ("stable", "moves", "nudged -y")
    assert (toppled["moved_mm"], toppled["tilt_degrees"]) == (pytest.approx(300.0), pytest.approx(80.0))
    assert lines["0002", "PyBullet"]["when"] == "at rest"
    assert (lines["0003", "PhysX"]["certificate"], lines["0003", "PhysX"]["verdict"]) == ("moves", "stable")
    goals = {goal["goal"]: goal for goal in report["goals"]}
    assert len(goals) == len(SETUPS) + 1
    last = goals["objects on which more than one engine contradicts the certificate"]
    assert (last["found"], last["met"]) == (1, False), "PhysX after its warm-up is no second engine"
    assert goals["free objects within 1 cm and 5 degrees, nudged too: PhysX [%]"]["met"]
    text = printed(report)
    for words in (
        "pillow_0002",
        "nudged -y",
        "300.0 mm",
        "80.0 deg",
        "MISSED",
        "the house: [no] folder",
        "impratio 10",
        "those of the file",
    ):
        assert words in text
    json.dumps(report, allow_nan=False)


def test_an_engine_that_is_not_installed_is_named_with_what_installs_it(scene: SceneFiles) -> None:
    report = report_of([scene], [recorded("MuJoCo, shipped", dict.fromkeys(scene.poses, STILL))])
    text = printed(report)
    missing = {row["engine"]: row["missing"] for row in report["engines"] if row["missing"]}
    assert missing.keys() == BY_NAME.keys() - {"MuJoCo, shipped"}
    assert text.count("not installed:") == len(missing)
    for engine in FOREIGN:
        assert f"{engine.install}; then --engine {engine.name}=PYTHON" in missing.values()
    unknown = [goal for goal in report["goals"] if goal["met"] is None]
    assert len(unknown) == len(missing), "neither met nor missed"


def test_a_scene_without_a_result_counts_every_object_as_gone(scene: SceneFiles) -> None:
    far = Moved((math.inf,) * len(RUNS), (math.inf,) * len(RUNS))
    report = report_of([scene], [recorded("PyBullet", dict.fromkeys(scene.poses, far), "ended with code 1: no [such] mesh")])
    row = next(row for row in report["engines"] if row["engine"] == "PyBullet")
    assert (row["rest_1cm"], row["nudged_5cm"], row["version"], row["missing"]) == (0, 0, None, None)
    assert report["failures"] == [["demo/a", "PyBullet", "ended with code 1: no [such] mesh"]]
    assert "no [such] mesh" in printed(report)


def test_every_engine_has_a_lock_or_a_command_of_the_users_own() -> None:
    requirements = Path(__file__).resolve().parents[2] / "requirements"
    assert {engine.name for engine in FOREIGN} == {"pybullet", "newton", "ovphysx"}
    locks = {engine.name for engine in FOREIGN if engine.install == f"pip install -r requirements/{engine.name}.lock"}
    assert locks == {"pybullet", "newton"}
    for name in locks:
        lines = [line for line in (requirements / f"{name}.lock").read_text().splitlines() if not line.startswith("#")]
        assert all(len(line.split("==")) == 2 for line in lines), "versions, no host"
    assert not list(requirements.glob("*ovphysx*")), "it is proprietary"
    scripts = [Path(sys.modules["bench.engines.setups"].__file__ or "").with_name(engine.script or "") for engine in FOREIGN]
    assert all(script.is_file() for script in scripts)


# --- distances -------------------------------------------------------------------------------------------------------


def test_distances_are_of_the_origin_and_of_the_upright_axis() -> None:
    pose = translation([1.0, 2.0, 0.5])
    pose[:3, :3] = rotation_of([0.3, 0.0, 0.0])
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3] @ rotation_of([0.0, 0.0, 1.0]) @ rotation_of([0.0, 0.2, 0.0])
    metres, radians = distances(pose, [1.0, 2.0, 0.53, *quaternion_wxyz(turned)])
    assert metres == pytest.approx(0.03)
    assert radians == pytest.approx(0.2), "a turn about the upright axis is no tilt"
    assert distances(pose, None) == distances(pose, [math.nan, 0, 0, 1, 0, 0, 0]) == (math.inf, math.inf)
    edge = Moved((0.01, 0.0), (math.radians(4.999), math.radians(5.001)))
    assert edge.is_stable(0.01, nudged=False)
    assert not edge.is_stable(0.05, nudged=True)


# --- interpreters ----------------------------------------------------------------------------------------------------


def test_what_is_wrong_with_an_interpreter_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for engine in FOREIGN:
        monkeypatch.delenv(engine.variable, raising=False)
    assert interpreters(()) == {}
    for word in ("bullet=/bin/true", "pybullet", "pybullet="):
        with pytest.raises(InputError, match=r"--engine: names none of pybullet, ovphysx, newton with its interpreter; write pybullet="):
            interpreters((word,))
    with pytest.raises(InputError, match=r"no_such: --engine pybullet: is no program that can be run; .*pybullet\.lock"):
        interpreters((f"pybullet={tmp_path / 'no_such'}",))
    with pytest.raises(InputError, match=r"--engine ovphysx: has no package ovphysx; .*pip install ovphysx==0\.7\.0"):
        interpreters((f"ovphysx={sys.executable}",))
    monkeypatch.setenv(PYBULLET.variable, str(tmp_path / "no_such"))
    with pytest.raises(InputError, match="is no program"):
        interpreters(())
    text = tmp_path / "text"
    text.write_text("no program")
    text.chmod(0o755)
    with pytest.raises(InputError, match="cannot be run"):
        interpreters((f"pybullet={text}",))


def test_an_engine_that_fails_on_a_scene_says_why(small: SceneFiles) -> None:
    runs = simulate(small, BY_NAME["PyBullet"], Path(sys.executable))
    assert runs.failure == "ended with code 1: ModuleNotFoundError: No module named 'pybullet'"
    assert runs.moved.keys() == small.poses.keys()
    assert not any(moved.is_stable(0.05, nudged=False) for moved in runs.moved.values())
    broken = dataclasses.replace(small, files={**small.files, "mjcf": small.files["mjcf"].with_name("no_such.xml")})
    assert "no_such.xml" in (simulate(broken, BY_NAME["MuJoCo, shipped"], None).failure or "")


# --- engines on a small scene ------------------------------------------------------------------------------------------


def assert_falls_and_stands(runs: SceneRuns, scene: SceneFiles) -> None:
    """The box in the air falls, the rod falls when it is nudged, everything else stays; every pose is read as it was written."""
    assert runs.failure is None
    assert runs.apart_m is not None
    assert runs.apart_m < 1e-5
    assert runs.moved.keys() == scene.poses.keys()
    assert runs.moved[IN_THE_AIR].metres[0] == pytest.approx(0.5, abs=0.01)
    assert runs.moved[ROD].is_stable(0.01, nudged=False), runs.moved[ROD]
    assert not any(runs.moved[ROD].stays(0.05, run) for run in range(1, len(RUNS))), runs.moved[ROD]
    rest = {name: moved for name, moved in runs.moved.items() if name not in (IN_THE_AIR, ROD)}
    assert all(moved.is_stable(0.01, nudged=True) for moved in rest.values()), rest
    assert len(rest) == 5


@pytest.mark.parametrize("name", [setup.name for setup in SETUPS if setup.engine.script is None])
def test_mujoco_lets_fall_what_falls_and_stand_what_stands(small: SceneFiles, name: str) -> None:
    runs = simulate(small, BY_NAME[name], None)
    assert_falls_and_stands(runs, small)
    again = simulate(small, BY_NAME[name], None)
    assert again.moved == runs.moved


def test_mujoco_s_two_settings_are_two(small: SceneFiles) -> None:
    shipped, defaults = (simulate(small, BY_NAME[name], None) for name in ("MuJoCo, shipped", "MuJoCo, defaults"))
    assert shipped.moved != defaults.moved


@pytest.mark.slow
@pytest.mark.parametrize("setup", [setup for setup in SETUPS if setup.engine.script is not None], ids=lambda setup: setup.name)
def test_an_installed_engine_lets_fall_what_falls_and_stand_what_stands(small: SceneFiles, setup: Setup) -> None:
    if not os.environ.get(setup.engine.variable):
        pytest.skip(f"{setup.engine.variable} names no interpreter with {setup.engine.package} installed: {setup.engine.install}")
    runs = simulate(small, setup, interpreters(())[setup.engine.name])
    assert runs.failure is None, runs.failure
    pins = Path(__file__).resolve().parents[2] / "requirements" / f"{setup.engine.name}.lock"
    if pins.exists():
        assert f"{setup.engine.package}=={(runs.version or '').split(',')[0]}\n" in pins.read_text()
    assert_falls_and_stands(runs, small)


# --- scenes and the command --------------------------------------------------------------------------------------------


def test_a_folder_without_the_house_is_refused(tmp_path: Path) -> None:
    choice = SceneChoice(tmp_path, demo=0, rooms=0, realdata=tmp_path / "no_such")
    with pytest.raises(InputError, match=r"--realdata: holds no scene_aws_small_house/house\.glb; name the folder that does"):
        exported_scenes(choice, lambda name: None)
    assert choice.steps == 1
    assert choice.left_out == ["3 of the demo's 3 scenes", "10 of 10 generated rooms"]


def test_the_demo_and_the_house_are_made_as_anybody_would(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The house is scanned once; lakes are brought up to date every time, and what they hold is exported by source."""
    realdata = tmp_path / "realdata"
    (realdata / "scene_aws_small_house").mkdir(parents=True)
    (realdata / "scene_aws_small_house" / "house.glb").write_bytes(b"glTF")
    typed: list[list[str]] = []
    exported: list[tuple[str, Path, str]] = []
    monkeypatch.setattr(scenes_module, "_metascenes", lambda *words: typed.append([str(word) for word in words]))
    monkeypatch.setattr(scenes_module, "of_lake", lambda address, out, source: exported.append((address, out, source)) or [])
    choice = SceneChoice(tmp_path, demo=2, rooms=0, realdata=realdata, lake="s3://a/lake", seed=7, processes=3)
    advanced: list[str] = []
    assert exported_scenes(choice, advanced.append) == []
    assert advanced == ["demo", "house", "lake"]
    assert choice.steps == len(advanced)
    assert [words[0] for words in typed] == ["demo", "scan", "run"]
    options = ["--seed", "7", "--workers", "3"]
    assert typed[0] == ["demo", "--out", str(tmp_path / "demo"), "--scenes", "2", *options]
    assert typed[2][-4:] == options
    for words in typed:
        assert refusal(["metascenes", *words]) is None
    assert [(address, source) for address, _, source in exported] == [
        (str(tmp_path / "demo" / "lake"), "demo"), (str(tmp_path / "house" / "lake"), "house"), ("s3://a/lake", "lake"),
    ]  # fmt: skip
    assert len({out for _, out, _ in exported}) == 3
    (tmp_path / "house" / "scans").mkdir(parents=True)
    (tmp_path / "house" / "scans" / "house.truth.json").write_text("{}")
    exported_scenes(choice, advanced.append)
    assert [words[0] for words in typed[3:]] == ["demo", "run"]


def test_a_run_that_fails_ends_the_benchmark_in_its_own_words(tmp_path: Path) -> None:
    (tmp_path / "demo").write_text("no folder")
    with pytest.raises(InputError, match=r"metascenes demo: ended with code \d+: .*; run it alone to see more"):
        exported_scenes(SceneChoice(tmp_path, rooms=0), lambda name: None)


def test_no_scene_at_all_is_refused() -> None:
    done = CliRunner().invoke(command, ["engines", "--demo", "0", "--rooms", "0"], env={"METASCENES_REALDATA": ""})
    assert done.exit_code == 2
    assert "--demo 0 together with --rooms 0: no scene is left" in done.output


@pytest.mark.slow
def test_generated_rooms_go_through_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rooms are made, exported and simulated by MuJoCo; the others are named, and the exit code says whether goals are met."""
    for engine in FOREIGN:
        monkeypatch.delenv(engine.variable, raising=False)
    monkeypatch.delenv("METASCENES_REALDATA", raising=False)
    words = ["engines", "--demo", "0", "--rooms", "1", "--processes", "1", "--folder", str(tmp_path), "--json"]
    done = CliRunner().invoke(command, words)
    report = json.loads(done.stdout)
    assert done.exit_code == int(any(goal["met"] is False for goal in report["goals"]))
    (scene,) = report["scenes"]
    assert scene["source"] == "generated"
    assert scene["objects"] >= scene["free"] >= scene["certified_1cm"] > 10
    rows = {row["engine"]: row for row in report["engines"]}
    assert {name for name, row in rows.items() if row["missing"] is None} == {"MuJoCo, shipped", "MuJoCo, defaults"}
    for name in ("MuJoCo, shipped", "MuJoCo, defaults"):
        assert rows[name]["objects"] == scene["free"]
        assert rows[name]["apart_m"] < 1e-9
        assert rows[name]["rest_1cm"] >= rows[name]["nudged_1cm"] > 0.9 * scene["free"]
    assert report["left_out"][0].startswith("the house: METASCENES_REALDATA")


def test_runs_come_in_the_order_of_the_table_whatever_ends_first(small: SceneFiles) -> None:
    config = EnginesBench(SceneChoice(Path("."), processes=2), {})
    advanced: list[str] = []
    report = run_engines_bench(config, [small], advanced.append)
    assert sorted(advanced) == sorted(f"{small.scene_id} in {setup.name}" for setup in config.setups)
    assert {row["engine"] for row in report["engines"] if row["version"]} == {setup.name for setup in config.setups}
    again = run_engines_bench(config, [small], advanced.append)
    assert again["disagreements"] == report["disagreements"]
    assert {(line["instance"], line["engine"]) for line in report["disagreements"]} == {(ROD, setup.name) for setup in config.setups}
