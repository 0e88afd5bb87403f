"""Evaluation: trajectories from files and built-in policies, and metrics in SQL against plain Python."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.inputs.evaluation import import_trajectories, metrics_of, run_policy
from flows.run.configuration import configure
from schemas.errors import InputError
from schemas.evaluation import ACTIONS, Trajectory
from schemas.navigation import Episode, Navmesh
from schemas.record import rows_to_arrow
from schemas.runs import StageRun
from tasks import navigation
from tasks.batches import parse_json
from tasks.evaluation import POLICIES, SCHEMA_FILE, STAGE, EvaluationConfig, TrajectoryBatch, parse_batch, read_batch, run
from tasks.evaluation.measures import path_finder
from tasks.exports.habitat import rotation
from tasks.families import member
from tasks.geometry.transforms import Z_UP_TO_Y_UP, transform_points
from tasks.navigation.recast import RecastConfig
from tasks.stage import Context
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.tasks.navigation.test_navigation import CONFIG, SCENE, living_room
from tests.tasks.navigation.test_recast import native
from tests.warehouse.questions.view_answers import Database, by_key, same
from warehouse.lake import Lake

quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


# The metrics in plain Python. SQL must give the same.


def success(row: Trajectory) -> bool:
    """S: stop was called and the geodesic distance to the nearest view point is below the success distance (Anderson et al. 2018)."""
    return row.called_stop and row.final_distance_m is not None and row.final_distance_m < row.success_distance_m


def spl(row: Trajectory) -> float:
    """S l / max(p, l): l the geodesic distance at the start, p the travelled length (Anderson et al. 2018); 1 where both are 0."""
    longest = max(row.travelled_m, row.start_distance_m)
    return float(success(row)) * (row.start_distance_m / longest if longest else 1.0)


def sel(row: Trajectory) -> float:
    """S w / max(e, w): w the expert's actions, e the episode's (as SPOC computes it); where w is 0, 1 if e is 0 and else 0."""
    e, w = len(row.actions), row.expert_actions
    if not success(row):
        return 0.0
    return w / max(e, w) if w else float(e == 0)


def way(row: Trajectory) -> list[complex]:
    """Positions as complex numbers, those less than 1 mm from the one before left out."""
    at = [complex(x, y) for x, y, _ in row.poses]
    return at[:1] + [b for a, b in itertools.pairwise(at) if abs(b - a) >= 1e-3]


def curvature_finite_differences(row: Trajectory) -> float:
    """Mean of |x' y'' - y' x''| / (x'^2 + y'^2)^(3/2) over inner positions by central differences; 0 for fewer than three."""
    found, at = [], way(row)
    for a, b, c in zip(at, at[1:], at[2:], strict=False):
        first, second = (c - a) / 2, c - 2 * b + a
        if abs(first) > 1e-6:
            found.append(abs((first.conjugate() * second).imag) / abs(first) ** 3)
    return math.fsum(found) / len(found) if found else 0.0


def curvature_turning_angle(row: Trajectory) -> float:
    """Sum of turning angles over the sum of the mean lengths of the steps that meet there [rad/m]; 0 for fewer than three."""
    at = way(row)
    steps = [b - a for a, b in itertools.pairwise(at)]
    turns = [abs(math.atan2(z.imag, z.real)) for z in (b * a.conjugate() for a, b in itertools.pairwise(steps))]
    lengths = [(abs(a) + abs(b)) / 2 for a, b in itertools.pairwise(steps)]
    return math.fsum(turns) / math.fsum(lengths) if lengths else 0.0


def trajectory(**values: Any) -> Trajectory:
    given = {
        "scene_id": SCENE, "actions": ("forward", "stop"), "poses": ((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), (0.25, 0.0, 0.0)),
        "called_stop": True, "travelled_m": 0.25, "start_distance_m": 0.25, "final_distance_m": 0.0, "success_distance_m": 0.2,
        "expert_actions": 2,
    }  # fmt: skip
    return sample(Trajectory, **(given | values))


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    made = Database()
    yield made
    made.connection.close()


CORNER = ((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), (0.25, 0.0, math.pi / 6), (0.25 + 0.25 * math.cos(math.pi / 6), 0.125, math.pi / 6))

# Worked by hand. Shortest path l = 3 m, travelled p = 4 m: SPL 3/4. Expert w = 6 actions, episode e = 8: SEL 6/8.
WORKED: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "a detour": (
        {"start_distance_m": 3.0, "travelled_m": 4.0, "expert_actions": 6, "actions": ("forward",) * 7 + ("stop",)},
        {"success": True, "spl": 0.75, "sel": 0.75, "episode_length": 8},
    ),
    # Shorter than the shortest way to the view point, since 0.2 m before it is enough: the quotients stop at 1.
    "better than the expert": (
        {"start_distance_m": 3.0, "travelled_m": 2.875, "expert_actions": 6, "actions": ("forward",) * 4 + ("stop",)},
        {"success": True, "spl": 1.0, "sel": 1.0, "episode_length": 5},
    ),
    "at the success distance is not below it": ({"final_distance_m": 0.2}, {"success": False, "spl": 0.0, "sel": 0.0}),
    "there without a stop": ({"called_stop": False, "actions": ("forward",)}, {"success": False, "spl": 0.0, "sel": 0.0}),
    "an end off the navmesh": ({"final_distance_m": None}, {"success": False, "spl": 0.0, "sel": 0.0}),
    "stopped at once, at the target": (
        {"actions": ("stop",), "poses": ((0.0, 0.0, 0.0),) * 2, "travelled_m": 0.0, "start_distance_m": 0.0, "expert_actions": 1},
        {"success": True, "spl": 1.0, "sel": 1.0, "episode_length": 1, "curvature_finite_differences_per_m": 0.0,
         "curvature_turning_angle_per_m": 0.0},
    ),
    "an expert without actions": ({"expert_actions": 0}, {"success": True, "sel": 0.0}),
    # Two positions are left once the stop's is dropped, so there is no corner.
    "straight": ({}, {"curvature_finite_differences_per_m": 0.0, "curvature_turning_angle_per_m": 0.0}),
    # Steps d = 1/4 with a corner t = 30 degrees: t / d = 2.0944; by differences 2 sin(t/2) / (d cos^2(t/2)) = 2.2192.
    "a corner of 30 degrees": (
        {"actions": ("forward", "left", "forward"), "poses": CORNER},
        {"curvature_turning_angle_per_m": math.pi / 6 / 0.25,
         "curvature_finite_differences_per_m": 2 * math.sin(math.pi / 12) / (0.25 * math.cos(math.pi / 12) ** 2)},
    ),
    # Forth and back: half a turn over one step, pi / 0.25; differences have no direction there and leave it out.
    "forth and back": (
        {"poses": ((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), (0.0, 0.0, math.pi))},
        {"curvature_turning_angle_per_m": math.pi / 0.25, "curvature_finite_differences_per_m": 0.0},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WORKED)
def test_metrics_worked_by_hand(database: Database, name: str) -> None:
    values, expected = WORKED[name]
    database.fill(trajectory(**values))
    (row,) = database.ask("trajectory_metrics")
    same(row, **expected)


def test_points_of_a_circle_have_its_curvature(database: Database) -> None:
    """A circle of radius 2 m in steps of 1 degree: 1/2 rad/m by both readings, up to the square of the step."""
    angles = np.radians(np.arange(91))
    poses = tuple((2 * math.cos(a), 2 * math.sin(a), a) for a in angles)
    database.fill(trajectory(poses=poses))
    (row,) = database.ask("trajectory_curvature")
    assert row["curvature_turning_angle_per_m"] == pytest.approx(0.5, rel=1e-4)
    assert row["curvature_finite_differences_per_m"] == pytest.approx(0.5, rel=1e-3)


coordinate = st.sampled_from([0.0, 0.0004, 0.25, 0.5]) | st.integers(-320, 320).map(lambda n: n / 64)
"""No two differ by about 1 mm, where rounding would decide whether a position is repeated."""


BEGINNINGS = (
    ((1.0, 2.0, 0.0), 0.5, "0001"), ((1.0, 2.5, 0.0), 0.5, "0001"), ((1.0, 2.0, 0.0), 0.75, "0001"), ((1.0, 2.0, 0.0), 0.5, "0002")
)  # fmt: skip
"""Start, heading and target of an episode: trajectories have the first or the second."""


def begins(row: Trajectory | Episode) -> tuple[Any, ...]:
    return row.start_position, row.start_yaw_radians, row.instance_id


def spread(values: list[float]) -> Any:
    """1.96 standard errors of a mean, None for one value."""
    return pytest.approx(1.96 * np.std(values, ddof=1) / math.sqrt(len(values)), rel=1e-9, abs=1e-12) if len(values) > 1 else None


@st.composite
def trajectories(draw: st.DrawFn) -> list[Any]:
    """Trajectories of some policies in batches, the runs that brought them, and some of the episodes."""
    rows: list[Any] = []
    batches = draw(st.lists(st.sampled_from(["b1", "b2", "b3"]), unique=True))
    order = draw(st.permutations(batches))
    for batch in batches:
        policy, success_distance = draw(st.sampled_from(["expert", "mine"])), draw(st.sampled_from([0.2, 0.3]))
        rows.append(stage_run(batch, "evaluation", fingerprint(batch), snapshot_id=1 + order.index(batch)))
        for scene, episode in draw(st.lists(st.tuples(st.sampled_from(["demo/a", "demo/b"]), st.integers(0, 3)), unique=True)):
            actions = tuple(draw(st.lists(st.sampled_from(ACTIONS[:3]), max_size=6))) + ("stop",) * draw(st.integers(0, 1))
            rows.append(trajectory(
                batch_id=batch, scene_id=scene, episode_id=f"{episode:04d}", policy=policy, run_name="r",
                split="train" if scene == "demo/a" else "test", category=draw(st.sampled_from(["chair", "mug"])), agent="a",
                actions=actions, called_stop=actions[-1:] == ("stop",), poses=tuple(
                    (draw(coordinate), draw(coordinate), 0.0) for _ in range(len(actions) + 1)
                ), collisions=draw(st.integers(0, 2)), travelled_m=draw(st.sampled_from([0.0, 1.0, 2.5])),
                start_distance_m=draw(st.sampled_from([0.0, 1.0, 2.0])), success_distance_m=success_distance,
                final_distance_m=draw(st.sampled_from([None, 0.0, 0.125, 0.2, 3.0])), expert_actions=draw(st.integers(0, 6)),
                problem=draw(st.sampled_from([None, "off"])), instance_id="0001", start_yaw_radians=0.5,
                start_position=draw(st.sampled_from([(1.0, 2.0, 0.0), (1.0, 2.5, 0.0)])),
            ))  # fmt: skip
    for scene, episode in draw(st.lists(st.tuples(st.sampled_from(["demo/a", "demo/b"]), st.integers(0, 3)), unique=True)):
        start, yaw, target = draw(st.sampled_from(BEGINNINGS))
        rows.append(sample(
            Episode, scene_id=scene, episode_id=f"{episode:04d}", instance_id=target, start_position=start, start_yaw_radians=yaw
        ))  # fmt: skip
    return rows


@pytest.mark.slow
@pytest.mark.whole
@quick
@given(rows=trajectories())
def test_sql_is_the_plain_python(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    given_rows = [row for row in rows if type(row) is Trajectory]
    snapshots = {row.scene_id: row.snapshot_id for row in rows if type(row) is StageRun}
    starts = {(row.scene_id, row.episode_id): begins(row) for row in rows if type(row) is Episode}
    counted: dict[tuple[Any, ...], Trajectory] = {}
    for row in sorted(given_rows, key=lambda r: (starts.get((r.scene_id, r.episode_id)) == begins(r), snapshots[r.batch_id])):
        counted[row.policy, row.success_distance_m, row.scene_id, row.episode_id] = row
    answer = by_key(database.ask("trajectory_metrics"), "batch_id", "scene_id", "episode_id")
    assert answer.keys() == {(row.batch_id, row.scene_id, row.episode_id) for row in given_rows}
    for row in given_rows:
        same(
            answer[row.batch_id, row.scene_id, row.episode_id], success=success(row), spl=spl(row), sel=sel(row),
            episode_length=len(row.actions), curvature_finite_differences_per_m=pytest.approx(curvature_finite_differences(row), rel=1e-9),
            curvature_turning_angle_per_m=pytest.approx(curvature_turning_angle(row), rel=1e-9),
            is_counted=counted[row.policy, row.success_distance_m, row.scene_id, row.episode_id] is row,
            is_outdated=starts.get((row.scene_id, row.episode_id)) != begins(row),
        )  # fmt: skip
    for view, names in {
        "navigation_metrics": ("split",), "navigation_metrics_by_scene": ("split", "scene_id"),
        "navigation_metrics_by_category": ("split", "category"),
    }.items():  # fmt: skip
        groups: dict[tuple[Any, ...], list[Trajectory]] = defaultdict(list)
        for row in counted.values():
            groups[row.policy, row.run_name, row.agent, row.success_distance_m, *(getattr(row, name) for name in names)].append(row)
        answers = by_key(database.ask(view), "policy", "run_name", "agent", "success_distance_m", *names)
        assert answers.keys() == groups.keys()
        for key, group in groups.items():
            means = {
                "sr": np.mean([success(r) for r in group]), "spl": np.mean([spl(r) for r in group]),
                "sel": np.mean([sel(r) for r in group]), "el": np.mean([len(r.actions) for r in group]),
                "curvature_turning_angle_per_m": np.mean([curvature_turning_angle(r) for r in group]),
                "curvature_finite_differences_per_m": np.mean([curvature_finite_differences(r) for r in group]),
            }  # fmt: skip
            found = answers[key]
            assert {name: found[name] for name in means} == pytest.approx(means, rel=1e-9, abs=1e-12)
            assert found["n"] == len(group)
            assert found["outdated"] == sum(starts.get((r.scene_id, r.episode_id)) != begins(r) for r in group)
            won = [len(r.actions) for r in group if success(r)]
            left = [r.final_distance_m for r in group if r.final_distance_m is not None]
            assert found["el_success"] == (pytest.approx(np.mean(won)) if won else None)
            assert found["final_distance_m"] == (pytest.approx(np.mean(left)) if left else None)
            assert found["mean_collisions"] == pytest.approx(np.mean([r.collisions for r in group]))
            assert found["problems"] == sum(r.problem is not None for r in group)
            assert found.get("scenes", 1) == len({r.scene_id for r in group})
            assert (found["spl_95"], found["sel_95"]) == (spread([spl(r) for r in group]), spread([sel(r) for r in group]))
            assert found["spl"] <= found["sr"] + 1e-12
            assert found["sel"] <= found["sr"] + 1e-12
            assert 0 <= found["sr_low"] <= found["sr"] <= found["sr_high"] <= 1
            for end in (found["sr_low"], found["sr_high"]):  # Wilson's ends p solve |sr - p| = z sqrt(p (1 - p) / n)
                if 0 < end < 1:
                    assert abs(found["sr"] - end) == pytest.approx(1.96 * math.sqrt(end * (1 - end) / len(group)), rel=1e-6)


def test_an_empty_table_gives_empty_answers(database: Database) -> None:
    database.fill()
    for view in ("trajectory_metrics", "trajectory_curvature", "navigation_metrics", "navigation_metrics_by_scene"):
        assert database.ask(view) == []
    assert database.ask("navigation_metrics_by_category") == []


# The stage on a generated scene.


@pytest.fixture(scope="module")
def scene() -> tuple[list[Episode], list[Navmesh], dict[str, bytes]]:
    """Episodes, navmesh and blobs of a furnished room."""
    tables, context = living_room()
    made = navigation.run(**tables, context=context, config=dataclasses.replace(CONFIG, train_episodes=40, test_episodes=40))
    return made.rows["episodes"], made.rows["navmeshes"], dict(made.blobs)


@pytest.fixture
def lake(scene: tuple[list[Episode], list[Navmesh], dict[str, bytes]], tmp_path: Path) -> Lake:
    """A lake that holds the room's navigation."""
    made = Lake.open(tmp_path / "lake")
    _commit(made, *scene)
    return made


def _commit(lake: Lake, episodes: list[Episode], navmeshes: list[Navmesh], blobs: dict[str, bytes]) -> None:
    for name, data in blobs.items():
        lake.blobs.put(data, name.partition(".")[2])
    rows = {"episodes": episodes, "navmeshes": navmeshes}
    at = float(lake.snapshot().snapshot_id)
    lake.stage_rows(stage_run(SCENE, "navigation", fingerprint(len(episodes), at), at=at), rows)
    lake.commit("navigation")


def measured(scene: tuple[list[Episode], list[Navmesh], dict[str, bytes]], batch: TrajectoryBatch, **values: Any) -> list[Trajectory]:
    episodes, navmeshes, blobs = scene
    context = Context(batch.batch_id, STAGE.name, 0, blobs)
    rows = run(
        trajectory_batch=batch, episodes=episodes, navmeshes=navmeshes, shells=(), instances=(), assets=(), placements=(), context=context,
        config=EvaluationConfig(**values),
    ).rows["trajectories"]  # fmt: skip
    rows_to_arrow(rows, Trajectory)
    return rows


def built_in(scene: tuple[list[Episode], list[Navmesh], dict[str, bytes]], policy: str, seed: int = 0) -> list[Trajectory]:
    context = Context(policy, STAGE.name, seed, {})
    return measured(scene, TrajectoryBatch(policy, policy, "r", member(POLICIES, policy).act(scene[0], EvaluationConfig(), context.rng)))


def test_the_expert_arrives_as_its_episodes_say(scene: Any) -> None:
    episodes = {row.episode_id: row for row in scene[0]}
    rows = built_in(scene, "expert")
    assert len(rows) == len(episodes) == 40
    for row in rows:
        episode = episodes[row.episode_id]
        assert success(row)
        assert row.collisions == 0
        assert row.problem is None
        assert row.poses[-1][:2] == pytest.approx(episode.final_position[:2], abs=1e-5)
        assert row.start_distance_m == pytest.approx(episode.geodesic_m, abs=1e-4)
        assert row.final_distance_m <= episode.final_distance_m + 1e-4
        assert row.travelled_m == pytest.approx(0.25 * row.actions.count("forward"), abs=1e-9)
        assert sel(row) == 1.0
    assert np.mean([spl(row) for row in rows]) > 0.9


@native
def test_the_expert_arrives_on_navmeshes_of_recast() -> None:
    """Distances are exact on the same polygons: never longer than those that Detour gave the episodes."""
    tables, context = living_room()
    config = dataclasses.replace(CONFIG, train_episodes=40, test_episodes=40, path_finder=RecastConfig())
    made = navigation.run(**tables, context=context, config=config)
    episodes = {row.episode_id: row for row in made.rows["episodes"]}
    rows = built_in((made.rows["episodes"], made.rows["navmeshes"], dict(made.blobs)), "expert")
    assert len(rows) == 40
    for row in rows:
        assert success(row)
        assert (row.collisions, row.problem) == (0, None)
        assert math.dist(row.poses[-1][:2], episodes[row.episode_id].final_position[:2]) < 1e-5
        assert row.start_distance_m <= episodes[row.episode_id].geodesic_m + 1e-3


def test_chance_is_far_below_the_expert_and_never_leaves_the_navmesh(scene: Any) -> None:
    (mesh,) = scene[1]
    free = shapely.buffer(path_finder(scene[2][mesh.navmesh_blob], "x").free, 2e-6)
    for seed in range(3):
        rows = built_in(scene, "random", seed)
        assert np.mean([success(row) for row in rows]) < 0.5
        assert all(row.problem is None for row in rows)
        for row in rows:
            assert free.covers(shapely.LineString(np.array(row.poses)[:, :2]))
            assert row.final_distance_m is not None
            assert len(row.actions) <= EvaluationConfig().max_steps
        assert sum(row.collisions for row in rows) > 0
    actions = [a for row in rows for a in row.actions if a != "stop"]
    share = actions.count("forward") / len(actions)
    assert abs(share - 1 / 3) < 4 * math.sqrt(2 / 9 / len(actions))
    assert built_in(scene, "random", 2) == rows
    assert built_in(scene, "random", 1) != rows
    fewer = (scene[0][::2], scene[1], scene[2])
    assert built_in(fewer, "random", 2) == [row for row in rows if row.episode_id in {e.episode_id for e in fewer[0]}]


def as_file(rows: list[Trajectory], frame: str, *, poses: bool = True, **values: Any) -> dict[str, Any]:
    """Trajectories as another program would write them."""
    items = []
    for row in rows:
        item: dict[str, Any] = {"scene_id": row.scene_id, "episode_id": row.episode_id, "actions": list(row.actions)}
        if frame == "habitat":
            item["actions"] = [{"forward": "move_forward", "left": "turn_left", "right": "turn_right"}.get(a, a) for a in row.actions]
        if poses and frame == "world":
            item["poses"] = [list(pose) for pose in row.poses]
        if poses and frame == "habitat":
            at = np.array([(x, y, 0.1) for x, y, _ in row.poses])
            item["positions"] = transform_points(at, Z_UP_TO_Y_UP).tolist()
            item["rotations"] = [rotation(yaw) for _, _, yaw in row.poses]
        items.append(item)
    return {"batch_id": "mine-1", "policy": "mine", "run_name": "seed 7", "frame": frame, "trajectories": items} | values


@pytest.mark.parametrize("policy", ["expert", "random"])
@pytest.mark.parametrize("frame", ["world", "habitat"])
def test_a_file_of_what_a_policy_did_gives_its_rows(scene: Any, frame: str, policy: str, tmp_path: Path) -> None:
    """The same through JSON, JSON Lines, either frame, and without poses, up to the digits that the file has."""
    wanted = built_in(scene, policy)
    document = as_file(wanted, frame)
    (tmp_path / "a.json").write_text(json.dumps(document))
    head = {key: value for key, value in document.items() if key != "trajectories"}
    (tmp_path / "a.jsonl").write_text("\n".join(json.dumps(item) for item in [head, *document["trajectories"]]) + "\n\n")
    (tmp_path / "b.json").write_text(json.dumps(as_file(wanted[::-1], frame, poses=False)))
    for name in ("a.json", "a.jsonl", "b.json"):
        batch = read_batch(tmp_path / name)
        assert (batch.batch_id, batch.policy, batch.run_name, batch.source_file) == ("mine-1", "mine", "seed 7", name)
        rows = measured(scene, batch)
        for row, expected in zip(rows, wanted, strict=True):
            assert np.allclose([p[:2] for p in row.poses], [p[:2] for p in expected.poses], atol=1e-6)
            turned = [math.remainder(a[2] - b[2], 2 * math.pi) for a, b in zip(row.poses, expected.poses, strict=True)]
            assert np.allclose(turned, 0, atol=1e-6)
            assert (row.actions, row.called_stop, row.episode_id) == (expected.actions, expected.called_stop, expected.episode_id)
            assert row.final_distance_m == pytest.approx(expected.final_distance_m, abs=1e-5)
            assert row.travelled_m == pytest.approx(expected.travelled_m, abs=1e-5)
            assert abs(row.collisions - expected.collisions) <= (0 if policy == "expert" else expected.collisions)
            assert success(row) == success(expected)


def test_collisions_are_those_of_the_file_or_steps_that_ended_short(scene: Any) -> None:
    (first, *_) = built_in(scene, "expert")
    x, y, yaw = first.poses[0]
    ways = [0.0, 0.25, 0.495, 0.725, 0.725, 0.725]  # steps of 25, 24.5, 23 and 0 cm, and a stop
    poses = [[x + way * math.cos(yaw), y + way * math.sin(yaw), yaw] for way in ways]
    item = {"scene_id": SCENE, "episode_id": first.episode_id, "actions": ["forward"] * 4 + ["stop"], "poses": poses}
    for given_, counted in (({}, 2), ({"collisions": 3}, 3), ({"collisions": 0}, 0)):
        (row,) = measured(scene, parse_batch({"batch_id": "b", "policy": "p", "trajectories": [item | given_]}))
        assert row.collisions == counted
        assert row.travelled_m == pytest.approx(0.725)


def test_leaving_the_navmesh_is_recorded_and_no_success(scene: Any) -> None:
    (first, *_) = built_in(scene, "expert")
    # Straight out of the room in whole steps, then a stop there.
    x, y, yaw = first.poses[0]
    poses = [[x + 0.25 * k * math.cos(yaw), y + 0.25 * k * math.sin(yaw), yaw] for k in range(60)]
    item = {"scene_id": SCENE, "episode_id": first.episode_id, "actions": ["forward"] * 59 + ["stop"], "poses": [*poses, poses[-1]]}
    (row,) = measured(scene, parse_batch({"batch_id": "b", "policy": "ghost", "trajectories": [item]}))
    assert row.final_distance_m is None
    assert not success(row)
    assert "off the navmesh, the last one among them" in (row.problem or "")
    assert row.travelled_m == pytest.approx(59 * 0.25)
    assert row.collisions == 0


def change(**values: Any) -> dict[str, Any]:
    return values


WRONG: dict[str, tuple[dict[str, Any], str, str]] = {
    "scene": (change(scene_id="demo/other"), "trajectories[1].scene_id", "has no episodes"),
    "scene name": (change(scene_id="../x"), "trajectories[1].scene_id", "not allowed"),
    "episode": (change(episode_id="0999"), "trajectories[1].episode_id", "no episode 0999"),
    "action": (change(actions=["forward", "fly"]), "trajectories[1].actions[1]", "not allowed: \"fly\""),
    "stop twice": (change(actions=["stop", "stop"]), "trajectories[1].actions", "after the stop at 0"),
    "field": (change(reward=1), "trajectories[1]", "unknown field 'reward'"),
    "count": (change(actions=["stop"]), "trajectories[1].poses", "rows for 1 actions"),
    "flat pose": (change(poses=[[0, 0]]), "trajectories[1].poses[0]", "must have 3 values"),
    "text pose": (change(poses=[[0, 0, "a"]]), "trajectories[1].poses[0][2]", "must be a number"),
    "truth pose": (change(poses=[[0, 0, True]]), "trajectories[1].poses[0][2]", "must be a number"),
    "huge": (change(actions=[], poses=[[1e9, 0, 0]]), "trajectories[1].poses", "too large"),
    "other frame": (change(actions=[], positions=[[0, 0, 0]], rotations=[[0, 0, 0, 1]], poses=...), "trajectories[1]", "frame 'world' has"),
    "long": (change(actions=["left"] * 501, poses=...), "trajectories[1].actions", "the limit is 500"),
    "again": (change(episode_id="0000"), "trajectories[1]", "again, as trajectories[0]"),
    "collisions": (change(collisions=-1), "trajectories[1].collisions", "at least 0"),
    "collisions without steps": (change(actions=["left"], poses=..., collisions=1), "trajectories[1].collisions", "more than the 0"),
    "countless collisions": (change(collisions=10**400), "trajectories[1].collisions", "more than the"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_trajectory_is_refused_with_its_place(scene: Any, name: str, tmp_path: Path) -> None:
    values, where, why = WRONG[name]
    document = as_file(built_in(scene, "expert")[:2], "world")
    item = document["trajectories"][1] | values
    document["trajectories"][1] = {key: value for key, value in item.items() if value is not ...}
    with pytest.raises(InputError) as caught:
        measured(scene, parse_batch(document))
    assert caught.value.field == where
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)
    head = {key: value for key, value in document.items() if key != "trajectories"}
    path = tmp_path / "b.jsonl"
    path.write_text("\n\n".join(json.dumps(one) for one in [head, *document["trajectories"]]))
    with pytest.raises(InputError, match=r"^b\.jsonl: line 5") as caught:
        measured(scene, read_batch(path))
    assert where.partition("]")[2].lstrip(".") in caught.value.field


def test_poses_that_no_run_of_the_episode_can_have_are_refused(scene: Any) -> None:
    (first, *_) = built_in(scene, "expert")

    def refused(**values: Any) -> str:
        document = as_file([dataclasses.replace(first, **values)], "world")
        with pytest.raises(InputError) as caught:
            measured(scene, parse_batch(document))
        return str(caught.value)

    moved = tuple((x + 0.5, y, yaw) for x, y, yaw in first.poses)
    assert "begins 0.5 m from the start" in refused(poses=moved)
    assert "degrees off the heading" in refused(poses=tuple((x, y, yaw + math.pi / 2) for x, y, yaw in first.poses))
    scaled = tuple((moved[0][0] - 0.5 + 2 * (x - moved[0][0] + 0.5), y, yaw) for x, y, yaw in first.poses)
    assert scaled[0] == pytest.approx(first.poses[0])
    stretched = tuple(
        (scaled[0][0] + 2 * (x - first.poses[0][0]), scaled[0][1] + 2 * (y - first.poses[0][1]), w) for x, y, w in first.poses
    )
    assert "moves 0.5 m by 'forward'" in refused(poses=stretched)
    slid = (*first.poses[:-1], (first.poses[-1][0] + 0.05, *first.poses[-1][1:]))
    assert "moves 0.05 m by 'stop'" in refused(poses=slid)


def test_turns_that_are_not_the_robots_are_refused(scene: Any) -> None:
    first = next(row for row in built_in(scene, "expert") if {"left", "right"} & set(row.actions))
    turn = next(i for i, action in enumerate(first.actions) if action in ("left", "right"))
    sign = 1 if first.actions[turn] == "left" else -1

    def refused(**values: Any) -> str:
        with pytest.raises(InputError) as caught:
            measured(scene, parse_batch(as_file([dataclasses.replace(first, **values)], "world")))
        assert caught.value.field == "trajectories[0].poses"
        return str(caught.value)

    other = {"left": "right", "right": "left"}
    swapped = refused(actions=tuple(other.get(action, action) for action in first.actions))
    assert (
        f"turns {30 * sign} degrees (left is above 0) by {other[first.actions[turn]]!r}, which turns {-30 * sign} (action {turn})"
        in swapped
    )
    still = tuple((x, y, first.poses[0][2]) for x, y, _ in first.poses)
    assert "turns 0 degrees" in refused(poses=still)
    # A robot that turns twice as far by one action needs fewer of them: its episode lengths are not those of this one.
    wide = tuple((x, y, yaw + (sign * math.pi / 6 if i > turn else 0)) for i, (x, y, yaw) in enumerate(first.poses))
    assert f"turns {60 * sign} degrees" in refused(poses=wide)
    spun = tuple((x, y, yaw + (0.1 if i == len(first.actions) else 0)) for i, (x, y, yaw) in enumerate(first.poses))
    assert "by 'stop', which turns 0" in refused(poses=spun)


def test_a_habitat_rotation_that_is_no_upright_turn_is_refused(scene: Any) -> None:
    document = as_file(built_in(scene, "expert")[:1], "habitat")
    other_order = [math.cos(0.3), 0, math.sin(0.3), 0]  # w, x, y, z of a turn about +Y: read as x, y, z, w it stands on its head
    for wrong, why in (
        ([0, 0, 0, 2], "length 2"), ([math.sin(0.1), 0, 0, math.cos(0.1)], "not upright"), (other_order, "not upright")
    ):  # fmt: skip
        document["trajectories"][0]["rotations"][1] = wrong
        with pytest.raises(InputError, match=why) as caught:
            parse_batch(document)
        assert caught.value.field == "trajectories[0].rotations[1]"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "line 1"),
        (b"[]", "line 1"),
        (b"{", "line 1 column"),
        (b'{"batch_id": "b", "policy": "p"}\n{', "line 2 column"),
        (b'{"batch_id": "b", "policy": "p"}\n', "no trajectories"),
        (b'{"batch_id": "b"}\n', "line 1: lacks 'policy'"),
        (b'{"batch_id": "b", "policy": "p", "policy": "q"}', "twice"),
        (b'{"batch_id": NaN}', "NaN"),
    ],
)
def test_lines_that_are_no_batch_are_refused(tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "b.jsonl").write_bytes(content)
    with pytest.raises(InputError, match=r"^b\.jsonl") as caught:
        read_batch(tmp_path / "b.jsonl")
    assert why in str(caught.value)


@pytest.mark.parametrize("head", [b"", b'{"batch_id": "b", "policy": "p"}\n'])
def test_the_first_line_that_is_wrong_is_refused_before_the_next_one_is_read(
    head: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "b.jsonl").write_bytes(head + b"11\n" * 5_000_000)
    parsed = list[bytes]()

    def parse(raw: bytes, name: str, first_line: int = 1) -> Any:
        parsed.append(raw)
        assert len(parsed) < 3
        return parse_json(raw, name, first_line)

    monkeypatch.setattr("tasks.evaluation.batch.parse_json", parse)
    with pytest.raises(InputError, match=r"^b\.jsonl: line " + ("2: must be an object" if head else "1: is not the batch")):
        read_batch(tmp_path / "b.jsonl")


def test_lines_of_nothing_have_a_weight(tmp_path: Path) -> None:
    (tmp_path / "b.jsonl").write_bytes(b"\n" * 30_000_000)
    with pytest.raises(InputError, match=r"^b\.jsonl: its values take about \d+ MB"):
        read_batch(tmp_path / "b.jsonl")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5) | st.sampled_from(ACTIONS),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["scene_id", "actions", "x"]), inner, max_size=3),
    max_leaves=12,
)


@given(field=st.sampled_from(["scene_id", "episode_id", "actions", "poses", "positions", "collisions", "other"]), value=json_values)
@settings(max_examples=150, deadline=None)
def test_whatever_a_field_holds_the_schema_decides_as_published(field: str, value: Any) -> None:
    """Cutting long lists short before the check lets nothing through that the published schema refuses."""
    item = {"scene_id": SCENE, "episode_id": "0001", "actions": []} | {field: value}
    document = {"batch_id": "b", "policy": "p", "trajectories": [item]}
    valid = not list(jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text())).iter_errors(document))
    refused = None
    try:
        assert len(parse_batch(document).attempts) == 1
    except InputError as error:
        refused = error
    if refused is None:
        assert valid
    else:
        assert "\n" not in str(refused)
        assert refused.field.startswith("trajectories[0]")


def test_the_published_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(SCHEMA_FILE.read_text()))


# Through a lake.


@pytest.mark.whole
def test_a_batch_goes_into_the_lake_once(lake: Lake, tmp_path: Path) -> None:
    configuration = configure()
    expert = run_policy(lake, "expert", configuration)
    assert (expert.trajectories, expert.new, expert.scenes, expert.failed) == (40, 40, 1, ())
    random = run_policy(lake, "random", configuration)
    snapshot = lake.snapshot().snapshot_id
    assert run_policy(lake, "expert", configuration) == dataclasses.replace(expert, new=0)
    rows = [row for row in lake.snapshot().rows(Trajectory) if row.policy == "random"]
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(as_file(rows, "world")))
    assert import_trajectories(lake, path, configuration, dry_run=True).new == 40
    assert lake.snapshot().snapshot_id == snapshot
    mine = import_trajectories(lake, path, configuration)
    again = import_trajectories(lake, path, configuration)
    assert (mine.new, again.new, again.trajectories) == (40, 0, 40)
    assert lake.snapshot().snapshot_id == snapshot + 1
    by_policy = {row["policy"]: row for row in metrics_of(lake.snapshot(), [expert, random, mine], configuration)}
    assert by_policy["expert"]["sr"] == by_policy["expert"]["sel"] == 1.0
    assert by_policy["expert"]["spl"] > 0.9
    assert by_policy["random"]["sr"] < by_policy["expert"]["sr"]
    for name in ("n", "sr", "spl", "sel", "el", "outdated", "curvature_turning_angle_per_m", "curvature_finite_differences_per_m"):
        assert by_policy["mine"][name] == pytest.approx(by_policy["random"][name], abs=1e-9)
    path.write_text(json.dumps(as_file(rows[1:], "world")))
    with pytest.raises(InputError, match="in the lake with other trajectories"):
        import_trajectories(lake, path, configuration)


def test_what_was_measured_and_not_committed_is_not_measured_again(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a kill between the two."""
    with monkeypatch.context() as patch:
        patch.setattr(Lake, "commit", lambda *_, **__: None)
        run_policy(lake, "random", configure())
    assert not lake.snapshot().rows(Trajectory)
    assert run_policy(lake, "random", configure()).new == 0
    assert len(lake.snapshot().rows(Trajectory)) == 40


@pytest.mark.whole
def test_metrics_are_those_of_the_settings_that_are_given(lake: Lake) -> None:
    usual, strict = configure(), configure(settings=["evaluation.success_m=0.01", "evaluation.stop_probability=0.3"])

    def told(configuration: Any) -> list[tuple[Any, ...]]:
        done = [run_policy(lake, policy, configuration) for policy in ("expert", "random")]
        rows = metrics_of(lake.snapshot(), done, configuration)
        assert [row["n"] for row in rows] == [40, 40]
        return [(row["run_name"], row["success_distance_m"], row["sr"], row["el"]) for row in rows]

    first = told(usual)
    other = told(strict)
    assert told(usual) == first
    assert told(strict) == other
    assert [row[:2] for row in first + other] == [
        ("built-in", 0.2), ("seed 0", 0.2), ("built-in", 0.01), ("seed 0, stop_probability 0.3", 0.01)
    ]  # fmt: skip
    assert first[0][2] == 1.0 > other[0][2]
    assert first[1][3] > other[1][3]


def test_a_batch_is_measured_at_one_success_distance(lake: Lake, scene: Any, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(as_file(built_in(scene, "random"), "world")))
    import_trajectories(lake, path, configure())
    with pytest.raises(InputError, match=r"at a success distance of 0\.2 m, not 1 m"):
        import_trajectories(lake, path, configure(settings=["evaluation.success_m=1.0"]))
    assert import_trajectories(lake, path, configure()).new == 0


def test_newer_code_measures_again_in_place(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run_policy(lake, "random", configure())
    before = lake.snapshot().rows(Trajectory)
    monkeypatch.setattr("flows.evaluation.measuring.code_fingerprint", lambda _: "newer")
    again = run_policy(lake, "random", configure())
    assert (again.batches, again.new) == (first.batches, 40)
    assert lake.snapshot().rows(Trajectory) == before
    assert run_policy(lake, "random", configure()).new == 0


@pytest.mark.whole
def test_changed_episodes_change_no_old_metric(lake: Lake, scene: Any) -> None:
    run_policy(lake, "expert", configure())
    before = lake.snapshot().rows(Trajectory)
    episodes, navmeshes, blobs = scene
    # As after a new capture: half the episodes have gone, one has the start of another.
    changed = episodes[:20]
    changed[3] = dataclasses.replace(episodes[30], episode_id=changed[3].episode_id)
    _commit(lake, changed, navmeshes, blobs)

    def counts() -> list[Any]:
        with lake.snapshot().connect() as connection:
            return connection.sql("SELECT sr, n, outdated FROM navigation_metrics").fetchall()

    assert counts() == [(1.0, 40, 21)]
    assert lake.snapshot().rows(Trajectory) == before
    second = run_policy(lake, "expert", configure())
    assert second.new == 20
    assert [row for row in lake.snapshot().rows(Trajectory) if row.batch_id not in second.batches] == before
    assert counts() == [(1.0, 40, 20)]  # 20 trajectories took the place of older ones, 20 episodes are gone
    _commit(lake, episodes, navmeshes, blobs)
    assert run_policy(lake, "expert", configure()).new == 0
    assert counts() == [(1.0, 40, 0)]  # the first batch's trajectories are of the lake's episodes again


def test_a_scene_without_a_usable_navmesh_does_not_stop_the_others(lake: Lake, scene: Any) -> None:
    episodes, navmeshes, _ = scene
    broken = lake.blobs.put(b"TESM", "navmesh")
    for name, blob in (("demo/none", None), ("demo/torn", broken)):
        rows = {
            "episodes": [dataclasses.replace(row, scene_id=name) for row in episodes[:3]],
            "navmeshes": [dataclasses.replace(navmeshes[0], scene_id=name, navmesh_blob=blob)] if blob else [],
        }
        lake.stage_rows(stage_run(name, "navigation", fingerprint(name)), rows)
    lake.commit("two more")
    done = run_policy(lake, "random", configure())
    assert (done.scenes, done.trajectories, len(done.failed)) == (1, 40, 2)
    assert "no navmesh for agent" in done.failed[0]
    assert "cut short" in done.failed[1]
    failed = [row for row in lake.snapshot().rows(StageRun) if row.outcome == "failed"]
    assert sorted(f"{row.error_kind} {row.stage}" for row in failed) == ["input evaluation"] * 2
    assert len(lake.snapshot().rows(Trajectory)) == 40


def test_a_robot_that_moves_otherwise_than_the_episodes_is_refused(lake: Lake) -> None:
    with pytest.raises(InputError, match=r"evaluation\.forward_m"):
        run_policy(lake, "expert", configure(settings=["evaluation.forward_m=0.5"]))


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_says_how_well_and_exits_as_a_scheduler_expects(lake: Lake, tmp_path: Path) -> None:
    def ask(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "flows.cli", "evaluate", *words, "--lake", lake.address]
        return subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY)

    planned = ask("--policy", "expert", "--dry-run")
    assert planned.returncode == 0
    assert "40 trajectories in 1 scene: 40 would be measured" in planned.stdout
    assert not lake.snapshot().rows(Trajectory)
    done = ask("--policy", "expert", "--policy", "random", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [(one["policy"], one["new"]) for one in told["policies"]] == [("expert", 40), ("random", 40)]
    assert {row["policy"]: row["n"] for row in told["metrics"]} == {"expert": 40, "random": 40}
    again = ask("--policy", "expert")
    assert again.returncode == 0
    assert "0 measured, 40 are in the lake already" in again.stdout
    status = subprocess.run(
        [sys.executable, "-m", "flows.cli", "status", "--lake", lake.address, "--json"], capture_output=True, text=True, cwd=REPOSITORY
    )
    told = json.loads(status.stdout)
    assert (told["scenes"], told["errors"]) == ({SCENE: {"navigation": "done"}}, [])
    assert sum(told["counts"].values()) == 1, "a batch is no scene"
    (tmp_path / "b.json").write_text("{}")
    for words in ([], ["--policy", "expert", str(tmp_path / "b.json")], [str(tmp_path / "b.json")], [str(tmp_path / "none.json")]):
        assert ask(*words).returncode == 2
    rows = {"episodes": [dataclasses.replace(lake.snapshot().rows(Episode)[0], scene_id="demo/none")], "navmeshes": []}
    lake.stage_rows(stage_run("demo/none", "navigation", fingerprint("none")), rows)
    lake.commit("one more")
    partly = ask("--policy", "expert")
    assert partly.returncode == 1
    assert "failed: expert: demo/none" in partly.stderr
