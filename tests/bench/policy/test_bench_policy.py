"""The benchmark of policies: rooms, trainings, figures by the views of the lake, goals, and a whole run that goes on."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console
from scipy.stats import binomtest

from bench.policy import rooms, trainings
from bench.policy.acting import EXPERT, FACING, RANDOM, SUCCESS_M, ActedRun, ActingPolicy, points_between, run_figures, settings_of
from bench.policy.killed import KILLS, KillsBench, kill_goals, measure_kills
from bench.policy.report import LOOP, PolicyBench, accuracy_of, agent_of, loop_goals
from bench.policy.rooms import PolicyRooms, make_room, make_rooms, room_name
from bench.policy.tables import print_policy
from bench.policy.trainings import BLIND, DAGGER, GOALLESS, ROUNDS, SENSING, SMALL, STOP_M, USUAL, VARIANTS, PolicyTraining
from bench.rooms import generated_scene
from flows.cli import cli
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode, Split
from tasks.furniture.rooms import FurnishedRoom
from tests.samples import sample
from tests.warehouse.questions.view_answers import Database
from warehouse.lake import Lake
from warehouse.tables.digest import digests

START = (0.0, 0.0, 0.0)


def trajectory(run: str, number: int, final_m: float, *, seen: bool, stopped: bool = True, success_m: float = SUCCESS_M) -> Trajectory:
    """A way of a policy in an episode of a room."""
    row: Trajectory = sample(
        Trajectory, batch_id=f"navigation-{run}", scene_id="bench/room_0001", episode_id=f"{number:04d}", policy="navigation", run_name=run,
        instance_id="0001", start_position=START, start_yaw_radians=0.0, actions=("forward", "stop") if stopped else ("forward",),
        poses=((0.0, 0.0, 0.0), (0.25, 0.0, 0.0)), called_stop=stopped, is_target_seen=seen, final_distance_m=final_m, start_distance_m=2.0,
        travelled_m=2.5, expert_actions=2, success_distance_m=success_m, problem=None,
    )  # fmt: skip
    return row


def episode(number: int) -> Episode:
    """An episode of a room."""
    row: Episode = sample(
        Episode, scene_id="bench/room_0001", episode_id=f"{number:04d}", instance_id="0001", start_position=START, start_yaw_radians=0.0
    )
    return row


def run(name: str, seed: int = 0) -> ActedRun:
    return ActedRun(ActingPolicy(SMALL, seed, name), "navigation", name, ())


def test_figures_are_those_of_the_views_and_intervals_those_of_others() -> None:
    ways = [
        trajectory("a", 0, 0.05, seen=True), trajectory("a", 1, 0.7, seen=True), trajectory("a", 2, 0.7, seen=False),
        trajectory("a", 3, 0.3, seen=True, stopped=False), trajectory("a", 4, 1.4, seen=True),
        *(trajectory("b", number, 0.5, seen=True) for number in range(5)),
        dataclasses.replace(trajectory("a", 1, 0.7, seen=True, success_m=0.2), batch_id="measured-otherwise"),
    ]  # fmt: skip
    with Database() as database:
        database.fill(*ways, *map(episode, range(5)))
        in_view = ["bench/room_0001 0001", "bench/room_0001 0002", "bench/room_0001 0003"]
        own = run_figures(database.connection, in_view, [run("a")])
        both = run_figures(database.connection, in_view, [run("a"), run("b", 1)])
        nobody = run_figures(database.connection, [], [run("c")])
        (view,) = [row for row in database.ask("navigation_metrics") if (row["run_name"], row["success_distance_m"]) == ("a", SUCCESS_M)]
    assert (own["n"], own["found_count"], own["in_view_count"], own["found_in_view_count"]) == (5, 2, 3, 1)
    assert (own["found"], own["found_in_view"], own["stopped"]) == (0.4, pytest.approx(1 / 3), 0.8)
    same = ("sel", "spl", "el", "found_spl", "el_success")
    named = {"found": "found_share", "arrived": "arrived_share", "success": "sr", "curvature": "curvature_finite_differences_per_m"}
    for key, column in {**{name: name for name in same}, **named}.items():
        assert own[key] == pytest.approx(view[column]), key
    interval = own["found_interval"]
    assert (interval["low"], interval["high"]) == pytest.approx((view["found_share_low"], view["found_share_high"]))
    for figures, count, of in ((own, 2, 5), (both, 7, 10)):
        wilson = binomtest(count, of).proportion_ci(method="wilson")
        assert figures["found_interval"]["low"] == pytest.approx(wilson.low, abs=1e-4)
        assert figures["found_interval"]["high"] == pytest.approx(wilson.high, abs=1e-4)
    in_view_by_both = binomtest(4, 6).proportion_ci(method="wilson")
    assert both["found_in_view_interval"]["low"] == pytest.approx(in_view_by_both.low, abs=1e-4)
    assert (nobody["n"], nobody["found"], nobody["found_interval"]) == (0, None, None)


def share(value: float, width: float = 0.05) -> dict[str, Any]:
    """Figures of who finds so much, and as much when it is in view."""
    interval = {"low": value - width, "high": value + width}
    return {
        "seeds": 3, "n": 100, "found": value, "found_interval": interval, "found_in_view": value, "found_in_view_interval": interval,
        "in_view_count": 40, "found_spl": value - 0.04, "success": value, "arrived": 0.1, "stopped": 0.9, "sel": 0.3, "el": 20.0,
        "el_success": None, "curvature": 0.5, "collisions": 1.0, "by_seed": [value] * 3,
    }  # fmt: skip


def verdicts(figures: dict[str, Any], accuracy: float = 0.9, **rooms_by_split: int) -> dict[str, bool | None]:
    known = {name: {"accuracy": accuracy, "low": accuracy, "high": accuracy, "majority": 0.5} for name in figures}
    return {row["goal"]: row["met"] for row in loop_goals({"train": 60, "test": 15} | rooms_by_split, 3, figures, known, [])}


def test_an_agent_must_find_enough_and_more_than_the_blind_with_intervals_apart() -> None:
    good = {DAGGER: share(0.62), SMALL: share(0.1), BLIND: share(0.3), RANDOM: share(0.06)}
    assert all(verdicts(good).values())
    assert agent_of(good) == DAGGER
    assert (agent_of({SMALL: 0, BLIND: 0}), agent_of({EXPERT: 0})) == (SMALL, None)
    assert points_between(good, DAGGER, BLIND) == (pytest.approx(32), pytest.approx(22))
    for figures, missed in (
        ({**good, DAGGER: share(0.55)}, {f"targets that {DAGGER} finds when they are in view at the start [%]"}),
        ({**good, BLIND: share(0.5)}, {f"points that {DAGGER} finds more than {BLIND}"}),
        ({**good, BLIND: share(0.45, 0.2)}, {f"points between the intervals of {DAGGER} and {BLIND}"}),
        ({**good, DAGGER: share(0.62) | {"found_spl": 0.5}}, {f"points that the SPL of {DAGGER} is below that"}),
    ):
        assert {name for name, met in verdicts(figures).items() if not met} >= missed
    assert {name for name, met in verdicts(good, accuracy=0.85).items() if not met} == {f"right actions of {DAGGER} in held-out rooms [%]"}
    assert {name for name, met in verdicts(good, train=59).items() if not met} == {"rooms to learn from"}
    assert verdicts({**good, DAGGER: share(0.0) | {"found_spl": 0.0}})[f"points that the SPL of {DAGGER} is below that"] is None
    assert set(verdicts({EXPERT: share(1.0)})) == {
        "rooms to learn from", "held-out rooms", "seeds of each training", "rooms in which somebody could not act",
    }  # fmt: skip


def test_what_kills_leave_is_held_against_whole_ones_and_who_was_not_killed_proves_nothing() -> None:
    sound = {
        "trainings_killed": len(KILLS), "evaluations_killed": 1, "trajectories": 9, "same_weights": True, "same_losses": True,
        "same_trajectories": True,
    }  # fmt: skip
    assert all(row["met"] for row in kill_goals(sound))
    for key, value in (("trainings_killed", 1), ("evaluations_killed", 0), ("trajectories", 0), ("same_weights", False),
                       ("same_losses", False), ("same_trajectories", False)):  # fmt: skip
        assert [row["met"] for row in kill_goals(sound | {key: value})].count(False) == 1, key


def test_a_fifth_of_the_rooms_is_held_out_by_the_seed() -> None:
    held = PolicyRooms(Path(), 75, 0).tested
    assert len(held) == 15
    assert held <= {*range(75)}
    assert held == PolicyRooms(Path("elsewhere"), 75, 0).tested != PolicyRooms(Path(), 75, 1).tested
    assert [len(PolicyRooms(Path(), count, 0).tested) for count in (2, 3, 10)] == [1, 1, 2]
    marks = {PolicyRooms(Path(), *words).mark for words in ((75, 0), (76, 0), (75, 1), (75, 0, 50))}
    assert len(marks) == 4
    assert PolicyRooms(Path("elsewhere"), 75, 0).mark in marks


def test_variants_differ_in_what_they_are_called_by_and_learn_from_experts_who_face_the_target() -> None:
    systems = {name: PolicyTraining(name, 0).system for name in VARIANTS}
    assert [name for name, system in systems.items() if system.corrections.rounds == ROUNDS] == [
        DAGGER, "blind-dagger", "goalless-dagger", "small-dagger"
    ]  # fmt: skip
    assert [name for name, system in systems.items() if system.model.blind] == [BLIND, "blind-dagger"]
    assert [name for name, system in systems.items() if system.model.goalless] == [GOALLESS, "goalless-dagger"]
    assert [name for name, system in systems.items() if system.model.senses_goal] == [SENSING, DAGGER]
    assert {(system.walks.facing, system.walks.stop_m) for system in systems.values()} == {(True, STOP_M)}
    assert len({system.fitting for system in systems.values()}) == 1
    assert (systems[SMALL].walks.train_episodes, systems[SMALL].walks.test_episodes) == (100, 50)
    short = PolicyTraining(DAGGER, 5, 40, 8)
    assert (short.system.fitting.steps, short.system.corrections.steps, short.system.fitting.validate_steps) == (40, 20, 10)
    assert (short.system.walks.train_episodes, short.system.walks.test_episodes) == (8, 4)
    assert (short.configuration.seed, short.configuration.stages["training"].system) == (5, short.system)
    config = settings_of(3, 40)
    assert (config.seed, config.stages["evaluation"].success_m, config.stages["evaluation"].max_steps) == (3, SUCCESS_M, 40)
    assert settings_of(0, 0).stages["evaluation"].max_steps == 500


@pytest.mark.whole
def test_rooms_are_made_once_and_lie_on_their_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def scene(number: int, count: int, seed: int, shares: Any) -> Any:
        asked.append(number)
        return generated_scene(number % 2, 40, seed, shares=shares)

    monkeypatch.setattr(rooms, "generated_scene", scene)
    data = PolicyRooms(tmp_path, 2, 0, 6)
    told: list[str] = []
    make_rooms(data, 1, told.append)
    assert told == [room_name(0), room_name(1)]
    reader, (held,) = data.lake.snapshot(), data.tested
    assert {row.room_id: row.split for row in reader.rows(Split)} == {room_name(held): "test", room_name(1 - held): "train"}
    episodes = reader.rows(Episode)
    assert {(row.scene_id, row.split) for row in episodes} == {(room_name(held), "test"), (room_name(1 - held), "train")}
    assert [sum(row.split == split for row in episodes) for split in ("train", "test")] == [6, 3]
    assert data.held_out == [room_name(held)]
    before, asked[:] = digests(reader), []
    make_rooms(data, 1, told.append)
    assert (asked, len(told)) == ([], 4)
    again = PolicyRooms(tmp_path / "again", 2, 0, 6)
    make_rooms(again, 1, told.append)
    assert digests(again.lake.snapshot())["episodes"] == before["episodes"]


def test_a_room_without_floor_is_drawn_again_and_not_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    staged: list[Any] = []

    def scene(number: int, count: int, seed: int, shares: Any) -> FurnishedRoom | int:
        seeds.append(seed)
        return seed

    monkeypatch.setattr(rooms, "generated_scene", scene)
    monkeypatch.setattr(rooms, "as_drawn", lambda drawn: (drawn, {}))
    monkeypatch.setattr(rooms, "with_episodes", lambda rows, *_: ({"episodes": [1] if rows > rooms.ANEW else []}, {}))
    monkeypatch.setattr(rooms, "stage_room", lambda lake, rows, *_: staged.append(rows))
    data = PolicyRooms(tmp_path, 5, 7)
    assert make_room(data, 0) == 0
    assert seeds == [7, 7 + rooms.ANEW]
    assert staged == [{"episodes": [1]}]
    monkeypatch.setattr(rooms, "with_episodes", lambda *_: ({"episodes": []}, {}))
    with pytest.raises(InputError, match=r"--rooms: room 0 of 5 leaves the agent no floor in 20 draws; give another --seed"):
        make_room(data, 0)


def test_the_report_shows_each_part_that_was_measured() -> None:
    row = {"name": SMALL, "seed": 0, "model_id": "a", "parameters": 5, "seconds": 60.0, "device": "cpu", "accuracy": 0.9, "majority": 0.6}
    figures = {RANDOM: share(0.06), SMALL: share(0.5)}
    loop = {
        "rooms": {"train": 60, "test": 15}, "episodes": {"train": 6000, "test": 750}, "seeds": 1, "figures": figures, "trainings": [row],
        "accuracy": accuracy_of([row, {**row, "seed": 1, "accuracy": 0.8}]), "failed": ["small 0: bench/room_0001: no navmesh"],
    }  # fmt: skip
    steps = {"agents": 2, "scenes": 1, "objects": 9, "sizes": [64], "batched": {"64": 7000.4}, "copied": {"64": 6000}, "single": {}}
    killed = {"trainings_killed": 2, "evaluations_killed": 1, "trajectories": 9, "rooms": 4}
    where = {"processor": "p", "cores": 2, "system": "s", "python": "3", "versions": {}}
    goals = loop_goals(loop["rooms"], 1, figures, loop["accuracy"], loop["failed"])
    page = io.StringIO()
    parts = {LOOP: loop, "steps": steps, "killed": killed}
    print_policy({"machine": where, "seed": 0, "processes": 1, "parts": parts, "goals": goals}, Console(file=page, width=170))
    text = page.getvalue()
    for words in ("50.0 (45.0-55.0)", "40 / 100", "85.0 (80.0-90.0)", "7,000", "2 times a training", "failed: small 0: bench/room_0001: no",
                  "6,000 episodes in 60 rooms", "MISSED", "n/a"):  # fmt: skip
        assert words in text


def test_the_command_knows_its_parts_and_variants() -> None:
    runner = CliRunner()
    for option, value in (("--parts", "loops"), ("--variants", "tiny")):
        refused = runner.invoke(cli, ["bench", "policy", option, value])
        assert refused.exit_code == 2
        assert f"'{value}' is none of" in refused.output
    config = PolicyBench(Path(), rooms=10, seeds=2)
    assert config.variants == USUAL
    assert len(config.trainings) == 2 * len(USUAL)
    assert PolicyBench(Path(), rooms=10, seeds=2, variants=(SMALL,), parts=(LOOP,)).advances == 10 + 2 * 2 + 2 + 2


@pytest.mark.slow
@pytest.mark.whole
def test_a_whole_benchmark_goes_on_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    words = ["bench", "policy", "--rooms", "3", "--episodes", "4", "--seeds", "1", "--steps", "3", "--variants", "small", "--parts", "loop",
             "--processes", "1", "--folder", str(tmp_path / "policy"), "--json"]  # fmt: skip
    first = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert first.exit_code == 1, first.output  # three steps teach nothing, and three rooms are too few
    report = json.loads(first.stdout)["parts"][LOOP]
    assert Lake.open(report["lake"]).exists
    assert (report["rooms"], report["episodes"], report["failed"]) == ({"train": 2, "test": 1}, {"train": 8, "test": 2}, [])
    assert set(report["figures"]) == {RANDOM, EXPERT, FACING, SMALL}
    assert {row["n"] for row in report["figures"].values()} == {2}
    assert report["figures"][FACING]["found"] == report["figures"][FACING]["success"] == report["figures"][EXPERT]["success"] == 1.0
    assert report["figures"][EXPERT]["sel"] == 1.0
    (training,) = report["trainings"]
    assert 0 < training["accuracy"] < 1
    assert 0 < training["majority"] < 1

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("was made before")

    monkeypatch.setattr(trainings, "train", lambda lake, planned: planned.held or refuse())
    monkeypatch.setattr(rooms, "make_room", refuse)
    again = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert json.loads(again.stdout)["parts"][LOOP] == report


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.timeout(1800)
def test_who_is_killed_goes_on_to_the_same_weights_and_rows(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    report = measure_kills(KillsBench(tmp_path, rooms=3, episodes=8), lambda _: None)
    assert [row["goal"] for row in report["goals"] if not row["met"]] == []
