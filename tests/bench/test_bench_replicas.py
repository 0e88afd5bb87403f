"""The benchmarks of exports and navigation: what they measure is there, and what is wrong is said."""

from __future__ import annotations

import dataclasses
import json
import math

import mujoco
import numpy as np
import pytest
import shapely
from click.testing import CliRunner

from bench import exports as exports_bench
from bench import navigation as navigation_bench
from bench.exports import ExportsBench, RoomExports
from bench.gravity import Unstable, farthest_apart, left_alone, unstable_of
from bench.navigation import NavigationBench, RoomPaths
from bench.paths import PlainGraph, replayed
from bench.replicas import as_drawn
from bench.rooms import generated_scene
from flows.commands.bench import command
from schemas.families.export_formats import EXPORT_FORMATS

pytestmark = pytest.mark.whole


def unmet(goals: list[dict]) -> set[str]:
    return {goal["goal"] for goal in goals if goal["met"] is False}


# --- exports --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported() -> RoomExports:
    # not room 0: a lamp falls off a nightstand onto a bottle there, and by how much that leans then is chance
    return exports_bench.measure_room(ExportsBench(rooms=10, episodes=3), 1)


@pytest.mark.slow
def test_a_room_passes_every_gate_and_its_files_agree_with_its_certificate(exported: RoomExports) -> None:
    assert exported.objects >= 10
    assert set(EXPORT_FORMATS) <= exported.seconds.keys()
    assert set(EXPORT_FORMATS) == exported.sizes.keys() == exported.files.keys()
    assert exported.broken == ()
    assert exported.rules > 5 * len(EXPORT_FORMATS)
    for falls in exported.states.values():
        assert falls.read["mjcf"] == falls.read["usd"] == falls.certified
        assert max(falls.apart.values()) < 1e-3
    assert exported.states["as optimized"].apart["mjcf"] < 1e-6
    assert exported.states["in disorder"].certified.at_1cm > exported.states["as optimized"].certified.at_1cm
    assert unmet(exports_bench.goals([exported])) == set()


@pytest.mark.slow
def test_what_is_broken_or_differs_misses_its_goal(exported: RoomExports) -> None:
    sound = dataclasses.replace(exported, broken=())
    broken = dataclasses.replace(exported, broken=(("urdf", "mass", "is 0"),))
    assert unmet(exports_bench.goals([sound, broken])) == {"exports that pass their gate [%]"}
    disorder = sound.states["in disorder"]
    still = dataclasses.replace(disorder, read={**disorder.read, "usd": Unstable(frozenset(), disorder.certified.at_5cm)})
    other = dataclasses.replace(sound, states={**sound.states, "in disorder": still})
    assert unmet(exports_bench.goals([other])) == {"free objects in disorder that usd and certificate judge otherwise at 1 cm"}


def test_what_is_left_alone_falls_tips_or_stays() -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><geom type="plane" size="0 0 1"/>
        <body name="high_0001" pos="0 0 0.6"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
        <body name="still_0002" pos="1 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
        <body name="leaning_0003" pos="2 0 0.32" euler="0 20 0"><freejoint/><geom type="box" size="0.05 0.2 0.3"/></body>
        <body name="fixed_0004" pos="3 0 2"><geom type="box" size="0.1 0.1 0.1"/></body>
      </worldbody></mujoco>""")
    settled = left_alone(model, 2.0)
    assert settled.keys() == {"high_0001", "still_0002", "leaning_0003"}
    assert settled["high_0001"].displacement == pytest.approx(0.5, abs=0.005)
    assert settled["leaning_0003"].tilt > math.radians(5)
    found = unstable_of(settled)
    assert found.at_1cm == found.at_5cm == {"0001", "0003"}
    assert farthest_apart(settled, []) == 0.0


# --- navigation -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walked() -> RoomPaths:
    measured = navigation_bench.measure_room(NavigationBench(rooms=10), 1)
    assert measured is not None
    return measured


def test_a_room_is_walked_through_and_every_episode_holds(walked: RoomPaths) -> None:
    planar = walked.trajectories["planar"]
    assert planar.made == planar.asked in (50, 100)
    assert planar.steps > planar.made
    assert (planar.off, planar.missed) == (0, 0)
    assert walked.plain_difference_m < 1e-9
    assert (walked.lengths["planar"] >= walked.lengths["straight"] - 1e-9).all()
    assert (walked.lengths["planar"] > walked.lengths["straight"] + 0.01).any(), "something is walked around"


def test_paths_and_episodes_that_are_wrong_miss_their_goals(walked: RoomPaths) -> None:
    fine = {"has_recast": True, "plain_difference_m": 0.0, "times_faster_than_plain": 1e3, "episodes": {"planar": {"off": 0, "missed": 0}}}
    detour = dataclasses.replace(walked, lengths={**walked.lengths, "recast": walked.lengths["planar"]})
    assert unmet(navigation_bench.goals([detour], fine)) == set()
    short = dataclasses.replace(detour, lengths={**detour.lengths, "recast": detour.lengths["planar"] - 0.002})
    assert "paths of planar longer than Detour's on the same navmesh by more than 1 mm" in unmet(navigation_bench.goals([short], fine))
    lost = dataclasses.replace(detour, lengths={**detour.lengths, "planar": np.full_like(detour.lengths["planar"], np.inf)})
    assert "paths of planar longer than Detour's on the same navmesh by more than 1 mm" in unmet(navigation_bench.goals([lost], fine))
    wrong = {**fine, "plain_difference_m": 0.1, "times_faster_than_plain": 0.5, "episodes": {"planar": {"off": 1, "missed": 2}}}
    assert len(unmet(navigation_bench.goals([detour], wrong))) == 4


def test_actions_that_miss_or_leave_are_counted() -> None:
    """The benchmark's own replay knows nothing of the path finders: a step too many is seen."""
    from collections import defaultdict

    from tasks import navigation
    from tasks.navigation import NavigationConfig
    from tasks.stage import Context

    scene = generated_scene(1, 10, 0)
    rows, blobs = as_drawn(scene)
    config = NavigationConfig(train_episodes=4, test_episodes=4)
    context = Context(scene.scene_id, "navigation", 0, blobs, defaultdict(dict))
    outcome = navigation.run(**{table: rows[table] for table in navigation.STAGE.reads}, context=context, config=config)
    assert navigation_bench._judged(outcome, config, 0.0).missed == 0
    outcome.rows["episodes"] = [
        dataclasses.replace(episode, actions=("forward",) * 60 + episode.actions) for episode in outcome.rows["episodes"]
    ]
    judged = navigation_bench._judged(outcome, config, 0.0)
    assert (judged.off, judged.missed) == (4, 4)


def test_the_plain_graph_walks_around_a_block() -> None:
    free = shapely.difference(shapely.box(0, 0, 4, 4), shapely.box(1, 1, 3, 3))
    graph = PlainGraph(free)
    assert graph.distance(np.array([0.5, 2.0]), np.array([0.5, 3.0])) == pytest.approx(1.0)
    around = 2 * math.hypot(0.5, 1.0) + 2.0
    assert graph.distance(np.array([0.5, 2.0]), np.array([3.5, 2.0])) == pytest.approx(around)
    apart = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])
    assert PlainGraph(apart).distance(np.array([0.5, 0.5]), np.array([2.5, 0.5])) == math.inf


def test_replays_turn_left_counter_clockwise() -> None:
    places = replayed(("forward", "left", "left", "left", "forward", "right", "stop"), np.zeros(2), 0.0, 0.25, math.pi / 6)
    assert places == pytest.approx(np.array([[0, 0], [0.25, 0], [0.25, 0.25]]), abs=1e-12)


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_reports_are_printed_and_a_missed_goal_is_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    done = CliRunner().invoke(command, ["navigation", "--rooms", "1", "--processes", "1"])
    assert done.exit_code == 0, done.output
    assert "episodes made" in done.output
    assert "MISSED" not in done.output
    report = {
        "machine": {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}, "seed": 0, "processes": 1, "rooms": 1,
        "objects": 3, "formats": {"usd": {"seconds_mean": 1.0, "megabytes_mean": 1.0, "files_mean": 3.0, "scenes_passed": 0}},
        "states": {}, "broken": [["a/b", "usd", "mass", "is [0]"]],
        "goals": [{"goal": "exports that pass their gate [%]", "found": 0.0, "wanted": ">= 100", "met": False}],
    }  # fmt: skip
    monkeypatch.setattr("bench.exports.run_exports_bench", lambda config, advance: report)
    done = CliRunner().invoke(command, ["exports"])
    assert done.exit_code == 1
    assert "MISSED" in done.output
    assert "is [0]" in done.output
    done = CliRunner().invoke(command, ["exports", "--json"])
    assert done.exit_code == 1
    assert json.loads(done.stdout) == report
