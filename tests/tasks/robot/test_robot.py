"""The robot stage on scenes with furniture: carts arrive, touch nothing, know where they are, and their rows say what happened."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from schemas.evaluation import Trajectory
from schemas.navigation import Episode
from schemas.robot import RobotRun
from tasks.evaluation import EvaluationConfig
from tasks.evaluation.batch import Attempt
from tasks.evaluation.measures import SceneAttempts, measure
from tasks.robot import STAGE, DriveBatch, RobotConfig, run
from tasks.robot.configuration import Displacement, unusual
from tasks.robot.routes import spread_ways
from tasks.stage import Context
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_scene

pytestmark = pytest.mark.whole


def ways_of(scene_id: str) -> tuple[Trajectory, ...]:
    """The shortest paths of a scene, as the policy `expert` goes them."""
    made = acted_scene(scene_id)
    (mesh,) = made.rows["navmeshes"]
    attempts = tuple(Attempt(scene_id, row.episode_id, tuple(row.actions), None, None, row.episode_id) for row in made.episodes)
    labels = {"batch_id": "b", "policy": "expert", "run_name": "built-in", "source_file": None}
    named = {row.episode_id: row for row in made.episodes}
    rows = measure(SceneAttempts(named, attempts, {mesh.agent: mesh}, {mesh.agent: made.navmesh}, labels, EvaluationConfig()))
    assert all(isinstance(row, Trajectory) for row in rows)
    return tuple(sorted(rows, key=lambda row: row.episode_id))


def driven(scene_id: str, config: RobotConfig, seed: int = 0, **changed: Any) -> list[RobotRun]:
    made = acted_scene(scene_id)
    rows = {name: made.rows.get(name, []) for name in STAGE.reads}
    batch = DriveBatch("drive-0", scene_id, changed.get("ways", ways_of(scene_id)), unusual(config))
    outcome = run(drive_batch=batch, **rows, context=Context("drive-0", "robot", seed, made.blobs), config=config)
    return outcome.rows["robot_runs"]


def steady(rows: list[RobotRun]) -> list[RobotRun]:
    """Rows without what the clock said."""
    return [dataclasses.replace(row, decision_seconds=0.0, slowest_decision_seconds=0.0) for row in rows]


@pytest.fixture(scope="module")
def living() -> list[RobotRun]:
    return driven(LIVING, RobotConfig())


@pytest.mark.slow
def test_all_ways_of_a_living_room_are_driven(living: list[RobotRun]) -> None:
    assert [row.episode_id for row in living] == [row.episode_id for row in acted_scene(LIVING).episodes]
    for row in living:
        assert (row.outcome, row.problem, row.collisions, row.touched) == ("arrived", None, 0, None)
        assert row.goal_distance_m < RobotConfig().planner.arrive_m + row.greatest_error_m
        assert 0.0 < row.least_clearance_m <= min(row.clearances)
        assert row.travelled_m >= np.hypot(*(np.array(row.track[-1][:2]) - row.track[0][:2])) - 1e-9
        assert len(row.times) == len(row.track) == len(row.estimate) == len(row.clearances)
        assert np.allclose(np.diff(row.times[:-1]), RobotConfig().record_s)
        assert row.times[-1] == row.seconds
        assert row.moved == ()
        assert row.setup == ""
    assert np.mean([row.error_m for row in living]) < 0.01
    assert all(row.final_error_m < 0.02 for row in living)


def test_wheels_alone_are_worse_than_with_the_gyro_and_both_than_with_the_lidar(living: list[RobotRun]) -> None:
    wheels, gyro, final = (
        np.sqrt(np.mean([getattr(row, name) ** 2 for row in living])) for name in ("wheels_error_m", "wheels_gyro_error_m", "final_error_m")
    )
    assert wheels > 2 * gyro > 4 * final


def test_the_same_seed_drives_the_same_and_another_one_otherwise(living: list[RobotRun]) -> None:
    assert steady(driven(LIVING, RobotConfig())) == steady(living)
    other = driven(LIVING, RobotConfig(), seed=1)
    assert all(a.track != b.track for a, b in zip(steady(other), steady(living), strict=True))


def test_what_goes_wrong_on_a_way_does_not_depend_on_the_ways_beside_it(living: list[RobotRun]) -> None:
    (alone,) = driven(LIVING, RobotConfig(), ways=ways_of(LIVING)[2:3])
    assert steady([alone]) == steady([row for row in living if row.episode_id == alone.episode_id])


def test_moved_things_are_in_the_rows_and_nothing_is_touched(living: list[RobotRun]) -> None:
    rows = driven(LIVING, RobotConfig(displacement=Displacement(share=0.5)))
    assert all(row.collisions == 0 for row in rows)
    assert any(row.moved for row in rows)
    assert sum(row.outcome == "arrived" for row in rows) >= len(rows) - 1
    known = {row.instance_id for row in acted_scene(LIVING).rows["instances"]}
    for row in rows:
        assert row.setup == "displacement.share 0.5"
        for line in row.moved:
            name, far = line.split()
            assert name in known
            assert 0.0 <= float(far) <= Displacement().reach_m
    assert [row.subgoals for row in rows] == [row.subgoals for row in living]  # the map has not changed


def test_wheels_on_the_floor_of_the_exported_scene_arrive_too() -> None:
    rows = driven(STUDY, RobotConfig(body="mujoco"), ways=ways_of(STUDY)[:2])
    for row in rows:
        assert (row.body, row.outcome, row.collisions) == ("mujoco", "arrived", 0)
        assert row.error_m < 0.02


def test_wheels_on_the_floor_go_around_what_was_moved() -> None:
    config = RobotConfig(body="mujoco", displacement=Displacement(share=1.0))
    rows = driven(STUDY, config, ways=ways_of(STUDY)[:2])
    assert any(row.moved for row in rows)
    assert all(row.collisions == 0 for row in rows)
    assert any(row.outcome == "arrived" for row in rows)


def test_what_is_touched_is_where_a_run_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cart that is told to go straight on: its record goes up to the touch, and no distance is left then."""
    monkeypatch.setattr("tasks.robot.navigator.Navigator.command", lambda *_: (0.5, 0.0))
    rows = driven(STUDY, RobotConfig(), ways=ways_of(STUDY)[:2])
    for row in rows:
        assert (row.outcome, row.collisions) == ("collided", 1)
        assert row.touched
        assert row.problem == f"ran into {row.touched} after {row.seconds:.1f} s"
        assert row.times[-1] == row.seconds
        assert abs(row.clearances[-1]) < 1e-3
        assert row.least_clearance_m == pytest.approx(min(row.clearances), abs=1e-9)


def test_a_cart_that_does_not_fit_says_so_and_goes_nowhere() -> None:
    wide = dataclasses.replace(RobotConfig().cart, radius_m=1.4)
    rows = driven(STUDY, RobotConfig(cart=wide))
    for row in rows:
        assert (row.outcome, row.seconds, row.travelled_m, row.collisions) == ("unreachable", 0.0, 0.0, 0)
        assert row.problem
    notes = run(
        drive_batch=DriveBatch("drive-0", STUDY, ways_of(STUDY)), **{name: acted_scene(STUDY).rows.get(name, []) for name in STAGE.reads},
        context=Context("drive-0", "robot", 0, acted_scene(STUDY).blobs), config=RobotConfig(cart=wide),
    ).degradations  # fmt: skip
    assert [note for note in notes if note.startswith(f"{STUDY} {rows[0].episode_id}: unreachable: ")]


def test_time_that_is_too_short_ends_a_run() -> None:
    rows = driven(LIVING, dataclasses.replace(RobotConfig(), seconds=1.0))
    late = [row for row in rows if row.outcome == "timeout"]
    assert late
    assert all("was still" in (row.problem or "") and row.seconds <= 1.0 + 1e-9 for row in late)


def test_ways_are_spread_over_the_episodes_in_their_order() -> None:
    ways = ways_of(LIVING)
    assert spread_ways(ways, 100) == ways
    some = spread_ways(tuple(reversed(ways)), 3)
    assert [row.episode_id for row in some] == [ways[index].episode_id for index in (0, 2, 4)]
    standing = dataclasses.replace(ways[0], travelled_m=0.0)
    assert standing not in spread_ways([standing, *ways[1:]], 100)


def test_what_is_unusual_is_told_in_a_line() -> None:
    assert unusual(RobotConfig()) == unusual(RobotConfig(body="mujoco", routes=20, record_s=0.1)) == ""
    config = RobotConfig(displacement=Displacement(share=0.1), noise=dataclasses.replace(RobotConfig().noise, slip=0.05))
    assert unusual(config) == "displacement.share 0.1, noise.slip 0.05"


def test_an_episode_is_where_its_way_begins() -> None:
    named = {row.episode_id: row for row in acted_scene(LIVING).episodes if isinstance(row, Episode)}
    for way in ways_of(LIVING):
        assert np.allclose(way.poses[0][:2], named[way.episode_id].start_position[:2])
