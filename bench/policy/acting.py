"""Policies in held-out rooms: who acts there, by the evaluation that `metascenes evaluate` starts, and figures by the lake's views."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.policy.rooms import PolicyRooms
from bench.policy.trainings import STOP_M, TrainedVariant
from bench.selection.trainings import mapped
from flows.inputs.evaluation import Evaluated, import_trajectories, run_policy
from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.evaluation import ACTIONS
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from tasks.evaluation.configuration import EvaluationConfig
from tasks.evaluation.measures import path_finder
from tasks.evaluation.policies import expert, random
from tasks.evaluation.sights import SceneSights
from tasks.policy.demonstrations import WalkConfig, walk_of
from warehouse.lake import Lake

if TYPE_CHECKING:
    import duckdb

RANDOM, EXPERT = random.RANDOM.name, expert.EXPERT.name
FACING = f"{EXPERT}, facing"
"""Who acts beside models: chance, the actions that come with episodes, and these up to `STOP_M` with turns to the target."""

SUCCESS_M = 1.0
"""A run counts as a success within so far of a view point [m], where nobody asks whether the target is in view."""

FIGURES = """
WITH chosen AS (
    SELECT *, list_contains($in_view, scene_id || ' ' || episode_id) AS starts_in_view
    FROM trajectory_metrics
    WHERE is_counted AND success_distance_m = $success_m AND policy = $policy AND list_contains($runs, run_name)
)
SELECT
    count(*) AS n,
    count(found) AS looked_at,
    count(*) FILTER (found) AS found_count,
    count(found) FILTER (starts_in_view) AS in_view_count,
    count(*) FILTER (found AND starts_in_view) AS found_in_view_count,
    wilson_interval(count(*) FILTER (found), count(found)) AS found_interval,
    wilson_interval(count(*) FILTER (found AND starts_in_view), count(found) FILTER (starts_in_view)) AS found_in_view_interval,
    avg(CAST(found AS INTEGER)) AS found,
    avg(CAST(found AS INTEGER)) FILTER (starts_in_view) AS found_in_view,
    avg(CAST(success AS INTEGER)) AS success,
    avg(CAST(arrived AS INTEGER)) AS arrived,
    avg(CAST(called_stop AS INTEGER)) AS stopped,
    avg(found_spl) AS found_spl,
    avg(spl) AS spl,
    avg(sel) AS sel,
    avg(episode_length) AS el,
    avg(episode_length) FILTER (success) AS el_success,
    avg(curvature_finite_differences_per_m) AS curvature,
    avg(collisions) AS collisions
FROM chosen
"""
"""Figures of the trajectories of some runs of a policy, one of each episode; what is in them is the view's."""


@dataclasses.dataclass(frozen=True)
class ActingPolicy:
    """Who acts. model_id: Of the lake of rooms; None for who learns nothing."""

    name: str
    seed: int
    model_id: str | None = None


@dataclasses.dataclass(frozen=True)
class ActedRun:
    """What came of one who acted. label, run_name: How the lake calls it. failed: What went wrong, a line each."""

    policy: ActingPolicy
    label: str
    run_name: str
    failed: tuple[str, ...]


def acting_in(variants: Sequence[TrainedVariant], seeds: int) -> list[ActingPolicy]:
    """All who act: chance with each seed, experts, and models."""
    return [
        *(ActingPolicy(RANDOM, seed) for seed in range(seeds)), ActingPolicy(EXPERT, 0), ActingPolicy(FACING, 0),
        *(ActingPolicy(variant.training.name, variant.training.seed, variant.model.model_id) for variant in variants),
    ]  # fmt: skip


def settings_of(seed: int, max_steps: int) -> Configuration:
    """Settings of an evaluation. max_steps: 0 for the stage's own."""
    steps = [f"evaluation.max_steps={max_steps}"] if max_steps else []
    return configure(seed=seed, settings=[f"evaluation.success_m={SUCCESS_M}", *steps])


def acted_runs(data: PolicyRooms, policies: Sequence[ActingPolicy], max_steps: int, processes: int) -> Iterator[ActedRun]:
    """Let all act in the held-out rooms, by so many processes; what was measured before is not measured again."""
    with mapped(processes) as spread:
        yield from spread(partial(_acted, data, max_steps), policies)


def _acted(data: PolicyRooms, max_steps: int, policy: ActingPolicy) -> ActedRun:
    lake, configuration = data.lake, settings_of(policy.seed, max_steps)
    with contextlib.redirect_stderr(io.StringIO()):  # a bar of its own would be drawn over that of the benchmark
        if policy.name == FACING:
            made = _facing(lake, data.held_out, configuration)
        else:
            made = run_policy(lake, policy.model_id or policy.name, configuration, episodes=dict.fromkeys(data.held_out, ()))
    return ActedRun(policy, made.policy, made.run_name, made.failed)


def _facing(lake: Lake, scenes: Sequence[str], configuration: Configuration) -> Evaluated:
    """The experts that policies learn from, as a batch by others: they end with the target in view, which those of episodes need not."""
    reader, walks = lake.snapshot(), WalkConfig(facing=True, stop_m=STOP_M)
    trajectories = []
    for mesh in (row for scene in scenes for row in reader.rows(Navmesh, scene)):
        finder = path_finder(lake.blobs[mesh.navmesh_blob], f"{mesh.scene_id} {mesh.navmesh_blob[:12]}.navmesh")
        for episode in reader.rows(Episode, mesh.scene_id):
            walk = walk_of(episode, mesh.scene_id, finder, walks)
            actions = episode.actions if walk is None else tuple(ACTIONS[action] for action in walk.done)
            trajectories.append({"scene_id": episode.scene_id, "episode_id": episode.episode_id, "actions": actions})
    mark = digest(canonical_json(trajectories), canonical_json(configuration.stages["evaluation"]), code_fingerprint("tasks.evaluation"))
    document = {"batch_id": f"expert-facing-{mark[:16]}", "policy": FACING, "run_name": "built-in", "trajectories": trajectories}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "batch.json"
        file.write_text(json.dumps(document))
        return import_trajectories(lake, file, configuration)


def in_view_at_start(data: PolicyRooms, config: EvaluationConfig) -> list[str]:
    """Episodes of held-out rooms whose target is in the first picture, as `<scene> <episode>`: as evaluation sees the end."""
    lake = data.lake
    reader, names = lake.snapshot(), []
    for scene in data.held_out:
        placements, episodes = reader.rows(Placement, scene), reader.rows(Episode, scene)
        assets = reader.rows_by_key(Asset, sorted({row.asset_id for row in placements}))
        shells = reader.rows(Shell, scene)
        sights = SceneSights(
            shells[0] if shells else None, tuple(placements), tuple(reader.rows(Instance, scene)), tuple(assets), lake.blobs
        )
        starts = [(row.instance_id, (*row.start_position[:2], row.start_yaw_radians)) for row in episodes]
        names += [
            f"{scene} {row.episode_id}" for row, is_seen in zip(episodes, sights.seen(starts, config), strict=True) if is_seen
        ]  # fmt: skip
    return names


def acted_figures(data: PolicyRooms, runs: Sequence[ActedRun], max_steps: int) -> dict[str, dict[str, Any]]:
    """Figures of all who acted, of all seeds together, by name; `by_seed` has the share of targets found with each seed.

    Wilson's intervals take trajectories as independent, which those of one room, or of one episode by several seeds, are not quite.
    """
    named: dict[str, list[ActedRun]] = {}
    for run in runs:
        named.setdefault(run.policy.name, []).append(run)
    in_view = in_view_at_start(data, settings_of(0, max_steps).stages["evaluation"])
    figures = {}
    with data.lake.snapshot().connect() as connection:
        for name, own in named.items():
            by_seed = [run_figures(connection, in_view, [run])["found"] for run in own]
            figures[name] = {"seeds": len(own), **run_figures(connection, in_view, own), "by_seed": by_seed}
    return figures


def run_figures(connection: duckdb.DuckDBPyConnection, in_view: Sequence[str], runs: Sequence[ActedRun]) -> dict[str, Any]:
    """Figures of some runs of one policy together. in_view: Episodes whose target is in view at the start, as `<scene> <episode>`."""
    given = {"in_view": list(in_view), "success_m": SUCCESS_M, "policy": runs[0].label, "runs": [run.run_name for run in runs]}
    row: dict[str, Any] = connection.sql(FIGURES, params=given).to_arrow_table().to_pylist()[0]
    return row


def failures(runs: Sequence[ActedRun]) -> list[str]:
    """Rooms in which somebody could not act, a line each."""
    return [f"{run.policy.name} {run.policy.seed}: {line}" for run in runs for line in run.failed]


def points_between(figures: Mapping[str, Any], name: str, other: str) -> tuple[float, float]:
    """By how many points [%] somebody finds more targets than another does, and how far their intervals are apart; below 0 where they
    overlap."""
    above = 100 * (figures[name]["found"] - figures[other]["found"])
    return above, 100 * (figures[name]["found_interval"]["low"] - figures[other]["found_interval"]["high"])
