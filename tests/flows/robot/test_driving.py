"""Carts in a lake: what is driven, once; killed runs go on; what people, scripts, films and the report are told."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from PIL import Image

from flows.commands.drive import _metrics, _tell, command
from flows.evaluation.acting import in_this_process as acted_here
from flows.evaluation.acting import planned_policy
from flows.outputs.drives import shown_drives, write_drive_films
from flows.robot.driving import Driven, _lasting, driven, in_this_process, planned_drives
from flows.robot.flow import seconds_for
from flows.run.configuration import configure
from flows.stats import write_report
from flows.stats.scenes import drive_still_of
from flows.view.drives import drives_of
from schemas.capture import Scene
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode
from schemas.robot import RobotRun
from schemas.runs import StageRun
from tasks.films.walks import FilmLook
from tasks.stats.scenes import PictureConfig
from tests.samples import fingerprint, stage_run
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_lake
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

FEW = ["robot.routes=2"]
LOOK = FilmLook(room=PictureConfig(width=160, height=120, oversampling=1), view_px=32, text_px=8)


@pytest.fixture(scope="module")
def acted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake in which the expert has acted."""
    lake = acted_lake(tmp_path_factory.mktemp("drives") / "lake")
    planned = planned_policy(lake, "expert", configure())
    assert not [run.error for run in acted_here(planned.todo) if run.error]
    lake.commit(scenes=planned.batches)
    return Path(lake.address)


@pytest.fixture
def lake(acted: Path, tmp_path: Path) -> Lake:
    return Lake.open(shutil.copytree(acted, tmp_path / "lake"))


@pytest.fixture(scope="module")
def driven_lake(acted: Path, tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Of the expert's ways two in each scene are driven."""
    lake = Lake.open(shutil.copytree(acted, tmp_path_factory.mktemp("driven") / "lake"))
    carried_out(lake, FEW)
    return lake


def batches(lake: Lake) -> list[str]:
    return sorted({row.batch_id for row in lake.snapshot().rows(Trajectory)})


def carried_out(lake: Lake, settings: list[str]) -> Driven:
    """What the flow does, in this process."""
    planned = planned_drives(lake, batches(lake), configure(None, settings))
    runs = {run.scene_id: run for run in in_this_process([drive for drive in planned if drive.is_new])}
    lake.commit(scenes=[drive.batch_id for drive in planned])
    return driven(planned, runs)


def rows_of(lake: Lake) -> list[dict[str, Any]]:
    """Rows without what the clock said."""
    with lake.snapshot().connect() as connection:
        query = "SELECT * EXCLUDE (decision_seconds, slowest_decision_seconds) FROM robot_runs ORDER BY batch_id, scene_id, episode_id"
        return connection.sql(query).to_arrow_table().to_pylist()


def test_ways_are_driven_once(driven_lake: Lake) -> None:
    rows = driven_lake.snapshot().rows(RobotRun)
    assert {row.scene_id for row in rows} == {LIVING, STUDY}
    assert len(rows) == 4
    assert all(row.outcome == "arrived" and row.collisions == 0 for row in rows)
    before = rows_of(driven_lake)
    again = carried_out(driven_lake, FEW)
    assert (again.new, again.runs, again.scenes, again.failed) == (0, 4, 2, ())
    assert rows_of(driven_lake) == before


def test_other_settings_are_another_batch_and_a_setup_of_their_own(driven_lake: Lake, tmp_path: Path) -> None:
    lake = Lake.open(shutil.copytree(driven_lake.address, tmp_path / "lake"))
    done = carried_out(lake, [*FEW, "robot.displacement.share=0.5"])
    assert done.new == 4
    with lake.snapshot().connect() as connection:
        table = connection.sql("SELECT setup, n, arrived_share, collisions FROM robot_metrics ORDER BY setup").fetchall()
    assert [(row[0], row[1], row[3]) for row in table] == [("", 4, 0), ("displacement.share 0.5", 4, 0)]


def test_the_view_is_arithmetic_over_the_rows(driven_lake: Lake) -> None:
    rows = driven_lake.snapshot().rows(RobotRun)
    with driven_lake.snapshot().connect() as connection:
        (row,) = connection.sql("SELECT * FROM robot_metrics").to_arrow_table().to_pylist()
    assert row["n"] == len(rows)
    assert row["error_m"] == pytest.approx(sum(run.error_m for run in rows) / len(rows))
    assert row["wheels_error_m"] == pytest.approx((sum(run.wheels_error_m**2 for run in rows) / len(rows)) ** 0.5)
    turned = sum(math.degrees(run.heading_error_radians) for run in rows) / len(rows)
    assert row["heading_error_degrees"] == pytest.approx(turned)
    assert row["mean_recoveries"] == pytest.approx(sum(run.recoveries for run in rows) / len(rows))
    assert row["scans_used_share"] == pytest.approx(sum(run.scans_used for run in rows) / sum(run.scans for run in rows))
    assert row["least_clearance_m"] == min(run.least_clearance_m for run in rows)
    assert row["arrived_share_low"] < row["arrived_share"] <= row["arrived_share_high"] == 1.0


def test_what_fails_in_one_scene_is_written_down_and_the_other_is_driven(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    import tasks.robot

    whole = tasks.robot.floor_in

    def torn(tables: Any, blobs: Any, config: Any) -> Any:
        if tables["shells"][0].scene_id == STUDY:
            raise InputError(STUDY, "shells", "has no floor", "run capture on the scene again")
        return whole(tables, blobs, config)

    monkeypatch.setattr("tasks.robot.floor_in", torn)
    done = carried_out(lake, FEW)
    assert done.failed == (f"{STUDY}: {STUDY}: shells: has no floor; run capture on the scene again",)
    assert {row.scene_id for row in lake.snapshot().rows(RobotRun)} == {LIVING}
    (failed,) = [run for run in lake.snapshot().rows(StageRun) if run.stage == "robot" and run.error]
    assert failed.error_kind == "input"
    monkeypatch.setattr("tasks.robot.floor_in", whole)
    assert carried_out(lake, FEW).new == 2
    assert {row.scene_id for row in lake.snapshot().rows(RobotRun)} == {LIVING, STUDY}


def test_a_batch_that_is_not_there_is_refused(lake: Lake) -> None:
    with pytest.raises(InputError, match="there is no batch nonesuch; `metascenes evaluate` makes and imports them"):
        planned_drives(lake, ["nonesuch"], configure())


def test_where_a_scan_lay_makes_no_other_drive(lake: Lake) -> None:
    reader = lake.snapshot()
    (scene,) = reader.rows(Scene, STUDY)
    elsewhere = dataclasses.replace(scene, scan_path="/elsewhere")
    assert _lasting("scenes", elsewhere) == _lasting("scenes", scene)
    assert _lasting("scenes", dataclasses.replace(scene, license="CC0-1.0")) != _lasting("scenes", scene)


def test_where_no_cart_moved_there_is_nothing_to_say_of_errors(lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
    done = carried_out(lake, [*FEW, "robot.cart.radius_m=1.4"])
    assert done.new == 4
    metrics = _metrics(lake, done)
    assert (metrics[0]["unreachable"], metrics[0]["error_m"]) == (4, None)
    _tell(done, metrics, False)
    assert capsys.readouterr().out.splitlines()[-1].split()[-3:] == ["-", "-", "-"]


def test_films_report_and_viewer_show_the_run_that_counts(driven_lake: Lake, tmp_path: Path) -> None:
    """A newer run of the same way, in a batch whose name comes first, that ended otherwise."""
    lake = Lake.open(shutil.copytree(driven_lake.address, tmp_path / "lake"))
    before = [row for row in lake.snapshot().rows(RobotRun) if row.scene_id == STUDY]
    later = [dataclasses.replace(row, batch_id="a-later-drive", outcome="stuck", problem="no way on") for row in before]
    lake.stage_rows(stage_run("a-later-drive", "robot", fingerprint("later")), {"robot_runs": later})
    lake.commit(scenes=["a-later-drive"])
    with lake.snapshot().connect() as connection:
        shown = connection.sql(shown_drives(9, f"scene_id = '{STUDY}'")).to_arrow_table().to_pylist()
    assert {row["batch_id"] for row in shown} == {"a-later-drive"}
    assert {run["outcome"] for run in drives_of(lake.snapshot(), STUDY)} == {"stuck"}


def test_a_drive_may_take_as_long_as_all_its_ways(lake: Lake) -> None:
    short, long = (planned_drives(lake, batches(lake), configure(None, [f"robot.routes={count}"]))[0] for count in (1, 4))
    assert seconds_for(long) - seconds_for(short) == 3 * 10.0 * 180.0


@pytest.mark.slow
def test_killed_in_the_middle_the_same_command_goes_on_to_the_same_rows(lake: Lake, driven_lake: Lake, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "flows.cli", "drive", "--lake", lake.address, "--workers", "1", "--set", *FEW]
    for batch in batches(lake):
        words += ["--batch", batch]
    environment = {**os.environ, "HOME": str(tmp_path)}
    process = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    def finished() -> dict[str, Any]:
        return {
            key[0]: state.done.started_at for key, state in Lake.open(lake.address).history().items() if key[1] == "robot" and state.done
        }

    while process.poll() is None and not finished():
        time.sleep(0.05)
    assert process.poll() is None, "the kill must fall into the run"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = finished()
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert rows_of(lake) == rows_of(driven_lake)
    assert {batch: finished()[batch] for batch in kept} == kept, "what was finished is not driven again"


@pytest.mark.slow
def test_killed_between_acting_and_driving_the_same_command_goes_on(driven_lake: Lake, tmp_path: Path) -> None:
    """The expert's trajectories are staged and not committed, as a kill leaves them."""
    bare = acted_lake(tmp_path / "bare")
    planned = planned_policy(bare, "expert", configure())
    assert not [run.error for run in acted_here(planned.todo) if run.error]
    done = told(tmp_path, "--policy", "expert", "--lake", bare.address, "--set", FEW[0], "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("4 ways in 2 scenes: 4 driven")
    assert rows_of(bare) == rows_of(driven_lake)


def told(home: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command, as people give it."""
    line = [sys.executable, "-m", "flows.cli", "drive", *words]
    return subprocess.run(line, env={**os.environ, "HOME": str(home)}, capture_output=True, text=True)


@pytest.mark.slow
def test_the_command_lets_a_policy_act_and_drives_its_ways(tmp_path: Path) -> None:
    lake = acted_lake(tmp_path / "lake", (STUDY,))
    words = ["--policy", "expert", "--lake", lake.address, "--set", FEW[0]]
    dry = told(tmp_path, *words, "--dry-run")
    assert dry.returncode == 0, dry.stderr
    assert "note: expert would act first, scenes: 1" in dry.stderr
    assert not list(lake.snapshot().rows(RobotRun))
    done = told(tmp_path, *words, "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["runs"], document["scenes"], document["new"], document["failed"]) == (2, 1, 2, [])
    (metrics,) = document["metrics"]
    assert (metrics["policy"], metrics["arrived_share"], metrics["collisions"]) == ("expert", 1.0, 0)
    again = told(tmp_path, *words)
    assert again.stdout.startswith("2 ways in 1 scene: 0 driven, 2 are in the lake already")
    assert "expert, built-in, planar" in again.stdout
    episode = min(lake.snapshot().rows(Episode), key=lambda row: row.episode_id)
    mine = {"scene_id": STUDY, "episode_id": episode.episode_id, "actions": list(episode.actions)}
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"batch_id": "mine-1", "policy": "mine", "run_name": "checkpoint 3", "trajectories": [mine]}))
    filed = told(tmp_path, str(file), "--lake", lake.address)
    assert filed.returncode == 0, filed.stderr
    assert filed.stdout.startswith("1 way in 1 scene: 1 driven\n")
    assert "mine, checkpoint 3, planar" in filed.stdout


def test_the_command_says_what_it_needs(lake: Lake, tmp_path: Path) -> None:
    nothing = CliRunner().invoke(command, ["--lake", lake.address])
    assert nothing.exit_code == 2
    assert "give a file of trajectories, --policy or --batch" in nothing.stderr
    films = CliRunner().invoke(command, ["--lake", lake.address, "--policy", "expert", "--films", str(tmp_path / "films"), "--dry-run"])
    assert films.exit_code == 2
    assert "--dry-run writes nothing" in films.stderr


def test_films_are_the_same_bytes_each_time(driven_lake: Lake, tmp_path: Path) -> None:
    named = sorted({row.batch_id for row in driven_lake.snapshot().rows(RobotRun)})
    first, second = (write_drive_films(driven_lake, named, tmp_path / name, 1, LOOK) for name in ("a", "b"))
    assert [file.name for file in first.files] == [file.name for file in second.files]
    (file,) = first.files
    assert file.name.startswith("cart_expert_arrived_demo_")
    assert file.read_bytes() == second.files[0].read_bytes()
    with Image.open(file) as film:
        assert film.n_frames > 10  # type: ignore[attr-defined]
    assert write_drive_films(driven_lake, ["none"], tmp_path / "c", 1, LOOK).missing == ("no run to film",)


def test_the_report_shows_runs_of_carts(driven_lake: Lake, tmp_path: Path) -> None:
    reader = driven_lake.snapshot()
    with reader.connect() as connection:
        (row,) = connection.sql(shown_drives(1, "true")).to_arrow_table().to_pylist()
    still = drive_still_of(driven_lake, reader.snapshot_id, row)
    assert (still.outcome, still.mark) == ("arrived", "success")
    with Image.open(io.BytesIO(still.picture)) as image:
        assert image.format == "JPEG"
    look = PictureConfig(width=60, height=42, oversampling=1)
    text = write_report(driven_lake, tmp_path / "report.html", workers=1, look=look).path.read_text()
    assert '<section id="robot"' in text
    assert "way of expert, built-in: to the" in text
    assert 'href="#robot"' in text
