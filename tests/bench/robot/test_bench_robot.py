"""The benchmark of carts: what its figures and goals say, and a small one of it all."""

from __future__ import annotations

import dataclasses
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from bench.robot.drives import MOVED, SETUPS, USUAL, figures, nees_band, setup_figures
from bench.robot.killed import kill_goals
from bench.robot.replicas import RobotReplicas, scene_of
from bench.robot.report import RobotBench, drive_goals, run_robot_bench
from bench.robot.tables import print_robot
from flows.commands.bench import command
from schemas.robot import RobotRun
from tests.samples import sample

RUN = sample(
    RobotRun, scene_id="plain/scene0000_00", episode_id="0000", outcome="arrived", problem=None, collisions=0, seconds=10.0, error_m=0.01,
    greatest_error_m=0.02, wheels_error_m=3.0, wheels_gyro_error_m=0.4, final_error_m=0.01, nees=3.0, least_clearance_m=0.1, moved=(),
    decision_seconds=0.004, slowest_decision_seconds=0.02, travelled_m=4.0, recoveries=0, decisions=100,
)  # fmt: skip


def runs(*changed: dict[str, Any]) -> list[RobotRun]:
    return [dataclasses.replace(RUN, episode_id=f"{index:04d}", **values) for index, values in enumerate(changed)]


def test_figures_are_counts_means_and_roots_of_runs() -> None:
    row = figures(runs({}, {"wheels_error_m": 4.0, "nees": 5.0}, {"outcome": "collided", "collisions": 1, "problem": "ran into 0003"}))
    assert (row["runs"], row["arrived"], row["collided"], row["collisions"]) == (3, 2, 1, 1)
    assert row["arrived_share"] == pytest.approx(2 / 3)
    assert row["final_wheels_m"] == pytest.approx(math.sqrt((9 + 16 + 9) / 3))
    assert row["nees"] == pytest.approx(11 / 3)
    assert row["why"] == {"plain/scene0000_00 0002": "collided: ran into 0003"}


def test_ways_that_no_cart_can_drive_count_as_not_arrived_and_have_no_error() -> None:
    row = figures(runs({}, {"outcome": "unreachable", "problem": "too narrow", "seconds": 0.0, "nees": 0.0, "least_clearance_m": 0.0}))
    assert (row["arrived_share"], row["nees"], row["least_clearance_m"]) == (0.5, 3.0, 0.1)


def test_runs_of_each_dataset_are_told_apart() -> None:
    rows = setup_figures(USUAL, [RUN, dataclasses.replace(RUN, scene_id="hard/scene0001_00", outcome="stuck", problem="no way on")])
    assert [(row["replicas"], row["runs"], row["arrived"]) for row in rows] == [("all", 2, 1), ("plain", 1, 1), ("hard", 1, 0)]


def test_the_band_holds_95_of_100_means_of_a_consistent_filters_nees() -> None:
    low, high = nees_band(200)
    means = np.random.default_rng(0).chisquare(3, (20_000, 200)).mean(axis=1)
    assert ((means > low) & (means < high)).mean() == pytest.approx(0.95, abs=0.005)
    assert all(map(math.isnan, nees_band(0)))


def report_of(rows: list[RobotRun], moved: list[RobotRun]) -> dict[str, bool | None]:
    table = [*setup_figures(USUAL, rows), *setup_figures(MOVED, moved)]
    return {row["goal"].partition(",")[0]: row["met"] for row in drive_goals(table, 1)}


def test_goals_are_missed_one_by_one() -> None:
    well, moved = [RUN] * 40, [dataclasses.replace(RUN, moved=("0003 0.40",))]
    assert all(report_of(well, moved).values())
    assert (
        report_of([*well, *runs({"outcome": "stuck"}, {}, {"outcome": "timeout"}, {"outcome": "stuck"})], moved)["runs that arrive [%]"]
        is False
    )
    collided = {
        row["goal"]: row["met"] for row in drive_goals([*setup_figures(USUAL, well), *setup_figures(MOVED, runs({"collisions": 1}))], 1)
    }
    assert collided["collisions, as mapped"] is True
    assert collided["collisions, a tenth moved"] is False
    assert report_of(runs({}), moved)["runs"] is False
    assert report_of(well, [RUN])["things that were moved"] is False
    assert report_of([dataclasses.replace(RUN, error_m=0.06)] * 40, moved)["mean error with wheels"] is False
    assert report_of([dataclasses.replace(RUN, nees=9.0)] * 40, moved)["mean NEES"] is False
    assert report_of([dataclasses.replace(RUN, slowest_decision_seconds=0.2)] * 40, moved)["decisions per second"] is False


def test_a_kill_that_came_too_late_or_early_proves_nothing() -> None:
    figures = {"killed": 1, "runs": 6, "went_on_with": 4, "same_batches": True, "same_rows": True}
    assert all(row["met"] for row in kill_goals(figures))
    for name, value in (("killed", 0), ("went_on_with", 0), ("went_on_with", 6), ("same_rows", False)):
        assert not all(row["met"] for row in kill_goals({**figures, name: value})), name


def test_every_other_room_is_hard_and_the_house_is_one_more(tmp_path: Path) -> None:
    data = RobotReplicas(tmp_path, 3)
    assert [scene_of(*job) for job in data.jobs] == ["plain/scene0000_00", "hard/scene0001_00", "plain/scene0002_00"]
    assert RobotBench(tmp_path, 3).advances == 3 + 1 + 3 * len(SETUPS) + 3


def test_the_report_is_printed() -> None:
    rows = [*setup_figures(USUAL, runs({}, {"outcome": "stuck", "problem": "no way on from [m]"})), *setup_figures(MOVED, [RUN])]
    machine = {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}
    killed = {"killed": 1, "runs": 6, "went_on_with": 4, "same_rows": True, "goals": []}
    goals = drive_goals(rows, 1)
    report = {
        "machine": machine, "seed": 0, "processes": 1, "failed": ["hard/scene0001_00: capture: no floor"],
        "parts": {"drives": {"setups": rows, "goals": goals}, "killed": killed}, "goals": goals,
    }  # fmt: skip
    out = io.StringIO()
    print_robot(report, Console(file=out, width=200))
    text = out.getvalue()
    assert "as mapped: plain/scene0000_00 0001: stuck: no way on from [m]" in text
    assert "failed: hard/scene0001_00: capture: no floor" in text
    assert "MISSED" in text
    assert "the rows are those of a whole drive" in text


@pytest.mark.slow
def test_a_small_one_of_it_all(tmp_path: Path) -> None:
    advanced: list[str] = []
    config = RobotBench(tmp_path, rooms=2, processes=2)
    report = run_robot_bench(config, advanced.append)
    assert len(advanced) == config.advances
    assert report["failed"] == []
    whole = {row["setup"]: row for row in report["parts"]["drives"]["setups"] if row["replicas"] == "all"}
    assert set(whole) == {setup.name for setup in SETUPS}
    assert all(row["scenes"] == 2 and row["collisions"] == 0 for row in whole.values())
    assert whole[USUAL.name]["arrived_share"] >= 0.9
    assert all(row["met"] for row in report["parts"]["killed"]["goals"])
    again = CliRunner().invoke(command, ["robot", "--rooms", "2", "--folder", str(tmp_path), "--parts", "drives", "--json"])
    assert json.loads(again.stdout)["parts"]["drives"]["setups"] == report["parts"]["drives"]["setups"]
